"""``lcp dem``: content of DEM files from labels and pixels, and the coverage of a set of them."""

from __future__ import annotations

import json

import click

from . import dem_check, options
from .files import FileCommand
from .messages import echo, say
from .value_types import PLACE


@click.group()
def command() -> None:
    """Inspect DEM files."""


command.add_command(dem_check.command)


@command.command(
    cls=FileCommand, rule=True, example="lcp dem info LDEM_*.LBL --at 0 -89.5 --map used.png"
)
@options.dem_argument
@options.json_option("Print one JSON list, one object for each file.")
@click.option(
    "--at",
    "places",
    multiple=True,
    type=PLACE,
    metavar="LON LAT",
    help="Also print the height at a place, degrees; may be repeated.",
)
@click.option(
    "--set",
    "only_set",
    is_flag=True,
    help="Print only the coverage of all files together; with --json one object instead of the list.",
)
@click.option(
    "--quick", is_flag=True, help="Read no pixels: print no heights and no missing pixels."
)
@options.other_output_option(
    "--map",
    "OUT.png",
    "Also write a map of the product used at each place, over shaded relief (not with --quick).",
    "map_path",
)
@options.product_order_option
@options.overwrite_option
def info(
    dem: tuple[str, ...],
    as_json: bool,
    places: tuple[tuple[float, float], ...],
    only_set: bool,
    quick: bool,
    map_path: str | None,
    product_order: tuple[str, ...] | None,
    overwrite: bool,
) -> None:
    """Show projection, bounds, cell size, heights and missing pixels of DEM files (GeoTIFF, or PDS
    by image or label), and the coverage of all files together: areas by latitude and product,
    overlaps, gaps, missing pixels.
    """
    if places and (quick or only_set):
        raise click.UsageError("--at cannot be combined with --quick or --set")
    if overwrite and not map_path:
        raise click.UsageError("--overwrite needs --map OUT.png")

    from lcp_catalog.dem.public import dem_info  # rasterio and numba: only when the command runs

    from . import dem_text

    found = dem_info(dem, at_deg=places, quick=quick, product_order=product_order or ())
    files = [] if only_set else list(found.files)
    if map_path is not None:
        from lcp_catalog.atomic_files import write_bytes
        from lcp_catalog.dem.coverage_map import set_map

        write_bytes(map_path, set_map(found.dems, found.heights), overwrite)
    if as_json and not only_set:  # the list has no field for it
        for one in found.whole["disagreements"] or ():
            say(f"lcp: warning: {one['message']}")
    if as_json:
        echo(json.dumps(found.whole if only_set else files, indent=2))
    else:
        echo("\n\n".join([*map(dem_text.file_text, files), dem_text.set_text(found.whole)]))
    for line in dem_text.outside(files):
        say(f"lcp: {line}")
