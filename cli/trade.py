"""``lcp trade``: run time and errors of the accuracy tiers on the user's own DEM and sweep."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from .build_options import config_option, configuration, point_options, sweep_options
from .files import FileCommand
from .messages import echo, say
from .options import (
    LAW,
    REFLECTANCE_HELP,
    albedo_options,
    dem_argument,
    output_option,
    overwrite_option,
    product_order_option,
    region_options,
)


def _written(folder: str) -> Iterator[Path]:
    from lcp_catalog.tradeoff.report import FILES

    yield from (Path(folder, name) for name in FILES)


@click.command(
    "trade",
    cls=FileCommand,
    rule=True,
    example="lcp trade DEM.tif -o trade --center 3.5 26 --size 60 --areas 2",
)
@dem_argument
@product_order_option
@output_option("DIR", written=_written)
@config_option
@region_options
@sweep_options
@click.option(
    "--reflectance",
    type=LAW,
    default=None,
    help=REFLECTANCE_HELP,
)
@albedo_options
@point_options
@click.option(
    "--areas",
    type=click.IntRange(1),
    metavar="N",
    help="Number of the build's areas to compute, spread over the region; default 4.",
)
@click.option(
    "--rounds",
    type=click.IntRange(1),
    metavar="N",
    help="Number of timed runs of each area in each tier; the median counts; default 2.",
)
@overwrite_option
def command(
    dem: tuple[str, ...],
    output: str,
    areas: int | None,
    rounds: int | None,
    overwrite: bool,
    **flags: Any,
) -> None:
    """Measure the run time and the errors of each accuracy tier on your own DEM and sweep.

    The options describe a build as in `lcp build-catalog`. Some areas of that build are computed
    in every tier, each tier in a process of its own, and compared with the tier `reference`.

    Writes DIR/trade.json, DIR/trade.html (table, plot and images) and DIR/trade.md (the table in
    Markdown).
    """
    config = configuration(**flags)
    from lcp_catalog.production.run import Build
    from lcp_catalog.tradeoff.measurement import AREAS, ROUNDS, measure_trade
    from lcp_catalog.tradeoff.report import check_trade_folder, markdown, write_trade

    from .progress import progress

    folder = Path(output)
    check_trade_folder(folder, overwrite)
    build = Build.plan(tuple(Path(path) for path in dem), config)
    if build.levels:
        raise click.UsageError("the configuration has several levels: give one cell size, --gsd")
    with progress("tiers") as update:
        trade = measure_trade(build, areas or AREAS, rounds or ROUNDS, progress=update)
    write_trade(trade, folder, overwrite)
    echo(markdown(trade), nl=False)
    compared = trade.compared
    say(f"{output}: {len(trade.rows)} tiers on {compared['areas']} of {compared['areas_of']} areas")
