"""A render set into a picture: what stands behind the terrain, and the terrain's shadow on it.

In the camera's plane, where the terrain is missed, the background shows: a second frame taken from the same
place, or the panorama itself. On a transparent plane, horizontal at a height of the area's ENU frame, the
terrain's shadow darkens it (Voloboy et al. 2006, section 2.2): by the irradiance of a diffuse surface there
with what the terrain hides, over that without. The plane hides nothing, casts nothing and sees no other light.
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
from ..light.environment_map import Panorama
from ..light.hdr_image import Picture, read_picture, resized
from ..light.sky_sampling import samples_of
from ..light.solar_disc import disc_directions
from ..light.sources import Lighting
from ..terrain.horizons import Points
from ..terrain.terrain import Terrain
from .renderer import Rendering

WHITE_PERCENTILE = 99.5
"""Of the render's lit radiance: what white of a background encoded for a display stands for, as in a preview."""

_SHAPE = 0.01  # how much a background's shape may differ from the camera's, as a share
_CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class Backdrop:
    """What is behind the terrain. ``catcher_m``: ENU z of the plane that catches shadows, None: there is none;
    ``picture`` None: the panorama; ``white``: radiance factor of the picture's 1, None: `white_of`.
    """

    catcher_m: float | None = None
    picture: Picture | None = None
    white: float | None = None
    files: tuple[Path, ...] = ()

    @classmethod
    def open(
        cls, catcher_m: float | None, path: Path | str | None, white: float | None
    ) -> Backdrop:
        """ImageError for a picture that cannot be read."""
        if path is None:
            return cls(catcher_m)
        return cls(catcher_m, read_picture(path), white, (Path(path),))

    def white_of(self, radiance: NDArray[np.floating]) -> float:
        """The stated white; else 1 of linear values, which are radiance factors, and of a display's codes
        what a preview of the render shows white.
        """
        if self.white is not None:
            return self.white
        if self.picture is None or not self.picture.encoded:
            return 1.0
        lit = radiance[radiance > 0.0]
        return float(np.percentile(lit, WHITE_PERCENTILE)) if lit.size else 1.0


def composite(
    photo: Rendering,
    terrain: Terrain,
    camera: Camera,
    light: Lighting,
    backdrop: Backdrop,
    panorama: Panorama | None,
    accuracy: Accuracy,
) -> Array:
    """The render where the terrain is seen, the shaded background elsewhere; (rows, cols) of the camera.

    ``panorama``: what the background is without a picture, in radiance factors over pi. ImageError
    for a background of another shape, CameraError for a plane that the camera is under.
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
            f"{camera.name}: it stands at {origin[2]:.6g} m of the area's frame, not above the shadow catcher at "
            f"{backdrop.catcher_m:g} m"
        )
    missed = ~seen & (rays[..., 2] < 0.0)
    reach = (backdrop.catcher_m - origin[2]) / rays[missed][:, 2]
    points = origin + reach[:, None] * rays[missed]
    out[missed] *= shadow_factor(terrain, points, light, accuracy)
    return out


def shadow_factor(terrain: Terrain, points_m: Array, light: Lighting, accuracy: Accuracy) -> Array:
    """Irradiance of horizontal surfaces at ENU points (n, 3) with what the terrain hides over that
    without, 0..1; 1 where nothing lights them.
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
        part = Points(terrain.field, points_m[first : first + _CHUNK], terrain.far)
        hidden = np.zeros(len(part))
        for direction, level in lights:
            hidden += level * part.occluded(direction)
        out[first : first + _CHUNK] = np.clip(1.0 - hidden / whole, 0.0, 1.0)
    return out


def _lights(light: Lighting, accuracy: Accuracy) -> Iterator[tuple[Array, float]]:
    """Directions and irradiances that stand for all light; a disc by directions of equal flux."""
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


def _require_shape(picture: Picture, camera: Camera) -> None:
    (rows, cols), (height, width) = picture.luminance.shape, camera.shape
    if abs(math.log(cols * height / (rows * width))) > _SHAPE and (rows, cols) != (height, width):
        raise ImageError(
            f"{picture.name}: {cols} x {rows} pixels are no picture of the camera's {width} x {height}: "
            "the sides' ratio differs"
        )
