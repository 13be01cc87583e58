"""The rows of all approximations within a limit of time, and the configuration for a budget of time or of error, confirmed by
its own measurement on more areas.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import Any

from ..approximations import APPROXIMATIONS
from ..errors import AreaFailedError, ConfigError
from ..production.executor import processes
from ..production.run import Build
from ..stages import Steps
from .knob_rows import Written, row_of, rows_of
from .knobs import Measurement, Sample, Setting, Started, for_budget, settings
from .measurement import Budget, Trade, spread
from .proposal import (
    SAVING,
    is_clear,
    keeps_enough,
    proposal,
    relative,
    require_one,
    saves,
    scatter_of,
    scattered,
    together,
    together_row,
)

WORKERS = 2
"""Processes that compute alternatives."""

LIMIT_S, TIERS_SHARE = 180.0, 0.5
"""Default limit of the time, seconds, and the share of it that tiers may take."""

_TRIES = 4


def measure_all(
    found: Trade,
    build: Build,
    areas: int | None,
    budget: Budget,
    until: float,
    workers: int = WORKERS,
    steps: Steps | None = None,
) -> Trade:
    """A measurement with the rows of all approximations, on ``areas`` areas (None: all), and the configuration for the
    budget. ``until``: time of `time.monotonic` after which no other alternative is begun. ConfigError for an impossible
    budget; otherwise errors as an area's.
    """
    require_one(budget.seconds, budget.error)
    with processes(workers) if workers else nullcontext() as pool:
        started = Started(workers, pool)
        return _measured(found, build, areas, budget, until, started, steps or Steps())


def _measured(
    found: Trade,
    build: Build,
    areas: int | None,
    budget: Budget,
    until: float,
    workers: Started,
    steps: Steps,
) -> Trade:
    """`measure_all` with processes that have started."""
    config = build.recipe.config.replaced({"model.reflectance": build.recipe.law.model.name})
    chosen = [build.jobs[i] for i in spread(build, areas or len(build.jobs))]
    sample, own = Sample(build, config, chosen), Setting("", "as configured", {})
    steps.begin(1)
    sample.start_s(build.levels[0])
    steps.one()
    begun = time.monotonic()
    first_runs = [
        outcome
        for _, outcome in Measurement(sample, workers, math.inf, steps=steps).outcomes([own, own])
    ]
    if isinstance(first_runs[0], str) or isinstance(first_runs[1], str):
        raise AreaFailedError(str(first_runs[0]))
    usual, baseline_s = first_runs[0], [one.cpu_s for one in first_runs if not isinstance(one, str)]
    setting_s = min(baseline_s) / max(1, workers.number)
    whole = Written.of(usual.level, sample) if areas is None else None
    first = row_of(own, usual, usual) | (whole.beside(whole) if whole else {})
    asked = budget.seconds is not None or budget.error is not None
    left_s = until - time.monotonic()
    # of the least confirmation: both configurations on as many areas, as these two runs were
    least_s = 1.5 * (time.monotonic() - begun)
    # on CONFIRMED areas and then on twice as many, of both configurations
    most_s = 6.0 * CONFIRMED * setting_s / len(chosen) + 2.0 * _START_S
    pairs_s = _PAIRED * 2.0 * PAIRS * setting_s + _START_S
    kept_s = min(max(least_s, most_s) + pairs_s, left_s / 2.0) if asked else 0.0
    measured = Measurement(sample, workers, until - kept_s, setting_s)
    wanted, finer = settings(config), (budget.seconds or 0.0) >= first["build_seconds"]
    if asked:
        wanted = for_budget(wanted, finer)
    done: list[tuple[Setting, dict[str, Any]]] = []
    missing = dict(found.not_measured)
    if whole and whole.kept_share is None:
        missing["change of the promise"] = (
            "this build promises nothing (`points.spacing_m`, or `points.per_view` 0)"
        )
    between = _between(wanted, own)
    steps.begin(len(between))
    for setting, row in rows_of(measured, usual, between, whole):
        steps.one()
        if not setting.knob:
            baseline_s += [] if isinstance(row, str) else [row["seconds"]]
        elif isinstance(row, str):
            missing[f"{setting.knob}, {setting.value}"] = row
        else:
            done.append((setting, row))
    missing |= {one.name: one.unpriced for one in APPROXIMATIONS if one.unpriced}
    relative([first, *(row for _, row in done)], baseline_s)
    found = replace(found, rows=[first, *(row for _, row in done)], not_measured=missing)
    if not asked:
        return found
    spent_s = sum(baseline_s) + sum(row["seconds"] for _, row in done)
    pace = (time.monotonic() - begun) / spent_s  # wall time for a second of processor time
    area_s = pace * first["seconds"] / len(chosen)
    scatter = scatter_of(baseline_s)
    confirmation = Confirmation(sample, len(chosen), workers, until, area_s, scatter, steps)
    best, best_row = _best(confirmation, done, first, budget)
    tried = [setting for setting, _ in done]
    untried = sum(one.turned and one.finer == finer and one not in tried for one in wanted)
    return replace(
        found,
        best=config.replaced(best.values),
        best_row=best_row,
        budget=budget,
        untried=untried,
    )


BASELINE_EVERY = 10
"""Alternatives between two runs of the configuration itself."""

PAIRS, _PAIRED = 2, 3
"""Runs, at most, of an alternative that an answer takes, each beside one of the configuration: all must save time; and the
number of such alternatives for which time is kept.
"""

_START_S = 5.0
"""Time in which processes start and load kernels."""


def _between(wanted: list[Setting], own: Setting) -> list[Setting]:
    """The settings with the configuration itself between them and as the last."""
    found: list[Setting] = []
    for first in range(0, len(wanted), BASELINE_EVERY):
        found += [*wanted[first : first + BASELINE_EVERY], own]
    return found


def _best(
    confirmation: Confirmation,
    done: list[tuple[Setting, dict[str, Any]]],
    first: dict[str, Any],
    budget: Budget,
) -> tuple[Setting, dict[str, Any]]:
    """The configuration for a budget and its row. What would be taken to save time is measured again beside the configuration
    first, and left out if it does not (``unconfirmed``). Taken back, the last setting first, is what exceeds the error, or the
    time with finer settings, what saves none together, and what together keeps too few places and points, though each keeps enough.
    """
    left, unsure = list(done), []
    finer = (budget.seconds or 0.0) >= first["build_seconds"]
    for turn in range(_TRIES + 1):
        taken = proposal(left if turn < _TRIES else [], first, budget.seconds, budget.error)
        while new := [
            one for one in left if one[0] in taken and "pairs" not in one[1] and not finer
        ]:
            confirmation.again(new, first)
            unsure += [f"{one.knob}: {one.value}" for one, row in new if not saves(row, 0.0)]
            taken = proposal(left, first, budget.seconds, budget.error)
        rows = [row for setting, row in left if setting in taken]
        best = together(taken)
        told = together_row(first, rows)
        best_row = confirmation.row(best, told)
        if budget.error is not None:
            kept = (best_row["conditions_changed_share"] or 0.0) <= budget.error
        else:
            kept = not any(s.finer for s in taken) or best_row["build_seconds"] <= budget.seconds
        faster = finer or best_row["seconds_relative"] < 1.0 - SAVING
        if not taken or (kept and faster and keeps_enough(best_row)):
            break
        left = [one for one in left if one[0] != taken[-1]]
    found = {"finer": any(one.finer for one in taken), "unconfirmed": unsure}
    return best, best_row | found


CONFIRMED, CLOSE = 32, 0.15
"""Least number of areas, where the build has them, on which the configuration for a budget is measured; and how far below its error
the interval may begin, as a share of it (the scatter of areas alone; none for an error of 0), before twice as many are taken, as
they are where what its points are worth is not clear (`is_clear`)."""


@dataclass(frozen=True)
class Confirmation:
    """Measures the configuration for a budget, on more areas than those on which it was chosen: a few areas say what saves
    most, but their mean error is as uncertain as it is large. ``until``: no areas are begun that would be done after it, by
    ``area_s``, the time of an area of the user's configuration; ``scatter``: of its runs (`scatter_of`); ``steps``: counts
    the areas.
    """

    sample: Sample
    least: int
    workers: Started
    until: float
    area_s: float
    scatter: Sequence[float] = (1.0, 1.0)
    steps: Steps = field(default_factory=Steps)

    def fits(self, count: int, relative: float) -> bool:
        """True if ``count`` areas of both configurations are done before the end."""
        start_s = _START_S if self.workers.number else 0.0
        return time.monotonic() + count * self.area_s * (1.0 + relative) + start_s <= self.until

    def again(self, some: Sequence[tuple[Setting, dict[str, Any]]], usual: dict[str, Any]) -> None:
        """Measure settings `PAIRS` times more, each beside the configuration area by area, and set the times of their rows by that;
        once where there is no time for more, and of those for which there is none ``pairs`` is 0.
        """
        fit: list[tuple[Setting, dict[str, Any]]] = []
        wanted: list[Setting] = []
        areas, count = 0.5 * len(self.sample.jobs), 0.0
        every = sum(areas * (1.0 + row["seconds_relative"]) for _, row in some)
        turns = PAIRS if self.fits(PAIRS * every, 1.0) else 1
        for setting, row in some:
            count += turns * areas * (1.0 + row["seconds_relative"])
            row["pairs"] = turns if self.fits(count, 1.0) else 0
            if not row["pairs"]:
                continue
            for pair in range(turns):
                name = f"{len(fit)} {pair}"
                both = [Setting("", "", {}, configured=name), replace(setting, configured=name)]
                wanted += both[:: 1 - 2 * (pair % 2)]  # what comes first comes last then
            fit.append((setting, row))
        measured = self._in_turn(self.sample)
        areas_s = {
            (one.configured, one.knob == ""): outcome.areas_s()[0]
            for one, outcome in measured.outcomes(wanted)
            if not isinstance(outcome, str)
        }
        own_s = usual["build_seconds"] - usual["build_start_seconds"]
        for k, (_, row) in enumerate(fit):
            start_s = row["build_start_seconds"]
            pairs = [areas_s[f"{k} {n}", False] / areas_s[f"{k} {n}", True] for n in range(turns)]
            mean = sum(pairs) / turns
            row |= {
                "seconds": usual["seconds"] * mean,
                "seconds_relative": mean,
                "seconds_interval": [min(pairs), max(pairs)],
                "build_interval": row["build_interval"]
                and [
                    (one - start_s) * mean / row["seconds_relative"] + start_s
                    for one in row["build_interval"]
                ],
                "build_seconds": own_s * mean + start_s,
            }

    def row(self, best: Setting, told: dict[str, Any]) -> dict[str, Any]:
        """The row of the configuration; ``told``, what its settings say together, where there is no time for any
        measurement. ConfigError for settings that exclude each other.
        """
        count, row = max(CONFIRMED, self.least), None
        while count > self.least and not self.fits(count, told["seconds_relative"]):
            count = max(self.least, count // 2)
        while self.fits(min(count, len(self.sample.build.jobs)), told["seconds_relative"]):
            row = self._of(best, count)
            around, share = row["interval"], row["conditions_changed_share"] or 0.0
            close = around is None or not share or share - around[0] <= CLOSE * share
            if (close and is_clear(row)) or row["areas"] == len(self.sample.build.jobs):
                break
            count *= 2
        return row or told

    def _in_turn(self, sample: Sample) -> Measurement:
        self.steps.begin()
        return Measurement(sample, self.workers, math.inf, in_turn=True, steps=self.steps)

    def _of(self, best: Setting, count: int) -> dict[str, Any]:
        build, own = self.sample.build, Setting("", "as configured", {})
        jobs = [build.jobs[i] for i in spread(build, min(count, len(build.jobs)))]
        sample = Sample(build, self.sample.config, jobs, self.sample.starts)
        measured = self._in_turn(sample)
        found = {one.knob: outcome for one, outcome in measured.outcomes([own, best])}
        usual, outcome = found[own.knob], found[best.knob]
        if isinstance(usual, str) or isinstance(outcome, str):
            raise ConfigError(str(outcome))
        row = row_of(best, usual, outcome)
        return row | {"build_interval": scattered(row["build_interval"], self.scatter)}
