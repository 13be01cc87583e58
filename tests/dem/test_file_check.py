"""Problems that ``check_dem`` finds in sizes and statements: each kind of damage is made on purpose, on products with real
heights.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.archive_files import Product
from helpers.damaged import edit, only_problem
from helpers.products import cut

from lcp_catalog.dem.file_check import CheckResult, check_dem


@pytest.mark.slow
def test_every_product_is_sound(archive: dict[str, Product]) -> None:
    for product in archive.values():
        for path in product.opened_by:
            verdict = check_dem(path)
            assert verdict.problems == (), verdict
            known = not product.name.startswith("Haworth")
            assert (verdict.notes == ()) == known, verdict
            assert verdict.product == product.name


def test_the_archives_own_files_are_sound(ldem_4: Path) -> None:
    """LDEM_4's label is one count away from its pixels (-17758 and -17757), its JP2 is lossy: both are as archived."""
    for path in sorted(ldem_4.iterdir()):
        assert check_dem(path) == CheckResult(str(path), "LDEM_4", ())


class TestSizes:
    @pytest.mark.parametrize(
        "image", ["LDEM_16.IMG", "WAC_GLD100_E300N0450_256P.IMG", "ldem_875s_20m_float.img"]
    )
    def test_cut_short(
        self, archive_copy: Callable[[str], Path], tmp_path: Path, image: str
    ) -> None:
        path = archive_copy(image)
        (tmp_path / image).write_bytes((tmp_path / image).read_bytes()[:-2])
        assert re.search(
            r"has \d+ bytes where its label .* states \d+: cut short", only_problem(path)
        )

    @pytest.mark.parametrize(
        "image", ["LDEM_16.IMG", "WAC_GLD100_E300N0450_256P.IMG", "ldem_875s_20m_float.img"]
    )
    def test_too_long(
        self, archive_copy: Callable[[str], Path], tmp_path: Path, image: str
    ) -> None:
        path = archive_copy(image)
        with (tmp_path / image).open("ab") as file:
            file.write(bytes(144))
        assert "144 more than its label" in only_problem(path)

    def test_objects_behind_an_attached_image_are_no_surplus(
        self, archive_copy: Callable[[str], Path]
    ) -> None:
        path = archive_copy("WAC_GLD100_E300N0450_256P.IMG")
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

    def test_truncated_jp2(self, archive_copy: Callable[[str], Path], tmp_path: Path) -> None:
        path = archive_copy("LDEM_64.JP2")
        image = tmp_path / "LDEM_64.JP2"
        image.write_bytes(image.read_bytes()[:-200])
        assert "damaged or truncated" in only_problem(path)

    def test_truncated_geotiff(self, archive_copy: Callable[[str], Path]) -> None:
        path = archive_copy("ldem_87s_5mpp.tif")
        path.write_bytes(path.read_bytes()[:9000])
        assert re.search("truncated|not a DEM that can be read", only_problem(path))

    def test_jp2_of_another_size(self, archive_copy: Callable[[str], Path]) -> None:
        path = archive_copy("LDEM_64.JP2")
        edit(path, lambda text: cut(text, LINES=59))
        assert "has 60 x 72 pixels where its label LDEM_64_JP2.LBL states 59 x 72" in only_problem(
            path
        )

    @pytest.mark.parametrize("given_as", ["LBL", "TIF"])
    def test_tif_of_another_size(self, archive_copy: Callable[[str], Path], given_as: str) -> None:
        path = archive_copy("NAC_DTM_APOLLO15.TIF")
        edit(path, lambda text: cut(text, LINE_SAMPLES=71))
        assert "60 x 72 pixels where its label NAC_DTM_APOLLO15.LBL states 60 x 71" in only_problem(
            path.with_suffix(f".{given_as}")
        )

    def test_a_label_that_contradicts_itself(self, archive_copy: Callable[[str], Path]) -> None:
        path = archive_copy("LDEM_16.IMG")
        edit(path, lambda text: cut(text, FILE_RECORDS=30))
        assert "states a file of 4320 bytes, which cannot hold 60 x 72 samples" in only_problem(
            path
        )

    @pytest.mark.parametrize(("gone", "given"), [("LBL", "IMG"), ("IMG", "LBL")])
    def test_label_or_image_missing(
        self, archive_copy: Callable[[str], Path], gone: str, given: str
    ) -> None:
        path = archive_copy("LDEM_16.IMG")
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
        self, archive_copy: Callable[[str], Path], image: str, key: str
    ) -> None:
        path = archive_copy(image)
        away = 0.003 if "FLOAT" in image else 4  # 3 m; 2 m
        said = float(re.search(rf"\b{key}\s*=\s*(\S+)", path.read_bytes().decode("latin-1"))[1])
        edit(path, lambda text: cut(text, **{key: said + away}))
        assert f"states {key} {said + away:g} where the pixels of" in only_problem(path)

    def test_one_count_is_allowed(self, archive_copy: Callable[[str], Path]) -> None:
        path = archive_copy("LDEM_64.IMG")
        low = int(re.search(r"\bMINIMUM\s*=\s*(\S+)", path.read_text(encoding="latin-1"))[1])
        edit(path, lambda text: cut(text, MINIMUM=low - 1))
        assert check_dem(path).sound

    def test_derived_extremes(self, archive_copy: Callable[[str], Path]) -> None:
        path = archive_copy("LDEM_80S_20M.IMG")
        edit(path, lambda text: cut(text, DERIVED_MAXIMUM=14054))
        assert "states MAXIMUM 14054" in only_problem(path)

    def test_extremes_in_metres(self, archive_copy: Callable[[str], Path]) -> None:
        path = archive_copy("LDEM_64.IMG")
        low = int(re.search(r"\bMINIMUM\s*=\s*(\S+)", path.read_text(encoding="latin-1"))[1])
        edit(path, lambda text: cut(text, MINIMUM=low / 2))
        assert check_dem(path).sound

    @pytest.mark.parametrize("image", ["LDEM_64.IMG", "LDEM_64.JP2", "ldem_875s_20m_float.img"])
    def test_md5(self, archive_copy: Callable[[str], Path], tmp_path: Path, image: str) -> None:
        path = archive_copy(image)
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

    def test_checksum(
        self, archive_copy: Callable[[str], Path], archive: dict[str, Product]
    ) -> None:
        """PDS3: the unsigned 32-bit sum of all data values of the object."""
        path = archive_copy("LDEM_64.IMG")
        total = int(np.fromfile(archive["LDEM_64.IMG"].image, "<i2").astype(object).sum())
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
        self, archive_copy: Callable[[str], Path], image: str, key: str, value: float, says: str
    ) -> None:
        path = archive_copy(image)
        edit(path, lambda text: cut(text, **{key: value}))
        assert any(says in problem for problem in check_dem(path).problems)

    def test_a_label_that_puts_its_tif_elsewhere(self, archive_copy: Callable[[str], Path]) -> None:
        path = archive_copy("NAC_DTM_APOLLO15.TIF")

        def shift(text: str) -> str:  # 3 pixels are within the tolerance of the bounds
            said = float(re.search(r"SAMPLE_PROJECTION_OFFSET\s*=\s*(\S+)", text)[1])
            return cut(text, SAMPLE_PROJECTION_OFFSET=said - 1.4)

        edit(path, shift)
        assert "puts the north-west pixel 1.4 pixels away" in only_problem(path.with_suffix(".TIF"))
