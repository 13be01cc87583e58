"""USGS image support data (ISD): the JSON that ALE writes for the CSM sensor models of framing
cameras, line scanners and push-frame cameras of the Moon.

Lens and detector of an ISD.

Tables of an ISD: positions and attitudes of the spacecraft, rotation of the Moon, position of
the Sun, times.

Times are seconds from ``center_ephemeris_time``. An ephemeris time itself, 1e8 s and more, has too
few digits left for the time of a line.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..ephemeris.times import utc_of_ephemeris_time
from ..geometry.rotations import inverse, turned
from .distortion import FocalPlane, KaguyaLism, Lens, LroNac, NoLens, OpenCV, UsgsRadial, plane_of
from .frame_camera import FARTHEST_M, Camera, fields_of_plane
from .json_fields import JsonFields
from .scanners import BEYOND, LineScanner, PushFrame, Scanner
from .trajectory import Attitude, Track, Trajectory

_log = logging.getLogger(__name__)

_INERTIAL = 1
_MEAN_EARTH = {31001, 31003, 31005, 31007, 31009, 31011}
_RADIUS_TOLERANCE = 0.01
_UNIT_TOLERANCE = 1e-3
_CENTURY_S = 99.9 * 365.25 * 86400.0
_UNITS_M = {"m": 1.0, "km": 1000.0}
_VELOCITY_SHARE, _VELOCITY_M = 0.1, 1.0
_SPARE = 0.02
"""Share of the image's duration, plus one step of the table, by which a table may be too short."""


@dataclass(frozen=True)
class Tables:
    """The tables of one ISD. Every method raises CameraError, which names the file and the field."""

    fields: JsonFields

    def check_body(self) -> None:
        """CameraError for an ISD of another body; log a body-fixed frame other than that of lunar
        maps.
        """
        unit = self._unit("radii.unit")
        for axis in ("semimajor", "semiminor"):
            radius_m = self.fields.positive(f"radii.{axis}") * unit
            if abs(radius_m / MOON_RADIUS_M - 1.0) > _RADIUS_TOLERANCE:
                self.fields.refuse(
                    f"radii.{axis}", f"is {radius_m / 1e3:g} km, not that of the Moon"
                )
        if self._body_frame not in _MEAN_EARTH:
            _log.warning(
                "%s: its body-fixed frame (NAIF %s) is not the mean-Earth frame of lunar maps: "
                "IAU_MOON differs by up to 155 m, principal axes by 0.9 km",
                self.fields.name,
                self._body_frame,
            )

    @property
    def instant(self) -> str:
        """UTC of the middle of the image."""
        seconds = self.fields.number("center_ephemeris_time")
        if abs(seconds) > _CENTURY_S:
            self.fields.refuse("center_ephemeris_time", f"is {seconds:g} s: not within 1900-2099")
        return utc_of_ephemeris_time(seconds)

    @cached_property
    def trajectory(self) -> Trajectory:
        """Trajectory in the axes of the ISD's sensor frame."""
        body, pointing = self._turning("body_rotation"), self._turning("instrument_pointing")
        if self._frame("body_rotation") != self._frame("instrument_pointing"):
            self.fields.refuse("instrument_pointing.reference_frame", "is not body_rotation's")
        track = self._track("instrument_position")
        away = np.linalg.norm(track.positions_m, axis=1)
        if (away < 0.5 * MOON_RADIUS_M).any() or (away > FARTHEST_M).any():
            self.fields.refuse(
                "instrument_position.positions", f"reach {away.min() / 1e3:g} km from the centre"
            )
        return Trajectory(track, body, pointing, self._is_fixed("instrument_position"))

    @property
    def looks_back(self) -> bool:
        """True if the Moon lies towards -z of the sensor frame.

        CSM models follow the line of sight of a pixel both ways and take the nearer of the two
        points of the surface; for the Apollo metric cameras that is the one at -z.
        """
        now = np.zeros(1)
        ahead = self.trajectory.to_mcmf(now, np.array([[0.0, 0.0, 1.0]]))[0]
        return bool(ahead @ self.trajectory.positions(now)[0] > 0.0)

    def sun(self) -> Array | None:
        """MCMF position of the Sun (3,), metres, at the middle of the image; None if the ISD has no
        Sun.
        """
        if self.fields.find("sun_position") is None:
            return None
        now = np.zeros(1)
        there = self._track("sun_position").at(now)[0]
        if self._is_fixed("sun_position"):
            return np.asarray(there)
        return turned(self.trajectory.body.at(now)[0], there)

    def cover(self, first_s: float, last_s: float) -> None:
        """CameraError for tables that do not cover the duration of an image."""
        spare = _SPARE * (last_s - first_s)
        for table in ("instrument_position", "instrument_pointing", "body_rotation"):
            times = self._times(table)
            step = (times[-1] - times[0]) / max(len(times) - 1, 1)
            short = max(times[0] - first_s, last_s - times[-1])
            if short > spare + step or (len(times) == 1 and last_s > first_s):
                self.fields.refuse(
                    f"{table}.ephemeris_times",
                    f"do not cover the image, {first_s:g} to {last_s:g} s from its centre",
                )

    def _unit(self, path: str) -> float:
        """Metres per unit; kilometres if no unit is given, as ALE writes."""
        stated = "km" if self.fields.find(path) is None else self.fields.text(path)
        if stated not in _UNITS_M:
            self.fields.refuse(path, f"is {stated!r}; supported are {', '.join(_UNITS_M)}")
        return _UNITS_M[stated]

    def _times(self, table: str) -> Array:
        times = self.fields.numbers(f"{table}.ephemeris_times", (None,))
        if not (np.diff(times) > 0.0).all():
            self.fields.refuse(f"{table}.ephemeris_times", "must increase")
        return times - self.fields.number("center_ephemeris_time")

    def _track(self, table: str) -> Track:
        times, unit = self._times(table), self._unit(f"{table}.unit")
        shape = (len(times), 3)
        positions = unit * self.fields.numbers(f"{table}.positions", shape)
        if not self.fields.find(f"{table}.velocities"):
            return Track(times, positions)
        velocities = unit * self.fields.numbers(f"{table}.velocities", shape)
        if not _fit(times, positions, velocities):
            _log.warning(
                "%s: %s.velocities do not fit the positions and are left aside",
                self.fields.name,
                table,
            )
            return Track(times, positions)
        return Track(times, positions, velocities)

    def _turning(self, table: str) -> Attitude:
        times = self._times(table)
        quaternions = self.fields.numbers(f"{table}.quaternions", (len(times), 4))
        if (np.abs(np.linalg.norm(quaternions, axis=1) - 1.0) > _UNIT_TOLERANCE).any():
            self.fields.refuse(f"{table}.quaternions", "must have length 1")
        after = np.eye(3)
        if self.fields.find(f"{table}.constant_rotation") is not None:
            after = self.fields.numbers(f"{table}.constant_rotation", (9,)).reshape(3, 3)
            off = np.abs(after @ after.T - np.eye(3)).max()
            if off > _UNIT_TOLERANCE or np.linalg.det(after) < 0:
                self.fields.refuse(f"{table}.constant_rotation", "is not a rotation")
        return Attitude.of_table(times, quaternions, after)

    def _frame(self, table: str) -> int:
        path = f"{table}.reference_frame"
        return _INERTIAL if self.fields.find(path) is None else round(self.fields.number(path))

    @property
    def _body_frame(self) -> int | None:
        """NAIF number of the frame to which ``body_rotation`` leads; None if it is not given."""
        kinds = ("constant", "time_dependent")
        codes = [self.fields.codes(f"body_rotation.{kind}_frames") for kind in kinds]
        return next((code for some in codes for code in some), None)

    def _is_fixed(self, table: str) -> bool:
        """True if a table's positions are body-fixed already."""
        frame = self._frame(table)
        if frame not in (_INERTIAL, self._body_frame):
            self.fields.refuse(
                f"{table}.reference_frame", f"is {frame}: neither J2000 (1) nor the body's"
            )
        return frame != _INERTIAL


def _fit(times: Array, positions: Array, velocities: Array) -> bool:
    """True if velocities agree with the change of the positions within a tolerance; False for other
    units or other quantities.
    """
    steps = np.diff(times)[:, None]
    run = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    mean = 0.5 * np.linalg.norm((velocities[1:] + velocities[:-1]) * steps, axis=1)
    off = np.linalg.norm(
        np.diff(positions, axis=0) - 0.5 * steps * (velocities[1:] + velocities[:-1]), axis=1
    )
    return bool((off <= _VELOCITY_SHARE * np.maximum(run, mean) + _VELOCITY_M).all())


CORNER_PX = 0.5
"""Offset from an ISD's lines and samples, which count from the corner, to pixels."""

_SKEWEST = 1e3
_BACK = np.diag([-1.0, 1.0, -1.0])


def plane_of_isd(
    fields: JsonFields, *, looks_back: bool, upside_down: int | None = None
) -> tuple[FocalPlane, Array]:
    """Focal plane from directions to pixels of the image, of a framelet (with first row 0), or of a
    line (with upper edge -0.5), and rotation (3, 3) from the ISD's sensor frame to its axes.

    ``looks_back``: True if the scene is towards -z of the sensor frame. ``upside_down``: number of
    rows of a framelet whose last line is first in the image. CameraError for an invalid field.
    """
    matrix, origin = np.empty((2, 2)), np.empty(2)
    for i, axis in enumerate(("sample", "line")):
        summing = fields.positive(f"detector_{axis}_summing")
        offset, *matrix[i] = fields.numbers(f"focal2pixel_{axis}s", (3,)) / summing
        centre = fields.number(f"detector_center.{axis}")
        start = fields.number(f"starting_detector_{axis}")
        origin[i] = offset + (centre - start) / summing - CORNER_PX
    if not np.linalg.cond(matrix) < _SKEWEST:
        fields.refuse("focal2pixel_lines", "and focal2pixel_samples are parallel")
    if upside_down is not None:
        matrix[1], origin[1] = -matrix[1], upside_down - 1.0 - origin[1]
    focal_mm = fields.positive("focal_length_model.focal_length")
    column, row = origin.tolist()
    plane, turn = plane_of(_lens(fields), focal_mm, matrix, (column, row), flipped=looks_back)
    # half a turn about y brings the scene ahead; this changes the sign of y / z but not of x / z
    return plane, turn @ _BACK if looks_back else turn


def _lens(fields: JsonFields) -> Lens:
    """The lens, in millimetres of the focal plane."""
    stated = fields.need("optical_distortion")
    kinds = {"radial": _radial, "radtan": _radtan, "lrolrocnac": _lro_nac, "kaguyalism": _kaguya}
    if not isinstance(stated, dict) or len(stated) != 1 or not set(stated) <= set(kinds):
        said = ", ".join(stated) if isinstance(stated, dict) else stated
        fields.refuse("optical_distortion", f"is {said}; supported are {', '.join(kinds)}")
    return kinds[next(iter(stated))](fields)


def _coefficients(fields: JsonFields, kind: str, most: int) -> list[float]:
    path = f"optical_distortion.{kind}.coefficients"
    numbers = fields.numbers(path, (None,)).tolist()
    if any(numbers[most:]):
        fields.refuse(path, f"has more than {most} numbers")
    return [*numbers, *[0.0] * most][:most]


def _radial(fields: JsonFields) -> Lens:
    k0, k1, k2 = _coefficients(fields, "radial", 3)
    return UsgsRadial(k0, k1, k2) if k0 or k1 or k2 else NoLens()


def _radtan(fields: JsonFields) -> Lens:
    return OpenCV(*_coefficients(fields, "radtan", 5))


def _lro_nac(fields: JsonFields) -> Lens:
    return LroNac(*_coefficients(fields, "lrolrocnac", 1))


def _kaguya(fields: JsonFields) -> Lens:
    path = "optical_distortion.kaguyalism"
    (a0, a1, a2, a3), (b0, b1, b2, b3) = (
        fields.numbers(f"{path}.{axis}", (4,)).tolist() for axis in ("x", "y")
    )
    x, y = (fields.number(f"{path}.boresight_{axis}") for axis in ("x", "y"))
    return KaguyaLism((a0, a1, a2, a3), (b0, b1, b2, b3), x, y)


AnySensor = Camera | LineScanner | PushFrame


def is_isd(fields: JsonFields) -> bool:
    """True if a document is an ISD."""
    return "name_model" in fields.document or "instrument_pointing" in fields.document


def sensor_from_isd(fields: JsonFields) -> AnySensor:
    """The sensor that an ISD describes; CameraError names the file and the invalid field."""
    kinds: dict[str, Callable[[JsonFields, Tables], AnySensor]] = {
        "USGS_ASTRO_FRAME_SENSOR_MODEL": frame_from_isd,
        "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL": _line_scanner,
        "USGS_ASTRO_PUSH_FRAME_SENSOR_MODEL": _push_frame,
    }
    model = fields.text("name_model")
    if model not in kinds:
        fields.refuse("name_model", f"is {model}; supported are {', '.join(kinds)}")
    tables = Tables(fields)
    tables.check_body()
    return kinds[model](fields, tables)


def isd_with_sun(document: dict[str, Any], scanner: Scanner) -> dict[str, Any]:
    """The ISD of a scanner, ``document``, with the scanner's Sun in place of its own."""
    assert scanner.sun_position_mcmf_m is not None
    now = np.zeros(1)
    inertial = turned(inverse(scanner.trajectory.body.at(now)), scanner.sun_position_mcmf_m)
    sun = {
        "positions": (1e-3 * inertial).reshape(1, 3).tolist(),
        "ephemeris_times": [document["center_ephemeris_time"]],
        "reference_frame": 1,
        "unit": "km",
    }
    return document | {"sun_position": sun}


def _common(fields: JsonFields, tables: Tables) -> dict[str, Any]:
    return {
        "sun_position_mcmf_m": tables.sun(),
        "time_utc": tables.instant,
        "name": fields.name,
    }


def frame_from_isd(fields: JsonFields, tables: Tables, looks_back: bool | None = None) -> Camera:
    """The framing camera of an ISD. ``looks_back``: whether its scene is towards -z of the sensor frame;
    None: where the Moon is.
    """
    back = tables.looks_back if looks_back is None else looks_back
    plane, axes = plane_of_isd(fields, looks_back=back)
    trajectory = tables.trajectory.with_axes(axes)
    return Camera(
        position_mcmf_m=trajectory.positions(np.zeros(1))[0],
        rotation_mcmf_to_camera=trajectory.to_mcmf(np.zeros(3), np.eye(3)),
        image_size_px=(fields.whole("image_samples"), fields.whole("image_lines")),
        **_common(fields, tables),
        **fields_of_plane(plane),
    )


def _line_scanner(fields: JsonFields, tables: Tables) -> LineScanner:
    lines, samples = fields.whole("image_lines"), fields.whole("image_samples")
    times = _line_times(fields, lines)
    tables.cover(times[BEYOND], times[-1 - BEYOND])
    plane, axes = plane_of_isd(fields, looks_back=tables.looks_back)
    return LineScanner(
        image_shape=(lines, samples),
        plane=plane,
        trajectory=tables.trajectory.with_axes(axes),
        times_s=times,
        line_px=-CORNER_PX,  # usgscsm takes the line of sight of the upper edge of the detector's line
        **_common(fields, tables),
    )


def _line_times(fields: JsonFields, count: int) -> Array:
    """Times of the middle of the exposure of every line, and of `BEYOND` lines before and after.

    Each row of ``line_scan_rate`` holds a line (its centre at .5), the time at which its exposure
    begins, and the duration of a line from there on.
    """
    lines, starts, lasting = fields.numbers("line_scan_rate", (None, 3)).T
    if not ((np.diff(lines) > 0.0).all() and (lasting > 0.0).all()):
        fields.refuse("line_scan_rate", "must have increasing lines and positive line times")
    line = np.arange(-BEYOND, count + BEYOND) + CORNER_PX
    part = np.clip(np.searchsorted(lines, line, side="right") - 1, 0, None)
    times = starts[part] + lasting[part] * (line - lines[part] + 0.5)
    if not (np.diff(times) > 0.0).all():
        fields.refuse("line_scan_rate", "has a later line with an earlier time")
    return np.asarray(times)


def _push_frame(fields: JsonFields, tables: Tables) -> PushFrame:
    lines, samples = fields.whole("image_lines"), fields.whole("image_samples")
    height = fields.positive("framelet_height") / fields.positive("detector_line_summing")
    if height != round(height) or lines % height:
        fields.refuse("framelet_height", f"does not divide {lines} lines into framelets")
    step = fields.positive("interframe_delay")
    first = fields.number("starting_ephemeris_time") - fields.number("center_ephemeris_time")
    first += 0.5 * fields.number("exposure_duration")
    last = first + step * (lines / height - 1.0)
    tables.cover(first, last)
    if fields.flag("framelet_order_reversed"):
        first, step = last, -step
    upside_down = int(height) if fields.flag("framelets_flipped") else None
    plane, axes = plane_of_isd(fields, looks_back=tables.looks_back, upside_down=upside_down)
    return PushFrame(
        image_shape=(lines, samples),
        plane=plane,
        trajectory=tables.trajectory.with_axes(axes),
        lines=int(height),
        first_s=first,
        step_s=step,
        **_common(fields, tables),
    )
