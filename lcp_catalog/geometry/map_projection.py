"""Map projections of the Moon, for every projection that PROJ supports: longitude and latitude to
map coordinates and back.
"""

from __future__ import annotations

import math
from functools import cached_property, lru_cache

import numpy as np
import pyproj
from numpy.typing import ArrayLike

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..errors import LabelError

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
