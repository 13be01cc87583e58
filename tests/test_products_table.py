"""Every product of the documentation's table, and every trap of reading them.

The products are made by ``products.py`` from the archive's label texts and real heights. The judges are PROJ (where a
pixel lies), the surface that the generator drew from (how high it is), and GDAL for its own reading.
"""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import archive_products
import numpy as np
import pyproj
import pytest
import rasterio
import real_heights
from archive_products import Product
from products import cut, geotiff, label_text

from lcp_catalog.dem import Dem
from lcp_catalog.dem_survey import survey
from lcp_catalog.demset import DemSet
from lcp_catalog.errors import DemError, LabelError
from lcp_catalog.grid import Grid
from lcp_catalog.label import Label

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


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Product]:
    found = archive_products.all_products(tmp_path_factory.mktemp("products"))
    return {product.image.name: product for product in found}


def test_the_table_is_whole(made: dict[str, Product]) -> None:
    assert sorted(made) == sorted(row[0] for row in TABLE)


@pytest.mark.parametrize("image", [row[0] for row in TABLE])
class TestEachProduct:
    def test_what_it_is(self, made: dict[str, Product], image: str) -> None:
        product = made[image]
        _, name, projection, pixel_m, pole = next(row for row in TABLE if row[0] == image)
        for path in product.opened_by:
            dem = Dem.open(path)
            assert (dem.product, dem.grid.projection, dem.grid.pole) == (name, projection, pole)
            assert dem.gsd_m == pytest.approx(pixel_m, rel=1e-9)
            assert (dem.grid.width, dem.grid.height) == (product.frame.cols, product.frame.rows)
            assert dem.files[-1] == product.image
            _compare_bounds(dem, product)

    def test_pixels_lie_where_proj_has_them(self, made: dict[str, Product], image: str) -> None:
        product, grid = made[image], Dem.open(made[image].image).grid
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

    def test_heights_are_those_of_the_source(self, made: dict[str, Product], image: str) -> None:
        product = made[image]
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

    def test_heights_by_longitude_and_latitude(self, made: dict[str, Product], image: str) -> None:
        """Any sampling at a pixel's centre stays within the pixels around it (on a cylinder neighbours may be averaged)."""
        product = made[image]
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
                assert height == pytest.approx(
                    product.heights_m[i, j], abs=0.5 * product.step_m + 1e-3
                )

    def test_letter_case_does_not_matter(
        self, made: dict[str, Product], image: str, tmp_path: Path
    ) -> None:
        product = made[image]
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


@pytest.mark.parametrize("name", [row[0] for row in POLAR])
def test_the_pole_and_the_meridians_of_polar_products(made: dict[str, Product], name: str) -> None:
    """PROJ: longitude 0 runs up from the south pole and down from the north pole; 90 E is right of both."""
    product, grid = made[f"{name}.IMG"], Dem.open(made[f"{name}.IMG"].image).grid
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


class TestTraps:
    """One test for each line of the list of what goes wrong in reading LOLA and SLDEM products."""

    def test_jp2_counts_are_half_metres_whatever_gdal_says(self, made: dict[str, Product]) -> None:
        product = made["LDEM_80S_20M.JP2"]
        with rasterio.open(product.image) as dataset:
            counts = dataset.read(1)  # a bare JP2: GDAL has no scale at all
        got = Dem.open(product.image).read(0, 60, 0, 72)
        np.testing.assert_array_equal(got, counts * 0.5)
        assert np.abs(got - product.heights_m).max() <= 0.25
        assert np.abs(counts - product.heights_m).max() > 100.0  # a scale of 1 would be seen

    def test_a_bare_jp2_is_refused(self, made: dict[str, Product], tmp_path: Path) -> None:
        image = Path(shutil.copy(made["LDEM_16.JP2"].image, tmp_path))
        with pytest.raises(
            LabelError, match=r"LDEM_16_JP2\.LBL is missing .*does not say its heights' scale"
        ):
            Dem.open(image)

    @pytest.mark.parametrize("image", ["LDEM_16.IMG", "LDEM_16.JP2", "SLDEM2015_512_00N_30N_000_045_FLOAT.IMG",
                                       "LDEM_85N_10M_FLOAT.IMG", "ldem_875s_20m_float.img"])  # fmt: skip
    def test_offset_is_no_term_of_height(self, made: dict[str, Product], image: str) -> None:
        product = made[image]
        text = product.label.read_text(encoding="latin-1") if product.label else ""
        assert "1737400." in text or "1737.4" in text
        found = survey(Dem.open(product.image)).statistics
        assert found.min_m == pytest.approx(product.heights_m.min(), abs=product.step_m)
        assert found.max_m == pytest.approx(product.heights_m.max(), abs=product.step_m)

    @pytest.mark.parametrize("said", ["", "'N/A'", '"N/A"', "N/A"])
    def test_no_missing_value_is_invented(
        self, made: dict[str, Product], tmp_path: Path, said: str
    ) -> None:
        """Silence and "N/A": neither -32768 (GDAL's guess) nor 0 (what GDAL makes of "N/A") turns into a hole."""
        label = _copy(made["LDEM_16.IMG"], tmp_path)
        if said:
            _edit(label, "    UNIT  ", f"    MISSING_CONSTANT = {said}\r\n    UNIT  ")
        samples = np.fromfile(label.with_suffix(".IMG"), "<i2")
        samples[:100] = 0
        samples.tofile(label.with_suffix(".IMG"))
        dem = Dem.open(label)
        assert survey(dem).statistics.nodata_share == 0.0
        assert (dem.read(0, 1, 0, 50) == 0.0).all()
        samples[0] = -32768
        samples.tofile(label.with_suffix(".IMG"))
        assert dem.read(0, 1, 0, 1)[0, 0] == -16384.0  # said by `lcp dem check`; no hole
        _edit(label, "    UNIT  ", "    MISSING_CONSTANT = -32768\r\n    UNIT  ")
        assert np.isnan(Dem.open(label).read(0, 1, 0, 1)[0, 0]) == (
            said == ""
        )  # a key's first value counts

    def test_no_real_number_is_invented_as_missing(
        self, made: dict[str, Product], tmp_path: Path
    ) -> None:
        label = _copy(made["NAC_DTM_APOLLO15_2.IMG"], tmp_path)
        samples = np.fromfile(label.with_suffix(".IMG"), "<f4")
        samples[5] = -3.4028227e38
        samples.tofile(label.with_suffix(".IMG"))
        with pytest.raises(DemError, match="cannot be on the Moon"):
            survey(Dem.open(label))
        _edit(label, "  BANDS ", "  CORE_NULL = 16#FF7FFFFB#\n  BANDS ")
        assert survey(Dem.open(label)).statistics.nodata_share == 1 / samples.size

    def test_a_rounded_map_scale_moves_nothing(
        self, made: dict[str, Product], tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        """0.0592 km instead of 0.0592252938: 427 parts in a million, 39 pixels at 177 degrees from the centre."""
        product = made["SLDEM2015_512_00N_30N_000_045_FLOAT.IMG"]
        label = _copy(product, tmp_path)
        label.write_text(
            cut(label.read_text(encoding="latin-1"), MAP_SCALE="0.0592"), encoding="latin-1"
        )
        with caplog.at_level(logging.WARNING):
            grid = Dem.open(label).grid
        assert grid.pixel(*product.frame.lonlat(70.0, 50.0)) == pytest.approx(
            (70.0, 50.0), abs=1e-4
        )
        assert "MAP_SCALE" in caplog.text

    def test_a_rounded_map_resolution_moves_no_polar_pixel(
        self, made: dict[str, Product], tmp_path: Path
    ) -> None:
        label = _copy(made["LDEM_80S_20M.IMG"], tmp_path)
        label.write_text(
            cut(label.read_text(encoding="latin-1"), MAP_RESOLUTION="1517"), encoding="latin-1"
        )
        assert Dem.open(label).gsd_m == 20.0

    @pytest.mark.parametrize("name", ["LDEM_80S_20M", "LDEM_80N_20M", "LDEM_875N_5M", "LDEM_64"])
    def test_gdals_half_pixel_is_ours(self, made: dict[str, Product], name: str) -> None:
        """GDAL's default puts the pole at map (0, 0); so must we, without any shift option."""
        product = made[f"{name}.IMG"]
        grid = Dem.open(product.image).grid
        with rasterio.open(product.label) as dataset:
            x, y = dataset.transform * (0.5, 0.5)
        assert (grid.x0_m, grid.y0_m) == pytest.approx((x, y), abs=0.01 * grid.pixel_m)
        if grid.pole:
            column, row = grid.pixel(77.0, 90.0 * grid.pole)
            assert ~dataset.transform * (0.0, 0.0) == pytest.approx(
                (column + 0.5, row + 0.5), abs=1e-6
            )

    def test_an_img_is_found_by_its_label_where_gdal_knows_nothing(
        self, made: dict[str, Product]
    ) -> None:
        product = made["LDEM_75N_30M.IMG"]
        with pytest.raises(rasterio.errors.RasterioIOError):
            rasterio.open(product.image)
        assert Dem.open(product.image).files == (product.label, product.image)

    @pytest.mark.parametrize("image", ["LDEM_16.IMG", "LDEM_85S_10M_FLOAT.IMG", "ldem_875s_20m_float.img",
                                       "WAC_GLD100_E300N0450_256P.IMG"])  # fmt: skip
    def test_one_byte_too_few_is_refused_at_once(
        self, made: dict[str, Product], tmp_path: Path, image: str
    ) -> None:
        """GDAL opens it; of the PDS4 product it even gives zeros for what is not there."""
        label = _copy(made[image], tmp_path)
        path = tmp_path / image
        path.write_bytes(path.read_bytes()[:-1])
        for given in (label, path):
            with pytest.raises(DemError, match="cut short; fetch it again"):
                Dem.open(given)

    def test_map_scale_without_a_unit(self, made: dict[str, Product], tmp_path: Path) -> None:
        """GDAL takes kilometres: 20 without a unit would be 20 km. MAP_RESOLUTION decides; without it nobody knows."""
        label = _copy(made["LDEM_80S_20M.IMG"], tmp_path)
        _edit(label, "20 <m/pix>", "20")
        assert Dem.open(label).gsd_m == 20.0
        _edit(label, " MAP_RESOLUTION ", " NO_RESOLUTION ")
        with pytest.raises(LabelError, match="metres or kilometres"):
            Dem.open(label)

    def test_crs_equality_says_nothing(self, tmp_path: Path) -> None:
        """Three ways to write one CRS: unequal to pyproj, one grid to us; tiles written in two of them join."""
        texts = ["IAU_2015:30135", "+proj=stere +lat_0=-90 +R=1737400", _esri_south()]
        crs = [pyproj.CRS(text) for text in texts]
        assert crs[0] != crs[1] != crs[2]
        grids = [Grid.from_wkt(one.to_wkt(), (20.0, 0, -400, 0, -20.0, 400), 40, 40) for one in crs]
        assert grids[0] == grids[1] == grids[2]
        values = np.zeros((4, 4), np.float32)
        west = Dem.open(geotiff(tmp_path / "w.tif", values, 0.0, 80.0, 20.0, crs=texts[0]))
        east = Dem.open(geotiff(tmp_path / "e.tif", values, 80.0, 80.0, 20.0, crs=texts[2]))
        assert west.grid.same_lattice(east.grid) == (4, 0)

    def test_an_authoritys_code_does_not_excuse_another_radius(self) -> None:
        """A code of the Moon on a sphere of 1738 km: the numbers count."""
        wkt = pyproj.CRS("IAU_2015:30110").to_wkt().replace("1737400", "1738000")
        assert "30110" in wkt
        with pytest.raises(LabelError, match="1738000"):
            Grid.from_wkt(wkt, (20.0, 0, 0, 0, -20.0, 0), 4, 4)

    @pytest.mark.parametrize("code", [30100, 30110, 30115, *range(30120, 30195, 5)])
    def test_iau_codes_resolve_offline(self, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
        """Cylinders and poles are taken, the others refused in one line; nothing is fetched."""
        monkeypatch.setenv("PROJ_NETWORK", "OFF")
        pyproj.network.set_network_enabled(False)
        wkt = pyproj.CRS(f"IAU_2015:{code}").to_wkt()
        affine = (0.01, 0, 10, 0, -0.01, 20) if code == 30100 else (20.0, 0, -40, 0, -20.0, 40)
        if code in (30100, 30110, 30115, 30130, 30135):
            assert Grid.from_wkt(wkt, affine, 4, 4).pole == {30130: 1, 30135: -1}.get(code, 0)
        else:
            with pytest.raises(LabelError, match="is not supported"):
                Grid.from_wkt(wkt, affine, 4, 4)

    def test_a_tif_beside_another_label_is_refused(
        self, made: dict[str, Product], tmp_path: Path
    ) -> None:
        label = _copy(made["NAC_DTM_APOLLO15.TIF"], tmp_path)
        label.write_text(cut(label.read_text(encoding="latin-1"), LINES=61), encoding="latin-1")
        with pytest.raises(
            DemError, match=r"60 x 72 pixels where its label NAC_DTM_APOLLO15\.LBL says 61 x 72"
        ):
            Dem.open(label)

    def test_an_img_with_the_label_of_a_tif_is_refused(
        self, made: dict[str, Product], tmp_path: Path
    ) -> None:
        label = _copy(made["NAC_DTM_APOLLO15.TIF"], tmp_path)
        label.with_suffix(".IMG").write_bytes(bytes(400_000))
        with pytest.raises(DemError, match=r"describes NAC_DTM_APOLLO15\.TIF"):
            Dem.open(label.with_suffix(".IMG"))


@pytest.mark.parametrize(
    "crs",
    [
        "IAU_2015:30135",
        "+proj=stere +lat_0=-90 +lat_ts=-90 +R=1737400 +units=m",
        'PROJCS["Moon_South_Pole",GEOGCS["Moon 2000",DATUM["D_Moon_2000",SPHEROID["Moon_2000_IAU_IAG",1737400,0]],'
        'PRIMEM["Greenwich",0],UNIT["Decimal_Degree",0.0174532925199433]],PROJECTION["Polar_Stereographic"],'
        'PARAMETER["latitude_of_origin",-90],PARAMETER["central_meridian",0],UNIT["metre",1]]',
        "esri",
    ],
)
@pytest.mark.parametrize("point", [False, True])
def test_polar_geotiffs_however_they_write_their_crs(tmp_path: Path, crs: str, point: bool) -> None:
    """Also with AREA_OR_POINT=Point, where the file's tie point is the centre of a pixel."""
    path = tmp_path / "p.tif"
    crs = _esri_south() if crs == "esri" else crs
    geotiff(path, np.zeros((20, 20), np.float32), -100.0, 100.0, 10.0, crs=crs)
    if point:
        with rasterio.open(path, "r+") as dataset:
            dataset.update_tags(AREA_OR_POINT="Point")
        with rasterio.open(path) as dataset:
            assert dataset.tags()["AREA_OR_POINT"] == "Point"
    grid = Dem.open(path).grid
    assert (grid.projection, grid.pole, grid.true_lat_deg) == ("polar-stereographic", -1, -90.0)
    assert grid.pixel(0.0, -90.0) == pytest.approx((9.5, 9.5))


def _esri_south() -> str:
    return (
        'PROJCS["Moon_2000_South_Pole_Stereographic",GEOGCS["GCS_Moon_2000",DATUM["D_Moon_2000",'
        'SPHEROID["Moon_2000_IAU_IAG",1737400.0,0.0]],PRIMEM["Reference_Meridian",0.0],UNIT["Degree",0.0174532925199433]],'
        'PROJECTION["Stereographic_South_Pole"],PARAMETER["False_Easting",0.0],PARAMETER["False_Northing",0.0],'
        'PARAMETER["Central_Meridian",0.0],PARAMETER["Standard_Parallel_1",-90.0],UNIT["Meter",1.0]]'
    )


def _copy(product: Product, folder: Path) -> Path:
    """The product's files in another folder; the label's path, or the image's where the label is in front."""
    copies = [Path(shutil.copy(path, folder)) for path in product.opened_by]
    return copies[0]


def _edit(path: Path, old: str, new: str) -> None:
    text = path.read_bytes().decode("latin-1")
    assert old in text
    path.write_bytes(text.replace(old, new, 1).encode("latin-1"))


def test_pds4_agrees_with_gdal(made: dict[str, Product]) -> None:
    """GDAL's PDS4 driver: the same map and, kilometres taken for metres, the same heights."""
    product = made["ldem_875s_20m_float.img"]
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
        (">Positive East<", ">Positive West<", "grow to the west"),
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
    made: dict[str, Product], tmp_path: Path, old: str, new: str, says: str
) -> None:
    label = _copy(made["ldem_875s_20m_float.img"], tmp_path)
    _edit(label, old, new)
    with pytest.raises(LabelError, match=says) as caught:
        Dem.open(label)
    assert str(caught.value).startswith(f"{label}: ")
    assert "\n" not in str(caught.value)


def test_pds4_missing_constants(made: dict[str, Product], tmp_path: Path) -> None:
    label = _copy(made["ldem_875s_20m_float.img"], tmp_path)
    _edit(label, "</Element_Array>", "</Element_Array><Special_Constants><missing_constant>-99</missing_constant>"
          "</Special_Constants>")  # fmt: skip
    samples = np.fromfile(label.with_suffix(".img"), "<f4")
    samples[3] = -99.0
    samples.tofile(label.with_suffix(".img"))
    assert np.isnan(Dem.open(label).read(0, 1, 0, 5)).tolist() == [
        [False, False, False, True, False]
    ]


class TestScaleWithoutUnit:
    """SCALING_FACTOR without UNIT: the sphere's radius in OFFSET shows the unit, else the label is refused."""

    def test_the_radius_shows_it(self) -> None:
        for name, scale in (("LDEM_16", 0.5), ("SLDEM2015_512_00N_30N_000_045_FLOAT", 1000.0)):
            text = label_text(name).replace("    UNIT  ", "    NO_UNIT  ")
            assert Label.from_text(text, Path("X.LBL")).height_scale_m == scale

    @pytest.mark.parametrize("name", ["LDEM_16", "SLDEM2015_512_00N_30N_000_045_FLOAT"])
    def test_nothing_shows_it(self, name: str) -> None:
        text = (
            label_text(name)
            .replace("    UNIT  ", "    NO_UNIT  ")
            .replace("    OFFSET  ", "    NO_OFFSET  ")
        )
        with pytest.raises(LabelError, match="SCALING_FACTOR has no UNIT"):
            Label.from_text(text, Path("X.LBL"))

    def test_whole_unscaled_numbers_are_metres(self) -> None:
        text = cut(
            label_text("WAC_GLD100_E000N1800_016P_attached"),
            BANDS="1\r\n SCALING_FACTOR = 1.0\r\n OFFSET = 0.0",
        )
        assert Label.from_text(text, Path("X.LBL")).height_scale_m == 1.0

    def test_a_jp2_does_not_take_the_scale_of_real_numbers(self, ldem_4: Path) -> None:
        """Kilometres of an uncompressed float image are not those of a JP2's counts."""
        text = (ldem_4 / "LDEM_4_JP2.LBL").read_text(encoding="latin-1")
        head, _, tail = text.partition("OBJECT                    = UNCOMPRESSED_FILE")
        for key in ("UNIT", "SCALING_FACTOR", "OFFSET"):
            head = head.replace(f"  {key} ", f"  NO_{key} ")
        tail = cut(tail, SAMPLE_TYPE="PC_REAL", UNIT="KILOMETER", SCALING_FACTOR=1, OFFSET=1737.4)
        whole = f"{head}OBJECT = UNCOMPRESSED_FILE{tail}"
        assert Label.from_text(whole, Path("X.LBL")).height_scale_m == 0.5
