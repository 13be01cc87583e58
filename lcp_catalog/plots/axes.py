"""Charts as SVG: a plot area with two axes, linear or logarithmic, and what is drawn in it.

The plot area extends from (0, 0) to (``width``, ``height``) in SVG units, x to the right and y
down; ticks and titles lie outside. Colours are the CSS classes of ``templates/page.css``.

Polar charts of angular distributions over a half circle, as SVG that needs no style sheet.

Angles are measured from the normal, which points up; positive angles are on the left, the side of
the source.
"""

# ruff: noqa: E501 - lines of markup
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


STYLES = ("solid", "dashed", "thin", "dotted")
"""Line styles (CSS classes) of the curves; ``dots`` marks measurements."""

_RADIUS = 190.0
_PANEL = (470.0, 300.0)
_STYLE = """
svg{background:#fff;font:13px system-ui,sans-serif;fill:#333}
.grid{fill:none;stroke:#ccc}.axis{fill:none;stroke:#888}.title{font-weight:600;font-size:15px}
.solid{fill:none;stroke:#1f5fbf;stroke-width:2}.dashed{fill:none;stroke:#c05a00;stroke-width:1.6;stroke-dasharray:6 4}
.thin{fill:none;stroke:#2a7f3e;stroke-width:1.6}.dotted{fill:none;stroke:#8a4fb0;stroke-width:1.6;stroke-dasharray:2 3}
.dots{fill:#111}.source{stroke:#d9a400;stroke-width:2;fill:none}
@media(prefers-color-scheme:dark){svg{background:#16181c;fill:#ddd}.grid{stroke:#3a3e45}.axis{stroke:#888}.dots{fill:#eee}
.solid{stroke:#6fa8ff}.dashed{stroke:#f0954a}.thin{stroke:#63c27a}.dotted{stroke:#c79be6}}
"""


@dataclass(frozen=True)
class Curve:
    """Values (n,) at angles theta in degrees (n,): a line of one of `STYLES`, or ``dots``."""

    theta_deg: Array
    values: Array
    style: str
    name: str


@dataclass(frozen=True)
class Panel:
    """One polar plot: its title, its curves, and the angles of the sources to mark, each with a style."""

    title: str
    curves: tuple[Curve, ...]
    sources_deg: tuple[tuple[float, str], ...] = ()


def polar_chart(panels: Sequence[Panel], title: str, columns: int) -> str:
    """SVG of panels in rows; each panel has its own scale."""
    width, height = _PANEL
    rows = math.ceil(len(panels) / columns)
    drawn = "".join(
        f'<g transform="translate({(k % columns) * width:g} {40 + (k // columns) * height:g})">{_draw(panel)}</g>'
        for k, panel in enumerate(panels)
    )
    names, names_width = _legend(panels)
    wide, whole = max(columns * width, names_width + 16.0), 40 + rows * height + 24
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide:g} {whole:g}" width="{wide:g}" '
        f'height="{whole:g}" role="img" aria-label="{escape(title)}"><style>{_STYLE}</style>'
        f'<text class="title" x="16" y="24">{escape(title)}</text>{drawn}'
        f'<g transform="translate(16 {whole - 14:g})">{names}</g></svg>\n'
    )


def _draw(panel: Panel) -> str:
    rim = _round_up(max(float(curve.values.max()) for curve in panel.curves))
    inside = _grid(rim, [angle for angle, _ in panel.sources_deg])
    inside += "".join(_curve(curve, rim) for curve in panel.curves)
    for angle, style in panel.sources_deg:
        (near_x, x), (near_y, y) = _place(np.full(2, angle), np.array([1.02, 1.13]))
        inside += (
            f'<path class="{style}" d="M{x:.1f} {y:.1f}L{near_x:.1f} {near_y:.1f}"/>'
            f'<circle class="{style}" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'
        )
    return f'<text x="16" y="16">{escape(panel.title)}</text><g transform="translate({_PANEL[0] / 2:g} {_PANEL[1] - 42:g})">{inside}</g>'


def _grid(rim: float, sources_deg: Sequence[float]) -> str:
    """Circles of half and full scale, and rays; a ray near a source has no label."""
    parts = [f'<path class="axis" d="M{-_RADIUS:g} 0H{_RADIUS:g}"/>']
    for share in (0.5, 1.0):
        r = share * _RADIUS
        parts.append(f'<path class="grid" d="M{-r:g} 0A{r:g} {r:g} 0 0 1 {r:g} 0"/>')
        parts.append(f'<text x="{r:g}" y="16" text-anchor="middle">{number(share * rim)}</text>')
    for theta in range(-90, 91, 30):
        (x, far_x), (y, far_y) = _place(np.full(2, theta), np.array([1.0, 1.09]))
        parts.append(f'<path class="grid" d="M0 0L{x:.1f} {y:.1f}"/>')
        if abs(theta) < 90 and all(abs(theta - source) > 8.0 for source in sources_deg):
            parts.append(
                f'<text x="{far_x:.1f}" y="{far_y + 4:.1f}" text-anchor="middle">{theta}°</text>'
            )
    return "".join(parts)


def _curve(curve: Curve, rim: float) -> str:
    x, y = _place(curve.theta_deg, curve.values / rim)
    if curve.style == "dots":
        return "".join(
            f'<circle class="dots" cx="{a:.1f}" cy="{b:.1f}" r="2.6"/>'
            for a, b in zip(x, y, strict=True)
        )
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return f'<polyline class="{curve.style}" points="{points}"/>'


def _place(theta_deg: Array, share: Array) -> Array:
    """Pixels (2, n) of angles and shares of the rim's radius; y points down."""
    theta = np.radians(theta_deg)
    return np.array([-np.sin(theta) * share * _RADIUS, -np.cos(theta) * share * _RADIUS])


def _legend(panels: Sequence[Panel]) -> tuple[str, float]:
    """Marks and names of the curves in one line, and its width in pixels."""
    names = {curve.name: curve.style for panel in panels for curve in panel.curves}
    parts, x = [], 0.0
    for name, style in names.items():
        mark = (
            '<circle class="dots" cx="14" cy="-4" r="2.6"/>'
            if style == "dots"
            else f'<path class="{style}" d="M0 -4h28"/>'
        )
        parts.append(
            f'<g transform="translate({x:g} 0)">{mark}<text x="34" y="0">{escape(name)}</text></g>'
        )
        x += 50.0 + 8.0 * len(name)
    return "".join(parts), x


def _round_up(value: float) -> float:
    """Smallest of 1, 1.2, 1.5, 2, 3, 5 or 8 times a power of ten that is not below the value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-9)))
    return next(
        step * power for step in (1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0) if step * power >= value
    )
