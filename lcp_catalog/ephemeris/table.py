"""The Sun over a place at many instants: azimuth, elevation and visible share of the disc."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..constants import ASTRONOMICAL_UNIT_M, FRAME, SOLAR_RADIUS_RAD
from ..geometry.bounds import turned_deg
from ..geometry.frames import EnuFrame, azimuth_elevation, mcmf_to_lonlat
from .limb_darkening import VISIBLE, LimbDarkening
from .solar_position import DIRECTION_ERROR_DEG, ERROR_YEARS, apparent_sun
from .times import Instants, Times, instants

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


def share_above_plane(
    elevation_rad: NDArray[np.float64],
    radius_rad: NDArray[np.float64],
    law: LimbDarkening = VISIBLE,
) -> Array:
    """Share of the disc's light above a plane through the observer, by the elevation of the disc's
    centre above that plane.

    In the gnomonic projection from the observer onto the plane tangent to the sky at the disc's
    centre, the disc is a circle of radius tan(r) and the horizon a straight line at -tan(e).
    """
    near = np.clip(elevation_rad, -0.1, 0.1)  # beyond, the share is 0 or 1
    return np.clip(law.share_above(-np.tan(near) / np.tan(radius_rad)), 0.0, 1.0)


def azimuth_zero_lon(place: EnuFrame) -> float | None:
    """Meridian (0..360 deg) towards which azimuth 0 points at a pole; None elsewhere.

    North there is the limit along the given meridian (`geometry.frames.enu_rotation`): at the north
    pole the meridian on the far side, at the south pole the given one.
    """
    if abs(place.lat_deg) < 90.0:
        return None
    return turned_deg(place.lon_deg + (180.0 if place.lat_deg > 0.0 else 0.0))


def remarks(table: SunTable) -> list[str]:
    """Notes for readers of the values: frame, error and conventions; one line each."""
    lines = [
        f"frame {FRAME}, approximated by the IAU series of the Moon's rotation; directions are "
        f"accurate to {DIRECTION_ERROR_DEG:g} deg, {ERROR_YEARS[0]}-{ERROR_YEARS[1]}",
        "apparent Sun: light time, aberration and parallax are included; times are UTC",
        "azimuth clockwise from north; elevation of the disc's centre; share: of the disc's light "
        "above the horizontal plane, without terrain",
    ]
    if table.terrain_share is not None:
        lines.append(
            "horizon: elevation of the terrain below the disc's centre; lit: share of its light "
            "above the terrain"
        )
    zero = azimuth_zero_lon(table.place)
    if zero is not None:
        lines.append(f"at the pole azimuth 0 points along the meridian {zero:.10g} deg east")
    first, last = table.instants.years()
    if first < ERROR_YEARS[0] or last > ERROR_YEARS[1]:
        lines.append(
            f"some instants lie outside {ERROR_YEARS[0]}-{ERROR_YEARS[1]}: the error is not known "
            "for them"
        )
    return lines


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
