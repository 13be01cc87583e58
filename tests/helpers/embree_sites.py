"""Made DEMs around places on the lattices of real products, their meshes for Embree, and what ``lcp render`` makes of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import rasterio

pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")

from lcp_catalog.accuracy import TIERS
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.rendering.pipeline import prepare
from lcp_catalog.rendering.public import encode
from lcp_catalog.rendering.request import Request
from lcp_catalog.terrain.area import Area

from .embree_mesh import (
    RADIUS_M,
    Mesh,
    Product,
    agreement,
    enu_axes,
    map_to_lonlat,
    mcmf,
    sun_direction,
)
from .products import DEGREE_M, EQC, geotiff
from .synthetic import cratered

AGREED = 0.995
STERE = "+proj=stere +lat_0={} +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs"


@dataclass(frozen=True)
class Place:
    """A made DEM around a place, on the lattice of a real product, and the Suns to judge it under."""

    lon_deg: float
    lat_deg: float
    pixel_m: float
    half_m: float  # of the DEM, on the ground
    relief: float
    suns: tuple[tuple[float, float], ...]  # azimuth, elevation; chosen so that 15-60 % is dark
    detail_px: float = 1.0  # spacing of the spline that the relief is made of
    nodes_per_px: int = 1
    ridge: bool = False  # a mountain that only the far terrain knows

    @property
    def is_polar(self) -> bool:
        return abs(self.lat_deg) > 75.0

    @property
    def size_km(self) -> float:
        """Of an area of 300 x 300 nodes."""
        return 300 * self.pixel_m / self.nodes_per_px / 1e3


SLDEM_512, LDEM_30M, LDEM_240M = DEGREE_M / 512, 30.0, 240.0  # pixels, metres

PLACES = {
    "equator": Place(23, 0, SLDEM_512, 13e3, 1.0, ((37, 4.0), (215, 6.0), (290, 8.0))),
    "60 N": Place(31, 60, SLDEM_512, 13e3, 2.5, ((37, 10.0), (151, 14.0), (80, 20.0))),
    "80 N": Place(33, 80, LDEM_30M, 7e3, 1.0, ((37, 4.0), (151, 6.0), (200, 8.0))),
    "80 S": Place(211, -80, LDEM_30M, 7e3, 0.2, ((37, 0.7), (151, 1.0), (290, 1.5))),
    "89.9 N": Place(
        50, 89.9, LDEM_240M, 130e3, 0.2, ((37, 0.7), (151, 1.2), (290, 1.5)), ridge=True
    ),
    "smooth": Place(50, 80, LDEM_240M, 45e3, 0.4, ((45, 0.7),), detail_px=4.0, nodes_per_px=8),
}


def spline(z: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The uniform cubic B-spline of a periodic table at columns u and rows v: smooth ground, of the table's detail."""

    def weights(t: np.ndarray) -> list[np.ndarray]:
        t2, t3, s = t * t, t * t * t, 1.0 - t
        return [s * s * s, 3.0 * t3 - 6.0 * t2 + 4.0, 3.0 * (t + t2 - t3) + 1.0, t3]

    row, col = np.floor(v).astype(int), np.floor(u).astype(int)
    cols = [(col - 1 + j) % z.shape[1] for j in range(4)]
    out = np.zeros(u.shape)
    for i, down in enumerate(weights(v - row)):
        line = (row - 1 + i) % z.shape[0]
        for across, at in zip(weights(u - col), cols, strict=True):
            out += down * across * z[line, at]
    return out / 36.0


def ground_m(place: Place, lon: np.ndarray, lat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """East and north of the place along the sphere (azimuthal equidistant), metres."""
    east, north, up = np.moveaxis(mcmf(lon, lat) @ enu_axes(place.lon_deg, place.lat_deg).T, -1, 0)
    away = np.hypot(east, north)
    stretch = RADIUS_M * np.arctan2(away, up) / np.maximum(away, 1e-9)
    return east * stretch, north * stretch


@dataclass(frozen=True, eq=False)
class Site:
    """A place with its DEM on disk, what that was made from, and its mesh."""

    place: Place
    path: Path
    heights_m: np.ndarray
    east_m: np.ndarray
    north_m: np.ndarray
    corner_m: tuple[float, float]  # west, north of the map
    crs: str
    mesh: Mesh

    def written(self, heights_m: np.ndarray, east_m: float = 0.0, south_m: float = 0.0) -> Path:
        """Other heights on the same lattice, or on one that is moved."""
        west, north = self.corner_m[0] + east_m, self.corner_m[1] - south_m
        path = self.path.with_name("faulty.tif")
        return geotiff(path, heights_m.astype("f4"), west, north, self.place.pixel_m, crs=self.crs)


def make_site(place: Place, folder: Path) -> Site:
    lon, lat, pixel = place.lon_deg, place.lat_deg, place.pixel_m
    half = np.array([place.half_m, place.half_m])
    if place.is_polar:
        sign = np.sign(lat)
        away = 2.0 * RADIUS_M * np.tan(np.radians(90.0 - abs(lat)) / 2.0)
        centre = away * np.array([np.sin(np.radians(lon)), -sign * np.cos(np.radians(lon))])
        crs = STERE.format(int(90 * sign))
    else:
        centre, crs = DEGREE_M * np.array([lon, lat]), EQC
        half[0] /= np.cos(np.radians(lat))
    west, south = np.floor((centre - half) / pixel) * pixel
    cols, rows = np.ceil(2.0 * half / pixel).astype(int)
    north = south + rows * pixel
    x, y = west + (np.arange(cols) + 0.5) * pixel, north - (np.arange(rows) + 0.5) * pixel
    places = map_to_lonlat(rasterio.CRS.from_string(crs), *np.meshgrid(x, y))
    east_m, north_m = ground_m(place, *places)
    heights = relief(place, east_m, north_m)
    path = geotiff(folder / "dem.tif", heights, west, north, pixel, crs=crs)
    mesh = Mesh.of(path, lon, lat, 2.0 * place.half_m)
    return Site(place, path, heights, east_m, north_m, (west, north), crs, mesh)


def relief(place: Place, east_m: np.ndarray, north_m: np.ndarray) -> np.ndarray:
    """Craters on fractal ground; where asked a ridge of 5 km, 110 km away in azimuth 151: seen from level ground
    its crest stands 0.8 degrees high, the Moon's curvature taken off.
    """
    cell = place.detail_px * place.pixel_m
    size = int(2.2 * place.half_m / cell)
    z = cratered(size, cell, seed=5 if place.ridge else 3, relief_m=place.relief)
    heights = spline(z, east_m / cell + size / 2, size / 2 - north_m / cell)
    if place.ridge:
        toward = np.array([np.sin(np.radians(151.0)), np.cos(np.radians(151.0))])
        along = east_m * toward[0] + north_m * toward[1]
        across = east_m * toward[1] - north_m * toward[0]
        heights += 5e3 * np.exp(-(((along - 110e3) / 9e3) ** 2) - (across / 25e3) ** 4)
    return heights.astype("f4")


def render(
    path: Path,
    place: Place,
    azimuth_deg: float,
    elevation_deg: float,
    tier: str = "reference",
    gsd_m: float | None = None,
) -> Product:
    """What ``lcp render DEM --center --size --sun-azimuth --sun-elevation --sun point --accuracy`` writes."""
    request = Request(
        DemSet.open([path]),
        area=Area(place.lon_deg, place.lat_deg, place.size_km),
        gsd_m=gsd_m,
        sun=SunChoice(azimuth_deg, elevation_deg),
        accuracy=TIERS[tier],
        disc=False,
    )
    scene = prepare(request)
    return Product.read(encode(scene, scene.expose()))


def judge(product: Product, mesh: Mesh, place: Place, azimuth_deg: float, elevation_deg: float):
    sun = sun_direction(place.lon_deg, place.lat_deg, azimuth_deg, elevation_deg)
    found = agreement(product, mesh, sun)
    print(f"{place.lat_deg} az {azimuth_deg} el {elevation_deg}: {found}")
    return found, float(np.abs(product.sun_mcmf - sun).max())


def require_telling(found, most_dark: float = 0.6) -> None:
    """A comparison says something only where much is dark, much lit, and not all of it an edge."""
    assert found.nodes >= 299 * 299
    assert 0.15 <= found.dark <= most_dark
    assert found.near_edge < 0.4
