"""Formulas of the plane, undone: what is taken to a point, and how far a polynomial rises."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..arrays import Array

Pair = tuple[Array, Array]
Map = Callable[[Any, Any], tuple[Any, Any]]
Slopes = tuple[Array, Array, Array, Array]
"""du/dx, du/dy, dv/dx, dv/dy."""

MOST_STEPS = 50
_CONVERGED = 1e-9  # Newton doubles the digits: after a step so small the next is below the last bit
_COMPLEX_STEP = 1e-30


def first_root(*rising: float) -> float:
    """The least positive root of a polynomial, lowest power first; infinity without one."""
    turns = np.roots(rising[::-1])
    real = turns[(np.abs(turns.imag) < 1e-12) & (turns.real > 0)].real if turns.size else turns
    return float(real.min()) if real.size else math.inf


def settled(step: Array, value: Array) -> bool:
    """Whether no step, of those that are numbers, still matters."""
    largest = np.fmax.reduce(np.abs(step), axis=None, initial=0.0)
    scale = np.fmax.reduce(np.abs(value), axis=None, initial=1.0)
    return bool(largest <= _CONVERGED * scale)


def undone(
    forward: Map, u: Array, v: Array, slopes: Callable[[Array, Array], Slopes] | None = None
) -> Pair:
    """What ``forward`` takes to (u, v): Newton's method, from (u, v) itself. Without ``slopes`` the derivatives come from
    complex steps, which are exact for formulas like these.
    """
    x, y = np.array(u, dtype=np.float64), np.array(v, dtype=np.float64)
    slopes = slopes or _complex_slopes(forward)
    with np.errstate(all="ignore"):  # what diverges ends as NaN; the caller looks
        for _ in range(MOST_STEPS):
            at_u, at_v = forward(x, y)
            uu, uv, vu, vv = slopes(x, y)
            du, dv, determinant = at_u - u, at_v - v, uu * vv - uv * vu
            step_x, step_y = (vv * du - uv * dv) / determinant, (uu * dv - vu * du) / determinant
            x, y = x - step_x, y - step_y
            if settled(np.hypot(step_x, step_y), np.hypot(x, y)):
                break
    return x, y


def _complex_slopes(forward: Map) -> Callable[[Array, Array], Slopes]:
    """du/dx, du/dy, dv/dx, dv/dy (Squire & Trapp 1998)."""

    def slopes(x: Array, y: Array) -> Slopes:
        step = 1j * _COMPLEX_STEP
        by_x, by_y = forward(x + step, y + 0j), forward(x + 0j, y + step)
        parts = (by_x[0], by_y[0], by_x[1], by_y[1])
        uu, uv, vu, vv = (np.asarray(part.imag / _COMPLEX_STEP) for part in parts)
        return uu, uv, vu, vv

    return slopes
