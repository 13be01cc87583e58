"""Exact horizons against shadow rays and brute force: a horizon is above a ray exactly where the
ray is blocked.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.random_heightfields import terrains
from helpers.synthetic import cratered
from helpers.twins import blocking, triangles
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lcp_catalog.terrain.far_terrain import HorizonPoints, Nodes, on_rim
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.threads import limit_threads, thread_limit

GSD, X0, Y0 = 4.0, 10.0, 20.0
ANY = (-1e9, 1e9)
"""Bounds between which every horizon of these terrains lies."""

quick = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


azimuths = st.sampled_from([0, 45, 90, 135, 180, 225, 270, 315]) | st.floats(0, 360)
elevations = st.sampled_from([0.0, 1e-6, 0.1, -5.0, 45.0, 80.0]) | st.floats(-60, 85)


def sun(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.sin(a) * math.cos(e), math.cos(a) * math.cos(e), math.sin(e)])


def all_nodes(field: Heightfield) -> Nodes:
    rows, cols = np.indices(field.shape)
    return Nodes(field, rows.ravel(), cols.ravel())


def horizons(seen: Nodes | HorizonPoints, ray: tuple, low: float, high: float) -> np.ndarray:
    return seen.horizons(np.array([[ray[0], ray[1], low, high]]))[:, 0]


@quick
@given(terrains(), azimuths, elevations)
def test_a_horizon_is_above_a_ray_where_the_ray_is_blocked(z, azimuth_deg, elevation_deg) -> None:
    """At a tie (a facet in the ray's own plane) the slope is the ray's but for rounding."""
    field = Heightfield(z, GSD, X0, Y0)
    ray = field.ray_in_cells(sun(azimuth_deg, elevation_deg))
    found = horizons(all_nodes(field), ray, *ANY)
    decided = abs(found - ray[2]) > 1e-9 * max(abs(ray[2]), 1.0)
    blocked = field.occluded_nodes(sun(azimuth_deg, elevation_deg)).ravel()
    np.testing.assert_array_equal((found > ray[2])[decided], blocked[decided])


@quick
@given(terrains(), azimuths)
def test_no_triangle_rises_above_a_horizon_and_one_reaches_it(z, azimuth_deg) -> None:
    field = Heightfield(z, GSD, X0, Y0)
    du, dv, _ = field.ray_in_cells(sun(azimuth_deg, 0.0))
    corners = triangles(z.astype(float))
    seen = all_nodes(field)
    for i, j, slope in zip(seen.rows, seen.cols, horizons(seen, (du, dv), *ANY), strict=True):
        origin = (float(j), float(i), float(z[i, j]))
        if math.isnan(origin[2]):
            assert slope == ANY[0]
            continue
        slack = 1e-6 * max(abs(slope), 1.0)
        if (
            slope > ANY[0]
        ):  # a ray along an edge, but for rounding, may meet either side: on one there can be a hole
            beside = (0.0, -1e-12, 1e-12) if min(abs(du), abs(dv)) < 1e-12 else (0.0,)
            assert any(
                blocking(
                    corners, origin, (du + aside * abs(dv), dv + aside * abs(du), slope - slack)
                )
                > 0.0
                for aside in beside
            )
        assert not blocking(corners, origin, (du, dv, max(slope, -1e6) + slack)) > 1e-9


@quick
@given(terrains(), azimuths, st.floats(-3.0, 3.0), st.floats(0.01, 3.0))
def test_bounds_clip_a_horizon_and_change_nothing_else(z, azimuth_deg, low, width) -> None:
    """Equal but for rounding: the parts skipped as too low depend on the slope they are compared
    with.
    """
    field = Heightfield(z, GSD, X0, Y0)
    ray = field.ray_in_cells(sun(azimuth_deg, 0.0))
    free = horizons(all_nodes(field), ray, *ANY)
    bound = horizons(all_nodes(field), ray, low, low + width)
    np.testing.assert_allclose(bound, np.clip(free, low, low + width), rtol=1e-12, atol=1e-12)


@quick
@given(terrains(), azimuths, elevations, st.integers(0, 2**32 - 1))
def test_points_of_the_surface_agree_with_their_shadow_rays(
    z, azimuth_deg, elevation_deg, seed
) -> None:
    field = Heightfield(z, GSD, X0, Y0)
    rng = np.random.default_rng(seed)
    x = X0 + rng.random(40) * (z.shape[1] - 1) * GSD
    y = Y0 - rng.random(40) * (z.shape[0] - 1) * GSD
    lift = rng.choice([0.0, 5e-4, -5e-4, 3.0, -3.0], 40)
    points = np.stack([x, y, field.heights_at(x, y) + lift], axis=-1)
    ray = field.ray_in_cells(sun(azimuth_deg, elevation_deg))
    found = horizons(HorizonPoints(field, points), ray, *ANY)
    decided = abs(found - ray[2]) > 1e-6 * max(abs(ray[2]), 1.0)
    blocked = field.occluded_points(points, sun(azimuth_deg, elevation_deg))
    np.testing.assert_array_equal((found > ray[2])[decided], blocked[decided])


def test_nodes_as_points_have_the_same_horizons() -> None:
    z = cratered(48)
    z[20:24, 30:33] = np.nan
    field = Heightfield(z, GSD, X0, Y0)
    seen = all_nodes(field)
    x, y = X0 + seen.cols * GSD, Y0 - seen.rows * GSD
    points = HorizonPoints(field, np.stack([x, y, z.ravel().astype(float)], axis=-1))
    planes = np.array([(*field.ray_in_cells(sun(a, 0.0))[:2], *ANY) for a in (0, 37, 135, 300)])
    np.testing.assert_array_equal(points.horizons(planes), seen.horizons(planes))


def test_threads_change_nothing() -> None:
    field = Heightfield(cratered(96), 20.0)
    planes = np.array([(*field.ray_in_cells(sun(a, 0.0))[:2], *ANY) for a in (12, 250)])
    answers = []
    for threads in (1, thread_limit()):
        with limit_threads(threads):
            answers.append(all_nodes(field).horizons(planes))
    np.testing.assert_array_equal(*answers)


@pytest.mark.parametrize("slope", [(0.3, 0.0), (0.0, -0.7), (0.2, 0.5)])
def test_a_plane_is_as_steep_as_it_is(slope) -> None:
    rows, cols = np.indices((9, 7))
    z = cols * slope[0] * GSD + rows * slope[1] * GSD
    assert Heightfield(z, GSD).steepest_tangent == pytest.approx(math.hypot(*slope), rel=1e-6)


@quick
@given(terrains())
def test_the_steepest_gradient_is_that_of_the_steepest_triangle(z) -> None:
    corners = triangles(z.astype(float))
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(e * [GSD, GSD, 1.0], f * [GSD, GSD, 1.0])
    expected = np.max(np.hypot(normal[:, 0], normal[:, 1]) / abs(normal[:, 2]), initial=0.0)
    assert Heightfield(z, GSD).steepest_tangent == pytest.approx(expected, rel=1e-9, abs=1e-12)


@quick
@given(terrains())
def test_the_rim_is_beside_what_is_missing(z) -> None:
    field = Heightfield(z, GSD)
    padded = np.pad(np.isnan(z), 1, constant_values=True)
    beside = np.zeros(z.shape, dtype=bool)
    for a in range(3):
        for b in range(3):
            beside |= padded[a : a + z.shape[0], b : b + z.shape[1]]
    np.testing.assert_array_equal(on_rim(field, field.whole), beside & ~np.isnan(z))
    row0, row1, col0, col1 = window = (1, z.shape[0], 0, z.shape[1] - 1)
    np.testing.assert_array_equal(
        on_rim(field, window), (beside & ~np.isnan(z))[row0:row1, col0:col1]
    )
