"""Marks and arrows over an image, as SVG: the matches of the validation report.

Colours are CSS classes of ``plots/templates/validation.css``. Every drawing has a label for screen
readers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..matching.matches import FOUND
from ..plots.numbers import nice_step, number, typeset

CANVAS = 960.0
"""Width of a drawing in SVG units; smaller for an image whose drawing would be higher than
`TALLEST` times that.
"""

TALLEST, NARROWEST = 1.5, 480.0
"""Largest height of a drawing in units of `CANVAS`, and its smallest width in SVG units, which
holds a line of text.
"""

LEFT, RIGHT, TOP, BOTTOM = 130.0, 60.0, 16.0, 60.0
"""Margins around the image for the axes, SVG units: five digits in the font of the narrowest page."""

SYMBOLS = {
    FOUND: ("M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0Z", "found"),
    "at the edge": ("M-5 0H5", "outside"),
    "not lit": ("M0 -5.5L5 4H-5Z", "light"),
    "not seen": ("M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0Z", "light"),
    "low contrast": ("M-4.5 -4.5H4.5V4.5H-4.5Z", "light"),
    "no data": ("M-4.5 -4.5H4.5V4.5H-4.5ZM-4.5 4.5L4.5 -4.5", "outside"),
    "saturated": ("M0 -6L6 0L0 6L-6 0Z", "light"),
    "weak": ("M-4 -4L4 4M-4 4L4 -4", "doubt"),
    "no peak": ("M-5 0L0 5L5 0", "doubt"),
    "no exact place": ("M-4 -4L4 4M-4 4L4 -4M-5 0H5", "doubt"),
    "ambiguous": ("M-5 0H5M0 -5V5", "doubt"),
    "not confirmed": ("M-5 4L0 -5L5 4", "doubt"),
    "not searched": ("M-5 -2H5M-5 2H5", "light"),
    "inconsistent": ("M-5 -5L5 5M-5 5L5 -5", "wrong"),
}
"""SVG path and CSS class of every match result. Green and filled: found; yellow: not visible or no
texture; orange: the search failed; red: found at a place that contradicts the other points.
"""

ERROR_CLASSES = ((1.0, "within1"), (2.0, "within2"), (3.0, "within3"), (math.inf, "beyond3"))
"""Upper limits of a residual in units of its sigma, and the CSS class of its arrow."""


@dataclass(frozen=True)
class ImageDrawing:
    """Image of ``width`` x ``height`` pixels in a drawing, with axes from its upper left corner in a
    unit of ``pixel`` units per pixel. The centre of pixel (0, 0) is half a pixel from the corner.
    """

    width: float
    height: float
    pixel: float = 1.0
    unit: str = "px"

    @property
    def scale(self) -> float:
        """SVG units per pixel."""
        return CANVAS / max(self.width, self.height / TALLEST)

    def at(self, pixels: ArrayLike) -> Array:
        """SVG coordinates of pixels (..., 2), (column, row)."""
        return (np.asarray(pixels, dtype=np.float64) + 0.5) * self.scale

    def holds(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """True for pixels (..., 2) inside the image; False for NaN."""
        p = np.asarray(pixels, dtype=np.float64) + 0.5
        return np.asarray(((p >= 0.0) & (p <= (self.width, self.height))).all(axis=-1))

    def drawing(self, inside: str, label: str, below: float = 0.0) -> Markup:
        """The whole SVG around the elements ``inside``: axes, and a space below them."""
        width, height = self.width * self.scale, self.height * self.scale
        wide = max(width, NARROWEST) + LEFT + RIGHT
        high = height + TOP + BOTTOM + below
        return Markup(
            f'<div class="drawing" style="--wide:{wide:.0f}"><svg class="over" style="max-width:{wide:.0f}px" '
            f'viewBox="{-LEFT:g} {-TOP:g} {wide:.1f} {high:.1f}" role="img" aria-label="{escape(label)}">'
            f'<rect class="void" width="{width:.1f}" height="{height:.1f}"/>{inside}'
            f'<rect class="edge" width="{width:.1f}" height="{height:.1f}"/>{self._axes(width, height)}</svg></div>'
        )

    def _axes(self, width: float, height: float) -> Markup:
        """Ticks and their numbers at the left and the lower edge, with the unit once at each: at the
        top and at the right.
        """
        step = nice_step(max(width, height) / self.scale * self.pixel, 6)
        apart = step / self.pixel * self.scale
        parts = []
        for name, length in (("x", width), ("y", height)):
            count = int(length / apart + 1e-9)
            for k in range(count + 1):
                at, text = k * apart, typeset(number(k * step, 6))
                if k == (count if name == "x" else 0):
                    text += f" {self.unit}"
                parts.append(
                    f'<path class="axis" d="M{at:.1f} {height:.1f}v8"/>'
                    f'<text class="middle" x="{at:.1f}" y="{height + 10:.1f}" dy=".9em">{text}</text>'
                    if name == "x"
                    else f'<path class="axis" d="M0 {at:.1f}h-8"/>'
                    f'<text class="end" x="-12" y="{at:.1f}" dy=".35em">{text}</text>'
                )
        return Markup().join(Markup(part) for part in parts)

    def picture(self, address: str) -> Markup:
        """The image element with the frame's extent."""
        size = f'width="{self.width * self.scale:.1f}" height="{self.height * self.scale:.1f}"'
        return Markup(f'<image href="{address}" {size} preserveAspectRatio="none"/>')


@dataclass(frozen=True, eq=False)
class Arrows:
    """n arrows in pixels of a frame: vectors ``by`` (n, 2) from ``start`` (n, 2), CSS classes and
    tooltips.
    """

    start: Array
    by: Array
    css: Sequence[str]
    titles: Sequence[str]

    @property
    def longest(self) -> float:
        """90th percentile of the lengths, pixels; 0 without arrows."""
        lengths = np.linalg.norm(self.by, axis=-1)
        return float(np.percentile(lengths, 90.0)) if len(lengths) else 0.0


def magnification(frame: ImageDrawing, arrows: Arrows, drawn: float = 56.0) -> float:
    """Magnification of arrows, 1, 2 or 5 times a power of ten: one arrow in ten is longer than
    about ``drawn`` SVG units.
    """
    if arrows.longest <= 0.0:
        return 1.0
    wanted = drawn / (arrows.longest * frame.scale)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= wanted * (1 + 1e-9))


def arrow_marks(frame: ImageDrawing, arrows: Arrows, times: float) -> Markup:
    """Arrows magnified ``times``, with a dot at their start."""
    start = frame.at(arrows.start)
    tips = start + arrows.by * frame.scale * times
    return Markup("").join(
        Markup(
            f'<g class="arrow {css}"><path class="back" d="{_arrow(a, b)}"/><path d="{_arrow(a, b)}"/>'
            f'<circle cx="{a[0]:.1f}" cy="{a[1]:.1f}" r="2.4"/><title>{escape(title)}</title></g>'
        )
        for a, b, css, title in zip(start, tips, arrows.css, arrows.titles, strict=True)
    )


def _arrow(start: Array, tip: Array) -> str:
    """Path of a shaft and, if long enough, of a head."""
    shaft = f"M{start[0]:.1f} {start[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}"
    length = float(np.linalg.norm(tip - start))
    if length < 4.0:
        return shaft
    ahead = (tip - start) / length * min(8.0, 0.5 * length)
    aside = 0.5 * np.array([-ahead[1], ahead[0]])
    left, right = tip - ahead + aside, tip - ahead - aside
    return f"{shaft}M{left[0]:.1f} {left[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}L{right[0]:.1f} {right[1]:.1f}"


def scale_arrow(frame: ImageDrawing, times: float, arrows: Arrows, unit: str) -> Markup:
    """Scale below the image: an arrow of a round length, its length and the magnification."""
    length = nice_step(max(arrows.longest, 1e-6), 1)
    length = length / 2.0 if length * frame.scale * times > 140.0 else length
    y = frame.height * frame.scale + BOTTOM + 26.0
    start, tip = np.array([12.0, y]), np.array([12.0 + length * frame.scale * times, y])
    long = "to scale" if times == 1.0 else f"magnified {number(times)} times"
    text = f"{number(length)} {unit}; arrows {long}"
    return Markup(
        f'<g class="arrow key"><path d="{_arrow(start, tip)}"/></g>'
        f'<text x="{tip[0] + 14:.1f}" y="{y:.1f}" dy=".35em">{escape(text)}</text>'
    )


SCALE_ROOM = 50.0
"""Height of the space below a drawing for `scale_arrow`, SVG units."""


def error_classes(residual_px: Array, covariance_px2: Array) -> tuple[Array, list[str]]:
    """Residuals (n, 2) in units of their sigma, and their CSS classes; NaN is in the last class.

    The measure is the root of half the squared Mahalanobis distance: its root mean square is 1 if
    the covariances (n, 2, 2) are true.
    """
    (a, b), (c, d) = np.moveaxis(covariance_px2, 0, -1)
    x, y = np.moveaxis(residual_px, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        over = np.sqrt(0.5 * (d * x * x - (b + c) * x * y + a * y * y) / (a * d - b * c))
    css = [next((c for limit, c in ERROR_CLASSES if v <= limit), "beyond3") for v in over]
    return over, css


def quiver(frame: ImageDrawing, arrows: Arrows, label: str, unit: str, picture: str = "") -> Markup:
    """Magnified arrows over an image with their scale."""
    times = magnification(frame, arrows)
    inside = (
        Markup(picture)
        + arrow_marks(frame, arrows, times)
        + scale_arrow(frame, times, arrows, unit)
    )
    return frame.drawing(inside, label, SCALE_ROOM)


# -- marks


def reason_mark(reason: str) -> Markup:
    """Symbol of a match result, on top of a dark outline, legible on any background."""
    path, css = SYMBOLS[reason]
    return Markup(
        f'<g class="mark"><path class="back" d="{path}"/><path class="{css}" d="{path}"/></g>'
    )


def reason_marks(
    frame: ImageDrawing, pixels: Array, reasons: Sequence[str], titles: Sequence[str]
) -> Markup:
    """Symbols at pixels (n, 2), without those outside the image."""
    inside = frame.holds(pixels)
    return Markup("").join(
        Markup(
            f'<g transform="translate({x:.1f} {y:.1f})">{reason_mark(reason)}<title>{escape(title)}</title></g>'
        )
        for (x, y), reason, title, drawn in zip(
            frame.at(pixels), reasons, titles, inside, strict=True
        )
        if drawn
    )


def reason_key(counts: Iterable[tuple[str, int]], meanings: dict[str, str]) -> list[dict[str, Any]]:
    """Legend of the match results that occur: symbol, name, count and meaning."""
    return [
        {
            "symbol": Markup(
                f'<svg class="key" viewBox="-8 -8 16 16" aria-hidden="true">{reason_mark(reason)}</svg>'
            ),
            "name": reason,
            "count": count,
            "meaning": meanings[reason],
        }
        for reason, count in counts
    ]
