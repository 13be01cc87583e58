"""Output folder of a validation: the report as JSON and as a page, and CSV tables."""

from __future__ import annotations

import os
from pathlib import Path

from ..atomic_files import check_folder, check_output, depfile_text, write_bytes
from ..errors import OutputError
from .report import render
from .run import Result
from .tables import csv_text, windows_csv_text

FILES = ("points.csv", "windows.csv", "report.html", "report.json")
"""Files in the order of writing; report.json, the target of the make rule, is the last."""


def check_validation_folder(
    folder: Path, overwrite: bool, depfile: Path | str | None = None
) -> None:
    """Check the output folder before the validation. Raises as `atomic_files.check_folder`, and for
    the make rule as `atomic_files.check_output`.
    """
    check_folder(folder, FILES, overwrite)
    if depfile:
        _require_elsewhere(folder, depfile)


def _require_elsewhere(folder: Path, depfile: Path | str) -> None:
    """Check that the make rule does not replace a file of the report. The folder need not exist
    yet.
    """
    place = Path(os.path.realpath(depfile))
    if place.parent != Path(os.path.realpath(folder)):
        check_output(depfile, overwrite=True)
    elif place.name in FILES:
        raise OutputError(f"{depfile}: is a file of the report; choose another name for --depfile")


def write_validation(
    result: Result, folder: Path, overwrite: bool = False, depfile: Path | str | None = None
) -> None:
    """Write `FILES` into a folder, which is created if missing. ``depfile``: also the list of input
    files, as a rule for make.
    """
    check_validation_folder(folder, overwrite, depfile)
    images = result.verdict.images
    texts = (
        csv_text(images),
        windows_csv_text(images),
        render(result.verdict, result.pictures),
        result.verdict.to_json(),
    )
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: the folder cannot be created: {error.strerror}") from error
    for name, text in zip(FILES, texts, strict=True):
        write_bytes(folder / name, text.encode("utf-8"), overwrite)
    if depfile:
        rule = depfile_text(folder / FILES[-1], result.sources)
        write_bytes(depfile, rule.encode("utf-8"), overwrite=True)
