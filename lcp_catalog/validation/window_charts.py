"""Drawings of windows as inline SVG: the map and the histogram of their correlation, as the paper's figure 4 has it.

Colours are CSS classes of `STYLE`, so that drawings follow light and dark.
"""

from __future__ import annotations

import math
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..plots.svg import nice_step, number
from .report_marks import Frame
from .window_correlation import WindowComparison

LIMITS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
"""Between the colours of correlation."""

COLOURS = (
    (68, 1, 84),
    (70, 50, 126),
    (54, 92, 141),
    (39, 127, 142),
    (31, 161, 135),
    (74, 193, 109),
    (160, 218, 57),
    (253, 231, 37),
)
"""One more than `LIMITS`, dark to light and even for colour-blind eyes (the map known as viridis)."""

BINS_BELOW, BINS_ABOVE, BIN = 10, 50, 0.02
"""Bins of the histogram: so many below and above 0, and their width: -0.2 to 1, as in the paper's figure 4."""

LOWEST = -BINS_BELOW * BIN

_PLOT = (420.0, 220.0)
_LEFT, _RIGHT, _TOP, _BOTTOM = 56.0, 12.0, 30.0, 48.0
_WHOLE = (_LEFT + _PLOT[0] + _RIGHT, _TOP + _PLOT[1] + _BOTTOM)


def correlation_class(values: ArrayLike) -> NDArray[np.int64]:
    """Index into `COLOURS`: how many of `LIMITS` lie below."""
    return np.searchsorted(LIMITS, np.asarray(values), side="left")


def correlation_pixels(windows: WindowComparison) -> NDArray[np.uint8]:
    """One pixel a window, RGBA, rows and columns in steps from the first; no window is transparent, a flat one grey."""
    row, col = (
        (at - (at.min() if len(at) else 0)) // windows.step for at in (windows.row, windows.col)
    )
    shape = (int(row.max()) + 1, int(col.max()) + 1) if len(row) else (1, 1)
    pixels = np.zeros((*shape, 4), dtype=np.uint8)
    known = np.isfinite(windows.correlation)
    pixels[row, col] = (128, 128, 128, 255)
    colours = np.array(COLOURS, dtype=np.uint8)[
        correlation_class(np.where(known, windows.correlation, 0.0))
    ]
    pixels[row[known], col[known], :3] = colours[known]
    return pixels


def correlation_map(frame: Frame, windows: WindowComparison, address: str) -> str:
    """The picture of `correlation_pixels` where its windows lie: each one's pixel covers the step around its middle."""
    rest = (windows.size - windows.step) / 2.0
    left, top = (float(at.min()) + rest for at in (windows.col, windows.row))
    wide, high = (float(at.max() - at.min() + windows.step) for at in (windows.col, windows.row))
    k = frame.scale
    return (
        f'<image class="cells" href="{address}" x="{left * k:.2f}" y="{top * k:.2f}" width="{wide * k:.2f}" '
        f'height="{high * k:.2f}" preserveAspectRatio="none"/>'
    )


def colour_scale() -> str:
    """The colours of correlation and the limits between them."""
    width, step = 300.0, 300.0 / len(COLOURS)
    boxes = "".join(
        f'<rect class="k{k}" x="{k * step:.1f}" width="{step:.1f}" height="14"/>'
        for k in range(len(COLOURS))
    )
    names = "".join(
        f'<text x="{(k + 1) * step:.1f}" y="30">{limit:g}</text>' for k, limit in enumerate(LIMITS)
    )
    return (
        f'<svg class="scale-bar" viewBox="-2 -2 {width + 4:g} 36" role="img" aria-label="colours of correlation, below 0 to 1">'
        f"{boxes}<g class='names'>{names}</g></svg>"
    )


def bin_shares(correlation: ArrayLike) -> Array:
    """Share of all values in each of the bins (a, b] from -0.2 to 1; what is lower counts in the first, NaN in none."""
    values = np.asarray(correlation, dtype=np.float64)
    known = values[np.isfinite(values)]
    index = np.ceil(known / BIN).astype(np.int64) + BINS_BELOW - 1
    counts = np.bincount(
        np.clip(index, 0, BINS_BELOW + BINS_ABOVE - 1), minlength=BINS_BELOW + BINS_ABOVE
    )
    return counts / max(len(values), 1)


def correlation_histogram(windows: WindowComparison) -> str:
    """Share of the windows over their correlation, as the paper's figure 4: mode, and the shares above 0.9 and 0.7."""
    shares = 100.0 * bin_shares(windows.correlation)
    step = nice_step(max(float(shares.max()), 1e-3), 5)
    top = step * math.ceil(float(shares.max()) / step * (1 - 1e-9))
    top = max(top, step)
    label = (
        f"histogram of the correlation of {windows.count} windows: {_percent(windows, 0.9)} above 0.9, "
        f"{_percent(windows, 0.7)} above 0.7, mode {windows.mode:.3f}"
    )
    drawn = (
        _plot_grid(top, step),
        _bars(shares, top),
        _plot_axes(windows.size),
        _mode_line(windows.mode),
        _shares_text(windows),
    )
    return (
        f'<svg class="plot" viewBox="{-_LEFT:g} {-_TOP:g} {_WHOLE[0]:g} {_WHOLE[1]:g}" role="img" '
        f'aria-label="{escape(label)}">{"".join(drawn)}</svg>'
    )


def _percent(windows: WindowComparison, limit: float) -> str:
    return f"{100.0 * windows.share_above(limit):.1f} %"


def _plot_x(correlation: float) -> float:
    return (correlation - LOWEST) / (BINS_ABOVE * BIN - LOWEST) * _PLOT[0]


def _bars(shares: Array, top: float) -> str:
    parts = []
    for k in np.flatnonzero(shares):
        low, high = ((int(k) + d - BINS_BELOW) / BINS_ABOVE for d in (0, 1))
        css = "h9" if low >= 0.9 else "h7" if low >= 0.7 else "h0"
        tall = _PLOT[1] * float(shares[k]) / top
        left, right = _plot_x(low) + 0.4, _plot_x(high) - 0.4
        below = "below " if k == 0 else f"{low:.2f} to "
        parts.append(
            f'<rect class="{css}" x="{left:.1f}" y="{_PLOT[1] - tall:.1f}" width="{right - left:.1f}" height="{tall:.1f}">'
            f"<title>{below}{high:.2f}: {shares[k]:.2f} % of the windows</title></rect>"
        )
    return "".join(parts)


def _plot_grid(top: float, step: float) -> str:
    parts = []
    for k in range(round(top / step) + 1):
        y = _PLOT[1] * (1 - k * step / top)
        parts.append(
            f'<path class="grid" d="M0 {y:.1f}H{_PLOT[0]:g}"/><text class="end" x="-7" y="{y + 4:.1f}">{number(k * step)}</text>'
        )
    return "".join(parts)


def _plot_axes(size: int) -> str:
    width, height = _PLOT
    ticks = "".join(
        f'<path class="axis" d="M{_plot_x(v / 5):.1f} {height:g}v5"/><text class="middle" x="{_plot_x(v / 5):.1f}" '
        f'y="{height + 19:g}">{v / 5:g}</text>'
        for v in range(-1, 6)
    )
    return (
        f'<path class="axis" d="M0 0V{height:g}H{width:g}"/>{ticks}'
        f'<text class="middle" x="{width / 2:g}" y="{height + 39:g}">'
        f"correlation of image and render in {size} x {size} cells</text>"
        f'<text class="middle" transform="translate(-42 {height / 2:g}) rotate(-90)">share of the windows, %</text>'
    )


def _mode_line(mode: float) -> str:
    if not math.isfinite(mode):
        return ""
    x = min(max(_plot_x(mode), 0.0), _PLOT[0])
    end = "end" if x > _PLOT[0] / 2 else "start"
    return (
        f'<path class="mode" d="M{x:.1f} -6V{_PLOT[1]:g}"/>'
        f'<text class="name {end}" x="{x:.1f}" y="-12">mode {mode:.3f}</text>'
    )


def _shares_text(windows: WindowComparison) -> str:
    lines = (("h9", 0.9), ("h7", 0.7))
    return "".join(
        f'<rect class="{css}" x="12" y="{12 + 22 * k}" width="12" height="12"/>'
        f'<text class="name" x="31" y="{22 + 22 * k}">{_percent(windows, limit)} above {limit:g}</text>'
        for k, (css, limit) in enumerate(lines)
    )


STYLE = """
:root{--bar9:#0f7b4f;--bar7:#79b89a;--bar0:#b9bcc4}
@media (prefers-color-scheme:dark){:root{--bar9:#43c98d;--bar7:#2d7a59;--bar0:#5a5e69}}
@media print{:root{--bar9:#0f7b4f;--bar7:#79b89a;--bar0:#b9bcc4}}
.cells{image-rendering:pixelated}
.plot{width:100%;height:auto;max-width:560px;font-size:12px}
.plot .grid{stroke:var(--line);fill:none}.plot .axis{stroke:var(--soft);fill:none}
.plot .h9{fill:var(--bar9)}.plot .h7{fill:var(--bar7)}.plot .h0{fill:var(--bar0)}
.plot .mode{stroke:var(--ink);stroke-dasharray:4 3;fill:none}.plot .name{fill:var(--ink);font-weight:600}
.plot .end{text-anchor:end}.plot .start{text-anchor:start}.plot .middle{text-anchor:middle}
.scale-bar{width:100%;max-width:340px}.scale-bar .names text{text-anchor:middle;font-size:11px}
@media (max-width:520px){.plot{font-size:14px}}
""" + "".join(f".k{k}{{fill:rgb{colour}}}" for k, colour in enumerate(COLOURS))
