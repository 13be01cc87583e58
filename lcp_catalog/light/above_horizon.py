"""Light sources above the horizon of a terrain."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..errors import SunError
from ..geometry.direction import Direction
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .sources import Lighting, Source

_ROUNDING_DEG = 1e-9  # of the Sun's elevation: one on the horizon is not below it


def light_above_horizon(terrain: Terrain, light: Lighting) -> Lighting:
    """The light, its sources without irradiance where they stand below the horizon of even the
    area's highest node, a disc with its upper limb; SunError where all do and there is no sky.

    Seen from a height h above the lowest ground around, the horizon of a sphere of that ground dips
    by acos(R / (R + h)). Beyond the terrain there is nothing: without this a set Sun would light its
    border from below.
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
            f"the {first.name} stands {-_above_deg(terrain, first, lowest_m, 1):.2f} deg below the "
            f"horizon of the area's highest ground: nothing is lit; state another {first.name}"
        )
    return replace(light, sources=tuple(sources))


def _is_set(terrain: Terrain, source: Source, lowest_m: float, step: int) -> bool:
    """Whether a source stands below every horizon; few nodes are asked where they say no."""
    return all(_above_deg(terrain, source, lowest_m, every) < 0 for every in (step, 1))


def _lowest_m(terrain: Terrain, step: int) -> float:
    """Least distance of the terrain's nodes from the Moon's centre."""
    all_around = terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.field.whole, step))
    radius = np.linalg.norm(all_around, axis=-1)
    lowest_m = float(np.nanmin(radius)) if np.isfinite(radius).any() else np.nan
    for level in terrain.far.levels if terrain.far else ():
        beyond = np.linalg.norm(terrain.frame.to_mcmf(nodes_enu(level, level.whole, 4)), axis=-1)
        lowest_m = float(np.nanmin(beyond, initial=lowest_m))
    return lowest_m


def _above_deg(terrain: Terrain, source: Source, lowest_m: float, step: int) -> float:
    """Greatest elevation of a source's upper limb above the dipped horizon of the core's nodes; NaN
    without heights.
    """
    limb = (math.degrees(source.disc.radius_rad) if source.disc else 0.0) + _ROUNDING_DEG
    return _sun_above_horizon_deg(terrain, source.direction, lowest_m, step) + limb


def _sun_above_horizon_deg(terrain: Terrain, sun: Direction, lowest_m: float, step: int) -> float:
    """Greatest elevation of the Sun above the dipped horizon of the core's nodes; NaN without
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
