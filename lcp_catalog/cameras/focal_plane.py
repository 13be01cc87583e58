"""Directions in camera axes to pixels through a lens, and back.

Camera axes are those of OpenCV: X right along rows, Y down along columns, Z ahead. A lens works in
coordinates of the focal plane divided by the focal length: X / Z and Y / Z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from .distortion import Lens, Matrix, NoLens, OnPlane

INVERSE_TOLERANCE_PX = 1e-6
"""Largest error of a lens's inverse: a pixel's direction projects to the pixel within this
distance.
"""

_SAME = 1e-14


@dataclass(frozen=True)
class FocalPlane:
    """Projection of directions to the image. ``lens`` is in units of the focal length."""

    focal_length_px: float
    principal_point_px: tuple[float, float]
    lens: Lens

    def part(self, column: int, row: int, count: int = 1) -> FocalPlane:
        """The plane with its pixels counted from another column and row, each divided into
        ``count`` x ``count`` equal parts.
        """
        cx, cy = self.principal_point_px
        middle = (cx - column + 0.5) * count - 0.5, (cy - row + 0.5) * count - 0.5
        return FocalPlane(self.focal_length_px * count, middle, self.lens)

    def pixels(self, directions: Array) -> Array:
        """Pixels (..., 2), column and row, of directions (..., 3) of any length; NaN for directions
        that are not ahead, or beyond the fold of the lens.
        """
        x, y, depth = np.moveaxis(directions, -1, 0)
        seen = depth > 0
        safe = np.where(seen, depth, 1.0)
        x, y = x / safe, y / safe
        seen &= self.lens.within(x, y)
        u, v = self.lens.distort(np.where(seen, x, 0.0), np.where(seen, y, 0.0))
        cx, cy = self.principal_point_px
        pixels = np.stack([cx + self.focal_length_px * u, cy + self.focal_length_px * v], axis=-1)
        return np.where(seen[..., None], pixels, np.nan)

    def directions(self, pixels: Array) -> Array:
        """Unit directions (..., 3) of pixels (..., 2); NaN where the lens has no inverse."""
        column, row = np.moveaxis(pixels, -1, 0)
        cx, cy = self.principal_point_px
        u, v = (column - cx) / self.focal_length_px, (row - cy) / self.focal_length_px
        x, y = self.lens.undistort(u, v)
        with np.errstate(all="ignore"):
            looking = np.stack([x, y, np.ones_like(x)], axis=-1)
            looking /= np.sqrt(1.0 + x * x + y * y)[..., None]
            if isinstance(self.lens, NoLens):
                return looking
            back = self.lens.distort(x, y)
            off_px = np.hypot(back[0] - u, back[1] - v) * self.focal_length_px
            solved = (off_px < INVERSE_TOLERANCE_PX) & self.lens.within(x, y)
        return np.where(solved[..., None], looking, np.nan)


def plane_of(
    lens: Lens,
    focal_length: float,
    pixels_per_unit: Array,
    origin_px: tuple[float, float],
    *,
    flipped: bool = False,
) -> tuple[FocalPlane, Array]:
    """The focal plane of a camera whose lens has other units and whose axes x, y, z are different,
    and the rotation (3, 3) about z from those axes to camera axes.

    An ideal point of that lens's plane is ``focal_length`` times (x / z, y / z), or (x / z, -y / z)
    if ``flipped``. A distorted point (u, v) falls on the pixel ``origin_px`` + ``pixels_per_unit``
    (u, v); rows of the matrix: column, row. The rotation brings X as close as possible to the
    direction of columns; in a mirrored image Y points up instead of down.
    """
    matrix = np.asarray(pixels_per_unit, dtype=np.float64)
    flip = np.diag([1.0, -1.0 if flipped else 1.0])
    left, sizes, right = np.linalg.svd(matrix @ flip)
    turn = left @ right  # the polar factor: matrix = (symmetric) @ turn
    if np.linalg.det(turn) < 0:
        turn = np.diag([1.0, -1.0]) @ turn
    turn = np.where(np.abs(turn) < 1e-15, 0.0, turn)
    density = float(np.sqrt(sizes[0] * sizes[1]))
    into, out = focal_length * flip @ turn.T, matrix / (density * focal_length)
    axes = np.eye(3)
    axes[:2, :2] = turn
    through = out @ into if isinstance(lens, NoLens) else np.concatenate([into, out])
    if np.abs(through - np.tile(np.eye(2), (len(through) // 2, 1))).max() > _SAME:
        lens = OnPlane(_square(into), lens, _square(out))
    return FocalPlane(density * focal_length, origin_px, lens), axes


def _square(matrix: Array) -> Matrix:
    (a, b), (c, d) = matrix.tolist()
    return (a, b), (c, d)
