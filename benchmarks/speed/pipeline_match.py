"""The statistics of a match in plain NumPy and OpenCV, for the straightforward pipeline: rivals by
cv2.matchTemplate, covariance and detection probability by the formulas of `landmarks.localization`,
`landmarks.error_model` and `landmarks.detection`, batched over the patches of an image.

Nothing here uses the library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from scipy.special import ndtr

RIVALS, EXCLUSION = 64, 2.0
LEAST_CORRELATION = 0.3
LEAST_VARIANCE = 1e-12
CLEAR_BY = 0.2 * 0.8416212335729143
"""Joint sigmas by which the true place must be higher: a fifth of those with which a mistake is less probable than 0.2."""
BORDER_PX = 1.8993
"""How much narrower than its patch a template is."""
STEPS = np.linspace(-5.0, 5.0, 61)
QUADRATURE, WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
WEIGHTS = WEIGHTS / WEIGHTS.sum()
TURNS = np.arange(16) * np.pi / 8.0
RING = np.unique(np.rint(5.0 * np.stack([np.cos(TURNS), np.sin(TURNS)], 1)).astype(int), axis=0)


def windows(image: np.ndarray, rows: np.ndarray, cols: np.ndarray, half: int) -> np.ndarray:
    """The squares around nodes that lie at least ``half`` nodes inside the image, (n, p, p)."""
    views = np.lib.stride_tricks.sliding_window_view(image, (2 * half + 1, 2 * half + 1))
    return np.asarray(views[rows - half, cols - half])


# -- rivals


@dataclass(frozen=True)
class Searched:
    """Correlation and contrast of the other maxima (n, 64), NaN where there are fewer, and of the
    places of `RING` (n, 16)."""

    rivals: np.ndarray
    contrast: np.ndarray
    near: np.ndarray
    near_contrast: np.ndarray


def search(
    image: np.ndarray, templates: np.ndarray, rows: np.ndarray, cols: np.ndarray, reach: int
) -> Searched:
    """Full-resolution search for each template around its own place in the image it belongs to."""
    n, p = templates.shape[:2]
    half = p // 2
    level = image - np.float32(image.mean(dtype=np.float64))
    mean = cv2.boxFilter(level, cv2.CV_64F, (p, p))
    square = cv2.sqrBoxFilter(level, cv2.CV_64F, (p, p))
    variance = square - mean * mean
    deviation = np.sqrt(np.where(variance > 1e-6 * level.var(), variance, 0.0))
    out = [np.full((n, count), np.nan) for count in (RIVALS, RIVALS, len(RING), len(RING))]
    flat = templates.std(axis=(1, 2)) <= 1e-3 * level.std()
    for k in range(n):
        if flat[k]:
            out[0][k, 0], out[1][k, 0] = 1.0, templates[k].std()
        _one(level, deviation, templates[k], (rows[k], cols[k], half, reach), flat[k], k, out)
    return Searched(*out)


def _one(
    image: np.ndarray,
    deviation: np.ndarray,
    template: np.ndarray,
    place: tuple[int, int, int, int],
    flat: bool,
    k: int,
    out: list[np.ndarray],
) -> None:
    row, col, half, reach = place
    top, left = max(row - reach, half), max(col - reach, half)
    bottom = min(row + reach, image.shape[0] - half - 1)
    right = min(col + reach, image.shape[1] - half - 1)
    part = image[top - half : bottom + half + 1, left - half : right + half + 1]
    score = cv2.matchTemplate(part, template, cv2.TM_CCOEFF_NORMED)
    spread = deviation[top : bottom + 1, left : right + 1]
    score[spread == 0.0] = 0.0
    if not flat:
        peaks = score >= cv2.dilate(score, np.ones((3, 3), np.uint8))
        down, across = np.nonzero(peaks)
        away = (down + top - row) ** 2 + (across + left - col) ** 2 > EXCLUSION**2
        down, across = down[away], across[away]
        best = np.argsort(-score[down, across], kind="stable")[:RIVALS]
        down, across = down[best], across[best]
        out[0][k, : len(best)], out[1][k, : len(best)] = score[down, across], spread[down, across]
    i, j = row + RING[:, 1] - top, col + RING[:, 0] - left
    inside = (i >= 0) & (j >= 0) & (i < score.shape[0]) & (j < score.shape[1])
    out[2][k, inside], out[3][k, inside] = score[i[inside], j[inside]], spread[i[inside], j[inside]]


# -- covariance


@lru_cache(maxsize=32)
def covariances(model: Any, nodes: int, pixel_m: float) -> tuple[np.ndarray, ...]:
    """Matrices (p, p) of the axes: value, first and second derivative of the height error, and the
    unmapped brightness."""
    lag = (np.arange(nodes)[:, None] - np.arange(nodes)) * pixel_m

    def gaussian(length: float) -> tuple[np.ndarray, float]:
        wide2 = length**2 + pixel_m**2 / 6.0
        return length / math.sqrt(wide2) * np.exp(-0.5 * lag**2 / wide2), wide2

    value, wide2 = gaussian(model.height_length_m)
    first, second = lag / wide2 * value, (1.0 - lag**2 / wide2) / wide2 * value
    parts = [model.height_sigma_m * part for part in (value, first, second)]
    parts.append(model.albedo_sigma * gaussian(model.albedo_length_m)[0])
    return tuple(without_tiny(part) for part in parts)


def without_tiny(values: np.ndarray) -> np.ndarray:
    """In single precision, 0 where 1e-12 of the largest is not reached: products with numbers near the
    smallest ones, 1e-38, take some processors a hundred times as long.
    """
    return np.where(np.abs(values) < 1e-12 * np.abs(values).max(), 0.0, values).astype(np.float32)


def slope(patches: np.ndarray, axis: int) -> np.ndarray:
    """Differences of the sixth order, of lower order near the edge."""
    z = np.moveaxis(patches, axis, 0)
    out = np.gradient(z, axis=0)
    out[2:-2] = (8.0 * (z[3:-1] - z[1:-3]) - (z[4:] - z[:-4])) / 12.0
    out[3:-3] = (45.0 * (z[4:-2] - z[2:-4]) - 9.0 * (z[5:-1] - z[1:-5]) + z[6:] - z[:-6]) / 60.0
    return np.moveaxis(out, 0, axis)


@dataclass(frozen=True)
class Match:
    """Statistics of n patches, as `landmarks.localization.Registration`."""

    contrast: np.ndarray
    noise: np.ndarray
    along: np.ndarray
    loss: np.ndarray
    covariance: np.ndarray
    slope_noise: np.ndarray
    bias: np.ndarray
    nodes: float


def registered(
    patches: np.ndarray,
    seen: np.ndarray,
    errors: tuple[np.ndarray, np.ndarray, np.ndarray],
    model: Any,
    pixel_m: float,
    cosine: float,
) -> Match:
    """Of patches (n, p, p) and the same as the image shows them, both over the patches' mean signal;
    errors: level and derivatives with respect to the slopes, (n, p, p) each; ``cosine`` of the emission angle."""
    n, p = patches.shape[:2]
    image = patches.astype(np.float64)
    centred = image - image.mean(axis=(1, 2), keepdims=True)
    power = (centred**2).sum(axis=(1, 2))
    textured = power > 1e-12 * p * p
    safe = np.where(textured, power, 1.0)
    unit = centred / np.sqrt(safe)[:, None, None]
    slopes = np.stack([slope(image, 2), slope(image, 1)], axis=1)
    loss = (slopes**2).sum(axis=(1, 2, 3)) / safe / 24.0
    slopes -= slopes.mean(axis=(2, 3), keepdims=True)
    slopes -= (slopes * unit[:, None]).sum(axis=(2, 3))[..., None, None] * unit[:, None]
    flat = np.full_like(unit, 1.0 / p)
    fields = np.concatenate([slopes, unit[:, None], flat[:, None]], axis=1).astype(np.float32)
    level, east, south = (part[:, None] for part in errors)
    value, first, second, albedo = covariances(model, p, pixel_m)
    by_east, by_south = fields * east, fields * south
    noise = np.float32(model.sensor_noise**2) * fields
    noise += east * (value @ by_east @ second.T + -first @ by_south @ first.T)
    noise += south * (second @ by_south @ value.T + -first @ by_east @ first.T)
    noise += level * (albedo @ (fields * level) @ albedo.T)
    rows, other = fields.reshape(n, 4, -1), noise.reshape(n, 4, -1)
    products = (rows @ other.transpose(0, 2, 1)).astype(np.float64)
    products = 0.5 * (products + products.transpose(0, 2, 1))
    steep, unmapped = float(value[0, 0] * second[0, 0]), float(albedo[0, 0] ** 2)
    squares = [np.mean(np.square(part, dtype=np.float64), axis=(1, 2)) for part in errors]
    variance = model.sensor_noise**2 + unmapped * squares[0] + steep * (squares[1] + squares[2])
    xx, yy, xy = ((slopes[:, a] * slopes[:, b]).sum((1, 2)) for a, b in ((0, 0), (1, 1), (0, 1)))
    determinant = xx * yy - xy * xy
    good = determinant > 1e-9 * (xx + yy) ** 2
    inverse = np.stack([yy, -xy, -xy, xx], -1).reshape(-1, 2, 2)
    inverse /= np.where(good, determinant, 1.0)[:, None, None]
    covariance = inverse @ products[:, :2, :2] @ inverse * math.exp(2.0 * model.spread**2)
    covariance[~good] = np.diag([np.inf, np.inf])
    moved = -inverse @ (slopes * (seen - patches)[:, None]).sum(axis=(2, 3))[..., None]
    return Match(
        contrast=np.sqrt(power / (p * p)),
        noise=np.maximum(variance - products[:, 3, 3] / (p * p), 0.0),
        along=np.where(textured, products[:, 2, 2], np.inf),
        loss=np.clip(loss, 0.0, 1.0),
        covariance=covariance,
        slope_noise=products[:, :2, :2] / safe[:, None, None],
        bias=np.where(good[:, None], moved[..., 0], 0.0),
        nodes=(p + 1.0 - BORDER_PX) * max((p + 1.0) * cosine - BORDER_PX, 1.0),
    )


# -- detection


def expected(contrast: Any, rho: Any, noise: Any, along: Any, nodes: float) -> tuple[Any, Any]:
    """Mean and variance of a correlation in noise."""
    total = np.square(contrast) + noise
    total = np.where(total > 0.0, total, 1.0)
    mean = rho * contrast / np.sqrt(total)
    variance = along / nodes / total * (1.0 - mean**2 * (1.0 + 0.5 * noise / total))
    return mean, np.maximum(variance, LEAST_VARIANCE)


def probabilities(
    match: Match, found: Searched, level: np.ndarray, own: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Of each patch: that it is found at its true place and nowhere else, and that its correlation
    there is high enough, (n,)."""
    rho = own * (1.0 - match.loss)
    some = np.isfinite(found.rivals).any(axis=0)
    rivals = raised(match, found.rivals, found.contrast / level[:, None], rho, spread)
    rivals = np.where(np.isnan(rivals), -99.0, rivals)[:, some]
    contrast = np.where(np.isnan(found.contrast), 1e9, found.contrast)[:, some] / level[:, None]
    bad = ~(match.contrast > 0.0) | ~np.isfinite(match.along)
    total = np.zeros((2, len(rho)))
    density = np.exp(-0.5 * STEPS**2)
    for at, weight in zip(QUADRATURE, WEIGHTS, strict=True):
        louder = math.exp(2.0 * spread * at)
        noise, along = match.noise * louder, np.where(bad, 1.0, match.along) * louder
        mean, variance = expected(match.contrast, rho, noise, along, match.nodes)
        theirs, theirs_variance = expected(
            contrast, rivals, noise[:, None], along[:, None], match.nodes
        )
        theirs += CLEAR_BY * np.sqrt(variance[:, None] + theirs_variance)
        sigma = np.sqrt(variance)
        x = mean[:, None] + STEPS * sigma[:, None]
        width = (STEPS[1] - STEPS[0]) * sigma
        passed = density * np.clip((x - LEAST_CORRELATION) / width[:, None] + 0.5, 0.0, 1.0)
        gaps = (x[:, :, None] - theirs[:, None]) / np.sqrt(theirs_variance)[:, None]
        above = ndtr(gaps).prod(axis=2)
        total += weight * np.stack([(passed * above).sum(1), passed.sum(1)]) / density.sum()
    total[:, bad] = 0.0
    return np.minimum(total[0], _on_top(match, found, level, own)) * settling(match), total[1]


def raised(
    match: Match, rivals: np.ndarray, contrast: np.ndarray, rho: np.ndarray, places: float
) -> np.ndarray:
    """Rivals with what noise raises them more than the true place, (n, k)."""
    power = match.contrast**2 + match.noise
    noise = match.slope_noise / (match.nodes * power)[:, None, None]
    known = np.isfinite(match.covariance).all(axis=(1, 2))
    roots = np.linalg.eigvals(np.where(known[:, None, None], match.covariance, 0.0) @ noise).real
    moved = np.sqrt(np.maximum(roots, 0.0)).sum(axis=1, keepdims=True) / math.exp(places**2)
    slope = np.sqrt(0.5 * np.trace(noise, axis1=1, axis2=2))[:, None]
    spread = np.sqrt(contrast**2 + match.noise[:, None])
    true = (rho * match.contrast / np.sqrt(power))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        steep = np.where(moved > 0.0, 1.4 * slope / moved, 0.0)
        height = np.clip(rivals * contrast / spread / true, 0.0, 1.0)
        falls = np.exp(-steep * height) - np.exp(-steep)
        more = 3.0 * slope * np.sqrt(power)[:, None] * falls / contrast
        return np.where(more > 0.0, np.minimum(rivals + more, spread / contrast), rivals)


def settling(match: Match) -> np.ndarray:
    """Probability that the fit to a fraction of a pixel ends near the peak: broad ones lose it."""
    finite = np.where(np.isfinite(match.covariance), match.covariance, 1e12)
    sigma = np.sqrt(np.linalg.eigvalsh(finite)[:, 1])
    return np.asarray(np.clip(1.0 - 0.3 * (sigma - 0.3), 0.0, 1.0))


def _on_top(match: Match, found: Searched, level: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Probability that noise does not move the top of the peak to a place of `RING`."""
    mean, variance = expected(match.contrast, own, match.noise, match.along, match.nodes)
    there, spread = expected(
        found.near_contrast / level[:, None], found.near, match.noise[:, None],
        match.along[:, None], match.nodes,
    )  # fmt: skip
    power = match.nodes * (match.contrast**2 + match.noise)
    apart = np.einsum("ka,nab,kb->nk", RING, match.slope_noise, RING) / power[:, None]
    apart = np.maximum(np.minimum(apart, variance[:, None] + spread), LEAST_VARIANCE)
    margin = (mean[:, None] - there) / np.sqrt(apart)
    least = np.where(np.isfinite(margin), margin, np.inf).min(axis=1)
    return np.asarray(ndtr(least))
