"""What a catalogue needs for given images: views, cells, footprint, region and Suns of a build.

The directions in which the images' cameras are seen from the ground lie in the azimuthal equidistant plane about
the vertical. Views are the middle and the corners of the smallest rectangle, turned as it fits best, that
holds them, less the margin beyond evaluated views within which claims hold (`catalog.prediction.VIEW_REACH_DEG`): claims are
interpolated between views. A side longer than `SIDE_MAX_DEG` has views between its ends, too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array
from ..cameras.sensor import Sensor, pixel_size_m
from ..cameras.view import border_and_inside, footprint, looking_camera, sees_nothing
from ..catalog.prediction import VIEW_REACH_DEG, ViewMesh, view_plane
from ..choices import LEVEL_RATIO
from ..dem.mosaic import DemSet
from ..errors import AreaError, CameraError
from ..geometry import sphere_intersection
from ..geometry.bounds import Bounds, enclosing_arc, turned_deg
from ..geometry.frames import EnuFrame, azimuth_elevation, enu_rotation, mcmf_to_lonlat
from ..light.sun_choice import SunChoice
from ..terrain.area import Area
from ..terrain.useful_cell import useful_cell
from .config import (
    POLAR_ELEVATIONS_DEG,
    SUN_ELEVATIONS_DEG,
    BuildConfig,
    SunConfig,
    ViewConfig,
    between,
)

SIDE_MAX_DEG = 75.0
"""Longest side of a rectangle of views without views between its corners."""

FARTHEST_DEG = 80.0
"""Views farther from the vertical are left out: hardly anything is seen of a surface there."""

_SMALL_PART = 18.0
"""Widths of a region in an image from which the build is for the image's share of it, which is refused: less than one unit of
the 255 that can be wanted. In an image of more than one width the region's points alone must locate it: what the default
footprint asks for.
"""

_PIXELS = 1024
"""Pixels along a side of an image of which the field of view alone is known; the views do not depend on it."""

_SAMPLES = 17
"""Rays along a border of an image."""

_FINE = 64
"""Rays along a side of an image for the area of its ground."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What the images of n rays see: directions to the cameras in the view plane (n, 2), degrees; azimuths and
    elevations (n,) of the Sun, degrees, NaN where none is stated; by image the size of a pixel (m,), 0 where it is
    not known, and the area (m,) of the ground; and its bounds, none for an image of any place.
    """

    views: Array
    sun_azimuth_deg: Array
    sun_elevation_deg: Array
    pixel_m: Array
    ground_m2: Array
    bounds: tuple[Bounds, ...]

    @classmethod
    def by(cls, sensors: Iterable[Sensor]) -> Seen:
        """Of sensors under the Suns of their files. CameraError for one that sees nothing of the Moon or is below
        its surface.
        """
        views, suns, pixels, grounds, bounds = zip(*map(_seen, sensors), strict=True)
        azimuth, elevation = np.concatenate(suns).T
        return cls(
            np.concatenate(views), azimuth, elevation, np.array(pixels), np.array(grounds), bounds
        )

    @classmethod
    def from_above(cls, field_deg: float, altitude_km: float) -> Seen:
        """Of a square image that looks straight down, of this angle along a side, anywhere, with any pixel and Sun.
        CameraError for a field that is not below 180 degrees, or an altitude that is not above 0.
        """
        if not (0.0 < field_deg < 180.0 and 0.0 < altitude_km < math.inf):
            raise CameraError(
                f"a camera needs a field of view above 0 and below 180 degrees and an altitude above 0, not {field_deg:g} "
                f"degrees and {altitude_km:g} km"
            )
        side_m = 2e3 * altitude_km * math.tan(math.radians(field_deg) / 2.0)
        camera = looking_camera(
            EnuFrame(0.0, 0.0), (0.0, 0.0, 1e3 * altitude_km), side_m / _PIXELS, (side_m, side_m)
        )
        return replace(cls.by([camera]), pixel_m=np.zeros(1), bounds=())

    @property
    def box(self) -> Bounds:
        """The bounds of all images."""
        west, east = enclosing_arc([b.west for b in self.bounds], [b.east for b in self.bounds])
        return Bounds(
            west, min(b.south for b in self.bounds), east, max(b.north for b in self.bounds)
        )

    @property
    def view_config(self) -> ViewConfig:
        """The views."""
        off = np.linalg.norm(self.views, axis=1)
        places = view_places(self.views[off <= FARTHEST_DEG])
        angle, azimuth = np.linalg.norm(places, axis=1), np.arctan2(places[:, 0], places[:, 1])
        azimuth_deg = np.where(
            angle > 0.0, np.round(turned_deg(np.degrees(azimuth)), 1) % 360.0, 0.0
        )
        return ViewConfig(
            tuple(np.round(angle, 1).tolist()),
            tuple(azimuth_deg.tolist()),
            (math.inf,) * len(places),
        )

    def claimed_share(self, views: ViewConfig) -> float:
        """Share of the images' pixels on the ground that are near enough to the views for claims."""
        mesh = ViewMesh.of(view_plane(views.off_nadir_deg, views.azimuth_deg))
        return float(np.mean(mesh.weights(self.views)[2] <= VIEW_REACH_DEG))

    @property
    def footprint_km(self) -> float:
        """Diameter of the circle of the same area as the ground that the image sees which sees least."""
        return 2e-3 * math.sqrt(float(self.ground_m2.min()) / math.pi)

    def sun_config(self, sun: SunConfig) -> SunConfig:
        """The nodes of a grid of Suns, or of the default one, that enclose the Suns of the images; all of them if no Sun
        is stated, or it does not rise.
        """
        up = self.sun_elevation_deg > 0.0
        if not up.any():
            return sun
        elevations = np.asarray(sun.elevations_deg or (*POLAR_ELEVATIONS_DEG, *SUN_ELEVATIONS_DEG))
        seen = self.sun_elevation_deg[up]
        low = np.searchsorted(elevations, seen.min(), side="right") - 1
        high = np.searchsorted(elevations, seen.max(), side="left")
        chosen = elevations[max(0, low) : high + 1]
        west, east = enclosing_arc(self.sun_azimuth_deg[up], self.sun_azimuth_deg[up])
        grid = np.asarray(sun.azimuths_deg)
        step = 360.0 / len(grid)
        inside = turned_deg(grid - west + step) < east - west + 2.0 * step
        return SunConfig(tuple(grid[inside].tolist()) or sun.azimuths_deg, tuple(chosen.tolist()))

    def cells_m(self, useful_m: float) -> tuple[float, ...]:
        """Cell sizes for the images where the finest useful one is ``useful_m``: that alone as long as no pixel is more
        than twice as large; else up to half of the largest pixel.
        """
        fine = max(useful_m, float(self.pixel_m.min()))
        coarse = max(fine, float(self.pixel_m.max()) / 2.0)
        if coarse <= useful_m:
            return (useful_m,)
        return between(fine, coarse) if coarse > LEVEL_RATIO * fine else (fine,)


def _seen(sensor: Sensor) -> tuple[Array, Array, float, float, Bounds]:
    """Places in the view plane (n, 2), Suns (n, 2), pixel, area of the ground and bounds of one image."""
    bounds = footprint(sensor)
    pixels = border_and_inside(sensor.shape, _SAMPLES)
    ground, towards = _seen_ground(sensor, pixels)
    if not len(ground):
        raise sees_nothing(sensor)
    lon, lat, _ = mcmf_to_lonlat(ground)
    rotation = np.stack(
        [enu_rotation(a, b) for a, b in zip(lon.tolist(), lat.tolist(), strict=True)]
    )
    azimuth, above = azimuth_elevation(np.einsum("nij,nj->ni", rotation, towards))
    suns = np.full((len(ground), 2), np.nan)
    if sensor.sun_position_mcmf_m is not None or sensor.time_utc is not None:
        sun = SunChoice().direction_mcmf(EnuFrame(float(lon[0]), float(lat[0])), sensor)
        suns = np.stack(azimuth_elevation(rotation @ sun), axis=-1)
    pixel = float(np.median(pixel_size_m(sensor, ground)))
    return view_plane(90.0 - above, azimuth), suns, pixel, _ground_area(sensor), bounds


def _seen_ground(sensor: Sensor, pixels: Array) -> tuple[Array, Array]:
    """Places (m, 3) on the sphere that pixels (n, 2) see, and the directions from there to the camera, MCMF."""
    positions, directions = sensor.looks(pixels)
    looking = np.isfinite(directions).all(axis=-1)
    distance, ground = sphere_intersection.hits(positions[looking], directions[looking])
    met = np.isfinite(distance)
    return ground[met], -directions[looking][met]


def _ground_area(sensor: Sensor) -> float:
    """Area in m^2 of the ground in an image, by the middles of equal parts of it."""
    middles = (np.indices((_FINE, _FINE)).reshape(2, -1).T + 0.5) / _FINE
    ground, towards = _seen_ground(sensor, middles * sensor.shape[::-1] - 0.5)
    sine = np.einsum("ni,ni->n", ground, towards) / np.linalg.norm(ground, axis=-1)
    slant = np.maximum(sine, math.cos(math.radians(FARTHEST_DEG)))
    areas = pixel_size_m(sensor, ground) ** 2 / slant
    return float(np.sum(areas)) * math.prod(sensor.shape) / len(middles)


def view_places(seen: Array) -> Array:
    """Places (v, 2) of views in the view plane for directions (n, 2), degrees."""
    half_margin = VIEW_REACH_DEG / 2.0
    best: tuple[float, Array, Array, Array] | None = None
    for turn in np.radians(np.arange(0.0, 90.0, 1.0)):
        axes = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        along = seen @ axes.T
        low, high = along.min(axis=0), along.max(axis=0)
        size = float(np.prod(high - low))
        if best is None or size < best[0] - 1e-9:
            best = size, axes, low, high
    assert best is not None
    _, axes, low, high = best
    middle, half = (low + high) / 2.0, np.maximum((high - low) / 2.0 - half_margin, 0.0)
    counts = [1 if h <= half_margin else 2 + int(2.0 * h / SIDE_MAX_DEG) for h in half]
    lines = [
        np.linspace(m - h, m + h, n) if n > 1 else np.array([m])
        for m, h, n in zip(middle, half, counts, strict=True)
    ]
    places = [np.array(place) for place in itertools.product(*lines)]
    if counts == [2, 2]:
        places.insert(0, middle)
    return np.array(places) @ axes


def for_images(config: BuildConfig, seen: Seen, dems: DemSet) -> BuildConfig:
    """The configuration with the views of images, and with their Suns, cells, footprint and region where it leaves
    those open; the default footprint if an image sees more than the region. AreaError if the images see nothing of the DEM.
    """
    area, points = config.area, config.points
    if area.region is None and seen.bounds:
        box = seen.box.common(dems.bounds)
        if box is None:
            raise AreaError(f"the camera sees {seen.box}; the DEM covers {dems.bounds}")
        if box.east - box.west < 360.0 - 1e-9:
            area = replace(area, bounds_deg=tuple(box))
    region = area.region or Area.from_bounds(*dems.bounds)
    if not (area.gsd_m or area.levels_m or area.altitudes_km):
        useful_m = useful_cell(dems, region).gsd_m
        cells = seen.cells_m(useful_m)
        if len(cells) > 1:
            area = replace(area, levels_m=cells)
        elif cells[0] > useful_m:
            area = replace(area, gsd_m=cells[0])
    x0, x1, y0, y1 = region.extent_m
    wider = 1e3 * seen.footprint_km / min(x1 - x0, y1 - y0)
    if points.footprint_km is None and not 1.0 < wider < _SMALL_PART:
        points = replace(points, footprint_km=seen.footprint_km)
    sun = config.sun
    if not sun.elevations_deg and sun.azimuths_deg == SunConfig().azimuths_deg:
        sun = seen.sun_config(sun)
    return replace(config, area=area, points=points, sun=sun, view=seen.view_config)
