"""Repeatability of images, and the offset of a series from its renders; a supplement to
`photographs.py`.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import rasterio
from helpers import apollo_frames as apollo


def repeatability(shared: Path, keys: list[str], fwhm: float) -> list[tuple[float, float]]:
    """For consecutive frames: Sun elevation, and the correlation of the two images over a window of
    common terrain.
    """
    found = []
    for first, second in pairwise(keys):
        if int(second[-4:]) - int(first[-4:]) == 1:
            found += _pairs(shared, first, second, fwhm)
    return found


def _pairs(shared: Path, first: str, second: str, fwhm: float) -> list[tuple[float, float]]:
    a, b = (apollo.series_frame(shared, key, fwhm=fwhm) for key in (first, second))
    folder = shared / "images" / apollo.SERIES / "DIM_input_1280mpp_masked"
    with rasterio.open(folder / f"{first}.tif") as file:
        from_a = file.transform
    with rasterio.open(folder / f"{second}.tif") as file:
        to_b = ~file.transform
    col, row = np.meshgrid(np.arange(a.image.shape[1]) + 0.5, np.arange(a.image.shape[0]) + 0.5)
    at = [np.float32(axis - 0.5) for axis in to_b @ (from_a @ (col, row))]
    other = cv2.remap(b.image, *at, cv2.INTER_LINEAR)
    a.compared &= cv2.remap(b.compared.astype(np.float32), *at, cv2.INTER_LINEAR) > 0.99
    return [(a.sun_elevation_deg, a.correlation(other, place)) for place in a.windows()]


def measured_shift(shared: Path, keys: list[str], model: str) -> tuple[float, float]:
    """Median, over frames with a Sun below 25 deg, of the shift at which the windows of a render
    without albedo correlate best, in pixels (columns, rows).
    """
    best = []
    for key in keys:
        frame = apollo.series_frame(shared, key, (0.0, 0.0))
        if frame.sun_elevation_deg < 25.0:
            best.append(_best_shift(frame, model))
    return tuple(np.median(best, axis=0))


def _best_shift(frame: apollo.Frame, model: str) -> tuple[float, float]:
    steps = np.arange(-2.0, 2.01, 0.1)
    render, places = frame.render(model), frame.windows()
    rows, cols = np.mgrid[: render.shape[0], : render.shape[1]].astype(np.float32)

    def score(col: float, row: float) -> float:
        moved = cv2.remap(
            render.astype(np.float32),
            cols + np.float32(col),
            rows + np.float32(row),
            cv2.INTER_LINEAR,
        )
        return float(np.median([frame.correlation(moved, place) for place in places]))

    across = max(steps, key=lambda step: score(step, 0.0))
    along = max(steps, key=lambda step: score(across, step))
    return float(max(steps, key=lambda step: score(step, along))), float(along)
