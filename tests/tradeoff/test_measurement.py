"""``measure_trade``: from a build to the document, the page and the files."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.catalogs import HADLEY
from helpers.pages import in_browser, measured, parsed
from helpers.trades import CONFIG, candidates, cratered_dem, faulty

from lcp_catalog.accuracy import TIERS
from lcp_catalog.errors import ConfigError, OutputError, OutputExistsError
from lcp_catalog.production.area_job import Candidates
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig
from lcp_catalog.production.run import Build
from lcp_catalog.tradeoff import image_errors, knob_table, measurement, report
from lcp_catalog.tradeoff.measurement import TimedArea, Trade, measure_trade, spread

CONTRACT = {
    "accuracy",
    "seconds",
    "memory_mb",
    "sunlit_error_share",
    "radiance_rmse",
    "points_lost",
    "points_gained",
    "conditions_changed_share",
}


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return Build.plan((cratered_dem(tmp_path_factory.mktemp("dem")),), CONFIG)


@pytest.fixture(scope="module")
def trade(build: Build) -> Trade:
    """With a draft tier that is wrong at one node in ten; in this process."""
    patch = pytest.MonkeyPatch()
    faulty(patch, lambda azimuth, dark: np.random.default_rng(5).random(dark.shape) < 0.1)
    try:
        return measure_trade(build, areas=2, rounds=1, isolated=False)
    finally:
        patch.undo()


def test_suns_that_never_occur_are_not_said_to_be_compared() -> None:
    """At 26 deg of latitude the Sun is at most 90 - 26 + 1.6 deg high, which is nearer to 60 than to 85 deg."""
    area = AreaConfig(center_deg=(3.5, 26.0), size_km=30.0, gsd_m=474.0)
    sun = SunConfig((90.0, 180.0), (10.0, 30.0, 60.0, 85.0))
    build = Build.plan([HADLEY], BuildConfig(area=area, sun=sun))
    compared = measurement._compared(build, list(build.jobs), 1, True)
    assert compared["sun_elevations_deg"] == [10.0, 30.0, 60.0]
    assert "Sun directions, elevations 10 to 60°" in report.compared_line(compared, [])


@pytest.mark.slow
def test_a_wrong_tier_changes_points_and_the_others_do_not(trade: Trade) -> None:
    rows = {row["accuracy"]: row for row in trade.tiers}
    assert list(rows) == ["draft", "standard", "high", "reference"]
    for tier in ("standard", "high", "reference"):
        found = rows[tier]
        nothing = (
            "sunlit_error_share",
            "radiance_rmse",
            "points_lost",
            "points_gained",
            "points_moved",
            "conditions_changed_share",
            "detection_changed_share",
            "detection_change_max",
        )
        assert [found[name] for name in nothing] == [0.0] * len(nothing)
        assert found["localization_sigma_change_m"] == {"median": 0.0, "p95": 0.0}
        assert found["points"] == rows["reference"]["points"] > 0
    wrong = rows["draft"]
    assert wrong["sunlit_error_share"] > 0.06
    assert wrong["points_lost"] > 0
    assert wrong["points"] == rows["reference"]["points"] - wrong["points_lost"] + wrong["points_gained"]  # fmt: skip


def test_the_document_is_the_contracts(trade: Trade) -> None:
    document = json.loads(json.dumps(trade.document(), allow_nan=False))
    for row in document["tiers"]:
        assert set(row) >= CONTRACT
        assert row["seconds"] > 0.0
        assert row["memory_mb"] is None  # not measured in one process
        assert row["bound"] == TIERS[row["accuracy"]].node_error
    assert document["tiers"][-1]["seconds_relative"] == 1.0
    compared = document["compared"]
    assert (compared["areas"], compared["rounds"], compared["threads"]) == (2, 1, 1)
    assert compared["areas_of"] >= 4
    assert compared["suns"] == [4]
    assert compared["dems"] == ["craters.tif"]


def test_seconds_are_medians_and_tiers_take_turns(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock with known readings: the warm-up does not count, and each round begins with another
    tier.
    """
    calls: list[tuple[str, str]] = []
    empty = Candidates(*candidates([], []))

    def stand_in(job: Any) -> Any:
        tier = job.recipe.config.model.accuracy
        calls.append((job.task.name, tier))
        seen = calls.count(calls[-1])
        warm = 1000.0 if len(calls) <= len(TIERS) else 0.0
        seconds = warm + (2.0 if tier == "draft" else 4.0) * (9.0 if seen == 3 else 1.0)
        return TimedArea(seconds, seconds / 2.0, empty, 1.0, float(len(calls)))

    monkeypatch.setattr(measurement, "timed_area", stand_in)
    monkeypatch.setattr(measurement, "_images", lambda *_: [])
    trade = measure_trade(build, areas=2, rounds=3, isolated=False)
    assert (trade.compared["areas"], trade.compared["rounds"]) == (2, 3)
    rows = trade.tiers
    assert [row["seconds"] for row in rows] == [4.0, 8.0, 8.0, 8.0]
    assert [row["cpu_seconds"] for row in rows] == [2.0, 4.0, 4.0, 4.0]
    assert [row["seconds_relative"] for row in rows] == [0.5, 1.0, 1.0, 1.0]
    firsts = [tier for _, tier in calls[4::8]]
    assert firsts == ["draft", "standard", "high"]


def test_the_time_limit_ends_areas_and_then_rounds(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that a run of a tier sets forward by 1 s, images by 4 s: 20 s for the first area with its untimed runs, 8 s for
    every other one, 8 s for another round of two areas.
    """
    clock = [0.0]
    empty = Candidates(*candidates([], []))

    def run(job: Any) -> Any:
        clock[0] += 1.0
        return TimedArea(1.0, 1.0, empty, 1.0, 1.0)

    def images(*_: Any) -> list[Any]:
        clock[0] += 12.0 if clock[0] == 0.0 else 4.0
        return []

    monkeypatch.setattr(measurement, "timed_area", run)
    monkeypatch.setattr(measurement, "_images", images)
    monkeypatch.setattr(measurement, "compare_models", lambda job: image_errors.ModelChanges())
    monkeypatch.setattr(measurement.time, "monotonic", lambda: clock[0])

    def done(limit_s: float, areas: int = 2) -> tuple[int, int, list[str]]:
        clock[0] = 0.0
        found = measure_trade(build, areas, 3, isolated=False, limit_s=limit_s)
        took = found.compared
        assert len(took["area_names"]) == took["areas"]
        assert [row["cpu_seconds"] for row in found.tiers] == [took["areas"]] * len(TIERS)
        return took["areas"], took["rounds"], list(found.not_measured)

    areas, rounds = "accuracy tiers, 1 of 2 areas", "accuracy tiers, {} of 3 rounds"
    assert done(0.0) == (1, 1, [areas, rounds.format(2)])
    assert done(27.0) == (1, 2, [areas, rounds.format(1)])
    assert done(28.0) == (2, 1, [rounds.format(2)])
    assert done(36.0) == (2, 2, [rounds.format(1)])
    assert done(44.0) == (2, 3, [])
    assert done(36.0, 3) == (3, 1, [rounds.format(2)])


def test_counts_below_one_are_refused(build: Build) -> None:
    with pytest.raises(ConfigError, match="at least 1"):
        measure_trade(build, areas=0)
    with pytest.raises(ConfigError, match="at least 1"):
        measure_trade(build, rounds=0)


def test_areas_are_spread(build: Build) -> None:
    everything = spread(build, len(build.jobs))
    assert sorted(everything) == list(range(len(build.jobs)))
    assert spread(build, 3) == everything[:3]


def test_the_middle_comes_first_then_what_is_far_away_and_slivers_only_for_all() -> None:
    """Five areas on the equator around 2.1 E; the middle one is cut to a tenth."""
    tasks = [
        (SimpleNamespace(lon_deg=lon, lat_deg=0.0), 10 * rows)
        for lon, rows in ((0.0, 10), (1.0, 10), (2.0, 1), (3.0, 10), (4.5, 10))
    ]
    region = SimpleNamespace(lon_deg=2.1, lat_deg=0.0)
    jobs = [SimpleNamespace(task=task, nodes=nodes) for task, nodes in tasks]
    recipe = SimpleNamespace(region=region)
    of_these = SimpleNamespace(jobs=jobs, recipe=recipe)
    assert spread(of_these, 5) == [3, 0, 4, 1, 2]
    assert spread(of_these, 4) == spread(of_these, 9) == [3, 0, 4, 1]


def test_the_page_needs_nothing_but_itself(trade: Trade) -> None:
    html = report.render_trade(trade)
    page = parsed(html)
    assert not re.search(r"url\(|@import|https?://|<link|<script|<iframe", html)
    assert len(page.addresses) == len(TIERS)
    assert all(address.startswith("data:image/png;base64,") for address in page.addresses)
    assert page.counts["circle"] == 2 * len(TIERS)
    assert page.counts["tr"] == len(report.COLUMNS) + 1 + len(trade.models.rows())
    assert f"2 of {trade.compared['areas_of']} areas" in html
    assert "craters.tif" in html
    text = (
        r"\.pareto { min-width: (\d+)px.*font-size: (\d+)px",
        r'chart pareto" viewBox="\S+ \S+ (\d+) ',
    )
    (least, size), (wide,) = (map(int, re.search(one, html).groups()) for one in text)
    assert (
        size * least / wide >= 11.0
    )  # pixels of the text on a narrow screen, where the chart scrolls
    assert str(Path.home()) not in html
    assert "nan" not in re.sub(r"base64,[^'\"]*", "", html).lower().split()


def test_what_the_columns_mean_is_a_list_below_the_table(trade: Trade) -> None:
    """On the page and in the text; without an alternative neither the list nor a chart of one mark."""
    own = {
        "knob": "", "value": "as configured", "configured": "", "default": True, "areas": 1, "areas_of": 1,
        "seconds_relative": 1.0, "seconds_interval": [0.9, 1.1], "conditions_changed_share": 0.0, "interval": None,
        "points": 3, "points_lost": 0, "points_gained": 0, "usable_ratio": 1.0, "usable_interval": None,
        "detection_change_mean": 0.0, "detection_change_max": 0.0, "build_seconds": 5.0, "memory_mb": 300.0, "bytes": 1e5,
        "sigma_ratio": 1.0, "shift_cells": None, "sunlit_error_share": None, "promise_change": None,
    }  # fmt: skip
    other = own | {"knob": "dependence", "value": "0", "seconds_relative": 0.5}
    both, alone = (dataclasses.replace(trade, rows=rows) for rows in ([own, other], [own]))
    said = [
        re.sub("<.*?>", "", one) for one in re.findall("<li>.*?</li>", report.render_trade(both))
    ]
    assert [one for one in said if one in knob_table.KNOBS_EXPLAINED] == [
        *knob_table.KNOBS_EXPLAINED
    ]
    assert len(knob_table.KNOBS_EXPLAINED) == 7
    assert {f"- {one}" for one in knob_table.KNOBS_EXPLAINED} < {
        *report.markdown(both).splitlines()
    }
    assert "The large mark is your configuration" in report.render_trade(both)
    page = report.render_trade(alone)
    assert "0 alternatives measured" in page
    assert "The large mark" not in page
    assert knob_table.KNOBS_EXPLAINED[0] not in page


@in_browser
@pytest.mark.slow
@pytest.mark.parametrize("width", [800, 1280])
def test_no_table_is_wider_than_the_page(trade: Trade, width: int, tmp_path: Path) -> None:
    """With texts as long as those of the sample."""
    row = {
        "knob": "search at half resolution first", "value": "0.2 of a correlation", "configured": "0.3 of a correlation",
        "default": False, "areas": 2, "areas_of": 67, "seconds_relative": 14.64, "seconds_interval": [10.36, 20.03],
        "conditions_changed_share": 0.258, "interval": [0.19, 0.345], "points": 127, "points_lost": 117, "points_gained": 116,
        "usable_ratio": 1.54, "usable_interval": [1.16, 1.92], "detection_change_mean": 7.1e-5, "detection_change_max": 0.39,
        "build_seconds": 196.0, "memory_mb": 400.0, "bytes": 14.47e6, "sigma_ratio": 0.738, "shift_cells": 0.0044,
        "sunlit_error_share": 0.0077, "promise_change": -0.012,
    }  # fmt: skip
    own = row | {"knob": "", "default": True, "value": "as configured", "configured": ""}
    page = report.render_trade(dataclasses.replace(trade, rows=[own, row]))
    assert page.count("overflow-x: auto") == 2
    found = measured(page.replace("overflow-x: auto", "overflow: visible"), width, tmp_path)
    assert found["wide"] == 0
    assert found["texts"] > 200


def test_the_range_of_one_run_is_not_said(trade: Trade) -> None:
    assert report._around("0.54", "0.54") == ""
    assert report._around("0.50", "0.54") == " (0.50..0.54)"


def test_the_table_has_a_column_a_tier(trade: Trade) -> None:
    text = report.markdown(trade)
    tiers, _, laws = text.partition("\n## ")
    table = [line for line in tiers.splitlines() if line.startswith("|")]
    assert len(table) == len(report.COLUMNS) + 1
    assert len([line for line in laws.splitlines() if line.startswith("|")]) == 2 + len(
        trade.models.rows()
    )
    assert {line.count("|") for line in table} == {len(TIERS) + 2}


def test_files_are_written_and_not_overwritten(trade: Trade, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    report.write_trade(trade, folder)
    assert sorted(p.name for p in folder.iterdir()) == sorted(report.FILES)
    written = json.loads((folder / "trade.json").read_text())
    assert written["advice"] == report.advice(trade.tiers)
    with pytest.raises(OutputExistsError, match="`overwrite`"):
        report.write_trade(trade, folder)
    (folder / "best.toml").touch()  # of a run before, with a budget
    report.write_trade(trade, folder, overwrite=True)
    assert not (folder / "best.toml").exists()
    with pytest.raises(OutputError, match="not a folder"):
        report.write_trade(trade, folder / "trade.json", overwrite=True)
    with pytest.raises(OutputError, match="does not exist"):
        report.write_trade(trade, tmp_path / "no" / "where")
