"""``lcp build-catalog``: a catalogue of control points from DEMs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lcp_catalog.stages import Progress, unseen

from . import options
from .build_options import OPTIONS, PartParam, build_options
from .files import FileCommand, OutputFile, depfile_option
from .groups import collected
from .messages import echo, log_format_option, say
from .names import option as option_of
from .value_types import POSITIVE, Number
from .warm_up import compile_missing

if TYPE_CHECKING:
    from lcp_catalog.production.camera_views import Seen
    from lcp_catalog.production.config import BuildConfig
    from lcp_catalog.production.run import Build, BuildReport, BuildRun

EXIT_SOME_FAILED = 3
JOBS_MAX = max(64, 4 * (os.cpu_count() or 1))
"""Most processes that can be asked for."""

_NAMES = 8
"""Greatest number of missing areas that are named for a part."""


@dataclass(frozen=True)
class Planned:
    """What is built: the DEMs, the configuration, the images that it is for, and the memory of a process."""

    dem: tuple[str, ...]
    config: BuildConfig
    images: PlannedImages
    memory_gb: float | None

    @cached_property
    def build(self) -> Build:
        """The plan."""
        from lcp_catalog.production.run import Build

        return Build.plan(self.dem, self.config, self.memory_gb, self.images.seen())


@dataclass(frozen=True)
class PlannedImages:
    """The images that a catalogue is for, by one of three ways."""

    camera: tuple[str, ...]
    trajectory: str | None
    field_of_view_deg: float | None
    altitude_km: float | None

    def __post_init__(self) -> None:
        field = self.field_of_view_deg is not None
        if field != (self.altitude_km is not None):
            raise click.UsageError("--field-of-view and --altitude go together")
        if field and (self.camera or self.trajectory):
            raise click.UsageError(
                "--field-of-view and --camera or --trajectory exclude each other"
            )
        if self.trajectory and len(self.camera) > 1:
            raise click.UsageError("--trajectory takes one --camera")

    def seen(self) -> Seen | None:
        """What the images see; None without images."""
        if not (self.camera or self.trajectory or self.field_of_view_deg):
            return None

        from lcp_catalog.cameras.camera_file import read_camera, read_sensor
        from lcp_catalog.navigation.trajectory_file import read_trajectory
        from lcp_catalog.production.camera_views import Seen

        if self.field_of_view_deg is not None and self.altitude_km is not None:
            return Seen.from_above(self.field_of_view_deg, self.altitude_km)
        if self.trajectory:
            one = read_camera(self.camera[0]) if self.camera else None
            return Seen.by(read_trajectory(self.trajectory, one))
        return Seen.by(map(read_sensor, self.camera))


image_options = collected(
    "images",
    PlannedImages,
    options.camera_file_option(
        "Camera of an image that the catalogue is for; repeat for more. It gives the views and, unless they are "
        "stated, the Suns (of the camera's Sun or time), the cells, the footprint and the region.",
        multiple=True,
    ),
    options.trajectory_option(
        "The same for the frames of a trajectory, as in lcp query; a CSV needs --camera."
    ),
    click.option(
        "--field-of-view",
        "field_of_view_deg",
        type=Number(0.0, 180.0, min_open=True, max_open=True),
        metavar="DEG",
        help="The same for a camera that looks straight down anywhere: angle along a side of its square image. It gives "
        "views and footprint.",
    ),
    options.altitude_option("With --field-of-view: altitude of the camera."),
)


@dataclass(frozen=True)
class Mode:
    """What is done with the areas; by default all are computed and the catalogue is written."""

    plan: bool
    part: tuple[int, int] | None
    list_parts: bool
    select: bool
    merge: bool
    as_json: bool

    def __post_init__(self) -> None:
        modes = {
            "--plan": self.plan,
            "--part": self.part,
            "--list-parts": self.list_parts,
            "--select": self.select,
            "--merge": self.merge,
        }
        if len(chosen := [name for name, value in modes.items() if value]) > 1:
            raise click.UsageError(f"{' and '.join(chosen)} exclude each other")
        if self.as_json and not (self.plan or self.list_parts):
            raise click.UsageError("--json needs --plan or --list-parts")


@dataclass(frozen=True)
class Run:
    """How the areas are computed, which does not change the catalogue."""

    jobs: int | None
    scheduler: str | None
    resume: bool
    keep_going: bool
    try_cures_s: float | None
    overwrite: bool

    @property
    def workers(self) -> int:
        """Number of processes, by default that of the processor cores (`threads.cores`)."""
        from lcp_catalog.threads import cores

        return self.jobs or cores()


mode_options = collected(
    "mode",
    Mode,
    click.option(
        "--part",
        type=PartParam(),
        metavar="K/N",
        help="Compute only every Nth area from the Kth on, into CATALOG.h5.parts: one task of an array job on a shared disk. "
        "Finished areas are kept. --merge writes the catalogue.",
    ),
    click.option(
        "--list-parts",
        is_flag=True,
        help="Print which parts are finished and which areas are missing; nothing is computed.",
    ),
    click.option(
        "--select",
        is_flag=True,
        help="With --passes 2, when all parts are finished: choose the candidates that the second pass evaluates. Then run the "
        "parts again, and --merge.",
    ),
    click.option(
        "--merge",
        is_flag=True,
        help="Write the catalogue from the areas that all parts have computed.",
    ),
    click.option(
        "--plan",
        "plan",
        is_flag=True,
        help="Print the number of areas and conditions, and estimates of time, file size and memory; with `lcp -v` also the "
        "decisions of the scene plan. Up to five areas are computed for the estimates; nothing is written.",
    ),
    options.json_option("With --plan or --list-parts: print one JSON object."),
)

run_options = collected(
    "run",
    Run,
    click.option(
        "--jobs",
        "-j",
        type=click.IntRange(1, JOBS_MAX),
        metavar="N",
        help="Number of areas computed at the same time; default: number of CPU cores that the process may use.",
    ),
    click.option(
        "--scheduler",
        metavar="ADDRESS|FILE",
        help="Compute the areas on the cluster of this dask scheduler: tcp://HOST:PORT, or its scheduler file.",
    ),
    click.option(
        "--resume",
        is_flag=True,
        help="Continue an interrupted run: keep its finished areas. With --overwrite, those of a run with other inputs are "
        "removed.",
    ),
    click.option(
        "--keep-going",
        is_flag=True,
        help="If areas fail, write the catalogue without them (exit code 3).",
    ),
    click.option(
        "--try-cures",
        "try_cures_s",
        type=Number(0.0),
        metavar="SECONDS",
        help="Greatest time in which changes of the configuration are tried on a part of the region, if the catalogue holds no "
        "point or keeps less than half of its promise: those that help are named with their price. Default: as long as the "
        "areas took, at most 30 s. 0: none is tried.",
    ),
    options.overwrite_option,
)


@click.command(
    "build-catalog",
    cls=FileCommand,
    example="lcp build-catalog DEM.tif -o site.h5 --center 3.5 26 --size 60",
)
@options.dem_argument
@options.output_option("CATALOG.h5", OutputFile(replaced=True), required=False)
@build_options(OPTIONS)
@image_options
@run_options
@click.option(
    "--memory",
    "memory_gb",
    type=POSITIVE,
    metavar="GB",
    help="Greatest memory of each process that computes areas. Areas are made smaller for it, which changes the points near "
    "their borders; the catalogue states their size. Default: areas of at most 512 nodes a side.",
)
@mode_options
@depfile_option
@log_format_option
def command(
    dem: tuple[str, ...],
    output: str | None,
    config: BuildConfig,
    images: PlannedImages,
    run: Run,
    memory_gb: float | None,
    mode: Mode,
    depfile: str | None,
) -> int:
    """Build a catalogue of control points from one or more DEM files.

    The region is divided into areas. Each area is rendered for every Sun and view that can occur there. A point is
    kept if an image can be matched with it accurately, if nothing within the search radius looks like it, and if
    terrain outside its patch hardly shadows or hides it.
    Without --center or --bounds the region is the whole DEM.
    """
    if output is None and not mode.plan:
        raise click.UsageError("-o CATALOG.h5 is missing (or --plan)")
    planned = Planned(dem, config, images, memory_gb)
    if mode.plan or output is None:
        _print_plan(planned.build, run, mode.as_json)
        return 0
    if mode.list_parts:
        _print_parts(planned.build, output, mode.as_json)
        return 0
    if mode.part is not None:
        return _run_part(planned, output, run, mode.part)
    if mode.select:
        return _select(planned, output, run)
    report = _merge(planned, output, run) if mode.merge else _build(planned, output, run)
    if depfile:
        from lcp_catalog.atomic_files import depfile_rule, write_bytes

        write_bytes(depfile, depfile_rule(output, report.files), overwrite=True)
    say(
        f"{output}: {report.points} control point{'s' * (report.points != 1)} from {report.areas} area{'s' * (report.areas != 1)}",
        "done",
        points=report.points,
        areas=report.areas,
    )
    return _failures(report.failed)


def _failures(failed: dict[str, str]) -> int:
    """Print the causes of failed areas; the exit code."""
    for cause in failed.values():
        say(f"failed: {cause}", "failed")
    return EXIT_SOME_FAILED if failed else 0


@contextmanager
def _computing(run: Run) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of a computation of areas; its processes are prepared while this one imports the build
    and plans it.
    """
    from lcp_catalog.production.executor import start_early

    from .progress import progress

    if not run.scheduler:
        if run.workers > 1:
            start_early()
        compile_missing("build-catalog")
    try:
        with progress("areas") as update:
            yield update
    except KeyboardInterrupt:
        say("finished areas, if any, are kept: run again with --resume")
        raise


def _run(planned: Planned, output: str, run: Run, progress: Progress = unseen) -> BuildRun:
    """The build as it is carried out."""
    from lcp_catalog.production.run import BuildRun

    return BuildRun(
        planned.build,
        Path(output),
        jobs=run.workers,
        scheduler=run.scheduler,
        resume=run.resume,
        overwrite=run.overwrite,
        keep_going=run.keep_going,
        try_cures_s=run.try_cures_s,
        progress=progress,
    )


def _build(planned: Planned, output: str, run: Run) -> BuildReport:
    with _computing(run) as update:
        return _run(planned, output, run, update).whole()


def _merge(planned: Planned, output: str, run: Run) -> BuildReport:
    if not planned.build.recipe.config.points.two_passes:
        return _run(planned, output, run).merge()
    with _computing(run) as update:
        return _run(planned, output, run, update).merge()


def _select(planned: Planned, output: str, run: Run) -> int:
    left = _run(planned, output, run).select()
    then = "run the parts again" if left.areas else "nothing is left to evaluate, run --merge"
    text = f"{left.candidates} candidates of {left.areas} areas are chosen: {then}"
    say(f"{output}.parts: {text}", "done", candidates=left.candidates, areas=left.areas)
    return 0


def _run_part(planned: Planned, output: str, run: Run, number: tuple[int, int]) -> int:
    """Compute a part; finished areas are kept with and without ``--resume``."""
    with _computing(run) as update:
        from lcp_catalog.production.run import BuildPart

        part = BuildPart(number[0], number[1])
        failed = _run(planned, output, run, update).part(part)
    areas = len(part.share(planned.build.jobs)) - len(failed)
    say(f"{output}.parts: part {part} with {areas} areas is computed", "done", areas=areas)
    return _failures(failed)


def _print_parts(build: Build, output: str, as_json: bool) -> None:
    from lcp_catalog.production.run import BuildRun

    states = BuildRun(build, Path(output)).list_parts()
    rows = [
        {"part": str(state.part), "areas": state.areas, "missing": list(state.missing)}
        for state in states
    ]
    areas, missing = sum(s.areas for s in states), sum(len(s.missing) for s in states)
    if as_json:
        echo(json.dumps({"areas": areas, "missing": missing, "parts": rows}, indent=2))
        return
    for state in states:
        first, more = state.missing[:_NAMES], len(state.missing) - _NAMES
        names = ": " + " ".join(first) if first else ""
        names += f" and {more} more (all with --json)" if more > 0 else ""
        echo(f"part {state.part}: {len(state.missing)} of {state.areas} missing{names}")
    echo(f"{areas - missing} of {areas} areas are computed")


def _print_plan(build: Build, run: Run, as_json: bool) -> None:
    from lcp_catalog.production.estimate import estimate

    compile_missing("build-catalog")
    workers = run.workers
    document = estimate(build, workers, cluster=run.scheduler is not None)
    share = build.claimed_share
    if share is not None:
        document["claimed_share"] = share
    for level in (document, *document.get("levels", ())):
        _name_switches(level["decisions"])
    if as_json:
        echo(json.dumps(document, indent=2))
        return
    echo(_plan_text(document, workers))
    if share is not None:
        echo(f"claims for {100.0 * share:.0f} % of the camera's pixels, by the views")
    if (turned := document["one_direction"])["flags_changed"] > 0.0005:
        echo(
            f"one Sun direction an area: about {100.0 * turned['flags_changed']:.1f} % of the unshadowed flags at "
            f"{turned['sun_elevation']:g} deg of Sun are others than under the points' own Suns (-v: more)"
        )
    for text in _by_sun(document):
        echo(text)
    if click.get_current_context().find_root().params.get("verbose"):
        for level in document.get("levels", ()):
            echo(
                f"level of {level['gsd_m']:.5g} m: "
                + _plan_text(level, workers).replace("\n", "; ")
            )
        for decision in document["decisions"]:
            echo(_decision_text(decision))
        matching = 100.0 * document["matching_cost"]
        echo(f"  candidates, search and claims: {matching:.2g} % of the time")


def _by_sun(document: dict[str, Any]) -> Iterator[str]:
    """What is expected of the points, by the Sun's elevation, and of the promise."""
    if worth := document.get("albedo_worth"):
        told = "; ".join(
            f"{one['sun_elevation']:g} deg {one['usable']:g} ({one['without']:g})" for one in worth
        )
        yield f"usable candidates of one area by Sun, in brackets without the albedo map: {told}"
    if frames := document.get("located_by_sun"):
        told = "; ".join(
            f"{one['sun_elevation']:g} deg {one['by_points']:.2f}, {one['with_ground']:.2f}"
            for one in frames
        )
        yield f"about how probably a frame of the footprint is located, by points, with the ground: {told}"
    if (kept := document.get("promise_kept")) is not None:
        yield f"of the promise for all places, views and Suns, also between those evaluated, roughly {100.0 * kept:.0f} % is kept"


def _name_switches(decisions: list[dict[str, Any]]) -> None:
    """Options in the place of the fields of the configuration that have one."""
    for one in decisions:
        field = one["switch"]
        one["switch"] = field and (option_of(field) or field)


def _decision_text(decision: dict[str, Any]) -> str:
    """One line: the effect, what it takes, what switches it, and why."""
    said = "modelled" if decision["modelled"] else "not modelled"
    if decision["cost"]:
        said += f", {100.0 * decision['cost']:.2g} % of the time"
    if decision["switch"]:
        said += f" ({decision['switch']})"
    return f"  {decision['effect']}: {said}; {decision['reason']}"


def _plan_text(plan: dict[str, Any], workers: int) -> str:
    """Three lines: what is computed, how long it takes, how large file and processes are."""
    from .progress import duration_text

    jobs = min(workers, plan["areas"])
    return (
        f"{plan['areas']:,} area{'s' * (plan['areas'] != 1)} x {plan['suns']:,} Sun{'s' * (plan['suns'] != 1)} x "
        f"{plan['views']:,} view{'s' * (plan['views'] != 1)}, {plan['cell_renders']:,} cells rendered\n"
        f"{duration_text(plan['seconds_estimate'])} with --jobs {jobs}\n"
        f"{plan['bytes_estimate'] / 1e6:,.1f} MB of catalogue, {plan['memory_mb_per_worker']:,} MB of memory a job, "
        f"{plan['memory_mb_parent']:,} MB to merge"
    )
