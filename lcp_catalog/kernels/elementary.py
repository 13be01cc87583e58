"""Exponential function, logarithm and normal distribution in single precision and without branches, so
that the compiler computes many numbers at once.
"""

import math

import numpy as np
from numba import njit

_F = np.float32
_ZERO, _HALF, _ONE = _F(0.0), _F(0.5), _F(1.0)
_LOG2E, _LN2 = _F(1.0 / math.log(2.0)), _F(math.log(2.0))
_LOWEST, _BIAS, _SHIFT, _SQRT_HALF = _F(-126.0), np.int32(127), np.int32(23), np.int32(0x3F3504F3)
# 2^x on [-1/2, 1/2], Taylor: 1.2e-7
_EXP = tuple(_F(math.log(2.0) ** k / math.factorial(k)) for k in range(7))
# ln((1 + s) / (1 - s)) on |s| <= 0.172, Taylor: 1e-9
_LOG = tuple(_F(2.0 / (2 * k + 1)) for k in range(5))
# erfc(y) = (polynomial of t without constant) exp(-y^2), t = 1 / (1 + p y), y >= 0: Abramowitz and
# Stegun, 7.1.26, 1.5e-7
_SLOWER = _F(0.3275911 * math.sqrt(0.5))
_ERFC = tuple(
    _F(0.5 * c) for c in (0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429)
)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _power(x):
    """e^x for x <= 0, float32, as (1 + rest) scale; 0 is 1e-38."""
    z = max(_LOWEST, x * _LOG2E)
    whole = np.int32(z - _HALF)
    f = z - _F(whole)
    p = ((_EXP[6] * f + _EXP[5]) * f + _EXP[4]) * f + _EXP[3]
    p = ((p * f + _EXP[2]) * f + _EXP[1]) * f
    return p, np.int32((whole + _BIAS) << _SHIFT).view(np.float32)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def exp_lane(x):
    """e^x for x <= 0."""
    rest, scale = _power(x)
    return scale * rest + scale


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def gap_lane(x):
    """1 - e^x for x <= 0, accurate also where it is small."""
    rest, scale = _power(x)
    return (_ONE - scale) - scale * rest


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def log_lane(x):
    """Natural logarithm of a positive normal float32."""
    bits = _F(x).view(np.int32)
    power = (bits - _SQRT_HALF) >> _SHIFT
    m = np.int32(bits - (power << _SHIFT)).view(np.float32)
    s = (m - _ONE) / (m + _ONE)
    q = s * s
    p = (((_LOG[4] * q + _LOG[3]) * q + _LOG[2]) * q + _LOG[1]) * q + _LOG[0]
    return p * s + _F(power) * _LN2


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def normal_lane(x):
    """The distribution function of the normal distribution at a float32, within 3e-7."""
    y = abs(x)
    t = _ONE / (_ONE + _SLOWER * y)
    p = ((((_ERFC[4] * t + _ERFC[3]) * t + _ERFC[2]) * t + _ERFC[1]) * t + _ERFC[0]) * t
    beyond = p * exp_lane(-_HALF * y * y)
    return _ONE - beyond if x > _ZERO else beyond
