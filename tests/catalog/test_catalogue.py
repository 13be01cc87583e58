"""A catalogue in memory: inconsistent contents are refused when it is made."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import catalogs

from lcp_catalog.catalog.model import Coverage
from lcp_catalog.catalog.schema import summarise_usable
from lcp_catalog.errors import CatalogError


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("gsd", np.ones(3), "gsd: 3 along point where others have 4"),
        ("dem", np.zeros((4, 9)), "dem: 2 dimensions"),
        ("dem", np.zeros((4, 8, 8)), "no centre node"),
        ("point_id", np.array([1.5, 2, 3, 4]), "not whole numbers"),
        ("condition", np.full((4, 3, 8, 24), 300), "condition: does not fit into u1"),
        ("condition", np.full((4, 3, 8, 24), 64, np.uint8), "has undefined bits"),
        ("longitude", np.array(["a"] * 4), "not numbers"),
        ("sources", "{", "sources: is not a list"),
    ],
)
def test_what_does_not_fit_is_refused_at_birth(name: str, value: object, text: str) -> None:
    with pytest.raises(CatalogError, match=text):
        catalogs.catalog(4, **{name: value})


def test_a_point_that_is_never_usable_may_lack_figures() -> None:
    spoilt = catalogs.arrays(2)
    spoilt["condition"][0] &= 15
    lowest, highest = summarise_usable(spoilt["condition"], spoilt["sun_elevation"])
    spoilt |= {"sun_elevation_min": lowest, "sun_elevation_max": highest}
    spoilt["second_peak"][0] = np.nan
    catalogs.Catalog(**spoilt)
    spoilt["second_peak"][1] = np.nan
    with pytest.raises(CatalogError, match="second_peak"):
        catalogs.Catalog(**spoilt)


def test_cells_of_different_lengths_are_refused() -> None:
    cells = Coverage(longitude=np.zeros(2), latitude=np.zeros(3), status=np.zeros(2), spacing_m=1.0)
    with pytest.raises(CatalogError):
        catalogs.catalog(1, coverage=cells)
