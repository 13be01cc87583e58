"""Coordinate reference systems of DEM files, reduced to the two projections of `grid`, by method,
radius, origin and units: authority codes for the Moon are unreliable.
"""

from __future__ import annotations

import math
from typing import Any, Literal

from ..constants import MOON_RADIUS_M
from ..errors import LabelError

Projection = Literal["equirectangular", "polar-stereographic"]


class Crs:
    """Projection, origin, latitude of true scale and unit of a CRS. LabelError for other bodies,
    radii and projections.
    """

    def __init__(self, wkt: str) -> None:
        from ..geometry.map_projection import lunar_crs  # noqa: PLC0415  # 0.1 s for pyproj

        crs, _ = lunar_crs(wkt, (MOON_RADIUS_M - 0.5, MOON_RADIUS_M + 0.5))
        self.center_lon_deg = 0.0
        self.true_lat_deg = 0.0
        self.false_m = (0.0, 0.0)
        self.projection: Projection = "equirectangular"
        factor = float(crs.axis_info[0].unit_conversion_factor) if crs.axis_info else 1.0
        if crs.is_geographic:
            self.unit_m = factor * MOON_RADIUS_M  # the factor makes radians
            return
        self.unit_m = factor
        self._read_operation(crs.coordinate_operation)

    def _read_operation(self, operation: Any) -> None:
        method = operation.method_name.lower()
        radians = {
            p.name.lower(): p.value * (p.unit_conversion_factor or 1.0) for p in operation.params
        }

        def degrees(*names: str, default: float = 0.0) -> float:
            found = [radians[name] for name in names if name in radians]
            return round(math.degrees(found[0]), 12) if found else default

        self.center_lon_deg = degrees("longitude of natural origin", "longitude of origin")
        self.false_m = (
            radians.get("false easting", radians.get("easting at projection centre", 0.0)),
            radians.get("false northing", radians.get("northing at projection centre", 0.0)),
        )
        latitude = degrees("latitude of natural origin", "latitude of origin")
        if (
            "equidistant cylindrical" in method
            or "plate carr" in method
            or "equirectangular" in method
        ):
            self.true_lat_deg = degrees(
                "latitude of 1st standard parallel", "latitude of standard parallel"
            )
            self.false_m = (
                self.false_m[0],
                self.false_m[1] - math.radians(latitude) * MOON_RADIUS_M,
            )
        elif "stereographic" in method:
            self.projection = "polar-stereographic"
            self.true_lat_deg = self._polar_true_latitude(
                operation.method_name, radians, latitude, degrees
            )
        else:
            raise LabelError(
                f"map projection {operation.method_name!r} is not supported; cylindrical "
                "and polar ones are"
            )

    @staticmethod
    def _polar_true_latitude(
        method: str, radians: dict[str, float], latitude: float, degrees: Any
    ) -> float:
        if "latitude of standard parallel" in radians and "variant b" in method.lower():
            return float(degrees("latitude of standard parallel"))
        if abs(abs(latitude) - 90.0) > 1e-9:
            raise LabelError(
                f"an oblique stereographic projection (centre latitude {latitude:g}) is "
                "not supported"
            )
        scale = radians.get("scale factor at natural origin", 1.0)
        if not 0.5 < scale <= 1.0:
            raise LabelError(f"a polar projection with scale factor {scale:g} is not supported")
        return math.copysign(round(math.degrees(math.asin(2.0 * scale - 1.0)), 9), latitude)
