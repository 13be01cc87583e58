"""Trajectories from files: a CSV table of times, positions and attitudes of one camera, or a JSON
list of cameras.

A CSV has a header with ``time_utc``, ``x_m``, ``y_m``, ``z_m`` (MCMF) and either ``qw``, ``qx``,
``qy``, ``qz``, the quaternion that takes MCMF vectors to camera axes, or ``r11`` ... ``r33``, the
elements of ``rotation_mcmf_to_camera`` row by row. Other columns, empty lines and lines that begin
with # are ignored.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array
from ..cameras.frame_camera import Camera, camera_from_json
from ..cameras.json_fields import json_value
from ..ephemeris.times import instants
from ..errors import CameraError, SunError
from ..geometry.rotations import turned

FRAMES_MAX = 100_000
"""Most frames of a trajectory."""

_POSITION = ("x_m", "y_m", "z_m")
_QUATERNION = ("qw", "qx", "qy", "qz")
_MATRIX = tuple(f"r{row}{column}" for row in "123" for column in "123")
_UNIT_TOLERANCE = 1e-3
"""Largest deviation of a quaternion's length from 1; they are often written with few digits."""


def read_trajectory(path: Path | str, camera: Camera | None = None) -> list[Camera]:
    """The cameras of a trajectory, in the file's order. ``camera``: that of a CSV; its own position,
    attitude, time and Sun are not used. CameraError, one line, for a file that is invalid, and for a
    camera that is missing or too many.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise CameraError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise CameraError(f"{path}: is not text: {error}") from error
    if text.lstrip().startswith(("[", "{")):
        if camera is not None:
            raise CameraError(f"{path}: lists whole cameras; leave out `camera`")
        found = _from_json(text, str(path))
    else:
        if camera is None:
            raise CameraError(f"{path}: is a CSV table of positions; give its camera with `camera`")
        found = _from_csv(text, str(path), camera)
    if not found:
        raise CameraError(f"{path}: has no frame")
    return found


def _from_json(text: str, name: str) -> list[Camera]:
    documents = json_value(text, name)
    if not isinstance(documents, list):
        raise CameraError(f"{name}: must be a list of cameras, or a CSV table")
    _require_few(len(documents), name)
    return [camera_from_json(one, f"{name}: camera {k}") for k, one in enumerate(documents, 1)]


def _from_csv(text: str, name: str, camera: Camera) -> list[Camera]:
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    _require_few(len(lines) - 1, name)
    try:
        rows = list(csv.reader((line for _, line in lines), strict=True))
    except csv.Error as error:
        raise CameraError(f"{name}: is not a CSV table: {error}") from error
    columns = _columns([head.strip() for head in rows[0]] if rows else [], name)
    return [
        _camera(row, columns, f"{name}: line {number}", camera)
        for (number, _), row in zip(lines[1:], rows[1:], strict=True)
    ]


def _columns(heads: list[str], name: str) -> dict[str, int]:
    """Number of each column that is used."""
    wanted = ["time_utc", *_POSITION]
    if "qw" in heads:
        wanted += _QUATERNION
    elif "r11" in heads:
        wanted += _MATRIX
    else:
        raise CameraError(f"{name}: the header lacks qw, qx, qy, qz (or r11 ... r33)")
    missing = [head for head in wanted if head not in heads]
    if missing:
        raise CameraError(f"{name}: the header lacks {', '.join(missing)}")
    twice = [head for head in wanted if heads.count(head) > 1]
    if twice:
        raise CameraError(f"{name}: the header has {twice[0]} twice")
    return {head: heads.index(head) for head in wanted}


def _camera(row: list[str], columns: dict[str, int], name: str, camera: Camera) -> Camera:
    if len(row) <= max(columns.values()):
        raise CameraError(f"{name}: has {len(row)} columns, fewer than the header")
    values = {}
    for head, column in columns.items():
        if head != "time_utc":
            values[head] = _number(row[column], head, name)
    time = row[columns["time_utc"]].strip()
    _require_time(time, name)
    changed: dict[str, Any] = {
        "position_mcmf_m": np.array([values[head] for head in _POSITION]),
        "rotation_mcmf_to_camera": _rotation(values, name),
        "sun_position_mcmf_m": None,
        "time_utc": time,
        "name": name,
    }
    return replace(camera, **changed)


def _rotation(values: dict[str, float], name: str) -> Array:
    if "qw" not in values:
        return np.array([values[head] for head in _MATRIX]).reshape(3, 3)
    quaternion = np.array([values[head] for head in _QUATERNION])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= _UNIT_TOLERANCE:
        raise CameraError(f"{name}: qw, qx, qy, qz have the length {length:.6g}, not 1")
    return np.asarray(turned(quaternion / length, np.eye(3)).T)


def _number(text: str, head: str, name: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise CameraError(f"{name}: {head} is not a number: {text.strip()!r}") from error


def _require_time(text: str, name: str) -> None:
    try:
        instants(text)
    except SunError as error:
        raise CameraError(f"{name}: {error}") from error


def _require_few(count: int, name: str) -> None:
    if count > FRAMES_MAX:
        raise CameraError(f"{name}: has {count} frames, more than {FRAMES_MAX}: cut the file")
