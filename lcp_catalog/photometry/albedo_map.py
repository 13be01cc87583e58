"""Albedo maps: relative brightness of the surface, as a factor on the radiance of the reflectance
model.

The factor is the map's value over a reference, by default the map's mean over the surface. Values
are resampled like heights (`dem.tiles`): area means for cells coarser than the map's pixels, cubic
convolution for finer cells.

Pixels of an albedo map: linear values of a band, and their mean by area on the surface.

Albedo maps in colour: red, green and blue as three albedo maps over one reference.

The reference is by default the mean luminance of the map (ITU-R BT.709), so that colours stay as they
are in the map, and the luminance of a render is that under the map's luminance.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Hashable, Sequence
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
from ..dem.grid import Grid
from ..dem.products import facts_of, product_name
from ..dem.raster import Gridded, Raster, grid_of, open_dataset
from ..dem.tiles import Layer
from ..errors import AlbedoError, DemError
from ..geometry.bounds import Bounds
from ..geometry.frames import EnuFrame
from ..kernels.resampling import heights
from ..terrain.area import Area
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from . import moon_map
from .srgb import decode_srgb, luminance

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
    files: tuple[Path, ...]

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
    dataset, files = _opened(path)
    _refuse_heights(dataset, path)
    if band is None:
        _refuse_colours(dataset, path)
    k = 0 if band is None else band - 1
    try:
        grid = grid_of(dataset, path)
    except DemError as error:
        raise AlbedoError(str(error)) from error
    raster = replace(Raster.of_band(dataset, files, path, k + 1), masked=_masked(dataset, k))
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
    return AlbedoPixels(path, grid, Brightness(raster, encoding or "linear", full), files)


def colour_bands(path: Path) -> tuple[int, ...]:
    """The bands, counted from 1, of red, green and blue: those that the file names so, else all of a
    raster of three bands besides alpha. Empty for any other raster. AlbedoError if it cannot be read.
    """
    names = [kind.name for kind in _opened(path)[0].colorinterp]
    if set(_RGB) <= set(names):
        return tuple(names.index(colour) + 1 for colour in _RGB)
    bands = [k for k, name in enumerate(names, start=1) if name != "alpha"]
    named = any(name in _COLOURS for name in names)
    return tuple(bands) if len(bands) == len(_RGB) and not named else ()


def _opened(path: Path) -> tuple[Any, tuple[Path, ...]]:
    try:
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


_UNIT = 1024.0
"""Factors are sampled in units of 1/1024: sums along a row have steps of 1/8192
(`kernels.resampling.heights`)."""

PATCH_STEP = 2.0**-11
"""Step of the factors of patches: an error of at most 0.00025, far below that of any map, so that a file holds them in
half the bytes."""

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

        Without a ``reference`` every pixel is read once for the mean, except of the package's own map,
        which the word ``moon`` names, too.
        """
        check_reading(encoding, reference)
        pixels = open_pixels(_file(path), encoding)
        value = reference
        if value is None:
            value = moon_map.MEAN if pixels.path == moon_map.FILE else mean_value(pixels)
        return cls.over(pixels, float(value), reference is None)

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
        """Every local file that is read for the map."""
        return self.pixels.files

    def describe(self) -> dict[str, Any]:
        """Values for a result's metadata; without folders. Of the package's own map also version and licence."""
        how = "mean of the map" if self.reference_is_mean else "stated"
        origin = moon_map.ORIGIN if self.pixels.path == moon_map.FILE else {}
        return {
            "name": self.name,
            "encoding": self.encoding,
            "reference": self.reference,
            "reference_is": how,
        } | origin

    def provenance(self) -> dict[str, Any]:
        """`describe`, with the side of a pixel at true scale, and name, size and SHA-256 of every file."""
        return self.describe() | {"pixel_m": self.pixels.gsd_m, "files": file_facts(self.files)}

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
        is north, column 0 west. NaN outside the map. They are rounded to `PATCH_STEP`.
        """
        step = (np.arange(z_m.shape[1]) - z_m.shape[1] // 2) * gsd_m
        x, y = np.tile(step, len(step)), np.repeat(-step, len(step))
        lon, lat = np.empty((2, len(frames), x.size))
        for k, (frame, z) in enumerate(zip(frames, z_m, strict=True)):
            up_m, heights_m = MOON_RADIUS_M + frame.height_m, z.ravel().astype(np.float64)
            heights.enu_to_lonlat(x, y, heights_m, frame.rotation, up_m, lon[k], lat[k])
        found = self.at(np.degrees(lon), np.degrees(lat), gsd_m).reshape(z_m.shape)
        return (np.rint(found / PATCH_STEP) * PATCH_STEP).astype(np.float32)

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


def _file(name: Path | str) -> Path:
    """The file of a map (`moon_map.map_file`); AlbedoError for the word that means none."""
    path = moon_map.map_file(name)
    if path is None:
        raise AlbedoError(f"{name}: means no albedo map; leave it out")
    return path


def open_map(
    path: Path | str, encoding: str | None = None, reference: float | None = None
) -> AlbedoMap | ColourMap:
    """The map of a raster: in colour if it has red, green and blue, or three bands; else its first
    band. AlbedoError if it cannot be used.
    """
    bands = colour_bands(_file(path))
    if bands:
        return ColourMap.open(path, bands, encoding, reference)
    return AlbedoMap.open(path, encoding, reference)


def open_grey_map(
    path: Path | str, encoding: str | None = None, reference: float | None = None
) -> AlbedoMap:
    """The first band of a raster, as `AlbedoMap.open`; AlbedoError for one that `open_map` opens in
    colour.
    """
    if colour_bands(_file(path)):
        raise AlbedoError(
            f"{path}: has three bands, which lcp render takes as red, green and blue; a frame has one: "
            "choose a band first (gdal_translate -b 1)"
        )
    return AlbedoMap.open(path, encoding, reference)
