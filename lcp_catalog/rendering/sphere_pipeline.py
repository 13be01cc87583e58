"""A render of the plain sphere, from the request to the bands; no heights are read."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..accuracy import TIERS
from ..arrays import Array
from ..cameras.frame_camera import Camera
from ..constants import HIGHEST_M, LOWEST_M, MOON_RADIUS_M
from ..geometry import sphere_intersection
from ..geometry.frames import EnuFrame, enu_rotation
from ..light.sources import Lighting
from ..photometry.albedo_map import AlbedoMap, ColourMap
from ..photometry.law_choice import SLOPE_RMS, LawChoice, choose
from ..terrain.area import NodeWindow
from . import decisions
from .decisions import Decision
from .placement import SpherePlace, place_on_sphere
from .plan import ScenePlan
from .renderer import Rendering
from .request import Request
from .scene import Scene, require_visible
from .sphere_renderer import render_sphere_camera, render_sphere_enu, sphere_nodes

_SAMPLES = 64
"""Pixels or nodes per side at which a scene is sampled for its plan."""


@dataclass(frozen=True, eq=False)
class SphereScene(Scene):
    """A scene on the plain sphere. Its place has no cell in the plane of a given camera."""

    place: SpherePlace

    @property
    def frame(self) -> EnuFrame:
        """The area's frame."""
        return self.place.frame

    @property
    def gsd_m(self) -> float | None:
        """Cell size of the nodes."""
        return self.place.gsd_m

    @property
    def window(self) -> NodeWindow:
        """The nodes, in the frame's plane."""
        assert self.gsd_m is not None
        assert self.place.extent_m is not None
        return NodeWindow.covering(self.place.extent_m, self.gsd_m)

    @property
    def corner_m(self) -> tuple[float, float]:
        """ENU x and y of the first node."""
        assert self.gsd_m is not None
        return self.window.col0 * self.gsd_m, -self.window.row0 * self.gsd_m

    def expose(self) -> Rendering:
        """Render. CameraError if the camera sees nothing of the sphere or is below it, SunError if
        nothing is lit.
        """
        camera = self.view.camera
        model, albedo = self.model, self.request.albedo
        if self.request.in_camera_plane and camera is not None:
            result = render_sphere_camera(
                self.frame,
                camera,
                self.light,
                model=model,
                albedo=albedo,
                extent_m=self.place.extent_m,
            )
        else:
            assert self.gsd_m is not None
            frame, window, gsd_m = self.frame, self.window, self.gsd_m
            result = render_sphere_enu(
                frame, window, gsd_m, self.light, self.view, model=model, albedo=albedo
            )
        return require_visible(self, result)


def prepare_sphere(request: Request) -> SphereScene:
    """The scene of a request. Raises the library's errors for a request that cannot be rendered."""
    place = place_on_sphere(request)
    frame, view = place.frame, place.view
    light = request.lighting(frame)
    points, towards, pixel_m = _sample(request, place)
    choice = _choose(request, frame, light, points, towards)
    albedo = request.albedo
    covered = _albedo_decision(albedo, frame, points, pixel_m) if albedo else None
    shift_px = _shift_px(points, towards, pixel_m)
    half_m = 0.5 * float(np.linalg.norm(np.ptp(points, axis=0)))
    pixels = request.in_camera_plane
    rays = decisions.perspective_of_pixels() if pixels else decisions.perspective_of_nodes()
    plan = _plan(light, choice, shift_px, half_m, rays, covered)
    files = request.dems.files if request.dems else ()
    files += tuple(albedo.files) if albedo else ()
    files += (choice.model.file,) if choice.model.file else ()
    return SphereScene(request, light, choice.model, view, plan, files, place)


def _sample(request: Request, place: SpherePlace) -> tuple[Array, Array, Array]:
    """Sample points (n, 3) of the rendered part, MCMF, unit directions (n, 3) to the camera, and the
    width (n,) of a pixel there, across the line of sight.
    """
    frame, view, camera = place.frame, place.view, place.view.camera
    if request.in_camera_plane and camera is not None:
        rows, cols = (np.unique(np.linspace(0, n - 1, _SAMPLES).round()) for n in camera.shape)
        rays = camera.rays(np.stack(np.meshgrid(cols, rows), axis=-1)).reshape(-1, 3)
        away, points = sphere_intersection.hits(camera.position_mcmf_m, rays)
        seen = np.isfinite(away)
        if not seen.any():
            away, points, rays = _under(camera)
            seen = np.ones(1, dtype=np.bool_)
        return points[seen], -rays[seen], away[seen] / camera.focal_length_px
    assert place.extent_m is not None
    assert place.gsd_m is not None
    west, east, south, north = place.extent_m
    x, y = np.meshgrid(np.linspace(west, east, _SAMPLES), np.linspace(south, north, _SAMPLES))
    nodes = sphere_nodes(x, y).reshape(-1, 3)
    nodes = nodes[np.isfinite(nodes[:, 2])]
    if not len(nodes):
        nodes = np.zeros((1, 3))
    towards = frame.direction_to_mcmf(view.directions(nodes))
    points = frame.to_mcmf(nodes)
    facing = np.sum(points * towards, axis=-1) > 0.0
    facing |= not facing.any()
    return points[facing], towards[facing], np.full(int(facing.sum()), place.gsd_m)


def _under(camera: Camera) -> tuple[Array, Array, Array]:
    """The point below a camera, as from `sphere_intersection.hits`: for an image whose samples are sky."""
    down = -camera.position_mcmf_m[None] / np.linalg.norm(camera.position_mcmf_m)
    return (*sphere_intersection.hits(camera.position_mcmf_m, down), down)


def _choose(
    request: Request, frame: EnuFrame, light: Lighting, points: Array, towards: Array
) -> LawChoice:
    """The reflectance model for all lit and visible points, each in its own level frame."""
    sun = frame.direction_to_mcmf(light.first.direction)
    lit = points[:: max(1, len(points) // _SAMPLES)], towards[:: max(1, len(points) // _SAMPLES)]
    up = np.sum(lit[0] * sun, axis=-1) > 0.0
    up |= not up.any()
    lon, lat = sphere_intersection.lonlat(lit[0][up])
    turned = enu_rotation(lon, lat)
    suns = np.array([rotation @ sun for rotation in turned])
    cameras = np.array([r @ d for r, d in zip(turned, lit[1][up], strict=True)])
    return choose(request.accuracy, suns[None], cameras[None], SLOPE_RMS, request.model)


def _albedo_decision(
    albedo: AlbedoMap | ColourMap, frame: EnuFrame, points: Array, pixel_m: Array
) -> Decision:
    lon, lat = sphere_intersection.lonlat(points)
    cover = albedo.cover_at(lon, lat, float(np.median(pixel_m)))
    where = f"around {frame.lon_deg:.6g}, {frame.lat_deg:.6g}"
    return decisions.albedo(albedo, albedo.check_cover(cover, where))


def _shift_px(points: Array, towards: Array, pixel_m: Array) -> float:
    """Greatest shift, in pixels, of the Moon's highest terrain from its place on the sphere: its height
    as seen across the line of sight.
    """
    sine = np.linalg.norm(np.cross(points, towards), axis=-1) / MOON_RADIUS_M
    return float((HIGHEST_M * sine / pixel_m).max())


def _plan(
    light: Lighting,
    choice: LawChoice,
    shift_px: float,
    half_m: float,
    perspective: Decision,
    albedo: Decision | None,
) -> ScenePlan:
    """The plan of a render on the plain sphere. Relief is left out, and without heights only the
    Moon's extreme heights bound its effect.

    ``shift_px``: shift of the Moon's highest terrain; ``half_m``: distance from the middle of what
    is rendered to its farthest point.
    """
    share = "share of nodes"
    shadows = "the plain sphere: its night side is dark; relief casts no shadow"
    hidden = "the plain sphere: it hides what lies behind its limb, exactly; relief hides nothing"
    return ScenePlan(
        cast_shadows=Decision("cast shadows", False, shadows, None, share),
        occlusion=Decision("occlusion", False, hidden, None, share),
        perspective=perspective,
        solar_disc=_solar_disc(light),
        relief=_relief(shift_px),
        float_width=Decision("float width", True, "float64", 0.0, "rad of a normal"),
        reflectance=decisions.reflectance(choice),
        albedo=albedo or decisions.albedo(),
        others=(
            Decision("curvature", True, "the surface is the sphere itself", 0.0, "m"),
            *decisions.always(half_m, decisions.LightWords.of(light))[1:],
        ),
    )


def _solar_disc(light: Lighting) -> Decision:
    effect, unit = "solar disc", "share of the disc"
    if light.first.disc is None:
        return Decision(effect, False, "a point Sun", 1.0, unit)
    reason = (
        "closed forms of the share of the disc above each point's level horizon, and of the mean "
        "cosine of incidence of that share"
    )
    return Decision(effect, True, reason, TIERS["reference"].disc_rms, unit)


def _relief(shift_px: float) -> Decision:
    reason = (
        f"the plain sphere, as asked; the Moon's surface lies {LOWEST_M / 1e3:g} to "
        f"{HIGHEST_M / 1e3:g} km above it"
    )
    if not math.isfinite(shift_px):
        return Decision("relief", False, reason, None, "pixels")
    reason += f", which shifts it by up to {shift_px:.2g} pixels"
    return Decision("relief", False, reason, shift_px, "pixels")
