"""Maps seen through pixels: half a pixel's shift, the seam at 180 deg, the poles, and aliasing, on
maps whose every value is known.
"""

import math
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.cameras.view import looking_camera, oblique_view
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry import sphere_intersection
from lcp_catalog.geometry.frames import EnuFrame, direction_enu, lonlat_to_mcmf, mcmf_to_lonlat
from lcp_catalog.light.sources import Lighting
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.sphere_renderer import (
    PROBES_MOST,
    render_sphere_camera,
    render_sphere_enu,
    seen_through,
)
from lcp_catalog.terrain.area import NodeWindow

R = MOON_RADIUS_M
LAMBERT = reflectance_model("lambert")
EAST = np.array([[0.0, 1.0, 0.0]])


def write_map(path, value, columns=720, west=-180.0):
    """A global map with the value(longitude, latitude) of the pixel centres."""
    step = 360.0 / columns
    lon = west + (np.arange(columns) + 0.5) * step
    lat = 90.0 - (np.arange(columns // 2) + 0.5) * step
    degree = math.radians(1.0) * R
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=columns,
        height=columns // 2,
        count=1,
        dtype="float32",
        crs=pyproj.CRS.from_proj4(f"+proj=eqc +R={R} +units=m").to_wkt(),
        transform=rasterio.Affine(
            step * degree, 0, west * degree, 0, -step * degree, 90.0 * degree
        ),
    ) as file:
        file.write(np.asarray(value(*np.meshgrid(lon, lat)), dtype=np.float32), 1)
    return AlbedoMap.open(path, "linear", 1.0)


def waves(lon, lat):
    """Smooth all over the sphere, poles and seam included; not alike east and west, north and
    south.
    """
    x, y, z = np.moveaxis(lonlat_to_mcmf(lon, lat), -1, 0) / R
    return 1.0 + 0.2 * x + 0.1 * y - 0.15 * z + 0.3 * x * y + 0.2 * np.sin(4.0 * z + 2.0 * y)


@pytest.fixture(scope="module", params=[-180.0, 0.0], ids=["from180W", "from0"])
def wavy(request, tmp_path_factory):
    return write_map(tmp_path_factory.mktemp("map") / "waves.tif", waves, west=request.param)


def looked_up(ground, lon, lat, width_m, along_m=None):
    points = lonlat_to_mcmf(lon, lat)
    width = np.full(len(points), float(width_m))
    along = width if along_m is None else np.full(len(points), float(along_m))
    return seen_through(ground, points, width, along, np.broadcast_to(EAST, points.shape))


def test_no_half_pixel_and_no_seam(wavy):
    """Everywhere, on the seams and on the poles: half a pixel would be 0.002 to 0.006, a mirrored
    map 0.5.
    """
    rng = np.random.default_rng(4)
    lon = np.concatenate(
        [rng.uniform(-180, 360, 2000), [180.0, -180.0, 179.999, 0.0, 359.999, 360.0]]
    )
    lat = np.concatenate([np.degrees(np.arcsin(rng.uniform(-1, 1, 2000))), [3.0] * 6])
    assert looked_up(wavy, lon, lat, 2e3) == pytest.approx(waves(lon, lat), abs=2e-4)
    assert looked_up(wavy, lon, lat, 2e4) == pytest.approx(waves(lon, lat), abs=2e-3)


@pytest.mark.parametrize("pole", [90.0, -90.0])
def test_poles_are_places_like_others(wavy, pole):
    """The value at a pole does not depend on the longitude, and a ring around it has no edge."""
    lon = np.arange(0.0, 360.0, 7.0)
    for width in (2e3, 2e4, 1e5):
        there = looked_up(wavy, lon, np.full(lon.size, pole), width)
        assert np.ptp(there) < 4e-3
        assert there == pytest.approx(waves(0.0, pole), abs=1e-2)
        ring = looked_up(wavy, np.arange(0.0, 360.0, 0.05), np.full(7200, pole * 0.9999), width)
        assert np.abs(np.diff(ring)).max() < 2e-3


@settings(max_examples=60, deadline=None)
@given(st.floats(-180.0, 360.0), st.floats(-88.0, 88.0), st.floats(2.0, 4.8), st.floats(1.0, 16.0))
def test_a_footprint_is_a_mean(wavy, lon, lat, log_width, stretch):
    """Against the mean of the known function over the footprint: 41 x 41 places of an east-west
    rectangle of the ground.
    """
    width = 10.0**log_width
    along = min(width * stretch, 3e5)
    frame = EnuFrame(lon % 360.0, lat)
    step = (np.arange(41) + 0.5) / 41 - 0.5
    x, y = np.meshgrid(step * along, step * width)
    places = frame.to_mcmf(np.stack([x, y, np.zeros_like(x)], -1))
    true = waves(*mcmf_to_lonlat(places)[:2]).mean()
    found = seen_through(
        wavy, frame.origin_mcmf_m[None], np.array([width]), np.array([along]), frame.rotation[:1]
    )
    assert found[0] == pytest.approx(true, abs=6e-3)


def test_probes_lie_along_the_footprint(tmp_path):
    """Waves of 18 deg of longitude, footprints up to 9 deg long on them: along the waves' axis the mean
    over a box is a sinc, across it nothing is lost.
    """
    ground = write_map(
        tmp_path / "stripes.tif", lambda lon, _: 1.0 + 0.5 * np.sin(np.radians(20 * lon))
    )
    for along_deg in (2.0, 5.0, 9.0):
        along = math.radians(along_deg) * R
        for lon in (0.0, 2.0, 4.5, 7.0, 13.5):
            frame = EnuFrame(lon, 0.0)
            sides = np.array([along / 16]), np.array([along])
            found = [
                seen_through(ground, frame.origin_mcmf_m[None], *sides, axis[None])[0] - 1.0
                for axis in frame.rotation[:2]
            ]
            true = 0.5 * math.sin(math.radians(20 * lon))
            blur = np.sinc(20 * along_deg / 360.0) * np.sinc(20 * along_deg / 16 / 360.0)
            assert found[0] == pytest.approx(true * blur, abs=0.01)
            assert found[1] == pytest.approx(true, abs=0.02)


def noise(lon, lat):
    return np.random.default_rng(8).uniform(0.0, 2.0, np.shape(lon))


def test_detail_below_a_pixel_does_not_alias(tmp_path):
    """White noise of 15 km pixels, sigma 0.577, through pixels n times as wide: what is left must
    fall like that of means over n x n pixels, here within a factor of 1.6.
    """
    ground = write_map(tmp_path / "noise.tif", noise)
    frame = EnuFrame(0.0, 0.0)
    for pixels, wide in ((60, 3.8), (24, 9.5)):
        camera = looking_camera(frame, [0, 0, 1e9], 2 * R / pixels, (2 * R, 2 * R))
        light = Lighting.of_sun(direction_enu(0, 90))
        plain, mapped = (
            render_sphere_camera(frame, camera, light, model=LAMBERT, albedo=a)
            for a in (None, ground)
        )
        factor = mapped.radiance / plain.radiance
        inner = plain.emission_deg < 45.0
        assert factor[inner].mean() == pytest.approx(1.0, abs=0.02)
        assert factor[inner].std() < 1.6 * 0.577 / wide
        assert factor[inner].std() > 0.2 * 0.577 / wide
        limb = (plain.emission_deg > 60.0) & (plain.visible > 0)
        assert factor[limb].std() < 0.577 / wide


def test_a_slanting_view_of_noise_against_brute_force(tmp_path):
    """From 200 km, 62 to 75 deg off the vertical, ground of 8 km noise: pixels 6 to 20 km wide and up to
    five times as long, each against 15 x 15 rays.
    """
    ground = write_map(tmp_path / "noise.tif", noise, 1440)
    frame = EnuFrame(60.0, 20.0)
    camera = looking_camera(frame, [0.0, -420e3, 200e3], 10e3, (240e3, 100e3))
    light = Lighting.of_sun(direction_enu(0, 60))
    plain, mapped = (
        render_sphere_camera(frame, camera, light, model=LAMBERT, albedo=a) for a in (None, ground)
    )
    step = (np.arange(15) + 0.5) / 15 - 0.5
    found, true = [], []
    for i, j in np.argwhere(plain.visible == 1.0):
        rays = camera.rays(np.stack(np.meshgrid(j + step, i + step), -1))
        _, points = sphere_intersection.hits(camera.position_mcmf_m, rays)
        lon, lat, _ = mcmf_to_lonlat(points)
        true.append(ground.at(lon, lat, 100.0).mean())
        found.append(mapped.radiance[i, j] / plain.radiance[i, j])
    found, true = np.array(found), np.array(true)
    assert len(found) > 150
    assert np.corrcoef(found, true)[0, 1] > 0.95
    assert found.std() == pytest.approx(true.std(), rel=0.15)


def test_pixels_of_a_picture_against_brute_force(wavy):
    """Every pixel of an image with the limb, compared with 15 x 15 rays per pixel."""
    frame = EnuFrame(178.0, 80.0)  # the seam and a pole are in it
    camera = looking_camera(frame, [0, 0, 3e6], 2e5, (5e6, 5e6))
    light = Lighting.of_sun(direction_enu(40, 70))
    plain, mapped = (
        render_sphere_camera(frame, camera, light, model=LAMBERT, albedo=a) for a in (None, wavy)
    )
    step = (np.arange(15) + 0.5) / 15 - 0.5
    checked = 0
    for i, j in np.argwhere((plain.visible > 0.2) & (plain.radiance > 0)):
        rays = camera.rays(np.stack(np.meshgrid(j + step, i + step), -1))
        _, points = sphere_intersection.hits(camera.position_mcmf_m, rays)
        on = np.isfinite(points[..., 0])
        true = waves(*mcmf_to_lonlat(points[on])[:2]).mean()
        assert mapped.radiance[i, j] / plain.radiance[i, j] == pytest.approx(true, abs=0.03)
        checked += 1
    assert checked > 110


def test_nodes_take_the_same_factors(wavy):
    """The same at nodes; those seen edge-on in the plane cover more of the surface."""
    frame = EnuFrame(20.0, -70.0)
    window = NodeWindow(-30, 31, -30, 31)
    how = (frame, window, 55e3, Lighting.of_sun(direction_enu(0, 90)), oblique_view(0.0, 0.0))
    plain, mapped = (render_sphere_enu(*how, model=LAMBERT, albedo=a) for a in (None, wavy))
    y, x = np.meshgrid(30 - np.arange(61), np.arange(61) - 30, indexing="ij")
    z = np.sqrt(np.maximum(R**2 - (x**2 + y**2) * 55e3**2, 0.0)) - R
    lon, lat, _ = mcmf_to_lonlat(frame.to_mcmf(np.stack([x * 55e3, y * 55e3, z], -1)))
    inner = np.hypot(x, y) * 55e3 < 0.9 * R
    factor = mapped.radiance / plain.radiance
    assert factor[inner] == pytest.approx(waves(lon, lat)[inner], abs=0.01)


def test_where_the_map_has_nothing_the_factor_is_one(tmp_path):
    def half(lon, lat):
        return np.where(lat > 0.0, 3.0, np.nan)

    ground = write_map(tmp_path / "half.tif", half, 360)
    assert np.isnan(looked_up(ground, [10.0], [-20.0], 1e3)[0])
    frame = EnuFrame(0.0, 0.0)
    how = (
        frame,
        NodeWindow(-9, 10, -9, 10),
        30e3,
        Lighting.of_sun(direction_enu(0, 90)),
        oblique_view(0.0, 0.0),
    )
    plain, mapped = (render_sphere_enu(*how, albedo=a).radiance for a in (None, ground))
    assert mapped[:8] == pytest.approx(3.0 * plain[:8], rel=1e-3)
    assert mapped[11:] == pytest.approx(plain[11:], rel=1e-3)


class Counting:
    """A map of ones that counts its calls."""

    gsd_m = 1000.0

    def __init__(self):
        self.asked = []

    def at(self, lon_deg, lat_deg, gsd_m):
        self.asked += [gsd_m] * len(lon_deg)
        return np.ones(len(lon_deg))


def test_probes_are_no_more_than_it_takes():
    for stretch, probes in ((1.0, 1), (1.5, 2), (4.0, 4), (5.0, 8), (400.0, PROBES_MOST)):
        ground = Counting()
        value = looked_up(ground, [0.0], [0.0], 4000.0, 4000.0 * stretch)
        assert value == 1.0
        assert probes <= len(ground.asked) <= 2 * probes
        assert max(ground.asked) >= max(4000.0, 4000.0 * stretch / PROBES_MOST)


ALBEDO = Path(__file__).resolve().parents[3] / "shared/data/albedo/relative_albedo_11ppd.tif"


@pytest.mark.skipif(not ALBEDO.exists(), reason="the global map of brightness is not shipped")
def test_maria_are_where_they_belong():
    """The full Moon from the Earth, north up: each mare against highlands in a mirror's place; by
    columns and rows of the picture, not by its longitudes.
    """
    ground = AlbedoMap.open(ALBEDO, "linear")
    frame = EnuFrame(0.0, 0.0)
    camera = looking_camera(frame, [0, 0, 3.8e8], R / 100, (2.1 * R, 2.1 * R))
    light = Lighting.of_sun(direction_enu(0, 90))
    seen = render_sphere_camera(frame, camera, light, albedo=ground).radiance

    def around(lon, lat):
        middle = (seen.shape[0] - 1) / 2
        east = 100 * math.cos(math.radians(lat)) * math.sin(math.radians(lon))
        north = 100 * math.sin(math.radians(lat))
        row, col = round(middle - north), round(middle + east)
        return np.mean(seen[row - 2 : row + 3, col - 2 : col + 3])

    imbrium, crisium, humorum, tycho = (-16, 33), (59, 17), (-39, -24), (-11, -43)
    assert around(*imbrium) < 0.75 * around(-16, -33)
    assert around(*humorum) < 0.75 * around(39, -24)
    assert around(*crisium) < 0.8 * around(59, 30)
    assert around(*tycho) > 1.3 * around(-11, 43)
