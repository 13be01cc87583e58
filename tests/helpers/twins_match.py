"""Slow, plain versions of the matcher's parts, and catalogues of any patches for their tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.photometry.laws import DEFAULT_MODEL, Reflectance, photometry
from lcp_catalog.terrain.heightfield import Heightfield

from .catalogs import HADLEY, catalog, unevaluated
from .one_patch import sample_patch


def catalog_of_patches(
    patches: np.ndarray, frames: Sequence[EnuFrame], gsd_m: float, **changes
) -> Catalog:
    """A catalogue of given patches (n, p, p), each in its own frame, without claims; other fields by name."""
    n = len(frames)
    made = {
        "dem": patches,
        "gsd": np.full(n, gsd_m),
        "position_mcmf": np.array([f.origin_mcmf_m for f in frames]).reshape(-1, 3),
        "rotation_mcmf_to_enu": np.array([f.rotation for f in frames]).reshape(-1, 3, 3),
        "longitude": np.array([f.lon_deg % 360.0 for f in frames]),
        "latitude": np.array([f.lat_deg for f in frames]),
        "elevation": np.array([f.height_m for f in frames]),
        "gsd_min": np.full(n, 0.05 * gsd_m),
        "gsd_max": np.full(n, 4.0 * gsd_m),
    }
    return catalog(n, patches.shape[1], **(unevaluated(n) | made | changes))


def catalog_of_dem(
    lon: np.ndarray, lat: np.ndarray, size: int, gsd_m: float, dem: Path | str = HADLEY
) -> Catalog:
    """Patches of real terrain around given places, good or bad as control points."""
    dems = DemSet.open([dem], ())
    cut = [
        sample_patch(dems, float(o), float(a), size, gsd_m) for o, a in zip(lon, lat, strict=True)
    ]
    return catalog_of_patches(np.array([p.z_m for p in cut]), [p.frame for p in cut], gsd_m)


def looking_at(
    frame: EnuFrame,
    away_m: float,
    off_nadir_deg: float,
    azimuth_deg: float,
    roll_deg: float,
    focal_px: float,
    size: tuple[int, int],
    middle: tuple[float, float] | None = None,
) -> Camera:
    """A camera ``away_m`` from a frame's origin, which it sees at the pixel ``middle`` (default: of
    the image).
    """
    off, azimuth, roll = np.radians([off_nadir_deg, azimuth_deg, roll_deg])
    up = np.array([np.sin(off) * np.sin(azimuth), np.sin(off) * np.cos(azimuth), np.cos(off)])
    ahead = -frame.direction_to_mcmf(up)
    right = np.cross(ahead, frame.direction_to_mcmf([0.0, 1.0, 0.0]))
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    rows = np.array(
        [
            np.cos(roll) * right + np.sin(roll) * down,
            np.cos(roll) * down - np.sin(roll) * right,
            ahead,
        ]
    )
    width, height = size
    middle = ((width - 1) / 2, (height - 1) / 2) if middle is None else middle
    return Camera(frame.to_mcmf(up * away_m), rows, focal_px, middle, size, name="made up")


def traced_image(
    heights: np.ndarray,
    gsd_m: float,
    frame: EnuFrame,
    camera: Camera,
    sun_enu: np.ndarray,
    window: tuple[int, int, int, int],
    rays: int,
    model: Reflectance = DEFAULT_MODEL,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean radiance, and the share of rays that meet the patch, of pixels (first column, first row, columns, rows), each
    ``rays`` x ``rays`` exact rays: hits, shadows and interpolated normals of `Heightfield`.
    """
    half = heights.shape[0] // 2
    field = Heightfield(heights, gsd_m, -half * gsd_m, half * gsd_m)
    col0, row0, cols, rows = window
    steps = (np.arange(rays) + 0.5) / rays - 0.5
    x = (col0 + np.arange(cols)[:, None] + steps).ravel()
    y = (row0 + np.arange(rows)[:, None] + steps).ravel()
    pixels = np.stack(np.meshgrid(x, y), axis=-1)
    origin = frame.from_mcmf(camera.position_mcmf_m)
    ahead = frame.direction_from_mcmf(camera.rays(pixels))
    away = field.first_hits(origin, ahead)
    met = np.isfinite(away)
    points = origin + np.where(met, away, 0.0)[..., None] * ahead
    light = np.full(met.shape, np.nan)
    hits = points[met]
    normals = field.normals_at(hits[:, 0], hits[:, 1])
    lit = ~field.occluded_points(hits, sun_enu)
    bands = photometry(normals, sun_enu, -ahead[met], lit, np.ones(len(hits), bool), model)
    light[met] = bands.radiance
    blocks = light.reshape(rows, rays, cols, rays)
    seen = np.isfinite(blocks)
    share = seen.mean(axis=(1, 3))
    total = np.where(seen, blocks, 0.0).sum(axis=(1, 3))
    return total / np.maximum(seen.sum(axis=(1, 3)), 1), share


# -- the search, place by place


def correlation_at(
    image: np.ndarray, values: np.ndarray, mask: np.ndarray, row: int, col: int
) -> float:
    """Correlation of the masked part with an image's pixels, the template's first pixel at (row,
    col).
    """
    at = np.argwhere(mask) + np.array([row, col])
    return float(np.corrcoef(image[tuple(at.T)].astype(np.float64), values[mask])[0, 1])


def correlations_near(
    image: np.ndarray,
    weight: np.ndarray,
    values: np.ndarray,
    mask: np.ndarray,
    origin: tuple[int, int],
    reach: int,
    least_real: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Correlations, and shares of valid pixels under the mask, at every offset (2 reach + 1 rows,
    columns) from a first pixel at ``origin`` (column, row); NaN where the masked part leaves the
    image, the correlation also where too few pixels are valid.
    """
    score, real = (np.full((2 * reach + 1,) * 2, np.nan) for _ in range(2))
    covered = np.argwhere(mask)
    for down, right in np.ndindex(score.shape):
        row, col = origin[1] + down - reach, origin[0] + right - reach
        at = covered + np.array([row, col])
        if (at < 0).any() or (at >= image.shape).any():
            continue
        real[down, right] = weight[tuple(at.T)].mean()
        if real[down, right] >= least_real - 1e-9:
            score[down, right] = correlation_at(image, values, mask, row, col)
    return score, real


def sought(
    image: np.ndarray,
    weight: np.ndarray,
    values: np.ndarray,
    mask: np.ndarray,
    origin: tuple[int, int],
    reach: int,
    exclusion: float,
    least_real: float,
    most: int,
) -> np.ndarray:
    """Result of `kernels.matching.search.find_templates` for one template, by a loop over every place: its
    rival is the highest of the ``most`` highest maxima (none of the eight places around is higher)
    farther than ``exclusion`` from the best.
    """
    score, real = correlations_near(image, weight, values, mask, origin, reach, least_real)
    shares = [np.isfinite(real).mean(), np.nanmax(real)]
    around = np.pad(np.nan_to_num(score, nan=-2.0), 1, constant_values=-2.0)
    highest = np.lib.stride_tricks.sliding_window_view(around, (3, 3)).max(axis=(2, 3))
    tops = np.argwhere((score > 0.0) & (score >= highest))
    tops = tops[np.argsort(-score[tuple(tops.T)])][:most]
    best = tops[0]
    away = tops[np.hypot(*(tops - best).T) > exclusion]
    second = score[tuple(away[0])] if len(away) else np.nan
    return np.array([best[1] - reach, best[0] - reach, score[tuple(best)], second, *shares])


def at_half(
    values: np.ndarray, mask: np.ndarray, odd: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Means over blocks of 2 x 2 of the masked pixels, and the masked share of each block; with
    ``odd`` the first row and column are the second of a block.
    """
    sides = [(o, (o + n) % 2) for o, n in zip(odd, values.shape, strict=True)]
    covered = np.pad(mask.astype(float), sides)
    total = np.pad(np.where(mask, values, 0.0), sides)
    rows, cols = (n // 2 for n in covered.shape)
    covered, total = (a.reshape(rows, 2, cols, 2).sum(axis=(1, 3)) for a in (covered, total))
    return total / np.maximum(covered, 1.0), covered / 4.0


# -- the fraction of a pixel, and the way back


@dataclass(frozen=True)
class Placed:
    """Result of least squares for a place: see `kernels.matching.subpixel_fit.refine`."""

    covariance: np.ndarray  # (3,) xx, xy, yy
    correlation: float
    gain: float
    noise: float
    likeness: float


def newey_west(drawn: np.ndarray, image: np.ndarray, weight: np.ndarray) -> Placed:
    """The covariance of the shift of a template with its slopes (3, rows, cols) in an image of its
    size: every pair of pixels up to 7 apart either way, with Bartlett's taper in both directions
    (docs/measurements/matching-and-pose.md).
    """
    t, gx, gy, light = (a - np.average(a, weights=weight) for a in (*drawn.astype(float), image))
    total = [float((weight * a * b).sum()) for a, b in ((t, light), (t, t), (light, light))]
    gain, correlation = total[0] / total[1], total[0] / np.sqrt(total[1] * total[2])
    slopes = [g - t * (weight * g * t).sum() / total[1] for g in (gx, gy)]
    at = np.argwhere(weight > 0.0)
    w = weight[tuple(at.T)]
    a = np.stack([gain * g[tuple(at.T)] * w for g in slopes], axis=-1)
    rest = (light - gain * t)[tuple(at.T)] * w
    apart = at[:, None] - at[None]
    near = (np.abs(apart) <= 7).all(-1)
    lags = np.where(near, (apart[..., 0] + 7) * 15 + apart[..., 1] + 7, 225)
    pairs, both = (
        np.bincount(lags.ravel(), np.outer(v, v).ravel(), minlength=226) for v in (w, rest)
    )
    here = both / np.maximum(pairs, 1e-300)
    white = here[112] * len(at) / (len(at) - 4.0)
    share = (1.0 - np.abs(apart) / 8.0).prod(-1)
    known = np.where(near, share * here[lags], 0.0)
    known[np.arange(len(at)), np.arange(len(at))] = white
    inverse = np.linalg.inv(a.T @ a)
    covariance = inverse @ (a.T @ known @ a) @ inverse
    least = white * inverse
    if not ((np.diag(covariance) > np.diag(least)).all() and np.linalg.det(covariance) > 0.0):
        covariance = least
    likeness = 0.5 * (here[113] + here[127]) / white
    covariance = covariance * (1.0 + 3.0 * min(max(likeness, 0.0), 1.0))
    three = np.array([covariance[0, 0], covariance[0, 1], covariance[1, 1]])
    return Placed(three, correlation, gain, float(np.sqrt(white)), likeness)


def way_back(
    values: np.ndarray,
    mask: np.ndarray,
    image: np.ndarray,
    weight: np.ndarray,
    place: tuple[int, int],
    inner: float,
    reach: int,
    least_real: float,
) -> np.ndarray:
    """Result of `kernels.matching.backward_search.find_backwards` for one template: the image's inner
    part, correlated with the template (its mean outside its mask) at every place; the best one by
    parabolas along both axes.
    """
    (r0, c0), (r1, c1) = np.argwhere(mask).min(0), np.argwhere(mask).max(0) + 1
    values, mask = values[r0:r1, c0:c1], mask[r0:r1, c0:c1]
    filled = np.where(mask, values, values[mask].mean())
    cut = [int(0.5 * (1.0 - inner) * n) for n in mask.shape]
    box = tuple(slice(k, n - k) for k, n in zip(cut, mask.shape, strict=True))
    at = np.argwhere(mask[box]) + cut
    there = at + np.array([place[1] + r0, place[0] + c0])
    known = weight[tuple(there.T)] > 0.0
    at, chip = at[known], image[tuple(there[known].T)].astype(float)
    score = np.full((2 * reach + 1,) * 2, -2.0)
    for down, right in np.ndindex(score.shape):
        off = np.array([down, right]) - reach
        if (np.abs(off) > cut).any():
            continue
        under = tuple((at + off).T)
        if mask[under].mean() >= least_real - 1e-9:
            score[down, right] = np.corrcoef(chip, filled[under])[0, 1]
    i, j = (int(k) for k in np.unravel_index(score.argmax(), score.shape))
    best = score[i, j]
    if best <= 0.0:
        return np.full(3, np.nan)
    places = [i - reach, j - reach]
    padded = np.pad(score, 1, constant_values=-2.0)
    for axis, (a, b) in enumerate(
        ((padded[i, j + 1], padded[i + 2, j + 1]), (padded[i + 1, j], padded[i + 1, j + 2]))
    ):
        if a > -2.0 and b > -2.0:
            places[axis] += 0.5 * (a - b) / (a - 2.0 * best + b)
    return np.array([places[1], places[0], best])
