"""``lcp query``: usable points of a camera and a Sun, and the position that they are expected to give."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lcp_catalog.choices import CHART_ENDINGS, POINT_ENDINGS

from . import options
from .files import FileCommand, InputFile, OutputFile
from .messages import echo, say
from .progress import progress
from .value_types import Number

if TYPE_CHECKING:
    from lcp_catalog.catalog.catalogue import Catalog
    from lcp_catalog.navigation.expected_position import Answer, Query
    from lcp_catalog.navigation.frame_points import PlannedImage
    from lcp_catalog.navigation.trajectory_chart import TrajectoryChart

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""The matrices are small; and a process of one thread has its file checked without a fresh interpreter."""

POINTS_SHOWN = 12
"""Rows of the table on a terminal."""


def frame_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The frames of which is asked: a camera, or a trajectory."""
    for option in reversed(_FRAME_OPTIONS):
        command = option(command)
    return command


def accuracy_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """What is known before about attitude, heights and map."""
    for option in reversed(_ACCURACY_OPTIONS):
        command = option(command)
    return command


_FRAME_OPTIONS = (
    click.option(
        "--camera",
        "camera_path",
        type=InputFile(),
        metavar="CAMERA.json",
        help="Camera file: CAMERA.json, USGS ISD or .tsai. With --trajectory FILE.csv: the camera without its place.",
    ),
    click.option(
        "--trajectory",
        "trajectory_path",
        type=InputFile(),
        metavar="FILE",
        help="Frames in time: CSV with time_utc, x_m, y_m, z_m and qw, qx, qy, qz (or r11 ... r33), or a JSON list of "
        "CAMERA.json objects.",
    ),
)

_ACCURACY_OPTIONS = (
    click.option(
        "--attitude-sigma",
        "attitude_deg",
        type=Number(0.0, 90.0),
        metavar="DEG",
        help="Known attitude: 1 sigma about each axis; 0: exact. Default: unknown, solved with the position.",
    ),
    click.option(
        "--height-sigma",
        "height_sigma_m",
        type=Number(0.0),
        metavar="M",
        help="1 sigma of the points' heights; default: that of the catalogue.",
    ),
    click.option(
        "--map-sigma",
        "map_sigma_m",
        type=Number(0.0),
        default=0.0,
        show_default=True,
        metavar="M",
        help="1 sigma, each axis, of an error of place common to all points, such as the map's tie to the Moon's frame.",
    ),
    click.option(
        "--pixel-sigma",
        "pixel_sigma_px",
        type=Number(0.0),
        metavar="PX",
        help="1 sigma, each axis, of what a match errs beyond its claim, in pixels not finer than the point's cells; "
        "default: 0.02.",
    ),
)


@click.command(
    cls=FileCommand,
    rule=True,
    example="lcp query site.h5 --camera CAMERA.json --time 2026-03-01T12:00 --max 20",
)
@options.catalog_argument
@frame_options
@options.sun_angle_options
@click.option(
    "--max",
    "most",
    type=click.IntRange(1, 100_000),
    metavar="N",
    help="Only the N points of a frame that together determine the position best, the most informative first; default: all.",
)
@accuracy_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")
@options.output_option("OUT.csv|.geojson", required=False)
@click.option(
    "--plot",
    type=OutputFile(),
    metavar="OUT.svg|.html",
    help="With --trajectory: chart of usable points, accuracy and holes.",
)
@options.overwrite_option
def command(
    catalog: str,
    camera_path: str | None,
    trajectory_path: str | None,
    as_json: bool,
    output: str | None,
    plot: str | None,
    overwrite: bool,
    **flags: Any,
) -> None:
    """List the points of a catalogue that a camera can use under a Sun, and the expected accuracy of a
    position from them.

    With --trajectory: one row for each frame; --json lists the points of all frames. The Sun is the
    stated one (angles at the image's centre), else that of the camera file.
    """
    _check(camera_path, trajectory_path, output, plot, flags)

    from lcp_catalog.atomic_files import check_output
    from lcp_catalog.catalog.hdf5 import open_catalog

    for name in (output, plot):
        if name is not None:
            check_output(name, overwrite)
    query = query_of(**flags)
    frames = frames_of(camera_path, trajectory_path, flags)
    opened = open_catalog(catalog, check=False)
    if trajectory_path is None:
        _one(opened, frames[0], query, as_json, output, overwrite)
    else:
        _along(opened, frames, query, as_json, output, plot, overwrite, Path(trajectory_path).name)


def _check(
    camera: str | None,
    trajectory: str | None,
    output: str | None,
    plot: str | None,
    flags: dict[str, Any],
) -> None:
    """Raise a usage error for options that do not fit together."""
    if camera is None and trajectory is None:
        raise click.UsageError("give --camera CAMERA.json or --trajectory FILE")
    if plot is not None and trajectory is None:
        raise click.UsageError("--plot needs --trajectory")
    endings = POINT_ENDINGS if trajectory is None else (".csv",)
    if output is not None and Path(output).suffix.lower() not in endings:
        raise click.UsageError(f"-o {output}: the output must end in {' or '.join(endings)}")
    if plot is not None and Path(plot).suffix.lower() not in CHART_ENDINGS:
        raise click.UsageError(f"--plot {plot}: the chart must end in {' or '.join(CHART_ENDINGS)}")
    options.check_sun(*(flags[name] for name in options.SUN_ANGLES))


def query_of(
    most: int | None,
    attitude_deg: float | None,
    height_sigma_m: float | None,
    map_sigma_m: float,
    pixel_sigma_px: float | None,
    **_sun: Any,
) -> Query:
    from lcp_catalog.matching.point_claims import LEAST_SIGMA_PX
    from lcp_catalog.navigation.expected_position import Query

    attitude = math.inf if attitude_deg is None else math.radians(attitude_deg)
    pixel_px = LEAST_SIGMA_PX if pixel_sigma_px is None else pixel_sigma_px
    return Query(most, attitude, height_sigma_m, map_sigma_m, pixel_px)


def frames_of(
    camera: str | None, trajectory: str | None, flags: dict[str, Any]
) -> list[PlannedImage]:
    from lcp_catalog.cameras.camera_file import read_camera, read_sensor
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.navigation.frame_points import PlannedImage
    from lcp_catalog.navigation.trajectory_file import read_trajectory

    sun = SunChoice(*(flags[name] for name in options.SUN_ANGLES))
    if trajectory is None:
        assert camera is not None
        return [PlannedImage.lit(read_sensor(camera), sun)]
    taken = read_trajectory(trajectory, read_camera(camera) if camera else None)
    return [PlannedImage.lit(one, sun) for one in taken]


def _one(
    catalog: Catalog,
    frame: PlannedImage,
    query: Query,
    as_json: bool,
    output: str | None,
    overwrite: bool,
) -> None:
    """The answer for one frame."""
    from lcp_catalog.atomic_files import write_bytes
    from lcp_catalog.navigation import documents
    from lcp_catalog.navigation.expected_position import answers

    (answer,) = answers(catalog, [frame], query)
    if output is not None:
        text = documents.points_csv if output.lower().endswith(".csv") else documents.points_geojson
        write_bytes(output, text(answer, catalog).encode("utf-8"), overwrite)
    if as_json:
        click.echo(json.dumps(documents.document(answer, catalog), indent=2, allow_nan=False))
    elif output is None:
        for line in documents.point_lines(answer, catalog, POINTS_SHOWN):
            echo(line)
    echo(documents.result_line(answer), err=as_json)
    if output is not None:
        say(f"{output}: {len(answer.rows)} points written")


def _along(
    catalog: Catalog,
    frames: list[PlannedImage],
    query: Query,
    as_json: bool,
    output: str | None,
    plot: str | None,
    overwrite: bool,
    title: str,
) -> None:
    """The answers for the frames of a trajectory, written as they come."""
    from lcp_catalog.atomic_files import write_aside, write_bytes
    from lcp_catalog.navigation import documents
    from lcp_catalog.navigation.trajectory_chart import TrajectoryChart

    chart = TrajectoryChart()
    found = _told(catalog, frames, query, chart, as_json)
    if output is None:
        for line in documents.frame_lines(found):
            if not as_json:
                echo(line)
    else:
        with (
            write_aside(output, overwrite) as aside,
            aside.open("w", encoding="utf-8", newline="") as file,
        ):
            file.writelines(documents.frames_csv(found))
    for line in chart.summary():
        echo(line, err=as_json)
    if plot is not None:
        write_bytes(plot, chart.encode(plot, title), overwrite)
    for name in (output, plot):
        if name is not None:
            say(f"{name}: written")


def _told(
    catalog: Catalog,
    frames: list[PlannedImage],
    query: Query,
    chart: TrajectoryChart,
    as_json: bool,
) -> Iterator[Answer]:
    """The answers, each added to the chart and, with ``--json``, printed as an element of one list."""
    from lcp_catalog.navigation.documents import document
    from lcp_catalog.navigation.expected_position import answers

    with progress("frames") as update:
        for done, answer in enumerate(answers(catalog, frames, query), 1):
            chart.add(answer)
            if as_json:
                text = json.dumps(document(answer, catalog), allow_nan=False)
                click.echo(("[" if done == 1 else ",\n") + text, nl=False)
            update(done, len(frames))
            yield answer
    if as_json:
        click.echo("]")
