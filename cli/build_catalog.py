"""``lcp build-catalog``: DEMs in, a catalogue of control points out."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .build_options import config_option, configuration, point_options, sweep_options
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
@point_options
@click.option(
    "--jobs",
    "-j",
    type=click.IntRange(1),
    metavar="N",
    help="Areas computed side by side; default: the cores of this machine.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="A dask scheduler to send the areas to.",
)
@click.option(
    "--plan",
    "plan_only",
    is_flag=True,
    help="Say what the build would do; compute one area to time it.",
)
@click.option(
    "--json",
    "as_json",
    is_flag=True,
    help="With --plan: one JSON object on stdout.",
)
@click.option(
    "--resume", is_flag=True, help="Take up the finished areas of a run that was broken off."
)
@click.option(
    "--keep-going", is_flag=True, help="Write the catalogue even if areas failed (exit code 3)."
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

    The region is cut into areas; each is rendered under every Sun and view that can happen there, and the points that can be
    localised, are unique and do not depend on the relief around them are kept.
    """
    if output is None and not plan_only:
        raise click.UsageError("-o CATALOG.h5 is missing (or say --plan)")
    if resume and overwrite:
        raise click.UsageError("--resume and --overwrite exclude each other")
    config, workers = configuration(**flags), jobs or os.cpu_count() or 1
    if plan_only:
        _print_plan(dem, config, workers, as_json)
        return 0
    assert output is not None

    from lcp_catalog.build.run import build_catalog

    from .progress import progress

    try:
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
