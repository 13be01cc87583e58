"""``lcp windows``: when a site has how many usable points."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import options
from .files import FileCommand, InputFile
from .messages import echo, say
from .progress import progress
from .value_types import AZIMUTH, CELL_SIZE, LATITUDE, LONGITUDE, POSITIVE, Instant, Number, Step

if TYPE_CHECKING:
    from lcp_catalog.ephemeris.times import Instants
    from lcp_catalog.navigation.site_windows import SiteWindows

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""The matrices are small; and a process of one thread has its file checked without a fresh interpreter."""

DEFAULT_SIZE_KM = 20.0


@click.command(
    cls=FileCommand,
    rule=True,
    example="lcp windows site.h5 --center 3.5 26 --range 2026-03-01 2026-04-01 6h -o windows.csv",
)
@options.catalog_argument
@click.option(
    "--center",
    nargs=2,
    type=click.Tuple([LONGITUDE, LATITUDE]),
    required=True,
    metavar="LON LAT",
    help="Centre of the site, degrees; the Sun's angles are those there.",
)
@click.option(
    "--range",
    "span",
    nargs=3,
    type=click.Tuple([Instant(), Instant(), Step()]),
    required=True,
    metavar="FROM TO STEP",
    help="Instants from FROM to TO, UTC; STEP is like 30m, 6h, 1d or PT6H.",
)
@click.option(
    "--size",
    "size_km",
    type=POSITIVE,
    metavar="KM",
    help=f"Side length of the square site; default: {DEFAULT_SIZE_KM:g}.",
)
@click.option(
    "--gsd",
    "gsd_m",
    type=CELL_SIZE,
    metavar="M",
    help="Size of the image's pixel on the ground; default: the cell size of each point.",
)
@click.option(
    "--off-nadir",
    type=Number(0, 90, max_open=True),
    metavar="DEG",
    help="Angle between the vertical and the direction to the camera, degrees; default: 0.",
)
@click.option(
    "--view-azimuth",
    type=AZIMUTH,
    metavar="DEG",
    help="Azimuth of the camera, seen from the site, degrees clockwise from north.",
)
@click.option(
    "--camera",
    "camera_path",
    type=InputFile(),
    metavar="CAMERA.json",
    help="Camera that stays at its place: the points in its image, and the expected accuracy of its position.",
)
@click.option(
    "--min-points",
    type=click.IntRange(1),
    default=4,
    show_default=True,
    metavar="N",
    help="Least number of usable points of an interval.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout.")
@options.output_option("OUT.csv", required=False)
@options.overwrite_option
def command(
    catalog: str,
    center: tuple[float, float],
    span: tuple[str, str, float],
    min_points: int,
    as_json: bool,
    output: str | None,
    overwrite: bool,
    **flags: Any,
) -> None:
    """List the intervals of time in which a site has enough usable points.

    A point is usable if the catalogue says so for the Sun, the view and the size of a pixel, as in lcp
    query. -o and --json give the number at every instant.
    """
    _check(output, flags)

    from lcp_catalog.atomic_files import check_output, write_bytes

    if output is not None:
        check_output(output, overwrite)
    found = _found(catalog, center, _instants(*span), flags)
    intervals = found.intervals(min_points)
    if output is not None:
        write_bytes(output, found.csv_text().encode("utf-8"), overwrite)
    if as_json:
        whole = {
            "center": {"lon": center[0], "lat": center[1]},
            "points": found.points,
            "min_points": min_points,
            "intervals": intervals,
            "instants": list(found.records()),
        }
        click.echo(json.dumps(whole, indent=2, allow_nan=False))
    else:
        for line in _text(found, intervals, min_points):
            echo(line)
    if output is not None:
        say(f"{output}: {len(found.times)} instants written")


def _check(output: str | None, flags: dict[str, Any]) -> None:
    """Raise a usage error for options that do not fit together."""
    if output is not None and Path(output).suffix.lower() != ".csv":
        raise click.UsageError(f"-o {output}: the output must end in .csv")
    of_site = [name for name in ("size_km", "gsd_m", "off_nadir", "view_azimuth") if flags[name]]
    if flags["camera_path"] and of_site:
        raise click.UsageError("--camera excludes --size, --gsd, --off-nadir and --view-azimuth")
    if flags["off_nadir"] and flags["view_azimuth"] is None:
        raise click.UsageError("--off-nadir needs --view-azimuth")


def _instants(start: str, stop: str, step_s: float) -> Instants:
    from lcp_catalog.ephemeris.times import instant_range
    from lcp_catalog.errors import SunError

    try:
        return instant_range(start, stop, step_s)
    except SunError as error:
        raise click.UsageError(f"--range: {error}") from error


def _found(
    path: str, center: tuple[float, float], times: Instants, flags: dict[str, Any]
) -> SiteWindows:
    from lcp_catalog.cameras.camera_file import read_sensor
    from lcp_catalog.catalog.hdf5 import open_catalog
    from lcp_catalog.geometry.frames import EnuFrame
    from lcp_catalog.navigation.site_windows import Site, camera_windows, site_windows

    place = EnuFrame(*center)
    sensor = read_sensor(flags["camera_path"]) if flags["camera_path"] else None
    catalog = open_catalog(path, check=False)
    with progress("instants") as update:
        if sensor is not None:
            return camera_windows(catalog, place, sensor, times, update)
        site = Site(
            place,
            1e3 * (flags["size_km"] or DEFAULT_SIZE_KM),
            flags["gsd_m"],
            flags["off_nadir"] or 0.0,
            flags["view_azimuth"] or 0.0,
        )
        return site_windows(catalog, site, times, update)


def _text(found: SiteWindows, intervals: list[dict[str, Any]], least: int) -> list[str]:
    lines = []
    if intervals:
        lines.append("from                  to                    instants  usable     Sun, deg")
    for one in intervals:
        usable = f"{one['usable_min']} to {one['usable_max']}"
        sun = f"{one['sun_elevation_min_deg']:.1f} to {one['sun_elevation_max_deg']:.1f}"
        lines.append(f"{one['from']:<20}  {one['to']:<20} {one['instants']:>9}  {usable:<9}  {sun}")
    enough = sum(one["instants"] for one in intervals)
    lines.append(
        f"{found.points} points; at least {least} of them usable at {enough} of {len(found.times)} instants, "
        f"at most {int(found.usable.max())}"
    )
    return lines
