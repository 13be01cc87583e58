"""Polar charts of angular distributions over a half circle, as SVG that needs no style sheet.

Angles are measured from the normal, which points up; positive angles are on the left, the side of
the source.
"""

# ruff: noqa: E501 - lines of markup

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from ..arrays import Array
from .numbers import number

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
