"""Check of the Sun with an albedo map that lacks detail: how much, and what it does to the best azimuth."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from helpers.lone_hill import EAST, HERE, plain_photo
from helpers.twins_match import HADLEY, catalog_of_dem, catalog_of_patches, looking_at
from scipy.ndimage import gaussian_filter

import lcp_catalog as lcp
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation, direction_enu
from lcp_catalog.images.image import Image
from lcp_catalog.matching.map_detail import MISSING, MapDetail
from lcp_catalog.matching.point_search import Criteria, SearchImage
from lcp_catalog.matching.sun_check import MatchedPoints, check_sun
from lcp_catalog.matching.sun_verdict import SunCheck
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.photometry.laws import reflectance_model

MAP = Path(HADLEY).with_name("hadley_albedo_643nm_11ppd.tif")
CELL_M = 100.0
LAW = reflectance_model("lunar-lambert")


def uneven(values: np.ndarray) -> np.ndarray:
    return values - values.mean(axis=(1, 2), keepdims=True)


def leaning(east: float, north: float) -> tuple[Catalog, np.ndarray, np.ndarray]:
    """30 patches of smooth noise whose log brightness rises with their slopes to the east and north; those slopes."""
    rng = np.random.default_rng(0)
    z = gaussian_filter(rng.normal(size=(30, 25, 25)), (0, 2, 2)) * 400.0
    z -= z[:, 12:13, 12:13]
    to_east, to_north = np.gradient(z, axis=2) / CELL_M, -np.gradient(z, axis=1) / CELL_M
    bright = np.exp(east * to_east + north * to_north + rng.normal(0.0, 0.02, z.shape))
    made = catalog_of_patches(
        z.astype(np.float32), [HERE] * 30, CELL_M, albedo=bright.astype(np.float32),
        albedo_map=AlbedoMap.open(MAP).provenance(),
    )  # fmt: skip
    return made, uneven(to_east), uneven(to_north)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 215.0])
def test_slopes_across_the_sun_are_altered_by_a_share_of_what_the_map_has(
    azimuth_deg: float,
) -> None:
    """Slopes that rise to the right of the Sun's direction."""
    points, east, north = leaning(0.3, -0.2)
    turn = math.radians(azimuth_deg)
    sun = HERE.direction_to_mcmf(direction_enu(azimuth_deg, 40.0))
    detail = MapDetail.of(points, np.arange(30), np.tile(sun, (30, 1)))
    assert detail is not None
    share = MISSING * (25 * CELL_M / 2665.0) ** -0.8
    np.testing.assert_allclose(detail.sigma, min(share, 1.0) * math.hypot(0.3, 0.2), rtol=0.03)
    changed = np.log(detail.altered(-2.0).albedo / points.albedo)
    wanted = -2.0 * detail.sigma[0] * (east * math.cos(turn) - north * math.sin(turn))
    np.testing.assert_allclose(changed, wanted, atol=2e-5)


@pytest.mark.parametrize(("pixels_a_degree", "pixel_m"), [(50, 606.5), (6, 5053.9)])
def test_a_map_of_another_pixel_lacks_other_detail(
    pixels_a_degree: int, pixel_m: float, tmp_path: Path
) -> None:
    """30.323 km are a degree. A finer map lacks less, a coarser one more, at most as much as it has; a catalogue that does not
    state the pixel has that of the package's map.
    """
    points, *_ = leaning(0.3, -0.2)
    kind = {"driver": "GTiff", "width": 6, "height": 6, "count": 1, "dtype": "float32"}
    with rasterio.open(MAP) as source:
        kind["crs"] = source.crs
    side_m = np.radians(1.0) * 1737400.0 / pixels_a_degree
    path = tmp_path / "own.tif"
    with rasterio.open(path, "w", **kind, transform=rasterio.transform.from_origin(0.0, 0.0, side_m, side_m)) as made:  # fmt: skip
        made.write(np.full((6, 6), 0.5, np.float32), 1)
    told = AlbedoMap.open(path).provenance()
    silent = {name: value for name, value in told.items() if name != "pixel_m"}

    def sigma(albedo_map: dict[str, Any]) -> float:
        some = replace(points, albedo_map=albedo_map)
        detail = MapDetail.of(some, np.arange(30), np.tile(EAST, (30, 1)))
        assert detail is not None
        return float(detail.sigma[0])

    whole = sigma(told | {"pixel_m": 1e9})
    share = 1.36 * (25 * CELL_M / pixel_m) ** -0.8
    assert sigma(told) / whole == pytest.approx(min(share, 1.0), rel=1e-3)
    assert sigma(silent) == sigma(told | {"pixel_m": 2665.0})


def test_around_a_pole_the_direction_that_is_bright_is_one() -> None:
    """Patches on all longitudes, bright on slopes that rise to one side of a Sun that is the same for all."""
    points, east, north = leaning(0.0, 0.0)
    frames = [EnuFrame(12.0 * k, 89.5) for k in range(30)]
    turns = np.array([f.rotation for f in frames])
    sun = frames[0].direction_to_mcmf(direction_enu(70.0, 20.0))
    up = turns[0].T @ [0.0, 0.0, 1.0]
    aside = turns @ np.cross(sun, up)
    aside /= np.linalg.norm(aside[:, :2], axis=1)[:, None]
    bright = np.exp(0.36 * (east * aside[:, :1, None] + north * aside[:, 1:2, None]))
    polar = catalog_of_patches(
        points.dem, frames, CELL_M, albedo=bright.astype(np.float32), albedo_map=points.albedo_map
    )
    detail = MapDetail.of(polar, np.arange(30), np.tile(sun, (30, 1)))
    assert detail is not None
    share = min(MISSING * (25 * CELL_M / 2665.0) ** -0.8, 1.0)
    assert detail.sigma[0] == pytest.approx(0.36 * share, rel=0.05)


def test_nothing_is_missing_without_a_map_and_across_no_sun_at_the_zenith() -> None:
    points, *_ = leaning(0.3, -0.2)
    zenith = MapDetail.of(points, np.arange(3), np.tile(HERE.rotation[2], (3, 1)))
    assert zenith is not None
    assert np.isfinite(zenith.across).all()
    bare = replace(points, albedo=None, albedo_map=None)
    assert MapDetail.of(bare, np.arange(3), np.tile(EAST, (3, 1))) is None


@pytest.mark.parametrize(
    ("leans", "sigma"), [((-9.0, 15.0), math.hypot(1.0, 12.0)), ((-9.0, math.nan), math.inf)]
)
def test_an_azimuths_sigma_has_half_the_difference_that_the_detail_makes(
    leans: tuple[float, float], sigma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Points that lose with the square of the distance from a best azimuth; NaN: they gain with it."""
    monkeypatch.setattr("lcp_catalog.matching.sun_check.LAWS", ())
    points, *_ = leaning(0.3, -0.2)
    rng = np.random.default_rng(1)
    off = rng.normal(size=30)
    off = 18.0 + 1.0 * math.sqrt(30) * (off - off.mean()) / off.std()
    lies = iter((0.0, *leans))
    camera = looking_at(HERE, 60e3, 0.0, 0.0, 0.0, 600.0, (160, 160))
    sun = HERE.direction_to_mcmf(direction_enu(100.0, 50.0))
    photo = plain_photo(np.ones(camera.shape), camera, sun)

    def search_for(which: np.ndarray, _: Catalog | None):
        lie = next(lies)

        def search(moved: Image, _law, some: np.ndarray, _power: float):
            azimuth, _ = azimuth_elevation(HERE.direction_from_mcmf(moved.sun_direction_mcmf))
            away = float(azimuth) - 100.0 - off[which[some]] - np.nan_to_num(lie)
            z = 1.0 + (1e-4 if math.isnan(lie) else -1e-4) * away**2
            return np.tanh(z), np.zeros((len(some), 2))

        return search

    check = check_sun(search_for, points, np.arange(30), photo, LAW)
    assert check.best_turn_deg == pytest.approx(18.0, abs=0.01)
    assert check.best_turn_sigma_deg == pytest.approx(sigma, rel=0.01)
    assert check.fits
    assert check.azimuth_advice == (
        "the Sun's azimuth may be wrong: 30 points correlate best under one turned by +18 deg; "
        "brightness that the albedo map lacks can look so, too: check the Sun and the time"
    )
    assert replace(check, best_turn_sigma_deg=1.0).azimuth_advice == ""  # refused
    assert replace(check, turned_by_map=False).azimuth_advice == ""


@pytest.mark.slow
def test_a_map_that_lacks_detail_does_not_refuse_the_right_sun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mountains at Hadley are bright to the north-west. The map is blurred; the Sun shines across, from the south-west."""
    with rasterio.open(MAP) as source:
        bright, profile = source.read(1).astype(float), source.profile
    blurred = tmp_path / "blurred.tif"
    with rasterio.open(blurred, "w", **profile | {"dtype": "float32", "nodata": None}) as made:
        made.write(np.exp(gaussian_filter(np.log(bright), 0.8)).astype(np.float32), 1)
    rng = np.random.default_rng(0)
    lon, lat = rng.uniform(1.5, 5.5, 60), rng.uniform(24.2, 27.8, 60)
    ground = catalog_of_dem(lon, lat, 33, 474.0)
    frames = [EnuFrame(*where) for where in zip(lon, lat, strict=True)]
    here = EnuFrame(3.5, 26.0)
    camera = replace(
        looking_at(here, 400e3, 0.0, 0.0, 0.0, 820.0, (400, 400)),
        sun_position_mcmf_m=1.5e11 * here.direction_to_mcmf(direction_enu(225.0, 52.0)),
    )
    seen = lcp.simulate([HADLEY], camera, seed=0, accuracy="draft", reflectance=LAW.name, albedo=MAP)  # fmt: skip

    def check(path: Path) -> SunCheck:
        one = AlbedoMap.open(path)
        known = replace(
            ground, albedo=one.patches(frames, ground.dem, 474.0), albedo_map=one.provenance()
        )
        rows, still = np.arange(60), np.zeros((60, 2))
        return MatchedPoints(known, SearchImage.of(seen.image), LAW, rows, still, Criteria()).check()  # fmt: skip

    assert check(MAP).fits
    assert check(blurred).fits
    monkeypatch.setattr(MapDetail, "of", lambda *_: None)
    assert check(MAP).fits
    assert not check(blurred).fits  # by the scatter of the points alone
