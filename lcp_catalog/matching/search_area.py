"""Points that may lie in the image of a sensor with an uncertain position, and the reach of their
search.

A point's reach is a number of sigmas of its place in the image, by the sensor's Jacobian: to first
order in the uncertainty. If that is too far for a search point by point, the offset of the whole
image is found first (`coarse_offset.coarse_shift`); the reach is then that of the uncertainty given
this offset, by a Kalman step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Index
from ..cameras.sensor import Sensor, Uncertainty
from ..cameras.view import center_of
from ..catalog.catalogue import Catalog
from ..constants import MOON_RADIUS_M
from ..errors import ImageError
from ..geometry.bounds import enclosing_bounds
from ..geometry.frames import lonlat_to_mcmf
from ..images.image import Image
from ..photometry.laws import Reflectance
from .coarse_offset import coarse_shift
from .consensus import SIGNIFICANT
from .point_choice import facing
from .pose import jacobian

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
    reach = _reach(jacobian(sensor, catalog.position_mcmf[rows]), prior, sigmas)
    kept = (off[rows] <= np.array([width, height]) / 2.0 + reach[:, None]).all(-1)
    return SearchArea(rows[kept], np.zeros((int(kept.sum()), 2)), reach[kept])


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
    """One line: the place of the image's centre, its distance from the nearest point on the sphere,
    and the box of the points.
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
    try:
        lon_deg, lat_deg = center_of(sensor)
    except ImageError:
        return f"{none}: the image's centre shows no ground; {points}"
    cosine = lonlat_to_mcmf(lon, lat) @ lonlat_to_mcmf(lon_deg, lat_deg) / MOON_RADIUS_M**2
    away_km = MOON_RADIUS_M / 1e3 * math.acos(float(np.clip(cosine.max(), -1.0, 1.0)))
    return (
        f"{none}: the image's centre shows longitude {lon_deg:.2f}, latitude {lat_deg:.2f}, "
        f"{away_km:.0f} km from the nearest point; {points}"
    )
