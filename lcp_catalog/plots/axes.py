"""Charts as SVG: a plot area with two axes, linear or logarithmic, and what is drawn in it.

The plot area extends from (0, 0) to (``width``, ``height``) in SVG units, x to the right and y
down; ticks and titles lie outside. Colours are the CSS classes of ``templates/page.css``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike

from ..arrays import Array
from .numbers import nice_step, number, typeset


@dataclass(frozen=True)
class Axis:
    """One axis from ``low`` to ``high``, which may be smaller than ``low``.

    ``ticks`` are pairs of value and label. With ``grid`` they are lines across the plot area,
    else short marks.
    """

    low: float
    high: float
    ticks: Sequence[tuple[float, str]] = ()
    title: str = ""
    log: bool = False
    grid: bool = False

    def share(self, values: ArrayLike) -> Array:
        """Position of values along the axis: 0 at ``low``, 1 at ``high``."""
        scale: Callable[[ArrayLike], Array] = np.log10 if self.log else np.asarray
        low, high = scale(self.low), scale(self.high)
        return np.asarray((scale(values) - low) / (high - low))


def round_ticks(low: float, high: float, parts: int) -> list[tuple[float, str]]:
    """Ticks at multiples of a round step within [low, high]: at most about ``parts`` + 1."""
    step = nice_step(abs(high - low), parts)
    first, last = (k / step for k in sorted((low, high)))
    values = [k * step for k in range(math.ceil(first - 1e-9), math.floor(last + 1e-9) + 1)]
    return [(value, typeset(number(value))) for value in values]


@dataclass(frozen=True)
class Axes:
    """A plot area with an x axis below it and a y axis on its left. Margins hold ticks and titles."""

    x: Axis
    y: Axis
    width: float = 420.0
    height: float = 220.0
    left: float = 56.0
    right: float = 12.0
    top: float = 30.0
    bottom: float = 48.0

    def at(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """SVG coordinates of values."""
        return self.width * self.x.share(x), self.height * (1.0 - self.y.share(y))

    def bars(
        self, bars: Iterable[tuple[float, float, float, str, str]], gap: float = 0.4
    ) -> Markup:
        """Bars from y = ``y.low`` up. A bar is (from x, to x, y, CSS class, text of the tooltip)."""
        parts = []
        for start, end, value, css, text in bars:
            (left, right), (top, base) = self.at([start, end], [value, self.y.low])
            parts.append(
                Markup(
                    '<rect class="{}" x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}"><title>{}</title></rect>'
                ).format(css, left + gap, top, right - left - 2 * gap, base - top, text)
            )
        return Markup().join(parts)

    def line(self, x: ArrayLike, y: ArrayLike, css: str) -> Markup:
        """A line through points (n,), (n,)."""
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(*self.at(x, y), strict=True))
        return Markup('<polyline class="{}" points="{}"/>').format(css, points)

    def draw(self, inside: Markup, label: str, style: str = "", css: str = "") -> Markup:
        """The whole chart: grid, ``inside`` (elements of the plot area), axes.

        ``label`` describes it to screen readers. ``style``: rules for a file of its own, without a
        page.
        """
        width, height = (
            self.left + self.width + self.right,
            self.top + self.height + self.bottom,
        )
        box = f"{-self.left:g} {-self.top:g} {width:g} {height:g}"
        own = ' xmlns="http://www.w3.org/2000/svg"' if style else ""
        return Markup(
            f'<svg{own} class="chart{" " * bool(css)}{css}" viewBox="{box}" role="img" aria-label="{escape(label)}">'
            f"{f'<style>{style}</style>' * bool(style)}{self._y_ticks()}{self._x_ticks()}{inside}"
            f'<path class="axis" d="M0 0V{self.height:g}H{self.width:g}"/>{self._titles()}</svg>'
        )

    def _x_ticks(self) -> Markup:
        height = f"{self.height:g}"
        mark = f"0V{height}" if self.x.grid else f"{height}v5"
        css = "grid" if self.x.grid else "axis"
        return Markup().join(
            Markup(
                f'<path class="{css}" d="M{x:.1f} {mark}"/>'
                f'<text class="middle" x="{x:.1f}" y="{self.height + 19:g}">{escape(text)}</text>'
            )
            for x, text in self._placed(self.x, self.width)
        )

    def _y_ticks(self) -> Markup:
        parts = []
        for share, text in self._placed(self.y, 1.0):
            y = self.height * (1.0 - share)
            line = f"M0 {y:.1f}H{self.width:g}" if self.y.grid else f"M0 {y:.1f}h-5"
            css = "grid" if self.y.grid else "axis"
            parts.append(
                Markup(
                    f'<path class="{css}" d="{line}"/>'
                    f'<text class="end" x="-7" y="{y + 4:.1f}">{escape(text)}</text>'
                )
            )
        return Markup().join(parts)

    @staticmethod
    def _placed(axis: Axis, length: float) -> list[tuple[float, str]]:
        return [(length * float(axis.share(value)), text) for value, text in axis.ticks]

    def _titles(self) -> Markup:
        parts = []
        if self.x.title:
            parts.append(
                Markup('<text class="middle" x="{:g}" y="{:g}">{}</text>').format(
                    self.width / 2, self.height + 39, self.x.title
                )
            )
        if self.y.title:
            parts.append(
                Markup(
                    '<text class="middle" transform="translate({:g} {:g}) rotate(-90)">{}</text>'
                ).format(14.0 - self.left, self.height / 2, self.y.title)
            )
        return Markup().join(parts)
