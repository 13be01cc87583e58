"""Evaluation of candidates in every condition: detection probability, covariance of the match and
independence of the terrain around them, at several scales of the image.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..arrays import Array, Bytes, Float32, Index, Mask
from ..catalog.schema import EVALUATED, LOCALIZABLE, UNIQUE, UNOCCLUDED, UNSHADOWED
from ..geometry.ellipses import error_ellipses
from ..landmarks.corners import fill_missing
from ..landmarks.detection import detection_probability, least_rival, top_probability
from ..landmarks.error_model import ErrorModel
from ..landmarks.localization import Registration, harris_response, light_of
from ..landmarks.patches import halved, halved_changes, through_optics
from ..landmarks.uniqueness import RING, SearchImages, other_places, searched_exactly
from .config import BuildConfig
from .patches import Items, Patches, PatchLight
from .place_errors import PlaceErrors
from .sweep import RenderedImages, Sweep

_DOUBT = 0.02, 0.07
"""Detection probabilities so far below and above the limit are computed again with a search at full
resolution. The first search can miss places; it then states too much."""

_BATCH_NODES = 400_000
"""Nodes of images that are evaluated together: few enough for a processor's cache, and enough for
long loops."""

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

    condition: Bytes
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
        whole, scaled = (count, *shape), (count, scales, *shape)
        of_scales = ("detection", "sigma_major_m", "sigma_minor_m", "sigma_angle_deg")
        sizes = {f.name: scaled if f.name in of_scales else whole for f in dataclasses.fields(cls)}
        values: dict[str, Any] = {
            name: np.full(size, np.nan, np.float32) for name, size in sizes.items()
        }
        return cls(**{**values, "condition": np.zeros(whole, np.uint8)})

    def share_views(self, views: Index, first: Index) -> None:
        """Give each of the views the results of view ``first``, which sees the same."""
        for f in dataclasses.fields(self):
            values = np.moveaxis(getattr(self, f.name), -3, 0)
            values[views] = values[first]

    def one(self, row: int) -> Evaluation:
        """The results of one candidate, as views of the same memory."""
        fields = dataclasses.fields(self)
        return Evaluation(*(getattr(self, f.name)[row : row + 1] for f in fields))

    def put(self, rows: Index, other: Evaluation) -> None:
        """Write the results of ``other`` for the given candidates."""
        for f in dataclasses.fields(self):
            getattr(self, f.name)[rows] = getattr(other, f.name)


def evaluate(
    sweep: Sweep, rows: Index, cols: Index, config: BuildConfig, errors: ErrorModel | PlaceErrors
) -> Evaluation:
    """Evaluate candidates at nodes (rows, cols) of the sweep's window in every condition that can occur;
    ``errors``: one model for all, or those of their places. Views with parallel rays are rendered
    once for all candidates, near views for each candidate with its own camera.
    """
    if isinstance(errors, ErrorModel):
        errors = PlaceErrors.alike(errors, len(rows))
    scales = image_scales(config.points.patch_nodes)
    result = Evaluation.empty(len(rows), len(scales), sweep.conditions.shape)
    if not len(rows):
        return result
    known = sweep.conditions.reachable
    result.detection[..., known] = 0.0
    result.sigma_major_m[..., known] = result.sigma_minor_m[..., known] = np.inf
    near, half = np.flatnonzero(sweep.near_views), config.points.half
    if len(near) < len(sweep.near_views):
        light = PatchLight(sweep, rows, cols, half)
        _Judge(light, config, errors, result).views(np.flatnonzero(~sweep.near_views))
    if len(near):
        for azimuth, _ in sweep.suns:
            sweep.dark(azimuth)  # once for all candidates
    for k in range(len(rows)) if len(near) else ():
        own, row0, col0 = sweep.over(
            int(rows[k]), int(cols[k]), config.points.halo_nodes(config.gsd_m)
        )
        light = PatchLight(own, rows[k : k + 1] - row0, cols[k : k + 1] - col0, half)
        _Judge(light, config, errors.rows(np.array([k])), result.one(k)).views(near)
    return result


def _first_alike(directions: Array, ranges_m: Array) -> Index:
    """The number of the first of equal directions (n, 3) with equal ranges (n,), for each."""
    apart = np.abs(directions[:, None] - directions).max(axis=2)
    return np.asarray(np.argmax((apart < 1e-9) & (ranges_m[:, None] == ranges_m), axis=1))


class _Judge:
    """Evaluation of all candidates in rendered images."""

    def __init__(
        self,
        light: PatchLight,
        config: BuildConfig,
        errors: PlaceErrors,
        result: Evaluation,
    ) -> None:
        self.light, self.points, self.gsd_m = light, config.points, config.gsd_m
        self.errors = errors
        self.result, self.scales = result, image_scales(config.points.patch_nodes)
        self.whole_search = config.model.precision.whole_search

    def views(self, views: Index) -> None:
        """Write the results of the given views, at least one."""
        sweep = self.light.sweep
        for view in views.tolist():
            hidden = self.light.occlusion_dependence(view)
            self.result.occlusion_dependence[:, view, sweep.conditions.reachable] = hidden[:, None]
        together = max(1, _BATCH_NODES // math.prod(sweep.planes.shape[1:]))
        ranges_m = np.where(sweep.near_views, sweep.conditions.view_ranges_m, np.inf)
        first = _first_alike(sweep.view_directions, ranges_m)
        for images in sweep.stacks(together, tuple(np.unique(first[views]).tolist())):
            self.images(images)
        self.result.share_views(views, first[views])

    def images(self, images: RenderedImages) -> None:
        """Write the results of some images."""
        result, points, light = self.result, self.points, self.light
        rows, cols, half = light.rows, light.cols, light.half
        conditions, count = images.conditions, len(images.conditions)
        suns, own_sun = np.unique(conditions[:, 1:], axis=0, return_inverse=True)
        found = [
            light.shadow_dependence(elevation, azimuth) for elevation, azimuth in suns.tolist()
        ]
        shares, casts = zip(*found, strict=True)
        own_sun, cast = own_sun.ravel(), np.stack(casts)
        at = (slice(None), *conditions.T)
        result.shadow_dependence[at] = np.stack(shares)[own_sun].T
        flags = np.full((len(rows), count), EVALUATED, np.uint8)
        for part, flag in (
            (result.shadow_dependence[at], UNSHADOWED),
            (result.occlusion_dependence[at], UNOCCLUDED),
        ):
            flags |= _flagged(part <= points.max_dependence, flag)
        result.condition[at] = flags

        # hidden nodes: filled from their surroundings they have no texture, and they count as unlit
        size = 2 * half + 1
        filled = images.radiance if images.complete else _filled(images.radiance, size)
        radiance, slopes = filled, images.slopes
        whole = Items.all(count, rows, cols, half)
        own = whole.of(filled)
        share, level = light_of(own)
        result.harris[at] = harris_response(own, level).reshape(count, -1).T
        if not images.complete:
            share, _ = light_of(whole.of(images.radiance))
        items = whole.some(np.flatnonzero(share >= points.min_lit_share))
        changed, change = self._changes(items, filled, conditions, cast[own_sun])
        for slot, scale in enumerate(self.scales):
            if scale > 1:
                radiance, slopes = halved(radiance), halved(slopes)
                change = halved_changes(change, items.rows[changed], items.cols[changed])
                items = items.halved()
            shown = through_optics(radiance, scale)
            seen = items.of(shown)
            alone = seen
            if len(changed):
                alone = seen.copy()
                alone[changed] += through_optics(change, scale)
            _, level = light_of(alone)
            good = np.flatnonzero(np.isfinite(level))
            if len(good):
                patches = Patches(items, seen, alone, level, shown, slopes)
                if len(good) < len(level):
                    patches = patches.some(good)
                self._judge(slot, conditions, patches)

    def _changes(
        self,
        items: Items,
        filled: Float32,
        conditions: Index,
        cast: Mask,
    ) -> tuple[Index, Float32]:
        """The patches into which only terrain around them casts shadows (k,), and their difference (k,
        p, p) from those in the images if they are rendered from their own nodes alone: these nodes
        are lit. ``cast`` (images, candidates, p, p): these nodes.
        """
        dark: Mask = np.any(cast, axis=(2, 3))
        numbers = np.flatnonzero(dark.any(axis=1))
        here = np.flatnonzero(dark[items.which, items.candidate])
        if not len(here):
            return here, np.zeros((0, *cast.shape[2:]), np.float32)
        shaded = items.some(here)
        lit = np.stack([self.light.sweep.unshadowed(at) for at in map(tuple, conditions[numbers])])
        place = np.zeros(len(conditions), np.int64)
        place[numbers] = np.arange(len(numbers))
        difference = dataclasses.replace(shaded, which=place[shaded.which]).of(lit)
        difference -= shaded.of(filled)
        own = cast[shaded.which, shaded.candidate] & np.isfinite(difference)
        return here, np.where(own, difference, np.float32(0.0))

    def _judge(self, slot: int, conditions: Index, patches: Patches) -> None:
        """Write detection and covariance of patches in images of a scale; ``conditions`` (k, 3): view,
        elevation and azimuth of each image.
        """
        scale, items, points = self.scales[slot], patches.items, self.points
        pixel_m = scale * self.gsd_m
        models = self.errors.rows(items.candidate)
        match = models.registration(patches.alone, patches.errors, pixel_m, patches.level)
        search = max(1, points.search_nodes(self.gsd_m) // scale)
        images = SearchImages.of(patches.radiance, patches.size)
        false_match = points.min_detection if scale == 1 else math.inf
        whole = self.whole_search or searched_exactly(patches.size, search)
        chances = _chances(match, images, patches, search, false_match, exact=whole)
        below, above = _DOUBT
        doubt = chances.detection - points.min_detection
        again = np.flatnonzero((doubt > -below) & (doubt < above))
        if len(again) and not whole:
            checked = _chances(
                match.rows(again), images, patches.some(again), search, false_match, exact=True
            )
            for part, values in zip(chances, checked, strict=True):
                part[again] = values
        bias = np.where(np.isfinite(match.bias), match.bias, 0.0)
        place = self.errors.models[0].position_sigma_m ** 2 * np.eye(2)
        covariance = match.covariance_px2 + bias[:, :, None] * bias[:, None]
        # axes of the patch: east and south; angles are clockwise from north
        sigma, angle = error_ellipses(covariance * pixel_m**2 + place, first_axis_deg=90.0)
        major, minor = np.where(np.isnan(sigma), np.inf, sigma).T
        result, condition = self.result, conditions[items.which].T
        where = (items.candidate, slot, *condition)
        result.detection[where] = chances.detection
        result.sigma_major_m[where], result.sigma_minor_m[where] = major, minor
        result.sigma_angle_deg[where] = (angle - self.light.turn_deg) % 180.0
        if scale == 1:
            own = (items.candidate, *condition)
            result.second_peak[own] = chances.second_peak
            result.false_match[own] = chances.false_match
            for values, flag in ((chances.located, LOCALIZABLE), (chances.detection, UNIQUE)):
                result.condition[own] |= _flagged(values >= points.min_detection, flag)


def _filled(images: Float32, size: int) -> Float32:
    """Images (k, rows, cols) through `fill_missing`."""
    return np.stack([fill_missing(image, size) for image in images])


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
    patches: Patches,
    search: int,
    false_match: float,
    exact: bool,
) -> _Chances:
    """The probabilities of patches of images in a search of +-``search`` pixels; that of a false match
    only for patches that are found with at least the probability ``false_match``, else it may be NaN.
    """
    items = patches.items
    others = other_places(
        images, patches.alone, items.rows, items.cols, search, items.which,
        least_rival(match, match.own), exact=exact,
    )  # fmt: skip
    unit = patches.level[:, None]
    detection, located, unique = detection_probability(
        match, others.correlation, others.contrast / unit, match.own, third_from=false_match
    )
    on_top = top_probability(match, RING, others.near, others.near_contrast / unit, match.own)
    return _Chances(
        detection * on_top, located, 1.0 - unique * on_top, np.fmax(others.correlation[:, 0], -1.0)
    )


def _flagged(which: Mask, flag: int) -> Bytes:
    """The flag where ``which`` is true, else 0."""
    return np.where(which, flag, 0).astype(np.uint8)
