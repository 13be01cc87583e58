"""Points that may lie in the image of a sensor with an uncertain position, and the reach of their
search.

A point's reach is a number of sigmas of its place in the image, by the sensor's Jacobian: to first
order in the uncertainty. If that is too far for a search point by point, the offset of the whole
image is found first (`coarse_shift`); the reach is then that of the uncertainty given
this offset, by a Kalman step.

Offset of a whole image from where its sensor projects it, also by hundreds of pixels: the
correlations of all points added up over one grid of offsets.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter

from ..arrays import Array, Float32, Index, Mask
from ..cameras.sensor import Sensor, Uncertainty, pixel_size_m
from ..cameras.view import below_sphere, center_of, optical_axis
from ..catalog.catalogue import Catalog
from ..constants import MOON_RADIUS_M
from ..errors import ImageError
from ..geometry.bounds import enclosing_bounds
from ..geometry.frames import lonlat_to_mcmf, mcmf_to_lonlat
from ..images.image import Image
from ..kernels.matching import correlation
from ..landmarks.ground_votes import independent_votes
from ..landmarks.located import SIGNIFICANT
from ..photometry.laws import DEFAULT_MODEL, Reflectance
from .consensus import (
    SHARE_IF_HERE,
)
from .point_choice import facing, likeliest
from .point_search import SearchImage
from .pose import jacobian
from .templates import render_patches

_GRID_PX = 64
"""Reach of the grid in its own pixels: the image is reduced to it, or until templates are
`_SMALLEST_PX` a side.
"""
_SMALLEST_PX = 8
_CHUNK = 64
_CHUNK_OFFSETS = 4_000_000
"""Largest number of points whose maps are kept at once, and of the offsets of all of them."""
_MOST_POINTS = 400
_LEAST_REAL = 0.7
_LEAST_SHARE = 0.3
"""Least share of the points that can be compared at an offset for it to count."""
_LEAST_CELLS = 100
"""Least number of offsets outside a peak for a result."""
_LEVELS = 4096
_PLATEAU = 0.05


@dataclass(frozen=True)
class CoarseShift:
    """The offset on which most points agree, in pixels of the full-resolution image.
    ``log10_false_alarms``: log10 of the expected number of offsets with as high an agreement by
    chance in an area of this size; ``rival_log10``: the same for the best offset elsewhere;
    ``if_here_log10``: the same if `SHARE_IF_HERE` of the points gave one offset the highest vote that a
    map can give, and the others the mean vote.
    """

    offset_px: tuple[float, float]
    log10_false_alarms: float
    rival_log10: float
    precision_px: float  # the grid's own pixel, and the slack
    points: int
    if_here_log10: float = -math.inf


def coarse_shift(
    catalog: Catalog,
    image: Image,
    model: Reflectance = DEFAULT_MODEL,
    reach_px: float = 500.0,
    *,
    points: ArrayLike,
    offset_px: ArrayLike | Callable[[Index], Array] | None = None,
    slack_px: float = 0.0,
    grid_px: int = _GRID_PX,
    share: float = 1.0,
) -> CoarseShift | None:
    """The offset, within ``reach_px``, at which the points (rows of the catalogue) agree best; None
    if too few can be compared.

    ``offset_px``: added first to each point's place ((2,), (n, 2), or a function of the rows).
    ``slack_px``: largest distance of single points from the common offset, as in a turned or scaled
    image.

    Every point votes for every offset by how rare so high a correlation is in its own map: -ln(rank
    / offsets). By chance a vote is exponential with mean 1 whatever the map looks like, and the sum
    of n votes has the tail of Gamma(n); times the number of offsets it is the number of false
    alarms (Desolneux, Moisan and Morel 2008). Points count as independent, or, if their patches
    overlap, as ``share`` of their number (`ground_votes.independent_share`) with the same mean vote.
    """
    given = np.asarray(points, dtype=np.int64)
    suns = image.sun_directions(catalog.position_mcmf[given])
    some = likeliest(catalog, given, image.sensor, suns, _MOST_POINTS)
    rows = given[some]
    if not len(rows):
        return None
    factor, size = _scale(catalog, image, rows, reach_px / image.sensor.factor, grid_px)
    searched = SearchImage.of(image.reduced(factor))
    offset = offset_px(rows) if callable(offset_px) else offset_px
    offset = np.zeros(2) if offset is None else np.asarray(offset, dtype=np.float64)
    if np.shape(offset) == (len(given), 2):
        offset = offset[some]
    offset = np.broadcast_to(offset, (len(rows), 2)) / searched.factor
    reach, slack = max(1, math.ceil(reach_px / searched.factor)), round(slack_px / searched.factor)
    votes, voters = np.zeros((2 * reach + 1,) * 2), np.zeros((2 * reach + 1,) * 2, np.int64)
    count = max(1, min(_CHUNK, _CHUNK_OFFSETS // votes.size))
    for start in range(0, len(rows), count):
        part = slice(start, start + count)
        maps = correlation_maps(catalog, searched, model, rows[part], offset[part], reach)
        for score in maps:
            known = np.isfinite(score)
            if known.any():
                voters += known
                votes += _vote(score, known, slack)
    return _peak(votes, voters, searched.factor, slack, 0.5 * size + 2 * slack, share)


def correlation_maps(
    catalog: Catalog,
    searched: SearchImage,
    model: Reflectance,
    rows: Index,
    offset: Array,
    reach: int,
) -> Float32:
    """Correlations (n, 2 reach + 1, 2 reach + 1), rows before columns, of points (rows (n,) of the
    catalogue) at every whole offset within ``reach`` of where the image's sensor projects them,
    plus ``offset`` (n, 2) rounded; NaN where there is none. Pixels of the searched image.
    """
    suns = searched.source.sun_directions(catalog.position_mcmf[rows])
    sensor = searched.source.sensor
    templates = render_patches(catalog, rows, sensor, suns, model)
    maps = np.empty((len(rows), 2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    origin = templates.origin + np.round(offset).astype(np.int64)
    correlation.maps(
        searched.fine,
        searched.weight,
        templates.values,
        templates.mask,
        origin,
        reach,
        _LEAST_REAL,
        maps,
    )
    return maps


def _scale(
    catalog: Catalog, image: Image, rows: Index, reach: float, grid_px: int
) -> tuple[int, float]:
    """Reduction factor of the image, and the side of the templates then, in pixels."""
    pixel = float(np.nanmedian(pixel_size_m(image.sensor, catalog.position_mcmf[rows])))
    size = float(np.median(catalog.gsd[rows])) * catalog.patch_nodes / pixel
    factor = max(1, min(math.ceil(reach / grid_px), math.floor(size / _SMALLEST_PX)))
    return factor, size / factor


def _vote(score: Float32, known: Mask, slack: int) -> Array:
    """-ln of the share of a map's offsets with as high a correlation, within ``slack`` of each; 0
    where there is none.
    """
    level = np.where(known, np.clip(score, -1.0, 1.0), -1.0)
    level = ((level + 1.0) * (0.5 * (_LEVELS - 1))).astype(np.int64)
    level = maximum_filter(level, 2 * slack + 1, mode="constant") if slack else level
    count = np.bincount(level[known], minlength=_LEVELS)
    as_high = np.maximum(np.cumsum(count[::-1])[::-1], 1)
    return np.where(known, np.log(known.sum() / as_high)[level], 0.0)


def _peak(
    votes: Array, voters: Index, factor: int, slack: int, zone: float, share: float
) -> CoarseShift | None:
    """The best offset, and the best one farther from it than ``zone``; None if too few remain
    outside.
    """
    known = (voters > 0) & (voters >= _LEAST_SHARE * voters.max())
    clear = np.where(known, (votes - voters) / np.sqrt(np.maximum(voters, 1)), -np.inf)
    row, col = (int(k) for k in np.unravel_index(int(np.argmax(clear)), clear.shape))
    down, right = np.ogrid[-row : clear.shape[0] - row, -col : clear.shape[1] - col]
    near = down**2 + right**2 <= zone**2
    others = known & ~near
    if others.sum() < _LEAST_CELLS:
        return None
    away = np.unravel_index(int(np.argmax(np.where(others, clear, -np.inf))), clear.shape)
    # a slack makes a plateau of the peak: its middle
    top = near & known & (clear >= clear[row, col] - _PLATEAU * max(float(clear[row, col]), 0.0))
    middle = np.argwhere(top).mean(axis=0) - (clear.shape[0] // 2)
    alarms = [
        math.log10(known.sum()) + _log10_gamma_tail(int(voters[at]), float(votes[at]), share)
        for at in ((row, col), away)
    ]
    offset = (float(middle[1] * factor), float(middle[0] * factor))
    most = int(voters.max())
    highest = math.log(max(known.sum() / (1 + 2 * slack) ** 2, math.e))  # of a plateau of the slack
    total = most * (1.0 + SHARE_IF_HERE * (highest - 1.0))
    if_here = math.log10(known.sum()) + _log10_gamma_tail(most, total, share)
    return CoarseShift(offset, alarms[0], alarms[1], float(factor * (1 + slack)), most, if_here)


def _log10_gamma_tail(n: int, total: float, share: float = 1.0) -> float:
    """log10 of the probability that n exponential votes of mean 1 add up to more than t: e^-t times
    the sum of t^k / k!, k < n. Of dependent votes `independent_votes` count, with the same mean.
    """
    if total <= 0.0:
        return 0.0
    count = independent_votes(n, share)
    total *= count / n
    k = np.arange(count)
    terms = k * math.log(total) - np.array([math.lgamma(v + 1.0) for v in k])
    top = float(terms.max())
    return (top + math.log(float(np.exp(terms - top).sum())) - total) / math.log(10.0)


_FARTHEST = 2.0
"""Points that the sensor projects further from the image's middle than this many image sizes plus
reaches of the middle are left out: that far off, a pinhole's linear reach is invalid.
"""
_NOBODY = np.zeros(0, dtype=np.int64)
_TELLS = -3.0
"""log10 of the false alarms that a quarter of the points could reach, above which the lack of a common
offset says nothing.
"""
_ROUGH = 2
"""Pixels of the coarse grid by which its offset may be wrong beyond its own precision."""


@dataclass(frozen=True, eq=False)
class SearchArea:
    """Points (rows of the catalogue, (n,)), each searched within ``reach_px`` (n,) of where the
    sensor projects it plus ``offset_px`` (n, 2). Pixels of the full-resolution image.
    ``log10_places``: log10 of the number of areas of this size among which this one was chosen.
    """

    points: Index
    offset_px: Array
    reach_px: Array
    log10_places: float = 0.0

    def __len__(self) -> int:
        return len(self.points)

    def at_least(self, least_px: float) -> SearchArea:
        """The area with a least reach."""
        return replace(self, reach_px=np.maximum(self.reach_px, least_px))

    def only(self, rows: NDArray[np.bool_] | Index) -> SearchArea:
        """The area of some of its points."""
        return replace(
            self,
            points=self.points[rows],
            offset_px=self.offset_px[rows],
            reach_px=self.reach_px[rows],
        )


def perhaps_in_view(
    catalog: Catalog, sensor: Sensor, uncertainty: Uncertainty, sigmas: float
) -> SearchArea:
    """The points that may be in the image, each with its reach, ``sigmas`` times that of its place."""
    height, width = sensor.shape
    middle = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    prior = np.diag(uncertainty.sigmas(sensor) ** 2)
    off = np.abs(sensor.project(catalog.position_mcmf) - middle)
    away = np.nan_to_num(off, nan=np.inf).max(axis=-1, initial=0.0)
    nothing = SearchArea(_NOBODY, np.zeros((0, 2)), np.zeros(0))
    if not np.isfinite(away).any():
        return nothing
    central = jacobian(sensor, catalog.position_mcmf[[int(np.argmin(away))]])
    farthest = _FARTHEST * (max(height, width) + float(_reach(central, prior, sigmas)[0]))
    rows = facing(catalog, sensor, np.flatnonzero(away < farthest))
    if not len(rows):
        return nothing
    reach = search_reach_px(sensor, catalog.position_mcmf[rows], uncertainty, sigmas)
    kept = (off[rows] <= np.array([width, height]) / 2.0 + reach[:, None]).all(-1)
    return SearchArea(rows[kept], np.zeros((int(kept.sum()), 2)), reach[kept])


def search_reach_px(
    sensor: Sensor, points_mcmf_m: Array, uncertainty: Uncertainty, sigmas: float
) -> Array:
    """``sigmas`` times the largest sigma (n,) of where points (n, 3) lie in the image."""
    prior = np.diag(uncertainty.sigmas(sensor) ** 2)
    return _reach(jacobian(sensor, points_mcmf_m), prior, sigmas)


def narrowed(
    area: SearchArea,
    catalog: Catalog,
    image: Image,
    sensor: Sensor,
    uncertainty: Uncertainty,
    model: Reflectance,
    sigmas: float,
    least_px: float,
) -> tuple[SearchArea, float, float]:
    """The area after the offset of the whole image is found; log10 of the expected number of
    offsets as clear by chance; and the distance, in pixels, by which turning and scaling move
    single points from a common offset (1 sigma, the median).

    If no offset can be found, or none could be significant because the points are too few for the
    slack: the area as it is, and minus infinity. ``image`` is the searched
    image, ``sensor`` that of the full-resolution image.
    """
    prior = np.diag(uncertainty.sigmas(sensor) ** 2)
    slope = jacobian(sensor, catalog.position_mcmf[area.points])
    common = slope.mean(axis=0)
    slack = _slack(slope, prior)
    shift = coarse_shift(
        catalog,
        image,
        model,
        float(np.median(area.reach_px)),
        points=area.points,
        slack_px=slack,
    )
    vague = shift is not None and shift.if_here_log10 > _TELLS
    if shift is None or (vague and shift.log10_false_alarms > SIGNIFICANT):
        return area, -math.inf, slack
    noise = (_ROUGH * shift.precision_px) ** 2 * np.eye(2)
    gain = prior @ common.T @ np.linalg.inv(common @ prior @ common.T + noise)
    correction = gain @ np.array(shift.offset_px)
    left = prior - gain @ common @ prior
    reach = np.maximum(_reach(slope, left, sigmas), least_px)
    reach = np.minimum(reach, area.reach_px)
    places = 2.0 * math.log10(float(np.median(area.reach_px)) / float(np.median(reach)))
    narrow = SearchArea(area.points, slope @ correction, reach, max(places, 0.0))
    return narrow, shift.log10_false_alarms, slack


def slack_px(sensor: Sensor, points_mcmf_m: Array, uncertainty: Uncertainty) -> float:
    """Distance, in pixels, by which an uncertainty, as it turns and scales the image, moves ground
    points (n, 3) from an offset common to all: the median of 1 sigma.
    """
    return _slack(jacobian(sensor, points_mcmf_m), np.diag(uncertainty.sigmas(sensor) ** 2))


def _slack(slope: Array, covariance: Array) -> float:
    return float(np.median(_reach(slope - slope.mean(axis=0), covariance, 1.0)))


def _reach(slope: Array, covariance: Array, sigmas: float) -> Array:
    """``sigmas`` times the sigma of the worse of a place's two coordinates, (n,)."""
    variance = np.einsum("nia,ab,nib->ni", slope, covariance, slope).max(-1, initial=0.0)
    return np.asarray(sigmas * np.sqrt(np.maximum(variance, 0.0)))


def none_in_view(catalog: Catalog, sensor: Sensor) -> str:
    """One line: the place of the image's centre (of a camera below the reference sphere its own), its distance from
    the nearest point on the sphere, and the box of the points.
    """
    none = f"none of the catalogue's {len(catalog)} points can be in view"
    if not len(catalog):
        return none
    lon, lat = catalog.longitude, catalog.latitude
    box = enclosing_bounds(lon, lon, float(lat.min()), float(lat.max()))
    points = (
        f"the points lie at longitude {box.west:.2f} .. {box.east:.2f}, "
        f"latitude {box.south:.2f} .. {box.north:.2f}"
    )
    below = below_sphere(sensor)
    shows = f"{below}, over" if below else "the image's centre shows"
    try:
        lon_deg, lat_deg = _below(sensor) if below else center_of(sensor)
    except ImageError:
        return f"{none}: the image's centre shows no ground; {points}"
    cosine = lonlat_to_mcmf(lon, lat) @ lonlat_to_mcmf(lon_deg, lat_deg) / MOON_RADIUS_M**2
    away_km = MOON_RADIUS_M / 1e3 * math.acos(float(np.clip(cosine.max(), -1.0, 1.0)))
    return (
        f"{none}: {shows} longitude {lon_deg:.2f}, latitude {lat_deg:.2f}, "
        f"{away_km:.0f} km from the nearest point; {points}"
    )


def _below(sensor: Sensor) -> tuple[float, float]:
    """Longitude and latitude, degrees, of the place below a sensor."""
    lon, lat, _ = mcmf_to_lonlat(optical_axis(sensor)[0])
    return float(lon), float(lat)
