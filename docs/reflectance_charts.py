"""Charts of the reflectance models, as SVG that needs no style sheet: phase curves, and polar charts.

``python docs/reflectance_charts.py`` writes those of the page about reflectance models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from lcp_catalog.arrays import Array
from lcp_catalog.photometry.laws import Reflectance, radiance_factor, reflectance_model
from lcp_catalog.plots.axes import Axes, Axis, Curve, Panel, polar_chart

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


def phase_curve_chart(models: Sequence[Reflectance]) -> str:
    """SVG of magnitudes of a sphere's disc by phase, relative to 10 deg for each model, with the Moon's
    (Allen 1973).
    """
    last = 150.5
    curves = {}
    for model in models:
        values = np.array([disc_reflectance(model, float(g)) for g in _PHASES_DEG])
        with np.errstate(divide="ignore"):
            curves[model.name] = -2.5 * np.log10(values / disc_reflectance(model, 10.0))
    top = max(1.0, *(float(np.max(c[np.isfinite(c)])) for c in curves.values()))
    low = math.ceil(min(top, 7.0))
    axes = Axes(
        Axis(0.0, last, _ticks(0, last, 15), "phase angle, degrees", grid=True),
        Axis(low, -1.0, _ticks(-1, low, 1), "magnitudes below phase 10°", grid=True),
        width=652.0, height=342.0, left=88.0, right=20.0, top=20.0, bottom=58.0,
    )  # fmt: skip
    lines = _measured(axes) + _curves(axes, _PHASES_DEG, curves)
    title = "phase curves of a sphere’s disc; circles: the Moon (Allen 1973)"
    return str(axes.draw(lines, title, _STYLE))


def _ticks(first: int, last: float, step: int) -> list[tuple[float, str]]:
    return [(value, str(value)) for value in range(first, int(last) + 1, step)]


def incidence_chart(
    model: Reflectance, incidences_deg: Sequence[float] = (0.0, 30.0, 60.0, 80.0)
) -> str:
    """SVG of the radiance factor of level terrain in the plane of incidence, as a polar chart over the
    emission angle, one curve for each of up to four incidences.
    """
    theta = np.linspace(-89.9, 89.9, 360)
    styles = list(zip(incidences_deg, ("solid", "dashed", "thin", "dotted"), strict=False))
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


def main() -> None:
    """Write the charts of docs/explanation/photometry.md."""
    folder = Path(__file__).with_name("images")
    names = (
        "hapke",
        "lunar-lambert",
        "lommel-seeliger:rolo",
        "lommel-seeliger",
        "minnaert",
        "lambert",
    )
    phases = phase_curve_chart([reflectance_model(name) for name in names])
    (folder / "reflectance_phase.svg").write_text(phases, encoding="utf-8")
    for name in ("hapke", "lunar-lambert"):
        chart = incidence_chart(reflectance_model(name))
        (folder / f"reflectance_polar_{name}.svg").write_text(chart, encoding="utf-8")


if __name__ == "__main__":
    main()
