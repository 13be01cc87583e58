"""An ISD evaluated from its documentation: scipy's rotations and splines, one pixel or point at a time, no code of ours.

Lines and samples here are an ISD's own: the centre of the first pixel is at 0.5.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq, root
from scipy.spatial.transform import Rotation, Slerp

MOON_M = 1737.4e3


class TwinIsd:
    """One ISD. Times are seconds from its centre."""

    def __init__(self, path: Path) -> None:
        self.d = json.loads(Path(path).read_text())
        self.t0 = self.d["center_ephemeris_time"]
        self.body = self._rotations("body_rotation")
        self.sensor = self._rotations("instrument_pointing")
        table = self.d["instrument_position"]
        self.times = np.array(table["ephemeris_times"]) - self.t0
        self.where = 1e3 * np.array(table["positions"])
        self.speed = 1e3 * np.array(table["velocities"])
        self.position, self.from_sensor = cache(self._position), cache(self._from_sensor)

    def _rotations(self, key):
        table = self.d[key]
        times = np.array(table["ephemeris_times"]) - self.t0
        wxyz = np.array(table["quaternions"])
        turns = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]])
        fixed = Rotation.from_matrix(
            np.reshape(table.get("constant_rotation", np.eye(3).ravel()), (3, 3))
        )
        if len(times) == 1:
            return lambda t: fixed * turns[0]
        path = Slerp(times, turns)
        return lambda t: fixed * path(np.clip(t, times[0], times[-1]))

    def _position(self, t):
        """Body-fixed metres."""
        if len(self.times) == 1:
            return self.body(t).apply(self.where[0])
        return self.body(t).apply(CubicHermiteSpline(self.times, self.where, self.speed)(t))

    def _from_sensor(self, t):
        """Sensor frame to body-fixed."""
        return self.body(t) * self.sensor(t).inv()

    @property
    def z(self):
        """+1 or -1: the side of the sensor frame on which the Moon is."""
        return -np.sign(self.from_sensor(0.0).apply([0, 0, 1.0]) @ self.position(0.0))

    # optics: millimetres of the focal plane

    def ideal(self, x, y):
        """Ideal coordinates of distorted ones."""
        ((kind, value),) = self.d["optical_distortion"].items()
        if kind == "radial":
            k0, k1, k2 = value["coefficients"]
            r = np.hypot(x, y)
            dr = k0 + k1 * r**2 + k2 * r**4
            return x - x * dr, y - y * dr
        if kind == "lrolrocnac":
            return x, y / (1 + value["coefficients"][0] * y**2)
        if kind == "kaguyalism":
            r = np.hypot(x, y)
            powers = r ** np.arange(4)
            return (
                x + value["boresight_x"] + np.dot(value["x"], powers),
                y + value["boresight_y"] + np.dot(value["y"], powers),
            )
        raise ValueError(kind)

    def distorted(self, x, y):
        """Inverse of `ideal`, by a general solver."""
        found = root(lambda p: np.subtract(self.ideal(*p), (x, y)), (x, y), tol=1e-13)
        return found.x

    def _axis(self, axis):
        d = self.d
        return (
            np.array(d[f"focal2pixel_{axis}s"]),
            d["detector_center"][axis],
            d[f"starting_detector_{axis}"],
            d[f"detector_{axis}_summing"],
        )

    def to_plane(self, line, sample):
        """Distorted millimetres of a line and sample of the detector's window."""
        rows, right = [], []
        for axis, value in (("line", line), ("sample", sample)):
            (c0, c1, c2), centre, start, summing = self._axis(axis)
            rows.append([c1, c2])
            right.append(value * summing + start - centre - c0)
        return np.linalg.solve(rows, right)

    def of_plane(self, x, y):
        """Line and sample of the window of distorted millimetres."""
        out = []
        for axis in ("line", "sample"):
            (c0, c1, c2), centre, start, summing = self._axis(axis)
            out.append((c0 + c1 * x + c2 * y + centre - start) / summing)
        return out

    @property
    def focal(self):
        return self.d["focal_length_model"]["focal_length"]

    def look(self, t, line, sample):
        """Position and unit direction of a pixel of the window at a time."""
        x, y = self.ideal(*self.to_plane(line, sample))
        ray = self.z * np.array([x, y, self.focal])
        ray = self.from_sensor(t).apply(ray)
        return self.position(t), ray / np.linalg.norm(ray)

    def window(self, t, point, lens=True):
        """Line and sample of the window of a body-fixed point at a time; approximate without the
        lens.
        """
        x, y, z = self.from_sensor(t).inv().apply(point - self.position(t))
        x, y = self.focal * x / z, self.focal * y / z
        return self.of_plane(*(self.distorted(x, y) if lens else (x, y)))

    # times

    def line_time(self, line):
        """The middle of a line's exposure."""
        best = [row for row in self.d["line_scan_rate"] if row[0] <= line] or [
            self.d["line_scan_rate"][0]
        ]
        first, start, duration = best[-1]
        return start + (line - first + 0.5) * duration

    @property
    def framelet_lines(self):
        return self.d["framelet_height"] // self.d["detector_line_summing"]

    @property
    def framelets(self):
        return self.d["image_lines"] // self.framelet_lines

    def framelet_time(self, k):
        k = self.framelets - 1 - k if self.d["framelet_order_reversed"] else k
        start = self.d["starting_ephemeris_time"] - self.t0 + self.d["exposure_duration"] / 2
        return start + k * self.d["interframe_delay"]

    # whole images

    def ray(self, line, sample):
        """Position and direction of an image's pixel."""
        kind = self.d["name_model"]
        if "LINE_SCANNER" in kind:
            return self.look(self.line_time(line), 0.0, sample)
        if "PUSH_FRAME" in kind:
            k = min(int(line // self.framelet_lines), self.framelets - 1)
            within = line - k * self.framelet_lines
            if self.d["framelets_flipped"]:
                within = self.framelet_lines - within
            return self.look(self.framelet_time(k), within, sample)
        return self.look(0.0, line, sample)

    def _in_framelet(self, k, point):
        """Distance of a point from the middle of a framelet; line and sample of the image."""
        within, sample = self.window(self.framelet_time(k), point)
        if self.d["framelets_flipped"]:
            within = self.framelet_lines - within
        return abs(within - self.framelet_lines / 2), k * self.framelet_lines + within, sample

    def _off_line(self, line, point):
        return self.window(self.line_time(line), point)[0]

    def pixel(self, point):
        """Line and sample of a body-fixed point."""
        kind = self.d["name_model"]
        if "LINE_SCANNER" in kind:
            line = brentq(self._off_line, 0.0, self.d["image_lines"], point, 1e-12, 1e-15)
            return line, self.window(self.line_time(line), point)[1]
        if "PUSH_FRAME" in kind:
            rough = [
                abs(self.window(self.framelet_time(k), point, lens=False)[0])
                for k in range(self.framelets)
            ]
            return min(self._in_framelet(k, point) for k in np.argsort(rough)[:9])[1:]
        return self.window(0.0, point)


def on_sphere(origin, ray, radius_m=MOON_M):
    """First intersection of a ray with a sphere; NaN without one."""
    b = origin @ ray
    inside = b * b - origin @ origin + radius_m**2
    return origin + (-b - np.sqrt(inside)) * ray if inside > 0 else np.full(3, np.nan)


def isd_of_cube(path: Path, tables: Any, lines: int, samples: int) -> dict[str, Any]:
    """An ISD document of an LRO NAC cube (cropped) with the tables that ISIS's spiceinit attached:
    from its label and the constants of the instrument kernels (lro_lroc_v18.ti,
    lro_instrumentAddendum_v04.ti).
    """

    def table(name, columns):
        head = tables[f"Table_{name}"]
        fields = [v["Name"] for k, v in head.items() if k.startswith("Field_")]
        count, start = int(head["Records"]), int(head["StartByte"]) - 1
        values = np.fromfile(path, "<f8", count * len(fields), offset=start).reshape(count, -1)
        kept = values[:, [fields.index(column) for column in columns]].tolist()
        return kept, values[:, fields.index("ET")].tolist(), head

    quaternion = [f"J2000Q{i}" for i in range(4)]
    pointing, pointing_times, _ = table("InstrumentPointing", quaternion)
    body, body_times, head = table("BodyRotation", quaternion)
    places, times, where = table("InstrumentPosition", ["J2000X", "J2000Y", "J2000Z"])
    speeds, _, _ = table("InstrumentPosition", ["J2000XV", "J2000YV", "J2000ZV"])
    cube = tables["IsisCube"]
    line_s = cube["Instrument"]["LineExposureDuration"]["value"] * 1e-3 * (1 + 0.0045)
    start = where["SpkTableStartTime"]
    centre = start + lines / 2 * line_s
    return {
        "name_model": "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL",
        "center_ephemeris_time": centre,
        "radii": {"semimajor": 1737.4, "semiminor": 1737.4, "unit": "km"},
        "image_lines": lines,
        "image_samples": samples,
        "line_scan_rate": [[0.5, start - centre, line_s]],
        "detector_center": {"line": 0.0, "sample": 2548.0 - 0.5},
        "detector_line_summing": 1,
        "detector_sample_summing": 1,
        "starting_detector_line": 0,
        "starting_detector_sample": cube["AlphaCube"]["AlphaStartingSample"] - 0.5,
        "focal2pixel_lines": [0.0, 142.857, 0.0],
        "focal2pixel_samples": [0.0, 0.0, 142.857],
        "focal_length_model": {"focal_length": 699.62},
        "optical_distortion": {"lrolrocnac": {"coefficients": [1.81e-5]}},
        "instrument_pointing": {"quaternions": pointing, "ephemeris_times": pointing_times},
        "instrument_position": {
            "positions": places,
            "velocities": speeds,
            "ephemeris_times": times,
        },
        "body_rotation": {
            "quaternions": body,
            "ephemeris_times": body_times,
            "constant_rotation": head["ConstantRotation"],
            "constant_frames": head["ConstantFrames"],
        },
    }
