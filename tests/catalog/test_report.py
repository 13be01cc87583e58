"""The catalogue page: no outside references, real images; its drawings."""

from __future__ import annotations

import io
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import catalogs
from helpers.pages import decoded, parsed

from lcp_catalog.catalog import charts, report
from lcp_catalog.catalog.hdf5 import Overview, write_catalog
from lcp_catalog.catalog.summary import summary
from lcp_catalog.errors import CatalogError, OutputExistsError
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.plots.numbers import number
from lcp_catalog.plots.png import encode_png


@pytest.fixture(scope="module")
def html() -> str:
    return report.render_report(catalogs.catalog(70, 9), "a&b.h5")


def test_the_page_refers_to_nothing_outside(html: str) -> None:
    page = parsed(html)
    assert all(a.startswith(("data:image/png;base64,", "#")) for a in page.addresses)
    assert not re.search(r"url\(|@import|https?://|//cdn|<link|<iframe", html)


def test_what_the_page_uses_it_holds(html: str) -> None:
    page = parsed(html)
    assert len(page.ids) == len(set(page.ids))
    used = {a[1:] for a in page.addresses if a.startswith("#")}
    assert used
    assert used <= set(page.ids)


def test_the_page_shows_the_catalogue(html: str) -> None:
    found = catalogs.catalog(70, 9)
    page = parsed(html)
    assert page.counts["article"] == report.CARDS_MAX
    assert "60 of 70 points: the 20 with the largest usable share, the 20 with the smallest" in html
    assert "a&amp;b.h5" in html
    assert "a&b.h5" not in html
    assert html.count('class="c') > 70
    assert f"<h3>{found.point_id[0]}</h3>" in html or f"{found.point_id[0]}: " in html
    pictures = [a for a in page.addresses if a.startswith("data:")]
    assert len(pictures) == 61
    assert decoded(pictures[0]).shape[:2] == found.overview.height.shape
    assert decoded(pictures[1]).shape[:2] == (9, 9)
    for status in ("featureless", "ambiguous", "dependent", "nodata"):
        count = summary(found)["coverage"][status]
        assert f"<b>{status}</b> {count}:" in html
    assert "sha256 " + "0" * 64 in html


def test_texts_of_the_catalogue_cannot_become_markup() -> None:
    bad = "<script>alert(1)</script>"
    html = report.render_report(
        catalogs.catalog(
            3,
            title=bad,
            config=bad,
            scene_plan={"a": bad},
            sources=[{"name": bad}],
            dem_product=[bad] * 3,
        ),
        bad,
    )
    parsed(html)
    assert bad not in html


def test_equal_catalogues_are_equal_pages(html: str) -> None:
    assert report.render_report(catalogs.catalog(70, 9), "a&b.h5") == html


def test_few_and_no_points_have_pages() -> None:
    one = report.render_report(catalogs.catalog(1), "one.h5")
    assert parsed(one).counts["article"] == 1
    none = report.render_report(catalogs.catalog(0), "none.h5")
    assert "article" not in parsed(none).counts
    assert "The catalogue has no points." in none


def test_a_region_without_ground_and_one_node_has_a_page() -> None:
    void = Overview(
        height=np.full((1, 1), np.nan),
        x=np.zeros(1),
        y=np.zeros(1),
        center_lon=3.5,
        center_lat=26.0,
    )
    parsed(report.render_report(catalogs.catalog(1, overview=void), "void.h5"))


@pytest.mark.parametrize("lat", [-90.0, 89.9, 0.0])
def test_a_map_anywhere_parses(lat: float) -> None:
    x = np.linspace(-40e3, 40e3, 33)
    drawn = charts.Map(np.zeros((33, 33)), x, x[::-1], EnuFrame(359.9, lat)).draw([], "map")
    parsed(drawn)
    assert "nan" not in drawn


def test_written_page_is_whole_and_kept(tmp_path: Path) -> None:
    path, page = tmp_path / "c.h5", tmp_path / "c.html"
    write_catalog(catalogs.catalog(3), path)
    report.write_report(path, page)
    assert page.read_text(encoding="utf-8").endswith("</html>\n")
    with pytest.raises(OutputExistsError):
        report.write_report(path, page)
    path.write_bytes(b"nothing")
    with pytest.raises(CatalogError):
        report.write_report(path, page, overwrite=True)
    assert page.read_text(encoding="utf-8").endswith("</html>\n")


# -- figures


def test_numbers_have_few_digits() -> None:
    texts = [
        (0.0, "0"),
        (118.0, "118"),
        (1.23456, "1.23"),
        (1e-7, "1.00e-07"),
        (100.0, "100"),
        (np.nan, "–"),
    ]
    for value, text in texts:
        assert number(value) == text


# -- pictures


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_is_read_by_others(channels: int) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, channels), dtype=np.uint8)
    found = cv2.imdecode(np.frombuffer(encode_png(pixels), np.uint8), cv2.IMREAD_UNCHANGED)
    assert io.BytesIO(encode_png(pixels)).read(4) == b"\x89PNG"
    if channels == 1:
        np.testing.assert_array_equal(found, pixels[..., 0])
    elif channels == 2:  # OpenCV gives grey and alpha as four channels
        np.testing.assert_array_equal(found[..., [0, 3]], pixels)
    else:
        order = [2, 1, 0, 3][:channels]
        np.testing.assert_array_equal(found[..., order], pixels)


@pytest.mark.parametrize(
    "pixels", [np.zeros((2, 2)), np.zeros((0, 3), np.uint8), np.zeros((1, 1, 5), np.uint8)]
)
def test_what_is_no_picture_is_refused(pixels: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"image"):
        encode_png(pixels)


def test_slopes_to_the_north_west_are_bright() -> None:
    row, col = np.indices((21, 21)) - 10
    lit = charts.hillshade(500.0 - 30.0 * np.hypot(row, col), 100.0)  # a cone
    assert lit[4, 4, 0] > 200  # row 0 is north, column 0 west
    assert lit[16, 16, 0] < 100
    holed = np.zeros((5, 5))
    holed[0, 0] = np.nan
    assert charts.hillshade(holed, 1.0)[0, 0, 1] == 0


def test_the_disc_has_north_up_and_east_right() -> None:
    disc = charts.SunDisc(np.array([0.0, 30.0, 60.0]), np.array([0.0, 90.0, 180.0, 270.0]))
    outline = re.search(r'id="s1-1" d="M([^A]*)A', disc.definitions())
    assert outline is not None
    x, y = (float(v) for v in outline[1].split())  # elevation 15, azimuth 45: up and right
    assert (x, y) == pytest.approx(
        (100 * 75 / 90 * np.sqrt(0.5), -100 * 75 / 90 * np.sqrt(0.5)), abs=0.06
    )
    share = np.full((3, 4), np.nan)
    share[1, 1] = 1.0
    drawn = disc.draw(share, "d")
    assert drawn.count("<use") == 1
    assert '<use href="#s1-1" class="c5">' in drawn


def test_a_map_puts_places_where_they_are() -> None:
    x = np.arange(-5, 6) * 100.0
    chart = charts.Map(np.zeros((11, 11)), x, x[::-1], EnuFrame(0.0, 0.0))
    west, north = chart.pixel(-550.0, 550.0)
    east, south = chart.pixel(550.0, -550.0)
    assert (west, north) == pytest.approx((84.0, 14.0))
    assert east == pytest.approx(946.0)
    assert south > north


def test_histograms_count_everything() -> None:
    values = np.random.default_rng(2).normal(5.0, 2.0, 500)
    drawn = charts.distribution([*values, np.nan], "m", "h").chart
    parsed(drawn)
    assert sum(int(n) for n in re.findall(r": (\d+)</title>", drawn)) == 500
    same = charts.distribution([2.0, 2.0, 2.0], "m", "h")
    assert (same.chart, same.single, same.count) == (None, "2 m", 3)
    nothing = charts.distribution([np.nan], "m", "h")
    assert (nothing.chart, nothing.single, nothing.count) == (None, "", 0)
