"""Tables of an ISD: positions and attitudes of the spacecraft, rotation of the Moon, position of
the Sun, times.

Times are seconds from ``center_ephemeris_time``. An ephemeris time itself, 1e8 s and more, has too
few digits left for the time of a line.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..ephemeris.times import utc_of_ephemeris_time
from ..geometry.rotations import turned
from .frame_camera import FARTHEST_M
from .json_fields import JsonFields
from .trajectory import Attitude, Track, Trajectory

_log = logging.getLogger(__name__)

_INERTIAL = 1
_MEAN_EARTH = {31001, 31003, 31005, 31007, 31009}
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
