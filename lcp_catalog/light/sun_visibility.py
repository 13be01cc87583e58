"""Sun tables of a place within its terrain: the horizon below the Sun, and the visible share of its
disc.

Public function about the Sun over a place.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ..accuracy import TIERS
from ..arrays import Array
from ..dem.mosaic import DemSet
from ..dem.plausibility import warn_of_doubts
from ..dem.public import Dems, dem_set
from ..ephemeris.solar_position import SunTable, sun_table
from ..ephemeris.times import Times
from ..errors import AreaError, ConfigError, pair
from ..geometry.frames import EnuFrame, direction_enu
from ..kernels.rays.bundles import scaled
from ..terrain.area import Area, NodeWindow
from ..terrain.far_terrain import HorizonPoints
from ..terrain.surroundings import SunRays, build_surrounded, surroundings
from ..terrain.terrain import Ground, Terrain, native_gsd_m
from .solar_disc import SolarDisc, share_at_points


def sun_at(
    center: tuple[float, float],
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
    center:
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
    ConfigError
        For ``gsd_m`` without ``dem``.

    Examples
    --------
    >>> sun = lcp.sun_at((3.63, 26.13), "1971-07-31T01:25:52")
    >>> round(float(sun.azimuth_deg[0]), 1), round(float(sun.elevation_deg[0]), 1)
    (96.5, 13.5)
    """
    lon_deg, lat_deg = pair(center, "center", "longitude and latitude, degrees")
    if dem is None:
        if gsd_m is not None:
            raise ConfigError("`gsd_m` needs `dem`: it is the cell size of the terrain")
        return sun_table(EnuFrame(lon_deg, lat_deg, height_m), times)
    return sun_over_ground(dem_set(dem), lon_deg, lat_deg, times, height_m, gsd_m)


_LOWEST_DEG = -7.0
"""Below this elevation no summit of the Moon sees the horizon (6.4 deg of dip at 10.8 km)."""


def sun_over_ground(
    dems: DemSet,
    lon_deg: float,
    lat_deg: float,
    times: Times,
    above_m: float = 0.0,
    gsd_m: float | None = None,
) -> SunTable:
    """`sun_table` of a place ``above_m`` metres over the terrain, with ``horizon_deg`` and
    ``terrain_share``.

    Nearby terrain has cells of ``gsd_m`` (None: the DEM's own); distant terrain has coarser cells
    (`surroundings`). AreaError if ``above_m`` is negative or the DEM has no height there.
    """
    if above_m < 0.0:
        raise AreaError(f"invalid height above the terrain: {above_m:g} m")
    warn_of_doubts(dems, dems.bounds)
    if gsd_m is None:
        gsd_m = native_gsd_m(dems, Area(lon_deg, lat_deg, 1e-3))
    height, index = dems.heights(lon_deg, lat_deg, gsd_m)
    if index < 0:
        raise AreaError(
            f"no DEM has a height at longitude {lon_deg:g}, latitude {lat_deg:g}; the DEM covers {dems.bounds}"
        )
    table = sun_table(EnuFrame(lon_deg, lat_deg, float(height) + above_m), times)
    lowest = float(np.min(table.elevation_deg - table.disc_radius_deg, initial=90.0))
    tangent = math.tan(math.radians(min(max(lowest, _LOWEST_DEG), 89.0)))
    ground = Ground(dems, EnuFrame(lon_deg, lat_deg), NodeWindow(0, 1, 0, 1), gsd_m)
    terrain = build_surrounded(ground, surroundings(ground, SunRays.all_around(tangent)))
    return among_terrain(table, terrain, above_m)


def among_terrain(table: SunTable, terrain: Terrain, above_m: float) -> SunTable:
    """Return a table with the horizon and the visible share of the disc, seen from ``above_m``
    metres over the terrain at the origin of its frame.
    """
    ground = terrain.field.heights_at(0.0, 0.0)
    point = np.array([[0.0, 0.0, float(ground) + above_m]])
    observer = HorizonPoints(terrain.field, point, terrain.far)
    planes, lengths = _planes(np.radians(table.azimuth_deg), terrain.field.gsd_m)
    horizon = np.degrees(np.arctan(observer.horizons(planes)[0] / lengths))
    shares = np.empty(len(table))
    for k in range(len(table)):
        sun = direction_enu(table.azimuth_deg[k], table.elevation_deg[k])
        disc = SolarDisc(math.radians(table.disc_radius_deg[k]))
        shares[k] = share_at_points(
            terrain.field, point, sun, TIERS["high"], disc, far=terrain.far
        )[0]
    return dataclasses.replace(table, horizon_deg=horizon, terrain_share=shares)


def _planes(azimuth_rad: Array, gsd_m: float) -> tuple[Array, Array]:
    """Vertical planes (k, 4) for `horizons`, from the nadir up, and metres along each for a unit of
    its direction (k,).
    """
    planes, lengths = np.empty((azimuth_rad.size, 4)), np.empty(azimuth_rad.size)
    for k, azimuth in enumerate(azimuth_rad):
        du, dv, _, _ = scaled(math.sin(azimuth), -math.cos(azimuth), 0.0)
        lengths[k] = gsd_m * math.hypot(du, dv)
        planes[k] = du, dv, -lengths[k] * 1e3, lengths[k] * 1e3
    return planes, lengths
