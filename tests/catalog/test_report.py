"""The catalogue page: no outside references, real images."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from helpers import catalogs
from helpers.pages import beyond_paper, decoded, in_browser, measured, parsed

from lcp_catalog.catalog import report
from lcp_catalog.catalog.model import Overview
from lcp_catalog.catalog.summary import summary
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError, OutputError, OutputExistsError


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


@pytest.mark.slow
@in_browser
@pytest.mark.parametrize("width", [400, 600])
def test_texts_are_at_least_11_pixels_high(html: str, width: int, tmp_path: Path) -> None:
    found = measured(html, width, tmp_path)
    assert found["texts"] > 200
    assert found["smallest"][0][0] >= 11.0
    assert found["wide"] <= 0


@pytest.mark.slow
@in_browser
def test_tables_fit_on_paper(html: str, tmp_path: Path) -> None:
    assert beyond_paper(html, tmp_path) <= 0.0


def test_the_page_shows_the_catalogue(html: str) -> None:
    found = catalogs.catalog(70, 9)
    page = parsed(html)
    assert page.counts["article"] == report.CARDS_MAX + 1  # and the chosen point
    assert "60 of 70 points: the 20 with the largest usable share, the 20 with the smallest" in html
    assert "a&amp;b.h5" in html
    assert "a&b.h5" not in html
    assert html.count('class="c') > 70
    assert f"<h3>{found.point_id[0]}</h3>" in html or f"{found.point_id[0]}: " in html
    pictures = [a for a in page.addresses if a.startswith("data:")]
    assert len(pictures) == 62  # the map twice
    assert decoded(pictures[0]).shape[:2] == found.overview.height.shape
    assert decoded(pictures[-1]).shape[:2] == (9, 9)
    for status in ("featureless", "ambiguous", "dependent", "nodata"):
        count = summary(found)["coverage"][status]
        assert f"<b>{status}</b> {count}:" in html
    assert "sha256 " + "0" * 64 in html
    assert re.findall("Place of (.*?) in the Moon's frame: no published error", unescape(html))


def test_texts_of_the_catalogue_cannot_become_markup() -> None:
    bad = "<script>alert(1)</script>"
    html = report.render_report(
        catalogs.catalog(
            3,
            title=bad,
            config=f'title = "{bad}"',
            scene_plan={"a": bad},
            sources=[{"name": bad, "size": 1, "sha256": bad}],
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
    assert parsed(one).counts["article"] == 2  # its card, and the chosen point
    none = report.render_report(catalogs.catalog(0), "none.h5")
    assert "article" not in parsed(none).counts
    assert "The catalogue has no points." in none


@pytest.mark.parametrize("most", [0, 2, 3])
def test_the_page_has_so_many_cards(most: int) -> None:
    html = report.render_report(catalogs.catalog(4), "four.h5", cards_max=most)
    assert parsed(html).counts["article"] == most + 1  # the chosen point


def test_a_region_without_ground_and_one_node_has_a_page() -> None:
    void = Overview(
        height=np.full((1, 1), np.nan),
        x=np.zeros(1),
        y=np.zeros(1),
        center_lon=3.5,
        center_lat=26.0,
    )
    parsed(report.render_report(catalogs.catalog(1, overview=void), "void.h5"))


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


def test_a_page_never_replaces_its_catalogue(tmp_path: Path) -> None:
    path = tmp_path / "c.h5"
    write_catalog(catalogs.catalog(3), path)
    content = path.read_bytes()
    with pytest.raises(OutputError, match="is read, too"):
        report.write_report(path, path, overwrite=True)
    assert path.read_bytes() == content
