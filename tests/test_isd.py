"""ISD files: against usgscsm's own expectations, a twin written from the documentation, labels of the archives, and each other."""

import copy
import json
import logging

import numpy as np
import pytest
import rasterio
from twins_isd import MOON_M, TwinIsd, isd_of_cube, on_sphere

from lcp_catalog import sphere_rays
from lcp_catalog.camera import Camera
from lcp_catalog.camera_file import read_sensor
from lcp_catalog.errors import CameraError
from lcp_catalog.instants import of_ephemeris_time
from lcp_catalog.isd import sensor_from_isd
from lcp_catalog.json_fields import JsonFields
from lcp_catalog.scanners import LineScanner, PushFrame
from lcp_catalog.sphere import lonlat_to_mcmf, mcmf_to_lonlat

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
    """Random ones, the corners of the image, and the middles of its corner pixels."""
    rows, cols = sensor.shape
    low, high = np.full(2, -0.5), np.array([cols, rows]) - 0.5
    inside = np.random.default_rng(seed).uniform(low, high, (n, 2))
    corners = np.array([[0, 0], [cols - 1, 0], [0, rows - 1], [cols - 1, rows - 1]], dtype=float)
    return np.concatenate([inside, corners])


# what usgscsm's own tests expect of its fixtures


def fixture(model, **changes):
    """What usgscsm's fixtures have in common. Their bodies are other ones: radii are the Moon's here, which only rays' ends know
    of, and the test meets those with its own sphere.
    """
    return {
        "name_model": f"USGS_ASTRO_{model}_SENSOR_MODEL",
        "center_ephemeris_time": 1000.0,
        "starting_ephemeris_time": 999.2,
        "detector_sample_summing": 1,
        "detector_line_summing": 1,
        "focal2pixel_samples": [0.0, 0.0, 10.0],
        "focal_length_model": {"focal_length": 50},
        "image_lines": 16,
        "image_samples": 16,
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}},
        "radii": {"semimajor": 1737.4, "semiminor": 1737.4, "unit": "km"},
        "starting_detector_sample": 0,
    } | changes


def tables(times, positions, velocities, quaternions, unit="km"):
    body = {"quaternions": [[1.0, 0, 0, 0]] * len(times), "ephemeris_times": list(times)}
    return {
        "instrument_position": {
            "ephemeris_times": list(times),
            "positions": np.asarray(positions).tolist(),
            "velocities": np.asarray(velocities).tolist(),
            "unit": unit,
            "reference_frame": 1,
        },
        "instrument_pointing": {
            "ephemeris_times": list(times),
            "quaternions": np.asarray(quaternions).tolist(),
            "reference_frame": 1,
        },
        "body_rotation": body | {"reference_frame": 1},
    }


def read(document, name="x.json"):
    return sensor_from_isd(JsonFields(document, name))


def ground(sensor, line, sample, radius_m):
    """Where usgscsm's imageToGround ends: the sphere, or the ray's nearest point to it."""
    (origin,), (ray,) = sensor.looks([[sample - 0.5, line - 0.5]])
    hit = on_sphere(origin, ray, radius_m)
    return origin - (origin @ ray) * ray if np.isnan(hit).any() else hit


def orbital_framer():
    """tests/data/orbitalFramer.json."""
    q = [-0.707106781186547, 0.0, -0.707106781186547, 0.0]
    return fixture(
        "FRAME",
        focal2pixel_lines=[0.0, 10.0, 0.0],
        detector_center={"line": 8.0, "sample": 8.0},
        starting_detector_line=0,
        **tables([50], [[1050.0, 0, 0]], [[0.0, 0, -1.0]], [q]),
    ) | {"center_ephemeris_time": 50.0}


def orbital_line_scan():
    """tests/data/orbitalLineScan.json, a circular orbit rounded to eight digits as there; its quaternions (x, y, z, w, from
    sensor to body) as those of instrument_pointing.
    """
    a = 0.1 * np.arange(16) / 1050.0
    positions = np.round(np.stack([1050 * np.cos(a), 0 * a, -1050 * np.sin(a)], -1), 8)
    velocities = np.round(np.stack([-1050 * np.sin(a), 0 * a, -1050 * np.cos(a)], -1), 8)
    half = np.pi / 4 - a / 2
    quaternions = np.round(np.stack([np.cos(half), 0 * a, np.sin(half), 0 * a], -1), 8)
    return fixture(
        "LINE_SCANNER",
        focal2pixel_lines=[0.0, -10.0, 0.0],
        detector_center={"line": 0.5, "sample": 8.0},
        starting_detector_line=1,
        line_scan_rate=[[0.5, -0.85, 0.1]],
        **tables(999.2 + 0.1 * np.arange(16), positions, velocities, quaternions),
    )


def constant_velocity_line_scan():
    """tests/data/constVelocityLineScan.json, 10^5 times as large: its metres are those of a body of 10 m."""
    z = 16.0 - 4.0 * np.arange(9)
    positions = 1e5 * np.stack([np.full(9, 1000.0), 0 * z, z], -1)
    q = [0.707106781186547, 0.0, 0.707106781186547, 0.0]
    return fixture(
        "LINE_SCANNER",
        focal2pixel_lines=[0.0, -10.0, 0.0],
        detector_center={"line": 0.5, "sample": 8.0},
        starting_detector_line=1,
        line_scan_rate=[[0.5, -0.85, 0.1]],
        **tables(999.2 + 0.2 * np.arange(9), positions, [[0, 0, -2e6]] * 9, [q] * 9, unit="m"),
    )


def orbital_push_frame():
    """tests/data/orbitalPushFrame.json: 1260 m between framelets on a circle."""
    a = 1.26 * np.arange(30) / 1050.0
    positions = np.stack([1050 * np.cos(a), 0 * a, -1050 * np.sin(a)], -1)
    velocities = np.stack([-1050 * np.sin(a), 0 * a, -1050 * np.cos(a)], -1)
    half = np.pi / 4 + a / 2
    quaternions = np.stack([np.cos(half), 0 * a, -np.sin(half), 0 * a], -1)
    return fixture(
        "PUSH_FRAME",
        focal2pixel_lines=[0.0, -10.0, 0.0],
        detector_center={"line": 6.0, "sample": 8.0},
        starting_detector_line=0,
        image_lines=360,
        exposure_duration=0.05,
        interframe_delay=0.1,
        framelet_height=12,
        framelets_flipped=False,
        framelet_order_reversed=False,
        **tables(998.5 + 0.1 * np.arange(30), positions, velocities, quaternions),
    ) | {"starting_ephemeris_time": 998.475}


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


# the real ones against the twin


@pytest.mark.parametrize("name", REAL)
def test_a_real_isd_against_the_twin(real, name):
    sensor, twin = read_sensor(real[name]), TwinIsd(real[name])
    assert type(sensor) is REAL[name]
    pixels = some_pixels(sensor)
    origins, rays = sensor.looks(pixels)
    for (column, row), origin, ray in zip(pixels, origins, rays, strict=True):
        theirs = twin.ray(row + 0.5, column + 0.5)
        assert np.abs(origin - theirs[0]).max() < 1e-6  # metres
        assert np.abs(ray - theirs[1]).max() < 5e-11  # of a line's tables' own rounding


@pytest.mark.parametrize("name", REAL)
def test_ground_to_image_against_the_twin(real, name):
    """The twin finds the line by bisection, and the framelet by trying them all."""
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
    """At the corners and all over the image: what a pixel sees is seen in that pixel, or (framelets overlap) in another one
    that sees the same.
    """
    sensor = read_sensor(real[name])
    pixels = some_pixels(sensor, 400)
    ranges, points = sphere_rays.hits(*sensor.looks(pixels))
    points, pixels = points[np.isfinite(ranges)], pixels[np.isfinite(ranges)]
    assert len(points) > 80  # the Apollo frame looks past the limb
    again = sensor.project(points)
    assert np.isfinite(again).all()
    assert sensor.in_image(again[:400]).all() or REAL[name] is PushFrame
    if REAL[name] is not PushFrame:
        assert np.abs(again - pixels).max() < 1e-6
    _, seen = sphere_rays.hits(*sensor.looks(again))
    half = np.array([0.5, 0.0])
    left, right = (sphere_rays.hits(*sensor.looks(again + d))[1] for d in (-half, half))
    pixel_m = np.linalg.norm(right - left, axis=1)
    assert np.abs(np.linalg.norm(seen - points, axis=1) / pixel_m).max() < 1e-6
    towards = sensor.towards(points)
    assert np.abs(towards + sensor.looks(again)[1]).max() < 1e-9


@pytest.mark.parametrize("name", REAL)
def test_the_sun_stands_over_the_moon(real, name):
    sensor = read_sensor(real[name])
    _, lat, height = mcmf_to_lonlat(sensor.sun_position_mcmf_m)
    assert abs(lat) < 1.59
    assert height == pytest.approx(1.496e11, rel=0.02)


# against archives


def test_corners_of_a_terrain_camera_image(real, shared_data):
    """JAXA's label states where the corners of TC1S2B0_01_06691S820E0465 lie. Its ISD is body-fixed by IAU_MOON, which lies up to
    155 m from the label's mean-Earth frame; a pixel of the image is 7 m, a swath 24 km.
    """
    label = (shared_data / "cameras" / "TC1S2B0_01_06691S820E0465_pds3.lbl").read_text()
    stated = {
        line.split("=")[0].strip(): float(line.split("=")[1].split("<")[0])
        for line in label.splitlines()
        if line.startswith(("UPPER_", "LOWER_")) and "TUDE" in line
    }
    sensor = read_sensor(real["kaguyatc_isd"])
    _, points = sphere_rays.hits(*sensor.looks([[0, 0], [3207, 0]]))
    off = []
    for point, corner in zip(points, ("UPPER_LEFT", "UPPER_RIGHT"), strict=True):
        place = lonlat_to_mcmf(stated[f"{corner}_LONGITUDE"], stated[f"{corner}_LATITUDE"])
        off.append(point - place)
        assert np.linalg.norm(off[-1]) < 155.0
    assert np.linalg.norm(off[0] - off[1]) < 25.0  # both ends of the line are off alike
    # the whole image has 4656 lines, of which the ISD describes 400: lines run on along its left edge
    _, (first, last) = sphere_rays.hits(*sensor.looks([[0, 0], [0, 399]]))
    lower = lonlat_to_mcmf(stated["LOWER_LEFT_LONGITUDE"], stated["LOWER_LEFT_LATITUDE"])
    along = (last - first) / np.linalg.norm(last - first)
    ahead = (lower - first) / np.linalg.norm(lower - first)
    assert along @ ahead > 0.999


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_real_image_s_own_tables(shared_data):
    """M143947267L with the tables that ISIS attached to it: geometry_computed.json beside it was worked out from the same tables
    by other hands. Positions agree to 0.1 mm, lines to 1e-4; columns differ by one: there y = (s - 1 - 2548) pitch for the
    sample s counted from 1, where ISIS (LroNarrowAngleCamera, detector origin 2548) and ALE have y = (s - 2548) pitch. What is
    left, 0.0009, is a pitch of 0.007 mm against 1 / 142.857.
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
    """M103595705LE's label: START_TIME 2009-07-30T12:20:38.185; AS15-M-1450's: 1971-08-01T14:58:03.78 (before 1972 SPICE leaves
    0.5 s of UTC aside).
    """
    one_line = read_sensor(real["lro_isis_isd"])
    assert one_line.time_utc == "2009-07-30T12:20:38.185Z"
    assert read_sensor(real["apollometric_isd"]).time_utc.startswith("1971-08-01T14:58:03")


@pytest.mark.parametrize("name", ["lrolrocwac_isd", "usgscsm_lroWacPushFrame"])
def test_framelets_follow_on_one_another(real, name):
    """The ground under one framelet goes on in the next, along its rows and with some overlap, as the instrument is run: rows,
    order and times fit together (one of the two images holds its framelets in reverse).
    """
    sensor = read_sensor(real[name])
    column, first = sensor.shape[1] / 2, sensor.lines * (sensor.framelets // 2)
    rows = [first, first + sensor.lines - 1, first + sensor.lines]
    start, end, after = sphere_rays.hits(*sensor.looks([[column, row] for row in rows]))[1]
    row = (end - start) / (sensor.lines - 1)
    advance = (after - start) @ row / (row @ row)
    assert 0.7 * sensor.lines < advance < sensor.lines
    assert np.linalg.norm(after - start - advance * row) < 0.05 * np.linalg.norm(row)


def test_j2000_in_utc():
    """2000-01-01T12:00:00 TDB is 11:58:55.816 UTC (NAIF, Time Required Reading)."""
    assert of_ephemeris_time(0.0) == "2000-01-01T11:58:55.816Z"


def test_two_isds_of_one_image_agree(real):
    """One from SPICE kernels, the other from a cube that ISIS attached tables to: their sensor frames point their lines opposite
    ways, and the tables are thinned out in one; the first line lies within a hundredth of a pixel.
    """
    kernels, cube = read_sensor(real["lrolroc_isd"]), read_sensor(real["lro_isis_isd"])
    points = sphere_rays.hits(*cube.looks([[0.0, 0.0]]))[1]
    assert kernels.project(points)[0] == pytest.approx([0.0, 0.0], abs=0.01)


def test_an_apollo_camera_looks_along_minus_z(real):
    """Its image is no mirror image: along a row and then along a column is clockwise, seen from above. (This ISD has the optical
    axis in the image's upper left corner; most of the frame looks past the Moon.)
    """
    camera = read_sensor(real["apollometric_isd"])
    middle = np.array([1000.0, 500.0])
    _, (at, right, down) = sphere_rays.hits(
        *camera.looks(middle + np.array([[0.0, 0], [50.0, 0], [0.0, 50.0]]))
    )
    assert np.cross(right - at, down - at) @ at < 0.0
    tilt = np.degrees(
        np.arccos(-camera.rotation_mcmf_to_camera[2] @ camera.position_mcmf_m / 1855.8e3)
    )
    assert tilt == pytest.approx(40.0, abs=0.5)  # the mission's oblique strips


def test_a_camera_of_an_isd_survives_its_json(real):
    from lcp_catalog.camera import camera_from_json

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


# conventions, one by one, on a small ISD


def pixel_of(document, point=(1e6, 300.0, 500.0)):
    return read(document).project(point)


def test_summing_and_starts():
    plain = pixel_of(orbital_framer())
    column, row = plain
    binned = pixel_of(orbital_framer() | {"detector_sample_summing": 2, "detector_line_summing": 4})
    assert (binned + 0.5) == pytest.approx([(column + 0.5) / 2, (row + 0.5) / 4], abs=1e-9)
    cut = pixel_of(orbital_framer() | {"starting_detector_sample": 3, "starting_detector_line": 5})
    assert cut == pytest.approx(plain - [3, 5], abs=1e-9)
    constant = orbital_framer() | {"focal2pixel_samples": [2.0, 0.0, 10.0]}
    assert pixel_of(constant) == pytest.approx([column + 2, row], abs=1e-9)


def test_units_and_frames():
    plain = orbital_framer()
    metres = copy.deepcopy(plain)
    metres["instrument_position"] |= {"unit": "m", "positions": [[1.05e6, 0, 0]]}
    assert pixel_of(metres) == pytest.approx(pixel_of(plain), abs=1e-9)
    unstated = copy.deepcopy(plain)
    del unstated["instrument_position"]["unit"]
    assert pixel_of(unstated) == pytest.approx(pixel_of(plain), abs=1e-9)
    # the body turned by 90 deg about z: what was along x is along -y in its axes
    turned = copy.deepcopy(plain)
    half = np.sqrt(0.5)
    turned["body_rotation"]["quaternions"] = [[half, 0, 0, half]]
    there = read(turned)
    assert there.position_mcmf_m == pytest.approx([0, 1.05e6, 0], abs=1e-6)
    assert there.project([-300.0, 1e6, 500.0]) == pytest.approx(pixel_of(plain), abs=1e-8)
    fixed = copy.deepcopy(turned)
    fixed["body_rotation"]["constant_frames"] = [31001]
    fixed["instrument_position"] |= {"reference_frame": 31001, "positions": [[0, 1050.0, 0]]}
    assert read(fixed).position_mcmf_m == pytest.approx([0, 1.05e6, 0], abs=1e-6)


def test_framelets_upside_down_and_in_reverse():
    plain = read(orbital_push_frame())
    reverse = read(orbital_push_frame() | {"framelet_order_reversed": True})
    flipped = read(orbital_push_frame() | {"framelets_flipped": True})
    for framelet in (0, 7, 29):
        for row in range(12):
            pixel = np.array([3.25, 12.0 * framelet + row])
            ray = plain.looks(pixel)
            assert reverse.looks([3.25, 12.0 * (29 - framelet) + row])[1] == pytest.approx(ray[1])
            upside = flipped.looks([3.25, 12.0 * framelet + 11 - row])
            assert upside[0] == pytest.approx(ray[0])
            assert upside[1] == pytest.approx(ray[1], abs=1e-12)


def test_lines_of_several_rates():
    """Lines 0..4 take 0.1 s, 5..9 take 0.2 s, the rest 0.05 s; a line is seen in the middle of its exposure."""
    rates = [[0.5, -0.85, 0.1], [5.5, -0.35, 0.2], [10.5, 0.65, 0.05]]
    document = orbital_line_scan() | {"line_scan_rate": rates, "image_lines": 12}
    scanner = read(document)
    expected = [*(-0.8 + 0.1 * np.arange(5)), *(-0.25 + 0.2 * np.arange(5)), 0.675, 0.725]
    found = scanner.times_s[64:-64]
    assert found == pytest.approx(expected, abs=1e-12)
    rows = np.array([0.0, 4.5, 9.5, 10.25])
    points = sphere_rays.hits(*scanner.looks(np.stack([0 * rows + 4.0, rows], -1)), 1e6)[1]
    assert scanner.project(points)[:, 1] == pytest.approx(rows, abs=1e-7)


# what is refused


def broken(path, value, document=None, delete=True):
    document = copy.deepcopy(orbital_line_scan() if document is None else document)
    inner = document
    *way, last = path.split(".")
    for part in way:
        inner = inner[part]
    if value is None and delete:
        del inner[last]
    else:
        inner[last] = value
    return document


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("name_model", "USGS_ASTRO_SAR_SENSOR_MODEL", "name_model is USGS_ASTRO_SAR"),
        ("name_model", None, "lacks name_model"),
        ("radii.semimajor", 3396.19, "radii.semimajor is 3396.19 km: not the Moon's"),
        ("radii.semiminor", -1.0, "radii.semiminor must be positive"),
        ("radii.unit", "furlong", "radii.unit is 'furlong'"),
        ("radii.unit", 3, "radii.unit is not a text"),
        ("body_rotation.constant_frames", [31001.5], "constant_frames is not a list of whole"),
        ("starting_detector_line", 1e13, "starting_detector_line holds a number beyond 1e.12"),
        ("image_lines", True, "image_lines is not made of numbers"),
        ("radii", None, "lacks radii.semimajor"),
        ("image_lines", 0, "image_lines must be positive"),
        ("image_lines", 16.5, "image_lines must be a whole number"),
        ("image_samples", "many", "image_samples is not made of numbers"),
        ("center_ephemeris_time", float("nan"), "center_ephemeris_time holds what is not a finite"),
        ("focal_length_model.focal_length", 0.0, "focal_length must be positive"),
        ("focal2pixel_lines", [0.0, 10.0], "focal2pixel_lines must be 3, is 2"),
        ("focal2pixel_lines", [0.0, 0.0, 10.0], "focal2pixel_lines and focal2pixel_samples run"),
        ("detector_center.line", None, "lacks detector_center.line"),
        ("detector_line_summing", 0, "detector_line_summing must be positive"),
        ("optical_distortion", {"cahvor": {}}, "optical_distortion is cahvor; read is one of"),
        ("optical_distortion", {}, "optical_distortion is ; read is one of"),
        ("optical_distortion", {"radial": {}}, "lacks optical_distortion.radial.coefficients"),
        ("optical_distortion", {"radial": {"coefficients": [0, 0, 0, 1]}}, "has more than 3"),
        ("optical_distortion", {"lrolrocnac": {"coefficients": []}}, "must be n, is 0"),
        ("optical_distortion", {"kaguyalism": {"x": [0.0] * 4}}, "lacks optical.*kaguyalism.y"),
        ("instrument_position.ephemeris_times", [], "ephemeris_times must be n, is 0"),
        (
            "instrument_position.positions",
            [[1.0, 2.0]],
            "instrument_position.positions must be 16 x 3",
        ),
        (
            "instrument_position.positions",
            [[1.0, 2.0, 3.0]] * 16,
            "reach 3.7.* km from the centre",
        ),
        (
            "instrument_position.velocities",
            [[1.0, 2.0, 3.0]],
            "velocities must be 16 x 3, is 1 x 3",
        ),
        ("instrument_position.reference_frame", 31001, "reference_frame is 31001: neither J2000"),
        ("instrument_pointing.reference_frame", 31001, "reference_frame is not body_rotation's"),
        (
            "instrument_pointing.quaternions",
            [[1.0, 1.0, 0, 0]] * 16,
            "quaternions must have length 1",
        ),
        ("instrument_pointing.quaternions", None, "lacks instrument_pointing.quaternions"),
        ("instrument_pointing.constant_rotation", [1.0] * 9, "constant_rotation is not a rotation"),
        ("instrument_pointing.constant_rotation", [1.0] * 8, "constant_rotation must be 9, is 8"),
        ("body_rotation.ephemeris_times", [999.2] * 16, "body_rotation.ephemeris_times must rise"),
        ("line_scan_rate", None, "lacks line_scan_rate"),
        ("line_scan_rate", [[0.5, -0.85, 0.0]], "line_scan_rate must have rising lines"),
        ("line_scan_rate", [[0.5, -0.85, 0.1], [5.5, -2.0, 0.1]], "later line at an earlier time"),
        ("line_scan_rate", [[0.5, 4.0, 0.1]], "instrument_position.ephemeris_times do not cover"),
    ],
)
def test_what_is_wrong_is_named(path, value, says):
    with pytest.raises(CameraError, match=rf"^x\.json: .*{says}"):
        read(broken(path, value))


ODD = [None, [], {}, "x", np.nan, np.inf, -1, 0, True, 1e300, [[]], [[1, 2], [3]], [None] * 3]
ODD += [{"a": 1}, [1e308] * 3]


def everywhere(document, before=""):
    for key, value in document.items():
        yield before + key
        if isinstance(value, dict):
            yield from everywhere(value, f"{before}{key}.")


@pytest.mark.parametrize(
    ("make", "turn"), [(orbital_framer, 0), (orbital_line_scan, 1), (orbital_push_frame, 2)]
)
def test_oddities_anywhere_are_read_or_refused_in_one_line(make, turn):
    """Whatever stands in any one field (a third of the oddities in each kind): CameraError, or a sensor that answers."""
    sun = {"positions": [[1e5, 1e5, 0.0]], "ephemeris_times": [1000.0], "unit": "km"}
    whole = make() | {"sun_position": sun}
    whole["body_rotation"] |= {
        "constant_frames": [31001],
        "constant_rotation": np.eye(3).ravel().tolist(),
    }
    said = []
    for path in everywhere(whole):
        for value in ODD[turn::3]:
            try:
                sensor = read(broken(path, value, whole, delete=False))
                sensor.project([[1e6, 0.0, 0.0]])
                sensor.looks([1.0, 2.0])
            except CameraError as error:
                said.append(str(error))
    assert len(said) > 150
    assert all(line.startswith("x.json: ") and "\n" not in line for line in said)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"framelets_flipped": "no"}, "framelets_flipped is neither true nor false"),
        ({"framelet_height": 7}, "framelet_height does not divide 360 lines"),
        ({"framelet_height": 12.5}, "framelet_height does not divide"),
        ({"interframe_delay": 0.0}, "interframe_delay must be positive"),
        ({"exposure_duration": None}, "lacks exposure_duration"),
        ({"starting_ephemeris_time": 990.0}, "do not cover the image, -9.975 to -7.075 s"),
    ],
)
def test_what_is_wrong_with_framelets(changes, says):
    with pytest.raises(CameraError, match=says):
        read(orbital_push_frame() | changes)


def test_a_frame_of_no_century_of_ours():
    with pytest.raises(
        CameraError, match=r"center_ephemeris_time is 5e\+09 s: not within 1900-2099"
    ):
        read(orbital_framer() | {"center_ephemeris_time": 5e9})


def test_a_scanner_needs_more_than_one_attitude():
    document = orbital_line_scan()
    document["body_rotation"] = {"quaternions": [[1.0, 0, 0, 0]], "ephemeris_times": [1000.0]}
    with pytest.raises(CameraError, match=r"body_rotation\.ephemeris_times do not cover"):
        read(document)


def test_velocities_that_do_not_fit_are_left_aside(caplog):
    """usgscsm's fixtures state 1050 km/s for an orbit that runs at 1 km/s: between the times positions alone count."""
    with caplog.at_level(logging.WARNING):
        scanner = read(orbital_line_scan())
    assert "instrument_position.velocities do not fit" in caplog.text
    a = 0.75 / 1050.0
    there = scanner.trajectory.positions(np.array([-0.05]))[0]
    assert there == pytest.approx([1.05e6 * np.cos(a), 0.0, -1.05e6 * np.sin(a)], abs=1e-4)
    document = orbital_line_scan()
    fitting = np.array(document["instrument_position"]["velocities"]) / 1050.0
    document["instrument_position"]["velocities"] = fitting.tolist()
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert read(document).trajectory.track.velocities_m_s is not None
    assert "do not fit" not in caplog.text


def test_no_sun_is_no_sun():
    assert read(orbital_framer()).sun_position_mcmf_m is None
    sun = {
        "positions": [[1e5, 1e5, 0.0]],
        "ephemeris_times": [50],
        "unit": "m",
        "reference_frame": 1,
    }
    stated = read(orbital_framer() | {"sun_position": sun})
    assert stated.sun_position_mcmf_m == pytest.approx([1e5, 1e5, 0.0])


def test_moon_m_is_the_spheres():
    from lcp_catalog.constants import MOON_RADIUS_M

    assert MOON_M == MOON_RADIUS_M
