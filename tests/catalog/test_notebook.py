"""A catalogue in a notebook: short texts, points one by one, selections, tables."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest
from helpers import catalogs, navigable

import lcp_catalog as lcp
from lcp_catalog import errors
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError, MissingPackageError


@pytest.fixture(scope="module", params=["memory", "file"])
def catalog(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> lcp.Catalog:
    made = catalogs.catalog(20)
    if request.param == "memory":
        return made
    path = tmp_path_factory.mktemp("notebook") / "c.h5"
    write_catalog(made, path)
    return lcp.open_catalog(path)


def test_texts_are_short(catalog: lcp.Catalog) -> None:
    for one in (catalog, catalog.coverage, catalog.overview):
        assert len(repr(one)) <= 1000
    text = catalog._repr_html_()
    assert text.startswith("<table>")
    assert text.count("<tr>") == text.count("</tr>") > 10
    assert "<td>20</td>" in text
    assert "Sun at" in text


def test_points_one_by_one(catalog: lcp.Catalog) -> None:
    every = list(catalog)
    assert len(every) == len(catalog) == 20
    for row in (0, 7, -1):
        np.testing.assert_equal(catalog[row], every[row])
        assert catalog[row]["point_id"] == catalog.point_id[row]
        assert catalog[row]["longitude"] == catalog.longitude[row]
    assert "dem" not in every[0]
    with pytest.raises(IndexError):
        catalog[20]


def test_some_of_the_points(catalog: lcp.Catalog) -> None:
    for which in (slice(3, 9), np.arange(3, 9), np.isin(np.arange(20), np.arange(3, 9))):
        some = catalog[which]
        assert isinstance(some, lcp.Catalog)
        np.testing.assert_array_equal(some.point_id, catalog.point_id[3:9])
        np.testing.assert_array_equal(some.condition, catalog.condition[3:9])


def test_points_that_work_in_a_condition(catalog: lcp.Catalog) -> None:
    """Counted by the flags: all five of them."""
    works = np.asarray(catalog.condition) == 31  # (n, v, e, a)
    e = int(np.argmin(np.abs(catalog.sun_elevation - 21.0)))
    a = catalog.sun_azimuth.tolist().index(0.0)
    found = catalog.sel(view=1, sun_elevation=21.0, sun_azimuth=359.0)
    np.testing.assert_array_equal(found.point_id, catalog.point_id[works[:, 1, e, a]])
    low = catalog.sel(sun_elevation=21.0)
    np.testing.assert_array_equal(low.point_id, catalog.point_id[works[:, :, e].any((1, 2))])
    with pytest.raises(CatalogError, match=r"has no view 9, but \d, from 0 on"):
        catalog.sel(view=9)


def test_tables(catalog: lcp.Catalog) -> None:
    frame = catalog.to_dataframe()
    assert frame.index.tolist() == catalog.point_id.tolist()
    assert frame["elevation"].tolist() == catalog.elevation.tolist()
    chance = catalog["detection_probability"]
    one = chance.sel(view=0, sun_elevation=catalog.sun_elevation[1], image_scale=1.0)
    np.testing.assert_array_equal(one, np.asarray(catalog.detection_probability)[:, 0, 0, 1])
    with pytest.raises(CatalogError, match="has no colour"):
        catalog["colour"]


def test_a_missing_package_is_one_line(
    catalog: lcp.Catalog, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(errors, "import_module", missing)
    with pytest.raises(MissingPackageError, match=r"needs the package pandas: pip install"):
        catalog.to_dataframe()


def test_a_sun_at_an_instant() -> None:
    text = "2026-03-01T12:00:00"
    utc = dt.datetime(2026, 3, 1, 14, tzinfo=dt.timezone(dt.timedelta(hours=2)))
    for time in (text, dt.datetime(2026, 3, 1, 12), utc, np.datetime64(text)):
        assert lcp.Sun.at(time) == lcp.SunChoice(time_utc=f"{text}Z")
    assert lcp.SunChoice.of(np.datetime64(text)) == lcp.Sun.at(text)
    with pytest.raises(errors.SunError, match="invalid time: 'noon'"):
        lcp.Sun.at("noon")


def test_one_dem_is_opened_by_its_name() -> None:
    assert lcp.DemSet.open(str(catalogs.HADLEY)).products == lcp.DemSet.open([catalogs.HADLEY]).products  # fmt: skip
    assert navigable.everywhere_usable(4).path is None
