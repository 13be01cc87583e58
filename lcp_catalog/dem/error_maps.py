"""Maps of a DEM's height error and effective resolution, as some archives give them beside the
heights (PGDA product 90: the _ERR and _EFFRES layers).

Height errors of a DEM: 1 sigma and correlation length, from maps, from a calibration, or from
the product's published figure and the resolution of its heights.

The errors of a DEM that was made by stereo, by filtering or by interpolation hang together over
about what it resolves: nodes that share observations share errors. A length of half the effective
resolution as the standard deviation of the Gaussian autocorrelation makes the errors of nodes one
effective resolution apart correlate by exp(-2) = 0.14.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Float32
from ..errors import DemError
from .dem import Dem
from .grid import Grid
from .mosaic import DemSet
from .products import LENGTH_PER_RESOLUTION, UNKNOWN
from .raster import Gridded, Raster, grid_of, open_dataset, unit_m

log = logging.getLogger(__name__)

GREATEST_M = 100e3
"""Greatest value that is read, metres: larger ones are no errors of a DEM, but missing data that
the file does not declare.
"""

_LEAST_SHARE = 1e-9
"""Weights up to this one are rounding errors at the centre of a pixel."""

_TILE_PX = 512
"""Side of the windows in which a map is read, pixels."""


@dataclass(frozen=True)
class Figures:
    """Pixels of a map in metres. DemError for values that are below 0 or above `GREATEST_M`."""

    raster: Raster
    meaning: str

    def read(self, row0: int, row1: int, col0: int, col1: int) -> Float32:
        """Values of a window inside the raster, float32 metres, NaN for missing pixels."""
        values = self.raster.values(row0, row1, col0, col1)
        with np.errstate(invalid="ignore"):
            wrong = (values < 0.0) | (values > GREATEST_M)
        if wrong.any():
            raise DemError(
                f"{self.raster.path}: has the value {values[wrong][0]:g}, which cannot be "
                f"{self.meaning} in metres; either this is another layer, or its value for missing "
                "data is not declared (gdal_translate -a_nodata)"
            )
        return values.astype(np.float32)


@dataclass(frozen=True)
class FigureMap(Gridded):
    """A raster of one figure of a DEM, in metres. Picklable; pixels are read when needed."""

    path: Path
    grid: Grid
    raster: Figures
    files: tuple[Path, ...]

    @classmethod
    def open(cls, path: Path | str, meaning: str) -> FigureMap:
        """The first and only band of a raster that GDAL reads, in a lunar CRS, values in metres (or
        kilometres, if the band's unit says so). DemError if it cannot be used. No pixel is read.
        """
        path, kind = Path(path), f"a map of {meaning}"
        dataset, files = open_dataset(path, kind)
        if dataset.count != 1:
            raise DemError(f"{path}: has {dataset.count} bands; {kind} has one")
        grid, raster = grid_of(dataset, path), Raster.of_band(dataset, files, path)
        scale_m, offset_m = (unit_m(dataset) * x for x in (raster.scale_m, raster.offset_m))
        figures = Figures(replace(raster, scale_m=scale_m, offset_m=offset_m), meaning)
        return cls(path, grid, figures, files)

    def at(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> Array:
        """Values at places (n,), metres, by bilinear interpolation; NaN outside the map and where
        one of the pixels used is missing. In the outer half of its pixels the map's value is that
        of its edge.
        """
        lon, lat = np.broadcast_arrays(
            *(np.atleast_1d(a).astype(float) for a in (lon_deg, lat_deg))
        )
        inside, column, row = self.grid.located(lon, lat)
        out = np.full(lon.size, np.nan)
        if not self.grid.wraps:
            column = np.clip(column, 0.0, self.grid.width - 1.0)
        row = np.clip(row, 0.0, self.grid.height - 1.0)
        tiles = np.floor(np.stack([row, column]) / _TILE_PX)
        for tile in np.unique(tiles[:, inside], axis=1).T:
            here = np.flatnonzero(inside & (tiles == tile[:, None]).all(axis=0))
            out[here] = self._bilinear(row[here], column[here])
        return out

    def _bilinear(self, row: Array, column: Array) -> Array:
        top, left = int(np.floor(row.min())), int(np.floor(column.min()))
        bottom = min(int(np.floor(row.max())) + 2, self.grid.height)
        right = int(np.floor(column.max())) + 2
        if not self.grid.wraps:
            right = min(right, self.grid.width)
        z = self.read(top, bottom, left, right).astype(np.float64)
        i, j = np.floor(row).astype(np.int64) - top, np.floor(column).astype(np.int64) - left
        down, across = row - top - i, column - left - j
        below, beside = np.minimum(i + 1, len(z) - 1), np.minimum(j + 1, z.shape[1] - 1)
        parts = (
            (z[i, j], (1.0 - down) * (1.0 - across)),
            (z[i, beside], (1.0 - down) * across),
            (z[below, j], down * (1.0 - across)),
            (z[below, beside], down * across),
        )
        return np.asarray(
            sum(np.where(share > _LEAST_SHARE, value * share, 0.0) for value, share in parts)
        )


@dataclass(frozen=True)
class ErrorMaps:
    """Maps of the 1 sigma of heights and of the effective resolution; None where there is none."""

    sigma: FigureMap | None = None
    resolution: FigureMap | None = None

    @classmethod
    def open(
        cls, sigma_path: Path | str | None, resolution_path: Path | str | None
    ) -> ErrorMaps | None:
        """The maps of two files, each in metres; None if neither is given. DemError for a file that
        cannot be used.
        """
        if sigma_path is None and resolution_path is None:
            return None
        return cls(
            None if sigma_path is None else FigureMap.open(sigma_path, "the 1 sigma of heights"),
            None
            if resolution_path is None
            else FigureMap.open(resolution_path, "the effective resolution"),
        )

    @property
    def maps(self) -> tuple[FigureMap, ...]:
        """The maps that are given."""
        return tuple(one for one in (self.sigma, self.resolution) if one is not None)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every local file that is read for the maps."""
        return tuple(dict.fromkeys(file for one in self.maps for file in one.files))

    def check_cover(self, lon_deg: ArrayLike, lat_deg: ArrayLike, where: object) -> None:
        """DemError for a map without a value at any of some places (n,) of an area, which ``where``
        names; a log message for one that lacks some of them.
        """
        for one in self.maps:
            share = float(np.isfinite(one.at(lon_deg, lat_deg)).mean())
            if share == 0.0:
                raise DemError(
                    f"{one.path}: has no value in the area ({where}); it covers {one.grid.bounds}"
                )
            if share < 1.0:
                log.warning(
                    "%s: has no value in %.2g %% of the area; the figures of the DEM's product are "
                    "used there", one.path, 100.0 * (1.0 - share),
                )  # fmt: skip

    def at(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Array, Array]:
        """1 sigma of the heights and effective resolution at places (n,), metres, both (n,); NaN
        without a map or a value, and for a resolution of 0.
        """
        size = np.broadcast(np.atleast_1d(lon_deg), np.atleast_1d(lat_deg)).size
        sigma, resolution = (
            np.full(size, np.nan) if one is None else one.at(lon_deg, lat_deg)
            for one in (self.sigma, self.resolution)
        )
        return sigma, np.where(resolution > 0.0, resolution, np.nan)


SIGMA_PER_RESOLUTION = 0.0245
"""1 sigma of height errors over the effective resolution, for a product without a figure: that of GLD100's calibration
(24.5 m where it resolves 1000 m).
"""

_STEP_PX = 256
"""Pixels along the side of the middle of a file in which the step of its heights is looked for."""


@dataclass(frozen=True)
class HeightErrors:
    """1 sigma and correlation length of height errors, metres."""

    sigma_m: float
    length_m: float


def errors_of_file(dem: Dem) -> HeightErrors:
    """Height errors of a DEM file: as calibrated, else as published (`grid.facts_of`), else by what it resolves
    (`SIGMA_PER_RESOLUTION`) and the step of its heights; the length as calibrated, else by the effective resolution
    (`LENGTH_PER_RESOLUTION`).
    """
    facts, found = dem.facts, dem.effective_resolution
    resolution_m = found.resolution_m if found.is_measured else dem.gsd_m
    sigma_m = facts.sigma_m if facts.calibrated_sigma_m is None else facts.calibrated_sigma_m
    if sigma_m is None:
        rounding_m = height_step_m(dem) / math.sqrt(12.0)
        sigma_m = math.hypot(SIGMA_PER_RESOLUTION * resolution_m, rounding_m)
    if facts.calibrated_length_m is not None:
        return HeightErrors(sigma_m, facts.calibrated_length_m)
    if not found.is_measured and facts.resolution_m is not None:
        resolution_m = max(facts.resolution_m, dem.gsd_m)
    return HeightErrors(sigma_m, LENGTH_PER_RESOLUTION * resolution_m)


def height_step_m(dem: Dem) -> float:
    """Least difference of two heights in the middle of a file, metres: the step of quantised heights, next to nothing for
    others.
    """
    down, across = dem.grid.height, dem.grid.width
    row, col = (max(0, (size - _STEP_PX) // 2) for size in (down, across))
    z = dem.read(row, min(row + _STEP_PX, down), col, min(col + _STEP_PX, across)).astype(
        np.float64
    )
    steps = np.diff(np.unique(z[np.isfinite(z)]))
    return float(steps.min(initial=np.inf)) if steps.size else 0.0


def warn_of_unknown(dems: DemSet, lon_deg: ArrayLike, lat_deg: ArrayLike) -> None:
    """Log a warning that names the files used at places (n,) for whose heights no 1 sigma is known."""
    used = np.unique(dems.product_at(lon_deg, lat_deg))
    for dem in (dems.dems[n] for n in used[used >= 0].tolist()):
        facts = dem.facts
        if facts.sigma_m is None and facts.calibrated_sigma_m is None:
            unknown = "not recognised as a product with a known error (was the file renamed?)"
            log.warning(
                "%s: %s: a 1 sigma of %.3g m is assumed "
                "for its heights, %g %% of what they resolve; give [errors] height_sigma_m in a BUILD.toml, or maps: "
                "`dem.sigma_map`, `dem.resolution_map`",
                dem.path.name,
                unknown if facts is UNKNOWN else f"{facts.family}: {facts.source}",
                errors_of_file(dem).sigma_m,
                100.0 * SIGMA_PER_RESOLUTION,
            )


def height_errors(
    dems: DemSet,
    lon_deg: ArrayLike,
    lat_deg: ArrayLike,
    maps: ErrorMaps | None = None,
    product: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """1 sigma and correlation length of the height errors at places (n,), metres, both (n,).

    From the maps where they have a value; else those of the file that is used there
    (`errors_of_file`); NaN outside all files. ``product`` (n,): index of that file, -1 for none;
    default: the first by rank whose footprint contains the place (`DemSet.product_at`).
    """
    lon, lat = np.broadcast_arrays(*(np.atleast_1d(a).astype(float) for a in (lon_deg, lat_deg)))
    index = dems.product_at(lon, lat) if product is None else np.atleast_1d(product)
    sigma, length = np.full(lon.size, np.nan), np.full(lon.size, np.nan)
    for number in np.unique(index[index >= 0]).tolist():
        found = errors_of_file(dems.dems[number])
        here = index == number
        sigma[here], length[here] = found.sigma_m, found.length_m
    if maps is not None:
        mapped, resolution = maps.at(lon, lat)
        held = index >= 0
        sigma = np.where(held & np.isfinite(mapped), mapped, sigma)
        length = np.where(
            held & np.isfinite(resolution), LENGTH_PER_RESOLUTION * resolution, length
        )
    return sigma, length
