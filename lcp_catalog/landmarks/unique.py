"""Is there anything else like a patch where it may be searched for?

Correlation is the centred, normalised one (cv2's TM_CCOEFF_NORMED): blind to gain and offset.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from .corners import fill_missing
from .localize import mean_lit_level

Float = NDArray[np.float32]
Array = NDArray[np.float64]
Index = NDArray[np.int64]

_FLAT = 1e-3
"""A window whose contrast is below this share of the patch's (or of the image's level) is flat: it is like nothing."""

_REFINED = 4
"""Peaks of the half-resolution map that are looked at again at full resolution."""

_REACH = 3
"""Nodes around such a peak that are computed at full resolution; its place is known to half a coarse node or so."""

_COARSE_HALF_MIN = 8
"""Smaller patches have too few nodes at half resolution: they are searched at full resolution."""


def second_peak(
    image: Float,
    rows: Index,
    cols: Index,
    half: int,
    search: int,
    exclusion: float | None = None,
    exact: bool = False,
) -> Float:
    """Highest correlation of each point's patch with anything else whose centre lies within +-``search`` nodes, (n,).

    "Anything else" is a local maximum of the correlation (3 x 3 nodes) farther than ``exclusion`` nodes (default: ``half``) from
    the true place. Asking for a maximum keeps out the flank of the true one, however broad it is: on it every node has a
    higher neighbour towards the middle. A ridge along which nothing changes is a chain of equal maxima and counts. Places are
    whole nodes; the search square is cut at the image's border.

    Missing nodes hold the mean of the valid nodes around them, and windows without contrast correlate 0, so neither can
    look alike. The answer is 1 for a patch without contrast (it cannot be told from anything), -1 where nothing else is in
    the search square, and NaN where the patch itself does not lie whole in the image.

    Unless ``exact``, the map is computed at half resolution and its 4 highest peaks again at full resolution; the loss is
    measured in docs/control-points.md.
    """
    exclusion = float(half) if exclusion is None else float(exclusion)
    finder = _Finder(np.asarray(image, dtype=np.float32), half, search, exclusion)
    coarse = not exact and half >= _COARSE_HALF_MIN
    find = finder.by_halves if coarse else finder.in_full
    places = zip(np.asarray(rows).tolist(), np.asarray(cols).tolist(), strict=True)
    return np.array([find(row, col) for row, col in places], dtype=np.float32)


@dataclass(frozen=True)
class _Finder:
    """One image, prepared once for all its points."""

    image: Float
    half: int
    search: int
    exclusion: float

    @cached_property
    def filled(self) -> Float:
        """The image without gaps and without its mean, so that float32 sums keep their digits."""
        whole = fill_missing(self.image, 2 * self.half + 1)
        return np.asarray(whole - whole.mean(dtype=np.float64), dtype=np.float32)

    @cached_property
    def contrast(self) -> Float:
        """Standard deviation of every whole window, by its north-west node."""
        return _contrast(self.filled, 2 * self.half + 1)

    @cached_property
    def flat(self) -> float:
        """Contrast below which a window is rounding error."""
        known = self.image[np.isfinite(self.image)]
        return float(1e-6 * np.abs(known).max(initial=0.0))

    @cached_property
    def coarse(self) -> Float:
        """2 x 2 means; an odd last row or column is left out."""
        height, width = (n // 2 * 2 for n in self.filled.shape)
        return np.ascontiguousarray(
            cv2.resize(self.filled[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        )

    @cached_property
    def coarse_contrast(self) -> Float:
        return _contrast(self.coarse, self.half)

    def _known(self, row: int, col: int) -> float | None:
        """The answer where no search is needed."""
        height, width = self.image.shape
        half = self.half
        if not (half <= row < height - half and half <= col < width - half):
            return math.nan
        return 1.0 if self.contrast[row - half, col - half] <= self.flat else None

    def in_full(self, row: int, col: int) -> float:
        """Every node at full resolution."""
        known = self._known(row, col)
        if known is not None:
            return known
        return self._highest(row, col, (row - self.search, row + self.search, col - self.search, col + self.search))

    def _highest(self, row: int, col: int, box: tuple[int, int, int, int]) -> float:
        """The highest maximum among centres in the box (inclusive) and the search square; -1 for none.

        Nodes just outside the box take part in deciding what is a maximum, so the box is grown by one first and shrunk again
        where it was cut by nothing but itself.
        """
        half, search = self.half, self.search
        height, width = self.image.shape
        r0, r1 = max(box[0], row - search, half), min(box[1], row + search, height - half - 1)
        c0, c1 = max(box[2], col - search, half), min(box[3], col + search, width - half - 1)
        if r0 > r1 or c0 > c1:
            return -1.0
        template = self.filled[row - half : row + half + 1, col - half : col + half + 1]
        region = self.filled[r0 - half : r1 + half + 1, c0 - half : c1 + half + 1]
        contrast = self.contrast[r0 - half : r1 - half + 1, c0 - half : c1 - half + 1]
        floor = max(self.flat, _FLAT * float(self.contrast[row - half, col - half]))
        score = _correlate(region, template, contrast, floor)
        peak = _maxima(score)
        peak[0, :] &= r0 == max(row - search, half)
        peak[-1, :] &= r1 == min(row + search, height - half - 1)
        peak[:, 0] &= c0 == max(col - search, half)
        peak[:, -1] &= c1 == min(col + search, width - half - 1)
        away = _away(np.arange(r0, r1 + 1) - row, np.arange(c0, c1 + 1) - col, self.exclusion)
        return float(score[peak & away].max(initial=-1.0))

    def by_halves(self, row: int, col: int) -> float:
        """Half resolution first, then the best few peaks at full resolution."""
        known = self._known(row, col)
        if known is not None:
            return known
        best = -1.0
        for at_row, at_col in self._coarse_peaks(row, col):
            box = (at_row - _REACH, at_row + _REACH, at_col - _REACH, at_col + _REACH)
            best = max(best, self._highest(row, col, box))
        return best

    def _coarse_peaks(self, row: int, col: int) -> list[tuple[int, int]]:
        """Centres (full-resolution nodes) of the highest peaks of the half-resolution map, best first."""
        half, size = self.half, self.half  # a coarse patch of ``half`` nodes covers 2 half of the 2 half + 1
        top, left = (row - half + 1) // 2, (col - half + 1) // 2
        reach = self.search // 2 + 1
        height, width = self.coarse.shape
        top, left = min(top, height - size), min(left, width - size)
        r0, r1 = max(0, top - reach), min(height - size, top + reach)
        c0, c1 = max(0, left - reach), min(width - size, left + reach)
        template = self.coarse[top : top + size, left : left + size]
        contrast = self.coarse_contrast[r0 : r1 + 1, c0 : c1 + 1]
        floor = max(self.flat, _FLAT * float(self.coarse_contrast[top, left]))
        score = _correlate(self.coarse[r0 : r1 + size, c0 : c1 + size], template, contrast, floor)
        dr, dc = 2 * (np.arange(r0, r1 + 1) - top), 2 * (np.arange(c0, c1 + 1) - left)
        found = np.flatnonzero(_maxima(score) & _away(dr, dc, self.exclusion - _REACH))
        if len(found) > _REFINED:
            found = found[np.argsort(-score.ravel()[found], kind="stable")[:_REFINED]]
        i, j = np.divmod(found, score.shape[1])
        return [(row + int(dr[a]), col + int(dc[b])) for a, b in zip(i, j, strict=True)]


def _contrast(image: Float, size: int) -> Float:
    """Standard deviation of every whole ``size`` x ``size`` window, by its north-west node; float64 sums."""
    total, squares = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    mean, mean2 = (
        (s[size:, size:] - s[:-size, size:] - s[size:, :-size] + s[:-size, :-size]) / size**2 for s in (total, squares)
    )
    return np.sqrt(np.clip(mean2 - mean**2, 0.0, None)).astype(np.float32)


def _correlate(region: Float, template: Float, contrast: Float, floor: float) -> Float:
    """cv2's normalised correlation, 0 where the window is flat (cv2 divides rounding errors there)."""
    score = cv2.matchTemplate(region, template, cv2.TM_CCOEFF_NORMED)
    return np.where((contrast > floor) & np.isfinite(score), score, np.float32(0.0))


def _maxima(score: Float) -> NDArray[np.bool_]:
    return np.asarray(score >= cv2.dilate(score, np.ones((3, 3), np.uint8)))


def _away(dr: NDArray[np.int64], dc: NDArray[np.int64], exclusion: float) -> NDArray[np.bool_]:
    return np.asarray(dr[:, None] ** 2 + dc**2 > max(exclusion, 0.0) ** 2)


def expected_correlation(patches: Float, noise: float) -> Array:
    """Correlation of each patch (n, p, p) with itself seen through noise, (n,): 1 / sqrt(1 + (noise / contrast)^2).

    Contrast is the standard deviation over the mean lit level, ``noise`` 1 sigma of a pixel over the same. 0 for a patch without
    contrast, without light or with a missing node. The mean over noise; it scatters by about (1 - r^2) / sqrt(p^2).
    """
    level = mean_lit_level(patches)
    image = np.asarray(patches, dtype=np.float64)
    good = np.isfinite(level)
    contrast = np.where(good[:, None, None], image, 0.0).std(axis=(1, 2)) / np.where(good, level, 1.0)
    return contrast / np.sqrt(contrast**2 + noise**2) if noise > 0.0 else (contrast > 0.0).astype(np.float64)


def effective_samples(patches: Float) -> Array:
    """How many independent samples each patch (n, p, p) is worth when it is correlated with another like it, (n,); 1..p^2.

    Bartlett (1935): the correlation of two independent fields scatters with variance 1 / n_eff, n_eff = N / sum of rho(lag)^2.
    By Parseval that is (sum S)^2 / sum S^2 of the power spectrum S; a periodogram P scatters about S like an exponential
    variable, for which E[P^2] = 2 S^2, so n_eff = 2 (sum P)^2 / sum P^2, over all frequencies but zero. Missing nodes hold the
    patch's mean; a patch without contrast gets 1.
    """
    image = np.asarray(patches, dtype=np.float64)
    known = np.isfinite(image)
    count = np.maximum(known.sum(axis=(1, 2), keepdims=True), 1)
    mean = np.where(known, image, 0.0).sum(axis=(1, 2), keepdims=True) / count
    centred = np.where(known, image - mean, 0.0)
    power = np.abs(np.fft.fft2(centred)) ** 2
    power[:, 0, 0] = 0.0
    total, squares = power.sum(axis=(1, 2)), (power**2).sum(axis=(1, 2))
    nodes = image.shape[1] * image.shape[2]
    return np.clip(2.0 * total**2 / np.where(squares > 0.0, squares, 1.0), 1.0, nodes)


def false_match_probability(true_correlation: Array, second_peak: Array, effective_samples: Array) -> Array:
    """Probability that the correlation at the second peak comes out above the one at the true place, (n,).

    Fisher (1921): z = artanh(r) is nearly normal with variance 1 / (n_eff - 3); the difference of two has twice that, so
    p = Phi((z_second - z_true) / sqrt(2 / (n_eff - 3))). With n_eff <= 3 nothing is known: 1/2. The two correlations share the
    image and are not quite independent, and only the one strongest rival is asked: read it as an order of magnitude.
    """
    limit = 1.0 - 1e-12
    true, second = (np.arctanh(np.clip(np.asarray(r, dtype=np.float64), -limit, limit)) for r in (true_correlation, second_peak))
    freedom = np.clip(np.asarray(effective_samples, dtype=np.float64) - 3.0, 0.0, None)
    score = (second - true) * np.sqrt(freedom / 2.0)
    return _normal_cdf(score)


def _normal_cdf(x: Array) -> Array:
    return np.array([0.5 * math.erfc(-v / math.sqrt(2.0)) for v in np.ravel(x)]).reshape(np.shape(x))
