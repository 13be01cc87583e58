"""The validation report: one self-contained HTML page. The template is ``validation.html.j2``. The
drawings are in `report_pictures`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from ..arrays import Array
from ..cameras.sensor import POSE
from ..catalog.summary import percent
from ..geometry.ellipses import error_ellipses
from ..matching.matches import MEANINGS, REASONS
from ..matching.pose import PositionError
from ..matching.position_fix import BY_ALL_POINTS, LOCATED
from ..matching.sun_check import SunCheck
from ..navigation.documents import MEANINGS as WORDS
from ..plots.axes import Axes, Axis
from ..plots.numbers import number, page
from ..plots.pictures import data_uri, grey, shrunk
from . import report_pictures as drawings
from .claims import GATE_PX, GATE_SIGMAS, Bin, Scores
from .report_pictures import MODES, SCALE_ROOM, Arrows, ImageDrawing, windows_data
from .result import ImageVerdict, Pictures, PoseFigures, ValidationResult, plain


def render(verdict: ValidationResult, pictures: Sequence[Pictures]) -> str:
    """The report as HTML; one of ``pictures`` for each image. Equal content gives equal text."""
    names = ", ".join(image.facts.name for image in verdict.images)
    catalog = str(verdict.catalog.get("name", ""))
    document = verdict.document()
    stated = {name: document[name] for name in ("catalog", "options", "software")}
    return page(
        "validation.html.j2",
        title=f"Validation of {catalog}: {names}",
        heading="Validation of a catalogue with images",
        below=f"{catalog}: {names}",
        modes=MODES,
        claims=claims_data(verdict),
        images=[
            _image(image, shown) for image, shown in zip(verdict.images, pictures, strict=True)
        ],
        data=json.dumps(stated, indent=1, ensure_ascii=False),
    )


def _image(image: ImageVerdict, shown: Pictures) -> dict[str, Any]:
    """Everything the page shows of an image."""
    return {
        "name": image.facts.name,
        "opened": image.facts.opened,
        "result": image.verdict,
        "reason": image.reason,
        "overview": _overview_cells(image),
        "tiles": _tiles(image),
        "facts": _facts(image),
        "windows": windows_data(image, shown),
        "points": points_data(image, shown),
        "pose": pose_data(image.pose),
        "table": table_data(image),
    }


def _overview_cells(image: ImageVerdict) -> tuple[str, ...]:
    w = image.windows.compared if image.windows else None
    pose = image.pose
    return (
        f"{int(image.matches.found.sum())} of {len(image.matches)}",
        percent(w.share_above(0.9)) if w and w.count else "–",
        number(pose.pose.position_sigma_m) if pose else "–",
        _maybe(pose.position_error_m) if pose else "–",
    )


def _tiles(image: ImageVerdict) -> list[tuple[str, str]]:
    found: dict[str, Any] = plain(image.figures())
    count = f"{found['points_found']} of {found['points_in_view']}"
    what = (
        "points in view were found"
        if image.pose
        else "points that may be in view match individually"
    )
    shown = [(count, what) if found["points_in_view"] else ("0", "control points are in view")]
    if found["points_found"]:
        px, metres = found["offset_px"]["median"], found["offset_m"]["median"]
        shown.append(
            (f"{_maybe(px)} px", f"median offset from the given camera: {_maybe(metres)} m")
        )
    if image.pose is not None:
        error = image.pose.position_error_m
        known = "" if error is None else f"; error {number(error)} m"
        shown.append(
            (
                f"{number(image.pose.pose.position_sigma_m)} m",
                f"position uncertainty, 1 sigma{known}",
            )
        )
    if image.windows is not None and image.windows.compared.count:
        w = image.windows.compared
        text = f"of {w.count} windows of {w.size} x {w.size} cells correlate above 0.9"
        shown.append((percent(w.share_above(0.9)), text))
    return shown


def _facts(image: ImageVerdict) -> list[tuple[str, str]]:
    f, w = image.facts, image.windows
    sun = f"azimuth {f.sun_azimuth_deg:.1f}°, elevation {f.sun_elevation_deg:.1f}°"
    origin = f" ({f.sun_from})" if f.sun_from else ""
    rows = [
        ("image", f"{f.width_px} x {f.height_px} pixels of {_maybe(f.pixel_m)} m"),
        ("sensor", f.sensor),
        ("Sun", sun + origin if math.isfinite(f.sun_elevation_deg) else ""),
        ("off nadir", f"{f.off_nadir_deg:.1f}°" if math.isfinite(f.off_nadir_deg) else ""),
        ("saturated", percent(f.saturated_share) if f.saturated_share > 0 else ""),
        ("without data", percent(f.missing_share) if f.missing_share > 0 else ""),
        ("chance agreement", _chance(image)),
        ("check of the Sun", _light(image.located.sun)),
        ("encoding", image.encoding.sentence if image.encoding else ""),
        ("rendered DEM", w.against if w else ""),
        ("window cells", f"{number(w.compared.gsd_m, 4)} m: {w.resolution}" if w else ""),
        ("offset", w.offset_sentence if w else ""),
    ]
    return [(name, text) for name, text in rows if text]


def _chance(image: ImageVerdict) -> str:
    """Expected number of chance agreements as good as that of the points, or of the whole terrain."""
    known, rival = image.located.log10_false_alarms, image.located.rival_log10
    whole = image.located.by == BY_ALL_POINTS
    if not (whole or image.matches.found.any()) or not math.isfinite(known):
        return ""
    random = "images of other terrain" if whole else "random matches"
    return f"expected number of equally good agreements of {random}: 10^{known:.0f}; for the second-best position 10^{rival:.0f}"


def _light(check: SunCheck | None) -> str:
    """Median correlation of the points under the stated Sun direction and under others."""
    if check is None:
        return ""
    others = ", ".join(
        f"{number(value)} ({_turn(turned, raised)})"
        for (turned, raised), value in zip(check.turns_deg, check.correlations, strict=True)
    )
    says = "fits" if check.fits else "does not fit"
    if check.law:
        says += f" (rendered with {check.law}, which fits the image better)"
    return (
        f"{says}: median correlation {number(check.correlation)}; with the Sun elsewhere {others}"
    )


def _turn(turned_deg: float, raised_deg: float) -> str:
    parts = [(turned_deg, "turned"), (raised_deg, "raised")]
    return ", ".join(f"{how} {by:+g}°" for by, how in parts if by)


def _maybe(value: float | None) -> str:
    return number(math.nan if value is None else value)


COLUMNS = (
    "",
    "trials",
    "found of usable",
    "found of others",
    "usable of found",
    "Brier score (constant)",
    "calibration error",
    "squared error over claimed",
)
"""Columns of the table of scores: the image, and `_cells`."""

_TICKS = [(k / 5, f"{k / 5:g}") for k in range(6)]
_SIDE = 330.0


def claims_data(verdict: ValidationResult) -> dict[str, Any]:
    """The diagram, its caption, and the table; ``none`` states why nothing was scored."""
    whole = verdict.scores
    data: dict[str, Any] = dict.fromkeys(("none", "diagram", "caption"), None)
    data |= {"columns": COLUMNS, "rows": []}
    if not whole.count:
        return data | {"none": f": {whole.reason}" if whole.reason else ""}
    rows = [(k, image.facts.name, _cells(image.scores)) for k, image in enumerate(verdict.images)]
    together = [(None, "all images", _cells(whole))] if len(rows) > 1 else []
    return data | {
        "diagram": reliability_diagram(whole),
        "caption": _caption(whole),
        "rows": rows + together,
    }


def reliability_diagram(scores: Scores) -> Markup:
    """Observed over predicted share found, one mark per bin with trials, its 95 % interval, and the
    number of trials above it.
    """
    axes = Axes(
        Axis(0.0, 1.0, _TICKS, "claimed detection probability", grid=True),
        Axis(0.0, 1.0, _TICKS, "share found", grid=True),
        width=_SIDE,
        height=_SIDE,
        top=40.0,
    )
    filled = [b for b in scores.reliability if b.count]
    label = "reliability diagram: " + ", ".join(
        f"claimed {b.predicted:.2f}, found {b.observed:.2f} of {b.count}" for b in filled
    )
    inside = axes.line([0.0, 1.0], [0.0, 1.0], "ideal")
    inside += Markup('<text class="name" x="0" y="-24">trials in each bin</text>')
    inside += Markup().join(_mark(axes, b) for b in filled)
    return axes.draw(inside, label, css="square")


def _mark(axes: Axes, b: Bin) -> Markup:
    """A bin: interval, mark and number of trials."""
    x, y = (float(at) for at in axes.at(b.predicted, b.observed))
    low, high = b.interval
    _, ends = axes.at([b.predicted] * 2, [low, high])
    middle = float(axes.at((b.low + b.high) / 2.0, 0.0)[0])
    return Markup(
        '<g class="bin"><title>{:g} to {:g}: {} trials, claimed {:.3f}, found {:.3f} (95 % interval {:.3f} to {:.3f})</title>'
        '<path d="M{:.1f} {:.1f}V{:.1f}"/><circle cx="{:.1f}" cy="{:.1f}" r="4.5"/>'
        '<text class="middle" x="{:.1f}" y="-7">{}</text></g>'
    ).format(
        b.low, b.high, b.count, b.predicted, b.observed, low, high, x, *ends, x, y, middle, b.count
    )


def unclaimed_text(scores: Scores) -> str:
    """How many points have no claim, and why."""
    if not scores.unclaimed:
        return "Every point in view has a claim."
    causes = (f"{WORDS[cause]} {count}" for cause, count in scores.unclaimed_by_cause.items())
    return f"Points in view without a claim, left out: {scores.unclaimed} ({', '.join(causes)})."


def _caption(scores: Scores) -> list[str]:
    """Sentences below the diagram."""
    sentences = [
        f"Trials: {scores.count} searches for points in view, each within the catalogue's search radius. "
        f"{unclaimed_text(scores)}",
        f"Found: a match within {GATE_SIGMAS:g} claimed sigmas, or {GATE_PX:g} pixels, of the place that the corrected "
        "camera predicts.",
        "Vertical bars: 95 % confidence intervals of the share found (Wilson). Broken line: exact agreement. Mean distance "
        f"from it (expected calibration error): {number(scores.expected_calibration_error)}.",
    ]
    if scores.errors:
        sentences.append(
            f"Squared error of the {scores.errors} usable points that were found, over its expectation by the claimed "
            f"covariance: {number(scores.normalised_squared_error)} in the mean, "
            f"{number(scores.normalised_squared_error_median)} by the median. Above 1 the claimed sigmas are too small."
        )
    return sentences


def _cells(scores: Scores) -> tuple[str, ...]:
    """Cells of a row of the table; the reason alone if there is no trial."""
    if not scores.count:
        return (scores.reason or "no trial",)
    error = number(scores.normalised_squared_error)
    return (
        str(scores.count),
        _share(scores.found_of_usable, scores.usable),
        _share(scores.found_of_unusable, scores.count - scores.usable),
        _share(scores.usable_of_found, scores.found),
        f"{number(scores.brier)} ({number(scores.brier_of_the_mean)})",
        number(scores.expected_calibration_error),
        f"{error} of {scores.errors}" if scores.errors else "–",
    )


def _share(share: float, count: int) -> str:
    return f"{percent(share)} of {count}" if math.isfinite(share) else "–"


_ARC_SECONDS = math.degrees(3600.0)
_CORRECTIONS = {
    "x_m": ("position, MCMF x", "m", 1.0),
    "y_m": ("position, MCMF y", "m", 1.0),
    "z_m": ("position, MCMF z", "m", 1.0),
    "turn_x_rad": ("rotation, camera x (right)", "″", _ARC_SECONDS),
    "turn_y_rad": ("rotation, camera y (down)", "″", _ARC_SECONDS),
    "turn_z_rad": ("rotation, line of sight", "″", _ARC_SECONDS),
    "east_m": ("map, east", "m", 1.0),
    "north_m": ("map, north", "m", 1.0),
}
"""Name, unit, and the factor to that unit."""


def pose_data(figures: PoseFigures | None) -> dict[str, Any] | None:
    """Table of the corrections and facts on the position; None without a pose."""
    if figures is None:
        return None
    pose = figures.pose
    each = zip(pose.sensor.corrections, pose.correction, pose.sigma, pose.solved, strict=True)
    axes = " x ".join(number(axis) for axis in figures.position_axes_m)
    facts = [
        ("position, 1 sigma", f"{number(pose.position_sigma_m)} m; along its axes {axes} m"),
        ("position error", _error(figures.error) if pose.sensor.corrections == POSE else ""),
        ("normalised error", f"{number(pose.normalised_error)} (expected: 1)"),
    ]
    return {
        "corrections": [_correction(n, value, sigma, solved) for n, value, sigma, solved in each],
        "facts": [(name, text) for name, text in facts if text],
    }


def _correction(name: str, value: float, sigma: float, solved: bool) -> tuple[str, str, str]:
    """Name, correction and 1 sigma of a parameter; a parameter that was not estimated is "fixed"."""
    meaning, unit, factor = _CORRECTIONS[name]
    if not solved:
        return meaning, "–", "fixed"
    return meaning, f"{_signed(value * factor)} {unit}", f"{number(sigma * factor)} {unit}"


def _error(error: PositionError | None) -> str:
    if error is None:
        return "unknown; if the pose is stated to be known, the camera file’s position is taken as the true one"
    off, sigma = error.error, error.sigma
    return (
        f"{number(off.whole_m)} m from the true position; across the line of sight {number(off.across_m)} m "
        f"(1 sigma {number(sigma.across_m)} m), along it {number(off.along_m)} m ({number(sigma.along_m)} m)"
    )


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + number(value).replace("-", "−")


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
