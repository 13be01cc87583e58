"""Places in a box of longitudes and latitudes, by their integer degrees going east from its west edge."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.geometry.bounds import Bounds

BOXES = (
    Bounds(10.0, -20.0, 30.0, 40.0),
    Bounds(350.0, -5.0, 370.0, 5.0),
    Bounds(-170.0, 60.0, 170.0, 90.0),
    Bounds(0.0, -90.0, 360.0, 90.0),
)


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("turn", [-720, -360, 0, 360])
def test_a_box_contains_what_a_walk_east_from_its_west_edge_meets(box: Bounds, turn: int) -> None:
    walked = {step % 360 for step in range(int(box.west), int(box.east) + 1)}
    lon, lat = np.meshgrid(np.arange(360) + turn, np.arange(-90, 91))
    want = np.isin(lon % 360, [*walked]) & (lat >= box.south) & (lat <= box.north)
    np.testing.assert_array_equal(box.contains(lon, lat), want)


def test_a_longitude_that_rounds_to_a_whole_turn_is_on_the_west_edge() -> None:
    box = Bounds(0.0, -5.0, 20.0, 5.0)
    assert box.contains(-1e-17, 0.0)
    assert not box.contains(-1e-9, 0.0)
    assert not box.contains(np.nan, 0.0)
