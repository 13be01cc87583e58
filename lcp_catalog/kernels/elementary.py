"""Exponential function, logarithm and normal distribution in single precision and without branches: the
first two of numbers, of which the compiler computes many at once, the last one of vectors.
"""

import math

import numpy as np

from .cache import njit
from .vectors import magnitude, rounded, smaller, splat, two_to, where_above

_F = np.float32
_ZERO, _HALF, _ONE = _F(0.0), _F(0.5), _F(1.0)
_LOG2E, _LN2 = _F(1.0 / math.log(2.0)), _F(math.log(2.0))
_LOWEST, _BIAS, _SHIFT, _SQRT_HALF = _F(-126.0), np.int32(127), np.int32(23), np.int32(0x3F3504F3)
# 2^x on [-1/2, 1/2], Taylor: 1.2e-7
_EXP = tuple(_F(math.log(2.0) ** k / math.factorial(k)) for k in range(7))
# ln((1 + s) / (1 - s)) on |s| <= 0.172, Taylor: 1e-9
_LOG = tuple(_F(2.0 / (2 * k + 1)) for k in range(5))
# exp(y^2 / 2) Phi(-y) on 0 <= y <= 6: the polynomial whose error times exp(-y^2 / 2) is least at its
# greatest, 7e-8 (a linear programme over 2001 Chebyshev points)
_TAIL = tuple(
    _F(c)
    for c in (
        4.99999934e-01, -3.98936515e-01, 2.49916793e-01, -1.32513788e-01, 6.11548534e-02,
        -2.43138811e-02, 7.93935089e-03, -1.97460862e-03, 3.39733293e-04, -3.52070192e-05,
        1.63164254e-06,
    )
)  # fmt: skip
_TAIL_END = _F(6.0)


@njit(nogil=True, inline="always", error_model="numpy")
def _power(x):
    """e^x for x <= 0, float32, as (1 + rest) scale; 0 is 1e-38."""
    z = max(_LOWEST, x * _LOG2E)
    whole = np.int32(z - _HALF)
    f = z - _F(whole)
    p = ((_EXP[6] * f + _EXP[5]) * f + _EXP[4]) * f + _EXP[3]
    p = ((p * f + _EXP[2]) * f + _EXP[1]) * f
    return p, np.int32((whole + _BIAS) << _SHIFT).view(np.float32)


@njit(nogil=True, inline="always", error_model="numpy")
def exp_lane(x):
    """e^x for x <= 0."""
    rest, scale = _power(x)
    return scale * rest + scale


@njit(nogil=True, inline="always", error_model="numpy")
def gap_lane(x):
    """1 - e^x for x <= 0, accurate also where it is small."""
    rest, scale = _power(x)
    return (_ONE - scale) - scale * rest


@njit(nogil=True, inline="always", error_model="numpy")
def log_lane(x):
    """Natural logarithm of a positive normal float32."""
    bits = _F(x).view(np.int32)
    power = (bits - _SQRT_HALF) >> _SHIFT
    m = np.int32(bits - (power << _SHIFT)).view(np.float32)
    s = (m - _ONE) / (m + _ONE)
    q = s * s
    p = (((_LOG[4] * q + _LOG[3]) * q + _LOG[2]) * q + _LOG[1]) * q + _LOG[0]
    return p * s + _F(power) * _LN2


@njit(nogil=True, error_model="numpy", forceinline=True)
def _even(x2, c0, c2, c4):
    """c0 + c2 x^2 + c4 x^4 of a vector of squares."""
    return (splat(c4) * x2 + splat(c2)) * x2 + splat(c0)


@njit(nogil=True, error_model="numpy", forceinline=True)
def normal(x):
    """The distribution function of the normal distribution at a vector, within 3e-7; from -6 down and 6 on
    that at these places.
    """
    y = smaller(magnitude(x), splat(_TAIL_END))
    y2 = y * y
    low, high = _even(y2, _TAIL[0], _TAIL[2], _TAIL[4]), _even(y2, _TAIL[6], _TAIL[8], _TAIL[10])
    odd = _even(y2, _TAIL[1], _TAIL[3], _TAIL[5])
    last = (splat(_TAIL[9]) * y2 + splat(_TAIL[7])) * (y2 * y2 * y2)
    tail = (high * (y2 * y2 * y2) + low) + (odd + last) * y
    z = splat(-_HALF * _LOG2E) * y2
    whole = rounded(z)
    f = z - whole
    f2 = f * f
    power = _even(f2, _ONE, _EXP[2], _EXP[4]) + splat(_EXP[6]) * (f2 * f2 * f2)
    power = power + _even(f2, _EXP[1], _EXP[3], _EXP[5]) * f
    beyond = tail * two_to(whole) * power
    return where_above(x, splat(_ZERO), splat(_ONE) - beyond, beyond)
