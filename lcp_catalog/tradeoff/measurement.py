"""Measurement of time and errors of each accuracy tier against ``reference`` on a user's own build.

Each tier computes the same areas in a process of its own with one thread. The tiers take turns area
by area, so that changes in the machine's speed affect all of them. The images are compared
separately, on terrain that is made once.
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
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..accuracy import DEFAULT_TIER, TIERS
from ..errors import AreaFailedError, ConfigError
from ..geometry.frames import lonlat_to_mcmf
from ..memory import peak_mb
from ..production.area_job import AreaJob, Candidates, run_area
from ..production.config import BuildConfig
from ..production.executor import children_start, processes
from ..production.run import Build
from ..stages import Steps
from ..threads import limit_threads
from .image_errors import (
    REFERENCE,
    ErrorPicture,
    ImageChanges,
    ModelChanges,
    compare_images,
    compare_models,
)
from .point_changes import compare_points, joined
from .proposal import other_ground


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
        return self.calls({name: (function, *arguments)})[name]

    def calls(self, wanted: dict[str, tuple[Any, ...]]) -> dict[str, Any]:
        """Call functions with arguments, each in its process, at the same time. Raises as `call`."""
        if not self._isolated:
            return {name: function(*arguments) for name, (function, *arguments) in wanted.items()}
        for name in wanted:
            if name not in self._pools:
                self._pools[name] = self._stack.enter_context(processes(1))
        try:
            with children_start():
                called = {name: self._pools[name].submit(*one) for name, one in wanted.items()}
            return {name: one.result() for name, one in called.items()}
        except BrokenProcessPool as error:
            raise AreaFailedError(
                f"a process of {' or '.join(wanted)} died (killed or out of memory); use a coarser `gsd_m` or a smaller area"
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
    steps: Steps | None = None,
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
    steps = steps or Steps()
    steps.begin(len(jobs) * (2 + rounds * len(TIERS)) + len(TIERS))
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
                # loads kernels, fills the file cache
                for tier, run in workers.calls({t: (timed_area, job[t]) for t in TIERS}).items():
                    runs[tier].base_mb = run.before_mb
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

    Areas with less than half of the nodes of the largest one, which the region's border cuts, are taken only for all areas, as the
    last.
    """
    nodes = np.array([job.nodes for job in build.jobs])
    lon, lat = np.array([(job.task.lon_deg, job.task.lat_deg) for job in build.jobs]).T
    place, region = lonlat_to_mcmf(lon, lat), build.recipe.region
    centre = lonlat_to_mcmf(region.lon_deg, region.lat_deg)
    rank = np.where(2 * nodes >= nodes.max(), 0, 1)
    most = len(nodes) if count == len(nodes) else np.count_nonzero(rank == 0)
    chosen: list[int] = []
    away = -np.linalg.norm(place - centre, axis=1)
    while len(chosen) < min(count, most):
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
    steps: Steps,
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
    suns = np.any([job.conditions.reachable for job in chosen], axis=0)
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
        "sun_elevations_deg": np.array(config.sun.elevations_deg)[suns.any(axis=1)].tolist(),
        "views": len(config.view),
        "view_off_nadir_deg": list(config.view.off_nadir_deg),
        "reflectance": build.recipe.law.model.name,
        "threads": 1,
        "rounds": rounds,
        "own_process": isolated,
    }
