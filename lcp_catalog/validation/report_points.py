"""The control points in the validation report: marks over the image, residuals, and the table."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from markupsafe import Markup

from ..arrays import Array
from ..geometry.ellipses import error_ellipses
from ..matching.matches import MEANINGS, REASONS
from ..matching.position_fix import LOCATED
from ..plots.numbers import number
from ..plots.pictures import data_uri, grey, shrunk
from . import report_pictures as drawings
from .report_pictures import SCALE_ROOM, Arrows, ImageDrawing
from .result import ImageVerdict, Pictures

ROWS_MAX = 1500
"""Most points in the page's table; the CSV file has all."""


def points_data(image: ImageVerdict, shown: Pictures) -> dict[str, Any] | None:
    """Drawing of the marks over the image, with its legend; None without points in view."""
    if not len(image.matches):
        return None
    frame, arrows = _frame(image), _arrows(image)
    times = drawings.magnification(frame, arrows)
    has_arrows = len(arrows.by) > 0
    marks = drawings.reason_marks(frame, _places(image), _reasons(image), _titles(image))
    inside = _image_picture(frame, shown) + marks
    inside += drawings.arrow_marks(frame, arrows, times)
    if has_arrows:
        inside += drawings.scale_arrow(frame, times, arrows, "px")
    label = f"control points in {image.facts.name}"
    return {
        "drawing": frame.drawing(inside, label, SCALE_ROOM if has_arrows else 0),
        "text": _arrow_sentence(image),
        "residuals": _residuals(image, arrows),
        "legend": drawings.reason_key(image.matches.counts().items(), MEANINGS),
    }


def _frame(image: ImageVerdict) -> ImageDrawing:
    return ImageDrawing(max(image.facts.width_px, 1), max(image.facts.height_px, 1))


def _image_picture(frame: ImageDrawing, shown: Pictures) -> Markup:
    """The image below the marks. Incomplete blocks are missing at its right and lower edge."""
    if shown.image is None:
        return Markup("")
    rows, cols = (n * shown.image_factor for n in shown.image.shape)
    address = data_uri(grey(shrunk(shown.image)))
    return Markup(
        f'<image href="{address}" width="{cols * frame.scale:.1f}" height="{rows * frame.scale:.1f}" '
        'preserveAspectRatio="none"/>'
    )


def _reasons(image: ImageVerdict) -> list[str]:
    return [REASONS[code] for code in image.matches.code]


def _places(image: ImageVerdict) -> Array:
    """Pixels (n, 2) of the points in the corrected sensor, or in the given one without a
    correction.
    """
    corrected = image.points.corrected_px
    return np.where(np.isfinite(corrected), corrected, image.matches.predicted_px)


def _titles(image: ImageVerdict) -> list[str]:
    return [
        f"{identifier}: {reason}" + (f", correlation {value:.3f}" if math.isfinite(value) else "")
        for identifier, reason, value in zip(
            image.points.point_id, _reasons(image), image.matches.correlation, strict=True
        )
    ]


def _arrows(image: ImageVerdict) -> Arrows:
    """Residuals of the points found; without a pose, their offsets from the given sensor's
    prediction.
    """
    found = np.flatnonzero(image.matches.found)
    located = image.verdict == LOCATED
    by = (image.residual_px if located else image.matches.offset_px)[found]
    start = image.matches.found_px[found] - by
    over, css = drawings.error_classes(by, image.matches.covariance_px2[found])
    titles = [
        f"{identifier}: {number(dx)} px right, {number(dy)} down"
        + (f", {number(times)} sigma" if located else "")
        for identifier, (dx, dy), times in zip(image.points.point_id[found], by, over, strict=True)
    ]
    return Arrows(start, by, css if located else [""] * len(found), titles)


def _arrow_sentence(image: ImageVerdict) -> str:
    if not image.matches.found.any():
        return ""
    start = "the corrected camera" if image.verdict == LOCATED else "the given camera"
    return f"Arrows lead from the position predicted by {start} to the position found."


def _residuals(image: ImageVerdict, arrows: Arrows) -> dict[str, Any] | None:
    """Numbers of residuals by their size in sigma, which colours the arrows; None without a pose."""
    if image.verdict != LOCATED or not len(arrows.by):
        return None
    names = ("within 1 sigma", "1 to 2", "2 to 3", "beyond 3")
    median = np.median(arrows.by, axis=0)
    return {
        "text": (
            "Residuals after the pose estimate, in units of their sigma (expected shares: 63 %, 35 %, 2 % and 0.01 %). "
            f"Median {median[0]:+.3f} px right, {median[1]:+.3f} px down."
        ),
        "classes": [
            (css, name, arrows.css.count(css))
            for (_, css), name in zip(drawings.ERROR_CLASSES, names, strict=True)
        ],
    }


# -- the table


_COLUMNS = (
    ("id", "identifier in the catalogue"),
    ("lon, °E", "longitude"),
    ("lat, °N", "latitude"),
    ("expected, px", "column, row from the given camera"),
    ("found, px", "column, row"),
    ("residual, px", "length, after the pose estimate"),
    ("sigma, px", "1 sigma, major and minor axis"),
    ("corr.", "correlation at the peak"),
    ("2nd", "highest correlation elsewhere in the search area"),
    ("back, px", "closing error of the backward search"),
    ("claimed", "detection probability by the catalogue, without claim: –"),
    ("result", "found, or the reason why not"),
)


def table_data(image: ImageVerdict) -> dict[str, Any] | None:
    """Table of the points in view; None without any."""
    n = len(image.matches)
    if not n:
        return None
    more = f" The first {ROWS_MAX} are shown; the CSV file has all." if n > ROWS_MAX else ""
    return {
        "summary": f"Table of the {n} points {'' if image.pose else 'that may be '}in view.{more}",
        "columns": _COLUMNS,
        "rows": list(zip(image.matches.found[:ROWS_MAX], _rows(image), strict=True)),
    }


def _rows(image: ImageVerdict) -> list[tuple[str, ...]]:
    matches, points = image.matches, image.points
    sigma, _ = error_ellipses(matches.covariance_px2)
    residual = np.linalg.norm(image.residual_px, axis=-1)
    return [
        (
            str(points.point_id[i]),
            f"{points.longitude_deg[i]:.4f}",
            f"{points.latitude_deg[i]:.4f}",
            _pair(matches.predicted_px[i], ", ", ".1f"),
            _pair(matches.found_px[i], ", ", ".2f"),
            _fixed(residual[i], ".3f"),
            _pair(sigma[i], " x ", ".3f"),
            _fixed(matches.correlation[i], ".3f"),
            _fixed(matches.second[i], ".3f"),
            _fixed(matches.back_px[i], ".2f"),
            _fixed(image.claims.probability[i], ".2f"),
            REASONS[matches.code[i]],
        )
        for i in range(min(len(matches), ROWS_MAX))
    ]


def _fixed(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else "–"


def _pair(values: Array, between: str, form: str) -> str:
    if not np.isfinite(values).all():
        return "–"
    return between.join(format(value, form) for value in values)
