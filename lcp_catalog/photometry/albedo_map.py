"""Albedo maps: relative brightness of the surface, as a factor on the radiance of the reflectance
model.

The factor is the map's value over a reference, by default the map's mean over the surface. Values
are resampled like heights (`dem.tiles`): area means for cells coarser than the map's pixels, cubic
convolution for finer cells.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Float32
from ..atomic_files import file_facts
from ..choices import ENCODINGS
from ..constants import MOON_RADIUS_M
from ..dem.raster import dataset_files
from ..dem.tiles import Layer
from ..errors import AlbedoError
from ..geometry.bounds import Bounds
from ..geometry.frames import EnuFrame
from ..kernels.resampling import heights
from ..terrain.area import Area
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .albedo_raster import AlbedoPixels, mean_value, open_pixels

log = logging.getLogger(__name__)

_UNIT = 1024.0
"""Factors are sampled in units of 1/1024: sums along a row have steps of 1/8192
(`kernels.resampling.heights`)."""

_BLOCK_ROWS = 256
_SAMPLE_NODES = 256
"""Side of the sample of an area's nodes for contrast and coverage."""


@dataclass(frozen=True)
class AlbedoCover:
    """Coverage of an area by a map: covered share, least and greatest factor, and contrast
    (standard deviation over mean). Without coverage the figures are NaN.
    """

    share: float
    lowest: float = math.nan
    highest: float = math.nan
    contrast: float = math.nan

    @classmethod
    def of(cls, factors: Array, there: NDArray[np.bool_]) -> AlbedoCover:
        """Coverage by factors (NaN: missing) at the places where ``there`` is True."""
        found = factors[there & np.isfinite(factors)]
        if not found.size:
            return cls(0.0)
        mean = float(found.mean())
        spread = float(found.std()) / mean if mean > 0.0 else 0.0
        return cls(found.size / int(there.sum()), float(found.min()), float(found.max()), spread)


@dataclass(frozen=True)
class AlbedoMap:
    """A map of relative brightness. Small and picklable; pixels are read when they are needed."""

    pixels: AlbedoPixels
    reference: float
    """Value whose factor is 1."""
    reference_is_mean: bool
    """True if the reference is the map's own mean."""

    @classmethod
    def open(
        cls, path: Path | str, encoding: str | None = None, reference: float | None = None
    ) -> AlbedoMap:
        """The first band of a raster that GDAL reads, in a lunar CRS (cylindrical, polar
        stereographic or degrees); ``encoding`` is one of `choices.ENCODINGS` (None: linear, with a
        warning for a probable display image). AlbedoError if it cannot be used.

        Without a ``reference`` every pixel is read once for the mean.
        """
        check_reading(encoding, reference)
        pixels = open_pixels(Path(path), encoding)
        value = mean_value(pixels) if reference is None else float(reference)
        return cls.over(pixels, value, reference is None)

    @classmethod
    def over(cls, pixels: AlbedoPixels, reference: float, is_mean: bool) -> AlbedoMap:
        """The map of opened pixels, over a reference."""
        raster = replace(pixels.raster, unit=_UNIT / reference)
        return cls(replace(pixels, raster=raster), reference, is_mean)

    @property
    def name(self) -> str:
        """File name without folders."""
        return self.pixels.path.name

    @property
    def encoding(self) -> str:
        """One of `choices.ENCODINGS`."""
        return self.pixels.raster.encoding

    @property
    def gsd_m(self) -> float:
        """Width of a pixel at true scale, metres."""
        return self.pixels.gsd_m

    @property
    def bounds(self) -> Bounds:
        """Bounds of the map in longitude and latitude."""
        return self.pixels.grid.bounds

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that GDAL reads for the map, including the sources of a virtual raster."""
        return dataset_files(self.pixels.path)

    def describe(self) -> dict[str, Any]:
        """Values for a result's metadata; without folders."""
        how = "mean of the map" if self.reference_is_mean else "stated"
        return {
            "name": self.name,
            "encoding": self.encoding,
            "reference": self.reference,
            "reference_is": how,
        }

    def provenance(self) -> dict[str, Any]:
        """`describe`, with name, size and SHA-256 of every file."""
        return self.describe() | {"files": file_facts(self.files)}

    def __str__(self) -> str:
        return json.dumps(self.describe(), sort_keys=True)

    # -- factors

    @cached_property
    def _layer(self) -> Layer[AlbedoPixels]:
        return Layer((self.pixels,))

    def at(self, lon_deg: ArrayLike, lat_deg: ArrayLike, gsd_m: float) -> Array:
        """Factors at places on cells of a width, in the arguments' broadcast shape; NaN outside the
        map. Negative values of cubic convolution beside bright terrain are set to 0.
        """
        lon, lat = np.broadcast_arrays(
            np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
        )
        found = self._layer.sample(lon.ravel(), lat.ravel(), gsd_m).height
        return np.maximum(found, 0.0).reshape(lon.shape) / _UNIT

    def at_enu(self, frame: EnuFrame, points_m: ArrayLike, gsd_m: float) -> Array:
        """Factors (...) at ENU points (..., 3) of a frame; NaN for a missing point and outside the
        map.
        """
        points = np.asarray(points_m, dtype=np.float64)
        x, y, z = (np.ascontiguousarray(points[..., k]).ravel() for k in range(3))
        lon, lat = np.empty(x.size), np.empty(x.size)
        up_m = MOON_RADIUS_M + frame.height_m
        heights.enu_to_lonlat(x, y, z, frame.rotation, up_m, lon, lat)
        return self.at(np.degrees(lon), np.degrees(lat), gsd_m).reshape(points.shape[:-1])

    def known_nodes(self, terrain: Terrain) -> Float32:
        """Factors (rows, cols) at the nodes of the core window; NaN without a height or outside the
        map.
        """
        field, (row0, row1, col0, col1) = terrain.field, terrain.core
        out = np.empty((row1 - row0, col1 - col0), np.float32)
        for row in range(row0, row1, _BLOCK_ROWS):
            window = (row, min(row + _BLOCK_ROWS, row1), col0, col1)
            points = nodes_enu(field, window)
            out[row - row0 : window[1] - row0] = self.at_enu(terrain.frame, points, field.gsd_m)
        return out

    def at_nodes(self, terrain: Terrain) -> Float32:
        """Factors (rows, cols) at the nodes of the core window; 1 outside the map."""
        return neutral(self.known_nodes(terrain))

    def at_points(self, terrain: Terrain, points: Array) -> Float32:
        """Factors (n,) at ENU points (n, 3) of the surface; 1 outside the map."""
        return neutral(self.at_enu(terrain.frame, points, terrain.field.gsd_m).astype(np.float32))

    def patches(self, frames: Sequence[EnuFrame], z_m: Float32, gsd_m: float) -> Float32:
        """Factors (n, p, p) at the nodes of square patches around the origins of their frames; row 0
        is north, column 0 west. NaN outside the map.
        """
        step = (np.arange(z_m.shape[1]) - z_m.shape[1] // 2) * gsd_m
        x, y = np.tile(step, len(step)), np.repeat(-step, len(step))
        lon, lat = np.empty((2, len(frames), x.size))
        for k, (frame, z) in enumerate(zip(frames, z_m, strict=True)):
            up_m, heights_m = MOON_RADIUS_M + frame.height_m, z.ravel().astype(np.float64)
            heights.enu_to_lonlat(x, y, heights_m, frame.rotation, up_m, lon[k], lat[k])
        return (
            self.at(np.degrees(lon), np.degrees(lat), gsd_m).reshape(z_m.shape).astype(np.float32)
        )

    # -- what it covers

    def cover(self, terrain: Terrain) -> AlbedoCover:
        """Coverage of the core's nodes with a height, by a sample of them."""
        points = sample_nodes(terrain)
        factors = self.at_enu(terrain.frame, points, terrain.field.gsd_m)
        return AlbedoCover.of(factors, np.isfinite(points[..., 2]))

    def cover_of(self, area: Area, gsd_m: float) -> AlbedoCover:
        """Coverage of an area without a terrain, by a lattice of places on the sphere."""
        return self.cover_at(*area.lattice(129), gsd_m)

    def cover_at(self, lon_deg: Array, lat_deg: Array, gsd_m: float) -> AlbedoCover:
        """Coverage of places (n,) with cells of a width."""
        return AlbedoCover.of(self.at(lon_deg, lat_deg, gsd_m), np.ones(len(lon_deg), dtype=bool))

    def check_cover(self, cover: AlbedoCover, where: object) -> AlbedoCover:
        """Return the coverage; AlbedoError if it is empty or black, a warning if it is partial."""
        if cover.share == 0.0:
            raise AlbedoError(
                f"{self.pixels.path}: does not cover the area ({where}); it covers {self.bounds}"
            )
        if cover.highest == 0.0:
            raise AlbedoError(f"{self.pixels.path}: is 0 everywhere in the area ({where})")
        if cover.share < 1.0:
            log.warning(
                "%s: does not cover %.2g %% of the area; the factor is 1 there, which makes an edge in "
                "brightness at the map's border",
                self.pixels.path,
                max(100.0 * (1.0 - cover.share), 0.01),
            )
        return cover


def check_reading(encoding: str | None, reference: float | None) -> None:
    """Raise AlbedoError for an invalid encoding or reference."""
    if encoding is not None and encoding not in ENCODINGS:
        raise AlbedoError(f"no albedo encoding {encoding!r}; valid names: {', '.join(ENCODINGS)}")
    if reference is not None and not 0.0 < reference < math.inf:
        raise AlbedoError(f"invalid albedo reference {reference:g}; it must be above 0")


def sample_nodes(terrain: Terrain) -> Array:
    """ENU points (rows, cols, 3) of a sample of the core's nodes, by which a map's cover is judged."""
    step = max(1, max(terrain.product_index.shape) // _SAMPLE_NODES)
    return nodes_enu(terrain.field, terrain.core, step)


def neutral(factors: Float32) -> Float32:
    """Factors with 1 in place of NaN."""
    return np.where(np.isnan(factors), np.float32(1.0), factors)
