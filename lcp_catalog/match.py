"""A catalogue's points sought in a photograph: each patch is rendered as the image must show it, searched by correlation, placed
to a fraction of a pixel with a covariance, and sought backwards (docs/matching.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .coarse_match import CoarseShift, coarse_shift
from .contents import Catalog
from .kernels import register, search
from .kernels.way_back import seek_back
from .landmarks.unique import effective_samples, false_match_probability
from .matches import CODE, Matches
from .patch_render import LEAST_COVER, POINT_SPREAD_PX, Templates, render_patches
from .photo import Photo
from .reflectance import DEFAULT_MODEL, Reflectance
from .search_image import SearchImage, full_pixels
from .usable import usable_now, working_photo

__all__ = [
    "CoarseShift",
    "Criteria",
    "coarse_shift",
    "match",
    "points_in_view",
    "usable_now",
    "working_photo",
]

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_CHUNK = 128
"""Points rendered at once: their drawings are kept only so long."""


@dataclass(frozen=True)
class Criteria:
    """What a match must be. Shares are of the template's pixels, correlations centred and normalised."""

    psf_sigma_px: float = POINT_SPREAD_PX
    min_correlation: float = 0.4
    max_false_match: float = 0.2
    min_lit_share: float = 0.3
    min_contrast: float = 0.005  # standard deviation over mean of the render
    min_pixels: int = 36
    min_real_share: float = 0.7
    min_area_share: float = 0.3  # of the search area that lies in the image
    max_emission_deg: float = 80.0
    max_back_px: float = 1.5
    floor_px: float = 0.02  # 1 sigma that no match is better than


def match(
    catalog: Catalog,
    photo: Photo,
    model: Reflectance = DEFAULT_MODEL,
    reach_px: ArrayLike = 64.0,
    *,
    points: ArrayLike | None = None,
    offset_px: ArrayLike | None = None,
    criteria: Criteria = Criteria(),
    whole_search: bool = False,
) -> Matches:
    """Seek points (rows of the catalogue; default: all that the photograph's sensor puts into the image) within ``reach_px`` (one
    or (n,)) pixels of where the sensor, plus ``offset_px`` (2,) or (n, 2), puts them.

    Pixels are always those of the image as it came, though the photo be a reduced one; the covariance too. ``whole_search``
    correlates every place at full resolution: slower, the same but for peaks that half resolution does not
    show (docs/matching.md).
    """
    image = SearchImage.of(photo)
    rows = points_in_view(catalog, photo) if points is None else np.asarray(points, dtype=np.int64)
    reach = np.broadcast_to(np.asarray(reach_px, np.float64) / image.factor, rows.shape)
    offset = np.zeros((len(rows), 2)) if offset_px is None else np.asarray(offset_px, np.float64)
    offset = np.broadcast_to(offset, (len(rows), 2)) / image.factor
    parts = [_blank(catalog, photo, rows[:0])]
    for start in range(0, len(rows), _CHUNK):
        part = slice(start, start + _CHUNK)
        parts.append(
            _match_chunk(
                catalog, image, model, rows[part], reach[part], offset[part], criteria, whole_search
            )
        )
    return _joined(parts)


def points_in_view(catalog: Catalog, photo: Photo) -> Index:
    """Rows of the points that the sensor puts into the image, on the side of the Moon that it sees, (n,)."""
    pixels = photo.sensor.project(catalog.position_mcmf)
    inside = photo.sensor.in_image(pixels)
    facing = np.zeros(len(catalog), dtype=np.bool_)
    towards = photo.sensor.towards(catalog.position_mcmf[inside])
    facing[inside] = np.sum(towards * catalog.rotation_mcmf_to_enu[inside, 2], axis=-1) > 0.0
    return np.flatnonzero(facing)


def _blank(catalog: Catalog, photo: Photo, rows: Index) -> Matches:
    """Matches of points nobody has looked for yet."""
    n = len(rows)
    predicted = photo.sensor.project(catalog.position_mcmf[rows])
    nothing = np.full((5, n), np.nan)
    return Matches(
        rows, predicted, np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan),
        nothing[0], nothing[1], nothing[2], np.zeros(n, np.uint8),
    )  # fmt: skip


def _joined(parts: list[Matches]) -> Matches:
    names = Matches.__dataclass_fields__
    return Matches(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})


def _match_chunk(
    catalog: Catalog,
    image: SearchImage,
    model: Reflectance,
    rows: Index,
    reach: Array,
    offset: Array,
    criteria: Criteria,
    whole_search: bool,
) -> Matches:
    photo = image.photo
    suns = photo.sun_directions(catalog.position_mcmf[rows])
    code = _unlit_unseen(catalog, photo, rows, suns, criteria)
    templates = render_patches(
        catalog, rows, photo.sensor, suns, model, psf_sigma_px=criteria.psf_sigma_px
    )
    _judge_templates(templates, criteria, code)
    whole = np.round(offset).astype(np.int64)
    start = templates.origin + whole
    size = templates.mask.sum(axis=(1, 2))
    exclusion = 0.5 * np.sqrt(size)
    found = np.full((len(rows), search.NUMBERS), np.nan)
    coarse = (size >= _HALVED_FROM) & (not whole_search)
    span = np.where(code == 0, np.ceil(reach), -1).astype(np.int64)
    search.seek(
        image.fine, image.weight, image.half, image.half_weight, templates.values,
        templates.mask & (code == 0)[:, None, None], start, span, exclusion,
        criteria.min_real_share, coarse, found,
    )  # fmt: skip
    _judge_search(found, image, start, templates, criteria, code)
    sought = np.isfinite(found[:, 2]) & (code == 0)
    places = start + np.where(sought[:, None], found[:, :2], 0.0).astype(np.int64)
    precise = np.full((len(rows), register.NUMBERS), np.nan)
    some = np.flatnonzero(sought)
    if len(some):
        precise[some] = _refined(templates, some, places, image)
    _judge_places(templates, found, precise, criteria, code)
    back = _way_back(templates, precise, places, image, code)
    code[(code == 0) & ~(back <= criteria.max_back_px)] = CODE["not confirmed"]
    shift = precise[:, :2] + (places - templates.origin)
    f = image.factor
    good = np.isfinite(precise[:, 2])
    covariance = precise[:, [3, 4, 4, 5]].reshape(-1, 2, 2) + criteria.floor_px**2 * np.eye(2)
    return Matches(
        rows,
        full_pixels(templates.predicted_px, f),
        full_pixels(templates.predicted_px + shift, f),
        covariance * f**2,
        np.where(good, precise[:, 2], found[:, 2]),
        found[:, 3],
        back * f,
        code,
    )


_HALVED_FROM = 144
"""Templates of fewer pixels are searched at full resolution: too little is left of them at half."""


def _unlit_unseen(
    catalog: Catalog, photo: Photo, rows: Index, suns: Array, criteria: Criteria
) -> NDArray[np.uint8]:
    """Codes of points on which the Sun has not risen, or which the camera sees edge-on; else 0, which means nothing yet."""
    up = catalog.rotation_mcmf_to_enu[rows, 2]
    towards = photo.sensor.towards(catalog.position_mcmf[rows])
    code = np.zeros(len(rows), np.uint8)
    code[~(np.sum(up * suns, axis=-1) > 0.0)] = CODE["not lit"]
    level = math.cos(math.radians(criteria.max_emission_deg))
    code[~(np.sum(up * towards, axis=-1) > level)] = CODE["not seen"]
    return code


def _mark(code: NDArray[np.uint8], where: Mask, reason: str) -> None:
    """Say why of those nothing has been said of yet."""
    code[where & (code == 0)] = CODE[reason]


def _judge_templates(templates: Templates, criteria: Criteria, code: NDArray[np.uint8]) -> None:
    size = templates.mask.sum(axis=(1, 2))
    _mark(code, size == 0, "not seen")
    _mark(code, templates.lit_share < criteria.min_lit_share, "not lit")
    count = np.maximum(size, 1)
    mean = templates.values.sum(axis=(1, 2), dtype=np.float64) / count
    square = (templates.values.astype(np.float64) ** 2).sum(axis=(1, 2)) / count
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0))
    _mark(code, (size < criteria.min_pixels) | ~(deviation > criteria.min_contrast * mean), "low contrast")


def _judge_search(
    found: Array,
    image: SearchImage,
    start: Index,
    templates: Templates,
    criteria: Criteria,
    code: NDArray[np.uint8],
) -> None:
    _mark(code, found[:, 4] < criteria.min_area_share, "out of frame")
    few = found[:, 5] < criteria.min_real_share
    if few.any():
        middle = start + np.array(templates.shape[::-1]) // 2
        _mark(code, few & image.is_saturated(middle, templates.shape), "saturated")
    _mark(code, few, "no data")
    _mark(code, ~np.isfinite(found[:, 2]), "weak")


def _refined(templates: Templates, some: Index, places: Index, image: SearchImage) -> Array:
    out = np.full((len(some), register.NUMBERS), np.nan)
    register.refine(
        templates.drawing[some], templates.sub, templates.sigma_px, LEAST_COVER, image.fine,
        image.weight, places[some], np.zeros((len(some), 2)), out,
    )  # fmt: skip
    return out


def _judge_places(
    templates: Templates,
    found: Array,
    precise: Array,
    criteria: Criteria,
    code: NDArray[np.uint8],
) -> None:
    correlation = np.where(np.isfinite(precise[:, 2]), precise[:, 2], found[:, 2])
    _mark(code, ~(correlation >= criteria.min_correlation), "weak")
    _mark(code, ~np.isfinite(precise).all(axis=1), "weak")
    rival = np.isfinite(found[:, 3]) & (code == 0)
    some = np.flatnonzero(rival)
    if len(some):
        patches = np.where(templates.mask[some], templates.values[some], np.float32(np.nan))
        chance = false_match_probability(
            correlation[some], found[some, 3], effective_samples(patches)
        )
        ambiguous = np.zeros(len(code), np.bool_)
        ambiguous[some] = ~(chance <= criteria.max_false_match)
        _mark(code, ambiguous, "ambiguous")


_BACK_COVER = 0.8
_INNER = 0.6
"""Share of a template's sides that is sought backwards."""


def _way_back(
    templates: Templates, precise: Array, places: Index, image: SearchImage, code: NDArray[np.uint8]
) -> Array:
    """How far from where it was found each point comes back to, working pixels (n,); NaN where nothing was found."""
    back = np.full(len(code), np.nan)
    some = np.flatnonzero(code == 0)
    if not len(some):
        return back
    found = np.full((len(some), 3), np.nan)
    reach = max(2, int(0.2 * max(templates.shape)))
    seek_back(
        templates.values[some], templates.mask[some], image.fine, image.weight, places[some], _INNER,
        reach, _BACK_COVER, found,
    )  # fmt: skip
    back[some] = np.hypot(*(found[:, :2] + precise[some, :2]).T)
    return back
