"""Output folder of a validation: the report as JSON and as a page, and CSV tables."""

from __future__ import annotations

import os
from pathlib import Path

from ..atomic_files import check_folder, check_output, depfile_rule, write_bytes
from ..errors import OutputError
from .report import render
from .run import Result
from .tables import csv_text, windows_csv_text

FILES = ("points.csv", "windows.csv", "report.html", "report.json")
"""Files in the order of writing; report.json, the target of the make rule, is the last."""


def check_validation_folder(
    folder: Path,
    overwrite: bool,
    depfile: Path | str | None = None,
    errors_file: Path | None = None,
) -> None:
    """Check the output folder before the validation. Raises as `atomic_files.check_folder`, and for
    the make rule and the file of fitted errors as `atomic_files.check_output`; OutputError if one of
    these is a file of the report, or both are one file.
    """
    check_folder(folder, FILES, overwrite)
    if depfile:
        _require_elsewhere(folder, depfile, "`depfile`", overwrite=True)
    if errors_file:
        _require_elsewhere(folder, errors_file, "`fit_errors`", overwrite)
    if depfile and errors_file and os.path.realpath(depfile) == os.path.realpath(errors_file):
        raise OutputError(f"{errors_file}: is the file of `depfile`; choose another one")


def _require_elsewhere(folder: Path, path: Path | str, option: str, overwrite: bool) -> None:
    """Check that another output does not replace a file of the report. The folder need not exist
    yet.
    """
    place = Path(os.path.realpath(path))
    if place.parent == Path(os.path.realpath(folder)) and place.name in FILES:
        raise OutputError(f"{path}: is a file of the report; choose another name for {option}")
    if folder.is_dir() or place.parent != Path(os.path.realpath(folder)):
        check_output(path, overwrite)


def write_validation(
    result: Result,
    folder: Path,
    overwrite: bool = False,
    depfile: Path | str | None = None,
    errors_file: Path | None = None,
) -> None:
    """Write `FILES` into a folder, which is created if missing. ``depfile``: also the list of input
    files, as a rule for make. ``errors_file``: also the fitted error model.
    """
    check_validation_folder(folder, overwrite, depfile, errors_file)
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
    if errors_file and result.fitted:
        write_bytes(errors_file, result.fitted.to_toml().encode("utf-8"), overwrite)
    for name, text in zip(FILES, texts, strict=True):
        write_bytes(folder / name, text.encode("utf-8"), overwrite)
    if depfile:
        rule = depfile_rule(folder / FILES[-1], result.sources)
        write_bytes(depfile, rule, overwrite=True)
