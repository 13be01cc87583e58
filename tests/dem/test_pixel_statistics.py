"""Statistics of all pixels of a file: damage on purpose that ``check_dem`` must find, samples against plain numpy; missing
pixels counted by plain numpy, their area in closed form.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.archive_files import Product
from helpers.bare_files import NORTH, R_KM, plane_rectangle, rectangle
from helpers.damaged import edit, only_problem, set_samples
from helpers.products import DEGREE_M, cut, geotiff, holed
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.dem import raster as raster_module
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.file_check import check_dem
from lcp_catalog.dem.grid import Grid
from lcp_catalog.dem.pixel_statistics import height_statistics, pixel_km2, sample_statistics
from lcp_catalog.dem.raster import Raster


class TestPixels:
    @pytest.mark.parametrize(
        ("image", "old", "new"),
        [
            ("LDEM_64.IMG", "LSB_INTEGER", "MSB_INTEGER"),
            ("LDEM_80N_20M.IMG", "LSB_INTEGER", "MSB_INTEGER"),
            ("SLDEM2015_256_00N_30N_000_045_FLOAT.IMG", "PC_REAL", "IEEE_REAL"),
            ("LDEM_875S_5M_FLOAT.IMG", "PC_REAL", "IEEE_REAL"),
            ("ldem_875s_20m_float.img", "IEEE754LSBSingle", "IEEE754MSBSingle"),
        ],
    )
    def test_swapped_bytes(
        self, archive_copy: Callable[[str], Path], image: str, old: str, new: str
    ) -> None:
        path = archive_copy(image)
        edit(path, lambda text: text.replace(old, new))
        assert any("only with swapped bytes" in problem for problem in check_dem(path).problems)

    @pytest.mark.parametrize("value", [-32768, 32767])
    def test_a_sign_that_is_not_declared(
        self, archive_copy: Callable[[str], Path], tmp_path: Path, value: int
    ) -> None:
        path = archive_copy("LDEM_64.IMG")
        set_samples(
            tmp_path / "LDEM_64.IMG",
            "<i2",
            lambda samples: samples[10, 3:8].__setitem__(slice(None), value),
        )
        problems = [p for p in check_dem(path).problems if "states M" not in p]
        assert len(problems) == 1
        assert f"the value {value} occurs in 5 pixels (0.12 %)" in problems[0]
        assert "MISSING_CONSTANT" in problems[0]

    def test_a_sign_within_the_possible_heights(
        self, tmp_path: Path, archive: dict[str, Product]
    ) -> None:
        heights = archive["LDEM_64.IMG"].heights_m.astype(np.float32)
        heights[7, 5:9] = -9999.0
        path = geotiff(tmp_path / "LDEM_64.tif", heights, 0.0, 29 * DEGREE_M, DEGREE_M / 64)
        assert "the value -9999 occurs in 4 pixels" in only_problem(path)
        path = geotiff(
            tmp_path / "LDEM_64.tif", heights, 0.0, 29 * DEGREE_M, DEGREE_M / 64, nodata=-9999.0
        )
        assert check_dem(path).sound

    def test_impossible_heights(self, archive_copy: Callable[[str], Path], tmp_path: Path) -> None:
        path = archive_copy("LDEM_64.JP2")
        edit(path, lambda text: cut(text, SCALING_FACTOR="8", MINIMUM="'N/A'", MAXIMUM="'N/A'"))
        problem = only_problem(path)
        assert "heights lie beyond 12000 m, the first at row" in problem
        assert "scale or unit is wrong" in problem

    def test_all_missing(self, tmp_path: Path) -> None:
        path = geotiff(
            tmp_path / "x.tif", np.full((4, 4), -1.0, np.float32), 0.0, 0.0, 10.0, nodata=-1.0
        )
        assert "every pixel is missing" in only_problem(path)

    def test_all_zero(self, tmp_path: Path) -> None:
        path = geotiff(tmp_path / "x.tif", np.zeros((4, 4), np.float32), 0.0, 0.0, 10.0)
        assert "every pixel is zero" in only_problem(path)

    def test_stripes_of_zero_are_a_note(
        self, archive_copy: Callable[[str], Path], tmp_path: Path
    ) -> None:
        path = archive_copy("LDEM_875N_5M.IMG")

        def stripe(samples: np.ndarray) -> None:
            samples[20:23] = 0
            samples[:, 5] = 0

        set_samples(tmp_path / "LDEM_875N_5M.IMG", "<i2", stripe)
        edit(path, lambda text: cut(text, DERIVED_MINIMUM="'N/A'", DERIVED_MAXIMUM="'N/A'"))
        verdict = check_dem(path)
        assert any("3 rows and 1 columns hold only zeros" in note for note in verdict.notes)
        assert "lie in lines or blocks of zeros" in verdict.warnings[0]

    def test_one_value_is_doubtful(self, tmp_path: Path) -> None:
        path = geotiff(tmp_path / "LDEM_64.tif", np.full((4, 4), 7.0, np.float32), 0.0, 0.0, 10.0)
        verdict = check_dem(path)
        assert (verdict.problems, verdict.notes) == ((), ())
        assert "heights from 7 to 7 m over 0.04 km are flatter than" in verdict.warnings[0]

    def test_an_unknown_product_is_a_note(self, tmp_path: Path) -> None:
        path = geotiff(
            tmp_path / "mine.tif", np.arange(16, dtype=np.float32).reshape(4, 4), 0.0, 0.0, 10.0
        )
        verdict = check_dem(path)
        assert verdict.sound
        assert "the product is not known" in verdict.notes[0]

    def test_a_renamed_image_is_a_note(
        self, archive_copy: Callable[[str], Path], tmp_path: Path
    ) -> None:
        path = archive_copy("LDEM_64.IMG")
        for ending in ("LBL", "IMG"):
            (tmp_path / f"LDEM_64.{ending}").rename(tmp_path / f"LDEM_64_mine.{ending}")
        assert check_dem(path.with_name("LDEM_64_mine.IMG")).notes == (
            "the label names its image LDEM_64.IMG, the file is called LDEM_64_mine.IMG",
        )


@settings(deadline=None)
@given(
    samples=st.lists(st.lists(st.integers(-5, 5), min_size=3, max_size=3), min_size=1, max_size=40),
    missing=st.sampled_from([(), (0.0,), (-5.0, 5.0)]),
)
def test_strips_change_nothing(
    samples: list[list[int]], missing: tuple[float, ...], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Statistics in windows of one row against plain numpy over the whole file."""
    values = np.array(samples, "<i2")
    path = tmp_path_factory.mktemp("strips") / "x.img"
    path.write_bytes(values.tobytes())
    raster = Raster(path, 3, len(values), 2.0, 0.0, missing, "<i2")
    whole = sample_statistics(raster)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(raster_module, "_WINDOW_PIXELS", 3)
        assert sample_statistics(raster) == whole
    there = values[~np.isin(values, missing)]
    assert whole.missing == values.size - there.size
    assert (whole.lowest is None) == (there.size == 0)
    if there.size:
        unique, counts = np.unique(there, return_counts=True)
        assert whole.lowest
        assert whole.highest
        assert (whole.lowest.value, whole.lowest.count) == (unique[0], counts[0])
        assert (whole.highest.value, whole.highest.count) == (unique[-1], counts[-1])
        if len(unique) > 1:
            assert (whole.lowest.gap, whole.highest.gap) == (
                unique[1] - unique[0],
                unique[-1] - unique[-2],
            )
    assert whole.sample_sum == int(values.sum()) % 2**32
    zero = (values == 0) & ~np.isin(values, missing)
    assert (whole.zero_rows, whole.zero_columns) == (zero.all(axis=1).sum(), zero.all(axis=0).sum())


def test_counts_are_those_of_numpy(tmp_path: Path) -> None:
    """1500 x 2600 pixels: blocks of three, the last ones cut; holes of any shape."""
    lost = np.random.default_rng(1).random((1500, 2600)) < 1e-3
    heights = np.where(
        lost, np.nan, np.random.default_rng(2).uniform(-5e3, 5e3, lost.shape)
    ).astype(np.float32)
    dem = Dem.open(geotiff(tmp_path / "a.tif", heights, 0.0, 15 * DEGREE_M, DEGREE_M / 100))
    found = height_statistics(dem)
    assert found.block == 3
    assert found.missing.shape == (500, 867)
    padded = np.zeros((1500, 2601), bool)
    padded[:, :2600] = lost
    assert np.array_equal(found.missing, padded.reshape(500, 3, 867, 3).sum(axis=(1, 3)))
    assert (found.min_m, found.max_m) == (
        np.nanmin(heights),
        np.nanmax(heights),
    )
    assert found.nodata_share == lost.mean()


def test_holes_are_connected_regions(tmp_path: Path) -> None:
    """A global file of one degree: a hole over its seam is one piece, the largest comes first."""
    holes = [np.s_[80:100, :10], np.s_[80:100, 350:], np.s_[10:20, 100:110]]
    found = height_statistics(
        Dem.open(
            holed(tmp_path / "a.tif", (180, 360), holes, -180 * DEGREE_M, 90 * DEGREE_M, DEGREE_M)
        )
    )
    first, second = found.holes()
    assert tuple(first.bounds) == pytest.approx((170, -10, 190, 10))
    assert first.area_km2 == pytest.approx(
        rectangle(170, -10, 190, 10), rel=2e-5
    )  # pixels' centres
    assert tuple(second.bounds) == pytest.approx((-80 % 360, 70, -70 % 360, 80))
    assert second.area_km2 == pytest.approx(rectangle(0, 70, 10, 80), rel=2e-5)
    assert found.hole_km2() == pytest.approx(first.area_km2 + second.area_km2)
    lon, lat = [175.0, -175.0, 185.0, 165.0, -75.0, -75.0], [0.0, 0.0, 9.0, 0.0, 75.0, 65.0]
    assert found.absent(lon, lat).tolist() == [True, True, True, False, True, False]


def test_a_hole_over_the_pole(tmp_path: Path) -> None:
    crs = NORTH.format(lon=0)
    found = height_statistics(
        Dem.open(
            holed(tmp_path / "a.tif", (100, 100), [np.s_[40:60, 40:60]], -5e4, 5e4, 1000.0, crs=crs)
        )
    )
    (hole,) = found.holes()
    assert (hole.bounds.west, hole.bounds.east, hole.bounds.north) == (0.0, 360.0, 90.0)
    assert hole.bounds.south == pytest.approx(
        90.0 - 2.0 * math.degrees(math.atan(math.hypot(10, 10) / 2 / R_KM))
    )
    assert hole.area_km2 == pytest.approx(plane_rectangle(-10, -10, 10, 10), rel=1e-6)


def test_a_hole_beside_the_pole(tmp_path: Path) -> None:
    """Columns 70..79, rows 45..54 of the north polar map: around longitude 90 E."""
    crs = NORTH.format(lon=0)
    found = height_statistics(
        Dem.open(
            holed(tmp_path / "a.tif", (100, 100), [np.s_[45:55, 70:80]], -5e4, 5e4, 1000.0, crs=crs)
        )
    )
    (hole,) = found.holes()
    half = math.degrees(math.atan(5 / 20))
    assert (hole.bounds.west, hole.bounds.east) == pytest.approx((90.0 - half, 90.0 + half))
    assert not found.absent(
        [90.0, 90.0], [90.0 - math.degrees(v / R_KM) for v in (19.0, 31.0)]
    ).any()
    assert found.absent(90.0, 90.0 - math.degrees(25.0 / R_KM))


@pytest.mark.parametrize("true_lat", [0.0, 30.0, -55.0])
def test_pixels_of_a_cylinder_add_up_to_its_area(true_lat: float) -> None:
    """True to scale away from the equator: a pixel's area is not its square at the equator."""
    squeeze = math.cos(math.radians(true_lat))
    pixel_m = DEGREE_M / 10
    grid = Grid("equirectangular", 200, 300, pixel_m, 0.5 * pixel_m, 399.5 * pixel_m, 0.0, true_lat)
    total = pixel_km2(grid, 0.0, np.arange(300)).sum() * 200
    assert total == pytest.approx(rectangle(0.0, 10.0, 20.0 / squeeze, 40.0), rel=1e-5)


def test_pixels_of_a_polar_map_add_up_to_its_area() -> None:
    grid = Grid("polar-stereographic", 400, 400, 1000.0, -199_500.0, 199_500.0, 0.0, -80.0)
    column, row = np.meshgrid(np.arange(400), np.arange(400))
    scale = (1.0 + math.sin(math.radians(80.0))) / 2.0  # the plane's kilometres are true at 80 S
    assert pixel_km2(grid, column, row).sum() == pytest.approx(
        plane_rectangle(*(v / scale for v in (-200, -200, 200, 200))), rel=1e-6
    )
