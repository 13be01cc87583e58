"""``lcp flight-source``: the C reference of the flight file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from . import options
from .files import FileCommand, OutputFile
from .messages import echo


def _written(folder: str) -> Iterator[Path]:
    from lcp_catalog._package_files import FLIGHT_FILES

    yield from (Path(folder, name) for name in FLIGHT_FILES)


@click.command(cls=FileCommand, example="lcp flight-source -o flight")
@options.output_option("DIR", OutputFile(_written))
@options.overwrite_option
def command(output: str, overwrite: bool) -> None:
    """Write the C99 reference of the flight file (.lcpf) into a folder: it checks the file, finds the points in view of
    a camera, renders their patches and finds them in an image.

    make -C DIR test compiles it and runs its test vector, make -C DIR fuzz damages files and images under sanitizers.
    """
    from lcp_catalog._package_files import write_flight_source

    written = write_flight_source(Path(output), overwrite)
    echo(f"{output}: {len(written)} files; make -C {output} test")
