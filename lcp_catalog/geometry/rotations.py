"""Rotations by a vector (axis times angle) and by unit quaternions (w, x, y, z), which turn a
vector v to q v q*.

`scipy.spatial.transform` gives the same to 1e-14 (the tests compare them), but its products of
arrays of rotations were 20 to 200 times slower than `product`, which a line scanner needs at every
iteration, and its Slerp does not extrapolate.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array


def by_vector(turn_rad: ArrayLike) -> Array:
    """Rotation matrix exp([turn]x), (3, 3): turns vectors about ``turn`` (3,) by its length in
    radians, counter-clockwise seen from its tip (Rodrigues). Exact for any length; the two factors
    keep their digits for small angles.
    """
    x, y, z = np.asarray(turn_rad, dtype=np.float64)
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    once = np.sinc(angle / np.pi)  # sin(a) / a
    twice = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2  # (1 - cos(a)) / a^2
    return np.asarray(np.eye(3) + once * cross + twice * cross @ cross)


def quaternion_of(matrix: Array) -> Array:
    """Unit quaternion (4,) of a rotation matrix (3, 3), the nearest one if the matrix has rounding
    errors (Bar-Itzhack 2000).
    """
    m = np.asarray(matrix, dtype=np.float64)
    axis = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    gram = np.empty((4, 4))
    gram[0, 0], gram[0, 1:], gram[1:, 0] = np.trace(m), axis, axis
    gram[1:, 1:] = m + m.T - np.trace(m) * np.eye(3)
    return np.asarray(np.linalg.eigh(gram)[1][:, -1])


def product(later: Array, first: Array) -> Array:
    """Quaternions (..., 4) of the rotation ``first`` followed by ``later``."""
    a, b, c, d = np.moveaxis(later, -1, 0)
    w, x, y, z = np.moveaxis(first, -1, 0)
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def inverse(quaternions: Array) -> Array:
    """Quaternions (..., 4) of the inverse rotations."""
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, -1.0]))


def turned(quaternions: Array, vectors: Array) -> Array:
    """Vectors (..., 3) turned by quaternions (..., 4)."""
    w, a, b, c = np.moveaxis(quaternions, -1, 0)
    x, y, z = np.moveaxis(vectors, -1, 0)
    p, q, r = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return np.stack(
        [x + w * p + b * r - c * q, y + w * q + c * p - a * r, z + w * r + a * q - b * p], axis=-1
    )


def same_sides(quaternions: Array) -> Array:
    """Quaternions (n, 4) of unit length with signs such that neighbours have a positive dot
    product: q and -q are one rotation, and the shorter way between two rotations is that between
    the nearer signs.
    """
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    dots = np.einsum("ij,ij->i", unit[1:], unit[:-1])
    signs = np.cumprod(np.concatenate([[1.0], np.where(dots < 0.0, -1.0, 1.0)]))
    return np.asarray(unit * signs[:, None])


def apart_rad(first: Array, second: Array) -> Array:
    """Angles (n,) between unit quaternions (n, 4) as vectors, half of those between the rotations;
    accurate for small angles too.
    """
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(2.0 * np.arctan2(chord, np.linalg.norm(first + second, axis=-1)))


def between(first: Array, second: Array, angle_rad: Array, share: Array) -> Array:
    """Rotations (n, 4) at ``share`` (n,) of the way from one to the other at a constant rate
    (slerp, Shoemake 1985); a share outside 0..1 extrapolates at that rate. Both are (n, 4), unit,
    with the signs of `same_sides`; ``angle_rad`` (n,) is `apart_rad` of both.
    """
    turns = angle_rad / np.pi
    whole = np.sinc(turns)
    a = (1.0 - share) * np.sinc((1.0 - share) * turns) / whole
    b = share * np.sinc(share * turns) / whole
    return np.asarray(a[:, None] * first + b[:, None] * second)
