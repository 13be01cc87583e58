"""Sets of DEM products: resampling against GDAL's and surfaces with known answers, and how products join."""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path

import numpy as np
import pytest
from products import (
    DEGREE_M,
    EQC,
    cylinder,
    geotiff,
    hills,
    ldem_80s,
    sldem_512,
)
from rasterio.enums import Resampling
from rasterio.transform import from_origin
from rasterio.warp import reproject

from lcp_catalog import demset as demset_module
from lcp_catalog.dem import Dem
from lcp_catalog.demset import DemSet
from lcp_catalog.errors import AreaError, DemError


class TestResampling:
    def test_a_quadratic_is_exact(self, tmp_path: Path) -> None:
        """Keys' cubic convolution with a = -0.5 is of third order."""
        rows, cols = np.mgrid[0:40, 0:50].astype(np.float64)
        heights = 3.0 * rows**2 - 2.0 * cols**2 + rows * cols + 5.0
        dems = DemSet.open([geotiff(tmp_path / "q.tif", heights, 0.0, 4000.0, 100.0)])
        u, v = np.random.default_rng(1).uniform(2.0, 36.0, (2, 500))
        lon, lat = dems.dems[0].grid.lonlat(u, v)
        want = 3.0 * v**2 - 2.0 * u**2 + u * v + 5.0
        np.testing.assert_allclose(
            dems.heights(lon, lat, 100.0)[0], want, atol=1e-3
        )  # float32 pixels of up to 7 km

    def test_agrees_with_gdals_cubic(self, tmp_path: Path) -> None:
        """GDAL's `cubic` is the same convolution when neither side is coarser: grids of one cell,
        shifted by 0.3 pixels.
        """
        source = np.random.default_rng(2).normal(0.0, 300.0, (60, 70)).astype(np.float32)
        dems = DemSet.open([geotiff(tmp_path / "s.tif", source, 0.0, 6000.0, 100.0)])
        want = np.zeros((40, 50), np.float32)
        where = from_origin(830.0, 5170.0, 100.0, 100.0)
        reproject(
            source, want, src_transform=from_origin(0.0, 6000.0, 100.0, 100.0), src_crs=EQC,
            dst_transform=where, dst_crs=EQC,
            resampling=Resampling.cubic,
        )  # fmt: skip
        x, y = 830.0 + (np.arange(50) + 0.5) * 100.0, 5170.0 - (np.arange(40) + 0.5) * 100.0
        lon, lat = np.meshgrid(x / DEGREE_M, y / DEGREE_M)
        np.testing.assert_allclose(dems.heights(lon, lat, 100.0)[0], want, atol=2e-3)

    def test_nodata_is_not_smeared(self, tmp_path: Path) -> None:
        heights = np.full((20, 20), 100.0, np.float32)
        heights[10, 10] = -32768.0
        dems = DemSet.open(
            [geotiff(tmp_path / "n.tif", heights, 0.0, 2000.0, 100.0, nodata=-32768.0)]
        )
        u, v = np.meshgrid(np.linspace(7.0, 13.0, 61), np.linspace(7.0, 13.0, 61))
        got, index = dems.heights(*dems.dems[0].grid.lonlat(u, v), 100.0)
        hole = (np.abs(u - 10.0) < 0.4999) & (np.abs(v - 10.0) < 0.4999)
        assert np.isnan(got[hole]).all()
        assert (index[hole] == -1).all()
        beside = (np.abs(u - 10.0) > 0.5001) | (np.abs(v - 10.0) > 0.5001)
        np.testing.assert_allclose(got[beside], 100.0, atol=1e-9)

    def test_the_whole_of_the_outermost_pixels_counts(self, tmp_path: Path) -> None:
        dems = DemSet.open(
            [geotiff(tmp_path / "e.tif", np.full((5, 6), 7.0, np.float32), 1e6, 500.0, 100.0)]
        )
        u, v = np.meshgrid([-0.5, 0.0, 2.5, 5.5], [-0.5, 2.2, 4.5])
        np.testing.assert_allclose(dems.heights(*dems.dems[0].grid.lonlat(u, v), 100.0)[0], 7.0)
        outside = dems.dems[0].grid.lonlat(
            np.array([-0.51, 5.51, 2.0, 2.0]), np.array([2.0, 2.0, -0.51, 4.51])
        )
        assert np.isnan(dems.heights(*outside, 100.0)[0]).all()

    def test_block_means_are_true_to_area(self, tmp_path: Path) -> None:
        """A linear surface seen in blocks: a mean by cos(latitude) sits where the block's ground
        has its centre.
        """
        dems = DemSet.open(
            [
                cylinder(
                    tmp_path / "b.tif",
                    0.0,
                    84.0,
                    (400, 300),
                    100.0,
                    surface=lambda lon, lat: lat * 100.0,
                )
            ]
        )
        dem = dems.dems[0]
        assert dem.factor(1.4 * dem.gsd_m) == 1
        assert dem.factor(1.5 * dem.gsd_m) == 2
        assert dem.factor(40.2 * dem.gsd_m) == 40
        lat_edges = 84.0 - np.array([2, 3]) * 0.4  # the block of rows 80..119
        lat = np.radians(lat_edges[1] + (np.arange(4000) + 0.5) * 0.4 / 4000)
        want = np.average(np.degrees(lat) * 100.0, weights=np.cos(lat))
        got = dems._window(0, 2, 3, 3, 4, 40)[0, 0]
        assert got == pytest.approx(want, abs=0.02)
        assert abs(got - lat_edges.mean() * 100.0) > 0.1  # the plain mean is not the area's

    def test_coarse_cells_do_not_alias(self, tmp_path: Path) -> None:
        """One-pixel noise of 100 m is 100 / 16 m in means of 16 x 16, and 100 m when single pixels
        are picked.
        """
        noise = np.random.default_rng(3).normal(0.0, 100.0, (640, 640)).astype(np.float32)
        dems = DemSet.open([geotiff(tmp_path / "n.tif", noise, 0.0, 64_000.0, 100.0)])
        lon, lat = np.meshgrid(np.linspace(0.3, 1.8, 30), np.linspace(0.3, 1.8, 30))
        assert 3.0 < dems.heights(lon, lat, 1600.0)[0].std() < 8.0
        assert dems.heights(lon, lat, 100.0)[0].std() > 60.0

    def test_around_the_moon_blocks_divide_the_columns(self, ldem_4: Path) -> None:
        dem = Dem.open(ldem_4 / "LDEM_4.IMG")
        assert dem.factor(7.0 * dem.gsd_m) == 6  # 1440 = 6 * 240; 7 does not divide it
        assert dem.factor(16.0 * dem.gsd_m) == 16

    def test_large_windows_are_read_in_parts(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        dems = DemSet.open([cylinder(tmp_path / "g.tif", 0.0, 90.0, (180, 360), 1.0)])
        lon, lat = np.meshgrid(np.linspace(-180.0, 180.0, 50), np.linspace(-90.0, 90.0, 40))
        whole = [dems.heights(lon, lat, gsd)[0] for gsd in (3e4, 1.2e5)]
        monkeypatch.setattr(demset_module, "_WINDOW_PIXELS", 900)
        for before, gsd in zip(whole, (3e4, 1.2e5), strict=True):
            np.testing.assert_array_equal(dems.heights(lon, lat, gsd)[0], before)


class TestSets:
    def test_the_first_with_a_height_wins(self, tmp_path: Path) -> None:
        first = np.full((20, 20), 1.0, np.float32)
        first[5:10, 5:10] = np.nan
        a = geotiff(tmp_path / "a.tif", first, 0.0, 2000.0, 100.0)
        b = geotiff(tmp_path / "b.tif", np.full((40, 40), 2.0, np.float32), 0.0, 4000.0, 100.0)
        dems = DemSet.open([a, b])
        grid = dems.dems[0].grid
        lon, lat = grid.lonlat(np.array([2.0, 7.0, 30.0, 50.0]), np.array([2.0, 7.0, 2.0, 2.0]))
        height, index = dems.heights(lon, lat, 100.0)
        np.testing.assert_array_equal(index, [0, 1, 1, -1])
        np.testing.assert_array_equal(height, [1.0, 2.0, 2.0, np.nan])
        assert dems.products == ("a", "b")
        assert DemSet.open([b, a]).heights(lon, lat, 100.0)[1].tolist() == [0, 0, 0, -1]

    def test_tiles_of_one_product_join_without_a_seam(self, tmp_path: Path) -> None:
        """Cubic convolution across the edge of a tile takes the next tile's pixels: as if there
        were one file.
        """
        west, east = sldem_512(tmp_path, 9, 20, 512, 40), sldem_512(tmp_path, 10, 20, 64, 40)
        lon, lat = np.meshgrid(
            10.0 + np.linspace(-4.0, 4.0, 33) / 512, np.linspace(19.95, 19.98, 7)
        )
        joined, index = DemSet.open([west, east]).heights(lon, lat, 59.0)
        assert set(index.ravel()) == {0, 1}
        np.testing.assert_allclose(joined, hills(lon, lat), atol=2e-3)
        alone, _ = DemSet.open([west]).heights(lon, lat, 59.0)
        assert np.nanmax(np.abs(alone - hills(lon, lat))) > 0.02  # what a seam would look like

    def test_tiles_join_across_the_prime_meridian(self, tmp_path: Path) -> None:
        left, right = sldem_512(tmp_path, 359, 20, 512, 40), sldem_512(tmp_path, 0, 20, 64, 40)
        dems = DemSet.open([left, right])
        lon, lat = np.meshgrid(np.linspace(-4.0, 4.0, 33) / 512, np.linspace(19.95, 19.98, 7))
        np.testing.assert_allclose(dems.heights(lon, lat, 59.0)[0], hills(lon, lat), atol=2e-3)
        assert dems.bounds.east - dems.bounds.west == pytest.approx(1.125)

    def test_native_cell_is_the_products_that_has_ground(self, tmp_path: Path) -> None:
        polar, tile = ldem_80s(tmp_path, 60), sldem_512(tmp_path, 10, 20, 64, 40)
        dems = DemSet.open([polar, tile])
        assert dems.native_gsd_m(0.0, -90.0) == 20.0
        assert dems.native_gsd_m(10.05, 19.95) == pytest.approx(59.2252938)
        with pytest.raises(AreaError, match="the DEM covers longitude"):
            dems.native_gsd_m(100.0, 0.0)

    def test_sources(self, ldem_4: Path) -> None:
        sources = DemSet.open([ldem_4 / "LDEM_4.IMG"]).sources()
        assert [s["name"] for s in sources] == ["LDEM_4.LBL", "LDEM_4.IMG"]
        assert sources[1]["size"] == 2_073_600
        assert (
            sources[1]["sha256"] == hashlib.sha256((ldem_4 / "LDEM_4.IMG").read_bytes()).hexdigest()
        )

    def test_travels_between_processes(self, ldem_4: Path) -> None:
        dems = DemSet.open([ldem_4 / "LDEM_4.JP2"])
        before = dems.heights(3.0, 4.0, 7580.0)[0]
        again = pickle.loads(pickle.dumps(dems))
        assert again == dems
        assert again.heights(3.0, 4.0, 7580.0)[0] == before

    def test_no_places_and_impossible_places(self, ldem_4: Path) -> None:
        dems = DemSet.open([ldem_4 / "LDEM_4.IMG"])
        assert dems.heights(np.empty(0), np.empty(0), 7580.0)[0].shape == (0,)
        height, index = dems.heights([np.nan, 0.0, 0.0], [0.0, np.nan, 90.5], 7580.0)
        assert np.isnan(height).all()
        assert (index == -1).all()

    def test_none_given(self) -> None:
        with pytest.raises(DemError, match="no DEM"):
            DemSet(())
