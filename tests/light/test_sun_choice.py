"""A Sun as functions take it."""

from __future__ import annotations

import pytest

from lcp_catalog.errors import SunError
from lcp_catalog.light.sun_choice import SunChoice


def test_angles_an_instant_a_choice_or_nothing() -> None:
    assert SunChoice.of((96.5, 14)) == SunChoice(azimuth_deg=96.5, elevation_deg=14.0)
    assert SunChoice.of("1971-07-31T01:25:52") == SunChoice(time_utc="1971-07-31T01:25:52")
    assert SunChoice.of(SunChoice(subsolar_deg=(3.0, 1.0))).subsolar_deg == (3.0, 1.0)
    assert not SunChoice.of(None).is_stated


@pytest.mark.parametrize("sun", [5.0, (1.0, 2.0, 3.0), [1.0, 2.0], (1.0,)])
def test_anything_else_is_refused_in_words(sun: object) -> None:
    with pytest.raises(SunError, match="`sun` is azimuth and elevation, an instant or a SunChoice"):
        SunChoice.of(sun)  # type: ignore[arg-type]  # what is refused


@pytest.mark.parametrize("sun", [{"azimuth_deg": 1.0}, {"elevation_deg": 1.0}])
def test_one_angle_alone_is_refused(sun: dict[str, float]) -> None:
    with pytest.raises(SunError, match="go together"):
        SunChoice(**sun)  # type: ignore[arg-type]  # a part of the fields
