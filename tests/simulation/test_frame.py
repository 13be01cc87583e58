"""Simulated frames: cameras of parts of pixels, area means compared with brute force, sky and
unknown terrain, the Sun, patches.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.catalogs import ALBEDO_MAP
from helpers.match_frames import simulated_image
from helpers.one_patch import sample_patch
from helpers.products import DEGREE_M, cylinder, geotiff
from helpers.twins_match import catalog_of_patches
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from lcp_catalog.accuracy import TIERS
from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.public import read_sensor
from lcp_catalog.cameras.view import looking_camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.constants import ASTRONOMICAL_UNIT_M
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.ephemeris.solar_position import sun_direction_at, sun_distance_m
from lcp_catalog.errors import AreaError, CameraError, CatalogError, SunError
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation, direction_enu
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.simulation.frame import (
    DemSurface,
    SimulatedFrame,
    frame,
    grown,
    samples_for,
    subdivided,
    sun_position,
    windowed,
)
from lcp_catalog.simulation.output import simulate
from lcp_catalog.simulation.patch_surface import PatchSurface, is_catalog

PLACE = EnuFrame(200.4, -30.6)
CELL_M = 474.0
LAW = reflectance_model("lommel-seeliger")


def rolling(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """Hills a few kilometres wide with slopes to 20 degrees, metres."""
    lon, lat = 40.0 * lon_deg, 40.0 * lat_deg
    wide = 250.0 * np.sin(lon + 0.5 * lat) * np.cos(0.7 * lat)
    return wide + 80.0 * np.sin(2.3 * lon - 1.0) * np.cos(2.9 * lat + 0.4 * lon)


@pytest.fixture(scope="module")
def dem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rolling hills, 1.5 degrees wide, at 64 pixels a degree."""
    return cylinder(
        tmp_path_factory.mktemp("dem") / "hills.tif", 199.65, -29.85, (96, 96), 64, rolling
    )


def camera(
    pixel_m: float = CELL_M, pixels: int = 40, off_m: float = 0.0, sun_deg: float = 30.0
) -> Camera:
    """A camera 80 km over the place, moved to the east, with a Sun in the east."""
    made = looking_camera(PLACE, [off_m, 0.0, 80e3], pixel_m, (pixels * pixel_m,) * 2)
    sun = PLACE.to_mcmf(1.5e11 * direction_enu(100.0, sun_deg))
    return replace(made, sun_position_mcmf_m=sun)


def request(dem: Path, taken_by: Camera, **changes) -> Request:
    how = {"accuracy": TIERS["reference"], "disc": False, "model": LAW}
    return Request(DemSet.open([dem]), view=ViewChoice(taken_by), **(how | changes))


def shoot(dem: Path, taken_by: Camera, samples: int, **detector) -> SimulatedFrame:
    found = Detector(**detector)
    ground = DemSurface.seen(request(dem, taken_by), found.margin_px)
    return frame(ground, taken_by, found, samples)


# Cameras of parts of pixels


@given(st.integers(1, 7), st.floats(-30, 70), st.floats(-30, 70))
def test_a_place_in_a_pixel_is_the_same_place_in_its_parts(count, column, row):
    """Pixel i extends from i - 0.5 to i + 0.5, its parts from count i - 0.5 on."""
    bent = [0.1, 0.02, 1e-3, -2e-3, 0.0]
    whole = replace(camera(off_m=2e4), principal_point_px=(17.3, 26.1), distortion=bent)
    point = whole.position_mcmf_m + 8e4 * whole.rays([column, row])
    found = subdivided(whole, count).project(point)
    np.testing.assert_allclose(found, np.array([column, row]) * count + (count - 1) / 2, atol=1e-6)


def test_a_window_is_a_part_of_the_image():
    whole = camera()
    part = windowed(whole, (3, 11, -4, 30))
    assert part.shape == (8, 34)
    point = whole.position_mcmf_m + 8e4 * whole.rays([7.0, 9.0])
    np.testing.assert_allclose(part.project(point), [11.0, 6.0], atol=1e-9)
    assert grown(whole, 5).shape == (50, 50)
    np.testing.assert_allclose(grown(whole, 5).project(point), [12.0, 14.0], atol=1e-9)


def test_rays_are_as_many_as_cells_within_bounds():
    assert [samples_for(cells) for cells in (0.1, 1.0, 2.0, 2.5, 3.0, 40.0)] == [2, 2, 2, 3, 3, 4]


# Area means


def test_a_frame_is_a_mean_over_its_pixels(dem):
    """Compared with 12 x 12 rays per pixel, in pixels of 1.5 cells under a low Sun, with shadows."""
    taken_by = camera(1.5 * CELL_M, 24, sun_deg=12.0)
    exact = shoot(dem, taken_by, 12).radiance
    centre = shoot(dem, taken_by, 1).radiance
    assert (exact < 0.1 * exact.mean()).any()
    errors = np.array([np.abs(shoot(dem, taken_by, n).radiance - exact).mean() for n in (2, 4)])
    scale = exact.mean()
    assert np.abs(centre - exact).mean() > 2.0 * errors[0]
    assert errors[0] / scale < 0.05
    assert errors[1] / scale < 0.02


def test_one_ray_a_pixel_without_blur_is_the_render(dem):
    taken_by = camera()
    ground = DemSurface.seen(request(dem, taken_by))
    found = frame(ground, taken_by, Detector(), 1)
    np.testing.assert_array_equal(found.radiance, ground.radiance(taken_by).astype(np.float32))


def test_pictures_in_strips_are_the_picture(dem, monkeypatch):
    whole = shoot(dem, camera(), 3, blur_px=0.7).radiance
    monkeypatch.setattr("lcp_catalog.simulation.frame._RAYS_AT_ONCE", 1000)
    np.testing.assert_array_equal(shoot(dem, camera(), 3, blur_px=0.7).radiance, whole)


def test_blur_reaches_into_the_frame_from_outside(dem):
    """A wider frame, blurred by scipy and cut, is the same to its last columns."""
    taken_by = camera(pixels=30)
    found = shoot(dem, taken_by, 6, blur_px=1.5).radiance
    wide = shoot(dem, grown(taken_by, 12), 6).radiance.astype(np.float64)
    judged = ndimage.gaussian_filter(wide, 1.5, truncate=6.0)[12:-12, 12:-12]
    assert np.abs(found - judged).max() / found.mean() < 1e-3
    assert np.abs(wide[12:-12, 12:-12] - judged).max() / found.mean() > 0.05


def test_a_map_of_brightness_is_in_the_frame(dem, tmp_path):
    """Terrain twice as bright to the east of the place's meridian."""
    factor = np.where(np.arange(96) < 48, 1.0, 2.0) * np.ones((96, 1))
    west, north = 199.65 * DEGREE_M, -29.85 * DEGREE_M
    path = geotiff(tmp_path / "map.tif", factor.astype("f4"), west, north, DEGREE_M / 64)
    taken_by = camera(sun_deg=50.0)
    albedo = AlbedoMap.open(path, None, 1.0)
    plain, mapped = (
        frame(DemSurface.seen(request(dem, taken_by, **how)), taken_by, Detector(), 1).radiance
        for how in ({}, {"albedo": albedo})
    )
    ratio = mapped / plain
    np.testing.assert_allclose(ratio[:, :17], 1.0, rtol=1e-3)
    np.testing.assert_allclose(ratio[:, -17:], 2.0, rtol=1e-3)


# What is not ground


def test_sky_is_black_and_ground_beyond_the_dem_is_not_known(dem):
    """A camera 60 km up that looks along the surface: the DEM in its middle, unknown terrain around
    it, sky above the limb.
    """
    towards = PLACE.to_mcmf([0.0, 0.0, 0.0])
    position = PLACE.to_mcmf([-150e3, 0.0, 60e3])
    ahead = (towards - position) / np.linalg.norm(towards - position)
    right = np.cross(ahead, PLACE.rotation[2])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(ahead, right), ahead])
    looks = Camera(position, axes, 60.0, (39.5, 39.5), (80, 80))
    looks = replace(looks, sun_position_mcmf_m=camera().sun_position_mcmf_m)
    found = shoot(dem, looks, 2, noise=0.05)
    assert found.radiance[39, 39] > 0.0
    assert np.isnan(found.radiance[70, 39])
    assert (found.radiance[:15] == 0.0).all()
    shown = found.image
    assert np.isnan(shown.signal[70, 39])
    assert shown.weight[70, 39] == 0.0
    assert (shown.weight[:15] == 1.0).all()
    assert shown.missing_share == np.isnan(found.radiance).mean()
    assert (found.numbers[np.isnan(found.radiance)] == 0).all()


def test_a_camera_that_sees_nothing_is_refused(dem):
    away = looking_camera(EnuFrame(20.0, 30.0), [0.0, 0.0, 80e3], CELL_M, (2e4, 2e4))
    away = replace(away, sun_position_mcmf_m=camera().sun_position_mcmf_m)
    with pytest.raises(AreaError, match="covers"):
        DemSurface.seen(request(dem, away))
    with pytest.raises(CameraError, match="has none"):
        DemSurface.seen(replace(request(dem, away), view=ViewChoice()))
    up = np.diag([1.0, -1.0, -1.0]) @ camera().rotation_mcmf_to_camera
    with pytest.raises(CameraError, match="sees nothing"):
        frame(
            DemSurface.seen(request(dem, camera())),
            replace(camera(), rotation_mcmf_to_camera=up),
            Detector(),
            1,
        )


# The image


def test_an_image_is_what_was_read_out(dem):
    taken_by = camera()
    found = shoot(dem, taken_by, 2, noise=0.03, bits=10, full_scale=0.0235)
    shown = replace(found.image, name="frame 7")
    full = found.numbers == 1023
    assert 0.0 < full.mean() < 0.5
    np.testing.assert_allclose(shown.signal, found.numbers * (0.0235 / 1023), rtol=1e-6)
    np.testing.assert_array_equal(shown.weight, np.where(full, 0.0, 1.0))
    assert shown.saturated_share == full.mean()
    assert shown.name == "frame 7"
    np.testing.assert_array_equal(shown.sun_position_mcmf_m, taken_by.sun_position_mcmf_m)
    assert shown.sensor is found.camera
    elsewhere = replace(taken_by, position_mcmf_m=taken_by.position_mcmf_m + 100.0)
    assert found.image.with_sensor(elsewhere).sensor is elsewhere
    detector = Detector(noise=0.03, bits=10, full_scale=0.0235)
    np.testing.assert_array_equal(
        simulated_image(request(dem, taken_by), detector, 2).signal, found.signal
    )


# The Sun


def test_the_sun_stands_where_it_is_said_to():
    own = camera()
    assert sun_position(SunChoice(), PLACE, own) is own.sun_position_mcmf_m or np.array_equal(
        sun_position(SunChoice(), PLACE, own), own.sun_position_mcmf_m
    )
    away = sun_position(SunChoice(230.0, 12.0), PLACE, own) - PLACE.origin_mcmf_m
    angles = azimuth_elevation(PLACE.direction_from_mcmf(away))
    np.testing.assert_allclose(angles, [230.0, 12.0])
    assert np.linalg.norm(away) == pytest.approx(ASTRONOMICAL_UNIT_M)
    time = "2024-03-01T12:00:00"
    away = sun_position(SunChoice(time_utc=time), PLACE, own) - PLACE.origin_mcmf_m
    assert np.linalg.norm(away) == pytest.approx(sun_distance_m(time))
    np.testing.assert_allclose(away / np.linalg.norm(away), sun_direction_at(time), atol=1e-12)
    with pytest.raises(SunError):
        sun_position(SunChoice(), PLACE, replace(own, sun_position_mcmf_m=None))


def test_a_stated_sun_lights_the_frame_and_is_in_its_camera(dem):
    """Under a Sun in the west, slopes to the west are bright: the image changes, and so does the
    camera.
    """
    own, west = camera(), SunChoice(280.0, 30.0)
    first = frame(DemSurface.seen(request(dem, own)), own, Detector(), 1)
    second = frame(DemSurface.seen(request(dem, own, sun=west)), own, Detector(), 1)
    assert np.corrcoef(first.radiance.ravel(), second.radiance.ravel())[0, 1] < 0.0
    towards = second.camera.sun_position_mcmf_m - PLACE.origin_mcmf_m
    assert azimuth_elevation(PLACE.direction_from_mcmf(towards))[0] == pytest.approx(280.0, abs=0.5)


# Patches


def patches(dem: Path, offsets_deg, nodes: int = 21, raised_m=(0.0, 0.0), **changes) -> Catalog:
    """A catalogue of two patches cut from a DEM, some of them raised."""
    dems = DemSet.open([dem])
    cut = [
        sample_patch(dems, PLACE.lon_deg + lon, PLACE.lat_deg + lat, nodes, CELL_M)
        for lon, lat in offsets_deg
    ]
    up = np.array(raised_m)
    frames = [
        EnuFrame(p.frame.lon_deg, p.frame.lat_deg, p.frame.height_m + h)
        for p, h in zip(cut, up, strict=True)
    ]
    sizes = {"gsd_min": np.full(2, CELL_M / 16), "gsd_max": np.full(2, CELL_M)}
    return catalog_of_patches(np.array([p.z_m for p in cut]), frames, CELL_M, **(sizes | changes))


def ground_of(catalog: Catalog, taken_by: Camera) -> PatchSurface:
    sun = np.asarray(taken_by.sun_position_mcmf_m)
    return PatchSurface(catalog, Path("x.h5"), sun, LAW, disc=False)


APART = [(-0.2, 0.1), (0.25, -0.15)]


@pytest.mark.parametrize("off_m", [0.0, 5e4])
def test_patches_are_islands_of_the_dem(dem, off_m):
    """Under a high Sun, without shadows from outside, they look like the DEM; between them there is
    nothing.
    """
    taken_by = camera(CELL_M, 120, off_m=off_m, sun_deg=55.0)
    whole = frame(DemSurface.seen(request(dem, taken_by)), taken_by, Detector(), 2).radiance
    alone = frame(ground_of(patches(dem, APART), taken_by), taken_by, Detector(), 2).radiance
    seen = np.isfinite(alone)
    labels, count = ndimage.label(seen)
    assert count == 2
    inner = ndimage.binary_erosion(seen, iterations=2)
    assert inner.sum() > 400
    off = (alone[inner] - whole[inner]) / whole[inner].mean()
    assert abs(off.mean()) < 1e-3  # their nodes lie elsewhere than the DEM's area's
    assert np.abs(off).max() < 0.03
    centres = ndimage.center_of_mass(seen, labels, [1, 2])
    places = taken_by.project(
        [EnuFrame(PLACE.lon_deg + a, PLACE.lat_deg + b).origin_mcmf_m for a, b in APART]
    )
    for row, col in centres:
        assert np.abs(places - [col, row]).sum(axis=1).min() < 3.0


@pytest.mark.parametrize("order", [(0.0, 4000.0), (4000.0, 0.0)])
def test_of_two_patches_the_nearer_is_seen(dem, order):
    taken_by = camera(CELL_M, 60)
    near = int(np.argmax(order))
    both = patches(dem, [(0.0, 0.0), (0.02, 0.0)], raised_m=order)
    ground = ground_of(both, taken_by)
    seen = ground.radiance(taken_by)
    alone = replace(ground, catalog=both)
    alone.__dict__["patches"] = [ground.patches[near]]
    top = alone.radiance(taken_by)
    assert np.isfinite(top).sum() > 200
    np.testing.assert_array_equal(seen[np.isfinite(top)], top[np.isfinite(top)])
    assert np.isfinite(seen).sum() > np.isfinite(top).sum()


def test_a_patch_has_its_own_albedo(dem):
    taken_by = camera(CELL_M, 60, sun_deg=50.0)
    plain = patches(dem, APART)
    factor = np.ones((2, 21, 21), dtype=np.float32)
    factor[0] = 0.5
    factor[1] += 0.01 * np.arange(21)
    mapped = patches(dem, APART, albedo=factor, albedo_map=ALBEDO_MAP)
    light, dark = (ground_of(c, taken_by).radiance(taken_by) for c in (plain, mapped))
    ratio = dark / light
    west, east = ratio[:, :30], ratio[:, 30:]
    np.testing.assert_allclose(west[np.isfinite(west)], 0.5, rtol=1e-6)
    some = np.isfinite(east).any(axis=0)
    along = np.nanmean(east[:, some], axis=0)
    assert (np.diff(along) > 0.0).all()
    assert along[0] == pytest.approx(1.0, abs=0.01)
    assert along[-1] == pytest.approx(1.2, abs=0.01)


def test_a_patch_is_drawn_whole(dem):
    """Rendered in a window of the image or in all of it: the same pixels."""
    taken_by = camera(CELL_M, 60)
    ground = ground_of(patches(dem, [(-0.2, 0.1), (0.2, -0.12)]), taken_by)
    drawn = [ground._rendered(patch, taken_by)[0] for patch in ground.patches]
    both = np.where(np.isfinite(drawn[0]), drawn[0], drawn[1])
    assert all(np.isfinite(one).sum() > 200 for one in drawn)
    np.testing.assert_allclose(ground.radiance(taken_by), both, rtol=1e-9)


def test_a_catalogue_is_known_by_its_first_bytes(dem, tmp_path):
    path = tmp_path / "any.name"
    write_catalog(patches(dem, APART), path)
    assert is_catalog(path)
    assert not is_catalog(dem)
    assert not is_catalog(tmp_path / "nothing.h5")
    ground = PatchSurface.lit(path, SunChoice(90.0, 20.0), camera())
    assert ground.sources == (path,)
    middle = EnuFrame(ground.catalog.overview.center_lon, ground.catalog.overview.center_lat)
    towards = middle.direction_from_mcmf(ground.sun_position_mcmf_m - middle.origin_mcmf_m)
    np.testing.assert_allclose(azimuth_elevation(towards), [90.0, 20.0])
    with pytest.raises(CatalogError, match="the catalogue has no points"):
        simulate(ground.catalog.take([]), camera(), (90.0, 20.0))


def test_what_two_rays_a_side_leave_is_stated() -> None:
    """Fifty pixels of the sample, two cells wide, under 5 deg of Sun: against eight rays a side."""
    folder = Path(__file__).parents[2] / "sample_data"
    photo = read_sensor(folder / "AS15-M-0414_camera.json")
    assert isinstance(photo, Camera)
    half = replace(
        photo,
        focal_length_px=photo.focal_length_px / 2.0,
        principal_point_px=(25.0, 25.0),
        image_size_px=(50, 50),
        sun_position_mcmf_m=None,
    )
    dem = folder / "hadley_gld100_256ppd.tif"
    few, many = (
        simulate(dem, half, (100.0, 5.0), samples=n, seed=1, gsd_m=CELL_M).radiance.astype(float)
        for n in (2, 8)
    )
    rms = np.sqrt(np.nanmean((few - many) ** 2)) / np.nanmean(many)
    stated = next(one for one in APPROXIMATIONS if one.name == "rays of a simulated frame").error
    assert 100.0 * rms == pytest.approx(stated.value, rel=0.02)
