"""Files of heights are refused as images; images of every kind are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.products import geotiff, sldem_512

from lcp_catalog.errors import ImageError
from lcp_catalog.images.image_file import refuse_heights

ROOT = Path(__file__).resolve().parents[2]
DEGREE_M = 30323.35


def relief(low: float, high: float, dtype: str = "float32") -> np.ndarray:
    """A rough surface with a range of values."""
    noise = np.random.default_rng(1).random((60, 80))
    return (low + (high - low) * noise).astype(dtype)


def made(path: Path, values: np.ndarray) -> Path:
    return geotiff(path, values, 3.0 * DEGREE_M, 26.0 * DEGREE_M, 100.0)


REFUSED = {
    "plain.tif": relief(-2500.0, 1500.0),  # by samples below 0
    "sldem2015_512_part.tif": relief(1000.0, 4000.0),  # by its name
    "wac_gld100_e300n0450_256p.tif": relief(1000.0, 4000.0, "int16"),
    "counts.tif": relief(-3000.0, -100.0, "int16"),
}

ACCEPTED = {
    "reflectance.tif": relief(-0.02, 0.3),  # calibrated, with noise below 0
    "radiance.tif": relief(0.0, 400.0),
    "noisy.tif": relief(-40.0, 4000.0),  # counts with a dark level removed
    "gld100_256p_render.tif": relief(0.0, 0.4),  # a render with the name of its DEM
    "NAC_DTM_APOLLO11_M150361817_50CM.tif": relief(0.0, 3000.0, "int16"),
    "sldem2015_view.tif": relief(0.0, 255.0, "uint8"),
    "sldem2015_wide.tif": relief(0.0, 60000.0, "uint16"),
    "signed.tif": relief(-1000.0, 20000.0, "int16"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_heights_are_no_image(tmp_path: Path, name: str) -> None:
    with pytest.raises(ImageError, match=r"holds heights .* m\), not brightness; .* `dem`") as said:
        refuse_heights(made(tmp_path / name, REFUSED[name]))
    assert "\n" not in str(said.value)


@pytest.mark.parametrize("name", ACCEPTED)
def test_brightness_is_an_image(tmp_path: Path, name: str) -> None:
    refuse_heights(made(tmp_path / name, ACCEPTED[name]))


def test_the_samples_are_told_apart() -> None:
    assert refuse_heights(ROOT / "sample_data" / "AS15-M-0414.png") is None
    with pytest.raises(
        ImageError, match=r"hadley_gld100_256ppd\.tif: holds heights \(GLD100_256: -2688"
    ):
        refuse_heights(ROOT / "sample_data" / "hadley_gld100_256ppd.tif")
    with pytest.raises(ImageError, match="LDEM_4"):
        refuse_heights(ROOT / "tests" / "data" / "ldem_4" / "LDEM_4.IMG")


def test_a_product_with_a_label_is_known_by_it(tmp_path: Path) -> None:
    """Its samples are kilometres, so that they look like brightness."""
    label = sldem_512(tmp_path, 3, 26, 60, 40)
    for path in (label, next(tmp_path.glob("*.IMG"))):
        with pytest.raises(ImageError, match="SLDEM2015_512"):
            refuse_heights(path)


def test_no_data_and_special_codes_say_nothing(tmp_path: Path) -> None:
    """Missing samples, and the largest floats of ISIS, are no heights."""
    values = relief(0.0, 0.3)
    values[:30] = np.float32(-3.4028227e38)
    refuse_heights(made(tmp_path / "special.tif", values))
    empty = geotiff(
        tmp_path / "empty.tif", np.full((9, 9), -9999.0, "float32"), 0.0, 0.0, 100.0, nodata=-9999.0
    )
    refuse_heights(empty)


def test_other_files_are_left_to_the_reader(tmp_path: Path) -> None:
    (tmp_path / "note.tif").write_text("no raster")
    refuse_heights(tmp_path / "note.tif")
    (tmp_path / "alone.img").write_bytes(bytes(100))
    refuse_heights(tmp_path / "alone.img")
