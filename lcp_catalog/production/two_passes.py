"""A build of two passes: the first looks at all candidates of all areas, the choice is made by that, and the second evaluates
the chosen ones; what fails is replaced, in a few rounds.

What each pass leaves of an area is a checkpoint with a letter of its own: that of the first has the table and the sites of
the candidates, each round's has the table and the records of those that it evaluated. At the end each area has the same
checkpoint as in a build of one pass, in which candidates that were not evaluated cannot become points. The rounds are
determined by the tables alone, so an interrupted build goes on with what is there, and a build in parts has the same ones.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import AnyArray, Bytes, Index, Mask
from ..catalog.schema import Cause
from ..landmarks.selection import SPARE_STAGE, USABLE_STAGE
from ..rendering.plan import ScenePlan
from .area_job import FIRST, SITE, AreaJob, AreaResult, run_area
from .assembly import choose
from .checkpoints import Checkpoints, StoredArea, lost_area
from .config import BuildConfig
from .finished_area import UNIT, FinishedArea, finished_area, record_type
from .kept_ground import KEPT_AREAS, KeptGrounds
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


def area_in_passes(job: AreaJob) -> AreaResult:
    """An area alone in two passes, without replacements: the result of its chosen candidates."""
    config = job.recipe.config
    result = run_area(replace(job, step=FIRST, keeps=True))
    look = finished_area(result, config, first_look=True)
    choice = PromiseChoice.of(job.recipe.region, config)
    if choice and look.stages is not None:
        choice.see(look.table, look.stages)
    rows = choice.rows(look.table, None) if choice else choose(look.table, config)
    assert result.candidates.sites is not None
    sites = result.candidates.sites[np.sort(rows)]
    return run_area(replace(job, step=ROUNDS[0], sites=sites, ground=result.ground))


@dataclass
class _SecondPass:
    """The areas of a recipe whose first pass is done, and the rows of each that a round has evaluated."""

    recipe: Recipe
    checkpoints: Checkpoints
    jobs: list[AreaJob]
    rounds: list[tuple[str, dict[str, Index]]] = field(default_factory=list)

    def wanted(self) -> dict[str, Index]:
        """The candidates that are chosen by what is known of all, and are not evaluated: their rows, by area."""
        config = self.recipe.config
        choice = PromiseChoice.of(self.recipe.region, config)
        tables, evaluated = [], []
        for job in self.jobs:
            area = self._known(job.task.name)
            tables.append(area.table)
            evaluated.append(area.evaluated)
            if choice:
                choice.see(area.table, area.stages)
        table, done = np.concatenate(tables), np.concatenate(evaluated)
        most = config.points.max_points
        rows = choice.rows(table, most) if choice else _chosen_after(table, done, config)
        rows = np.sort(rows[~done[rows]])
        ends = np.cumsum([len(one) for one in tables])
        area_of = np.searchsorted(ends, rows, side="right")
        found = {}
        for k in np.unique(area_of).tolist():
            own = rows[area_of == k]
            found[self.jobs[k].task.name] = own - (ends[k] - len(tables[k]))
        return found

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
        stages[others] = _not_evaluated(stages[others], settled)
        if not settled:
            table["stage"][others & (table["stage"] == USABLE_STAGE)] = SPARE_STAGE
        plan = ScenePlan.from_json(json.loads(area.plan))
        self.checkpoints.write(name, FinishedArea(table, records, plan, stages))

    def _known(self, name: str) -> _Known:
        """What the first pass, or else a round of the second, knows of an area."""
        first = _stored(self.checkpoints, name + FIRST)
        table, stages = first.table, first.stages.copy()
        evaluated = np.zeros(len(table), np.bool_)
        for step, wanted in self.rounds:
            if name in wanted:
                own, rows = _stored(self.checkpoints, name + step), wanted[name]
                table[rows], stages[rows] = own.table, own.stages
                evaluated[rows] = True
        return _Known(table, stages, evaluated, first.plan)


@dataclass(frozen=True)
class _Known:
    """Table, stages and plan of an area as in `checkpoints.StoredArea`, and which of its candidates are evaluated (n,)."""

    table: AnyArray
    stages: Bytes
    evaluated: Mask
    plan: str


def _not_evaluated(stages: Bytes, settled: bool) -> Bytes:
    """The stages (n, cells) of candidates of which only a first look is known: they are worth nothing."""
    causes = stages % np.uint8(UNIT)
    return causes if settled else np.where(stages >= UNIT, np.uint8(Cause.NOT_EXAMINED), causes)


def _chosen_after(table: AnyArray, evaluated: Mask, config: BuildConfig) -> Index:
    """`assembly.choose`, but of candidates those that are evaluated first."""
    table = table.copy()
    table["worth"][evaluated & (table["worth"] > 0)] += _EVALUATED
    return choose(table, config)
