"""``lcp build-catalog``: DEMs in, a catalogue of control points out."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from pathlib import Path
from typing import Any

import click

from .options import (
    area_options,
    check_accuracy,
    check_area,
    dem_argument,
    depfile_option,
    model_options,
    output_option,
    overwrite_option,
)

EXIT_SOME_FAILED = 3


class NumberList(click.ParamType):
    """Numbers with commas between them, or START:STOP:STEP with both ends included."""

    name = "numbers"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        if isinstance(value, tuple):
            return value
        try:
            if ":" in value:
                start, stop, step = (float(part) for part in value.split(":"))
                if not step > 0 or not math.isfinite((stop - start) / step):
                    self.fail(f"{value!r}: the step must be positive", param, ctx)
                return tuple(
                    start + i * step for i in range(math.floor((stop - start) / step + 1e-9) + 1)
                )
            return tuple(float(part) for part in value.split(","))
        except ValueError:
            self.fail(f"{value!r} is neither A,B,C nor START:STOP:STEP", param, ctx)


class ViewParam(click.ParamType):
    """OFF_NADIR[:AZIMUTH[:ALTITUDE_KM]]."""

    name = "view"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        try:
            parts = [float(part) for part in value.split(":")]
        except ValueError:
            parts = []
        if not 1 <= len(parts) <= 3 or (len(parts) == 1 and parts[0] != 0.0):
            self.fail(f"{value!r} is not OFF_NADIR:AZIMUTH[:ALTITUDE_KM] (or 0)", param, ctx)
        return (*parts, *(0.0, math.inf)[len(parts) - 1 :])


@click.command("build-catalog")
@dem_argument
@output_option("CATALOG.h5", required=False)
@click.option(
    "--config",
    "config_path",
    type=click.Path(path_type=Path),
    metavar="BUILD.toml",
    help="The whole configuration; flags override it.",
)
@area_options
@click.option(
    "--sun-azimuths",
    type=NumberList(),
    metavar="LIST",
    help="Azimuths of the Sun's grid: A,B,C or START:STOP:STEP, degrees.",
)
@click.option(
    "--sun-elevations",
    type=NumberList(),
    metavar="LIST",
    help="Elevations of the Sun's grid, degrees.",
)
@click.option(
    "--view",
    "views",
    type=ViewParam(),
    multiple=True,
    metavar="OFF:AZ[:KM]",
    help="A viewpoint: angle off the vertical at the point, azimuth, altitude; may be repeated.",
)
@model_options
@click.option(
    "--spacing",
    "spacing_km",
    type=click.FloatRange(0, min_open=True),
    metavar="KM",
    help="Least distance of two points; default: two patches.",
)
@click.option(
    "--search",
    "search_km",
    type=click.FloatRange(0, min_open=True),
    metavar="KM",
    help="Radius inside which a point must be unique; default: 64 cells.",
)
@click.option(
    "--noise",
    "image_noise",
    type=click.FloatRange(0, 1, min_open=True, max_open=True),
    metavar="SHARE",
    help="1 sigma of image minus render, as a share of the mean signal; default 0.15.",
)
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
    from lcp_catalog.build import Build, build_catalog

    from .progress import progress

    build = Build.plan(tuple(Path(path) for path in dem), _configuration(**flags))
    workers = jobs or os.cpu_count() or 1
    if plan_only:
        _tell_plan(build, workers, as_json)
        return 0
    assert output is not None
    try:
        with progress("areas") as update:
            report = build_catalog(
                build,
                Path(output),
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
        _write_depfile(depfile, output, build)
    click.echo(f"{output}: {report.points} control points from {report.areas} areas", err=True)
    for cause in report.failed.values():
        click.echo(f"failed: {cause}", err=True)
    return EXIT_SOME_FAILED if report.failed else 0


def _configuration(
    config_path: Path | None,
    center: tuple[float, float] | None,
    size_km: float | None,
    bounds: tuple[float, ...] | None,
    gsd_m: float | None,
    sun_azimuths: tuple[float, ...] | None,
    sun_elevations: tuple[float, ...] | None,
    views: tuple[tuple[float, ...], ...],
    reflectance: str | None,
    accuracy: str | None,
    tolerance: float | None,
    spacing_km: float | None,
    search_km: float | None,
    image_noise: float | None,
) -> Any:
    """The file's configuration with the flags laid over it."""
    from lcp_catalog.config import BuildConfig

    check_area(center, size_km, bounds)
    check_accuracy(accuracy, tolerance)
    config = BuildConfig.from_toml(config_path) if config_path else BuildConfig()
    area: dict[str, Any] = {}
    if center or bounds:
        area = {
            "center_deg": tuple(center or ()),
            "size_km": size_km,
            "bounds_deg": tuple(bounds or ()),
        }
    columns = list(zip(*views, strict=True))
    return dataclasses.replace(
        config,
        area=_over(config.area, gsd_m=gsd_m, **area),
        sun=_over(config.sun, azimuths_deg=sun_azimuths, elevations_deg=sun_elevations),
        view=_over(
            config.view,
            **dict(zip(("off_nadir_deg", "azimuth_deg", "altitude_km"), columns, strict=False)),
        ),
        points=_over(
            config.points,
            spacing_m=spacing_km and spacing_km * 1e3,
            search_m=search_km and search_km * 1e3,
            image_noise=image_noise,
        ),
        model=_over(
            _undecided(config.model) if accuracy or tolerance is not None else config.model,
            reflectance=reflectance,
            accuracy=accuracy,
            tolerance=tolerance,
        ),
    )


def _undecided(model: Any) -> Any:
    """The file's model without its tier and tolerance: a flag replaces whichever of both it states."""
    return dataclasses.replace(model, accuracy=None, tolerance=None)


def _over(section: Any, **values: Any) -> Any:
    """A section with the flags that were given; with an area given, what the file said of the area's place is dropped."""
    given = {
        name: value for name, value in values.items() if value is not None or name == "size_km"
    }
    return dataclasses.replace(section, **given) if given else section


def _tell_plan(build: Any, workers: int, as_json: bool) -> None:
    from lcp_catalog.estimate import estimate

    document = estimate(build, workers)
    if as_json:
        click.echo(json.dumps(document, indent=2))
        return
    for name, value in document.items():
        if name == "decisions":
            for decision in value:
                click.echo(
                    f"  {decision['effect']}: {'modelled' if decision['modelled'] else 'not modelled'}; {decision['reason']}"
                )
        else:
            click.echo(
                f"{name:24} {value:,}" if isinstance(value, int) else f"{name:24} {value:,.1f}"
            )


def _write_depfile(depfile: str, output: str, build: Any) -> None:
    from lcp_catalog.demset import DemSet
    from lcp_catalog.files import depfile_text, write_bytes

    sources = [path for opened in DemSet.open(build.dem_paths).dems for path in opened.files]
    write_bytes(depfile, depfile_text(output, sources).encode(), overwrite=True)
