"""Output folder of a validation: the report as JSON and as a page, and CSV tables (RFC 4180) of the
points and the windows.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Mask
from ..atomic_files import csv_lines, depfile_rule, write_bytes, write_folder
from ..geometry.ellipses import error_ellipses
from ..matching.matches import REASONS
from .error_fit import FittedErrors
from .report import render
from .result import (
    DIGITS,
    ImageVerdict,
)
from .run import Result

FILES = ("report.json", "report.html", "windows.csv", "points.csv")
"""Files of a report. The first, the target of the make rule, appears last."""


def write_validation(
    result: Result,
    folder: Path,
    overwrite: bool = False,
    depfile: Path | str | None = None,
    errors_file: Path | None = None,
) -> None:
    """Write `FILES` into a folder, which is created if missing. ``depfile``: also the list of input
    files, as a rule for make. ``errors_file``: also the fitted error models (`errors_files`).
    """
    images = result.verdict.images
    texts = (
        result.verdict.to_json(),
        render(result.verdict, result.pictures),
        windows_csv_text(images),
        csv_text(images),
    )
    files = dict(zip(FILES, texts, strict=True))
    if errors_file:
        for path, fitted in errors_files(errors_file, result.fitted):
            files[os.path.abspath(path)] = fitted.to_toml()  # elsewhere: `folder / name`
    write_folder(folder, files, overwrite)
    if depfile:
        rule = depfile_rule(folder / FILES[0], result.sources)
        write_bytes(depfile, rule, overwrite=True)


def errors_files(path: Path, fitted: Sequence[FittedErrors]) -> list[tuple[Path, FittedErrors]]:
    """Files of fitted error models: the first has the given name, one of another kind of images has its kind at the end
    (``errors-line-scanner.toml``).
    """
    kinds = [f"-{one.kind.replace(' ', '-')}" if k else "" for k, one in enumerate(fitted)]
    return [
        (path.with_stem(path.stem + kind), one) for kind, one in zip(kinds, fitted, strict=True)
    ]


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
    return "".join(csv_lines([columns, *(map(_cell, row) for row in rows)]))


def _cell(value: Any) -> Any:
    if isinstance(value, float | np.floating):
        return f"{float(value) + 0.0:.{DIGITS}g}" if math.isfinite(value) else ""
    return value
