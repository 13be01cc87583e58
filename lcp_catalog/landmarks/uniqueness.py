"""Uniqueness of a patch within the area in which it may be searched for.

Correlation is centred and normalised: it does not depend on gain and offset.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from ..arrays import Array, Float32, Index
from ..kernels.matching.search import rivals
from .corners import fill_missing
from .localization import mean_lit_level
from .patches import gather_patches, halved

_FLAT = 1e-3
"""A patch whose contrast is not above this share of the whole image's has no contrast."""

_COARSE_HALF_MIN = 8
"""Smaller patches have too few nodes at half resolution: they are searched at full resolution."""


def second_peak(
    image: Float32,
    rows: Index,
    cols: Index,
    half: int,
    search: int,
    exclusion: float | None = None,
    exact: bool = False,
) -> Float32:
    """Highest correlation of each point's patch with another place whose centre lies within
    +-``search`` nodes in both axes, (n,).

    Another place is a local maximum of the correlation (3 x 3 nodes) farther than ``exclusion``
    nodes (default: ``half``) from the point. The flank of the main lobe is not counted, however
    broad it is: every node on it has a higher neighbour. A ridge without change along itself is a
    chain of equal maxima and counts. Places are whole nodes; the search square is cut at the
    image's border.

    Missing nodes hold the mean of the valid nodes around them; windows without contrast correlate
    0. The result is 1 for a patch without contrast, -1 where there is no other place in the search
    square, and NaN for a patch that the image's border cuts.

    The search is that of the matcher (`kernels.matching.search`): half resolution first, then full
    resolution from its highest peaks, never more than the exact result; ``exact``: full resolution
    everywhere. Patches of fewer than 17 nodes a side are always searched at full resolution.
    """
    filled = fill_missing(np.asarray(image, dtype=np.float32), 2 * half + 1)
    fine = np.ascontiguousarray(filled - filled.mean(dtype=np.float64), dtype=np.float32)
    centres, size = np.stack([cols, rows], axis=-1).astype(np.int64).reshape(-1, 2), 2 * half + 1
    cut = ((centres < half) | (centres >= np.array(fine.shape[::-1]) - half)).any(axis=1)
    out = np.where(cut, np.float32(np.nan), np.float32(1.0))
    patches = gather_patches(fine, centres[:, 1], centres[:, 0], half)
    contrast = patches.std(axis=(1, 2), dtype=np.float64)
    textured = np.flatnonzero(contrast > _FLAT * fine.std(dtype=np.float64))
    found = np.empty(len(textured))
    coarse = halved(fine)
    rivals(
        fine, np.ones_like(fine), coarse, np.ones_like(coarse), centres[textured] - half, size, search,
        float(half) if exclusion is None else max(float(exclusion), 0.0),
        half >= _COARSE_HALF_MIN and not exact, found,
    )  # fmt: skip
    out[textured] = found
    return out


def expected_correlation(patches: Float32, noise: float) -> Array:
    """Expected correlation of each patch (n, p, p) with a noisy image of itself, (n,):
    1 / sqrt(1 + (noise / contrast)^2).

    Contrast is the standard deviation divided by the mean lit level, ``noise`` is 1 sigma of a
    pixel divided by the same. 0 for a patch without contrast, without light or with a missing
    node. Single correlations scatter about it by about (1 - r^2) / sqrt(p^2).
    """
    level = mean_lit_level(patches)
    image = np.asarray(patches, dtype=np.float64)
    good = np.isfinite(level)
    contrast = np.where(good[:, None, None], image, 0.0).std(axis=(1, 2)) / np.where(
        good, level, 1.0
    )
    return (
        contrast / np.sqrt(contrast**2 + noise**2)
        if noise > 0.0
        else (contrast > 0.0).astype(np.float64)
    )


def effective_samples(patches: Float32) -> Array:
    """Effective number of independent samples of each patch (n, p, p) in a correlation with another
    patch of the same statistics, (n,); 1..p^2.

    Bartlett (1935): the correlation of two independent fields scatters with variance 1 / n_eff,
    n_eff = N / sum of rho(lag)^2. By Parseval that is (sum S)^2 / sum S^2 of the power spectrum S;
    a periodogram P scatters about S like an exponential variable, for which E[P^2] = 2 S^2, so
    n_eff = 2 (sum P)^2 / sum P^2 - 8, over all frequencies but zero. The 8 is measured; it is the
    contribution of few strong frequencies and of the patch's edges. With it n_eff is correct to
    15 % for patches of 17, 33 and 65 nodes a side where it is above 6, and too high by up to 2
    below. Missing nodes hold the patch's mean; the result is 1 for a patch without contrast.
    """
    image = np.asarray(patches, dtype=np.float64)
    known = np.isfinite(image)
    count = np.maximum(known.sum(axis=(1, 2), keepdims=True), 1)
    mean = np.where(known, image, 0.0).sum(axis=(1, 2), keepdims=True) / count
    centred = np.where(known, image - mean, 0.0)
    power = np.abs(np.fft.fft2(centred)) ** 2
    power[:, 0, 0] = 0.0
    total, squares = power.sum(axis=(1, 2)), (power**2).sum(axis=(1, 2))
    nodes = image.shape[1] * image.shape[2]
    return np.clip(2.0 * total**2 / np.where(squares > 0.0, squares, 1.0) - 8.0, 1.0, nodes)


def false_match_probability(
    true_correlation: Array, second_peak: Array, effective_samples: Array
) -> Array:
    """Probability that the correlation at the second peak exceeds the one at the true place, (n,).

    Fisher (1921): z = artanh(r) is nearly normal with variance 1 / (n_eff - 3); the difference of
    two has twice that, so p = Phi((z_second - z_true) / sqrt(2 / (n_eff - 3))); 1/2 for n_eff <= 3.
    The result is an order of magnitude: the two correlations share the image and are not quite
    independent, and only the highest second peak is considered.
    """
    limit = 1.0 - 1e-12
    true, second = (
        np.arctanh(np.clip(np.asarray(r, dtype=np.float64), -limit, limit))
        for r in (true_correlation, second_peak)
    )
    freedom = np.clip(np.asarray(effective_samples, dtype=np.float64) - 3.0, 0.0, None)
    score = (second - true) * np.sqrt(freedom / 2.0)
    return np.asarray(ndtr(score))
