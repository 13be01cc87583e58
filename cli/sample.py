"""``lcp sample``: the sample data, for the tutorial."""

from __future__ import annotations

import re
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
@click.argument("folder", metavar="FOLDER", type=OutputFile(_written), required=False)
@click.option("--list", "listed", is_flag=True, help="Print the files, and what each is.")
@options.overwrite_option
def command(folder: str | None, listed: bool, overwrite: bool) -> None:
    """Write the sample data of the tutorial into a folder: the DEM and an albedo map of the Apollo 15 landing
    region, a photograph of it with its camera, a Makefile that builds a catalogue and tests it, two notebooks, examples
    (a descent among them), and JSON schemas of the files that users write.

    FOLDER/PROVENANCE.txt states where each file is from, and its licence. Nothing is downloaded.
    """
    from lcp_catalog._package_files import SAMPLE_FILES, sample_folder, write_sample

    if listed:
        told = (sample_folder() / "PROVENANCE.txt").read_text(encoding="utf-8")
        about = dict(re.findall(r"^(\S+)\n *What: ([^,;:(\n]+)", told, re.M))
        for name in SAMPLE_FILES:
            echo(f"{name:36} {about.get(name, '')}".rstrip())
        return
    if folder is None:
        raise click.UsageError("give a FOLDER, or --list")
    written = write_sample(Path(folder), overwrite)
    size = sum(path.stat().st_size for path in written)
    echo(f"{folder}: {len(written)} files, {size / 1e6:.1f} MB; sources and licences: {written[0]}")
    echo(f"catalogue, report and validation: make -C {folder}")
