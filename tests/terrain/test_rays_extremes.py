"""Rays at the extremes: Suns from the nadir to the zenith along every special line; cameras below,
on and near the surface and a million kilometres away; cliffs, spikes, holes and tiny rasters.

The reference computes in rational numbers (`twins_extremes`): ties are compared, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import pytest
from helpers.twins_extremes import (
    KILOMETRES_20,
    blocked,
    exact,
    first_hit,
    judged,
    judged_from,
    margins_from,
    terrains,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.threads import limit_threads

TERRAINS = terrains()
GSD = 0.5
"""Half a metre: between +20 and -20 km a cliff of 89.9993 degrees, and cell units without rounding.
"""

LINES = [
    *[(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)],
    *[(2, 1), (-1, 2), (-4, -1), (1, -2)],
]
"""East, north: along rows, columns and diagonals, and through every second or fourth row's nodes.
"""

TANGENTS = [
    0.0,
    *[math.tan(math.radians(e)) for e in (1e-6, 0.1, 89.9, -1e-6, -30.0, -89.9)],
    *[1.0, KILOMETRES_20 / GSD, 2 * KILOMETRES_20 / GSD, 4 * KILOMETRES_20 / GSD],
]
"""Rise over run; the last ones are the slopes of the cliffs and spikes."""

anyhow = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def field(name: str) -> Heightfield:
    return Heightfield(TERRAINS[name], GSD, -1.0, 1.0)


def place(f: Heightfield, u: float, v: float) -> tuple[float, float]:
    return f.x0_m + u * f.gsd_m, f.y0_m - v * f.gsd_m


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Thousands of calls with few rays."""
    with limit_threads(1):
        yield


@pytest.mark.slow
@pytest.mark.parametrize("name", TERRAINS)
def test_suns_along_every_special_line(name):
    f = field(name)
    turn = list(TERRAINS).index(name)  # every line meets every slope on every fourth terrain
    for k, (east, north) in enumerate(LINES):
        longest = max(abs(east), abs(north))
        for tangent in TANGENTS[(k + turn) % 4 :: 4]:
            ray = (east / longest, -north / longest, tangent * GSD)
            answer = f.occluded_nodes([east, north, longest * tangent])
            np.testing.assert_array_equal(answer, judged(f.z_m, ray), f"{east, north, tangent}")


@pytest.mark.parametrize("name", TERRAINS)
def test_suns_at_the_zenith_and_the_nadir(name):
    f = field(name)
    assert not f.occluded_nodes([0, 0, 1]).any()
    assert not f.occluded_nodes([1e-17, -1e-17, 1]).any()  # rounding of cos(90 deg)
    np.testing.assert_array_equal(f.occluded_nodes([0, 0, -1]), judged(f.z_m, (0.0, 0.0, -1.0)))


@pytest.mark.slow
@pytest.mark.parametrize("name", TERRAINS)
def test_points_in_the_middle_of_facets_and_edges(name):
    """Points on the surface other than nodes: inside a facet and on its three edges."""
    f = field(name)
    rows, cols = f.shape
    u, v = (
        a.ravel()
        for a in np.meshgrid(np.arange(0, cols - 0.5, 0.5), np.arange(0, rows - 0.5, 0.25))
    )
    heights = f.heights_at(*place(f, u, v))
    points = np.stack([*place(f, u, v), heights], axis=-1)
    chosen = np.random.default_rng(3).permutation(len(points))[:4]
    for east, north in LINES[:9]:
        longest = max(abs(east), abs(north))
        for tangent in (0.0, TANGENTS[1], 1.0, KILOMETRES_20 / GSD):
            ray = exact((east / longest, -north / longest, tangent * GSD))
            answer = f.occluded_points(points[chosen], [east, north, longest * tangent])
            for k, dark in zip(chosen, answer, strict=True):
                point = (u[k], v[k], heights[k])
                assert any(dark == said for said in _allowed(f, point, ray)), (point, ray)


def _allowed(f: Heightfield, point: tuple[float, float, float], ray) -> Iterator[bool]:
    """Results of the reference for a point; both values are allowed where the ray runs in the plane
    of a facet and crosses an edge at a position that float64 does not represent (a third of a
    cell).
    """
    if math.isnan(point[2]):
        yield False
        return
    for turn in (0.0, 1e-13, -1e-13):
        yield blocked(f.z_m, exact(point), (*ray[:2], ray[2] * (1 + Fraction(turn))))


CAMERAS = {
    "1 m over a node": (3.0, 2.0, 1.0),
    "on a node": (3.0, 2.0, 0.0),
    "1 m over an edge": (1.5, 2.0, 1.0),
    "1 m over a diagonal": (1.5, 1.5, 1.0),
    "1 m over a facet": (2.75, 3.5, 1.0),
    "30 km over a node": (2.0, 2.0, 30_000.0),
    "level with the plain, outside": (-8.0, 2.0, 0.0),
    "at the limb": (-1000.0, 2.0, 1.0),
    "a million km up": (2.0, 2.0, 1e9),
    "a million km east": (2e9, 2.0, 1.0),
    "a million km to the south-east": (1.9e9, 1.7e9, 1e9),
}
"""Column, row, and height above the surface there (above 0 outside)."""


def stand(f: Heightfield, camera: tuple[float, float, float]) -> tuple[float, float, float]:
    """A camera in cells, its height counted from the surface below it if there is one."""
    u, v, height = camera
    ground = float(f.heights_at(*place(f, u, v)))
    return u, v, height + (0.0 if math.isnan(ground) else ground)


@pytest.mark.slow
@pytest.mark.parametrize("name", TERRAINS)
def test_the_nodes_that_a_camera_sees(name):
    f = field(name)
    i, j = np.mgrid[: f.shape[0], : f.shape[1]]
    for camera, position in CAMERAS.items():
        u, v, z = stand(f, position)
        answer = f.occluded_nodes_from([*place(f, u, v), z])
        # a camera on the surface sees some of it edge-on, over crossings that float64 does not represent
        # (thirds of cells): there, off the grid's lines, a millionth of a millimetre is left to rounding
        named = (i == v) | (j == u) | (np.abs(i - v) == np.abs(j - u)) | (camera != "on a node")
        sure = named | (np.abs(margins_from(f.z_m, (u, v, z))) > 1e-9)
        np.testing.assert_array_equal(answer[sure], judged_from(f.z_m, (u, v, z))[sure], camera)


@pytest.mark.slow
@pytest.mark.parametrize("name", TERRAINS)
def test_the_hits_of_a_cameras_rays(name):
    f = field(name)
    aims = aims_over(f)
    for camera, position in CAMERAS.items():
        u, v, z = stand(f, position)
        origin = np.array([*place(f, u, v), z])
        got = f.first_hits(origin, aims - origin)
        for (east, north, up), s in zip(aims - origin, got, strict=True):
            ray = exact((east / GSD, -north / GSD, up))
            want = first_hit(f.z_m, exact((u, v, z)), ray)
            if s != pytest.approx(want, rel=1e-12, abs=1e-9, nan_ok=True):
                beside = list(_beside(f, (u, v, z), ray))
                alike = np.isclose(beside, want, rtol=1e-6, atol=1e-4, equal_nan=True)
                assert not alike.all(), (camera, s, want, ray)


def _beside(f: Heightfield, origin: tuple[float, float, float], ray) -> Iterator[float]:
    """Hits of rays that start and end slightly beside: a different result shows a grazing ray, or
    one along the raster's border.
    """
    u, v, z = origin
    for turn in (-1e-13, 1e-13):
        yield first_hit(f.z_m, exact(origin), (*ray[:2], ray[2] + abs(ray[2]) * Fraction(turn)))
    for off_u, off_v, off_z in (
        (1e-6, 1e-6, 1e-5),
        (-1e-6, -1e-6, 1e-5),
        (1e-6, -1e-6, -1e-5),
        (-1e-6, 1e-6, -1e-5),
    ):
        yield first_hit(f.z_m, exact((u + off_u, v + off_v, z + off_z)), ray)


def aims_over(f: Heightfield) -> np.ndarray:
    """Targets in ENU: some nodes, edges and insides of facets, on, above and below the surface."""
    rows, cols = f.shape
    rng = np.random.default_rng(5)
    u = np.concatenate([rng.integers(0, cols, 8), rng.integers(-1, 4 * cols, 8) / 4])
    v = np.concatenate([rng.integers(0, rows, 8), rng.integers(-1, 4 * rows, 8) / 4])
    ground = f.heights_at(*place(f, u, v))
    lift = rng.choice([0.0, -1.0, 1.0, 500.0], 16)
    return np.stack([*place(f, u, v), np.where(np.isnan(ground), 0.0, ground) + lift], axis=-1)


@pytest.mark.parametrize("name", TERRAINS)
def test_nothing_is_visible_from_below_the_surface(name):
    f = field(name)
    u, v, z = stand(f, (1.5, 2.25, -1.0))
    camera = [*place(f, u, v), z]
    if math.isfinite(float(f.heights_at(*camera[:2]))):
        assert f.occluded_nodes_from(camera)[np.isfinite(f.z_m)].all()
        assert np.isnan(f.first_hits(camera, aims_over(f) - np.array(camera))).all()


@pytest.mark.parametrize("name", TERRAINS)
def test_rays_straight_down_meet_every_node(name):
    f = field(name)
    i, j = np.mgrid[: f.shape[0], : f.shape[1]]
    x, y = place(f, j, i)
    ground = f.heights_at(x, y)
    for height in (KILOMETRES_20, KILOMETRES_20 + 1.0, 1e9):
        for k, n in np.ndindex(f.shape):
            got = f.first_hits([x[k, n], y[k, n], height], [[0.0, 0.0, -1.0]])[0]
            assert got == pytest.approx(height - ground[k, n], rel=1e-15, nan_ok=True)


@pytest.mark.parametrize("name", TERRAINS)
def test_a_camera_a_million_kilometres_away_is_a_direction(name):
    """Nodes whose parallel ray is clear of the terrain, or below it, by more than the parallax."""
    f = field(name)
    for direction in ([0.64, 0.48, 0.6], [-0.48, 0.64, 0.6], [0.3, -0.7, 1e-3], [0.1, 0.2, 1e5]):
        unit = np.array(direction) / np.linalg.norm(direction)
        longest = np.abs(unit[:2]).max()
        u, v, z = unit / longest * (1, -1, GSD)
        steeper, flatter = (judged(f.z_m, (u, v, z * (1 + turn))) for turn in (1e-6, -1e-6))
        sure = steeper == flatter
        far = f.occluded_nodes_from(unit * 1e9)
        assert sure.mean() > 0.9
        np.testing.assert_array_equal(far[sure], f.occluded_nodes(unit)[sure])


@anyhow
@given(
    z=st.tuples(st.integers(2, 6), st.integers(2, 6), st.integers(0, 2**32 - 1)),
    scale=st.sampled_from([1.0, 1024.0, KILOMETRES_20]),
    gsd=st.sampled_from([0.5, 1.0, 8192.0]),
    line=st.sampled_from(LINES[:8]),
    tangent=st.sampled_from([*TANGENTS, 0.25, 2.0**-40, 1e-300]),
    holes=st.sampled_from([0.0, 0.2, 0.6]),
)
def test_random_terrain_of_integers(z, scale, gsd, line, tangent, holes):
    """All nodes, ties included, for cells of half a metre to 8 km."""
    rng = np.random.default_rng(z[2])
    heights = (rng.integers(-1, 2, z[:2]) * scale).astype(np.float32)
    heights[rng.random(z[:2]) < holes] = np.nan
    ray = (float(line[0]), float(-line[1]), tangent * gsd)
    answer = Heightfield(heights, gsd).occluded_nodes([*line, tangent])
    np.testing.assert_array_equal(answer, judged(heights, ray))
