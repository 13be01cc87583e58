"""Fit of the error model to images: from the residuals of points that were found.

For each point the image is resampled to the nodes of its patch at the place where it was found, the
patch is rendered alone, and the best gain and offset are removed. What is left, relative to gain
times mean signal, is a sample of the model's noise. Its covariances at lags of up to `LAGS` nodes are
linear in the variances of the model's sources:

    E[e(r) e(r + d)] = s_h^2 (A_pp(d) c_xx(d) + 2 A_pq(d) c_xy(d) + A_qq(d) c_yy(d))
                       + s_a^2 A_II(d) c_a(d) + s_n^2 [d = 0]

with A the mean products of the patches' slope sensitivities and radiances at that lag, and c the
unit covariances of `landmarks.error_model`, less their means over a patch, because an offset is
removed. For a grid of correlation lengths the variances follow from non-negative least squares; the
lengths with the least misfit are taken. Images under several Suns separate height errors, which
change with the Sun, from unmapped brightness, which does not.
"""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import tomli_w

from ..arrays import AnyArray, Array, Float32, Index, Mask
from ..cameras.sensor import ground_errors_m
from ..catalog.catalogue import Catalog
from ..catalog.patch_terrain import nodes_mcmf, patch_terrain
from ..catalog.schema import DETECTION_STEP
from ..errors import ImageError
from ..images.image import Image
from ..landmarks.detection import shifted
from ..landmarks.error_model import ErrorModel, PatchErrors, local_contrast
from ..landmarks.localization import registration
from ..landmarks.patches import through_optics
from ..landmarks.point_spread import within_border
from ..photometry.laws import SLOPE_STEP, Reflectance, planes_of, radiance_of_nodes, steeper
from .claims import Claims
from .orthoimage import orthorectify

log = logging.getLogger(__name__)

LAGS = 6
"""Largest lag, nodes, of the covariances that are fitted."""

HEIGHT_LENGTHS = np.geomspace(0.35, 3.0, 14)
"""Correlation lengths of height errors that are tried, in cells."""

ALBEDO_LENGTHS = np.geomspace(1.0, 8.0, 7)
"""Correlation lengths of unmapped brightness that are tried, in cells."""

FEWEST = 10
"""Least number of points for a fit."""

_OWN_GAIN = 0.5
_LEAST_PLACE_M = 1e-3
"""Errors of place below this are 0."""


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of n points found in one image: ``residual`` (n, p, p), relative to the patch's mean
    signal, 0 where the image has no valid pixel (``valid`` False); ``patches`` (n, p, p), the renders
    relative to their means; ``errors``, their sources of error; ``place_m`` (n, 2), the error of each
    place, metres east and south, NaN for points that were not found; ``pixel_m``, the cells' side;
    ``contrast`` (n,), local contrast of the albedo of the patches' ground, NaN without a map.
    """

    residual: Float32
    valid: Mask
    patches: Float32
    errors: PatchErrors
    place_m: Array
    pixel_m: float
    contrast: Array

    def __len__(self) -> int:
        return len(self.residual)


def residuals_of(
    catalog: Catalog, image: Image, rows: Index, found_px: Array, model: Reflectance
) -> Residuals:
    """Residuals of points (catalogue rows (n,)) at pixels (n, 2) of an image with a corrected sensor;
    NaN for a point that was searched for but not found, which is then compared where the sensor
    projects it: without these points the fit would see only the places where the model's errors are
    small. A point whose patch is not completely in the image is left out. Patches must have one
    cell size. ImageError if no point is left.

    The gain of a patch is its own if it correlates with the image by at least `_OWN_GAIN`, else the
    median of the others': the gain of a patch that hardly resembles the image is too small. Where all are
    such, it is the median ratio of their brightness.
    """
    some = [
        _sample(catalog, image, int(r), at, model) for r, at in zip(rows, found_px, strict=True)
    ]
    samples = [sample for sample in some if sample is not None]
    if not samples:
        raise ImageError(f"{image.name}: no point was found whose patch lies in the image")
    columns = [np.stack(column) for column in zip(*samples, strict=True)]
    light, valid, render, east, south, place, gain, contrast = columns
    clear = np.isfinite(gain)
    mean = [np.where(valid, x, 0.0).sum((1, 2)) / valid.sum((1, 2)) for x in (light, render)]
    gain = np.where(clear, gain, np.median(gain[clear] if clear.any() else mean[0] / mean[1]))
    difference = light / gain[:, None, None] - render
    difference -= (mean[0] / gain - mean[1])[:, None, None]
    return Residuals(
        np.where(valid, difference, 0.0).astype(np.float32),
        valid,
        render.astype(np.float32),
        PatchErrors(*(a.astype(np.float32) for a in (render, east, south))),
        place,
        float(np.median(catalog.gsd[rows])),
        contrast,
    )


def _sample(
    catalog: Catalog, image: Image, row: int, found_px: Array, model: Reflectance
) -> tuple[AnyArray, ...] | None:
    """Signal of the image, valid nodes, render and its sensitivities east and south, relative to its
    mean (p, p) each, error of place (2,), gain and local contrast of one point; NaN for unknown ones.
    """
    terrain = patch_terrain(catalog, row)
    origin, sensor = terrain.frame.origin_mcmf_m, image.sensor
    sun = terrain.frame.direction_from_mcmf(image.sun_directions(origin))
    view = terrain.frame.direction_from_mcmf(sensor.towards(origin))
    if not (sun[2] > 0.0 and view[2] > 0.0):
        return None
    normals = planes_of(terrain.field.normals(terrain.core))
    size = catalog.patch_nodes
    half = np.array([size // 2])
    dark = terrain.field.occluded_alone(half, half, size // 2, sun)[0].astype(np.uint8)
    hidden = np.zeros((size, size), np.bool_)
    bands = [radiance_of_nodes(normals, sun, view, dark, hidden, model)]
    for planes in steeper(normals):
        change = radiance_of_nodes(planes, sun, view, dark, hidden, model) - bands[0]
        bands.append(change / SLOPE_STEP)
    contrast = np.array(np.nan)
    if catalog.albedo is not None:
        contrast = local_contrast(catalog.albedo[row][None])[0]
        bands = [band * np.nan_to_num(catalog.albedo[row], nan=1.0) for band in bands]
    render, east, south = (np.nan_to_num(band).astype(np.float64) for band in bands)
    error = np.full(2, np.nan)
    if np.isfinite(found_px).all():
        offset = (np.asarray(found_px) - sensor.project(origin))[None]
        error = ground_errors_m(sensor, origin[None], terrain.frame.rotation[None], offset)[0]
    moved = np.nan_to_num(error) @ terrain.frame.rotation[:2]
    ortho = orthorectify(image, nodes_mcmf(catalog, [row])[0] + moved)
    valid = ortho.weight > 0.9
    level = float(render[render > 0.0].mean()) if (render > 0.0).any() else 0.0
    if valid.mean() < 0.9 or level <= 0.0:
        return None
    render, east, south = (band / level for band in (render, east, south))
    light = np.where(valid, ortho.signal, 0.0)
    a = np.where(valid, light - light[valid].mean(), 0.0)
    b = np.where(valid, render - render[valid].mean(), 0.0)
    both, power, bright = float((a * b).sum()), float((b * b).sum()), float((a * a).sum())
    if not (power > 0.0 and bright > 0.0):
        return None
    clear = both > _OWN_GAIN * math.sqrt(power * bright)
    gain = both / power if clear else math.nan
    return light, valid, render, east, south, error * [1.0, -1.0], np.array(gain), contrast


def fit_errors(samples: Sequence[Residuals], stated: ErrorModel) -> ErrorModel:
    """The error model with the least misfit to residuals of several images. ImageError for fewer
    than `FEWEST` points.

    Which part of the noise displaces matches, and the shift by shadows below a cell, are those of the model ``stated`` by
    the catalogue; the error of place is fitted with them, and as a whole, so that it has no least value in cells.
    """
    from scipy.optimize import nnls  # half a second, for few

    samples = [sample for sample in samples if len(sample)]
    if sum(len(sample) for sample in samples) < FEWEST:
        count = sum(len(sample) for sample in samples)
        raise ImageError(f"{count} points were found in the images, {FEWEST} are needed for a fit")
    moments = [_Moments.of(sample) for sample in samples]
    best = (math.inf, stated)
    cell = float(np.median([sample.pixel_m for sample in samples]))
    for height, albedo in itertools.product(HEIGHT_LENGTHS * cell, ALBEDO_LENGTHS * cell):
        design = np.concatenate([m.design(height, albedo) for m in moments])
        target = np.concatenate([m.target for m in moments])
        variances, misfit = nnls(design, target)
        if misfit < best[0]:
            sigmas = np.sqrt(variances)
            fitted = replace(
                stated,
                height_sigma_m=float(sigmas[0]), height_length_m=float(height),
                albedo_sigma=float(sigmas[1]), albedo_length_m=float(albedo),
                sensor_noise=float(sigmas[2]), position_sigma_cells=0.0,
            )  # fmt: skip
            best = (misfit, fitted)
    return _with_places(samples, _with_spread(samples, best[1]))


@dataclass(frozen=True, eq=False)
class _Moments:
    """Mean products at lags of the residuals of one image and of their sources; the half-plane of
    lags, weighted with the root of their share of pairs.
    """

    lags: Array
    weight: Array
    residual: Array
    east: Array
    cross: Array
    south: Array
    level: Array
    pixel_m: float
    nodes: int

    @classmethod
    def of(cls, sample: Residuals) -> _Moments:
        span = range(-LAGS, LAGS + 1)
        lags = [(i, j) for i in range(LAGS + 1) for j in span if i > 0 or j >= 0]
        rows = [_at_lag(sample, down, right) for down, right in lags]
        columns = np.array(rows).T
        scale = 1.0 / columns[0][0]  # an image with large residuals counts as much as another
        weight = scale * math.sqrt(len(sample)) * np.ones(len(lags))
        size = sample.residual.shape[1]
        where = np.array(lags, dtype=np.float64)
        residual, east, cross, south, level = columns
        return cls(where, weight, residual, east, cross, south, level, sample.pixel_m, size)

    @property
    def target(self) -> Array:
        return self.weight * self.residual

    def design(self, height_m: float, albedo_m: float) -> Array:
        """Columns of the variances of height, albedo and sensor noise."""
        h, span = self.pixel_m, self.nodes * self.pixel_m
        y, x = (self.lags * h).T
        wide = height_m**2 + h**2 / 6.0
        c = height_m**2 / wide * np.exp(-0.5 * (x**2 + y**2) / wide)
        heights = (
            c
            / wide
            * (
                self.east * (1.0 - x**2 / wide)
                + self.south * (1.0 - y**2 / wide)
                - self.cross * x * y / wide
            )
        )
        wide = albedo_m**2 + h**2 / 6.0
        c = albedo_m**2 / wide * np.exp(-0.5 * (x**2 + y**2) / wide)
        mean = _variance_of_mean(albedo_m, span)  # the offset removes the mean over the patch
        brightness = self.level * (c - mean)
        white = (self.lags == 0.0).all(axis=1).astype(np.float64)
        return np.stack([heights, brightness, white], axis=1) * self.weight[:, None]


def _variance_of_mean(length: float, side: float) -> float:
    """Variance of the mean over a square of a field with variance 1 and autocorrelation
    exp(-r^2 / 2 l^2): the square of (2 / s^2) times the integral of (s - u) exp(-u^2 / 2 l^2) from 0
    to the side s.
    """
    ratio = side / length
    whole = math.sqrt(math.pi / 2.0) * ratio * math.erf(ratio / math.sqrt(2.0))
    return float((2.0 * (whole - 1.0 + math.exp(-0.5 * ratio**2)) / ratio**2) ** 2)


def _at_lag(sample: Residuals, down: int, right: int) -> tuple[float, ...]:
    """Mean products over the pairs of nodes at a lag: residuals, east sensitivities, east with south
    (both ways), south, radiance.
    """
    size = sample.residual.shape[1]
    first = np.s_[:, : size - down, max(0, -right) : size - max(0, right)]
    other = np.s_[:, down:, max(0, right) : size + min(0, right)]
    pairs = sample.valid[first] & sample.valid[other]
    count = max(int(pairs.sum()), 1)

    def product(a: Float32, b: Float32) -> float:
        return float(np.where(pairs, a[first] * b[other], 0.0).sum(dtype=np.float64) / count)

    e = sample.errors
    return (
        product(sample.residual, sample.residual),
        product(e.east, e.east),
        product(e.east, e.south) + product(e.south, e.east),
        product(e.south, e.south),
        product(e.level, e.level),
    )


def _with_spread(samples: Sequence[Residuals], model: ErrorModel) -> ErrorModel:
    """The model with the spread of the noise between places, from the residuals' variances over those
    of the model: half of the robust standard deviation of the logarithm of their ratios.
    """
    ratios = []
    for sample in samples:
        match = registration(sample.patches, sample.errors, model, sample.pixel_m)
        measured = np.square(sample.residual).sum(axis=(1, 2)) / sample.valid.sum(axis=(1, 2))
        ratios.append(0.5 * np.log(measured / match.noise_variance))
    low, high = np.percentile(np.concatenate(ratios), [15.87, 84.13])
    return replace(model, spread=float(0.5 * (high - low)))


def _with_places(samples: Sequence[Residuals], model: ErrorModel) -> ErrorModel:
    """The model with the error of place at which the median of the places' squared errors over their
    covariances is that of chi-squared; 0 if it is below that without. The covariances are those that a catalogue
    claims: of patches through the optics, and of the part of the noise that displaces matches.
    """
    places = np.concatenate([sample.place_m for sample in samples])
    placed = np.isfinite(places).all(axis=1)
    covariances = np.concatenate([_claimed_m2(sample, model) for sample in samples])
    places, covariances = places[placed], covariances[placed]
    if not len(places):
        return model
    low, high = 0.0, 10.0 * float(np.sqrt(np.square(places).mean())) + 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        whole = covariances + middle**2 * np.eye(2)
        error = np.einsum("ni,nij,nj->n", places, np.linalg.inv(whole), places)
        if np.median(error) > 2.0 * math.log(2.0):  # the median of chi-squared with 2 degrees
            low = middle
        else:
            high = middle
    return replace(model, position_sigma_m=high if high > _LEAST_PLACE_M else 0.0)


def _claimed_m2(sample: Residuals, model: ErrorModel) -> Array:
    """Covariances (n, 2, 2) of the matches, m^2, as a catalogue claims them, without the error of place."""
    shown = within_border(through_optics(sample.patches, 1))
    east, south = (within_border(part) for part in (sample.errors.east, sample.errors.south))
    match = registration(shown, PatchErrors(shown, east, south), model, sample.pixel_m)
    moved = model.moving(sample.contrast)[:, None, None]
    return np.asarray(moved * match.covariance_px2 * sample.pixel_m**2)


_SHIFT_SIGMA = 0.5
"""1 sigma, probits, of the shift of a kind of images before its trials are known; points of an image fail together, so that
they say less than as many independent ones. It was 0.35 for the maps of Apollo 16 and 0 for simulated frames."""

_SHIFT_MOST = 2.0
"""Greatest change of the shift that is tried, probits."""


def fitted_shift(claims: Claims, stated: float) -> float:
    """`ErrorModel.detection_shift` with which the probabilities of a catalogue are those of its trials in images of a kind:
    the most likely change of the ``stated`` one, with a normal prior of `_SHIFT_SIGMA`. It belongs to the catalogue's
    other errors: where these are fitted anew, fit again to a catalogue that is built with them.
    """
    from scipy.optimize import minimize_scalar

    tried = claims.tried & claims.claimed
    if not tried.any():
        return stated
    least = DETECTION_STEP / 2.0
    p = np.clip(claims.probability[tried], least, 1.0 - least)
    found = claims.found[tried]

    def misfit(change: float) -> float:
        chance = np.clip(shifted(p, change), 1e-9, 1.0 - 1e-9)
        trials = -np.log(np.where(found, chance, 1.0 - chance)).sum()
        return float(trials) + 0.5 * (change / _SHIFT_SIGMA) ** 2

    return stated + float(
        minimize_scalar(misfit, bounds=(-_SHIFT_MOST, _SHIFT_MOST), method="bounded").x
    )


def _at_ends(model: ErrorModel, stated: ErrorModel, samples: Sequence[Residuals]) -> list[str]:
    """The values of a fit that are at an end of what is tried, with their names; a length matters only with its sigma."""
    cell = float(np.median([sample.pixel_m for sample in samples if len(sample)]))
    change = abs(model.detection_shift - stated.detection_shift)
    ends = {
        "detection_shift": change > 0.999 * _SHIFT_MOST,  # a search within bounds ends just inside
        "height_length_m": model.height_sigma_m > 0.0
        and model.height_length_m in HEIGHT_LENGTHS[[0, -1]] * cell,
        "albedo_length_m": model.albedo_sigma > 0.0
        and model.albedo_length_m in ALBEDO_LENGTHS[[0, -1]] * cell,
    }
    return [f"{name} {getattr(model, name):.{DIGITS}g}" for name, is_at in ends.items() if is_at]


DIGITS = 4
"""Significant digits of a value in the file; a fit is not more precise."""


@dataclass(frozen=True)
class FittedErrors:
    """An error model, the number of points that it was fitted to, and the names of their images, all of one kind
    (`Sensor.kind`).
    """

    kind: str
    model: ErrorModel
    points: int
    images: tuple[str, ...]

    def to_toml(self) -> str:
        """The section ``[errors]`` of a BUILD.toml; equal models give equal text."""
        values = {name: float(f"{v:.{DIGITS}g}") for name, v in self.model.to_dict().items()}
        names = ", ".join(_plain(name) for name in self.images)
        source = f"{self.points} points searched for in {names} ({self.kind})"
        return f"# fitted to {source}\n" + tomli_w.dumps({"errors": values})


def fitted_by_kind(
    samples: Sequence[tuple[str, str, Residuals, Claims]], stated: ErrorModel
) -> tuple[FittedErrors, ...]:
    """A model for each kind of images, by the number of points; ``samples``: kinds, names, residuals and tried claims of images.
    A map, a scanner and a camera differ from renders in other ways. ImageError if no kind has `FEWEST` points.
    """
    kinds = dict.fromkeys(kind for kind, *_ in samples)
    found = []
    for kind in kinds or [""]:
        own = [(name, sample, claims) for its, name, sample, claims in samples if its == kind]
        points = sum(len(sample) for _, sample, _ in own)
        if points < FEWEST and len(kinds) > 1:
            log.warning("%s: %d points are too few for a fit", kind, points)
            continue
        model = fit_errors([sample for _, sample, _ in own], stated)
        shift = fitted_shift(Claims.pooled([claims for *_, claims in own]), stated.detection_shift)
        model = replace(model, detection_shift=shift)
        if ends := _at_ends(model, stated, [sample for _, sample, _ in own]):
            why = "these images do not tell it, or some do not belong to the catalogue"
            log.warning("%s: %s at an end of what is tried: %s", kind, ", ".join(ends), why)
        found.append(FittedErrors(kind, model, points, tuple(name for name, *_ in own)))
    if not found:
        total = sum(len(sample) for _, _, sample, _ in samples)
        raise ImageError(
            f"{total} points of {len(kinds)} kinds of images are too few for a fit: {FEWEST} of a kind are needed"
        )
    return tuple(sorted(found, key=lambda one: -one.points))


def _plain(name: str) -> str:
    """A file's name without line ends and other control characters, for a comment."""
    return "".join(c if c.isprintable() else "?" for c in name)
