"""The alternatives to a configuration that `lcp trade` tries: which fields, with which values (`approximations`).

Each function takes a configuration and returns what differs from it. The module imports nothing of the library.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

Values = dict[str, dict[str, Any]]
"""Alternatives to a configuration: the fields that each replaces, by its name."""


def none(config: Any) -> Values:
    """No alternative."""
    return {}


def numbers(field: str, *factors: float) -> Callable[[Any], Values]:
    """A number times each of the factors, as whole as it was."""

    def values(config: Any) -> Values:
        section, _, key = field.partition(".")
        own = getattr(getattr(config, section), key)
        found = {f: type(own)(f * own) for f in factors}
        return {f"{value:g}": {field: value} for value in found.values() if value != own}

    return values


def choices(field: str, *choices: Any, usual: Any = None) -> Callable[[Any], Values]:
    """The choices that the field has not; ``usual``: its value where it is None."""

    def values(config: Any) -> Values:
        section, _, key = field.partition(".")
        own = getattr(getattr(config, section), key) or usual
        return {_shown(value): {field: value} for value in choices if value != own}

    return values


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value).replace(",)", ")")


TIERS = "draft", "standard", "high", "reference"
_LAWS = "lommel-seeliger", "lunar-lambert", "hapke"


def law(config: Any) -> float:
    """How fine a law is: its place among the named ones, others last."""
    name = config.model.reflectance.partition(":")[0]
    return _LAWS.index(name) if name in _LAWS else len(_LAWS)


def tiers(config: Any) -> Values:
    """The other accuracy tiers."""
    own = config.model.precision.tier
    return {tier: {"model.accuracy": tier} for tier in TIERS if tier != own}


def whole_search(config: Any) -> Values:
    """Search at half resolution first, or at full resolution."""
    other = not config.model.precision.whole_search
    return {"full resolution" if other else "half first": {"model.whole_search": other}}


def views(config: Any) -> Values:
    """The first view alone, and a ring of more views."""
    own = config.view
    first = {f"view.{key}": getattr(own, key)[:1] for key in _VIEW}
    # within reach of the outermost views, so that their claims are compared with those of views between
    far = max(own.off_nadir_deg)
    off = far - 15.0 if far >= 30.0 else far + 15.0
    sides = own.azimuth_deg[1:] if len(own) > 1 else (0.0, 90.0, 180.0, 270.0)
    ring = (off,) * len(sides), sides, own.altitude_km[:1] * len(sides)
    more = {f"view.{k}": getattr(own, k) + r for k, r in zip(_VIEW, ring, strict=True)}
    few = {"the first alone": first} if len(own) > 1 else {}
    return few | {f"and {off:g} deg from {len(sides)} sides": more}


_VIEW = "off_nadir_deg", "azimuth_deg", "altitude_km"


def altitudes(config: Any) -> Values:
    """Near views for parallel ones, or parallel ones."""
    own = config.view.altitude_km
    other = 100.0 if math.isinf(max(own)) else math.inf
    return {
        "near, 100 km" if other == 100.0 else "parallel": {"view.altitude_km": (other,) * len(own)}
    }


def azimuths(config: Any) -> Values:
    """Half and twice the azimuths of the Sun."""
    own = config.sun.azimuths_deg
    middles = [0.5 * (a + b) for a, b in zip(own, (*own[1:], own[0] + 360.0), strict=True)]
    every = tuple(sorted({*own, *(m % 360.0 for m in middles)}))
    found = {"every second azimuth": {"sun.azimuths_deg": own[::2]}} if len(own) > 3 else {}
    return found | {"twice the azimuths": {"sun.azimuths_deg": every}}


def elevations(config: Any) -> Values:
    """Half and twice the elevations of the Sun."""
    own = config.sun.elevations_deg
    middles = tuple(0.5 * (a + b) for a, b in itertools.pairwise(own))
    few = (*own[:-1:2], own[-1])
    found = {"every second elevation": few, "twice the elevations": tuple(sorted((*own, *middles)))}
    return {name: {"sun.elevations_deg": value} for name, value in found.items() if value != own}


def patches(config: Any) -> Values:
    """Patches of half and of twice the width."""
    own = config.points.patch_nodes
    sizes = max(9, own // 2 | 1), min(257, 2 * own - 1)
    return {str(size): {"points.patch_nodes": size} for size in sizes if size != own}


def searches(config: Any) -> Values:
    """Half and twice the search radius."""
    cell_m, points = config.area.gsd_m, config.points
    nodes = points.search_nodes(cell_m)
    wanted = max(points.half, nodes // 2), 2 * nodes
    return {f"{n} cells": {"points.search_m": n * cell_m} for n in wanted if n != nodes}


def directions(config: Any) -> Values:
    """Twice and half the tolerance of a direction, and own Suns of points."""
    found = numbers("model.direction_tolerance_deg", 2.0, 0.5)(config)
    deg = 0.0 if config.model.precision.own_sun_deg else 15.0
    return found | {f"own Sun to {deg:g} deg": {"model.own_sun_deg": deg}}


def scales(config: Any) -> Values:
    """Claims at the cells' own scale alone."""
    many = len(config.points.scales)
    return {"1": {"points.image_scales": 1}} if many > 1 else {}
