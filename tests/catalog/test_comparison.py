"""Differences of two catalogues, against a comparison point by point in plain loops."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catalogs

from lcp_catalog.catalog import comparison
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.comparison import compare, compare_catalogs
from lcp_catalog.catalog.schema import levels, summarise_usable
from lcp_catalog.catalog.stored import StoredFile, stored_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.errors import CatalogError

FIGURES = ("elevation", "second_peak", "dem_resolution", "harris_response", "shadow_dependence")


@pytest.fixture(autouse=True)
def unchecked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files that a test wrote are not checked: a check takes a process, and has tests of its own."""
    monkeypatch.setattr(
        comparison, "open_catalog", lambda path, check=True: stored_catalog(StoredFile.of(path))
    )


def edited(catalog: Catalog, seed: int = 3) -> Catalog:
    """Another order, some points left out, some under other ids, some with other values."""
    dice = np.random.default_rng(seed)
    found = catalog.take(dice.permutation(len(catalog))[: len(catalog) * 3 // 4])
    count, middle = len(found), catalog.patch_nodes // 2
    bumps = dice.normal(0.0, 2.0, found.dem.shape) * (dice.random(count) < 0.4)[:, None, None]
    bumps[:, middle, middle] = 0.0
    flags = found.condition.copy()
    flags[:, 1] &= np.where(dice.random(flags[:, 1].shape) < 0.1, 31 - 16, 31).astype(np.uint8)
    lowest, highest = summarise_usable(flags, found.sun_elevation)
    return replace(
        found,
        point_id=np.where(dice.random(count) < 0.3, found.point_id + 5, found.point_id),
        dem=found.dem + bumps.astype(np.float32),
        condition=flags,
        sun_elevation_min=lowest,
        sun_elevation_max=highest,
        second_peak=np.where(dice.random(count) < 0.2, 0.5, found.second_peak),
        dem_resolution=np.where(dice.random(count) < 0.5, np.nan, found.dem_resolution),
        dem_product=np.where(dice.random(count) < 0.5, "other", found.dem_product).astype(object),
    )


def distance_m(one: Catalog, row: int, other: Catalog, its: int) -> float:
    """By the haversine formula."""
    lon, lat, lon2, lat2 = (
        math.radians(value)
        for value in (
            one.longitude[row],
            one.latitude[row],
            other.longitude[its],
            other.latitude[its],
        )
    )
    half = math.sin((lat2 - lat) / 2.0) ** 2
    half += math.cos(lat) * math.cos(lat2) * math.sin((lon2 - lon) / 2.0) ** 2
    return 2.0 * MOON_RADIUS_M * math.asin(math.sqrt(half))


def moves_by_search(one: Catalog, old: list[int], other: Catalog, new: list[int]) -> set[Any]:
    """The closest pair, then the closest of the rest, and so on: pairs that are nearest to each other."""
    pairs = sorted((distance_m(one, a, other, b), a, b) for a in old for b in new)
    found, used, used_too = set(), set(), set()
    for away, a, b in pairs:
        if away <= one.coverage.spacing_m and a not in used and b not in used_too:
            found.add((int(one.point_id[a]), int(other.point_id[b]), round(away, 3)))
            used.add(a)
            used_too.add(b)
    return found


def largest(first: np.ndarray, second: np.ndarray) -> float:
    """The largest difference of two arrays, inf where one alone has a value."""
    worst = 0.0
    for a, b in zip(first.ravel().tolist(), second.ravel().tolist(), strict=True):
        if math.isnan(a) != math.isnan(b):
            worst = math.inf
        elif not math.isnan(a):
            worst = max(worst, abs(a - b))
    return worst


@pytest.mark.slow
@pytest.mark.parametrize("block", [2**24, 500])
def test_points_are_compared_as_in_plain_loops(
    block: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparison, "BLOCK_BYTES", block)
    one = catalogs.catalog(30)
    other = edited(one)
    for name, catalog in (("a.h5", one), ("b.h5", other)):
        write_catalog(catalog, tmp_path / name)
    found = compare(tmp_path / "a.h5", tmp_path / "b.h5")
    rows = {int(i): k for k, i in enumerate(one.point_id)}
    its = {int(i): k for k, i in enumerate(other.point_id)}
    old, new = sorted(rows.keys() - its.keys()), sorted(its.keys() - rows.keys())
    moved = moves_by_search(one, [rows[i] for i in old], other, [its[i] for i in new])
    ids = zip(found.moved_from.point_id, found.moved_to.point_id, found.moved_m, strict=True)
    assert {(int(a), int(b), round(float(m), 3)) for a, b, m in ids} == moved
    assert len(moved) > 3
    assert {*found.went.point_id.tolist()} == {*old} - {a for a, _, _ in moved}
    assert {*found.came.point_id.tolist()} == {*new} - {b for _, b, _ in moved}
    assert len(found.went) > 3
    both = sorted(rows.keys() & its.keys())
    expected: dict[int, dict[str, float]] = {}
    for i in both:
        a, b = rows[i], its[i]
        own = {name: largest(getattr(one, name)[a], getattr(other, name)[b]) for name in FIGURES}
        own["dem"] = largest(one.dem[a], other.dem[b])
        own["condition"] = float(sum((one.condition[a] != other.condition[b]).ravel().tolist()))
        own["dem_product"] = float(one.dem_product[a] != other.dem_product[b])
        for name in ("sun_elevation_min", "sun_elevation_max"):
            own[name] = largest(getattr(one, name)[a], getattr(other, name)[b])
        expected[i] = {name: amount for name, amount in own.items() if amount}
    stated = {
        one["point_id"]: {
            name: math.inf if amount is None else amount
            for name, amount in one["differences"].items()
        }
        for one in found.changes()
    }
    assert stated.keys() == {i for i in both if expected[i]}
    for i, own in stated.items():
        assert own == pytest.approx(expected[i], rel=1e-12)
    assert found.differs
    flags = [one["differences"].get("condition", 0.0) for one in found.changes()]
    assert flags == sorted(flags, reverse=True)


@pytest.mark.slow
def test_order_and_version_do_not_count(tmp_path: Path) -> None:
    one = catalogs.catalog(9)
    other = replace(one.take(np.arange(9)[::-1]), software_version="another")
    assert not compare_catalogs(one, other).differs
    for name, catalog in (("a.h5", one), ("b.h5", other)):
        write_catalog(catalog, tmp_path / name)
    assert not compare(tmp_path / "a.h5", tmp_path / "b.h5").differs
    document = json.loads("".join(compare(tmp_path / "a.h5", tmp_path / "b.h5").json_pieces()))
    assert document["differs"] is False
    assert document["points"]["matched"] == 9
    assert document["came"] == document["went"] == document["moved"] == document["changed"] == []


def test_equal_digests_are_answered_without_reading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a.h5", "b.h5"):
        write_catalog(catalogs.catalog(9), tmp_path / name)
    monkeypatch.setattr(comparison, "compare_catalogs", None)
    found = compare(tmp_path / "a.h5", tmp_path / "b.h5")
    assert not found.differs
    assert found.points == (9, 9)


def test_axes_cells_and_settings_are_named() -> None:
    """Variables on axes that differ are not compared, the others are."""
    one = catalogs.catalog(9)
    half = {
        name: getattr(one, name)[..., ::2]
        for name in (
            "condition", "sun_elevation_min", "sun_elevation_max", "sun_azimuth",
            "detection_probability", "sigma_major", "sigma_minor", "sigma_angle",
        )
    }  # fmt: skip
    lowest, highest = summarise_usable(half["condition"], one.sun_elevation)
    cells = replace(one.coverage, usable=None, spacing_m=5000.0)
    other = replace(
        one,
        **half | {"sun_elevation_min": lowest, "sun_elevation_max": highest},
        coverage=cells,
        gsd=2.0 * one.gsd,
        config="[points]\npatch_nodes = 9\n[view]\naltitude_km = [inf]\n",
        errors=one.errors | {"sensor_noise": 0.5},
    )
    found = compare_catalogs(one, other)
    stated = found.attributes
    assert stated["sun_azimuth"] == (one.sun_azimuth.tolist(), one.sun_azimuth[::2].tolist())
    assert stated["gsd_m"] == ([118.0], [236.0])
    assert stated["spacing_m"] == (9000.0, 5000.0)
    assert stated["config.view"] == (None, {"altitude_km": ["inf"]})
    assert stated["errors.sensor_noise"] == (0.02, 0.5)
    assert next(iter(stated)) == "sun_azimuth"
    assert {"condition", "detection_probability", "sigma_major"} <= {*found.not_compared}
    assert "dem" not in found.not_compared
    assert (found.amounts["gsd"] == 118.0).all()
    json.loads("".join(found.json_pieces()))


def test_maps_are_compared() -> None:
    one = catalogs.catalog(9)
    status = one.coverage.status.copy()
    status[:3] = (status[:3] + 1) % 5
    height = one.overview.height.copy()
    height[0, 0] = 7.0 if np.isnan(height[0, 0]) else np.nan
    other = replace(
        one,
        coverage=replace(one.coverage, status=status),
        overview=replace(one.overview, height=height),
    )
    found = compare_catalogs(one, other)
    assert found.maps["coverage/status"] == f"3 of {len(status)} values differ"
    assert found.maps["overview/height"] == f"1 of {height.size} values differ"
    fewer = one.take(np.arange(9), np.arange(4))
    assert compare_catalogs(one, fewer).maps["coverage/status"] == "has another shape"


def test_angles_return(tmp_path: Path) -> None:
    """Longitudes 359.9999 and 0 are near each other, and so are axes at 179 and 0 degrees."""
    one, two = np.array([[359.9999], [10.0]]), np.array([[0.0], [350.0]])
    assert comparison._amount("longitude", one, two) == pytest.approx([1e-4, 20.0])
    one, two = np.array([[179.0, 90.0]]), np.array([[0.0, 92.0]])
    assert comparison._amount("sigma_angle", one, two) == pytest.approx([2.0])


def test_a_moved_point_has_cells_of_the_same_level() -> None:
    one = catalogs.catalog(9)
    finer = replace(one, point_id=one.point_id + 3, gsd=one.gsd / 2.0, gsd_min=one.gsd_min / 2.0)
    found = compare_catalogs(one, finer)
    assert len(found.moved_m) == 0
    assert len(found.came) == len(found.went) == 9
    nearly = replace(one, point_id=one.point_id + 3, gsd=1.05 * one.gsd, gsd_max=4.0 * one.gsd)
    assert len(compare_catalogs(one, nearly).moved_m) == 9


def test_levels() -> None:
    assert levels([118.0, 20.0, 120.0, 10.0, 20.0]).tolist() == [2, 1, 2, 0, 1]
    assert levels([]).tolist() == []


def test_the_table_holds_every_point(tmp_path: Path) -> None:
    one = catalogs.catalog(30)
    found = compare_catalogs(one, edited(one))
    found.write_table(tmp_path / "t.csv")
    with open(tmp_path / "t.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    counts = found.counts()
    kinds = [row["difference"] for row in rows]
    for kind in ("came", "went", "moved", "changed"):
        assert kinds.count(kind) == counts[kind] > 0 or kind == "came"
    amounts = {row["point_id"]: row["dem [m]"] for row in rows if row["difference"] == "changed"}
    for change in found.changes():
        text = amounts[str(change["point_id"])]
        assert float(text or 0.0) == change["differences"].get("dem", 0.0)
    assert "one" in {row["dem_resolution [m]"] for row in rows}


def test_a_damaged_file_is_one_line(tmp_path: Path) -> None:
    write_catalog(catalogs.catalog(9), tmp_path / "a.h5")
    (tmp_path / "b.h5").write_bytes((tmp_path / "a.h5").read_bytes()[:-100])
    with pytest.raises(CatalogError, match=r"b\.h5"):
        compare(tmp_path / "a.h5", tmp_path / "b.h5")
