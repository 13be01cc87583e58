"""The Pareto plot of a trade: error over time, as inline SVG in the page's own colours."""

# ruff: noqa: E501 - lines of markup

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape
from typing import Any

from ..plots.svg import number

Row = dict[str, Any]

_LEFT, _RIGHT, _TOP, _BOTTOM = 92.0, 24.0, 18.0, 64.0
_WIDTH, _HEIGHT = 760.0, 400.0
_NONE_PX = 84.0
"""Height of the strip for no error at all, which has no place on a logarithmic axis."""


@dataclass(frozen=True)
class _Axes:
    """Logarithms of the limits of time (x) and of error (y, whole decades), and the strip of no error below."""

    times: tuple[float, float]
    errors: tuple[int, int]

    def x(self, ratio: float) -> float:
        low, high = self.times
        share = (math.log10(max(ratio, 1e-9)) - low) / (high - low)
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * share

    def y(self, error: float) -> float:
        base = _HEIGHT - _BOTTOM
        if error <= 0.0:
            return base - 16.0
        low, high = self.errors
        share = (math.log10(error) - low) / (high - low)
        return base - _NONE_PX - (base - _NONE_PX - _TOP) * share


def pareto(rows: list[Row]) -> str:
    """The plot. A row gives two marks: the whole work (``cpu_relative``), and the images alone (``render_relative``); both stand
    at ``sunlit_error_share``. The line joins the rows that no other beats in both time and error.
    """
    axes = _Axes(
        _round_times([r[key] for r in rows for key in ("cpu_relative", "render_relative")]),
        _decades([r["sunlit_error_share"] for r in rows if r["sunlit_error_share"] > 0.0]),
    )
    corners = " ".join(
        f"{axes.x(r['cpu_relative']):.1f},{axes.y(r['sunlit_error_share']):.1f}"
        for r in front(rows)
    )
    marks = "".join(
        _marks(axes, row, place) for row, place in zip(rows, _lifted(rows), strict=True)
    )
    return (
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="error of every tier over its time">'
        f'{_grid(axes)}<polyline class="front" points="{corners}"/>{marks}</svg>'
    )


def front(rows: list[Row]) -> list[Row]:
    """The rows that no other one beats: less time at no more error, or less error at no more time; from the fastest on."""

    def beaten(row: Row) -> bool:
        mine = (row["cpu_relative"], row["sunlit_error_share"])
        theirs = ((r["cpu_relative"], r["sunlit_error_share"]) for r in rows if r is not row)
        return any(t <= mine[0] and e <= mine[1] and (t, e) != mine for t, e in theirs)

    return sorted((r for r in rows if not beaten(r)), key=lambda r: r["cpu_relative"])


def _decades(errors: list[float]) -> tuple[int, int]:
    """Whole decades around the errors, two at least."""
    logs = [math.log10(e) for e in errors] or [-3.0]
    low, high = math.floor(min(logs)), math.ceil(max(logs))
    return (low, high) if high - low > 1 else (high - 2, high)


def _round_times(ratios: list[float]) -> tuple[float, float]:
    """The ticks around the ratios and their own, 1."""
    low, high = max(min(ratios), 1e-6), max(ratios)
    ticks = _ticks(math.floor(math.log10(low)), math.ceil(math.log10(max(high, 1.0))) + 1)
    below = [t for t in ticks if t <= min(low, 0.5) * 0.95]
    above = [t for t in ticks if t >= max(high, 1.0) * 1.05]
    return math.log10(below[-1] if below else ticks[0]), math.log10(above[0])


def _ticks(first: int, last: int) -> list[float]:
    """1, 2, 5 in every decade from below the first to the last."""
    return [step * 10.0**power for power in range(first - 1, last + 1) for step in (1, 2, 5)]


def _lifted(rows: list[Row]) -> list[int]:
    """How many names stand below each name already: tiers without errors share one strip."""
    return [
        sum(1 for r in rows[:i] if r["sunlit_error_share"] == row["sunlit_error_share"])
        for i, row in enumerate(rows)
    ]


def _marks(axes: _Axes, row: Row, place: int) -> str:
    """Ring, dot, the line between them, and the name above the dot."""
    error, name = row["sunlit_error_share"], escape(row["accuracy"])
    whole, images, y = (
        axes.x(row["cpu_relative"]),
        axes.x(row["render_relative"]),
        axes.y(error),
    )
    wrong = f"{100.0 * error:.3g} % of the nodes wrong"
    return (
        f'<path class="tie" d="M{images:.1f} {y:.1f}H{whole:.1f}"/>'
        f'<circle class="images" cx="{images:.1f}" cy="{y:.1f}" r="5"><title>{name}, images alone: {row["render_relative"]:.3g} of reference, {wrong}</title></circle>'
        f'<circle class="whole" cx="{whole:.1f}" cy="{y:.1f}" r="6"><title>{name}, whole work: {row["cpu_relative"]:.3g} of reference, {wrong}</title></circle>'
        f'<text class="name" x="{whole:.1f}" y="{y - 12 - 15 * place:.1f}" text-anchor="middle">{name}</text>'
    )


def _percent(power: int) -> str:
    """A power of ten of a share, in per cent, without an exponent."""
    return f"{100.0 * 10.0**power:.{max(0, -2 - power)}f} %"


def _grid(axes: _Axes) -> str:
    base, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    lines, names = [], []
    low, high = axes.times
    for value in _ticks(math.floor(low), math.ceil(high)):
        if low - 1e-9 <= math.log10(value) <= high + 1e-9:
            x = axes.x(value)
            lines.append(f'<path class="grid" d="M{x:.1f} {_TOP:g}V{base:g}"/>')
            names.append(
                f'<text x="{x:.1f}" y="{base + 18:g}" text-anchor="middle">{number(value)}</text>'
            )
    for power in range(axes.errors[0], axes.errors[1] + 1):
        y = axes.y(10.0**power)
        lines.append(f'<path class="grid" d="M{_LEFT:g} {y:.1f}H{right:g}"/>')
        names.append(
            f'<text x="{_LEFT - 8:g}" y="{y + 4:.1f}" text-anchor="end">{_percent(power)}</text>'
        )
    names.append(f'<text x="{_LEFT - 8:g}" y="{axes.y(0.0) + 4:.1f}" text-anchor="end">none</text>')
    middle = (_LEFT + right) / 2.0
    names.append(
        f'<text x="{middle:.1f}" y="{base + 44:g}" text-anchor="middle">CPU time, as a share of reference’s</text>'
    )
    names.append(
        f'<text transform="translate(16 {(_TOP + base) / 2:.1f}) rotate(-90)" text-anchor="middle">sunlit nodes wrong</text>'
    )
    frame = f'<path class="axis" d="M{_LEFT:g} {_TOP:g}V{base:g}H{right:g}"/>'
    return "".join([*lines, frame, *names])
