"""Planes of overview maps: there and back, north, extents, against pyproj."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.bounds import Bounds
from lcp_catalog.geometry.frames import lonlat_to_mcmf
from lcp_catalog.geometry.map_plane import MapPlane

SPHERE = f"+R={MOON_RADIUS_M} +units=m +no_defs"
PLANES = {
    f"+proj=eqc +lat_ts=30 +lat_0=30 +lon_0=200 {SPHERE}": MapPlane("equirectangular", 200.0, 30.0),
    f"+proj=stere +lat_0=90 +lon_0=0 {SPHERE}": MapPlane("polar stereographic", 0.0, 90.0),
    f"+proj=stere +lat_0=-90 +lon_0=40 {SPHERE}": MapPlane("polar stereographic", 40.0, -90.0),
    f"+proj=ortho +lat_0=26 +lon_0=3 {SPHERE}": MapPlane("orthographic", 3.0, 26.0),
}


@pytest.mark.parametrize("crs", PLANES)
def test_places_are_those_of_proj_and_come_back(crs: str) -> None:
    plane, rng = PLANES[crs], np.random.default_rng(5)
    near = 50.0 if plane.projection == "orthographic" else 180.0
    lon = plane.center_lon + rng.uniform(-near, near, 400)
    lat = np.clip(plane.center_lat + rng.uniform(-60.0, 60.0, 400), -89.0, 89.0)
    x, y = plane.at(lon, lat)
    px, py = pyproj.Proj(crs)((lon + 180.0) % 360.0 - 180.0, lat)
    shown = np.isfinite(x) & np.isfinite(px)
    assert shown.mean() > 0.7
    np.testing.assert_allclose(x[shown], np.array(px)[shown], atol=1e-3)
    np.testing.assert_allclose(y[shown], np.array(py)[shown], atol=1e-3)
    back = lonlat_to_mcmf(*plane.lonlat(x[shown], y[shown]))
    np.testing.assert_allclose(back, lonlat_to_mcmf(lon[shown], lat[shown]), atol=1e-2)
    up = np.array(plane.at(lon, lat + 1e-4)) - np.array([x, y])
    turn = np.degrees(np.arctan2(*up)) - plane.north(lon, lat)
    assert np.nanmax(np.abs((turn[shown] + 180.0) % 360.0 - 180.0)) < 0.01


@pytest.mark.parametrize(
    ("box", "projection", "center"),
    [
        (Bounds(-180.0, -60.0, 180.0, 60.0), "equirectangular", (0.0, 0.0)),
        (Bounds(-180.0, -90.0, 180.0, 90.0), "equirectangular", (0.0, 0.0)),
        (Bounds(0.0, 60.0, 360.0, 90.0), "polar stereographic", (0.0, 90.0)),
        (Bounds(-180.0, -90.0, 180.0, -50.0), "polar stereographic", (0.0, -90.0)),
        (Bounds(150.0, -20.0, 250.0, 30.0), "equirectangular", (200.0, 5.0)),
    ],
)
def test_the_plane_suits_the_box(box: Bounds, projection: str, center: tuple[float, float]) -> None:
    plane = MapPlane.showing(box)
    assert (plane.projection, plane.center_lon, plane.center_lat) == (projection, *center)
    x0, x1, y0, y1 = plane.extent_m(box)
    lon, lat = np.meshgrid(
        np.linspace(box.west, box.east, 50), np.linspace(box.south, box.north, 50)
    )
    x, y = plane.at(lon, lat)
    assert x0 - 1 <= x.min() <= x.max() <= x1 + 1
    assert y0 - 1 <= y.min() <= y.max() <= y1 + 1


def test_a_plane_has_a_known_projection() -> None:
    with pytest.raises(ValueError, match="unknown projection"):
        MapPlane("mercator", 0.0, 0.0)
    with pytest.raises(ValueError, match="at a pole"):
        MapPlane("polar stereographic", 0.0, 60.0)
