"""Choice of a catalogue's points for a Sun and a camera, and the scale at which an image is
searched for them.

Claims of a catalogue about its points in one image: the probability of a match before the search,
and the least covariance of a match.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Index, Mask
from ..cameras.frame_camera import Camera
from ..cameras.mistakes import Sees
from ..cameras.public import SensorOrPath, any_sensor
from ..cameras.sensor import Sensor, altitude_km, ground_slopes, pixel_size_m
from ..cameras.view import border_and_inside
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..catalog.prediction import Prediction, predict
from ..catalog.schema import DETECTION_STEP
from ..catalog.shards import Shard
from ..catalog.stored import narrowed
from ..constants import MOON_RADIUS_M
from ..errors import SunError
from ..images.image import Image
from ..landmarks.located import Units
from ..landmarks.point_spread import sharper_sigma

NO_CLAIM = 0.5
"""Probability of a match before the search where the catalogue claims nothing."""

LEAST_SIGMA_PX = 0.02
"""1 sigma, each axis, of what a match errs beyond its covariance."""

_ENOUGH, _NEARLY = 0.99, 0.9
"""Probability with which points that are enough locate a frame; share of the most units, at most those of enough points, that is
as good: 0.9 of the units that surely locate a frame are taken as enough.
"""

_LEAST_MOVING = 1e-3
"""Share of the noise that displaces matches below which that of a claim says nothing about the rest."""


@dataclass(frozen=True, eq=False)
class PointClaims:
    """Claims about n points. ``probability`` (n,): that a search finds the point; ``covariance_px2``
    (n, 2, 2): of the match, pixels of the searched image; ``usable`` (n,): the catalogue calls it
    usable. NaN, False: no claim. ``still_px2`` (n, 2, 2): covariance of the match in that part of the noise
    which the catalogue foresees and of which it knows that it displaces no match; 0 without a claim.
    """

    probability: Array
    covariance_px2: Array
    usable: Mask
    still_px2: Array

    @classmethod
    def of(
        cls, catalog: Catalog, rows: Index, sensor: Sensor, sun_directions: ArrayLike
    ) -> PointClaims:
        """Claims about rows (n,) of a catalogue in an image of ``sensor`` under Suns (n, 3)."""
        stated = claimed(catalog, rows, sensor, sun_directions)
        probability = np.asarray(stated.detection_probability, np.float64)
        slope = ground_slopes(
            sensor, catalog.position_mcmf[rows], catalog.rotation_mcmf_to_enu[rows]
        )
        turned = np.swapaxes(slope, -1, -2)
        covariance = slope @ stated.covariance_m2 @ turned
        place_m = catalog.place_sigma_m(rows) * sharper_sigma(sensor.factor)
        by_noise = covariance - place_m[:, None, None] ** 2 * (slope @ turned)
        moving = np.maximum(catalog.moving(rows), _LEAST_MOVING)
        still = np.nan_to_num((1.0 / moving - 1.0)[:, None, None] * by_noise)
        return cls(probability, covariance, stated.usable, still)

    def some(self, part: slice) -> PointClaims:
        """The claims about some of the points."""
        return PointClaims(*(values[part] for values in vars(self).values()))

    def of_matches(self, noise_px2: Array) -> Array:
        """Covariances (n, 2, 2) of matches from those in all of an image's noise: noise as it is foreseen counts as in a
        claim, any more counts whole; not smaller in any direction than the claim.
        """
        return at_least(noise_px2 - self.still_px2, self.covariance_px2)


def claimed(
    catalog: Catalog, rows: Index, sensor: Sensor, sun_directions: ArrayLike, factor: int = 1
) -> Prediction:
    """Prediction for points (rows (n,) of a catalogue) in an image of ``sensor``, reduced by ``factor``, whose pixels are those
    of the searched image; ``sun_directions`` (n, 3): unit MCMF vectors.
    """
    places, rotation = catalog.position_mcmf[rows], catalog.rotation_mcmf_to_enu[rows]
    sun = np.einsum("nij,nj->ni", rotation, np.asarray(sun_directions, np.float64))
    view = np.einsum("nij,nj->ni", rotation, sensor.towards(places))
    pixel = factor * (pixel_size_m(sensor, places) if len(rows) else np.zeros(0))
    height = altitude_km(sensor, places)
    return predict(catalog, rows, sun, view, pixel, height, factor * sensor.factor)


def at_least(covariance: Array, least: Array) -> Array:
    """Covariances (n, 2, 2), raised so that none is smaller in any direction than ``least``
    (n, 2, 2): with least = L L^T, the eigenvalues of L^-1 C L^-T below 1 become 1. Unchanged where
    one of the two is not finite, or ``least`` is singular.
    """
    raised = np.array(covariance, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        area = least[:, 0, 0] * least[:, 1, 1] - least[:, 0, 1] ** 2
        known = np.isfinite(raised).all((1, 2)) & np.isfinite(least).all((1, 2))
        known &= (least[:, 0, 0] > 0.0) & (area > 1e-12 * least[:, 0, 0] * least[:, 1, 1])
    if known.any():
        root = np.linalg.cholesky(least[known])
        inverse = np.linalg.inv(root)
        inner = inverse @ raised[known] @ np.swapaxes(inverse, -1, -2)
        values, axes = np.linalg.eigh(inner)
        outer = root @ axes
        raised[known] = (outer * np.maximum(values, 1.0)[:, None]) @ np.swapaxes(outer, -1, -2)
    return raised


RESOLUTION_SHARE = 0.5
"""Pixel size of the searched image as a share of the DEM's true resolution."""
_WIDEST_PX = 48
"""Largest useful side of a template; wider ones give no more information than ones half as wide."""
_NARROWEST_PX = 16
"""Least side of a template to which an image is reduced for the sake of the DEM's resolution."""
_CONE_MARGIN = 0.02
"""Margin of the cosine of the cone around an image, for what lies between the rays that it is made of."""


def points_in_view(catalog: Catalog, sensor: Sensor) -> Index:
    """Rows (n,), ascending, of the points that lie in the sensor's image and on the side of the
    Moon that faces it.
    """
    places = catalog.position_mcmf
    rows = _in_cone(catalog, sensor) if isinstance(sensor, Camera) else np.arange(len(places))
    pixels = sensor.project(places[rows])
    return facing(catalog, sensor, rows[sensor.in_image(pixels)])


def shows_points(catalog: CatalogOrPath) -> Sees:
    """What says whether a camera sees points of a catalogue; a file is opened when it is asked."""

    def sees(camera: Camera) -> bool:
        return len(points_in_view(opened_catalog(catalog, check=False), camera)) > 0

    return sees


def seen_from(catalog: Catalog, sensors: Sequence[Sensor]) -> Catalog:
    """The catalogue of an index with those shards alone that can have a point in the image of any of the sensors: the
    others are not opened. Its rows are its own.
    """
    seen = [_Cone.of(one) if isinstance(one, Camera) else None for one in sensors]
    return narrowed(catalog, lambda shard: any(cone is None or cone.meets(shard) for cone in seen))


def facing(catalog: Catalog, sensor: Sensor, rows: Index) -> Index:
    """Those rows whose point lies on the side of the Moon that faces the sensor."""
    places = catalog.position_mcmf[rows]
    return np.asarray(rows[(sensor.towards(places) * places).sum(-1) > 0.0])


def _in_cone(catalog: Catalog, camera: Camera) -> Index:
    """Rows (n,), ascending, of the points above whose horizontal plane the camera lies, and within the
    cone around the rays of its image: few are left to project.
    """
    cone = _Cone.of(camera)
    origin, cosine = cone.origin, cone.cosine
    # einsum takes one thread, which is enough here
    along, ahead = (np.einsum("ij,j->i", catalog.position_mcmf, one) for one in (origin, cone.axis))
    square = (MOON_RADIUS_M + catalog.elevation) ** 2
    near = along > square
    if cosine > 0.0:  # not for a wide image, or a lens without an inverse
        ahead -= origin @ cone.axis
        away = square - 2.0 * along + origin @ origin
        near &= (ahead > 0.0) & (ahead**2 >= cosine**2 * away)
    return np.flatnonzero(near)


@dataclass(frozen=True, eq=False)
class _Cone:
    """A cone around the rays of an image: origin (3,), MCMF, axis (3,), cosine of its half angle."""

    origin: Array
    axis: Array
    cosine: float

    @classmethod
    def of(cls, camera: Camera) -> _Cone:
        looking = camera.focal_plane.directions(border_and_inside(camera.shape, 9))
        rays = looking @ camera.rotation_mcmf_to_camera
        axis = rays.mean(axis=0)
        axis /= np.linalg.norm(axis)
        return cls(camera.position_mcmf_m, axis, float((rays @ axis).min()) - _CONE_MARGIN)

    def meets(self, shard: Shard) -> bool:
        """False if no point in the shard's sphere can lie in the cone with the origin above its horizontal plane."""
        center_m, radius_m = np.array(shard.center_m), shard.radius_m
        height = np.linalg.norm(self.origin)
        least = max(0.0, float(np.linalg.norm(center_m)) - radius_m)
        if center_m @ self.origin + radius_m * height <= least**2:
            return False
        away = center_m - self.origin
        distance = float(np.linalg.norm(away))
        if distance <= radius_m or not self.cosine > 0.0:
            return True
        angle = math.acos(min(1.0, max(-1.0, float(away @ self.axis) / distance)))
        return angle <= math.acos(self.cosine) + math.asin(radius_m / distance)


def at_one_scale(
    catalog: Catalog, rows: Index, sensor: Sensor, sun_directions: ArrayLike | None
) -> Index:
    """Those rows (n,) whose level works at one scale of the image: the cell is not larger than the pixel, and
    the pixel not larger than the greatest `Catalog.gsd_max` of the level. Scales are the image's own and,
    for levels of larger cells, reduced ones; the finest is taken at which points have 0.9 of the units (`landmarks.located`) that
    surely locate the frame under the Sun (``sun_directions`` (n, 3) or (3,), unit MCMF vectors), else of the most units.
    Without claims, the finest at which at least half as many points work as at the best. All rows if they are of one level, or
    if no level works.
    """
    level = np.asarray(catalog.level)[rows]
    of_level = [level == number for number in np.unique(level)]
    if len(of_level) < 2:
        return rows
    pixel_m = float(np.nanmedian(pixel_size_m(sensor, catalog.position_mcmf[rows])))
    cell_m = np.array([catalog.gsd[rows[own]].max() for own in of_level])
    coarsest_m = np.array([catalog.gsd_max[rows[own]].max() for own in of_level])
    scale_m = np.unique(np.maximum(pixel_m, cell_m))[:, None]
    works = ((cell_m <= scale_m) & (scale_m <= coarsest_m)) @ np.array(of_level)
    count = works.sum(axis=1)
    best = int(np.argmax(2 * count >= count.max()))
    if sun_directions is not None:
        suns = np.broadcast_to(sun_directions, (len(rows), 3))
        factors = np.maximum(np.rint(scale_m[:, 0] / pixel_m), 1.0).astype(np.int64).tolist()
        parts = zip(works, factors, strict=True)
        worth = [_worth(catalog, rows[some], sensor, suns[some], k) for some, k in parts]
        enough = np.minimum(worth, 1.0)
        best = int(np.argmax(enough >= _NEARLY * enough.max())) if max(worth) > 0.0 else best
    return rows[works[best]] if works[best].any() else rows


def searched_first(
    catalog: Catalog, rows: Index, sensor: Sensor, sun_directions: ArrayLike | None
) -> Index:
    """Those rows (n,) of points in view, or perhaps in view, whose level is one of those `at_one_scale` of the points in view,
    for all who ask alike; of no point in view, of the rows. ``sun_directions`` (3,) or (n, 3): unit MCMF vectors, of the rows.
    """
    level = np.asarray(catalog.level)
    if not len(rows) or (level[rows] == level[rows[0]]).all():
        return rows
    sun = None if sun_directions is None else np.mean(np.atleast_2d(sun_directions), axis=0)
    seen = points_in_view(catalog, sensor)
    first = at_one_scale(catalog, seen if len(seen) else rows, sensor, sun)
    some = rows[np.isin(level[rows], level[first])]
    return some if len(some) else rows


def searched_in(catalog: Catalog, rows: Index, image: Image) -> Index:
    """Those rows (n,) that are `searched_first` in an image under its Sun."""
    suns = image.sun_directions(catalog.position_mcmf[rows])
    return searched_first(catalog, rows, image.sensor, suns)


def _worth(catalog: Catalog, rows: Index, sensor: Sensor, suns: Array, factor: int) -> float:
    """Units of points by their claims in a reduced image, over those that surely locate a frame."""
    if not len(rows):
        return 0.0
    units = Units.of_located(_ENOUGH, float(catalog.gsd[rows].max()))
    claims = claimed(catalog, rows, sensor, suns, factor)
    p = np.nan_to_num(claims.detection_probability)
    return float(np.searchsorted(units.least, p, "right").sum()) / units.demand


def choose_points(
    catalog: CatalogOrPath,
    sensor: SensorOrPath,
    sun_direction: ArrayLike | None = None,
    most: int | None = None,
) -> Index:
    """Points in view that are usable under a Sun and a camera.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    sensor:
        Camera or another sensor, or its file.
    sun_direction:
        Unit MCMF vector (3,); None: from each point to the sensor's own Sun position.
    most:
        Upper limit of their number: the most likely ones, spread over the image.

    Returns
    -------
    array
        Rows (n,) of the catalogue, ascending.

    Raises
    ------
    SunError
        Without a Sun.

    Examples
    --------
    >>> len(lcp.choose_points(catalog, camera, most=3))
    3
    """
    catalog, sensor = opened_catalog(catalog), any_sensor(sensor)
    rows = points_in_view(catalog, sensor)
    suns = directions_to_sun(sensor, catalog.position_mcmf[rows], sun_direction)
    chosen = rows[usable_points(catalog, rows, sensor, suns)]
    if most is None:
        return chosen
    suns = directions_to_sun(sensor, catalog.position_mcmf[chosen], sun_direction)
    return chosen[likeliest(catalog, chosen, sensor, suns, most)]


def likeliest(
    catalog: Catalog, rows: Index, sensor: Sensor, sun_directions: ArrayLike, most: int
) -> Index:
    """Indices (m,), ascending, into the rows (n,): at most ``most`` points, those most likely to be
    found, spread over the image.

    The image is divided into square cells, ``most`` in its area. Taken are the points with the
    highest claimed detection probability of each cell, then the second of each cell and so on, in
    each round the highest probabilities first; of equal ones, as they are stored, the smaller sigma.
    Points with a probability below one half come after all others; a point without a claim counts
    as one half.
    ``sun_directions`` (n, 3): unit MCMF vectors.
    """
    if len(rows) <= most:
        return evenly(np.arange(len(rows)), most)
    stated = claimed(catalog, rows, sensor, sun_directions)
    probability = np.nan_to_num(stated.detection_probability, nan=0.5)
    steps = np.floor(probability / DETECTION_STEP + 0.25)
    sigma = np.nan_to_num(stated.sigma_major_m, nan=np.inf)
    side = math.sqrt(math.prod(sensor.shape) / max(most, 1))
    pixels = np.nan_to_num(sensor.project(catalog.position_mcmf[rows]))
    column, row = np.floor(pixels / side).T
    order = np.lexsort((sigma, -steps, row, column))
    first = np.ones(len(rows), bool)
    first[1:] = (np.diff(column[order]) != 0) | (np.diff(row[order]) != 0)
    place = np.arange(len(rows))
    turn = np.empty(len(rows), np.int64)
    turn[order] = place - np.maximum.accumulate(np.where(first, place, 0))
    best = np.lexsort((sigma, -steps, turn, probability < 0.5))[:most]
    return np.sort(best)


def evenly(rows: Index, most: int) -> Index:
    """At most ``most`` of the rows, evenly spread over the list, its ends included."""
    if len(rows) <= most:
        return rows
    return rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]


def usable_points(
    catalog: Catalog, points: ArrayLike, sensor: Sensor, sun_directions: ArrayLike
) -> Mask:
    """True (n,) for the points (rows (n,) of the catalogue) that are usable under a view and a Sun;
    ``sun_directions`` (n, 3): unit MCMF vectors.

    The catalogue says so for the sensor's view and pixel size, between the angles of its grid
    (`prediction.predict`).
    """
    rows = np.asarray(points, dtype=np.int64)
    return np.asarray(claimed(catalog, rows, sensor, sun_directions).usable)


def directions_to_sun(
    sensor: Sensor, points_mcmf_m: Array, sun_direction: ArrayLike | None = None
) -> Array:
    """Unit MCMF vectors (n, 3) from points (n, 3) to the Sun: ``sun_direction`` ((3,) or (n, 3)),
    or, if that is None, towards the sensor's own Sun position. SunError if the sensor has none.
    """
    if sun_direction is not None:
        given = np.asarray(sun_direction, dtype=np.float64)
        return np.broadcast_to(given, points_mcmf_m.shape)
    if sensor.sun_position_mcmf_m is None:
        raise SunError(f"{sensor.name}: has no position of the Sun; give the direction to the Sun")
    away = sensor.sun_position_mcmf_m - points_mcmf_m
    return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))


def working_image(catalog: Catalog, image: Image, points: ArrayLike) -> Image:
    """The image, reduced by a whole number to the scale at which it is searched.

    Its pixel at the points becomes the nearest size below `RESOLUTION_SHARE` of the true resolution
    of their DEM (the DEM's cell where that is coarser, or where the true resolution is unknown);
    templates become at most 48 pixels wide, and a coarse resolution leaves them at least 16. Of
    several levels (`at_one_scale`) the coarsest counts.
    """
    rows = np.asarray(points, dtype=np.int64)
    return image.reduced(reduction(catalog, image.sensor, rows)) if len(rows) else image


def reduction(catalog: Catalog, sensor: Sensor, rows: Index) -> int:
    """The whole number by which `working_image` reduces a sensor's image, for at least one point."""
    level = np.asarray(catalog.level)[rows]
    rows = rows[level == level.max()]
    pixel = float(np.nanmedian(pixel_size_m(sensor, catalog.position_mcmf[rows])))
    gsd = float(np.median(catalog.gsd[rows]))
    resolution = np.asarray(catalog.dem_resolution, dtype=np.float64)[rows]
    known = np.isfinite(resolution)
    true = float(np.median(resolution[known])) if known.any() else gsd
    narrow = gsd * catalog.patch_nodes / _NARROWEST_PX
    target = max(gsd, min(RESOLUTION_SHARE * true, narrow))
    wide = gsd * catalog.patch_nodes / _WIDEST_PX
    return max(math.floor(target / pixel), math.ceil(wide / pixel), 1)


def reductions(
    catalog: Catalog, sensor: Sensor, rows: Index, levels: frozenset[int], factor: int
) -> Index:
    """Pixels (n,) of a sensor's image along the side of one of the image in which each point (rows (n,)) is searched,
    once the sensor is known: ``factor`` for the levels that were searched first, else that of a level alone.
    """
    factors = np.full(len(rows), factor)
    level = np.asarray(catalog.level)[rows]
    for other in set(np.unique(level).tolist()) - levels:
        own = level == other
        factors[own] = reduction(catalog, sensor, rows[own])
    return factors


def usual_reductions(
    catalog: Catalog, sensor: Sensor, rows: Index, sun_directions: ArrayLike | None
) -> Index:
    """`reductions` (n,) of the points in view (rows (n,)) where some are `searched_first`."""
    if not len(rows):
        return np.ones(0, np.int64)
    first = searched_first(catalog, rows, sensor, sun_directions)
    levels = frozenset(np.asarray(catalog.level)[first].tolist())
    return reductions(catalog, sensor, rows, levels, reduction(catalog, sensor, first))


def patch_width_px(catalog: Catalog, sensor: Sensor, rows: Index) -> float:
    """Side of a patch in an image, pixels; the median of some points."""
    ground = pixel_size_m(sensor, catalog.position_mcmf[rows])
    return float(np.nanmedian(catalog.gsd[rows] * (catalog.patch_nodes - 1) / ground))
