"""How well a patch can be placed in a noisy image: the covariance of its registration.

Matching a known patch I (rendered, without noise) with an image I(x - d) + e, where e is white
noise, by least squares or by correlation, has to first order the covariance  noise^2 M^-1,  M = sum
over the patch of g g^T,  g = grad(I) / mean lit level: the Cramer-Rao bound of the shift (Foerstner
and Guelch 1987; the M of Harris and Stephens 1988). Correlation is blind to gain and offset; what a
shift has in common with them is useless, so M is taken after the parts of g along the constant and
along I are projected out (Schur complement). A patch that is one even slope of brightness has no
place at all, although its plain M is large along the slope.

Limits: first order, so for sigmas well below the width of the features; noise white, one figure per
pixel. Central differences damp detail near one pixel (an ideal step counts half), so very sharp
patches do better than stated; two noisy images are worse by sqrt(2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32

HARRIS_K = 0.04
_CHUNK = 256
_SMALLEST_PX = 7
"""Pixels a side below which a decimated patch is not tried."""


@dataclass(frozen=True)
class Localization:
    """Per patch, shapes (n,): 1-sigma of the place along both axes, and the angle of the major
    axis.

    The angle is in radians from the direction of columns (east) towards the direction of rows
    (south), -pi/2..pi/2: along it the patch is worst placed. Infinite sigmas (angle NaN) for a
    patch that cannot be placed. ``harris`` is det M - 0.04 trace(M)^2 of the plain M, divided by
    the number of nodes squared; NaN where a node is missing.
    """

    sigma_major_px: Float32
    sigma_minor_px: Float32
    axis_angle_rad: Float32
    harris: Float32

    def localizable(self, max_sigma_px: float) -> NDArray[np.bool_]:
        """Whether the worse axis is good enough."""
        return np.asarray(self.sigma_major_px <= max_sigma_px)


def localization(patches: Float32, noise: float) -> Localization:
    """Registration accuracy of patches (n, p, p); ``noise`` is 1 sigma of a pixel over the patch's
    mean lit (> 0) signal.

    A patch with a NaN, without light, or flat along any direction gets infinite sigmas.
    """
    chunks = range(0, len(patches), _CHUNK)
    plain, free = (
        np.concatenate(t)
        for t in zip(
            np.zeros((2, 0, 3)), *(_tensors(patches[i : i + _CHUNK]) for i in chunks), strict=True
        )
    )
    harris = (plain[:, 0] * plain[:, 1] - plain[:, 2] ** 2) - HARRIS_K * (
        plain[:, 0] + plain[:, 1]
    ) ** 2
    major, minor, angle = _ellipse(free, plain, noise)
    nodes = patches.shape[1] * patches.shape[2]
    parts = (major, minor, angle, harris / nodes**2)
    return Localization(*(p.astype(np.float32) for p in parts))


def lit_share(patches: Float32) -> Array:
    """Share of each patch's nodes that are lit (> 0), (n,); a missing node is not lit."""
    return np.asarray((np.nan_to_num(patches) > 0.0).mean(axis=(1, 2)))


def _tensors(patches: Float32) -> tuple[Array, Array]:
    """(n, 3) xx, yy, xy of the plain structure tensor and of the one with gain and offset free; NaN
    for bad patches.
    """
    image = _normalised(patches)
    gy, gx = np.gradient(image, axis=(1, 2))
    n = len(image)
    nodes = image.shape[1] * image.shape[2]
    g = np.stack([gx, gy], axis=1).reshape(n, 2, nodes)
    flat = image.reshape(n, nodes)
    flat = flat - flat.mean(axis=1, keepdims=True)
    power = np.einsum("ni,ni->n", flat, flat)
    plain = np.einsum("nai,nbi->nab", g, g)
    mean = g.mean(axis=2)
    along = np.einsum("nai,ni->na", g, flat) / np.sqrt(np.where(power > 0.0, power, 1.0))[:, None]
    free = (
        plain - nodes * mean[:, :, None] * mean[:, None, :] - along[:, :, None] * along[:, None, :]
    )
    return _three(plain), _three(free)


def _three(tensor: Array) -> Array:
    return np.stack([tensor[:, 0, 0], tensor[:, 1, 1], tensor[:, 0, 1]], axis=1)


def mean_lit_level(patches: Float32) -> Array:
    """Mean of each patch's lit (> 0) nodes, (n,); NaN where a node is missing or nothing is lit."""
    image = np.asarray(patches, dtype=np.float64)
    lit = np.nan_to_num(image) > 0.0
    count = lit.sum(axis=(1, 2))
    level = np.where(lit, image, 0.0).sum(axis=(1, 2)) / np.maximum(count, 1)
    return np.where((count > 0) & np.isfinite(image).all(axis=(1, 2)), level, np.nan)


def _normalised(patches: Float32) -> Array:
    """Patches over their mean lit level, float64; all NaN where a node is missing or nothing is
    lit.
    """
    level = mean_lit_level(patches)
    good = np.isfinite(level)[:, None, None]
    return np.where(good, np.asarray(patches, dtype=np.float64), np.nan) / level[:, None, None]


def _ellipse(free: Array, plain: Array, noise: float) -> tuple[Array, Array, Array]:
    """Sigmas along the major and minor axis, and the major axis' angle, of noise^2 inv(free)."""
    xx, yy, xy = free.T
    middle, radius = (xx + yy) / 2.0, np.hypot((xx - yy) / 2.0, xy)
    strong = middle + radius
    with np.errstate(invalid="ignore"):
        weak = np.where(
            strong > 0.0, (xx * yy - xy * xy) / np.where(strong > 0.0, strong, 1.0), 0.0
        )
        floor = 1e-9 * (
            plain[:, 0] + plain[:, 1]
        )  # rounding of float32 input: below it there is nothing
        good = (weak > floor) & np.isfinite(weak)
    sigma = [
        np.where(good, noise / np.sqrt(np.where(good, m, 1.0)), np.inf) for m in (weak, strong)
    ]
    angle = (
        0.5 * np.arctan2(2.0 * xy, xx - yy) + np.pi / 2.0
    )  # strong axis of M is the minor axis of the ellipse
    angle = (angle + np.pi / 2.0) % np.pi - np.pi / 2.0
    return sigma[0], sigma[1], np.where(good, angle, np.nan)


def coarsest_scale(
    patches: Float32,
    noise: float,
    scales: Sequence[float],
    max_sigma_px: float,
    min_lit: float = 0.0,
) -> Float32:
    """The coarsest of ``scales`` at which each patch is still placed to ``max_sigma_px`` of the
    *coarse* pixel, (n,).

    A scale s >= 1 stands for images whose pixels are s times as wide; each is the mean over its
    area, the noise per pixel stays, and at least ``min_lit`` of the pixels must be lit. Scales are
    climbed from the finest and the climb ends at the first that fails, so that everything between
    works too; NaN where the finest fails. Fewer than 7 coarse pixels a side fail.
    """
    best = np.full(len(patches), np.nan, dtype=np.float32)
    alive = np.arange(len(patches))
    for scale in sorted(scales):
        small = decimate(patches[alive], scale)
        if small.shape[1] < _SMALLEST_PX or not len(alive):
            break
        fine = localization(small, noise).localizable(max_sigma_px) & (lit_share(small) >= min_lit)
        alive = alive[fine]
        best[alive] = scale
    return best


def decimate(patches: Float32, scale: float) -> Float32:
    """Patches (n, p, p) as seen with pixels ``scale`` >= 1 times as wide: area means, (n, m, m), m
    = floor(p / scale).

    A node is a cell of one brightness. The coarse pixels lie symmetrically about the patch's
    centre; a strip of less than one of them is lost at the edges.
    """
    size = patches.shape[1]
    count = int(size / scale + 1e-9)
    edges = (size - count * scale) / 2.0 + scale * np.arange(count + 1)
    node = np.arange(size)
    low, high = np.maximum(edges[:-1, None], node), np.minimum(edges[1:, None], node + 1.0)
    weights = np.clip(high - low, 0.0, None) / scale
    small = weights @ patches.astype(np.float64) @ weights.T
    return np.asarray(small, dtype=np.float32)
