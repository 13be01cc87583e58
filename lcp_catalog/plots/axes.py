"""Charts as SVG: a plot area with two axes, linear or logarithmic, and what is drawn in it.

The plot area extends from (0, 0) to (``width``, ``height``) in SVG units, x to the right and y
down; ticks and titles lie outside. Colours are the CSS classes of ``templates/page.css``.

Polar charts of angular distributions over a half circle, as SVG that needs no style sheet.

Angles are measured from the normal, which points up; positive angles are on the left, the side of
the source.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from ..arrays import Array
from .numbers import drawing, nice_step, number, typeset


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
        x_ticks = [(self.width * float(self.x.share(v)), text) for v, text in self.x.ticks]
        y_ticks = [(self.height * (1.0 - float(self.y.share(v))), t) for v, t in self.y.ticks]
        return drawing("chart", self, x_ticks, y_ticks, inside, label, style, css)


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
    """Values (n,) at angles theta in degrees (n,): a line, solid, dashed, thin or dotted, or the ``dots`` of
    measurements (CSS classes).
    """

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

    def is_free(self, theta_deg: float) -> bool:
        """True for an angle that is near no source: its ray has a label. Called by the template."""
        return all(abs(theta_deg - source) > 8.0 for source, _ in self.sources_deg)


def polar_chart(panels: Sequence[Panel], title: str, columns: int) -> str:
    """SVG of panels in rows; each panel has its own scale."""
    width, height = _PANEL
    names = {curve.name: curve.style for panel in panels for curve in panel.curves}
    starts = [0.0, *accumulate(50.0 + 8.0 * len(name) for name in names)]
    placed = []
    for k, panel in enumerate(panels):
        rim = _round_up(max(float(curve.values.max()) for curve in panel.curves))
        curves = [
            (curve.style, _place(curve.theta_deg, curve.values / rim).T) for curve in panel.curves
        ]
        placed.append((k % columns * width, 40 + k // columns * height, panel, rim, curves))
    return (
        drawing(
            "polar",
            title,
            _STYLE,
            max(columns * width, starts[-1] + 16.0),
            40 + math.ceil(len(panels) / columns) * height + 24,
            (width / 2, height - 42),
            _RADIUS,
            placed,
            [(left, *named) for left, named in zip(starts, names.items(), strict=False)],
            _place,
        )
        + "\n"
    )


def _place(theta_deg: ArrayLike, share: ArrayLike) -> Array:
    """Pixels (2, n) of angles and shares of the rim's radius; y points down."""
    theta = np.radians(theta_deg)
    return np.array([-np.sin(theta) * share * _RADIUS, -np.cos(theta) * share * _RADIUS])


def _round_up(value: float) -> float:
    """Smallest of 1, 1.2, 1.5, 2, 3, 5 or 8 times a power of ten that is not below the value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-9)))
    return next(
        step * power for step in (1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0) if step * power >= value
    )
