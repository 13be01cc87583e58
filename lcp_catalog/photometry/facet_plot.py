"""Polar plots of a facet model in the plane of incidence, as the paper's figures 4 to 7 have them: SVG that stands by itself.

The light comes from the upper left, so that the specular direction is on the right; angles are the paper's theta, positive on
the source's side.
"""

# ruff: noqa: E501 - lines of markup

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from ..arrays import Array
from ..plots.svg import number
from .facet_fit import Fit
from .facet_model import FacetModel, Node, constants, lobes, shadowing_share
from .goniometer import Measurements

_RADIUS = 190.0
_PANEL = (470.0, 300.0)
_STYLE = """
svg{background:#fff;font:13px system-ui,sans-serif;fill:#333}
.grid{fill:none;stroke:#ccc}.axis{fill:none;stroke:#888}.title{font-weight:600;font-size:15px}
.model{fill:none;stroke:#1f5fbf;stroke-width:2}.diffuse{fill:none;stroke:#c05a00;stroke-width:1.6;stroke-dasharray:6 4}
.directional{fill:none;stroke:#2a7f3e;stroke-width:1.6}.other{fill:none;stroke:#8a4fb0;stroke-width:1.6;stroke-dasharray:2 3}
.data{fill:#111}.light{stroke:#d9a400;stroke-width:2;fill:none}
@media(prefers-color-scheme:dark){svg{background:#16181c;fill:#ddd}.grid{stroke:#3a3e45}.axis{stroke:#888}.data{fill:#eee}
.model{stroke:#6fa8ff}.diffuse{stroke:#f0954a}.directional{stroke:#63c27a}.other{stroke:#c79be6}}
"""


@dataclass(frozen=True)
class Curve:
    """Values (n,) over angles theta in degrees (n,): a line of a class of the style, or dots (``data``)."""

    theta_deg: Array
    values: Array
    css: str
    name: str


@dataclass(frozen=True)
class Panel:
    """One polar plot: curves, a title, the incidence whose light is drawn."""

    title: str
    curves: tuple[Curve, ...]
    incidence_deg: float | None = None


def fit_chart(fit: Fit, measurements: Measurements) -> str:
    """Measurements in the plane of incidence, the model and its two lobes: relative intensities, one panel an incidence (the
    paper's figure 6).
    """
    panels = []
    for sample, node in zip(measurements.samples, fit.model.nodes, strict=True):
        taken = sample.scaled() if fit.normalized else sample
        emission, values = taken.level_values()
        dots = Curve(emission, values, "data", "measured")
        title = f"incidence {node.incidence_deg:g}°"
        panels.append(Panel(title, (dots, *_lobes(fit.model, node)), node.incidence_deg))
    return polar_chart(panels, f"{measurements.name}: relative intensity", 2)


def intensity_chart(model: FacetModel, incidences_deg: Sequence[float]) -> str:
    """I_rel of a model and its lobes at some incidences (figure 6)."""
    panels = [_panel(model, angle, over_cosine=False) for angle in incidences_deg]
    return polar_chart(panels, f"{model.name}: relative intensity", 2)


def brightness_chart(model: FacetModel, incidences_deg: Sequence[float]) -> str:
    """The brightness coefficient, to 80 deg (figures 4 and 5)."""
    panels = [_panel(model, angle, over_cosine=True) for angle in incidences_deg]
    return polar_chart(panels, f"{model.name}: brightness coefficient", 2)


def shadowing_chart(model: FacetModel, incidences_deg: Sequence[float]) -> str:
    """P(psi, theta, 0), the share of facets that are lit and seen, without a shift (figure 7)."""
    theta = np.linspace(-89.9, 89.9, 360)
    styles = ("model", "diffuse", "directional", "other")
    curves = tuple(
        Curve(
            theta, shadowing_share(model.shadowing, angle, theta), styles[k % 4], f"ψ = {angle:g}°"
        )
        for k, angle in enumerate(incidences_deg)
    )
    return polar_chart([Panel("lit and seen", curves)], f"{model.name}: shadowing and masking", 1)


def polar_chart(panels: Sequence[Panel], title: str, columns: int) -> str:
    """Panels in rows, each with its own scale."""
    width, height = _PANEL
    rows = math.ceil(len(panels) / columns)
    drawn = "".join(
        f'<g transform="translate({(k % columns) * width:g} {40 + (k // columns) * height:g})">{_draw(panel)}</g>'
        for k, panel in enumerate(panels)
    )
    names = _legend(panels)
    whole = 40 + rows * height + 24
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {columns * width:g} {whole:g}" width="{columns * width:g}" '
        f'height="{whole:g}" role="img" aria-label="{escape(title)}"><style>{_STYLE}</style>'
        f'<text class="title" x="16" y="24">{escape(title)}</text>{drawn}'
        f'<g transform="translate(16 {whole - 14:g})">{names}</g></svg>\n'
    )


def _panel(model: FacetModel, incidence_deg: float, over_cosine: bool) -> Panel:
    curves = _lobes(model, model.parameters(incidence_deg))
    if over_cosine:
        curves = tuple(_brightness(curve) for curve in curves)
    return Panel(f"incidence {incidence_deg:g}°", curves, incidence_deg)


def _brightness(curve: Curve) -> Curve:
    measured = np.abs(curve.theta_deg) <= 80.0
    theta = curve.theta_deg[measured]
    return Curve(theta, curve.values[measured] / np.cos(np.radians(theta)), curve.css, curve.name)


def _lobes(model: FacetModel, node: Node) -> tuple[Curve, ...]:
    """Whole, diffuse, directional."""
    theta, head = np.linspace(-89.9, 89.9, 361), constants(model.optics, model.shadowing)
    both = lobes(node, head, theta)
    glow = lobes(node._replace(w_b=0.0), head, theta)
    return (
        Curve(theta, glow, "diffuse", "diffuse lobe"),
        Curve(theta, both - glow, "directional", "directional lobe"),
        Curve(theta, both, "model", "model"),
    )


def _draw(panel: Panel) -> str:
    largest = max(float(curve.values.max()) for curve in panel.curves)
    rim = _round_up(largest)
    inside = _grid(rim, panel.incidence_deg) + "".join(_curve(curve, rim) for curve in panel.curves)
    if panel.incidence_deg is not None:
        x, y = _place(np.array([panel.incidence_deg]), np.array([1.13]))[:, 0]
        near_x, near_y = _place(np.array([panel.incidence_deg]), np.array([1.02]))[:, 0]
        inside += f'<path class="light" d="M{x:.1f} {y:.1f}L{near_x:.1f} {near_y:.1f}"/><circle class="light" cx="{x:.1f}" cy="{y:.1f}" r="4"/>'
    return f'<text x="16" y="16">{escape(panel.title)}</text><g transform="translate({_PANEL[0] / 2:g} {_PANEL[1] - 42:g})">{inside}</g>'


def _grid(rim: float, source_deg: float | None) -> str:
    """Half and whole circle, rays; the ray at the source has no name, the source stands there."""
    parts = [f'<path class="axis" d="M{-_RADIUS:g} 0H{_RADIUS:g}"/>']
    for share in (0.5, 1.0):
        r = share * _RADIUS
        parts.append(f'<path class="grid" d="M{-r:g} 0A{r:g} {r:g} 0 0 1 {r:g} 0"/>')
        parts.append(f'<text x="{r:g}" y="16" text-anchor="middle">{number(share * rim)}</text>')
    for theta in range(-90, 91, 30):
        (x,), (y,) = _place(np.array([theta]), np.array([1.0]))
        (far_x,), (far_y,) = _place(np.array([theta]), np.array([1.09]))
        parts.append(f'<path class="grid" d="M0 0L{x:.1f} {y:.1f}"/>')
        if abs(theta) < 90 and (source_deg is None or abs(theta - source_deg) > 8.0):
            parts.append(
                f'<text x="{far_x:.1f}" y="{far_y + 4:.1f}" text-anchor="middle">{theta}°</text>'
            )
    return "".join(parts)


def _curve(curve: Curve, rim: float) -> str:
    x, y = _place(curve.theta_deg, curve.values / rim)
    if curve.css == "data":
        return "".join(
            f'<circle class="data" cx="{a:.1f}" cy="{b:.1f}" r="2.6"/>'
            for a, b in zip(x, y, strict=True)
        )
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return f'<polyline class="{curve.css}" points="{points}"/>'


def _place(theta_deg: Array, share: Array) -> Array:
    """Pixels of angles and shares of the rim: the source's side on the left, up is the normal."""
    theta = np.radians(theta_deg)
    return np.array([-np.sin(theta) * share * _RADIUS, -np.cos(theta) * share * _RADIUS])


def _legend(panels: Sequence[Panel]) -> str:
    names = {curve.name: curve.css for panel in panels for curve in panel.curves}
    parts, x = [], 0.0
    for name, css in names.items():
        mark = (
            '<circle class="data" cx="14" cy="-4" r="2.6"/>'
            if css == "data"
            else f'<path class="{css}" d="M0 -4h28"/>'
        )
        parts.append(
            f'<g transform="translate({x:g} 0)">{mark}<text x="34" y="0">{escape(name)}</text></g>'
        )
        x += 50.0 + 8.0 * len(name)
    return "".join(parts)


def _round_up(value: float) -> float:
    """1, 1.2, 1.5, 2, 3, 5 or 8 times a power of ten, no less than the value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-9)))
    return next(
        step * power for step in (1.0, 1.2, 1.5, 2.0, 3.0, 5.0, 8.0, 10.0) if step * power >= value
    )
