"""The claims in the validation report: reliability diagram of all images together, and scores per
image.
"""

from __future__ import annotations

import math
from typing import Any

from markupsafe import Markup

from ..catalog.summary import percent
from ..plots.axes import Axes, Axis
from ..plots.numbers import number
from .claims import GATE_PX, GATE_SIGMAS, Bin, Scores
from .result import ValidationResult

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


def _caption(scores: Scores) -> list[str]:
    """Sentences below the diagram."""
    sentences = [
        f"Trials: {scores.count} searches for points in view, each within the catalogue's search radius. Number of points "
        f"without a claim for the image's Sun, view and scale, left out: {scores.unclaimed}.",
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
