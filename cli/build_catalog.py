"""``lcp build-catalog``: a catalogue of control points from DEMs."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from .build_options import (
    PartParam,
    config_option,
    configuration,
    error_map_options,
    level_options,
    point_options,
    sweep_options,
)
from .files import FileCommand
from .messages import echo, log_format_option, say
from .options import (
    albedo_options,
    dem_argument,
    depfile_option,
    model_options,
    output_option,
    overwrite_option,
    product_order_option,
    region_options,
)
from .value_types import POSITIVE

if TYPE_CHECKING:
    from lcp_catalog.production.config import BuildConfig
    from lcp_catalog.production.run import BuildReport

Inputs: TypeAlias = "tuple[tuple[str, ...], BuildConfig, float | None]"
"""What a build is planned from: DEM files, configuration, and memory of a worker in GB (`Build.plan`)."""

EXIT_SOME_FAILED = 3
JOBS_MAX = max(64, 4 * (os.cpu_count() or 1))
"""Most processes that can be asked for."""

_NAMES = 8
"""Greatest number of missing areas that are named for a part."""


@click.command(
    "build-catalog",
    cls=FileCommand,
    example="lcp build-catalog DEM.tif -o site.h5 --center 3.5 26 --size 60",
)
@dem_argument
@product_order_option
@output_option("CATALOG.h5", required=False)
@config_option
@region_options
@level_options
@sweep_options
@model_options
@albedo_options
@error_map_options
@point_options
@click.option(
    "--jobs",
    "-j",
    type=click.IntRange(1, JOBS_MAX),
    metavar="N",
    help="Number of areas computed at the same time; default: number of CPU cores that the process may use.",
)
@click.option(
    "--memory",
    "memory_gb",
    type=POSITIVE,
    metavar="GB",
    help="Greatest memory of each process that computes areas. Areas are made smaller for it, which changes the points near "
    "their borders; the catalogue states their size. Default: areas of at most 512 nodes a side.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS|FILE",
    help="Compute the areas on the cluster of this dask scheduler: tcp://HOST:PORT, or its scheduler file.",
)
@click.option(
    "--part",
    type=PartParam(),
    metavar="K/N",
    help="Compute only every Nth area from the Kth on, into CATALOG.h5.parts: one task of an array job on a shared disk. "
    "Finished areas are kept. --merge writes the catalogue.",
)
@click.option(
    "--list-parts",
    is_flag=True,
    help="Print which parts are finished and which areas are missing; nothing is computed.",
)
@click.option(
    "--merge",
    is_flag=True,
    help="Write the catalogue from the areas that all parts have computed.",
)
@click.option(
    "--plan",
    "plan_only",
    is_flag=True,
    help="Print the number of areas and conditions, and estimates of time, file size and memory; with `lcp -v` also the "
    "decisions of the scene plan. Two areas are computed for the estimates; nothing is written.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="With --plan or --list-parts: print one JSON object.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Continue an interrupted run: keep its finished areas. With --overwrite, those of a run with other inputs are "
    "removed.",
)
@click.option(
    "--keep-going",
    is_flag=True,
    help="If areas fail, write the catalogue without them (exit code 3).",
)
@overwrite_option
@depfile_option
@log_format_option
def command(
    dem: tuple[str, ...],
    output: str | None,
    plan_only: bool,
    as_json: bool,
    jobs: int | None,
    memory_gb: float | None,
    part: tuple[int, int] | None,
    list_parts: bool,
    merge: bool,
    depfile: str | None,
    **given: Any,
) -> int:
    """Build a catalogue of control points from one or more DEM files.

    The region is divided into areas. Each area is rendered for every Sun and view that can occur there. Points are
    kept if they can be localised, are unique within the search radius, and do not depend on the relief around them.
    Without --center or --bounds the region is the whole DEM.
    """
    modes = {"--plan": plan_only, "--part": part, "--list-parts": list_parts, "--merge": merge}
    if len(chosen := [name for name, value in modes.items() if value]) > 1:
        raise click.UsageError(f"{' and '.join(chosen)} exclude each other")
    if as_json and not (plan_only or list_parts):
        raise click.UsageError("--json needs --plan or --list-parts")
    if output is None and not plan_only:
        raise click.UsageError("-o CATALOG.h5 is missing (or --plan)")
    run = {name: given.pop(name) for name in ("scheduler", "resume", "keep_going", "overwrite")}
    config, workers = configuration(**given), jobs or _cores()
    inputs = (dem, config, memory_gb)
    if plan_only:
        _print_plan(inputs, workers, run["scheduler"], as_json)
        return 0
    assert output is not None
    if list_parts:
        _print_parts(inputs, output, as_json)
        return 0
    if merge:
        report = _merge(inputs, output, **run)
    elif part is not None:
        return _run_part(inputs, output, part, jobs=workers, **run)
    else:
        report = _build(inputs, output, jobs=workers, **run)
    if depfile:
        _write_depfile(depfile, output, report.files)
    say(
        f"{output}: {report.points} control points from {report.areas} areas",
        "done",
        points=report.points,
        areas=report.areas,
    )
    return _failures(report.failed)


def _cores() -> int:
    """Number of processor cores that this process may use, which a batch system can limit."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _failures(failed: dict[str, str]) -> int:
    """Print the causes of failed areas; the exit code."""
    for cause in failed.values():
        say(f"failed: {cause}", "failed")
    return EXIT_SOME_FAILED if failed else 0


@contextmanager
def _workers(jobs: int, scheduler: str | None) -> Iterator[dict[str, Any]]:
    """Options of a computation of areas: its processes, which are prepared while this one imports the
    build and plans it, and its progress.
    """
    from lcp_catalog.production.executor import start_early

    from .progress import progress

    if jobs > 1 and not scheduler:
        start_early()
    try:
        with progress("areas") as update:
            yield {"jobs": jobs, "scheduler": scheduler, "progress": update}
    except KeyboardInterrupt:
        say("finished areas are kept: run again with --resume")
        raise


def _build(
    inputs: Inputs,
    output: str,
    jobs: int,
    scheduler: str | None,
    **options: bool,
) -> BuildReport:
    with _workers(jobs, scheduler) as engine:
        from lcp_catalog.production.run import build_catalog

        dem, config, memory_gb = inputs
        return build_catalog(dem, config, output, memory_gb=memory_gb, **engine, **options)


def _run_part(
    inputs: Inputs,
    output: str,
    number: tuple[int, int],
    jobs: int,
    scheduler: str | None,
    overwrite: bool,
    keep_going: bool,
    resume: bool,
) -> int:
    """Compute a part; finished areas are kept with and without ``resume``."""
    with _workers(jobs, scheduler) as engine:
        from lcp_catalog.production.parts import BuildPart, run_part
        from lcp_catalog.production.run import Build

        build, part = Build.plan(*inputs), BuildPart(*number)
        options = {"overwrite": overwrite, "keep_going": keep_going}
        failed = run_part(build, Path(output), part, **engine, **options)
    areas = len(part.share(build.jobs)) - len(failed)
    say(f"{output}.parts: part {part} with {areas} areas is computed", "done", areas=areas)
    return _failures(failed)


def _merge(
    inputs: Inputs,
    output: str,
    overwrite: bool,
    keep_going: bool,
    **unused: Any,
) -> BuildReport:
    from lcp_catalog.production.parts import merge_parts
    from lcp_catalog.production.run import Build

    build = Build.plan(*inputs)
    return merge_parts(build, Path(output), overwrite=overwrite, keep_going=keep_going)


def _print_parts(inputs: Inputs, output: str, as_json: bool) -> None:
    from lcp_catalog.production.parts import list_parts
    from lcp_catalog.production.run import Build

    states = list_parts(Build.plan(*inputs), Path(output))
    rows = [
        {"part": str(state.part), "areas": state.areas, "missing": list(state.missing)}
        for state in states
    ]
    areas, missing = sum(s.areas for s in states), sum(len(s.missing) for s in states)
    if as_json:
        click.echo(json.dumps({"areas": areas, "missing": missing, "parts": rows}, indent=2))
        return
    for state in states:
        first, more = state.missing[:_NAMES], len(state.missing) - _NAMES
        names = ": " + " ".join(first) if first else ""
        names += f" and {more} more (all with --json)" if more > 0 else ""
        echo(f"part {state.part}: {len(state.missing)} of {state.areas} missing{names}")
    echo(f"{areas - missing} of {areas} areas are computed")


def _print_plan(inputs: Inputs, workers: int, scheduler: str | None, as_json: bool) -> None:
    from lcp_catalog.production.estimate import estimate
    from lcp_catalog.production.run import Build

    document = estimate(Build.plan(*inputs), workers, cluster=scheduler is not None)
    if as_json:
        click.echo(json.dumps(document, indent=2))
        return
    echo(_plan_text(document, workers))
    if click.get_current_context().find_root().params.get("verbose"):
        for level in document.get("levels", ()):
            echo(
                f"level of {level['gsd_m']:.5g} m: "
                + _plan_text(level, workers).replace("\n", "; ")
            )
        for decision in document["decisions"]:
            modelled = "modelled" if decision["modelled"] else "not modelled"
            echo(f"  {decision['effect']}: {modelled}; {decision['reason']}")


def _plan_text(plan: dict[str, Any], workers: int) -> str:
    """Three lines: what is computed, how long it takes, how large file and processes are."""
    from .progress import duration_text

    jobs = min(workers, plan["areas"])
    counts = f"{plan['areas']:,} areas x {plan['suns']:,} Suns x {plan['views']:,} views"
    return (
        f"{counts}, {plan['cell_renders']:,} cells rendered\n"
        f"{duration_text(plan['seconds_estimate'])} with --jobs {jobs}\n"
        f"{plan['bytes_estimate'] / 1e6:,.1f} MB of catalogue, {plan['memory_mb_per_worker']:,} MB of memory a job, "
        f"{plan['memory_mb_parent']:,} MB to merge"
    )


def _write_depfile(depfile: str, output: str, files: tuple[Path, ...]) -> None:
    from lcp_catalog.atomic_files import depfile_rule, write_bytes

    write_bytes(depfile, depfile_rule(output, files), overwrite=True)
