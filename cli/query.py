"""``lcp query``: usable points of a camera and a Sun, and the position that they are expected to give."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import click

from . import options
from .files import FileCommand, require_ending
from .groups import collected, option_group
from .messages import echo, say
from .names import in_options
from .progress import progress
from .value_types import Number

if TYPE_CHECKING:
    from lcp_catalog.catalog.catalogue import Catalog
    from lcp_catalog.light.sun_choice import SunChoice
    from lcp_catalog.navigation.documents import TrajectoryChart
    from lcp_catalog.navigation.expected_position import Answer, Query
    from lcp_catalog.navigation.frame_points import PlannedImage

POINTS_SHOWN = 12
"""Rows of the table on a terminal."""


@dataclass(frozen=True)
class FrameOptions:
    """The frames of which is asked: a camera, or a trajectory."""

    camera: str | None
    trajectory: str | None

    def read(self, sun: SunChoice, catalog: str) -> list[PlannedImage]:
        """The frames under a Sun, or under their own; an empty list of neither."""
        from lcp_catalog.cameras.camera_file import read_camera, read_sensor
        from lcp_catalog.matching.point_choice import shows_points
        from lcp_catalog.navigation.frame_points import PlannedImage
        from lcp_catalog.navigation.trajectory_file import read_trajectory

        if self.trajectory is not None:
            of_all = None if self.camera is None else read_camera(self.camera)
            return [PlannedImage.lit(one, sun) for one in read_trajectory(self.trajectory, of_all)]
        if self.camera is None:
            return []
        sensor = read_sensor(self.camera, sees=shows_points(catalog))
        return [PlannedImage.lit(sensor, sun, warns=True)]


frame_options = collected(
    "frames",
    FrameOptions,
    options.camera_file_option(
        "Camera file: CAMERA.json, USGS ISD or .tsai. With --trajectory FILE.csv: the camera without its place."
    ),
    options.trajectory_option(
        "Frames in time: CSV with time_utc, x_m, y_m, z_m and qw, qx, qy, qz (or r11 ... r33), or a JSON list of "
        "CAMERA.json objects."
    ),
)
"""The frames, which a command gets as ``frames``."""


def query_choice(
    attitude_sigma_deg: float | None,
    height_sigma_m: float | None,
    map_sigma_m: float | None,
    pixel_sigma_px: float | None,
    most: int | None = None,
) -> Query:
    """What is asked, and what is known before."""
    from lcp_catalog.matching.point_choice import LEAST_SIGMA_PX
    from lcp_catalog.navigation.expected_position import Query

    attitude = math.inf if attitude_sigma_deg is None else math.radians(attitude_sigma_deg)
    pixel_px = LEAST_SIGMA_PX if pixel_sigma_px is None else pixel_sigma_px
    return Query(most, attitude, height_sigma_m, map_sigma_m, pixel_px)


most_option = click.option(
    "--max",
    "most",
    type=click.IntRange(1, 100_000),
    metavar="N",
    help="Only the N points of a frame that together determine the position best, the most informative first; default: all.",
)


known_options = option_group(
    click.option(
        "--attitude-sigma",
        "attitude_sigma_deg",
        type=Number(0.0, 90.0),
        metavar="DEG",
        help="Uncertainty of the attitude as known before: 1 sigma about each axis; 0: exact. Default: unknown; it is estimated "
        "with the position.",
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
        metavar="M",
        help="1 sigma for each axis of a position error that all points share, such as an offset of the map in the "
        "Moon-fixed frame; default: that of the DEM's product (GLD100: 30; LOLA, SLDEM2015, NAC DTM: 10), 0 where none is "
        "published.",
    ),
    click.option(
        "--pixel-sigma",
        "pixel_sigma_px",
        type=Number(0.0),
        metavar="PX",
        help="1 sigma for each axis of a match's error that the catalogue's sigma does not include, in pixels of the image, "
        "or in cells of the point if these are larger; default: 0.02.",
    ),
)
"""What is known before about attitude, heights and map."""


@click.command(
    cls=FileCommand,
    rule=True,
    example="lcp query site.h5 --camera CAMERA.json --time 2026-03-01T12:00 --max 20",
)
@options.catalog_argument
@frame_options
@options.sun_angle_options
@collected("query", query_choice, most_option, known_options)
@options.json_option()
@options.output_option("OUT.csv|.geojson", required=False)
@options.other_output_option(
    "--plot", "OUT.svg|.html", "With --trajectory: chart of usable points, accuracy and holes."
)
@options.overwrite_option
def command(
    catalog: str,
    frames: FrameOptions,
    sun: SunChoice,
    query: Query,
    as_json: bool,
    output: str | None,
    plot: str | None,
    overwrite: bool,
) -> None:
    """List the points of a catalogue that a camera can use under a Sun, and the expected accuracy of a
    position from them.

    With --trajectory: one row for each frame; --json lists the points of all frames. The Sun is the
    stated one (angles at the image's centre), else that of the camera file.
    """
    _check(frames, output, plot)

    from lcp_catalog.catalog.verification import open_catalog
    from lcp_catalog.matching.point_choice import seen_from

    images = frames.read(sun, catalog)
    opened = seen_from(open_catalog(catalog, check=False), [one.sensor for one in images])
    asked = Asked(opened, images, query, as_json, output, overwrite)
    if frames.trajectory is None:
        _one(asked)
    else:
        _along(asked, plot, Path(frames.trajectory).name)


def _check(frames: FrameOptions, output: str | None, plot: str | None) -> None:
    """Raise a usage error for options that do not fit together."""
    if frames.camera is None and frames.trajectory is None:
        raise click.UsageError("give --camera CAMERA.json or --trajectory FILE")
    if plot is not None and frames.trajectory is None:
        raise click.UsageError("--plot needs --trajectory")
    if output is not None and frames.trajectory is not None:
        require_ending("-o", output, (".csv",))


@dataclass(frozen=True)
class Asked:
    """Frames of which is asked, and where the answers go."""

    catalog: Catalog
    images: list[PlannedImage]
    query: Query
    as_json: bool
    output: str | None
    overwrite: bool
    lacking: list[str] = field(default_factory=list)
    """What would help the first frame of a trajectory without a position, if any."""


def _one(asked: Asked) -> None:
    """The answer for one frame."""
    from lcp_catalog.atomic_files import write_bytes
    from lcp_catalog.navigation import documents
    from lcp_catalog.navigation.expected_position import answers

    output, catalog = asked.output, asked.catalog
    (answer,) = answers(catalog, asked.images, asked.query)
    if output is not None:
        text = documents.points_csv if output.lower().endswith(".csv") else documents.points_geojson
        write_bytes(output, text(answer, catalog).encode("utf-8"), asked.overwrite)
    if asked.as_json:
        echo(json.dumps(documents.document(answer, catalog), indent=2, allow_nan=False))
    elif output is None and len(answer.rows):
        for line in documents.point_lines(answer, catalog, POINTS_SHOWN):
            echo(line)
    line = documents.result_line(answer)
    if not answer.counts["in_view"]:
        from lcp_catalog.navigation.camera_info import blind_to_points

        line += f"; {blind_to_points(catalog, answer.frame.sensor)}"
    line += _cures(asked, answer)
    echo(in_options(line), err=asked.as_json)
    if output is not None:
        say(f"{output}: {len(answer.rows)} points written")


def _cures(asked: Asked, answer: Answer) -> str:
    """The cheapest catalogues that may give a position, as the end of a sentence; empty if there is one, or if fewer points were
    asked for.
    """
    from lcp_catalog.navigation.better_catalog import better_catalog

    if answer.position.covariance is not None or len(answer.rows) < answer.usable:
        return ""
    return better_catalog(asked.catalog, answer.frame, planned=True)


def _along(asked: Asked, plot: str | None, title: str) -> None:
    """The answers for the frames of a trajectory, written as they come."""
    from lcp_catalog.atomic_files import write_bytes, write_lines
    from lcp_catalog.navigation import documents
    from lcp_catalog.navigation.documents import TrajectoryChart

    chart = TrajectoryChart()
    found = _told(asked, chart)
    if asked.output is None:
        for line in documents.frame_lines(found):
            if not asked.as_json:
                echo(line)
    else:
        write_lines(asked.output, documents.frames_csv(found), asked.overwrite)
    for line in [*chart.summary(), *asked.lacking]:
        echo(in_options(line), err=asked.as_json)
    if plot is not None:
        write_bytes(plot, chart.encode(plot, title), asked.overwrite)
    for name in filter(None, (asked.output, plot)):
        say(f"{name}: written")


def _told(asked: Asked, chart: TrajectoryChart) -> Iterator[Answer]:
    """The answers, each added to the chart and, with ``--json``, printed as an element of one list."""
    from lcp_catalog.navigation.documents import document
    from lcp_catalog.navigation.expected_position import answers

    with progress("frames") as update:
        for done, answer in enumerate(answers(asked.catalog, asked.images, asked.query), 1):
            chart.add(answer)
            if not asked.lacking and (cures := _cures(asked, answer)):
                asked.lacking.append(f"{answer.frame.time_utc or f'frame {done}'}: {cures[2:]}")
            if asked.as_json:
                text = json.dumps(document(answer, asked.catalog), allow_nan=False)
                click.echo(("[" if done == 1 else ",\n") + text, nl=False)
            update(done, len(asked.images))
            yield answer
    if asked.as_json:
        click.echo("]")
