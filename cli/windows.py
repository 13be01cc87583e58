"""``lcp windows``: when a site has how many usable points."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from lcp_catalog.choices import SITE_KM

from . import options
from .build_options import field_option
from .files import FileCommand
from .groups import option_group
from .messages import echo, say
from .progress import progress
from .sun import range_of
from .value_types import POSITIVE

if TYPE_CHECKING:
    from lcp_catalog.navigation.site_windows import SiteWindows


site_options = option_group(
    field_option(
        "area.gsd_m",
        help="Size of the image's pixel on the ground; default: the cell size of each point.",
    ),
    click.option(
        "--size",
        "size_km",
        type=POSITIVE,
        metavar="KM",
        help=f"Side length of the square site; default: {SITE_KM:g}.",
    ),
    options.view_angle_options,
    options.camera_file_option(
        "Camera that stays at its place: the points in its image, and the expected accuracy of its position."
    ),
)
"""Whose points count: those of a square as seen from one direction, or those in the image of a camera."""


@click.command(
    cls=FileCommand,
    rule=True,
    example="lcp windows site.h5 --center 3.5 26 --range 2026-03-01 2026-04-01 6h -o windows.csv",
)
@options.catalog_argument
@options.center_option(
    "Centre of the site, degrees; the Sun's angles are those there.", required=True
)
@options.range_option(
    "Instants from FROM to TO, UTC; STEP is like 30m, 6h, 1d or PT6H.",
    required=True,
    metavar="FROM TO STEP",
)
@site_options
@click.option(
    "--min-points",
    type=click.IntRange(1),
    default=4,
    metavar="N",
    help="Least number of usable points of an interval.",
)
@options.json_option()
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
    size_km: float | None,
    gsd_m: float | None,
    off_nadir: float | None,
    view_azimuth: float | None,
    camera: str | None,
) -> None:
    """List the intervals of time in which a site has enough usable points.

    A point is usable if the catalogue says so for the Sun, the view and the size of a pixel, as in lcp
    query. -o and --json give the number at every instant.
    """
    from lcp_catalog.atomic_files import write_bytes
    from lcp_catalog.catalog.verification import open_catalog
    from lcp_catalog.navigation.site_windows import windows

    opened = open_catalog(catalog, check=False)  # here is one thread, and `progress` starts another
    with progress("instants") as update:
        found = windows(
            opened,
            center,
            range_of(span),
            size_km=size_km,
            gsd_m=gsd_m,
            off_nadir_deg=off_nadir,
            view_azimuth_deg=view_azimuth,
            camera=camera,
            progress=update,
        )
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
        echo(json.dumps(whole, indent=2, allow_nan=False))
    else:
        for line in _text(found, intervals, min_points):
            echo(line)
    if output is not None:
        say(f"{output}: {len(found.times)} instants written")


def _text(found: SiteWindows, intervals: list[dict[str, Any]], least: int) -> list[str]:
    lines = []
    if intervals:
        located = "" if found.located is None else "        located, at least"
        lines.append(
            f"from                  to                    instants  usable     Sun, deg{located}"
        )
    for one in intervals:
        usable = f"{one['usable_min']} to {one['usable_max']}"
        sun = f"{one['sun_elevation_min_deg']:.1f} to {one['sun_elevation_max_deg']:.1f}"
        line = f"{one['from']:<20}  {one['to']:<20} {one['instants']:>9}  {usable:<9}  {sun}"
        least_located = one.get("located_probability_min")
        lines.append(line if least_located is None else f"{line:<77}  {least_located:.2f}")
    enough = sum(one["instants"] for one in intervals)
    lines.append(
        f"{found.points} points; at least {least} of them usable at {enough} of {len(found.times)} instants, "
        f"at most {int(found.usable.max())}"
    )
    return lines
