"""Levels of the maps of a large region, against loops over nodes and cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lcp_catalog.catalog.maps import coverage_levels, overview_levels
from lcp_catalog.catalog.model import Coverage, Overview
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.map_plane import EQUIRECTANGULAR
from lcp_catalog.production.region_maps import coverage_cells
from lcp_catalog.terrain.area import Area

MOON = Area.from_bounds(-180.0, -90.0, 180.0, 90.0)


@pytest.mark.parametrize("shape", [(16, 32), (17, 35), (9, 3), (1, 5), (1, 1)])
def test_a_node_of_a_level_is_the_mean_of_the_known_nodes_of_the_level_before(
    shape: tuple[int, int],
) -> None:
    rng = np.random.default_rng(4)
    height = rng.normal(0.0, 1e3, shape).astype(np.float32)
    height[rng.random(shape) < 0.3] = np.nan
    x, y = np.arange(shape[1]) * 1e3, -np.arange(shape[0]) * 1e3
    levels = overview_levels(Overview(height, x, y, 0.0, 0.0, EQUIRECTANGULAR))
    assert len(levels) == 3
    for found in levels:
        rows, cols = (max(1, length // 2) for length in height.shape)
        assert found.height.shape == (rows, cols) == (len(found.y), len(found.x))
        for r in range(rows):
            for c in range(cols):
                nodes = height[2 * r : 2 * r + 2, 2 * c : 2 * c + 2]
                known = nodes[~np.isnan(nodes)].astype(np.float64)
                expected = np.float32(known.mean()) if len(known) else np.nan
                np.testing.assert_allclose(found.height[r, c], expected, rtol=1e-6)
        for axis, coarse in ((x, found.x), (y, found.y)):
            for k, middle in enumerate(coarse):
                assert middle == axis[2 * k : 2 * k + 2].mean()
        height, x, y = found.height, found.x, found.y


def test_an_overview_and_a_coverage_in_a_plane_have_no_levels() -> None:
    none = np.zeros(0)
    assert overview_levels(Overview(np.zeros((2, 2)), none, none, 0.0, 0.0)) == ()
    assert coverage_levels(Coverage(none, none, none.astype(np.uint8), 4e3)) is None


def test_cells_of_a_level_count_the_cells_whose_centres_lie_in_them() -> None:
    rng = np.random.default_rng(8)
    lon, lat, step_m = coverage_cells(MOON, 4e3, 3000)
    status = rng.integers(0, 6, len(lon)).astype(np.uint8)
    usable = rng.choice(np.array([0, 1, 255], np.uint8), (len(lon), 2, 3, 4))
    usable[lat < -70.0] = 255
    found = coverage_levels(Coverage(lon, lat, status, 4e3, usable, step_m))
    assert found is not None
    for factor in (2, 4, 8):
        rings = math.ceil(math.pi * MOON_RADIUS_M / (factor * step_m))
        expected: dict[tuple[float, float], list[int]] = {}
        for cell, (x, y) in enumerate(zip(lon, lat, strict=True)):
            ring = math.floor((y + 90.0) * rings / 180.0)
            middle = -90.0 + (ring + 0.5) * 180.0 / rings
            across = max(1, round(2 * rings * math.cos(math.radians(middle))))
            column = math.floor(x / 360.0 * across)
            place = round((column + 0.5) * 360.0 / across, 6), round(middle, 6)
            expected.setdefault(place, []).append(cell)
        rows = np.flatnonzero(found.factor == factor)
        assert len(rows) == len(expected)
        for row in rows:
            own = expected[round(found.longitude[row], 6), round(found.latitude[row], 6)]
            np.testing.assert_array_equal(found.cells[row], np.bincount(status[own], minlength=6))
            known = usable[own][usable[own] != 255]
            share = (known == 1).mean() if len(known) else np.nan
            np.testing.assert_allclose(found.usable_share[row], share, rtol=1e-6)
