"""Albedo maps in colour: red, green and blue as three albedo maps over one reference.

The reference is by default the mean luminance of the map (ITU-R BT.709), so that colours stay as they
are in the map, and the luminance of a render is that under the map's luminance.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array, Float32
from ..errors import AlbedoError
from ..terrain.terrain import Terrain
from .albedo_map import AlbedoCover, AlbedoMap, check_reading, sample_nodes
from .albedo_raster import colour_bands, mean_value, open_pixels
from .srgb import luminance


@dataclass(frozen=True)
class ColourMap:
    """Red, green and blue of one file, all over the same reference. Small and picklable."""

    bands: tuple[AlbedoMap, ...]

    @classmethod
    def open(
        cls,
        path: Path | str,
        bands: Sequence[int],
        encoding: str | None = None,
        reference: float | None = None,
    ) -> ColourMap:
        """Three bands of a raster, counted from 1; otherwise as `AlbedoMap.open`."""
        check_reading(encoding, reference)
        pixels = [open_pixels(Path(path), encoding, band) for band in bands]
        value = reference
        if value is None:
            value = float(luminance(np.array([mean_value(band) for band in pixels])))
        return cls(tuple(AlbedoMap.over(band, value, reference is None) for band in pixels))

    @property
    def name(self) -> str:
        """File name without folders."""
        return self.bands[0].name

    @property
    def encoding(self) -> str:
        """One of `choices.ENCODINGS`."""
        return self.bands[0].encoding

    @property
    def reference(self) -> float:
        """Value whose factor is 1, in every band."""
        return self.bands[0].reference

    @property
    def reference_is_mean(self) -> bool:
        """True if the reference is the map's own mean luminance."""
        return self.bands[0].reference_is_mean

    @property
    def gsd_m(self) -> float:
        """Width of a pixel at true scale, metres."""
        return self.bands[0].gsd_m

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that GDAL reads for the map."""
        return self.bands[0].files

    def describe(self) -> dict[str, Any]:
        """Values for a result's metadata; ``bands``: those of the file that are red, green and blue."""
        said = self.bands[0].describe()
        if self.reference_is_mean:
            said["reference_is"] = "mean luminance of the map"
        return said | {"bands": [band.pixels.raster.raster.band for band in self.bands]}

    def __str__(self) -> str:
        return json.dumps(self.describe(), sort_keys=True)

    def at_nodes(self, terrain: Terrain) -> Float32:
        """Factors (3, rows, cols) at the nodes of the core window; 1 outside the map."""
        return np.stack([band.at_nodes(terrain) for band in self.bands])

    def at_points(self, terrain: Terrain, points: Array) -> Float32:
        """Factors (3, n) at ENU points (n, 3) of the surface; 1 outside the map."""
        return np.stack([band.at_points(terrain, points) for band in self.bands])

    def cover(self, terrain: Terrain) -> AlbedoCover:
        """Coverage of the core's nodes with a height, by the luminance of a sample of them."""
        points = sample_nodes(terrain)
        frame, gsd_m = terrain.frame, terrain.field.gsd_m
        factors = luminance(np.stack([band.at_enu(frame, points, gsd_m) for band in self.bands]))
        return AlbedoCover.of(factors, np.isfinite(points[..., 2]))

    def cover_at(self, lon_deg: Array, lat_deg: Array, gsd_m: float) -> AlbedoCover:
        """Coverage of places (n,) with cells of a width, by luminance."""
        found = [band.at(lon_deg, lat_deg, gsd_m) for band in self.bands]
        return AlbedoCover.of(luminance(np.stack(found)), np.ones(len(lon_deg), dtype=bool))

    def check_cover(self, cover: AlbedoCover, where: object) -> AlbedoCover:
        """Return the coverage; AlbedoError if it is empty or black, a warning if it is partial."""
        return self.bands[0].check_cover(cover, where)


def open_map(
    path: Path | str, encoding: str | None = None, reference: float | None = None
) -> AlbedoMap | ColourMap:
    """The map of a raster: in colour if it has red, green and blue, or three bands; else its first
    band. AlbedoError if it cannot be used.
    """
    bands = colour_bands(Path(path))
    if bands:
        return ColourMap.open(path, bands, encoding, reference)
    return AlbedoMap.open(path, encoding, reference)


def open_grey_map(
    path: Path | str, encoding: str | None = None, reference: float | None = None
) -> AlbedoMap:
    """The first band of a raster, as `AlbedoMap.open`; AlbedoError for one that `open_map` opens in
    colour.
    """
    if colour_bands(Path(path)):
        raise AlbedoError(
            f"{path}: has three bands, which lcp render takes as red, green and blue; a frame has one: "
            "choose a band first (gdal_translate -b 1)"
        )
    return AlbedoMap.open(path, encoding, reference)
