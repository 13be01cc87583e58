"""A render in front of a background, with the terrain's shadow on it.

Pixels of the camera that miss the terrain show the background: an image taken from the same position, or
the environment map. The terrain's shadow on a horizontal plane at a height of the area's ENU frame darkens
the background (Voloboy et al. 2006, section 2.2), by the ratio of the irradiance of the plane with and
without the terrain. The plane itself is transparent and casts no shadow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..accuracy import Accuracy
from ..arrays import Array
from ..cameras.frame_camera import Camera
from ..errors import CameraError, ImageError
from ..light.environment_map import LuminanceImage, Panorama, read_picture, resized
from ..light.sky_sampling import samples_of
from ..light.solar_disc import disc_directions
from ..light.sources import Lighting
from ..terrain.horizons import HorizonPoints
from ..terrain.terrain import Terrain
from .renderer import Rendering

WHITE_PERCENTILE = 99.5
"""Percentile of the lit radiance that is the white of an 8 or 16 bit background, as in a preview."""

_SHAPE = 0.01  # greatest relative difference between the aspect ratios of background and camera
_CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class Backdrop:
    """The background of a render. ``catcher_m``: ENU z of the plane that receives shadows, None for no
    plane; ``picture``: None for the environment map; ``white``: radiance factor of the picture's value
    1, None for `white_of`; ``files``: files that were read.
    """

    catcher_m: float | None = None
    picture: LuminanceImage | None = None
    white: float | None = None
    files: tuple[Path, ...] = ()

    @classmethod
    def open(
        cls, catcher_m: float | None, path: Path | str | None, white: float | None
    ) -> Backdrop:
        """Read the picture, if there is one. ImageError if it cannot be read."""
        if path is None:
            return cls(catcher_m)
        return cls(catcher_m, read_picture(path), white, (Path(path),))

    def white_of(self, radiance: NDArray[np.floating]) -> float:
        """The radiance factor of the picture's value 1: as given; else 1 for linear pictures and the white of
        the render's preview for 8 and 16 bit pictures.
        """
        if self.white is not None:
            return self.white
        if self.picture is None or not self.picture.encoded:
            return 1.0
        lit = radiance[radiance > 0.0]
        return float(np.percentile(lit, WHITE_PERCENTILE)) if lit.size else 1.0

    def resolution(self, camera: Camera, panorama: Panorama | None) -> tuple[str, float]:
        """Name of the background and the width of its pixel at the middle of a camera's image, in
        pixels of the camera; ``panorama``: the background without a picture.
        """
        if self.picture is not None:
            return self.picture.name, camera.shape[1] / self.picture.luminance.shape[1]
        assert panorama is not None
        return panorama.name, panorama.pixel_rad * camera.focal_length_px


def composite(
    photo: Rendering,
    terrain: Terrain,
    camera: Camera,
    light: Lighting,
    backdrop: Backdrop,
    panorama: Panorama | None,
    accuracy: Accuracy,
) -> Array:
    """The render where terrain is visible, the shaded background elsewhere; (rows, cols) of the camera.

    ``panorama``: the background without a picture, in radiance factors over pi. ImageError for a
    background with another aspect ratio, CameraError for a camera below the plane.
    """
    seen = np.asarray(photo.visible, dtype=np.bool_)
    origin, rays = camera.rays_enu(terrain.frame)
    if backdrop.picture is not None:
        _require_shape(backdrop.picture, camera)
        behind = resized(backdrop.picture.luminance, camera.shape)
        behind = behind * backdrop.white_of(photo.radiance)
    else:
        assert panorama is not None
        behind = math.pi * panorama.at(rays)
    out = np.where(seen, photo.radiance, behind)
    if backdrop.catcher_m is None:
        return out
    if origin[2] <= backdrop.catcher_m:
        raise CameraError(
            f"{camera.name}: the camera's height in the area's frame, {origin[2]:.6g} m, is not above the shadow "
            f"catcher at {backdrop.catcher_m:g} m"
        )
    missed = ~seen & (rays[..., 2] < 0.0)
    reach = (backdrop.catcher_m - origin[2]) / rays[missed][:, 2]
    points = origin + reach[:, None] * rays[missed]
    out[missed] *= shadow_factor(terrain, points, light, accuracy)
    return out


def shadow_factor(terrain: Terrain, points_m: Array, light: Lighting, accuracy: Accuracy) -> Array:
    """Ratio of the irradiance of horizontal surfaces at ENU points (n, 3) with and without the terrain,
    0..1; 1 where no light reaches them.
    """
    lights = [
        (direction, irradiance * direction[2])
        for direction, irradiance in _lights(light, accuracy)
        if direction[2] > 0.0 and irradiance > 0.0
    ]
    whole = math.fsum(level for _, level in lights)
    out = np.ones(len(points_m))
    if whole <= 0.0:
        return out
    for first in range(0, len(points_m), _CHUNK):
        part = HorizonPoints(terrain.field, points_m[first : first + _CHUNK], terrain.far)
        hidden = np.zeros(len(part))
        for direction, level in lights:
            hidden += level * part.occluded(direction)
        out[first : first + _CHUNK] = np.clip(1.0 - hidden / whole, 0.0, 1.0)
    return out


def _lights(light: Lighting, accuracy: Accuracy) -> Iterator[tuple[Array, float]]:
    """Directions and irradiances that sample all light; a disc by directions of equal flux."""
    for source in light.sources:
        if source.disc is None:
            yield source.direction.vector, source.irradiance
            continue
        directions = disc_directions(source.direction, source.disc, accuracy)
        for direction in directions:
            yield direction, source.irradiance / len(directions)
    if light.sky is not None:
        samples = samples_of(light.sky, accuracy)
        for azimuth in range(len(samples.azimuths)):
            for direction in samples.directions(azimuth):
                yield direction, samples.irradiance


def _require_shape(picture: LuminanceImage, camera: Camera) -> None:
    (rows, cols), (height, width) = picture.luminance.shape, camera.shape
    if abs(math.log(cols * height / (rows * width))) > _SHAPE and (rows, cols) != (height, width):
        raise ImageError(
            f"{picture.name}: the aspect ratio of {cols} x {rows} pixels differs from the camera's "
            f"{width} x {height}"
        )
