"""What every approximation costs and changes on a user's own build: one alternative at a time around the
configuration, on the same ground.

The alternatives of the registry (`approximations`) are computed in the order of their expected effect, until a
limit of time. Where an alternative has other areas, all of those that reach into the sample are computed, and count with
their share of it.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from ..approximations import APPROXIMATIONS, Approximation
from ..arrays import Array, Index, Mask
from ..catalog.prediction import FREE_SHARE, VIEW_REACH_DEG
from ..catalog.promise import kept_promise
from ..catalog.schema import UNOCCLUDED, UNSHADOWED, evaluated
from ..catalog.stored import StoredFile, stored_catalog
from ..errors import ConfigError, LcpError
from ..geometry.bounds import wrapped_deg
from ..geometry.frames import direction_enu
from ..landmarks.selection import Places, nearest
from ..memory import peak_mb, restart_peak
from ..plots.numbers import number
from ..production.area_job import AreaJob, Candidates, area_sweep, run_area
from ..production.areas import AreaGrid
from ..production.assembly import choose
from ..production.config import BuildConfig
from ..production.estimate import BESIDE_S, file_bytes
from ..production.executor import children_start, processes
from ..production.finished_area import table_of
from ..production.recipe import InputFiles, Recipe
from ..production.run import Build, BuildRun, Level
from ..production.two_passes import area_in_passes
from ..threads import limit_threads
from .image_errors import CONTRAST, ImageChanges, judge
from .point_changes import joined, sigma_m, usable_points

NEAR_CELLS = 2.0
"""Cells within which two candidates are the same place: those of a point's own peak."""

_LOWEST_SUNS = 2

_PLACES = 24
"""Places along a side of an area's box that tell how much of it is in the sample."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Setting:
    """A configuration and how it differs from the user's: ``values`` of fields; ``turned``: True if a budget may take
    it, because the catalogue that it gives answers the same questions; ``images``: True if it changes them; ``finer``: True
    if it leaves less out; ``slower``: its time over that of the configuration, at most, by the registry;
    ``on_sample``: the same on the sample, 1 where it is not known.
    """

    knob: str
    value: str
    values: Mapping[str, Any]
    turned: bool = False
    images: bool = False
    finer: bool = False
    slower: float = 1.0
    on_sample: float = 1.0


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


_ready: list[bool] = []
"""Not empty in a process that has loaded its kernels."""


def _run(job: AreaJob, usual: AreaJob | None) -> _Run:
    """Compute an area on one thread. ``usual``: the same area under the user's configuration, for the images."""
    with limit_threads(1):
        run = area_in_passes if job.recipe.config.points.two_passes else run_area
        if not _ready:  # loads kernels and fills caches
            run(job)
            _ready.append(True)
        restart_peak()
        start = time.process_time()
        found = run(job)
        spent = time.process_time() - start
        images, shifts = _images(job, usual) if usual else (None, np.empty(0))
    return _Run(spent, peak_mb(), found.candidates, images, shifts)


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

    def __init__(self, build: Build, config: BuildConfig, jobs: Sequence[AreaJob]) -> None:
        self.build, self.jobs, self.level = build, jobs, build.levels[0]
        self.config, self.grid = config, jobs[0].grid
        self.boxes = {(job.task.row, job.task.column): k for k, job in enumerate(jobs)}
        self.nodes = {(job.task.row, job.task.column): job.nodes for job in self.level.jobs}
        self.share = _work(jobs) / _work(self.level.jobs)

    def level_of(self, values: Mapping[str, Any]) -> Level:
        """The whole build with other values of fields."""
        config = self.config.replaced(values)
        recipe = self.build.recipe
        own = Recipe.of(config, recipe.dems, recipe.region, InputFiles())
        cell_m = config.gsd_m
        if cell_m == self.config.gsd_m and AreaGrid.for_cell(cell_m, config.model) == self.grid:
            jobs = (dataclasses.replace(job, recipe=own) for job in self.level.jobs)
            return Level(own, self.level.cell, tuple(jobs))
        return Level.plan(own, dataclasses.replace(self.level.cell, gsd_m=cell_m), None, None)

    def parts(self, level: Level) -> list[tuple[AreaJob, float, AreaJob | None]]:
        """The areas of a level that reach into the sample, the share of each that does, and the area of the user's
        configuration that has the same nodes.
        """
        own = {job.task: job for job in self.jobs}
        if level.jobs[0].grid == self.grid and level.recipe.gsd_m == self.config.gsd_m:
            return [(job, 1.0, own[job.task]) for job in level.jobs if job.task in own]
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


def _work(jobs: Sequence[AreaJob]) -> float:
    """Nodes with their halo times conditions."""
    halo = jobs[0].recipe.config.points.halo_nodes(jobs[0].recipe.gsd_m)
    return sum(math.prod(j.task.window.grown(halo).shape) * j.conditions.count for j in jobs) or 1.0


@dataclass(frozen=True)
class Outcome:
    """What a setting gives on the sample: candidates there with the ``area`` of each, processor time, memory."""

    level: Level
    candidates: Candidates
    area: Index
    cpu_s: float
    peak_mb: float
    images: ImageChanges | None
    shift_px: float | None
    parts: Array
    """Processor time and work (nodes with their halo times conditions) of each area of its own (n, 2)."""

    def areas_s(self) -> tuple[float, list[float] | None]:
        """Processor time of all areas of the level, by that of its work, and its 90 % interval: areas of another grid differ
        in what the region's border leaves of them.
        """
        whole = _work(self.level.jobs)
        around = _interval(self.parts, math.inf)
        spent, work = self.parts.sum(axis=0)
        return float(spent / work * whole), around and [one * whole for one in around]

    @classmethod
    def of(
        cls,
        sample: Sample,
        level: Level,
        parts: Sequence[tuple[AreaJob, float, AreaJob | None]],
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
            level, _some(every, kept), area[kept],
            sum(share * run.cpu_s for share, run in zip(shares, runs, strict=True)),
            max(run.peak_mb for run in runs),
            total if images else None, float(np.median(shifts)) if len(shifts) else None,
            np.array([(p[1] * r.cpu_s, p[1] * _work([p[0]])) for p, r in zip(parts, runs, strict=True)]),
        )  # fmt: skip


def _some(candidates: Any, rows: Index) -> Any:
    """A selection of candidates, and of the results in them."""
    parts = {f.name: getattr(candidates, f.name) for f in dataclasses.fields(candidates)}
    return dataclasses.replace(
        candidates,
        **{
            name: None if v is None else _some(v, rows) if dataclasses.is_dataclass(v) else v[rows]
            for name, v in parts.items()
        },
    )


# -- conditions of two grids


def _along(wanted: Sequence[float], given: Sequence[float], turn: float | None) -> Array:
    """Weights (wanted, given), linear between neighbours; rows of zeros outside. ``turn``: the period."""
    weights = np.zeros((len(wanted), len(given)))
    for k, value in enumerate(wanted):
        away = np.asarray(given) - value
        away = wrapped_deg(away) if turn else away
        if (near := np.abs(away) < 1e-6).any():
            weights[k, np.argmax(near)] = 1.0
            continue
        below, above = (np.where(side, np.abs(away), np.inf) for side in (away < 0, away > 0))
        low, high = int(np.argmin(below)), int(np.argmin(above))
        step = below[low] + above[high]
        if math.isfinite(step):
            weights[k, low], weights[k, high] = above[high] / step, below[low] / step
    return weights


def _of_views(wanted: Any, given: Any) -> Array:
    """Weights (wanted, given): the nearest view within reach."""
    pairs = [
        direction_enu(np.array(v.azimuth_deg), 90.0 - np.array(v.off_nadir_deg))
        for v in (wanted, given)
    ]
    cosine = np.clip(pairs[0] @ pairs[1].T, -1.0, 1.0)
    near = np.eye(len(given))[np.argmax(cosine, axis=1)]
    reached = np.degrees(np.arccos(cosine.max(axis=1))) <= VIEW_REACH_DEG
    return np.asarray(near * reached[:, None])


@dataclass(frozen=True)
class _Claims:
    """Claims (n, view, elevation, azimuth) at the cells: whether there is one, its probability, and whether it is usable."""

    known: Mask
    detection: Array
    usable: Mask

    @classmethod
    def at(cls, candidates: Candidates, own: BuildConfig, wanted: BuildConfig) -> _Claims:
        """The claims of candidates under a configuration at the views and Suns of another."""
        weights = (
            _of_views(wanted.view, own.view),
            _along(wanted.sun.elevations_deg, own.sun.elevations_deg, None),
            _along(wanted.sun.azimuths_deg, own.sun.azimuths_deg, 360.0),
        )

        def mean(values: Array) -> Array:
            for axis, weight in enumerate(weights, start=1):
                values = np.moveaxis(np.tensordot(values, weight, (axis, 1)), -1, axis)
            return values

        condition = candidates.evaluation.condition
        chance = candidates.evaluation.detection[:, 0].astype(np.float64)
        stated = evaluated(condition) & np.isfinite(chance)
        weight = mean(stated.astype(np.float64))
        free = UNSHADOWED | UNOCCLUDED
        clear = mean((stated & ((condition & free) == free)).astype(np.float64))
        known = weight >= 0.5
        with np.errstate(invalid="ignore", divide="ignore"):
            detection = mean(np.where(stated, chance, 0.0)) / weight
            usable = (
                known
                & (detection >= own.points.min_detection - 1e-9)
                & (clear >= FREE_SHARE * weight - 1e-9)
            )
        return cls(known, np.where(known, detection, np.nan), usable)


def _wanted(usual: BuildConfig, other: BuildConfig) -> BuildConfig:
    """The configuration with the finer grid of views and Suns."""
    more = len(other.view) * len(other.sun.azimuths_deg) * len(other.sun.elevations_deg)
    return (
        other
        if more > len(usual.view) * len(usual.sun.azimuths_deg) * len(usual.sun.elevations_deg)
        else usual
    )


# -- rows


def row_of(sample: Sample, setting: Setting, usual: Outcome, found: Outcome) -> Row:
    """A row of the table: a setting beside the user's configuration."""
    before, after = usual.candidates, found.candidates
    config, own = usual.level.recipe.config, found.level.recipe.config
    near_m = NEAR_CELLS * config.gsd_m
    at, away_m = nearest(
        Places(before.lon_deg, before.lat_deg), Places(after.lon_deg, after.lat_deg)
    )
    here = np.flatnonzero(away_m <= near_m)
    there = at[here]
    wanted = _wanted(config, own)
    old, new = (
        _Claims.at(_some(some, rows), of, wanted)
        for some, rows, of in ((before, here, config), (after, there, own))
    )
    # Suns of a finer grid that never occur are not judged
    judged = old.known & new.known if wanted is not config else old.known
    changed = (old.usable != new.usable) & judged
    by_area = np.array(
        [
            (changed[group].sum(), judged[group].sum())
            for k in range(len(sample.jobs))
            if judged[group := usual.area[here] == k].any()
        ],
        np.float64,
    )
    share = float(changed.sum() / judged.sum()) if judged.any() else None
    shift = np.abs(old.detection - new.detection)
    shift = shift[np.isfinite(shift)]
    sigma = [
        sigma_m(some, of)[rows] for some, of, rows in ((before, config, here), (after, own, there))
    ]
    both = (sigma[0] > 0.0) & (sigma[1] > 0.0) & np.isfinite(sigma[0]) & np.isfinite(sigma[1])
    points = [
        (some, choose(table_of(some, of), of)) for some, of in ((before, config), (after, own))
    ]
    chosen = [Places(some.lon_deg[rows], some.lat_deg[rows]) for some, rows in points]
    worth = [usable_points(some, rows) for some, rows in points]
    lost, gained = (int((nearest(a, b)[1] > near_m).sum()) for a, b in (chosen, chosen[::-1]))
    areas_s, around_s = found.areas_s()
    return {
        "knob": setting.knob,
        "value": setting.value,
        "default": setting.knob == "",
        "accuracy": own.model.precision.tier,
        "seconds": found.cpu_s,
        "seconds_relative": areas_s / usual.areas_s()[0],
        "seconds_interval": None,
        "build_seconds": areas_s + BESIDE_S,
        "build_interval": around_s and [one + BESIDE_S for one in around_s],
        "memory_mb": found.peak_mb,
        "bytes": file_bytes(found.level, len(chosen[1].lon_deg) / sample.share),
        # with light by way of other ground a node in shadow is not black
        "sunlit_error_share": found.images.sunlit_error_share
        if found.images and own.model.bounce == config.model.bounce
        else None,
        "radiance_rmse": found.images.radiance_rmse if found.images else None,
        "points": len(chosen[1].lon_deg),
        "points_lost": lost,
        "points_gained": gained,
        "matched_share": len(here) / max(1, len(before)),
        # areas that choose alone lose places at their borders, as a build in two passes, which chooses for the region, does not
        "usable_ratio": worth[1] / max(worth[0], 1e-9)
        if own.points.passes == config.points.passes
        else None,
        "conditions_changed_share": share,
        "interval": _interval(by_area),
        "elsewhere": _interval(by_area, wider=math.sqrt(2.0)),
        "detection_change_mean": float(shift.mean()) if len(shift) else None,
        "detection_change_max": float(shift.max()) if len(shift) else None,
        "sigma_ratio": float(np.median(sigma[1][both] / sigma[0][both])) if both.any() else None,
        "shift_cells": found.shift_px,
        "promise_change": None,
    }


def _interval(by_area: Array, most: float = 1.0, wider: float = 1.0) -> list[float] | None:
    """The 90 % interval, from 0 to ``most``, of the share of all changed among all judged conditions, of those of each area
    (n, 2): Cochran (1977), *Sampling Techniques*, 6.3, for a ratio; None for one area. With ``wider`` sqrt(2) that of the share
    on as many other areas of such ground.
    """
    count = len(by_area)
    if count < 2:
        return None
    changed, judged = by_area.T
    share = float(changed.sum() / judged.sum())
    spread = float(np.std(changed - share * judged, ddof=1) / judged.mean())
    half = wider * float(stdtrit(count - 1, 0.95)) * spread / math.sqrt(count)
    return [max(0.0, share - half), min(most, share + half)]


# -- the measurement


def settings(config: BuildConfig) -> list[Setting]:
    """The alternatives to a configuration, those of the greatest expected effect for their time first."""
    order = sorted(APPROXIMATIONS, key=lambda one: -one.expected / one.slower[1])
    return [
        Setting(
            one.name,
            name,
            values,
            turned=one.fineness is not None,
            images=bool(one.effects),
            finer=_finer(one, config, values),
            slower=one.slower[1],
            on_sample=one.sample_times().get(name, 1.0),
        )
        for one in order
        for name, values in one.values(config).items()
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


def _too_late(slow_s: float) -> str:
    if slow_s > 0.0:
        return f"it may take {number(slow_s, 2)} s more than others, beyond the time limit"
    return "the time limit was reached"


class Measurement:
    """Settings that are computed on a sample with some processes (0: in this one), until ``until``, a time of
    `time.monotonic`.
    """

    def __init__(self, sample: Sample, workers: int, until: float, setting_s: float = 0.0) -> None:
        self.sample, self.workers, self.until = sample, workers, until
        self.setting_s = setting_s
        """Time of a setting as slow as the configuration."""

    def outcomes(self, wanted: Sequence[Setting]) -> Iterator[tuple[Setting, Outcome | str]]:
        """What each setting gives, or why it was not measured, in the order in which they are done."""
        with ExitStack() as stack:
            pool = stack.enter_context(processes(self.workers)) if self.workers else None
            waiting: dict[Future[Any], tuple[int, int]] = {}
            open_: dict[
                int, tuple[Level, list[tuple[AreaJob, float, AreaJob | None]], list[Any]]
            ] = {}
            left = list(enumerate(wanted))
            queue: list[tuple[int, int, AreaJob, AreaJob | None]] = []
            while left or queue or waiting:
                while not queue and left and len(waiting) <= self.workers:
                    number, setting = left.pop(0)
                    slow_s = self.setting_s * (setting.slower - 1.0)
                    if time.monotonic() + slow_s > self.until:
                        yield setting, _too_late(slow_s)
                        continue
                    try:
                        level = self.sample.level_of(setting.values)
                        parts = self.sample.parts(level)
                    except LcpError as error:  # a cell below the DEM's, a spacing of too few cells
                        yield setting, str(error)
                        continue
                    open_[number] = (level, parts, [None] * len(parts))
                    queue += [
                        (number, k, job, same if setting.images else None)
                        for k, (job, _, same) in enumerate(parts)
                    ]
                if pool is None and queue:
                    number, k, job, same = queue.pop(0)
                    open_[number][2][k] = _run(job, same)
                elif pool is not None:
                    while queue and len(waiting) <= self.workers:
                        number, k, job, same = queue.pop(0)
                        with children_start():
                            waiting[pool.submit(_run, job, same)] = (number, k)
                    for future in (
                        wait(waiting, return_when=FIRST_COMPLETED).done if waiting else ()
                    ):
                        number, k = waiting.pop(future)
                        open_[number][2][k] = future.result()
                for number in [
                    n for n, (_, _, runs) in open_.items() if all(r is not None for r in runs)
                ]:
                    level, parts, runs = open_.pop(number)
                    yield wanted[number], Outcome.of(self.sample, level, parts, runs)

    def rows(
        self, usual: Outcome, wanted: Sequence[Setting], whole: Written | None
    ) -> Iterator[tuple[Setting, Row | str]]:
        """The rows of settings, or why they were not measured. ``whole``: the file of the usual catalogue, if the sample is the
        whole build; each catalogue is then written for its promise and its size.
        """
        for setting, found in self.outcomes(wanted):
            if isinstance(found, str):
                yield setting, found
                continue
            row = row_of(self.sample, setting, usual, found)
            if whole and setting.knob:
                row |= Written.of(found.level, self.sample).beside(whole)
            yield setting, row


@dataclass(frozen=True)
class Written:
    """The file of a whole build: the share of its promise that it keeps, None without a promise, and its size."""

    kept_share: float | None
    bytes: int

    @classmethod
    def of(cls, level: Level, sample: Sample) -> Written:
        """Build a level and write it to a temporary file."""
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder, "c.h5")
            build = dataclasses.replace(sample.build, levels=(level,))
            BuildRun(build, output, jobs=2, advises=False).whole()
            kept = kept_promise(stored_catalog(StoredFile.of(output)))
            share = float(kept["kept_share"]) if kept else None
            return cls(share, output.stat().st_size)

    def beside(self, usual: Written) -> Row:
        """What a row says of it beside the usual one."""
        mine, theirs = self.kept_share, usual.kept_share
        change = None if mine is None or theirs is None else mine - theirs
        return {"promise_change": change, "bytes": self.bytes}
