"""The scene plan: for each effect, if it is modelled, why, and with what error.

An effect is left out where the result is provably the same, or within the requested tolerance. Each
decision has a bound on its error.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from ..accuracy import TIERS, Accuracy
from ..arrays import Array
from ..cameras.view import CameraView, MovingView, ParallelView, ScannerView, View
from ..constants import SOLAR_RADIUS_RAD
from ..photometry.law_choice import SLOPE_RMS, LawChoice, choose
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from ..terrain.relief_bounds import (
    Relief,
    Steepness,
    core_box,
    lowest_core_tangent,
    nodes_enu,
    relief,
    ring_of,
    tangent_of,
)
from ..terrain.surroundings import REACH_MAX_M
from ..terrain.terrain import Terrain
from . import decisions as effects
from .decisions import (
    EVERY_NODE,
    EVERY_PIXEL,
    SUN_ALONE,
    Decision,
    LightWords,
    MergedDecision,
    RayMethod,
)
from .error_bounds import (
    horizon_beyond_rad,
    limb_tangent,
    parallel_direction,
    parallel_error,
    penumbra_px,
    pixel_m,
    ray_angle_rad,
    sphere_cost,
)

_SLOPE_NODES = 256  # per side, for the slope statistics of a terrain
_PHASES = 4  # parts of a side between which a law's phase angles are taken


@dataclass(frozen=True)
class ScenePlan:
    """All decisions of a scene: of one image, or of all images of a build."""

    cast_shadows: Decision
    occlusion: Decision
    perspective: Decision
    solar_disc: Decision
    relief: Decision
    float_width: Decision
    reflectance: Decision
    albedo: Decision
    others: tuple[Decision, ...] = ()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """Every decision: the named ones in the order of the fields, then the others."""
        return (*(getattr(self, name) for name in _NAMED), *self.others)

    @property
    def bounces(self) -> bool:
        """True if light that reaches ground by way of other ground is modelled."""
        return any(one.effect == effects.SCATTERED and one.modelled for one in self.others)

    @classmethod
    def of(cls, decisions: Sequence[Decision]) -> ScenePlan:
        """The plan of a list of decisions in the order of `decisions`."""
        named = dict(zip(_NAMED, decisions, strict=False))
        # one decision for each named field, in their order
        return cls(**named, others=tuple(decisions[len(_NAMED) :]))

    @classmethod
    def merged(cls, by_area: Iterable[tuple[str, ScenePlan]]) -> ScenePlan:
        """One plan for several areas and their plans, by name, each decision a `MergedDecision`. The
        plans are not kept. ValueError for plans with different numbers of decisions.
        """
        columns: list[MergedDecision] = []
        for area, plan in by_area:
            columns = columns or [MergedDecision() for _ in plan.decisions]
            for column, decision in zip(columns, plan.decisions, strict=True):
                column.add(area, decision)
        return cls.of([column.decision for column in columns])

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> ScenePlan:
        """The plan of a document that `to_json` gave."""
        # the keys of a decision are its fields: `to_json` wrote them
        return cls.of([Decision(**decision) for decision in document["decisions"]])

    def to_json(self) -> dict[str, list[dict[str, object]]]:
        """The decisions as a document of JSON."""
        return {"decisions": [asdict(decision) for decision in self.decisions]}

    def __str__(self) -> str:
        return json.dumps(self.to_json(), sort_keys=True)


_NAMED = tuple(field.name for field in fields(ScenePlan) if field.name != "others")


def plan_scene(
    terrain: Terrain,
    sun: Array,
    view: View,
    in_camera_plane: bool = False,
    ring: Decision | None = None,
    *,
    accuracy: Accuracy = TIERS["reference"],
    disc: bool = False,
    disc_radius_rad: float = SOLAR_RADIUS_RAD,
    model: Reflectance = DEFAULT_MODEL,
    choice: LawChoice | None = None,
    albedo: Decision | None = None,
    sphere_may_do: bool = False,
    lowest: bool = False,
    words: LightWords = SUN_ALONE,
    scattered: Decision | None = None,
) -> ScenePlan:
    """The plan for a terrain, a direction to the Sun (ENU unit vector (3,), to its centre) and a view.

    in_camera_plane: True for an image in the camera's plane, False for nodes. ring: decision about the
    terrain beyond the area (`ring_decision`). disc: True for a Sun of radius ``disc_radius_rad``.
    choice: how ``model`` was chosen, if it was compared with others. albedo: decision about an albedo
    map; None without a map.
    sphere_may_do: True if the plain sphere may replace the heightfield. words: the light, in words. scattered:
    decision about light by way of other ground; None to leave it out.

    lowest: True if the Sun and the view are the lowest of several. Every decision depends only on
    their elevations, monotonically, so the plan holds for the higher ones too.
    """
    found, least_view = relief(terrain), lowest_core_tangent(view, terrain)
    light_slope: Steepness | None = found.slope
    disc_slope = found.slope
    if terrain.far is not None:  # far terrain is not part of the connected surface
        light_slope, disc_slope = None, replace(found.slope, connected=False)
    limb = limb_tangent(sun, disc_radius_rad)
    finest_m = pixel_m(found, view, in_camera_plane)
    width_px = penumbra_px(found, sun, finest_m)
    point = f"{words.first} is a point" if words.at_infinity else "a point Sun"
    solar_disc = effects.solar_disc(disc, disc_slope, limb, width_px, accuracy, point)
    source = "the lowest Sun" if lowest else words.first
    what, light = f"{source}'s elevation", tangent_of(sun)
    if solar_disc.modelled:
        what, light = f"the elevation of {source}'s lower limb", limb
    rays = EVERY_PIXEL if in_camera_plane else RayMethod.of(accuracy)
    shadows = effects.hiding("cast shadows", what, light, light_slope, rays)
    nothing_hidden = not shadows.modelled and found.slope.clears(least_view)
    sphere = None
    if sphere_may_do and nothing_hidden and not accuracy.exact and accuracy.tolerance > 0.0:
        sphere = sphere_cost(
            terrain, sun, view, model, least_view, finest_m, accuracy.tolerance, in_camera_plane
        )
    away_m = float(np.hypot(found.box.corners_m[:, 0], found.box.corners_m[:, 1]).max())
    half_m = 0.5 * float(np.hypot(*(found.box.high_m - found.box.low_m)[:2]))
    law = effects.reflectance(choice) if choice else effects.reflectance_as_asked(model.name)
    return ScenePlan(
        cast_shadows=shadows,
        occlusion=_occlusion(found.slope, view, least_view, in_camera_plane, accuracy, lowest),
        perspective=_perspective(found, view, least_view, in_camera_plane, accuracy, model),
        solar_disc=solar_disc,
        relief=effects.surface(found, least_view, away_m, sphere, accuracy),
        float_width=effects.float_width(),
        reflectance=law,
        albedo=albedo or effects.albedo(),
        others=(*((ring,) if ring is not None else ()), *effects.always(half_m, words, scattered)),
    )


def _occlusion(
    slope: Steepness,
    view: View,
    least_tangent: float,
    in_camera_plane: bool,
    accuracy: Accuracy,
    lowest: bool,
) -> Decision:
    if in_camera_plane:
        reason = "every pixel's ray is traced to its first hit"
        return Decision("occlusion", True, reason, 0.0, "share of nodes")
    if isinstance(view, ParallelView | MovingView) and is_vertical(view.direction):
        return effects.straight_down()
    own = isinstance(view, CameraView | ScannerView)
    rays = EVERY_NODE if own else RayMethod.of(accuracy)
    what = "the lowest view's elevation" if lowest else "the camera's least elevation"
    return effects.hiding("occlusion", what, least_tangent, slope, rays)


def is_vertical(direction: Array) -> bool:
    """True if an ENU unit vector (3,) points straight up, but for rounding."""
    return bool(direction[2] >= 1.0 - 1e-15)


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
    if isinstance(view, MovingView | ScannerView):
        return effects.perspective_of_nodes()
    if isinstance(view, ParallelView):
        return effects.perspective_of_infinity()
    angle = ray_angle_rad(found.box, view)
    error = parallel_error(found, angle, least_tangent, model)
    return effects.perspective(angle, error, accuracy)


def parallel_view(terrain: Terrain, view: CameraView) -> ParallelView:
    """The parallel view in the direction from the middle of the core to a camera."""
    return ParallelView(parallel_direction(core_box(terrain), view), view.camera)


def choose_model(
    terrain: Terrain, sun: Array, view: View, accuracy: Accuracy, asked: Reflectance | None = None
) -> LawChoice:
    """The reflectance model for one image of a terrain: the requested one, or the choice for the slopes
    of the terrain and all phase angles of the image.
    """
    row0, row1, col0, col1 = terrain.core
    field = terrain.field
    step = max(1, max(row1 - row0, col1 - col0) // _SLOPE_NODES)
    normals = field.normals(terrain.core)[::step, ::step].reshape(-1, 3)
    normals = normals[np.isfinite(normals[:, 2]) & (normals[:, 2] > 0)].astype(np.float64)
    slope = normals[:, :2] / normals[:, 2:]
    slope_rms = float(np.sqrt(np.mean(slope**2))) if len(slope) else SLOPE_RMS
    points = nodes_enu(field, terrain.core, max(1, max(row1 - row0, col1 - col0) // _PHASES))
    points = points.reshape(-1, 3)[np.isfinite(points.reshape(-1, 3)[:, 2])]
    cameras = view.directions(points) if len(points) else np.array([[0.0, 0.0, 1.0]])
    cameras = np.broadcast_to(cameras, (max(1, len(points)), 3))
    if isinstance(view, ScannerView):  # points beyond its image have no direction
        cameras = np.where(np.isnan(cameras), view.direction, cameras)
    suns = np.broadcast_to(sun, cameras.shape)
    return choose(accuracy, suns[None], cameras[None], slope_rms, asked)


def ring_decision(
    terrain: Terrain, ring_m: float, needed_m: float, limit_m: float = REACH_MAX_M
) -> Decision:
    """Decision about the terrain around an area. ``ring_m``: width of the ring with the area's own
    cells; ``needed_m``: distance to which terrain matters; ``limit_m``: no terrain farther away was
    read.
    """
    ring, box, far = ring_of(terrain), core_box(terrain), terrain.far
    known_m = min(ring_m if needed_m > ring_m and far is None else math.inf, ring.gap_m)
    if far is not None:
        known_m = min(known_m, far.gap_m)
    limited = limit_m < REACH_MAX_M or (far is not None and needed_m >= limit_m)
    if limited:
        known_m = min(known_m, limit_m)
    horizon = None
    if math.isfinite(known_m):
        sides = np.concatenate([-box.low_m[:2], box.high_m[:2]])
        lowest, origin_m = float(box.low_m[2]), float(sides.min()) + known_m
        horizon = horizon_beyond_rad(known_m, lowest, origin_m, terrain.frame.height_m)
    gsd_m, ends_m = terrain.field.gsd_m, limit_m if limited else None
    if far is not None:
        return effects.far_terrain(ring_m, needed_m, ring, far, gsd_m, ends_m, horizon)
    return effects.near_terrain(ring_m, needed_m, ring, gsd_m, ends_m, horizon)
