"""Evaluation of candidates in every condition: detection probability, covariance of the match and
independence of the terrain around them, at several scales of the image.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32
from ..catalog.schema import EVALUATED, LOCALIZABLE, UNIQUE, UNOCCLUDED, UNSHADOWED
from ..landmarks.corners import fill_missing
from ..landmarks.correlation import moments
from ..landmarks.detection import detection_probability, top_probability
from ..landmarks.error_model import ErrorModel, PatchErrors
from ..landmarks.localization import harris_response, lit_share, mean_lit_level, shift_bias
from ..landmarks.patches import gather_patches, halved, through_optics
from ..landmarks.uniqueness import RING, other_places, places_around
from .config import BuildConfig
from .patch_light import PatchLight
from .place_errors import PlaceErrors
from .sweep import RenderedImage, Sweep

SMALLEST_PX = 7
"""Fewest pixels a side of a patch in a coarser image."""


def image_scales(patch_nodes: int) -> tuple[int, ...]:
    """Cell sizes of the images that are simulated, as multiples of the patch's own: powers of 2 as
    long as a patch has `SMALLEST_PX` pixels a side.
    """
    scales = [1]
    while 2 * (patch_nodes // 2 // (2 * scales[-1])) + 1 >= SMALLEST_PX:
        scales.append(2 * scales[-1])
    return tuple(scales)


@dataclass(frozen=True)
class Evaluation:
    """Results by candidate and condition, NaN where not evaluated. ``detection``, ``sigma_major_m``,
    ``sigma_minor_m``, ``sigma_angle_deg`` (of the major axis, clockwise from north, 0..180):
    (n, image_scale, view, sun_elevation, sun_azimuth); the others (n, view, sun_elevation,
    sun_azimuth).
    """

    condition: NDArray[np.uint8]
    detection: Float32
    sigma_major_m: Float32
    sigma_minor_m: Float32
    sigma_angle_deg: Float32
    harris: Float32
    second_peak: Float32
    false_match: Float32
    shadow_dependence: Float32
    occlusion_dependence: Float32

    @classmethod
    def empty(cls, count: int, scales: int, shape: tuple[int, int, int]) -> Evaluation:
        """``count`` candidates without results."""
        condition = np.zeros((count, *shape), dtype=np.uint8)
        scaled = [np.full((count, scales, *shape), np.nan, dtype=np.float32) for _ in range(4)]
        rest = [np.full((count, *shape), np.nan, dtype=np.float32) for _ in range(5)]
        return cls(condition, *scaled, *rest)

    def with_rows(self, rows: NDArray[np.int64], other: Evaluation) -> Evaluation:
        """A copy in which the given candidates are taken from ``other``."""
        merged = []
        for f in dataclasses.fields(self):
            values = getattr(self, f.name).copy()
            values[rows] = getattr(other, f.name)
            merged.append(values)
        return Evaluation(*merged)


def evaluate(
    sweep: Sweep,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    config: BuildConfig,
    gsd_m: float,
    errors: ErrorModel | PlaceErrors,
) -> Evaluation:
    """Evaluate candidates at nodes (rows, cols) of the sweep's window in every condition that can occur;
    ``errors``: one model for all, or those of their places.
    """
    if isinstance(errors, ErrorModel):
        errors = PlaceErrors.alike(errors, len(rows))
    scales = image_scales(config.points.patch_nodes)
    result = Evaluation.empty(len(rows), len(scales), sweep.conditions.shape)
    if not len(rows):
        return result
    patches = PatchLight(sweep, rows, cols, config.points.half)
    hidden = [
        patches.occlusion_dependence(view) for view in range(len(sweep.conditions.off_nadir_deg))
    ]
    shaded: dict[tuple[int, int], tuple[Float32, NDArray[np.bool_]]] = {}
    for image in sweep.images(sensitivity=True):
        sun = (image.elevation, image.azimuth)
        if sun not in shaded:
            shaded[sun] = patches.shadow_dependence(*sun)
        at = (slice(None), image.view, image.elevation, image.azimuth)
        share, cast = shaded[sun]
        result.shadow_dependence[at] = share
        result.occlusion_dependence[at] = hidden[image.view]
        _Condition(image, patches, cast, config, gsd_m, errors).judge(result, at)
    return result


class _Condition:
    """One condition of all candidates."""

    def __init__(
        self,
        image: RenderedImage,
        patches: PatchLight,
        cast: NDArray[np.bool_],
        config: BuildConfig,
        gsd_m: float,
        errors: PlaceErrors,
    ) -> None:
        self.image, self.patches, self.cast = image, patches, cast
        self.points, self.gsd_m, self.errors = config.points, gsd_m, errors

    def judge(self, result: Evaluation, at: tuple[slice, int, int, int]) -> None:
        """Write the results of the condition."""
        points, (rows, cols, half) = self.points, self.patches.where
        raw = gather_patches(self.image.radiance, rows, cols, half)
        # hidden nodes: filled from their surroundings they have no texture, and they count as unlit
        filled = fill_missing(self.image.radiance, 2 * half + 1)
        sources = [filled, *(np.nan_to_num(slope) for slope in self.image.slopes)]
        seen = gather_patches(filled, rows, cols, half)
        alone = self._alone(seen)
        lit = lit_share(raw) >= points.min_lit_share
        result.harris[at] = harris_response(seen)
        flags = np.full(len(rows), EVALUATED, dtype=np.uint8)
        place = (rows, cols, half)
        for slot, scale in enumerate(image_scales(points.patch_nodes)):
            if scale > 1:
                change = _halved_change(alone - seen, place)
                place = (rows // scale, cols // scale, half // scale)
                sources = [halved(source) for source in sources]
                seen = gather_patches(sources[0], *place)
                alone = seen + change
            shown = [through_optics(sources[0], scale), *sources[1:]]
            blurred = gather_patches(shown[0], *place)
            alone_blurred = blurred + _blurred_patches(np.nan_to_num(alone - seen), scale)
            found = self._at_scale(scale, shown, place, blurred, alone_blurred, lit)
            column = (at[0], slot, *at[1:])
            result.detection[column] = found.detection
            result.sigma_major_m[column] = found.major_m
            result.sigma_minor_m[column] = found.minor_m
            result.sigma_angle_deg[column] = (found.angle_deg - self.patches.turn_deg) % 180.0
            if scale == 1:
                result.second_peak[at] = found.second_peak
                result.false_match[at] = found.false_match
                flags |= np.where(found.located >= points.min_detection, LOCALIZABLE, 0).astype(
                    np.uint8
                )
                flags |= np.where(found.detection >= points.min_detection, UNIQUE, 0).astype(
                    np.uint8
                )
        for name, flag in (("shadow", UNSHADOWED), ("occlusion", UNOCCLUDED)):
            share = getattr(result, f"{name}_dependence")[at]
            flags |= np.where(share <= points.max_dependence, flag, 0).astype(np.uint8)
        result.condition[at] = flags

    def _alone(self, seen: Float32) -> Float32:
        """The patches rendered from their own nodes alone: nodes that only terrain around the patch
        shadows are lit.
        """
        some = np.flatnonzero(self.cast.any(axis=(1, 2)))
        if not len(some):
            return seen
        alone = seen.copy()
        lit = self.patches.unshadowed(some, self.image)
        alone[some] = np.where(self.cast[some] & np.isfinite(lit), lit, seen[some])
        return alone

    def _at_scale(
        self,
        scale: int,
        sources: list[Float32],
        place: tuple[NDArray[np.int64], NDArray[np.int64], int],
        seen: Float32,
        alone: Float32,
        lit: NDArray[np.bool_],
    ) -> _Found:
        """Detection and covariance in an image of a scale; ``sources``: radiance as the image shows it,
        and its slope sensitivities, at that scale.
        """
        rows, cols, half = place
        found = _Found.nothing(len(rows))
        level = mean_lit_level(alone)
        good = np.flatnonzero(lit & np.isfinite(level) & np.isfinite(seen).all(axis=(1, 2)))
        if not len(good):
            return found
        unit = level[good][:, None, None]
        parts = [gather_patches(s, rows[good], cols[good], half) / unit for s in sources]
        errors = PatchErrors(*(np.asarray(part, dtype=np.float32) for part in parts))
        pixel_m = scale * self.gsd_m
        match = self.errors.rows(good).registration(alone[good] / unit, errors, pixel_m)
        search = max(1, self.points.search_nodes(self.gsd_m) // scale)
        rivals, spread = other_places(sources[0], alone[good], rows[good], cols[good], search)
        own = moments(*(a[good].reshape(len(good), -1) for a in (alone, seen))).correlation
        detection, located, unique = detection_probability(
            match, rivals, spread / level[good][:, None], own
        )
        near, contrast = places_around(sources[0], alone[good], rows[good], cols[good])
        on_top = top_probability(match, RING, near, contrast / level[good][:, None], own)
        detection, unique = detection * on_top, unique * on_top
        found.detection[good], found.located[good] = detection, located
        found.second_peak[good] = np.fmax(rivals[:, 0], -1.0)
        found.false_match[good] = 1.0 - unique
        bias = np.zeros((len(good), 2))
        shaded = np.flatnonzero((seen[good] != alone[good]).any(axis=(1, 2)))
        some = good[shaded]
        bias[shaded] = shift_bias(alone[some], seen[some] - alone[some])
        bias[np.isinf(match.covariance_px2).any(axis=(1, 2))] = 0.0
        major, minor, angle = _ellipse(
            (match.covariance_px2 + bias[:, :, None] * bias[:, None]) * pixel_m**2
            + self.errors.models[0].position_sigma_m ** 2 * np.eye(2)
        )
        found.major_m[good], found.minor_m[good], found.angle_deg[good] = major, minor, angle
        return found


@dataclass(frozen=True)
class _Found:
    """Results of one condition at one scale, (n,) each."""

    detection: Array
    located: Array
    second_peak: Array
    false_match: Array
    major_m: Array
    minor_m: Array
    angle_deg: Array

    @classmethod
    def nothing(cls, count: int) -> _Found:
        """Results of patches that are not found: infinite sigma, no angle."""
        blank = [0.0, 0.0, np.nan, np.nan, np.inf, np.inf, np.nan]
        return cls(*(np.full(count, value) for value in blank))


def _blurred_patches(patches: Float32, scale: int) -> Float32:
    """Patches (n, p, p) through the optics, each alone."""
    if not patches.any():
        return patches
    return np.stack([through_optics(patch, scale) for patch in patches])


def _halved_change(
    change: Float32, place: tuple[NDArray[np.int64], NDArray[np.int64], int]
) -> Float32:
    """Differences (n, p, p) from an image at the patches at ``place`` (rows, cols, half of p), at
    half their resolution, on the pixels of the image at half its resolution
    (`landmarks.patches.halved`); 0 beyond the patches.
    """
    rows, cols, fine = place
    size = 2 * (fine // 2) + 1
    out = np.zeros((len(change), size, size), dtype=np.float32)
    for k in np.flatnonzero(change.any(axis=(1, 2))):
        top, left = 1 + fine % 2 - rows[k] % 2, 1 + fine % 2 - cols[k] % 2
        part = np.pad(change[k], 1)[top : top + 2 * size, left : left + 2 * size]
        out[k] = part.reshape(size, 2, size, 2).mean(axis=(1, 3))
    return out


def _ellipse(covariance: Array) -> tuple[Array, Array, Array]:
    """1 sigma along the major and minor axis and the major axis' angle, degrees clockwise from north,
    0..180, of covariances (n, 2, 2) of columns (east) and rows (south); infinite and NaN for
    infinite ones.
    """
    finite = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    values, vectors = np.linalg.eigh(np.where(finite[:, None, None], covariance, np.eye(2)))
    sigma = np.where(finite[:, None], np.sqrt(np.maximum(values, 0.0)), np.inf)
    angle = np.degrees(np.arctan2(vectors[:, 0, 1], -vectors[:, 1, 1])) % 180.0
    return sigma[:, 1], sigma[:, 0], np.where(finite, angle, np.nan)
