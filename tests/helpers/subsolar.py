"""The subsolar point of the library's Sun direction."""

from __future__ import annotations

import datetime as dt

from lcp_catalog.ephemeris.solar_position import sun_direction_at
from lcp_catalog.geometry.frames import mcmf_to_lonlat


def subsolar_point(time_utc: str | dt.datetime) -> tuple[float, float]:
    """Longitude (0..360) and latitude in degrees of the point with the Sun overhead."""
    lon, lat, _ = mcmf_to_lonlat(sun_direction_at(time_utc))
    return float(lon), float(lat)
