"""Every point and every window of a validation as a table of text (RFC 4180): for spreadsheets and other programs."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ..arrays import Array
from ..matching.matches import REASONS
from .result import DIGITS, ImageVerdict

POINT_COLUMNS = (
    "image", "point_id", "longitude_deg", "latitude_deg",
    "predicted_column_px", "predicted_row_px", "found_column_px", "found_row_px",
    "sigma_major_px", "sigma_minor_px", "major_axis_deg",
    "correlation", "second_correlation", "back_px", "reason",
    "residual_column_px", "residual_row_px", "pixel_m",
)  # fmt: skip
"""One row a point. The major axis is turned from the columns' direction (right) towards the rows' (down), 0..180; residuals are
found minus where the corrected sensor puts the point.
"""

WINDOW_COLUMNS = (
    "image", "point_id", "row", "column", "longitude_deg", "latitude_deg",
    "correlation", "contrast", "offset_column_cells", "offset_row_cells",
)  # fmt: skip
"""One row a window: the patch it lies in where patches were compared, its first cell on the grid, its middle, the render's
contrast, and by how many cells its image lies off its render.
"""


def csv_text(images: Iterable[ImageVerdict]) -> str:
    """All points of all images; empty where there is no figure."""
    return _text(POINT_COLUMNS, (row for image in images for row in point_rows(image)))


def windows_csv_text(images: Iterable[ImageVerdict]) -> str:
    """All windows of all images."""
    return _text(WINDOW_COLUMNS, (row for image in images for row in _window_rows(image)))


def point_rows(image: ImageVerdict) -> list[tuple[Any, ...]]:
    """The points of an image as `POINT_COLUMNS` have them."""
    matches, points = image.matches, image.points
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


def error_ellipses(covariance_px2: Array) -> tuple[Array, Array]:
    """1 sigma along the major and the minor axis (n, 2), and the major axis in degrees from right towards down (n,), 0..180, of
    covariances (n, 2, 2); NaN for NaN.
    """
    known = np.isfinite(covariance_px2).all(axis=(1, 2))
    sigma, angle = np.full((known.size, 2), np.nan), np.full(known.size, np.nan)
    values, vectors = np.linalg.eigh(covariance_px2[known])
    sigma[known] = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    angle[known] = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])) % 180.0
    return sigma, angle


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
