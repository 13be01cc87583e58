"""The part of a validation's page that holds image and render against each other, window by window."""

from __future__ import annotations

import math
from html import escape

import numpy as np

from ..arrays import Array
from ..catalog.summary import percent
from ..plots.greyscale import Pictures, grey, shrunk
from ..plots.svg import data_uri, number
from . import report_marks, window_charts
from .report_marks import Arrows, Frame
from .result import ImageVerdict, WindowFigures
from .window_correlation import WindowComparison

ARROWS_MAX = 1200
"""Windows whose offsets are drawn; of more, every second, third ... one."""

OFFSET_CORRELATION = 0.7
"""Windows below it say little of their offset, and are not drawn."""

PAIRS_MAX, PAIR_PIXELS = 18, 16_384
"""Patches that are shown where there is no DEM, and most pixels of each."""

MODES = ("side by side", "image", "render", "blink", "swipe", "correlation")
"""Ways to look at the image, its render and their correlation; "swipe" needs a script and shows only with one."""


def windows_section(k: int, image: ImageVerdict, shown: Pictures) -> str:
    title = "<h3 class='part'>Image against render</h3>"
    if image.windows is None or not image.windows.compared.count:
        reason = f": {image.windows_reason}" if image.windows_reason else ""
        return f"{title}<p class='none'>Nothing was compared{escape(reason)}.</p>"
    w = image.windows.compared
    histogram = (
        f"<figure>{window_charts.correlation_histogram(w)}"
        f"<figcaption>{_histogram_caption(image.windows)}</figcaption></figure>"
    )
    if shown.ground_image is None or shown.ground_render is None:
        return title + histogram
    if w.patch is not None:
        pairs = _pairs(image.windows, shown.ground_image, shown.ground_render)
        return f"{title}<div class='columns'>{histogram}{pairs}</div>"
    frame = Frame(*shown.ground_image.shape[::-1])
    photo, model = shrunk(shown.ground_image), shrunk(shown.ground_render)
    layers = {
        "image": frame.picture(data_uri(grey(photo, model))),
        "render": frame.picture(data_uri(grey(model, photo))),
        "correlation": window_charts.correlation_map(
            frame, w, data_uri(window_charts.correlation_pixels(w))
        ),
    }
    return (
        f"{title}{_switched(k, frame, layers, image.facts.name)}"
        f"<div class='columns'>{histogram}{_window_quiver(frame, w)}</div>"
    )


def _switched(k: int, frame: Frame, layers: dict[str, str], name: str) -> str:
    """The layers in one figure; radio buttons and rules of style say which are seen, without a script."""
    switches = "".join(
        f"<input type='radio' name='look-{k}' id='look-{k}-{n}' class='to-{mode.split()[0]}'{'' if n else ' checked'}>"
        f"<label for='look-{k}-{n}' class='for-{mode.split()[0]}'>{mode}</label>"
        for n, mode in enumerate(MODES)
    )
    captions = {
        "image": ("the image on the ground’s grid", ""),
        "render": ("the render, light as in the image", ""),
        "correlation": (
            "correlation of each window; none where too few cells are known",
            window_charts.colour_scale(),
        ),
    }
    shown = "".join(
        f"<figure class='layer {layer}'>{frame.drawing(layers[layer], f'{caption}: {name}')}"
        f"<figcaption>{caption}{more}</figcaption></figure>"
        for layer, (caption, more) in captions.items()
    )
    swipe = "<input type='range' class='swipe' min='0' max='100' value='50' aria-label='how much of the image is seen'>"
    return f"<div class='look' role='group' aria-label='ways to look'>{switches}{swipe}<div class='stack'>{shown}</div></div>"


def _pairs(windows: WindowFigures, images: Array, renders: Array) -> str:
    """Some patches (k, rows, cols), each as image and render: the worst, the middle, the best by their windows' median."""
    w = windows.compared
    assert w.patch is not None
    patches = np.unique(w.patch)
    medians = np.array([np.median(w.correlation[w.patch == k]) for k in patches])
    order = np.argsort(medians, kind="stable")
    some = np.unique(np.linspace(0, len(order) - 1, min(PAIRS_MAX, len(order))).round().astype(int))
    drawn = []
    for k, median in zip(patches[order[some]], medians[order[some]], strict=True):
        name = "" if windows.point_id is None else str(windows.point_id[np.argmax(w.patch == k)])
        photo, model = shrunk(images[k], PAIR_PIXELS), shrunk(renders[k], PAIR_PIXELS)
        pair = (("image", grey(photo, model)), ("render", grey(model, photo)))
        shown = "".join(
            f"<img src='{data_uri(p)}' alt='{what} of patch {name}'>" for what, p in pair
        )
        drawn.append(
            f"<figure><div>{shown}</div><figcaption>{median:.3f} {name}</figcaption></figure>"
        )
    text = (
        f"{len(some)} of {len(order)} patches, from the worst to the best: image, render, the median correlation "
        "of its windows, its point."
    )
    return f"<div><p class='file'>{text}</p><div class='pairs'>{''.join(drawn)}</div></div>"


def _histogram_caption(windows: WindowFigures) -> str:
    """What counts, and what else is known of the windows."""
    w = windows.compared
    flat = int(np.count_nonzero(w.correlation == 0.0))
    low = int(np.count_nonzero(w.correlation < window_charts.LOWEST))
    sentences = [
        f"All {w.count} windows count; they begin {w.step} cells of {number(w.gsd_m, 4)} m apart.",
        f"Median {w.median:.3f}; of the half with the most texture {percent(w.textured.share_above(0.9))} lie above 0.9.",
        f"Flat, and correlated with nothing: {flat}." if flat else "",
        f"In the first bar, being below {window_charts.LOWEST:g}: {low}." if low else "",
        f"As to offsets, {windows.offset_sentence}.",
    ]
    return escape(" ".join(filter(None, sentences)))


def _window_quiver(frame: Frame, w: WindowComparison) -> str:
    """Where each window's image lies off its render, of those windows that say so."""
    if w.offset_px is None:
        return ""
    sure = np.isfinite(w.offset_px).all(axis=1) & (w.correlation > OFFSET_CORRELATION)
    chosen = np.flatnonzero(sure)
    if not len(chosen):
        return ""
    chosen = chosen[:: math.ceil(len(chosen) / ARROWS_MAX)]
    corners = np.stack([w.col, w.row], axis=-1)[chosen].astype(np.float64)
    offsets = w.offset_px[chosen]
    titles = [f"{number(dx)} cells right, {number(dy)} down" for dx, dy in offsets]
    arrows = Arrows(corners + (w.size - 1) / 2.0, offsets, [""] * len(chosen), titles)
    drawn = report_marks.quiver(frame, arrows, "offsets of the windows", "cells")
    text = (
        f"Where each window’s image lies off its render: {len(chosen)} of {int(sure.sum())} windows that "
        f"correlate above {OFFSET_CORRELATION:g} there."
    )
    return f"<figure class='bare'>{drawn}<figcaption>{text}</figcaption></figure>"
