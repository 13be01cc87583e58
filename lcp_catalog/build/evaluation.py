"""Evaluation of candidates in every condition: detection probability, covariance of the match and
independence of the terrain around them, at several scales of the image.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32, Index
from ..catalog.schema import EVALUATED, LOCALIZABLE, UNIQUE, UNOCCLUDED, UNSHADOWED
from ..landmarks.corners import fill_missing
from ..landmarks.detection import detection_probability, least_rival, top_probability
from ..landmarks.error_model import ErrorModel, PatchErrors
from ..landmarks.localization import Registration, harris_response, lit_share, mean_lit_level
from ..landmarks.patches import halved, halved_changes, patches_of, through_optics
from ..landmarks.uniqueness import RING, SearchImages, other_places, searched_exactly
from .config import BuildConfig
from .patch_light import PatchLight
from .place_errors import PlaceErrors
from .sweep import RenderedImage, Sweep

_DOUBT = 0.03, 0.07
"""Detection probabilities so far below and above the limit are computed again with a search at full
resolution. The first search can miss places; it then states too much."""

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
    light = PatchLight(sweep, rows, cols, config.points.half)
    for view in range(len(sweep.conditions.off_nadir_deg)):
        hidden = light.occlusion_dependence(view)
        result.occlusion_dependence[:, view] = hidden[:, None, None]
    judge = _Judge(light, config, gsd_m, errors)
    for (elevation, azimuth), images in groupby(sweep.images(sensitivity=True), lambda i: i.sun):
        share, cast = light.shadow_dependence(elevation, azimuth)
        at = (slice(None), slice(None), elevation, azimuth)
        result.shadow_dependence[at] = share[:, None]
        judge.sun(list(images), cast, result, at)
    never = ~sweep.conditions.reachable
    result.occlusion_dependence[:, :, never] = np.nan
    return result


_At = tuple[slice, slice, int, int]


class _Judge:
    """Evaluation of all candidates in all images of a Sun. An item is a candidate in an image; items
    are ordered by image, then by candidate.
    """

    def __init__(
        self, light: PatchLight, config: BuildConfig, gsd_m: float, errors: PlaceErrors
    ) -> None:
        self.light, self.points, self.gsd_m, self.errors = light, config.points, gsd_m, errors
        self.scales = image_scales(config.points.patch_nodes)

    def sun(
        self, images: list[RenderedImage], cast: NDArray[np.bool_], result: Evaluation, at: _At
    ) -> None:
        """Write the results of one Sun's images; ``cast`` (n, p, p): nodes that only terrain around a
        patch shadows.
        """
        points, (rows, cols, half) = self.points, self.light.where
        count, shape = len(rows), (len(images), len(rows))
        raw = np.stack([image.radiance for image in images])
        # hidden nodes: filled from their surroundings they have no texture, and they count as unlit
        filled = np.stack([fill_missing(image, 2 * half + 1) for image in raw])
        slopes = [_complete(np.stack(s)) for s in zip(*(i.slopes for i in images), strict=True)]
        items = _Items(
            np.repeat(np.arange(len(images)), count),
            np.tile(rows, len(images)),
            np.tile(cols, len(images)),
            half,
        )
        lit = lit_share(items.of(raw)) >= points.min_lit_share
        seen = items.of(filled)
        alone = self._alone(seen, images, cast)
        result.harris[at] = harris_response(seen).reshape(shape).T
        flags = np.full(shape, EVALUATED, dtype=np.uint8)
        sources = [filled, *slopes]
        for slot, scale in enumerate(self.scales):
            if scale > 1:
                change = halved_changes(alone - seen, items.rows, items.cols)
                items = items.halved()
                sources = [halved(source) for source in sources]
                seen = items.of(sources[0])
                alone = seen + change
            shown = [through_optics(sources[0], scale), *sources[1:]]
            blurred = items.of(shown[0])
            alone_blurred = blurred + through_optics(_complete(alone - seen), scale)
            found = self._at_scale(scale, shown, items, blurred, alone_blurred, lit)
            for part, values in (
                (result.detection, found.detection),
                (result.sigma_major_m, found.major_m),
                (result.sigma_minor_m, found.minor_m),
                (result.sigma_angle_deg, (found.angle_deg - self.light.turn_deg) % 180.0),
            ):
                part[(at[0], slot, *at[1:])] = values.reshape(shape).T
            if scale == 1:
                result.second_peak[at] = found.second_peak.reshape(shape).T
                result.false_match[at] = found.false_match.reshape(shape).T
                for values, flag in ((found.located, LOCALIZABLE), (found.detection, UNIQUE)):
                    flags |= _flagged(values >= points.min_detection, flag).reshape(shape)
        result.condition[at] = flags.T
        for share, flag in (
            (result.shadow_dependence[at], UNSHADOWED),
            (result.occlusion_dependence[at], UNOCCLUDED),
        ):
            result.condition[at] |= _flagged(share <= points.max_dependence, flag)

    def _alone(
        self, seen: Float32, images: list[RenderedImage], cast: NDArray[np.bool_]
    ) -> Float32:
        """The patches rendered from their own nodes alone: nodes that only terrain around the patch
        shadows are lit.
        """
        some = np.flatnonzero(cast.any(axis=(1, 2)))
        if not len(some):
            return seen
        alone = seen.copy()
        for number, image in enumerate(images):
            items = number * len(cast) + some
            lit = self.light.unshadowed(some, image)
            alone[items] = np.where(cast[some] & np.isfinite(lit), lit, seen[items])
        return alone

    def _at_scale(
        self,
        scale: int,
        sources: list[Float32],
        items: _Items,
        seen: Float32,
        alone: Float32,
        lit: NDArray[np.bool_],
    ) -> _Found:
        """Detection and covariance in images of a scale; ``sources``: radiance as the images show it,
        and its slope sensitivities, at that scale.
        """
        found = _Found.nothing(len(lit))
        level = mean_lit_level(alone)
        good = np.flatnonzero(lit & np.isfinite(level) & np.isfinite(seen).all(axis=(1, 2)))
        if not len(good):
            return found
        some, level = items.some(good), level[good]
        errors = PatchErrors(seen[good], *(some.of(source) for source in sources[1:]))
        pixel_m = scale * self.gsd_m
        models = self.errors.rows(good % len(self.errors.which))
        match = models.registration(alone[good], errors, pixel_m, level)
        search = max(1, self.points.search_nodes(self.gsd_m) // scale)
        images = SearchImages.of(sources[0], alone.shape[1])
        chances = _chances(match, images, alone[good], level, some, search)
        below, above = _DOUBT
        doubt = chances.detection - self.points.min_detection
        again = np.flatnonzero((doubt > -below) & (doubt < above))
        if len(again) and not searched_exactly(alone.shape[1], search):
            checked = _chances(
                match.rows(again), images, alone[good[again]], level[again], some.some(again),
                search, exact=True,
            )  # fmt: skip
            for part, values in zip(chances, checked, strict=True):
                part[again] = values
        found.detection[good], found.located[good] = chances.detection, chances.located
        found.second_peak[good], found.false_match[good] = chances.second_peak, chances.false_match
        bias = np.where(np.isfinite(match.bias), match.bias, 0.0)
        place = self.errors.models[0].position_sigma_m ** 2 * np.eye(2)
        covariance = match.covariance_px2 + bias[:, :, None] * bias[:, None]
        major, minor, angle = _ellipse(covariance * pixel_m**2 + place)
        found.major_m[good], found.minor_m[good], found.angle_deg[good] = major, minor, angle
        return found


def _complete(values: Float32) -> Float32:
    """The values, 0 where one is missing."""
    return values if np.isfinite(values.sum()) else np.nan_to_num(values)


class _Chances(NamedTuple):
    """Probabilities of patches, (n,) each: that a patch is found; that it is located, whatever is
    elsewhere; that another place is taken for it; and the highest correlation elsewhere.
    """

    detection: Array
    located: Array
    false_match: Array
    second_peak: Array


def _chances(
    match: Registration,
    images: SearchImages,
    patches: Float32,
    level: Array,
    items: _Items,
    search: int,
    exact: bool = False,
) -> _Chances:
    """The probabilities of patches of images in a search of +-``search`` pixels."""
    others = other_places(
        images, patches, items.rows, items.cols, search, items.which,
        least_rival(match, match.own), exact=exact,
    )  # fmt: skip
    unit = level[:, None]
    detection, located, unique = detection_probability(
        match, others.correlation, others.contrast / unit, match.own
    )
    on_top = top_probability(match, RING, others.near, others.near_contrast / unit, match.own)
    return _Chances(
        detection * on_top, located, 1.0 - unique * on_top, np.fmax(others.correlation[:, 0], -1.0)
    )


def _flagged(which: NDArray[np.bool_], flag: int) -> NDArray[np.uint8]:
    """The flag where ``which`` is true, else 0."""
    return np.where(which, flag, 0).astype(np.uint8)


@dataclass(frozen=True)
class _Items:
    """Patches of images: the image (n,) of each, the row and column of its middle, and the nodes from
    there to its edge.
    """

    which: Index
    rows: Index
    cols: Index
    half: int

    def of(self, images: Float32) -> Float32:
        """The patches (n, p, p) of images (k, rows, cols)."""
        return patches_of(images, self.which, self.rows, self.cols, self.half)

    def some(self, chosen: Index) -> _Items:
        """A selection of the items."""
        return _Items(self.which[chosen], self.rows[chosen], self.cols[chosen], self.half)

    def halved(self) -> _Items:
        """The same places in images at half the resolution."""
        return _Items(self.which, self.rows // 2, self.cols // 2, self.half // 2)


@dataclass(frozen=True)
class _Found:
    """Results of items at one scale, (n,) each."""

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


def _ellipse(covariance: Array) -> tuple[Array, Array, Array]:
    """1 sigma along the major and minor axis and the major axis' angle, degrees clockwise from north,
    0..180, of covariances (n, 2, 2) of columns (east) and rows (south); infinite and NaN for
    infinite ones.
    """
    xx, yy, xy = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 0, 1]
    finite = np.isfinite(xx) & np.isfinite(yy) & np.isfinite(xy)
    xx, yy, xy = (np.where(finite, part, 0.0) for part in (xx, yy, xy))
    middle, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    major, minor = (
        np.where(finite, np.sqrt(np.maximum(value, 0.0)), np.inf)
        for value in (middle + apart, middle - apart)
    )
    # the axis (cos t, sin t) of columns and rows has tan 2t = 2 xy / (xx - yy)
    east_of = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    angle = (np.degrees(east_of) + 90.0) % 180.0
    return major, minor, np.where(finite, angle, np.nan)
