"""A build of two passes: the first looks at all candidates of all areas, the choice is made by that, and the second evaluates
the chosen ones; what fails is replaced, in a few rounds.

What each pass leaves of an area is a checkpoint with a letter of its own: that of the first has the table and the sites of
the candidates, each round's has the table and the records of those that it evaluated. At the end each area has the same
checkpoint as in a build of one pass, in which candidates that were not evaluated cannot become points. The rounds are
determined by the tables alone, so an interrupted build goes on with what is there, and a build in parts has the same ones.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..arrays import AnyArray, Bytes, Index, Mask
from ..catalog.schema import DETECTION_STEP, Cause
from ..kernels.sun_moments import UNKNOWN
from ..landmarks.selection import SPARE_STAGE, USABLE_STAGE
from ..rendering.plan import ScenePlan
from .area_job import FIRST, SITE, AreaJob, AreaResult
from .assembly import choose
from .checkpoints import Checkpoints, StoredArea, lost_area
from .config import BuildConfig
from .finished_area import FinishedArea, finished_area, record_type, units_of
from .kept_ground import KEPT_AREAS, KEPT_MB, KeptGrounds
from .promise import PromiseChoice
from .recipe import Recipe

ROUNDS = "bc"
"""Steps of the second pass: rounds in which chosen candidates are evaluated."""

_EVALUATED = 2**30
"""More usable conditions than a candidate has: those that are evaluated come first."""


def computed_in_passes(
    recipe: Recipe,
    jobs: Sequence[AreaJob],
    checkpoints: Checkpoints,
    compute: Callable[[Sequence[AreaJob]], dict[str, str]],
    grounds: KeptGrounds,
) -> dict[str, str]:
    """Compute the areas of a recipe in two passes. Return the causes of those that failed, by name. ``compute``: makes
    the checkpoints of jobs that have none, and returns the same. ``grounds``: what it keeps of jobs that ask for it.

    AreaFailedError for an area that is lost or damaged meanwhile.
    """
    keeps = len(jobs) <= KEPT_AREAS
    failed = compute([replace(job, step=FIRST, keeps=keeps) for job in jobs])
    second = _SecondPass(recipe, checkpoints, [job for job in jobs if job.task.name not in failed])
    if not second.jobs:
        return failed
    for step in ROUNDS:
        wanted = second.wanted()
        if not wanted:
            break
        second.forget_others(wanted, step)
        known = second.jobs_of(wanted, step)
        lost = compute([replace(job, ground=grounds.of(job.task.name)) for job in known])
        second.note(wanted, step, lost)
        failed |= lost
    second.finish(settled=not wanted)
    return failed


def known_rounds(
    recipe: Recipe,
    jobs: Sequence[AreaJob],
    checkpoints: Checkpoints,
    missing: Callable[[Sequence[AreaJob]], Sequence[AreaJob]],
) -> dict[str, dict[str, Index]]:
    """The rounds of the second pass of areas whose first looks are finished: by step the rows of the candidates, by area.
    The last has ``missing`` areas, or nothing is left to evaluate.

    AreaFailedError for an area that is lost or damaged meanwhile.
    """
    second, rounds = _SecondPass(recipe, checkpoints, list(jobs)), {}
    for step in ROUNDS:
        wanted = second.wanted()
        if not wanted:
            break
        rounds[step] = wanted
        second.forget_others(wanted, step)
        if missing(second.jobs_of(wanted, step)):
            break
        second.note(wanted, step, {})
    return rounds


def with_sites(job: AreaJob, checkpoints: Checkpoints, rows: Index) -> AreaJob:
    """The job of a round with the candidates that it evaluates: rows of the table of its first look."""
    first = _stored(checkpoints, job.task.name + FIRST)
    number = np.cumsum(first.table["worth"] > 0) - 1
    sums = first.table["checksum"][rows]
    name = job.task.name + FIRST
    return replace(job, sites=checkpoints.records(name, SITE, first.before, number[rows], sums))


def _stored(checkpoints: Checkpoints, name: str) -> StoredArea:
    found = checkpoints.read(name)
    if found is None:
        raise lost_area(checkpoints.path(name))
    return found


def areas_in_passes(
    jobs: Sequence[AreaJob], areas: int, run: Callable[[int, AreaJob], AreaResult]
) -> None:
    """Some areas in two passes, in memory: the choice is among the candidates of all of them, as in a build of these alone.
    ``run``: computes a job of the area with a number, first looks and then rounds; ``areas``: of the whole build, of whose kept
    grounds these have their share.
    """
    recipe, grounds = jobs[0].recipe, KeptGrounds(KEPT_MB * len(jobs) / areas)
    known, sites = [], []
    for k, job in enumerate(jobs):
        look = run(k, replace(job, step=FIRST, keeps=areas <= KEPT_AREAS))
        known.append(_Known.of(finished_area(look, recipe.config, first_look=True)))
        assert look.candidates.sites is not None
        sites.append(look.candidates.sites)
        grounds.keep(job.task.name, look.ground or b"")
    for step in ROUNDS:
        for k, rows in enumerate(_chosen_next(recipe, known)):
            if len(rows):
                ground = grounds.of(jobs[k].task.name) or None
                job = replace(jobs[k], step=step, sites=sites[k][rows], ground=ground)
                known[k].learn(rows, finished_area(run(k, job), recipe.config))


def _chosen_next(recipe: Recipe, areas: Iterable[_Known]) -> list[Index]:
    """The candidates of each area that are chosen by what is known of all, and are not evaluated: their rows."""
    config = recipe.config
    choice = PromiseChoice.of(recipe.region, config)
    tables, evaluated = [], []
    for area in areas:
        tables.append(area.table)
        evaluated.append(area.evaluated)
        if choice:
            choice.see(area.table, area.stages)
    table, done = np.concatenate(tables), np.concatenate(evaluated)
    most = config.points.max_points
    rows = choice.rows(table, most)[0] if choice else _chosen_after(table, done, config)
    rows = np.sort(rows[~done[rows]])
    ends = np.cumsum([len(one) for one in tables])
    each = np.split(rows, np.searchsorted(rows, ends[:-1]))
    return [own - (end - len(one)) for own, end, one in zip(each, ends, tables, strict=True)]


@dataclass
class _SecondPass:
    """The areas of a recipe whose first pass is done, and the rows of each that a round has evaluated."""

    recipe: Recipe
    checkpoints: Checkpoints
    jobs: list[AreaJob]
    rounds: list[tuple[str, dict[str, Index]]] = field(default_factory=list)

    def wanted(self) -> dict[str, Index]:
        """The candidates that are chosen by what is known of all, and are not evaluated: their rows, by area."""
        rows = _chosen_next(self.recipe, (self._known(job.task.name) for job in self.jobs))
        return {job.task.name: own for job, own in zip(self.jobs, rows, strict=True) if len(own)}

    def jobs_of(self, wanted: dict[str, Index], step: str) -> list[AreaJob]:
        """The jobs that evaluate the wanted candidates."""
        return [
            with_sites(replace(job, step=step), self.checkpoints, wanted[job.task.name])
            for job in self.jobs
            if job.task.name in wanted
        ]

    def forget_others(self, wanted: dict[str, Index], step: str) -> None:
        """Remove checkpoints of a round that have other candidates than the wanted: they are of a choice among other areas,
        before one that had failed was computed.
        """
        for name, rows in wanted.items():
            own = self.checkpoints.read(name + step)
            first = _stored(self.checkpoints, name + FIRST).table[rows]
            if own is not None and any(
                not np.array_equal(own.table[at], first[at]) for at in ("lon_deg", "lat_deg")
            ):
                self.checkpoints.path(name + step).unlink(missing_ok=True)

    def note(self, wanted: dict[str, Index], step: str, failed: dict[str, str]) -> None:
        """Note that the wanted candidates are evaluated, but in areas that failed, which are left out."""
        self.jobs = [job for job in self.jobs if job.task.name not in failed]
        self.rounds.append((step, wanted))

    def finish(self, settled: bool) -> None:
        """Make the checkpoints from which the catalogue is written. ``settled``: no candidate that is not evaluated would be
        chosen.
        """
        for job in self.jobs:
            self._finish(job.task.name, settled)

    def _finish(self, name: str, settled: bool) -> None:
        area, kind = self._known(name), record_type(self.recipe.config)
        parts = [np.zeros(0, kind)]
        rows = [np.zeros(0, np.int64)]
        for step, wanted in self.rounds:
            if name not in wanted:
                continue
            own = _stored(self.checkpoints, name + step)
            some = own.table["worth"] > 0
            rows.append(wanted[name][some])
            if some.any():
                sums = own.table["checksum"][some]
                parts.append(
                    self.checkpoints.records(
                        name + step, kind, own.before, np.arange(own.records), sums
                    )
                )
        records = np.concatenate(parts)[np.argsort(np.concatenate(rows))]
        table, stages, others = area.table, area.stages, ~area.evaluated
        table["worth"][others] = table["checksum"][others] = 0
        least = 0 if settled else round(units_of(self.recipe.config).least[0] / DETECTION_STEP)
        stages[others] = _not_evaluated(stages[others], least)
        if not settled:
            table["stage"][others & (table["stage"] == USABLE_STAGE)] = SPARE_STAGE
        plan = ScenePlan.from_json(json.loads(area.plan))
        self.checkpoints.write(name, FinishedArea(table, records, plan, stages))

    def _known(self, name: str) -> _Known:
        """What the first pass, or else a round of the second, knows of an area."""
        first = _stored(self.checkpoints, name + FIRST)
        known = _Known.of(first)
        for step, wanted in self.rounds:
            if name in wanted:
                known.learn(wanted[name], _stored(self.checkpoints, name + step))
        return known


@dataclass(frozen=True)
class _Known:
    """Table, stages and plan of an area as in `checkpoints.StoredArea`, and which of its candidates are evaluated (n,)."""

    table: AnyArray
    stages: Bytes
    evaluated: Mask
    plan: Any

    @classmethod
    def of(cls, first: StoredArea | FinishedArea) -> _Known:
        """What a first look knows."""
        count = len(first.table)
        stages = np.zeros((count, 0), np.uint8) if first.stages is None else first.stages.copy()
        return cls(first.table, stages, np.zeros(count, np.bool_), first.plan)

    def learn(self, rows: Index, own: StoredArea | FinishedArea) -> None:
        """Note what a round has found of rows."""
        self.table[rows], self.evaluated[rows] = own.table, True
        if own.stages is not None:
            self.stages[rows] = own.stages


def _not_evaluated(stages: Bytes, least: int) -> Bytes:
    """The stages (n, 2 cells) of candidates of which only a first look is known: they are worth nothing. ``least``: probability,
    in its steps, from which one would be worth something, and is not examined; 0: none would be chosen.
    """
    causes, codes = np.hsplit(stages, 2)
    if least:
        some = (causes > Cause.MET) & (codes >= least) & (codes < UNKNOWN)
        causes = np.where(some, np.uint8(Cause.NOT_EXAMINED), causes)
    return np.concatenate([causes, np.where(codes < UNKNOWN, np.uint8(0), codes)], axis=1)


def _chosen_after(table: AnyArray, evaluated: Mask, config: BuildConfig) -> Index:
    """`assembly.choose`, but of candidates those that are evaluated first."""
    table = table.copy()
    table["worth"][evaluated & (table["worth"] > 0)] += _EVALUATED
    return choose(table, config)
