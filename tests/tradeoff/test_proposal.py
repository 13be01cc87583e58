"""What a budget of time or of error takes of the alternatives, by their rows."""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.trades import CONFIG, cratered_dem

from lcp_catalog.approximations import APPROXIMATIONS
from lcp_catalog.errors import ConfigError
from lcp_catalog.production.area_job import run_area
from lcp_catalog.production.run import Build
from lcp_catalog.tradeoff import (
    confirmation,
    knobs,
)
from lcp_catalog.tradeoff.knobs import Setting, Started
from lcp_catalog.tradeoff.measurement import Budget
from lcp_catalog.tradeoff.proposal import (
    keeps_enough,
    proposal,
    require_one,
    together_row,
)


def _row(relative: float, error: float) -> dict[str, Any]:
    return {
        "seconds_relative": relative,
        "conditions_changed_share": error,
        "seconds_interval": [relative, relative],
        "matched_share": 1.0,
        "usable_ratio": 1.0,
        "usable_interval": None,
        "points": 28,
        "points_lost": 0,
        "points_gained": 0,
        "detection_change_max": error,
        "bytes": 1000,
        "memory_mb": 300.0,
        "build_seconds": 100.0,
        "build_start_seconds": 2.0,
        "build_interval": [90.0, 110.0],
        "build_jobs": 1,
    }


def test_a_budget_takes_what_saves_most_for_its_error() -> None:
    rows = [
        (Setting("a", "1", {}, True), _row(0.5, 0.01)),
        (Setting("a", "2", {}, True), _row(0.4, 0.2)),
        (Setting("b", "1", {}, True), _row(0.9, 0.001)),
        (Setting("c", "not the same catalogue", {}, False), _row(0.1, 0.0)),
        (Setting("d", "slower", {}, True), _row(2.0, 0.05)),
    ]
    usual = _row(1.0, 0.0)

    def taken(budget_s: float | None, error: float | None) -> list[str]:
        return [one.knob + one.value for one in proposal(rows, usual, budget_s, error)]

    assert taken(95.0, None) == ["b1"]
    assert taken(50.0, None) == ["b1", "a1"]
    assert taken(None, 0.005) == ["b1"]
    assert taken(None, 0.02) == ["b1", "a1"]
    assert taken(None, 0.0) == []
    assert taken(250.0, None) == taken(100.0, None) == []
    # a start that no setting shortens
    assert taken(1.0, None) == taken(2.0, None) == ["b1", "a1"]
    # few places evaluated, many other points, which are worth as much
    two = _row(0.7, 0.0) | {"matched_share": 0.28, "points_lost": 15, "points_gained": 15}
    rows.append((Setting("passes", "2", {}, True), two))
    assert taken(None, 0.0) == ["passes2"]
    two["usable_ratio"] = 0.9
    assert taken(None, 0.0) == []
    # what runs of the configuration itself differ by is no saving
    usual["seconds_interval"] = [0.9, 1.05]
    assert taken(None, 1.0) == ["a1"]
    assert taken(95.0, None) == ["a1"]


def test_a_budget_above_the_time_takes_finer_settings() -> None:
    """Those that change most for their time, one of an approximation, while they fit; nothing coarser, nothing without effect."""
    finer = {"turned": True, "finer": True}
    rows = [
        (Setting("a", "1", {}, **finer), _row(1.5, 0.01)),
        (Setting("a", "2", {}, **finer), _row(1.5, 0.02)),
        (Setting("b", "1", {}, **finer), _row(1.4, 0.04)),
        (Setting("c", "coarse", {}, True), _row(0.5, 0.1)),
        (Setting("d", "dear", {}, **finer), _row(30.0, 0.1)),
        (Setting("e", "free", {}, **finer), _row(1.0, 0.001)),
        (Setting("f", "equal", {}, **finer), _row(1.0, 0.0)),
        (Setting("g", "other", {}, finer=True), _row(1.0, 0.5)),
    ]

    def taken(budget_s: float) -> list[str]:
        found = proposal(rows, _row(1.0, 0.0), budget_s, None)
        return [one.knob + one.value for one in found]

    assert taken(100.0) == ["efree"]
    assert taken(145.0) == ["b1", "efree"]
    assert taken(155.0) == ["b1", "efree"]  # for a2 there is no time left
    assert taken(210.0) == ["b1", "a2", "efree"]
    assert taken(1e4) == ["b1", "a2", "efree", "ddear"]


def test_finer_settings_are_known() -> None:
    """By the registry: what leaves less out than the defaults, and no other."""
    config = CONFIG.replaced(
        {"model.reflectance": "lommel-seeliger:rolo", "model.ring_max_km": 400.0}
    )
    finer = {(one.knob, one.value) for one in knobs.settings(config) if one.finer}
    assert {knob for knob, _ in finer} == {one.name for one in APPROXIMATIONS if one.fineness} - {
        "far terrain",  # whose alternatives are nearer
        "two passes",  # the default is one
    }
    assert {value for knob, value in finer if knob == "accuracy tier"} == {"high", "reference"}
    assert {value for knob, value in finer if knob == "rounding of height errors"} == {
        "0.01 of the value"
    }
    assert ("search at half resolution first", "full resolution") in finer
    assert {one.turned for one in knobs.settings(config) if one.finer} == {True}


def test_a_budget_measures_first_what_it_may_take() -> None:
    """For less time or an error the coarser alternatives, what saves most on the sample first; for more time the finer ones."""
    config = CONFIG.replaced({"points.image_scales": 2, "model.ring_max_km": 400.0})
    wanted = knobs.settings(config)
    coarser, finer = (knobs.for_budget(wanted, finer) for finer in (False, True))
    assert {id(one) for one in coarser} == {id(one) for one in finer} == {id(one) for one in wanted}
    for order, is_finer in ((coarser, False), (finer, True)):
        may = [one.turned and one.finer == is_finer for one in order]
        assert may == sorted(may, reverse=True)
        assert 5 < sum(may) < len(may)
    saved = [one.on_sample for one in coarser if one.turned and not one.finer]
    assert saved == sorted(saved)
    assert ("two passes", 0.69) in [(one.knob, one.on_sample) for one in coarser[:4]]


def test_what_together_keeps_too_little_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two alternatives whose points are worth as much each, and less together: the second is left out."""
    rows = [
        (
            Setting("a", "1", {"points.rivals": 12}, True),
            _row(0.5, 0.001) | {"knob": "a", "value": "1"},
        ),
        (
            Setting("b", "1", {"points.error_step": 0.4}, True),
            _row(0.6, 0.01) | {"knob": "b", "value": "1"},
        ),
    ]

    class Told:
        def again(self, some: list[tuple[Setting, dict[str, Any]]], usual: dict[str, Any]) -> None:
            for _, row in some:
                row["pairs"] = 2

        def row(self, best: Setting, told: dict[str, Any]) -> dict[str, Any]:
            both = len(best.values) == 2
            return told | ({"usable_ratio": 0.9} if both else {})

    usual = _row(1.0, 0.0) | {"seconds": 1.0}
    best, row = confirmation._best(Told(), rows, usual, Budget(error=0.05))
    assert best.value == "a: 1"
    assert row["usable_ratio"] == 1.0
    monkeypatch.setattr(Told, "row", lambda self, best, told: told)
    assert confirmation._best(Told(), rows, usual, Budget(error=0.05))[0].value == "a: 1; b: 1"
    for worth in (0.9, None):  # too little, or not known, as that of two passes
        rows[1][1]["usable_ratio"] = worth
        assert confirmation._best(Told(), rows, usual, Budget(error=0.05))[0].value == "a: 1"


def test_a_saving_that_is_not_found_again_is_not_taken() -> None:
    """Of three that one run said to save time the second does not in every pair of runs, and for the third there was no time."""
    rows = [
        (Setting(knob, "1", {}, True), _row(0.7, 0.01) | {"knob": knob, "value": "1"})
        for knob in "abc"
    ]
    found = {"a": (2, 0.8, 0.9), "b": (2, 0.6, 1.02), "c": (0, 0.7, 0.7)}

    class Again:
        calls = 0

        def again(self, some: list[tuple[Setting, dict[str, Any]]], usual: dict[str, Any]) -> None:
            self.calls += 1
            for setting, row in some:
                pairs, *interval = found[setting.knob]
                row |= {"pairs": pairs, "seconds_interval": interval}

        def row(self, best: Setting, told: dict[str, Any]) -> dict[str, Any]:
            return told

    usual, again = _row(1.0, 0.0) | {"seconds": 1.0}, Again()
    best, row = confirmation._best(again, rows, usual, Budget(error=0.05))
    assert best.value == "a: 1"
    assert (row["unconfirmed"], again.calls) == (["b: 1", "c: 1"], 1)
    slower = {"seconds_relative": 1.0}  # together, on more areas
    again.row = lambda best, told: told | (slower if best.values is not None and best.value else {})
    best, row = confirmation._best(again, rows, usual, Budget(error=0.05))
    assert best.value == ""


def test_a_saving_is_measured_beside_the_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twice for each, area by area, by processor times that are given: 0.5 and 0.6 s for an alternative where the configuration
    takes 1 s.
    """
    build = Build.plan((cratered_dem(tmp_path),), CONFIG)
    sample = knobs.Sample(build, build.recipe.config, build.jobs[:2])
    confirm = confirmation.Confirmation(sample, 2, Started(), math.inf, 0.0)
    settings = [Setting(str(k), "1", {"points.rivals": 60 + k}, True) for k in range(2)]
    asked: list[int] = []

    def runs(jobs: Any, usual: Any, areas: int) -> list[knobs._Run]:
        rivals = jobs[0].recipe.config.points.rivals
        asked.append(rivals)
        spent = {60: 0.5, 61: 0.6}.get(rivals, 1.0) * jobs[0].work
        return [knobs._Run(spent, 1.0, finished.candidates, None, np.empty(0))]

    finished = run_area(build.jobs[0])
    monkeypatch.setattr(knobs, "_runs", runs)
    some = [(setting, _row(0.4, 0.01)) for setting in settings]
    confirm.again(some, _row(1.0, 0.0) | {"seconds": 1.0})
    own = build.recipe.config.points.rivals
    assert asked == 2 * [own, 60, 60, own, own, 61, 61, own]
    for (_, row), expected in zip(some, (0.5, 0.6), strict=True):
        assert row["pairs"] == 2
        assert row["seconds_interval"] == pytest.approx([expected, expected])
        assert row["build_seconds"] == pytest.approx(2.0 + 98.0 * expected)
        # of a row of 0.4 of the time
        around = [2.0 + expected / 0.4 * areas_s for areas_s in (88.0, 108.0)]
        assert row["build_interval"] == pytest.approx(around)
    # for one pair alone: 2 areas by 1 + 0.4 of the time of one
    asked.clear()
    once = dataclasses.replace(confirm, until=time.monotonic() + 100.0, area_s=30.0)
    once.again(some[:1], _row(1.0, 0.0) | {"seconds": 1.0})
    assert (asked, some[0][1]["pairs"]) == (2 * [own, 60], 1)
    late = [(settings[0], _row(0.4, 0.01))]
    dataclasses.replace(confirm, until=0.0).again(late, _row(1.0, 0.0))
    assert late[0][1]["pairs"] == 0


def test_what_was_not_measured_together_is_said_by_the_rows() -> None:
    """No more points are lost than there are; what is usable multiplies, so that too little is seen without a confirmation."""
    one, two = (
        _row(0.5, 0.01) | {"points_lost": lost, "points_gained": 12, "usable_ratio": 0.96} | named
        for lost, named in ((20, {"knob": "a", "value": "1"}), (10, {"knob": "b", "value": "2"}))
    )
    told = together_row(_row(1.0, 0.0) | {"seconds": 1.0}, [one, two])
    assert (told["points_lost"], told["points_gained"], told["points"]) == (28, 24, 24)
    two["build_start_seconds"] = 5.0  # two passes start processes more often
    late = together_row(_row(1.0, 0.0) | {"seconds": 1.0}, [one, two])
    assert late["build_seconds"] == pytest.approx(98.0 * 0.25 + 5.0)
    assert told["usable_ratio"] == pytest.approx(0.9216)
    assert not keeps_enough(told)
    assert (told["detection_change_max"], told["detection_change_mean"]) == (0.01, None)


@pytest.mark.parametrize(
    "given",
    [
        (1.0, 0.1, 9.0),
        (0.0, None, 9.0),
        (None, 2.0, 9.0),
        (1.0, None, 0.0),
        (None, None, -1.0),
        *(
            (one, other, limit)
            for one, other, limit in [
                (math.nan, None, 9.0),
                (None, math.nan, 9.0),
                (None, None, math.nan),
            ]
        ),
    ],
)
def test_an_impossible_budget_is_refused(given: tuple[float | None, float | None, float]) -> None:
    with pytest.raises(ConfigError):
        require_one(*given)


@pytest.mark.parametrize(
    ("share", "low", "counts"),
    [
        (0.02, 0.0172, [32]),
        (0.02, 0.0168, [32, 64, 128, 256]),  # more than 15 % below: twice as many, up to all
        (0.0, 0.0, [32]),  # nothing changes
    ],
)
def test_the_confirmation_ends_where_its_areas_scatter_little(
    share: float, low: float, counts: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However far the interval goes up, for areas that may be like none measured."""
    taken: list[int] = []

    def row(self: confirmation.Confirmation, best: knobs.Setting, count: int) -> dict[str, Any]:
        taken.append(count)
        around = {"interval": [low, share + 0.01], "conditions_changed_share": share}
        return around | {"usable_interval": None, "areas": min(count, 200)}

    monkeypatch.setattr(confirmation.Confirmation, "_of", row)
    sample: Any = SimpleNamespace(build=SimpleNamespace(jobs=[None] * 200))
    confirm = confirmation.Confirmation(sample, 4, knobs.Started(), math.inf, 0.0)
    confirm.row(knobs.Setting("", "", {}), {"seconds_relative": 1.0})
    assert taken == counts
