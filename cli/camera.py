"""``lcp camera``: what a camera file describes, and camera files from SPICE kernels."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from . import options
from .files import CATALOG, FileCommand, InputFile
from .groups import Decorator, option_group
from .messages import EXIT_NO, echo, say
from .sun import range_of, times_of
from .value_types import POSITIVE, Instant, KeyNumbers, Number


@click.group()
def command() -> None:
    """Inspect camera files, and make them from SPICE kernels."""


@command.command(
    cls=FileCommand,
    rule=True,
    example="lcp camera info CAMERA.json --catalog site.h5 --plot seen.svg",
)
@click.argument("camera", metavar="CAMERA.json", type=InputFile())
@click.option(
    "--catalog",
    type=CATALOG,
    metavar="CATALOG.h5",
    help="Catalogue whose points the camera should see.",
)
@options.dems_option("DEMs whose ground the camera should see.")
@options.json_option()
@options.other_output_option(
    "--plot", "OUT.svg", "Also draw the image's outline on the ground, the limb and the points."
)
@options.overwrite_option
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


def _kernels(path: str) -> Iterator[Path]:
    """The files that a meta-kernel names; none if SPICE cannot load it, which the command says."""
    from lcp_catalog.cameras.spice import kernel_files
    from lcp_catalog.errors import CameraError

    with suppress(CameraError):
        yield from kernel_files(path)


def kernels_option(text: str, required: bool = False) -> Decorator:
    """``--kernels``, files; ``text``: which."""
    how: dict[str, Any] = {"multiple": True, "required": required, "type": InputFile(_kernels)}
    return click.option("--kernels", metavar="META.tm...", help=text, **how)


def spice_options(required: bool) -> Decorator:
    """The kernels, and the names that they have for spacecraft and camera."""
    needed = "" if required else " For .bsp and .bc."
    return option_group(
        kernels_option(
            "SPICE kernels, or meta-kernels that name them: SPK, CK, SCLK, FK, IK, LSK, and the Moon's PCK and FK."
            + needed,
            required,
        ),
        click.option(
            "--observer", required=required, metavar="NAME", help="The spacecraft, or its number."
        ),
        click.option(
            "--instrument", required=required, metavar="NAME", help="The camera, or its number."
        ),
    )


@command.command(
    cls=FileCommand,
    rule=True,
    example="lcp camera from-spice --kernels META.tm --observer LRO --instrument LRO_LROCWAC --time 2026-03-01T12:00 "
    "-o CAMERA.json",
)
@spice_options(required=True)
@click.option("--time", type=Instant(), metavar="UTC", help="Of a framing camera: the instant.")
@options.range_option("Of a framing camera: a trajectory, a camera each STEP (30s, 1m, PT1M).")
@click.option(
    "--start", type=Instant(), metavar="UTC", help="Of a line scanner: begin of the first line."
)
@click.option(
    "--stop", type=Instant(), metavar="UTC", help="Of a line scanner: end of the last line."
)
@click.option(
    "--line-time",
    "line_s",
    type=POSITIVE,
    metavar="S",
    help="Of a line scanner: seconds a line (LINE_EXPOSURE_DURATION of a PDS label is in ms).",
)
@click.option(
    "--summing",
    type=click.IntRange(1, 64),
    default=1,
    metavar="N",
    help="Pixels of the detector along a side of the image's pixel.",
)
@click.option(
    "--ik",
    multiple=True,
    type=KeyNumbers(),
    metavar="KEY=NUMBER,...",
    help="Keyword of the instrument kernel, without INS<id>_, that it lacks or has wrong: FOCAL_LENGTH=700.",
)
@click.option(
    "--body-frame",
    metavar="NAME",
    help="The Moon's frame; default: the kernels' mean-Earth frame MOON_ME, in which catalogues are.",
)
@options.output_option("CAMERA.json")
@options.overwrite_option
def from_spice(
    kernels: tuple[str, ...],
    observer: str,
    instrument: str,
    time: str | None,
    span: tuple[str, str, float] | None,
    start: str | None,
    stop: str | None,
    line_s: float | None,
    summing: int,
    ik: tuple[tuple[str, tuple[float, ...]], ...],
    body_frame: str | None,
    output: str,
    overwrite: bool,
) -> None:
    """Make a camera file from SPICE kernels (spiceypy, the extra spice).

    --time writes a CAMERA.json, --range a list of them (a trajectory for lcp query and lcp build-catalog), --start, --stop and
    --line-time the ISD of a line scanner. Positions and attitudes are geometric, without light time and aberration.
    """
    scanned = (start is not None) + (stop is not None) + (line_s is not None)
    if scanned not in {0, 3} or (time is not None) + (span is not None) + (scanned == 3) != 1:
        raise click.UsageError(
            "give --time UTC, or --range START STOP STEP, or --start, --stop and --line-time of a line scanner"
        )

    from lcp_catalog.atomic_files import write_bytes
    from lcp_catalog.cameras.spice import SpiceCamera

    orbiter = SpiceCamera(observer, instrument, kernels, dict(ik), body_frame, summing)
    document: object
    if start is not None and stop is not None and line_s is not None:
        document = orbiter.scanner_isd(start, stop, line_s)
    elif span is not None:
        document = [camera.to_json() for camera in orbiter.along(range_of(span))]
    else:
        assert time is not None
        document = orbiter.at(time).to_json()
    write_bytes(output, f"{json.dumps(document, allow_nan=False)}\n".encode(), overwrite)
    say(f"{output}: written")


@command.command(
    cls=FileCommand,
    rule=True,
    example="lcp camera from-ccsds --oem orbit.oem --aem attitude.aem --camera CAMERA.json --range 2026-03-01 2026-03-01T00:10 1m "
    "--kernels moon.tm -o TRAJECTORY.json",
)
@click.option(
    "--oem", required=True, type=InputFile(), metavar="FILE", help="Orbit: CCSDS OEM, text (KVN)."
)
@click.option(
    "--aem", required=True, type=InputFile(), metavar="FILE", help="Attitude: CCSDS AEM, text."
)
@options.camera_file_option(
    "The camera: lens and image size; its place is not used.", required=True
)
@click.option("--time", type=Instant(), metavar="UTC", help="One camera, at an instant.")
@options.range_option("A trajectory, a camera each STEP (30s, 1m, PT1M).")
@kernels_option(
    "SPICE kernels with the Moon's orientation (PCK, FK), for messages in an inertial frame."
)
@click.option(
    "--mounting",
    type=click.Tuple([Number(-1, 1)] * 4),
    default=(1.0, 0.0, 0.0, 0.0),
    metavar="W X Y Z",
    help="Quaternion from the axes of the AEM's body to those of the camera (right, down, ahead).",
)
@options.output_option("CAMERA.json")
@options.overwrite_option
def from_ccsds(
    oem: str,
    aem: str,
    camera: str,
    time: str | None,
    span: tuple[str, str, float] | None,
    kernels: tuple[str, ...],
    mounting: tuple[float, ...],
    output: str,
    overwrite: bool,
) -> None:
    """Make a camera file, or with --range a trajectory, from a CCSDS orbit and attitude."""
    times = times_of(time, span)
    from lcp_catalog.atomic_files import write_bytes
    from lcp_catalog.cameras.ccsds import cameras_from_ccsds

    found = cameras_from_ccsds(oem, aem, camera, times, kernels, mounting)
    every = [one.to_json() for one in found]
    text = json.dumps(every[0] if span is None else every, allow_nan=False)
    write_bytes(output, f"{text}\n".encode(), overwrite)
    say(f"{output}: written")


@command.command(
    cls=FileCommand,
    rule=True,
    example="lcp camera export CAMERA.json --report check/report.json --kernels META.tm --observer LRO "
    "--instrument LRO_LROCWAC -o solved.bsp",
)
@click.argument("cameras", metavar="CAMERA.json...", nargs=-1, required=True, type=InputFile())
@click.option(
    "--report",
    type=InputFile(),
    metavar="report.json",
    help="Of lcp validate, whose images had these cameras, in this order: write the solved positions and attitudes.",
)
@spice_options(required=False)
@options.output_option("OUT.json|.bsp|.bc")
@options.overwrite_option
def export(
    cameras: tuple[str, ...],
    report: str | None,
    kernels: tuple[str, ...],
    observer: str | None,
    instrument: str | None,
    output: str,
    overwrite: bool,
) -> None:
    """Write cameras, or what lcp validate solved for them, for other programs.

    \b
    .json  the ISD of a camera (USGS CSM, ISIS, Ames Stereo Pipeline)
    .bsp   SPICE SPK, type 13, of the spacecraft
    .bc    SPICE CK, type 3, of the structure that carries the instrument
    """
    kernel = Path(output).suffix.lower() in {".bsp", ".bc"}
    if kernel and not (kernels and observer and instrument):
        raise click.UsageError(f"-o {output} needs --kernels, --observer and --instrument")

    from lcp_catalog.exports.cameras import export_cameras

    count = export_cameras(
        cameras, output, report, kernels, observer or "", instrument or "", overwrite
    )
    say(f"{output}: {count} camera{'s' * (count > 1)} written")
