"""Planes of overview maps: orthographic for regions that a tangent plane shows, else equirectangular or
polar stereographic.

Map projections of the Moon, for every projection that PROJ supports: longitude and latitude to
map coordinates and back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..errors import LabelError
from .bounds import Bounds, turned_deg, wrapped_deg
from .frames import EnuFrame, enu_rotation, lonlat_to_mcmf, mcmf_to_lonlat

if TYPE_CHECKING:
    import pyproj

RADIUS_RANGE_M = (1_730_000.0, 1_742_000.0)
"""Range of axes that are accepted as the Moon's: radii of 1735 to 1738.1 km are in use."""

_CYLINDERS = ("cylindrical", "plate carr", "equirectangular", "mercator")
_NO_CYLINDERS = ("transverse", "oblique")


def lunar_crs(
    wkt: str, radius_range_m: tuple[float, float] = RADIUS_RANGE_M
) -> tuple[pyproj.CRS, tuple[float, float]]:
    """A geographic or projected CRS of the Moon, and its semi-major and semi-minor axis, metres.

    Raises LabelError for a text that is no CRS, for another kind of CRS, and for axes outside
    ``radius_range_m``.
    """
    import pyproj  # noqa: PLC0415  # 20 MB and 0.1 s: only where a CRS is read

    try:
        crs = pyproj.CRS.from_wkt(wkt)
    except pyproj.exceptions.CRSError as error:
        raise LabelError(f"the CRS is not understood: {error}") from error
    ellipsoid = crs.ellipsoid
    if not (crs.is_geographic or crs.is_projected) or ellipsoid is None:
        raise LabelError(f"the CRS {crs.name!r} is neither geographic nor projected")
    major, minor = float(ellipsoid.semi_major_metre), float(ellipsoid.semi_minor_metre)
    low, high = radius_range_m
    if not (low <= minor <= high and low <= major <= high):
        raise LabelError(
            f"the CRS has radii {major:.10g}/{minor:.10g} m, not the Moon's "
            f"(a sphere of {MOON_RADIUS_M:.10g} m)"
        )
    return crs, (major, minor)


class MapProjection:
    """A CRS of the Moon. Longitudes and latitudes are planetocentric degrees for any figure of the
    CRS: on a sphere of another radius they stay, and geodetic latitudes of an ellipsoid are
    converted.

    LabelError for a text that is not a CRS, for a CRS that is neither geographic nor projected, and
    for a figure that is not the Moon's.
    """

    def __init__(self, wkt: str) -> None:
        self.crs, (major, minor) = lunar_crs(wkt)
        self.radius_m, self._axis_ratio = major, minor / major

    @cached_property
    def _transformer(self) -> pyproj.Transformer:
        """Transformer from longitude and geodetic latitude, degrees, from the Moon's prime
        meridian, to the map.
        """
        import pyproj  # noqa: PLC0415  # as in `lunar_crs`

        major, minor = self.radius_m, self.radius_m * self._axis_ratio
        longlat = pyproj.CRS.from_dict({"proj": "longlat", "a": major, "b": minor})
        return pyproj.Transformer.from_crs(longlat, self.crs, always_xy=True)

    def forward(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Array, Array]:
        """Map coordinates x, y of places, in the unit of the CRS; NaN outside the projection's
        domain.
        """
        lon, lat = np.broadcast_arrays(
            np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
        )
        if self._axis_ratio != 1.0:
            lat = np.degrees(np.arctan(np.tan(np.radians(lat)) / self._axis_ratio**2))
        x, y = self._transformer.transform(lon, lat)
        return _finite(x, y)

    def inverse(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Longitude (-180..360) and latitude, degrees, of map coordinates; NaN off the map."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        lon, lat = self._transformer.transform(x, y, direction="INVERSE")
        lon, lat = _finite(lon, lat)
        if self._axis_ratio != 1.0:
            lat = np.degrees(np.arctan(np.tan(np.radians(lat)) * self._axis_ratio**2))
        return _finite(lon, np.where(np.abs(lat) <= 90.0 + 1e-9, lat, np.nan))

    @cached_property
    def is_cylinder(self) -> bool:
        """True if meridians are parallel lines, so that the map repeats itself in x."""
        if self.crs.is_geographic:
            return True
        operation = self.crs.coordinate_operation
        method = "" if operation is None else operation.method_name.lower()
        return any(name in method for name in _CYLINDERS) and not any(
            name in method for name in _NO_CYLINDERS
        )

    @cached_property
    def period(self) -> float:
        """Increase of x once around the Moon, in the unit of the CRS; infinite for a map that does
        not repeat itself.
        """
        if not self.is_cylinder:
            return math.inf
        if self.crs.is_geographic:
            return float(2.0 * math.pi / self.crs.axis_info[0].unit_conversion_factor)
        middle, _ = self.inverse(0.0, 0.0)
        lon = middle + np.array([-60.0, 60.0])
        x, _ = self.forward(lon, np.zeros(2))
        return float(abs(x[1] - x[0]) * 3.0)


@lru_cache(maxsize=64)
def map_projection(wkt: str) -> MapProjection:
    """The projection of a CRS. It is cached, since images of one map share it."""
    return MapProjection(wkt)


def _finite(x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Both coordinates as float64, NaN where either is infinite (PROJ's sign of failure)."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    known = np.isfinite(x) & np.isfinite(y)
    return np.where(known, x, np.nan), np.where(known, y, np.nan)


ORTHOGRAPHIC = "orthographic"
EQUIRECTANGULAR = "equirectangular"
POLAR_STEREOGRAPHIC = "polar stereographic"
PROJECTIONS = (ORTHOGRAPHIC, EQUIRECTANGULAR, POLAR_STEREOGRAPHIC)

GEOGRAPHIC_WKT = (
    'GEOGCS["GCS_Moon_2015",DATUM["D_Moon_2015",'
    f'SPHEROID["Moon_2015_IAU_IAG",{MOON_RADIUS_M:.1f},0]],'
    'PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]'
)
"""Longitude and latitude on the sphere, WKT 1."""

_POLAR_REACH_DEG = 75.0
"""Greatest distance from the pole of a polar map."""
_EDGE = 129


@dataclass(frozen=True)
class MapPlane:
    """A plane with x to the right and y up, metres on the sphere of 1737400 m, its origin at a centre.

    Orthographic: east and north of the centre's tangent frame, the near side. Equirectangular: true
    to scale at the centre's parallel, all longitudes within 180 degrees of the centre. Polar
    stereographic: true to scale at the centre, which is a pole; the centre's meridian runs down
    from the north pole, up from the south pole. ValueError for another projection, or for a polar map
    whose centre is not a pole.
    """

    projection: str
    center_lon: float
    center_lat: float

    def __post_init__(self) -> None:
        if self.projection not in PROJECTIONS:
            raise ValueError(f"unknown projection {self.projection!r}")
        if self.projection == POLAR_STEREOGRAPHIC and abs(self.center_lat) != 90.0:
            raise ValueError(f"a polar map has its centre at a pole, not at {self.center_lat:g}")

    @classmethod
    def showing(cls, box: Bounds) -> MapPlane:
        """The plane for a box that is too large for a tangent plane."""
        for pole, away in ((90.0, 90.0 - box.south), (-90.0, 90.0 + box.north)):
            if away <= _POLAR_REACH_DEG:
                return cls(POLAR_STEREOGRAPHIC, 0.0, pole)
        lon, lat = turned_deg((box.west + box.east) / 2.0), (box.south + box.north) / 2.0
        return cls(EQUIRECTANGULAR, lon, lat)

    @property
    def wkt(self) -> str:
        """The CRS whose x and y are those of the plane, in metres, for points of the sphere; WKT 1."""
        lon = self.center_lon - 360.0 if self.center_lon > 180.0 else self.center_lon
        lon, lat = float(lon), float(self.center_lat)
        method, parameters = {
            ORTHOGRAPHIC: ("Orthographic", {"latitude_of_origin": lat, "central_meridian": lon}),
            EQUIRECTANGULAR: (
                "Equirectangular",
                {"standard_parallel_1": lat, "latitude_of_origin": lat, "central_meridian": lon},
            ),
            POLAR_STEREOGRAPHIC: (
                "Polar_Stereographic",
                {"latitude_of_origin": lat, "central_meridian": lon, "scale_factor": 1},
            ),
        }[self.projection]
        named = "".join(f'PARAMETER["{name}",{value!r}],' for name, value in parameters.items())
        return (
            f'PROJCS["Moon {self.projection}, centred at {lon:.6f} {lat:.6f}",'
            f'{GEOGRAPHIC_WKT},PROJECTION["{method}"],{named}'
            'PARAMETER["false_easting",0],PARAMETER["false_northing",0],'
            'UNIT["metre",1],AXIS["Easting",EAST],AXIS["Northing",NORTH]]'
        )

    @cached_property
    def _frame(self) -> EnuFrame:
        return EnuFrame(self.center_lon, self.center_lat)

    @property
    def _north(self) -> bool:
        return self.center_lat > 0.0

    def places(self, position_mcmf_m: ArrayLike) -> tuple[Array, Array]:
        """x and y of positions (..., 3) in the Moon-fixed frame, metres; NaN where the plane does not
        show them.
        """
        position = np.asarray(position_mcmf_m, dtype=np.float64)
        if self.projection == ORTHOGRAPHIC:
            x, y, z = np.moveaxis(self._frame.from_mcmf(position), -1, 0)
            hidden = z < -MOON_RADIUS_M
            return np.where(hidden, np.nan, x), np.where(hidden, np.nan, y)
        lon, lat, _ = mcmf_to_lonlat(position)
        return self.at(lon, lat)

    def at(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Array, Array]:
        """x and y of places on the sphere, metres; NaN where the plane does not show them."""
        lon, lat = np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64)
        if self.projection == ORTHOGRAPHIC:
            return self.places(lonlat_to_mcmf(lon, lat))
        if self.projection == EQUIRECTANGULAR:
            away = wrapped_deg(lon - self.center_lon)
            x = MOON_RADIUS_M * math.cos(math.radians(self.center_lat)) * np.radians(away)
            return x, MOON_RADIUS_M * np.radians(lat - self.center_lat)
        colatitude = np.radians(90.0 - lat if self._north else 90.0 + lat)
        radius = 2.0 * MOON_RADIUS_M * np.tan(np.minimum(colatitude, np.radians(170.0)) / 2.0)
        turn = np.radians(lon - self.center_lon)
        down = radius * np.cos(turn)
        return radius * np.sin(turn), -down if self._north else down

    def lonlat(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[Array, Array]:
        """Longitude (0..360) and latitude, degrees, of the places on the sphere at x and y; NaN off the
        Moon.
        """
        x, y = np.asarray(x_m, np.float64), np.asarray(y_m, np.float64)
        if self.projection == ORTHOGRAPHIC:
            up = MOON_RADIUS_M**2 - x**2 - y**2
            z = np.sqrt(np.where(up >= 0.0, up, np.nan)) - MOON_RADIUS_M
            lon, lat, _ = mcmf_to_lonlat(self._frame.to_mcmf(np.stack([x, y, z], axis=-1)))
            return lon, lat
        if self.projection == EQUIRECTANGULAR:
            away = np.degrees(x / MOON_RADIUS_M / math.cos(math.radians(self.center_lat)))
            lat = self.center_lat + np.degrees(y / MOON_RADIUS_M)
            off = (np.abs(away) > 180.0 + 1e-9) | (np.abs(lat) > 90.0 + 1e-9)
            lon = np.where(off, np.nan, turned_deg(self.center_lon + away))
            return lon, np.where(off, np.nan, np.clip(lat, -90.0, 90.0))
        colatitude = np.degrees(2.0 * np.arctan(np.hypot(x, y) / (2.0 * MOON_RADIUS_M)))
        turn = np.degrees(np.arctan2(x, -y if self._north else y))
        lat = 90.0 - colatitude if self._north else colatitude - 90.0
        return turned_deg(self.center_lon + turn), lat

    def north(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> Array:
        """Direction of north on the map at places (n,), degrees clockwise from up."""
        lon, lat = np.radians(np.atleast_1d(lon_deg)), np.radians(np.atleast_1d(lat_deg))
        if self.projection == EQUIRECTANGULAR:
            return np.zeros(lon.shape)
        if self.projection == POLAR_STEREOGRAPHIC:
            turn = lon - math.radians(self.center_lon)
            east, up = -np.sin(turn), np.cos(turn)
            return np.asarray(np.degrees(np.arctan2(east if self._north else -east, up)))
        direction = np.stack(
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], -1
        )
        along = direction @ enu_rotation(self.center_lon, self.center_lat).T
        return np.degrees(np.arctan2(along[:, 0], along[:, 1]))

    def extent_m(self, box: Bounds) -> tuple[float, float, float, float]:
        """Least x, greatest x, least y, greatest y of a box that the plane shows."""
        if self.projection == EQUIRECTANGULAR:
            half = math.radians((box.east - box.west) / 2.0) * MOON_RADIUS_M
            half *= math.cos(math.radians(self.center_lat))
            _, (low, high) = self.at([0.0, 0.0], [box.south, box.north])
            return -half, half, float(low), float(high)
        lon, lat = np.meshgrid(
            np.linspace(box.west, box.east, _EDGE), np.linspace(box.south, box.north, _EDGE)
        )
        x, y = self.at(lon, lat)
        return float(np.nanmin(x)), float(np.nanmax(x)), float(np.nanmin(y)), float(np.nanmax(y))
