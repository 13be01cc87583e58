"""The shadows of ``lcp render`` against Embree on the DEM's own nodes in MCMF.

Run with ``-rP`` to see every comparison's figures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")

from helpers.embree_mesh import RADIUS_M, Mesh
from helpers.embree_sites import (
    AGREED,
    PLACES,
    Place,
    Site,
    judge,
    make_site,
    render,
    require_telling,
)
from helpers.products import DEGREE_M

EVERY_TIME = {("equator", 0), ("80 S", 0)}
CASES = [
    pytest.param(name, number, marks=() if (name, number) in EVERY_TIME else pytest.mark.slow)
    for name in PLACES
    if name != "smooth"
    for number in range(3)
]


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Site]:
    """Sites, each made at its first use."""

    class Sites(dict):
        def __missing__(self, name: str) -> Site:
            self[name] = make_site(PLACES[name], tmp_path_factory.mktemp("embree"))
            return self[name]

    return Sites()


@pytest.mark.parametrize(("name", "number"), CASES)
def test_shadows_are_embrees(sites, name, number):
    place, sun = PLACES[name], PLACES[name].suns[number]
    found, sun_off = judge(render(sites[name].path, place, *sun), sites[name].mesh, place, *sun)
    assert sun_off < 1e-12
    require_telling(found)
    assert found.away >= AGREED
    assert found.away_from_judges >= AGREED


@pytest.mark.parametrize("name", ["equator", pytest.param("60 N", marks=pytest.mark.slow), "80 S"])
def test_standard_shadows_are_embrees(sites, name):
    place, sun = PLACES[name], PLACES[name].suns[1]
    product = render(sites[name].path, place, *sun, tier="standard")
    found, _ = judge(product, sites[name].mesh, place, *sun)
    require_telling(found)
    assert found.away >= AGREED


def faulty(site: Site, fault: str) -> tuple[Path, float]:
    """A DEM with an error, and the error of the Sun's azimuth."""
    z, pixel = site.heights_m, site.place.pixel_m
    away = np.hypot(site.east_m, site.north_m)
    fallen = away**2 / (2.0 * RADIUS_M)  # drop of the sphere below the tangent plane
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
    pytest.param("smooth", "no curvature", marks=pytest.mark.slow),
    pytest.param("smooth", "mirrored", marks=pytest.mark.slow),
    ("smooth", "half a pixel east"),
    pytest.param("smooth", "half a pixel south-east", marks=pytest.mark.slow),
    pytest.param("89.9 N", "no far terrain", marks=pytest.mark.slow),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "fault"), FAULTS)
def test_the_comparison_finds_faults(sites, name, fault):
    """With eight nodes per pixel, on terrain that is smooth over pixels, half a pixel is more than
    the width of an edge; at the DEM's own cell size the edges that are left out would conceal it.
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


# Real terrain, if the data are available

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
