"""Where a whole photograph lies from where its sensor puts it, when that may be hundreds of pixels: the correlations of all points
added up over one grid of offsets.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .contents import Catalog
from .kernels import search
from .landmarks.unique import effective_samples
from .patch_render import render_patches
from .photo import Photo
from .reflectance import DEFAULT_MODEL, Reflectance
from .search_image import SearchImage, reduction
from .sensors import pixel_size_m

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_GRID_PX = 64
"""Reach of the grid, in its own pixels: the photograph is reduced to this."""
_SMALLEST_PX = 8
_CHUNK = 64
_MOST_POINTS = 400
_LEAST_REAL = 0.7
_LEAST_SHARE = 0.3
"""Offsets at which fewer than this share of the points' weight can be looked at are left out."""
_STRONGEST = 0.98


@dataclass(frozen=True)
class CoarseShift:
    """The offset on which most points agree. ``log10_false_alarms``: how often, in powers of ten, an area as large without the
    ground in it would show as high a peak. Pixels of the image as it came.
    """

    offset_px: tuple[float, float]
    log10_false_alarms: float
    precision_px: float  # the grid's own pixel, and the slack
    peak: float  # of the mean map, in its standard deviations
    rival: float  # the highest peak elsewhere, in the same
    points: int


def coarse_shift(
    catalog: Catalog,
    photo: Photo,
    model: Reflectance = DEFAULT_MODEL,
    reach_px: float = 500.0,
    *,
    points: ArrayLike,
    offset_px: ArrayLike | Callable[[Index], Array] | None = None,
    slack_px: float = 0.0,
    grid_px: int = _GRID_PX,
    psf_sigma_px: float = 0.5,
) -> CoarseShift | None:
    """The offset, within ``reach_px``, at which the points (rows of the catalogue) agree best; None where no point can be
    looked at.

    ``offset_px``: what is added to each point's place before ((2,), (n, 2), or a function of the rows). ``slack_px``: how far single
    points may lie from the common offset, as a turned or scaled image has them. The photograph is reduced until the reach is
    ``grid_px`` of its pixels, or templates are 8 pixels a side. A map's value is n_eff log(1 / (1 - r^2)) / 2, r its correlation where that is positive:
    the likelihood gained over chance; the maps' sum is judged by its own scatter, as a Gaussian field of
    as many cells as there are template-sized places.
    """
    rows = _thinned(np.asarray(points, dtype=np.int64))
    factor = _factor(catalog, photo, rows, reach_px / reduction(photo.sensor), grid_px)
    image = SearchImage.of(photo.reduced(factor))
    offset = offset_px(rows) if callable(offset_px) else offset_px
    offset = np.zeros(2) if offset is None else np.asarray(offset, dtype=np.float64)
    offset = np.broadcast_to(offset, (len(rows), 2)) / image.factor
    reach = max(1, math.ceil(reach_px / image.factor))
    slack = round(slack_px / image.factor)
    total = np.zeros((2 * reach + 1, 2 * reach + 1))
    weights, cells, used = np.zeros_like(total), [], 0
    for start in range(0, len(rows), _CHUNK):
        part = slice(start, start + _CHUNK)
        suns = image.photo.sun_directions(catalog.position_mcmf[rows[part]])
        templates = render_patches(
            catalog, rows[part], image.photo.sensor, suns, model, psf_sigma_px=psf_sigma_px
        )
        maps = np.full((len(templates), *total.shape), np.nan, dtype=np.float32)
        origin = templates.origin + np.round(offset[part]).astype(np.int64)
        search.maps(
            image.fine, image.weight, templates.values, templates.mask, origin, reach, _LEAST_REAL, maps
        )
        patches = np.where(templates.mask, templates.values, np.float32(np.nan))
        samples = effective_samples(patches)
        for score, n_eff in zip(maps, samples, strict=True):
            known = np.isfinite(score)
            if not known.any():
                continue
            gain = _likelihood(score, n_eff)
            gain = _highest_near(gain, slack) if slack else gain
            total += np.where(known, gain, 0.0)
            weights += known * n_eff
            used += 1
        cells += templates.mask.sum(axis=(1, 2)).tolist()
    if not used:
        return None
    return _peak(total, weights, float(np.median(cells)) / 4.0, image.factor, slack, used)


def _factor(catalog: Catalog, photo: Photo, rows: Index, reach: float, grid_px: int) -> int:
    """By what the photo is reduced: the reach to the grid's, but templates no smaller than `_SMALLEST_PX`."""
    pixel = np.nanmedian(pixel_size_m(photo.sensor, catalog.position_mcmf[rows]))
    size = float(np.median(catalog.gsd[rows]) * catalog.patch_nodes / pixel)
    return max(1, min(math.ceil(reach / grid_px), math.floor(size / _SMALLEST_PX)))


def _thinned(rows: Index) -> Index:
    """At most so many, evenly from the list."""
    if len(rows) <= _MOST_POINTS:
        return rows
    return rows[np.linspace(0, len(rows) - 1, _MOST_POINTS).astype(np.int64)]


def _likelihood(score: NDArray[np.float32], n_eff: float) -> Array:
    r = np.clip(np.nan_to_num(score, nan=0.0), 0.0, _STRONGEST).astype(np.float64)
    return np.asarray(-0.5 * n_eff * np.log1p(-r * r))


def _highest_near(values: Array, reach: int) -> Array:
    """The highest value within ``reach`` rows and columns."""
    out = values
    for axis in (0, 1):
        padded = np.pad(out, [(reach, reach) if a == axis else (0, 0) for a in (0, 1)])
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=axis)
        out = windows.max(axis=-1)
    return out


def _peak(
    total: Array, weights: Array, cell_px2: float, factor: int, slack: int, used: int
) -> CoarseShift:
    known = weights >= _LEAST_SHARE * weights.max()
    mean = np.where(known, total / np.where(known, weights, 1.0), -np.inf)
    row, col = np.unravel_index(int(np.argmax(mean)), mean.shape)
    reach = mean.shape[0] // 2
    down, right = np.ogrid[-row : mean.shape[0] - row, -col : mean.shape[1] - col]
    radius = 2.0 * math.sqrt(cell_px2) + slack
    away = known & (down**2 + right**2 > radius**2)
    others = mean[away] if away.any() else np.zeros(1)
    middle = float(np.median(others))
    scatter = 1.4826 * float(np.median(np.abs(others - middle)))
    scatter = max(scatter, float(others.std()), 1e-12)
    height, rival = (float(mean[row, col]) - middle) / scatter, (float(others.max()) - middle) / scatter
    cells = max(1.0, known.sum() / max(cell_px2, 1.0))
    offset = (float((col - reach) * factor), float((row - reach) * factor))
    return CoarseShift(
        offset, math.log10(cells) + _log10_tail(height), float(factor * (1 + slack)), height, rival, used
    )


def _log10_tail(x: float) -> float:
    """log10 of the chance that a standard normal is above x; asymptotic where it is too small for a float."""
    if x < 30.0:
        return math.log10(0.5 * math.erfc(x / math.sqrt(2.0)))
    return -0.5 * x * x / math.log(10.0) - math.log10(x * math.sqrt(2.0 * math.pi))
