"""A Moon of any resolution whose files need no space: virtual rasters (GDAL's VRT) that repeat one small tile."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyproj
import rasterio

from .synthetic import cratered

RADIUS_M = 1737400.0
_HEIGHT_MAX_M = 5000.0
POLAR_LATITUDE = 60.0
"""Latitude from which polar files exist too."""


def virtual_moon(folder: Path, pixels_per_degree: int, tile_px: int = 2048) -> list[Path]:
    """Three DEM files: latitudes -60..60 in an equirectangular map, and both poles in stereographic maps.

    The files together are at most 14 MB. The terrain is continuous and repeats after ``tile_px`` pixels.
    """
    folder.mkdir(parents=True, exist_ok=True)
    tile = folder / "tile.tif"
    pixel_m = math.radians(1.0) * RADIUS_M / pixels_per_degree
    if not tile.exists():
        quarter = cratered(tile_px // 2, pixel_m, seed=16)
        quarter *= min(1.0, _HEIGHT_MAX_M / float(np.abs(quarter).max()))
        half = np.concatenate([quarter, quarter[:, ::-1]], axis=1)
        _write_tile(tile, np.concatenate([half, half[::-1]], axis=0))
    width, height = 360 * pixels_per_degree, int(2 * POLAR_LATITUDE) * pixels_per_degree
    edge_m = 2.0 * RADIUS_M * math.tan(math.radians((90.0 - POLAR_LATITUDE) / 2.0))
    side = 2 * math.ceil(edge_m / pixel_m + 8)
    sphere = f"+R={RADIUS_M:.0f} +units=m +no_defs"
    maps = {
        "moon_belt": (f"+proj=eqc +lat_ts=0 +lon_0=0 {sphere}", width, height),
        "moon_north": (f"+proj=stere +lat_0=90 +lon_0=0 {sphere}", side, side),
        "moon_south": (f"+proj=stere +lat_0=-90 +lon_0=0 {sphere}", side, side),
    }
    files = []
    for name, (crs, columns, rows) in maps.items():
        path = folder / f"{name}_{pixels_per_degree}.vrt"
        path.write_text(_vrt(crs, columns, rows, pixel_m, tile.name, tile_px))
        files.append(path)
    return files


def _write_tile(path: Path, height_m: np.ndarray) -> None:
    rows, columns = height_m.shape
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="float32",
        tiled=True, blockxsize=256, blockysize=256, compress="deflate", predictor=3,
        transform=rasterio.Affine(2.0, 0.0, 0.0, 0.0, -2.0, 0.0),
    ) as file:  # fmt: skip
        file.write(height_m, 1)


def _vrt(crs: str, columns: int, rows: int, pixel_m: float, tile: str, tile_px: int) -> str:
    """A virtual raster centred on the origin of its map, covered with copies of the tile."""
    sources = [
        f'<SimpleSource><SourceFilename relativeToVRT="1">{tile}</SourceFilename><SourceBand>1</SourceBand>'
        f'<SourceProperties RasterXSize="{tile_px}" RasterYSize="{tile_px}" DataType="Float32" BlockXSize="256" BlockYSize="256"/>'
        f'<SrcRect xOff="0" yOff="0" xSize="{min(tile_px, columns - x)}" ySize="{min(tile_px, rows - y)}"/>'
        f'<DstRect xOff="{x}" yOff="{y}" xSize="{min(tile_px, columns - x)}" ySize="{min(tile_px, rows - y)}"/></SimpleSource>'
        for y in range(0, rows, tile_px)
        for x in range(0, columns, tile_px)
    ]
    corner = f"{-columns / 2 * pixel_m!r}, {pixel_m!r}, 0, {rows / 2 * pixel_m!r}, 0, {-pixel_m!r}"
    return (
        f'<VRTDataset rasterXSize="{columns}" rasterYSize="{rows}"><SRS>{pyproj.CRS.from_proj4(crs).to_wkt()}</SRS>'
        f'<GeoTransform>{corner}</GeoTransform><VRTRasterBand dataType="Float32" band="1" blockXSize="256" blockYSize="256">'
        f"{''.join(sources)}</VRTRasterBand></VRTDataset>"
    )
