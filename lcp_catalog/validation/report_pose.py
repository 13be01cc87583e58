"""The pose in the validation report: corrections of the sensor's position and attitude, and their
uncertainty.
"""

from __future__ import annotations

import math
from typing import Any

from ..cameras.sensor import POSE
from ..matching.pose import PositionError
from ..plots.numbers import number
from .result import PoseFigures

_ARC_SECONDS = math.degrees(3600.0)
_CORRECTIONS = {
    "x_m": ("position, MCMF x", "m", 1.0),
    "y_m": ("position, MCMF y", "m", 1.0),
    "z_m": ("position, MCMF z", "m", 1.0),
    "turn_x_rad": ("rotation, camera x (right)", "″", _ARC_SECONDS),
    "turn_y_rad": ("rotation, camera y (down)", "″", _ARC_SECONDS),
    "turn_z_rad": ("rotation, line of sight", "″", _ARC_SECONDS),
    "east_m": ("map, east", "m", 1.0),
    "north_m": ("map, north", "m", 1.0),
}
"""Name, unit, and the factor to that unit."""


def pose_data(figures: PoseFigures | None) -> dict[str, Any] | None:
    """Table of the corrections and facts on the position; None without a pose."""
    if figures is None:
        return None
    pose = figures.pose
    each = zip(pose.sensor.corrections, pose.correction, pose.sigma, pose.solved, strict=True)
    axes = " x ".join(number(axis) for axis in figures.position_axes_m)
    facts = [
        ("position, 1 sigma", f"{number(pose.position_sigma_m)} m; along its axes {axes} m"),
        ("position error", _error(figures.error) if pose.sensor.corrections == POSE else ""),
        ("normalised error", f"{number(pose.normalised_error)} (expected: 1)"),
    ]
    return {
        "corrections": [_correction(n, value, sigma, solved) for n, value, sigma, solved in each],
        "facts": [(name, text) for name, text in facts if text],
    }


def _correction(name: str, value: float, sigma: float, solved: bool) -> tuple[str, str, str]:
    """Name, correction and 1 sigma of a parameter; a parameter that was not estimated is "fixed"."""
    meaning, unit, factor = _CORRECTIONS[name]
    if not solved:
        return meaning, "–", "fixed"
    return meaning, f"{_signed(value * factor)} {unit}", f"{number(sigma * factor)} {unit}"


def _error(error: PositionError | None) -> str:
    if error is None:
        return "unknown; if the pose is stated to be known, the camera file’s position is taken as the true one"
    off, sigma = error.error, error.sigma
    return (
        f"{number(off.whole_m)} m from the true position; across the line of sight {number(off.across_m)} m "
        f"(1 sigma {number(sigma.across_m)} m), along it {number(off.along_m)} m ({number(sigma.along_m)} m)"
    )


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + number(value).replace("-", "−")
