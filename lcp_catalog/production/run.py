"""A build: its plan, the computation of its areas, the choice among all candidates, the catalogue.

Points are chosen over all areas together, so that no point is duplicated or missing at the border of
two areas.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .._version import __version__
from ..atomic_files import check_output
from ..catalog.hdf5 import open_catalog
from ..catalog.schema import COVERAGE_STATUS, SCHEMA_VERSION
from ..dem.consistency import warn_of_disagreements
from ..dem.error_maps import ErrorMaps
from ..dem.height_errors import height_errors, warn_of_unknown
from ..dem.mosaic import DemSet
from ..ephemeris.reachable import highest_sun_deg
from ..errors import AreaError, AreaFailedError, SunError
from ..landmarks.error_model import ErrorModel
from ..photometry.albedo_map import AlbedoMap
from ..photometry.facet_file import law_file
from ..photometry.law_choice import LawChoice
from ..terrain.area import Area
from ..terrain.region_warnings import warn_of_region
from ..terrain.useful_cell import Cell, useful_cell
from .area_job import AreaJob, run_area
from .areas import AreaTask
from .assembly import Assembly
from .checkpoints import Checkpoints
from .config import BuildConfig, ModelConfig
from .executor import run_tasks
from .finished_area import FinishedArea, finished_area
from .input_files import InputFiles
from .levels import level_cells, sources, with_sources
from .merging import merge_catalogs
from .promise import PromiseChoice
from .sweep import Conditions, law_of_build
from .worker_memory import caches_mb, divided

log = logging.getLogger(__name__)

_ERROR_PLACES = 33
"""Side of the lattice of places at which a region's height errors are sampled."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Build:
    """A planned build: its region, divided into areas. ``levels``: of a catalogue of several cell sizes, the
    build of each, from fine to coarse; ``cell`` is the finest, and ``jobs`` are those of all.
    """

    config: BuildConfig
    dems: DemSet
    region: Area
    cell: Cell
    jobs: tuple[AreaJob, ...]
    choice: LawChoice
    errors: ErrorModel
    albedo: AlbedoMap | None = None
    maps: ErrorMaps | None = None
    inputs: InputFiles = field(default_factory=InputFiles, compare=False)
    levels: tuple[Build, ...] = ()

    @classmethod
    def plan(
        cls,
        dem_paths: Sequence[Path | str],
        config: BuildConfig,
        memory_gb: float | None = None,
    ) -> Build:
        """Cut the region into areas, for each level of a configuration with several. AreaError if the
        region has none, or for a level that no DEM resolves.

        memory_gb: greatest memory of a process that computes areas (GB); areas are made smaller for it,
        which the build's ``config`` says (`worker_memory.divided`).
        """
        inputs = InputFiles()
        dems = DemSet.open(dem_paths, config.dem.product_order)
        inputs.add(dems.files)
        region = region_of(dems, config)
        config = replace(config, sun=config.sun.at(most_poleward(region)))
        warn_of_disagreements(dems, region.bounds)
        if config.area.region is not None:
            warn_of_region(dems, region, config.area.gsd_m)
        cells = level_cells(config, dems, region)
        cell = cells[0] if cells else _cell(config, dems, region)
        law = law_file(config.model.reflectance)
        choice = law_of_build(config, region.lat_deg)
        inputs.add([law] if law else ())
        albedo = _albedo_map(config.model)
        if albedo:
            inputs.add(albedo.files)
            albedo.check_cover(albedo.cover_of(region, cell.gsd_m), region.bounds)
        maps = ErrorMaps.open(config.dem.sigma_map, config.dem.resolution_map)
        inputs.add(maps.files if maps else ())
        errors = error_model(config, dems, region, maps)
        build = cls(config, dems, region, cell, (), choice, errors, albedo, maps, inputs)
        if len(cells) < 2:
            own = config.at_level(cell.gsd_m) if cells else config
            build = replace(build, config=own)._with_areas(memory_gb)
        else:
            levels = [
                replace(build, config=config.at_level(c.gsd_m), cell=c)._with_areas(
                    memory_gb, number
                )
                for number, c in enumerate(cells)
            ]
            jobs = tuple(job for level in levels for job in level.jobs)
            build = replace(build, jobs=jobs, levels=tuple(levels))
        _require_sunlight([job.task for job in build.jobs], config)
        return build

    def _with_areas(self, memory_gb: float | None, level: int | None = None) -> Build:
        """The build with its areas, as the ``level`` of several."""
        gsd_m = self.gsd_m
        self.config.points.check_cells(gsd_m)
        PromiseChoice.of(self.region, self.config, gsd_m)  # raises ConfigError
        config, grid, tasks = divided(self.region, gsd_m, self.config, memory_gb)
        if not tasks:
            raise AreaError(
                "the region is smaller than a cell: give a larger `area.size_km` or other `area.bounds_deg`"
            )
        tasks = with_sources(tasks, grid, self.dems, sources(config, self.dems, gsd_m))
        if not tasks:
            raise AreaError(f"no DEM that resolves cells of {gsd_m:g} m reaches into the region")
        given = (grid, self.region, gsd_m, config, self.dems, self.choice, self.errors)
        maps = (self.albedo, self.maps, caches_mb(memory_gb))
        jobs = tuple(AreaJob(replace(task, level=level), *given, *maps) for task in tasks)
        return replace(self, config=config, jobs=jobs)

    @property
    def gsd_m(self) -> float:
        """Cell size of the patches, metres."""
        return self.cell.gsd_m

    @property
    def files(self) -> list[Path]:
        """Every file that the build reads, except its configuration."""
        law = law_file(self.config.model.reflectance)
        return [*self.jobs[0].files, *([law] if law else ())]

    def fingerprint(self) -> str:
        """Digest of all that determines the areas' content: version, configuration, bytes of all files.
        AreaFailedError if a file was changed since it was opened.
        """
        self.inputs.digest()
        sources = self.dems.sources()
        config = "".join(
            replace(c, model=c.model.portable, dem=c.dem.portable).to_toml()
            for c in (build.config for build in self.levels or (self,))
        )
        facts: list[Any] = [__version__, SCHEMA_VERSION, config, sources]
        facts += [self.albedo.provenance()] if self.albedo else []
        facts += [self.maps.provenance()] if self.maps else []
        law = law_file(self.config.model.reflectance)
        facts += [hashlib.sha256(law.read_bytes()).hexdigest()] if law else []
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class BuildReport:
    """Result of a build: number of points written and of areas finished, the areas that failed with
    their one-line causes, and the files that were read (except the configuration).
    """

    points: int
    areas: int
    failed: dict[str, str]
    files: tuple[Path, ...]


def _albedo_map(model: ModelConfig) -> AlbedoMap | None:
    """The albedo map of a configuration; None without one."""
    if model.albedo is None:
        return None
    return AlbedoMap.open(model.albedo, model.albedo_encoding, model.albedo_reference)


def _cell(config: BuildConfig, dems: DemSet, region: Area) -> Cell:
    """The configured cell, or the finest useful one."""
    if config.area.gsd_m:
        return Cell(config.area.gsd_m, "as configured")
    cell = useful_cell(dems, region)
    log.info("cells of %.5g m: %s; `area.gsd_m` overrules it", cell.gsd_m, cell.reason)
    return cell


def error_model(
    config: BuildConfig,
    dems: DemSet,
    region: Area,
    maps: ErrorMaps | None,
) -> ErrorModel:
    """The error model of a build: its configuration, completed by the height errors of the DEMs and
    the maps, as medians over the region (`dem.height_errors`). DemError for a map without a value in
    the region.
    """
    places = region.lattice(_ERROR_PLACES)
    if maps is not None:
        maps.check_cover(*places, region.bounds)
    if config.errors.height_sigma_m is None and config.dem.sigma_map is None:
        warn_of_unknown(dems, *places)
    sigma, length = height_errors(dems, *places, maps)
    known = np.isfinite(sigma)
    if not known.any():
        raise AreaError(f"no DEM covers the region ({region.bounds})")
    height_m = float(np.median(sigma[known])), float(np.median(length[known]))
    return config.errors.model(*height_m)


def region_of(dems: DemSet, config: BuildConfig) -> Area:
    """The region of a configuration; by default the bounds of the DEM."""
    return config.area.region or Area.from_bounds(*dems.bounds)


def most_poleward(region: Area) -> float:
    """The region's latitude that is nearest to a pole, degrees."""
    return max(region.bounds[1::2], key=abs)


def build_catalog(
    dem_paths: Sequence[Path | str],
    config: BuildConfig,
    output: Path | str,
    *,
    jobs: int = 1,
    memory_gb: float | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    keep_going: bool = False,
    progress: Progress = lambda done, total: None,
) -> BuildReport:
    """Build a catalogue of control points from DEM files and write it to ``output`` (HDF5).

    jobs: processes that compute areas at the same time; the result does not depend on it. memory_gb: greatest
    memory of each (GB); areas are made smaller for it, and the points near their borders change.
    scheduler: address, or scheduler file, of a dask scheduler that computes the areas instead. resume: keep the finished
    areas of an interrupted run with the same inputs. overwrite: replace an existing output; with
    resume, also finished areas of a run with other inputs.
    keep_going: leave out areas that fail (they are named in the report) instead of raising
    AreaFailedError. progress: called with the number of finished areas and of all areas.

    Raises the library's errors (`errors`): AreaError for a region without cells, ConfigError for a memory
    that is too small for any area, SunError if the Sun
    reaches none of the configured directions, OutputExistsError, and those of the files that are read.
    """
    build = Build.plan(dem_paths, config, memory_gb)
    return run_build(
        build,
        Path(output),
        jobs=jobs,
        scheduler=scheduler,
        resume=resume,
        overwrite=overwrite,
        keep_going=keep_going,
        progress=progress,
    )


def run_build(
    build: Build,
    output: Path,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
    keep_going: bool = False,
    progress: Progress = lambda done, total: None,
) -> BuildReport:
    """Run a planned build and write the catalogue; options as in `build_catalog`.

    Finished areas are kept beside the output until the catalogue has been written.
    """
    check_output(output, overwrite, build.files)
    checkpoints = Checkpoints.beside(output, build.fingerprint())
    with checkpoints.locked():
        checkpoints.begin(resume, overwrite)
        failed = compute_areas(
            build, build.jobs, checkpoints, jobs, scheduler, keep_going, progress
        )
        return finish(build, output, checkpoints, failed, overwrite)


def finish(
    build: Build,
    output: Path,
    checkpoints: Checkpoints,
    failed: dict[str, str],
    overwrite: bool,
) -> BuildReport:
    """Write the catalogue from the checkpoints of all areas but those that failed (causes by name), and
    remove them.
    """
    names = [job.task.name for job in build.jobs if job.task.name not in failed]
    if not names:
        raise AreaFailedError(
            f"all {len(build.jobs)} areas failed; the first: {next(iter(failed.values()))}"
        )
    if build.levels:
        points = _write_levels(build, output, checkpoints, names, overwrite)
    else:
        points = _write(build, output, checkpoints, names, overwrite)
    checkpoints.remove()
    if not points:
        _warn_of_no_points(output)
    return BuildReport(points, len(names), failed, tuple(build.files))


_HELP = {
    "featureless": "a finer `area.gsd_m`, known `errors.height_sigma_m` or a smaller `errors.sensor_noise` help",
    "ambiguous": "a smaller `points.search_m` helps",
    "dependent": "lower limits of dependence (`points.max_dependence`) or higher `sun.elevations_deg` help",
    "nodata": "another area or DEM helps",
}
"""What helps where most cells have no point for a reason of `schema.COVERAGE_STATUS`."""


def _warn_of_no_points(output: Path) -> None:
    """Log a warning about a catalogue without points, with its cells by cause."""
    status = np.asarray(open_catalog(output).coverage.status)
    counts = {cause: int((status == code).sum()) for code, cause in COVERAGE_STATUS.items()}
    most = max(_HELP, key=lambda cause: counts[cause])
    cells = ", ".join(f"{count} {cause}" for cause, count in counts.items() if count)
    log.warning(
        "%s: holds no point; cells by cause: %s; where most are %s, %s",
        output,
        cells or "none",
        most,
        _HELP[most],
    )


def _write(
    build: Build, output: Path, checkpoints: Checkpoints, names: Sequence[str], overwrite: bool
) -> int:
    """Write the catalogue of the areas ``names``; the number of points."""
    assembly = Assembly(
        build.config,
        build.dems,
        build.region,
        build.gsd_m,
        build.choice.model,
        build.errors,
        build.albedo,
        build.maps,
    )
    return assembly.write(checkpoints, names, output, overwrite, build.inputs.require_unchanged)


def _write_levels(
    build: Build, output: Path, checkpoints: Checkpoints, names: Sequence[str], overwrite: bool
) -> int:
    """Write a catalogue of each level beside the checkpoints, and join them; the number of points."""
    finished, files = set(names), []
    for number, level in enumerate(build.levels):
        own = [job.task.name for job in level.jobs if job.task.name in finished]
        if own:
            files.append(checkpoints.level_file(number))
            _write(level, files[-1], checkpoints, own, overwrite=True)
    return merge_catalogs(files, output, overwrite).points


def compute_areas(
    build: Build,
    areas: Sequence[AreaJob],
    checkpoints: Checkpoints,
    jobs: int,
    scheduler: str | None,
    keep_going: bool,
    progress: Progress,
) -> dict[str, str]:
    """Compute those of a build's areas that have no checkpoint; options as in `build_catalog`. Return
    the causes of those that failed, by name. AreaFailedError if an input file is changed meanwhile: no
    area that may have read it is kept.
    """
    todo = missing(areas, checkpoints)
    todo.sort(key=lambda job: job.work, reverse=True)  # no worker ends with a long one alone
    todo = _in_turn(todo, jobs)
    done, failed = len(areas) - len(todo), {}
    progress(done, len(areas))
    inputs = areas[0].files if areas else ()
    for index, outcome in run_tasks(_finished_area, todo, jobs, scheduler, inputs):
        build.inputs.require_unchanged()
        name = todo[index].task.name
        if isinstance(outcome, Exception):
            cause = f"area {name} at {todo[index].task.lon_deg:.3f}, {todo[index].task.lat_deg:.3f}: {outcome}"
            if not keep_going:
                raise AreaFailedError(
                    f"{cause} (finished areas are kept: run again with `resume`)"
                ) from outcome
            log.warning("%s", cause)
            failed[name] = cause
        else:
            checkpoints.write(name, outcome)
        done += 1
        progress(done, len(areas))
    return failed


def _in_turn(areas: list[AreaJob], parts: int) -> list[AreaJob]:
    """The areas in turn from as many parts of the list: a worker that gets every ``parts``-th one stays
    in its part, whose areas are neighbours and read the same blocks of the DEM.
    """
    size = -(-len(areas) // parts) or 1
    places = sorted(range(len(areas)), key=lambda k: (k % size, k // size))
    return [areas[k] for k in places]


def missing(areas: Sequence[AreaJob], checkpoints: Checkpoints) -> list[AreaJob]:
    """The areas without an undamaged checkpoint."""
    return [job for job in areas if not checkpoints.is_whole(job.task.name)]


def _finished_area(job: AreaJob) -> FinishedArea:
    """What is kept of an area; computed where the area is, so that nothing else is sent."""
    return finished_area(run_area(job), job.config, job.gsd_m)


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
