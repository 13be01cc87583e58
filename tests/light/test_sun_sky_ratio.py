"""Sun over sky: which Suns are recognised as cut off, and what is made of them."""

import logging

import pytest
from helpers.environment_maps import Lamp, cie_sky, recorded, room, with_lamps

from lcp_catalog.errors import ImageError
from lcp_catalog.light.environment import Environment


def test_a_sun_that_is_cut_off_is_scaled_and_told(caplog):
    caplog.set_level(logging.WARNING)
    found = Environment.of(recorded(cut_at=200.0))
    assert found.ratio.scaled
    assert found.ratio.clipped
    assert found.split.sun_sky_ratio < 1.0
    assert found.used.sun_sky_ratio == pytest.approx(4.0)
    assert "one luminance" in caplog.text
    assert "scaled to 4" in caplog.text
    assert "`sun_sky_ratio` found" in caplog.text


def test_as_recorded_where_that_was_asked(caplog):
    caplog.set_level(logging.WARNING)
    found = Environment.of(recorded(cut_at=200.0), sun_sky_ratio=None)
    assert not found.ratio.scaled
    assert found.used is found.split
    assert "not scaled, as asked" in found.ratio.reason
    asked = Environment.of(recorded(cut_at=200.0), sun_sky_ratio=7.0)
    assert asked.used.sun_sky_ratio == pytest.approx(7.0)
    assert not caplog.text


@pytest.mark.parametrize(
    ("panorama", "clipped", "why"),
    [
        (recorded(over=1.0), False, "not cut off"),  # a weak Sun, but its glare has a peak
        (recorded(over=60.0, cut_at=1e4), False, "or more"),  # cut off and strong enough
        (recorded(elevation=20.0, cut_at=200.0), True, "20 deg high"),
        (room(180, [Lamp(0, 50, 1, 4.0)], 0.5), True, "too large for a Sun"),
        (room(180, [Lamp(0, 50, 1, 2), Lamp(90, 50, 1, 2)], 0.5), True, "as lamps are"),
        (cie_sky(64, 0.0, 50.0), False, "nothing to scale"),
        (with_lamps(cie_sky(64, 0.0, 50.0), [Lamp(0, 50, 1.0)]), False, "not cut off"),  # 1 pixel
    ],
)
def test_what_is_not_scaled(caplog, panorama, clipped, why):
    caplog.set_level(logging.WARNING)
    found = Environment.of(panorama)
    assert not found.ratio.scaled
    assert found.used is found.split
    assert why in found.ratio.reason
    assert found.ratio.clipped is clipped
    assert ("`sun_sky_ratio` RATIO" in caplog.text) is clipped


def test_a_number_needs_a_source():
    with pytest.raises(ImageError, match="no bright source"):
        Environment.of(cie_sky(64, 0.0, 50.0), sun_sky_ratio=4.0)
