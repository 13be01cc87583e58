"""The part of a validation's page that shows the control points: marks over the image, residuals, the table."""

from __future__ import annotations

import math
from html import escape

import numpy as np

from ..arrays import Array
from ..matching.matches import FOUND, REASONS
from ..plots.greyscale import Pictures, grey, shrunk
from ..plots.svg import data_uri, number
from . import report_marks
from .report_marks import SCALE_ROOM, Arrows, Frame
from .result import LOCATED, ImageVerdict
from .tables import error_ellipses

ROWS_MAX = 1500
"""Points that the page's table shows; the CSV beside it has all."""

MEANINGS = {
    FOUND: "where it was found",
    "out of frame": "its search area does not lie in the image",
    "not lit": "the Sun is below its horizon, or too little of the patch is lit",
    "not seen": "the camera sees it edge-on, from behind, or not at all",
    "low contrast": "its render has too little texture to be placed",
    "no data": "the image has too little there that is neither missing nor saturated",
    "saturated": "the image is saturated there",
    "weak": "the highest correlation is too low",
    "ambiguous": "another place correlates about as well",
    "not confirmed": "searched for backwards it is somewhere else",
    "inconsistent": "no camera that agrees with the others sees it there",
}
"""What each of `REASONS` says."""


def points_section(image: ImageVerdict, shown: Pictures) -> str:
    """Marks over the image, and what each says."""
    title = "<h3 class='part'>Points in the image</h3>"
    if not len(image.matches):
        return f"{title}<p class='none'>No control point is in view.</p>"
    frame, arrows = _frame(image), _arrows(image)
    times = report_marks.magnification(frame, arrows)
    under = _photo_picture(frame, shown)
    marks = report_marks.reason_marks(frame, _places(image), _reasons(image), _titles(image))
    over = report_marks.arrow_marks(frame, arrows, times)
    key = report_marks.scale_arrow(frame, times, arrows, "px") if len(arrows.by) else ""
    drawn = frame.drawing(
        under + marks + over + key,
        f"control points in {image.facts.name}",
        SCALE_ROOM if key else 0,
    )
    counts = report_marks.reason_key(image.matches.counts().items(), MEANINGS)
    return (
        f"{title}<figure class='drawn'>{drawn}"
        f"<figcaption>{_arrow_sentence(image)}{counts}</figcaption></figure>"
    )


def _frame(image: ImageVerdict) -> Frame:
    return Frame(max(image.facts.width_px, 1), max(image.facts.height_px, 1))


def _photo_picture(frame: Frame, shown: Pictures) -> str:
    """The image below the marks; blocks that were not whole are missing at its right and lower edge."""
    if shown.photo is None:
        return ""
    rows, cols = (n * shown.photo_factor for n in shown.photo.shape)
    address = data_uri(grey(shrunk(shown.photo)))
    return (
        f'<image href="{address}" width="{cols * frame.scale:.1f}" height="{rows * frame.scale:.1f}" '
        'preserveAspectRatio="none"/>'
    )


def _reasons(image: ImageVerdict) -> list[str]:
    return [REASONS[code] for code in image.matches.code]


def _places(image: ImageVerdict) -> Array:
    """Where the corrected sensor has each point, else the given one; (n, 2)."""
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
    """Residuals of what was found; without a pose, offsets from where the given sensor puts it."""
    found = np.flatnonzero(image.matches.found)
    located = image.verdict == LOCATED
    by = (image.residual_px if located else image.matches.offset_px)[found]
    start = image.matches.found_px[found] - by
    over, css = report_marks.error_classes(by, image.matches.covariance_px2[found])
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
    return f"<p>Arrows lead from where {start} puts a point to where it was found.</p>"


def residuals_section(image: ImageVerdict) -> str:
    """The residuals by themselves, coloured by how many sigma they are; nothing without a pose."""
    arrows = _arrows(image)
    if image.verdict != LOCATED or not len(arrows.by):
        return ""
    drawn = report_marks.quiver(
        _frame(image), arrows, f"residuals of the points in {image.facts.name}", "px"
    )
    counts = {css: arrows.css.count(css) for _, css in report_marks.ERROR_CLASSES}
    legend = "".join(
        f"<li><b class='{css}'>{name}</b> {counts[css]}</li>"
        for (_, css), name in zip(
            report_marks.ERROR_CLASSES,
            ("within 1 sigma", "1 to 2", "2 to 3", "beyond 3"),
            strict=True,
        )
    )
    median = np.median(arrows.by, axis=0)
    text = (
        f"Residuals after the pose, by their own sigma (of true ones 63 %, 35 %, 2 % and 0.01 % are expected). "
        f"Median {median[0]:+.3f} px right, {median[1]:+.3f} px down."
    )
    return f"<figure class='bare'>{drawn}<figcaption>{text}<ul class='classes'>{legend}</ul></figcaption></figure>"


# -- the table


_COLUMNS = (
    ("id", "the catalogue’s point"),
    ("lon, °E", "longitude"),
    ("lat, °N", "latitude"),
    ("expected, px", "column, row where the given camera puts it"),
    ("found, px", "column, row"),
    ("residual, px", "length, after the pose"),
    ("sigma, px", "1 sigma, major and minor axis"),
    ("corr.", "correlation at the peak"),
    ("2nd", "highest correlation elsewhere in the search area"),
    ("back, px", "how far off the backward search ended"),
    ("says", "found, or why not"),
)


def table_section(image: ImageVerdict) -> str:
    if not len(image.matches):
        return ""
    head = "".join(
        f"<th scope='col'><button type='button' title='{escape(meaning)}'>{name}</button></th>"
        for name, meaning in _COLUMNS
    )
    lines = "".join(
        f"<tr class='{'is-found' if found else 'not-found'}'>"
        + "".join(f"<td>{escape(text)}</td>" for text in cells)
        + "</tr>"
        for found, cells in zip(image.matches.found[:ROWS_MAX], _rows(image), strict=True)
    )
    n = len(image.matches)
    more = f" The first {ROWS_MAX} are here, all in the CSV." if n > ROWS_MAX else ""
    return (
        f"<details open><summary>Table of the {n} points in view.{more}</summary><div class='wide tall'>"
        f"<table class='sortable'><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table></div></details>"
    )


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
