"""Direction and distance of the Sun at an instant, and the rotation of the Moon.

The Sun's position comes from the series of pyerfa (Earth: epv00, Moon: moon98). The Moon's rotation
is the IAU series (Archinal et al. 2011, table 2), which approximates the mean-Earth frame. The
direction is the apparent one: it includes light time and the aberration by the Moon's motion, as
SPICE's subslr with LT+S does. The subsolar point differs from that of DE421 by at most 0.0042 deg
in 1990-2050. The directions hold at the Moon's centre; on its surface they differ by up to 0.0007
deg (R / 1 au), which `table.sun_table` includes.
"""

from __future__ import annotations

import datetime as dt
import math

import erfa
import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import ASTRONOMICAL_UNIT_M
from ..errors import SunError
from ..geometry.frames import EnuFrame, direction_enu, lonlat_to_mcmf
from .times import Times, instants

DIRECTION_ERROR_DEG = 0.005
"""Bound on the error of a direction to the Sun in the mean-Earth frame."""

ERROR_YEARS = 1990, 2050
"""First and last year for which `DIRECTION_ERROR_DEG` holds."""

_J2000 = 2451545.0
_LIGHT_TIME_DAY_PER_AU = erfa.AULT / erfa.DAYSEC

# Nutation angles E1..E13: degrees at J2000 and degrees per day.
# fmt: off
_E0 = np.array([
    125.045, 250.089, 260.008, 176.625, 357.529, 311.589, 134.963, 276.617, 34.226, 15.134,
    119.743, 239.961, 25.053,
])
_E1 = np.array([
    -0.0529921, -0.1059842, 13.0120009, 13.3407154, 0.9856003, 26.4057084, 13.0649930, 0.3287146,
    1.7484877, -0.1589763, 0.0036096, 0.1643573, 12.9590088,
])
# Their amplitudes in the pole's right ascension (sine), its declination (cosine), the spin (sine).
_RA = np.array([-3.8787, -0.1204, 0.0700, -0.0172, 0, 0.0072, 0, 0, 0, -0.0052, 0, 0, 0.0043])
_DEC = np.array([1.5419, 0.0239, -0.0278, 0.0068, 0, -0.0029, 0.0009, 0, 0, 0.0008, 0, 0, -0.0009])
_W = np.array([
    3.5610, 0.1208, -0.0642, 0.0158, 0.0252, -0.0066, -0.0047, -0.0046, 0.0028, 0.0052,
    0.0040, 0.0019, -0.0044,
])
# fmt: on


def sun_direction_at(time_utc: str | dt.datetime) -> Array:
    """Unit MCMF vector (3,) from the Moon's centre to the apparent Sun.

    A time without a time zone is UTC. SunError for an invalid time or a year outside 1900-2099.
    """
    directions, _ = apparent_sun(time_utc)
    return np.asarray(directions[0])


def sun_distance_m(time_utc: str | dt.datetime) -> float:
    """Distance between the centres of the Moon and the Sun in metres; errors as `sun_direction_at`."""
    _, distance_au = apparent_sun(time_utc)
    return float(distance_au[0]) * ASTRONOMICAL_UNIT_M


def apparent_sun(times: Times) -> tuple[Array, Array]:
    """Unit MCMF vectors (n, 3) from the Moon's centre to the apparent Sun, and its distance (n,) in
    au.
    """
    jd1, jd2 = instants(times).terrestrial()  # approximates TDB within 2 ms
    heliocentric, barycentric = erfa.epv00(jd1, jd2)
    lunar = erfa.moon98(jd1, jd2)
    velocity = (barycentric["v"] + lunar["v"]) * _LIGHT_TIME_DAY_PER_AU  # of the Moon, in c
    geometric = -heliocentric["p"] - lunar["p"]
    delay = np.linalg.norm(geometric, axis=-1) * _LIGHT_TIME_DAY_PER_AU
    drift = barycentric["v"] - heliocentric["v"]  # the Sun's own motion, 13 m/s
    to_sun = geometric - drift * delay[:, None]
    distance_au = np.linalg.norm(to_sun, axis=-1)
    lorentz = np.sqrt(1.0 - np.sum(velocity**2, axis=-1))
    apparent = erfa.ab(to_sun / distance_au[:, None], velocity, distance_au, lorentz)
    rotation = lunar_rotation((jd1 - _J2000) + jd2)
    return np.einsum("nij,nj->ni", rotation, apparent), distance_au


def lunar_rotation(days: ArrayLike) -> Array:
    """Rotation (..., 3, 3) from the celestial frame (ICRF) to the body-fixed frame, ``days`` (...)
    of TDB after J2000 (Archinal et al. 2011).
    """
    days = np.asarray(days, dtype=np.float64)
    angles = np.radians(_E0 + _E1 * days[..., None])
    sines, centuries = np.sin(angles), days / 36525.0
    ra = np.radians(269.9949 + 0.0031 * centuries + (sines * _RA).sum(-1))
    dec = np.radians(66.5392 + 0.0130 * centuries + (np.cos(angles) * _DEC).sum(-1))
    spin = np.radians(38.3213 + 13.17635815 * days - 1.4e-12 * days**2 + (sines * _W).sum(-1))
    node = erfa.rz(math.pi / 2 + ra, np.eye(3))
    return np.asarray(erfa.rz(spin, erfa.rx(math.pi / 2 - dec, node)), dtype=np.float64)


def direction_from_subsolar(lon_deg: float, lat_deg: float) -> Array:
    """Unit MCMF direction (3,) to a Sun that is overhead at a place, degrees.

    SunError for a place that does not exist. Latitudes beyond +-1.59 deg do not occur in nature but
    are allowed.
    """
    if not (math.isfinite(lon_deg) and math.isfinite(lat_deg) and abs(lat_deg) <= 90.0):
        raise SunError(f"invalid subsolar point: longitude {lon_deg}, latitude {lat_deg}")
    unit = lonlat_to_mcmf(lon_deg, lat_deg)
    return unit / np.linalg.norm(unit)


def direction_from_angles(frame: EnuFrame, azimuth_deg: float, elevation_deg: float) -> Array:
    """Unit MCMF direction (3,) to a Sun at an azimuth (clockwise from north) and elevation,
    degrees, at the frame's origin. SunError for angles that do not exist.
    """
    if not (math.isfinite(azimuth_deg) and -90.0 <= elevation_deg <= 90.0):
        raise SunError(f"invalid Sun: azimuth {azimuth_deg} deg, elevation {elevation_deg} deg")
    return frame.direction_to_mcmf(direction_enu(azimuth_deg, elevation_deg))


def direction_from_position(frame: EnuFrame, sun_position_mcmf_m: ArrayLike) -> Array:
    """Unit MCMF direction (3,) from the frame's origin to a Sun position (MCMF metres). SunError
    for a position that is not finite or nearer than 1e9 m.
    """
    position = np.asarray(sun_position_mcmf_m, dtype=np.float64)
    if position.shape != (3,) or not np.isfinite(position).all() or np.linalg.norm(position) < 1e9:
        raise SunError(
            f"invalid Sun position: {position.tolist()} (three MCMF coordinates in metres)"
        )
    towards = position - frame.origin_mcmf_m
    return towards / np.linalg.norm(towards)
