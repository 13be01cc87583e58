"""Checks of the Embree reference: closed forms against PROJ, a closed mesh, a shadow of known
length.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyproj
import pytest
import rasterio

pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")

from helpers.embree_mesh import (
    RADIUS_M,
    Mesh,
    Nodes,
    map_to_lonlat,
    mcmf,
    read_nodes,
    sun_direction,
)
from helpers.embree_sites import STERE
from helpers.products import EQC, geotiff


def test_places_are_projs():
    rng = np.random.default_rng(7)
    lon, lat = rng.uniform(-180, 180, 200), rng.uniform(-90, 90, 200)
    height = rng.uniform(-9e3, 11e3, 200)
    to_mcmf = pyproj.Transformer.from_crs(
        "+proj=longlat +R=1737400", "+proj=geocent +R=1737400 +units=m", always_xy=True
    )
    theirs = np.stack(to_mcmf.transform(lon, lat, height), axis=-1)
    assert np.abs(mcmf(lon, lat, height) - theirs).max() < 1e-6


@pytest.mark.parametrize(
    ("crs", "reach_m"),
    [(EQC, 2.7e6), (EQC.replace("lat_ts=0", "lat_ts=47"), 1.8e6)]
    + [(STERE.format(sign * 90), 6e5) for sign in (1, -1)],
)
def test_maps_are_projs(crs, reach_m):
    x, y = np.random.default_rng(8).uniform(-reach_m, reach_m, (2, 200))
    back = pyproj.Transformer.from_crs(crs, "+proj=longlat +R=1737400", always_xy=True)
    ours = map_to_lonlat(rasterio.CRS.from_string(crs), x, y)
    assert np.abs(mcmf(*ours) - mcmf(*back.transform(x, y))).max() < 1e-5


BALL_M = 1000.0


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Mesh:
    """The whole Moon, 1000 m above the sphere, in pixels of half a degree, read like any other DEM:
    seam and poles must be closed.
    """
    heights = np.full((360, 720), BALL_M, "f4")
    half_moon = np.pi * RADIUS_M
    path = geotiff(
        tmp_path_factory.mktemp("ball") / "ball.tif", heights, 0.0, half_moon / 2, half_moon / 360
    )
    nodes = read_nodes(path, 0.0, 90.0, 2.0 * half_moon)
    north = Mesh(replace(nodes, pole=1), np.zeros(3))
    assert nodes.is_ring
    assert nodes.pole == -1
    assert north.count == 2 * 359 * 720 + 720
    return north


@pytest.mark.slow
def test_the_ring_and_the_pole_are_closed(ball):
    """Rays from the Moon's centre meet the mesh everywhere, also at the seam and the north pole."""
    lon = np.append(np.random.default_rng(9).uniform(0, 360, 4000), [0.0, 359.9, 0.1, 12.0])
    lat = np.append(np.random.default_rng(10).uniform(-89, 90, 4000), [3.0, -60.0, 89.9, 90.0])
    outward = (mcmf(lon, lat) / RADIUS_M).astype(np.float32)
    distance = ball.scene.run(np.zeros_like(outward), outward, query="DISTANCE")
    lowest = (RADIUS_M + BALL_M) * np.cos(np.radians(0.5 / np.sqrt(2.0)))
    assert distance.min() > lowest - 0.5
    assert distance.max() < RADIUS_M + BALL_M + 0.5


def test_a_bare_ball_is_lit_on_the_sunny_side(ball):
    """Neighbouring facets differ by half a degree: half a degree about the terminator is left out."""
    sun = sun_direction(40.0, 20.0, 70.0, 30.0)
    rng = np.random.default_rng(11)
    points = mcmf(rng.uniform(0, 360, 4000), rng.uniform(-89, 89, 4000), BALL_M)
    height = np.degrees(np.arcsin(points @ sun / (RADIUS_M + BALL_M)))
    lit, found, _ = ball.lit(points, sun)
    clear = np.abs(height) > 0.5
    assert found.all()
    assert np.array_equal(lit[clear], height[clear] > 0.0)


@pytest.mark.parametrize("elevation_deg", [0.5, 2.0, 10.0])
def test_a_peaks_shadow_ends_where_the_sphere_says(elevation_deg):
    """On a smooth sphere the top of a peak of height H, an angle t away, has the elevation tan e =
    ((R + H) cos t - R) / ((R + H) sin t); on a plane its shadow would be longer by a third at a Sun
    elevation of 2 degrees, three times as long at half a degree.
    """
    peak_m, step = 2000.0, 1.0 / 64.0
    lon, lat = np.meshgrid(np.arange(-64, 257) * step, np.arange(8, -9, -1) * step)
    heights = np.where((lon == 0.0) & (lat == 0.0), peak_m, 0.0)
    mesh = Mesh(Nodes(lon, lat, heights, False, 0), mcmf(0.0, 0.0))
    away, top = np.radians(np.linspace(4.0, 0.02, 40_000)), RADIUS_M + peak_m
    stands = np.degrees(np.arctan2(top * np.cos(away) - RADIUS_M, top * np.sin(away)))
    tip_deg = np.degrees(np.interp(elevation_deg, stands, away))
    sun = sun_direction(tip_deg, 0.0, 270.0, elevation_deg)
    lit, _, _ = mesh.lit(mcmf(tip_deg * np.array([0.5, 0.99, 1.01]), np.zeros(3)), sun)
    assert lit.tolist() == [False, False, True]
