"""Evaluation of candidates in every condition: detection probability, covariance of the match and
independence of the terrain around them, at several scales of the image.

Patches of images that are evaluated together, and their dependence on the terrain around them.

Error models of candidates by their places: height errors differ where maps or several DEMs give
them, all else is common to a build.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array, Bytes, Float32, Index, Mask
from ..catalog.schema import EVALUATED, LOCALIZABLE, UNIQUE, UNOCCLUDED, UNSHADOWED
from ..geometry.ellipses import error_ellipses
from ..landmarks.corners import MissingNodes, Part
from ..landmarks.detection import (
    LEAST_CORRELATION,
    SEEN,
    SPREAD_NODES,
    clearance,
    detection_probability,
    least_rival,
    settling_probability,
    shifted,
    top_probability,
)
from ..landmarks.error_model import ErrorModel, PatchErrors
from ..landmarks.localization import Registration, harris_response, light_of, registration
from ..landmarks.patches import halved, halved_changes, patches_of, through_optics
from ..landmarks.point_spread import (
    BORDER_NODES,
    POINT_SPREAD_PX,
    template_pixels,
    within_border,
)
from ..landmarks.uniqueness import RING, RIVALS, SearchImages, other_places, searched_exactly
from .config import BuildConfig
from .patch_light import PatchLight
from .point_config import SEARCH_DOUBT, PointConfig
from .sweep import RenderedImages, Sweep

STEP = 0.05
"""Steps of the logarithm to which height errors are rounded, so that candidates share models: at
most 2.5 % of the 1 sigma and of the length.
"""

_LEAST_M = math.exp(-7.0)


@dataclass(frozen=True, eq=False)
class PlaceErrors:
    """The error models of n candidates: ``which`` (n,) of ``models``; ``place_m`` (n,): 1 sigma, for each axis, of their
    places, NaN: that of the models, which are alike in all but heights.
    """

    models: tuple[ErrorModel, ...]
    which: Index
    place_m: Array

    @classmethod
    def alike(cls, model: ErrorModel, count: int) -> PlaceErrors:
        """One model for all candidates."""
        return cls((model,), np.zeros(count, np.int64), np.full(count, np.nan))

    @classmethod
    def of_heights(
        cls,
        model: ErrorModel,
        sigma_m: Array,
        length_m: Array,
        step: float | None = STEP,
        place_m: Array | None = None,
    ) -> PlaceErrors:
        """A build's model with the 1 sigma and the correlation length of height errors (n,) of each place, and of the
        place itself; NaN: those of the model. Figures of heights are rounded to steps of the logarithm of metres, so
        that a place has the same ones in every build; None: they are few and kept as they are.
        """
        own, figures = (sigma_m, length_m), (model.height_sigma_m, model.height_length_m)
        whole = [np.maximum(part, _LEAST_M) for part in own]
        if step is not None:
            whole = [np.exp(step * np.rint(np.log(part) / step)) for part in whole]
        whole = [np.where(np.isfinite(a), a, b) for a, b in zip(whole, figures, strict=True)]
        found, which = np.unique(np.stack(whole, axis=1), axis=0, return_inverse=True)
        models = tuple(
            dataclasses.replace(model, height_sigma_m=float(a), height_length_m=float(b))
            for a, b in found
        )
        place_m = np.full(len(sigma_m), np.nan) if place_m is None else place_m
        return cls(models, which.reshape(-1), place_m)

    @property
    def slope_sigma(self) -> Array:
        """1 sigma (n,) of the slopes' errors."""
        slopes = [model.height_sigma_m / model.height_length_m for model in self.models]
        return np.array(slopes, np.float64)[self.which]

    def place_sigma_m(self, cell_m: float) -> Array:
        """`ErrorModel.place_sigma_m` (n,) of the candidates, in cells of one size."""
        model = self.models[0]
        own = np.where(np.isfinite(self.place_m), self.place_m, model.position_sigma_m)
        return np.maximum(own, model.position_sigma_cells * cell_m)

    def rows(self, some: NDArray[np.int64]) -> PlaceErrors:
        """A selection of the candidates."""
        return PlaceErrors(self.models, self.which[some], self.place_m[some])

    def registration(
        self, patches: AnyArray, errors: PatchErrors, pixel_m: float, level: Array, pixels: Array
    ) -> Registration:
        """`landmarks.localization.registration` of the candidates' patches (n, p, p), each with its
        own model.
        """
        if len(self.models) == 1:
            return registration(patches, errors, self.models[0], pixel_m, level, pixels)
        used = np.unique(self.which)
        parts = []
        for number in used.tolist():
            here = np.flatnonzero(self.which == number)
            own = registration(
                patches[here],
                errors.rows(here),
                self.models[number],
                pixel_m,
                level[here],
                pixels[here],
            )
            parts.append((here, own))
        return _joined(parts)


def _joined(parts: list[tuple[NDArray[np.intp], Registration]]) -> Registration:
    """Statistics of groups of patches, by their rows, in one."""
    back = np.argsort(np.concatenate([rows for rows, _ in parts]))
    first = parts[0][1]
    columns: dict[str, Any] = {}
    for field in dataclasses.fields(Registration):
        values = [getattr(one, field.name) for _, one in parts]
        columns[field.name] = (
            np.concatenate(values)[back] if isinstance(values[0], np.ndarray) else values[0]
        )
    return dataclasses.replace(first, **columns)


@dataclass(frozen=True)
class Items:
    """Patches of images: the candidate and the image (n,) of each, the row and column of its middle,
    and the nodes from there to its edge.
    """

    candidate: Index
    which: Index
    rows: Index
    cols: Index
    half: int

    @classmethod
    def all(cls, images: int, rows: Index, cols: Index, half: int) -> Items:
        """All candidates in all images, ordered by image."""
        count = len(rows)
        which = np.repeat(np.arange(images), count)
        candidate = np.tile(np.arange(count), images)
        return cls(candidate, which, rows[candidate], cols[candidate], half)

    def of(self, images: Float32) -> Float32:
        """The patches (n, p, p) of images (k, rows, cols)."""
        return patches_of(images, self.which, self.rows, self.cols, self.half)

    def some(self, chosen: Index) -> Items:
        """A selection of the items."""
        parts = (self.candidate, self.which, self.rows, self.cols)
        candidate, which, rows, cols = (part[chosen] for part in parts)
        return Items(candidate, which, rows, cols, self.half)

    def from_corner(self, corner: tuple[int, int]) -> Items:
        """The same places counted from another first row and column."""
        return dataclasses.replace(self, rows=self.rows - corner[0], cols=self.cols - corner[1])

    def within_border(self) -> Items:
        """The same places, of patches without the nodes that no template has (`point_spread.within_border`)."""
        return dataclasses.replace(self, half=self.half - BORDER_NODES)

    def halved(self) -> Items:
        """The same places in images at half the resolution."""
        return dataclasses.replace(
            self, rows=self.rows // 2, cols=self.cols // 2, half=self.half // 2
        )


@dataclass(frozen=True)
class Patches:
    """Patches (n, p, p) in images and rendered from their own nodes alone, their mean lit level (n,),
    and the images (k, rows, cols): radiance, and in a part of them that begins at ``corner`` its derivatives with respect to
    the slopes towards east and south.
    """

    items: Items
    seen: Float32
    alone: Float32
    level: Array
    radiance: Float32
    slopes: Float32  # (2, k, some rows, some cols)
    corner: tuple[int, int] = (0, 0)

    @property
    def size(self) -> int:
        """Nodes along a side."""
        return int(self.alone.shape[1])

    @property
    def errors(self) -> PatchErrors:
        """The patches' sources of error."""
        east, south = self.slopes
        own = self.items.from_corner(self.corner)
        return PatchErrors(self.seen, own.of(east), own.of(south))

    def some(self, chosen: Index) -> Patches:
        """A selection of the patches."""
        return dataclasses.replace(
            self,
            items=self.items.some(chosen),
            seen=self.seen[chosen],
            alone=self.alone[chosen],
            level=self.level[chosen],
        )


_BATCH_NODES = 400_000
"""Nodes of images that are evaluated together: few enough for a processor's cache, and enough for
long loops."""


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
    scales = config.points.scales
    result = Evaluation.empty(len(rows), len(scales), sweep.conditions.shape)
    if not len(rows):
        return result
    known = sweep.conditions.reachable
    result.detection[..., known] = 0.0
    result.sigma_major_m[..., known] = result.sigma_minor_m[..., known] = np.inf
    near = np.flatnonzero(sweep.near_views)
    if len(near) < len(sweep.near_views):
        light = PatchLight.of(sweep, rows, cols, config)
        _Judge(light, config, errors, result).views(np.flatnonzero(~sweep.near_views))
    if len(near):
        for azimuth, _ in sweep.suns:
            sweep.dark(azimuth)  # once for all candidates
    for k in range(len(rows)) if len(near) else ():
        own, row0, col0 = sweep.over(
            int(rows[k]), int(cols[k]), config.points.halo_nodes(config.gsd_m)
        )
        light = PatchLight.of(own, rows[k : k + 1] - row0, cols[k : k + 1] - col0, config)
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
        self.result, self.scales = result, config.points.scales
        self.whole_search = config.model.precision.whole_search
        self._casts: dict[tuple[int, int], tuple[Float32, Mask]] = {}
        self._gaps: dict[int, MissingNodes] = {}

    def views(self, views: Index) -> None:
        """Write the results of the given views, at least one."""
        sweep = self.light.sweep
        for view in views.tolist():
            hidden = self.light.occlusion_dependence(view)
            self.result.occlusion_dependence[:, view, sweep.conditions.reachable] = hidden[:, None]
        together = max(1, _BATCH_NODES // math.prod(sweep.planes.shape[1:]))
        ranges_m = np.where(sweep.near_views, sweep.conditions.view_ranges_m, np.inf)
        first = _first_alike(sweep.view_directions, ranges_m)
        shown = tuple(np.unique(first[views]).tolist())
        for images in sweep.stacks(together, shown, self.part):
            self.images(images)
        self.result.share_views(views, first[views])

    @cached_property
    def part(self) -> Part:
        """The part of images with all nodes of the patches at every scale; its first row and column are multiples of all
        scales.
        """
        margin, step = self.points.half + max(self.scales), max(self.scales)
        shape = self.light.sweep.planes.shape[1:]
        rows, cols = (
            slice(
                max(0, int(at.min()) - margin) // step * step,
                min(most, (int(at.max()) + margin) // step * step + step),
            )
            for at, most in zip((self.light.rows, self.light.cols), shape, strict=True)
        )
        return rows, cols

    def images(self, images: RenderedImages) -> None:
        """Write the results of some images."""
        result, points, light = self.result, self.points, self.light
        rows, cols, half = light.rows, light.cols, light.half
        conditions, count = images.conditions, len(images.conditions)
        suns, own_sun = np.unique(conditions[:, 1:], axis=0, return_inverse=True)
        known = self._casts  # a Sun's views may be in several batches
        self._casts = {
            (up, at): known.get((up, at)) or light.shadow_dependence(up, at)
            for up, at in suns.tolist()
        }
        shares, casts = zip(*self._casts.values(), strict=True)
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
        blur_px = _given(points.point_spread_px, POINT_SPREAD_PX)
        filled = images.radiance if images.complete else self._filled(images, size)
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
            shown = through_optics(radiance, scale, blur_px)
            inner = items.within_border()
            seen = inner.of(shown)
            alone = seen
            if len(changed):
                alone = seen.copy()
                alone[changed] += within_border(through_optics(change, scale, blur_px))
            _, level = light_of(alone)
            good = np.flatnonzero(np.isfinite(level))
            if len(good):
                corner = self.part[0].start // scale, self.part[1].start // scale
                patches = Patches(inner, seen, alone, level, shown, slopes, corner)
                if len(good) < len(level):
                    patches = patches.some(good)
                self._judge(slot, conditions, patches)

    def _filled(self, images: RenderedImages, size: int) -> Float32:
        """The images (k, rows, cols) without missing nodes (`corners.fill_missing`). Those of a view are found once as long as
        they are the same."""
        filled = images.radiance.copy()
        for view, image in zip(images.conditions[:, 0].tolist(), filled, strict=True):
            missing = ~np.isfinite(image)
            if view not in self._gaps or not np.array_equal(self._gaps[view].missing, missing):
                self._gaps[view] = MissingNodes(missing, size)
            self._gaps[view].fill(image)
        return filled

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
        sweep, part = self.light.sweep, self.part
        lit = np.stack([sweep.unshadowed(at, part) for at in map(tuple, conditions[numbers])])
        place = np.zeros(len(conditions), np.int64)
        place[numbers] = np.arange(len(numbers))
        own_part = shaded.from_corner((part[0].start, part[1].start))
        difference = dataclasses.replace(own_part, which=place[shaded.which]).of(lit)
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
        up = self.light.sweep.view_directions[conditions[items.which, 0], 2]
        pixels = template_pixels(patches.size + 2 * BORDER_NODES, up)
        match = models.registration(patches.alone, patches.errors, pixel_m, patches.level, pixels)
        search = max(1, points.search_nodes(self.gsd_m) // scale)
        images = SearchImages.of(patches.radiance, patches.size)
        false_match = points.min_detection if scale == 1 else math.inf
        whole = self.whole_search or searched_exactly(patches.size, search)
        model = self.errors.models[0]
        shift = model.detection_shift
        chances = _chances(match, images, patches, search, false_match, points, shift, exact=whole)
        below, above = points.search_doubt or SEARCH_DOUBT
        doubt = chances.detection - points.min_detection
        again = np.flatnonzero((doubt > -below) & (doubt < above))
        if len(again) and not whole:
            checked = _chances(
                match.rows(again),
                images,
                patches.some(again),
                search,
                false_match,
                points,
                shift,
                exact=True,
            )
            for part, values in zip(chances, checked, strict=True):
                part[again] = values
        bias = np.where(np.isfinite(match.bias), match.bias, 0.0)
        place = models.place_sigma_m(self.gsd_m)[:, None, None] ** 2 * np.eye(2)
        moved = model.moving(self.light.contrast)[items.candidate, None, None]
        covariance = moved * match.covariance_px2 + bias[:, :, None] * bias[:, None]
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


class _Chances(NamedTuple):
    """Probabilities of patches, (n,) each: that a patch is found; that it is located, whatever is
    elsewhere; that another place is taken for it; and the highest correlation elsewhere.
    """

    detection: Array
    located: Array
    false_match: Array
    second_peak: Array


_CLEARANCE = SEEN * clearance()


def _given(value: float | None, default: float) -> float:
    """A value of the configuration, or the default in its place."""
    return default if value is None else value


def _chances(
    match: Registration,
    images: SearchImages,
    patches: Patches,
    search: int,
    false_match: float,
    points: PointConfig,
    shift: float,
    exact: bool,
) -> _Chances:
    """The probabilities of patches of images in a search of +-``search`` pixels; that of a false match
    only for patches that are found with at least the probability ``false_match``, else it may be NaN. ``shift``: probits
    that are added to the first two (`ErrorModel.detection_shift`).
    """
    items = patches.items
    nodes = points.spread_nodes or SPREAD_NODES
    others = other_places(
        images, patches.alone, items.rows, items.cols, search, items.which,
        least_rival(match, match.own, _CLEARANCE, nodes), exact=exact, most=points.rivals or RIVALS,
    )  # fmt: skip
    unit, third_from = patches.level[:, None], min(false_match, 1.0)
    if shift and third_from < 1.0:  # without one no process needs SciPy: 31 MB and its import
        third_from = float(shifted(np.array(third_from), -shift))
    detection, located, unique = detection_probability(
        match,
        others.correlation,
        others.contrast / unit,
        match.own,
        _given(points.least_correlation, LEAST_CORRELATION),
        third_from=third_from,
        clear_by=_CLEARANCE,
        spread_nodes=nodes,
    )
    on_top = top_probability(match, RING, others.near, others.near_contrast / unit, match.own)
    found = np.minimum(detection, on_top) * settling_probability(match)
    if shift:
        found, located = shifted(found, shift), shifted(located, shift)
    return _Chances(
        found,
        located,
        1.0 - np.minimum(unique, on_top),
        np.fmax(others.correlation[:, 0], -1.0),
    )


def _flagged(which: Mask, flag: int) -> Bytes:
    """The flag where ``which`` is true, else 0."""
    return np.where(which, flag, 0).astype(np.uint8)
