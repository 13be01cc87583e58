"""Search for a catalogue's points in an image: each patch is rendered as the image should show it,
found by correlation, placed to a fraction of a pixel with a covariance, and searched backwards.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Bytes, Float32, Index, Mask
from ..cameras.sensor import pixel_size_m
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..images.image import Image
from ..images.image_file import open_image
from ..kernels.matching import search, subpixel_fit
from ..kernels.matching.backward_search import find_backwards
from ..landmarks.corners import fill_missing
from ..landmarks.correlation import moments
from ..landmarks.detection import (
    AMBIGUOUS,
    LEAST_CORRELATION,
    highest_probability,
    mistake_probability,
)
from ..landmarks.patches import halved
from ..landmarks.point_spread import LEAST_COVER, POINT_SPREAD_PX, reduced_spread_px
from ..photometry.law_choice import law_of
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from .matches import CODE, Matches, joined
from .point_choice import LEAST_SIGMA_PX, NO_CLAIM, PointClaims, points_in_view
from .templates import PlacedPatches, Templates

_FILL_PX = 33
"""Width of the first window whose mean of valid pixels fills missing ones."""


LEAST_LIKENESS = 0.3
"""Least correlation of neighbouring pixels of an image of anything; that of plain noise is below.
"""


@dataclass(frozen=True, eq=False)
class SearchImage:
    """``fine`` (rows, cols): the signal less its ``mean``, gaps filled; ``weight`` (rows, cols) 0..1;
    ``factor``: side of one of its pixels in pixels of the full-resolution image.
    """

    source: Image
    fine: Float32
    weight: Float32
    factor: int
    mean: np.float32

    @classmethod
    def of(cls, image: Image) -> SearchImage:
        """Prepare an image. ValueError if it has no valid pixel."""
        valid = image.valid
        if not valid.any():
            raise ValueError(f"{image.name}: no pixel of it is valid")
        signal = np.where(valid, image.signal, np.float32(np.nan)).astype(np.float32)
        mean = np.float32(np.nanmean(signal, dtype=np.float64))
        signal -= mean
        if not valid.all():
            signal = fill_missing(signal, _FILL_PX)
        weight = np.where(valid, image.weight, 0.0).astype(np.float32)
        return cls(image, np.ascontiguousarray(signal), weight, image.sensor.factor, mean)

    def to_power(self, power: float, boxes: Iterable[tuple[slice, slice]]) -> SearchImage:
        """The image, its brightness (negative: 0) to a power, in boxes of rows and columns; 0 elsewhere. As if the whole image
        were prepared, except for the constant that is subtracted.
        """
        fine = np.zeros(self.fine.shape, np.float32)
        level = max(self.mean, np.float32(0.0)) ** np.float32(power)
        for rows, cols in boxes:
            top, left = (max(side.start - _FILL_PX // 2, 0) for side in (rows, cols))
            box = np.s_[top : rows.stop + _FILL_PX // 2, left : cols.stop + _FILL_PX // 2]
            signal = np.where(self.weight[box] > 0.0, self.source.signal[box], np.float32(np.nan))
            raised = fill_missing(np.maximum(signal, 0.0) ** np.float32(power) - level, _FILL_PX)
            inner = raised[rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
            fine[rows, cols] = inner
        return replace(self, fine=fine)

    @cached_property
    def half(self) -> Float32:
        """Means of 2 x 2 pixels, without an odd last row or column."""
        return halved(self.fine)

    @cached_property
    def half_weight(self) -> Float32:
        return halved(self.weight)

    def is_saturated(self, middle: Index, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """True for the pixels (n, 2) around which most of the invalid pixels are saturated, not
        missing.
        """
        high, wide = (n // 2 for n in shape)
        lost = self.weight <= 0.0
        bright = lost & np.isfinite(self.source.signal)
        out = np.zeros(len(middle), dtype=np.bool_)
        for k, (col, row) in enumerate(middle):
            box = np.s_[max(row - high, 0) : row + high + 1, max(col - wide, 0) : col + wide + 1]
            out[k] = bright[box].sum() > 0.5 * lost[box].sum()
        return out


def full_pixels(pixels: Array, factor: int) -> Array:
    """Pixels of a reduced image in pixels of the full-resolution image."""
    return (pixels + 0.5) * factor - 0.5


def nothing_in(image: Image) -> str | None:
    """The reason why nothing can be found in an image; None if there is none."""
    valid = image.valid
    if not valid.any():
        return "the image has no valid pixel"
    signal, likeness = image.signal, -1.0
    for one, next_one in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1, :], np.s_[1:, :])):
        both = valid[one] & valid[next_one]
        likeness = max(likeness, _correlation(signal[one], signal[next_one], both))
        if likeness > LEAST_LIKENESS:  # one way is enough
            return None
    return (
        f"the image is blank or nothing but noise: neighbouring pixels correlate by {likeness:.2f}"
    )


def _correlation(a: Float32, b: Float32, both: Mask) -> float:
    """Correlation of the pixels that are valid in both; 0 where there are none or one of the two is constant."""
    return float(moments(a[both], b[both]).correlation)


_CHUNK = 128
_CHUNK_PX = 2_000_000
"""Largest number of points rendered at once, and of the pixels of their templates (about 100 bytes
per pixel).
"""
_HALVED_FROM = 144
"""Least number of pixels of templates that are first searched at half resolution; smaller ones
would lose too much.
"""
_READ_PX = 4
"""Pixels around a search area that are read at half resolution."""
_INNER = 0.6
"""Share of a template's sides that is searched backwards."""
_BACK_REACH = 0.2
"""Reach of the backward search as a share of a template's longer side."""
_BACK_COVER = 0.8


@dataclass(frozen=True)
class Criteria:
    """Requirements for a match. Shares are of the template's pixels; correlations are centred and
    normalised. ``prior``: probability of a match before the search; None: what the catalogue claims,
    `NO_CLAIM` where it claims nothing.
    """

    psf_sigma_px: float = POINT_SPREAD_PX
    min_correlation: float = LEAST_CORRELATION
    max_false_match: float = AMBIGUOUS  # probability that the second peak is the true one
    prior: float | None = None
    min_lit_share: float = 0.3
    min_contrast: float = 0.005  # standard deviation of the render, as a share of its mean
    min_pixels: int = 36
    min_real_share: float = 0.7
    min_area_share: float = 0.3  # of the search area, inside the image
    max_emission_deg: float = 80.0
    max_back_px: float = 3.0
    floor_px: float = LEAST_SIGMA_PX


@dataclass(frozen=True, eq=False)
class _SearchTask:
    """Data common to all points of a call."""

    catalog: Catalog
    image: SearchImage
    model: Reflectance
    criteria: Criteria
    whole_search: bool


def find_points(
    catalog: CatalogOrPath,
    image: Image | SearchImage | Path | str,
    model: Reflectance | str = DEFAULT_MODEL,
    reach_px: ArrayLike = 64.0,
    *,
    points: ArrayLike | None = None,
    offset_px: ArrayLike | None = None,
    criteria: Criteria = Criteria(),
    whole_search: bool = False,
) -> Matches:
    """Search for points of a catalogue in an image, near where its sensor projects them: normalised
    cross-correlation with renders of their patches, then least-squares matching (Foerstner, 1982).

    The search takes the image at its own scale: first reduce an image much finer than the patches
    with `Image.reduced`. Results are in pixels of the full-resolution image, also for a reduced one.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    image:
        An image with its sensor and Sun, prepared or not, or the file of one in a map projection.
    model:
        Reflectance law of the renders, or its name.
    reach_px:
        Reach of the search, pixels; one or (n,).
    points:
        Rows (n,) of the catalogue; None: those in view.
    offset_px:
        Shift of the expected places, (2,) or (n, 2).
    criteria:
        What a match must fulfil.
    whole_search:
        True: correlate every place at full resolution: slower, and the same except for peaks that
        half resolution does not show.

    Returns
    -------
    Matches
        ``found`` (n,), ``found_px`` (n, 2), ``covariance_px2`` (n, 2, 2): of the image's noise as far as it
        displaces matches (`PointClaims.of_matches`), and not smaller in any direction than the catalogue claims for the
        image's Sun, view and scale; ``counts()`` by reason.

    Raises
    ------
    ValueError
        For an image without a valid pixel.

    Examples
    --------
    >>> image = lcp.open_image(folder / "AS15-M-0414.png", camera)
    >>> matches = lcp.find_points(catalog, image, reach_px=20.0)
    >>> matches.found_px.shape == (len(matches), 2)
    True
    """
    catalog, law = opened_catalog(catalog), law_of(model) or DEFAULT_MODEL
    if not isinstance(image, SearchImage):
        opened = open_image(image) if isinstance(image, Path | str) else image
        image = SearchImage.of(opened)
    task, image = _SearchTask(catalog, image, law, criteria, whole_search), image.source
    rows = (
        points_in_view(catalog, image.sensor)
        if points is None
        else np.asarray(points, dtype=np.int64)
    )
    factor = task.image.factor
    reach = np.broadcast_to(np.asarray(reach_px, np.float64) / factor, rows.shape)
    offset = np.zeros(2) if offset_px is None else np.asarray(offset_px, np.float64)
    offset = np.broadcast_to(offset / factor, (len(rows), 2))
    suns = image.sun_directions(catalog.position_mcmf[rows])
    claims = PointClaims.of(catalog, rows, image.sensor, suns)
    count = _at_once(catalog, image, rows)
    parts = [slice(start, start + count) for start in range(0, max(len(rows), 1), count)]
    found = [
        _match_chunk(task, rows[part], reach[part], offset[part], claims.some(part))
        for part in parts
    ]
    return joined(found)


def _at_once(catalog: Catalog, image: Image, rows: Index) -> int:
    """Number of points rendered at once."""
    pixels = pixel_size_m(image.sensor, catalog.position_mcmf[rows])
    sides = catalog.gsd[rows] * catalog.patch_nodes / np.where(pixels > 0.0, pixels, np.inf)
    largest = float(np.max(1.5 * sides, initial=1.0)) ** 2
    return int(np.clip(_CHUNK_PX / largest, 1, _CHUNK))


def _match_chunk(
    task: _SearchTask, rows: Index, reach: Array, offset: Array, claims: PointClaims
) -> Matches:
    suns = task.image.source.sun_directions(task.catalog.position_mcmf[rows])
    placed = PlacedPatches.of(task.catalog, rows, task.image.source.sensor)
    near = _near(task, placed, suns, reach, offset, True)
    posterior = _judge_places(task, near, claims.probability)
    back = _sought_back(task, near)
    _mark(near.code, ~(back <= task.criteria.max_back_px), "not confirmed")
    return _as_matches(task, near, back, claims, posterior)


@dataclass(frozen=True, eq=False)
class _Near:
    """What a search near n expected places finds: ``found`` (n, `search.NUMBERS`) to a pixel, ``precise`` (n,
    `subpixel_fit.NUMBERS`) from the pixels ``places`` (n, 2) on, ``code`` (n,) of the reasons against a point.
    """

    templates: Templates
    found: Array
    precise: Array
    places: Index
    code: Bytes

    @property
    def correlation(self) -> Array:
        precise = self.precise[:, 2]
        return np.where(np.isfinite(precise), precise, self.found[:, 2])

    def found_px(self, factor: int) -> Array:
        """Places (n, 2), full-resolution pixels; NaN where the fit did not converge."""
        shift = self.precise[:, :2] + (self.places - self.templates.origin)
        return full_pixels(self.templates.predicted_px + shift, factor)


def _near(
    task: _SearchTask, placed: PlacedPatches, suns: Array, reach: Array, offset: Array, whole: bool
) -> _Near:
    """Patches drawn under Suns (n, 3) and searched within ``reach`` (n,) of ``offset`` (n, 2) from where they are placed,
    working pixels; ``whole``: with covariances.
    """
    code = _unlit_unseen(task, placed.point, suns)
    spread_px = reduced_spread_px(task.criteria.psf_sigma_px, task.image.factor)
    templates = placed.templates(suns, task.model, spread_px)
    _judge_templates(templates, task.criteria, code)
    start = templates.origin + np.round(offset).astype(np.int64)
    found = _sought(task, templates, start, reach, code)
    _judge_search(task, templates, start, found, code)
    sought = np.isfinite(found[:, 2]) & (code == 0)
    places = start + np.where(sought[:, None], found[:, :2], 0.0).astype(np.int64)
    precise = _refined(task, templates, places, sought, whole)
    return _Near(templates, found, precise, places, code)


def _as_matches(
    task: _SearchTask, near: _Near, back: Array, claims: PointClaims, posterior: Array
) -> Matches:
    """Results in pixels of the full-resolution image."""
    f = task.image.factor
    covariance = near.precise[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    covariance = covariance + task.criteria.floor_px**2 * np.eye(2)
    return Matches(
        near.templates.point,
        full_pixels(near.templates.predicted_px, f),
        near.found_px(f),
        claims.of_matches(covariance) * f**2,
        near.correlation,
        near.found[:, 3],
        back * f,
        near.code,
        claims.probability,
        posterior,
        claims.usable,
    )


def _mark(code: Bytes, where: ArrayLike, reason: str) -> None:
    """Set the reason for those points that have none yet (code 0, which finally means found)."""
    code[np.asarray(where) & (code == 0)] = CODE[reason]


def _unlit_unseen(task: _SearchTask, rows: Index, suns: Array) -> Bytes:
    """Codes of points with the Sun below the horizon or seen edge-on; else 0."""
    up = task.catalog.rotation_mcmf_to_enu[rows, 2]
    towards = task.image.source.sensor.towards(task.catalog.position_mcmf[rows])
    code = np.zeros(len(rows), np.uint8)
    _mark(code, ~(np.sum(up * suns, axis=-1) > 0.0), "not lit")
    level = math.cos(math.radians(task.criteria.max_emission_deg))
    _mark(code, ~(np.sum(up * towards, axis=-1) > level), "not seen")
    return code


def _judge_templates(templates: Templates, criteria: Criteria, code: Bytes) -> None:
    size = templates.mask.sum(axis=(1, 2))
    _mark(code, size == 0, "not seen")
    _mark(code, templates.lit_share < criteria.min_lit_share, "not lit")
    count = np.maximum(size, 1)
    mean = templates.values.sum(axis=(1, 2), dtype=np.float64) / count
    square = np.square(templates.values, dtype=np.float64).sum(axis=(1, 2)) / count
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
    plain = ~(deviation > criteria.min_contrast * mean)
    _mark(code, (size < criteria.min_pixels) | plain, "low contrast")


def _sought(
    task: _SearchTask, templates: Templates, start: Index, reach: Array, code: Bytes
) -> Array:
    """Results (n, `search.NUMBERS`) of `search.find_templates` for the templates without a reason."""
    image, size = task.image, templates.mask.sum(axis=(1, 2))
    found = np.full((len(code), search.NUMBERS), np.nan)
    search.find_templates(
        image.fine, image.weight, image.half, image.half_weight,
        templates.values, templates.mask & (code == 0)[:, None, None], start,
        np.ceil(reach).astype(np.int64), 0.5 * np.sqrt(size), task.criteria.min_real_share,
        (size >= _HALVED_FROM) & (not task.whole_search), found,
    )  # fmt: skip
    return found


def _judge_search(
    task: _SearchTask, templates: Templates, start: Index, found: Array, code: Bytes
) -> None:
    _mark(code, found[:, 4] < task.criteria.min_area_share, "at the edge")
    few = found[:, 5] < task.criteria.min_real_share
    if few.any():
        middle = start + np.array(templates.shape[::-1]) // 2
        _mark(code, few & task.image.is_saturated(middle, templates.shape), "saturated")
    _mark(code, few, "no data")
    _mark(code, ~np.isfinite(found[:, 2]), "no peak")


def _refined(
    task: _SearchTask, templates: Templates, places: Index, sought: Mask, whole: bool
) -> Array:
    """Results (n, `subpixel_fit.NUMBERS`) of `subpixel_fit.refine` for the templates that were
    searched; ``whole``: with covariances.
    """
    out = np.full((len(sought), subpixel_fit.NUMBERS), np.nan)
    drawing, starts = templates.drawing[sought], np.zeros((int(sought.sum()), 2))
    out[sought] = _fitted(
        task.image, drawing, templates.sub, templates.sigma_px, places[sought], starts, whole=whole
    )
    return out


def _fitted(
    image: SearchImage,
    drawing: Float32,
    sub: int,
    sigma_px: float,
    places: Index,
    starts: Array,
    *,
    whole: bool,
) -> Array:
    """Results (n, `subpixel_fit.NUMBERS`) of `subpixel_fit.refine`."""
    out = np.full((len(drawing), subpixel_fit.NUMBERS), np.nan)
    subpixel_fit.refine(
        drawing, sub, sigma_px, LEAST_COVER, image.fine, image.weight, places, starts, whole, out
    )
    return out


@dataclass(frozen=True, eq=False)
class FoundPlaces:
    """Points that were found in an image, to be compared with it under other Suns, reflectance laws and powers of its
    brightness: only fitted to a fraction of a pixel, from the place that is known, or searched within ``reach_px`` of it.
    """

    image: SearchImage
    parts: tuple[PlacedPatches, ...]
    offset_px: tuple[
        Array, ...
    ]  # (n, 2) of a part's places from the predicted ones, searched pixels
    criteria: Criteria
    reach_px: float | None  # searched pixels; None: no search

    @classmethod
    def of(
        cls,
        catalog: Catalog,
        image: SearchImage,
        rows: Index,
        offset_px: Array,
        criteria: Criteria,
        reach_px: float | None = None,
    ) -> FoundPlaces:
        """Rows (n,) of the catalogue, found at ``offset_px`` (n, 2) from where the image's sensor projects them; pixels
        of the full-resolution image.
        """
        count, factor = _at_once(catalog, image.source, rows), image.factor
        some = [slice(k, k + count) for k in range(0, len(rows), count)]
        parts = tuple(PlacedPatches.of(catalog, rows[k], image.source.sensor) for k in some)
        offsets = tuple(offset_px[k] / factor for k in some)
        return cls(image, parts, offsets, criteria, None if reach_px is None else reach_px / factor)

    def under(self, image: Image, law: Reflectance) -> tuple[Array, Array]:
        """Correlations (n,), 0 where a point is not found or the fit does not converge, and places (n, 2), full-resolution
        pixels, in the image with another Sun.
        """
        found = []
        for part, offset in zip(self.parts, self.offset_px, strict=True):
            suns = image.sun_directions(part.catalog.position_mcmf[part.point])
            task = _SearchTask(part.catalog, self.image, law, self.criteria, whole_search=False)
            if self.reach_px is None:
                found.append(self._fitted(part, offset, part.drawn(suns, law)))
                continue
            reach = np.full(len(offset), self.reach_px)
            near = _near(task, part, suns, reach, offset, False)
            found.append((near.correlation, near.found_px(self.image.factor)))
        correlations, places = (np.concatenate(values) for values in zip(*found, strict=True))
        return np.nan_to_num(correlations), places

    def _fitted(self, part: PlacedPatches, offset: Array, drawing: Float32) -> tuple[Array, Array]:
        whole, factor = np.round(offset), self.image.factor
        spread_px = reduced_spread_px(self.criteria.psf_sigma_px, factor)
        places = part.origin + whole.astype(np.int64)
        fit = _fitted(self.image, drawing, part.sub, spread_px, places, offset - whole, whole=False)
        return fit[:, 2], full_pixels(part.predicted_px + fit[:, :2] + whole, factor)

    def to_power(self, power: float) -> FoundPlaces:
        """The same in the image with its brightness (negative: 0) to a power: of the pixels that are read."""
        margin = math.ceil(self.reach_px or 0.0) + _READ_PX
        parts = zip(self.parts, self.offset_px, strict=True)
        boxes = [
            np.s_[
                max(row - margin, 0) : row + p.shape[0] + margin,
                max(col - margin, 0) : col + p.shape[1] + margin,
            ]
            for p, offset in parts
            for col, row in p.origin + np.round(offset).astype(np.int64)
        ]
        return replace(self, image=self.image.to_power(power, boxes))


def _judge_places(task: _SearchTask, near: _Near, prior: Array) -> Array:
    """Probability (n,) that a place found is the true one; NaN where none was found."""
    templates, found, precise, code = near.templates, near.found, near.precise, near.code
    correlation = precise[:, 2]
    settled = np.isfinite(precise).all(axis=1)
    _mark(code, ~(near.correlation >= task.criteria.min_correlation), "weak")
    _mark(code, ~settled, "no exact place")
    rival = settled & np.isfinite(found[:, 3])
    chance = np.where(settled, 0.0, np.nan)
    before = np.where(np.isfinite(prior), highest_probability(prior), NO_CLAIM)
    if task.criteria.prior is not None:
        before = np.full(len(prior), task.criteria.prior)
    chance[rival] = mistake_probability(
        correlation[rival],
        found[rival, 3],
        templates.values[rival],
        templates.mask[rival],
        precise[rival, 9],
        before[rival],
    )
    _mark(code, ~(chance <= task.criteria.max_false_match), "ambiguous")
    return 1.0 - chance


def _sought_back(task: _SearchTask, near: _Near) -> Array:
    """Distance (n,), working pixels, from each point to where the backward search ends; NaN if it
    was not found.
    """
    templates, precise, good = near.templates, near.precise, near.code == 0
    back = np.full(len(good), np.nan)
    found = np.full((int(good.sum()), 3), np.nan)
    reach = max(2, int(_BACK_REACH * max(templates.shape)))
    find_backwards(
        templates.values[good], templates.mask[good], task.image.fine, task.image.weight,
        near.places[good], _INNER, reach, _BACK_COVER, found,
    )  # fmt: skip
    back[good] = np.hypot(*(found[:, :2] + precise[good, :2]).T)
    return back
