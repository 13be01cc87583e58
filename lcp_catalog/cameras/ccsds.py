"""Cameras along CCSDS messages: orbits (OEM, CCSDS 502.0) and attitudes (AEM, CCSDS 504.0), as text (KVN).

Positions follow the cubic through the positions and velocities of two rows, attitudes turn at a constant rate, as
`trajectory` does.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ..arrays import Array
from ..ephemeris.times import Times, ephemeris_times, instants
from ..errors import CameraError, SunError
from ..geometry.rotations import inverse, product, quaternion_of, turned
from .camera_file import read_camera
from .frame_camera import Camera
from .spice import MEAN_EARTH, moon_rotations
from .trajectory import Attitude, Track

_log = logging.getLogger(__name__)

INERTIAL = {"EME2000", "J2000", "ICRF", "ICRF2", "ICRF3", "GCRF"}
"""Names of the axes of J2000; those of the ICRF differ by 0.08 arcsec, and SPICE has them as J2000."""

_COARSE_M = 1.0
_UNIT = 1e-3
_ENDS_S = 1.0
"""Rows reach START_TIME and STOP_TIME, as texts that may be rounded; a message that ends earlier is cut."""

_ORDINAL = re.compile(r"(\d{4})-(\d{3})T")


@dataclass(frozen=True)
class _Segment:
    """Key words of a segment, times (n,) and numbers (n, m) of its rows."""

    name: str
    meta: dict[str, str]
    times: Array
    rows: Array
    last_line: int

    def refuse(self, key: str, wanted: str) -> NoReturn:
        raise CameraError(
            f"{self.name}: {key} is {self.meta.get(key, 'missing')}; supported: {wanted}"
        )

    def fixed(self, key: str) -> bool:
        """True for a Moon-fixed frame, False for an inertial one."""
        frame = self.meta.get(key, "").upper()
        if frame not in {*INERTIAL, *MEAN_EARTH}:
            self.refuse(key, ", ".join((*sorted(INERTIAL), *MEAN_EARTH)))
        return frame in MEAN_EARTH

    def track(self) -> Track:
        """Positions of an OEM, metres."""
        if self.meta.get("CENTER_NAME", "").upper() != "MOON":
            self.refuse("CENTER_NAME", "MOON")
        if self.rows.shape[1] < 6:
            raise CameraError(f"{self.name}: rows of an OEM are a time, a position and a velocity")
        found = Track(self.times, 1e3 * self.rows[:, :3], 1e3 * self.rows[:, 3:6])
        if len(self.times) > 4:
            kept = slice(None, None, 2)
            half = Track(found.times_s[kept], found.positions_m[kept], 1e3 * self.rows[kept, 3:6])
            inner = found.times_s[1:-1:2]
            off = np.linalg.norm(half.at(inner) - found.at(inner), axis=1).max() / 16.0
            if off > _COARSE_M:
                _log.warning(
                    "%s: rows are so far apart that positions between them err by about %.0f m",
                    self.name,
                    off,
                )
        return found

    def attitude(self) -> tuple[Attitude, bool]:
        """Quaternions of an AEM from the reference to the body, and True for a Moon-fixed reference."""
        if not self.meta.get("ATTITUDE_TYPE", "").upper().startswith("QUATERNION"):
            self.refuse("ATTITUDE_TYPE", "QUATERNION")
        given = self.rows[:, :4]
        if given.shape[1] < 4 or (np.abs(np.linalg.norm(given, axis=1) - 1.0) > _UNIT).any():
            raise CameraError(f"{self.name}: rows of an AEM are a time and a unit quaternion")
        scalar_first = self.meta.get("QUATERNION_TYPE", "LAST").upper() == "FIRST"
        ordered = given if scalar_first else np.roll(given, 1, axis=1)
        turns = inverse(ordered)  # CCSDS turns the axes, we turn the vector
        from_body = self.meta.get("REF_FRAME_A", "").upper() not in {*INERTIAL, *MEAN_EARTH}
        fixed = self.fixed("REF_FRAME_B" if from_body else "REF_FRAME_A")
        back = self.meta.get("ATTITUDE_DIR", "A2B").upper() == "B2A"
        turns = inverse(turns) if from_body != back else turns
        return Attitude.of_table(self.times, turns, np.eye(3)), fixed


def cameras_from_ccsds(
    orbit: Path | str,
    attitude: Path | str,
    camera: Camera | Path | str,
    times: Times,
    kernels: Path | str | Sequence[Path | str] = (),
    mounting: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
) -> list[Camera]:
    """The framing cameras along an orbit and an attitude at instants (UTC), in their order.

    Parameters
    ----------
    orbit, attitude:
        An OEM and an AEM. Their reference frames are inertial (`INERTIAL`) or MOON_ME, the centre is the Moon.
    camera:
        The camera, or its file; its own position, attitude, time and Sun are not used.
    times:
        The instants, within both messages.
    kernels:
        SPICE kernels with the Moon's orientation (PCK, FK), for messages in an inertial frame.
    mounting:
        Quaternion (w, x, y, z) that turns vectors in the axes of the AEM's body to those of the camera (right, down, ahead).

    Raises
    ------
    CameraError
        One line: the file and the keyword that is not supported, or times that a message does not cover.

    Examples
    --------
    >>> files = folder / "orbit.oem", folder / "attitude.aem"
    >>> len(lcp.cameras_from_ccsds(*files, camera, ["2026-03-01T00:00:10", "2026-03-01T00:00:20"]))
    2
    """
    base = camera if isinstance(camera, Camera) else read_camera(camera)
    labels, seconds = instants(times).labels(), ephemeris_times(times)
    mount = np.array(mounting, dtype=np.float64)
    if mount.shape != (4,) or abs(np.linalg.norm(mount) - 1.0) > _UNIT:
        raise CameraError(f"`mounting` {tuple(mounting)} is no unit quaternion (w, x, y, z)")
    orbits, turns = _segments(orbit), _segments(attitude)
    tracks = [(one, one.track(), one.fixed("REF_FRAME")) for one in orbits]
    attitudes = [(one, *one.attitude()) for one in turns]
    inertial = any(not fixed for *_, fixed in (*tracks, *attitudes))
    moon = (
        moon_rotations(kernels, seconds) if inertial else np.tile(np.eye(3), (len(seconds), 1, 1))
    )
    found = []
    for et, label, to_moon in zip(seconds, labels, moon, strict=True):
        _, track, track_fixed = _at(tracks, et, label)
        _, turning, turning_fixed = _at(attitudes, et, label)
        now, body = np.array([et]), quaternion_of(to_moon)
        place, turn = track.at(now)[0], product(mount / np.linalg.norm(mount), turning.at(now)[0])
        changed: dict[str, Any] = {
            "position_mcmf_m": place if track_fixed else to_moon @ place,
            "rotation_mcmf_to_camera": turned(
                turn if turning_fixed else product(turn, inverse(body)), np.eye(3)
            ).T,
            "sun_position_mcmf_m": None,
            "time_utc": label,
            "name": f"{base.name} {label}",
        }
        found.append(replace(base, **changed))
    return found


def _at(segments: Sequence[tuple[_Segment, Any, bool]], et: float, label: str) -> Any:
    """The segment that covers a time."""
    for one in segments:
        if one[0].times[0] <= et <= one[0].times[-1]:
            return one
    name, spans = segments[0][0].name, [one[0].meta for one in segments]
    covered = ", ".join(f"{m.get('START_TIME', '?')} to {m.get('STOP_TIME', '?')}" for m in spans)
    raise CameraError(f"{name}: does not cover {label}: it has {covered}")


def _segments(path: Path | str) -> list[_Segment]:
    """The segments of a message."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise CameraError(f"{path}: cannot be read as text: {error}") from error
    lines = text.splitlines()
    if lines and lines[0].lstrip().startswith("<"):
        raise CameraError(f"{path}: is XML; give the message as text (KVN)")
    kept = [_segment(str(path), meta, rows) for meta, rows in _parts(lines) if rows]
    if not kept:
        raise CameraError(f"{path}: has no META_START and rows: it is no OEM or AEM in text (KVN)")
    for block in ("META", "DATA", "COVARIANCE"):
        if len({sum(f"{block}_{end}" in line for line in lines) for end in ("START", "STOP")}) > 1:
            raise CameraError(f"{path}: is cut: a {block}_START or its {block}_STOP is missing")
    if not text.endswith("\n") and kept[-1].last_line == len(lines):
        raise CameraError(f"{path}: its last line has no end: it is cut, or add a newline")
    return kept


Row = tuple[int, list[str]]
"""Number of a line, and its words."""


def _parts(lines: Sequence[str]) -> list[tuple[dict[str, str], list[Row]]]:
    """Key words and rows of the segments."""
    found: list[tuple[dict[str, str], list[Row]]] = []
    meta = skipped = False
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if text == "META_START":
            found.append(({}, []))
        meta = text == "META_START" or (meta and text != "META_STOP")
        skipped = text == "COVARIANCE_START" or (skipped and text != "COVARIANCE_STOP")
        if skipped or not found or not text or text.startswith(_MARKS):
            continue
        key, equals, value = text.partition("=")
        if equals:
            found[-1][0][key.strip()] = value.strip()
        elif not meta:
            found[-1][1].append((number, text.split()))
    return found


_MARKS = ("COMMENT", "DATA_ST", "META_ST", "COVARIANCE_ST")


def _segment(path: str, meta: dict[str, str], rows: list[Row]) -> _Segment:
    lengths = {len(words) for _, words in rows}
    if len(lengths) > 1:
        raise CameraError(f"{path}: line {rows[0][0]} and others have unequal numbers of columns")
    try:
        numbers = np.array([words[1:] for _, words in rows], dtype=np.float64)
    except ValueError as error:
        raise CameraError(f"{path}: from line {rows[0][0]} on: {error}") from error
    system = meta.get("TIME_SYSTEM", "")
    times = _times(path, [words[0] for _, words in rows], system)
    if not (np.diff(times) > 0.0).all() or not np.isfinite(numbers).all():
        raise CameraError(
            f"{path}: from line {rows[0][0]} on: times must increase, numbers be finite"
        )
    for key, end, sign in (("START_TIME", times[0], 1.0), ("STOP_TIME", times[-1], -1.0)):
        if key in meta and sign * (end - _times(path, [meta[key]], system)[0]) > _ENDS_S:
            raise CameraError(f"{path}: is cut: its rows do not reach {key} = {meta[key]}")
    return _Segment(path, meta, times, numbers, rows[-1][0])


def _times(path: str, texts: Sequence[str], system: str) -> Array:
    """Ephemeris times of texts in a time system."""
    try:
        return ephemeris_times([_calendar(text) for text in texts], system)
    except SunError as error:
        raise CameraError(f"{path}: {error}") from error


def _calendar(text: str) -> str:
    """A time with its day of the year (``2026-060T...``) as one with month and day."""
    match = _ORDINAL.match(text)
    if match is None:
        return text
    day = np.datetime64(f"{match[1]}-01-01") + np.timedelta64(int(match[2]) - 1, "D")
    return f"{day}T{text[match.end() :]}"
