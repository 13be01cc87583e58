"""Small ISDs: the fixtures of usgscsm's own tests, made anew."""

from __future__ import annotations

import numpy as np

from lcp_catalog.cameras.isd import sensor_from_isd
from lcp_catalog.cameras.json_fields import JsonFields


def fixture(model, **changes):
    """Common fields of usgscsm's fixtures. Their bodies differ: radii are the Moon's here, which
    matters only for the ends of rays, and the test intersects those with its own sphere.
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


def line_scan(**changes):
    """Lines of 0.1 s across the middle of a detector."""
    return fixture(
        "LINE_SCANNER",
        focal2pixel_lines=[0.0, -10.0, 0.0],
        detector_center={"line": 0.5, "sample": 8.0},
        starting_detector_line=1,
        line_scan_rate=[[0.5, -0.85, 0.1]],
        **changes,
    )


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
    """tests/data/orbitalLineScan.json, a circular orbit rounded to eight digits as there; its
    quaternions (x, y, z, w, from sensor to body) as those of instrument_pointing.
    """
    a = 0.1 * np.arange(16) / 1050.0
    positions = np.round(np.stack([1050 * np.cos(a), 0 * a, -1050 * np.sin(a)], -1), 8)
    velocities = np.round(np.stack([-1050 * np.sin(a), 0 * a, -1050 * np.cos(a)], -1), 8)
    half = np.pi / 4 - a / 2
    quaternions = np.round(np.stack([np.cos(half), 0 * a, np.sin(half), 0 * a], -1), 8)
    return line_scan(
        **tables(999.2 + 0.1 * np.arange(16), positions, velocities, quaternions),
    )


def constant_velocity_line_scan():
    """tests/data/constVelocityLineScan.json, enlarged 10^5 times: its metres are those of a body of
    10 m.
    """
    z = 16.0 - 4.0 * np.arange(9)
    positions = 1e5 * np.stack([np.full(9, 1000.0), 0 * z, z], -1)
    q = [0.707106781186547, 0.0, 0.707106781186547, 0.0]
    return line_scan(
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
