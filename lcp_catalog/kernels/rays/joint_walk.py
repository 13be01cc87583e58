"""Camera rays of a tile that walk together, cell by cell, over a raster without nodata.

Waiting for the result of one ray's cell takes longer than all arithmetic, so a step is three loops over the rays: read
the heights of their cells, do the arithmetic, move the rays that walk on to the front. The loop of the arithmetic has
no branches and no index that is not the ray's, so that the compiler processes several rays at once. What a step works
on lies in rows of one flat array: the compiler then knows that no row overlaps another one.

Rays and units as in `tracing`; the bits of a result are those of `tracing.met`.
"""

import math

from ..cache import njit
from .tracing import NEVER, UNDERGROUND_M, entered, inverse_of, met_in_cell

RAYS = 64
"""Greatest number of rays that walk together."""

ROWS = 19
(
    _DU, _DV, _DZ, _INVERSE_U, _INVERSE_V, _INVERSE_ACROSS, _U, _V, _Z, _ROW, _COL, _S,
    _RAY, _FOUND, _ON, _Z00, _Z01, _Z10, _Z11,
) = (row * RAYS for row in range(ROWS))  # fmt: skip
"""Beginnings of the rows of a work array (ROWS * RAYS,): the ray in cell units, where it is, the number of the ray in its
tile, the parameter of its hit (-1: none), whether it walks on (1 or 0), and the heights of its cell.
"""


@njit(nogil=True, error_model="numpy")
def start_together(rows, cols, summit, clear, queue, count, work, found):
    """Put the rays of ``queue`` (11, RAYS; `bundles.approach`) that enter from above and are clear down to ``clear``
    into their first cells. Return their number.

    ``found`` (RAYS,) becomes -1 for rays that are done or walk, NaN for those that only `bundles.hit_from` follows.
    """
    for k in range(count):
        du, dv, dz = queue[0, k], queue[1, k], queue[2, k]
        length, first, height = queue[6, k], queue[7, k], queue[10, k]
        falls = (dz < 0.0) & (clear < height) & (height + UNDERGROUND_M >= summit)
        plain = falls & (length > 0.0) & (not math.isnan(first))
        s_clear = (clear - height) * queue[5, k] if plain else 0.0
        u, v = (queue[8, k] if plain else 0.0), (queue[9, k] if plain else 0.0)
        col, in_u = entered(u, du, queue[3, k], cols - 1.0, 1.0, s_clear)
        row, in_v = entered(v, dv, queue[4, k], rows - 1.0, 1.0, s_clear)
        inside = (col >= 0.0) & (row >= 0.0) & (col < cols - 1.0) & (row < rows - 1.0)
        work[_ROW + k], work[_COL + k], work[_S + k] = row, col, max(in_u, in_v, 0.0)
        work[_ON + k] = 1.0 if plain & inside else 0.0
        work[_FOUND + k] = -1.0 if plain else math.nan
    on = 0
    for k in range(count):
        found[k] = work[_FOUND + k]
        if work[_ON + k] > 0.0:
            work[_DU + on], work[_DV + on], work[_DZ + on] = queue[0, k], queue[1, k], queue[2, k]
            work[_INVERSE_U + on], work[_INVERSE_V + on] = queue[3, k], queue[4, k]
            work[_INVERSE_ACROSS + on] = inverse_of(queue[0, k] - queue[1, k])
            work[_U + on], work[_V + on], work[_Z + on] = queue[8, k], queue[9, k], queue[10, k]
            for row in (_ROW, _COL, _S):
                work[row + on] = work[row + k]
            work[_RAY + on] = k
            on += 1
    return on


@njit(nogil=True, error_model="numpy")
def walk_on(z, work, walking, found):
    """Move the first ``walking`` rays on by one cell and write the parameters of their hits there, else -1, into
    ``found``. Return the number of rays that walk on.
    """
    for k in range(walking):
        i, j = int(work[_ROW + k]), int(work[_COL + k])
        work[_Z00 + k], work[_Z01 + k] = z[i, j], z[i, j + 1]
        work[_Z10 + k], work[_Z11 + k] = z[i + 1, j], z[i + 1, j + 1]
    _cross_cells(z.shape[0] - 1.0, z.shape[1] - 1.0, work, walking)
    on = 0
    for k in range(walking):
        found[int(work[_RAY + k])] = work[_FOUND + k]
        if work[_ON + k] > 0.0:
            for row in range(_DU, _FOUND, RAYS):
                work[row + on] = work[row + k]
            on += 1
    return on


@njit(nogil=True, error_model="numpy")
def _cross_cells(rows, cols, work, walking):
    """Find the hits of rays in their cells and put the rays into the next ones, of a raster of ``rows`` and ``cols``
    cells.
    """
    for k in range(walking):
        du, dv, dz = work[_DU + k], work[_DV + k], work[_DZ + k]
        u, v, height = work[_U + k], work[_V + k], work[_Z + k]
        row, col, s = work[_ROW + k], work[_COL + k], work[_S + k]
        right, down = (1.0 if du > 0.0 else 0.0), (1.0 if dv > 0.0 else 0.0)
        s_u = (col + right - u) * work[_INVERSE_U + k] if du != 0.0 else NEVER
        s_v = (row + down - v) * work[_INVERSE_V + k] if dv != 0.0 else NEVER
        s_out = max(min(s_u, s_v), s)
        s_diagonal = ((col - row) - (u - v)) * work[_INVERSE_ACROSS + k]
        by_u = s_u < s_v
        found = met_in_cell(
            work[_Z00 + k], work[_Z01 + k], work[_Z10 + k], work[_Z11 + k],
            row, col, u, v, height, du, dv, dz, s, s_diagonal, s_out, NEVER, by_u,
        )  # fmt: skip
        col += (2.0 * right - 1.0) if by_u else 0.0
        row += 0.0 if by_u else (2.0 * down - 1.0)
        inside = (col >= 0.0) & (row >= 0.0) & (col < cols) & (row < rows)
        work[_ROW + k], work[_COL + k], work[_S + k], work[_FOUND + k] = row, col, s_out, found
        work[_ON + k] = 1.0 if (found < 0.0) & inside else 0.0


@njit(nogil=True, error_model="numpy", inline="always")
def walking_ray(work, k):
    """What `tracing.met` wants of the k-th walking ray: its number, and (u, v, z, du, dv, dz, their inverses, s)."""
    return int(work[_RAY + k]), (
        work[_U + k], work[_V + k], work[_Z + k], work[_DU + k], work[_DV + k], work[_DZ + k],
        work[_INVERSE_U + k], work[_INVERSE_V + k], work[_S + k],
    )  # fmt: skip
