"""Published parameters of Hapke's model for the Moon, as named sets.

Source: H. Sato, M. S. Robinson, B. Hapke, B. W. Denevi and A. K. Boyd, "Resolved Hapke parameter
maps of the Moon", JGR Planets 119 (2014) 1775, doi:10.1002/2013JE004580, and its archived product,
the LROC WAC parameter maps (PDS LRO-L-LROC-5-RDR, WAC_HAPKEPARAMMAP): fits of 1 deg cells, 70 N to
70 S, of 66 000 images. Limits of the fit: incidence below 75 deg, emission below 30, phase below
97; constant roughness (23.657 deg in the product, 23.4 in the paper), no coherent backscatter, no
porosity (K = 1).

Neither the paper nor the product was available: the numbers were taken from documents that quote
them, as stated for each set. Equations of the paper are quoted where they are used: (2) c = 3.29
exp(-17.4 b^2) - 0.908, and (4) B_S0 = (2.459 w + 0.078) / (w p(0)) at 643 nm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import ConfigError
from ..kernels.photometry.hapke import COT_SMOOTH

_THETA_DEG = 23.657
_DENSEST = 1.209 ** (-1.5)
"""Filling factor at the pole of the porosity factor, 0.752."""


@dataclass(frozen=True)
class HapkeSet:
    """Parameters of Hapke (2012): single-scattering albedo ``w``; ``b`` and ``c`` of the double
    Henyey-Greenstein function, in which the lobe (1 + c)/2 is backward; amplitude and width of
    shadow hiding ``b_s0``, ``h_s`` and of coherent backscatter ``b_c0``, ``h_c``; ``filling``
    factor of the particles; mean slope ``theta_bar_deg`` of the roughness. ConfigError for values
    outside the model.
    """

    name: str
    w: float
    b: float
    c: float
    b_s0: float
    h_s: float
    b_c0: float = 0.0
    h_c: float = 1.0
    filling: float = 0.0
    theta_bar_deg: float = _THETA_DEG

    def __post_init__(self) -> None:
        inside = {
            "w": 0.0 < self.w <= 1.0,
            "b": 0.0 <= self.b < 1.0,
            "c": abs(self.c) <= 1.0 or self._is_positive(),
            "b_s0, h_s": self.b_s0 >= 0.0 and self.h_s >= 0.0,
            "b_c0, h_c": self.b_c0 >= 0.0 and self.h_c >= 0.0,
            "filling": 0.0 <= self.filling < _DENSEST,
            "theta_bar_deg": 0.0 <= self.theta_bar_deg <= 60.0,
        }
        for parameter, holds in inside.items():
            if not holds:
                raise ConfigError(f"Hapke parameters {self.name!r}: {parameter} is out of range")

    def _is_positive(self) -> bool:
        """True if p(g) is not negative anywhere although one lobe is; its minimum is then at an
        end.
        """
        if not (0.0 <= self.b < 1.0 and math.isfinite(self.c)):
            return False
        return min(self.phase(1.0), self.phase(-1.0)) >= 0.0

    def phase(self, cos_g: float) -> float:
        """p(g); its mean over the sphere is 1."""
        spread, b = 1.0 - self.b**2, self.b
        behind, ahead = 1.0 + b * b - 2.0 * b * cos_g, 1.0 + b * b + 2.0 * b * cos_g
        return float(0.5 * spread * ((1.0 + self.c) / behind**1.5 + (1.0 - self.c) / ahead**1.5))

    @property
    def porosity(self) -> float:
        """K = -ln(1 - 1.209 phi^(2/3)) / (1.209 phi^(2/3)); Hapke 2012, eq. 7.45."""
        if self.filling == 0.0:
            return 1.0
        x = 1.209 * self.filling ** (2.0 / 3.0)
        return float(-math.log1p(-x) / x)

    @property
    def law(self) -> tuple[float, ...]:
        """Numbers in the order of `kernels.photometry.hapke`."""
        tan = math.tan(math.radians(self.theta_bar_deg))
        root = math.sqrt(1.0 - self.w)
        parameters = (self.w, self.b, self.c, self.b_s0, self.h_s, self.b_c0, self.h_c)
        cot = 1.0 / tan if tan > 1e-12 else COT_SMOOTH
        chi = 1.0 / math.sqrt(1.0 + math.pi * tan * tan)
        return (*parameters, self.porosity, cot, chi, (1.0 - root) / (1.0 + root), 1.0)


def backward_share(b: float) -> float:
    """Parameter c as a function of b (the hockey stick relation): Sato et al. (2014), eq. 2, after
    Hapke (2012b).
    """
    return 3.29 * math.exp(-17.4 * b * b) - 0.908


def _from_trends(name: str, w: float, b: float, h_s: float) -> HapkeSet:
    """A set at 643 nm with c and B_S0 from the paper's trends, equations 2 and 4."""
    bare = HapkeSet(name, w, b, backward_share(b), 0.0, h_s)
    surge = (2.459 * w + 0.078) / (w * bare.phase(1.0))
    return HapkeSet(name, w, b, backward_share(b), surge, h_s)


SETS = {
    found.name: found
    for found in (
        # medians of w, b, h_S of the WAC 643 nm maps over 30 S to 30 N; c, B_S0 by eq. 2, 4. Read in the documentation of the
        # Moon of layoutit/css.earth, which prints c 0.3253, B_S0 1.686
        _from_trends("wac-643", 0.3854, 0.2375, 0.0672),
        # cell of Tranquility Base (23.5 E, 0.5 N) of the WAC 643 nm maps, all five as fitted. Read in the documentation of a
        # lighting study of Apollo 11 photographs that prints the cell
        HapkeSet("wac-643-mare", 0.222, 0.254, 0.160, 1.993, 0.0597),
        # the same cell of the WAC 566 nm maps, from the same document
        HapkeSet("wac-566-mare", 0.188, 0.254, 0.158, 2.134, 0.0623),
        # put together: b and h_S that the paper prints for the highlands (section 3.4), w the 84th percentile of the 643 nm map
        # over 30 S to 30 N, c, B_S0 by eq. 2, 4. Read in the documentation of layoutit/css.earth
        _from_trends("wac-643-highland", 0.44, 0.23, 0.074),
    )
}

DEFAULT_SET = "wac-643"
"""Typical surface of the Moon; the one to multiply with a map of relative albedo."""


def hapke_set(name: str) -> HapkeSet:
    """Set of a name; ConfigError for an unknown name."""
    if name not in SETS:
        raise ConfigError(f"no Hapke parameters {name!r}; valid names: {', '.join(SETS)}")
    return SETS[name]
