"""The albedo map of the sample: decoded as its source says, without shading, and in place."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
from helpers.catalogs import HADLEY

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.bounds import Bounds
from lcp_catalog.photometry.albedo_map import AlbedoMap
from lcp_catalog.production.config import BuildConfig

SAMPLE = HADLEY.parent
MAP = SAMPLE / "hadley_albedo_643nm_11ppd.tif"


@pytest.fixture(scope="module")
def lattice() -> tuple[np.ndarray, np.ndarray]:
    """Places of the sample's DEM, 0.06 deg apart, clear of its edge."""
    return np.meshgrid(np.arange(0.3, 9.7, 0.06), np.arange(29.7, 20.3, -0.06))


def test_the_sample_is_built_with_it() -> None:
    config = BuildConfig.from_toml(SAMPLE / "hadley.toml")
    assert config.model.albedo == str(MAP)
    covered, wanted = AlbedoMap.open(MAP).bounds, Bounds(0.0, 20.0, 10.0, 30.0)
    assert covered.west < wanted.west - 3.0
    assert covered.east > wanted.east + 3.0
    assert covered.south < wanted.south - 3.0
    assert covered.north > wanted.north + 3.0


def test_values_are_those_of_the_moon_at_643_nm() -> None:
    """Sato et al. 2014, J. Geophys. Res. Planets 119, 1775: normalised to i = g = 60 deg, maria have an
    I/F of 0.02 to 0.03, highlands 0.04 to 0.05.
    """
    with rasterio.open(MAP) as source:
        values = source.read(1) * source.scales[0]
    assert 0.015 < np.percentile(values, 1) < 0.025
    assert 0.035 < np.percentile(values, 99) < 0.07


def test_it_has_no_shading(lattice: tuple[np.ndarray, np.ndarray]) -> None:
    """Brightness finer than a degree does not follow the slopes of the terrain (|r| of a shaded map
    of the same place: 0.4 to the east).
    """
    factor = np.log(AlbedoMap.open(MAP).at(*lattice, 2000.0))
    height, _ = DemSet.open([HADLEY]).heights(*lattice, 2000.0)
    fine = factor - _means(factor, 15)
    for slope in np.gradient(height):
        assert abs(np.corrcoef(fine.ravel(), slope.ravel())[0, 1]) < 0.2


def test_it_agrees_with_another_version_of_the_mosaic(
    shared_data, lattice: tuple[np.ndarray, np.ndarray]
) -> None:
    """Another processing of the LROC WAC colours: the same contrast, in the same place to a third of
    a pixel.
    """
    other = AlbedoMap.open(shared_data / "albedo" / "relative_albedo_11ppd.tif", "linear", 1.0)
    mine, theirs = AlbedoMap.open(MAP), np.log(other.at(*lattice, 2000.0)).ravel()
    lon, lat = lattice

    def agreement(east_px: float, north_px: float) -> float:
        step = 360.0 / 4096
        moved = np.log(mine.at(lon + east_px * step, lat + north_px * step, 2000.0)).ravel()
        return float(np.corrcoef(moved, theirs)[0, 1])

    slope = np.polyfit(theirs, np.log(mine.at(lon, lat, 2000.0)).ravel(), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.15)
    best = agreement(0.0, 0.0)
    assert best > 0.95
    for away in (-0.7, 0.7):
        assert agreement(away, 0.0) < best
        assert agreement(0.0, away) < best


def _means(values: np.ndarray, side: int) -> np.ndarray:
    """Means over squares of ``side`` places, the edges repeated."""
    padded = np.pad(values, side // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    return np.asarray(windows.mean(axis=(2, 3)))
