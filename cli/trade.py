"""``lcp trade``: every accuracy tier against ``reference``, on the user's own DEM and sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .build_options import config_option, configuration, point_options, sweep_options
from .options import (
    LAW,
    REFLECTANCE_HELP,
    albedo_options,
    area_options,
    dem_argument,
    output_option,
    overwrite_option,
    product_order_option,
)


@click.command("trade")
@dem_argument
@product_order_option
@output_option("DIR")
@config_option
@area_options
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
    help="How many of the build's areas to compute, spread over the region; default 4.",
)
@click.option(
    "--rounds",
    type=click.IntRange(1),
    metavar="N",
    help="How often each area is computed in each tier, for the median time; default 2.",
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
    """Measure what each accuracy tier costs and what it changes, on your own DEM and sweep.

    Some areas of the build that the same flags would make are computed in every tier, the tiers in turn, each in a process of its
    own. DIR gets trade.json, trade.html (a page with table, plot and pictures) and trade.md (the table to paste).
    """
    config = configuration(**flags)
    from lcp_catalog.build.run import Build
    from lcp_catalog.tradeoff.measurement import AREAS, ROUNDS, measure_trade
    from lcp_catalog.tradeoff.report import check_trade_folder, markdown, write_trade

    from .progress import progress

    folder = Path(output)
    check_trade_folder(folder, overwrite)
    build = Build.plan(tuple(Path(path) for path in dem), config)
    with progress("tiers") as update:
        trade = measure_trade(build, areas or AREAS, rounds or ROUNDS, progress=update)
    write_trade(trade, folder, overwrite)
    click.echo(markdown(trade), nl=False)
    compared = trade.compared
    click.echo(
        f"{output}: {len(trade.rows)} tiers on {compared['areas']} of {compared['areas_of']} areas",
        err=True,
    )
