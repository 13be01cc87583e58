"""Occlusion within patches of the surface, each traced without the terrain around it."""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .max_pyramid import extremes
from .surface import node_exists
from .tracing import NEVER, blocked


@njit(nogil=True, error_model="numpy", inline="always")
def _without_levels(rows, cols):
    """A pyramid without levels: a patch is small, so every ray walks its cells one by one."""
    return (
        np.empty(1, np.float32),
        np.zeros(1, np.int64),
        np.full(1, cols - 1, np.int64),
        np.full(1, rows - 1, np.int64),
    )


@njit(nogil=True, error_model="numpy")
def _trace_part(part, du, dv, dz, row, col, out):
    """Write the occlusion of the nodes of one patch into out, from (row, col) on."""
    rows, cols = part.shape
    _, summit, holes = extremes(part)
    pyramid = _without_levels(rows, cols)
    for i in range(rows):
        for j in range(cols):
            oz = np.float64(part[i, j])
            if math.isnan(oz):
                continue
            if du == 0.0 and dv == 0.0:
                out[row + i, col + j] = dz < 0.0 and node_exists(part, i, j)
            else:
                out[row + i, col + j] = blocked(
                    part, holes, pyramid, float(summit), float(j), float(i),
                    oz, du, dv, dz, NEVER, 0,
                )  # fmt: skip


@njit(nogil=True, error_model="numpy", parallel=True)
def occluded_alone(z, rows, cols, half, du, dv, dz, out):
    """Set out (n, size, size), initially False, to True for nodes of each patch where the patch
    itself rises above their ray.
    """
    done = 0
    for n in prange(rows.size):
        done += 1
        row0, row1 = max(rows[n] - half, 0), min(rows[n] + half + 1, z.shape[0])
        col0, col1 = max(cols[n] - half, 0), min(cols[n] + half + 1, z.shape[1])
        if row1 - row0 > 1 and col1 - col0 > 1:
            part = z[row0:row1, col0:col1].copy()
            _trace_part(part, du, dv, dz, row0 - rows[n] + half, col0 - cols[n] + half, out[n])
    all_done(done, rows.size)


@njit(nogil=True, error_model="numpy")
def _shadowed_from_outside(z, planes, dark, corner, at, size, rays, suns, cast):
    """One patch of `shadowed_from_outside`: its first node is at (row, column) ``at`` of the window,
    whose own first node is at ``corner`` of the raster.
    """
    rows, cols = dark.shape[1:]
    row0, row1 = max(at[0], 0), min(at[0] + size, rows)
    col0, col1 = max(at[1], 0), min(at[1] + size, cols)
    if row1 - row0 < 2 or col1 - col0 < 2:
        return
    part = z[corner[0] + row0 : corner[0] + row1, corner[1] + col0 : corner[1] + col1].copy()
    _, summit, holes = extremes(part)
    pyramid = _without_levels(row1 - row0, col1 - col0)
    for k in range(len(rays)):
        du, dv, dz = rays[k, 0], rays[k, 1], rays[k, 2]
        east, north, up = suns[k, 0], suns[k, 1], suns[k, 2]
        for i in range(row0, row1):
            for j in range(col0, col1):
                x, y, u = planes[0, i, j], planes[1, i, j], planes[2, i, j]
                if dark[k, i, j] and x * east + y * north + u * up > 0.0:
                    oz = np.float64(part[i - row0, j - col0])
                    cast[k, i - at[0], j - at[1]] = not blocked(
                        part, holes, pyramid, float(summit), float(j - col0), float(i - row0),
                        oz, du, dv, dz, NEVER, 0,
                    )  # fmt: skip


@njit(nogil=True, error_model="numpy", parallel=True)
def shadowed_from_outside(z, planes, dark, corner, rows, cols, half, rays, suns, cast):
    """Set cast (k, n, size, size), initially False, to True for the nodes of each patch that are
    dark in direction k and face it, and that the patch itself does not occlude.

    dark: (k, rows, cols) of a window of the raster whose first node is at ``corner``; planes: the
    components of its normals; rows, cols: middles of the patches in the window; rays (k, 3): the
    directions in cells (nothing may be dark in a vertical one); suns (k, 3): in ENU.
    """
    size = 2 * half + 1
    done = 0
    for n in prange(rows.size):
        done += 1
        _shadowed_from_outside(
            z, planes, dark, corner, (rows[n] - half, cols[n] - half), size, rays, suns, cast[:, n]
        )
    all_done(done, rows.size)
