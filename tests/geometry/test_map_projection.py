"""Map projections: against their closed forms (Snyder 1987, sphere); ellipsoids, prime meridians, units; refused CRSs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.snyder_maps import MAPS, R, geographic, places, sinusoidal

from lcp_catalog.cameras.map_projected import MapImage
from lcp_catalog.errors import ImageError, LabelError
from lcp_catalog.geometry.map_plane import MapProjection


@pytest.mark.parametrize("name", MAPS)
def test_projections_are_snyders(name: str) -> None:
    wkt, forward, *_ = MAPS[name]
    lon, lat = places(name)
    found, wanted = MapProjection(wkt).forward(lon, lat), forward(lon, lat)
    tolerance = 1e-9 if name == "geographic" else 1e-4
    np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance)


def test_period_of_cylinders_and_of_others() -> None:
    assert MapProjection(geographic()).period == pytest.approx(360.0, rel=1e-9)
    wkt = MAPS["cylindrical, true at 8, centred at 180"][0]
    circle = 2 * math.pi * R * math.cos(math.radians(8))
    assert MapProjection(wkt).period == pytest.approx(circle, rel=1e-12)
    assert MapProjection(MAPS["Mercator"][0]).period == pytest.approx(2 * math.pi * R, rel=1e-12)
    for name in ("north polar", "orthographic", "transverse Mercator", "sinusoidal"):
        assert math.isinf(MapProjection(MAPS[name][0]).period)


def test_latitudes_of_an_ellipsoid_are_geodetic() -> None:
    """Clarke: tan(geodetic) = (a/b)^2 tan(geocentric)."""
    flattening = 1.0 / (1738100.0 / (1738100.0 - 1736000.0))
    projection = MapProjection(geographic(1738100.0, 1 / flattening))
    lon, lat = projection.forward([10.0, 20.0, 30.0], [45.0, -60.0, 90.0])
    geodetic = np.degrees(np.arctan(np.tan(np.radians([45.0, -60.0])) * (1738100 / 1736000) ** 2))
    np.testing.assert_allclose(lat, [*geodetic, 90.0], atol=1e-9)
    np.testing.assert_allclose(projection.inverse(lon, lat)[1], [45.0, -60.0, 90.0], atol=1e-9)


def test_another_prime_meridian_is_minded() -> None:
    lon, _ = MapProjection(geographic(pm=15.0)).forward([20.0, 10.0], [0.0, 0.0])
    np.testing.assert_allclose(lon, [5.0, -5.0], atol=1e-12)


def test_grads_and_kilometres() -> None:
    grads = geographic().replace('"degree",0.0174532925199433', '"grad",0.015707963267948967')
    np.testing.assert_allclose(MapProjection(grads).forward(90.0, 45.0), (100.0, 50.0), atol=1e-9)
    assert MapProjection(grads).period == pytest.approx(400.0)
    km = MAPS["sinusoidal"][0].replace('UNIT["metre",1]', 'UNIT["kilometre",1000]')
    np.testing.assert_allclose(
        np.array(MapProjection(km).forward(-50.0, 20.0)) * 1e3, sinusoidal(-60)(np.array(-50.0), np.array(20.0)),
    )  # fmt: skip


@pytest.mark.parametrize(("wkt", "why"), [
    (geographic(6378137.0, 298.257), r"has radii 6378137/.* not the Moon's"),
    (geographic(1745000.0, 218.1), r"has radii 1745000/1736999"),
    (geographic(3396190.0), r"has radii 3396190/3396190 m"),
    ("nonsense", r"the CRS is not understood"),
    ('LOCAL_CS["local",UNIT["metre",1]]', r"neither geographic nor projected"),
])  # fmt: skip
def test_other_bodies_and_no_maps_are_refused(wkt: str, why: str) -> None:
    with pytest.raises(LabelError, match=why):
        MapProjection(wkt)
    with pytest.raises(ImageError, match=rf"^photo.tif: .*{why}"):
        MapImage(wkt, (1, 0, 0, 0, -1, 0), (10, 10), "photo.tif")
