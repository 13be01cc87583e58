"""Fields of an ISD: their conventions one by one, and refused values; all on small documents."""

import copy
import logging

import numpy as np
import pytest
from helpers.isd_files import orbital_framer, orbital_line_scan, orbital_push_frame, read

from lcp_catalog.errors import CameraError
from lcp_catalog.geometry import sphere_intersection

# conventions on a small ISD


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
    # the body rotated by 90 deg about z: x becomes -y in its axes
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
    """Lines 0..4 take 0.1 s, 5..9 take 0.2 s, the rest 0.05 s; the time of a line is the middle of
    its exposure.
    """
    rates = [[0.5, -0.85, 0.1], [5.5, -0.35, 0.2], [10.5, 0.65, 0.05]]
    document = orbital_line_scan() | {"line_scan_rate": rates, "image_lines": 12}
    scanner = read(document)
    expected = [*(-0.8 + 0.1 * np.arange(5)), *(-0.25 + 0.2 * np.arange(5)), 0.675, 0.725]
    found = scanner.times_s[64:-64]
    assert found == pytest.approx(expected, abs=1e-12)
    rows = np.array([0.0, 4.5, 9.5, 10.25])
    points = sphere_intersection.hits(*scanner.looks(np.stack([0 * rows + 4.0, rows], -1)), 1e6)[1]
    assert scanner.project(points)[:, 1] == pytest.approx(rows, abs=1e-7)


# refused values


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
        ("radii.semimajor", 3396.19, "radii.semimajor is 3396.19 km, not that of the Moon"),
        ("radii.semiminor", -1.0, "radii.semiminor must be positive"),
        ("radii.unit", "furlong", "radii.unit is 'furlong'"),
        ("radii.unit", 3, "radii.unit is not text"),
        ("body_rotation.constant_frames", [31001.5], "constant_frames is not a list of whole"),
        ("starting_detector_line", 1e13, "starting_detector_line holds a number beyond 1e.12"),
        ("image_lines", True, "image_lines does not consist of numbers"),
        ("radii", None, "lacks radii.semimajor"),
        ("image_lines", 0, "image_lines must be positive"),
        ("image_lines", 16.5, "image_lines must be a whole number"),
        ("image_samples", "many", "image_samples does not consist of numbers"),
        (
            "center_ephemeris_time",
            float("nan"),
            "center_ephemeris_time holds a number that is not finite",
        ),
        ("focal_length_model.focal_length", 0.0, "focal_length must be positive"),
        ("focal2pixel_lines", [0.0, 10.0], "focal2pixel_lines must be 3, is 2"),
        (
            "focal2pixel_lines",
            [0.0, 0.0, 10.0],
            "focal2pixel_lines and focal2pixel_samples are parallel",
        ),
        ("detector_center.line", None, "lacks detector_center.line"),
        ("detector_line_summing", 0, "detector_line_summing must be positive"),
        ("optical_distortion", {"cahvor": {}}, "optical_distortion is cahvor; supported are"),
        ("optical_distortion", {}, "optical_distortion is ; supported are"),
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
        (
            "body_rotation.ephemeris_times",
            [999.2] * 16,
            "body_rotation.ephemeris_times must increase",
        ),
        ("line_scan_rate", None, "lacks line_scan_rate"),
        ("line_scan_rate", [[0.5, -0.85, 0.0]], "line_scan_rate must have increasing lines"),
        (
            "line_scan_rate",
            [[0.5, -0.85, 0.1], [5.5, -2.0, 0.1]],
            "later line with an earlier time",
        ),
        ("line_scan_rate", [[0.5, 4.0, 0.1]], "instrument_position.ephemeris_times do not cover"),
    ],
)
def test_errors_name_the_field(path, value, says):
    with pytest.raises(CameraError, match=rf"^x\.json: .*{says}"):
        read(broken(path, value))


ODD = [None, [], {}, "x", np.nan, np.inf, -1, 0, True, 1e300, [[]], [[1, 2], [3]], [None] * 3]
ODD += [{"a": 1}, [1e308] * 3]


def everywhere(document, before=""):
    for key, value in document.items():
        yield before + key
        if isinstance(value, dict):
            yield from everywhere(value, f"{before}{key}.")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "turn"), [(orbital_framer, 0), (orbital_line_scan, 1), (orbital_push_frame, 2)]
)
def test_oddities_anywhere_are_read_or_refused_in_one_line(make, turn):
    """An odd value in any field (a third of them of each kind): CameraError, or a working sensor."""
    sun = {"positions": [[1e11, 1e11, 0.0]], "ephemeris_times": [1000.0], "unit": "km"}
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
def test_invalid_framelets(changes, says):
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
    """usgscsm's fixtures give 1050 km/s for an orbit with 1 km/s: between the times only positions
    are used.
    """
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
        "positions": [[1e11, 1e11, 0.0]],
        "ephemeris_times": [50],
        "unit": "m",
        "reference_frame": 1,
    }
    stated = read(orbital_framer() | {"sun_position": sun})
    assert stated.sun_position_mcmf_m == pytest.approx([1e11, 1e11, 0.0])
