"""Charts of the reflectance models, as SVG that needs no style sheet: phase curves, and polar charts."""

# ruff: noqa: E501 - lines of markup

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from lcp_catalog.arrays import Array
from lcp_catalog.photometry.facet_model import FacetModel, shadowing_share
from lcp_catalog.photometry.facet_plot import incidence_panel, lobe_curves
from lcp_catalog.photometry.laws import Reflectance, radiance_factor
from lcp_catalog.plots.polar import STYLES, Curve, Panel, polar_chart

_PHASES_DEG = np.concatenate([np.linspace(0.0, 7.0, 15), np.linspace(8.0, 150.0, 72)])

ALLEN_1973 = {
    10: 0.23, 20: 0.51, 30: 0.79, 40: 1.06, 50: 1.35, 60: 1.62, 70: 1.91,
    80: 2.24, 90: 2.63, 100: 3.04, 110: 3.48, 120: 3.93, 130: 4.44, 140: 5.07, 150: 5.9,
}  # fmt: skip
"""The Moon's magnitude below that of the full Moon, by phase in degrees: C. W. Allen, Astrophysical Quantities, 3rd ed. (1973), p. 143."""

_COLOURS = ("#4269d0", "#c3501e", "#3a8f5c", "#8e5bbf", "#a8871a", "#c94f7c", "#4f9fb3", "#7a6352")
_FRAME = (88.0, 20.0, 58.0, 20.0)  # left, right, bottom, top
_SIZE = (760.0, 420.0)
_STYLE = (
    "text{font:13px system-ui,sans-serif;fill:#444}.grid{stroke:#8884;fill:none}.axis{stroke:#888;fill:none}"
    ".curve{fill:none;stroke-width:2}.measured{fill:none;stroke:#888;stroke-width:1.5}"
    "@media(prefers-color-scheme:dark){text{fill:#ccc}}"
)


def disc_reflectance(model: Reflectance, phase_deg: float, count: int = 48) -> float:
    """Brightness of a sphere's disc relative to a white Lambert disc held square to the light; at 0 deg the geometric albedo.

    Gauss-Legendre quadrature over photometric longitude and latitude.
    """
    g = math.radians(phase_deg)
    at, weight = np.polynomial.legendre.leggauss(count)
    half = (math.pi - g) / 2.0
    lon, lat = np.meshgrid(g / 2.0 + half * at, math.pi / 2.0 * at)
    cosine = np.cos(lat)
    incidence, emission = np.arccos(cosine * np.cos(lon - g)), np.arccos(cosine * np.cos(lon))
    seen = radiance_factor(model, incidence, emission, g) * np.cos(emission) * cosine
    return float(weight @ seen @ weight) * half / 2.0


def ground_reflectance(model: Reflectance, phase_deg: float) -> float:
    """I/F of level ground seen from straight above, which the Sun leaves as the phase grows."""
    g = math.radians(phase_deg)
    return float(radiance_factor(model, g, 0.0, g))


def phase_curve_chart(models: Sequence[Reflectance], of_ground: bool = False) -> str:
    """Magnitudes against phase, each law from its own brightness at 10 deg: of a sphere's disc, beside the Moon's as Allen (1973)
    has it, or of level ground.
    """
    bright = ground_reflectance if of_ground else disc_reflectance
    last = 88.0 if of_ground else 150.5
    phases = np.array([g for g in _PHASES_DEG if g <= last])
    curves = {}
    for model in models:
        values = np.array([bright(model, float(g)) for g in phases])
        start = bright(model, 10.0)
        with np.errstate(divide="ignore"):
            curves[model.name] = -2.5 * np.log10(values / start)
    top = max(1.0, *(float(np.max(c[np.isfinite(c)])) for c in curves.values()))
    axes = _Axes((0.0, float(phases[-1])), (math.ceil(min(top, 7.0)), -1.0))
    marks = "" if of_ground else "".join(_measured(axes))
    what = (
        "level ground seen from above"
        if of_ground
        else "a sphere’s disc; circles: the Moon (Allen 1973)"
    )
    return _svg(
        axes.grid("phase, degrees", "magnitudes below phase 10°")
        + marks
        + _curves(axes, phases, curves),
        f"phase curves of {what}",
    )


def incidence_chart(
    model: Reflectance, incidences_deg: Sequence[float] = (0.0, 30.0, 60.0, 80.0)
) -> str:
    """SVG of the radiance factor of level terrain in the plane of incidence, as a polar chart over the
    emission angle, one curve for each of up to four incidences.
    """
    theta = np.linspace(-89.9, 89.9, 360)
    styles = list(zip(incidences_deg, STYLES, strict=False))
    curves = [
        Curve(theta, _in_plane(model, angle, theta), style, f"incidence {angle:g}°")
        for angle, style in styles
    ]
    panel = Panel("radiance factor I/F", tuple(curves), tuple(styles))
    return polar_chart([panel], f"{model.name}: radiance factor in the plane of incidence", 1)


def _in_plane(model: Reflectance, incidence_deg: float, theta_deg: Array) -> Array:
    """Radiance factor at signed emission angles; positive on the side of the source."""
    i, e = math.radians(incidence_deg), np.radians(theta_deg)
    return radiance_factor(model, i, np.abs(e), np.abs(e - i))


def intensity_chart(model: FacetModel, incidences_deg: Sequence[float]) -> str:
    """SVG of I_rel of a facet model and its lobes at some incidences (figure 6 of the paper)."""
    panels = [
        incidence_panel(angle, lobe_curves(model, model.parameters(angle)))
        for angle in incidences_deg
    ]
    return polar_chart(panels, f"{model.name}: relative intensity", 2)


def brightness_chart(model: FacetModel, incidences_deg: Sequence[float]) -> str:
    """SVG of the brightness coefficient of a facet model up to 80 deg of emission (figures 4 and 5)."""
    panels = []
    for angle in incidences_deg:
        curves = lobe_curves(model, model.parameters(angle))
        panels.append(incidence_panel(angle, tuple(_brightness(curve) for curve in curves)))
    return polar_chart(panels, f"{model.name}: brightness coefficient", 2)


def _brightness(curve: Curve) -> Curve:
    measured = np.abs(curve.theta_deg) <= 80.0
    theta = curve.theta_deg[measured]
    return replace(
        curve, theta_deg=theta, values=curve.values[measured] / np.cos(np.radians(theta))
    )


def shadowing_chart(model: FacetModel, incidences_deg: Sequence[float]) -> str:
    """SVG of P(psi, theta, 0), the share of facets that are neither shadowed nor masked (figure 7)."""
    theta = np.linspace(-89.9, 89.9, 360)
    curves = tuple(
        Curve(theta, shadowing_share(model.shadowing, angle, theta), style, f"ψ = {angle:g}°")
        for angle, style in zip(incidences_deg, STYLES, strict=False)
    )
    return polar_chart([Panel("lit and seen", curves)], f"{model.name}: shadowing and masking", 1)


class _Axes:
    """Two linear axes; y may fall."""

    def __init__(self, x: tuple[float, float], y: tuple[float, float]) -> None:
        self.x, self.y = x, y

    def at(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        left, right, bottom, top = _FRAME
        width, height = _SIZE[0] - left - right, _SIZE[1] - bottom - top
        across = (np.asarray(x) - self.x[0]) / (self.x[1] - self.x[0])
        up = (np.asarray(y) - self.y[0]) / (self.y[1] - self.y[0])
        return left + width * across, _SIZE[1] - bottom - height * up

    def grid(self, x_name: str, y_name: str) -> str:
        left, right, bottom, top = _FRAME
        parts = []
        for value in np.arange(self.x[0], self.x[1] + 0.1, 15.0):
            x, _ = self.at(value, self.y[0])
            parts.append(f'<path class="grid" d="M{float(x):.1f} {top:g}V{_SIZE[1] - bottom:g}"/>')
            parts.append(
                f'<text x="{float(x):.1f}" y="{_SIZE[1] - bottom + 18:g}" text-anchor="middle">{value:g}</text>'
            )
        for value in np.arange(min(self.y), max(self.y) + 0.1, 1.0):
            _, y = self.at(self.x[0], value)
            parts.append(f'<path class="grid" d="M{left:g} {float(y):.1f}H{_SIZE[0] - right:g}"/>')
            parts.append(
                f'<text x="{left - 8:g}" y="{float(y) + 4:.1f}" text-anchor="end">{value:g}</text>'
            )
        parts.append(
            f'<path class="axis" d="M{left:g} {top:g}V{_SIZE[1] - bottom:g}H{_SIZE[0] - right:g}"/>'
        )
        parts.append(
            f'<text x="{(left + _SIZE[0] - right) / 2:.1f}" y="{_SIZE[1] - 14:g}" text-anchor="middle">{escape(x_name)}</text>'
        )
        parts.append(
            f'<text transform="translate(26 {_SIZE[1] / 2:.1f}) rotate(-90)" text-anchor="middle">{escape(y_name)}</text>'
        )
        return "".join(parts)


def _curves(axes: _Axes, phases: Array, curves: dict[str, Array]) -> str:
    parts = []
    low = max(axes.y)
    for k, (name, values) in enumerate(curves.items()):
        inside = np.isfinite(values) & (values <= low)
        parts.append(_line(*axes.at(phases[inside], values[inside]), _COLOURS[k % len(_COLOURS)]))
        parts.append(_key(k, name, 110.0, 344.0 - 18.0 * len(curves)))
    return "".join(parts)


def _measured(axes: _Axes) -> list[str]:
    marks = []
    for phase, magnitude in ALLEN_1973.items():
        x, y = axes.at(np.float64(phase), np.float64(magnitude - ALLEN_1973[10]))
        if float(magnitude) - ALLEN_1973[10] <= max(axes.y):
            marks.append(
                f'<circle class="measured" cx="{float(x):.1f}" cy="{float(y):.1f}" r="5"/>'
            )
    return marks


def _key(place: int, name: str, x: float, top: float) -> str:
    y, colour = top + 18.0 * place, _COLOURS[place % len(_COLOURS)]
    return f'<path d="M{x:g} {y:g}h22" stroke="{colour}" stroke-width="3"/><text x="{x + 30:g}" y="{y + 4:g}">{escape(name)}</text>'


def _line(x: Array, y: Array, colour: str) -> str:
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return f'<polyline class="curve" stroke="{colour}" points="{points}"/>'


def _svg(body: str, label: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_SIZE[0]:g} {_SIZE[1]:g}" role="img" aria-label="{escape(label)}">'
        f"<style>{_STYLE}</style>{body}</svg>"
    )
