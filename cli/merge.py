"""``lcp merge``: catalogues joined into one."""

from __future__ import annotations

import click

from . import options
from .files import CATALOG, FileCommand
from .messages import say


@click.command(cls=FileCommand, rule=True, example="lcp merge west.h5 east.h5 -o both.h5")
@click.argument(
    "catalogs",
    nargs=-1,
    required=True,
    metavar="A.h5 B.h5...",
    type=CATALOG,
)
@options.output_option("C.h5|C.lcpx")
@options.overwrite_option
def command(catalogs: tuple[str, ...], output: str, overwrite: bool) -> None:
    """Join catalogues of neighbouring regions, or of several cell sizes, into one without doubles.

    Of points with the same id, and of points of one level that are nearer to each other than the spacing, the one
    with more usable conditions is kept, as in a build. The catalogues must have the same Suns, views, image scales, patch
    sizes and errors. Their order does not change the output.

    -o C.lcpx writes an index: the points stay in their files, and every command takes it in place of a catalogue. A file
    is opened when points of it are needed, and refused if it has changed since.
    """
    from lcp_catalog.production.public import merge

    if len(catalogs) < 2:
        raise click.UsageError("name at least two catalogues")
    done = merge(catalogs, output, overwrite=overwrite)
    cells = ", ".join(" and ".join(f"{size:.5g}" for size in sizes) for sizes in done.levels_m)
    say(
        f"{output}: {done.points} points of {sum(done.inputs)} in {len(done.inputs)} catalogue{'s' * (len(done.inputs) != 1)} "
        f"({done.doubles} doubles, {done.crowded} nearer than the spacing), cells of {cells} m"
    )
