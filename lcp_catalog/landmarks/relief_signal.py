"""How clearly relief shows in an image under a Sun and a view, and what follows for claims between the evaluated
conditions.

Relief shows by the change of brightness with slope. In Lommel-Seeliger light, mu0 / (mu0 + mu), its logarithm changes with
the slopes east and south by G = -s / mu0 + (s + v) / (mu0 + mu): s and v the horizontal parts of the directions to Sun and
camera, mu0 and mu the vertical ones (first order). G vanishes where the Sun stands behind the camera: there relief shows
least, often between the evaluated views and Suns. Against relief stand the unmapped brightness of the ground, alike
under every Sun, and slope errors of the DEM, which show like the relief itself (`landmarks.error_model`). The signal is

    r = |G| / sqrt(albedo_sigma^2 + |G|^2 (height_sigma / height_length)^2)

A point is found if its peak exceeds all others in the noise. Its height above them in sigmas grows with r, and a
probability P stands for the height d = `_NEEDED` + `_SPREAD` Phi^-1(P). Between conditions d / r is averaged, not P. In 2477
trials under Suns of 45 to 70 deg, averages of logits said 0.46 where the highest peak was the true one in 0.38, at phase
angles below 20 deg 0.24 for 0.08; heights say 0.38 and 0.10 (`benchmarks.evidence frames`).
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array

_NEEDED = 2.2
"""Height of a peak that is found in half of the cases, sigmas."""
_SPREAD = 1.1
_LEAST_HEIGHT = 0.3
"""Heights bend towards 0 below this."""
LEAST_SLOPE_SIGNAL = 0.03
"""|G| where the first order vanishes: what the higher orders and other laws show."""
LEAST_COSINE = 0.02


def log_signal(sun: Array, view: Array, albedo_sigma: float, slope_sigma: Array | float) -> Array:
    """log r (...) for directions to the Sun and the camera (..., 3), unit vectors east, north, up, and slope errors (...); 0
    without any noise.
    """
    return log_of(relief_signal(sun, view), albedo_sigma, slope_sigma)


def relief_signal(sun: Array, view: Array) -> Array:
    """|G| (...) of the same directions, at least `LEAST_SLOPE_SIGNAL`."""
    mu0, mu = (np.maximum(towards[..., 2:], LEAST_COSINE) for towards in (sun, view))
    across, seen = sun[..., :2], view[..., :2]
    slopes = np.linalg.norm((across + seen) / (mu0 + mu) - across / mu0, axis=-1)
    return np.asarray(np.maximum(slopes, LEAST_SLOPE_SIGNAL))


def log_of(slopes: Array, albedo_sigma: float, slope_sigma: Array | float) -> Array:
    """`log_signal` of `relief_signal`."""
    noise = np.hypot(albedo_sigma, slope_sigma * slopes)
    return np.log(slopes / noise) if albedo_sigma > 0.0 else np.zeros(noise.shape)


def peak_height(probability: Array) -> Array:
    """d of probabilities between 0 and 1."""
    from scipy.special import ndtri

    height = (_NEEDED + _SPREAD * ndtri(probability)) / _LEAST_HEIGHT
    return np.asarray(_LEAST_HEIGHT * np.logaddexp(0.0, height))


def probability_at(height: Array) -> Array:
    """The inverse of `peak_height`."""
    from scipy.special import ndtr

    bent = height / _LEAST_HEIGHT
    bent = bent + np.log(-np.expm1(-bent))
    return np.asarray(ndtr((_LEAST_HEIGHT * bent - _NEEDED) / _SPREAD))
