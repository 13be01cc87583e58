"""Rendered rasters as GeoTIFF and PNG, encoded in memory; the same input gives the same bytes.

`atomic_files` writes the bytes, so that a full disk raises an error: GDAL ignores some errors when it
closes a file.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import rasterio
from numpy.typing import ArrayLike, NDArray
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile
from rasterio.transform import Affine

from ..geometry.frames import EnuFrame
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane

TILE = 256
_GAMMA = 1.2
_WHITE_PERCENTILE = 99.5


def orthographic_crs(frame: EnuFrame) -> rasterio.CRS:
    """The CRS whose x and y are the frame's east and north, in metres, for points of the reference
    sphere.

    A point at height h has the map position of the sphere's point on the same vertical of the frame,
    not on its own vertical. At d metres from the centre, its longitude and latitude therefore differ
    by about h d / R metres.
    """
    return rasterio.CRS.from_wkt(MapPlane(ORTHOGRAPHIC, frame.lon_deg, frame.lat_deg).wkt)


def node_transform(x0_m: float, y0_m: float, gsd_m: float) -> Affine:
    """The transform of a raster whose pixel (0, 0) has its centre at the node (x0_m, y0_m)."""
    return Affine(gsd_m, 0.0, x0_m - gsd_m / 2, 0.0, -gsd_m, y0_m + gsd_m / 2)


def geotiff(
    bands: Mapping[str, ArrayLike],
    dtype: str,
    tags: Mapping[str, str],
    crs: rasterio.CRS | None = None,
    transform: Affine | None = None,
    units: Sequence[str] | None = None,
    colours: Mapping[str, str] | None = None,
) -> bytes:
    """A cloud-optimised GeoTIFF, compressed with deflate, with named bands of one shape; nodata is NaN.
    Overviews are means; the bands have their statistics as metadata. ``colours``: the colour (red,
    green, blue) of bands that are shown in one.
    """
    rows, columns = np.shape(next(iter(bands.values())))
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # a camera's plane has no CRS
        with memory.open(
            driver="COG",
            width=columns,
            height=rows,
            count=len(bands),
            dtype=dtype,
            nodata=np.nan,
            crs=crs,
            transform=transform,
            blocksize=TILE,
            compress="deflate",
            predictor="floating_point",
            bigtiff="if_safer",
            overview_resampling="average",
            statistics="yes",
        ) as file:
            for index, (name, band) in enumerate(bands.items(), start=1):
                file.write(np.asarray(band).astype(dtype, copy=False), index)
                file.set_band_description(index, name)
            if units is not None:
                file.units = tuple(units)
            if colours:
                shown = [colours.get(name, "undefined") for name in bands]
                file.colorinterp = tuple(ColorInterp[name] for name in shown)
            file.update_tags(**tags)
        return bytes(memory.getbuffer())


def picture(radiance: ArrayLike) -> NDArray[np.uint8]:
    """Values of a radiance for display, in its shape (with a first axis of three: in colour): 0 is
    black, the 99.5th percentile of all lit values is white, gamma 1.2.
    """
    values = np.nan_to_num(np.asarray(radiance, dtype=np.float64), nan=0.0)
    lit = values[values > 0]
    white = np.percentile(lit, _WHITE_PERCENTILE) if lit.size else 1.0
    grey = np.clip(values / white, 0.0, 1.0) ** (1 / _GAMMA)
    return np.round(255 * grey).astype(np.uint8)


def png(values: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """A PNG of 8 or 16 bits: grey (rows, cols), or red, green and blue (3, rows, cols)."""
    planes = values.reshape(-1, *values.shape[-2:])
    count, rows, columns = planes.shape
    with warnings.catch_warnings(), MemoryFile() as memory:
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        dtype = values.dtype.name
        with memory.open(
            driver="PNG", width=columns, height=rows, count=count, dtype=dtype
        ) as file:
            file.write(planes)
        return bytes(memory.getbuffer())
