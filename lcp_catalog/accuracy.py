"""Accuracy tiers: one table of error bounds and of the settings that keep them.

``reference`` is exact for the triangulated surface in float64. The errors of the other tiers are
relative to it. They are measured (the tests check them), except the bound on cast shadows of
``high``, which is proved (`kernels.shadows.proved_bounds`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from .errors import ConfigError


@dataclass(frozen=True)
class Accuracy:
    """One tier: its error bounds and its settings."""

    tier: str
    """Name of the tier."""

    node_error: float
    """Greatest share of nodes whose cast shadow, or whose occlusion along a direction, differs from
    ``reference``."""

    tolerance: float
    """Greatest error from an effect that the scene plan leaves out, as a share of the nodes or of the
    radiance factor."""

    disc: bool
    """True if the Sun is a disc unless the user states its shape; otherwise it is a point."""

    float64: bool
    """True if radiance is computed in float64 throughout."""

    shadows: Literal["lines", "likely", "proved", "rays"]
    """Method for cast shadows (`terrain.occlusion`): scan lines alone; a proved bound for lit nodes and
    scan lines for dark nodes; proved bounds for both; one ray from every node."""

    shadow_method: str
    """``shadows`` in words, for the scene plan."""

    far_doubt: float | None
    """Shadows of far terrain are interpolated over every eighth node. A node is traced if its height
    is within this margin around the interpolated heights, in units of their range; None: every node
    is traced. For a far ridge with slopes up to 60 deg that shades most of a plain, 0.04 % (draft)
    and 0.007 % (standard) of the nodes were wrong; interpolation without rays gave 2 %."""

    disc_strips: int | None
    """Vertical strips of the solar disc, one exact horizon each; None: doubled until no share changes
    by more than 1e-4."""

    disc_directions: int
    """Directions that sample the solar disc where strips do not apply (near the zenith)."""

    disc_rms: float
    """Bound on the rms error of the visible share of the disc, over all nodes of natural terrain. In
    penumbras alone: 0.2 (draft), 0.005 (standard), 0.0006 (high)."""

    sky_directions: tuple[int, int]
    """Azimuths that sample an environment map, and elevations at each azimuth."""

    sky_tier: str
    """Tier of the shadows under an environment map. The draft's wrong nodes cost less than the sampling
    error of draft and standard."""

    sky_rms: float
    """Bound on the rms error of the radiance under an environment map over natural terrain, as a share
    of the mean; measured against more samples with exact shadows."""

    whole_search: bool
    """True if places that resemble a patch are sought at full resolution everywhere; else at half
    resolution first, and again where the detection probability is near its limit (`production.evaluation`).
    Probabilities away from the limit can then be too high: in four areas 0 to 4 % of them by more than 0.05
    (docs/measurements/speed.md)."""

    own_sun_deg: float
    """Elevations of the Sun up to which a build judges a point that shadows from outside nearly disturb too much under its own
    Sun (`production.patch_light`); 0: never. Under the Sun of the area's centre 1.9, 1.6 and 0.9 % of the `unshadowed`
    flags are others at 4, 5 and 10 deg, with it none."""

    law_residual: float
    """Greatest rms residual of a cheaper reflectance model against Hapke's, as a share of the mean
    signal, at which that model is chosen (`photometry.laws`). It increases a noise of 0.15 by a
    fifth (draft), a twentieth (standard), 0.2 % (high) and nothing (reference)."""

    @property
    def exact(self) -> bool:
        """True if no node's shadow is wrong."""
        return self.node_error == 0.0


_COLUMNS: dict[str, tuple[Any, ...]] = {
    "tier": ("draft", "standard", "high", "reference"),
    "node_error": (5e-3, 2e-4, 0.0, 0.0),
    "tolerance": (5e-3, 2e-4, 2e-5, 0.0),
    "disc": (False, False, True, True),
    "float64": (False, False, False, True),
    "shadows": ("lines", "likely", "proved", "rays"),
    "shadow_method": (
        "two scan lines per column and the nearest cells",
        "a proved bound for lit nodes, two scan lines for dark ones, rays for the others",
        "proved bounds for lit and dark nodes, rays for the others",
        "a ray from every node",
    ),
    "far_doubt": (0.02, 1.0, None, None),
    "disc_strips": (1, 3, 9, None),
    "disc_directions": (16, 128, 512, 2048),
    "disc_rms": (0.07, 0.002, 0.0005, 1e-4),
    "sky_directions": ((16, 8), (32, 8), (64, 16), (128, 32)),
    "sky_tier": ("draft", "draft", "high", "high"),
    "sky_rms": (0.006, 0.004, 0.0015, 0.0006),
    "whole_search": (False, False, True, True),
    "own_sun_deg": (0.0, 0.0, 15.0, 15.0),
    "law_residual": (0.1, 0.05, 0.01, 0.0),
}
"""Each setting of the tiers, in their order."""

TIERS = {row.tier: row for row in map(Accuracy, *(_COLUMNS[one.name] for one in fields(Accuracy)))}
"""Tiers by name, from the fastest to the most exact."""

DEFAULT_TIER = "standard"


def accuracy(tier: str | None = None, tolerance: float | None = None) -> Accuracy:
    """Return the tier with a name (None: the default tier), or the fastest tier whose errors are within
    a tolerance (0: ``reference``).

    ConfigError for an unknown tier, for a tolerance that is negative or not finite, and if both are
    given.
    """
    if tier is not None and tolerance is not None:
        raise ConfigError("state an accuracy or a tolerance, not both")
    if tolerance is None:
        name = DEFAULT_TIER if tier is None else tier
        if name not in TIERS:
            raise ConfigError(f"no accuracy {name!r}; valid names: {', '.join(TIERS)}")
        return TIERS[name]
    if not (math.isfinite(tolerance) and tolerance >= 0.0):
        raise ConfigError(f"a tolerance must be 0 or more, not {tolerance}")
    if tolerance == 0.0:
        return TIERS["reference"]
    fitting = next(row for row in TIERS.values() if row.node_error <= tolerance)
    return replace(fitting, tolerance=tolerance)
