"""The place where the optical axis of a camera meets the surface."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import Array
from ..cameras.sensor import Sensor
from ..cameras.view import optical_axis
from ..constants import HIGHEST_M, LOWEST_M, MOON_RADIUS_M
from ..dem.mosaic import DemSet
from ..dem.nearest_pixels import nearest_heights
from ..errors import CameraError
from ..geometry.frames import mcmf_to_lonlat
from ..geometry.sphere_intersection import ranges

_STEPS = 1024


def axis_place(sensor: Sensor, dems: DemSet | None) -> tuple[float, float]:
    """Longitude and latitude, degrees, at which a sensor's optical axis first meets a DEM's stored
    pixels, or, without a DEM or beside it, the reference sphere. CameraError if it meets neither.

    The axis is sampled at `_STEPS` places between the Moon's extreme heights, and once more between
    the two of these where it goes below the surface: terrain narrower than the first step may be
    passed over.
    """
    origin, ahead = optical_axis(sensor)
    away_m = _met(origin, ahead, dems) if dems is not None else math.nan
    if math.isnan(away_m):
        away_m = float(ranges(origin, ahead))
    if math.isnan(away_m):
        raise CameraError(
            f"{sensor.name}: its optical axis does not meet the Moon; use `around` footprint"
        )
    lon, lat, _ = mcmf_to_lonlat(origin + away_m * ahead)
    return float(lon), float(lat)


def _met(origin: Array, ahead: Array, dems: DemSet) -> float:
    """Distance along the axis to the first crossing of the DEM's pixels; NaN without one."""
    top, bottom = (float(ranges(origin, ahead, MOON_RADIUS_M + h)) for h in (HIGHEST_M, LOWEST_M))
    middle = -float(origin @ ahead)  # nearest to the Moon's centre
    if np.linalg.norm(origin) <= MOON_RADIUS_M + HIGHEST_M:
        top = 0.0
    first, last = top, 2.0 * middle - top if math.isnan(bottom) else bottom
    if not first < last:
        return math.nan
    for _ in range(2):
        away = np.linspace(first, last, _STEPS)
        lon, lat, height = mcmf_to_lonlat(origin + away[:, None] * ahead)
        above = height - nearest_heights(dems, lon, lat)
        under = np.flatnonzero(above <= 0.0)
        if not under.size:
            return math.nan
        last = float(away[under[0]])
        first = float(away[max(under[0] - 1, 0)])
    return last
