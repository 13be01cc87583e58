"""Windows of a site, against predictions point by point."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from helpers import catalogs
from helpers.navigable import everywhere_usable
from helpers.posed import camera

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.ephemeris.solar_position import sun_direction_at
from lcp_catalog.ephemeris.times import instant_range
from lcp_catalog.errors import CatalogError
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.navigation import site_windows as windows
from lcp_catalog.navigation.expected_position import Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage

SITE = EnuFrame(*catalogs.CENTER)
TIMES = instant_range("2026-01-20", "2026-02-14", 2 * 86400.0)


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return catalogs.catalog(40)


@pytest.mark.slow
def test_the_counts_are_those_of_every_point_alone(
    catalog: Catalog, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = windows.Site(SITE, 40e3, 200.0, 28.0, 91.0)
    found = windows.site_windows(catalog, site, TIMES)
    for at_once in (1, 100):
        monkeypatch.setattr(windows, "PAIRS_AT_ONCE", at_once)
        same = windows.site_windows(catalog, site, TIMES)
        assert same.usable.tolist() == found.usable.tolist()
        np.testing.assert_allclose(same.expected, found.expected, rtol=1e-6)
    off, azimuth = np.radians([28.0, 91.0])
    view = [np.sin(off) * np.sin(azimuth), np.sin(off) * np.cos(azimuth), np.cos(off)]
    rows = [
        i
        for i, place in enumerate(catalog.position_mcmf)
        if (np.abs(SITE.rotation[:2] @ (place - SITE.origin_mcmf_m)) <= 20e3).all()
    ]
    assert 8 < len(rows) < 40
    assert found.points == len(rows)
    for k, time in enumerate(TIMES.labels()):
        claims = [
            predict(catalog, [i], catalog.rotation_mcmf_to_enu[i] @ sun_direction_at(time), view, 200.0)
            for i in rows
        ]  # fmt: skip
        usable = [bool(one.usable[0]) for one in claims]
        assert found.usable[k] == sum(usable)
        chance = [one.detection_probability[0] for one in claims if one.usable[0]]
        assert found.expected[k] == pytest.approx(sum(chance))
    assert found.usable.max() > 4
    assert found.usable.min() == 0


def test_intervals_are_runs_of_enough_points(catalog: Catalog) -> None:
    found = windows.site_windows(catalog, windows.Site(SITE, 80e3), TIMES)
    for least in (1, 4, 12, 99):
        inside = set()
        for one in found.intervals(least):
            first, last = (TIMES.labels().index(one[name]) for name in ("from", "to"))
            assert one["instants"] == last - first + 1
            own = found.usable[first : last + 1]
            assert (own.min(), own.max()) == (one["usable_min"], one["usable_max"])
            inside |= set(range(first, last + 1))
        assert inside == set(np.flatnonzero(found.usable >= least))
    assert found.intervals(4)
    assert found.intervals(99) == []


def test_the_table_has_the_numbers(catalog: Catalog) -> None:
    found = windows.site_windows(catalog, windows.Site(SITE, 80e3), TIMES)
    rows = list(csv.DictReader(io.StringIO(found.csv_text(), newline="")))
    assert [row["time_utc"] for row in rows] == TIMES.labels()
    assert [int(row["usable"]) for row in rows] == found.usable.tolist()
    assert not {"position_sigma_m", "located_probability"} & rows[0].keys()


def test_a_camera_has_what_a_query_says() -> None:
    catalog, taken = everywhere_usable(), camera()
    found = windows.camera_windows(catalog, SITE, taken, TIMES)
    for k, time in enumerate(TIMES.labels()):
        frame = PlannedImage.lit(taken, SunChoice(time_utc=time))
        (answer,) = answers(catalog, [frame], Query())
        assert found.usable[k] == answer.usable
        assert found.located[k] == answer.joint.located
        sigma = answer.position.position_sigma_m
        assert (sigma is None) == bool(np.isnan(found.position_sigma_m[k]))
        if sigma is not None:
            assert found.position_sigma_m[k] == pytest.approx(sigma, rel=1e-6)
    assert np.isfinite(found.position_sigma_m).any()
    assert "position_sigma_m" in next(found.records())
    assert max(record["located_probability"] for record in found.records()) > 0.9
    for interval in found.intervals(1):
        within = (np.array(TIMES.labels()) >= interval["from"]) & (
            np.array(TIMES.labels()) <= interval["to"]
        )
        assert interval["located_probability_min"] == round(found.located[within].min(), 4)


def test_a_catalogue_without_points_is_refused(catalog: Catalog) -> None:
    site = windows.Site(EnuFrame(*catalogs.CENTER), 50e3)
    with pytest.raises(CatalogError, match="the catalogue has no points"):
        site.rows(catalog.take([]))


def test_a_site_without_points_is_refused(catalog: Catalog) -> None:
    """Also one on the other side of the Moon, where the points lie below the plane."""
    for lon, lat in ((catalogs.CENTER[0] + 180.0, -catalogs.CENTER[1]), (40.0, 0.0)):
        site = windows.Site(EnuFrame(lon, lat), 50e3)
        with pytest.raises(CatalogError, match="no point of the catalogue lies within"):
            windows.site_windows(catalog, site, TIMES)
