"""Pixels on the limb of the sphere, and the share of each that shows the sphere."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..cameras.frame_camera import Camera
from ..constants import MOON_RADIUS_M
from ..geometry.sphere_intersection import limb_angle, nadir_angles
from ..kernels import sphere_rays as kernel

COVERAGE_ERROR = 2e-4
"""Error of a limb pixel's coverage, as a share of the pixel; measured against brute force."""


_CELLS_LEAST = 4


_CELLS_MOST = 64


_CORNERS_AT_ONCE = 1 << 20


def coverage(
    camera: Camera, columns: ArrayLike, rows: ArrayLike, radius_m: float = MOON_RADIUS_M
) -> tuple[Array, Array]:
    """Share (n,) of the pixels' area that shows the sphere, and the middle (n, 2) of that part, column
    and row in the image; NaN if the share is 0.

    Each pixel is divided into cells in which the limb is nearly straight; their number depends on the
    curvature of the limb in the image. ValueError for a camera inside the sphere.
    """
    pixels = np.stack(np.broadcast_arrays(columns, rows), axis=-1).astype(np.float64).reshape(-1, 2)
    position, limb = camera.position_mcmf_m, limb_angle(camera.position_mcmf_m, radius_m)
    cells = _cells(camera.focal_length_px * math.tan(limb))
    steps = np.arange(cells + 1) / cells - 0.5
    off = np.stack(np.meshgrid(steps, steps), axis=-1)
    shares, middles = np.empty(len(pixels)), np.empty((len(pixels), 2))
    at_once = max(1, _CORNERS_AT_ONCE // off[..., 0].size)
    for first in range(0, len(pixels), at_once):
        part = slice(first, first + at_once)
        directions = camera.rays(pixels[part, None, None] + off)
        kernel.covered(limb - nadir_angles(position, directions), shares[part], middles[part])
    middles = np.where(shares[:, None] > 0.0, pixels + middles, np.nan)
    return shares, middles


def _cells(curvature_px: float) -> int:
    """Cells per side of a pixel, for a limb with a radius of curvature r in pixels of the image. The
    area between the limb and a chord across a cell of 1 / k pixels is 1 / (12 r k^3) pixels^2, and k
    chords cross a pixel.
    """
    wanted = math.sqrt(1.0 / (6.0 * max(curvature_px, 1e-3) * COVERAGE_ERROR))
    return min(max(math.ceil(wanted), _CELLS_LEAST), _CELLS_MOST)


def pixel_angle(camera: Camera) -> float:
    """Greatest angle between opposite corners of a pixel, radians, over the image."""
    width, height = camera.image_size_px
    column, row = (np.unique(np.linspace(0, n - 1, 33).round())[None, :] for n in (width, height))
    corners = camera.rays(np.stack(np.broadcast_arrays(*_corner_grid(column[0], row[0])), axis=-1))
    first = np.linalg.norm(corners[:, :, 1, 1] - corners[:, :, 0, 0], axis=-1)
    second = np.linalg.norm(corners[:, :, 1, 0] - corners[:, :, 0, 1], axis=-1)
    return 2.0 * math.asin(min(1.0, 0.5 * float(np.maximum(first, second).max())))


def _corner_grid(columns: Array, rows: Array) -> tuple[Array, Array]:
    """Columns and rows of the four corners of pixels, (rows, columns, 2, 2)."""
    half = np.array([-0.5, 0.5])
    return (
        columns[None, :, None, None] + half[None, None, None, :],
        rows[:, None, None, None] + half[None, None, :, None],
    )


def limb_pixels(camera: Camera, directions: Array, pixel_rad: float) -> NDArray[np.bool_]:
    """True for pixels that the limb may cross, by the directions (..., 3) of their centres;
    ``pixel_rad``: `pixel_angle`.
    """
    off = nadir_angles(camera.position_mcmf_m, directions) - limb_angle(camera.position_mcmf_m)
    return np.asarray(np.abs(off) <= pixel_rad)
