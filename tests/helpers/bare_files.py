"""Files of a DEM set without pixels, only footprints; and areas of rectangles on their maps in closed form."""

from __future__ import annotations

import math
from pathlib import Path

from lcp_catalog.dem.coverage import set_coverage
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.grid import Grid
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.raster import Raster

from .products import DEGREE_M, RADIUS_M

R_KM = RADIUS_M / 1000.0
NORTH = "+proj=stere +lat_0=90 +lat_ts=90 +lon_0={lon} +R=1737400 +units=m +no_defs"
SOUTH = NORTH.replace("+lat_0=90 +lat_ts=90", "+lat_0=-90 +lat_ts=-90")


def made(product: str, grid: Grid) -> Dem:
    path = Path(f"{product}.tif")
    return Dem(path, product, grid, Raster(path, grid.width, grid.height), (path,))


def cylinder(
    west: float, south: float, east: float, north: float, ppd: int = 16, product: str = "LDEM_16"
) -> Dem:
    """A tile in whole pixels; its origin is counted from longitude 0, east of -180."""
    width, height, pixel = round((east - west) * ppd), round((north - south) * ppd), DEGREE_M / ppd
    return made(
        product,
        Grid(
            "equirectangular",
            width,
            height,
            pixel,
            (west * ppd + 0.5) * pixel,
            (north * ppd - 0.5) * pixel,
        ),
    )


def polar(
    left_km: float,
    bottom_km: float,
    width: int,
    height: int,
    pole: int = 1,
    lon: float = 0.0,
    product: str = "POLAR",
) -> Dem:
    """Pixels of 1 km around a pole; ``lon`` is the map's central meridian."""
    return made(
        product,
        Grid(
            "polar-stereographic", width, height, 1000.0, 1000.0 * left_km + 500.0, 1000.0 * (bottom_km + height) - 500.0, lon,
            90.0 * pole,
        ),
    )  # fmt: skip


def rectangle(west: float, south: float, east: float, north: float) -> float:
    """Archimedes: the zone's height times the circumference's share."""
    return (
        R_KM**2
        * math.radians(east - west)
        * (math.sin(math.radians(north)) - math.sin(math.radians(south)))
    )


def corner(a: float, b: float) -> float:
    """Area of the stereographic rectangle 0..a x 0..b (units of 2 R): the integral of 4 / (1 + x^2 + y^2)^2."""
    p, q = math.sqrt(1.0 + a * a), math.sqrt(1.0 + b * b)
    return 2.0 * R_KM**2 * (a / p * math.atan(b / p) + b / q * math.atan(a / q))


def plane_rectangle(x0: float, y0: float, x1: float, y1: float) -> float:
    """Area of a rectangle of a polar map, kilometres at the pole."""
    x0, y0, x1, y1 = (v / (2.0 * R_KM) for v in (x0, y0, x1, y1))
    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)


def covered(*dems: Dem):
    return set_coverage(DemSet(dems))
