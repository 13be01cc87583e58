"""Published phase functions of the Moon for the models of Lommel-Seeliger and lunar-Lambert, as
numbers of these models.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

from ..errors import ConfigError
from ..kernels.photometry import laws as kernel

_even_sphere, _mixture, _two_lobes = (
    cast(Callable[..., float], compiled.py_func)
    for compiled in (kernel.even_sphere, kernel.mixture, kernel.two_lobes)
)
"""The kernels' functions, not compiled."""


@dataclass(frozen=True)
class SurfacePhase:
    """Yokota et al. (2011): reflectance ``r30`` at incidence and phase 30 deg, emission 0, and the
    phase function (1 + B0 / (1 + tan(g/2)/h)) times a double Henyey-Greenstein function of ``c``
    and ``asymmetry``, in which the lobe (1 - c)/2 is backward.
    """

    r30: float
    b0: float
    h: float
    c: float
    asymmetry: float
    source: str


_SELENE = (
    "group of the Spectral Profiler of SELENE at 644.6 nm: Y. Yokota et al., Icarus 215 (2011) 639, supporting information, as "
    "distributed with the code of T. Kouyama et al. (2016), TKouyama/SP_LunarCal_example"
)

SURFACES = {
    "sp-low": SurfacePhase(0.045, 1.657, 0.0735, -0.053, 0.208, f"low albedo {_SELENE}"),
    "sp-mid": SurfacePhase(0.064, 1.347, 0.0565, -0.053, 0.227, f"middle albedo {_SELENE}"),
    "sp-high": SurfacePhase(0.094, 1.087, 0.0850, -0.183, 0.210, f"high albedo {_SELENE}"),
}
"""For the lunar-Lambert model with McEwen's L(g), with which they were fitted; phase 5 to 85 deg.
"""

DEFAULT_SURFACE = "sp-mid"


@dataclass(frozen=True)
class DiscPhase:
    """Kieffer and Stone (2005), eq. 10, without libration and with the Sun's longitude 0: the
    logarithm of the disc's reflectance is sum a_i g^i (radians) + d1 exp(-g/p1) + d2 exp(-g/p2) +
    d3 cos((g - p3)/p4) (degrees).
    """

    a: tuple[float, float, float, float]
    d: tuple[float, float, float]
    p: tuple[float, float, float, float]
    last_deg: float
    source: str


DISCS = {
    "rolo": DiscPhase(
        a=(-1.88914, -1.58096, 0.30477, -0.17908),
        d=(0.37141, -0.13514, 0.01248),
        p=(4.06054, 12.8802, -30.5858, 16.7498),
        last_deg=97.0,
        source="H. H. Kieffer, T. C. Stone, AJ 129 (2005) 2887, table 4, 665.1 nm; coefficients from a plot by J. Hollan, who "
        "has them from T. Stone. Measured from 1.55 to 97 deg of phase",
    )
}
"""For Lommel-Seeliger's model: a sphere has the measured brightness of the Moon's disc, up to the
last measured phase."""


def surface_law(name: str) -> tuple[float, ...]:
    """Numbers of the lunar-Lambert model: scale, B0, h, c, asymmetry. ConfigError for an unknown
    name.
    """
    if name not in SURFACES:
        raise ConfigError(
            f"no lunar-Lambert phase function {name!r}; valid names: {', '.join(SURFACES)}"
        )
    found = SURFACES[name]
    shape = (found.b0, found.h, found.c, found.asymmetry)
    cosine = math.cos(math.radians(30.0))
    share = _mixture(cosine)
    bright = cosine * (2.0 * share / (1.0 + cosine) + 1.0 - share)
    return (found.r30 / (bright * _two_lobes((1.0, *shape), cosine)), *shape)


def disc_law(name: str) -> tuple[float, ...]:
    """Numbers of Lommel-Seeliger's model with the phase function of a disc, in the order of
    `kernels.photometry.laws.even_sphere`. ConfigError for an unknown name.

    Beyond the last measured phase the logarithm of the factor is extrapolated linearly.
    """
    if name not in DISCS:
        raise ConfigError(
            f"no Lommel-Seeliger phase function {name!r}; valid names: {', '.join(DISCS)}"
        )
    found = DISCS[name]
    last, step = math.radians(found.last_deg), 1e-5
    measured = (*found.a, *found.d, *found.p, math.pi, 0.0, 0.0)
    before, at = (math.log(_even_sphere(measured, math.cos(g))) for g in (last - step, last))
    return (*measured[:-3], last, at, (at - before) / step)
