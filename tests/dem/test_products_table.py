"""Every product of the documentation's table.

The products are made by ``archive_products`` from the archive's label texts and real heights. The references are PROJ (positions of
pixels) and the surface that the products were sampled from (heights).
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyproj
import pytest
from helpers import real_heights
from helpers.archive_files import Product

from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.mosaic import DemSet

DEGREE = 1_737_400.0 * np.pi / 180.0
POLAR = [(f"LDEM_{area}{side}_{m}M", float(m), pole) for area, m in (("75", 30), ("80", 20), ("85", 10), ("875", 5))
         for side, pole in (("N", 1), ("S", -1))]  # fmt: skip

TABLE: list[tuple[str, str, str, float, int]] = [
    # the image, the name it goes by, projection, pixel in metres, pole
    *((f"SLDEM2015_{n}_{tile}{ending}", f"SLDEM2015_{n}", "equirectangular", DEGREE / n, 0)
      for n, tile in ((512, "00N_30N_000_045"), (256, "00N_30N_000_045"), (128, "60S_60N_000_360"))
      for ending in ("_FLOAT.IMG", ".JP2")),
    *((f"LDEM_{n}{'_00N_45N_000_090' if n == 512 else ''}.{ending}", f"LDEM_{n}", "equirectangular", DEGREE / n, 0)
      for n in (4, 16, 64, 128, 512) for ending in ("IMG", "JP2")),
    *((f"{name}{ending}", name, "polar-stereographic", pixel_m, pole)
      for name, pixel_m, pole in POLAR for ending in (".IMG", "_FLOAT.IMG", ".JP2")),
    ("ldem_875s_20m_float.img", "LDEM_875S_20M", "polar-stereographic", 20.0, -1),
    ("ldem_87s_5mpp.tif", "LDEM_87S_5MPP", "polar-stereographic", 5.0, -1),
    ("LDEM_80S_20MPP_ADJ.tif", "LDEM_80S_20MPP_ADJ", "polar-stereographic", 20.0, -1),
    ("Haworth_final_adj_5mpp_surf.tif", "Haworth_final_adj_5mpp_surf", "polar-stereographic", 5.0, -1),
    ("NAC_DTM_APOLLO15.TIF", "NAC_DTM_APOLLO15", "equirectangular", 2.0, 0),
    ("NAC_DTM_APOLLO15_2.IMG", "NAC_DTM_APOLLO15_2", "equirectangular", 2.0, 0),
    ("NAC_DTM_APOLLO15_3.IMG", "NAC_DTM_APOLLO15_3", "equirectangular", 2.0, 0),
    *((f"WAC_GLD100_{area}_{n:03d}P.IMG", f"GLD100_{n}", "equirectangular", DEGREE / n, 0)
      for n, area in ((16, "E000N1800"), (64, "E000N1800"), (256, "E300N0450"))),
]  # fmt: skip


def test_the_table_is_whole(archive: dict[str, Product]) -> None:
    assert sorted(archive) == sorted(row[0] for row in TABLE)


@pytest.mark.slow
@pytest.mark.parametrize("image", [row[0] for row in TABLE])
def test_each_product(archive: dict[str, Product], image: str, tmp_path: Path) -> None:
    """Facts, pixels, heights and file names of one product."""
    for check in (
        check_facts,
        check_pixels_against_proj,
        check_heights_of_the_source,
        check_heights_by_longitude_and_latitude,
        check_letter_case,
    ):
        check(archive, image, tmp_path)


def check_facts(archive: dict[str, Product], image: str, tmp_path: Path) -> None:
    product = archive[image]
    _, name, projection, pixel_m, pole = next(row for row in TABLE if row[0] == image)
    for path in product.opened_by:
        dem = Dem.open(path)
        assert (dem.product, dem.grid.projection, dem.grid.pole) == (name, projection, pole)
        assert dem.gsd_m == pytest.approx(pixel_m, rel=1e-9)
        assert (dem.grid.width, dem.grid.height) == (product.frame.cols, product.frame.rows)
        assert dem.files[-1] == product.image
        _compare_bounds(dem, product)


def check_pixels_against_proj(archive: dict[str, Product], image: str, tmp_path: Path) -> None:
    product, grid = archive[image], Dem.open(archive[image].image).grid
    right, bottom = product.frame.cols - 1, product.frame.rows - 1
    column = np.array([-0.5, 0.0, right + 0.5, 0.0, right, right / 3.0, right / 2.0])
    row = np.array([-0.5, 0.0, bottom + 0.5, bottom, 0.0, bottom / 7.0, bottom / 2.0])
    lon, lat = product.frame.lonlat(column, row)
    got = grid.pixel(lon, lat)
    np.testing.assert_allclose(got[0], column, atol=2e-5)
    np.testing.assert_allclose(got[1], row, atol=2e-5)
    back = grid.lonlat(column, row)
    np.testing.assert_allclose(back[1], lat, atol=1e-9)
    np.testing.assert_allclose((back[0] - lon + 180.0) % 360.0, 180.0, atol=1e-6)


def check_heights_of_the_source(archive: dict[str, Product], image: str, tmp_path: Path) -> None:
    product = archive[image]
    dem = Dem.open(product.image)
    got = dem.read(0, dem.grid.height, 0, dem.grid.width).astype(np.float64)
    want = product.heights_m
    tolerance = 0.5 * product.step_m + 1e-3
    np.testing.assert_array_equal(np.isnan(got), np.isnan(want))
    assert np.nanmax(np.abs(got - want)) <= tolerance
    # the surface is steep enough to tell a pixel from its neighbours, and one corner from another
    for wrong in (want[1:], want[:, 1:]):
        there = got[: wrong.shape[0], : wrong.shape[1]]
        assert np.nanmax(np.abs(there - wrong)) > tolerance
    for wrong in (want[::-1], want[:, ::-1]):
        assert np.nanmax(np.abs(got - wrong)) > 4.0 * tolerance


def check_heights_by_longitude_and_latitude(
    archive: dict[str, Product], image: str, tmp_path: Path
) -> None:
    """A sample at the centre of a pixel lies within the range of the pixels around it (on a cylinder neighbours can be
    averaged).
    """
    product = archive[image]
    rng = np.random.default_rng(4)
    row, column = (
        rng.integers(6, product.frame.rows - 6, 40),
        rng.integers(8, product.frame.cols - 8, 40),
    )
    lon, lat = product.frame.lonlat(column, row)
    got, index = DemSet.open([product.image]).heights(lon, lat, Dem.open(product.image).gsd_m)
    assert (index == 0).all()
    for i, j, height in zip(row, column, got, strict=True):
        around = product.heights_m[i - 1 : i + 2, j - 1 : j + 2]
        low, high = np.nanmin(around) - product.step_m, np.nanmax(around) + product.step_m
        assert low <= height <= high
        if product.frame.has_pole:
            assert height == pytest.approx(product.heights_m[i, j], abs=0.5 * product.step_m + 1e-3)


def check_letter_case(archive: dict[str, Product], image: str, tmp_path: Path) -> None:
    product = archive[image]
    want = Dem.open(product.image)
    for change in (str.lower, str.upper):
        folder = tmp_path / change("case")
        folder.mkdir()
        for path in product.opened_by:
            shutil.copy(path, folder / change(path.name))
        for path in product.opened_by:
            dem = Dem.open(folder / change(path.name))
            assert dem.grid == want.grid
            assert dem.product.upper() == want.product.upper()
            np.testing.assert_array_equal(dem.read(2, 9, 3, 8), want.read(2, 9, 3, 8))


def _compare_bounds(dem: Dem, product: Product) -> None:
    lon, lat = product.frame.edges()
    box = dem.grid.bounds
    if product.frame.has_pole:
        away = 90.0 - np.abs(lat)
        assert (box.west, box.east) == (0.0, 360.0)
        assert (box.south == -90.0) if dem.grid.pole < 0 else (box.north == 90.0)
        reach = box.north + 90.0 if dem.grid.pole < 0 else 90.0 - box.south
        assert reach == pytest.approx(away.max(), abs=1e-9)
        return
    assert (box.south, box.north) == pytest.approx((lat.min(), lat.max()), abs=1e-8)
    turn = (lon - box.west + 180.0) % 360.0 - 180.0  # degrees east of the west edge
    assert turn.min() == pytest.approx(0.0, abs=1e-5)
    assert box.east - box.west == pytest.approx(turn.max(), abs=1e-5)


def test_the_pole_and_the_meridians_of_polar_products(archive: dict[str, Product]) -> None:
    """PROJ: longitude 0 runs up from the south pole and down from the north pole; 90 E is right of both."""
    for name, _, _ in POLAR:
        _check_pole(archive, name)


def _check_pole(archive: dict[str, Product], name: str) -> None:
    product, grid = archive[f"{name}.IMG"], Dem.open(archive[f"{name}.IMG"].image).grid
    forward = pyproj.Transformer.from_crs(real_heights.SPHERE, product.frame.crs, always_xy=True)
    origin = grid.pixel(12.0, 90.0 * grid.pole)
    assert forward.transform(12.0, 90.0 * grid.pole) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert origin == pytest.approx(
        (
            -product.frame.west_m / product.frame.pixel_m - 0.5,
            product.frame.north_m / product.frame.pixel_m - 0.5,
        )
    )
    for lon in (0.0, 90.0, 215.0):
        x, y = forward.transform(lon, 89.999 * grid.pole)
        column, row = grid.pixel(lon, 89.999 * grid.pole)
        assert (column - origin[0], row - origin[1]) == pytest.approx(
            (x / grid.pixel_m, -y / grid.pixel_m), abs=1e-5
        )
    assert (grid.pixel(0.0, 89.99 * grid.pole)[1] > origin[1]) == (grid.pole > 0)
