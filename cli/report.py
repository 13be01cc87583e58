"""``lcp report``: a catalogue as one self-contained page."""

from __future__ import annotations

import click

from . import options


@click.command()
@click.argument("catalog", metavar="CATALOG.h5", type=click.Path(exists=True, dir_okay=False))
@options.output_option("REPORT.html")
@options.overwrite_option
def command(catalog: str, output: str, overwrite: bool) -> None:
    """Draw a catalogue as one page: the map, the patches, and the Suns they serve under.

    The page is one file, needs no network and shows the same in ten years.
    """
    from lcp_catalog.catalog.report import write_report

    write_report(catalog, output, overwrite=overwrite)
    click.echo(f"{output}: written", err=True)
