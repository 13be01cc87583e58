"""Sets of DEM products: resampling against GDAL and known surfaces, and the joining of products."""

from __future__ import annotations

import hashlib
import os
import pickle
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from helpers.products import (
    DEGREE_M,
    EQC,
    cut,
    cylinder,
    geotiff,
    hills,
    label_text,
    ldem_80s,
    sldem_512,
)
from rasterio.enums import Resampling
from rasterio.transform import from_origin
from rasterio.warp import reproject

from lcp_catalog.dem import tiles
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.raster import Raster
from lcp_catalog.errors import AreaError, DemError


def _sparse_tile(folder: Path, west: int, north: int) -> Path:
    """The label of a whole tile of 45 x 30 degrees with an image that takes no room on the disc."""
    name = f"SLDEM2015_512_{north:02d}N_{west:03d}_FLOAT"
    text = cut(
        label_text("SLDEM2015_512_00N_30N_000_045_FLOAT"),
        PRODUCT_ID=f'"{name}"',
        FILE_NAME=f'"{name}.IMG"',
        POINTER_IMAGE=f'"{name}.IMG"',
        MAXIMUM_LATITUDE=north,
        MINIMUM_LATITUDE=north - 30,
        WESTERNMOST_LONGITUDE=west,
        EASTERNMOST_LONGITUDE=west + 45,
        LINE_PROJECTION_OFFSET=north * 512 - 0.5,
        SAMPLE_PROJECTION_OFFSET=(180 - west) * 512 - 0.5,
    )
    image = folder / f"{name}.IMG"
    image.touch()
    os.truncate(image, 23040 * 15360 * 4)
    label = folder / f"{name}.LBL"
    label.write_text(text, encoding="latin-1", newline="")
    return label


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
        """A linear surface seen in blocks: a mean by cos(latitude) lies where the block's surface
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
        got = dems.layers[0]._window(0, 2, 3, 3, 4, 40)[0, 0]
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
        monkeypatch.setattr(tiles, "_WINDOW_PIXELS", 900)
        for before, gsd in zip(whole, (3e4, 1.2e5), strict=True):
            np.testing.assert_array_equal(dems.heights(lon, lat, gsd)[0], before)


class TestSets:
    def test_of_equal_pixels_the_first_given_answers(self, tmp_path: Path) -> None:
        """Heights that it lacks come from the next product."""
        first = np.full((200, 200), 1.0, np.float32)
        first[50:100, 50:100] = np.nan
        a = geotiff(tmp_path / "a.tif", first, 0.0, 20000.0, 100.0)
        b = geotiff(tmp_path / "b.tif", np.full((400, 400), 2.0, np.float32), 0.0, 40000.0, 100.0)
        dems = DemSet.open([a, b])
        grid = dems.dems[0].grid
        lon, lat = grid.lonlat(np.array([20.0, 75, 300, 500]), np.array([20.0, 75, 20, 20]))
        height, index = dems.heights(lon, lat, 100.0)
        np.testing.assert_array_equal(index, [0, 1, 1, -1])
        np.testing.assert_allclose(height, [1.0, 2.0, 2.0, np.nan], atol=1e-12)
        assert dems.products == ("a", "b")
        turned = DemSet.open([b, a])
        assert turned.heights(lon, lat, 100.0)[1].tolist() == [0, 0, 0, -1]
        assert turned.product_at(lon, lat).tolist() == [0, 0, 0, -1]
        assert dems.product_at(lon, lat).tolist() == [0, 0, 1, -1]  # a hole is none to geometry
        assert dems.candidates_at(lon, lat).tolist() == [[1, 1, 0, 0], [1, 1, 1, 0]]

    def test_a_finer_pixel_comes_first_and_the_method_s_product_before_it(
        self, tmp_path: Path
    ) -> None:
        """Constants 1..4 m: LDEM_512 (1), a finer unknown one (2), SLDEM2015 (3), a coarse unknown one (4), all everywhere."""
        paths = [
            cylinder(tmp_path / f"{name}.tif", -180.0, 90.0, (180 * n, 360 * n), n, surface)
            for name, n, surface in (
                ("LDEM_512", 2, lambda lon, lat: 0.0 * lon + 1.0),
                ("fine", 4, lambda lon, lat: 0.0 * lon + 2.0),
                ("SLDEM2015_512", 2, lambda lon, lat: 0.0 * lon + 3.0),
                ("coarse", 1, lambda lon, lat: 0.0 * lon + 4.0),
            )
        ]
        lat = np.array([-85.0, -70.0, -58.0, 0.0, 58.0, 70.0, 85.0])

        def heights(*numbers: int, order: tuple[str, ...] = ()) -> list[float]:
            dems = DemSet.open([paths[i] for i in numbers], order)
            height, index = dems.heights(10.0, lat, 1e3)
            assert index.tolist() == dems.product_at(10.0, lat).tolist()
            return [round(h, 9) for h in height.tolist()]

        assert heights(0, 1, 2, 3) == [2, 1, 3, 3, 3, 1, 2]
        assert heights(3, 2, 1, 0) == [2, 1, 3, 3, 3, 1, 2]  # as given decides ties only
        assert heights(3, 1) == [2] * 7
        assert heights(3, 2, 1, 0, order=("coarse",)) == [4] * 7
        assert heights(0, 1, 2, 3, order=("fine.tif",)) == [2] * 7
        assert heights(0, 1, 2, order=("sldem2015",)) == [3] * 7  # a family
        with pytest.raises(DemError, match=r"no DEM matches GLD100; products given: fine, coarse"):
            heights(1, 3, order=("coarse", "GLD100"))

    def test_west_of_a_polar_map_there_is_nothing(self, tmp_path: Path) -> None:
        """Columns below the first are outside, like those beyond the last."""
        dems = DemSet.open([ldem_80s(tmp_path, 60)])
        lon, lat = dems.dems[0].grid.lonlat(
            np.array([-0.4, -0.6, -30.0, 59.4, 59.6]), np.full(5, 30.0)
        )
        assert np.isnan(dems.heights(lon, lat, 20.0)[0]).tolist() == [
            False,
            True,
            True,
            False,
            True,
        ]
        assert dems.candidates_at(lon, lat)[0].tolist() == [True, False, False, True, False]

    def test_who_answers_is_geometry_alone(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Against footprints by hand: boxes of longitude and latitude, and Snyder's rho for the polar map; no pixel is read."""
        tile, polar = sldem_512(tmp_path, 350, -80, 512, 512), ldem_80s(tmp_path, 400)
        wide = cylinder(tmp_path / "LDEM_512.tif", -180.0, 90.0, (180, 360), 1.0)
        dems = DemSet.open([tile, wide, polar])
        monkeypatch.setattr(Raster, "read", lambda *_: pytest.fail("a pixel was read"))
        rng = np.random.default_rng(7)
        lon, lat = rng.uniform(-15.0, 5.0, 3000), rng.uniform(-90.0, -70.0, 3000)
        lat[:1000] = rng.uniform(-90.0, -89.7, 1000)
        lon[1000:2000] = rng.uniform(-11.0, -8.0, 1000)
        lat[1000:2000] = rng.uniform(-82.0, -79.0, 1000)
        rho = 2.0 * 1_737_400.0 * np.tan(np.radians(90.0 + lat) / 2.0)
        x, y = rho * np.sin(np.radians(lon)), rho * np.cos(np.radians(lon))
        inside = np.array(
            [
                (lon >= -10.0) & (lon <= -9.0) & (lat <= -80.0) & (lat >= -81.0),
                np.ones(3000, bool),
                (np.abs(x) <= 4e3) & (np.abs(y) <= 4e3),
            ]
        )
        np.testing.assert_array_equal(dems.candidates_at(lon, lat), inside)
        assert inside.sum(axis=1).min() > 20
        want = np.where(
            inside[2], 2, np.where(inside[0], 0, 1)
        )  # by the pixel: 20, 59 and 30 323 m
        np.testing.assert_array_equal(dems.product_at(lon, lat), want)

    def test_forty_gigabytes_are_opened_without_reading_them(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """All 32 tiles of SLDEM2015_512 (sparse): only the window of the requested area is read."""
        paths = [_sparse_tile(tmp_path, west, north) for west in range(0, 360, 45) for north in (60, 30, 0, -30)]  # fmt: skip
        assert sum(path.with_suffix(".IMG").stat().st_size for path in paths) > 40e9
        read: list[int] = []
        original = Raster.read

        def counted(raster: Raster, row0: int, row1: int, col0: int, col1: int) -> np.ndarray:
            read.append((row1 - row0) * (col1 - col0) * 4)
            return original(raster, row0, row1, col0, col1)

        monkeypatch.setattr(Raster, "read", counted)
        tracemalloc.start()
        dems = DemSet.open(paths)
        assert read == []
        lon, lat = np.meshgrid(45.0 + np.linspace(-0.05, 0.05, 60), np.linspace(-0.05, 0.05, 60))
        height, index = dems.heights(lon, lat, 59.0)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert (height == 0.0).all()
        assert len(set(index.ravel())) == 4  # over the corner where four tiles meet
        window = (0.1 * 512 + 4) ** 2 * 4
        assert sum(read) < 12 * window
        assert peak < 8e6

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
        two = DemSet((*dems.dems, Dem.open(ldem_4 / "LDEM_4.JP2")))
        assert two.heights(np.empty(0), np.empty(0), 7580.0)[0].shape == (0,)
        np.testing.assert_array_equal(
            two.heights([np.nan, 0.0, 0.0], [0.0, np.nan, 90.5], 7580.0)[1], index
        )
        assert two.product_at([np.nan, 0.0], [0.0, np.nan]).tolist() == [-1, -1]
        assert np.isnan(height).all()
        assert (index == -1).all()

    def test_none_given(self) -> None:
        with pytest.raises(DemError, match="no DEM"):
            DemSet(())
