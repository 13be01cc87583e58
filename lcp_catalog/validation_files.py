"""The folder that a validation writes: the report as JSON and as a page, and its tables."""

from __future__ import annotations

from pathlib import Path

from .files import check_folder, depfile_text, write_bytes
from .match_table import csv_text, windows_csv_text
from .validate import Result
from .validation_report import render

FILES = ("points.csv", "windows.csv", "report.html", "report.json")
"""In the order in which they are written: report.json, which Make waits for, comes last."""


def check_validation_folder(folder: Path, overwrite: bool) -> None:
    """Say early what would fail late. Raises as `files.check_folder`."""
    check_folder(folder, FILES, overwrite)


def write_validation(
    result: Result, folder: Path, overwrite: bool = False, depfile: Path | str | None = None
) -> None:
    """Write `FILES` into a folder, which is made where it is missing; ``depfile``: also what was read, as a rule for Make."""
    check_validation_folder(folder, overwrite)
    images = result.verdict.images
    texts = (
        csv_text(images),
        windows_csv_text(images),
        render(result.verdict, result.pictures),
        result.verdict.to_json(),
    )
    folder.mkdir(exist_ok=True)
    for name, text in zip(FILES, texts, strict=True):
        write_bytes(folder / name, text.encode("utf-8"), overwrite)
    if depfile:
        rule = depfile_text(folder / FILES[-1], result.sources)
        write_bytes(depfile, rule.encode("utf-8"), overwrite=True)
