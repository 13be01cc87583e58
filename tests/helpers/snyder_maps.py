"""Map projections of the sphere in closed form (Snyder 1987), and rasters over them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from rasterio.transform import Affine

from lcp_catalog.cameras.map_projected import MapImage
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import enu_rotation, lonlat_to_mcmf

R = MOON_RADIUS_M
Forward = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
GEOGCS = 'GEOGCS["m",DATUM["d",SPHEROID["s",{a},{f}]],PRIMEM["p",{pm}],UNIT["degree",0.0174532925199433]]'


def geographic(a: float = R, f: float = 0.0, pm: float = 0.0) -> str:
    return GEOGCS.format(a=a, f=f, pm=pm)


def projected(method: str, a: float = R, **parameters: float) -> str:
    named = "".join(f',PARAMETER["{name}",{value}]' for name, value in parameters.items())
    return f'PROJCS["x",{geographic(a)},PROJECTION["{method}"]{named},UNIT["metre",1]]'


def wrapped(degrees: np.ndarray) -> np.ndarray:
    """Radians of degrees, -pi..pi."""
    return np.radians((degrees + 180.0) % 360.0 - 180.0)


def cylindrical(lon0: float, true_lat: float) -> Forward:
    k = math.cos(math.radians(true_lat))
    return lambda lon, lat: (R * k * wrapped(lon - lon0), R * np.radians(lat))


def polar(north: bool, lon0: float) -> Forward:
    def forward(lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn, sign = wrapped(lon - lon0), 1.0 if north else -1.0
        rho = 2.0 * R * np.tan(np.pi / 4 - sign * np.radians(lat) / 2)
        return rho * np.sin(turn), -sign * rho * np.cos(turn)

    return forward


def orthographic(lon0: float, lat0: float) -> Forward:
    frame = enu_rotation(lon0, lat0)

    def forward(lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        east, north, _ = np.moveaxis(lonlat_to_mcmf(lon, lat) @ frame.T, -1, 0)
        return east, north

    return forward


def transverse(lon0: float, lat0: float) -> Forward:
    def forward(lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn, phi = wrapped(lon - lon0), np.radians(lat)
        b = np.cos(phi) * np.sin(turn)
        return R * np.arctanh(b), R * (np.arctan2(np.tan(phi), np.cos(turn)) - math.radians(lat0))

    return forward


def sinusoidal(lon0: float) -> Forward:
    return lambda lon, lat: (
        R * wrapped(lon - lon0) * np.cos(np.radians(lat)),
        R * np.radians(lat),
    )


def mercator(lon0: float) -> Forward:
    return lambda lon, lat: (R * wrapped(lon - lon0), R * np.arctanh(np.sin(np.radians(lat))))


# name: (CRS, closed form, longitudes, latitudes of the piece that is looked at)
MAPS: dict[str, tuple[str, Forward, tuple[float, float], tuple[float, float]]] = {
    "geographic": (geographic(), lambda lon, lat: (np.degrees(wrapped(lon)), lat), (-30, 40), (-60, 70)),
    "cylindrical, true at 8, centred at 180": (
        projected("Equirectangular", standard_parallel_1=8, central_meridian=180),
        cylindrical(180, 8), (30, 60), (5, 12),
    ),
    "north polar": (
        projected("Polar_Stereographic", latitude_of_origin=90, central_meridian=0, scale_factor=1),
        polar(True, 0), (0, 360), (80, 90),
    ),
    "south polar": (
        projected("Polar_Stereographic", latitude_of_origin=-90, central_meridian=70, scale_factor=1),
        polar(False, 70), (0, 360), (-90, -80),
    ),
    "orthographic": (
        projected("Orthographic", latitude_of_origin=26, central_meridian=3.5),
        orthographic(3.5, 26), (-20, 30), (5, 50),
    ),
    "transverse Mercator": (
        projected("Transverse_Mercator", latitude_of_origin=-5, central_meridian=200, scale_factor=1),
        transverse(200, -5), (180, 220), (-30, 20),
    ),
    "sinusoidal": (
        projected("Sinusoidal", longitude_of_center=-60), sinusoidal(-60), (-100, -20), (-50, 50),
    ),
    "Mercator": (
        projected("Mercator_1SP", central_meridian=10, scale_factor=1), mercator(10), (-20, 40), (-60, 60),
    ),
}  # fmt: skip


def image_of(name: str, shape: tuple[int, int] = (400, 500), turn_deg: float = 0.0) -> MapImage:
    """A raster over the piece of ground of one of `MAPS`, perhaps turned about its middle."""
    wkt, forward, lon, lat = MAPS[name]
    grid = np.meshgrid(np.linspace(*lon, 41), np.linspace(*lat, 41))
    x, y = forward(grid[0], grid[1])
    rows, cols = shape
    middle = (x.min() + x.max()) / 2, (y.min() + y.max()) / 2
    scale = Affine.scale((x.max() - x.min()) / cols, -(y.max() - y.min()) / rows)
    turned = Affine.translation(*middle) * Affine.rotation(turn_deg) * scale
    whole = turned * Affine.translation(-cols / 2, -rows / 2)
    return MapImage(wkt, tuple(whole)[:6], shape, name)


def places(name: str, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    _, _, lon, lat = MAPS[name]
    return rng.uniform(*lon, count), rng.uniform(*lat, count)
