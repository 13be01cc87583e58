"""Sun directions that can occur at a latitude."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..constants import SOLAR_RADIUS_RAD, SUBSOLAR_LATITUDE_MAX_DEG
from ..errors import SunError
from ..geometry.bounds import turned_deg


def reachable_suns(
    lat_deg: float, azimuths_deg: ArrayLike, elevations_deg: ArrayLike
) -> NDArray[np.bool_]:
    """Mask (n_el, n_az): True for cells of a grid of Sun directions in which the Sun can occur.

    A cell is the box of half steps around its direction (see `azimuth_boxes`, `elevation_boxes`).
    It is reachable if some direction in the box has a declination within +-(1.59 deg + solar
    radius). SunError for a latitude or elevations that are invalid.
    """
    lowest, highest = declination_range(lat_deg, azimuths_deg, elevations_deg)
    limit = math.sin(math.radians(SUBSOLAR_LATITUDE_MAX_DEG) + SOLAR_RADIUS_RAD)
    return np.asarray((lowest <= limit) & (highest >= -limit))


def highest_sun_deg(lat_deg: float) -> float:
    """Greatest elevation of the solar disc's upper edge at a latitude, degrees; at most 90."""
    edge_deg = SUBSOLAR_LATITUDE_MAX_DEG + math.degrees(SOLAR_RADIUS_RAD)
    return min(90.0, 90.0 - abs(lat_deg) + edge_deg)


def declination_range(
    lat_deg: float, azimuths_deg: ArrayLike, elevations_deg: ArrayLike
) -> tuple[Array, Array]:
    """Least and greatest sine of the declination over each cell's box, (n_el, n_az) each; exact.

    sin(dec) = sin(lat) sin(el) + cos(lat) cos(el) cos(az) is monotone in cos(az). For a given
    cos(az) it is a single cosine in el, so that the extremes have a closed form.
    """
    if not abs(lat_deg) <= 90.0:
        raise SunError(f"invalid latitude: {lat_deg}")
    lat = math.radians(lat_deg)
    sin_lat, cos_lat = math.sin(lat), max(0.0, math.cos(lat))
    cos_min, cos_max = _cosine_range(*azimuth_boxes(azimuths_deg))
    low, high = (np.radians(edge)[:, None] for edge in elevation_boxes(elevations_deg))
    highest = _extreme(sin_lat, cos_lat * cos_max[None, :], low, high)
    lowest = -_extreme(-sin_lat, -cos_lat * cos_min[None, :], low, high)
    return lowest, highest


def azimuth_boxes(azimuths_deg: ArrayLike) -> tuple[Array, Array]:
    """Edges of the boxes (n,), degrees, first <= last, in the order given: halfway to the
    neighbours on the circle.

    A gap of more than half a circle ends a partial range: the box is then as wide outwards as
    inwards. A single azimuth has no width.
    """
    azimuth = turned_deg(np.atleast_1d(np.asarray(azimuths_deg, dtype=np.float64)))
    order = np.argsort(azimuth, kind="stable")
    sorted_ = azimuth[order]
    after = np.diff(np.append(sorted_, sorted_[0] + 360.0))
    before = np.roll(after, 1)
    left = np.where(before <= 180.0, before, np.where(after <= 180.0, after, 0.0)) / 2
    right = np.where(after <= 180.0, after, np.where(before <= 180.0, before, 0.0)) / 2
    first, last = np.empty_like(azimuth), np.empty_like(azimuth)
    first[order], last[order] = sorted_ - left, sorted_ + right
    return first, last


def elevation_boxes(elevations_deg: ArrayLike) -> tuple[Array, Array]:
    """Edges of the boxes (n,), degrees, within 0..90: halfway to the neighbours; boxes at the ends
    are as wide outwards as inwards.

    The elevations must increase. A single elevation has no width.
    """
    elevation = np.atleast_1d(np.asarray(elevations_deg, dtype=np.float64))
    if not (np.diff(elevation) > 0).all() or not ((elevation >= -90) & (elevation <= 90)).all():
        raise SunError("the Sun's elevations must increase and lie within -90..90 deg")
    step = np.diff(elevation) if elevation.size > 1 else np.zeros(1)
    below, above = np.append(step[:1], step)[: elevation.size], np.append(step, step[-1:])
    first, last = elevation - below / 2, elevation + above[: elevation.size] / 2
    return np.clip(first, 0.0, 90.0), np.clip(last, 0.0, 90.0)


def _cosine_range(first_deg: Array, last_deg: Array) -> tuple[Array, Array]:
    """Least and greatest cosine over intervals of an angle."""
    a, b = np.cos(np.radians(first_deg)), np.cos(np.radians(last_deg))
    has_zero = np.floor(last_deg / 360.0) >= np.ceil(first_deg / 360.0)
    has_half = np.floor((last_deg - 180.0) / 360.0) >= np.ceil((first_deg - 180.0) / 360.0)
    return np.where(has_half, -1.0, np.minimum(a, b)), np.where(has_zero, 1.0, np.maximum(a, b))


def _extreme(sine: float, cosine: Array, low: Array, high: Array) -> Array:
    """Greatest value of sine * sin(el) + cosine * cos(el) over low <= el <= high (radians, within
    0..pi/2).
    """
    ends = np.maximum(
        sine * np.sin(low) + cosine * np.cos(low), sine * np.sin(high) + cosine * np.cos(high)
    )
    crest = np.arctan2(sine, cosine)
    return np.where((low <= crest) & (crest <= high), np.hypot(sine, cosine), ends)
