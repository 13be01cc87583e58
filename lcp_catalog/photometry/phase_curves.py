"""Pictures of the laws of reflection, as SVG that stands alone: phase curves, and polar plots of where light goes."""

# ruff: noqa: E501 - lines of markup

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from .laws import Reflectance, radiance_factor

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


def polar_chart(
    model: Reflectance, incidences_deg: Sequence[float] = (0.0, 30.0, 60.0, 80.0)
) -> str:
    """Where level ground sends light in the plane of incidence: I/F as the length of the ray at each emission angle, the Sun on
    the left at each incidence, which a tick at the rim marks.
    """
    emission = np.linspace(-89.9, 89.9, 360)
    factors = {}
    for incidence in incidences_deg:
        i, e = math.radians(incidence), np.radians(emission)
        # emission below 0 is on the Sun's side
        factors[f"{incidence:g}°"] = (
            incidence,
            radiance_factor(model, i, np.abs(e), np.abs(e + i)),
        )
    greatest = max(float(values.max()) for _, values in factors.values())
    ring = _round_up(greatest)
    middle, base, radius = 380.0, 372.0, 318.0
    parts = [_half_rings(middle, base, radius, ring)]
    for k, (name, (incidence, values)) in enumerate(factors.items()):
        x = middle + radius * values / ring * np.sin(np.radians(emission))
        y = base - radius * values / ring * np.cos(np.radians(emission))
        colour = _COLOURS[k % len(_COLOURS)]
        parts.append(_line(x, y, colour))
        s, c = math.sin(math.radians(-incidence)), math.cos(math.radians(incidence))
        parts.append(
            f'<path d="M{middle + radius * s:.1f} {base - radius * c:.1f}L{middle + (radius + 12) * s:.1f} {base - (radius + 12) * c:.1f}" stroke="{colour}" stroke-width="3"/>'
        )
        parts.append(_key(k, f"incidence {name}", 600.0, 40.0))
    return _svg("".join(parts), f"{model.name}: radiance factor in the plane of incidence")


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


def _half_rings(middle: float, base: float, radius: float, ring: float) -> str:
    """A half circle of emission angles every 30 deg, and rings of equal radiance factor."""
    parts = []
    for k in range(1, 5):
        r = radius * k / 4.0
        parts.append(
            f'<path class="grid" d="M{middle - r:.1f} {base:g}A{r:.1f} {r:.1f} 0 0 1 {middle + r:.1f} {base:g}"/>'
        )
        parts.append(
            f'<text x="{middle + r:.1f}" y="{base + 18:g}" text-anchor="middle">{ring * k / 4:.3g}</text>'
        )
    for angle in range(-90, 91, 30):
        s, c = math.sin(math.radians(angle)), math.cos(math.radians(angle))
        parts.append(
            f'<path class="grid" d="M{middle:g} {base:g}L{middle + radius * s:.1f} {base - radius * c:.1f}"/>'
        )
        parts.append(
            f'<text x="{middle + (radius + 28) * s:.1f}" y="{base - (radius + 18) * c + 4:.1f}" text-anchor="middle">{abs(angle)}°</text>'
        )
    parts.append(
        f'<text x="40" y="40">the Sun’s side</text><text x="{middle:g}" y="{base + 38:g}" text-anchor="middle">radiance factor I/F</text>'
    )
    return "".join(parts)


def _round_up(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return power * next(
        m for m in (1.0, 1.2, 1.6, 2.0, 2.4, 3.2, 4.0, 6.0, 8.0, 10.0) if m * power >= value
    )


def _svg(body: str, label: str) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_SIZE[0]:g} {_SIZE[1]:g}" role="img" aria-label="{escape(label)}">'
        f"<style>{_STYLE}</style>{body}</svg>"
    )
