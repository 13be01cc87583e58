"""Shadows of every tier at the extremes: no crash, no dark node without a height or without relief,
symmetric results for symmetric scenes, the same for any number of threads.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.synthetic import cratered
from helpers.twins_extremes import KILOMETRES_20, facets, terrains

from lcp_catalog.accuracy import TIERS
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import occluded, occluded_sweep
from lcp_catalog.threads import limit_threads, thread_limit

TERRAINS = terrains()
GSD = 0.5
EVERY = pytest.mark.parametrize("tier", TIERS)
PROVED = pytest.mark.parametrize("tier", [t for t in TIERS if TIERS[t].exact])
AZIMUTHS = [0.0, 1e-6, 20.0, 45.0, 90.0, 135.0, 160.0, 180.0, 225.0, 270.0, 315.0, 333.0, 359.999]
ELEVATIONS = [90.0, 89.9, 60.0, 0.1, 1e-6, 0.0, -1e-6, -30.0, -89.9]


def sun(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])


def field(name: str) -> Heightfield:
    return Heightfield(TERRAINS[name], GSD, -1.0, 1.0)


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Thousands of small calls."""
    with limit_threads(1):
        yield


@pytest.mark.slow
@EVERY
def test_no_crash_and_no_dark_node_without_a_height(tier):
    for name in TERRAINS:
        _check_darkness(name, tier)


def _check_darkness(name, tier):
    f = field(name)
    holes, flat = np.isnan(f.z_m), len(np.unique(f.z_m[~np.isnan(f.z_m)])) < 2
    for azimuth in AZIMUTHS[::2]:
        for elevation in [*ELEVATIONS, -90.0]:
            dark = occluded(f, sun(azimuth, elevation), TIERS[tier])
            case = f"{name}, azimuth {azimuth}, elevation {elevation}"
            assert dark.shape == f.shape, case
            assert dark.dtype == np.bool_
            assert not dark[holes].any(), case
            if TIERS[tier].exact:
                traced = f.occluded_nodes(sun(azimuth, elevation))
                np.testing.assert_array_equal(dark, traced, case)
            if elevation == 90.0 or min(f.shape) == 1:
                assert not dark.any(), case
            if flat and elevation > 0.0:
                assert not dark.any(), case
        several = occluded_sweep(f, math.radians(azimuth), np.radians(ELEVATIONS), TIERS[tier])
        assert several.shape == (len(ELEVATIONS), *f.shape), name
        assert not several[:, holes].any(), name


@EVERY
def test_level_terrain_is_lit_by_any_sun_above_the_horizon(tier):
    suns = [sun(azimuth, e) for azimuth in AZIMUTHS for e in (1e-6, 0.1, 45.0, 89.9, 90.0)]
    for height in (0.0, KILOMETRES_20, -KILOMETRES_20, 1.0 / 3.0):
        for gsd in (0.5, 118.45, 10_000.0):
            z = np.full((40, 33), height, np.float32)
            for hole in (False, True):
                z[7:11, 20:] = np.nan if hole else height
                f = Heightfield(z, gsd)
                for direction in suns:
                    dark = occluded(f, direction, TIERS[tier])
                    assert not dark.any(), (height, gsd, hole, direction)


@EVERY
def test_a_sun_above_the_steepest_facet_lights_all_nodes(tier):
    for name in (n for n, z in TERRAINS.items() if np.isfinite(z).all()):
        f = field(name)
        z = f.z_m.astype(float)
        slopes = [0.0]
        for i, j, upper in facets(z):
            side = (z[i, j + 1], z[i + 1, j])[not upper]
            slopes.append(math.hypot(side - z[i, j], z[i + 1, j + 1] - side) / GSD)
        steepest = math.degrees(math.atan(max(slopes) * (1 + 1e-5)))
        for azimuth in AZIMUTHS:
            dark = occluded(f, sun(azimuth, steepest + 1e-9), TIERS[tier])
            assert not dark.any(), (name, azimuth)


def scenes() -> dict[str, np.ndarray]:
    """Terrains large enough for the scans, with different numbers of rows and columns."""
    craters = cratered(48)[:, :37]
    cliffs = np.where(craters > 0, KILOMETRES_20, -KILOMETRES_20).astype(np.float32)
    holes = craters.copy()
    holes[np.random.default_rng(2).random(craters.shape) < 0.1] = np.nan
    spikes = np.zeros_like(craters)
    spikes[[3, 20, 40], [5, 30, 11]] = 100.0
    spikes[[10, 33], [17, 2]] = -100.0
    return {"craters": craters, "cliffs": cliffs, "holes": holes, "spikes": spikes}


SCENES = scenes()
LIT = [(a, e) for a in AZIMUTHS for e in (0.1, 20.0)]


@EVERY
@pytest.mark.parametrize("name", SCENES)
def test_transposed_terrain_has_the_transposed_shadows(name, tier):
    """Rows and columns exchanged: the diagonals keep their direction, east becomes south."""
    z = SCENES[name]
    for azimuth, elevation in LIT:
        east, north, up = sun(azimuth, elevation)
        here = occluded(Heightfield(z, 20.0), [east, north, up], TIERS[tier])
        there = occluded(Heightfield(z.T, 20.0), [-north, -east, up], TIERS[tier])
        np.testing.assert_array_equal(here, there.T, f"{azimuth, elevation}")


@EVERY
@pytest.mark.parametrize("name", SCENES)
def test_terrain_turned_by_180_degrees_has_the_turned_shadows(name, tier):
    z = SCENES[name]
    for azimuth, elevation in LIT:
        east, north, up = sun(azimuth, elevation)
        here = occluded(Heightfield(z, 20.0), [east, north, up], TIERS[tier])
        there = occluded(Heightfield(z[::-1, ::-1], 20.0), [-east, -north, up], TIERS[tier])
        np.testing.assert_array_equal(here, there[::-1, ::-1], f"{azimuth, elevation}")


@EVERY
@pytest.mark.parametrize("name", SCENES)
def test_terrain_without_change_along_columns_may_be_mirrored(name, tier):
    """On a ridge along a row or column the diagonals have no effect: east and west may be
    exchanged.
    """
    ridge = SCENES[name][20:21].repeat(30, axis=0)
    for azimuth, elevation in LIT:
        east, north, up = sun(azimuth, elevation)
        here = occluded(Heightfield(ridge, 20.0), [east, north, up], TIERS[tier])
        there = occluded(Heightfield(ridge[:, ::-1], 20.0), [-east, north, up], TIERS[tier])
        np.testing.assert_array_equal(here, there[:, ::-1], f"{azimuth, elevation}")


@EVERY
@pytest.mark.parametrize("name", SCENES)
def test_threads_do_not_matter(name, tier):
    f = Heightfield(SCENES[name], 20.0)
    with limit_threads(1):
        one = [occluded(f, sun(*angles), TIERS[tier]) for angles in LIT]
    with limit_threads(thread_limit()):
        for angles, mask in zip(LIT, one, strict=True):
            np.testing.assert_array_equal(occluded(f, sun(*angles), TIERS[tier]), mask)


@PROVED
@pytest.mark.parametrize("name", SCENES)
def test_a_window_is_a_part_of_the_whole(name, tier):
    f = Heightfield(SCENES[name], 20.0)
    for window in ((0, 1, 0, 1), (47, 48, 36, 37), (5, 41, 7, 8), (9, 10, 0, 37), (3, 3, 5, 9)):
        row0, row1, col0, col1 = window
        for angles in LIT[::2]:
            part = occluded(f, sun(*angles), TIERS[tier], window)
            whole = occluded(f, sun(*angles), TIERS[tier])
            np.testing.assert_array_equal(part, whole[row0:row1, col0:col1])


@pytest.mark.parametrize("azimuth", [1e-9, 90.0 + 1e-9, 180.0 - 1e-9])
def test_a_ray_that_just_leaves_the_raster(azimuth):
    """At the raster's last column (or row) a tiny angle decides if there is terrain ahead."""
    f = Heightfield(SCENES["craters"], 20.0)
    dark = occluded(f, sun(azimuth, 5.0), TIERS["high"])
    np.testing.assert_array_equal(dark, f.occluded_nodes(sun(azimuth, 5.0)))


@EVERY
def test_invalid_directions_are_refused(tier):
    for bad in ([0, 0, 0], [math.nan, 0, 1], [math.inf, 0, 0], [0, 1, -math.inf]):
        with pytest.raises(ValueError, match="direction"):
            occluded(field("whole numbers"), bad, TIERS[tier])
