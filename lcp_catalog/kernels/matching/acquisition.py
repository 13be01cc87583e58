"""Probability that a normal variable is the highest of several and above a threshold."""

import math

from numba import njit

_STEPS = 61
_SIGMAS = 5.0
_CLEAR = 6.0
"""Sigmas beyond which a value counts as certainly above or below another."""


@njit(cache=True, nogil=True, error_model="numpy")
def acquisition(mean, sigma, others, spread, least, out):
    """For n normal variables with ``mean`` and ``sigma`` (n,) write into out (n, 3): the probability
    that the variable is above ``least`` and above all its independent rivals; that it is above
    ``least``; that it is above all its rivals.

    others, spread (n, k): means and sigmas of the rivals, which are normal, too; NaN where there are
    fewer. The integral over the variable is a sum of 61 steps within 5 sigma.
    """
    step = 2.0 * _SIGMAS / (_STEPS - 1)
    for i in range(mean.size):
        weight = found = above = first = 0.0
        for k in range(_STEPS):
            z = -_SIGMAS + k * step
            x = mean[i] + z * sigma[i]
            density = math.exp(-0.5 * z * z)
            passed = min(max((x - least) / (step * sigma[i]) + 0.5, 0.0), 1.0)
            highest = 1.0
            for j in range(others.shape[1]):
                if not others[i, j] > -2.0:
                    continue
                gap = (x - others[i, j]) / spread[i, j]
                if gap < _CLEAR:
                    highest *= 0.5 * math.erfc(-gap * math.sqrt(0.5))
                if highest < 1e-12:
                    break
            weight += density
            found += density * passed * highest
            above += density * passed
            first += density * highest
        out[i, 0], out[i, 1], out[i, 2] = found / weight, above / weight, first / weight
