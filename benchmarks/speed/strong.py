"""The pipeline as a strong engineer would write it in a week: Embree shadows and matrix products for the covariance as in
`pipeline`, rivals searched at half resolution first, and search and probabilities compiled by numba.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import cv2
import numpy as np
from numba import njit

from benchmarks.speed import pipeline_match as plain
from benchmarks.speed.pipeline import Pipeline, halved
from benchmarks.speed.pipeline_match import EXCLUSION, RING, RIVALS, Match, Searched

PEAKS = 16
"""Most maxima at half resolution from which one at full resolution is climbed."""

DOUBT = (0.035, 0.09)
"""Differences of the probability from the least one, below and above, at which the search is repeated, as the library does."""

_STEPS_UP = 8
_CLEAR = 6.0
"""Standard deviations below the true place beyond which a rival does not count."""


def deviations(image: np.ndarray, size: int) -> np.ndarray:
    """Standard deviation of the windows around all nodes; 0 for flat ones."""
    mean, square = (f(image, cv2.CV_64F, (size, size)) for f in (cv2.boxFilter, cv2.sqrBoxFilter))
    variance = square - mean * mean
    return np.sqrt(np.where(variance > 1e-6 * image.var(), variance, 0.0)).astype(np.float32)


def search(
    image: np.ndarray, templates: np.ndarray, rows: np.ndarray, cols: np.ndarray, reach: int
) -> Searched:
    """As `pipeline_match.search`, the rivals from maxima at half resolution."""
    n, p = templates.shape[:2]
    level = (image - np.float32(image.mean(dtype=np.float64))).astype(np.float32)
    small = np.ascontiguousarray(halved(level))
    side = (p - 1) // 2
    out = [np.full((n, count), np.nan) for count in (RIVALS, RIVALS, len(RING), len(RING))]
    centred = (templates - templates.mean(axis=(1, 2), keepdims=True)).astype(np.float32)
    flat = templates.std(axis=(1, 2)) <= 1e-3 * level.std()
    _search(
        level, deviations(level, p), small, _box_deviations(small, side),
        centred, flat, rows, cols, reach, RING.astype(np.int64), *out,
    )  # fmt: skip
    out[0][flat, 0], out[1][flat, 0] = 1.0, templates[flat].std(axis=(1, 2))
    return Searched(*out)


def _box_deviations(image: np.ndarray, side: int) -> np.ndarray:
    """Standard deviation of the windows that begin at each node."""
    mean, square = (
        f(image, cv2.CV_64F, (side, side), anchor=(0, 0), borderType=cv2.BORDER_REFLECT)
        for f in (cv2.boxFilter, cv2.sqrBoxFilter)
    )
    spread = np.sqrt(np.maximum(square - mean * mean, 1e-6 * image.var()))
    return np.asarray(spread, np.float32)


@njit(fastmath=True)
def _product(image: Any, template: Any, row: int, col: int) -> Any:
    total = np.float32(0.0)
    for i in range(template.shape[0]):
        line, values = image[row + i, col : col + template.shape[1]], template[i]
        for j in range(template.shape[1]):
            total += values[j] * line[j]
    return total


@njit(fastmath=True)
def _at(level: Any, deviation: Any, template: Any, norm: float, row: int, col: int) -> Any:
    """Correlation with the window around a node; -2 for one that leaves the image."""
    half = template.shape[0] // 2
    if min(row, col) < half or row + half >= level.shape[0] or col + half >= level.shape[1]:
        return -2.0
    spread = deviation[row, col] * template.shape[0]
    return _product(level, template, row - half, col - half) / (norm * spread) if spread else 0.0


@njit(fastmath=True)
def _search(
    level: Any, deviation: Any, small: Any, small_deviation: Any, templates: Any, flat: Any, rows: Any, cols: Any,
    reach: int, ring: Any, rivals: Any, contrast: Any, near: Any, near_contrast: Any,
) -> None:  # fmt: skip
    half = templates.shape[1] // 2
    for k in range(len(templates)):
        template = templates[k]
        norm = math.sqrt((template * template).sum())
        if norm == 0.0:
            continue
        for place in range(len(ring)):
            row, col = rows[k] + ring[place, 1], cols[k] + ring[place, 0]
            value = _at(level, deviation, template, norm, row, col)
            if value > -2.0:
                near[k, place], near_contrast[k, place] = value, deviation[row, col]
        if not flat[k]:
            top, left = rows[k] - half, cols[k] - half
            score = _coarse(small, small_deviation, template, top, left, reach // 2)
            peaks = 2 * _peaks(score)
            _climb(
                level,
                deviation,
                template,
                norm,
                rows[k],
                cols[k],
                reach,
                peaks,
                rivals[k],
                contrast[k],
            )


@njit(fastmath=True)
def _coarse(small: Any, deviation: Any, template: Any, top: int, left: int, reach: int) -> Any:
    """Correlation at half resolution around a template's place, -2 beyond the image."""
    side, wide = (template.shape[0] - 1) // 2, 2 * reach + 1
    odd_row, odd_col = top % 2, left % 2
    halved = np.empty((side, side), np.float32)
    for i in range(side):
        for j in range(side):
            row, col = 2 * i + odd_row, 2 * j + odd_col
            halved[i, j] = template[row : row + 2, col : col + 2].mean()
    halved -= np.float32(halved.mean())
    norm = math.sqrt((halved * halved).sum()) * side
    row0, col0 = (top + odd_row) // 2 - reach, (left + odd_col) // 2 - reach
    first, last = max(0, -col0), min(wide, small.shape[1] - side - col0 + 1)
    score = np.full((wide, wide), np.float32(-2.0))
    for i in range(max(0, -row0), min(wide, small.shape[0] - side - row0 + 1)):
        line = np.zeros(max(0, last - first), np.float32)
        for a in range(side):
            for b in range(side):
                weight, source = halved[a, b], small[row0 + i + a, col0 + first + b :]
                for j in range(len(line)):
                    line[j] += weight * source[j]
        for j in range(len(line)):
            score[i, first + j] = line[j] / (norm * deviation[row0 + i, col0 + first + j])
    return score


@njit(fastmath=True)
def _peaks(score: Any) -> Any:
    """Distances (k, 2) of the highest maxima from the middle, the middle left out."""
    reach = len(score) // 2
    values, places = np.full(PEAKS, np.float32(-2.0)), np.zeros((PEAKS, 2), np.int64)
    for i in range(len(score)):
        for j in range(len(score)):
            value = score[i, j]
            if value <= values[-1] or abs(i - reach) + abs(j - reach) < 2:
                continue
            if value < score[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].max():
                continue
            at = PEAKS - 1
            while at > 0 and values[at - 1] < value:
                values[at], places[at] = values[at - 1], places[at - 1]
                at -= 1
            values[at], places[at] = value, (i - reach, j - reach)
    return places[values > -2.0]


@njit(fastmath=True)
def _climb(
    level: Any, deviation: Any, template: Any, norm: float, row: int, col: int, reach: int, peaks: Any,
    rivals: Any, contrast: Any,
) -> None:  # fmt: skip
    """The maxima at full resolution above those at half resolution, each once, apart from the place itself."""
    count = 0
    for peak in range(len(peaks)):
        down, across, best = _ascent(level, deviation, template, norm, row, col, peaks[peak])
        known = down**2 + across**2 <= EXCLUSION**2 or max(abs(down), abs(across)) > reach
        for other in range(count):
            known |= rivals[other] == best
        if not known and best > -2.0:
            rivals[count], contrast[count] = best, deviation[row + down, col + across]
            count += 1


@njit(fastmath=True)
def _ascent(
    level: Any, deviation: Any, template: Any, norm: float, row: int, col: int, start: Any
) -> tuple[int, int, Any]:
    down, across = start[0], start[1]
    best = _at(level, deviation, template, norm, row + down, col + across)
    for _ in range(_STEPS_UP):
        here = (down, across)
        for i in range(here[0] - 1, here[0] + 2):
            for j in range(here[1] - 1, here[1] + 2):
                value = _at(level, deviation, template, norm, row + i, col + j)
                if value > best:
                    best, down, across = value, i, j
        if (down, across) == here:
            break
    return down, across, best


def probabilities(
    match: Match, found: Searched, level: np.ndarray, own: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """As `pipeline_match.probabilities`, without rivals that cannot be higher."""
    bad = ~(match.contrast > 0.0) | ~np.isfinite(match.along)
    out = np.zeros((2, len(own)))
    rho, contrast = own * (1.0 - match.loss), found.contrast / level[:, None]
    _probabilities(
        match.contrast, match.noise, np.where(bad, 1.0, match.along), rho, match.nodes,
        plain.raised(match, found.rivals, contrast, rho, spread), contrast, np.exp(2.0 * spread * plain.QUADRATURE), plain.WEIGHTS,
        plain.STEPS, out,
    )  # fmt: skip
    out[:, bad] = 0.0
    found_there = np.minimum(out[0], plain._on_top(match, found, level, own))
    return found_there * plain.settling(match), out[1]


@njit(fastmath=True)
def _moments(
    contrast: float, rho: float, noise: float, along: float, nodes: float
) -> tuple[float, float]:
    total = max(contrast * contrast + noise, 1e-30)
    mean = rho * contrast / math.sqrt(total)
    left = 1.0 - mean * mean * (1.0 + 0.5 * noise / total)
    return mean, math.sqrt(max(along / nodes / total * left, plain.LEAST_VARIANCE))


@njit
def _probabilities(
    contrast: Any, noise: Any, along: Any, rho: Any, nodes: float, rivals: Any, rival_contrast: Any, louder: Any,
    weights: Any, steps: Any, out: Any,
) -> None:  # fmt: skip
    density = np.exp(-0.5 * steps**2)
    density /= density.sum()
    theirs, sigmas = np.empty(rivals.shape[1]), np.empty(rivals.shape[1])
    for k in range(len(rho)):
        for q in range(len(louder)):
            more = (noise[k] * louder[q], along[k] * louder[q])
            mean, sigma = _moments(contrast[k], rho[k], more[0], more[1], nodes)
            count = 0
            for r in range(rivals.shape[1]):
                if np.isnan(rivals[k, r]):
                    continue
                one, its = _moments(rival_contrast[k, r], rivals[k, r], more[0], more[1], nodes)
                one += plain.CLEAR_BY * math.sqrt(sigma * sigma + its * its)
                if one + _CLEAR * its > mean + steps[0] * sigma:
                    theirs[count], sigmas[count], count = one, its, count + 1
            width = (steps[1] - steps[0]) * sigma
            for s in range(len(steps)):
                x = mean + steps[s] * sigma
                passed = density[s] * min(
                    max((x - plain.LEAST_CORRELATION) / width + 0.5, 0.0), 1.0
                )
                out[1, k] += weights[q] * passed
                for r in range(count):
                    if passed > 0.0:
                        passed *= 0.5 * math.erfc((theirs[r] - x) / sigmas[r] * math.sqrt(0.5))
                out[0, k] += weights[q] * passed


class Strong(Pipeline):
    """The pipeline with search and probabilities of this module; the search is repeated at full resolution where a decision
    is in doubt.
    """

    def search(self, *asked: Any) -> Searched:
        self._asked = asked
        return search(*asked)

    def probabilities(
        self, match: Match, found: Searched, level: np.ndarray, own: np.ndarray, spread: float
    ) -> tuple[np.ndarray, np.ndarray]:
        first, second = probabilities(match, found, level, own, spread)
        doubt = first - self.points.min_detection
        again = np.flatnonzero((doubt > -DOUBT[0]) & (doubt < DOUBT[1]))
        if len(again):
            image, templates, rows, cols, reach = self._asked
            exact = plain.search(image, templates[again], rows[again], cols[again], reach)
            parts: dict[str, Any] = {
                n: v[again] for n, v in vars(match).items() if isinstance(v, np.ndarray)
            }
            some = dataclasses.replace(match, **parts)
            first[again], _ = probabilities(some, exact, level[again], own[again], spread)
        return first, second
