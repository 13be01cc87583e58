"""Real relief where none of that resolution is at hand: GLD100's Hadley moved to 75 N and to the pole, as products of
the archive's kinds that meet there.

The ground within 135 km of 25 N 5 E is laid around another place, distances and azimuths from it kept (PROJ's aeqd, both
ways); its heights stay. Products are made of it by `products`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.warp import reproject

from . import products, real_heights
from .archive_files import Frame, Product, archive_text, cylinder_frame, img_product

SOURCE = (5.0, 25.0)
REACH_M, PLANE_M = 136e3, 100.0
"""How far the ground is laid out, and the cell of the plane that it goes through."""
OFFSET_M = 3.0
"""By how much the polar product of a pair stands higher: within what LOLA's and GLD100's uncertainties explain."""


def laid_around(lon: float, lat: float, frame: Frame, higher_m: float = 0.0) -> products.Surface:
    """The ground of `SOURCE`, laid around a place, at the pixels of a frame: GDAL's cubic B-spline, which has no creases at
    the source's posting as bilinear heights have; to the plane of the source, and from that of the place.
    """
    plane, there = (
        f"+proj=aeqd +lon_0={o} +lat_0={a} +R=1737400 +units=m +no_defs"
        for o, a in (SOURCE, (lon, lat))
    )
    side = 2 * round(REACH_M / PLANE_M)
    middle = np.empty((side, side), np.float32)
    corner = rasterio.Affine(PLANE_M, 0.0, -REACH_M, 0.0, -PLANE_M, REACH_M)
    spline = {"resampling": Resampling.cubic_spline}
    with rasterio.open(real_heights.SAMPLE) as source:
        band = rasterio.band(source, 1)
        reproject(band, middle, dst_transform=corner, dst_crs=plane, **spline)
    out = np.full((frame.rows, frame.cols), np.nan, np.float32)
    where = rasterio.Affine(frame.pixel_m, 0.0, frame.west_m, 0.0, -frame.pixel_m, frame.north_m)
    reproject(
        middle, out, src_transform=corner, src_crs=there, dst_transform=where, dst_crs=frame.crs,
        dst_nodata=np.nan, **spline,
    )  # fmt: skip
    assert np.isfinite(out).all(), "the source ends inside the frame"
    return lambda lons, lats: out.astype(np.float64) + higher_m


def polar_product(
    folder: Path,
    area: str,
    pixel_m: int,
    window_m: tuple[float, float, float],
    place: tuple[float, float],
    higher_m: float = 0.0,
) -> Product:
    """LDEM_<area>N: a square of the north's map by its middle x, y and half a side, metres."""
    x, y, half = window_m
    count = 2 * round(half / pixel_m)
    west, north = round((x - half) / pixel_m) * pixel_m, round((y + half) / pixel_m) * pixel_m
    crs = "+proj=stere +lat_0=90 +lon_0=0 +R=1737400 +units=m +no_defs"
    name = f"LDEM_{area}N_{pixel_m}M"
    text = archive_text("LDEM_80S_20M.LBL").replace("LDEM_80S_20M", name)
    scale = {"MAP_SCALE": pixel_m, "MAP_RESOLUTION": f"{products.DEGREE_M / pixel_m:.2f}"}
    frame = Frame(crs, pixel_m, west, north, count, count)
    surface = laid_around(*place, frame, higher_m)
    return img_product(folder, name, name, text, frame, surface, False, CENTER_LATITUDE=90, **scale)


def across_75n(folder: Path, lon: int = 40, half_m: float = 65e3) -> list[Path]:
    """Labels of LDEM_512 (south of 75.5 N) and LDEM_75N_30M (all around 75 N), which stands `OFFSET_M` higher."""
    wide = np.degrees(half_m / products.RADIUS_M / np.cos(np.radians(75.0)))
    cols = int(2 * wide * 512)
    west = round((lon - wide) * 512) / 512
    frame = cylinder_frame(
        west, 75.5, cols, int(512 * (0.5 + np.degrees(half_m / products.RADIUS_M))), 512.0, 180.0
    )
    text = archive_text("LDEM_128.LBL").replace("LDEM_128", "LDEM_512")
    scale = {"MAP_RESOLUTION": 512, "MAP_SCALE": "59.2252938"}
    south = img_product(
        folder, "LDEM_512", "LDEM_512", text, frame, laid_around(lon, 75.0, frame), False, **scale
    )
    rho = 2.0 * products.RADIUS_M * np.tan(np.radians(7.5))
    at = (rho * np.sin(np.radians(lon)), -rho * np.cos(np.radians(lon)), half_m)
    north = polar_product(folder, "75", 30, at, (lon, 75.0), OFFSET_M)
    assert south.label
    assert north.label
    return [south.label, north.label]


def at_the_pole(folder: Path, inner_m: float = 30e3, outer_m: float = 75e3) -> list[Path]:
    """Labels of LDEM_80N_20M and, in the middle of it, LDEM_85N_10M, which stands `OFFSET_M` higher."""
    outer = polar_product(folder, "80", 20, (0.0, 0.0, outer_m), (0.0, 90.0))
    inner = polar_product(folder, "85", 10, (0.0, 0.0, inner_m), (0.0, 90.0), OFFSET_M)
    assert outer.label
    assert inner.label
    return [outer.label, inner.label]
