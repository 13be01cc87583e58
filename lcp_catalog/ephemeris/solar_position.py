"""Direction and distance of the Sun at an instant, and the rotation of the Moon.

The Sun's position comes from the series of pyerfa (Earth: epv00, Moon: moon98). The Moon's rotation
is the IAU series (Archinal et al. 2011, table 2), which approximates the mean-Earth frame. The
direction is the apparent one: it includes light time and the aberration by the Moon's motion, as
SPICE's subslr with LT+S does. The subsolar point differs from that of DE421 by at most 0.0042 deg
in 1990-2050. The directions hold at the Moon's centre; on its surface they differ by up to 0.0007
deg (R / 1 au), which `solar_position.sun_table` includes.

The Sun over a place at many instants: azimuth, elevation and visible share of the disc.

Sun directions that can occur at a latitude.
"""

from __future__ import annotations

import datetime as dt
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..constants import ASTRONOMICAL_UNIT_M, FRAME, SOLAR_RADIUS_RAD, SUBSOLAR_LATITUDE_MAX_DEG
from ..errors import SunError
from ..geometry.bounds import turned_deg
from ..geometry.frames import (
    EnuFrame,
    azimuth_elevation,
    direction_enu,
    lonlat_to_mcmf,
    mcmf_to_lonlat,
)
from .limb_darkening import VISIBLE
from .times import Instants, Times, instants

SUNS_DIFFER_DEG = 1.0
"""Angle between two Suns of one image above which it is said."""

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


DECIMALS = 6
"""Decimals of the values of `SunTable.records`; their error is far larger."""

_CHUNK = 1 << 15


@dataclass(frozen=True, eq=False)
class SunTable:
    """The Sun over a place at ``n`` instants, each array (n,).

    Azimuth is clockwise from north, 0..360. Elevation is that of the disc's centre above the
    horizontal plane of the place. ``disc_share`` is the share of the disc's light above that plane,
    without terrain. The subsolar point, longitude 0..360, is that of the Moon's centre; distance
    and angular radius are those at the place. With terrain (`light.sun_visibility`):
    ``horizon_deg``, the elevation of the terrain horizon at the azimuth of the disc's centre, and
    ``terrain_share``, the share of the disc's light above the terrain horizon.
    """

    place: EnuFrame
    instants: Instants
    azimuth_deg: Array
    elevation_deg: Array
    disc_share: Array
    subsolar_lon: Array
    subsolar_lat: Array
    distance_au: Array
    disc_radius_deg: Array
    horizon_deg: Array | None = None
    terrain_share: Array | None = None

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the columns that the table has."""
        return tuple(name for name in FIGURES if getattr(self, name) is not None)

    def __len__(self) -> int:
        return len(self.instants)

    def records(self) -> Iterator[dict[str, str | float]]:
        """One record per instant, rounded to `DECIMALS`; the distance to two more."""
        figures = {name: np.round(getattr(self, name), DECIMALS) + 0.0 for name in self.figures}
        for name in ("azimuth_deg", "subsolar_lon"):
            figures[name] %= 360.0  # 359.9999999 is rounded to 360
        figures["distance_au"] = np.round(self.distance_au, DECIMALS + 2)
        columns = [self.instants.labels(), *(values.tolist() for values in figures.values())]
        for row in zip(*columns, strict=True):
            yield dict(zip(("time_utc", *self.figures), row, strict=True))

    @property
    def title(self) -> str:
        """The place, in words."""
        place = self.place
        return (
            f"the Sun over longitude {place.lon_deg:.10g}, latitude {place.lat_deg:.10g} deg, "
            f"{place.height_m:.10g} m above the sphere"
        )

    def remarks(self) -> list[str]:
        """Notes for readers of the values: frame, error and conventions; one line each."""
        lines = [
            f"frame {FRAME}, approximated by the IAU series of the Moon's rotation; directions are "
            f"accurate to {DIRECTION_ERROR_DEG:g} deg, {ERROR_YEARS[0]}-{ERROR_YEARS[1]}",
            "apparent Sun: light time, aberration and parallax are included; times are UTC",
            "azimuth clockwise from north; elevation of the disc's centre; share: of the disc's light "
            "above the horizontal plane, without terrain",
        ]
        if self.terrain_share is not None:
            lines.append(
                "horizon: elevation of the terrain below the disc's centre; lit: share of its light "
                "above the terrain"
            )
        if (zero := azimuth_zero_lon(self.place)) is not None:
            lines.append(f"at the pole azimuth 0 points along the meridian {zero:.10g} deg east")
        first, last = self.instants.years()
        if first < ERROR_YEARS[0] or last > ERROR_YEARS[1]:
            lines.append(
                f"some instants lie outside {ERROR_YEARS[0]}-{ERROR_YEARS[1]}: the error is not known "
                "for them"
            )
        return lines

    def csv_lines(self) -> Iterator[str]:
        """Lines of a CSV table of `records`, after `title` and `remarks` as comments."""
        yield from (f"# {line}\n" for line in (self.title, *self.remarks()))
        yield ",".join(("time_utc", *self.figures)) + "\n"
        for record in self.records():
            yield ",".join(map(str, record.values())) + "\n"

    def json_lines(self) -> Iterator[str]:
        """Lines of a JSON document, so that a million instants need no second copy."""
        head = {
            "frame": FRAME,
            "direction_error_deg": DIRECTION_ERROR_DEG,
            "lon": self.place.lon_deg,
            "lat": self.place.lat_deg,
            "height_m": self.place.height_m,
            "azimuth_zero_lon": azimuth_zero_lon(self.place),
            "remarks": self.remarks(),
        }
        yield json.dumps(head, indent=2).removesuffix("\n}") + ',\n  "suns": [\n'
        for index, record in enumerate(self.records(), 1):
            yield "    " + json.dumps(record) + (",\n" if index < len(self) else "\n")
        yield "  ]\n}\n"


FIGURES = (
    "azimuth_deg",
    "elevation_deg",
    "disc_share",
    "subsolar_lon",
    "subsolar_lat",
    "distance_au",
    "disc_radius_deg",
    "horizon_deg",
    "terrain_share",
)


def sun_table(place: EnuFrame, times: Times) -> SunTable:
    """The Sun over a place, including parallax (up to 0.0007 deg).

    SunError for an invalid time or a year outside 1900-2099.
    """
    when = instants(times)
    chunks = [_columns(place, when[k : k + _CHUNK]) for k in range(0, max(len(when), 1), _CHUNK)]
    columns = np.concatenate(chunks, axis=1)
    return SunTable(place, when, *columns)  # the rows of `_columns` are the fields, in their order


def share_above_plane(elevation_rad: NDArray[np.float64], radius_rad: NDArray[np.float64]) -> Array:
    """Share of the disc's light above a plane through the observer, by the elevation of the disc's
    centre above that plane.

    In the gnomonic projection from the observer onto the plane tangent to the sky at the disc's
    centre, the disc is a circle of radius tan(r) and the horizon a straight line at -tan(e).
    """
    near = np.clip(elevation_rad, -0.1, 0.1)  # beyond, the share is 0 or 1
    return np.clip(VISIBLE.share_above(-np.tan(near) / np.tan(radius_rad)), 0.0, 1.0)


def azimuth_zero_lon(place: EnuFrame) -> float | None:
    """Meridian (0..360 deg) towards which azimuth 0 points at a pole; None elsewhere.

    North there is the limit along the given meridian (`geometry.frames.enu_rotation`): at the north
    pole the meridian on the far side, at the south pole the given one.
    """
    if abs(place.lat_deg) < 90.0:
        return None
    return turned_deg(place.lon_deg + (180.0 if place.lat_deg > 0.0 else 0.0))


def _columns(place: EnuFrame, when: Instants) -> Array:
    """Values of `SunTable` in the order of its fields, (7, n)."""
    direction, distance_au = apparent_sun(when)
    from_place = direction * (distance_au * ASTRONOMICAL_UNIT_M)[:, None] - place.origin_mcmf_m
    azimuth, elevation = azimuth_elevation(place.direction_from_mcmf(from_place))
    seen_au = np.linalg.norm(from_place, axis=-1) / ASTRONOMICAL_UNIT_M
    radius = np.arcsin(np.sin(SOLAR_RADIUS_RAD) / seen_au)
    share = share_above_plane(np.radians(elevation), radius)
    lon, lat, _ = mcmf_to_lonlat(direction)
    return np.stack([azimuth, elevation, share, lon, lat, seen_au, np.degrees(radius)])


def reachable_suns(
    lat_deg: float, azimuths_deg: ArrayLike, elevations_deg: ArrayLike
) -> NDArray[np.bool_]:
    """Mask (n_el, n_az): True for cells of a grid of Sun directions in which the Sun can occur.

    A cell is the box of half steps around its direction (see `azimuth_boxes`, `elevation_boxes`).
    It is reachable if some direction in the box has a declination within +-(1.59 deg + solar
    radius). SunError for a latitude or elevations that are invalid.
    """
    lowest, highest = declination_range(lat_deg, azimuths_deg, elevations_deg)
    return np.asarray((lowest <= _HIGHEST_EDGE) & (highest >= -_HIGHEST_EDGE))


def can_stand(lat_deg: float, azimuth_rad: Array, elevation_rad: Array) -> NDArray[np.bool_]:
    """True for directions, radians, arrays that broadcast, in which the Sun can occur at a latitude: their declination is
    within +-(1.59 deg + solar radius).
    """
    lat = math.radians(lat_deg)
    sine = math.sin(lat) * np.sin(elevation_rad)
    sine += math.cos(lat) * np.cos(elevation_rad) * np.cos(azimuth_rad)
    return np.asarray(np.abs(sine) <= _HIGHEST_EDGE)


_HIGHEST_EDGE = math.sin(math.radians(SUBSOLAR_LATITUDE_MAX_DEG) + SOLAR_RADIUS_RAD)
"""Greatest sine of the declination of the disc's edge."""


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
