"""Real heights of the Moon as surfaces of longitude and latitude, for products that tests make.

Read with rasterio or numpy and interpolated bilinearly here, so that nothing of the library's own reading or
sampling is in them. Where the files come from: tests/data/PROVENANCE.md, sample_data/PROVENANCE.txt.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pyproj
import rasterio

DATA = Path(__file__).resolve().parents[1] / "data"
SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
SPHERE = "+proj=longlat +R=1737400 +no_defs"


def hadley(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """Heights of WAC GLD100 (256 pixels a degree) around Hadley Rille, 0..10 E, 20..30 N, metres."""
    return _from_map(SAMPLE, lon_deg, lat_deg)


def polar(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """Heights within 30 km of a pole (GLD100's LOLA fill; cells of 0.5 km north, 1 km south), metres."""
    north = np.all(np.asarray(lat_deg) > 0.0)
    name = "north_500m.tif" if north else "south_1000m.tif"
    return _from_map(DATA / "poles" / name, lon_deg, lat_deg)


def bilinear(values: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Between the four nearest cells; places outside the cells' centres are a mistake of the test."""
    rows, columns = values.shape
    assert np.min(column) >= 0.0, "west of the source"
    assert np.max(column) <= columns - 1, "east of the source"
    assert np.min(row) >= 0.0, "north of the source"
    assert np.max(row) <= rows - 1, "south of the source"
    j = np.minimum(np.floor(column).astype(int), columns - 2)
    i = np.minimum(np.floor(row).astype(int), rows - 2)
    u, v = column - j, row - i
    top = values[i, j] * (1.0 - u) + values[i, j + 1] * u
    bottom = values[i + 1, j] * (1.0 - u) + values[i + 1, j + 1] * u
    return np.asarray(top * (1.0 - v) + bottom * v)


def _from_map(path: Path, lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    values, affine, crs = _raster(path)
    x, y = pyproj.Transformer.from_crs(SPHERE, crs, always_xy=True).transform(lon_deg, lat_deg)
    column, row = ~affine * (np.asarray(x), np.asarray(y))
    return bilinear(values, column - 0.5, row - 0.5)


@functools.cache
def _raster(path: Path) -> tuple[np.ndarray, rasterio.Affine, str]:
    with rasterio.open(path) as dataset:
        values = dataset.read(1).astype(np.float64)
        assert dataset.nodata is None or not (values == dataset.nodata).any()
        return values, dataset.transform, dataset.crs.to_wkt()
