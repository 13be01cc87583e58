"""Output folder of a validation: the report as JSON and as a page, and CSV tables (RFC 4180) of the
points and the windows.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Mask
from ..atomic_files import check_folder, check_output, depfile_rule, write_bytes
from ..errors import OutputError
from ..geometry.ellipses import error_ellipses
from ..matching.matches import REASONS
from .report import render
from .result import DIGITS, ImageVerdict
from .run import Result

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


POINT_COLUMNS = (
    "image", "point_id", "longitude_deg", "latitude_deg",
    "predicted_column_px", "predicted_row_px", "found_column_px", "found_row_px",
    "sigma_major_px", "sigma_minor_px", "major_axis_deg",
    "correlation", "second_correlation", "back_px", "reason",
    "residual_column_px", "residual_row_px", "pixel_m",
    "detection_probability", "usable", "sigma_major_m", "sigma_minor_m", "sigma_angle_deg",
    "found", "error_east_m", "error_north_m", "prior", "posterior",
)  # fmt: skip
"""One row per point. ``major_axis_deg`` is from the column direction (right) towards the row
direction (down), 0..180. Residuals are the position found minus the prediction of the corrected
sensor. From ``detection_probability`` on: what the catalogue claims, and the trial of the claims
(`claim_trials`); ``usable`` and ``found`` are 0 or 1, empty without a claim and without a trial.
``prior`` and ``posterior`` are those of the match (`matching.matches`).
"""

WINDOW_COLUMNS = (
    "image", "point_id", "row", "column", "longitude_deg", "latitude_deg",
    "correlation", "contrast", "offset_column_cells", "offset_row_cells",
)  # fmt: skip
"""One row per window: the point of its patch if patches were compared, its first cell on the grid,
its centre, the contrast of the render, and the offset of the image from the render in cells.
"""


def csv_text(images: Iterable[ImageVerdict]) -> str:
    """Table of all points of all images; missing figures are empty cells."""
    return _text(POINT_COLUMNS, (row for image in images for row in point_rows(image)))


def windows_csv_text(images: Iterable[ImageVerdict]) -> str:
    """Table of all windows of all images."""
    return _text(WINDOW_COLUMNS, (row for image in images for row in _window_rows(image)))


def point_rows(image: ImageVerdict) -> list[tuple[Any, ...]]:
    """The points of an image in the order of `POINT_COLUMNS`."""
    matches, points = image.matches, image.points
    claims = image.claims
    sigma, angle = error_ellipses(matches.covariance_px2)
    columns = (
        [image.facts.name] * len(matches),
        points.point_id,
        points.longitude_deg,
        points.latitude_deg,
        *matches.predicted_px.T,
        *matches.found_px.T,
        *sigma.T,
        angle,
        matches.correlation,
        matches.second,
        matches.back_px,
        [REASONS[code] for code in matches.code],
        *image.residual_px.T,
        points.pixel_m,
        claims.probability,
        _bits(claims.usable, claims.claimed),
        *claims.sigma_m.T,
        claims.angle_deg,
        _bits(claims.found, claims.tried),
        *claims.error_m.T,
        matches.prior,
        matches.posterior,
    )
    return list(zip(*columns, strict=True))


def _window_rows(image: ImageVerdict) -> list[tuple[Any, ...]]:
    if image.windows is None:
        return []
    w = image.windows.compared
    unknown = np.full((w.count, 2), np.nan)
    columns = (
        [image.facts.name] * w.count,
        [""] * w.count if image.windows.point_id is None else image.windows.point_id,
        w.row,
        w.col,
        image.windows.longitude_deg,
        image.windows.latitude_deg,
        w.correlation,
        w.contrast,
        *(unknown if w.offset_px is None else w.offset_px).T,
    )
    return list(zip(*columns, strict=True))


def _bits(values: Mask, known: Mask) -> list[int | str]:
    """0 or 1; empty where the value is unknown."""
    return [int(value) if sure else "" for value, sure in zip(values, known, strict=True)]


def _text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\r\n")
    writer.writerow(columns)
    writer.writerows([_cell(value) for value in row] for row in rows)
    return out.getvalue()


def _cell(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return f"{float(value) + 0.0:.{DIGITS}g}" if math.isfinite(value) else ""
    return value
