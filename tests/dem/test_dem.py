"""Heights of DEM products: against the archive's own numbers, GDAL's resampling and surfaces with
known answers.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import rasterio
from helpers.products import (
    DEGREE_M,
    RADIUS_M,
    cut,
    cylinder,
    geotiff,
    gld100_attached,
    hills,
    label_text,
    ldem_80s,
    sldem_512,
)

from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.pixel_statistics import height_statistics
from lcp_catalog.dem.products import product_name
from lcp_catalog.errors import DemError, LabelError

# facts.md: quarter-degree cells of LDEM_4 (lat, lon, height in metres)
LDEM_4_HEIGHTS = np.array(
    [
        (0.125, 0.125, -796.0),
        (0.125, 90.125, -3814.5),
        (0.125, 180.125, 2432.0),
        (45.125, 45.125, -699.0),
        (-45.125, 315.125, -301.0),
        (89.875, 0.125, -119.5),
        (-89.875, 180.125, 172.0),
    ]
)


class TestLdem4:
    @pytest.mark.parametrize("name", ["LDEM_4.IMG", "LDEM_4.LBL"])
    def test_img_gives_the_reference_heights(self, ldem_4: Path, name: str) -> None:
        lat, lon, want = LDEM_4_HEIGHTS.T
        got, index = DemSet.open([ldem_4 / name]).heights(lon, lat, 1.0)  # pixels, no means
        np.testing.assert_allclose(got, want, atol=1e-6)
        assert (index == 0).all()

    @pytest.mark.parametrize("name", ["LDEM_4.JP2", "LDEM_4_JP2.LBL"])
    def test_jp2_gives_them_within_its_lossy_count(self, ldem_4: Path, name: str) -> None:
        lat, lon, want = LDEM_4_HEIGHTS.T
        got, _ = DemSet.open([ldem_4 / name]).heights(lon - 360.0 * (lon > 180.0), lat, 1.0)
        np.testing.assert_allclose(got, want, atol=0.5 + 1e-6)

    def test_range_is_the_labels(self, ldem_4: Path) -> None:
        found = height_statistics(Dem.open(ldem_4 / "LDEM_4.IMG"))
        # MINIMUM and MAXIMUM of the label are -17758 and 21008 counts; numpy.fromfile of the .IMG
        # itself has -17757
        assert (found.min_m, found.max_m) == (-17757 / 2, 21008 / 2)
        assert found.nodata_share == 0.0  # GDAL would take a made-up nodata value

    def test_pixels_are_those_that_gdal_reads(self, ldem_4: Path) -> None:
        with rasterio.open(ldem_4 / "LDEM_4.LBL") as dataset:
            counts = dataset.read(1)
        np.testing.assert_array_equal(
            Dem.open(ldem_4 / "LDEM_4.IMG").read(0, 720, 0, 1440), counts * 0.5
        )

    def test_the_seam_is_not_seen(self, ldem_4: Path) -> None:
        whole = DemSet.open([ldem_4 / "LDEM_4.IMG"])  # 0..360: seam at 0
        other = DemSet.open([ldem_4 / "LDEM_4.JP2"])  # -180..180: seam at 180
        for at in (0.0, 180.0):
            lon, lat = np.meshgrid(at + np.linspace(-1.0, 1.0, 41), np.linspace(-60.0, 60.0, 25))
            difference = whole.heights(lon, lat, 7580.0)[0] - other.heights(lon, lat, 7580.0)[0]
            assert np.abs(difference).max() < 1.0

    def test_windows_do_not_change_a_height(self, ldem_4: Path) -> None:
        dems = DemSet.open([ldem_4 / "LDEM_4.IMG"])
        for gsd in (7580.0, 40_000.0):
            lon, lat = np.meshgrid(np.linspace(-5.0, 5.0, 31), np.linspace(70.0, 90.0, 21))
            together, _ = dems.heights(lon, lat, gsd)
            alone = [
                dems.heights(o, a, gsd)[0] for o, a in zip(lon.ravel(), lat.ravel(), strict=True)
            ]
            np.testing.assert_array_equal(together.ravel(), alone)
        lon = np.linspace(-180.0, 180.0, 1441) + 0.06  # a window all the way around
        together, _ = dems.heights(lon, 33.3, 7580.0)
        alone = [dems.heights(o, 33.3, 7580.0)[0] for o in lon]
        np.testing.assert_array_equal(together, alone)


def test_int16_counts_and_kilometres_agree(tmp_path: Path) -> None:
    """SLDEM2015's kilometres and LDEM's half metres come out in the same unit."""
    sldem = DemSet.open([sldem_512(tmp_path, 10, 20, 64, 48)])
    lon, lat = np.meshgrid(np.linspace(10.01, 10.11, 15), np.linspace(19.92, 19.99, 15))
    np.testing.assert_allclose(sldem.heights(lon, lat, 59.0)[0], hills(lon, lat), atol=0.01)
    polar = DemSet.open([ldem_80s(tmp_path, 60)])
    lon, lat = np.array([0.0, 77.0, 200.0, 300.0]), np.array([-90.0, -89.99, -89.985, -89.995])
    np.testing.assert_allclose(polar.heights(lon, lat, 20.0)[0], hills(lon, lat), atol=0.3)


def test_polar_product_over_its_pole(tmp_path: Path) -> None:
    """Every longitude of the pole is one place; around it nothing is missing and nothing jumps."""
    dems = DemSet.open([ldem_80s(tmp_path, 80)])
    heights, index = dems.heights(np.linspace(0.0, 360.0, 13), np.full(13, -90.0), 20.0)
    np.testing.assert_allclose(heights, heights[0], atol=1e-9)
    assert (index == 0).all()
    assert dems.bounds.south == -90.0
    assert dems.dems[0].abs_latitude_use == (80.0, 85.0)


def test_a_cylinder_is_continued_over_its_pole(tmp_path: Path) -> None:
    path = cylinder(
        tmp_path / "g.tif",
        0.0,
        90.0,
        (180, 360),
        1.0,
        surface=lambda lon, lat: 100.0 * np.sin(np.radians(lat)) * 1.0,
    )
    dems = DemSet.open([path])
    for lat in (89.9, 89.5, -89.9, 90.0, -90.0):
        height = dems.heights(np.array([0.0, 90.0, 123.0]), np.full(3, lat), 30_000.0)[0]
        np.testing.assert_allclose(height, 100.0 * np.sin(np.radians(lat)), atol=0.01)


def test_attached_label(tmp_path: Path) -> None:
    samples = np.arange(18 * 36, dtype=np.int16).reshape(18, 36)
    samples[4, 7] = -32768
    samples[4, 9] = -32765  # an ISIS special pixel, not a height
    path = gld100_attached(tmp_path, samples)
    dem = Dem.open(path)
    assert dem.product == "GLD100_16"
    assert dem.files == (path,)
    got = dem.read(0, 18, 0, 36)
    assert np.isnan(got[4, 7])
    assert np.isnan(got[4, 9])
    assert np.isnan(got).sum() == 2
    assert got[3, 5] == samples[3, 5]
    assert tuple(dem.grid.bounds) == pytest.approx((0.0, -90.0, 360.0, 90.0))


class TestGeotiff:
    def test_own_scale_offset_and_nodata(self, tmp_path: Path) -> None:
        counts = np.array([[100, 200], [300, -1]], np.int16)
        dem = Dem.open(
            geotiff(
                tmp_path / "c.tif", counts, 0.0, 200.0, 100.0, nodata=-1, scale=0.5, offset=10.0
            )
        )
        np.testing.assert_array_equal(dem.read(0, 2, 0, 2), [[60.0, 110.0], [160.0, np.nan]])

    @pytest.mark.parametrize(
        ("scale", "offset", "factor"),
        [(0.5, RADIUS_M, 0.5), (1.0, RADIUS_M / 1000, 1000.0)],
        ids=["counts", "kilometres"],
    )
    def test_the_radius_as_offset_is_no_height(
        self, tmp_path: Path, scale: float, offset: float, factor: float
    ) -> None:
        """The label that gdal_translate derives from a LOLA label."""
        values = np.full((3, 3), 2.0, np.float32)
        dem = Dem.open(
            geotiff(tmp_path / "o.tif", values, 0.0, 300.0, 100.0, scale=scale, offset=offset)
        )
        assert dem.read(1, 2, 1, 2)[0, 0] == 2.0 * factor

    def test_no_nodata_is_invented(self, tmp_path: Path) -> None:
        values = np.array([[0, -9999], [-1, 1]], np.int16)
        assert not np.isnan(
            Dem.open(geotiff(tmp_path / "z.tif", values, 0.0, 200.0, 100.0)).read(0, 2, 0, 2)
        ).any()

    def test_undeclared_missing_values_are_said(self, tmp_path: Path) -> None:
        values = np.full((3, 3), -3.4028e38, np.float32)
        with pytest.raises(DemError, match="cannot be on the Moon"):
            height_statistics(Dem.open(geotiff(tmp_path / "m.tif", values, 0.0, 300.0, 100.0)))

    def test_radii_are_heights_with_the_offset_that_is_named(self, tmp_path: Path) -> None:
        radii = np.full((3, 3), 1_737_412.0, np.float32)
        with pytest.raises(DemError, match=r"a_offset (-\d+)\)") as refused:
            height_statistics(Dem.open(geotiff(tmp_path / "r.tif", radii, 0.0, 300.0, 100.0)))
        offset = float(re.search(r"a_offset (-\d+)", str(refused.value))[1])
        dem = Dem.open(geotiff(tmp_path / "h.tif", radii, 0.0, 300.0, 100.0, offset=offset))
        assert (dem.read(0, 3, 0, 3) == 12.0).all()

    def test_geographic_degrees(self, tmp_path: Path) -> None:
        lon, lat = np.meshgrid(
            10.0 + (np.arange(50) + 0.5) / 100, 20.0 - (np.arange(40) + 0.5) / 100
        )
        path = geotiff(
            tmp_path / "d.tif",
            hills(lon, lat),
            10.0,
            20.0,
            0.01,
            crs="+proj=longlat +R=1737400 +no_defs",
        )
        dems = DemSet.open([path])
        assert dems.dems[0].gsd_m == pytest.approx(DEGREE_M / 100)
        assert dems.heights(10.2, 19.8, 303.0)[0] == pytest.approx(hills(10.2, 19.8), abs=0.05)


class TestRefusals:
    def test_truncated_img(self, ldem_4: Path, tmp_path: Path) -> None:
        shutil.copy(ldem_4 / "LDEM_4.LBL", tmp_path)
        (tmp_path / "LDEM_4.IMG").write_bytes((ldem_4 / "LDEM_4.IMG").read_bytes()[:-1])
        with pytest.raises(
            DemError,
            match=r"LDEM_4\.IMG: has 2073599 bytes where its label LDEM_4\.LBL states 2073600",
        ):
            Dem.open(tmp_path / "LDEM_4.IMG")

    def test_truncated_geotiff(self, tmp_path: Path) -> None:
        path = geotiff(tmp_path / "t.tif", np.zeros((200, 200), np.float32), 0.0, 2e4, 100.0)
        path.write_bytes(path.read_bytes()[:60_000])
        with pytest.raises(DemError, match=r"t\.tif"):
            height_statistics(Dem.open(path))

    def test_bare_jp2(self, ldem_4: Path, tmp_path: Path) -> None:
        shutil.copy(ldem_4 / "LDEM_4.JP2", tmp_path)
        with pytest.raises(LabelError, match="does not state the scale of its heights"):
            Dem.open(tmp_path / "LDEM_4.JP2")

    def test_jp2_of_another_size(self, ldem_4: Path, tmp_path: Path) -> None:
        shutil.copy(ldem_4 / "LDEM_4.JP2", tmp_path)
        text = cut((ldem_4 / "LDEM_4_JP2.LBL").read_text(encoding="latin-1"), LINES=719)
        (tmp_path / "LDEM_4_JP2.LBL").write_text(text, encoding="latin-1")
        with pytest.raises(DemError, match="720 x 1440 pixels where its label"):
            Dem.open(tmp_path / "LDEM_4.JP2")

    def test_img_without_label(self, tmp_path: Path) -> None:
        (tmp_path / "X.IMG").write_bytes(bytes(1000))
        with pytest.raises(LabelError, match=r"X\.LBL is missing"):
            Dem.open(tmp_path / "X.IMG")

    def test_foreign_radius(self, tmp_path: Path) -> None:
        label = sldem_512(tmp_path, 10, 20, 16, 16, A_AXIS_RADIUS="1738.0")
        with pytest.raises(LabelError, match="1738000 m"):
            Dem.open(label)

    @pytest.mark.parametrize(
        ("make", "says"),
        [
            (lambda p: p.write_text("not a DEM"), "not a DEM that can be read"),
            (lambda p: p.write_bytes(b""), "not a DEM that can be read"),
            (lambda p: p.mkdir(), "is a folder"),
            (lambda p: None, "no such file"),
            (lambda p: p.write_text("PDS_VERSION_ID = PDS3\nEND\n"), "IMAGE_MAP_PROJECTION"),
            (lambda p: geotiff(p, np.zeros((3, 3), np.uint8), 0.0, 0.0, 1.0), "8-bit"),
            (
                lambda p: geotiff(p, np.zeros((3, 3), np.int16), 0.0, 0.0, 1.0, crs="EPSG:3857"),
                "radii 6378137",
            ),
            (
                lambda p: geotiff(p, np.zeros((3, 3), np.int16), 0.0, 0.0, 1.0, crs=None),
                "no map projection",
            ),
        ],
    )
    def test_what_is_no_dem(self, tmp_path: Path, make: object, says: str) -> None:
        path = tmp_path / "x.tif"
        make(path)  # type: ignore[operator]
        with pytest.raises((DemError, LabelError), match=says) as caught:
            Dem.open(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("identifier", "name", "use"),
    [
        ("SLDEM2015_512_00N_30N_000_045_FLOAT", "SLDEM2015_512", (0.0, 60.0)),
        ("LDEM_512_00N_45N_000_090", "LDEM_512", (60.0, 75.0)),
        ("ldem_75n_30m", "LDEM_75N_30M", (75.0, 80.0)),
        ("LDEM_80S_20M", "LDEM_80S_20M", (80.0, 85.0)),
        ("LDEM_85N_10M", "LDEM_85N_10M", (85.0, 90.0)),
        ("LDEM_875S_5M", "LDEM_875S_5M", None),
        ("LDEM_4", "LDEM_4", None),
        ("WAC_GLD100_E300N0450_256P", "GLD100_256", None),
        ("gld100_064ppd_lat75-90", "GLD100_64", None),
        ("NAC_DTM_APOLLO11", "NAC_DTM_APOLLO11", None),
    ],
)
def test_product_names(
    identifier: str, name: str, use: tuple[float, float] | None, ldem_4: Path
) -> None:
    assert product_name(identifier) == name
    one = Dem.open(ldem_4 / "LDEM_4.IMG")
    assert type(one)(one.path, name, one.grid, one.raster, one.files).abs_latitude_use == use


def test_real_gld100(shared_data: Path) -> None:
    dems = DemSet.open(
        [
            shared_data
            / "images"
            / "apollo15-metric-hadley"
            / "gld100_256ppd_lat20-30_lon000-010.tif"
        ]
    )
    assert tuple(dems.bounds) == pytest.approx((0.0, 20.0, 10.0, 30.0))
    assert dems.products == ("GLD100_256",)
    # against LDEM_4 means over quarter degrees; PROVENANCE: the two agree to some tens of metres
    height = dems.heights(3.0, 26.0, 7580.0)[0]
    ldem = DemSet.open([shared_data / "dem" / "ldem_4" / "LDEM_4.IMG"]).heights(3.0, 26.0, 7580.0)[
        0
    ]
    assert height == pytest.approx(ldem, abs=150.0)


def test_label_texts_are_cut_consistently(tmp_path: Path) -> None:
    """The recipe itself: a tile in the place of the archive's is the archive's grid."""
    whole = Dem.open(sldem_512(tmp_path, 0, 30, 32, 32)).grid
    assert (whole.x0_m, whole.y0_m) == pytest.approx(
        (-92159.5 * whole.pixel_m, 15359.5 * whole.pixel_m)
    )
    assert "15359.5" in label_text("SLDEM2015_512_00N_30N_000_045_FLOAT")
