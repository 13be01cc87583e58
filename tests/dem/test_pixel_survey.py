"""What ``check_dem`` finds in the pixels themselves: every kind of damage is made on purpose, on products with real heights;
and the survey against plain numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.archive_files import Product
from helpers.damaged import edit, only_problem, set_samples
from helpers.products import DEGREE_M, cut, geotiff
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.dem.file_check import Verdict, check_dem
from lcp_catalog.dem.pixel_survey import survey_pixels
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
        assert any("only when they are swapped" in problem for problem in check_dem(path).problems)

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
        assert f"the value {value} stands in 5 pixels (0.12%)" in problems[0]
        assert "MISSING_CONSTANT" in problems[0]

    def test_a_sign_within_the_possible_heights(
        self, tmp_path: Path, archive: dict[str, Product]
    ) -> None:
        heights = archive["LDEM_64.IMG"].heights_m.astype(np.float32)
        heights[7, 5:9] = -9999.0
        path = geotiff(tmp_path / "LDEM_64.tif", heights, 0.0, 29 * DEGREE_M, DEGREE_M / 64)
        assert "the value -9999 stands in 4 pixels" in only_problem(path)
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
        assert any("3 rows and 1 columns hold nothing but zero" in note for note in verdict.notes)

    def test_one_value_is_a_note(self, tmp_path: Path) -> None:
        path = geotiff(tmp_path / "LDEM_64.tif", np.full((4, 4), 7.0, np.float32), 0.0, 0.0, 10.0)
        assert check_dem(path) == Verdict(
            str(path), "LDEM_64", (), ("all pixels hold the one value 7",)
        )

    def test_an_unknown_product_is_a_note(self, tmp_path: Path) -> None:
        path = geotiff(
            tmp_path / "mine.tif", np.arange(16, dtype=np.float32).reshape(4, 4), 0.0, 0.0, 10.0
        )
        verdict = check_dem(path)
        assert verdict.sound
        assert "none that is known here" in verdict.notes[0]

    def test_a_renamed_image_is_a_note(
        self, archive_copy: Callable[[str], Path], tmp_path: Path
    ) -> None:
        path = archive_copy("LDEM_64.IMG")
        for ending in ("LBL", "IMG"):
            (tmp_path / f"LDEM_64.{ending}").rename(tmp_path / f"LDEM_64_mine.{ending}")
        assert check_dem(path.with_name("LDEM_64_mine.IMG")).notes == (
            "the label calls its image LDEM_64.IMG, the file is called LDEM_64_mine.IMG",
        )


@settings(deadline=None)
@given(
    samples=st.lists(st.lists(st.integers(-5, 5), min_size=3, max_size=3), min_size=1, max_size=40),
    missing=st.sampled_from([(), (0.0,), (-5.0, 5.0)]),
)
def test_strips_change_nothing(
    samples: list[list[int]], missing: tuple[float, ...], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The survey in strips of one row against plain numpy over the whole."""
    import lcp_catalog.dem.pixel_survey as module

    values = np.array(samples, "<i2")
    path = tmp_path_factory.mktemp("strips") / "x.img"
    path.write_bytes(values.tobytes())
    raster = Raster(path, 3, len(values), 2.0, 0.0, missing, "<i2")
    whole = survey_pixels(raster)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_STRIP_PIXELS", 3)
        assert survey_pixels(raster) == whole
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
