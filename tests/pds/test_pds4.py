"""PDS4 labels: the same map and heights as GDAL's driver finds, and labels that cannot be trusted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.archive_files import Product
from helpers.damaged import substitute

from lcp_catalog.dem.dem import Dem
from lcp_catalog.errors import LabelError


def test_pds4_agrees_with_gdal(archive: dict[str, Product]) -> None:
    """GDAL's PDS4 driver: the same map and, kilometres taken for metres, the same heights."""
    product = archive["ldem_875s_20m_float.img"]
    dem = Dem.open(product.label)
    with rasterio.open(product.label) as dataset:
        assert dataset.driver == "PDS4"
        assert (dataset.transform.c, dataset.transform.f) == (
            product.frame.west_m,
            product.frame.north_m,
        )
        np.testing.assert_allclose(dem.read(0, 60, 0, 72), dataset.read(1) * 1000.0, atol=1e-3)
        x, y = dataset.transform * (0.5, 0.5)
    assert (dem.grid.x0_m, dem.grid.y0_m) == (x, y)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (">Positive East<", ">Positive West<", "west-positive longitudes"),
        ("<name>Moon<", "<name>Mars<", "target is Mars"),
        ('<cart:a_axis_radius unit="km">1737.4', '<cart:a_axis_radius unit="km">3396.19', "3396190 m"),
        (' unit="m/pixel">20</cart:pixel_resolution_x', ">20</cart:pixel_resolution_x", "no unit: metres or kilometres"),
        ("<unit>KILOMETER</unit>", "", "no unit: metres or kilometres"),
        (">1737.4</value_offset>", ">3396.0</value_offset>", "3396000 m"),
        ("IEEE754LSBSingle", "ComplexLSB8", "type ComplexLSB8"),
        (">Polar Stereographic<", ">Sinusoidal<", "Sinusoidal"),
        (">-90</cart:latitude_of_projection_origin>", ">-60</cart:latitude_of_projection_origin>", "latitude -60"),
        ("<cart:upperleft_corner_x unit=\"m\">", "<cart:upperleft_corner_x unit=\"m\">x", "upperleft_corner_x"),
        ("</Product_Observational>", "", "damaged XML"),
        ("<elements>72", "<elements>none", "lines and samples"),
    ],
)  # fmt: skip
def test_pds4_labels_that_cannot_be_trusted(
    archive: dict[str, Product], tmp_path: Path, old: str, new: str, says: str
) -> None:
    label = archive["ldem_875s_20m_float.img"].copied_to(tmp_path)
    substitute(label, old, new)
    with pytest.raises(LabelError, match=says) as caught:
        Dem.open(label)
    assert str(caught.value).startswith(f"{label}: ")
    assert "\n" not in str(caught.value)


def test_pds4_missing_constants(archive: dict[str, Product], tmp_path: Path) -> None:
    label = archive["ldem_875s_20m_float.img"].copied_to(tmp_path)
    substitute(label, "</Element_Array>", "</Element_Array><Special_Constants><missing_constant>-99</missing_constant>"
          "</Special_Constants>")  # fmt: skip
    samples = np.fromfile(label.with_suffix(".img"), "<f4")
    samples[3] = -99.0
    samples.tofile(label.with_suffix(".img"))
    assert np.isnan(Dem.open(label).read(0, 1, 0, 5)).tolist() == [
        [False, False, False, True, False]
    ]
