"""Centred, normalised correlation of arrays of samples (Pearson's coefficient), weighted.

The samples of each pair of arrays are centred by their own weighted means before anything is
multiplied: sums of squares of uncentred samples lose the digits of low-contrast terrain, whose
contrast is a thousandth of its brightness. For the correlation of a template with every window of
an image see `kernels.matching.correlation`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array

_ROUNDING = 1e-14
"""A variance up to this share of the squared mean is rounding: the samples count as constant."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Weighted second moments of n pairs of sample arrays a and b about their means, (n,) each."""

    weight: Array
    """Sum of the weights."""
    aa: Array
    bb: Array
    ab: Array

    @property
    def correlation(self) -> Array:
        """-1..1; 0 where a or b is constant or has no weight."""
        product = self.aa * self.bb
        with np.errstate(invalid="ignore", divide="ignore"):
            found = np.where(product > 0.0, self.ab / np.sqrt(product), 0.0)
        return np.clip(found, -1.0, 1.0)

    @property
    def deviation_b(self) -> Array:
        """Standard deviation of b; 0 without weight."""
        return np.asarray(np.sqrt(self.bb / np.where(self.weight > 0.0, self.weight, 1.0)))


def moments(a: ArrayLike, b: ArrayLike, weight: ArrayLike | None = None) -> Moments:
    """Moments of sample arrays (n, m), or of one pair (m,), along the last axis, in float64.

    ``weight``: of each sample, at least 0 (default: 1); samples must be finite where it is 0, too.
    """
    samples = [np.asarray(x, dtype=np.float64) for x in (a, b)]
    w = None if weight is None else np.asarray(weight, dtype=np.float64)

    def summed(*factors: Array) -> Array:
        product = factors[0] if w is None else w * factors[0]
        for factor in factors[1:]:
            product = product * factor
        return np.asarray(np.sum(product, axis=-1))

    count, shape = samples[0].shape[-1], samples[0].shape[:-1]
    total = np.full(shape, float(count)) if w is None else np.asarray(w.sum(axis=-1))
    means = [summed(x) / np.where(total > 0.0, total, 1.0) for x in samples]
    x, y = (s - mean[..., None] for s, mean in zip(samples, means, strict=True))
    powers = (summed(z, z) for z in (x, y))
    aa, bb = (
        np.where(power > _ROUNDING * total * mean**2, power, 0.0)
        for power, mean in zip(powers, means, strict=True)
    )
    return Moments(total, aa, bb, summed(x, y))
