"""Small DEM products for tests, made from the archive's exact label texts with sizes, offsets and
bounds cut consistently, and simple ones of any surface. One of each, with real heights: `archive_products`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.transform import from_origin

LABELS = Path(__file__).resolve().parents[1] / "data" / "labels"
RADIUS_M = 1_737_400.0
DEGREE_M = np.radians(1.0) * RADIUS_M
EQC = "+proj=eqc +lat_ts=0 +lon_0=0 +R=1737400 +units=m +no_defs"

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]


def hills(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """A smooth surface of 2 km relief, continuous over the seam and the poles; heights in
    metres.
    """
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    x, y, z = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)
    return (
        600.0 * np.sin(40.0 * x + 1.0)
        + 500.0 * np.cos(33.0 * y)
        + 400.0 * np.sin(27.0 * z - 2.0) * np.cos(11.0 * x)
    )


def cut(text: str, **values: object) -> str:
    """The label with other values; a key that the text does not have is a mistake. Units behind the
    value stay.
    """
    for key, value in values.items():
        name = re.escape(key.replace("POINTER_", "^"))
        text, count = re.subn(
            rf'(?m)^(\s*{name}\s*=\s*)("[^"]*"|\'[^\']*\'|[^\s<]+)', rf"\g<1>{value}", text
        )
        assert count, f"the label has no {key}"
    return text


def label_text(name: str) -> str:
    return (LABELS / f"{name}.LBL").read_text(encoding="latin-1")


def sldem_512(
    folder: Path,
    west: int,
    north: int,
    cols: int,
    rows: int,
    surface: Surface = hills,
    **changes: object,
) -> Path:
    """A tile of SLDEM2015_512: float32 kilometres; returns the label's path."""
    name = f"SLDEM2015_512_{north:02d}N_{west:03d}_FLOAT"
    text = cut(
        label_text("SLDEM2015_512_00N_30N_000_045_FLOAT"),
        PRODUCT_ID=f'"{name}"',
        FILE_NAME=f'"{name}.IMG"',
        POINTER_IMAGE=f'"{name}.IMG"',
        FILE_RECORDS=rows,
        RECORD_BYTES=4 * cols,
        LINES=rows,
        LINE_SAMPLES=cols,
        LINE_LAST_PIXEL=rows,
        SAMPLE_LAST_PIXEL=cols,
        MAXIMUM_LATITUDE=north,
        MINIMUM_LATITUDE=north - rows / 512,
        WESTERNMOST_LONGITUDE=west,
        EASTERNMOST_LONGITUDE=west + cols / 512,
        LINE_PROJECTION_OFFSET=north * 512 - 0.5,
        SAMPLE_PROJECTION_OFFSET=(180 - west) * 512 - 0.5,
    )
    lon = west + (np.arange(cols) + 0.5) / 512
    lat = north - (np.arange(rows) + 0.5) / 512
    height = surface(*np.meshgrid(lon, lat))
    return _write(folder, name, cut(text, **changes), (height / 1000.0).astype("<f4"))


def ldem_80s(folder: Path, pixels: int, surface: Surface = hills, **changes: object) -> Path:
    """The middle of LDEM_80S_20M: int16 half metres around the south pole; returns the label's
    path.
    """
    name = "LDEM_80S_20M"
    text = cut(
        label_text(name),
        FILE_RECORDS=pixels,
        RECORD_BYTES=2 * pixels,
        LINES=pixels,
        LINE_SAMPLES=pixels,
        LINE_LAST_PIXEL=pixels,
        SAMPLE_LAST_PIXEL=pixels,
        LINE_PROJECTION_OFFSET=pixels / 2 - 0.5,
        SAMPLE_PROJECTION_OFFSET=pixels / 2 - 0.5,
    )
    if "MAXIMUM_LATITUDE" not in changes:  # of the middle of an edge, as in the archive's labels
        edge = -90.0 + 2.0 * np.degrees(np.arctan(10.0 * pixels / (2.0 * RADIUS_M)))
        text = cut(text, MAXIMUM_LATITUDE=edge)
    at = (np.arange(pixels) - (pixels / 2 - 0.5)) * 20.0
    x, y = np.meshgrid(at, -at)
    lat = -90.0 + 2.0 * np.degrees(
        np.arctan(np.hypot(x, y) / (2.0 * RADIUS_M))
    )  # Snyder (1987) eq. 20-14
    height = surface(np.degrees(np.arctan2(x, y)), lat)
    return _write(folder, name, cut(text, **changes), np.round(height * 2.0).astype("<i2"))


def gld100_attached(folder: Path, samples: np.ndarray) -> Path:
    """WAC GLD100 with its label in front of the pixels: int16 metres, the whole Moon with as many
    rows as ``samples`` has.
    """
    rows, cols = samples.shape
    assert cols == 2 * rows
    per_degree = rows / 180.0
    record = 11520
    text = cut(
        label_text("WAC_GLD100_E000N1800_016P_attached"),
        FILE_RECORDS=1 + rows,
        LINES=rows,
        LINE_SAMPLES=cols,
        LINE_LAST_PIXEL=rows,
        SAMPLE_LAST_PIXEL=cols,
        MAP_RESOLUTION=per_degree,
        MAP_SCALE=repr(DEGREE_M / per_degree),
        LINE_PROJECTION_OFFSET=rows / 2 - 0.5,
    )
    path = folder / "WAC_GLD100_E000N1800_016P.IMG"
    path.write_bytes(text.encode("latin-1").ljust(record) + samples.astype("<i2").tobytes())
    return path


def geotiff(
    path: Path,
    heights: np.ndarray,
    west_m: float,
    north_m: float,
    pixel_m: float,
    crs: str = EQC,
    nodata: float | None = None,
    scale: float = 1.0,
    offset: float = 0.0,
) -> Path:
    """A GeoTIFF whose north-west corner lies at map coordinates (west, north)."""
    profile = {
        "driver": "GTiff",
        "count": 1,
        "dtype": heights.dtype,
        "width": heights.shape[1],
        "height": heights.shape[0],
    }
    where = from_origin(west_m, north_m, pixel_m, pixel_m)
    with rasterio.open(path, "w", **profile, crs=crs, transform=where, nodata=nodata) as dataset:
        dataset.write(heights, 1)
        dataset.scales, dataset.offsets = (scale,), (offset,)
    return path


def cylinder(
    path: Path,
    west: float,
    north: float,
    shape: tuple[int, int],
    per_degree: float,
    surface: Surface = hills,
) -> Path:
    """A GeoTIFF cylinder of a surface, float64 so that only the resampling is judged.

    The surface is asked with longitudes (1, columns) and latitudes (rows, 1).
    """
    rows, cols = shape
    lon, lat = (
        west + (np.arange(cols) + 0.5) / per_degree,
        north - (np.arange(rows) + 0.5) / per_degree,
    )
    heights = np.array(np.broadcast_to(surface(lon[None, :], lat[:, None]), shape))
    return geotiff(path, heights, west * DEGREE_M, north * DEGREE_M, DEGREE_M / per_degree)


def _write(folder: Path, name: str, text: str, samples: np.ndarray) -> Path:
    (folder / f"{name}.IMG").write_bytes(samples.tobytes())
    label = folder / f"{name}.LBL"
    label.write_text(text, encoding="latin-1", newline="")
    return label


def holed(
    path: Path,
    shape: tuple[int, int],
    holes: list[tuple[slice, slice]],
    west_m: float,
    north_m: float,
    pixel_m: float,
    **how: Any,
) -> Path:
    """A GeoTIFF of noise with windows of its pixels missing."""
    heights = np.random.default_rng(5).uniform(-900.0, 900.0, shape).astype(np.float32)
    for hole in holes:
        heights[hole] = -32768.0
    return geotiff(path, heights, west_m, north_m, pixel_m, nodata=-32768.0, **how)
