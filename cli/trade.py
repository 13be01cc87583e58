"""``lcp trade``: run time and errors of the accuracy tiers on the user's own DEM and sweep."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .build_options import ALBEDO, AREA, POINTS, SWEEP, build_options
from .files import FileCommand
from .messages import echo, say
from .options import dem_argument, output_option, overwrite_option
from .progress import progress

if TYPE_CHECKING:
    from lcp_catalog.production.config import BuildConfig


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
@output_option("DIR", written=_written)
@build_options(["dem.product_order", *AREA, *SWEEP, "model.reflectance", *ALBEDO, *POINTS])
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
    config: BuildConfig,
) -> None:
    """Measure the run time and the errors of each accuracy tier on your own DEM and sweep.

    The options describe a build as in `lcp build-catalog`. Some areas of that build are computed
    in every tier, each tier in a process of its own, and compared with the tier `reference`.

    Writes DIR/trade.json, DIR/trade.html (table, plot and images) and DIR/trade.md (the table in
    Markdown).
    """
    from lcp_catalog.tradeoff.measurement import AREAS, ROUNDS
    from lcp_catalog.tradeoff.report import markdown, trade

    with progress("tiers") as update:
        found = trade(
            dem,
            output,
            config=config,
            areas=areas or AREAS,
            rounds=rounds or ROUNDS,
            overwrite=overwrite,
            progress=update,
        )
    echo(markdown(found), nl=False)
    compared = found.compared
    say(f"{output}: {len(found.rows)} tiers on {compared['areas']} of {compared['areas_of']} areas")
