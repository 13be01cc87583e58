"""Drawings of matches as inline SVG: marks and arrows over an image.

Colours are CSS classes of `STYLE`, so that drawings follow light and dark; every drawing has a name for those who
cannot see it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..matching.matches import FOUND
from ..plots.svg import nice_step, number

CANVAS = 960.0
"""Width of a drawing over an image, in its own units; less for one that would be higher than `TALLEST` times that."""

TALLEST, NARROWEST = 1.5, 480.0
"""Strips of scanners are drawn no higher than so many `CANVAS`, on a ground no narrower than this: it holds a line of text."""

SYMBOLS = {
    FOUND: ("M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0Z", "found"),
    "out of frame": ("M-5 0H5", "outside"),
    "not lit": ("M0 -5.5L5 4H-5Z", "light"),
    "not seen": ("M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0Z", "light"),
    "low contrast": ("M-4.5 -4.5H4.5V4.5H-4.5Z", "light"),
    "no data": ("M-4.5 -4.5H4.5V4.5H-4.5ZM-4.5 4.5L4.5 -4.5", "outside"),
    "saturated": ("M0 -6L6 0L0 6L-6 0Z", "light"),
    "weak": ("M-4 -4L4 4M-4 4L4 -4", "doubt"),
    "ambiguous": ("M-5 0H5M0 -5V5", "doubt"),
    "not confirmed": ("M-5 4L0 -5L5 4", "doubt"),
    "inconsistent": ("M-5 -5L5 5M-5 5L5 -5", "wrong"),
}
"""Outline and class of every reason: filled is only what was found; yellow: the ground or its light gives nothing; orange: it was
sought in vain; red: found where no camera sees it.
"""

ERROR_CLASSES = ((1.0, "within1"), (2.0, "within2"), (3.0, "within3"), (math.inf, "beyond3"))
"""Residuals over their own sigma, up to which: the class of an arrow."""


@dataclass(frozen=True)
class Frame:
    """An image of ``width`` x ``height`` pixels in a drawing; pixel (0, 0) has its centre half a pixel from the corner."""

    width: float
    height: float

    @property
    def scale(self) -> float:
        """Units of the drawing in a pixel."""
        return CANVAS / max(self.width, self.height / TALLEST)

    def at(self, pixels: ArrayLike) -> Array:
        """Where pixels (..., 2), (column, row), are drawn."""
        return (np.asarray(pixels, dtype=np.float64) + 0.5) * self.scale

    def holds(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Which pixels (..., 2) lie in the image; not NaN."""
        p = np.asarray(pixels, dtype=np.float64) + 0.5
        return np.asarray(((p >= 0.0) & (p <= (self.width, self.height))).all(axis=-1))

    def drawing(self, inside: str, label: str, below: float = 0.0) -> str:
        """A whole SVG around markup, with room below the image."""
        width, height = self.width * self.scale, self.height * self.scale
        wide = max(width, NARROWEST)
        return (
            f'<svg class="over" style="max-width:{wide:.0f}px" viewBox="0 0 {wide:.1f} {height + below:.1f}" role="img" '
            f'aria-label="{escape(label)}">{inside}<rect class="edge" width="{width:.1f}" height="{height:.1f}"/></svg>'
        )

    def picture(self, address: str) -> str:
        """A picture that fills the image's extent."""
        size = f'width="{self.width * self.scale:.1f}" height="{self.height * self.scale:.1f}"'
        return f'<image href="{address}" {size} preserveAspectRatio="none"/>'


@dataclass(frozen=True, eq=False)
class Arrows:
    """n arrows in pixels of a frame, ``by`` (n, 2) from ``start`` (n, 2), each with a class and what the pointer is told."""

    start: Array
    by: Array
    css: Sequence[str]
    titles: Sequence[str]

    @property
    def longest(self) -> float:
        """The 90th percentile of the lengths, pixels; 0 of none."""
        lengths = np.linalg.norm(self.by, axis=-1)
        return float(np.percentile(lengths, 90.0)) if len(lengths) else 0.0


def magnification(frame: Frame, arrows: Arrows, drawn: float = 56.0) -> float:
    """1, 2 or 5 times a power of ten: by how much arrows are drawn longer, so that one in ten is longer than about ``drawn``."""
    if arrows.longest <= 0.0:
        return 1.0
    wanted = drawn / (arrows.longest * frame.scale)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= wanted * (1 + 1e-9))


def arrow_marks(frame: Frame, arrows: Arrows, times: float) -> str:
    """Arrows, so many times their length, with a dot where they start."""
    start = frame.at(arrows.start)
    tips = start + arrows.by * frame.scale * times
    return "".join(
        f'<g class="arrow {css}"><path class="back" d="{_arrow(a, b)}"/><path d="{_arrow(a, b)}"/>'
        f'<circle cx="{a[0]:.1f}" cy="{a[1]:.1f}" r="2.4"/><title>{escape(title)}</title></g>'
        for a, b, css, title in zip(start, tips, arrows.css, arrows.titles, strict=True)
    )


def _arrow(start: Array, tip: Array) -> str:
    """A shaft and, where there is room, a head."""
    shaft = f"M{start[0]:.1f} {start[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}"
    length = float(np.linalg.norm(tip - start))
    if length < 4.0:
        return shaft
    ahead = (tip - start) / length * min(8.0, 0.5 * length)
    aside = 0.5 * np.array([-ahead[1], ahead[0]])
    left, right = tip - ahead + aside, tip - ahead - aside
    return f"{shaft}M{left[0]:.1f} {left[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}L{right[0]:.1f} {right[1]:.1f}"


def scale_arrow(frame: Frame, times: float, arrows: Arrows, unit: str) -> str:
    """Below the image: an arrow of a round length, how long that is, and the magnification."""
    length = nice_step(max(arrows.longest, 1e-6), 1)
    length = length / 2.0 if length * frame.scale * times > 140.0 else length
    y = frame.height * frame.scale + 26.0
    start, tip = np.array([12.0, y]), np.array([12.0 + length * frame.scale * times, y])
    long = "as long as they are" if times == 1.0 else f"{number(times)} times their length"
    text = f"{number(length)} {unit}; arrows {long}"
    return (
        f'<g class="arrow key"><path d="{_arrow(start, tip)}"/></g>'
        f'<text class="note" x="{tip[0] + 14:.1f}" y="{y + 6:.1f}">{escape(text)}</text>'
    )


SCALE_ROOM = 50.0
"""Room below a drawing for `scale_arrow`."""


def error_classes(residual_px: Array, covariance_px2: Array) -> tuple[Array, list[str]]:
    """Residuals (n, 2) over their own sigma (the root of half their squared Mahalanobis distance, which is 1 in the root mean
    square when the covariances (n, 2, 2) are true), and the class of each; NaN counts as beyond all.
    """
    (a, b), (c, d) = np.moveaxis(covariance_px2, 0, -1)
    x, y = np.moveaxis(residual_px, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        over = np.sqrt(0.5 * (d * x * x - (b + c) * x * y + a * y * y) / (a * d - b * c))
    css = [next((c for limit, c in ERROR_CLASSES if v <= limit), "beyond3") for v in over]
    return over, css


def quiver(frame: Frame, arrows: Arrows, label: str, unit: str, under: str = "") -> str:
    """Arrows in an image's frame, over ``under`` (markup) or empty ground."""
    times = magnification(frame, arrows)
    inside = under + arrow_marks(frame, arrows, times) + scale_arrow(frame, times, arrows, unit)
    return frame.drawing(inside, label, SCALE_ROOM)


# -- marks


def reason_mark(reason: str) -> str:
    """A reason's symbol with an outline that keeps it legible on any ground."""
    path, css = SYMBOLS[reason]
    return f'<g class="mark"><path class="back" d="{path}"/><path class="{css}" d="{path}"/></g>'


def reason_marks(frame: Frame, pixels: Array, reasons: Sequence[str], titles: Sequence[str]) -> str:
    """Symbols at pixels (n, 2); what lies outside of the image is left out."""
    inside = frame.holds(pixels)
    return "".join(
        f'<g transform="translate({x:.1f} {y:.1f})">{reason_mark(reason)}<title>{escape(title)}</title></g>'
        for (x, y), reason, title, drawn in zip(
            frame.at(pixels), reasons, titles, inside, strict=True
        )
        if drawn
    )


def reason_key(counts: Iterable[tuple[str, int]], meanings: dict[str, str]) -> str:
    """The symbols that occur, how often, and what they say."""
    entries = "".join(
        f'<li><svg class="key" viewBox="-8 -8 16 16" aria-hidden="true">{reason_mark(reason)}</svg> '
        f"<b>{escape(reason)}</b> {count}: {escape(meanings[reason])}</li>"
        for reason, count in counts
    )
    return f"<ul class='reasons'>{entries}</ul>"


STYLE = """
:root{--good:#0f7b4f;--mid:#b06f00;--bad:#c62320}
@media (prefers-color-scheme:dark){:root{--good:#43c98d;--mid:#efb04a;--bad:#ff6b66}}
@media print{:root{--good:#0f7b4f;--mid:#b06f00;--bad:#c62320}}
.over{width:100%;height:auto;background:var(--void)}.over .edge{fill:none;stroke:var(--line);stroke-width:1.5}
.over .note{font-size:22px}
.mark path{fill:none;stroke-width:1.7;stroke-linejoin:round;stroke-linecap:round}
.mark .back,.arrow .back{stroke:#000;stroke-width:4;stroke-opacity:.6}
.mark .found{fill:#4de08f;stroke:#0b3f25;stroke-width:1}.mark .light{stroke:#ffe25c}.mark .outside{stroke:#d7dbe4}
.mark .doubt{stroke:#ffa04a}.mark .wrong{stroke:#ff5a52}
.arrow path{fill:none;stroke:#ff7d4d;stroke-width:2;stroke-linecap:round}.arrow circle{fill:#fff;stroke:#000;stroke-width:.8}
.bare .arrow .back{stroke:none}.bare .arrow circle{fill:var(--ink);stroke:none}
.bare .arrow path,.arrow.key path{stroke:var(--ink)}.bare .within1 path{stroke:var(--good)}
.bare .within3 path{stroke:var(--mid)}.bare .beyond3 path{stroke:var(--bad)}
.reasons{list-style:none;padding:0;margin:6px 0;display:grid;gap:3px}.reasons li{padding-left:27px;text-indent:-27px}
.reasons .key{display:inline-block;width:20px;height:20px;vertical-align:-5px;margin-right:3px;background:#5a5c61;border-radius:3px}
@media (max-width:520px){.arrow path{stroke-width:3.4}.over .note{font-size:34px}
.over .mark,.arrow circle{transform:scale(1.9);transform-box:fill-box;transform-origin:center}}
"""
