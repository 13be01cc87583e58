"""Public function about the Sun over a place."""

from __future__ import annotations

from ..dem.public import Dems, dem_set
from ..ephemeris.table import SunTable, sun_table
from ..ephemeris.times import Times
from ..geometry.frames import EnuFrame
from .sun_visibility import sun_over_ground


def sun_at(
    center_deg: tuple[float, float],
    times: Times,
    *,
    height_m: float = 0.0,
    dem: Dems | None = None,
    gsd_m: float | None = None,
) -> SunTable:
    """The Sun over a place on the Moon at instants: azimuth, elevation, visible share of the disc,
    subsolar point, distance; with a DEM also the terrain's horizon.

    Light time, aberration and parallax are included; directions are accurate to
    `ephemeris.solar_position.DIRECTION_ERROR_DEG` (Earth and Sun: ERFA's ``epv00``; the Moon: Meeus,
    Astronomical Algorithms; its rotation: IAU).

    Parameters
    ----------
    center_deg:
        Longitude and latitude of the place, degrees.
    times:
        One instant (ISO text, UTC, or datetime), several, or `Instants`, 1900 to 2099.
    height_m:
        Height above the sphere of 1737.4 km; with ``dem``: above the terrain.
    dem:
        DEM files: add the terrain's horizon and the share of the disc above it.
    gsd_m:
        With ``dem``: cell size of the terrain nearby, metres; None: the DEM's own.

    Raises
    ------
    SunError
        For an invalid time.
    AreaError
        If the DEM has no height at the place, or ``height_m`` is negative with a DEM.

    Examples
    --------
    >>> sun = lcp.sun_at((3.63, 26.13), "1971-07-31T01:25:52")
    >>> round(float(sun.azimuth_deg[0]), 1), round(float(sun.elevation_deg[0]), 1)
    (96.5, 13.5)
    """
    lon_deg, lat_deg = center_deg
    if dem is None:
        return sun_table(EnuFrame(lon_deg, lat_deg, height_m), times)
    return sun_over_ground(dem_set(dem), lon_deg, lat_deg, times, height_m, gsd_m)
