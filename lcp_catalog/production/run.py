"""A build: its plan, the computation of its areas, whole or in parts, and the catalogue.

Points are chosen over all areas together, so that no point is duplicated or missing at the border of
two areas.

Parts are computed by processes without a connection on a shared disk: the tasks of an array job. Part
K of N computes the areas K, K + N, K + 2 N ... into the checkpoints beside the output, in any order, at
the same time or not. The merge writes the catalogue, the same as that of one build. Of two passes each is computed in parts;
between them the choice is made (`BuildRun.select`).
"""

from __future__ import annotations

import logging
import tempfile
import time
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from ..arrays import Index
from ..atomic_files import are_as_noted, check_output, file_facts, unread_facts
from ..catalog.stored import StoredFile, stored_catalog
from ..dem.disagreements import warn_of_disagreements
from ..dem.effective_resolution import WINDOW_PX
from ..dem.mosaic import DemSet
from ..dem.plausibility import refuse_zeros, warn_of_doubts
from ..ephemeris.solar_position import highest_sun_deg
from ..errors import AreaError, AreaFailedError, ConfigError, OutputExistsError, SunError
from ..photometry.facet_model import law_file
from ..stages import Progress, unseen
from ..terrain.area import Area
from ..terrain.useful_cell import Cell, warn_of_region
from ..threads import limit_threads
from .area_job import FIRST, AreaJob, run_area
from .areas import AreaTask, reached
from .assembly import Assembly
from .build_decisions import turned_text
from .camera_views import Seen, for_images
from .checkpoints import Checkpoints, fingerprint
from .code_facts import code_facts
from .config import BuildConfig
from .cures import TRY_S, Trial, Yield, warn_of_lone_elevations, warn_of_small_footprint
from .executor import SharedWorkers, run_tasks
from .finished_area import FinishedArea, finished_area
from .kept_ground import KEPT_MB, KeptGrounds
from .merging import merge_catalogs
from .promise import PromiseChoice
from .recipe import InputFiles, Recipe, cells
from .sweep import Conditions
from .two_passes import ROUNDS, computed_in_passes, known_rounds, with_sites
from .warm_up import compile_kernels, missing
from .worker_memory import caches_mb, divided, worker_mb

log = logging.getLogger(__name__)

_READ_BYTES_S, _READ_SHARE = 3e8, 0.05
"""Rate at which a file is read for its sum, and the most that this may take of the time that a part has spent."""


@dataclass(frozen=True)
class Level:
    """The areas of one cell size of a build."""

    recipe: Recipe
    cell: Cell
    jobs: tuple[AreaJob, ...]
    kept_mb: float = KEPT_MB
    """Memory for what two passes keep of areas (`kept_ground`)."""

    @classmethod
    def plan(cls, recipe: Recipe, cell: Cell, memory_gb: float | None, number: int | None) -> Level:
        """Divide the region into areas. AreaError if it has none. ``number``: of the level among
        several.
        """
        config = recipe.config
        config.points.check_cells(cell.gsd_m)
        promised = PromiseChoice.of(recipe.region, config)  # raises ConfigError
        warn_of_small_footprint(recipe.region, config.points, cell.gsd_m)
        if promised is not None:
            warn_of_lone_elevations(config)
        config, grid, tasks = divided(recipe.region, config, memory_gb)
        if not tasks:
            raise AreaError(
                "the region is smaller than a cell: give a larger `area.size_km` or other `area.bounds_deg`"
            )
        recipe = replace(recipe, config=config)
        tasks = reached(tasks, grid, recipe.dems, recipe.sources)
        if not tasks:
            raise AreaError(
                f"no DEM that resolves cells of {cell.gsd_m:g} m reaches into the region"
            )
        cached_mb, kept_mb = caches_mb(memory_gb), KEPT_MB
        if memory_gb is not None:
            kept_mb = min(kept_mb, 1e3 * memory_gb - worker_mb(tasks, config, memory_gb))
        jobs = (AreaJob(recipe, replace(task, level=number), grid, cached_mb) for task in tasks)
        return cls(recipe, cell, tuple(jobs), kept_mb)


@dataclass(frozen=True)
class Build:
    """A planned build: its cell sizes, from fine to coarse, and the files as they were opened."""

    levels: tuple[Level, ...]
    inputs: InputFiles = field(compare=False)
    claimed_share: float | None = None  # of the pixels of the images that it is for

    @classmethod
    def plan(
        cls,
        dem_paths: Sequence[Path | str],
        config: BuildConfig,
        memory_gb: float | None = None,
        seen: Seen | None = None,
    ) -> Build:
        """Cut the region into areas, for each level of a configuration with several. AreaError if the
        region has none, or for a level that no DEM resolves; DemError for DEMs without a surface.

        seen: what the images see that the catalogue is for; it gives the views, and what the configuration leaves
        open (`camera_views.for_images`).

        memory_gb: greatest memory of a process that computes areas (GB); areas are made smaller for it,
        which the recipes' ``config`` says (`run.divided`).
        """
        inputs = InputFiles()
        dems = DemSet.open(dem_paths, config.dem.product_order)
        dems.require_surface()
        inputs.add(dems.files)
        if seen is not None:
            config = for_images(config, seen, dems)
        region = config.area.region or Area.from_bounds(*dems.bounds)
        x0, x1, y0, y1 = region.extent_m
        config.points.check_size(max(x1 - x0, y1 - y0))
        config = replace(config, sun=config.sun.at(most_poleward(region)))
        warn_of_disagreements(dems, region.bounds)
        refuse_zeros(dems, region.bounds, WINDOW_PX)
        warn_of_doubts(dems, region.bounds, WINDOW_PX)
        if config.area.region is not None:
            warn_of_region(dems, region, config.area.gsd_m)
        chosen = cells(config, dems, region)
        dems.require_patch(config.points.patch_nodes, chosen[0].gsd_m)
        recipe = Recipe.of(config.at_cell(chosen[0].gsd_m), dems, region, inputs)
        levels = tuple(
            Level.plan(recipe.at_cell(cell.gsd_m), cell, memory_gb, k if len(chosen) > 1 else None)
            for k, cell in enumerate(chosen)
        )
        share = None if seen is None else seen.claimed_share(config.view)
        build = cls(levels, inputs, share)
        _require_sunlight([job.task for job in build.jobs], config)
        return build

    @property
    def recipe(self) -> Recipe:
        """The recipe of the finest cells."""
        return self.levels[0].recipe

    @cached_property
    def jobs(self) -> tuple[AreaJob, ...]:
        """The areas of all levels."""
        return tuple(job for level in self.levels for job in level.jobs)

    @property
    def files(self) -> list[Path]:
        """Every file that the build reads, except its configuration."""
        law = law_file(self.recipe.config.model.reflectance)
        return [*self.recipe.files, *([law] if law else ())]

    def facts(self, files: Any = None) -> dict[str, str]:
        """All that determines the areas' content, by name: code, libraries and processor, and digests of
        configuration and files. AreaFailedError if a file was changed since it was opened. ``files``: what stands for
        their content, in place of their sums (`noted_files`).
        """
        if files is None:
            self.inputs.digest()
            files = file_facts(self.files)
        configs = (level.recipe.config for level in self.levels)
        texts = [replace(c, model=c.model.portable, dem=c.dem.portable).to_toml() for c in configs]
        own = {"configuration": texts, "content of the files": files}
        return code_facts() | {name: fingerprint(facts) for name, facts in own.items()}


@dataclass(frozen=True)
class BuildReport:
    """Result of a build: number of points written and of areas finished, the areas that failed with
    their one-line causes, and the files that were read (except the configuration).
    """

    points: int
    areas: int
    failed: dict[str, str]
    files: tuple[Path, ...]


@dataclass(frozen=True)
class BuildPart:
    """Part ``number`` (from 1) of ``count``. ConfigError if there is no such part."""

    number: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise ConfigError(f"part {self}: K of K/N must be between 1 and N")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def share(self, jobs: Sequence[AreaJob]) -> Sequence[AreaJob]:
        """The part's areas of all those of a build."""
        return jobs[self.number - 1 :: self.count]


@dataclass(frozen=True)
class PartState:
    """State of a part: the number of its areas, and the names of those that are not computed yet."""

    part: BuildPart
    areas: int
    missing: tuple[str, ...]


class Choice(NamedTuple):
    """What a `BuildRun.select` leaves to evaluate: candidates, and areas in which they are."""

    candidates: int
    areas: int


def most_poleward(region: Area) -> float:
    """The region's latitude that is nearest to a pole, degrees."""
    return max(region.bounds[1::2], key=abs)


@dataclass(frozen=True)
class BuildRun:
    """A planned build that is carried out, whole or in parts; options as in `build_catalog`. ConfigError
    for less than one job.

    Finished areas are kept beside the output until the catalogue has been written.
    """

    build: Build
    output: Path
    jobs: int = 1
    scheduler: str | None = None
    resume: bool = False
    overwrite: bool = False
    keep_going: bool = False
    progress: Progress = unseen
    advises: bool = True
    """False: no warning about a catalogue that is poor."""
    try_cures_s: float | None = 0.0
    _spent_s: list[float] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ConfigError(f"`jobs` must be at least 1, not {self.jobs}")

    @cached_property
    def checkpoints(self) -> Checkpoints:
        """The finished areas beside the output: of the run that is noted there, if the input files are those of that run."""
        noted, files = Checkpoints.noted_files(self.output), self.build.files
        if not are_as_noted(files, noted):
            noted = unread_facts(files, self.output.resolve().parent)
        return Checkpoints.beside(self.output, self.build.facts(noted), noted)

    def whole(self) -> BuildReport:
        """Compute all areas and write the catalogue. Raises as `build_catalog`."""
        check_output(self.output, self.overwrite, self.build.files)
        Checkpoints.noted_files(self.output)
        self.build.inputs.digest()
        with self.checkpoints.locked():
            self.checkpoints.begin(self.resume, self.overwrite)
            return self.finish(self._computed())

    def part(self, part: BuildPart) -> dict[str, str]:
        """Compute the areas of a part that have no checkpoint yet. Return the causes of those that
        failed, by name (with ``keep_going``).

        Raises OutputExistsError while a whole build of the output runs, and if the checkpoints there are
        of a build with other inputs; AreaFailedError for an area that fails.
        """
        check_output(self.output, self.overwrite, self.build.files)
        with self.checkpoints.locked(shared=True):
            self._join(part.count)
            failed = self._compute(self._with_sites(part.share(self.pass_jobs)))
            self.checkpoints.note_sums()
            return failed

    @property
    def pass_jobs(self) -> list[AreaJob]:
        """The areas of the pass at which a build in parts is, without their sites: of two passes all until `select` has
        chosen, then those with chosen candidates.
        """
        if not self._two_passes:
            return list(self.build.jobs)
        chosen = self.checkpoints.chosen()
        if chosen is None:
            return [replace(job, step=FIRST) for job in self.build.jobs]
        return [
            replace(job, step=step)
            for step, areas in chosen.items()
            for job in self.build.jobs
            if job.task.name in areas
        ]

    def _with_sites(self, jobs: Sequence[AreaJob]) -> Sequence[AreaJob]:
        """Jobs of `pass_jobs` as they are computed. First looks that are damaged are computed again."""
        chosen = self.checkpoints.chosen() if self._two_passes else None
        if chosen is None:
            return jobs
        jobs = self._missing(jobs)
        if looks := self._missing([replace(job, step=FIRST) for job in jobs]):
            self._compute(looks)
        return [with_sites(job, self.checkpoints, chosen[job.step][job.task.name]) for job in jobs]

    def select(self) -> Choice:
        """Choose the candidates that the second of two passes evaluates, when all parts have had the first look; after its
        first round those that replace what failed in it, if there are any. Parts evaluate them when they are run again.

        AreaFailedError if areas are missing, unless ``keep_going`` leaves them out; OutputExistsError while parts are
        running; ConfigError for a build of one pass.
        """
        if not self._two_passes:
            raise ConfigError("a choice between two passes needs `points.passes` 2")
        with self._parts_alone():
            left = self._left([replace(job, step=FIRST) for job in self.build.jobs])
            rounds: dict[str, dict[str, Index]] = {step: {} for step in ROUNDS}
            for level in self.build.levels:
                if jobs := [job for job in level.jobs if job.task.name not in left]:
                    own = known_rounds(level.recipe, jobs, self.checkpoints, self._missing)
                    for step, areas in own.items():
                        rounds[step] |= areas
            self.checkpoints.write_chosen(rounds)
            todo = self._missing(self.pass_jobs)
            return Choice(sum(len(rounds[job.step][job.task.name]) for job in todo), len(todo))

    @contextmanager
    def _parts_alone(self) -> Iterator[None]:
        """The folder of the parts, for this process alone."""
        check_output(self.output, self.overwrite, self.build.files)
        folder = self.checkpoints.folder
        if not folder.is_dir():
            raise AreaFailedError(f"{folder}: no area is computed; run the parts first")
        with self.checkpoints.locked():
            self.checkpoints.begin(resume=True)
            yield

    def _left(self, jobs: Sequence[AreaJob]) -> dict[str, str]:
        """The causes by which areas are left out, by name: they are missing. AreaFailedError without ``keep_going``."""
        left = [job.task.name for job in self._missing(jobs)]
        if left and not self.keep_going:
            raise AreaFailedError(
                f"{self.checkpoints.folder}: {len(left)} of {len(jobs)} areas are missing, the first: {left[0]}; run "
                "their parts again (`list_parts` names them)"
            )
        return {name: f"area {name} is not computed" for name in left}

    def _join(self, parts: int) -> None:
        try:
            self.checkpoints.join(parts)
        except (
            OutputExistsError
        ):  # another part has noted its files meanwhile, read or not: are they the same?
            vars(self).pop("checkpoints")
            self.checkpoints.join(parts)

    def _read_inputs(self, spent_s: float) -> None:
        """Note the content of input files that parts know by their states alone, as soon as that takes a small share of
        what was spent: from then on a file that is only touched, or copied, is known again.
        """
        unread_s = self.build.inputs.unread_bytes / _READ_BYTES_S
        if 0.0 < unread_s < _READ_SHARE * spent_s:
            self.build.inputs.digest()
            self.checkpoints.note_sums()

    def list_parts(self) -> list[PartState]:
        """The states of all parts; of one part that is the whole if none has been started.
        OutputExistsError if the checkpoints beside the output are of a build with other inputs.
        """
        self.checkpoints.require_same_run()
        count = self.checkpoints.parts or 1
        parts = [BuildPart(k + 1, count) for k in range(count)]
        shares = [(part, part.share(self.pass_jobs)) for part in parts]
        return [
            PartState(part, len(share), tuple(job.task.name for job in self._missing(share)))
            for part, share in shares
        ]

    def merge(self) -> BuildReport:
        """Write the catalogue from the areas that the parts have computed, and remove these.

        AreaFailedError if areas are missing, unless ``keep_going`` leaves them out (they are named in the
        report); OutputExistsError while parts are running. Of two passes the second must be computed, too; what its first
        round leaves to evaluate is evaluated here unless `select` has given it to the parts.
        """
        with self._parts_alone():
            left = self._left(
                [replace(job, step=FIRST) for job in self.build.jobs]
                if self._two_passes
                else self.build.jobs
            )
            if self._two_passes:
                if self.checkpoints.chosen() is None:
                    raise AreaFailedError(
                        f"{self.checkpoints.folder}: only the first of two passes is computed; run `select`, then the "
                        "parts again"
                    )
                self._left(self.pass_jobs)
                left |= self._in_passes(left)
            self.build.inputs.digest()
            return self.finish(left)

    def finish(self, failed: dict[str, str]) -> BuildReport:
        """Write the catalogue from the checkpoints of all areas but those that failed (causes by name),
        and remove them.
        """
        levels = [
            (number, level.recipe, names)
            for number, level in enumerate(self.build.levels)
            if (names := [job.task.name for job in level.jobs if job.task.name not in failed])
        ]
        if not levels:
            raise AreaFailedError(
                f"all {len(self.build.jobs)} areas failed; the first: {next(iter(failed.values()))}"
            )
        check = self.build.inputs.require_unchanged
        if len(self.build.levels) == 1:
            ((_, recipe, names),) = levels
            assembly = Assembly(recipe, self.checkpoints, names)
            points = assembly.write(self.output, self.overwrite, check)
        else:
            files = []
            for number, recipe, names in levels:
                files.append(self.checkpoints.level_file(number))
                Assembly(recipe, self.checkpoints, names).write(files[-1], True, check)
            points = merge_catalogs(files, self.output, self.overwrite, of_one_build=True).points
        self.checkpoints.remove()
        if self.advises:
            spent_s = sum(self._spent_s)
            limit_s = self.try_cures_s
            if limit_s is None:
                limit_s = min(TRY_S, spent_s or TRY_S)
            Trial(self.build, self._small, limit_s, spent_s).warn(self.output)
            config = self.build.recipe.config
            model, exact = config.model, config.model.precision
            suns_deg, own_deg = config.sun.elevations_deg, exact.own_sun_deg
            if text := turned_text(model.direction_tolerance_deg, own_deg, suns_deg):
                log.info("%s: accuracy %s: %s", self.output, exact.tier, text)
        areas = len(self.build.jobs) - len(failed)
        return BuildReport(points, areas, failed, tuple(self.build.files))

    def _small(self, config: BuildConfig) -> Yield:
        """What the catalogue of a small region and one cell size has, of the build's own DEMs, made in this process."""
        region = config.area.region
        assert region is not None
        recipe = Recipe.of(config, self.build.recipe.dems, region, InputFiles())
        cell = replace(self.build.levels[0].cell, gsd_m=config.gsd_m)
        level = Level.plan(recipe, cell, None, None)
        with tempfile.TemporaryDirectory() as folder, limit_threads(self.jobs):
            output = Path(folder, "c.h5")
            finished = Checkpoints.beside(output, {})
            with finished.locked():
                for job in level.jobs:
                    finished.write(job.task.name, _finished_area(job))
                names = [job.task.name for job in level.jobs]
                Assembly(level.recipe, finished, names).write(output, False, lambda: None)
            return Yield.of(stored_catalog(StoredFile.of(output)))

    @property
    def _two_passes(self) -> bool:
        return self.build.recipe.config.points.two_passes

    def _computed(self) -> dict[str, str]:
        """Compute all areas. Return the causes of those that failed, by name."""
        if not self._two_passes or not self._missing(self.build.jobs):
            return self._compute(self.build.jobs)
        return self._in_passes()

    def _in_passes(self, left: Container[str] = ()) -> dict[str, str]:
        """Compute all areas in two passes but those that are ``left`` out. Return the causes of those that failed, by name."""
        failed: dict[str, str] = {}
        total, done = 2 * len(self.build.jobs), 0
        with SharedWorkers() as workers:
            for level in self.build.levels:
                both = range(done, done + 2 * len(level.jobs))
                some = [job for job in level.jobs if job.task.name not in left]
                if not some:
                    continue
                grounds = KeptGrounds(level.kept_mb)

                def compute(
                    jobs: Sequence[AreaJob], both: range = both, grounds: KeptGrounds = grounds
                ) -> dict[str, str]:
                    steps = {FIRST: both.start, ROUNDS[0]: both.stop - len(jobs)}
                    before = steps.get(jobs[0].step, both.stop)

                    def told(k: int, _: int) -> None:
                        self.progress(min(before + k, both.stop), total)

                    return self._compute(jobs, told, grounds, workers)

                failed |= computed_in_passes(level.recipe, some, self.checkpoints, compute, grounds)
                done = both.stop
        self.progress(total, total)
        return failed

    def _compute(
        self,
        areas: Sequence[AreaJob],
        progress: Progress | None = None,
        grounds: KeptGrounds | None = None,
        workers: SharedWorkers | None = None,
    ) -> dict[str, str]:
        """Compute those of the areas that have no checkpoint, in ``workers``, and keep their ``grounds``. Return the causes of
        those that failed, by name. AreaFailedError if an input file is changed meanwhile: no area that may have read it is
        kept.
        """
        progress = progress or self.progress
        todo = self._missing(areas)
        todo.sort(key=lambda job: job.work, reverse=True)  # no worker ends with a long one alone
        todo = _in_turn(todo, self.jobs)
        done, failed = len(areas) - len(todo), {}
        if todo and self.jobs > 1 and self.scheduler is None:
            compile_kernels(missing("build-catalog"))  # else each worker compiles them
        progress(done, len(areas))
        inputs, start = self.build.recipe.files, time.monotonic()
        for index, outcome in run_tasks(
            _finished_area, todo, self.jobs, self.scheduler, inputs, workers
        ):
            self.build.inputs.require_unchanged()
            task = todo[index].task
            if isinstance(outcome, Exception):
                cause = f"area {task.name} at {task.lon_deg:.3f}, {task.lat_deg:.3f}: {outcome}"
                if not self.keep_going:
                    raise AreaFailedError(
                        f"{cause} (finished areas are kept: run again with `resume`)"
                    ) from outcome
                log.warning("%s", cause)
                failed[task.name] = cause
            else:
                self.checkpoints.write(todo[index].name, outcome)
                if grounds and outcome.ground:
                    grounds.keep(task.name, outcome.ground)
            done += 1
            progress(done, len(areas))
            self._read_inputs(time.monotonic() - start)
        count = 1 if self.scheduler else max(1, min(self.jobs, len(todo)))
        self._spent_s.append(count * (time.monotonic() - start) if todo else 0.0)
        return failed

    def _missing(self, areas: Sequence[AreaJob]) -> list[AreaJob]:
        """The areas without an undamaged checkpoint."""
        return [job for job in areas if not self.checkpoints.is_whole(job.name)]


def _in_turn(areas: list[AreaJob], parts: int) -> list[AreaJob]:
    """The areas in turn from as many parts of the list: a worker that gets every ``parts``-th one stays
    in its part, whose areas are neighbours and read the same blocks of the DEM.
    """
    size = -(-len(areas) // parts) or 1
    places = sorted(range(len(areas)), key=lambda k: (k % size, k // size))
    return [areas[k] for k in places]


def _finished_area(job: AreaJob) -> FinishedArea:
    """What is kept of an area; computed where the area is, so that nothing else is sent."""
    return finished_area(run_area(job), job.recipe.config, first_look=job.step == FIRST)


def _require_sunlight(tasks: list[AreaTask], config: BuildConfig) -> None:
    """Raise SunError if no configured Sun direction ever occurs in the region."""
    if any(Conditions.at(task.lat_deg, config).reachable.any() for task in tasks):
        return
    least = min(abs(task.lat_deg) for task in tasks)
    lowest = min(config.sun.elevations_deg)
    if lowest <= highest_sun_deg(least):
        raise SunError(
            f"the Sun never reaches the requested directions: at latitude {least:.1f} deg it does not stand at these "
            "elevations in these azimuths; give other `sun.elevations_deg` or `sun.azimuths_deg`"
        )
    raise SunError(
        f"the Sun never reaches the requested directions: at latitude {least:.1f} deg its elevation is at most "
        f"{highest_sun_deg(least):.1f} deg, the lowest of `sun.elevations_deg` is {lowest:g}; give lower ones"
    )
