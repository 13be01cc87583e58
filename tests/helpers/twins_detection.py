"""Probability that a search finds the true place, and covariance of the match, in plain NumPy and SciPy.

Nothing here uses the library. The noise has 1 sigma of ``sigma`` at every pixel and the Gaussian autocorrelation
exp(-r^2 / 2 l^2); l = 0 is white noise. Correlations are centred and normalised. `plain_probability` is the formula of
Johnson's acquisition probability with Ding's correlated pixels; `refined_probability` adds what simulations showed to be missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.signal import fftconvolve
from scipy.special import log_ndtr

from .twins_registration import node_slopes

Array = NDArray[np.float64]

_STEPS = np.linspace(-8.0, 8.0, 321)
NEAR_NODES = 2.0
_RING = np.unique(
    np.round(
        3.0 * np.stack([f(np.arange(16) * np.pi / 8.0) for f in (np.sin, np.cos)], axis=-1)
    ).astype(int),
    axis=0,
)
"""Places (row, column) on a circle of 3 nodes about the true place."""
_RIVALS = 64


@dataclass(frozen=True, eq=False)
class Surroundings:
    """A patch in its image without noise, both in units of the patch's mean lit level.

    ``image`` (p + 2 s, p + 2 s) around the patch (p, p); ``correlation`` and ``contrast`` (2 s + 1, 2 s + 1) of each place in
    the search square: of the window there with the patch, and the window's standard deviation.
    """

    patch: Array
    image: Array
    correlation: Array
    contrast: Array

    @classmethod
    def of(
        cls, image: NDArray[np.float32], row: int, col: int, half: int, search: int
    ) -> Surroundings:
        """Cut from a whole image around a node; ValueError beyond the image's border."""
        reach = half + search
        if min(row, col) < reach or row + reach >= image.shape[0] or col + reach >= image.shape[1]:
            raise ValueError("the search square is cut by the image's border")
        wide = image[row - reach : row + reach + 1, col - reach : col + reach + 1].astype(
            np.float64
        )
        patch = wide[search : search + 2 * half + 1, search : search + 2 * half + 1]
        level = patch[patch > 0.0].mean() if (patch > 0.0).any() else np.nan
        wide, patch = wide / level, patch / level
        size = 2 * half + 1
        middle = wide - wide.mean()
        mean, square = (cv2.boxFilter(m, cv2.CV_64F, (size, size)) for m in (middle, middle**2))
        inner = slice(half, half + 2 * search + 1)
        contrast = np.sqrt(np.maximum(square - mean**2, 0.0)[inner, inner])
        score = correlation(middle, patch)
        return cls(patch, wide, np.where(contrast > 1e-6, score, 0.0), contrast)

    @property
    def search(self) -> int:
        """Nodes from the true place to the edge of the search square."""
        return len(self.correlation) // 2

    def tops(self) -> NDArray[np.bool_]:
        """Places without a higher neighbour."""
        highest = maximum_filter(self.correlation, 3, mode="constant", cval=-2.0)
        return np.asarray(self.correlation == highest)


def correlation(image: Array, patch: Array) -> Array:
    """Centred, normalised correlation of a patch with every window of an image."""
    pixels = [np.asarray(a - a.mean(), dtype=np.float32) for a in (image, patch)]
    return np.asarray(cv2.matchTemplate(*pixels, cv2.TM_CCOEFF_NORMED), dtype=np.float64)


def autocorrelation(nodes: int, length: float) -> Array:
    """Of the noise at lags of -(nodes - 1)..nodes - 1 in both axes, square."""
    lag = np.arange(-(nodes - 1), nodes)
    if length == 0.0:
        return (lag[:, None] == 0) * (lag == 0) * 1.0
    return np.exp(-(lag[:, None] ** 2 + lag**2) / (2.0 * length**2))


def noise_field(dice: np.random.Generator, nodes: int, length: float) -> Array:
    """Noise of unit variance and that autocorrelation, (nodes, nodes): white noise through a Gaussian of length / sqrt 2."""
    if length == 0.0:
        return dice.normal(size=(nodes, nodes))
    width = length / np.sqrt(2.0)
    reach = int(np.ceil(5.0 * width))
    kernel = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2.0 * width**2))
    kernel /= np.sqrt(np.sum(kernel**2))
    white = dice.normal(size=(nodes + 2 * reach,) * 2)
    return cv2.sepFilter2D(white, cv2.CV_64F, kernel, kernel)[reach:-reach, reach:-reach]


@dataclass(frozen=True, eq=False)
class _Scores:
    """Statistics of the correlation of a patch with noisy windows."""

    nodes: int
    lagged: Array  # covariance of the noise's part in the scores of two windows, by their distance
    within: float  # variance of the noise within a window, about the window's own mean
    squares: float  # sum of the squared autocorrelation over lags

    @classmethod
    def of(cls, patch: Array, sigma: float, length: float) -> _Scores:
        n = len(patch)
        unit = patch - patch.mean()
        unit = unit / np.sqrt(np.sum(unit**2))
        noise = autocorrelation(n, length)
        lagged = sigma**2 * fftconvolve(fftconvolve(unit, unit[::-1, ::-1]), noise)
        overlap = (n - np.abs(np.arange(-(n - 1), n))) / n
        mean = np.sum(noise * overlap[:, None] * overlap) / n**2
        return cls(n * n, lagged, sigma**2 * (1.0 - mean), max(1.0, float(np.sum(noise**2))))

    @property
    def variance(self) -> float:
        """V, of the noise's part in a score."""
        return float(self.lagged[len(self.lagged) // 2, len(self.lagged) // 2])

    def shared(self, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Array:
        """Correlation of the noise in the scores of two windows at a distance in nodes."""
        middle = len(self.lagged) // 2
        inside = (np.abs(rows) <= middle) & (np.abs(cols) <= middle)
        at = self.lagged[
            np.clip(middle + rows, 0, 2 * middle), np.clip(middle + cols, 0, 2 * middle)
        ]
        return np.where(inside, at / self.variance, 0.0)

    def expected(self, rho: Array, contrast: Array) -> Array:
        return rho * contrast / np.sqrt(contrast**2 + self.within)

    def spread(self, rho: Array, contrast: Array) -> Array:
        """Variance of a score: the noise along the patch, and that of the window's own power."""
        e, power = self.expected(rho, contrast), self.nodes * (contrast**2 + self.within)
        along = self.variance / power * (1.0 - e**2) ** 2
        across = (1.0 - rho**2) * contrast**2 * self.nodes * self.variance
        return along + e**2 * (across + self.within**2 * self.nodes * self.squares / 2.0) / power**2


def plain_probability(
    place: Surroundings, sigma: float, length: float, least: float = -1.0
) -> float:
    """`probability_among` all other tops of the search square."""
    tops = place.tops()
    tops[place.search, place.search] = False
    rivals = place.correlation[tops], place.contrast[tops]
    return probability_among(place.patch, sigma, length, *rivals, least)


def probability_among(
    patch: Array,
    sigma: float,
    length: float,
    rho: Array,
    contrast: Array,
    least: float = -1.0,
    clear_by: float = 0.0,
    slope: float = 0.0,
    steep: float = 0.0,
) -> float:
    """P = integral over x >= least of N(x; e_0, v_0) prod_k Phi((x - e_k) / sqrt(v_k)), with the correlations and contrasts (k,)
    of the rivals without noise: e = rho c / sqrt(c^2 + s^2), v = V / N / (c^2 + s^2) (1 - e^2 (1 + u / 2)), u = s^2 / (c^2 + s^2),
    s^2 the variance of the noise within a window. The rivals must be exceeded by ``clear_by`` joint sigmas. With ``slope`` g of
    the noise at the true place noise raises tops (`further_rise`).
    """
    scores = _Scores.of(patch, sigma, length)
    e = scores.expected(np.append(1.0, rho), np.append(patch.std(), contrast))
    power = scores.nodes * (np.append(patch.std(), contrast) ** 2 + scores.within)
    slopes = slope * np.sqrt(power[0] / power[1:])
    e[1:] += further_rise(slopes, steep, e[1:] / e[0])
    share = scores.nodes * scores.within / power
    spread = np.sqrt(scores.variance / power * (1.0 - e**2 * (1.0 + share / 2.0)))
    x = e[0] + spread[0] * _STEPS
    needed = e[1:] + clear_by * np.hypot(spread[0], spread[1:])
    logs = log_ndtr((x[:, None] - needed) / spread[1:]).sum(axis=1)
    return _integral(np.where(x >= least, np.exp(logs), 0.0))


def further_rise(slope: Array | float, steep: float, height: Array) -> Array:
    """By how much more than the true place noise raises tops that are ``height`` times as high: 3 g exp(-0.7 t ``steep``) with the
    ``slope`` g of the noise, for the height t less than for 1.
    """
    falls = np.exp(-0.7 * steep * np.clip(height, 0.0, 1.0)) - np.exp(-0.7 * steep)
    return np.asarray(3.0 * slope * falls)


def refined_probability(
    place: Surroundings, sigma: float, length: float, least: float = -1.0
) -> float:
    """That the highest correlation lies within `NEAR_NODES` of the true place. In addition to the plain formula:

    - of the places 3 nodes from the true one the strongest of each quadrant is a rival, too: noise moves the top of a broad peak,
      and favours windows of higher contrast;
    - noise that the windows of a rival and of the true place share (correlation r of their scores) acts on both;
    - noise that a rival shares with a stronger one counts once: its factor has the exponent sqrt(1 - r^2);
    - the power of the noise in a window varies.
    """
    scores = _Scores.of(place.patch, sigma, length)
    rho, contrast, s = place.correlation, place.contrast, place.search
    e0, v0 = (float(f(1.0, place.patch.std())) for f in (scores.expected, scores.spread))
    rows, cols = (a.ravel() for a in np.indices(rho.shape) - s)
    others = np.flatnonzero(place.tops().ravel() & (np.hypot(rows, cols) > NEAR_NODES))
    ring = (_RING + s) @ np.array([len(rho), 1])
    rho, contrast = rho.ravel(), contrast.ravel()
    others = others[np.argsort(-rho[others], kind="stable")[:_RIVALS]]
    others = np.append(others, _strongest(scores, ring, rho, contrast, rows, cols, (e0, v0)))
    others = others[np.argsort(-scores.expected(rho[others], contrast[others]), kind="stable")]
    e, v = (f(rho[others], contrast[others]) for f in (scores.expected, scores.spread))
    r = np.clip(scores.shared(rows[others], cols[others]), -0.95, 0.9999)
    x = e0 + np.sqrt(v0) * _STEPS
    logs = log_ndtr((x[:, None] - e - r * np.sqrt(v) * _STEPS[:, None]) / np.sqrt(v * (1.0 - r**2)))
    between = scores.shared(*(a[others][:, None] - a[others] for a in (rows, cols)))
    common = np.clip(np.tril(between, -1).max(axis=1), 0.0, 1.0)
    logs = logs * np.sqrt(1.0 - common**2)
    return _integral(np.where(x >= least, np.exp(logs.sum(axis=1)), 0.0))


def _strongest(
    scores: _Scores,
    ring: NDArray[np.int64],
    rho: Array,
    contrast: Array,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    true: tuple[float, float],
) -> NDArray[np.int64]:
    """Of each quadrant of the ring the place that most often exceeds the true one (mean and variance given)."""
    e, v = (f(rho[ring], contrast[ring]) for f in (scores.expected, scores.spread))
    shared = scores.shared(rows[ring], cols[ring]) * np.sqrt(true[1] * v)
    margin = (e - true[0]) / np.sqrt(np.maximum(true[1] + v - 2.0 * shared, 1e-12))
    quadrant = np.floor(np.arctan2(rows[ring], cols[ring]) / (np.pi / 2.0))
    some = (np.flatnonzero(quadrant == q) for q in np.unique(quadrant))
    return np.array([ring[k[margin[k].argmax()]] for k in some])


def sixth_order_slopes(patch: Array) -> tuple[Array, Array]:
    """Derivatives (down, right) by differences over seven nodes (`twins_registration.node_slopes`)."""
    down, right = (node_slopes(patch[None], axis)[0] for axis in (1, 2))
    return down, right


def _integral(values: Array) -> float:
    """Of values at `_STEPS` under the standard normal density."""
    weight = np.exp(-0.5 * _STEPS**2)
    return float(np.sum(weight * values) / np.sum(weight))


def shift_covariance(
    patch: Array, sigma: float, length: float, slopes: tuple[Array, Array] | None = None
) -> Array:
    """Covariance (column, row), nodes^2, of a least-squares fit of shift, gain and offset: F^-1 S F^-1 restricted to the shift,
    F = B B^T, S = B C B^T, B = [dx, dy, 1, patch], all sums written out as matrices; infinite where F is singular. ``slopes``:
    derivatives of the patch along rows and columns; central differences by default.
    """
    n = len(patch)
    down, right = np.gradient(patch) if slopes is None else slopes
    b = np.stack([right.ravel(), down.ravel(), np.ones(n * n), patch.ravel()])
    scale = np.maximum(np.linalg.norm(b, axis=1), 1e-30)
    b = b / scale[:, None]
    f = b @ b.T
    if not np.linalg.cond(f) < 1e12:
        return np.full((2, 2), np.inf)
    axis = np.arange(n)
    if length == 0.0:
        s = f
    else:
        along = np.exp(-((axis[:, None] - axis) ** 2) / (2.0 * length**2))
        s = np.stack([(along @ row.reshape(n, n) @ along).ravel() for row in b]) @ b.T
    inverse = np.linalg.inv(f)
    return np.asarray(sigma**2 * (inverse @ s @ inverse)[:2, :2] / np.outer(scale[:2], scale[:2]))
