"""An area as it looks under one Sun from one view: at its own nodes, or in the camera's plane.

Directions are unit ENU vectors of the terrain's frame, from the surface to the Sun (its middle).
What is modelled, and how exactly, the scene plan says (`scene`). Nodata is never rendered: its
radiance is NaN, it is neither lit nor seen, casts no shadow and hides nothing.

The radiance under a disc is that under a Sun in its middle, times the share of the disc above the
terrain's horizon. A facet that the middle does not reach is dark, though it may see part of the
disc: the cosine of incidence is wrong by less than sin(0.267 deg) = 0.0047 (docs/scene-plan.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .accuracy import TIERS, Accuracy
from .camera import Camera
from .constants import SOLAR_RADIUS_RAD
from .errors import CameraError, SunError
from .horizons import Points
from .reflectance import DEFAULT_MODEL, photometry
from .relief import nodes_enu
from .scene import ScenePlan, parallel_view, plan_scene
from .shadows import occluded
from .solar_disc import share_at_points, sunlit_share
from .sphere import mcmf_to_lonlat
from .terrain import Terrain
from .view import View, camera_view

Array = NDArray[np.float64]
Band = NDArray[np.floating]
Mask = NDArray[np.bool_]


_BLOCK_ROWS = 256
_ROUNDING_DEG = 1e-9  # of the Sun's elevation: one on the horizon is not below it


@dataclass(frozen=True, eq=False)
class Photograph:
    """Bands of one render, each (rows, cols): radiance factor (NaN where not seen, 0 where seen and
    not lit), sunlit share of the Sun (0 or 1 of a point), visible as a mask, angles in degrees (NaN
    without a surface), and where it is: ``height_m`` (ENU z) at the area's nodes,
    ``position_mcmf_m`` (rows, cols, 3) in the camera's plane.
    """

    radiance: Band
    sunlit: Band
    visible: Mask
    incidence_deg: Band
    emission_deg: Band
    phase_deg: Band
    height_m: Band | None = None
    position_mcmf_m: Array | None = None


def render_enu(
    terrain: Terrain,
    sun: Array,
    view: View,
    *,
    model: str = DEFAULT_MODEL,
    shadows: bool = True,
    accuracy: Accuracy = TIERS["reference"],
    disc: bool = False,
    plan: ScenePlan | None = None,
) -> Photograph:
    """The core window's nodes, float32.

    ``disc``: the Sun is a disc, not a point. With a view of a camera a node is visible only inside
    its image. ``shadows=False`` leaves out cast shadows, not attached ones. CameraError when the
    camera is under the ground, SunError when the Sun is below every horizon.
    """
    plan = plan or plan_scene(terrain, sun, view, accuracy=accuracy, disc=disc, model=model)
    check_sun(terrain, sun, disc)
    check_camera(terrain, view)
    field, (row0, row1, col0, col1) = terrain.field, terrain.core
    sunlit = _sunlit(terrain, sun, accuracy, plan if shadows else None)
    seen = np.ones(sunlit.shape, dtype=np.bool_)
    if plan.occlusion.modelled:
        seen = ~_hidden(terrain, view, accuracy)
    parallel = view if plan.perspective.modelled else _parallel(terrain, view)
    angles = [np.empty(seen.shape, dtype=np.float32) for _ in range(4)]
    for row in range(row0, row1, _BLOCK_ROWS):  # so that memory holds few float64 vectors at a time
        window = (row, min(row + _BLOCK_ROWS, row1), col0, col1)
        rows = slice(window[0] - row0, window[1] - row0)
        points, normals = nodes_enu(field, window), field.normals(window).astype(np.float64)
        towards = parallel.direction
        if towards is None:
            towards = view.directions(points)
        sunlit[rows] *= np.sum(normals * sun, axis=-1) > 0
        seen[rows] &= np.sum(normals * towards, axis=-1) > 0
        if view.camera is not None:
            pixels = view.camera.project(terrain.frame.to_mcmf(points))
            seen[rows] &= view.camera.in_image(pixels)
        for band, values in zip(
            angles, _bands(normals, sun, towards, sunlit[rows], seen[rows], model), strict=True
        ):
            band[rows] = values
    radiance, incidence, emission, phase = angles
    height = field.z_m[row0:row1, col0:col1]
    return Photograph(radiance, sunlit, seen, incidence, emission, phase, height_m=height)


def render_camera(
    terrain: Terrain,
    camera: Camera,
    sun: Array,
    *,
    model: str = DEFAULT_MODEL,
    shadows: bool = True,
    accuracy: Accuracy = TIERS["reference"],
    disc: bool = False,
    plan: ScenePlan | None = None,
) -> Photograph:
    """The camera's plane, one first hit a pixel, float64; ``disc``: the Sun is one, not a point.

    Normals are interpolated between the nodes'. What lies outside the core window hides, but is not
    drawn. A hit is visible even where its interpolated normal leans away (it counts as seen
    edge-on).
    """
    view = camera_view(camera, terrain.frame)
    plan = plan or plan_scene(
        terrain, sun, view, in_camera_plane=True, accuracy=accuracy, disc=disc, model=model
    )
    check_sun(terrain, sun, disc)
    check_camera(terrain, view)
    origin, rays = camera.rays_enu(terrain.frame)
    points = origin + terrain.field.first_hits(origin, rays)[..., None] * rays
    seen = _in_core(terrain, points)
    normals = np.full(points.shape, np.nan)
    normals[seen] = terrain.field.normals_at(points[seen][:, 0], points[seen][:, 1])
    seen &= ~np.isnan(normals[..., 0])
    points[~seen] = np.nan
    facing = np.sum(normals * sun, axis=-1) > 0
    sunlit = facing.astype(np.float64)
    if shadows:
        sunlit[facing] = _sunlit_points(terrain, points[facing], sun, accuracy, plan)
    bands = _bands(normals, sun, -rays, sunlit, seen, model)
    position = terrain.frame.to_mcmf(points)
    return Photograph(bands[0], sunlit, seen, *bands[1:], position_mcmf_m=position)


def check_sun(terrain: Terrain, sun: Array, disc: bool = False) -> None:
    """SunError when the Sun, as a ``disc`` its upper limb, stands below the horizon of even the
    highest node of the area.

    Seen from a height h above the lowest ground around, the horizon of a sphere of that ground dips
    by acos(R / (R + h)).
    """
    step = max(1, max(terrain.field.shape) // 256)
    all_around = terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.field.whole, step))
    radius = np.linalg.norm(all_around, axis=-1)
    lowest_m = float(np.nanmin(radius)) if np.isfinite(radius).any() else np.nan
    for level in terrain.far.levels if terrain.far else ():
        beyond = np.linalg.norm(terrain.frame.to_mcmf(nodes_enu(level, level.whole, 4)), axis=-1)
        lowest_m = float(np.nanmin(beyond, initial=lowest_m))
    limb = (math.degrees(SOLAR_RADIUS_RAD) if disc else 0.0) + _ROUNDING_DEG
    if not _sun_above_horizon_deg(terrain, sun, lowest_m, step) + limb < 0:
        return
    best = _sun_above_horizon_deg(terrain, sun, lowest_m, 1) + limb
    if best < 0:
        raise SunError(
            f"the Sun stands {-best:.2f} deg below the horizon of the area's highest ground: "
            "nothing is lit; state another Sun"
        )


def _sun_above_horizon_deg(terrain: Terrain, sun: Array, lowest_m: float, step: int) -> float:
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


def check_camera(terrain: Terrain, view: View) -> None:
    """CameraError when the camera is under the terrain's surface."""
    if view.position_m is None:
        return
    x, y, z = view.position_m
    ground = float(terrain.field.heights_at(x, y))
    if z < ground:
        name = view.camera.name if view.camera else "the view"
        _, _, height = mcmf_to_lonlat(terrain.frame.to_mcmf(view.position_m))
        raise CameraError(
            f"{name}: the camera is {ground - z:.0f} m under the ground "
            f"({float(height):.0f} m above the reference sphere)"
        )


def _sunlit(terrain: Terrain, sun: Array, accuracy: Accuracy, plan: ScenePlan | None) -> Band:
    """Share of the Sun above the terrain's horizon at the core's nodes, float32; without a plan no
    shadow is cast.
    """
    row0, row1, col0, col1 = terrain.core
    if plan is not None and plan.solar_disc.modelled:
        return sunlit_share(terrain.field, sun, accuracy, terrain.core, far=terrain.far)
    if plan is not None and plan.cast_shadows.modelled:
        dark = occluded(terrain.field, sun, accuracy, terrain.core, terrain.far)
        return (~dark).astype(np.float32)
    return np.ones((row1 - row0, col1 - col0), dtype=np.float32)


def _sunlit_points(
    terrain: Terrain, points: Array, sun: Array, accuracy: Accuracy, plan: ScenePlan
) -> Array:
    """The same at ENU points (n, 3) of the surface, float64 (n,)."""
    if plan.solar_disc.modelled:
        return share_at_points(terrain.field, points, sun, accuracy, far=terrain.far)
    if plan.cast_shadows.modelled:
        return (~Points(terrain.field, points, terrain.far).occluded(sun)).astype(np.float64)
    return np.ones(len(points))


def _parallel(terrain: Terrain, view: View) -> View:
    """The view of parallel rays, which one at infinity is already."""
    return view if view.direction is not None else parallel_view(terrain, view)


def _hidden(terrain: Terrain, view: View, accuracy: Accuracy) -> Mask:
    if view.direction is not None:
        return occluded(terrain.field, view.direction, accuracy, terrain.core)
    assert view.position_m is not None
    return terrain.field.occluded_nodes_from(view.position_m, terrain.core)


def _in_core(terrain: Terrain, points: Array) -> Mask:
    """Hits within half a cell of the core window's nodes; False for NaN."""
    row0, row1, col0, col1 = terrain.core
    field = terrain.field
    col = (points[..., 0] - field.x0_m) / field.gsd_m
    row = (field.y0_m - points[..., 1]) / field.gsd_m
    inside = (row >= row0 - 0.5) & (row <= row1 - 0.5) & (col >= col0 - 0.5) & (col <= col1 - 0.5)
    return np.asarray(inside)


def _bands(
    normals: Array, sun: Array, to_camera: Array, sunlit: Band, seen: Mask, model: str
) -> tuple[Array, Array, Array, Array]:
    """Radiance factor; incidence, emission and phase in degrees."""
    bands = photometry(normals, sun, to_camera, sunlit > 0.0, seen, model)
    angles = [np.degrees(band) for band in bands[1:]]
    return bands.radiance * sunlit, angles[0], angles[1], angles[2]
