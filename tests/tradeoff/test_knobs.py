"""Every approximation on a user's build: rows that count what is different, and the configuration for a budget; their intervals:
test_knob_intervals.py."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.trades import CONFIG, cratered_dem

from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.catalog.promise import kept_promise
from lcp_catalog.catalog.schema import EVALUATED, UNOCCLUDED, UNSHADOWED, USABLE, evaluated, usable
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.production.area_job import run_area
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.public import build_catalog
from lcp_catalog.production.run import Build
from lcp_catalog.stages import Steps
from lcp_catalog.tradeoff import (
    charts,
    confirmation,
    knob_rows,
    knob_table,
    knobs,
    measurement,
    report,
)
from lcp_catalog.tradeoff.confirmation import measure_all
from lcp_catalog.tradeoff.image_errors import ModelChanges
from lcp_catalog.tradeoff.knobs import Setting, Started, window_shifts
from lcp_catalog.tradeoff.measurement import Budget, Trade
from lcp_catalog.tradeoff.point_changes import joined, usable_shares
from lcp_catalog.tradeoff.proposal import relative

EMPTY = Trade([], {}, None, ModelChanges())

STEPS: list[tuple[int, int]] = []
"""Steps done, and of how many, as `found` told them."""

CONTRACT = {
    *("knob", "value", "default", "accuracy", "seconds", "memory_mb", "bytes"),
    *("sunlit_error_share", "radiance_rmse", "points_lost", "points_gained"),
    *("conditions_changed_share", "detection_change_mean", "detection_change_max"),
    *("sigma_ratio", "shift_cells", "promise_change", "interval"),
}

SOME = [
    Setting("dependence", "0", {"points.max_dependence": 0.0}, True),
    Setting("same", "same", {"points.rivals": 64}, True),
    Setting(
        "views",
        "one",
        {
            "view.off_nadir_deg": (30.0,),
            "view.azimuth_deg": (90.0,),
            "view.altitude_km": (math.inf,),
        },
    ),
    Setting("direction", "0.35", {"model.direction_tolerance_deg": 0.35}, True),
    Setting("Sun", "disc", {"model.sun": "disc"}, True, True),
    Setting("impossible", "cell", {"area.gsd_m": 0.001}),
]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return Build.plan((cratered_dem(tmp_path_factory.mktemp("dem")),), CONFIG)


@pytest.fixture(scope="module")
def found(build: Build) -> Trade:
    patch = pytest.MonkeyPatch()
    patch.setattr(confirmation, "settings", lambda config: SOME)
    try:
        steps = Steps(lambda done, of: STEPS.append((done, of)))
        return measure_all(EMPTY, build, 2, Budget(error=1.0), math.inf, workers=0, steps=steps)
    finally:
        patch.undo()


def test_the_confirmation_is_counted_as_it_goes(found: Trade, build: Build) -> None:
    """Area by area of both configurations after the last alternative, beside the start, both first runs and every alternative."""
    row = found.best_row
    assert row is not None
    done = [k for k, _ in STEPS]
    assert done == sorted(done)
    assert all(k <= n for k, n in STEPS)
    assert STEPS[-1] == (done[-1], done[-1])
    before = 1 + 2 * 2 + len(SOME) + 1
    assert before in done
    assert done[-1] - before >= 2 * row["areas"] > 0


@pytest.mark.slow
def test_rows_are_the_contracts_and_count_what_changes(found: Trade, build: Build) -> None:
    rows = {row["knob"]: row for row in json.loads(json.dumps(found.document()))["rows"]}
    assert all(set(row) >= CONTRACT for row in rows.values())
    assert [row["default"] for row in rows.values()] == [True, *[False] * (len(rows) - 1)]
    for name in ("", "same"):
        row = rows[name]
        assert row["conditions_changed_share"] == row["detection_change_max"] == 0.0
        assert row["points_lost"] == row["points_gained"] == 0
        assert row["sigma_ratio"] == 1.0
    # independently: without any dependence a usable condition stays so if no shadow falls into the patch
    changed = judged = 0
    for k in measurement.spread(build, 2):
        own = run_area(build.jobs[k]).candidates.evaluation
        works = usable(own.condition)
        cast = (own.shadow_dependence > 0.0) | (own.occlusion_dependence > 0.0)
        changed += int((works & cast).sum())
        judged += int(evaluated(own.condition).sum())
        assert (own.condition & UNSHADOWED).any()
    assert rows["dependence"]["conditions_changed_share"] == pytest.approx(changed / judged)
    assert changed > 0
    for row in rows.values():
        for value, *around in (
            ("usable_ratio", "usable_interval"),
            ("conditions_changed_share", "interval", "elsewhere"),
            ("build_seconds", "build_interval"),
        ):
            limits = [limit for name in around for limit in row[name] or ()]
            assert all(
                low <= row[value] <= high
                for low, high in zip(limits[::2], limits[1::2], strict=True)
            )
        assert row["build_seconds"] > row["build_start_seconds"] > 0.0
    # areas of another size have other borders, which two of them do not tell
    untold = {name for name, row in rows.items() if row["usable_ratio"] is None}
    assert untold == {name for name, row in rows.items() if row["usable_interval"] is None}
    assert untold == {"direction"}


def test_the_views_between_are_in_reach_of_those_of_the_build() -> None:
    (views,) = (one for one in APPROXIMATIONS if one.name.startswith("views"))
    for own in ((0.0,), (0.0, *[50.0] * 4)):
        sides = (0.0, *np.arange(len(own) - 1) * 90.0)
        usual = BuildConfig().replaced(
            {"area.gsd_m": 118.0, "view.off_nadir_deg": own, "view.azimuth_deg": sides, "view.altitude_km": (math.inf,) * len(own)}
        )  # fmt: skip
        (more,) = (change for name, change in views.values(usual).items() if name.startswith("and"))
        assert knob_rows._of_views(usual.replaced(more).view, usual.view).any(axis=1).all()


@pytest.mark.slow
def test_conditions_that_are_no_longer_stated_count_as_changed(found: Trade, build: Build) -> None:
    """One of two views 30 deg apart is left: the other's usable conditions are lost."""
    (row,) = (row for row in found.rows if row["knob"] == "views")
    lost = judged = 0
    for k in measurement.spread(build, 2):
        condition = run_area(build.jobs[k]).candidates.evaluation.condition
        lost += int(usable(condition)[:, 1].sum())
        judged += int(evaluated(condition).sum())
    assert row["matched_share"] == 1.0 or row["matched_share"] > 0.5
    if row["matched_share"] == 1.0:
        assert row["conditions_changed_share"] == pytest.approx(lost / judged)


def test_claims_for_coarser_pixels_are_compared(
    monkeypatch: pytest.MonkeyPatch, build: Build
) -> None:
    """With one image scale of two those of the second are lost, the others stay."""
    one = Setting("image scales", "1", {"points.image_scales": 1})
    monkeypatch.setattr(confirmation, "settings", lambda config: [one])
    trade = measure_all(EMPTY, build, 1, Budget(error=1.0), math.inf, workers=0)
    (row,) = (row for row in trade.rows if row["knob"] == "image scales")
    (k,) = measurement.spread(build, 1)
    own = run_area(build.jobs[k]).candidates.evaluation
    stated = evaluated(own.condition)[:, None] & np.isfinite(own.detection)
    both = UNSHADOWED | UNOCCLUDED
    works = stated & (own.detection >= 0.9) & ((own.condition & both) == both)[:, None]
    assert stated.shape[1] == 2
    assert works[:, 1].any()
    assert row["conditions_changed_share"] == pytest.approx(works[:, 1].sum() / stated.sum())


def test_other_areas_cover_the_same_ground(found: Trade) -> None:
    (row,) = (row for row in found.rows if row["knob"] == "direction")
    assert row["matched_share"] > 0.3
    assert row["seconds_relative"] > 1.2  # more areas, each with its halo


def test_all_of_a_build_is_all_of_its_other_areas(build: Build) -> None:
    """Also of those that the region's border cuts, whose boxes reach beyond it; and none of their neighbours."""
    config = build.recipe.config
    every = knobs.Sample(build, config, list(build.jobs))
    for values in (
        {"model.direction_tolerance_deg": 1.4},
        {"model.direction_tolerance_deg": 0.35},
        {"area.gsd_m": 0.5 * config.gsd_m},
    ):
        level = every.level_of(values)
        parts = every.parts(level)
        assert [share for _, share, _ in parts] == [1.0] * len(level.jobs)
        one = knobs.Sample(build, config, build.jobs[:1])
        rest = knobs.Sample(build, config, build.jobs[1:])
        shares = [{j.task: s for j, s, _ in some.parts(level)} for some in (one, rest)]
        assert all(
            shares[0].get(j.task, 0.0) + shares[1].get(j.task, 0.0) == pytest.approx(1.0)
            for j in level.jobs
        )
    assert len(one.parts(level)) == 1  # cells of the same areas


def test_a_disc_shifts_windows_by_little(found: Trade) -> None:
    (row,) = (row for row in found.rows if row["knob"] == "Sun")
    assert 0.0 < row["shift_cells"] < 0.1
    assert row["sunlit_error_share"] > 0.0


def test_what_is_not_measured_is_named(
    found: Trade, build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    unpriced = {one.name for one in APPROXIMATIONS if one.unpriced}
    assert set(found.not_measured) == unpriced | {"impossible, cell"}
    monkeypatch.setattr(confirmation, "settings", lambda config: SOME[:2])
    late = measure_all(EMPTY, build, 1, Budget(), 0.0, workers=0)
    assert len(late.rows) == 1
    assert late.not_measured["same, same"] == "the time limit was reached"
    names = [*late.not_measured]  # what there was no time for is named before what has no switch
    assert names.index("same, same") < min(names.index(name) for name in unpriced)
    count = len(names) - len(unpriced)
    assert (
        knob_table.knobs_said(late)[0]
        == f"0 alternatives measured, {count} not measured (listed below)."
    )
    assert late.rows[0]["interval"] is None  # one area


@pytest.mark.slow
def test_all_areas_state_the_promise_and_the_size_of_the_file(
    build: Build,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Of the files that `lcp build-catalog` writes; a build without a promise says so."""
    dense = Setting("patch", "9", {"points.patch_nodes": 9})
    monkeypatch.setattr(confirmation, "settings", lambda config: [dense])
    trade = measure_all(EMPTY, build, None, Budget(), math.inf, workers=0)
    assert "promise is kept" not in caplog.text  # of a file that nobody sees
    dem = build.recipe.dems.dems[0].path
    kept, sizes = [], []
    for k, config in enumerate((CONFIG, CONFIG.replaced(dense.values))):
        build_catalog(dem, tmp_path / f"{k}.h5", config=config)
        told = kept_promise(open_catalog(tmp_path / f"{k}.h5"))
        assert told is not None
        kept.append(told["kept_share"])
        sizes.append((tmp_path / f"{k}.h5").stat().st_size)
    assert [row["promise_change"] for row in trade.rows] == [0.0, pytest.approx(kept[1] - kept[0])]
    assert kept[1] != kept[0]
    assert [row["bytes"] for row in trade.rows] == pytest.approx(sizes, rel=0.01)
    spaced = Build.plan((dem,), CONFIG.replaced({"points.spacing_m": 8000.0}))
    monkeypatch.setattr(confirmation, "settings", lambda config: [])
    none = measure_all(EMPTY, spaced, None, Budget(), math.inf, workers=0)
    assert none.rows[0]["promise_change"] is None
    assert "promises nothing" in none.not_measured["change of the promise"]


@pytest.mark.slow
def test_the_configuration_for_a_budget_is_measured_on_more_areas(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On all of this small build, where its error is that of the whole; of time as for all areas."""
    few = Setting("dependence", "0", {"points.max_dependence": 0.0}, True)
    monkeypatch.setattr(confirmation, "settings", lambda config: [few])
    monkeypatch.setattr(confirmation, "proposal", lambda *_: [few])
    chosen = measure_all(EMPTY, build, 1, Budget(seconds=1.0), math.inf, workers=0)
    every = measure_all(EMPTY, build, None, Budget(), math.inf, workers=0)
    assert chosen.best_row is not None
    assert chosen.best_row["areas"] == len(build.jobs) > 1
    share = [row["conditions_changed_share"] for row in (chosen.best_row, every.rows[1])]
    assert share[0] == share[1] != chosen.rows[1]["conditions_changed_share"]


def test_the_configuration_is_read_again(found: Trade, tmp_path: Path) -> None:
    assert found.best is not None
    assert found.best_row is not None
    folder = tmp_path / "t"
    folder.mkdir()
    (folder / "best.toml").write_text(report._from(folder, found.best))
    read = BuildConfig.from_toml(folder / "best.toml")
    assert read.points == found.best.points
    assert found.best_row["knob"] == "together"
    table = "\n".join(knob_table.knobs_markdown(found))
    assert "your configuration" in table
    gone = f"lost, {found.best_row['points_gained']} gained"
    assert (gone in table) == bool(found.best_row["value"])
    assert "impossible, cell" in table
    assert not charts.knobs_chart([found.rows[0] | {"conditions_changed_share": None}])
    assert str(charts.knobs_chart(found.rows)).count("<circle") == sum(
        row["conditions_changed_share"] is not None for row in found.rows
    )


def test_times_are_over_the_median_of_runs_between(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    around = [80.0 + 2.0, 99.0 + 2.0]
    rows = [
        {
            "default": True,
            "seconds": 9.0,
            "build_seconds": 90.0 + 2.0,
            "build_start_seconds": 2.0,
            "build_interval": around,
        },
        {
            "default": False,
            "seconds": 11.0,
            "build_seconds": 115.0,
            "build_start_seconds": 5.0,
            "build_interval": None,
        },
    ]
    relative(rows, [9.0, 10.0, 12.5])
    assert rows[0]["seconds_relative"] == 1.0
    assert rows[0]["build_seconds"] == pytest.approx(100.0 + 2.0)
    # the start was run once, too: runs of 9 to 12.5 s where the median is 10
    assert rows[0]["build_interval"] == pytest.approx(
        [0.9 * (80.0 / 0.9 + 2.0), 1.25 * (99.0 / 0.9 + 2.0)]
    )
    assert rows[1]["build_interval"] is None
    assert rows[0]["seconds_interval"] == [0.8, pytest.approx(10.0 / 9.0)]
    assert rows[1]["seconds_relative"] == 1.1
    # it was run once: its own run scatters as those of the configuration do, too
    assert rows[1]["seconds_interval"] == pytest.approx([0.9 * 11.0 / 12.5, 1.25 * 11.0 / 9.0])
    asked: list[str] = []
    original = knobs.Measurement.outcomes

    def watched(self: Any, wanted: Any) -> Any:
        asked.extend(one.knob for one in wanted)
        return original(self, wanted)

    monkeypatch.setattr(confirmation, "settings", lambda config: SOME[:2])
    monkeypatch.setattr(confirmation, "BASELINE_EVERY", 1)
    monkeypatch.setattr(confirmation.Measurement, "outcomes", watched)
    found = measure_all(EMPTY, build, 1, Budget(), math.inf, workers=0)
    assert asked == ["", "", "dependence", "", "same", ""]
    assert [row["knob"] for row in found.rows] == ["", "dependence", "same"]
    low, high = found.rows[0]["seconds_interval"]
    assert low <= 1.0 <= high


@pytest.mark.slow
def test_the_time_limit_holds_for_the_confirmation_and_slow_rows(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fewer areas, or none: then the rows' product and sum are told; what takes longer than is left is not begun."""
    few = Setting("dependence", "0", {"points.max_dependence": 0.0}, True)
    told = {"seconds_relative": 1.0, "areas": 0}
    sample = knobs.Sample(build, build.recipe.config, build.jobs[:1])

    def areas(area_s: float) -> int:
        until = time.monotonic() + 100.0
        confirm = confirmation.Confirmation(sample, 1, Started(), until, area_s)
        return int(confirm.row(few, told)["areas"])

    assert len(build.jobs) > 2
    assert [areas(area_s) for area_s in (0.0, 20.0, 45.0, 1000.0)] == [len(build.jobs), 2, 1, 0]
    slow = Setting("slow", "on", {"points.rivals": 12}, slower=(1e9, 1e9))
    monkeypatch.setattr(confirmation, "settings", lambda config: [few, slow])
    until = time.monotonic() + 1000.0
    found = measure_all(EMPTY, build, 1, Budget(), until, workers=0)
    assert [row["knob"] for row in found.rows] == ["", "dependence"]
    assert "beyond the time limit" in found.not_measured["slow, on"]
    late = measure_all(EMPTY, build, 1, Budget(seconds=1.0), 0.0, workers=0)
    assert late.best_row is not None
    assert (late.best_row["areas"], late.best_row["seconds_relative"]) == (0, 1.0)
    assert "your configuration as it is, " in knob_table.knobs_said(late)[-1]
    some = dataclasses.replace(late, best_row=late.best_row | {"value": "dependence: 0"})
    assert "for want of time" in " ".join(knob_table.knobs_said(some))


@pytest.mark.parametrize("changes", [{}, {"points.image_scales": 2, "points.passes": 2}])
def test_every_number_has_its_unit(changes: dict[str, Any]) -> None:
    config = CONFIG.replaced({"model.ring_max_km": 400.0, **changes})
    found = {(one.knob, one.value): one.configured for one in knobs.settings(config)}
    assert not [value for _, value in found if not any(letter.isalpha() for letter in value)]
    assert found["one direction per area", "1.4 deg"] == "0.7 deg"
    assert found["cell size", "948 m"] == "474 m"
    assert found["far terrain", "30 km"] == "400 km"
    assert found["candidates per cell", "1 a cell"] == "2 a cell"
    assert found["searched again near the limit", "0 of a probability"] == ""
    assert found["accuracy tier", "draft"] == ""
    if changes:
        assert found["image scales", "1 scale"] == "2 scales"
        assert found["two passes", "1 pass"] == "2 passes"


def test_the_chart_marks_the_users_configuration_and_the_one_to_take(found: Trade) -> None:
    assert found.best_row is not None
    best = found.best_row | {"value": "a: 1", "conditions_changed_share": 0.02}
    for own, told in ((None, 0), (best, 1), (best | {"value": ""}, 0)):
        drawn = str(charts.knobs_chart(found.rows, own))
        assert drawn.count("<circle class='own'") == 1
        assert drawn.count(">your configuration</text>") == 1
        assert drawn.count("<circle class='taken'") == drawn.count(">to take</text>") == told


@pytest.mark.slow
def test_two_passes_choose_among_all_areas(build: Build, tmp_path: Path) -> None:
    """As many points, worth as much, as in the file of a build in two passes, and no place is lost where areas meet."""
    dem = build.recipe.dems.dems[0].path
    config = CONFIG.replaced({"points.spacing_m": 8000.0, "points.passes": 2})
    whole = Build.plan((dem,), config)
    every = knobs.Sample(whole, whole.recipe.config, list(whole.jobs))
    one_pass = Setting("two passes", "1", {"points.passes": 1})
    both = [Setting("", "", {}), one_pass]
    two, one = (found for _, found in knobs.Measurement(every, Started(), math.inf).outcomes(both))
    assert isinstance(two, knobs.Outcome)
    assert isinstance(one, knobs.Outcome)
    row = knob_rows.row_of(one_pass, two, one)
    worth = []
    for passes, outcome in ((2, two), (1, one)):
        path = tmp_path / f"{passes}.h5"
        build_catalog(dem, path, config=config.replaced({"points.passes": passes}))
        stored = open_catalog(path).condition
        axes = (1, 2, 3)
        worth.append(float((usable(stored).sum(axes) / evaluated(stored).sum(axes)).sum()))
        assert len(outcome.chosen) == len(stored)
        shares = usable_shares(outcome.candidates, outcome.chosen)
        assert shares.sum() == pytest.approx(worth[-1])
    assert len(two.candidates) < 0.6 * len(one.candidates)
    assert row["usable_ratio"] == pytest.approx(worth[1] / worth[0])


def test_what_to_take_says_what_holds_where(found: Trade) -> None:
    """Of this scene, of such ground and of other ground, each for itself; what was not tried is counted."""
    assert found.best_row is not None
    row = found.best_row | {
        "value": "a: 1", "areas": 14, "interval": [0.01, 0.03], "elsewhere": [0.005, 0.035],
        "conditions_changed_share": 0.02, "finer": False, "unconfirmed": [],
        "usable_interval": [0.96, 1.0],
    }  # fmt: skip
    some = dataclasses.replace(found, best_row=row, budget=Budget(error=0.05), untried=2)
    said = knob_table.best_said(some)
    assert said[0].startswith("2 alternatives that this answer could take were not measured")
    assert said[1] == "To take (best.toml): a: 1."
    assert said[2].startswith("On this scene, measured together on 14 areas: ")
    assert "2 % (1 to 3 %) of the conditions changed" in said[2]
    assert (
        "such ground with these Suns 0.5 % to 3.5 % of the conditions change (90 % interval)"
        in said[3]
    )
    assert said[4].startswith(
        "On other ground up to 3 times as much changed where it was compared (6 %)"
    )
    told = json.loads(json.dumps(some.document()))["best"]
    assert (told["elsewhere"], told["other_ground"]) == ([0.005, 0.035], [0.0, pytest.approx(0.06)])
    unclear = dataclasses.replace(some, best_row=row | {"usable_interval": [0.9, 1.0]})
    assert knob_table.best_said(unclear)[3].startswith(
        "Whether its points are worth 0.95 so few do"
    )
    ended = "No condition changes on these areas, so that no more were measured"
    for areas, share, most, told_so in (
        (14, 0.0, 0.01, True),
        (14, 0.02, 0.03, False),
        (67, 0.0, 0.0, False),
        (0, 0.0, 0.01, False),
    ):
        other = {"areas": areas, "interval": [0.0, most], "conditions_changed_share": share}
        of = knob_table.best_said(dataclasses.replace(some, best_row=row | other))
        assert told_so == any(one.startswith(ended) for one in of)
    alone = dataclasses.replace(some, best_row=row | {"elsewhere": None, "areas": 0})
    assert knob_table.best_said(alone)[-1] == said[4]
    for other in ({"finer": True}, {"conditions_changed_share": 0.004}, {"elsewhere": [0.0, 0.07]}):
        unknown = dataclasses.replace(some, best_row=row | other)
        assert unknown.document()["best"]["other_ground"] is None
        assert "other ground this does not say: measure there" in knob_table.best_said(unknown)[-1]
    assert knob_table.knobs_said(some)[1:] == said
    late = dataclasses.replace(some, budget=Budget(seconds=0.1))
    assert knob_table.best_said(late)[0].startswith("The budget of 0.1 s is not reached")
    assert "Without its areas a build takes" in knob_table.best_said(late)[0]
    none = dataclasses.replace(some, best_row=row | {"value": ""}, untried=0)
    (only,) = knob_table.best_said(none)
    assert (
        "nothing measured saves time for certain, changes at most 5 % and keeps what the points are worth"
        in only
    )
    assert knob_table.best_said(dataclasses.replace(some, best_row=None)) == []


def test_the_worth_of_points_is_their_usable_share(found: Trade, build: Build) -> None:
    """Counted point by point: without any dependence nothing else changes than what a shadow falls into."""
    areas = [run_area(build.jobs[k]).candidates for k in measurement.spread(build, 2)]
    some = joined(areas)
    rows = np.array([0, 3, 4])
    worth = 0.0
    for one in some.evaluation.condition[rows]:
        flags = [flag for flag in one.ravel() if flag & EVALUATED]
        worth += sum(flag & USABLE == USABLE for flag in flags) / max(1, len(flags))
    assert usable_shares(some, rows).sum() == pytest.approx(worth)
    assert 0.0 < worth < 3.0
    assert found.rows[0]["usable_ratio"] == 1.0


def test_names_in_the_chart_cover_nothing() -> None:
    """Crowded marks: all have a name, none lies on another or on a mark; each begins at the end of its line."""
    rng = np.random.default_rng(4)
    marks = [(float(x), float(y)) for x, y in rng.uniform((200, 100), (420, 300), (40, 2))]
    named = [(f"approximation {k}: some value", marks[k]) for k in range(12)]
    texts = [str(one) for one in charts._names(named, marks)]
    assert len(texts) == 12
    beside = 0
    form = r"x='([\d.]+)' y='([\d.]+)' text-anchor='(\w+)'>(.+)</text>"
    boxes = []
    for text in texts:
        found = re.search(form, text)
        assert found
        x, y, wide = float(found[1]), float(found[2]), 6.8 * len(found[4])
        own = dict(named)[found[4]]
        line = re.search(r"d='M(\S+) (\S+)L(\S+) (\S+)'", text)
        assert line
        begins, ends = np.array(line.groups(), float).reshape(2, 2)
        assert begins == pytest.approx(own, abs=0.06)
        assert ends == pytest.approx((x, y - 4.0), abs=0.11)
        beside += abs(y - 4.0 - own[1]) < 0.11
        assert 0.0 <= y - 11.0 < y + 3.0 <= 460.0
        left = x if found[3] == "start" else x - wide
        assert (left > own[0]) == (found[3] == "start")
        boxes.append((left, y - 10.0, left + wide, y + 2.0))
    for k, (left, top, right, bottom) in enumerate(boxes):
        assert not any(
            left < x + 3.9 and x - 3.9 < right and top < y + 3.9 and y - 3.9 < bottom
            for x, y in marks
        )
        assert all(
            right <= b[0] + 0.2 or b[2] <= left + 0.2 or bottom <= b[1] + 0.2 or b[3] <= top + 0.2
            for b in boxes[:k]
        )
    assert 0 < beside < 12
    assert charts._names([("x" * 200, (400.0, 200.0))], []) == []


@pytest.mark.parametrize("shift", [0.0, 0.02, 0.1])
def test_shifts_of_windows_are_those_of_the_image(shift: float) -> None:
    """A sum of waves, moved exactly, under another gain and offset."""
    rng = np.random.default_rng(2)
    waves = [(rng.uniform(-0.5, 0.5, 2), rng.uniform(0.0, 6.3)) for _ in range(12)]

    def image(east: float) -> np.ndarray:
        y, x = np.mgrid[:70, :70].astype(float)
        each = [np.sin(k[0] * (x - east) + k[1] * y + at) for k, at in waves]
        return np.asarray(5.0 + np.sum(each, axis=0))

    found = window_shifts(image(0.0), 1.7 * image(shift) + 0.3, 33)
    assert found == pytest.approx(np.full(4, shift), abs=0.06 * shift + 1e-9)


def test_weights_are_linear_and_turn_around() -> None:
    given = (0.0, 90.0, 180.0, 270.0)
    wanted = (0.0, 22.5, 315.0)
    np.testing.assert_allclose(
        knob_rows._along(wanted, given, 360.0),
        [[1.0, 0.0, 0.0, 0.0], [0.75, 0.25, 0.0, 0.0], [0.5, 0.0, 0.0, 0.5]],
    )
    heights = knob_rows._along((5.0, 7.0, 90.0, 2.0), (5.0, 10.0, 30.0), None)
    values = np.array([1.0, 3.0, 7.0])
    np.testing.assert_allclose(
        heights @ values, [1.0, np.interp(7.0, (5, 10, 30), values), 0.0, 0.0]
    )
