"""``lcp sun``: azimuth, elevation and visible share of the Sun over a place."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any

import click

from . import options
from .build_options import field_option
from .files import FileCommand
from .messages import echo
from .value_types import LATITUDE, LONGITUDE, Instant, Number

if TYPE_CHECKING:
    from lcp_catalog.ephemeris.solar_position import SunTable
    from lcp_catalog.ephemeris.times import Instants

LINES_AT_ONCE = 4096

COLUMNS = {
    # key of a record: (heading, width, decimals)
    "time_utc": ("time (UTC)", -27, None),
    "azimuth_deg": ("azimuth", 9, 4),
    "elevation_deg": ("elevation", 9, 4),
    "disc_share": ("share", 7, 4),
    "subsolar_lon": ("sub. lon", 9, 4),
    "subsolar_lat": ("sub. lat", 9, 4),
    "distance_au": ("au", 9, 6),
    "disc_radius_deg": ("radius", 8, 5),
    "horizon_deg": ("horizon", 8, 3),
    "terrain_share": ("lit", 7, 4),
}


@click.command(
    cls=FileCommand, rule=True, example="lcp sun --center 3.63 26.13 --time 1971-07-31T01:25:52"
)
@options.center_option("The place, degrees east and north.")
@click.option("--lon", type=LONGITUDE, metavar="DEG", help="Longitude; with --lat: as --center.")
@click.option("--lat", type=LATITUDE, metavar="DEG", help="Latitude; with --lon: as --center.")
@click.option(
    "--height",
    "height_m",
    type=Number(-20e3, 1e6),
    default=0.0,
    show_default=False,
    metavar="M",
    help="Height above the 1737.4 km sphere; with --dem: above the terrain; default: 0.",
)
@options.dems_option("Add the terrain horizon and the share of the disc above it.")
@field_option(
    "area.gsd_m",
    help="With --dem: cell size of the nearby terrain; default: that of the DEM.",
)
@click.option("--time", "time_utc", type=Instant(), metavar="UTC", help="One instant.")
@options.range_option("Instants from START to STOP; STEP is like 30m, 6h, 1d or PT6H.")
@options.json_option()
@options.output_option("OUT.csv", required=False)
@options.overwrite_option
def command(
    center: tuple[float, float] | None,
    lon: float | None,
    lat: float | None,
    height_m: float,
    dems: tuple[str, ...],
    gsd_m: float | None,
    time_utc: str | None,
    span: tuple[str, str, float] | None,
    as_json: bool,
    output: str | None,
    overwrite: bool,
) -> None:
    """Print the position of the Sun over a place on the Moon: azimuth, elevation, share of the disc
    above the horizontal plane, subsolar point, distance and angular radius.
    """
    place = _place_of(center, lon, lat)
    when = times_of(time_utc, span)
    if dems and height_m < 0.0:
        raise click.UsageError("--height must not be negative with --dem")

    from lcp_catalog.light.sun_visibility import sun_at

    table = sun_at(place, when, height_m=height_m, dem=dems or None, gsd_m=gsd_m)
    if output is not None:
        from lcp_catalog.atomic_files import write_lines

        write_lines(output, table.csv_lines(), overwrite)
    if as_json:
        _say(table.json_lines())
    elif output is None:
        _say(_text(table))


def _place_of(
    center: tuple[float, float] | None, lon: float | None, lat: float | None
) -> tuple[float, float]:
    """Longitude and latitude, degrees. Usage error if they are not given, or given twice."""
    if center is not None and lon is None and lat is None:
        return center
    if center is None and lon is not None and lat is not None:
        return lon, lat
    raise click.UsageError("give the place once: --center LON LAT, or --lon DEG and --lat DEG")


def times_of(time_utc: str | None, span: tuple[str, str, float] | None) -> Instants:
    """The instants of ``--time`` or ``--range``. Usage error unless one of them is given."""
    from lcp_catalog.ephemeris.times import instants

    if time_utc is not None and span is None:
        return instants(time_utc)
    if span is None or time_utc is not None:
        raise click.UsageError("give --time UTC or --range START STOP STEP")
    return range_of(span)


def range_of(span: tuple[str, str, float]) -> Instants:
    """The instants of ``--range``. Usage error for an empty or too long range."""
    from lcp_catalog.ephemeris.times import instant_range
    from lcp_catalog.errors import SunError

    start, stop, step_s = span
    try:
        return instant_range(start, stop, step_s)
    except SunError as error:
        raise click.UsageError(f"--range: {error}") from error


def _text(table: SunTable) -> Iterator[str]:
    yield from (f"# {line}\n" for line in (table.title, *table.remarks()))
    there = ("time_utc", *table.figures)
    columns = {key: column for key, column in COLUMNS.items() if key in there}
    yield " ".join(_cell(head, width) for head, width, _ in columns.values()) + "\n"
    for record in table.records():
        figures = (
            _cell(record[key] if digits is None else f"{record[key]:.{digits}f}", width)
            for key, (_, width, digits) in columns.items()
        )
        yield " ".join(figures) + "\n"


def _cell(text: Any, width: int) -> str:
    """Text aligned right, or left for a negative width."""
    return f"{text:<{-width}}" if width < 0 else f"{text:>{width}}"


def _say(lines: Iterator[str]) -> None:
    """Print in blocks of lines: one write per line would be slow for a million lines."""
    while block := list(islice(lines, LINES_AT_ONCE)):
        echo("".join(block), nl=False)
