"""What every approximation costs and changes on a user's own build: one alternative at a time around the
configuration, on the same ground.

The alternatives of the registry (`approximations`) are computed in the order of their expected effect, until a
limit of time. Where an alternative has other areas, all of those that reach into the sample are computed, and count with
their share of it.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

from ..approximations import APPROXIMATIONS, Approximation
from ..arrays import Array, Index
from ..errors import ConfigError, LcpError
from ..memory import peak_mb, restart_peak
from ..photometry.law_choice import LawChoice
from ..plots.numbers import number
from ..production.area_job import AreaJob, AreaResult, Candidates, area_sweep, run_area
from ..production.areas import AreaGrid
from ..production.assembly import choose
from ..production.config import BuildConfig
from ..production.estimate import start_of
from ..production.executor import children_start
from ..production.finished_area import table_of
from ..production.recipe import InputFiles, Recipe
from ..production.run import Build, Level
from ..production.sweep import law_of_build
from ..production.two_passes import areas_in_passes
from ..stages import Steps
from ..threads import cores, limit_threads
from .image_errors import CONTRAST, ImageChanges, judge
from .point_changes import joined, some_of

_LOWEST_SUNS = 2

_PLACES = 24
"""Places along a side of an area's box that tell how much of it is in the sample."""

Row = dict[str, Any]
Part = tuple[AreaJob, float, AreaJob | None]


@dataclass(frozen=True)
class Setting:
    """A configuration and how it differs from the user's: ``values`` of fields, ``configured`` the user's where these are
    numbers; ``turned``: True if a budget may take it, because the catalogue that it gives answers the same questions;
    ``images``: True if it changes them; ``finer``: True if it leaves less out; ``slower``: its time over that of the
    configuration, at least and at most, by the registry; ``on_sample``: the same on the sample, 1 where it is not known.
    """

    knob: str
    value: str
    values: Mapping[str, Any]
    turned: bool = False
    images: bool = False
    finer: bool = False
    slower: tuple[float, float] = (1.0, 1.0)
    on_sample: float = 1.0
    configured: str = ""


@dataclass(frozen=True)
class _Run:
    """An area of a setting that was computed: processor time, peak of memory, candidates, and the differences of its images
    from those of the user's configuration.
    """

    cpu_s: float
    peak_mb: float
    candidates: Candidates
    images: ImageChanges | None
    shifts_px: Array


_ready: set[str] = set()
"""Steps of areas whose kernels this process has loaded."""


def _run(job: AreaJob, usual: AreaJob | None) -> tuple[_Run, AreaResult]:
    """Compute an area, or a step of it, on one thread. ``usual``: the same area under the user's configuration, for the images."""
    with limit_threads(1):
        if job.step not in _ready:  # loads kernels and fills caches
            run_area(job)
            _ready.add(job.step)
        restart_peak()
        start = time.process_time()
        found = run_area(job)
        spent = time.process_time() - start
        images, shifts = _images(job, usual) if usual else (None, np.empty(0))
    return _Run(spent, peak_mb(), found.candidates, images, shifts), found


def _runs(jobs: Sequence[AreaJob], usual: Sequence[AreaJob | None], areas: int) -> list[_Run]:
    """Compute areas of a level of ``areas``, of two passes with a choice among all of them."""
    if not jobs[0].recipe.config.points.two_passes:
        return [_run(job, same)[0] for job, same in zip(jobs, usual, strict=True)]
    steps: list[list[_Run]] = [[] for _ in jobs]

    def step(k: int, job: AreaJob) -> AreaResult:
        run, result = _run(job, None if steps[k] else usual[k])
        steps[k].append(run)
        return result

    areas_in_passes(jobs, areas, step)
    return [_whole(look, evaluated) for look, *evaluated in steps]


def _whole(look: _Run, evaluated: Sequence[_Run]) -> _Run:
    """A first look and what was evaluated after it as one."""
    none: Candidates = some_of(look.candidates, np.zeros(0, np.int64))
    return dataclasses.replace(
        look,
        cpu_s=look.cpu_s + sum(one.cpu_s for one in evaluated),
        peak_mb=max(one.peak_mb for one in (look, *evaluated)),
        candidates=joined([none, *(one.candidates for one in evaluated)]),
    )


def _images(job: AreaJob, usual: AreaJob) -> tuple[ImageChanges, Array]:
    """Differences of the images under the lowest Suns, seen from the view nearest to straight down; and the shifts of
    windows between them, cells.
    """
    pair = [area_sweep(one) for one in (usual, job)]
    conditions = pair[0].conditions
    low = np.zeros_like(conditions.reachable)
    rows = np.flatnonzero(conditions.reachable.any(axis=1))[:_LOWEST_SUNS]
    low[rows] = conditions.reachable[rows]
    few = dataclasses.replace(conditions, reachable=low)
    view = (int(np.argmin(conditions.off_nadir_deg)),)
    changes, shifts = ImageChanges(), [np.empty(0)]
    side = usual.recipe.config.points.patch_nodes
    streams = (dataclasses.replace(sweep, conditions=few).images(view) for sweep in pair)
    for exact, ours in zip(*streams, strict=True):
        judge(changes, ours, exact)
        shifts.append(window_shifts(exact.radiance, ours.radiance, side))
    return changes, np.concatenate(shifts)


def window_shifts(known: Array, seen: Array, side: int) -> Array:
    """Lengths (n,) of the shifts, nodes, of the windows of an image in another, by least squares on shift, gain and
    offset; of the windows of ``side`` nodes that are visible in both and have contrast.
    """
    found = []
    for row in range(1, known.shape[0] - side, side):
        for col in range(1, known.shape[1] - side, side):
            part = np.s_[row - 1 : row + side + 1, col - 1 : col + side + 1]
            whole, other = known[part].astype(np.float64), seen[part].astype(np.float64)[1:-1, 1:-1]
            own = whole[1:-1, 1:-1]
            if not (np.isfinite(whole).all() and np.isfinite(other).all()):
                continue
            if own.std() <= CONTRAST * own.mean() or other.std() <= CONTRAST * other.mean():
                continue
            east, south = (whole[1:-1, 2:] - whole[1:-1, :-2]), (whole[2:, 1:-1] - whole[:-2, 1:-1])
            basis = np.stack([0.5 * east, 0.5 * south, own, np.ones_like(own)], -1).reshape(-1, 4)
            along, down, gain, _ = np.linalg.lstsq(basis, other.ravel(), rcond=None)[0]
            if gain > 0.0:
                found.append(math.hypot(along, down) / gain)
    return np.array(found)


class Sample:
    """Some areas of a build, and what every setting gives on their ground."""

    def __init__(
        self,
        build: Build,
        config: BuildConfig,
        jobs: Sequence[AreaJob],
        starts: dict[int, float] | None = None,
    ) -> None:
        self.build, self.jobs, self.level = build, jobs, build.levels[0]
        self.starts = {} if starts is None else starts
        """What is known of `start_s`, by jobs."""
        self.config, self.grid = config, jobs[0].grid
        self.boxes = {(job.task.row, job.task.column): k for k, job in enumerate(jobs)}
        self.nodes = {(job.task.row, job.task.column): job.nodes for job in self.level.jobs}
        self.share = _work(jobs) / _work(self.level.jobs)

    @cached_property
    def law(self) -> LawChoice:
        """The reflectance model of the configuration."""
        return law_of_build(self.config, self.build.recipe.region.lat_deg)

    def first(self, count: int) -> Sample:
        """The first areas of the sample."""
        some = self.jobs[:count]
        same = len(some) == len(self.jobs)
        return self if same else Sample(self.build, self.config, some, self.starts)

    def level_of(self, values: Mapping[str, Any]) -> Level:
        """The whole build with other values of fields."""
        config = self.config.replaced(values)
        recipe = self.build.recipe
        law = self.law if _of_law(config) == _of_law(self.config) else None
        own = Recipe.of(config, recipe.dems, recipe.region, InputFiles(), law)
        cell_m = config.gsd_m
        if cell_m == self.config.gsd_m and AreaGrid.for_cell(cell_m, config.model) == self.grid:
            jobs = (dataclasses.replace(job, recipe=own) for job in self.level.jobs)
            return Level(own, self.level.cell, tuple(jobs))
        return Level.plan(own, dataclasses.replace(self.level.cell, gsd_m=cell_m), None, None)

    def start_s(self, level: Level) -> float:
        """Processor time that a build of a level takes beside its areas (`start_of`). It is that of the configuration: two passes
        take as long, in the same processes (9.7, 10.6, 10.2 s beside 9.6, 10.5, 10.2 s for two jobs on 30 km of the sample,
        under load, 2026-11-29).
        """
        jobs = default_jobs(level)
        if jobs not in self.starts:
            self.starts[jobs] = start_of(self.level, jobs).cpu_s
        return self.starts[jobs]

    def same_areas(self, level: Level) -> bool:
        """True if a level has the areas of the user's configuration."""
        return level.jobs[0].grid == self.grid and level.recipe.gsd_m == self.config.gsd_m

    def parts(self, level: Level) -> list[Part]:
        """The areas of a level that reach into the sample, the share of each that does, and the area of the user's
        configuration that has the same nodes.
        """
        own = {job.task: job for job in level.jobs}
        if self.same_areas(level):
            return [(own[job.task], 1.0, job) for job in self.jobs if job.task in own]
        found: list[tuple[AreaJob, float, AreaJob | None]] = []
        for job in level.jobs:
            share = self._share(job)
            if share > 0.0:
                found.append((job, share, None))
        return found

    def _share(self, job: AreaJob) -> float:
        """Share of an area of another grid that is in the sample, of what of it is in the build at all: both have areas that
        the region's border cuts, so that places count by the nodes of the area that holds them.
        """
        west, south, east, north = job.grid.box(job.task.row, job.task.column)
        middles = (np.arange(_PLACES) + 0.5) / _PLACES
        lon, lat = np.meshgrid(west + (east - west) * middles, south + (north - south) * middles)
        pairs = self._boxes_at(lon.ravel(), lat.ravel())
        nodes = np.array([self.nodes.get(pair, 0) for pair in pairs])
        inside = np.array([pair in self.boxes for pair in pairs])
        return float(nodes[inside].sum() / max(1, nodes.sum()))

    def owner(self, lon_deg: Array, lat_deg: Array) -> Index:
        """Number of the sample's area that holds each place; -1 for none."""
        boxes = [self.boxes.get(pair, -1) for pair in self._boxes_at(lon_deg, lat_deg)]
        return np.array(boxes, dtype=np.int64)

    def _boxes_at(self, lon_deg: Array, lat_deg: Array) -> list[tuple[int, int]]:
        row, column = self.grid.owner(lon_deg, lat_deg)
        return list(zip(row.tolist(), column.tolist(), strict=True))


def _of_law(config: BuildConfig) -> tuple[Any, ...]:
    """What of a configuration `law_of_build` reads."""
    return config.sun, config.view, config.model.precision, config.model.reflectance


def default_jobs(level: Level) -> int:
    """Processes of a build of a level, if no number is given."""
    return min(cores(), len(level.jobs))


def _work(jobs: Sequence[AreaJob]) -> float:
    """Nodes with their halo times conditions."""
    halo = jobs[0].recipe.config.points.halo_nodes(jobs[0].recipe.gsd_m)
    return sum(math.prod(j.task.window.grown(halo).shape) * j.conditions.count for j in jobs) or 1.0


def ratio_interval(by_area: Array, wider: float = 1.0) -> list[float] | None:
    """The 90 % interval, from 0, of the ratio of two sums, of the parts of each area (n, 2): Cochran (1977), *Sampling
    Techniques*, 6.3; None for one area. With ``wider`` sqrt(2) that of the ratio on as many other areas of such ground.
    """
    count = len(by_area)
    if count < 2:
        return None
    changed, judged = by_area.T
    share = float(changed.sum() / judged.sum())
    spread = float(np.std(changed - share * judged, ddof=1) / judged.mean())
    half = wider * float(stdtrit(count - 1, 0.95)) * spread / math.sqrt(count)
    return [max(0.0, share - half), share + half]


@dataclass(frozen=True)
class Outcome:
    """What a setting gives on a sample: candidates there with the ``area`` of each, processor time, memory."""

    sample: Sample
    level: Level
    candidates: Candidates
    area: Index
    cpu_s: float
    peak_mb: float
    images: ImageChanges | None
    shift_px: float | None
    parts: Array
    """Processor time and work (nodes with their halo times conditions) of each area of its own (n, 2)."""

    @cached_property
    def chosen(self) -> Index:
        """The candidates that are chosen as points."""
        config = self.level.recipe.config
        return choose(table_of(self.candidates, config), config)

    def on(self, sample: Sample) -> Outcome:
        """The same of the user's configuration on the first areas of its sample."""
        count = len(sample.jobs)
        if count == len(self.sample.jobs):
            return self
        kept = np.flatnonzero(self.area < count)
        return dataclasses.replace(
            self,
            sample=sample,
            candidates=some_of(self.candidates, kept),
            area=self.area[kept],
            cpu_s=float(self.parts[:count, 0].sum()),
            parts=self.parts[:count],
        )

    def areas_s(self) -> tuple[float, list[float] | None]:
        """Processor time of all areas of the level, by that of its work, and its 90 % interval: areas of another grid differ
        in what the region's border leaves of them.
        """
        whole = _work(self.level.jobs)
        around = ratio_interval(self.parts)
        spent, work = self.parts.sum(axis=0)
        return float(spent / work * whole), around and [one * whole for one in around]

    @classmethod
    def of(
        cls,
        sample: Sample,
        level: Level,
        parts: Sequence[Part],
        runs: Sequence[_Run],
    ) -> Outcome:
        """The runs of the areas of a level that reach into the sample (`Sample.parts`)."""
        shares = [share for _, share, _ in parts]
        every: Candidates = joined([run.candidates for run in runs])
        area = sample.owner(every.lon_deg, every.lat_deg)
        kept = np.flatnonzero(area >= 0)
        images = [run.images for run in runs if run.images]
        total = ImageChanges()
        for one in images:
            total.add(one)
        shifts = np.concatenate([run.shifts_px for run in runs])
        return cls(
            sample, level, some_of(every, kept), area[kept],
            sum(share * run.cpu_s for share, run in zip(shares, runs, strict=True)),
            max(run.peak_mb for run in runs),
            total if images else None, float(np.median(shifts)) if len(shifts) else None,
            np.array([(p[1] * r.cpu_s, p[1] * _work([p[0]])) for p, r in zip(parts, runs, strict=True)]),
        )  # fmt: skip


_UNITS = {
    "deg": "deg", "m": "m", "km": "km", "px": "pixels", "nodes": "nodes", "max": "nodes", "cell": "a cell",
    "passes": "passes", "scales": "scales", "rivals": "rivals", "correlation": "of a correlation",
    "dependence": "of a patch", "share": "of a patch", "step": "of the value", "doubt": "of a probability",
}  # fmt: skip
"""Unit of a field by the last word of its name."""

_ONE = {"nodes": "node", "pixels": "pixel", "passes": "pass", "scales": "scale", "rivals": "rival"}


def _with_unit(field: str, value: Any) -> str:
    """A number, or several, with its unit."""
    unit = _UNITS[field.replace(".", "_").rpartition("_")[2]]
    figures = [number(one) for one in (value if isinstance(value, tuple) else (value,))]
    return f"{' and '.join(dict.fromkeys(figures))} {_ONE.get(unit, unit) if figures == ['1'] else unit}"


def _told(config: BuildConfig, name: str, values: Mapping[str, Any]) -> tuple[str, str]:
    """An alternative, and what the configuration has in its place where both are numbers and that is known."""
    if any(letter.isalpha() for letter in name):
        return name, ""
    ((field, value),) = values.items()
    section, _, key = field.partition(".")
    own = getattr(getattr(config, section), key)
    return _with_unit(field, value), "" if own is None else _with_unit(field, own)


def settings(config: BuildConfig) -> list[Setting]:
    """The alternatives to a configuration, those of the greatest expected effect for their time first."""
    order = sorted(APPROXIMATIONS, key=lambda one: -one.expected / one.slower[1])
    return [
        Setting(
            one.name,
            told,
            values,
            turned=one.fineness is not None,
            images=bool(one.effects),
            finer=_finer(one, config, values),
            slower=one.slower,
            on_sample=one.sample_times().get(name, 1.0),
            configured=own,
        )
        for one in order
        for name, values in one.values(config).items()
        for told, own in [_told(config, name, values)]
    ]


def for_budget(wanted: Sequence[Setting], finer: bool) -> list[Setting]:
    """The settings, but first those that a budget may take: the ``finer`` ones in their order, or the others, what saves
    most on the sample first.
    """

    def place(one: Setting) -> tuple[bool, float]:
        other = not one.turned or one.finer != finer
        return other, 0.0 if other or finer else one.on_sample

    return sorted(wanted, key=place)


def _finer(one: Approximation, config: BuildConfig, values: Mapping[str, Any]) -> bool:
    """True if the values leave less out than the configuration does."""
    if one.fineness is None:
        return False
    try:
        return one.fineness(config.replaced(values)) > one.fineness(config)
    except ConfigError:
        return False


class Started(NamedTuple):
    """Processes that have started; 0: none, but this one."""

    number: int = 0
    pool: Executor | None = None


def _too_late(slow_s: float) -> str:
    if slow_s > 0.0:
        return f"it may take {number(slow_s, 2)} s more than others, beyond the time limit"
    return "the time limit was reached"


class Measurement:
    """Settings that are computed on a sample in ``workers``, until ``until``, a time of
    `time.monotonic`. ``in_turn``: area by area, so that changes in the machine's speed affect all of them. ``steps``: counts
    the areas.
    """

    def __init__(
        self,
        sample: Sample,
        workers: Started,
        until: float,
        setting_s: float = 0.0,
        in_turn: bool = False,
        steps: Steps | None = None,
    ) -> None:
        self.sample, self.until, self.in_turn = sample, until, in_turn
        self.workers, self.pool = workers
        self.setting_s = setting_s
        """Time of a setting as slow as the configuration."""
        self.steps = steps or Steps()

    def _turn(self, area: int, areas: int) -> float:
        """Where an area of a setting comes among those of all; equal where they need not take turns."""
        return (area + 0.5) / areas if self.in_turn else 0.0

    def outcomes(self, wanted: Sequence[Setting]) -> Iterator[tuple[Setting, Outcome | str]]:
        """What each setting gives, or why it was not measured, in the order in which they are done."""
        waiting: dict[Future[Any], tuple[int, list[int]]] = {}
        open_: dict[int, tuple[Sample, Level, list[Part], list[Any]]] = {}
        left = list(enumerate(wanted))
        queue: list[tuple[int, list[int]]] = []
        while left or queue or waiting:
            while left and (self.in_turn or (not queue and len(waiting) <= self.workers)):
                at, setting = left.pop(0)
                opened = self._opened(setting)
                if isinstance(opened, str):
                    yield setting, opened
                    continue
                sample, level, parts = opened
                open_[at] = (sample, level, parts, [None] * len(parts))
                self.steps.more(len(parts))
                every = list(range(len(parts)))
                # of two passes all areas in one process, with one choice
                passes = level.recipe.config.points.two_passes
                queue += [(at, some) for some in ([every] if passes else [[k] for k in every])]
            queue.sort(key=lambda one: self._turn(one[1][0], len(open_[one[0]][3])))
            while queue and (self.pool is None or len(waiting) <= self.workers):
                at, some = queue.pop(0)
                _, level, parts, runs = open_[at]
                jobs = [parts[k][0] for k in some]
                same = [parts[k][2] if wanted[at].images else None for k in some]
                if self.pool is None:
                    for k, run in zip(some, _runs(jobs, same, len(level.jobs)), strict=True):
                        runs[k] = run
                    self.steps.one(len(some))
                    continue
                with children_start():
                    waiting[self.pool.submit(_runs, jobs, same, len(level.jobs))] = (at, some)
            for future in wait(waiting, return_when=FIRST_COMPLETED).done if waiting else ():
                at, some = waiting.pop(future)
                for k, run in zip(some, future.result(), strict=True):
                    open_[at][3][k] = run
                self.steps.one(len(some))
            for at in [n for n, (*_, runs) in open_.items() if all(r is not None for r in runs)]:
                sample, level, parts, runs = open_.pop(at)
                yield wanted[at], Outcome.of(sample, level, parts, runs)

    def _opened(self, setting: Setting) -> tuple[Sample, Level, list[Part]] | str:
        """The sample for a setting, its level, and the areas of it there; or why it is not computed. A slow one is computed on as
        many areas as there is certainly time for, or on one if there may be.
        """
        least_s, slow_s = (self.setting_s * (slower - 1.0) for slower in setting.slower)
        some, left_s = self.sample, self.until - time.monotonic()
        if slow_s > left_s:
            count = len(some.jobs)
            if left_s < 0.0 or least_s / count > left_s:
                return _too_late(slow_s)
            some = some.first(max(1, int(count * left_s / slow_s)))
        try:
            level = some.level_of(setting.values)
            if some is not self.sample and not some.same_areas(level):
                return _too_late(slow_s)
            return some, level, some.parts(level)
        except LcpError as error:  # a cell below the DEM's, a spacing of too few cells
            return str(error)
