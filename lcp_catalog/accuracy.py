"""How exact a render is: four tiers, each with a bound on its error against the last, and a tolerance.

A tier says how shadows and visibility are found; the tolerance says what the scene plan may leave
out. ``reference`` is exact for the triangulated surface (docs/contract, "The surface"); the bounds
of the others are measured (tests/test_shadows.py holds them) except that of ``high``, which is
proved (`kernels.bounds`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from .errors import ConfigError


@dataclass(frozen=True)
class Accuracy:
    """A tier and what it promises.

    ``node_error``: share of the nodes whose cast shadow (or occlusion seen from a direction) may
    differ from the exact one. ``tolerance``: what an effect left out of the scene may cost, as a
    share of the nodes or of the radiance factor. ``disc``: whether the Sun is a disc where nobody
    says.
    """

    tier: str
    node_error: float
    tolerance: float
    disc: bool

    @property
    def exact(self) -> bool:
        """Whether no node is wrong."""
        return self.node_error == 0.0


TIERS = {
    "draft": Accuracy("draft", node_error=5e-3, tolerance=5e-3, disc=False),
    "standard": Accuracy("standard", node_error=2e-4, tolerance=2e-4, disc=False),
    "high": Accuracy("high", node_error=0.0, tolerance=2e-5, disc=True),
    "reference": Accuracy("reference", node_error=0.0, tolerance=0.0, disc=True),
}
"""By name, from the fastest to the most exact."""

DEFAULT_TIER = "standard"


def accuracy(tier: str | None = None, tolerance: float | None = None) -> Accuracy:
    """The accuracy of a tier's name, or the fastest tier whose errors stay within a tolerance
    (0: ``reference``).

    ConfigError for an unknown tier, a tolerance that is negative or not finite, or both at once.
    """
    if tier is not None and tolerance is not None:
        raise ConfigError("state an accuracy or a tolerance, not both")
    if tolerance is None:
        name = DEFAULT_TIER if tier is None else tier
        if name not in TIERS:
            raise ConfigError(f"no accuracy {name!r}; there are {', '.join(TIERS)}")
        return TIERS[name]
    if not (math.isfinite(tolerance) and tolerance >= 0.0):
        raise ConfigError(f"a tolerance is a share, 0 or more, not {tolerance}")
    if tolerance == 0.0:
        return TIERS["reference"]
    fitting = next(t for t in TIERS.values() if t.node_error <= tolerance)
    return Accuracy(fitting.tier, fitting.node_error, tolerance, fitting.disc)
