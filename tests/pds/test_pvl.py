"""The language of labels: comments, lists, units, nesting, repeated keys."""

from __future__ import annotations

from lcp_catalog.pds.pds3 import Quantity, parse_pvl, text


def test_pvl() -> None:
    pvl = parse_pvl(
        """A = 1 /* not = this */
        B = {"x y
             z", 'w', 2 <km>}
        OBJECT = O
          C = 16#FF#
          GROUP = G
            D = 2009-07-13T17:33:17
          END_GROUP = G
        END_OBJECT = O
        ^E = ("F.IMG", 3 <BYTES>)
        A = 2
        END
        Z = 1"""
    )
    assert pvl == {
        "A": 1.0,
        "B": ["x y z", "w", Quantity(2.0, "KM")],
        "O": {"C": "16#FF#", "G": {"D": "2009-07-13T17:33:17"}},
        "^E": ["F.IMG", Quantity(3.0, "BYTES")],
    }


def test_text_of_a_list_is_its_first() -> None:
    pvl = parse_pvl('TARGET_NAME = {"Moon"}\nUNIT = 2 <km>\nEND')
    assert (text(pvl, "TARGET_NAME"), text(pvl, "UNIT"), text(pvl, "NONE")) == ("MOON", "2.0", "")
