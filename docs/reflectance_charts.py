"""Charts of the reflectance models, as SVG that needs no style sheet: phase curves, and polar charts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from markupsafe import Markup

from lcp_catalog.arrays import Array
from lcp_catalog.photometry.facet_model import FacetModel, shadowing_share
from lcp_catalog.photometry.facet_plot import incidence_panel, lobe_curves
from lcp_catalog.photometry.laws import Reflectance, radiance_factor
from lcp_catalog.plots.axes import Axes, Axis
from lcp_catalog.plots.polar import STYLES, Curve, Panel, polar_chart

_PHASES_DEG = np.concatenate([np.linspace(0.0, 7.0, 15), np.linspace(8.0, 150.0, 72)])

ALLEN_1973 = {
    10: 0.23, 20: 0.51, 30: 0.79, 40: 1.06, 50: 1.35, 60: 1.62, 70: 1.91,
    80: 2.24, 90: 2.63, 100: 3.04, 110: 3.48, 120: 3.93, 130: 4.44, 140: 5.07, 150: 5.9,
}  # fmt: skip
"""The Moon's magnitude relative to the full Moon, by phase in degrees: C. W. Allen, Astrophysical
Quantities, 3rd ed. (1973), p. 143."""

_COLOURS = ("#4269d0", "#c3501e", "#3a8f5c", "#8e5bbf", "#a8871a", "#c94f7c", "#4f9fb3", "#7a6352")
_STYLE = (
    "text{font:13px system-ui,sans-serif;fill:#444}.grid{stroke:#8884;fill:none}.axis{stroke:#888;fill:none}"
    ".end{text-anchor:end}.middle{text-anchor:middle}"
    ".curve{fill:none;stroke-width:2}.measured{fill:none;stroke:#888;stroke-width:1.5}"
    "@media(prefers-color-scheme:dark){text{fill:#ccc}}"
    + "".join(f".k{k}{{stroke:{colour}}}" for k, colour in enumerate(_COLOURS))
)


def disc_reflectance(model: Reflectance, phase_deg: float, count: int = 48) -> float:
    """Brightness of a sphere's disc relative to a white Lambert disc perpendicular to the light; at
    0 deg the geometric albedo.

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
    """I/F of level terrain seen from the zenith; the incidence is equal to the phase."""
    g = math.radians(phase_deg)
    return float(radiance_factor(model, g, 0.0, g))


def phase_curve_chart(models: Sequence[Reflectance], of_ground: bool = False) -> str:
    """SVG of magnitudes by phase, relative to 10 deg for each model: of a sphere's disc, with the
    Moon's (Allen 1973), or of level terrain.
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
    low = math.ceil(min(top, 7.0))
    axes = Axes(
        Axis(0.0, last, _ticks(0, last, 15), "phase angle, degrees", grid=True),
        Axis(low, -1.0, _ticks(-1, low, 1), "magnitudes below phase 10°", grid=True),
        width=652.0, height=342.0, left=88.0, right=20.0, top=20.0, bottom=58.0,
    )  # fmt: skip
    marks = Markup("") if of_ground else _measured(axes)
    what = (
        "level terrain seen from above"
        if of_ground
        else "a sphere’s disc; circles: the Moon (Allen 1973)"
    )
    return str(axes.draw(marks + _curves(axes, phases, curves), f"phase curves of {what}", _STYLE))


def _ticks(first: int, last: float, step: int) -> list[tuple[float, str]]:
    return [(value, str(value)) for value in range(first, int(last) + 1, step)]


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


def _curves(axes: Axes, phases: Array, curves: dict[str, Array]) -> Markup:
    """One line for each model, and the legend at the lower left."""
    parts = []
    for k, (name, values) in enumerate(curves.items()):
        inside = np.isfinite(values) & (values <= axes.y.low)
        css = f"k{k % len(_COLOURS)}"
        parts.append(axes.line(phases[inside], values[inside], f"curve {css}"))
        y = axes.height - 18.0 * (len(curves) - k)
        parts.append(
            Markup(
                '<path class="curve {}" d="M22 {:g}h22"/><text x="52" y="{:g}">{}</text>'
            ).format(css, y, y + 4, name)
        )
    return Markup("").join(parts)


def _measured(axes: Axes) -> Markup:
    """Circles at the measurements of Allen (1973)."""
    phases = np.array(list(ALLEN_1973))
    magnitudes = np.array(list(ALLEN_1973.values())) - ALLEN_1973[10]
    inside = magnitudes <= axes.y.low
    return Markup("").join(
        Markup(f'<circle class="measured" cx="{x:.1f}" cy="{y:.1f}" r="5"/>')
        for x, y in zip(*axes.at(phases[inside], magnitudes[inside]), strict=True)
    )
