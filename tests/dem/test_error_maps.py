"""Maps of a DEM's errors, against SciPy's interpolation and closed forms, and the figures that take
their place.
"""

from __future__ import annotations

import math
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.catalogs import HADLEY
from helpers.products import DEGREE_M, cylinder, geotiff
from scipy.interpolate import RegularGridInterpolator

from lcp_catalog.atomic_files import file_facts
from lcp_catalog.dem import products
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.error_maps import (
    ErrorMaps,
    FigureMap,
    errors_of_file,
    height_errors,
    height_step_m,
)
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.products import LENGTH_PER_RESOLUTION
from lcp_catalog.errors import DemError

STEP_DEG = 0.25


def figures(path: Path, values: np.ndarray, **more: object) -> Path:
    """A map of 4 pixels a degree from 10 E, 20 N on."""
    step = STEP_DEG * DEGREE_M
    return geotiff(path, values, 10.0 * DEGREE_M, 20.0 * DEGREE_M, step, **more)


def some(shape: tuple[int, int] = (30, 40)) -> np.ndarray:
    return np.random.default_rng(3).uniform(1.0, 9.0, shape).astype(np.float32)


# -- values


def test_values_between_pixels_are_bilinear(tmp_path: Path) -> None:
    values = some((700, 1100))  # more than one window each way
    found = FigureMap.open(figures(tmp_path / "err.tif", values), "the 1 sigma of heights")
    lon = 10.0 + STEP_DEG * (np.arange(1100) + 0.5)
    lat = 20.0 - STEP_DEG * (np.arange(700) + 0.5)
    by_scipy = RegularGridInterpolator((-lat, lon), values)
    rng = np.random.default_rng(1)
    at = rng.uniform(lon[0], lon[-1], 500), rng.uniform(-85.0, lat[0], 500)
    want = by_scipy(np.stack([-at[1], at[0]], axis=-1))
    np.testing.assert_allclose(found.at(*at), want, rtol=1e-6)
    np.testing.assert_allclose(found.at(lon[5:9], lat[5]), values[5, 5:9], rtol=1e-6)


def test_at_the_edge_the_value_is_that_of_the_edge_and_beyond_it_none(tmp_path: Path) -> None:
    values = some()
    found = FigureMap.open(figures(tmp_path / "err.tif", values), "the 1 sigma of heights")
    assert found.at([10.01], [19.99]) == pytest.approx(values[0, 0])
    assert np.isnan(found.at([9.99, 10.01, 200.0], [19.99, 20.01, 0.0])).all()


def test_a_map_around_the_moon_has_no_seam(tmp_path: Path) -> None:
    path = cylinder(tmp_path / "all.tif", 0.0, 90.0, (180, 360), 1.0, lambda o, a: o + 0.0 * a)
    found = FigureMap.open(path, "the 1 sigma of heights")
    np.testing.assert_allclose(
        found.at([359.5, 0.0, 0.25, -0.25, 180.0], np.zeros(5)),
        [359.5, 180.0, 90.25, 269.75, 180.0],
    )


def test_a_missing_pixel_gives_no_value_where_it_counts(tmp_path: Path) -> None:
    values = some()
    values[4, 6] = -9999.0
    found = FigureMap.open(
        figures(tmp_path / "err.tif", values, nodata=-9999.0), "the 1 sigma of heights"
    )
    lon, lat = 10.0 + STEP_DEG * 6.5, 20.0 - STEP_DEG * 4.5
    beside = found.at([lon - STEP_DEG, lon - 0.5 * STEP_DEG, lon, lon + 1.01 * STEP_DEG], [lat] * 4)
    assert beside[0] == pytest.approx(values[4, 5])  # it has no weight there
    assert np.isnan(beside[1:3]).all()
    assert np.isfinite(beside[3])


def test_stored_steps_are_applied(tmp_path: Path) -> None:
    stored = np.full((10, 10), 200, np.uint16)
    path = figures(tmp_path / "err.tif", stored, nodata=65535, scale=0.01, offset=0.5)
    assert FigureMap.open(path, "the 1 sigma of heights").at([11.0], [19.0]) == pytest.approx(2.5)


# -- files


def test_files_that_are_no_such_map_are_refused_in_one_line(tmp_path: Path) -> None:
    plain = tmp_path / "plain.txt"
    plain.write_text("no raster")
    bare = geotiff(tmp_path / "bare.tif", some(), 0.0, 0.0, 1.0, crs=None)
    for path, words in (
        (tmp_path / "none.tif", "there is no such file"),
        (tmp_path, "is a folder"),
        (plain, "not a map of the 1 sigma of heights"),
        (bare, "has no map projection"),
    ):
        with pytest.raises(DemError, match=words) as caught:
            ErrorMaps.open(path, None)
        assert "\n" not in str(caught.value)
        assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("value", [-3.0, 2e5])
def test_values_that_are_no_errors_are_refused(tmp_path: Path, value: float) -> None:
    values = some()
    values[3, 3] = value
    maps = ErrorMaps.open(figures(tmp_path / "err.tif", values), None)
    with pytest.raises(
        DemError, match=r"err\.tif: has the value .* cannot be the 1 sigma of heights in metres"
    ):
        maps.at([10.0 + STEP_DEG * 3.5], [20.0 - STEP_DEG * 3.5])


def test_no_map_at_all_is_none_and_one_of_two_is_enough(tmp_path: Path) -> None:
    assert ErrorMaps.open(None, None) is None
    path = figures(tmp_path / "effres.tif", some())
    maps = pickle.loads(pickle.dumps(ErrorMaps.open(None, path)))
    sigma, resolution = maps.at([11.0, 99.0], [19.0, 0.0])
    assert np.isnan(sigma).all()
    assert np.isfinite(resolution).tolist() == [True, False]
    assert maps.files == (path,)
    (fact,) = file_facts(maps.files)
    assert fact["name"] == "effres.tif"
    assert len(fact["sha256"]) == 64


def test_a_map_of_another_place_is_refused_and_a_part_is_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    maps = ErrorMaps.open(figures(tmp_path / "err.tif", some()), None)
    with pytest.raises(DemError, match=r"err\.tif: has no value in the area \(here\); it covers"):
        maps.check_cover([100.0, 101.0], [0.0, 0.0], "here")
    maps.check_cover([11.0, 99.0], [19.0, 0.0], "here")
    assert "no value in 50 % of the area" in caplog.text
    caplog.clear()
    maps.check_cover([11.0, 12.0], [19.0, 18.0], "here")
    assert not caplog.text


# -- the figures


def test_a_file_without_a_map_has_the_figures_of_its_product_and_of_its_heights() -> None:
    dem = Dem.open(HADLEY)
    found = errors_of_file(dem)
    facts = dem.facts
    assert found.sigma_m == (facts.calibrated_sigma_m or facts.sigma_m)
    if facts.calibrated_length_m is None:
        measured = dem.effective_resolution.resolution_m
        assert found.length_m == LENGTH_PER_RESOLUTION * measured


def test_a_calibration_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    made = products.ProductFacts("GLD100", None, 20.0, 300.0, "published", 6.5, 420.0)
    monkeypatch.setattr(Dem, "facts", property(lambda dem: made))
    found = errors_of_file(Dem.open(HADLEY))
    assert (found.sigma_m, found.length_m) == (6.5, 420.0)


def test_errors_of_a_product_without_figures_follow_what_it_resolves(tmp_path: Path) -> None:
    path = figures(tmp_path / "mine.tif", some())
    found = errors_of_file(Dem.open(path))
    posting_m = STEP_DEG * DEGREE_M  # too coarse to measure
    assert found.sigma_m == pytest.approx(0.0245 * posting_m, rel=1e-3)
    assert found.length_m == pytest.approx(0.5 * posting_m)


def test_a_renamed_product_has_about_the_errors_of_its_calibration(tmp_path: Path) -> None:
    renamed = shutil.copy(HADLEY, tmp_path / "mine.tif")
    known, found = errors_of_file(Dem.open(HADLEY)), errors_of_file(Dem.open(renamed))
    assert found.sigma_m == pytest.approx(known.sigma_m, rel=0.05)
    assert found.length_m == pytest.approx(known.length_m, rel=0.1)


@pytest.mark.parametrize("step_m", [0.467, 5.0])
def test_rounding_is_part_of_the_errors(tmp_path: Path, step_m: float) -> None:
    """Steps of an 8-bit DTM: their rms error is step / sqrt(12)."""
    rough = np.cumsum(np.random.default_rng(3).normal(0.0, 1.0, (64, 64)), axis=1)
    rounded = (np.rint(rough / step_m) * step_m).astype(np.float32)
    one, other = (
        Dem.open(geotiff(tmp_path / f"{name}.tif", z, 0.0, 0.0, 2.0))
        for name, z in (("rough", rough.astype(np.float32)), ("rounded", rounded))
    )
    assert height_step_m(other) == pytest.approx(step_m, rel=1e-3)
    assert height_step_m(one) < 0.01
    rounding = np.std(rounded - rough)
    without = 0.0245 * (other.effective_resolution.resolution_m or 2.0)
    assert errors_of_file(other).sigma_m == pytest.approx(np.hypot(without, rounding), rel=0.05)


def test_a_map_counts_where_it_has_a_value(tmp_path: Path) -> None:
    path = geotiff(
        tmp_path / "err.tif",
        np.full((4, 4), 7.0, np.float32),
        3.0 * DEGREE_M,
        27.0 * DEGREE_M,
        DEGREE_M,
    )
    maps = ErrorMaps.open(path, None)
    dems = DemSet.open([HADLEY])
    alone = errors_of_file(dems.dems[0])
    sigma, length = height_errors(dems, [4.0, 1.0, 4.0, 50.0], [26.0, 22.0, 29.0, 0.0], maps)
    np.testing.assert_allclose(sigma, [7.0, alone.sigma_m, alone.sigma_m, math.nan])
    np.testing.assert_allclose(length, [alone.length_m] * 3 + [math.nan])
    _, length = height_errors(dems, [4.0, 1.0], [26.0, 22.0], ErrorMaps.open(None, path))
    np.testing.assert_allclose(length, [7.0 * LENGTH_PER_RESOLUTION, alone.length_m])
