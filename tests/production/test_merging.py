"""Merged catalogues, against a greedy choice, a coverage and an overview in plain NumPy."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import catalogs, merges
from helpers.merges import read, written
from helpers.small_build import CONFIG, DEM
from helpers.verified import verify
from scipy.ndimage import map_coordinates

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.comparison import compare_catalogs
from lcp_catalog.catalog.model import Promise
from lcp_catalog.catalog.origins import Origin, origins
from lcp_catalog.catalog.point_errors import slope_sigma
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.catalog.promise import kept_promise, promise_rows
from lcp_catalog.catalog.report import render_report
from lcp_catalog.catalog.schema import Cause, usable
from lcp_catalog.catalog.summary import describe
from lcp_catalog.errors import CatalogError, OutputError, OutputExistsError
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.production import merging
from lcp_catalog.production.config import AreaConfig, SunConfig, ViewConfig
from lcp_catalog.production.merging import MergedMaps, merge_catalogs
from lcp_catalog.production.overlap import Agreement, MergedPart
from lcp_catalog.production.run import Build, BuildRun
from lcp_catalog.terrain.area import Area
from lcp_catalog.validation.claims import search_radius_m

pytestmark = pytest.mark.usefixtures("unchecked", "uncompared")

STATUS_ORDER = [4, 1, 2, 3, 5, 0]
"""Codes of a cell's status: of several reports the one that comes last here holds."""


@pytest.fixture
def uncompared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether heights agree, which takes half of a merge's time, is asked in test_overlap and in tests/cli/test_merge."""
    monkeypatch.setattr(merging, "agreement", lambda *_: Agreement())


@pytest.fixture(scope="module")
def paths(inputs: list[Catalog], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """``a.h5`` and ``b.h5``, the inputs in files."""
    return written(tmp_path_factory.mktemp("inputs"), inputs)


@pytest.fixture(scope="module")
def merged(paths: list[Path]) -> Path:
    merge_catalogs(paths, paths[0].with_name("m.h5"))
    return paths[0].with_name("m.h5")


@pytest.mark.slow
def test_points_are_those_of_a_greedy_choice(inputs: list[Catalog], merged: Path) -> None:
    """And each has all the figures that it has in its input."""
    found = read(merged)
    expected = merges.chosen_by_search(inputs, merges.SPACING_M)
    assert found.point_id.tolist() == sorted(expected)
    assert {number for number, _ in expected.values()} == {0, 1}
    assert len(expected) < len(np.unique(np.concatenate([one.point_id for one in inputs])))
    for row, point in enumerate(found.point_id.tolist()):
        number, its = expected[point]
        for name in found.point_variables:
            mine = found.part(name, row)
            np.testing.assert_array_equal(mine, inputs[number].part(name, its), err_msg=name)


@pytest.mark.slow
def test_a_merged_catalogue_is_intact_and_read_as_any(inputs: list[Catalog], merged: Path) -> None:
    assert verify(merged) == []
    facts = describe(merged)
    assert facts["intact"]
    assert facts["schema_version"] == "3.0"
    assert "</html>" in render_report(read(merged), "m.h5")
    builds = origins(read(merged).config)
    digests = ", ".join(sorted(one.content_sha256 for one in builds))
    assert read(merged).history == f"merge of 2 catalogues with the content_sha256 {digests}"
    assert {one.name for one in builds} == {"a.h5", "b.h5"}
    assert {one.points for one in builds} == {len(one) for one in inputs}
    kept = {one.name: one.config for one in builds}
    assert kept == {
        name: tomllib.loads(one.config) for name, one in zip(("a.h5", "b.h5"), inputs, strict=True)
    }


def test_coverage_is_that_of_the_points_and_of_the_nearest_cells(
    inputs: list[Catalog], merged: Path
) -> None:
    found = read(merged)
    cells = found.coverage
    places = np.stack([cells.longitude, cells.latitude], axis=1)
    assert (cells.longitude >= 2.1).all()
    assert (cells.longitude <= 4.9).all()
    area_m2 = np.radians(2.8) * (np.sin(np.radians(27.1)) - np.sin(np.radians(24.9)))
    assert len(places) == pytest.approx(area_m2 * 1737400.0**2 / merges.SPACING_M**2, rel=0.15)
    best = np.full(len(places), -1)
    for one, (west, east) in zip(inputs, ((2.1, 3.9), (3.2, 4.9)), strict=True):
        own = np.stack([one.coverage.longitude, one.coverage.latitude], axis=1)
        mine = (places[:, 0] >= west) & (places[:, 0] <= east)
        status = one.coverage.status[merges.distances_m(places, own).argmin(axis=1)]
        order = np.array([STATUS_ORDER.index(code) for code in status])
        best = np.maximum(best, np.where(mine, order, -1))
    near = merges.distances_m(places, merges.places(found)) <= merges.SPACING_M
    best[near.any(axis=1)] = 5
    assert cells.status.tolist() == [STATUS_ORDER[k] for k in best]
    assert len(np.unique(cells.status)) > 2
    works = usable(found.condition)
    expected = np.array([works[row].any(axis=0) for row in near]).astype(np.uint8)
    never = ~(found.condition > 0).any(axis=0)
    np.testing.assert_array_equal(
        cells.usable, np.where(never, 255, expected.reshape(-1, *never.shape))
    )


def test_overview_is_that_of_the_inputs(inputs: list[Catalog], merged: Path) -> None:
    """Bilinear between nodes; NaN beside places without heights, and outside."""
    found = read(merged).overview
    lon, lat = found.plane.lonlat(*np.meshgrid(found.x, found.y))
    view = inputs[0].overview  # the same raster in both
    x, y = view.plane.at(lon, lat)
    where = np.stack([(view.y[0] - y) / 450.0, (x - view.x[0]) / 450.0])
    expected = map_coordinates(view.height.astype(float), where, order=1, cval=np.nan)
    inside = (np.abs(x) <= view.x[-1]) & (np.abs(y) <= view.y[0])
    assert inside.mean() > 0.5
    np.testing.assert_allclose(found.height[inside], expected[inside], atol=0.01)
    far = (np.abs(x) > view.x[-1] + 225.0) | (np.abs(y) > view.y[0] + 225.0)
    assert np.isnan(found.height[far]).all()


def test_of_two_overviews_the_finer_one_holds(inputs: list[Catalog]) -> None:
    """A coarser one that says other heights is shown where the finer one knows none."""
    fine, view = inputs[0], inputs[0].overview
    coarse = replace(view, height=view.height[::2, ::2] + 1e5, x=view.x[::2], y=view.y[::2])
    west, whole = Area.from_bounds(2.1, 24.9, 3.5, 27.1), Area.from_bounds(2.1, 24.9, 4.9, 27.1)
    half = view.height.copy()
    half[:, view.x > 0.0] = np.nan
    one = MergedPart(replace(fine, overview=replace(view, height=half)), [west])
    other = MergedPart(replace(fine, overview=coarse), [whole])
    for parts in ([one, other], [other, one]):
        found = MergedMaps(parts).overview()
        lon, lat = found.plane.lonlat(*np.meshgrid(found.x, found.y))
        x, y = view.plane.at(lon, lat)
        known = np.isfinite(found.height) & (np.abs(x) < view.x[-1]) & (np.abs(y) < view.y[0])
        assert (found.height[known & (x < -450.0)] < 5e4).all()
        assert (found.height[known & (x > 450.0)] > 5e4).all()
        assert known[x < -450.0].any()
        assert known[x > 450.0].any()


def test_the_order_of_the_inputs_does_not_matter(paths: list[Path], tmp_path: Path) -> None:
    """Nor do repeated inputs, nor the size of the blocks."""
    third = merges.disturbed(merges.part(merges.whole(), 2.6, 4.2), seed=8)
    paths = [*paths, *written(tmp_path, [third], "c")]
    for name, order in (("m", paths), ("n", [*paths[::-1], paths[1]])):
        merge_catalogs(order, tmp_path / f"{name}.h5")
    assert (tmp_path / "m.h5").read_bytes() == (tmp_path / "n.h5").read_bytes()


@pytest.mark.slow
def test_files_are_merged_without_a_temporary_folder(
    paths: list[Path], merged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its removal can fail, and then it stays."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "no such folder"))
    merge_catalogs(paths, tmp_path / "m.h5")
    assert (tmp_path / "m.h5").read_bytes() == merged.read_bytes()


@pytest.mark.slow
def test_catalogues_in_memory_are_merged_as_files(
    inputs: list[Catalog], paths: list[Path], merged: Path, tmp_path: Path
) -> None:
    merge_catalogs([paths[0], *inputs[1:]], tmp_path / "m.h5")
    found, wanted = read(tmp_path / "m.h5"), read(merged)
    assert {*compare_catalogs(found, wanted).attributes} == {"config.merged"}  # names of files
    np.testing.assert_array_equal(found.point_id, wanted.point_id)
    np.testing.assert_array_equal(found.condition, wanted.condition)


@pytest.mark.slow
def test_small_blocks_give_the_same(
    paths: list[Path], merged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(merging, "BLOCK_BYTES", 100_000)
    merge_catalogs(paths, tmp_path / "m.h5")
    assert not compare_catalogs(read(tmp_path / "m.h5"), read(merged)).differs


@pytest.mark.slow
def test_a_catalogue_merged_with_itself_has_its_points(
    inputs: list[Catalog], paths: list[Path], merged: Path, tmp_path: Path
) -> None:
    """A merged one has its maps and its builds, too."""
    path = paths[0]
    spread = sorted(merges.chosen_by_search(inputs[:1], merges.SPACING_M))
    done = merge_catalogs([path, path], tmp_path / "m.h5")
    assert read(tmp_path / "m.h5").point_id.tolist() == spread
    assert (done.points, done.doubles) == (len(spread), 0)
    merge_catalogs([merged, merged], tmp_path / "again.h5")
    found = compare_catalogs(read(merged), read(tmp_path / "again.h5"))
    assert found.attributes == {}
    assert found.counts()["matched"] == found.points[0] == found.points[1]
    assert not found.amounts
    assert {name for name in found.maps if name.startswith("coverage")} == set()


@pytest.mark.slow
def test_pairs_first_or_last(paths: list[Path], tmp_path: Path) -> None:
    """Where no point is kept from another by a third one, merges may be nested in any way: here the
    third catalogue lies apart from the conflicts of the first two.
    """
    every = merges.whole()
    far = merges.part(every, 4.4, 4.9)
    middle = merges.disturbed(merges.part(every, 3.2, 4.2), seed=5)
    a, (b, c) = paths[0], written(tmp_path, [middle, far], "b")
    merge_catalogs([a, b, c], tmp_path / "abc.h5")
    merge_catalogs([a, b], tmp_path / "ab.h5")
    merge_catalogs([tmp_path / "ab.h5", c], tmp_path / "ab_c.h5")
    found = compare_catalogs(read(tmp_path / "abc.h5"), read(tmp_path / "ab_c.h5"))
    assert found.attributes == {}
    assert found.counts()["matched"] == found.points[0] == found.points[1]
    assert not found.amounts
    assert {name for name in found.maps if name.startswith("coverage")} == set()


@pytest.mark.slow
def test_levels_are_kept_apart(inputs: list[Catalog], paths: list[Path], tmp_path: Path) -> None:
    """A finer catalogue of the same ground: 0 is the finest, each level has its own spacing, and sigmas
    are rounded to the finer catalogue's step.
    """
    coarse, spacing = inputs[0], 5500.0
    fine = merges.disturbed(coarse, seed=2)
    figures = ("gsd", "gsd_min", "gsd_max", "sigma_major", "sigma_minor", "localization_sigma")
    half = {name: getattr(fine, name) / 4.0 for name in figures}
    text = merges.config(2.1, 3.9, 29.5, spacing)
    fine = replace(fine, **half, config=text, sigma_step_m=None)
    a, (b,) = paths[0], written(tmp_path, [fine], "b")
    done = merge_catalogs([a, b], tmp_path / "m.h5")
    found = read(tmp_path / "m.h5")
    assert verify(tmp_path / "m.h5") == []
    assert done.levels_m == ((29.5,), (118.0,))
    assert found.level.tolist() == np.where(found.gsd < 100.0, 0, 1).tolist()
    assert done.doubles > 3
    assert found.coverage.spacing_m == merges.SPACING_M
    both = np.bincount(found.level, minlength=2)
    assert both.min() > 10
    for level, least in ((0, spacing), (1, merges.SPACING_M)):
        own = merges.places(found)[found.level == level]
        away = merges.distances_m(own, own) + 1e9 * np.eye(len(own))
        assert away.min() >= least
    assert found.sigma_step_m == pytest.approx(0.0295)
    rows = {int(point): row for row, point in enumerate(found.point_id)}
    step = found.sigma_step_m
    for one, level in ((fine, 0), (coarse, 1)):
        for row, point in enumerate(one.point_id.tolist()):
            its = rows.get(point)
            if its is not None and found.level[its] == level:
                np.testing.assert_allclose(
                    found.sigma_major[its], one.sigma_major[row], atol=0.51 * step, rtol=1e-6
                )
    radius = search_radius_m(found, np.arange(len(found)))
    np.testing.assert_allclose(radius, 64.0 * found.gsd)


def promising(catalog: Catalog, seed: int, footprint_m: float) -> Catalog:
    """A catalogue with a promise at random places."""
    dice, shape = np.random.default_rng(seed), np.shape(catalog.condition)[1:]
    cells = (7 + seed, shape[0], shape[1], shape[2])
    points = dice.integers(0, 12, cells).astype(np.uint8)
    cause = np.where(points >= 8, Cause.MET, Cause.FEATURELESS).astype(np.uint8)
    return replace(
        catalog,
        promise=Promise(
            longitude=dice.uniform(2.0, 4.0, cells[0]), latitude=dice.uniform(25.0, 27.0, cells[0]),
            demand=np.full(cells[0], 8, np.uint8), points=points, cause=cause,
            size=np.arange(1, 5), met=np.linspace(0.2, 0.9, 4), served=np.linspace(0.2, 0.9, 4),
            places=np.array([cells[0]]), gsd=catalog.gsd[:1], per_view=np.array([8]),
            located_probability=np.zeros(1), units=np.ones(1, np.int64), located=catalogs.LOCATED,
            footprint=np.array([footprint_m]), radius=np.array([0.4 * footprint_m]),
            lower_bound=np.array([10.0 + seed]),
        ),
    )  # fmt: skip


@pytest.mark.slow
def test_promises_of_levels_are_kept_one_by_one(inputs: list[Catalog], tmp_path: Path) -> None:
    """Two levels of the same ground without common ids, then a third; one that loses points loses its
    promise.
    """
    alone = replace(inputs[0], config=merges.config(2.1, 3.9, spacing_m=1.0))  # keeps all points
    coarse = promising(alone, 1, 4e5)
    away = merges.moved(coarse, coarse.longitude + 0.011, coarse.latitude + 0.007)
    levels = [
        promising(
            replace(
                away if k == 1 else merges.moved(away, away.longitude + 0.01, away.latitude),
                **{name: getattr(away, name) / 4.0**k for name in ("gsd", "gsd_min", "gsd_max")},
                config=merges.config(2.1, 3.9, 118.0 / 4.0**k, 1.0),
            ),
            k + 1,
            4e5 / 4.0**k,
        )
        for k in (1, 2)
    ]
    a, b, c = written(tmp_path, [coarse, *levels])
    merge_catalogs([a, b], tmp_path / "two.h5")
    merge_catalogs([tmp_path / "two.h5", c], tmp_path / "m.h5")
    assert verify(tmp_path / "m.h5") == []
    found = read(tmp_path / "m.h5")
    told = found.promise
    assert told.gsd.tolist() == [118.0 / 16.0, 118.0 / 4.0, 118.0]
    assert told.footprint.tolist() == [4e5 / 16.0, 4e5 / 4.0, 4e5]
    assert told.least_points == 11.0 + 12.0 + 13.0
    for part, one in zip(told.parts(), [levels[1], levels[0], coarse], strict=True):
        for name in ("longitude", "latitude", "demand", "points", "cause"):
            expected = getattr(one.promise, name)
            np.testing.assert_array_equal(getattr(told, name)[part], expected)
    figures = kept_promise(found)
    assert figures is not None
    for level, one in zip(figures["levels"], [levels[1], levels[0], coarse], strict=True):
        assert level["kept_share"] == pytest.approx((one.promise.points >= 8).mean())
    assert figures["kept_share"] == pytest.approx((told.points >= 8).mean())
    names = [name for name, _ in promise_rows(figures)]
    assert names[:3] == ["promise, 7.375 m", "  else", "promise, 29.5 m"]
    page = render_report(found, "m.h5")
    tiles = re.findall(r"frames of \S+ km have what is promised, by cells of (\S+) m<", page)
    assert tiles == ["7.375", "29.5", "118"]
    (tmp_path / "more").mkdir()
    (d,) = written(tmp_path / "more", [promising(merges.disturbed(coarse, 2), 4, 4e5)])
    merge_catalogs([a, d], tmp_path / "lost.h5")
    lost = read(tmp_path / "lost.h5")
    kept = {int(i) for i in lost.point_id}
    assert len(lost.promise.gsd) == 2
    by_place = {float(one.promise.longitude[0]): one for one in (coarse, read(d))}
    for part in lost.promise.parts():
        one = by_place[float(lost.promise.longitude[part][0])]
        gone = [k for k, i in enumerate(one.point_id.tolist()) if i not in kept]
        seen_from = np.stack([one.promise.longitude, one.promise.latitude], axis=1)
        away = merges.distances_m(seen_from, merges.places(one)[gone])
        near = (away <= one.promise.radius[0]).sum(axis=1)[:, None, None, None]
        expected = np.maximum(one.promise.points.astype(int) - near, 0)
        assert (lost.promise.points[part] <= expected).all()
        met = lost.promise.cause[part] == Cause.MET
        np.testing.assert_array_equal(met, lost.promise.points[part] >= 8)


def test_no_sigma_is_cut_off_that_an_input_holds(inputs: list[Catalog], tmp_path: Path) -> None:
    """A coarse catalogue has sigmas beyond 65534 steps of the finer one: the step grows as far."""
    coarse = inputs[0]
    major = coarse.sigma_major.copy()
    major[0][np.isfinite(major[0])] = 5000.0
    coarse = replace(coarse, sigma_major=major)
    shrink = {name: getattr(inputs[1], name) / 4.0 for name in ("gsd", "gsd_min", "gsd_max")}
    fine = replace(inputs[1], **shrink, config=merges.config(3.2, 4.9, 29.5), sigma_step_m=None)
    merge_catalogs(written(tmp_path, [coarse, fine]), tmp_path / "m.h5")
    found = read(tmp_path / "m.h5")
    assert found.sigma_step_m == pytest.approx(5000.0 / 65534, rel=2e-5)
    row = found.point_id.tolist().index(int(coarse.point_id[0]))
    held = found.sigma_major[row]
    np.testing.assert_allclose(held[np.isfinite(held)], 5000.0, atol=0.1)


def test_nearly_equal_cells_are_one_level(
    inputs: list[Catalog], paths: list[Path], tmp_path: Path
) -> None:
    east = inputs[1]
    east = replace(
        east, gsd=1.02 * east.gsd, gsd_max=2.0 * east.gsd_max,
        config=merges.config(3.2, 4.9, 1.02 * catalogs.GSD_M),
    )  # fmt: skip
    done = merge_catalogs([paths[0], *written(tmp_path, [east], "b")], tmp_path / "m.h5")
    assert done.levels_m == ((118.0, 1.02 * 118.0),)
    found = read(tmp_path / "m.h5")
    assert (found.level == 0).all()
    away = merges.distances_m(merges.places(found), merges.places(found))
    assert (away + 1e9 * np.eye(len(found))).min() >= merges.SPACING_M


def test_a_catalogue_without_points(
    inputs: list[Catalog], paths: list[Path], tmp_path: Path
) -> None:
    none = inputs[1].take(np.zeros(0, np.int64))
    merge_catalogs([paths[0], *written(tmp_path, [none], "b")], tmp_path / "m.h5")
    assert verify(tmp_path / "m.h5") == []
    found = read(tmp_path / "m.h5")
    assert len(found) == len(merges.chosen_by_search(inputs[:1], merges.SPACING_M))
    assert found.coverage.longitude.max() > 4.5


def test_albedo_of_one_input(inputs: list[Catalog], paths: list[Path], tmp_path: Path) -> None:
    """Points of the other have none: they were tested with 1."""
    albedo = np.full(inputs[1].dem.shape, 1.25, np.float32)
    east = replace(inputs[1], albedo=albedo, albedo_map=catalogs.ALBEDO_MAP)
    merge_catalogs([paths[0], *written(tmp_path, [east], "b")], tmp_path / "m.h5")
    assert verify(tmp_path / "m.h5") == []
    found = read(tmp_path / "m.h5")
    known = np.isfinite(found.albedo).all(axis=(1, 2))
    assert known.any()
    assert not known.all()
    assert (found.albedo[known] == 1.25).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"view_azimuth": np.array([0.0, 90.0, 180.0])}, "view_azimuth"),
        (
            {"errors": catalogs.ERRORS | {"sensor_noise": 0.5}},
            "errors.sensor_noise is 0.5, not 0.02",
        ),
        ({"config": merges.config(3.2, 4.9) + "max_dependence = 0.5\n"}, "points.max_dependence"),
        ({"config": merges.config(3.2, 4.9).replace("7552.0", "9000.0")}, "points.search_m"),
        ({"config": "[points]\npatch_nodes = 9\n"}, "does not state the cell size"),
        ({"config": merges.config(3.2, 4.9, 60.0)}, "cells of 118 m"),
        ({"config": merges.config(3.2, 4.9).replace("bounds_deg", "#")}, "states no region"),
        ({"config": "merged = 3\n"}, "does not say what it was merged from"),
        ({"config": merges.config(3.2, 4.9) + "[points.more]\n"}, "configuration is invalid"),
        (
            {"config": merges.config(3.2, float("inf"))},
            r"\.h5: its configuration is invalid: longitude inf",
        ),
    ],
)
def test_what_does_not_go_together_is_one_line(
    inputs: list[Catalog], change: dict[str, Any], words: str
) -> None:
    first, other = opened(inputs[0], "a.h5"), replace(inputs[1], **change)
    with pytest.raises(CatalogError, match=words) as caught:
        merging._require_compatible(first, opened(other, "b.h5"))
    assert "\n" not in str(caught.value)


def opened(catalog: Catalog, name: str) -> merging._Input:
    itself = Origin(name, name, len(catalog), {})
    return merging._Input(name, catalog, (name,), origins(catalog.config, itself))


def test_errors_of_heights_may_differ() -> None:
    one, two = ({"height_sigma_m": sigma, "sensor_noise": 0.1} for sigma in (35.0, 20.0))
    three = two | {"height_sigma_m": [20.0, 30.0], "by_place": {"height_sigma_m": {"C": 20.0}}}
    found = merging._merged_errors([one, two, three], [{"A", "D"}, {"A", "B"}, {"C", "D", "E"}])
    figures = found.pop("by_place")
    assert found == {"height_sigma_m": [20.0, 30.0, 35.0], "sensor_noise": 0.1}
    # A: two figures; D, E: by what a point states of its DEM, in the third
    assert figures == {"height_sigma_m": {"B": 20.0, "C": 20.0}}
    assert merging._merged_errors([one, one], [{"A"}, {"A"}]) == one


def test_errors_of_places_may_differ_where_no_configuration_states_them(
    paths: list[Path], inputs: list[Catalog], tmp_path: Path
) -> None:
    """Each point of the merged catalogue has that of its own product, and positions are foreseen from it."""
    derived = {"height_length_m": 300.0, "position_sigma_m": 21.5}
    derived |= {"height_sigma_m": 12.0}
    other = replace(
        inputs[1],
        errors=inputs[1].errors | derived,
        dem_product=np.array(["OTHER"] * len(inputs[1]), object),
    )
    one = replace(inputs[0], errors=inputs[0].errors | {"position_sigma_m": 43.0})
    assert inputs[0].errors["height_length_m"] == 600.0
    merge_catalogs(written(tmp_path, [one, other], "p"), tmp_path / "m.h5")
    found = read(tmp_path / "m.h5")
    assert found.errors["position_sigma_m"] == [21.5, 43.0]
    rows = np.arange(len(found))
    mine = found.dem_product == "OTHER"
    assert 0 < mine.sum() < len(found)
    np.testing.assert_array_equal(found.place_sigma_m(rows), np.where(mine, 21.5, 43.0))
    np.testing.assert_allclose(slope_sigma(found, rows), np.where(mine, 12.0 / 300.0, 20.0 / 600.0))
    sun, view = (np.tile(direction_enu(90.0, e), (len(rows), 1)) for e in (12.0, 80.0))
    claims = predict(found, rows, sun, view, found.gsd)
    for part, catalog in ((mine, other), (~mine, one)):
        own = np.flatnonzero(np.isin(catalog.point_id, found.point_id[part]))
        own = own[np.argsort(catalog.point_id[own])]
        here = np.flatnonzero(part)[np.argsort(found.point_id[part])]
        alone = predict(catalog, own, sun[: len(own)], view[: len(own)], catalog.gsd[own])
        np.testing.assert_allclose(
            claims.detection_probability[here], alone.detection_probability, rtol=1e-6
        )
    stated = replace(other, errors=other.errors | {"position_sigma_m": 30.0})
    with pytest.raises(CatalogError, match=r"errors.position_sigma_m is 30.0, not 43.0"):
        merging._require_compatible(opened(one, "a.h5"), opened(stated, "b.h5"))


def test_different_albedo_maps(inputs: list[Catalog]) -> None:
    albedo = np.full(inputs[1].dem.shape, 1.25, np.float32)
    maps = [catalogs.ALBEDO_MAP, catalogs.ALBEDO_MAP | {"reference": 2.0}]
    both = [replace(inputs[1], albedo=albedo, albedo_map=which) for which in maps]
    with pytest.raises(CatalogError, match="albedo_map"):
        merging._require_compatible(opened(both[0], "a.h5"), opened(both[1], "b.h5"))
    # `both[0]` is of an earlier version, which does not state the pixel
    told = replace(both[0], albedo_map=maps[0] | {"pixel_m": 500.0})
    merging._require_compatible(opened(both[0], "a.h5"), opened(told, "b.h5"))


def test_other_refusals(inputs: list[Catalog], tmp_path: Path) -> None:
    (a,) = written(tmp_path, [inputs[0]])
    (tmp_path / "m.h5").write_text("mine")
    with pytest.raises(OutputExistsError):
        merge_catalogs([a, a], tmp_path / "m.h5")
    assert (tmp_path / "m.h5").read_text() == "mine"
    with pytest.raises(OutputError, match="is read, too"):
        merge_catalogs([a, a], a, overwrite=True)


@pytest.mark.slow
def test_ids_of_the_same_ground(tmp_path: Path) -> None:
    """Builds of a region and of its halves, one with two processes, and the merge of these: the same
    ground has the same ids and heights, and there are about as many points.
    """
    suns, view = SunConfig((90.0, 270.0), (10.0, 30.0)), ViewConfig((0.0,), (0.0,), (np.inf,))
    for name, west, east, jobs in (("all", 2.3, 4.7, 1), ("w", 2.3, 3.5, 1), ("e", 3.5, 4.7, 2)):
        area = AreaConfig(bounds_deg=(west, 25.0, east, 27.0), gsd_m=474.0)
        config = replace(CONFIG, area=area, sun=suns, view=view)
        BuildRun(Build.plan([DEM], config), tmp_path / f"{name}.h5", jobs=jobs).whole()
    merge_catalogs([tmp_path / "w.h5", tmp_path / "e.h5"], tmp_path / "m.h5")
    whole, *others = (read(tmp_path / f"{name}.h5") for name in ("all", "w", "e", "m"))
    for found in others:
        assert_ids_of_places(found)
        _, rows, its = np.intersect1d(whole.point_id, found.point_id, return_indices=True)
        assert len(rows) > 0.5 * len(found)  # the greedy choice depends on the region
        away = merges.distances_m(merges.places(whole), merges.places(found))
        assert np.count_nonzero(away < 60.0) == len(rows)
        np.testing.assert_array_equal(whole.longitude[rows], found.longitude[its])
        np.testing.assert_array_equal(whole.latitude[rows], found.latitude[its])
        np.testing.assert_array_equal(whole.dem[rows], found.dem[its])
    assert len(found) == pytest.approx(len(whole), rel=0.1)


def assert_ids_of_places(catalog: Catalog) -> None:
    """By the rule of the catalogue's page, in plain Python."""
    for point, lon, lat in zip(
        *(getattr(catalog, n).tolist() for n in ("point_id", "longitude", "latitude")), strict=True
    ):
        row = int((lat + 90.0) * 1000.0)
        columns = round(360_000 * np.cos(np.radians((row + 0.5) / 1000.0 - 90.0)))
        assert point == (row + 1) * 2**20 + int(lon / 360.0 * columns)
