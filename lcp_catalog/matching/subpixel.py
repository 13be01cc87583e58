"""Shifts between two arrays on one grid: by whole cells, by fractions of a cell, and the sub-cell
place of a peak.

Shifts are (column, row) in cells: how far an image lies right of and below the array that it is
compared with.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array


def undone(image: Array, weight: Array, shift_px: tuple[float, float]) -> tuple[Array, Array]:
    """The image and its weights with a shift (column, row) undone, by cubic convolution (Keys 1981,
    a = -1/2).

    Cells to which a missing cell or one from beyond the border contributes have weight 0. The image
    is extended by its border values.
    """
    there = weight > 0.0
    values = [np.where(there, image, 0.0), weight, (~there).astype(np.float64)]
    for axis, away in ((1, shift_px[0]), (0, shift_px[1])):
        whole, part = math.floor(away), away - math.floor(away)
        taps = [t for t in zip(range(-1, 3), _keys(part), strict=True) if t[1] != 0.0]
        linear = [(0, 1.0 - part), (1, part)]
        among = (taps, linear, [(step, abs(share)) for step, share in taps])
        values = [_mixed(x, axis, whole, parts) for x, parts in zip(values, among, strict=True)]
        values[2] = values[2] + _beyond(image.shape, axis, away)
    return values[0], np.where(values[2] > 0.0, 0.0, values[1])


def _keys(t: float) -> list[float]:
    """Weights of the four values around a place, a part ``t`` into the middle interval."""
    return [
        t * (-0.5 + t * (1.0 - 0.5 * t)),
        1.0 + t * t * (-2.5 + 1.5 * t),
        t * (0.5 + t * (2.0 - 1.5 * t)),
        t * t * (-0.5 + 0.5 * t),
    ]


def _mixed(values: Array, axis: int, whole: int, parts: list[tuple[int, float]]) -> Array:
    """Weighted sum of the values ``whole`` steps and a few more further on."""
    total = np.zeros_like(values)
    for step, share in parts:
        total += share * _along(values, axis, whole + step)
    return total


def _along(values: Array, axis: int, steps: int) -> Array:
    """The value ``steps`` cells further on, for every cell; beyond the border, the border's value."""
    at = np.clip(np.arange(values.shape[axis]) + steps, 0, values.shape[axis] - 1)
    return np.take(values, at, axis=axis)


def _beyond(shape: tuple[int, ...], axis: int, away: float) -> Array:
    """1 where a cell that far on lies outside, 0 elsewhere, broadcastable."""
    at = np.arange(shape[axis]) + away
    outside = ((at < -0.5) | (at > shape[axis] - 0.5)).astype(np.float64)
    return outside[:, None] if axis == 0 else outside[None]


def moves(reach: int) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Indices in a table of scores and the shift (column, row) of each."""
    span = range(-reach, reach + 1)
    return [((i, j), (col, row)) for i, row in enumerate(span) for j, col in enumerate(span)]


def moved(a: Array, b: Array, w: Array, shift: tuple[int, int]) -> tuple[Array, Array, Array]:
    """The image cells ``shift`` (column, row) right and below, aligned with the render's cells;
    weight 0 beyond the border.
    """
    col, row = shift
    moved = [np.zeros_like(a), np.zeros_like(w)]
    rows, cols = a.shape
    to = np.s_[max(0, -row) : rows - max(0, row), max(0, -col) : cols - max(0, col)]
    of = np.s_[max(0, row) : rows + min(0, row), max(0, col) : cols + min(0, col)]
    for out, source in zip(moved, (a, w), strict=True):
        out[to] = source[of]
    return moved[0], b, np.minimum(moved[1], np.where(w > 0.0, 1.0, 0.0))


def peaks(scores: Array) -> tuple[Array, Array, Array]:
    """Column and row (n,) of the highest value of each table of scores (m, m, n), and its height;
    NaN at the table's edge.
    """
    m, _, n = scores.shape
    at = scores.reshape(m * m, n).argmax(axis=0)
    i, j, k = at // m, at % m, np.arange(n)
    inner = (i > 0) & (i < m - 1) & (j > 0) & (j < m - 1)
    i, j = (np.clip(x, 1, m - 2) for x in (i, j))
    column, row = _summit_of_grid(
        [[scores[i + v, j + u, k] for u in (-1, 0, 1)] for v in (-1, 0, 1)]
    )
    away = [np.where(inner, x, np.nan) for x in (j - m // 2 + column, i - m // 2 + row)]
    return away[0], away[1], scores.max(axis=(0, 1))


def _summit_of_grid(near: list[list[Array]]) -> tuple[Array, Array]:
    """Maximum of the quadratic, cross term included, through a highest value's 3 x 3 neighbours:
    steps right and below, at most 1; 0 if it has no maximum there.
    """
    (nw, n, ne), (w, at, e), (sw, s, se) = near
    with np.errstate(invalid="ignore", divide="ignore"):
        slope_x, slope_y = 0.5 * (e - w), 0.5 * (s - n)
        xx, yy, xy = e - 2.0 * at + w, s - 2.0 * at + n, 0.25 * (se - sw - ne + nw)
        determinant = xx * yy - xy * xy
        x = (xy * slope_y - yy * slope_x) / determinant
        y = (xy * slope_x - xx * slope_y) / determinant
        good = (determinant > 0.0) & (np.abs(x) <= 1.0) & (np.abs(y) <= 1.0)
    return np.where(good, x, 0.0), np.where(good, y, 0.0)
