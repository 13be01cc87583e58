"""Every trap of reading LOLA and SLDEM products, and GLD100 and NAC beside them.

The products are made by ``archive_products`` from the archive's label texts and real heights; GDAL and PROJ judge.
"""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

import numpy as np
import pyproj
import pytest
import rasterio
from helpers.archive_files import Product
from helpers.damaged import substitute
from helpers.products import cut, geotiff, label_text

from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.grid import Grid
from lcp_catalog.dem.pixel_statistics import height_statistics
from lcp_catalog.errors import DemError, LabelError
from lcp_catalog.pds.pds3 import parse_pds3


class TestTraps:
    """One test for each known error in reading LOLA and SLDEM products."""

    def test_jp2_counts_are_half_metres_whatever_gdal_says(
        self, archive: dict[str, Product]
    ) -> None:
        product = archive["LDEM_80S_20M.JP2"]
        with rasterio.open(product.image) as dataset:
            counts = dataset.read(1)  # a bare JP2: GDAL has no scale at all
        got = Dem.open(product.image).read(0, 60, 0, 72)
        np.testing.assert_array_equal(got, counts * 0.5)
        assert np.abs(got - product.heights_m).max() <= 0.25
        assert np.abs(counts - product.heights_m).max() > 100.0  # a scale of 1 would be seen

    def test_a_bare_jp2_is_refused(self, archive: dict[str, Product], tmp_path: Path) -> None:
        image = Path(shutil.copy(archive["LDEM_16.JP2"].image, tmp_path))
        with pytest.raises(
            LabelError,
            match=r"LDEM_16_JP2\.LBL is missing .*does not state the scale of its heights",
        ):
            Dem.open(image)

    @pytest.mark.parametrize("image", ["LDEM_16.IMG", "LDEM_16.JP2", "SLDEM2015_512_00N_30N_000_045_FLOAT.IMG",
                                       "LDEM_85N_10M_FLOAT.IMG", "ldem_875s_20m_float.img"])  # fmt: skip
    def test_offset_is_no_term_of_height(self, archive: dict[str, Product], image: str) -> None:
        product = archive[image]
        text = product.label.read_text(encoding="latin-1") if product.label else ""
        assert "1737400." in text or "1737.4" in text
        found = height_statistics(Dem.open(product.image))
        assert found.min_m == pytest.approx(product.heights_m.min(), abs=product.step_m)
        assert found.max_m == pytest.approx(product.heights_m.max(), abs=product.step_m)

    @pytest.mark.parametrize("said", ["", "'N/A'", '"N/A"', "N/A"])
    def test_no_missing_value_is_invented(
        self, archive: dict[str, Product], tmp_path: Path, said: str
    ) -> None:
        """No statement and "N/A": neither -32768 (GDAL's default) nor 0 (GDAL's reading of "N/A") is missing."""
        label = archive["LDEM_16.IMG"].copied_to(tmp_path)
        if said:
            substitute(label, "    UNIT  ", f"    MISSING_CONSTANT = {said}\r\n    UNIT  ")
        samples = np.fromfile(label.with_suffix(".IMG"), "<i2")
        samples[:100] = 0
        samples.tofile(label.with_suffix(".IMG"))
        dem = Dem.open(label)
        assert height_statistics(dem).nodata_share == 0.0
        assert (dem.read(0, 1, 0, 50) == 0.0).all()
        samples[0] = -32768
        samples.tofile(label.with_suffix(".IMG"))
        with pytest.raises(DemError, match="-16384 m cannot be on the Moon"):  # no hole
            dem.read(0, 1, 0, 1)
        substitute(label, "    UNIT  ", "    MISSING_CONSTANT = -32768\r\n    UNIT  ")
        stated = Dem.open(label)
        if said:  # a key's first value counts
            with pytest.raises(DemError, match="cannot be on the Moon"):
                stated.read(0, 1, 0, 1)
        else:
            assert np.isnan(stated.read(0, 1, 0, 1)[0, 0])

    def test_no_real_number_is_invented_as_missing(
        self, archive: dict[str, Product], tmp_path: Path
    ) -> None:
        label = archive["NAC_DTM_APOLLO15_2.IMG"].copied_to(tmp_path)
        samples = np.fromfile(label.with_suffix(".IMG"), "<f4")
        samples[5] = -3.4028227e38
        samples.tofile(label.with_suffix(".IMG"))
        with pytest.raises(DemError, match="cannot be on the Moon"):
            height_statistics(Dem.open(label))
        substitute(label, "  BANDS ", "  CORE_NULL = 16#FF7FFFFB#\n  BANDS ")
        assert height_statistics(Dem.open(label)).nodata_share == 1 / samples.size

    def test_a_rounded_map_scale_moves_nothing(
        self, archive: dict[str, Product], tmp_path: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        """0.0592 km instead of 0.0592252938: 427 parts in a million, 39 pixels at 177 degrees from the centre."""
        product = archive["SLDEM2015_512_00N_30N_000_045_FLOAT.IMG"]
        label = product.copied_to(tmp_path)
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
        self, archive: dict[str, Product], tmp_path: Path
    ) -> None:
        label = archive["LDEM_80S_20M.IMG"].copied_to(tmp_path)
        label.write_text(
            cut(label.read_text(encoding="latin-1"), MAP_RESOLUTION="1517"), encoding="latin-1"
        )
        assert Dem.open(label).gsd_m == 20.0

    @pytest.mark.parametrize("name", ["LDEM_80S_20M", "LDEM_80N_20M", "LDEM_875N_5M", "LDEM_64"])
    def test_gdals_half_pixel_is_ours(self, archive: dict[str, Product], name: str) -> None:
        """GDAL's default puts the pole at map (0, 0); so must we, without any shift option."""
        product = archive[f"{name}.IMG"]
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
        self, archive: dict[str, Product]
    ) -> None:
        product = archive["LDEM_75N_30M.IMG"]
        with pytest.raises(rasterio.errors.RasterioIOError):
            rasterio.open(product.image)
        assert Dem.open(product.image).files == (product.label, product.image)

    @pytest.mark.parametrize("image", ["LDEM_16.IMG", "LDEM_85S_10M_FLOAT.IMG", "ldem_875s_20m_float.img",
                                       "WAC_GLD100_E300N0450_256P.IMG"])  # fmt: skip
    def test_one_byte_too_few_is_refused_at_once(
        self, archive: dict[str, Product], tmp_path: Path, image: str
    ) -> None:
        """GDAL opens it; for the missing end of the PDS4 product it gives zeros."""
        label = archive[image].copied_to(tmp_path)
        path = tmp_path / image
        path.write_bytes(path.read_bytes()[:-1])
        for given in (label, path):
            with pytest.raises(DemError, match="cut short; fetch it again"):
                Dem.open(given)

    def test_map_scale_without_a_unit(self, archive: dict[str, Product], tmp_path: Path) -> None:
        """GDAL assumes kilometres: 20 without a unit would be 20 km. MAP_RESOLUTION decides; without it the label is refused."""
        label = archive["LDEM_80S_20M.IMG"].copied_to(tmp_path)
        substitute(label, "20 <m/pix>", "20")
        assert Dem.open(label).gsd_m == 20.0
        substitute(label, " MAP_RESOLUTION ", " NO_RESOLUTION ")
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
        self, archive: dict[str, Product], tmp_path: Path
    ) -> None:
        label = archive["NAC_DTM_APOLLO15.TIF"].copied_to(tmp_path)
        label.write_text(cut(label.read_text(encoding="latin-1"), LINES=61), encoding="latin-1")
        with pytest.raises(
            DemError, match=r"60 x 72 pixels where its label NAC_DTM_APOLLO15\.LBL states 61 x 72"
        ):
            Dem.open(label)

    def test_an_img_with_the_label_of_a_tif_is_refused(
        self, archive: dict[str, Product], tmp_path: Path
    ) -> None:
        label = archive["NAC_DTM_APOLLO15.TIF"].copied_to(tmp_path)
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


class TestScaleWithoutUnit:
    """SCALING_FACTOR without UNIT: the sphere's radius in OFFSET shows the unit, else the label is refused."""

    def test_the_radius_shows_it(self) -> None:
        for name, scale in (("LDEM_16", 0.5), ("SLDEM2015_512_00N_30N_000_045_FLOAT", 1000.0)):
            text = label_text(name).replace("    UNIT  ", "    NO_UNIT  ")
            assert parse_pds3(text, Path("X.LBL")).height_scale_m == scale

    @pytest.mark.parametrize("name", ["LDEM_16", "SLDEM2015_512_00N_30N_000_045_FLOAT"])
    def test_nothing_shows_it(self, name: str) -> None:
        text = (
            label_text(name)
            .replace("    UNIT  ", "    NO_UNIT  ")
            .replace("    OFFSET  ", "    NO_OFFSET  ")
        )
        with pytest.raises(LabelError, match="SCALING_FACTOR has no UNIT"):
            parse_pds3(text, Path("X.LBL"))

    def test_whole_unscaled_numbers_are_metres(self) -> None:
        text = cut(
            label_text("WAC_GLD100_E000N1800_016P_attached"),
            BANDS="1\r\n SCALING_FACTOR = 1.0\r\n OFFSET = 0.0",
        )
        assert parse_pds3(text, Path("X.LBL")).height_scale_m == 1.0

    def test_a_jp2_does_not_take_the_scale_of_real_numbers(self, ldem_4: Path) -> None:
        """Kilometres of an uncompressed float image are not those of a JP2's counts."""
        text = (ldem_4 / "LDEM_4_JP2.LBL").read_text(encoding="latin-1")
        head, _, tail = text.partition("OBJECT                    = UNCOMPRESSED_FILE")
        for key in ("UNIT", "SCALING_FACTOR", "OFFSET"):
            head = head.replace(f"  {key} ", f"  NO_{key} ")
        tail = cut(tail, SAMPLE_TYPE="PC_REAL", UNIT="KILOMETER", SCALING_FACTOR=1, OFFSET=1737.4)
        whole = f"{head}OBJECT = UNCOMPRESSED_FILE{tail}"
        assert parse_pds3(whole, Path("X.LBL")).height_scale_m == 0.5


@pytest.mark.parametrize(
    "unit",
    [
        "ft",
        "feet",
        "US-ft",
        "US survey foot",
        "ftUS",
        "yard",
        "cm",
        "decimeters",
        "",
        "m",
        "elevation",
    ],
)
def test_heights_in_other_units_are_not_taken_as_metres(tmp_path: Path, unit: str) -> None:
    path = geotiff(tmp_path / "d.tif", np.full((20, 20), 7.0, np.float32), 0.0, 4000.0, 100.0)
    with rasterio.open(path, "r+") as dataset:
        dataset.units = (unit,)
    if unit in ("", "m", "elevation"):
        assert Dem.open(path).read(0, 1, 0, 1).item() == 7.0
    else:
        with pytest.raises(DemError, match=rf"d\.tif: the unit is {unit}; convert the values"):
            Dem.open(path)
