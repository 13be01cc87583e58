"""``lcp trade``: what every approximation costs and changes on the user's own DEM and sweep."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .build_options import ALBEDO, AREA, POINTS, SWEEP, build_options
from .files import FileCommand, OutputFile
from .messages import echo, say
from .options import dem_argument, output_option, overwrite_option
from .progress import progress
from .value_types import Number, Read

if TYPE_CHECKING:
    from lcp_catalog.production.config import BuildConfig


ALL = "all"


class AreaCount(Read):
    """N, or all."""

    name = "areas"

    def read(self, text: str) -> int | str:
        if text == ALL:
            return ALL
        if not text.isdigit() or int(text) < 1:
            raise click.BadParameter(f"{text!r} is not a number of at least 1, or {ALL}")
        return int(text)


def _written(folder: str) -> Iterator[Path]:
    from lcp_catalog.tradeoff.knob_table import BEST
    from lcp_catalog.tradeoff.report import FILES

    yield from (Path(folder, name) for name in (*FILES, BEST))


@click.command(
    "trade",
    cls=FileCommand,
    rule=True,
    example="lcp trade DEM.tif -o trade --center 3.5 26 --size 60 --areas 2",
)
@dem_argument
@output_option("DIR", OutputFile(_written))
@build_options(["dem.product_order", *AREA, *SWEEP, "model.reflectance", *ALBEDO, *POINTS])
@click.option(
    "--areas",
    type=AreaCount(),
    metavar="N|all",
    help="Number of the build's areas to compute, spread over the region; all: also small ones at its border, and the promise. "
    "Default 4.",
)
@click.option(
    "--rounds",
    type=click.IntRange(1),
    metavar="N",
    help="Number of timed runs of each area in each tier; the median counts; default 2.",
)
@click.option(
    "--budget",
    "budget_s",
    type=Number(0.0, None, min_open=True),
    metavar="SECONDS",
    help="Write best.toml, the configuration to take for so much processor time of the build; for this scene alone.",
)
@click.option(
    "--max-error",
    type=Number(0.0, 1.0),
    metavar="X",
    help="Write best.toml, the fastest configuration that changes at most this share of the conditions; for this scene alone.",
)
@click.option(
    "--time-limit",
    type=Number(0.0, None),
    default=180.0,
    show_default=False,
    metavar="SECONDS",
    help="Time after which nothing more is begun, half of it for the tiers; 0: tiers alone, without a limit. Default 180.",
)
@overwrite_option
def command(
    dem: tuple[str, ...],
    output: str,
    areas: int | str | None,
    rounds: int | None,
    budget_s: float | None,
    max_error: float | None,
    time_limit: float,
    overwrite: bool,
    config: BuildConfig,
) -> None:
    """Measure what every approximation costs and changes on your own DEM and sweep.

    The options describe a build as in `lcp build-catalog`. Some areas of that build are computed
    in every tier, each tier in a process of its own, and compared with the tier `reference`; then with
    one alternative at a time around the configuration, those with the greatest effect first.

    Writes DIR/trade.json, DIR/trade.html (tables, plots and images), DIR/trade.md (the tables in
    Markdown), and with --budget or --max-error DIR/best.toml.
    """
    from lcp_catalog.tradeoff.measurement import AREAS, ROUNDS
    from lcp_catalog.tradeoff.report import areas_said, markdown, trade

    with progress("runs") as update:
        found = trade(
            dem,
            output,
            config=config,
            areas=None if areas == ALL else int(areas or AREAS),
            budget_s=budget_s,
            max_error=max_error,
            time_limit_s=time_limit,
            rounds=rounds or ROUNDS,
            overwrite=overwrite,
            progress=update,
        )
    echo(markdown(found), nl=False)
    some, of = found.compared["areas"], found.compared["areas_of"]
    many = f"{len(found.tiers)} tiers and {max(0, len(found.rows) - 1)} alternative{'s' * (len(found.rows) != 2)}"
    if areas not in (None, ALL) and int(areas) > some:
        few = f"; {some} computed: the border halves the others, or the time ended" * (some < of)
        say(f"{output}: --areas {areas}, of which the build has {of}{few}")
    say(f"{output}: {many}; {areas_said(found.compared, found.rows)}")
