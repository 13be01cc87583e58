"""Offset of a whole image from where its sensor projects it, also by hundreds of pixels: the
correlations of all points added up over one grid of offsets.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import maximum_filter

from ..arrays import Array, Float32, Index, Mask
from ..cameras.sensor import pixel_size_m
from ..catalog.catalogue import Catalog
from ..images.image import Image
from ..kernels.matching import correlation
from ..landmarks.patches import POINT_SPREAD_PX
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from .consensus import SHARE_IF_HERE
from .point_choice import likeliest
from .point_search import SearchImage
from .templates import render_patches

_GRID_PX = 64
"""Reach of the grid in its own pixels: the image is reduced to it, or until templates are
`_SMALLEST_PX` a side.
"""
_SMALLEST_PX = 8
_CHUNK = 64
_CHUNK_OFFSETS = 4_000_000
"""Largest number of points whose maps are kept at once, and of the offsets of all of them."""
_MOST_POINTS = 400
_LEAST_REAL = 0.7
_LEAST_SHARE = 0.3
"""Least share of the points that can be compared at an offset for it to count."""
_LEAST_CELLS = 100
"""Least number of offsets outside a peak for a result."""
_LEVELS = 4096
_PLATEAU = 0.05


@dataclass(frozen=True)
class CoarseShift:
    """The offset on which most points agree, in pixels of the full-resolution image.
    ``log10_false_alarms``: log10 of the expected number of offsets with as high an agreement by
    chance in an area of this size; ``rival_log10``: the same for the best offset elsewhere;
    ``if_here_log10``: the same if `SHARE_IF_HERE` of the points gave one offset the highest vote that a
    map can give, and the others the mean vote.
    """

    offset_px: tuple[float, float]
    log10_false_alarms: float
    rival_log10: float
    precision_px: float  # the grid's own pixel, and the slack
    points: int
    if_here_log10: float = -math.inf


def coarse_shift(
    catalog: Catalog,
    image: Image,
    model: Reflectance = DEFAULT_MODEL,
    reach_px: float = 500.0,
    *,
    points: ArrayLike,
    offset_px: ArrayLike | Callable[[Index], Array] | None = None,
    slack_px: float = 0.0,
    grid_px: int = _GRID_PX,
    psf_sigma_px: float = POINT_SPREAD_PX,
    share: float = 1.0,
) -> CoarseShift | None:
    """The offset, within ``reach_px``, at which the points (rows of the catalogue) agree best; None
    if too few can be compared.

    ``offset_px``: added first to each point's place ((2,), (n, 2), or a function of the rows).
    ``slack_px``: largest distance of single points from the common offset, as in a turned or scaled
    image.

    Every point votes for every offset by how rare so high a correlation is in its own map: -ln(rank
    / offsets). By chance a vote is exponential with mean 1 whatever the map looks like, and the sum
    of n votes has the tail of Gamma(n); times the number of offsets it is the number of false
    alarms (Desolneux, Moisan and Morel 2008). Points count as independent, or, if their patches
    overlap, as ``share`` of their number (`consensus.independent_share`) with the same mean vote.
    """
    given = np.asarray(points, dtype=np.int64)
    suns = image.sun_directions(catalog.position_mcmf[given])
    some = likeliest(catalog, given, image.sensor, suns, _MOST_POINTS)
    rows = given[some]
    if not len(rows):
        return None
    factor, size = _scale(catalog, image, rows, reach_px / image.sensor.factor, grid_px)
    searched = SearchImage.of(image.reduced(factor))
    offset = offset_px(rows) if callable(offset_px) else offset_px
    offset = np.zeros(2) if offset is None else np.asarray(offset, dtype=np.float64)
    if np.shape(offset) == (len(given), 2):
        offset = offset[some]
    offset = np.broadcast_to(offset, (len(rows), 2)) / searched.factor
    reach, slack = max(1, math.ceil(reach_px / searched.factor)), round(slack_px / searched.factor)
    votes, voters = np.zeros((2 * reach + 1,) * 2), np.zeros((2 * reach + 1,) * 2, np.int64)
    count = max(1, min(_CHUNK, _CHUNK_OFFSETS // votes.size))
    for start in range(0, len(rows), count):
        part = slice(start, start + count)
        maps = correlation_maps(
            catalog, searched, model, rows[part], offset[part], reach, psf_sigma_px
        )
        for score in maps:
            known = np.isfinite(score)
            if known.any():
                voters += known
                votes += _vote(score, known, slack)
    return _peak(votes, voters, searched.factor, slack, 0.5 * size + 2 * slack, share)


def correlation_maps(
    catalog: Catalog,
    searched: SearchImage,
    model: Reflectance,
    rows: Index,
    offset: Array,
    reach: int,
    psf_sigma_px: float = POINT_SPREAD_PX,
) -> Float32:
    """Correlations (n, 2 reach + 1, 2 reach + 1), rows before columns, of points (rows (n,) of the
    catalogue) at every whole offset within ``reach`` of where the image's sensor projects them,
    plus ``offset`` (n, 2) rounded; NaN where there is none. Pixels of the searched image.
    """
    suns = searched.source.sun_directions(catalog.position_mcmf[rows])
    sensor = searched.source.sensor
    templates = render_patches(catalog, rows, sensor, suns, model, psf_sigma_px=psf_sigma_px)
    maps = np.empty((len(rows), 2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    origin = templates.origin + np.round(offset).astype(np.int64)
    correlation.maps(
        searched.fine,
        searched.weight,
        templates.values,
        templates.mask,
        origin,
        reach,
        _LEAST_REAL,
        maps,
    )
    return maps


def _scale(
    catalog: Catalog, image: Image, rows: Index, reach: float, grid_px: int
) -> tuple[int, float]:
    """Reduction factor of the image, and the side of the templates then, in pixels."""
    pixel = float(np.nanmedian(pixel_size_m(image.sensor, catalog.position_mcmf[rows])))
    size = float(np.median(catalog.gsd[rows])) * catalog.patch_nodes / pixel
    factor = max(1, min(math.ceil(reach / grid_px), math.floor(size / _SMALLEST_PX)))
    return factor, size / factor


def _vote(score: Float32, known: Mask, slack: int) -> Array:
    """-ln of the share of a map's offsets with as high a correlation, within ``slack`` of each; 0
    where there is none.
    """
    level = np.where(known, np.clip(score, -1.0, 1.0), -1.0)
    level = ((level + 1.0) * (0.5 * (_LEVELS - 1))).astype(np.int64)
    level = maximum_filter(level, 2 * slack + 1, mode="constant") if slack else level
    count = np.bincount(level[known], minlength=_LEVELS)
    as_high = np.maximum(np.cumsum(count[::-1])[::-1], 1)
    return np.where(known, np.log(known.sum() / as_high)[level], 0.0)


def _peak(
    votes: Array, voters: Index, factor: int, slack: int, zone: float, share: float
) -> CoarseShift | None:
    """The best offset, and the best one farther from it than ``zone``; None if too few remain
    outside.
    """
    known = (voters > 0) & (voters >= _LEAST_SHARE * voters.max())
    clear = np.where(known, (votes - voters) / np.sqrt(np.maximum(voters, 1)), -np.inf)
    row, col = (int(k) for k in np.unravel_index(int(np.argmax(clear)), clear.shape))
    down, right = np.ogrid[-row : clear.shape[0] - row, -col : clear.shape[1] - col]
    near = down**2 + right**2 <= zone**2
    others = known & ~near
    if others.sum() < _LEAST_CELLS:
        return None
    away = np.unravel_index(int(np.argmax(np.where(others, clear, -np.inf))), clear.shape)
    # a slack makes a plateau of the peak: its middle
    top = near & known & (clear >= clear[row, col] - _PLATEAU * max(float(clear[row, col]), 0.0))
    middle = np.argwhere(top).mean(axis=0) - (clear.shape[0] // 2)
    alarms = [
        math.log10(known.sum()) + _log10_gamma_tail(int(voters[at]), float(votes[at]), share)
        for at in ((row, col), away)
    ]
    offset = (float(middle[1] * factor), float(middle[0] * factor))
    most = int(voters.max())
    highest = math.log(max(known.sum() / (1 + 2 * slack) ** 2, math.e))  # of a plateau of the slack
    total = most * (1.0 + SHARE_IF_HERE * (highest - 1.0))
    if_here = math.log10(known.sum()) + _log10_gamma_tail(most, total, share)
    return CoarseShift(offset, alarms[0], alarms[1], float(factor * (1 + slack)), most, if_here)


def _log10_gamma_tail(n: int, total: float, share: float = 1.0) -> float:
    """log10 of the probability that n exponential votes of mean 1 add up to more than t: e^-t times
    the sum of t^k / k!, k < n. Of dependent votes a share counts, rounded down, with the same mean.
    """
    if total <= 0.0:
        return 0.0
    count = max(1, math.floor(share * n))
    total *= count / n
    k = np.arange(count)
    terms = k * math.log(total) - np.array([math.lgamma(v + 1.0) for v in k])
    top = float(terms.max())
    return (top + math.log(float(np.exp(terms - top).sum())) - total) / math.log(10.0)
