"""``lcp build-catalog``: a catalogue of control points from DEMs."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .build_options import (
    config_option,
    configuration,
    error_map_options,
    point_options,
    sweep_options,
)
from .options import (
    albedo_options,
    area_options,
    dem_argument,
    depfile_option,
    model_options,
    output_option,
    overwrite_option,
    product_order_option,
)

if TYPE_CHECKING:
    from lcp_catalog.build.config import BuildConfig

EXIT_SOME_FAILED = 3


@click.command("build-catalog")
@dem_argument
@product_order_option
@output_option("CATALOG.h5", required=False)
@config_option
@area_options
@sweep_options
@model_options
@albedo_options
@error_map_options
@point_options
@click.option(
    "--jobs",
    "-j",
    type=click.IntRange(1),
    metavar="N",
    help="Number of areas computed at the same time; default: number of CPU cores.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Compute the areas on the cluster of this dask scheduler (tcp://HOST:PORT).",
)
@click.option(
    "--plan",
    "plan_only",
    is_flag=True,
    help="Print the number of areas and conditions, estimates of time, memory and file size, and the scene plan. Two "
    "areas are computed for the estimates; nothing is written.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="With --plan: print one JSON object.",
)
@click.option(
    "--resume", is_flag=True, help="Continue an interrupted run: keep its finished areas."
)
@click.option(
    "--keep-going",
    is_flag=True,
    help="If areas fail, write the catalogue without them (exit code 3).",
)
@overwrite_option
@depfile_option
def command(
    dem: tuple[str, ...],
    output: str | None,
    plan_only: bool,
    as_json: bool,
    jobs: int | None,
    scheduler: str | None,
    resume: bool,
    keep_going: bool,
    overwrite: bool,
    depfile: str | None,
    **flags: Any,
) -> int:
    """Build a catalogue of control points from one or more DEM files.

    The region is divided into areas. Each area is rendered for every Sun and view that can occur there. Points are
    kept if they can be localised, are unique within the search radius, and do not depend on the relief around them.
    Without --center or --bounds the region is the whole DEM.
    """
    if output is None and not plan_only:
        raise click.UsageError("-o CATALOG.h5 is missing (or --plan)")
    if resume and overwrite:
        raise click.UsageError("--resume and --overwrite exclude each other")
    config, workers = configuration(**flags), jobs or os.cpu_count() or 1
    if plan_only:
        _print_plan(dem, config, workers, as_json)
        return 0
    assert output is not None

    from lcp_catalog.build.executor import prepare_for_areas, starting_workers

    from .progress import progress

    try:
        # the workers start while this process imports the build and plans it
        with starting_workers(1 if scheduler else workers, prepare_for_areas) as started:
            from lcp_catalog.build.run import build_catalog

            with progress("areas") as update:
                report = build_catalog(
                    dem,
                    config,
                    output,
                    jobs=workers,
                    scheduler=scheduler,
                    resume=resume,
                    overwrite=overwrite,
                    keep_going=keep_going,
                    progress=update,
                    started=started,
                )
    except KeyboardInterrupt:
        click.echo("\nfinished areas are kept: run again with --resume", err=True)
        raise
    if depfile:
        _write_depfile(depfile, output, report.files)
    click.echo(f"{output}: {report.points} control points from {report.areas} areas", err=True)
    for cause in report.failed.values():
        click.echo(f"failed: {cause}", err=True)
    return EXIT_SOME_FAILED if report.failed else 0


def _print_plan(dem: tuple[str, ...], config: BuildConfig, workers: int, as_json: bool) -> None:
    from lcp_catalog.build.estimate import estimate
    from lcp_catalog.build.run import Build

    document = estimate(Build.plan(dem, config), workers)
    if as_json:
        click.echo(json.dumps(document, indent=2))
        return
    decisions = document.pop("decisions")
    for name, value in document.items():
        click.echo(f"{name:24} {value:{',' if isinstance(value, int) else ',.1f'}}")
    for decision in decisions:
        modelled = "modelled" if decision["modelled"] else "not modelled"
        click.echo(f"  {decision['effect']}: {modelled}; {decision['reason']}")


def _write_depfile(depfile: str, output: str, files: tuple[Path, ...]) -> None:
    from lcp_catalog.atomic_files import depfile_text, write_bytes

    write_bytes(depfile, depfile_text(output, files).encode(), overwrite=True)
