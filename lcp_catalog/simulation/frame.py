"""Simulated frames: rendered with the exact surface, averaged over pixels, passed through a
detector.

A pixel is N x N rays, evenly spaced over its area and weighted with the detector's response; the
render extends beyond the frame by the reach of the blur. A ray that meets no terrain gives black
sky if it misses the reference sphere as well; else its radiance is unknown (NaN), because the
source holds no terrain there.

A scanner's ray has the time of its part of the line, so that the camera's motion during the exposure
is in the image. The framelets of a push-frame camera are frames of their own: blur does not mix them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from .. import stages
from ..arrays import Array, Float32, Mask, sizes
from ..cameras.frame_camera import Camera
from ..cameras.scanners import Scanner
from ..cameras.sensor import Sensor
from ..cameras.view import finest_pixel_m
from ..constants import ASTRONOMICAL_UNIT_M
from ..ephemeris import solar_position
from ..errors import CameraError
from ..geometry.frames import EnuFrame
from ..geometry.sphere_intersection import ranges
from ..images.image import Image
from ..light.environment import Environment
from ..light.sun_choice import SunChoice
from ..plots.pictures import shown
from ..rendering.pipeline import HeightfieldScene, prepare_terrain
from ..rendering.request import Request, ViewAngles, ViewChoice
from .detector import Detector, Numbers, gathered, response

Taking = TypeVar("Taking", bound=Camera | Scanner)

SAMPLES_LEAST, SAMPLES_MOST = 2, 4
"""Default number of rays along a pixel's side: one per cell, within these limits."""

_RAYS_AT_ONCE = 1 << 19


class Surface(Protocol):
    """The surface that a frame shows, under its Sun."""

    @property
    def sources(self) -> tuple[Path, ...]:
        """The files from which it was read."""

    @property
    def sun_position_mcmf_m(self) -> Array:
        """Position of the Sun, (3,)."""

    def cells_per_pixel(self, camera: Camera | Scanner) -> float:
        """Width of a pixel in cells of the surface, about."""

    def radiance(self, camera: Camera | Scanner) -> Array:
        """Radiance factor at the pixel centres, (rows, cols); NaN where a ray meets no terrain."""


@dataclass(frozen=True, eq=False)
class DemSurface:
    """The terrain of a DEM, as far as a camera's view and the ring around it need it."""

    scene: HeightfieldScene
    sun_position_mcmf_m: Array

    @classmethod
    def seen(cls, request: Request, margin_px: int = 0) -> DemSurface:
        """The surface in the view of a request's camera and ``margin_px`` pixels around it, under
        the request's light. Raises the library's errors for a scene that cannot be rendered.
        """
        camera = request.view.plane
        if camera is None:
            raise CameraError("a frame needs a camera; the request has none")
        wide = ViewChoice(grown(camera, margin_px) if isinstance(camera, Camera) else ViewAngles())
        if isinstance(camera, Scanner):
            wide = ViewChoice(camera.around(margin_px))
        scene = prepare_terrain(
            replace(request, view=wide, in_camera_plane=True, surface="heightfield")
        )
        if request.environment is not None:
            return cls(scene, source_position(request.environment, scene.frame))
        return cls(scene, sun_position(request.sun, scene.frame, camera))

    @property
    def sources(self) -> tuple[Path, ...]:
        return self.scene.sources

    def cells_per_pixel(self, camera: Camera | Scanner) -> float:
        if isinstance(camera, Scanner):
            return finest_pixel_m(camera) / self.scene.gsd_m
        away_m = np.linalg.norm(camera.position_mcmf_m - self.scene.frame.origin_mcmf_m)
        return float(away_m) / camera.focal_length_px / self.scene.gsd_m

    def radiance(self, camera: Camera | Scanner) -> Array:
        return np.asarray(self.scene.picture(camera).radiance)


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """One frame, (rows, cols): the radiance factor that each pixel gathers before noise (NaN:
    unknown), and the number read out; ``camera`` has the Sun's position.
    """

    radiance: Float32
    numbers: Numbers
    full_scale: float
    detector: Detector
    camera: Camera | Scanner
    samples: int
    sources: tuple[Path, ...]

    __repr__ = sizes

    def _repr_html_(self) -> str:
        """For a notebook what it holds and a picture of its numbers."""
        return f"<p>{escape(repr(self))}</p>{shown(self.numbers)}"

    @property
    def signal(self) -> Float32:
        """Radiance factor by the numbers, NaN where the terrain is unknown."""
        step = self.full_scale / self.detector.highest
        known = np.isfinite(self.radiance)
        return np.where(known, step * self.numbers, np.nan).astype(np.float32)

    @property
    def image(self) -> Image:
        """The frame as an image for the search; `Image.with_sensor` gives it another camera."""
        known = np.isfinite(self.radiance)
        full = known & (self.numbers >= self.detector.highest)
        return Image(
            "simulated",
            self.signal,
            (known & ~full).astype(np.float32),
            self.camera,
            sun_position_mcmf_m=self.camera.sun_position_mcmf_m,
            saturated_share=float(full.mean()),
            missing_share=float(1.0 - known.mean()),
        )


def frame(
    surface: Surface, camera: Camera | Scanner, detector: Detector, samples: int | None = None
) -> SimulatedFrame:
    """The frame that a camera takes of a surface. CameraError if the camera sees nothing of it."""
    count = samples or samples_for(surface.cells_per_pixel(camera))
    signal = _gathered(surface, camera, detector, count)
    stages.stage("detector")
    scale = detector.scale_of(signal)
    return SimulatedFrame(
        signal.astype(np.float32),
        detector.numbers(signal, scale),
        scale,
        detector,
        replace(camera, sun_position_mcmf_m=surface.sun_position_mcmf_m),
        count,
        surface.sources,
    )


def samples_for(cells_per_pixel: float) -> int:
    """Rays along a pixel's side."""
    return min(max(SAMPLES_LEAST, math.ceil(cells_per_pixel - 0.01)), SAMPLES_MOST)


def subdivided(camera: Taking, count: int) -> Taking:
    """The camera whose pixels are ``count`` x ``count`` equal parts of each pixel."""
    if isinstance(camera, Scanner):
        rows, cols = camera.shape
        return camera.part((0, rows, 0, cols), count)
    (cx, cy), (width, height) = camera.principal_point_px, camera.image_size_px
    return replace(
        camera,
        focal_length_px=camera.focal_length_px * count,
        principal_point_px=((cx + 0.5) * count - 0.5, (cy + 0.5) * count - 0.5),
        image_size_px=(width * count, height * count),
    )


def grown(camera: Taking, margin_px: int) -> Taking:
    """The camera with ``margin_px`` more pixels on every side."""
    (rows, cols), by = camera.shape, margin_px
    return windowed(camera, (-by, rows + by, -by, cols + by))


def windowed(camera: Taking, window: tuple[int, int, int, int]) -> Taking:
    """The camera of a window of its image (first row, row after the last, first column, column
    after the last), which may lie beyond the image.
    """
    if isinstance(camera, Scanner):
        return camera.part(window)
    row0, row1, col0, col1 = window
    cx, cy = camera.principal_point_px
    return replace(
        camera, principal_point_px=(cx - col0, cy - row0), image_size_px=(col1 - col0, row1 - row0)
    )


def sun_position(choice: SunChoice, frame: EnuFrame, camera: Sensor | None) -> Array:
    """Position of the Sun, (3,) MCMF metres: that of the camera if the choice states none; else in
    the chosen direction from the frame's origin, at the distance of the chosen time, or one
    astronomical unit away.
    """
    own = None if camera is None else camera.sun_position_mcmf_m
    if own is not None and choice == SunChoice():
        return np.asarray(own)
    time = choice.instant(camera)
    away_m = ASTRONOMICAL_UNIT_M if time is None else solar_position.sun_distance_m(time)
    return np.asarray(frame.origin_mcmf_m + away_m * choice.direction_mcmf(frame, camera))


def source_position(environment: Environment, frame: EnuFrame) -> Array:
    """Position that stands for the Sun's under an environment map, (3,) MCMF metres: in the direction
    of its first source from a frame's origin, one astronomical unit away.
    """
    towards = frame.direction_to_mcmf(environment.lighting.first.direction)
    return np.asarray(frame.origin_mcmf_m + ASTRONOMICAL_UNIT_M * towards)


def _gathered(surface: Surface, camera: Camera | Scanner, detector: Detector, count: int) -> Array:
    """Radiance factor that each pixel gathers from ``count`` x ``count`` rays; every exposure by
    itself. CameraError if no ray meets the surface.
    """
    weights, signals, met = response(detector.blur_px, count), [], False
    for one in camera.exposures if isinstance(camera, Scanner) else [camera]:
        fine, meets = _rendered(surface, subdivided(grown(one, detector.margin_px), count))
        signals.append(gathered(fine, weights, count))
        met |= meets
    if not met:
        raise CameraError(f"{camera.name}: the camera sees nothing of the terrain")
    return np.concatenate(signals)


def _rendered(surface: Surface, camera: Camera | Scanner) -> tuple[Float32, bool]:
    """Radiance factor at a camera's pixel centres, rendered in blocks of rows; 0 for the sky. True if
    a ray meets the surface.
    """
    rows, cols = camera.shape
    out, met = np.empty((rows, cols), dtype=np.float32), False
    step = max(1, _RAYS_AT_ONCE // cols)
    for row in range(0, rows, step):
        stages.part(f"{100 * row // rows} % of the rays")
        part = windowed(camera, (row, min(row + step, rows), 0, cols))
        light = surface.radiance(part)
        dark = ~np.isfinite(light)
        met |= not dark.all()
        if dark.any():
            pixels = np.argwhere(dark)[:, ::-1].astype(np.float64)
            light[dark] = np.where(_misses_moon(part, pixels), 0.0, np.nan)
        out[row : row + step] = light
    stages.part("")
    return out, met


def _misses_moon(camera: Camera | Scanner, pixels: Array) -> Mask:
    """True for pixels (n, 2) whose rays miss the reference sphere; False for pixels without a ray."""
    origins, rays = camera.looks(pixels)
    known = np.isfinite(rays).all(axis=-1)
    misses = np.zeros(len(pixels), dtype=np.bool_)
    misses[known] = np.isnan(ranges(origins[known], rays[known]))
    return misses
