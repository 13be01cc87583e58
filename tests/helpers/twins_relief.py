"""How clearly relief shows, and the height of a peak for a probability, by mpmath and SciPy; nothing of the library."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm


def by_facets(sun: np.ndarray, view: np.ndarray) -> float:
    """|d log I / d slope| of flat ground by mpmath's derivatives, I = mu0 / (mu0 + mu) of a facet's own normal."""

    def brightness(east: float, south: float) -> mpmath.mpf:
        normal = mpmath.matrix([-east, south, 1]) / mpmath.sqrt(1 + east**2 + south**2)
        mu0, mu = (mpmath.fdot(normal, mpmath.matrix(v.tolist())) for v in (sun, view))
        return mpmath.log(mu0 / (mu0 + mu))

    parts = [mpmath.diff(brightness, (0, 0), order) for order in ((1, 0), (0, 1))]
    return float(mpmath.hypot(*parts))


def height(probability: Any) -> Any:
    """How far a peak stands above all others, sigmas: 2.2 + 1.1 z, bent towards 0 below 0.3."""
    return 0.3 * np.log1p(np.exp((2.2 + 1.1 * norm.ppf(probability)) / 0.3))


def chance(of_height: Any) -> Any:
    """The probability of a height."""
    return np.vectorize(lambda h: brentq(lambda p: height(p) - h, 1e-4, 1.0 - 1e-7, xtol=1e-12))(of_height)  # fmt: skip
