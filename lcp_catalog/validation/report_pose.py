"""The part of a validation's page that says by how much the sensor's place was corrected, and how well it is known."""

from __future__ import annotations

import math

from ..cameras.sensor import POSE
from ..matching.pose import PositionError
from ..plots.html_page import facts
from ..plots.svg import number
from .result import PoseFigures

_ARC_SECONDS = math.degrees(3600.0)
_CORRECTIONS = {
    "x_m": ("position, MCMF x", "m", 1.0),
    "y_m": ("position, MCMF y", "m", 1.0),
    "z_m": ("position, MCMF z", "m", 1.0),
    "turn_x_rad": ("turn about the camera’s right", "″", _ARC_SECONDS),
    "turn_y_rad": ("turn about the camera’s down", "″", _ARC_SECONDS),
    "turn_z_rad": ("turn about the line of sight", "″", _ARC_SECONDS),
    "east_m": ("ground, east", "m", 1.0),
    "north_m": ("ground, north", "m", 1.0),
}
"""Name, unit, and the factor to it."""


def pose_section(figures: PoseFigures | None, beside: str = "") -> str:
    """The correction, with a figure beside it; nothing without a pose."""
    if figures is None:
        return ""
    pose = figures.pose
    each = zip(pose.sensor.corrections, pose.correction, pose.sigma, pose.solved, strict=True)
    lines = "".join(_correction(*one) for one in each)
    axes = " x ".join(number(axis) for axis in figures.position_axes_m)
    rows = [
        ("position, 1 sigma", f"{number(pose.position_sigma_m)} m; along its axes {axes} m"),
        ("position, error", _error(figures.error) if pose.sensor.corrections == POSE else ""),
        ("normalised error", f"{number(pose.normalised_error)}, 1 is expected"),
    ]
    return (
        f"<h3 class='part'>Pose</h3><div class='columns'>{beside}<div><div class='wide'><table>"
        "<thead><tr><th scope='col'>correction of the given place</th>"
        f"<th scope='col'>by</th><th scope='col'>1 sigma</th></tr></thead><tbody>{lines}</tbody></table></div>"
        f"{facts((name, text) for name, text in rows if text)}</div></div>"
    )


def _correction(name: str, value: float, sigma: float, solved: bool) -> str:
    """A row of the table."""
    meaning, unit, factor = _CORRECTIONS[name]
    cells = (f"{_signed(value * factor)} {unit}", f"{number(sigma * factor)} {unit}")
    by, known = cells if solved else ("–", "held")
    return f"<tr><th scope='row'>{meaning}</th><td>{by}</td><td>{known}</td></tr>"


def _error(error: PositionError | None) -> str:
    if error is None:
        return "not known: with --known-pose the camera file’s position counts as the true one"
    off, sigma = error.error, error.sigma
    return (
        f"{number(off.whole_m)} m against the true place; across the line of sight {number(off.across_m)} m "
        f"(1 sigma {number(sigma.across_m)}), along it {number(off.along_m)} m ({number(sigma.along_m)})"
    )


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + number(value).replace("-", "−")
