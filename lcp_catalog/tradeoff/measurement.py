"""Measurement of time and errors of each accuracy tier against ``reference`` on a user's own build.

Each tier computes the same areas in a process of its own with one thread. The tiers take turns area
by area, so that changes in the machine's speed affect all of them. The images are compared
separately, on terrain that is made once.

Areas computed in processes of their own, with their time and memory.
"""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..accuracy import DEFAULT_TIER, TIERS
from ..approximations import APPROXIMATIONS
from ..errors import AreaFailedError, ConfigError
from ..geometry.frames import lonlat_to_mcmf
from ..memory import peak_mb
from ..production.area_job import AreaJob, Candidates, run_area
from ..production.config import BuildConfig
from ..production.executor import children_start, processes
from ..production.run import Build
from ..threads import limit_threads
from .image_errors import (
    REFERENCE,
    ErrorPicture,
    ImageChanges,
    ModelChanges,
    compare_images,
    compare_models,
)
from .knobs import (
    Measurement,
    Sample,
    Setting,
    Written,
    for_budget,
    row_of,
    settings,
)
from .point_changes import compare_points, joined
from .proposal import (
    keeps_enough,
    other_ground,
    proposal,
    relative,
    require_one,
    together,
    together_row,
)


@dataclass(frozen=True)
class TimedArea:
    """Candidates of an area, their wall and CPU time, and the peak memory of the process before and
    after, MB.
    """

    seconds: float
    cpu_seconds: float
    candidates: Candidates
    before_mb: float
    peak_mb: float


def timed_area(job: AreaJob) -> TimedArea:
    """Run `area_job.run_area` on one thread and measure wall time and CPU time; other load on the
    machine affects CPU time less.
    """
    before_mb = peak_mb()
    with limit_threads(1):
        wall, own = time.perf_counter(), time.process_time()
        result = run_area(job)
        wall, own = time.perf_counter() - wall, time.process_time() - own
    return TimedArea(wall, own, result.candidates, before_mb, peak_mb())


class Workers:
    """A spawned process for each name, or this process for all."""

    def __init__(self, isolated: bool) -> None:
        self._isolated, self._stack = isolated, ExitStack()
        self._pools: dict[str, ProcessPoolExecutor] = {}

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function in the named process. Raises its errors, and AreaFailedError if the
        process dies.
        """
        if not self._isolated:
            return function(*arguments)
        if name not in self._pools:
            self._pools[name] = self._stack.enter_context(processes(1))
        try:
            with children_start():
                called = self._pools[name].submit(function, *arguments)
            return called.result()
        except BrokenProcessPool as error:
            raise AreaFailedError(
                f"the process of {name} died (killed or out of memory); use a coarser `gsd_m` or a smaller area"
            ) from error


@dataclass
class Runs:
    """Results of the process of one tier."""

    areas: dict[str, list[TimedArea]] = field(default_factory=dict)  # by name, one per round
    base_mb: float = 0.0

    def add(self, area: str, outcome: TimedArea) -> None:
        self.areas.setdefault(area, []).append(outcome)

    def total(self, clock: str) -> float:
        """Seconds of all areas by a clock (a field of `TimedArea`), each the median over its
        rounds.
        """
        areas = self.areas.values()
        return sum(float(statistics.median(getattr(r, clock) for r in runs)) for runs in areas)

    @property
    def by_round(self) -> list[float]:
        """Wall time of all areas in each round."""
        return [sum(run.seconds for run in turn) for turn in zip(*self.areas.values(), strict=True)]

    @property
    def peak_mb(self) -> float:
        return max(run.peak_mb for runs in self.areas.values() for run in runs)

    @property
    def candidates(self) -> Candidates:
        everything: Candidates = joined([runs[-1].candidates for runs in self.areas.values()])
        return everything


Progress = Callable[[int, int], None]

AREAS, ROUNDS = 4, 2
"""Default number of areas, and of rounds for each."""


@dataclass(frozen=True)
class Budget:
    """What is wanted of all approximations: at most so many seconds of processor time for the whole build, or at most
    this share of the conditions changed; neither: the table alone.
    """

    seconds: float | None = None
    error: float | None = None


@dataclass(frozen=True)
class Trade:
    """Result of a measurement: one row per tier, the compared areas and conditions, an image, and
    the reflectance models; of all approximations the ``rows``, one for each alternative to the user's
    configuration, the first the configuration itself; ``not_measured``: the others, with the reason;
    ``best``: the configuration to take for a budget, and ``best_row``, what it was measured to do.
    """

    tiers: list[dict[str, Any]]
    compared: dict[str, Any]
    picture: ErrorPicture | None
    models: ModelChanges
    rows: list[dict[str, Any]] = field(default_factory=list)
    not_measured: dict[str, str] = field(default_factory=dict)
    best: BuildConfig | None = None
    best_row: dict[str, Any] | None = None
    budget: Budget = Budget()
    """What was asked for."""
    untried: int = 0
    """Alternatives that the budget may take and that were not measured."""

    def document(self) -> dict[str, Any]:
        """The content of ``trade.json``."""
        times = self.models.times()
        laws = {
            "rows": self.models.rows(),
            "seconds_relative": {law: one[0] for law, one in times.items()},
            "seconds_relative_range": {law: one[1:] for law, one in times.items()},
        }
        return {
            "rows": self.rows,
            "not_measured": [f"{name}: {why}" for name, why in self.not_measured.items()],
            "best": self.best_row
            and self.best_row
            | {
                "asked": dataclasses.asdict(self.budget),
                "other_ground": other_ground(self.best_row),
            },
            "tiers": self.tiers,
            "models": laws,
            "compared": self.compared,
        }


def measure_trade(
    build: Build,
    areas: int = AREAS,
    rounds: int = ROUNDS,
    isolated: bool = True,
    progress: Progress = lambda done, total: None,
    limit_s: float = math.inf,
) -> Trade:
    """Compute some areas of a build in every tier and compare them.

    ``isolated``: each tier in a process of its own; otherwise ``memory_mb`` is None. ``limit_s``: no other area, and
    then no other round, is begun that would be done after so many seconds, if it takes as long as the one before; one of each
    is always done. Raises ConfigError for counts below 1, the library's errors of an area, and AreaFailedError if a
    process dies.
    """
    if areas < 1 or rounds < 1:
        raise ConfigError("`areas` and `rounds` must be at least 1")
    until = time.monotonic() + limit_s
    chosen = [build.jobs[i] for i in spread(build, areas)]
    jobs = [{tier: _in_tier(job, tier) for tier in TIERS} for job in chosen]
    steps = _Steps(progress, total=len(jobs) * (2 + rounds * len(TIERS)) + len(TIERS))
    images, runs = {tier: ImageChanges() for tier in TIERS}, {tier: Runs() for tier in TIERS}
    pictures: list[ErrorPicture] = []
    models, done, turns, area_s, round_s = ModelChanges(), 0, 0, 0.0, 0.0

    def timed(workers: Workers, job: dict[str, AreaJob], turn: int) -> None:
        for tier in _taking_turns(turn):
            runs[tier].add(job[tier].task.name, workers.call(tier, timed_area, job[tier]))
            steps.one()

    with Workers(isolated) as workers:
        while done < len(jobs) and (not done or time.monotonic() + area_s <= until):
            job, begun = jobs[done], time.monotonic()
            pictures += _images(workers, job, images, not done, steps)
            models.add(workers.call("images", compare_models, job[DEFAULT_TIER]))
            steps.one()
            images_s = time.monotonic() - begun
            if not done:
                for tier, run in runs.items():  # loads kernels, fills the file cache
                    run.base_mb = workers.call(tier, timed_area, job[tier]).before_mb
                    steps.one()
            begun = time.monotonic()
            timed(workers, job, 0)
            timed_s = time.monotonic() - begun
            # images of the first area load kernels, or compile them
            area_s = timed_s + (images_s if done else timed_s)
            round_s += timed_s
            done += 1
        for turns in range(1, rounds + 1):
            if turns == rounds or time.monotonic() + round_s > until:
                break
            for job in jobs[:done]:
                timed(workers, job, turns)
    counts = ("areas", done, len(jobs)), ("rounds", turns, rounds)
    return Trade(
        _rows(build, images, runs, isolated),
        _compared(build, chosen[:done], turns, isolated),
        max(pictures, key=lambda one: one.wrong_nodes, default=None),
        models,
        not_measured={
            f"accuracy tiers, {of - had} of {of} {what}": "half of the time limit was reached"
            for what, had, of in counts
            if had < of
        },
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
    progress: Progress = lambda done, total: None,
) -> Trade:
    """A measurement with the rows of all approximations, on ``areas`` areas (None: all), and the configuration for the
    budget. ``until``: time of `time.monotonic` after which no other alternative is begun. ConfigError for an impossible
    budget; otherwise errors as an area's.
    """
    require_one(budget.seconds, budget.error)
    recipe = build.recipe
    config = recipe.config.replaced({"model.reflectance": recipe.law.model.name})
    chosen = [build.jobs[i] for i in spread(build, areas or len(build.jobs))]
    sample, own = Sample(build, config, chosen), Setting("", "as configured", {})
    begun = time.monotonic()
    first_runs = [usual for _, usual in Measurement(sample, workers, math.inf).outcomes([own, own])]
    if isinstance(first_runs[0], str) or isinstance(first_runs[1], str):
        raise AreaFailedError(str(first_runs[0]))
    usual, baseline_s = first_runs[0], [one.cpu_s for one in first_runs if not isinstance(one, str)]
    setting_s = min(baseline_s) / max(1, workers)
    whole = Written.of(usual.level, sample) if areas is None else None
    first = row_of(sample, own, usual, usual) | (whole.beside(whole) if whole else {})
    asked = budget.seconds is not None or budget.error is not None
    left_s = until - time.monotonic()
    # of the least confirmation: both configurations on as many areas, as these two runs were
    least_s = 1.5 * (time.monotonic() - begun)
    # on CONFIRMED areas and then on twice as many, of both configurations
    most_s = 6.0 * CONFIRMED * setting_s / len(chosen) + 2.0 * _START_S
    kept_s = min(max(least_s, most_s), left_s / 3.0) if asked else 0.0
    measured = Measurement(sample, workers, until - kept_s, setting_s)
    wanted, finer = settings(config), (budget.seconds or 0.0) >= first["build_seconds"]
    if asked:
        wanted = for_budget(wanted, finer)
    done: list[tuple[Setting, dict[str, Any]]] = []
    missing = found.not_measured | {
        one.name: one.unpriced for one in APPROXIMATIONS if one.unpriced
    }
    if whole and whole.kept_share is None:
        missing["change of the promise"] = (
            "this build promises nothing (`points.spacing_m`, or `points.per_view` 0)"
        )
    between = _between(wanted, own)
    for count, (setting, row) in enumerate(measured.rows(usual, between, whole)):
        progress(count + 1, len(between))
        if not setting.knob:
            baseline_s += [] if isinstance(row, str) else [row["seconds"]]
        elif isinstance(row, str):
            missing[f"{setting.knob}, {setting.value}"] = row
        else:
            done.append((setting, row))
    relative([first, *(row for _, row in done)], baseline_s)
    found = replace(found, rows=[first, *(row for _, row in done)], not_measured=missing)
    if not asked:
        return found
    spent_s = sum(baseline_s) + sum(row["seconds"] for _, row in done)
    pace = (time.monotonic() - begun) / spent_s  # wall time for a second of processor time
    area_s = pace * first["seconds"] / len(chosen)
    confirmation = Confirmation(build, config, len(chosen), workers, until, area_s)
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
    """The configuration for a budget and its row. Taken back, the last setting first, is what exceeds the error, or the time
    with finer settings, and what together keeps too few places and points, though each keeps enough.
    """
    left = list(done)
    for turn in range(_TRIES + 1):
        taken = proposal(left if turn < _TRIES else [], first, budget.seconds, budget.error)
        rows = [row for setting, row in left if setting in taken]
        best = together(taken)
        told = together_row(first, rows)
        best_row = confirmation.row(best, told)
        if budget.error is not None:
            kept = (best_row["conditions_changed_share"] or 0.0) <= budget.error
        else:
            kept = not any(s.finer for s in taken) or best_row["build_seconds"] <= budget.seconds
        judged = told if best_row["usable_ratio"] is None else best_row
        if not taken or (kept and keeps_enough(judged)):
            break
        left = [one for one in left if one[0] != taken[-1]]
    return best, best_row | {"finer": any(one.finer for one in taken)}


CONFIRMED, CLOSE = 32, 0.15
"""Least number of areas, where the build has them, on which the configuration for a budget is measured; and the half width of the
interval of its error, as a share of it, above which twice as many are taken."""


@dataclass(frozen=True)
class Confirmation:
    """Measures the configuration for a budget, on more areas than those on which it was chosen: a few areas say what saves
    most, but their mean error is as uncertain as it is large. ``until``: no areas are begun that would be done after it, by
    ``area_s``, the time of an area of the user's configuration.
    """

    build: Build
    config: BuildConfig
    least: int
    workers: int
    until: float
    area_s: float

    def fits(self, count: int, relative: float) -> bool:
        """True if ``count`` areas of both configurations are done before the end."""
        start_s = _START_S if self.workers else 0.0
        return time.monotonic() + count * self.area_s * (1.0 + relative) + start_s <= self.until

    def row(self, best: Setting, told: dict[str, Any]) -> dict[str, Any]:
        """The row of the configuration; ``told``, what its settings say together, where there is no time for any
        measurement. ConfigError for settings that exclude each other.
        """
        count, row = max(CONFIRMED, self.least), None
        while count > self.least and not self.fits(count, told["seconds_relative"]):
            count = max(self.least, count // 2)
        while self.fits(min(count, len(self.build.jobs)), told["seconds_relative"]):
            row = self._of(best, count)
            around, share = row["interval"], row["conditions_changed_share"] or 0.0
            close = around is None or around[1] - around[0] <= 2.0 * CLOSE * share
            if close or row["areas"] == len(self.build.jobs):
                break
            count *= 2
        return row or told

    def _of(self, best: Setting, count: int) -> dict[str, Any]:
        jobs = [self.build.jobs[i] for i in spread(self.build, count)]
        sample, own = Sample(self.build, self.config, jobs), Setting("", "as configured", {})
        measured = Measurement(sample, self.workers, math.inf)
        found = {one.knob: outcome for one, outcome in measured.outcomes([own, best])}
        usual, outcome = found[own.knob], found[best.knob]
        if isinstance(usual, str) or isinstance(outcome, str):
            raise ConfigError(str(outcome))
        return row_of(sample, best, usual, outcome) | {"areas": len(jobs)}


class _Steps:
    """Counter of the finished steps for the progress callback."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0
        progress(0, total)

    def one(self) -> None:
        self._done += 1
        self._progress(self._done, self._total)


def _taking_turns(turn: int) -> list[str]:
    """The tiers, starting with another one in each round."""
    names = list(TIERS)
    return names[turn % len(names) :] + names[: turn % len(names)]


def _in_tier(job: AreaJob, tier: str) -> AreaJob:
    recipe = job.recipe
    model = dataclasses.replace(recipe.config.model, accuracy=tier, tolerance=None)
    config = dataclasses.replace(recipe.config, model=model)
    return dataclasses.replace(job, recipe=dataclasses.replace(recipe, config=config))


def spread(build: Build, count: int) -> list[int]:
    """Indices of sample areas: the one nearest to the region's centre, then repeatedly the one
    farthest from those chosen.

    Areas with less than half of the nodes of the largest one are chosen last.
    """
    nodes = np.array([job.nodes for job in build.jobs])
    lon, lat = np.array([(job.task.lon_deg, job.task.lat_deg) for job in build.jobs]).T
    place, region = lonlat_to_mcmf(lon, lat), build.recipe.region
    centre = lonlat_to_mcmf(region.lon_deg, region.lat_deg)
    rank = np.where(2 * nodes >= nodes.max(), 0, 1)
    chosen: list[int] = []
    away = -np.linalg.norm(place - centre, axis=1)
    while len(chosen) < min(count, len(nodes)):
        free = np.setdiff1d(np.arange(len(nodes)), chosen)
        free = free[rank[free] == rank[free].min()]
        chosen.append(int(free[np.argmax(away[free])]))
        away = np.linalg.norm(place[:, None] - place[chosen], axis=2).min(axis=1)
    return chosen


# -- images


def _images(
    workers: Workers,
    job: dict[str, AreaJob],
    totals: dict[str, ImageChanges],
    first: bool,
    steps: _Steps,
) -> list[ErrorPicture]:
    """Add the comparison of all images of an area to ``totals``; return its picture where nodes are wrong."""
    if first:
        # compiles kernels here, not in the processes whose memory is measured
        workers.call("images", run_area, job["draft"])
    changes, picture = workers.call("images", compare_images, job)
    for tier, change in changes.items():
        totals[tier].add(change)
    steps.one()
    return [picture] if picture else []


# -- the table


def _rows(
    build: Build, images: dict[str, ImageChanges], runs: dict[str, Runs], isolated: bool
) -> list[dict[str, Any]]:
    """One dictionary per tier, from ``draft`` to ``reference``."""
    found = {tier: run.candidates for tier, run in runs.items()}
    exact, exact_images = runs[REFERENCE], images[REFERENCE]
    rows = []
    for tier, run in runs.items():
        ratios = [a / b for a, b in zip(run.by_round, exact.by_round, strict=True)]
        change = images[tier]
        rows.append(
            {
                "accuracy": tier,
                "bound": TIERS[tier].node_error,
                "seconds": run.total("seconds"),
                "seconds_relative": run.total("seconds") / exact.total("seconds"),
                "seconds_relative_range": [min(ratios), max(ratios)],
                "cpu_seconds": run.total("cpu_seconds"),
                "cpu_relative": run.total("cpu_seconds") / exact.total("cpu_seconds"),
                "render_seconds": change.seconds,
                "render_relative": change.seconds / exact_images.seconds
                if exact_images.seconds
                else 1.0,
                "memory_mb": run.peak_mb if isolated else None,
                "memory_base_mb": run.base_mb if isolated else None,
                "sunlit_error_share": change.sunlit_error_share,
                "sunlit_error_near_edge_share": change.near_edge_share,
                "visible_error_share": change.visible_error_share,
                "radiance_rmse": change.radiance_rmse,
                **dataclasses.asdict(
                    compare_points(found[REFERENCE], found[tier], build.recipe.config)
                ),
            }
        )
    return rows


def _compared(build: Build, chosen: list[AreaJob], rounds: int, isolated: bool) -> dict[str, Any]:
    """The compared areas and conditions in plain values."""
    config, region = build.recipe.config, build.recipe.region
    return {
        "dems": [source["name"] for source in build.recipe.dems.sources()],
        "region": {
            "center_lon": region.lon_deg,
            "center_lat": region.lat_deg,
            **dict(zip(("west", "south", "east", "north"), region.bounds, strict=True)),
        },
        "gsd_m": config.gsd_m,
        "areas": len(chosen),
        "areas_of": len(build.jobs),
        "area_names": [job.task.name for job in chosen],
        "area_nodes": [job.nodes for job in chosen],
        "suns": sorted({int(job.conditions.reachable.sum()) for job in chosen}),
        "sun_azimuths_deg": list(config.sun.azimuths_deg),
        "sun_elevations_deg": list(config.sun.elevations_deg),
        "views": len(config.view),
        "view_off_nadir_deg": list(config.view.off_nadir_deg),
        "reflectance": build.recipe.law.model.name,
        "threads": 1,
        "rounds": rounds,
        "own_process": isolated,
    }
