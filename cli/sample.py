"""``lcp sample``: the sample data, for the tutorial."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from . import options
from .files import FileCommand, OutputFile
from .messages import echo


def _written(folder: str) -> Iterator[Path]:
    from lcp_catalog._package_files import SAMPLE_FILES

    yield from (Path(folder, name) for name in SAMPLE_FILES)


@click.command(cls=FileCommand, example="lcp sample hadley")
@click.argument("folder", metavar="FOLDER", type=OutputFile(_written))
@options.overwrite_option
def command(folder: str, overwrite: bool) -> None:
    """Write the sample data of the tutorial into a folder: the DEM and an albedo map of the Apollo 15 landing
    region, a photograph of it with its camera, and a Makefile that builds a catalogue and tests it.

    FOLDER/PROVENANCE.txt states where each file is from, and its licence. Nothing is downloaded.
    """
    from lcp_catalog._package_files import write_sample

    written = write_sample(Path(folder), overwrite)
    size = sum(path.stat().st_size for path in written)
    echo(f"{folder}: {len(written)} files, {size / 1e6:.1f} MB; sources and licences: {written[0]}")
    echo(f"catalogue, report and validation: make -C {folder}")
