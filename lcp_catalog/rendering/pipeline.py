"""One render, from the request to the bands: the terrain, the scene plan and the image.

Images of line scanners and push-frame cameras: each line from its own position, at its own time.

The image is rendered in parts of successive rows, with whole framelets of a push-frame camera. The rows
of a part share one direction to the Sun, that of the time of its middle. A part lasts so short that the
Sun moves by at most `SUN_MOVES_DEG` from there to its ends.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras.frame_camera import Camera
from ..cameras.scanners import Scanner
from ..cameras.view import CameraView, ScannerView, View
from ..constants import SOLAR_RADIUS_RAD
from ..dem.disagreements import warn_of_disagreements
from ..dem.mosaic import DemSet
from ..dem.plausibility import warn_of_doubts
from ..errors import CameraError, ImageError
from ..geometry.frames import Direction, EnuFrame
from ..light.bounced_light import BOUNCE_RMS, SHOWS, bounced_bound, bounced_sample
from ..light.sky_sampling import SKY_FLOOR_RAD, sky_rms
from ..light.sources import Lighting, light_above_horizon
from ..photometry.albedo_map import AlbedoMap, ColourMap
from ..photometry.laws import Reflectance
from ..stages import stage, timed
from ..terrain.area import Area, NodeWindow
from ..terrain.surroundings import SunRays, build_surrounded, surroundings
from ..terrain.terrain import Terrain, terrain_from_area
from ..terrain.useful_cell import warn_of_region
from . import decisions
from .decisions import Decision
from .placement import RING_MAX_M, area_of, cells_extent, place_on_terrain
from .plan import ScenePlan, choose_model, parallel_view, plan_scene, ring_decision
from .renderer import Method, Rendering, render_camera, render_enu
from .request import Backdrop, Request, composite
from .scene import Scene, require_visible
from .sphere_pipeline import SphereScene, prepare_sphere
from .sphere_renderer import render_sphere_camera, render_sphere_enu

log = logging.getLogger(__name__)

SUN_MOVES_DEG = 0.001
"""Greatest angle between the Sun's direction at a line and the direction under which it is rendered."""

_PIXELS_AT_ONCE = 1 << 21
_EFFECT, _UNIT = "motion of the Sun", "deg"


@dataclass(frozen=True, eq=False)
class MovingSun:
    """Light of the lines of a scanner's image: ``light`` at time 0 of the trajectory, in a frame's axes.

    ``deg_per_s``: rate of the Sun's direction; 0 if one direction holds for all lines.
    """

    request: Request
    frame: EnuFrame
    light: Lighting
    deg_per_s: float

    @classmethod
    def of(cls, request: Request, frame: EnuFrame, light: Lighting) -> tuple[MovingSun, Decision]:
        """The light of a request's scanner, and the decision about its motion. Nodes (an image that is
        not in the camera's plane) have one Sun.
        """
        scanner = request.view.scanner
        assert scanner is not None
        lasts = f"its {scanner.shape[0]} lines take {scanner.duration_s:.3g} s"
        sun = request.sun.drift_mcmf(scanner, scanner.duration_s)
        if request.environment is not None or sun is None:
            reason = f"the stated light holds for all lines; {lasts}"
            return cls(request, frame, light, 0.0), Decision(_EFFECT, False, reason, 0.0, _UNIT)
        drift_deg = math.degrees(float(np.linalg.norm(sun)))
        moves = f"{lasts}, in which the Sun moves by {drift_deg:.2g} deg"
        if not request.in_camera_plane or _parts_for(drift_deg) == 1:
            reason = f"{moves}: one direction, that of the middle, for all"
            decision = Decision(_EFFECT, False, reason, 0.5 * drift_deg, _UNIT)
            return cls(request, frame, light, 0.0), decision
        reason = f"{moves}: parts of the image are rendered under the Sun of their own middle"
        decision = Decision(_EFFECT, True, reason, SUN_MOVES_DEG, _UNIT)
        return cls(request, frame, light, drift_deg / scanner.duration_s), decision

    def at(self, seconds: float) -> Lighting:
        """The light at a time of the trajectory."""
        moved = self.request.sun.drift_mcmf(self.request.view.scanner, seconds)
        if self.deg_per_s == 0.0 or moved is None:
            return self.light
        first, *others = self.light.sources
        to_sun = self.frame.direction_to_mcmf(first.direction) + moved
        there = Direction.from_mcmf(to_sun / np.linalg.norm(to_sun), self.frame)
        return replace(self.light, sources=(replace(first, direction=there), *others))


def render_scan(
    scanner: Scanner, sun: MovingSun, rendered: Callable[[Scanner, Lighting], Rendering]
) -> Rendering:
    """Render the plane of a scanner; ``rendered``: the render of a part of it under its light."""
    shots = [rendered(part, sun.at(part.middle_s)) for part in _parts(scanner, sun.deg_per_s)]
    bands: dict[str, Any] = {}
    for name in (one.name for one in fields(Rendering)):
        rows = [getattr(shot, name) for shot in shots]
        axis = 1 if name == "colour" else 0
        bands[name] = None if rows[0] is None else np.concatenate(rows, axis=axis)
    return replace(shots[0], **bands)


def _parts_for(drift_deg: float) -> int:
    return max(1, math.ceil(drift_deg / (2.0 * SUN_MOVES_DEG)))


def _parts(scanner: Scanner, deg_per_s: float) -> Sequence[Scanner]:
    """Parts of an image in the order of its rows, for a Sun of a rate."""
    (rows, cols), drift_deg = scanner.shape, deg_per_s * scanner.duration_s
    count = max(_parts_for(drift_deg), math.ceil(rows * cols / _PIXELS_AT_ONCE))
    return scanner.divided(count)


@dataclass(frozen=True, eq=False)
class HeightfieldScene(Scene):
    """A scene of terrain."""

    terrain: Terrain
    moving: MovingSun | None = None
    """The light of the lines of a scanner."""

    @property
    def frame(self) -> EnuFrame:
        """The area's frame."""
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

    def expose(self) -> Rendering:
        """Render. CameraError if the camera sees nothing of the area, SunError if nothing is lit."""
        exposed = self._expose_terrain if self.plan.relief.modelled else self._expose_sphere
        return require_visible(self, exposed())

    def _expose_sphere(self) -> Rendering:
        """An area so smooth and level that the plan replaces it by the sphere."""
        model, albedo = self.model, self.request.albedo
        if not self.request.in_camera_plane:
            frame, window, gsd_m = self.frame, self.window, self.gsd_m
            return render_sphere_enu(
                frame, window, gsd_m, self.light, self.view, model=model, albedo=albedo
            )
        extent = cells_extent(self.window, self.gsd_m)
        return render_sphere_camera(
            self.frame, self.camera, self.light, model=model, albedo=albedo, extent_m=extent
        )

    def _expose_terrain(self) -> Rendering:
        request = self.request
        if not request.in_camera_plane:
            return render_enu(self.terrain, self.light, self.view, self._how)
        if isinstance(self.view, ScannerView):
            return self.picture(self.view.scanner)
        result = self.picture(self.camera)
        if request.backdrop is None:
            return result
        panorama = request.environment.in_factors if request.environment else None
        light = light_above_horizon(self.terrain, self.light)
        whole = composite(
            result, self.terrain, self.camera, light, request.backdrop, panorama, request.accuracy
        )
        return replace(result, composite=whole)

    def picture(self, camera: Camera | Scanner) -> Rendering:
        """Render the plane of the scene's camera, or of a part of it, on the heightfield."""
        if isinstance(camera, Scanner):
            assert self.moving is not None
            return render_scan(
                camera,
                self.moving,
                lambda part, light: render_camera(self.terrain, part, light, self._how),
            )
        return render_camera(self.terrain, camera, self.light, self._how)

    @property
    def _how(self) -> Method:
        request = self.request
        return Method(self.model, accuracy=request.accuracy, plan=self.plan, albedo=request.albedo)


def render(request: Request) -> Rendering:
    """Render an image: `prepare`, then `Scene.expose`. Raises the library's errors (`errors`) for a
    request that cannot be rendered.
    """
    return prepare(request).expose()


def prepare(request: Request) -> Scene:
    """The scene of a request, on terrain or on the plain sphere. Raises the library's errors for a
    request that cannot be rendered. For ``surface="sphere"`` a DEM gives only the area and the cell
    size. Logs a warning for a stated area that the DEM does not fill or resolve.
    """
    if request.surface == "sphere":
        return _prepare_sphere(request)
    if isinstance(request.area, Area):
        warn_of_region(request.ground, request.area, request.gsd_m)
    return prepare_terrain(request)


def prepare_terrain(request: Request) -> HeightfieldScene:
    """The scene of a request on its DEM's terrain; ``request.surface`` is not "sphere"."""
    if request.view.scanner is not None and request.backdrop is not None:
        raise CameraError(
            f"{request.view.scanner.name}: is a {request.view.scanner.kind}; a background and a shadow "
            "catcher need a framing camera: give a CAMERA.json"
        )
    stage("heights")
    dems = request.ground
    dems.require_surface()
    area, grows = area_of(request)
    warn_of_disagreements(dems, area.bounds, shifts=False)
    warn_of_doubts(dems, area.bounds)
    light = request.lighting(area.frame)
    terrain, view, ring = _ground(request, area, grows, light)
    choice = timed("reflectance")(choose_model)(
        terrain, light.first.direction.vector, view, request.accuracy, request.model
    )
    plan = plan_scene(
        terrain,
        light.first.direction.vector,
        view,
        in_camera_plane=request.in_camera_plane,
        ring=ring,
        accuracy=request.accuracy,
        disc=light.first.disc is not None,
        disc_radius_rad=light.first.radius_rad or SOLAR_RADIUS_RAD,
        model=choice.model,
        choice=choice,
        albedo=_albedo_decision(request.albedo, terrain),
        sphere_may_do=request.surface == "auto"
        and light.sky is None
        and not light.others  # for a single source alone the bounds of the plain sphere hold
        and not request.backdrop
        and not isinstance(view, ScannerView),
        words=decisions.LightWords.of(light),
        scattered=_bounced(request, terrain, light, view, choice.model),
    )
    others, moving = [*_of_light(request, light, view)], None
    if isinstance(view, ScannerView):
        moving, motion = MovingSun.of(request, area.frame, light)
        others.append(motion)
    plan = replace(plan, others=(*plan.others, *others))
    files = _files(request, dems, choice.model)
    _log_scene(terrain, light, choice.model, plan)
    return HeightfieldScene(request, light, choice.model, view, plan, files, terrain, moving)


def _log_scene(terrain: Terrain, light: Lighting, model: Reflectance, plan: ScenePlan) -> None:
    """Log what is rendered and, in detail, the scene plan."""
    frame, field, (row0, row1, col0, col1) = terrain.frame, terrain.field, terrain.core
    first = light.first.direction
    log.info(
        "terrain around %.4f, %.4f: %d x %d nodes of %.5g m, %d x %d with its surroundings",
        *(
            frame.lon_deg,
            frame.lat_deg,
            col1 - col0,
            row1 - row0,
            field.gsd_m,
            *field.z_m.shape[::-1],
        ),
    )
    log.info(
        "light from azimuth %.2f, elevation %.2f; %s; modelled: %s",
        *(first.azimuth_deg, first.elevation_deg, model.name),
        ", ".join(one.effect for one in plan.decisions if one.modelled) or "nothing else",
    )
    for one in plan.decisions:
        log.debug("%s: %s: %s", one.effect, "modelled" if one.modelled else "not", one.reason)


def _ground(
    request: Request, area: Area, grows: bool, light: Lighting
) -> tuple[Terrain, View, Decision]:
    """The terrain of an area with the terrain around it that can shadow or hide it, the view, and the
    decision about the terrain around. ``grows``: enlarge the area to hold all that the camera sees.
    """
    place = timed("relief")(place_on_terrain)(request, area, grows)
    lowest = light.lowest_tangent
    if light.sky is not None:
        lowest = min(lowest, math.tan(SKY_FLOOR_RAD))
    ring_m = min(place.ring_m, RING_MAX_M)
    around = timed("terrain beyond the area")(surroundings)(
        place.ground, SunRays.all_around(lowest), ring_m
    )
    terrain = timed("relief")(build_surrounded)(place.ground, around)
    if not np.isfinite(terrain.field.z_m[slice(*terrain.core[:2]), slice(*terrain.core[2:])]).any():
        terrain_from_area(request.ground, area, place.ground.gsd_m)  # raises the error
    needed_m = max(around.needed_m, place.ring_m)
    return terrain, place.view, ring_decision(terrain, around.ring_m, needed_m)


def _files(request: Request, dems: DemSet, model: Reflectance) -> tuple[Path, ...]:
    """Every file that a render reads, once, except the camera's."""
    files = list(dems.files)
    files += [model.file] if model.file else []
    for asked in (request.albedo, request.environment, request.backdrop):
        files += asked.files if asked else ()
    return tuple(dict.fromkeys(files))


def _prepare_sphere(request: Request) -> SphereScene:
    """The scene on the plain sphere; a DEM, if there is one, gives the area and the cell size."""
    if request.view.scanner is not None:
        raise CameraError(
            f"{request.view.scanner.name}: is a {request.view.scanner.kind}; the plain sphere is rendered "
            "for framing cameras: give a DEM and `surface` heightfield"
        )
    if request.environment is not None or request.backdrop is not None:
        raise ImageError(
            "an environment map, a background and a shadow catcher need terrain: give a DEM and "
            "`surface` heightfield"
        )
    scene = prepare_sphere(request)
    others = (*scene.plan.others, *_of_light(request, scene.light, scene.view))
    return replace(scene, plan=replace(scene.plan, others=others))


@timed(decisions.SCATTERED)
def _bounced(
    request: Request, terrain: Terrain, light: Lighting, view: View, model: Reflectance
) -> Decision:
    """The decision about light that reaches ground by way of other ground."""
    sample = None
    if request.bounce != "off" and light.first.irradiance > 0.0:
        one_way = parallel_view(terrain, view) if isinstance(view, CameraView) else view
        sample = bounced_sample(terrain, light, one_way.direction, model)
    bound = bounced_bound(terrain.field, model)
    words, tier = decisions.LightWords.of(light), request.accuracy.tier
    return decisions.bounced_light(
        request.bounce, words, bound, sample, BOUNCE_RMS[tier], SHOWS[tier]
    )


def _of_light(request: Request, light: Lighting, view: View) -> Iterator[Decision]:
    """Decisions about light besides the first source, and about the background."""
    if light.others:
        plane = request.in_camera_plane
        rays = decisions.EVERY_PIXEL if plane else decisions.RayMethod.of(request.accuracy)
        yield decisions.several_sources(len(light.others), rays)
    if light.sky is not None and request.environment is not None:
        samples = request.accuracy.sky_directions
        rms = sky_rms(request.accuracy, request.in_camera_plane)
        name = request.environment.panorama.name
        yield decisions.sky_light(name, light.sky.power_above, samples, rms)
        yield decisions.sun_over_sky(request.environment)
    if request.backdrop is not None and view.camera is not None:
        yield _background(request, request.backdrop, view.camera)


def _background(request: Request, backdrop: Backdrop, camera: Camera) -> Decision:
    """The decision about the background; a warning if it is much coarser than the camera."""
    panorama = request.environment.panorama if request.environment else None
    found = decisions.background(*backdrop.resolution(camera, panorama))
    if found.error_bound is not None and found.error_bound > decisions.BACKGROUND_PX:
        log.warning("the background is blurred: %s", found.reason)
    return found


def _albedo_decision(albedo: AlbedoMap | ColourMap | None, terrain: Terrain) -> Decision | None:
    """The decision about an albedo map; AlbedoError if it covers nothing of the area."""
    if albedo is None:
        return None
    where = f"around {terrain.frame.lon_deg:.6g}, {terrain.frame.lat_deg:.6g}"
    return decisions.albedo(albedo, albedo.check_cover(albedo.cover(terrain), where))
