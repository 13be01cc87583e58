"""One render, from what was asked for to the bytes of a file."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import sun
from ._version import __version__
from .accuracy import TIERS, Accuracy
from .camera import Camera
from .constants import FRAME, HIGHEST_M, LOWEST_M, MOON_RADIUS_M
from .demset import DemSet
from .disagreement import warn_of_disagreements
from .errors import AreaError, CameraError, SunError
from .grid import Bounds
from .lighting import Lighting
from .raster_out import geotiff, node_transform, orthographic_crs
from .reflectance import DEFAULT_MODEL, Reflectance
from .relief import (
    COARSE_NODES,
    COARSE_SLOPE,
    lowest_view_tangent,
    nodes_enu,
    ring_needed_m,
    tangent_of,
)
from .render import Photograph, render_camera, render_enu
from .scene import ScenePlan, plan_scene, ring_decision
from .scene_bounds import limb_tangent
from .sphere import EnuFrame, azimuth_elevation
from .surroundings import build_surrounded, surroundings
from .terrain import (
    Area,
    NodeWindow,
    Terrain,
    build_terrain,
    native_gsd_m,
    require_room,
    terrain_from_area,
)
from .view import View, camera_view, footprint, looking_camera, oblique_view

Array = NDArray[np.float64]

RING_MAX_M = 200e3
"""No terrain further from the area than this is looked for that could hide it from the view."""

_EXTENT_MAX_M = 2000e3


@dataclass(frozen=True)
class SunChoice:
    """How the Sun is stated: angles at the area's centre, an instant, or the subsolar point;
    nothing: the camera's own.
    """

    azimuth_deg: float | None = None
    elevation_deg: float | None = None
    time_utc: str | None = None
    subsolar_deg: tuple[float, float] | None = None

    def direction_mcmf(self, frame: EnuFrame, camera: Camera | None) -> Array:
        """Unit MCMF direction to the Sun from a frame's origin; SunError when none is stated."""
        if self.azimuth_deg is not None and self.elevation_deg is not None:
            return sun.direction_from_angles(frame, self.azimuth_deg, self.elevation_deg)
        if self.time_utc is not None:
            return sun.sun_direction_at(self.time_utc)
        if self.subsolar_deg is not None:
            return sun.direction_from_subsolar(*self.subsolar_deg)
        if camera is not None and camera.sun_position_mcmf_m is not None:
            return sun.direction_from_position(frame, camera.sun_position_mcmf_m)
        if camera is not None and camera.time_utc is not None:
            return sun.sun_direction_at(camera.time_utc)
        raise SunError("no Sun is stated, and the camera has none of its own")


@dataclass(frozen=True)
class ViewChoice:
    """From where: a camera, or angles at the area's centre (without an altitude from infinity);
    nothing: straight down.
    """

    camera: Camera | None = None
    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0
    altitude_km: float | None = None

    def view(self, frame: EnuFrame) -> View:
        if self.camera is not None:
            return camera_view(self.camera, frame)
        altitude_m = None if self.altitude_km is None else 1e3 * self.altitude_km
        return oblique_view(self.off_nadir_deg, self.view_azimuth_deg, altitude_m)


@dataclass(frozen=True)
class Request:
    """What one render is to show. ``area`` None: what the camera sees, else the whole DEM;
    ``gsd_m`` None: the DEM's own; ``disc``, whether the Sun is one, None: as the accuracy says.
    """

    dem_paths: Sequence[Path | str]
    area: Area | None = None
    gsd_m: float | None = None
    sun: SunChoice = SunChoice()
    view: ViewChoice = ViewChoice()
    in_camera_plane: bool = False
    model: Reflectance = DEFAULT_MODEL
    accuracy: Accuracy = TIERS["standard"]
    disc: bool | None = None
    product_order: tuple[str, ...] = ()

    @property
    def sun_is_disc(self) -> bool:
        """Whether the Sun is a disc, or a point."""
        return self.accuracy.disc if self.disc is None else self.disc


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything a render needs, and what was decided about it."""

    request: Request
    terrain: Terrain
    light: Lighting
    view: View
    plan: ScenePlan
    sources: tuple[Path, ...]  # every file that heights come from

    @property
    def sun(self) -> Array:
        """ENU direction to the first source."""
        return self.light.first.direction

    @property
    def camera(self) -> Camera:
        """The camera whose plane is rendered."""
        assert self.view.camera is not None
        return self.view.camera


def prepare(request: Request) -> Scene:
    """Read the terrain and decide; raises the library's errors for what cannot be rendered."""
    dems = DemSet.open(request.dem_paths, request.product_order)
    area, grows = _area(request, dems)
    warn_of_disagreements(dems, area.bounds)
    frame = area.frame
    to_sun = frame.direction_from_mcmf(request.sun.direction_mcmf(frame, request.view.camera))
    view = request.view.view(frame)
    gsd_m = native_gsd_m(dems, area) if request.gsd_m is None else request.gsd_m
    if not 0.0 < gsd_m < math.inf:
        raise AreaError(f"a cell of {gsd_m:g} m is none; --gsd must be positive")
    extent = area.extent_m
    _require_extent(extent)
    require_room(NodeWindow.covering(extent, gsd_m))
    if request.in_camera_plane and view.camera is None:
        view = replace(view, camera=_looking_camera(frame, view, gsd_m, extent))
    light = limb_tangent(to_sun) if request.sun_is_disc else tangent_of(to_sun)
    coarse = _coarse_terrain(dems, frame, extent, gsd_m, view)
    if grows:
        extent = _grown(extent, _height_reach_m(coarse, view))
        coarse = _coarse_terrain(dems, frame, extent, gsd_m, view)
    view_ring_m = _view_ring_m(coarse, view)
    place = (dems, frame, NodeWindow.covering(extent, gsd_m), gsd_m)
    around = surroundings(*place, light, min(view_ring_m, RING_MAX_M))
    needed_m = max(around.needed_m, view_ring_m)
    terrain = build_surrounded(*place, around)
    if not np.isfinite(terrain.field.z_m[slice(*terrain.core[:2]), slice(*terrain.core[2:])]).any():
        terrain_from_area(dems, area, gsd_m)  # says what is wrong with the area
    plan = plan_scene(
        terrain,
        to_sun,
        view,
        in_camera_plane=request.in_camera_plane,
        ring=ring_decision(terrain, around.ring_m, needed_m),
        accuracy=request.accuracy,
        disc=request.sun_is_disc,
        model=request.model,
    )
    sources = tuple(dict.fromkeys(path for dem in dems.dems for path in dem.files))
    lit_by = Lighting.of_sun(to_sun, request.sun_is_disc)
    return Scene(request, terrain, lit_by, view, plan, sources)


def expose(scene: Scene) -> Photograph:
    """Render a scene; CameraError when the camera sees nothing of the area."""
    request = scene.request
    how: dict[str, Any] = {"model": request.model, "accuracy": request.accuracy}
    how["plan"] = scene.plan
    if request.in_camera_plane:
        result = render_camera(scene.terrain, scene.camera, scene.light, **how)
    else:
        result = render_enu(scene.terrain, scene.light, scene.view, **how)
    if not result.visible.any():
        who = scene.view.camera.name if scene.view.camera else "the view"
        raise CameraError(f"{who}: the camera sees nothing of the area")
    return result


def encode(scene: Scene, result: Photograph) -> bytes:
    """The GeoTIFF of ``lcp render``."""
    bands: dict[str, ArrayLike] = {
        "radiance": result.radiance,
        "sunlit": result.sunlit,
        "visible": result.visible,
        "incidence": result.incidence_deg,
        "emission": result.emission_deg,
        "phase": result.phase_deg,
    }
    units = ["1", "1", "1", "degree", "degree", "degree"]
    if result.position_mcmf_m is not None:
        bands |= dict(zip("xyz", np.moveaxis(result.position_mcmf_m, -1, 0), strict=True))
        return geotiff(bands, "float64", tags(scene), units=[*units, *["metre"] * 3])
    assert result.height_m is not None
    bands["height"] = result.height_m
    field, (row0, _, col0, _) = scene.terrain.field, scene.terrain.core
    gsd_m = field.gsd_m
    transform = node_transform(field.x0_m + col0 * gsd_m, field.y0_m - row0 * gsd_m, gsd_m)
    crs = orthographic_crs(scene.terrain.frame)
    return geotiff(bands, "float32", tags(scene), crs, transform, [*units, "metre"])


def tags(scene: Scene) -> dict[str, str]:
    """What a result says about its making; no paths, no clock."""
    frame = scene.terrain.frame
    azimuth, elevation = azimuth_elevation(scene.sun)
    return {
        "body": "MOON",
        "frame": FRAME,
        "software": f"lcp {__version__}",
        "center_lon": repr(float(frame.lon_deg)),
        "center_lat": repr(float(frame.lat_deg)),
        "reference_radius_m": repr(MOON_RADIUS_M),
        "gsd_m": repr(float(scene.terrain.field.gsd_m)),
        "sun_azimuth": repr(float(azimuth)),
        "sun_elevation": repr(float(elevation)),
        "sun_direction_mcmf": json.dumps(frame.direction_to_mcmf(scene.sun).tolist()),
        "camera": json.dumps(scene.view.describe(), sort_keys=True),
        "sun_model": "disc" if scene.request.sun_is_disc else "point",
        "reflectance": scene.request.model.name,
        "accuracy": scene.request.accuracy.tier,
        "dem": json.dumps([Path(path).name for path in scene.request.dem_paths]),
        "scene_plan": str(scene.plan),
    }


def _area(request: Request, dems: DemSet) -> tuple[Area, bool]:
    """The area, and whether it is to grow so that it holds what the camera sees of high and low
    ground.
    """
    if request.area is not None:
        return request.area, False
    if request.view.camera is not None:
        seen = footprint(request.view.camera)
        box = _clipped(seen, dems.bounds)
        if box is None:
            name = request.view.camera.name
            raise AreaError(f"{name}: the camera sees {seen}; the DEM covers {dems.bounds}")
        return _box_area(box), True
    return _box_area(dems.bounds), False


def _box_area(box: Bounds) -> Area:
    """The area of a box; around a pole that lies inside, a square centred there."""
    if box.east - box.west < 360.0 - 1e-9:
        return Area.from_bounds(*box)
    for pole, equatorward in ((90.0, box.south), (-90.0, -box.north)):
        if abs(box.north if pole > 0 else box.south) == abs(pole) and equatorward > 0:
            size_km = 2e-3 * MOON_RADIUS_M * math.cos(math.radians(equatorward))
            return Area(0.0, pole, min(size_km, _EXTENT_MAX_M / 1e3))
    raise AreaError(f"{box} does not fit into one plane: state --center and --size, or --bounds")


def _clipped(box: Bounds, limit: Bounds) -> Bounds | None:
    """What two boxes have in common; None for nothing."""
    south, north = max(box.south, limit.south), min(box.north, limit.north)
    if south >= north:
        return None
    if limit.east - limit.west >= 360.0 - 1e-9:
        return Bounds(box.west, south, box.east, north)
    if box.east - box.west >= 360.0 - 1e-9:
        return Bounds(limit.west, south, limit.east, north)
    shared = []
    for turn in (-720.0, -360.0, 0.0, 360.0, 720.0):
        west, east = max(box.west + turn, limit.west), min(box.east + turn, limit.east)
        if west < east:
            shared.append((east - west, Bounds(west, south, east, north)))
    return max(shared)[1] if shared else None


def _require_extent(extent_m: tuple[float, float, float, float]) -> None:
    width, height = extent_m[1] - extent_m[0], extent_m[3] - extent_m[2]
    if max(width, height) > _EXTENT_MAX_M * (1 + 1e-9):
        raise AreaError(
            f"{width / 1e3:.0f} x {height / 1e3:.0f} km do not fit into one plane "
            f"(limit {_EXTENT_MAX_M / 1e3:.0f} km): state a smaller --size or --bounds"
        )


def _looking_camera(
    frame: EnuFrame, view: View, gsd_m: float, extent_m: tuple[float, float, float, float]
) -> Camera:
    if view.position_m is None:
        raise CameraError("a camera at infinity has no plane: state its altitude, or a camera")
    size_m = (extent_m[1] - extent_m[0], extent_m[3] - extent_m[2])
    return looking_camera(frame, view.position_m, gsd_m, size_m)


def _grown(
    extent_m: tuple[float, float, float, float], by_m: float
) -> tuple[float, float, float, float]:
    x0, x1, y0, y1 = extent_m
    return x0 - by_m, x1 + by_m, y0 - by_m, y1 + by_m


def _coarse_terrain(
    dems: DemSet,
    frame: EnuFrame,
    extent_m: tuple[float, float, float, float],
    gsd_m: float,
    view: View,
) -> Terrain:
    """The area and all around it that could hide it, on coarse nodes."""
    coarse_m = COARSE_NODES * gsd_m
    corners = np.array([[x, y, 0.0] for x in extent_m[:2] for y in extent_m[2:]])
    tangent = lowest_view_tangent(view, corners)
    reach_m = min(RING_MAX_M, (HIGHEST_M - LOWEST_M) / tangent) if tangent > 0 else RING_MAX_M
    window = NodeWindow.covering(extent_m, coarse_m)
    return build_terrain(dems, frame, window, coarse_m, reach_m)


def _height_reach_m(coarse: Terrain, view: View) -> float:
    """How far from its place on the sphere a ray of the camera can meet ground that is not at
    height 0.
    """
    points = nodes_enu(coarse.field, coarse.core)
    height = np.linalg.norm(coarse.frame.to_mcmf(points), axis=-1) - MOON_RADIUS_M
    if not np.isfinite(height).any():
        return 0.0
    margin = COARSE_SLOPE * coarse.field.gsd_m
    highest = min(float(np.nanmax(np.abs(height))) + margin, HIGHEST_M)
    tangent = lowest_view_tangent(view, points)
    return min(highest / tangent, RING_MAX_M) if tangent > 0 else RING_MAX_M


def _view_ring_m(coarse: Terrain, view: View) -> float:
    """How far beyond the area terrain can hide it."""
    tangent = lowest_view_tangent(view, nodes_enu(coarse.field, coarse.core))
    if not math.isfinite(tangent):
        return 0.0
    return ring_needed_m(coarse, tangent, COARSE_SLOPE * coarse.field.gsd_m)
