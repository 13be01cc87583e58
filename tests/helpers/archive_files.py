"""One product of the archives, small, from its exact label text: sizes, offsets and bounds cut consistently, pixels behind
or beside it. One of each: `archive_products`.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyproj
import rasterio

from . import real_heights
from .products import DEGREE_M, LABELS, Surface, _write, cut


@dataclass(frozen=True)
class Frame:
    """Pixels on a map: its CRS (PROJ), the pixel's side and the north-west corner, metres."""

    crs: str
    pixel_m: float
    west_m: float
    north_m: float
    cols: int
    rows: int

    def lonlat(self, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Degrees, by PROJ, of fractional pixels (0, 0 is the centre of the north-west one)."""
        x = self.west_m + (np.asarray(column) + 0.5) * self.pixel_m
        y = self.north_m - (np.asarray(row) + 0.5) * self.pixel_m
        back = pyproj.Transformer.from_crs(self.crs, real_heights.SPHERE, always_xy=True)
        lon, lat = back.transform(x, y)
        return np.asarray(lon), np.asarray(lat)

    @cached_property
    def heights_of(self) -> Callable[[Surface], np.ndarray]:
        places = self.lonlat(*np.meshgrid(np.arange(self.cols), np.arange(self.rows)))
        return lambda surface: surface(*places)

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Degrees of the outermost corners and of the middles of the sides."""
        right, bottom = self.cols - 0.5, self.rows - 0.5
        middle_c, middle_r = (self.cols - 1) / 2, (self.rows - 1) / 2
        column = np.array([-0.5, middle_c, right, right, right, middle_c, -0.5, -0.5])
        row = np.array([-0.5, -0.5, -0.5, middle_r, bottom, bottom, bottom, middle_r])
        return self.lonlat(column, row)

    @property
    def has_pole(self) -> bool:
        return (
            "+proj=stere" in self.crs
            and self.west_m < 0.0 < self.west_m + self.cols * self.pixel_m
            and self.north_m > 0.0 > self.north_m - self.rows * self.pixel_m
        )


@dataclass(frozen=True)
class Product:
    """A product as it was made: what a reader of it must find."""

    name: str  # what it goes by, see lcp_catalog.dem.grid
    label: Path | None  # None: in front of the pixels, or a GeoTIFF
    image: Path
    frame: Frame
    heights_m: (
        np.ndarray
    )  # of the surface at the pixels' centres, before they are stored; NaN: missing
    step_m: float  # between two heights that can be stored

    @property
    def opened_by(self) -> list[Path]:
        return [path for path in (self.label, self.image) if path is not None]

    def copied_to(self, folder: Path) -> Path:
        """Its files in another folder; the label's path, or the image's where the label is in front."""
        copies = [Path(shutil.copy(path, folder)) for path in self.opened_by]
        return copies[0]


def cylinder_frame(
    west: float,
    north: float,
    cols: int,
    rows: int,
    per_degree: float,
    lon_0: float,
    lat_ts: float = 0.0,
) -> Frame:
    """A window of a cylinder by its north-west corner in degrees."""
    pixel_m = DEGREE_M / per_degree
    crs = f"+proj=eqc +lat_ts={lat_ts:g} +lon_0={lon_0:g} +R=1737400 +units=m +no_defs"
    ring_m = DEGREE_M * np.cos(np.radians(lat_ts))
    return Frame(crs, pixel_m, (west - lon_0) * ring_m, north * DEGREE_M, cols, rows)


def polar_frame(pole: int, pixel_m: float, cols: int = 72, rows: int = 60) -> Frame:
    """A window with the pole inside, but not in its middle, so that no axis can be taken for another."""
    crs = f"+proj=stere +lat_0={90 * pole} +lon_0=0 +R=1737400 +units=m +no_defs"
    return Frame(crs, pixel_m, -(cols // 2 + 7) * pixel_m, (rows // 2 - 5) * pixel_m, cols, rows)


def archive_text(name: str) -> str:
    """The text byte for byte, its line ends too."""
    return (LABELS / name).read_bytes().decode("latin-1")


def map_object(text: str) -> str:
    """The map projection object of a label."""
    return re.search(
        r"OBJECT *= IMAGE_MAP_PROJECTION.*END_OBJECT *= IMAGE_MAP_PROJECTION", text, re.S
    )[0]


def cut_to(text: str, frame: Frame, **changes: object) -> str:
    """A label's sizes, offsets and bounds for another window, and further values; keys that the text
    does not have are left out (its SCALE is only changed where it is another product's).
    """
    lon, lat = frame.edges()
    values: dict[str, object] = {
        "FILE_RECORDS": frame.rows,
        "LINES": frame.rows,
        "LINE_SAMPLES": frame.cols,
        "LINE_LAST_PIXEL": frame.rows,
        "SAMPLE_LAST_PIXEL": frame.cols,
        "LINE_PROJECTION_OFFSET": round(frame.north_m / frame.pixel_m - 0.5, 6),
        "SAMPLE_PROJECTION_OFFSET": round(-frame.west_m / frame.pixel_m - 0.5, 6),
        "MAXIMUM_LATITUDE": 90 if frame.has_pole and lat[0] > 0 else round(float(lat.max()), 9),
        "MINIMUM_LATITUDE": -90 if frame.has_pole and lat[0] < 0 else round(float(lat.min()), 9),
    }
    if not frame.has_pole:
        values["WESTERNMOST_LONGITUDE"] = round(float(lon[0] % 360.0), 9)
        values["EASTERNMOST_LONGITUDE"] = round(float(lon[2] % 360.0), 9)
    known = {key: value for key, value in values.items() if re.search(rf"(?m)^\s*{key}\s*=", text)}
    return cut(text, **{**known, **changes})


def _range(text: str, counts: np.ndarray, digits: int | None) -> dict[str, object]:
    """What the label says of its pixels' extremes, under the keys that it has."""
    low, high = np.nanmin(counts), np.nanmax(counts)
    said = {"MINIMUM": low, "MAXIMUM": high, "DERIVED_MINIMUM": low, "DERIVED_MAXIMUM": high}
    return {
        key: int(value) if digits is None else round(float(value), digits)
        for key, value in said.items()
        if re.search(rf"(?m)^\s*{key}\s*=", text)
    }


def img_product(
    folder: Path,
    name: str,
    called: str,
    text: str,
    frame: Frame,
    surface: Surface,
    km: bool,
    **changes: object,
) -> Product:
    """An .IMG with its label beside it: float32 kilometres or int16 half metres."""
    heights = frame.heights_of(surface)
    samples = (heights / 1000.0).astype("<f4") if km else np.round(heights * 2.0).astype("<i2")
    text = cut_to(
        text,
        frame,
        RECORD_BYTES=samples.itemsize * frame.cols,
        **_range(text, samples, 3 if km else None),
        **changes,
    )
    label = _write(folder, name, text, samples)
    return Product(called, label, folder / f"{name}.IMG", frame, heights, 0.002 if km else 0.5)


def jp2_product(
    folder: Path,
    name: str,
    called: str,
    text: str,
    frame: Frame,
    surface: Surface,
    **changes: object,
) -> Product:
    """A lossless .JP2 of half metres with its _JP2.LBL."""
    heights = frame.heights_of(surface)
    samples = np.round(heights * 2.0).astype(np.int16)
    image = folder / f"{name}.JP2"
    profile = {"count": 1, "dtype": "int16", "width": frame.cols, "height": frame.rows}
    with rasterio.open(
        image, "w", driver="JP2OpenJPEG", QUALITY="100", REVERSIBLE="YES", **profile
    ) as dataset:
        dataset.write(samples, 1)
    found = {
        "REQUIRED_STORAGE_BYTES": f'"{image.stat().st_size}"',
        **_range(text, samples, None),
        **changes,
    }
    label = folder / f"{name}_JP2.LBL"
    label.write_bytes(cut_to(text, frame, **found).encode("latin-1"))
    return Product(called, label, image, frame, heights, 0.5)


def attached(
    folder: Path, name: str, called: str, text: str, frame: Frame, samples: np.ndarray, step_m: float,
    heights: np.ndarray | None = None,
) -> Product:  # fmt: skip
    """An .IMG with its label in front, in whole records of one line of pixels."""
    record = samples.itemsize * frame.cols
    records = -(-len(text) // record) + 1
    text = re.sub(r"(?m)^(\^IMAGE\s*=)[^\r\n]*", rf"\g<1> {records + 1}", text)
    text = cut(text, RECORD_BYTES=record, LABEL_RECORDS=records, FILE_RECORDS=records + frame.rows)
    image = folder / f"{name}.IMG"
    image.write_bytes(text.encode("latin-1").ljust(records * record) + samples.tobytes())
    return Product(
        called,
        None,
        image,
        frame,
        samples.astype(np.float64) if heights is None else heights,
        step_m,
    )
