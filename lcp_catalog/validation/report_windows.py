"""The windows in the validation report: image and render side by side, map and histogram of their
correlation, offsets.

The histogram follows figure 4 of Pivovarchuk et al. (2026).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..catalog.summary import percent
from ..plots.axes import Axes, Axis, round_ticks
from ..plots.greyscale import grey, shrunk
from ..plots.numbers import nice_step, number
from ..plots.png import data_uri
from . import report_marks
from .report_marks import Arrows, ImageDrawing
from .result import ImageVerdict, Pictures, WindowFigures
from .window_correlation import BIN, WindowComparison

ARROWS_MAX = 1200
"""Most windows whose offsets are drawn; of more, every second, third ... one."""

OFFSET_CORRELATION = 0.7
"""Least correlation of a window whose offset is drawn."""

UNDER_PIXELS = 160_000
"""Most pixels of the image under the offsets, which the page shows a second time."""

PAIRS_MAX, PAIR_PIXELS = 18, 16_384
"""Most patches shown if no DEM was rendered, and most pixels of each."""

MODES = {
    "side": "side by side",
    "image": "image",
    "render": "render",
    "blink": "blink",
    "swipe": "swipe",
    "correlation": "correlation",
}
"""Views of image, render and correlation, and their names; "swipe" needs a script and is hidden
without one.
"""

LIMITS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
"""Limits between the colours of correlation."""

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
"""Colours of correlation, dark to light, legible with colour blindness (viridis); one more than
`LIMITS`.
"""

LOWEST, MOST_BELOW = -0.2, 0.02
"""Lower end of the histogram, whose first bar includes all windows below; of an image of another
place, with a larger share of windows below than the second figure, the histogram begins at -1.
"""


def windows_data(image: ImageVerdict, shown: Pictures) -> dict[str, Any]:
    """Drawings and captions of the comparison; ``none`` states why there is no comparison."""
    figures = image.windows
    data: dict[str, Any] = dict.fromkeys(
        ("none", "histogram", "caption", "layers", "pairs", "quiver")
    )
    if figures is None or not figures.compared.count:
        data["none"] = f": {image.windows_reason}" if image.windows_reason else ""
        return data
    w = figures.compared
    data["histogram"], data["caption"] = correlation_histogram(w), _histogram_caption(figures)
    if shown.ground_image is None or shown.ground_render is None:
        return data
    if w.patch is not None:
        return data | {"pairs": _pairs(figures, shown.ground_image, shown.ground_render)}
    frame = ImageDrawing(
        *shown.ground_image.shape[::-1], **_axis_unit(w.gsd_m, shown.ground_image.shape)
    )
    return data | {
        "layers": _layers(frame, w, shown.ground_image, shown.ground_render, image.facts.name),
        "quiver": _window_quiver(frame, w, _under(frame, shown.ground_image)),
    }


def _axis_unit(gsd_m: float, shape: tuple[int, ...]) -> dict[str, Any]:
    """Metres or kilometres for axes of a grid (rows, cols)."""
    if max(shape) * gsd_m < 2000.0:
        return {"pixel": gsd_m, "unit": "m"}
    return {"pixel": gsd_m / 1000.0, "unit": "km"}


def _under(frame: ImageDrawing, image: Array) -> Markup:
    return frame.picture(data_uri(grey(shrunk(image, UNDER_PIXELS))))


def _layers(
    frame: ImageDrawing, w: WindowComparison, image: Array, render: Array, name: str
) -> list[dict[str, Any]]:
    """Image, render and correlation map on one grid, each with its caption."""
    seen, model = shrunk(image), shrunk(render)
    layers = (
        ("image", "image, resampled to the terrain grid", grey(seen, model), ""),
        ("render", "render under the Sun of the image", grey(model, seen), ""),
        ("correlation", "correlation of the windows; blank where too few cells are valid", None, colour_scale()),
    )  # fmt: skip
    return [
        {
            "name": layer,
            "drawing": frame.drawing(
                correlation_map(frame, w, data_uri(correlation_pixels(w)))
                if pixels is None
                else frame.picture(data_uri(pixels)),
                f"{caption}: {name}",
            ),
            "caption": caption,
            "scale": scale,
        }
        for layer, caption, pixels, scale in layers
    ]


def _pairs(windows: WindowFigures, images: Array, renders: Array) -> dict[str, Any]:
    """Some patches (k, rows, cols) as image and render, from the lowest to the highest median
    correlation.
    """
    w = windows.compared
    assert w.patch is not None
    patches = np.unique(w.patch)
    medians = np.array([np.median(w.correlation[w.patch == k]) for k in patches])
    order = np.argsort(medians, kind="stable")
    some = np.unique(np.linspace(0, len(order) - 1, min(PAIRS_MAX, len(order))).round().astype(int))
    drawn = []
    for k, median in zip(patches[order[some]], medians[order[some]], strict=True):
        name = "" if windows.point_id is None else str(windows.point_id[np.argmax(w.patch == k)])
        seen, model = shrunk(images[k], PAIR_PIXELS), shrunk(renders[k], PAIR_PIXELS)
        pair = {"image": data_uri(grey(seen, model)), "render": data_uri(grey(model, seen))}
        drawn.append({"point": name, "median": f"{median:.3f}", "images": pair})
    text = (
        f"{len(some)} of {len(order)} patches, from the lowest to the highest correlation: image, render, median correlation "
        "of the windows, point."
    )
    return {"text": text, "patches": drawn}


def _histogram_caption(windows: WindowFigures) -> str:
    """The windows that count, and special cases among them."""
    w = windows.compared
    flat = int(np.count_nonzero(w.correlation == 0.0))
    lowest = lowest_shown(w)
    low = int(np.count_nonzero(w.correlation < lowest))
    sentences = [
        f"All {w.count} windows count; their spacing is {w.step} cells of {number(w.gsd_m, 4)} m.",
        f"Median {w.median:.3f}; of the half with the most texture {percent(w.textured.share_above(0.9))} exceed 0.9.",
        f"Windows without contrast, whose correlation is set to 0: {flat}." if flat else "",
        f"Windows below {lowest:g}, which the first bar includes: {low}." if low else "",
        f"The mode is the centre of the fullest of the bins of {BIN:g} that are shown.",
        f"Offset: {windows.offset_sentence}.",
    ]
    return " ".join(filter(None, sentences))


def _window_quiver(
    frame: ImageDrawing, w: WindowComparison, picture: Markup
) -> dict[str, Any] | None:
    """Offset of each window's image from its render, where the correlation is high enough."""
    if w.offset_px is None:
        return None
    sure = np.isfinite(w.offset_px).all(axis=1) & (w.correlation > OFFSET_CORRELATION)
    chosen = np.flatnonzero(sure)
    if not len(chosen):
        return None
    chosen = chosen[:: math.ceil(len(chosen) / ARROWS_MAX)]
    corners = np.stack([w.col, w.row], axis=-1)[chosen].astype(np.float64)
    offsets = w.offset_px[chosen]
    titles = [f"{number(dx)} cells right, {number(dy)} down" for dx, dy in offsets]
    arrows = Arrows(corners + (w.size - 1) / 2.0, offsets, [""] * len(chosen), titles)
    text = _offsets_caption(w, int(sure.sum()), len(chosen))
    drawn = report_marks.quiver(frame, arrows, "offsets of the windows", "cells", picture)
    return {"drawing": drawn, "text": text}


def _offsets_caption(w: WindowComparison, known: int, drawn: int) -> str:
    """The windows whose offset the arrows show, counted from all of them down."""
    above = int((w.correlation > OFFSET_CORRELATION).sum())
    sentences = [
        "Offset of each window’s image from its render, drawn where the correlation is above "
        f"{OFFSET_CORRELATION:g}: {above} of {w.count} windows.",
        f"Offsets of {above - known} of these lie beyond the search and are not drawn."
        if above > known
        else "",
        f"Drawn: {drawn} of {known}." if drawn < known else "",
    ]
    return " ".join(filter(None, sentences))


# -- map of the correlation


def correlation_class(values: ArrayLike) -> NDArray[np.int64]:
    """Index into `COLOURS`: the number of `LIMITS` below a value."""
    return np.searchsorted(LIMITS, np.asarray(values), side="left")


def correlation_pixels(windows: WindowComparison) -> NDArray[np.uint8]:
    """One RGBA pixel per window step; transparent without a window, grey for NaN."""
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


def correlation_map(frame: ImageDrawing, windows: WindowComparison, address: str) -> Markup:
    """The image of `correlation_pixels` in a frame: each pixel covers one step around the centre of
    its window.
    """
    rest = (windows.size - windows.step) / 2.0
    left, top = (float(at.min()) + rest for at in (windows.col, windows.row))
    wide, high = (float(at.max() - at.min() + windows.step) for at in (windows.col, windows.row))
    k = frame.scale
    return Markup(
        f'<image class="cells" href="{address}" x="{left * k:.2f}" y="{top * k:.2f}" width="{wide * k:.2f}" '
        f'height="{high * k:.2f}" preserveAspectRatio="none"/>'
    )


def colour_scale() -> Markup:
    """The colours of correlation with the limits between them."""
    width, step = 300.0, 300.0 / len(COLOURS)
    boxes = "".join(
        f'<rect fill="rgb{colour}" x="{k * step:.1f}" width="{step:.1f}" height="14"/>'
        for k, colour in enumerate(COLOURS)
    )
    names = "".join(
        f'<text x="{(k + 1) * step:.1f}" y="30">{limit:g}</text>' for k, limit in enumerate(LIMITS)
    )
    return Markup(
        f'<svg class="scale-bar" viewBox="-2 -2 {width + 4:g} 36" role="img" aria-label="colours of correlation, below 0 to 1">'
        f'{boxes}<g class="names">{names}</g></svg>'
    )


# -- histogram of the correlation


def lowest_shown(windows: WindowComparison) -> float:
    """Lower end of the histogram: `LOWEST` or -1."""
    below = int(np.count_nonzero(windows.correlation < LOWEST))
    return LOWEST if below <= MOST_BELOW * windows.count else -1.0


def bars_shown(windows: WindowComparison) -> tuple[Array, Array]:
    """Shares (m,) of the windows in the bins of their histogram from `lowest_shown` to 1, and the
    edges of the bins (m + 1,). The first bin includes lower values.
    """
    counts, edges = windows.histogram()
    lowest = lowest_shown(windows)
    first = int(np.searchsorted(edges, lowest + 1e-9, side="right")) - 1
    shown = counts[first:].astype(np.float64)
    shown[0] += counts[:first].sum()
    return shown / max(windows.count, 1), np.round(edges[first:], 9)


def correlation_histogram(windows: WindowComparison) -> Markup:
    """Share of the windows over their correlation, with the mode and the shares above 0.9 and 0.7."""
    shares, edges = bars_shown(windows)
    shares = 100.0 * shares
    step = nice_step(max(float(shares.max()), 1e-3), 5)
    top = max(step * math.ceil(float(shares.max()) / step * (1 - 1e-9)), step)
    axes = Axes(
        Axis(
            float(edges[0]),
            1.0,
            [(k / 5, f"{k / 5:g}") for k in range(round(5 * edges[0]), 6)],
            f"correlation of image and render in {windows.size} x {windows.size} cells",
        ),
        Axis(0.0, top, round_ticks(0.0, top, 5), "share of the windows, %", grid=True),
    )
    label = (
        f"histogram of the correlation of {windows.count} windows: {_percent(windows, 0.9)} above 0.9, "
        f"{_percent(windows, 0.7)} above 0.7, mode {windows.mode:.3f}"
    )
    at_mode = int(np.clip(np.searchsorted(edges, windows.mode) - 1, 0, len(shares) - 1))
    mode = _mode_line(axes, windows.mode, float(shares[at_mode]))
    inside = _bars(axes, shares, edges) + mode + _shares_text(windows)
    return axes.draw(inside, label)


def _percent(windows: WindowComparison, limit: float) -> str:
    return f"{100.0 * windows.share_above(limit):.1f} %"


def _bars(axes: Axes, shares: Array, edges: Array) -> Markup:
    def bar(k: int) -> tuple[float, float, float, str, str]:
        low, high = float(edges[k]), float(edges[k + 1])
        css = "h9" if low >= 0.9 else "h7" if low >= 0.7 else "h0"
        limits = f"below {high:.2f}" if k == 0 else f"{low:.2f} to {high:.2f}"
        return low, high, float(shares[k]), css, f"{limits}: {shares[k]:.2f} % of the windows"

    return axes.bars((bar(int(k)) for k in np.flatnonzero(shares)), gap=0.2)


def _mode_line(axes: Axes, mode: float, share: float) -> Markup:
    """A line from the name of the mode down to its bar."""
    if not math.isfinite(mode):
        return Markup("")
    across, down = axes.at(mode, share)
    x = min(max(float(across), 0.0), axes.width)
    end = "end" if x > axes.width / 2 else "start"
    return Markup(
        f'<path class="mode" d="M{x:.1f} -6V{float(down):.1f}"/>'
        f'<text class="name {end}" x="{x:.1f}" y="-12">mode {mode:.3f}</text>'
    )


def _shares_text(windows: WindowComparison) -> Markup:
    return Markup("").join(
        Markup(
            f'<rect class="{css}" x="12" y="{12 + 22 * k}" width="12" height="12"/>'
            f'<text class="name" x="31" y="{22 + 22 * k}">{_percent(windows, limit)} above {limit:g}</text>'
        )
        for k, (css, limit) in enumerate((("h9", 0.9), ("h7", 0.7)))
    )
