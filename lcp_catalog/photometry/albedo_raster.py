"""Pixels of an albedo map: linear values of a band, and their mean by area on the surface."""

from __future__ import annotations

import logging
from collections.abc import Hashable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..dem.georeferenced import Gridded, grid_of
from ..dem.grid import Grid
from ..dem.products import facts_of, product_name
from ..dem.raster import Raster, open_dataset, require_file
from ..errors import AlbedoError, DemError
from .srgb import decode_srgb

log = logging.getLogger(__name__)

_COLOURS = ("red", "green", "blue", "cyan", "magenta", "yellow", "hue", "saturation", "palette")
_RGB = ("red", "green", "blue")
_LENGTHS = ("m", "km", "meter", "meters", "metre", "metres", "kilometer", "kilometers", "kilometre")


@dataclass(frozen=True)
class Brightness:
    """Linear values of a band of a file, times ``unit``."""

    raster: Raster
    encoding: str
    full: float  # code of full scale in a display image
    unit: float = 1.0

    def read(self, row0: int, row1: int, col0: int, col1: int) -> NDArray[np.float32]:
        """Values of a window inside the raster, float32; NaN for missing pixels."""
        return (self.linear(row0, row1, col0, col1) * self.unit).astype(np.float32)

    def linear(self, row0: int, row1: int, col0: int, col1: int) -> Array:
        """Decoded values of the map; AlbedoError for a value that is invalid as a brightness."""
        values = self.raster.values(row0, row1, col0, col1)
        self._refuse_impossible(values)
        return values if self.encoding == "linear" else decode_srgb(values / self.full)

    def _refuse_impossible(self, values: Array) -> None:
        with np.errstate(invalid="ignore"):
            wrong = values < 0.0
            if wrong.any():
                raise AlbedoError(
                    f"{self.raster.path}: has the value {values[wrong][0]:g}, but brightness is "
                    "never below 0. Either this is a DEM, or its value for missing data is not "
                    "declared (gdal_translate -a_nodata)"
                )
            wrong = values > self.full
        if self.encoding == "srgb" and wrong.any():
            raise AlbedoError(
                f"{self.raster.path}: has the value {values[wrong][0]:g}; but the codes of a display "
                f"image end at {self.full:g}; use `albedo_encoding` linear"
            )


@dataclass(frozen=True)
class AlbedoPixels(Gridded):
    """One map: its file, its grid and its values. Picklable; each process opens the file again."""

    path: Path
    grid: Grid
    raster: Brightness

    @property
    def identity(self) -> Hashable:
        """Key of the values: the file, the band and the decoding."""
        raster = self.raster
        return (super().identity, raster.raster.band, raster.encoding, raster.unit)


def open_pixels(path: Path, encoding: str | None, band: int | None = None) -> AlbedoPixels:
    """A band of a raster with a lunar CRS, counted from 1; None: the first, of a raster without
    colours. AlbedoError if it cannot be used.

    Without an ``encoding`` the values are linear, with a warning if they look like those of a
    display image.
    """
    dataset = _opened(path)
    _refuse_heights(dataset, path)
    if band is None:
        _refuse_colours(dataset, path)
    k = 0 if band is None else band - 1
    try:
        grid = grid_of(dataset, path)
    except DemError as error:
        raise AlbedoError(str(error)) from error
    raster = replace(Raster.of_band(dataset, path, k + 1), masked=_masked(dataset, k))
    plain = raster.scale_m == 1.0 and raster.offset_m == 0.0
    if encoding == "srgb" and not plain:
        raise AlbedoError(
            f"{path}: has a scale and an offset, unlike the codes of a display image; "
            "use `albedo_encoding` linear"
        )
    if encoding is None and plain and dataset.dtypes[k] == "uint8" and band in (None, 1):
        log.warning(
            "%s: 8-bit samples are read as linear brightness; if they are codes of a display image, "
            "use `albedo_encoding` srgb",
            path,
        )
    full = float(np.iinfo(dataset.dtypes[k]).max) if "int" in dataset.dtypes[k] else 1.0
    return AlbedoPixels(path, grid, Brightness(raster, encoding or "linear", full))


def colour_bands(path: Path) -> tuple[int, ...]:
    """The bands, counted from 1, of red, green and blue: those that the file names so, else all of a
    raster of three bands besides alpha. Empty for any other raster. AlbedoError if it cannot be read.
    """
    names = [kind.name for kind in _opened(path).colorinterp]
    if set(_RGB) <= set(names):
        return tuple(names.index(colour) + 1 for colour in _RGB)
    bands = [k for k, name in enumerate(names, start=1) if name != "alpha"]
    named = any(name in _COLOURS for name in names)
    return tuple(bands) if len(bands) == len(_RGB) and not named else ()


def _opened(path: Path) -> Any:
    try:
        require_file(path, "an albedo map")
        return open_dataset(path, "an albedo map")
    except DemError as error:
        raise AlbedoError(str(error)) from error


def mean_value(pixels: AlbedoPixels) -> float:
    """Mean of the valid values, weighted by area on the surface; AlbedoError if there are none or
    all are 0. Every pixel is read once, in strips.
    """
    total = weight = 0.0
    grid = pixels.grid
    turn = min(grid.width, grid.period) if grid.wraps else grid.width
    for row0, row1, col0, col1 in pixels.raster.raster.windows(turn):
        rows, columns = (row0, row1), (col0, col1)
        values = pixels.raster.linear(row0, row1, col0, col1)
        there = np.isfinite(values)
        values[~there] = 0.0
        total += _by_area(grid, rows, columns, values)
        weight += _by_area(grid, rows, columns, there)
    if weight == 0.0:
        raise AlbedoError(f"{pixels.path}: every pixel is missing")
    if total == 0.0:
        raise AlbedoError(f"{pixels.path}: every value is 0")
    return total / weight


def _by_area(
    grid: Grid, rows: tuple[int, int], columns: tuple[int, int], values: NDArray[Any]
) -> float:
    """Sum of a window's values, each times its pixel's area; on a cylindrical map, all pixels of a
    row have the same area.
    """
    row = np.arange(*rows)[:, None]
    if grid.pole:
        return float(np.sum(grid.cell_weight(np.arange(*columns)[None, :], row) * values))
    return float(np.sum(grid.cell_weight(np.zeros((1, 1)), row)[:, 0] * values.sum(axis=1)))


def _refuse_heights(dataset: Any, path: Path) -> None:
    """AlbedoError if the file is declared as a DEM; other DEMs are recognised by their negative
    heights.
    """
    unit, offset = (dataset.units[0] or "").strip().lower(), float(dataset.offsets[0])
    known = facts_of(product_name(path.stem)).family != "unknown"
    if known or unit in _LENGTHS or offset in (MOON_RADIUS_M, MOON_RADIUS_M / 1e3):
        raise AlbedoError(f"{path}: contains heights; a map of brightness is needed")


def _refuse_colours(dataset: Any, path: Path) -> None:
    names = [kind.name for kind in dataset.colorinterp]
    colours = [name for name in names if name in _COLOURS]
    if colours:
        raise AlbedoError(
            f"{path}: is a colour image ({', '.join(dict.fromkeys(colours))}); an albedo map has one "
            f"band of brightness, and only lcp render takes one of red, green and blue; make one "
            f"first (gdal_translate {'-expand gray' if 'palette' in colours else '-b 1'})"
        )
    more = [name for name in names[1:] if name != "alpha"]
    if more:
        hint = " (lcp render takes three as red, green and blue)" if len(more) == 2 else ""
        log.warning("%s: has %d bands; the first is used%s", path, len(more) + 1, hint)


def _masked(dataset: Any, k: int) -> bool:
    """True if a mask or an alpha band marks missing pixels of the band of index ``k``."""
    return any(flag.name in ("per_dataset", "alpha") for flag in dataset.mask_flag_enums[k])
