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
from ..matching.fix import BY_ALL_POINTS, LOCATED
from ..matching.matches import MEANINGS, REASONS
from ..matching.sun_verdict import SunCheck
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
        whole=verdict.scores,
        diagram=reliability_diagram(verdict.scores),
        unclaimed=unclaimed_text(verdict.scores),
        gates=(GATE_SIGMAS, GATE_PX),
        images=[
            _image(image, shown) for image, shown in zip(verdict.images, pictures, strict=True)
        ],
        located=LOCATED,
        full_pose=POSE,
        reasons=REASONS,
        rows_max=ROWS_MAX,
        percent=percent,
        finite=math.isfinite,
        data=json.dumps(stated, indent=1, ensure_ascii=False),
    )


def _image(image: ImageVerdict, shown: Pictures) -> dict[str, Any]:
    """What the page shows of an image besides its own figures."""
    return {
        "of": image,
        "figures": plain(image.figures()),
        "chance": _chance(image),
        "light": _light(image.located.sun),
        "windows": windows_data(image, shown),
        "points": points_data(image, shown),
        "corrections": _corrections(image.pose) if image.pose else [],
        "sigma_px": error_ellipses(image.matches.covariance_px2)[0],
        "residual_px": np.linalg.norm(image.residual_px, axis=-1),
    }


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
    risen = "lowered" if raised_deg < 0.0 else "raised"
    parts = [(f"{turned_deg:+g}", "turned"), (f"{abs(raised_deg):g}", risen)]
    return ", ".join(f"{how} {by}°" for by, how in parts if float(by))


_TICKS = [(k / 5, f"{k / 5:g}") for k in range(6)]
_SIDE = 330.0


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


def _corrections(figures: PoseFigures) -> list[tuple[str, str, str]]:
    """Rows of the table of the corrections."""
    pose = figures.pose
    each = zip(pose.sensor.corrections, pose.correction, pose.sigma, pose.solved, strict=True)
    return [_correction(n, value, sigma, solved) for n, value, sigma, solved in each]


def _correction(name: str, value: float, sigma: float, solved: bool) -> tuple[str, str, str]:
    """Name, correction and 1 sigma of a parameter; a parameter that was not estimated is "fixed"."""
    meaning, unit, factor = _CORRECTIONS[name]
    if not solved:
        return meaning, "–", "fixed"
    return meaning, f"{_signed(value * factor)} {unit}", f"{number(sigma * factor)} {unit}"


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
