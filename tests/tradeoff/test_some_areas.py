"""Rows of alternatives on some areas of a sample: slow ones on fewer, and how well some areas tell what points are worth."""

from __future__ import annotations

import dataclasses
import math
import time
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.trades import CONFIG, cratered_dem

from lcp_catalog.production.run import Build
from lcp_catalog.production.sweep import law_of_build
from lcp_catalog.tradeoff import knob_rows, knob_table, knobs
from lcp_catalog.tradeoff.knobs import Setting, Started
from lcp_catalog.tradeoff.proposal import is_clear


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    return Build.plan((cratered_dem(tmp_path_factory.mktemp("dem")),), CONFIG)


@pytest.mark.slow
def test_a_slow_alternative_is_computed_on_as_many_areas_as_there_is_time_for(
    build: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two areas of 10 s each there is time for one: its row is that of a sample of this area alone, and says so."""
    every = knobs.Sample(build, build.recipe.config, list(build.jobs))
    own = Setting("", "", {})
    ten_s = 1.0 + 10.0 * len(build.jobs)
    slow = Setting("dependence", "0", {"points.max_dependence": 0.0}, slower=(ten_s, ten_s))
    # the clock of this module alone stands still: processes that start wait by theirs
    monkeypatch.setattr(
        knobs, "time", SimpleNamespace(monotonic=lambda: 0.0, process_time=time.process_time)
    )

    def row(sample: knobs.Sample, setting: Setting, until: float) -> dict[str, Any]:
        measured = knobs.Measurement(sample, Started(), until, setting_s=1.0)
        usual, found = (outcome for _, outcome in measured.outcomes([own, setting]))
        assert isinstance(usual, knobs.Outcome)
        if isinstance(found, str):
            return {"why": found}
        return knob_rows.row_of(setting, usual, found)

    some, alone = (
        row(every, slow, 15.0),
        row(every.first(1), dataclasses.replace(slow, slower=(1.0, 1.0)), 15.0),
    )
    assert (some["areas"], some["areas_of"], some["interval"]) == (1, len(build.jobs), None)
    assert some["usable_ratio"] is None  # of fewer areas than other rows
    for name in (
        "points",
        "points_lost",
        "points_gained",
        "conditions_changed_share",
        "bytes",
    ):
        assert some[name] == alone[name], name
    assert knob_table._value(some) == f"0, on 1 of {len(build.jobs)} areas"
    assert knob_table._value(alone) == "0"
    assert row(every, slow, 10.0 * len(build.jobs))["areas"] == len(build.jobs)
    unsure = dataclasses.replace(
        slow, slower=(2.0, ten_s)
    )  # by the least it took there is time for one
    assert row(every, unsure, 9.0)["areas"] == 1
    other = dataclasses.replace(slow, values={"area.gsd_m": 600.0})  # other areas
    for setting, until in ((slow, 9.0), (other, 15.0)):
        assert "beyond the time limit" in row(every, setting, until)["why"]


@pytest.mark.slow
def test_an_interval_is_of_the_whole_build(build: Build) -> None:
    """Areas that were not sampled may change more; where all were, nothing is left to be known."""
    settings = [Setting("", "", {}), Setting("dependence", "0", {"points.max_dependence": 0.0})]
    ends = {}
    for count in (2, len(build.jobs)):
        some = knobs.Sample(build, build.recipe.config, list(build.jobs[:count]))
        measured = knobs.Measurement(some, Started(), math.inf).outcomes(settings)
        usual, found = (outcome for _, outcome in measured)
        row = knob_rows.row_of(settings[1], usual, found)
        low, high = row["interval"]
        assert low <= row["conditions_changed_share"] <= high
        ends[row["areas"]] = high - row["conditions_changed_share"]
    assert ends[2] > 0.01
    assert ends[len(build.jobs)] == pytest.approx(0.0, abs=1e-12)


def test_the_worth_of_points_has_the_interval_of_its_areas() -> None:
    """An interval that holds 0.95 inside is not clear; one that ends there, or none, is."""
    row = _with_worth((0.90, 1.0))
    assert not is_clear(row)
    assert knob_table._worth(row) == "0.96 (0.90 to 1.00)"
    own = {"usable_ratio": 1.0, "usable_interval": (0.3, 1.7), "default": True}
    assert knob_table._worth(own) == "1.00"  # the configuration beside itself
    assert [is_clear(_with_worth(one)) for one in ((0.5, 0.9), (0.95, 1.2), None)] == [True] * 3
    assert knob_table._worth(_with_worth(None)) == "0.96"


def _with_worth(around: tuple[float, float] | None) -> dict[str, Any]:
    return {"usable_ratio": 0.96, "usable_interval": around}


@pytest.mark.slow
def test_the_known_law_is_that_of_the_configuration(build: Build) -> None:
    """A level whose Suns, views and model are the configuration's takes its law; any other chooses its own, as a build does."""
    sample = knobs.Sample(build, build.recipe.config, list(build.jobs))
    for values in (
        {"points.rivals": 12},
        {"sun.elevations_deg": (70.0, 80.0)},
        {"model.accuracy": "draft"},
    ):
        found = sample.level_of(values).recipe.law
        config = sample.config.replaced(values)
        assert found == law_of_build(config, build.recipe.region.lat_deg)
        assert (found is sample.law) == ("points.rivals" in values)
