"""What ``check_dem`` finds: every kind of damage is made on purpose, on products with real heights."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import archive_products
import numpy as np
import pytest
from archive_products import Product
from hypothesis import given, settings
from hypothesis import strategies as st
from products import DEGREE_M, cut, geotiff

from lcp_catalog.integrity import Verdict, check_dem
from lcp_catalog.pixel_survey import survey_pixels
from lcp_catalog.raster import Raster


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Product]:
    found = archive_products.all_products(tmp_path_factory.mktemp("products"))
    return {product.image.name: product for product in found}


@pytest.fixture
def copy(made: dict[str, Product], tmp_path: Path) -> Callable[[str], Path]:
    """Copies a product; gives its label, or the image where the label is in front of it."""

    def do(image: str) -> Path:
        copies = [Path(shutil.copy(path, tmp_path)) for path in made[image].opened_by]
        return copies[0]

    return do


def edit(path: Path, change: Callable[[str], str]) -> None:
    text = path.read_bytes().decode("latin-1")
    changed = change(text)
    assert changed != text
    path.write_bytes(changed.encode("latin-1"))


def set_samples(
    image: Path, dtype: str, change: Callable[[np.ndarray], None], skip: int = 0
) -> None:
    data = image.read_bytes()
    samples = np.frombuffer(data[skip:], dtype).copy().reshape(60, 72)
    change(samples)
    image.write_bytes(data[:skip] + samples.tobytes())


def only_problem(path: Path) -> str:
    verdict = check_dem(path)
    assert len(verdict.problems) == 1, verdict
    assert not verdict.sound
    assert str(path.parent) in verdict.problems[0]
    assert "\n" not in verdict.problems[0]
    return verdict.problems[0]


def test_every_product_is_sound(made: dict[str, Product]) -> None:
    for product in made.values():
        for path in product.opened_by:
            verdict = check_dem(path)
            assert verdict.problems == (), verdict
            known = not product.name.startswith("Haworth")
            assert (verdict.notes == ()) == known, verdict
            assert verdict.product == product.name


def test_the_archives_own_files_are_sound(ldem_4: Path) -> None:
    """LDEM_4's label is one count away from its pixels (-17758 and -17757), its JP2 is lossy: both are as archived."""
    for path in sorted(ldem_4.iterdir()):
        assert check_dem(path) == Verdict(str(path), "LDEM_4", ())


class TestSizes:
    @pytest.mark.parametrize(
        "image", ["LDEM_16.IMG", "WAC_GLD100_E300N0450_256P.IMG", "ldem_875s_20m_float.img"]
    )
    def test_cut_short(self, copy: Callable[[str], Path], tmp_path: Path, image: str) -> None:
        path = copy(image)
        (tmp_path / image).write_bytes((tmp_path / image).read_bytes()[:-2])
        assert re.search(
            r"has \d+ bytes where its label .* says \d+: cut short", only_problem(path)
        )

    @pytest.mark.parametrize(
        "image", ["LDEM_16.IMG", "WAC_GLD100_E300N0450_256P.IMG", "ldem_875s_20m_float.img"]
    )
    def test_too_long(self, copy: Callable[[str], Path], tmp_path: Path, image: str) -> None:
        path = copy(image)
        with (tmp_path / image).open("ab") as file:
            file.write(bytes(144))
        assert "144 more than its label" in only_problem(path)

    def test_objects_behind_an_attached_image_are_no_surplus(
        self, copy: Callable[[str], Path]
    ) -> None:
        path = copy("WAC_GLD100_E300N0450_256P.IMG")
        records = int(re.search(r"FILE_RECORDS = (\d+)", path.read_bytes().decode("latin-1"))[1])
        more = str(records + 1)
        assert len(more) == len(str(records))  # so that no pixel moves
        edit(
            path,
            lambda text: (
                text.replace(f"FILE_RECORDS = {records}", f"FILE_RECORDS = {more}") + "x" * 144
            ),
        )
        assert check_dem(path).sound
        with path.open("ab") as file:
            file.write(b"x")
        assert "1 more than its label" in only_problem(path)

    def test_truncated_jp2(self, copy: Callable[[str], Path], tmp_path: Path) -> None:
        path = copy("LDEM_64.JP2")
        image = tmp_path / "LDEM_64.JP2"
        image.write_bytes(image.read_bytes()[:-200])
        assert "damaged or cut short" in only_problem(path)

    def test_truncated_geotiff(self, copy: Callable[[str], Path]) -> None:
        path = copy("ldem_87s_5mpp.tif")
        path.write_bytes(path.read_bytes()[:9000])
        assert re.search("cut short|not a DEM that can be read", only_problem(path))

    def test_jp2_of_another_size(self, copy: Callable[[str], Path]) -> None:
        path = copy("LDEM_64.JP2")
        edit(path, lambda text: cut(text, LINES=59))
        assert "has 60 x 72 pixels where its label LDEM_64_JP2.LBL says 59 x 72" in only_problem(
            path
        )

    @pytest.mark.parametrize("given_as", ["LBL", "TIF"])
    def test_tif_of_another_size(self, copy: Callable[[str], Path], given_as: str) -> None:
        path = copy("NAC_DTM_APOLLO15.TIF")
        edit(path, lambda text: cut(text, LINE_SAMPLES=71))
        assert "60 x 72 pixels where its label NAC_DTM_APOLLO15.LBL says 60 x 71" in only_problem(
            path.with_suffix(f".{given_as}")
        )

    def test_a_label_that_contradicts_itself(self, copy: Callable[[str], Path]) -> None:
        path = copy("LDEM_16.IMG")
        edit(path, lambda text: cut(text, FILE_RECORDS=30))
        assert "states a file of 4320 bytes, which cannot hold 60 x 72 samples" in only_problem(
            path
        )

    @pytest.mark.parametrize(("gone", "given"), [("LBL", "IMG"), ("IMG", "LBL")])
    def test_label_or_image_missing(
        self, copy: Callable[[str], Path], gone: str, given: str
    ) -> None:
        path = copy("LDEM_16.IMG")
        path.with_suffix(f".{gone}").unlink()
        assert f"LDEM_16.{gone}" in only_problem(path.with_suffix(f".{given}"))

    def test_not_there_at_all(self, tmp_path: Path) -> None:
        assert "no such file" in only_problem(tmp_path / "none.tif")


class TestStatements:
    @pytest.mark.parametrize("key", ["MINIMUM", "MAXIMUM"])
    @pytest.mark.parametrize(
        "image", ["LDEM_64.IMG", "LDEM_64.JP2", "SLDEM2015_256_00N_30N_000_045_FLOAT.IMG"]
    )
    def test_extremes_of_another_file(
        self, copy: Callable[[str], Path], image: str, key: str
    ) -> None:
        path = copy(image)
        away = 0.003 if "FLOAT" in image else 4  # 3 m; 2 m
        said = float(re.search(rf"\b{key}\s*=\s*(\S+)", path.read_bytes().decode("latin-1"))[1])
        edit(path, lambda text: cut(text, **{key: said + away}))
        assert f"states {key} {said + away:g} where the pixels of" in only_problem(path)

    def test_one_count_is_allowed(self, copy: Callable[[str], Path]) -> None:
        path = copy("LDEM_64.IMG")
        low = int(re.search(r"\bMINIMUM\s*=\s*(\S+)", path.read_text(encoding="latin-1"))[1])
        edit(path, lambda text: cut(text, MINIMUM=low - 1))
        assert check_dem(path).sound

    def test_derived_extremes(self, copy: Callable[[str], Path]) -> None:
        path = copy("LDEM_80S_20M.IMG")
        edit(path, lambda text: cut(text, DERIVED_MAXIMUM=14054))
        assert "states MAXIMUM 14054" in only_problem(path)

    def test_extremes_in_metres(self, copy: Callable[[str], Path]) -> None:
        path = copy("LDEM_64.IMG")
        low = int(re.search(r"\bMINIMUM\s*=\s*(\S+)", path.read_text(encoding="latin-1"))[1])
        edit(path, lambda text: cut(text, MINIMUM=low / 2))
        assert check_dem(path).sound

    @pytest.mark.parametrize("image", ["LDEM_64.IMG", "LDEM_64.JP2", "ldem_875s_20m_float.img"])
    def test_md5(self, copy: Callable[[str], Path], tmp_path: Path, image: str) -> None:
        path = copy(image)
        digest = hashlib.md5((tmp_path / image).read_bytes()).hexdigest()
        if path.suffix == ".xml":
            edit(
                path,
                lambda text: text.replace(
                    "</file_name>", f"</file_name><md5_checksum>{digest}</md5_checksum>"
                ),
            )
        else:
            edit(
                path,
                lambda text: text.replace(
                    "FILE_NAME ", f'MD5_CHECKSUM = "{digest}"\nFILE_NAME ', 1
                ),
            )
        assert check_dem(path).sound
        edit(path, lambda text: text.replace(digest, digest[::-1]))
        assert f"states the MD5 sum {digest[::-1]}, {image} has {digest}" in only_problem(path)

    def test_checksum(self, copy: Callable[[str], Path], made: dict[str, Product]) -> None:
        """PDS3: the unsigned 32-bit sum of all data values of the object."""
        path = copy("LDEM_64.IMG")
        total = int(np.fromfile(made["LDEM_64.IMG"].image, "<i2").astype(object).sum())
        assert total < 0
        edit(
            path,
            lambda text: text.replace(
                "  SAMPLE_TYPE ", f"  CHECKSUM = {total + 2**32}\n  SAMPLE_TYPE "
            ),
        )
        assert check_dem(path).sound
        edit(path, lambda text: cut(text, CHECKSUM=total + 2**32 + 1))
        assert "add up to" in only_problem(path)

    @pytest.mark.parametrize(
        ("image", "key", "value", "says"),
        [
            (
                "LDEM_64.IMG",
                "MINIMUM_LATITUDE",
                20,
                "states MINIMUM_LATITUDE 20, its last line ends at 28.0625",
            ),
            ("LDEM_64.IMG", "EASTERNMOST_LONGITUDE", 3, "states EASTERNMOST_LONGITUDE 3"),
            ("LDEM_64.IMG", "MAXIMUM_LATITUDE", 20, "puts the north edge at 29 deg"),
            ("LDEM_80S_20M.IMG", "MAXIMUM_LATITUDE", -80, "states latitude -80 for its edge"),
            (
                "LDEM_80S_20M.IMG",
                "MAXIMUM_LATITUDE",
                -89.999,
                "states latitude -89.999 for its edge",
            ),
            ("LDEM_80N_20M.IMG", "MINIMUM_LATITUDE", 80, "states latitude 80 for its edge"),
            (
                "LDEM_80N_20M.IMG",
                "LINE_PROJECTION_OFFSET",
                400,
                "states latitude 90, but the pole lies outside",
            ),
        ],
    )
    def test_bounds_against_offsets(
        self, copy: Callable[[str], Path], image: str, key: str, value: float, says: str
    ) -> None:
        path = copy(image)
        edit(path, lambda text: cut(text, **{key: value}))
        assert any(says in problem for problem in check_dem(path).problems)

    def test_a_label_that_puts_its_tif_elsewhere(self, copy: Callable[[str], Path]) -> None:
        path = copy("NAC_DTM_APOLLO15.TIF")

        def shift(text: str) -> str:  # 3 pixels are within the tolerance of the bounds
            said = float(re.search(r"SAMPLE_PROJECTION_OFFSET\s*=\s*(\S+)", text)[1])
            return cut(text, SAMPLE_PROJECTION_OFFSET=said - 1.4)

        edit(path, shift)
        assert "puts the north-west pixel 1.4 pixels away" in only_problem(path.with_suffix(".TIF"))


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
        self, copy: Callable[[str], Path], image: str, old: str, new: str
    ) -> None:
        path = copy(image)
        edit(path, lambda text: text.replace(old, new))
        assert any("only when they are swapped" in problem for problem in check_dem(path).problems)

    @pytest.mark.parametrize("value", [-32768, 32767])
    def test_a_sign_that_is_not_declared(
        self, copy: Callable[[str], Path], tmp_path: Path, value: int
    ) -> None:
        path = copy("LDEM_64.IMG")
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
        self, tmp_path: Path, made: dict[str, Product]
    ) -> None:
        heights = made["LDEM_64.IMG"].heights_m.astype(np.float32)
        heights[7, 5:9] = -9999.0
        path = geotiff(tmp_path / "LDEM_64.tif", heights, 0.0, 29 * DEGREE_M, DEGREE_M / 64)
        assert "the value -9999 stands in 4 pixels" in only_problem(path)
        path = geotiff(
            tmp_path / "LDEM_64.tif", heights, 0.0, 29 * DEGREE_M, DEGREE_M / 64, nodata=-9999.0
        )
        assert check_dem(path).sound

    def test_impossible_heights(self, copy: Callable[[str], Path], tmp_path: Path) -> None:
        path = copy("LDEM_64.JP2")
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

    def test_stripes_of_zero_are_a_note(self, copy: Callable[[str], Path], tmp_path: Path) -> None:
        path = copy("LDEM_875N_5M.IMG")

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

    def test_a_renamed_image_is_a_note(self, copy: Callable[[str], Path], tmp_path: Path) -> None:
        path = copy("LDEM_64.IMG")
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
    import lcp_catalog.pixel_survey as module

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
