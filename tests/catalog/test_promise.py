"""The promise of a catalogue in its file and in words."""

from __future__ import annotations

import dataclasses
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from helpers.catalogs import catalog as made
from helpers.catalogs import promised
from helpers.verified import verify

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.comparison import compare
from lcp_catalog.catalog.model import Promise
from lcp_catalog.catalog.promise import kept_promise
from lcp_catalog.catalog.report import render_report
from lcp_catalog.catalog.schema import NO_CELL, Cause
from lcp_catalog.catalog.summary import describe, summary_rows
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError


@pytest.fixture(scope="module")
def plain() -> Catalog:
    return made()


@pytest.fixture(scope="module")
def catalog(plain: Catalog) -> Catalog:
    return dataclasses.replace(plain, promise=promised(plain))


@pytest.fixture(scope="module")
def path(catalog: Catalog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("promise") / "p.h5"
    write_catalog(catalog, found)
    return found


def test_it_is_read_as_it_was_written(catalog: Catalog, path: Path) -> None:
    assert verify(path) == []
    found = open_catalog(path).promise
    for field in dataclasses.fields(Promise):
        np.testing.assert_array_equal(
            getattr(found, field.name), getattr(catalog.promise, field.name)
        )


def test_the_figures_are_those_of_a_count(catalog: Catalog, path: Path) -> None:
    facts = describe(path)["promise"]
    told = catalog.promise
    real = told.cause[told.cause != NO_CELL]
    assert facts["conditions"] == len(real)
    assert facts["kept_share"] == pytest.approx(np.mean(real == Cause.MET))
    assert facts["causes"] == {
        name: pytest.approx(np.mean(real == cause))
        for name, cause in (("dark", Cause.DARK), ("few", Cause.FEW))
    }
    assert facts["size_over_bound"] == len(catalog) / 2.5
    assert facts["curve"] == [[1, 0.25], [2, 0.75], [3, 1.0]]
    worst = facts["worst_suns"][0]
    elevation, azimuth = catalog.sun_elevation, catalog.sun_azimuth
    assert worst["view"] == 0
    assert worst["sun_elevation_deg"] == elevation[1:3].tolist()
    assert worst["sun_azimuth_deg"] == azimuth[2:4].tolist()
    assert (worst["kept_share"], worst["cause"]) == (0.0, "dark")
    assert worst["places"] == np.count_nonzero(told.cause[:, 0, 1, 2] != NO_CELL)


def _tile(page: str, words: str) -> str:
    """The figure above words in the first lines of a page; empty if they are not there."""
    text = " ".join(unescape(page).split())
    found = re.search(rf"<strong>([^<]*)</strong><span>[^<]*{re.escape(words)}", text)
    return found[1] if found else ""


def test_it_is_told_in_words(catalog: Catalog, plain: Catalog, path: Path) -> None:
    lines = dict(summary_rows(describe(path)))
    assert lines["promise"].startswith("2 usable points in every footprint of 40 km: kept in ")
    assert lines["promise"].endswith(" places x the catalogue's views x Suns")
    page = render_report(catalog, "p.h5")
    assert "What is promised" in page
    assert "(dark)" in page
    assert "located, at least" in page  # by Sun
    kept = 100.0 * np.mean(catalog.promise.cause[catalog.promise.cause != NO_CELL] == Cause.MET)
    cells = f"cells with heights, {catalog.coverage.spacing_m / 1e3:.3g} km wide, have a control point within that distance"
    assert _tile(page, "places, views and Suns: frames of 40 km have what is pr") == f"{kept:.1f} %"
    assert _tile(page, f"{cells}; points are chosen for frames")
    alone = render_report(plain, "p.h5")
    assert "What is promised" not in alone
    assert _tile(alone, f"{cells}<")
    assert kept_promise(plain) is None


def test_a_part_of_a_catalogue_promises_nothing(
    catalog: Catalog, plain: Catalog, path: Path, tmp_path: Path
) -> None:
    assert catalog.take(np.arange(2)).promise is None
    write_catalog(plain, tmp_path / "plain.h5")
    assert compare(path, tmp_path / "plain.h5").maps == {"promise": "only one of the two has it"}


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("demand", np.full(7, 3, np.uint8), "promise/cause: is not as demand and points say"),
        ("met", np.array([0.25, 0.75, 1.5]), r"promise/met: not in 0\.\.1"),
        ("size", np.array([1, 3, 2], np.int32), "promise/size: does not rise"),
        ("lower_bound", np.array([-1.0]), "promise/lower_bound: below 0"),
        ("places", np.array([6]), "promise/places: are not as many as there are"),
    ],
)
def test_what_contradicts_itself_is_refused(
    catalog: Catalog, name: str, value: object, says: str
) -> None:
    wrong = dataclasses.replace(catalog.promise, **{name: value})
    with pytest.raises(CatalogError, match=says):
        dataclasses.replace(catalog, promise=wrong)
