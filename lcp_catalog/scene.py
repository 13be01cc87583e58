"""Which effects a render models, at what error, and why (docs/scene-plan.md).

Effects are left out where the result is provably the same, or within the tolerance that was asked
for; each decision carries the bound on what it admits.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from . import scene_effects as effects
from .accuracy import TIERS, Accuracy
from .reflectance import DEFAULT_MODEL, Reflectance
from .relief import (
    Relief,
    Steepness,
    core_box,
    lowest_core_tangent,
    relief,
    ring_of,
    tangent_of,
)
from .scene_bounds import (
    horizon_beyond_rad,
    limb_tangent,
    parallel_direction,
    parallel_error,
    penumbra_px,
    pixel_m,
    ray_angle_rad,
)
from .scene_effects import EVERY_NODE, EVERY_PIXEL, Decision, Rays
from .surroundings import REACH_MAX_M
from .terrain import Terrain
from .view import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScenePlan:
    """All decisions of a render; a render looks at the first four."""

    cast_shadows: Decision
    occlusion: Decision
    perspective: Decision
    solar_disc: Decision
    relief: Decision
    float_width: Decision
    reflectance: Decision
    others: tuple[Decision, ...] = ()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        named = (self.cast_shadows, self.occlusion, self.perspective, self.solar_disc)
        return (*named, self.relief, self.float_width, self.reflectance, *self.others)

    def to_json(self) -> dict[str, list[dict[str, object]]]:
        """The document of ``lcp render --explain``."""
        return {"decisions": [asdict(decision) for decision in self.decisions]}

    def __str__(self) -> str:
        return json.dumps(self.to_json(), sort_keys=True)


def plan_scene(
    terrain: Terrain,
    sun: Array,
    view: View,
    in_camera_plane: bool = False,
    ring: Decision | None = None,
    *,
    accuracy: Accuracy = TIERS["reference"],
    disc: bool = False,
    model: Reflectance = DEFAULT_MODEL,
    everything: bool = False,
) -> ScenePlan:
    """Decide for a terrain, an ENU direction to the Sun (its middle, where ``disc``) and a view.

    ``everything``: leave out nothing that can be modelled; a disc only where it is asked for.
    """
    found, least_view = relief(terrain), lowest_core_tangent(view, terrain)
    slope = None if everything else found.slope
    # what stands on other cells far away is no part of the connected surface that a slope speaks of
    light_slope, disc_slope = slope, slope
    if terrain.far is not None:
        light_slope = None
        disc_slope = None if everything else replace(found.slope, connected=False)
    disc_decision = _disc(
        found, disc_slope, sun, pixel_m(found, view, in_camera_plane), disc, accuracy
    )
    away_m = float(np.hypot(found.box.corners_m[:, 0], found.box.corners_m[:, 1]).max())
    half_m = 0.5 * float(np.hypot(*(found.box.high_m - found.box.low_m)[:2]))
    if everything:
        accuracy = replace(accuracy, tolerance=0.0)
    return ScenePlan(
        cast_shadows=_shadows(light_slope, sun, disc_decision.modelled, in_camera_plane, accuracy),
        occlusion=_occlusion(slope, view, least_view, in_camera_plane, accuracy),
        perspective=_perspective(found, view, least_view, in_camera_plane, accuracy, model),
        solar_disc=disc_decision,
        relief=effects.surface(found, least_view, away_m),
        float_width=effects.float_width(),
        reflectance=effects.reflectance(model.name),
        others=(*((ring,) if ring is not None else ()), *effects.always(half_m)),
    )


def _disc(
    found: Relief,
    slope: Steepness | None,
    sun: Array,
    finest_m: float,
    asked: bool,
    accuracy: Accuracy,
) -> Decision:
    width = math.inf if asked and slope is None else penumbra_px(found, sun, finest_m)
    return effects.solar_disc(asked, slope, limb_tangent(sun), width, accuracy)


def _shadows(
    slope: Steepness | None, sun: Array, disc: bool, in_camera_plane: bool, accuracy: Accuracy
) -> Decision:
    rays = EVERY_PIXEL if in_camera_plane else Rays.of(accuracy)
    if disc:
        return effects.hiding(
            "cast shadows", "the elevation of the Sun's lower limb", limb_tangent(sun), slope, rays
        )
    return effects.hiding("cast shadows", "the Sun's elevation", tangent_of(sun), slope, rays)


def _occlusion(
    slope: Steepness | None,
    view: View,
    least_tangent: float,
    in_camera_plane: bool,
    accuracy: Accuracy,
) -> Decision:
    if in_camera_plane:
        reason = "every pixel's ray is traced to its first hit"
        return Decision("occlusion", True, reason, 0.0, "share of nodes")
    rays = EVERY_NODE if view.direction is None else Rays.of(accuracy)
    what = "the camera's least elevation"
    return effects.hiding("occlusion", what, least_tangent, slope, rays)


def _perspective(
    found: Relief,
    view: View,
    least_tangent: float,
    in_camera_plane: bool,
    accuracy: Accuracy,
    model: Reflectance,
) -> Decision:
    if in_camera_plane:
        return effects.perspective_of_pixels()
    if view.direction is not None:
        return effects.perspective_of_infinity()
    angle = ray_angle_rad(found.box, view)
    error = parallel_error(found, angle, least_tangent, model)
    return effects.perspective(angle, error, accuracy)


def parallel_view(terrain: Terrain, view: View) -> View:
    """The view of parallel rays from the middle of the core that may stand for one from near."""
    return View(direction=parallel_direction(core_box(terrain), view), camera=view.camera)


def ring_decision(terrain: Terrain, ring_m: float, needed_m: float) -> Decision:
    """What the terrain around an area holds, and what it does not; ``ring_m``: the width of what
    has the area's own cells.
    """
    ring, box, far = ring_of(terrain), core_box(terrain), terrain.far
    known_m = min(ring_m if needed_m > ring_m and far is None else math.inf, ring.gap_m)
    if far is not None:
        known_m = min(known_m, far.gap_m, REACH_MAX_M if needed_m >= REACH_MAX_M else math.inf)
    horizon = 0.0
    if math.isfinite(known_m):
        sides = np.concatenate([-box.low_m[:2], box.high_m[:2]])
        lowest, origin_m = float(box.low_m[2]), float(sides.min()) + known_m
        horizon = horizon_beyond_rad(known_m, lowest, origin_m, terrain.frame.height_m)
    if far is not None:
        return effects.far_terrain(ring_m, needed_m, ring, far, terrain.field.gsd_m, horizon)
    return effects.near_terrain(ring_m, needed_m, ring, terrain.field.gsd_m, horizon)
