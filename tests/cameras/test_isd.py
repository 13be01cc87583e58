"""ISD files, compared with expected values of usgscsm, a twin written from the documentation,
labels of the archives, and each other.
"""

import json
import logging

import numpy as np
import pytest
import rasterio
from helpers.isd_files import (
    constant_velocity_line_scan,
    orbital_framer,
    orbital_line_scan,
    orbital_push_frame,
    read,
)
from helpers.twins_isd import MOON_M, TwinIsd, isd_of_cube, on_sphere

from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.scanners import LineScanner, PushFrame
from lcp_catalog.ephemeris.times import utc_of_ephemeris_time
from lcp_catalog.geometry import sphere_intersection
from lcp_catalog.geometry.frames import lonlat_to_mcmf, mcmf_to_lonlat

REAL = {
    "apollometric_isd": Camera,
    "chandrayaan2_ohrc_isd": LineScanner,
    "chandrayaan2_tmc2_isd": LineScanner,
    "kaguyatc_isd": LineScanner,
    "lro_isis_isd": LineScanner,
    "lrolroc_isd": LineScanner,
    "lrolrocwac_isd": PushFrame,
    "usgscsm_lroWacPushFrame": PushFrame,
    "usgscsm_toughLroNacLineScan": LineScanner,
}


@pytest.fixture(scope="module")
def real(shared_data):
    return {name: shared_data / "cameras" / f"{name}.json" for name in REAL}


def some_pixels(sensor, n=12, seed=0):
    """Random pixels, the corners of the image, and the centres of its corner pixels."""
    rows, cols = sensor.shape
    low, high = np.full(2, -0.5), np.array([cols, rows]) - 0.5
    inside = np.random.default_rng(seed).uniform(low, high, (n, 2))
    corners = np.array([[0, 0], [cols - 1, 0], [0, rows - 1], [cols - 1, rows - 1]], dtype=float)
    return np.concatenate([inside, corners])


# expected values of usgscsm's tests for its fixtures


def ground(sensor, line, sample, radius_m):
    """Result of usgscsm's imageToGround: intersection with the sphere, or the nearest point of the
    ray.
    """
    (origin,), (ray,) = sensor.looks([[sample - 0.5, line - 0.5]])
    hit = on_sphere(origin, ray, radius_m)
    return origin - (origin @ ray) * ray if np.isnan(hit).any() else hit


def test_usgscsms_framing_camera():
    """FrameCameraTests.cpp: OrbitalFrameSensorModel Center and GroundPartials."""
    camera = read(orbital_framer())
    assert ground(camera, 8.0, 8.0, 1e6) == pytest.approx([1e6, 0, 0], abs=1e-6)
    point, steps = np.array([1e6, 0.0, 0.0]), np.eye(3)
    partials = 0.5 * (camera.project(point + steps) - camera.project(point - steps))
    assert partials[:, 1] == pytest.approx([0.0, 0.0, 0.01], abs=1e-9)  # lines
    assert partials[:, 0] == pytest.approx([0.0, 0.01, 0.0], abs=1e-9)  # samples


def test_usgscsms_line_scanner():
    """LineScanCameraTests.cpp of 2020: OrbitalLineScanSensorModel Center, ConstVelocityLineScanSensorModel Center and OffBody."""
    scanner = read(orbital_line_scan())
    expected = [999999.67040488799, 0.0, -811.90523782723039]
    assert ground(scanner, 8.5, 8.0, 1e6) == pytest.approx(expected, abs=1e-6)
    assert scanner.project(expected) == pytest.approx([7.5, 8.0], abs=1e-6)
    flat = read(constant_velocity_line_scan())
    expected = 1e5 * np.array([9.99999500000, 0.0, 0.00999999500])
    assert ground(flat, 8.0, 8.0, 1e6) == pytest.approx(expected, abs=1e5 * 1e-10)
    expected = 1e5 * np.array([0.04799688020, -7.99961602495, 16.00004799688])
    assert ground(flat, 0.0, 4.0, 1e6) == pytest.approx(expected, abs=1e5 * 1e-10)


def test_usgscsms_push_frame_camera():
    """PushFrameCameraTests.cpp: Center, there and back."""
    camera = read(orbital_push_frame())
    assert ground(camera, 6.0, 8.0, 1e6) == pytest.approx([1e6, 0, 0], abs=1e-6)
    assert camera.project([1e6, 0, 0]) == pytest.approx([7.5, 5.5], abs=1e-6)
    assert (camera.framelets, camera.lines) == (30, 12)


# real files, compared with the twin


@pytest.mark.parametrize("name", REAL)
def test_a_real_isd_against_the_twin(real, name):
    sensor, twin = read_sensor(real[name]), TwinIsd(real[name])
    assert type(sensor) is REAL[name]
    pixels = some_pixels(sensor)
    origins, rays = sensor.looks(pixels)
    for (column, row), origin, ray in zip(pixels, origins, rays, strict=True):
        theirs = twin.ray(row + 0.5, column + 0.5)
        assert np.abs(origin - theirs[0]).max() < 1e-6  # metres
        assert np.abs(ray - theirs[1]).max() < 5e-11  # rounding of a line's tables


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_ground_to_image_against_the_twin(real, name):
    """The twin finds the line by bisection and the framelet by trying all of them."""
    sensor, twin = read_sensor(real[name]), TwinIsd(real[name])
    count = 3 if REAL[name] is PushFrame else 6
    rows, cols = sensor.shape
    pixels = np.random.default_rng(3).uniform([0, 0], [cols - 1, rows - 1], (count, 2))
    for pixel in pixels:
        point = on_sphere(*(part[0] for part in sensor.looks(pixel[None])))
        if np.isnan(point).any():
            continue
        line, sample = twin.pixel(point)
        assert sensor.project(point) == pytest.approx([sample - 0.5, line - 0.5], abs=1e-6)


@pytest.mark.parametrize("name", REAL)
def test_ground_image_ground(real, name):
    """At the corners and all over the image: the surface point of a pixel projects to that pixel,
    or (framelets overlap) to another one that sees the same point.
    """
    sensor = read_sensor(real[name])
    pixels = some_pixels(sensor, 400)
    ranges, points = sphere_intersection.hits(*sensor.looks(pixels))
    points, pixels = points[np.isfinite(ranges)], pixels[np.isfinite(ranges)]
    assert len(points) > 80  # part of the Apollo frame is beyond the limb
    again = sensor.project(points)
    assert np.isfinite(again).all()
    assert sensor.in_image(again[:400]).all() or REAL[name] is PushFrame
    if REAL[name] is not PushFrame:
        assert np.abs(again - pixels).max() < 1e-6
    _, seen = sphere_intersection.hits(*sensor.looks(again))
    half = np.array([0.5, 0.0])
    left, right = (sphere_intersection.hits(*sensor.looks(again + d))[1] for d in (-half, half))
    pixel_m = np.linalg.norm(right - left, axis=1)
    assert np.abs(np.linalg.norm(seen - points, axis=1) / pixel_m).max() < 1e-6
    towards = sensor.towards(points)
    assert np.abs(towards + sensor.looks(again)[1]).max() < 1e-9


@pytest.mark.parametrize("name", REAL)
def test_the_subsolar_latitude_is_possible(real, name):
    sensor = read_sensor(real[name])
    _, lat, height = mcmf_to_lonlat(sensor.sun_position_mcmf_m)
    assert abs(lat) < 1.59
    assert height == pytest.approx(1.496e11, rel=0.02)


# compared with archives


def test_corners_of_a_terrain_camera_image(real, shared_data):
    """JAXA's label gives the corners of TC1S2B0_01_06691S820E0465. Its ISD is body-fixed by
    IAU_MOON, which differs by up to 155 m from the label's mean-Earth frame; a pixel of the image
    is 7 m, a swath 24 km.
    """
    label = (shared_data / "cameras" / "TC1S2B0_01_06691S820E0465_pds3.lbl").read_text()
    stated = {
        line.split("=")[0].strip(): float(line.split("=")[1].split("<")[0])
        for line in label.splitlines()
        if line.startswith(("UPPER_", "LOWER_")) and "TUDE" in line
    }
    sensor = read_sensor(real["kaguyatc_isd"])
    _, points = sphere_intersection.hits(*sensor.looks([[0, 0], [3207, 0]]))
    off = []
    for point, corner in zip(points, ("UPPER_LEFT", "UPPER_RIGHT"), strict=True):
        place = lonlat_to_mcmf(stated[f"{corner}_LONGITUDE"], stated[f"{corner}_LATITUDE"])
        off.append(point - place)
        assert np.linalg.norm(off[-1]) < 155.0
    assert np.linalg.norm(off[0] - off[1]) < 25.0  # both ends of the line have the same offset
    # the whole image has 4656 lines, of which the ISD describes 400: extrapolate along the left edge
    _, (first, last) = sphere_intersection.hits(*sensor.looks([[0, 0], [0, 399]]))
    lower = lonlat_to_mcmf(stated["LOWER_LEFT_LONGITUDE"], stated["LOWER_LEFT_LATITUDE"])
    along = (last - first) / np.linalg.norm(last - first)
    ahead = (lower - first) / np.linalg.norm(lower - first)
    assert along @ ahead > 0.999


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_real_image_s_own_tables(shared_data):
    """M143947267L with the tables that ISIS attached: geometry_computed.json is an independent
    evaluation of the same tables. Positions agree to 0.1 mm, lines to 1e-4. Columns differ by one:
    there y = (s - 1 - 2548) pitch for the sample s counted from 1, where ISIS
    (LroNarrowAngleCamera, detector origin 2548) and ALE have y = (s - 2548) pitch. The remaining
    0.0009 is a pitch of 0.007 mm against 1 / 142.857.
    """
    folder = shared_data / "images" / "nac-m143947267l-spice"
    cube = folder / "M143947267L.cal.echo.crop.cub"
    with rasterio.open(cube) as file:
        ((key, value),) = file.tags(ns="json:ISIS3").items()
    sensor = read(isd_of_cube(cube, json.loads(f"{key}:{value}"), 400, 400))
    known = json.loads((folder / "geometry_computed.json").read_text())
    pixels = {"UL": (0, 0), "UR": (399, 0), "LL": (0, 399), "LR": (399, 399), "C": (199.5, 199.5)}
    for name, pixel in pixels.items():
        origin, _ = sensor.looks(pixel)
        assert np.linalg.norm(origin - 1e3 * np.array(known[name]["P"])) < 1e-4
        column, row = sensor.project(1e3 * np.array(known[name]["g"])) - pixel
        assert column == pytest.approx(-1.0, abs=1e-3)
        assert row == pytest.approx(0.0, abs=1e-4)


def test_instants(real):
    """M103595705LE's label: START_TIME 2009-07-30T12:20:38.185; AS15-M-1450's:
    1971-08-01T14:58:03.78 (before 1972 SPICE omits 0.5 s of UTC).
    """
    one_line = read_sensor(real["lro_isis_isd"])
    assert one_line.time_utc == "2009-07-30T12:20:38.185Z"
    assert read_sensor(real["apollometric_isd"]).time_utc.startswith("1971-08-01T14:58:03")


@pytest.mark.parametrize("name", ["lrolrocwac_isd", "usgscsm_lroWacPushFrame"])
def test_framelets_follow_on_one_another(real, name):
    """The surface under one framelet continues in the next one, with some overlap: rows, order and
    times are consistent (one of the two images holds its framelets in reverse).
    """
    sensor = read_sensor(real[name])
    column, first = sensor.shape[1] / 2, sensor.lines * (sensor.framelets // 2)
    rows = [first, first + sensor.lines - 1, first + sensor.lines]
    start, end, after = sphere_intersection.hits(*sensor.looks([[column, row] for row in rows]))[1]
    row = (end - start) / (sensor.lines - 1)
    advance = (after - start) @ row / (row @ row)
    assert 0.7 * sensor.lines < advance < sensor.lines
    assert np.linalg.norm(after - start - advance * row) < 0.05 * np.linalg.norm(row)


def test_j2000_in_utc():
    """2000-01-01T12:00:00 TDB is 11:58:55.816 UTC (NAIF, Time Required Reading)."""
    assert utc_of_ephemeris_time(0.0) == "2000-01-01T11:58:55.816Z"


def test_two_isds_of_one_image_agree(real):
    """One is from SPICE kernels, the other from a cube with tables by ISIS: their sensor frames
    have lines in opposite directions, and one has reduced tables; the first line agrees within a
    hundredth of a pixel.
    """
    kernels, cube = read_sensor(real["lrolroc_isd"]), read_sensor(real["lro_isis_isd"])
    points = sphere_intersection.hits(*cube.looks([[0.0, 0.0]]))[1]
    assert kernels.project(points)[0] == pytest.approx([0.0, 0.0], abs=0.01)


def test_an_apollo_camera_looks_along_minus_z(real):
    """The image is not mirrored: along a row and then along a column is clockwise, seen from above.
    (This ISD has the optical axis in the upper left corner of the image; most of the frame is
    beyond the Moon.)
    """
    camera = read_sensor(real["apollometric_isd"])
    middle = np.array([1000.0, 500.0])
    _, (at, right, down) = sphere_intersection.hits(
        *camera.looks(middle + np.array([[0.0, 0], [50.0, 0], [0.0, 50.0]]))
    )
    assert np.cross(right - at, down - at) @ at < 0.0
    tilt = np.degrees(
        np.arccos(-camera.rotation_mcmf_to_camera[2] @ camera.position_mcmf_m / 1855.8e3)
    )
    assert tilt == pytest.approx(40.0, abs=0.5)  # the mission's oblique strips


def test_a_camera_of_an_isd_survives_its_json(real):
    from lcp_catalog.cameras.frame_camera import camera_from_json

    camera = read_sensor(real["apollometric_isd"])
    again = camera_from_json(json.loads(json.dumps(camera.to_json())))
    pixels = some_pixels(camera, 20)
    assert np.abs(again.rays(pixels) - camera.rays(pixels)).max() < 1e-15


def test_frames_that_are_not_the_maps_are_logged(real, caplog):
    with caplog.at_level(logging.WARNING):
        read_sensor(real["kaguyatc_isd"])
    assert "10020" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        read_sensor(real["lrolroc_isd"])
    assert not caplog.text


def test_moon_m_is_the_spheres():
    from lcp_catalog.constants import MOON_RADIUS_M

    assert MOON_M == MOON_RADIUS_M
