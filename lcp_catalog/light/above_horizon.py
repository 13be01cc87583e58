"""Light sources above the horizon of a terrain."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..errors import SunError
from ..geometry.direction import Direction
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .sources import Lighting, LightSource

_ROUNDING_DEG = 1e-9  # tolerance in elevation: a source on the horizon counts as above it


def light_above_horizon(terrain: Terrain, light: Lighting) -> Lighting:
    """Return the light with irradiance 0 for every source that is below the horizon of all nodes of
    the area; a disc is below with its upper limb. SunError if no source is left and there is no
    sky.

    The horizon is that of a sphere through the lowest surrounding terrain: from a height h above
    it, the horizon dips by acos(R / (R + h)). The terrain ends at its border; without this test a
    source below the horizon would illuminate the border from below.
    """
    step = max(1, max(terrain.field.shape) // 256)
    lowest_m = _lowest_m(terrain, step)
    sources = [
        replace(source, irradiance=0.0) if _is_set(terrain, source, lowest_m, step) else source
        for source in light.sources
    ]
    if light.sky is None and all(source.irradiance == 0.0 for source in sources):
        first = light.first
        raise SunError(
            f"the {first.name} is {-_above_deg(terrain, first, lowest_m, 1):.2f} deg below the horizon of "
            f"the area's highest terrain, so nothing is lit; state another {first.name}"
        )
    return replace(light, sources=tuple(sources))


def _is_set(terrain: Terrain, source: LightSource, lowest_m: float, step: int) -> bool:
    """True if a source is below every horizon; a coarse sample of nodes is tested first."""
    return all(_above_deg(terrain, source, lowest_m, every) < 0 for every in (step, 1))


def _lowest_m(terrain: Terrain, step: int) -> float:
    """Least distance of the terrain's nodes from the Moon's centre, metres."""
    all_around = terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.field.whole, step))
    radius = np.linalg.norm(all_around, axis=-1)
    lowest_m = float(np.nanmin(radius)) if np.isfinite(radius).any() else np.nan
    for level in terrain.far.levels if terrain.far else ():
        beyond = np.linalg.norm(terrain.frame.to_mcmf(nodes_enu(level, level.whole, 4)), axis=-1)
        lowest_m = float(np.nanmin(beyond, initial=lowest_m))
    return lowest_m


def _above_deg(terrain: Terrain, source: LightSource, lowest_m: float, step: int) -> float:
    """Greatest elevation of a source's upper limb above the horizon of the core's nodes, deg; NaN
    without heights.
    """
    limb = (math.degrees(source.disc.radius_rad) if source.disc else 0.0) + _ROUNDING_DEG
    return _sun_above_horizon_deg(terrain, source.direction, lowest_m, step) + limb


def _sun_above_horizon_deg(terrain: Terrain, sun: Direction, lowest_m: float, step: int) -> float:
    """Greatest elevation of a direction above the horizon of the core's nodes, deg; NaN without
    heights.
    """
    places = terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.core, step))
    places = places[np.isfinite(places[..., 2])]
    if not len(places):
        return float("nan")
    radius = np.linalg.norm(places, axis=-1)
    sine = np.clip(places @ terrain.frame.direction_to_mcmf(sun) / radius, -1.0, 1.0)
    elevation = np.arcsin(sine)
    dip = np.arccos(np.clip(lowest_m / radius, -1.0, 1.0))
    return float(np.degrees((elevation + dip).max()))
