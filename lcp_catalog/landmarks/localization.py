"""Covariance of the registration of a patch in a noisy image.

Let a known patch I (rendered, without noise) be matched with an image I(x - d) + e, e white noise,
by least squares or by correlation. To first order the covariance of the shift d is noise^2 M^-1,
with M = sum over the patch of g g^T and g = grad(I) / mean lit level: the Cramer-Rao bound
(Foerstner and Guelch 1987; M is that of Harris and Stephens 1988). Correlation does not depend on
gain and offset. The parts of g along the constant and along I are therefore projected out of M
(Schur complement). A patch of one uniform brightness gradient cannot be located, although its plain
M is large along the gradient.

Limits: first order, so for sigmas well below the width of the features; white noise, the same at
every pixel. Central differences damp detail near one pixel (an ideal step counts half), so very
sharp patches are located better than stated. With noise in both images sigmas are larger by
sqrt(2).
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
"""Fewest pixels a side of a decimated patch."""


@dataclass(frozen=True)
class Localization:
    """Error ellipse of each patch's position, shapes (n,): 1-sigma along both axes, and the angle
    of the major axis.

    The angle is in radians from the direction of columns (east) towards the direction of rows
    (south), -pi/2..pi/2. Sigmas are infinite and the angle NaN for a patch that cannot be located.
    ``harris`` is det M - 0.04 trace(M)^2 of the plain M, divided by the squared number of nodes;
    NaN where a node is missing.
    """

    sigma_major_px: Float32
    sigma_minor_px: Float32
    axis_angle_rad: Float32
    harris: Float32

    def localizable(self, max_sigma_px: float) -> NDArray[np.bool_]:
        """True where the larger sigma is at most ``max_sigma_px``, (n,)."""
        return np.asarray(self.sigma_major_px <= max_sigma_px)


def localization(patches: Float32, noise: float) -> Localization:
    """Registration accuracy of patches (n, p, p); ``noise`` is 1 sigma of a pixel relative to the
    patch's mean lit (> 0) signal.

    Sigmas are infinite for a patch that has a NaN, is not lit, or is constant along any direction.
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
    """Share of each patch's nodes that are lit (> 0), (n,); missing nodes are not lit."""
    return np.asarray((np.nan_to_num(patches) > 0.0).mean(axis=(1, 2)))


def _tensors(patches: Float32) -> tuple[Array, Array]:
    """xx, yy, xy (n, 3) of the plain structure tensor, and of the one with free gain and offset;
    NaN for a patch with a missing node or without light.
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
    """Mean of each patch's lit (> 0) nodes, (n,); NaN where a node is missing or no node is lit."""
    image = np.asarray(patches, dtype=np.float64)
    lit = np.nan_to_num(image) > 0.0
    count = lit.sum(axis=(1, 2))
    level = np.where(lit, image, 0.0).sum(axis=(1, 2)) / np.maximum(count, 1)
    return np.where((count > 0) & np.isfinite(image).all(axis=(1, 2)), level, np.nan)


def _normalised(patches: Float32) -> Array:
    """Patches divided by their mean lit level, float64; all NaN where a node is missing or no node
    is lit.
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
        floor = 1e-9 * (plain[:, 0] + plain[:, 1])  # rounding of the float32 input
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
    """The coarsest of ``scales`` at which each patch is still located to ``max_sigma_px`` *coarse*
    pixels, (n,).

    At scale s >= 1 the pixels are s times as wide; each is the mean over its area, the noise per
    pixel is the same, and at least ``min_lit`` of the pixels must be lit. Scales are tested from
    the finest up to the first that fails, so that all finer ones are valid, too. NaN where the
    finest fails. A scale with fewer than 7 coarse pixels a side fails.
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
    """Patches (n, p, p) with pixels ``scale`` >= 1 times as wide: area means, (n, m, m), m =
    floor(p / scale).

    Each node is a cell of constant brightness. The coarse pixels lie symmetrically about the
    patch's centre; a strip of less than one of them is left out at the edges.
    """
    size = patches.shape[1]
    count = int(size / scale + 1e-9)
    edges = (size - count * scale) / 2.0 + scale * np.arange(count + 1)
    node = np.arange(size)
    low, high = np.maximum(edges[:-1, None], node), np.minimum(edges[1:, None], node + 1.0)
    weights = np.clip(high - low, 0.0, None) / scale
    small = weights @ patches.astype(np.float64) @ weights.T
    return np.asarray(small, dtype=np.float32)
