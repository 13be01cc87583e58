"""Means of an image over parallelograms, one for each cell of the terrain.

Inside a parallelogram samples lie at the middles of equal parts, at most a pixel apart in each of
its directions (`SAMPLES_MAX` parts at most). A sample is interpolated by cubic convolution (Keys
1981, a = -1/2: exact for quadratics), or, if one of its 16 pixels is missing, from the four around
it with their weights. The pixels of the border are repeated beyond it.
"""

from __future__ import annotations

import math

import numpy as np

from ..cache import njit

SAMPLES_MAX = 64
_A = -0.5


@njit(nogil=True)
def means(light, weight, at, down, right, signal, mass):
    """Fill signal and mass (n,) from an image's light and weight (rows, cols), float32; ``at``,
    ``down``, ``right`` (n, 2): (column, row) of a parallelogram's middle and its sides.
    Parallelograms with NaN get NaN and 0.
    """
    for k in range(at.shape[0]):
        signal[k], mass[k] = np.nan, 0.0
        if math.isnan(at[k, 0] + at[k, 1] + down[k, 0] + down[k, 1] + right[k, 0] + right[k, 1]):
            continue
        tall = _parts(down[k])
        wide = _parts(right[k])
        total, whole = 0.0, 0.0
        for i in range(tall):
            v = (i + 0.5) / tall - 0.5
            for j in range(wide):
                u = (j + 0.5) / wide - 0.5
                x = at[k, 0] + v * down[k, 0] + u * right[k, 0]
                y = at[k, 1] + v * down[k, 1] + u * right[k, 1]
                value, w = _sample(light, weight, x, y)
                total += w * value
                whole += w
        if whole > 0.0:
            signal[k] = total / whole
            mass[k] = whole / (tall * wide)


@njit(nogil=True)
def _parts(side):
    """Number of parts of a side, each at most one pixel long."""
    length = max(abs(side[0]), abs(side[1]))
    return int(min(max(math.ceil(length - 1e-9), 1), SAMPLES_MAX))


@njit(nogil=True)
def _sample(light, weight, x, y):
    """Value and weight of an image at a position; weight 0 outside the image or where pixels are
    missing.
    """
    rows, cols = light.shape
    if not (-0.5 <= x <= cols - 0.5 and -0.5 <= y <= rows - 0.5):
        return 0.0, 0.0
    j, i = math.floor(x), math.floor(y)
    u, v = x - j, y - i
    mass, total = 0.0, 0.0
    for di in range(2):
        row = min(max(i + di, 0), rows - 1)
        for dj in range(2):
            col = min(max(j + dj, 0), cols - 1)
            share = (v if di else 1.0 - v) * (u if dj else 1.0 - u)
            w = share * weight[row, col]
            mass += w
            if w > 0.0:
                total += w * light[row, col]
    if mass <= 0.0:
        return 0.0, 0.0
    linear = total / mass
    cubic = 0.0
    for di in range(-1, 3):
        row = min(max(i + di, 0), rows - 1)
        share = _keys(v - di)
        for dj in range(-1, 3):
            col = min(max(j + dj, 0), cols - 1)
            if not weight[row, col] > 0.0:
                return linear, mass
            cubic += share * _keys(u - dj) * light[row, col]
    return cubic, mass


@njit(nogil=True)
def _keys(s):
    """Keys' cubic kernel at a distance."""
    s = abs(s)
    if s < 1.0:
        return ((_A + 2.0) * s - (_A + 3.0)) * s * s + 1.0
    if s < 2.0:
        return ((_A * s - 5.0 * _A) * s + 8.0 * _A) * s - 4.0 * _A
    return 0.0
