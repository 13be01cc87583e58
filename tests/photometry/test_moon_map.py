"""The albedo map of the package: where it lies, what it says, and that builds take it by default."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.small_build import CONFIG, DEM
from lcp_cli.main import run
from scipy.ndimage import gaussian_filter

from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import AlbedoError, ConfigError
from lcp_catalog.photometry import albedo_map, moon_map
from lcp_catalog.photometry.albedo_map import AlbedoMap, mean_value, open_map
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.run import Build
from lcp_catalog.terrain.area import Area

SAMPLE = DEM.parent / "hadley_albedo_643nm_11ppd.tif"


@pytest.fixture(scope="module")
def moon() -> AlbedoMap:
    return AlbedoMap.open("moon")


def test_it_is_small_and_its_mean_is_known(moon: AlbedoMap) -> None:
    assert moon_map.FILE.stat().st_size <= 4e6
    assert mean_value(moon.pixels) == pytest.approx(moon_map.MEAN, rel=1e-4)
    assert moon.reference == moon_map.MEAN
    assert moon.gsd_m == pytest.approx(2665.1, abs=0.1)


@pytest.mark.parametrize("south_deg", [-75.0, -30.0, 45.0])
def test_it_has_no_shading(shared_data: Path, moon: AlbedoMap, south_deg: float) -> None:
    """Brightness does not follow slopes to the north or east, by LOLA's heights, which its correction did not take (without that:
    0.26 in the south, -0.22 in the north).
    """
    dem = DemSet.open([shared_data / "dem" / "ldem_4" / "LDEM_4.LBL"])
    north_deg = 30.0 if south_deg == -30.0 else south_deg + 30.0
    lon, lat = np.meshgrid(np.arange(-180.0, 180.0, 0.25), np.arange(north_deg, south_deg, -0.25))
    bright = np.log(moon.at(lon, lat, 7600.0))
    height, _ = dem.heights(lon, lat, 7600.0)
    fine = bright - gaussian_filter(bright, 4.0)
    for slope in np.gradient(height):
        steep = slope - gaussian_filter(slope, 4.0)
        assert abs(np.corrcoef(fine.ravel(), steep.ravel())[0, 1]) < 0.06


def test_opening_it_reads_no_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(albedo_map, "mean_value")
    assert AlbedoMap.open("moon").reference_is_mean
    with pytest.raises(NameError):
        AlbedoMap.open(SAMPLE)


def test_it_is_the_map_that_the_sample_has_a_crop_of(moon: AlbedoMap) -> None:
    """The crop was cut from the source with 16 bits and without a second JPEG: the same I/F to 1 %, in place."""
    lon, lat = np.meshgrid(np.arange(0.3, 9.7, 0.06), np.arange(29.7, 20.3, -0.06))
    crop = AlbedoMap.open(SAMPLE, reference=moon_map.MEAN).at(lon, lat, 2000.0)
    errors = {
        east: float(np.std(moon.at(lon + east * 360.0 / 4096, lat, 2000.0) / crop - 1.0))
        for east in (-0.5, 0.0, 0.5)
    }
    assert errors[0.0] < 0.012
    assert min(errors[-0.5], errors[0.5]) > 2.0 * errors[0.0]


def test_it_agrees_with_another_version_of_the_mosaic(shared_data: Path, moon: AlbedoMap) -> None:
    """Another processing of the LROC WAC colours, within 60 deg of the equator, all around."""
    other = AlbedoMap.open(shared_data / "albedo" / "relative_albedo_11ppd.tif", "linear", 1.0)
    lon, lat = np.meshgrid(np.arange(-180.0, 180.0, 0.5), np.arange(-60.0, 60.0, 0.5))
    mine, its = np.log(moon.at(lon, lat, 2000.0)), np.log(other.at(lon, lat, 2000.0))
    assert np.corrcoef(mine.ravel(), its.ravel())[0, 1] > 0.97


def test_it_has_no_seam_at_180_deg_and_no_hole_at_the_poles(moon: AlbedoMap) -> None:
    lat = np.linspace(-89.99, 89.99, 721)
    west, east = moon.at(-179.9999, lat, 2000.0), moon.at(179.9999, lat, 2000.0)
    np.testing.assert_allclose(west, east, atol=2e-3)
    around = np.arange(0.0, 360.0, 5.0)
    for pole in (-90.0, 90.0):
        there = moon.at(around, pole, 2000.0)
        assert np.ptp(there) < 0.1  # one place; neighbours of a pixel that is 4096 pixels wide
        assert np.all((there > 0.8) & (there < 1.8))
    for region in (Area(180.0, 10.0, 100.0), Area(0.0, 89.9, 60.0), Area(30.0, -90.0, 60.0)):
        assert moon.cover_of(region, 474.0).share == 1.0


def test_below_its_pixels_it_is_smooth(moon: AlbedoMap) -> None:
    """Cells of 100 m get a cubic through pixels of 2.7 km: neighbours differ by a few per cent at most."""
    lon = 3.5 + np.arange(600) * 100.0 / 30323.0
    found = moon.at(lon, 26.0, 100.0)
    assert np.abs(np.diff(found) / found[1:]).max() < 0.05


def test_words_in_place_of_a_file(tmp_path: Path) -> None:
    assert BuildConfig().files == (moon_map.FILE,)
    assert ModelConfig(albedo="none").albedo_file is None
    for word in ("moon", "none"):
        model = ModelConfig(albedo=word)
        assert model.beside(tmp_path) == model == model.portable
        with pytest.raises(ConfigError, match=r"needs `model\.albedo`, a map's file"):
            ModelConfig(albedo=word, albedo_encoding="linear")
    assert ModelConfig(albedo="own.tif").beside(tmp_path).albedo_file == tmp_path / "own.tif"
    assert open_map("moon").name == moon_map.FILE.name
    with pytest.raises(AlbedoError, match="none: means no albedo map"):
        AlbedoMap.open("none")


@pytest.mark.slow
def test_a_build_takes_it_by_default(tmp_path: Path) -> None:
    """History, `albedo_map` with version and licence, depfile; a map of the user overrules it, ``none`` switches it off."""
    (tmp_path / "b.toml").write_text(CONFIG.replaced({"model.albedo": "moon"}).to_toml())
    names = {}
    for given in ((), ("--albedo", str(SAMPLE)), ("--albedo", "none")):
        output, rule = tmp_path / f"{len(names)}.h5", tmp_path / f"{len(names)}.d"
        words = ["build-catalog", str(DEM), "--config", str(tmp_path / "b.toml"), *given]
        words += ["--size", "20", "--sun-elevations", "30", "--accuracy", "draft"]
        assert run([*words, "-o", str(output), "--depfile", str(rule)]) == 0
        catalog = open_catalog(output)
        found = catalog.albedo_map or {}
        names[given[-1] if given else ""] = found.get("name")
        for name in (moon_map.FILE.name, SAMPLE.name):
            read = found.get("name") == name
            assert (name in catalog.history) == (name in rule.read_text()) == read
        if not given:
            assert "CGI Moon Kit" in found["version"]
            assert "Scientific Visualization Studio" in found["licence"]
            assert [one["size"] for one in found["files"]] == [moon_map.FILE.stat().st_size]
    assert list(names.values()) == [moon_map.FILE.name, SAMPLE.name, None]


def test_finished_areas_are_of_its_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = CONFIG.replaced({"model.albedo": "moon", "area.size_km": 20.0})
    facts = []
    for changed in (b"", b"\0"):
        copy = tmp_path / moon_map.FILE.name
        copy.write_bytes(moon_map.FILE.read_bytes() + changed)
        monkeypatch.setattr(moon_map, "FILE", copy)
        facts.append(Build.plan((DEM,), config).facts())
    one, two = facts
    assert {name for name in one if one[name] != two[name]} == {"content of the files"}
