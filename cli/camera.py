"""``lcp camera``: what a camera file describes."""

from __future__ import annotations

import json
from pathlib import Path

import click

from .files import FileCommand, InputFile, OutputFile
from .messages import EXIT_NO, echo, say
from .options import check_outputs, dems_option, overwrite_option


@click.group()
def command() -> None:
    """Inspect camera files."""


@command.command(
    cls=FileCommand,
    rule=True,
    example="lcp camera info CAMERA.json --catalog site.h5 --plot seen.svg",
)
@click.argument("camera", metavar="CAMERA.json", type=InputFile())
@click.option(
    "--catalog",
    type=InputFile(),
    metavar="CATALOG.h5",
    help="Catalogue whose points the camera should see.",
)
@dems_option("DEMs whose ground the camera should see.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")
@click.option(
    "--plot",
    type=OutputFile(),
    metavar="OUT.svg",
    help="Also draw the image's outline on the ground, the limb and the points.",
)
@overwrite_option
def info(
    camera: str,
    catalog: str | None,
    dems: tuple[str, ...],
    as_json: bool,
    plot: str | None,
    overwrite: bool,
) -> int:
    """Show what a camera sees (CAMERA.json, USGS ISD or .tsai): place, view, ground pixel, Sun, and points of a
    catalogue; and what is wrong with it.

    The exit code is 4 if anything looks wrong.
    """
    if plot is not None and Path(plot).suffix.lower() != ".svg":
        raise click.UsageError(f"--plot {plot}: the picture must end in .svg")
    check_outputs(overwrite, plot)

    from lcp_catalog.atomic_files import write_bytes
    from lcp_catalog.navigation.camera_info import camera_info

    found = camera_info(camera, catalog=catalog, dem=dems or None)
    document = json.dumps(found.document, indent=2, allow_nan=False)
    if plot is not None:
        write_bytes(plot, found.picture().encode("utf-8"), overwrite)
    echo(document if as_json else "\n".join(found.lines()))
    if plot is not None:
        say(f"{plot}: written")
    return EXIT_NO if found.problems else 0
