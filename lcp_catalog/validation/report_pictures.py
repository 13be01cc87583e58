"""Drawings of the validation report, as SVG over images: marks and arrows; windows side by side with
their map, histogram and offsets.

Colours are CSS classes of ``plots/templates/validation.css``. Every drawing has a label for screen
readers. The histogram follows figure 4 of Pivovarchuk et al. (2026).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..catalog.summary import percent
from ..matching.matches import FOUND
from ..plots.axes import Axes, Axis, round_ticks
from ..plots.numbers import drawing, nice_step, number, typeset
from ..plots.pictures import data_uri, grey, shrunk
from .ground_comparison import BIN, WindowComparison
from .result import ImageVerdict, Pictures, WindowFigures

CANVAS = 960.0
"""Width of a drawing in SVG units; smaller for an image whose drawing would be higher than
`TALLEST` times that.
"""

TALLEST, NARROWEST = 1.5, 480.0
"""Largest height of a drawing in units of `CANVAS`, and its smallest width in SVG units, which
holds a line of text.
"""

LEFT, RIGHT, TOP, BOTTOM = 130.0, 60.0, 16.0, 60.0
"""Margins around the image for the axes, SVG units: five digits in the font of the narrowest page."""

SYMBOLS = {
    FOUND: ("M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0Z", "found"),
    "at the edge": ("M-5 0H5", "outside"),
    "not lit": ("M0 -5.5L5 4H-5Z", "light"),
    "not seen": ("M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0Z", "light"),
    "low contrast": ("M-4.5 -4.5H4.5V4.5H-4.5Z", "light"),
    "no data": ("M-4.5 -4.5H4.5V4.5H-4.5ZM-4.5 4.5L4.5 -4.5", "outside"),
    "saturated": ("M0 -6L6 0L0 6L-6 0Z", "light"),
    "weak": ("M-4 -4L4 4M-4 4L4 -4", "doubt"),
    "no peak": ("M-5 0L0 5L5 0", "doubt"),
    "no exact place": ("M-4 -4L4 4M-4 4L4 -4M-5 0H5", "doubt"),
    "ambiguous": ("M-5 0H5M0 -5V5", "doubt"),
    "not confirmed": ("M-5 4L0 -5L5 4", "doubt"),
    "not searched": ("M-5 -2H5M-5 2H5", "light"),
    "inconsistent": ("M-5 -5L5 5M-5 5L5 -5", "wrong"),
}
"""SVG path and CSS class of every match result. Green and filled: found; yellow: not visible or no
texture; orange: the search failed; red: found at a place that contradicts the other points.
"""

ERROR_CLASSES = ((1.0, "within1"), (2.0, "within2"), (3.0, "within3"), (math.inf, "beyond3"))
"""Upper limits of a residual in units of its sigma, and the CSS class of its arrow."""


@dataclass(frozen=True)
class ImageDrawing:
    """Image of ``width`` x ``height`` pixels in a drawing, with axes from its upper left corner in a
    unit of ``pixel`` units per pixel. The centre of pixel (0, 0) is half a pixel from the corner.
    """

    width: float
    height: float
    pixel: float = 1.0
    unit: str = "px"

    @property
    def scale(self) -> float:
        """SVG units per pixel."""
        return CANVAS / max(self.width, self.height / TALLEST)

    def at(self, pixels: ArrayLike) -> Array:
        """SVG coordinates of pixels (..., 2), (column, row)."""
        return (np.asarray(pixels, dtype=np.float64) + 0.5) * self.scale

    def holds(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """True for pixels (..., 2) inside the image; False for NaN."""
        p = np.asarray(pixels, dtype=np.float64) + 0.5
        return np.asarray(((p >= 0.0) & (p <= (self.width, self.height))).all(axis=-1))

    def drawing(self, inside: str, label: str, below: float = 0.0) -> Markup:
        """The whole SVG around the elements ``inside``: axes, and a space below them. The unit stands once
        at each axis: at the top and at the right.
        """
        width, height = self.width * self.scale, self.height * self.scale
        wide, high = max(width, NARROWEST) + LEFT + RIGHT, height + TOP + BOTTOM + below
        x, y = self._ticks(width, last=True), self._ticks(height, last=False)
        return drawing("image", width, height, LEFT, TOP, wide, high, x, y, inside, label)

    def _ticks(self, length: float, last: bool) -> list[tuple[float, str]]:
        """Places and texts along an axis; its last or its first one has the unit."""
        step = nice_step(max(self.width, self.height) * self.pixel, 6)
        apart = step / self.pixel * self.scale
        count = int(length / apart + 1e-9)
        texts = [typeset(number(k * step, 6)) for k in range(count + 1)]
        texts[count if last else 0] += f" {self.unit}"
        return [(k * apart, text) for k, text in enumerate(texts)]

    def picture(self, address: str) -> Markup:
        """The image element with the frame's extent."""
        size = f'width="{self.width * self.scale:.1f}" height="{self.height * self.scale:.1f}"'
        return Markup(f'<image href="{address}" {size} preserveAspectRatio="none"/>')


@dataclass(frozen=True, eq=False)
class Arrows:
    """n arrows in pixels of a frame: vectors ``by`` (n, 2) from ``start`` (n, 2), CSS classes and
    tooltips.
    """

    start: Array
    by: Array
    css: Sequence[str]
    titles: Sequence[str]

    @property
    def longest(self) -> float:
        """90th percentile of the lengths, pixels; 0 without arrows."""
        lengths = np.linalg.norm(self.by, axis=-1)
        return float(np.percentile(lengths, 90.0)) if len(lengths) else 0.0


ARROW = 56.0
"""Length of a long arrow, SVG units."""


def magnification(frame: ImageDrawing, arrows: Arrows) -> float:
    """Magnification of arrows, 1, 2 or 5 times a power of ten: one arrow in ten is longer than
    about `ARROW`.
    """
    if arrows.longest <= 0.0:
        return 1.0
    wanted = ARROW / (arrows.longest * frame.scale)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= wanted * (1 + 1e-9))


def arrow_marks(frame: ImageDrawing, arrows: Arrows, times: float) -> Markup:
    """Arrows magnified ``times``, with a dot at their start."""
    start = frame.at(arrows.start)
    tips = start + arrows.by * frame.scale * times
    return Markup("").join(
        Markup(
            f'<g class="arrow {css}"><path class="back" d="{_arrow(a, b)}"/><path d="{_arrow(a, b)}"/>'
            f'<circle cx="{a[0]:.1f}" cy="{a[1]:.1f}" r="2.4"/><title>{escape(title)}</title></g>'
        )
        for a, b, css, title in zip(start, tips, arrows.css, arrows.titles, strict=True)
    )


def _arrow(start: Array, tip: Array) -> str:
    """Path of a shaft and, if long enough, of a head."""
    shaft = f"M{start[0]:.1f} {start[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}"
    length = float(np.linalg.norm(tip - start))
    if length < 4.0:
        return shaft
    ahead = (tip - start) / length * min(8.0, 0.5 * length)
    aside = 0.5 * np.array([-ahead[1], ahead[0]])
    left, right = tip - ahead + aside, tip - ahead - aside
    return f"{shaft}M{left[0]:.1f} {left[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}L{right[0]:.1f} {right[1]:.1f}"


def scale_arrow(frame: ImageDrawing, times: float, arrows: Arrows, unit: str) -> Markup:
    """Scale below the image: an arrow of a round length, its length and the magnification."""
    length = nice_step(max(arrows.longest, 1e-6), 1)
    length = length / 2.0 if length * frame.scale * times > 140.0 else length
    y = frame.height * frame.scale + BOTTOM + 26.0
    start, tip = np.array([12.0, y]), np.array([12.0 + length * frame.scale * times, y])
    long = "to scale" if times == 1.0 else f"magnified {number(times)} times"
    text = f"{number(length)} {unit}; arrows {long}"
    return Markup(
        f'<g class="arrow key"><path d="{_arrow(start, tip)}"/></g>'
        f'<text x="{tip[0] + 14:.1f}" y="{y:.1f}" dy=".35em">{escape(text)}</text>'
    )


SCALE_ROOM = 50.0
"""Height of the space below a drawing for `scale_arrow`, SVG units."""


def error_classes(residual_px: Array, covariance_px2: Array) -> tuple[Array, list[str]]:
    """Residuals (n, 2) in units of their sigma, and their CSS classes; NaN is in the last class.

    The measure is the root of half the squared Mahalanobis distance: its root mean square is 1 if
    the covariances (n, 2, 2) are true.
    """
    (a, b), (c, d) = np.moveaxis(covariance_px2, 0, -1)
    x, y = np.moveaxis(residual_px, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        over = np.sqrt(0.5 * (d * x * x - (b + c) * x * y + a * y * y) / (a * d - b * c))
    css = [next((c for limit, c in ERROR_CLASSES if v <= limit), "beyond3") for v in over]
    return over, css


def quiver(frame: ImageDrawing, arrows: Arrows, label: str, unit: str, picture: str = "") -> Markup:
    """Magnified arrows over an image with their scale."""
    times = magnification(frame, arrows)
    inside = (
        Markup(picture)
        + arrow_marks(frame, arrows, times)
        + scale_arrow(frame, times, arrows, unit)
    )
    return frame.drawing(inside, label, SCALE_ROOM)


# -- marks


def reason_mark(reason: str) -> Markup:
    """Symbol of a match result, on top of a dark outline, legible on any background."""
    path, css = SYMBOLS[reason]
    return Markup(
        f'<g class="mark"><path class="back" d="{path}"/><path class="{css}" d="{path}"/></g>'
    )


def reason_marks(
    frame: ImageDrawing, pixels: Array, reasons: Sequence[str], titles: Sequence[str]
) -> Markup:
    """Symbols at pixels (n, 2), without those outside the image."""
    inside = frame.holds(pixels)
    return Markup("").join(
        Markup(
            f'<g transform="translate({x:.1f} {y:.1f})">{reason_mark(reason)}<title>{escape(title)}</title></g>'
        )
        for (x, y), reason, title, drawn in zip(
            frame.at(pixels), reasons, titles, inside, strict=True
        )
        if drawn
    )


def reason_key(counts: Iterable[tuple[str, int]], meanings: dict[str, str]) -> list[dict[str, Any]]:
    """Legend of the match results that occur: symbol, name, count and meaning."""
    return [
        {
            "symbol": Markup(
                f'<svg class="key" viewBox="-8 -8 16 16" aria-hidden="true">{reason_mark(reason)}</svg>'
            ),
            "name": reason,
            "count": count,
            "meaning": meanings[reason],
        }
        for reason, count in counts
    ]


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


PLAIN_CAPTION = (
    "The same windows without smoothing: area means of image and render over the cells, "
    "as in Pivovarchuk et al. (2026)."
)


def windows_data(image: ImageVerdict, shown: Pictures) -> dict[str, Any]:
    """Drawings and captions of the comparison; ``none`` states why there is no comparison."""
    figures = image.windows
    data: dict[str, Any] = dict.fromkeys(
        ("none", "histogram", "caption", "plain", "plain_caption", "layers", "pairs", "quiver")
    )
    if figures is None or not figures.compared.count:
        data["none"] = f": {image.windows_reason}" if image.windows_reason else ""
        return data
    w = figures.compared
    data["histogram"], data["caption"] = correlation_histogram(w), _histogram_caption(figures)
    if figures.plain.count:
        data["plain"], data["plain_caption"] = correlation_histogram(figures.plain), PLAIN_CAPTION
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
        f"All {w.count} windows count; their spacing is {w.step} cells of {number(w.gsd_m, 4)} m. Image and render are smoothed "
        "by two cells, the image also by what the DEM does not resolve.",
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
    drawn = quiver(frame, arrows, "offsets of the windows", "cells", picture)
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
    return drawing("colour_scale", COLOURS, LIMITS, 300.0)


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


_NAMES_WIDE, _NAMES_BELOW = 0.4, 0.78
"""Part of the width that the names of the shares take at the left, and of the height that is free for bars below them."""


def correlation_histogram(windows: WindowComparison) -> Markup:
    """Share of the windows over their correlation, with the mode and the shares above 0.9 and 0.7."""
    shares, edges = bars_shown(windows)
    shares = 100.0 * shares
    left = edges[:-1] < edges[0] + _NAMES_WIDE * (1.0 - edges[0])
    high = max(float(shares.max()), float(shares[left].max(initial=0.0)) / _NAMES_BELOW)
    step = nice_step(max(high, 1e-3), 5)
    top = max(step * math.ceil(high / step * (1 - 1e-9)), step)
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
