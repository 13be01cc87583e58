"""``lcp report``: a catalogue as one self-contained HTML page."""

from __future__ import annotations

import click

from . import options
from .files import FileCommand
from .messages import say


@click.command(cls=FileCommand)
@options.catalog_argument
@options.output_option("REPORT.html")
@options.overwrite_option
def command(catalog: str, output: str, overwrite: bool) -> None:
    """Write a catalogue report: map of the points, their patches, and their usable Sun directions.

    The report is one HTML file without external references: it can be read offline.
    """
    from lcp_catalog.catalog.report import write_report

    write_report(catalog, output, overwrite=overwrite)
    say(f"{output}: written")
