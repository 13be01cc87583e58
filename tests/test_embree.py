"""The shadows of ``lcp render`` against Embree on the DEM's own nodes in MCMF (docs/design/embree-check.md).

Run with ``-rP`` to see every comparison's figures.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio

pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")

from embree_mesh import (
    RADIUS_M,
    Mesh,
    Nodes,
    Product,
    agreement,
    enu_axes,
    map_to_lonlat,
    mcmf,
    read_nodes,
    sun_direction,
)
from products import DEGREE_M, EQC, geotiff
from synthetic import cratered

from lcp_catalog.accuracy import TIERS
from lcp_catalog.exposure import expose, prepare
from lcp_catalog.render_file import encode
from lcp_catalog.request import Request, SunChoice
from lcp_catalog.terrain import Area

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
FIRST = [(name, number) for name in PLACES if name != "smooth" for number in (0, 1)]
THIRD = [(name, 2) for name in PLACES if name != "smooth"]
CASES = [*FIRST, *(pytest.param(*case, marks=pytest.mark.slow) for case in THIRD)]


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


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Site]:
    """Made when first asked for."""

    class Sites(dict):
        def __missing__(self, name: str) -> Site:
            self[name] = make_site(PLACES[name], tmp_path_factory.mktemp("embree"))
            return self[name]

    return Sites()


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
        [path],
        area=Area(place.lon_deg, place.lat_deg, place.size_km),
        gsd_m=gsd_m,
        sun=SunChoice(azimuth_deg, elevation_deg),
        accuracy=TIERS[tier],
        disc=False,
    )
    scene = prepare(request)
    return Product.read(encode(scene, expose(scene)))


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


@pytest.mark.parametrize(("name", "number"), CASES)
def test_shadows_are_embrees(sites, name, number):
    place, sun = PLACES[name], PLACES[name].suns[number]
    found, sun_off = judge(render(sites[name].path, place, *sun), sites[name].mesh, place, *sun)
    assert sun_off < 1e-12
    require_telling(found)
    assert found.away >= AGREED
    assert found.away_from_judges >= AGREED


@pytest.mark.parametrize("name", ["equator", "60 N", "80 S"])
def test_standard_shadows_are_embrees(sites, name):
    place, sun = PLACES[name], PLACES[name].suns[1]
    product = render(sites[name].path, place, *sun, tier="standard")
    found, _ = judge(product, sites[name].mesh, place, *sun)
    require_telling(found)
    assert found.away >= AGREED


def faulty(site: Site, fault: str) -> tuple[Path, float]:
    """A DEM with a fault, and by how much the Sun's azimuth is wrong."""
    z, pixel = site.heights_m, site.place.pixel_m
    away = np.hypot(site.east_m, site.north_m)
    fallen = away**2 / (2.0 * RADIUS_M)  # what the sphere falls away by
    match fault:
        case "none":
            return site.path, 0.0
        case "azimuth + 2 deg":
            return site.path, 2.0
        case "no curvature":
            path = site.written(z + fallen)
        case "mirrored":
            path = site.written(z[:, ::-1])
        case "half a pixel east":
            path = site.written(z, east_m=pixel / 2.0)
        case "half a pixel south-east":
            path = site.written(z, east_m=pixel / 2.0, south_m=pixel / 2.0)
        case "no far terrain":
            path = site.written(np.where(away < 75e3, z, np.nan))
        case _:
            raise ValueError(fault)
    return path, 0.0


FAULTS = [
    ("smooth", "none"),
    ("smooth", "azimuth + 2 deg"),
    ("smooth", "no curvature"),
    ("smooth", "mirrored"),
    ("smooth", "half a pixel east"),
    ("smooth", "half a pixel south-east"),
    ("89.9 N", "no far terrain"),
]


@pytest.mark.parametrize(("name", "fault"), FAULTS)
def test_the_comparison_finds_faults(sites, name, fault):
    """Rendered eight nodes to a pixel, on ground that is smooth over pixels, half a pixel is more than an edge's width;
    at the DEM's own cell the edges that are left out would hide it.
    """
    site, place = sites[name], PLACES[name]
    azimuth, elevation = place.suns[0 if name == "smooth" else 1]
    path, turned = faulty(site, fault)
    gsd_m = place.pixel_m / place.nodes_per_px if place.nodes_per_px > 1 else None
    product = render(path, place, azimuth + turned, elevation, gsd_m=gsd_m)
    found, _ = judge(product, site.mesh, place, azimuth, elevation)
    require_telling(found)
    assert (found.away >= AGREED) == (fault == "none")
    assert (found.away_from_judges >= AGREED) == (fault == "none")


# The judge judged: closed forms against PROJ, a mesh without leaks, a shadow whose length is known


def test_places_are_projs():
    rng = np.random.default_rng(7)
    lon, lat = rng.uniform(-180, 180, 200), rng.uniform(-90, 90, 200)
    height = rng.uniform(-9e3, 11e3, 200)
    to_mcmf = pyproj.Transformer.from_crs(
        "+proj=longlat +R=1737400", "+proj=geocent +R=1737400 +units=m", always_xy=True
    )
    theirs = np.stack(to_mcmf.transform(lon, lat, height), axis=-1)
    assert np.abs(mcmf(lon, lat, height) - theirs).max() < 1e-6


@pytest.mark.parametrize(
    ("crs", "reach_m"),
    [(EQC, 2.7e6), (EQC.replace("lat_ts=0", "lat_ts=47"), 1.8e6)]
    + [(STERE.format(sign * 90), 6e5) for sign in (1, -1)],
)
def test_maps_are_projs(crs, reach_m):
    x, y = np.random.default_rng(8).uniform(-reach_m, reach_m, (2, 200))
    back = pyproj.Transformer.from_crs(crs, "+proj=longlat +R=1737400", always_xy=True)
    ours = map_to_lonlat(rasterio.CRS.from_string(crs), x, y)
    assert np.abs(mcmf(*ours) - mcmf(*back.transform(x, y))).max() < 1e-5


def whole_moon(folder: Path, height_m: float) -> Mesh:
    """A ball of half-degree pixels, read like any other DEM: seam and poles have to be closed."""
    heights = np.full((360, 720), height_m, "f4")
    half_moon = np.pi * RADIUS_M
    path = geotiff(folder / "ball.tif", heights, 0.0, half_moon / 2, half_moon / 360)
    nodes = read_nodes(path, 0.0, 90.0, 2.0 * half_moon)
    north = Mesh(replace(nodes, pole=1), np.zeros(3))
    assert nodes.is_ring
    assert nodes.pole == -1
    assert north.count == 2 * 359 * 720 + 720
    return north


def test_the_ring_and_the_pole_are_closed(tmp_path):
    """Rays from the Moon's middle meet the ball everywhere, the seam and the north pole among them."""
    mesh = whole_moon(tmp_path, 1000.0)
    lon = np.append(np.random.default_rng(9).uniform(0, 360, 4000), [0.0, 359.9, 0.1, 12.0])
    lat = np.append(np.random.default_rng(10).uniform(-89, 90, 4000), [3.0, -60.0, 89.9, 90.0])
    outward = (mcmf(lon, lat) / RADIUS_M).astype(np.float32)
    distance = mesh.scene.run(np.zeros_like(outward), outward, query="DISTANCE")
    lowest = (RADIUS_M + 1000.0) * np.cos(np.radians(0.5 / np.sqrt(2.0)))
    assert distance.min() > lowest - 0.5
    assert distance.max() < RADIUS_M + 1000.5


def test_a_bare_ball_is_lit_on_the_sunny_side(tmp_path):
    """Facets turn by half a degree, so that half a degree about the terminator is left out."""
    mesh, sun = whole_moon(tmp_path, 0.0), sun_direction(40.0, 20.0, 70.0, 30.0)
    rng = np.random.default_rng(11)
    points = mcmf(rng.uniform(0, 360, 4000), rng.uniform(-89, 89, 4000))
    height = np.degrees(np.arcsin(points @ sun / RADIUS_M))
    lit, found, _ = mesh.lit(points, sun)
    clear = np.abs(height) > 0.5
    assert found.all()
    assert np.array_equal(lit[clear], height[clear] > 0.0)


@pytest.mark.parametrize("elevation_deg", [0.5, 2.0, 10.0])
def test_a_peaks_shadow_ends_where_the_sphere_says(elevation_deg):
    """On a bare sphere the top of a peak of height H, an angle t away, stands at
    tan e = ((R + H) cos t - R) / ((R + H) sin t) above the horizontal; on a plane its shadow would be longer by a third
    at 2 degrees, three times as long at half a degree.
    """
    peak_m, step = 2000.0, 1.0 / 64.0
    lon, lat = np.meshgrid(np.arange(-64, 257) * step, np.arange(8, -9, -1) * step)
    heights = np.where((lon == 0.0) & (lat == 0.0), peak_m, 0.0)
    mesh = Mesh(Nodes(lon, lat, heights, False, 0), mcmf(0.0, 0.0))
    away, top = np.radians(np.linspace(4.0, 0.02, 40_000)), RADIUS_M + peak_m
    stands = np.degrees(np.arctan2(top * np.cos(away) - RADIUS_M, top * np.sin(away)))
    tip_deg = np.degrees(np.interp(elevation_deg, stands, away))
    sun = sun_direction(tip_deg, 0.0, 270.0, elevation_deg)
    lit, _, _ = mesh.lit(mcmf(tip_deg * np.array([0.5, 0.99, 1.01]), np.zeros(3)), sun)
    assert lit.tolist() == [False, False, True]


# Real ground, where it is at hand

REAL = {
    "016 equator": ("gld100_016ppd_global.tif", 183.0, 0.0, 150e3, ((200, 5.0), (310, 10.0))),
    "016 60 N": ("gld100_016ppd_global.tif", 140.0, 60.0, 150e3, ((200, 4.0), (310, 7.0))),
    "016 60 S over the seam": ("gld100_016ppd_global.tif", 0.5, -60.0, 150e3, ((200, 4.0),)),
    "256 36 N": (
        "gld100_256ppd_giordano-bruno_lat33-39_lon099-107.tif",
        103.0,
        36.0,
        60e3,
        ((80, 3.0), (310, 15.0)),
    ),
    "064 80 N": ("gld100_064ppd_lat75-90.tif", 20.0, 80.0, 110e3, ((151, 3.0), (290, 6.0))),
    "064 89.9 N": ("gld100_064ppd_lat75-90.tif", 50.0, 89.9, 160e3, ((151, 1.0), (290, 1.5))),
}
REAL_PIXEL_M = {"016": 10916406.152693814 / 5760, "064": DEGREE_M / 64, "256": DEGREE_M / 256}


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_shadows_are_embrees(shared_data, name):
    """WAC GLD100. At the pole, where the Sun is never higher than 1.6 degrees, up to 80 % is dark."""
    file, lon, lat, beyond_m, suns = REAL[name]
    path = shared_data / "dem" / "gld100" / file
    if not path.is_file():
        pytest.skip(f"no {path}: GLD100 is not among the shared lunar data")
    place = Place(lon, lat, REAL_PIXEL_M[name[:3]], 0.0, 0.0, suns)
    cases = [(tier, sun) for tier in ("reference", "standard") for sun in suns]
    products = [render(path, place, *sun, tier=tier) for tier, sun in cases]
    mesh = Mesh.of(path, lon, lat, 707.0 * place.size_km + beyond_m)
    for product, (_, sun) in zip(products, cases, strict=True):
        found, sun_off = judge(product, mesh, place, *sun)
        assert sun_off < 1e-12
        require_telling(found, 0.8 if lat == 89.9 else 0.6)
        assert found.away >= AGREED
        assert found.away_from_judges >= AGREED
