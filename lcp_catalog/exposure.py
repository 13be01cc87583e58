"""One render, from what was asked for to the bytes of a file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import scene_effects as effects
from . import sun
from ._version import __version__
from .accuracy import TIERS, Accuracy
from .albedo import AlbedoMap
from .camera import Camera
from .compositing import Backdrop, composite
from .constants import FRAME, HIGHEST_M, LOWEST_M, MOON_RADIUS_M, SOLAR_RADIUS_RAD
from .demset import DemSet
from .disagreement import warn_of_disagreements
from .earthshine import earth_at, mean_earth
from .environment import Environment
from .errors import AreaError, CameraError, ImageError, SunError
from .grid import Bounds
from .lighting import Lighting
from .panorama_sky import SAMPLES, SKY_FLOOR_RAD, sky_rms
from .raster_out import geotiff, node_transform, orthographic_crs
from .reflectance import Reflectance
from .relief import (
    COARSE_NODES,
    COARSE_SLOPE,
    lowest_view_tangent,
    nodes_enu,
    ring_needed_m,
)
from .render import Photograph, render_camera, render_enu, risen
from .scene import ScenePlan, choose_model, plan_scene, ring_decision
from .scene_effects import Decision
from .solar_disc import MEAN_SUN, SolarDisc, radius_at
from .sphere import EnuFrame, azimuth_elevation, lonlat_to_mcmf
from .sphere_render import render_sphere_camera, render_sphere_enu
from .sphere_scene import Cap, SphereScene, expose_sphere, prepare_sphere
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
_WIDER = "render the plain sphere: --surface sphere"

SURFACES = ("auto", "heightfield", "sphere")
"""What stands for the ground: as the scene plan says, the DEM's heights, or the plain sphere."""


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

    def instant(self, camera: Camera | None) -> str | None:
        """The time that is stated, or the camera's where no Sun is."""
        if self.time_utc is not None or self._is_direction:
            return self.time_utc
        return None if camera is None else camera.time_utc

    def disc(self, frame: EnuFrame, camera: Camera | None) -> SolarDisc:
        """The Sun's disc by its distance, where a position or an instant says that; else the mean
        one.
        """
        position = None if camera is None else camera.sun_position_mcmf_m
        if self.time_utc is None and not self._is_direction and position is not None:
            return SolarDisc(radius_at(float(np.linalg.norm(position - frame.origin_mcmf_m))))
        time = self.instant(camera)
        return MEAN_SUN if time is None else SolarDisc(radius_at(sun.sun_distance_m(time)))

    @property
    def _is_direction(self) -> bool:
        return self.azimuth_deg is not None or self.subsolar_deg is not None


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
    ``gsd_m`` None: the DEM's own; ``model`` None: as the scene wants; ``disc``, whether the Sun is one, None: as the accuracy says.
    """

    dem_paths: Sequence[Path | str]
    area: Area | Cap | None = None
    gsd_m: float | None = None
    sun: SunChoice = SunChoice()
    view: ViewChoice = ViewChoice()
    in_camera_plane: bool = False
    model: Reflectance | None = None
    accuracy: Accuracy = TIERS["standard"]
    disc: bool | None = None
    product_order: tuple[str, ...] = ()
    albedo: AlbedoMap | None = None
    surface: str = SURFACES[0]
    environment: Environment | None = None
    earthshine: bool = False
    backdrop: Backdrop | None = None

    def lighting(self, frame: EnuFrame) -> Lighting:
        """What lights the scene, in a frame's axes: the panorama alone; or the Sun, and the Earth
        where it is asked for.
        """
        if self.environment is not None:
            return self.environment.lighting
        camera = self.view.camera
        to_sun = self.sun.direction_mcmf(frame, camera)
        disc = self.sun.disc(frame, camera) if self.sun_is_disc else False
        light = Lighting.of_sun(frame.direction_from_mcmf(to_sun), disc)
        if not self.earthshine:
            return light
        time = self.sun.instant(camera)
        earth = mean_earth(to_sun) if time is None else earth_at(time)
        return light.with_source(earth.source(frame, self.sun_is_disc))

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
    model: Reflectance
    view: View
    plan: ScenePlan
    sources: tuple[Path, ...]  # every file that heights and albedo come from

    @property
    def sun(self) -> Array:
        """ENU direction to the first source."""
        return self.light.first.direction

    @property
    def frame(self) -> EnuFrame:
        """The area's."""
        return self.terrain.frame

    @property
    def gsd_m(self) -> float:
        """Cell size."""
        return self.terrain.field.gsd_m

    @property
    def corner_m(self) -> tuple[float, float]:
        """ENU x and y of the core's first node."""
        field, (row0, _, col0, _) = self.terrain.field, self.terrain.core
        return field.x0_m + col0 * field.gsd_m, field.y0_m - row0 * field.gsd_m

    @property
    def window(self) -> NodeWindow:
        """The core's nodes, counted from the frame's origin."""
        (x, y), (row0, row1, col0, col1) = self.corner_m, self.terrain.core
        row, col = round(-y / self.gsd_m), round(x / self.gsd_m)
        return NodeWindow(row, row + row1 - row0, col, col + col1 - col0)

    @property
    def camera(self) -> Camera:
        """The camera whose plane is rendered."""
        assert self.view.camera is not None
        return self.view.camera


def prepare(request: Request) -> Scene | SphereScene:
    """Read the terrain and decide; raises the library's errors for what cannot be rendered. On the
    sphere that was asked for a DEM gives no more than its area and cell size.
    """
    if request.surface == "sphere":
        return _prepare_sphere(request)
    dems = DemSet.open(request.dem_paths, request.product_order)
    area, grows = _area(request, dems)
    warn_of_disagreements(dems, area.bounds)
    frame = area.frame
    lit_by = request.lighting(frame)
    to_sun, disc = lit_by.first.direction, lit_by.first.disc is not None
    view = request.view.view(frame)
    gsd_m = native_gsd_m(dems, area) if request.gsd_m is None else request.gsd_m
    if not 0.0 < gsd_m < math.inf:
        raise AreaError(f"a cell of {gsd_m:g} m is none; --gsd must be positive")
    extent = area.extent_m
    _require_extent(extent)
    require_room(NodeWindow.covering(extent, gsd_m))
    if request.in_camera_plane and view.camera is None:
        view = replace(view, camera=_looking_camera(frame, view, gsd_m, extent))
    light = lit_by.lowest_tangent
    if lit_by.sky is not None:
        light = min(light, math.tan(SKY_FLOOR_RAD))
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
    choice = choose_model(terrain, to_sun, view, request.accuracy.tier, request.model)
    plan = plan_scene(
        terrain,
        to_sun,
        view,
        in_camera_plane=request.in_camera_plane,
        ring=ring_decision(terrain, around.ring_m, needed_m),
        accuracy=request.accuracy,
        disc=disc,
        disc_radius_rad=lit_by.first.radius_rad or SOLAR_RADIUS_RAD,
        model=choice.model,
        choice=choice,
        albedo=_albedo_decision(request.albedo, terrain),
        sphere_may_do=request.surface == "auto" and _sun_alone(lit_by) and not request.backdrop,
    )
    plan = replace(plan, others=(*plan.others, *_of_light(request, lit_by)))
    files = [path for dem in dems.dems for path in dem.files]
    files += [choice.model.file] if choice.model.file else []
    files += request.albedo.files if request.albedo else ()
    files += request.environment.files if request.environment else ()
    files += request.backdrop.files if request.backdrop else ()
    sources = tuple(dict.fromkeys(files))
    return Scene(request, terrain, lit_by, choice.model, view, plan, sources)


def expose(scene: Scene | SphereScene) -> Photograph:
    """Render a scene; CameraError when the camera sees nothing of the area."""
    if isinstance(scene, SphereScene):
        result = expose_sphere(scene)
    elif not scene.plan.relief.modelled:
        result = _expose_plain(scene)
    else:
        result = _expose_terrain(scene)
    if not result.visible.any() and scene.request.backdrop is None:
        who = scene.view.camera.name if scene.view.camera else "the view"
        raise CameraError(f"{who}: the camera sees nothing of the area")
    return result


def _expose_plain(scene: Scene) -> Photograph:
    """An area so smooth and level that the sphere may stand for it."""
    request = scene.request
    how: dict[str, Any] = {"model": scene.model, "albedo": request.albedo}
    if not request.in_camera_plane:
        light = scene.light, scene.view
        return render_sphere_enu(scene.frame, scene.window, scene.gsd_m, *light, **how)
    (x, y), half, (rows, cols) = scene.corner_m, 0.5 * scene.gsd_m, scene.window.shape
    extent = (x - half, x + (cols - 0.5) * scene.gsd_m, y - (rows - 0.5) * scene.gsd_m, y + half)
    return render_sphere_camera(scene.frame, scene.camera, scene.light, extent_m=extent, **how)


def _expose_terrain(scene: Scene) -> Photograph:
    request = scene.request
    how: dict[str, Any] = {"model": scene.model, "accuracy": request.accuracy}
    how |= {"plan": scene.plan, "albedo": request.albedo}
    if not request.in_camera_plane:
        return render_enu(scene.terrain, scene.light, scene.view, **how)
    result = render_camera(scene.terrain, scene.camera, scene.light, **how)
    if request.backdrop is None:
        return result
    panorama = request.environment.in_factors if request.environment else None
    place = scene.terrain, scene.camera, risen(scene.terrain, scene.light)
    whole = composite(result, *place, request.backdrop, panorama, request.accuracy)
    return replace(result, composite=whole)


def encode(scene: Scene | SphereScene, result: Photograph) -> bytes:
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
        units += ["metre"] * 3
        if result.composite is not None:
            bands["composite"] = result.composite
            units.append("1")
        return geotiff(bands, "float64", tags(scene), units=units)
    assert result.height_m is not None
    bands["height"] = result.height_m
    assert scene.gsd_m is not None
    transform = node_transform(*scene.corner_m, scene.gsd_m)
    crs = orthographic_crs(scene.frame)
    return geotiff(bands, "float32", tags(scene), crs, transform, [*units, "metre"])


def tags(scene: Scene | SphereScene) -> dict[str, str]:
    """What a result says about its making; no paths, no clock."""
    frame = scene.frame
    azimuth, elevation = azimuth_elevation(scene.sun)
    gsd = {} if scene.gsd_m is None else {"gsd_m": repr(float(scene.gsd_m))}
    found = {
        "body": "MOON",
        "frame": FRAME,
        "software": f"lcp {__version__}",
        "center_lon": repr(float(frame.lon_deg)),
        "center_lat": repr(float(frame.lat_deg)),
        "reference_radius_m": repr(MOON_RADIUS_M),
        **gsd,
        "sun_azimuth": repr(float(azimuth)),
        "sun_elevation": repr(float(elevation)),
        "sun_direction_mcmf": json.dumps(frame.direction_to_mcmf(scene.sun).tolist()),
        "camera": json.dumps(scene.view.describe(), sort_keys=True),
        "sun_model": "disc" if scene.light.first.disc is not None else "point",
        "light": json.dumps(scene.light.describe(), sort_keys=True),
        "reflectance": scene.model.name,
        "accuracy": scene.request.accuracy.tier,
        "surface": "heightfield" if scene.plan.relief.modelled else "sphere",
        "dem": json.dumps([Path(path).name for path in scene.request.dem_paths]),
        "scene_plan": str(scene.plan),
    }
    if scene.request.environment is not None:
        found["environment"] = json.dumps(scene.request.environment.report, sort_keys=True)
    return found | ({"albedo": str(scene.request.albedo)} if scene.request.albedo else {})


def explain(scene: Scene | SphereScene) -> dict[str, Any]:
    """The document of ``lcp render --explain``: the plan's decisions, and the light."""
    light = scene.light.describe()
    if scene.request.environment is not None:
        light["environment"] = scene.request.environment.report
    return scene.plan.to_json() | {"light": light}


def _prepare_sphere(request: Request) -> SphereScene:
    """The sphere that was asked for; a DEM, if there is one, says which area and how fine."""
    if request.environment is not None or request.backdrop is not None:
        raise ImageError(
            "a panorama, a background and a shadow catcher belong to terrain: the plain sphere has none; "
            "give a DEM, and --surface heightfield"
        )
    gsd_m: float | None = None
    files: tuple[Path, ...] = ()
    if request.dem_paths:
        dems = DemSet.open(request.dem_paths, request.product_order)
        files = tuple(dict.fromkeys(path for dem in dems.dems for path in dem.files))
        if request.area is None and not (request.in_camera_plane and request.view.camera):
            request = replace(request, area=_area(request, dems)[0])
        gsd_m = min(dem.gsd_m for dem in dems.dems)
    scene = prepare_sphere(request, request.lighting, gsd_m)
    plan = replace(scene.plan, others=(*scene.plan.others, *_of_light(request, scene.light)))
    return replace(scene, plan=plan, sources=(*files, *scene.sources))


def _sun_alone(light: Lighting) -> bool:
    """Whether one source lights the scene: what the plan's bounds speak of."""
    return light.sky is None and not light.others


def _of_light(request: Request, light: Lighting) -> Iterator[Decision]:
    """Decisions about what lights the scene besides its first source."""
    if light.others:
        yield effects.several_sources(len(light.others))
    if light.sky is not None and request.environment is not None:
        samples = SAMPLES[request.accuracy.tier]
        rms = sky_rms(request.accuracy, request.in_camera_plane)
        name = request.environment.panorama.name
        yield effects.sky_light(name, light.sky.power_above, samples, rms)


def _albedo_decision(albedo: AlbedoMap | None, terrain: Terrain) -> Decision | None:
    """What a map of brightness does over the area; AlbedoError when it covers nothing of it."""
    if albedo is None:
        return None
    where = f"around {terrain.frame.lon_deg:.6g}, {terrain.frame.lat_deg:.6g}"
    return effects.albedo(albedo, albedo.check_cover(albedo.cover(terrain), where))


def _area(request: Request, dems: DemSet) -> tuple[Area, bool]:
    """The area, and whether it is to grow so that it holds what the camera sees of high and low
    ground.
    """
    if isinstance(request.area, Cap):
        raise AreaError(
            f"{request.area.size_km[0]:g} x {request.area.size_km[1]:g} km: only the plain sphere is drawn so wide"
        )
    if request.area is not None:
        return request.area, False
    if request.view.camera is not None:
        seen = footprint(request.view.camera)
        box = _clipped(seen, dems.bounds)
        if box is None:
            name = request.view.camera.name
            raise AreaError(f"{name}: the camera sees {seen}; the DEM covers {dems.bounds}")
        return _box_area(box, request), True
    return _box_area(dems.bounds, request), False


def _box_area(box: Bounds, request: Request) -> Area:
    """The area of a box; around a pole that lies inside, a square centred there."""
    if box.east - box.west < 360.0 - 1e-9:
        return Area.from_bounds(*box)
    for pole, equatorward in ((90.0, box.south), (-90.0, -box.north)):
        if abs(box.north if pole > 0 else box.south) == abs(pole) and equatorward > 0:
            size_km = 2e-3 * MOON_RADIUS_M * math.cos(math.radians(equatorward))
            return Area(0.0, pole, min(size_km, _EXTENT_MAX_M / 1e3))
    wider = "" if request.surface == "sphere" else f", or {_WIDER}"
    raise AreaError(f"{box} does not fit into one plane: state --center and --size, or --bounds{wider}")


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
            f"(limit {_EXTENT_MAX_M / 1e3:.0f} km): state a smaller --size or --bounds, or {_WIDER}"
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
    reach_m = min(reach_m, _dem_beyond_m(dems.bounds, frame, extent_m) + coarse_m)
    window = NodeWindow.covering(extent_m, coarse_m)
    return build_terrain(dems, frame, window, coarse_m, reach_m)


def _dem_beyond_m(
    box: Bounds, frame: EnuFrame, extent_m: tuple[float, float, float, float]
) -> float:
    """How far beyond an area a DEM goes at most, along an axis of the frame: a mock-up of a few metres
    is not looked for over kilometres. inf where it goes on behind the Moon.
    """
    lon, lat = np.linspace(box.west, box.east, 65), np.linspace(box.south, box.north, 65)
    x0, x1, y0, y1 = extent_m
    farthest_m = 0.0
    for edge in ((lon, lat[0]), (lon, lat[-1]), (lon[0], lat), (lon[-1], lat)):
        x, y, z = np.moveaxis(frame.from_mcmf(lonlat_to_mcmf(*edge)), -1, 0)
        if (z < -0.5 * MOON_RADIUS_M).any():
            return math.inf
        beyond = np.maximum(np.maximum(x0 - x, x - x1), np.maximum(y0 - y, y - y1))
        step = np.hypot(np.diff(x), np.diff(y)).max()  # between samples an edge goes no further
        farthest_m = max(farthest_m, float(beyond.max() + step))
    return farthest_m


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
