"""ISDs of scanners that fly south over a place, made from a few numbers, for renders.

Right in the image is east, down is south. The detector's x axis is along its columns, y along its
rows; the Moon turns during the flight.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.ephemeris.solar_position import direction_from_subsolar
from lcp_catalog.geometry.frames import EnuFrame

from .isd_files import fixture

MOON_TURNS = 2.66e-6  # radians per second
CENTRE_ET = 763387200.0  # 2024-03-10


def body_at(t: float) -> Rotation:
    """J2000 to MCMF."""
    return Rotation.from_rotvec([0.1, 0.0, 0.0]) * Rotation.from_rotvec(
        [0, 0, -0.7 - MOON_TURNS * t]
    )


def flight(lon: float, lat: float, altitude_m: float, times: np.ndarray, speed_m_s: float) -> dict:
    """Tables of a flight at a speed over the ground that passes a place at time 0."""
    places, axes, bodies = [], [], []
    for t in times:
        here = EnuFrame(lon, lat - np.degrees(speed_m_s * t / MOON_RADIUS_M))
        body = body_at(t)
        camera = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]) @ here.rotation)
        places.append(body.inv().apply(here.to_mcmf([0.0, 0.0, altitude_m])))
        axes.append((camera * body).as_quat()[[3, 0, 1, 2]])
        bodies.append(body.as_quat()[[3, 0, 1, 2]])
    speeds = np.gradient(np.array(places), times, axis=0, edge_order=2)
    table = {"ephemeris_times": (CENTRE_ET + times).tolist(), "reference_frame": 1}
    return {
        "instrument_position": table
        | {"positions": (1e-3 * np.array(places)).tolist(), "unit": "km"}
        | {"velocities": (1e-3 * speeds).tolist()},
        "instrument_pointing": table | {"quaternions": np.array(axes).tolist()},
        "body_rotation": table
        | {"quaternions": np.array(bodies).tolist(), "time_dependent_frames": [31001, 1]},
    }


def scan(
    path: Path,
    kind: str = "LINE_SCANNER",
    place: tuple[float, float] = (30.5, 10.5),
    shape: tuple[int, int] = (60, 80),
    pixel_m: float = 100.0,
    altitude_m: float = 50e3,
    lasts_s: float = 4.0,
    framelet: tuple[int, int] = (12, 10),
    subsolar: tuple[float, float] = (80.0, 0.0),
    **changes: Any,
) -> Path:
    """The ISD of an image whose middle shows a place. ``framelet``: its rows, and by how many of them
    it advances.
    """
    rows, cols = shape
    over = rows if kind == "LINE_SCANNER" else rows // framelet[0] * framelet[1]
    speed = over * pixel_m / lasts_s
    times = np.linspace(-0.6 * lasts_s, 0.6 * lasts_s, 41)
    per_mm = altitude_m / pixel_m / 50.0
    sun = body_at(0.0).inv().apply(1.5e8 * direction_from_subsolar(*subsolar))
    document = fixture(
        kind,
        image_lines=rows,
        image_samples=cols,
        focal2pixel_samples=[0.0, per_mm, 0.0],
        focal2pixel_lines=[0.0, 0.0, per_mm],
        starting_detector_line=0,
        sun_position={
            "positions": [sun.tolist()],
            "ephemeris_times": [CENTRE_ET],
            "reference_frame": 1,
            "unit": "km",
        },
        **flight(*place, altitude_m, times, speed),
    ) | {"center_ephemeris_time": CENTRE_ET}
    if kind == "LINE_SCANNER":
        document["detector_center"] = {"line": 0.0, "sample": cols / 2}
        document["line_scan_rate"] = [[0.5, -0.5 * lasts_s, lasts_s / rows]]
    else:
        high, step = framelet
        delay = step * pixel_m / speed
        start = -0.5 * delay * (rows // high - 1) - 0.005
        document |= {
            "detector_center": {"line": high / 2, "sample": cols / 2},
            "starting_ephemeris_time": CENTRE_ET + start,
            "exposure_duration": 0.01,
            "interframe_delay": delay,
            "framelet_height": high,
            "framelets_flipped": False,
            "framelet_order_reversed": False,
        }
    path.write_text(json.dumps(document | changes))
    return path
