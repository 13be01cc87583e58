"""Heights that were rounded to steps: the smoothest surface that would round to them.

A DEM kept in whole steps (8 bits over a crater, whole metres over a mare) has terraces, and a low Sun shades their edges. Every
surface within half a step of the heights rounds to them; of these this takes the one that bends least, so nothing is
claimed that the steps do not say, and no height moves by more than half a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lcp_catalog.arrays import Array

_BENDING_NORM = 64.0
"""No second difference's square sum grows a surface by more: 16 along rows, 16 along columns, 2 x 16 across."""


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Heights (rows, cols) in metres, NaN where there were none, and how far the search came: in the last of its ``rounds`` no
    height moved by more than ``last_move_m``.
    """

    heights_m: Array
    last_move_m: float
    rounds: int


def smooth_terraces(
    heights_m: ArrayLike, step_m: float, tolerance: float = 1e-4, most_rounds: int = 5000
) -> Smoothed:
    """The surface of least bending within half a step of heights (rows, cols); NaN stays NaN and bends nothing.

    Bending is the sum of z_xx^2 + 2 z_xy^2 + z_yy^2 (a thin plate's), by second differences in cells whose nodes are all
    there. Minimised by projected gradients with Nesterov's momentum, which starts anew where it would climb (O'Donoghue and Candes
    2015), until no height moves by more than ``tolerance`` steps in a round. ValueError for a step that is not positive.
    """
    if not (np.isfinite(step_m) and step_m > 0.0):
        raise ValueError(f"a step of {step_m} m; it must be positive")
    given = np.array(heights_m, dtype=np.float64)
    there = np.isfinite(given)
    middle = float(np.mean(given[there])) if there.any() else 0.0
    start = np.where(there, given - middle, 0.0) / step_m
    plate = _Plate.over(there)
    low, high = np.where(there, start - 0.5, 0.0), np.where(there, start + 0.5, 0.0)
    best, ahead, momentum, moved, rounds = start.copy(), start.copy(), 1.0, np.inf, 0
    while moved > tolerance and rounds < most_rounds:
        rounds += 1
        after = np.clip(ahead - plate.slope(ahead) / _BENDING_NORM, low, high)
        step = after - best
        if float(np.sum((ahead - after) * step)) > 0.0:
            momentum = 1.0
        grown = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * momentum**2))
        moved = float(np.abs(step).max(initial=0.0))
        ahead = after + (momentum - 1.0) / grown * step
        best, momentum = after, grown
    return Smoothed(np.where(there, best * step_m + middle, np.nan), moved * step_m, rounds)


@dataclass(frozen=True, eq=False)
class _Plate:
    """Which second differences exist: along rows, along columns, across."""

    along_rows: NDArray[np.bool_]
    along_cols: NDArray[np.bool_]
    across: NDArray[np.bool_]

    @classmethod
    def over(cls, there: NDArray[np.bool_]) -> _Plate:
        return cls(
            there[:, :-2] & there[:, 1:-1] & there[:, 2:],
            there[:-2] & there[1:-1] & there[2:],
            there[:-1, :-1] & there[:-1, 1:] & there[1:, :-1] & there[1:, 1:],
        )

    def slope(self, z: Array) -> Array:
        """Half the gradient of the bending, (rows, cols)."""
        out = np.zeros_like(z)
        for mask, a, b, c in (
            (self.along_rows, np.s_[:, :-2], np.s_[:, 1:-1], np.s_[:, 2:]),
            (self.along_cols, np.s_[:-2], np.s_[1:-1], np.s_[2:]),
        ):
            second = np.where(mask, z[a] - 2.0 * z[b] + z[c], 0.0)
            out[a] += second
            out[b] -= 2.0 * second
            out[c] += second
        nw, ne, sw, se = ((r, c) for r in _HALVES for c in _HALVES)
        twist = np.where(self.across, 2.0 * (z[nw] - z[ne] - z[sw] + z[se]), 0.0)
        out[nw] += twist
        out[ne] -= twist
        out[sw] -= twist
        out[se] += twist
        return out


_HALVES = (slice(None, -1), slice(1, None))
