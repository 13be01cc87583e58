"""The grid of a DEM product: longitude and latitude to fractional pixels and back, in closed form
on the sphere.

Pixel centres are at whole numbers, row 0 is north. The forms are those of Snyder (1987):
equirectangular p. 90, polar stereographic on the sphere p. 157; tests compare them with PROJ. A CRS
is read by its method, radius, origin and units, since authority codes for the Moon are unreliable.

Coordinate reference systems of DEM files, reduced to the two projections of `grid`, by method,
radius, origin and units: authority codes for the Moon are unreliable.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Mask
from ..constants import MOON_RADIUS_M
from ..errors import LabelError
from ..geometry.bounds import Bounds, enclosing_arc, turned_deg, wrapped_deg
from ..geometry.map_plane import lunar_crs
from ..pds.label import Label

Projection = Literal["equirectangular", "polar-stereographic"]


class Crs:
    """Projection, origin, latitude of true scale and unit of a CRS. LabelError for other bodies,
    radii and projections.
    """

    def __init__(self, wkt: str) -> None:
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


EDGE_PX = 1e-6
"""Places up to this distance outside the outermost pixel count as inside (rounding errors)."""

_DEGREE_M = math.radians(1.0) * MOON_RADIUS_M


@dataclass(frozen=True)
class Grid:
    """Pixels of one product on the sphere of 1 737 400 m. LabelError for values that are not
    possible.

    ``x0_m``, ``y0_m`` are the map coordinates of the centre of pixel (0, 0) relative to the origin
    of the projection: the equator at ``center_lon_deg`` (cylinder), or the pole. ``true_lat_deg``
    is the latitude of true scale; at a pole its sign gives the pole, and +-90 means true scale at
    the pole itself.
    """

    projection: Projection
    width: int
    height: int
    pixel_m: float
    x0_m: float
    y0_m: float
    center_lon_deg: float = 0.0
    true_lat_deg: float = 0.0

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or not 0.0 < self.pixel_m < math.inf:
            raise LabelError(
                f"invalid grid of {self.width} x {self.height} pixels of {self.pixel_m:g} m"
            )
        if not (
            math.isfinite(self.x0_m)
            and math.isfinite(self.y0_m)
            and math.isfinite(self.center_lon_deg)
        ):
            raise LabelError("the grid's origin is not a finite number")
        if self.projection == "polar-stereographic" and self.true_lat_deg == 0.0:
            raise LabelError("a polar grid needs a latitude of true scale other than the equator")
        if self.projection == "equirectangular" and abs(self.true_lat_deg) >= 90.0:
            raise LabelError("a cylinder cannot be true to scale at a pole")

    @classmethod
    def from_label(cls, label: Label) -> Grid:
        """The grid of a PDS label. LabelError if its bounds are others than those of its offsets."""
        polar = label.projection == "polar-stereographic"
        grid = cls(
            projection="polar-stereographic" if polar else "equirectangular",
            width=label.line_samples,
            height=label.lines,
            pixel_m=label.pixel_m,
            x0_m=-label.sample_offset * label.pixel_m,
            y0_m=label.line_offset * label.pixel_m,
            center_lon_deg=label.center_lon_deg,
            true_lat_deg=label.center_lat_deg,
        )
        for wrong in _polar_misstated(grid, label) if polar else _cylinder_misstated(grid, label):
            raise LabelError(f"{wrong}: its offsets or its bounds are wrong; fetch the label again")
        return grid

    @classmethod
    def from_wkt(cls, wkt: str, affine: tuple[float, ...], width: int, height: int) -> Grid:
        """The grid of a raster with a CRS and an affine transform (a, b, c, d, e, f) of pixel
        corners.

        LabelError for another body or radius, a rotated or sheared grid, an oblique projection.
        """
        a, b, c, d, e, f = affine[:6]
        if b != 0.0 or d != 0.0:
            raise LabelError(
                "a rotated or sheared grid is not supported; warp it to north-up first"
            )
        if not (a > 0.0 > e) or abs(a + e) > 1e-6 * a:
            raise LabelError(f"square pixels with north up are required, not {a:g} x {e:g}")
        crs = Crs(wkt)
        unit = crs.unit_m
        x0, y0 = (c + 0.5 * a) * unit - crs.false_m[0], (f + 0.5 * e) * unit - crs.false_m[1]
        return cls(
            crs.projection, width, height, a * unit, x0, y0, crs.center_lon_deg, crs.true_lat_deg
        )

    @property
    def pole(self) -> int:
        """+1 or -1 of a polar grid, 0 of a cylinder."""
        return (
            0
            if self.projection == "equirectangular"
            else int(math.copysign(1.0, self.true_lat_deg))
        )

    @property
    def period(self) -> int:
        """Pixels around the Moon of a cylinder that has a whole number of them, else 0."""
        if self.pole:
            return 0
        exact = 360.0 * self._ring_m / self.pixel_m
        whole = round(exact)
        return whole if whole > 0 and abs(exact - whole) < 0.01 else 0

    @property
    def wraps(self) -> bool:
        """True if the grid goes all the way around the Moon."""
        return 0 < self.period <= self.width

    @property
    def _ring_m(self) -> float:
        """Metres of the map in a degree of longitude (cylinder)."""
        return _DEGREE_M * math.cos(math.radians(self.true_lat_deg))

    @property
    def _rho_m(self) -> float:
        """Factor of tan(colatitude / 2) in the radius of a polar map."""
        return MOON_RADIUS_M * (1.0 + math.sin(math.radians(abs(self.true_lat_deg))))

    def pixel(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Array, Array]:
        """Fractional (column, row) of places; whole numbers are pixel centres.

        On a cylinder the column lies within one turn east of the grid's west edge (less 1e-6
        pixel). The other pole of a polar grid is infinitely far away.
        """
        lon, lat = np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
        if self.pole:
            return self._polar_pixel(lon, lat)
        turn = 360.0 * self._ring_m / self.pixel_m
        column = ((lon - self.center_lon_deg) * self._ring_m - self.x0_m) / self.pixel_m
        if not _within(column, -0.5 - EDGE_PX, turn - 0.5 - 2.0 * EDGE_PX):
            column = column - np.floor((column + 0.5 + EDGE_PX) / turn) * turn
        row = (self.y0_m - lat * _DEGREE_M) / self.pixel_m
        return np.broadcast_to(column, np.broadcast_shapes(column.shape, row.shape)), row

    def _polar_pixel(self, lon: Array, lat: Array) -> tuple[Array, Array]:
        away = np.radians(lon - self.center_lon_deg)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            rho = self._rho_m * np.tan(np.radians(90.0 - self.pole * lat) / 2.0)
            column = (rho * np.sin(away) - self.x0_m) / self.pixel_m
            row = (self.y0_m + self.pole * rho * np.cos(away)) / self.pixel_m
        return column, row

    def located(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Mask, Array, Array]:
        """True at the places inside the outer edges of the pixels (to `EDGE_PX`), and the fractional
        (column, row) of all places.
        """
        column, row = self.pixel(lon_deg, lat_deg)
        low, right, bottom = -0.5 - EDGE_PX, self.width - 0.5, self.height - 0.5
        if (
            _within(column, 0.0, right)
            and _within(row, 0.0, bottom)
            and _within(np.asarray(lat_deg), -90.0, 90.0)
        ):
            return np.ones(np.shape(column), np.bool_), column, row
        with np.errstate(invalid="ignore"):
            inside = (column >= low) & (column <= right + EDGE_PX)
            inside = inside & (row >= low) & (row <= bottom + EDGE_PX)
        return inside & (np.abs(lat_deg) <= 90.0), column, row

    def holds(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> Mask:
        """True at the places inside the outer edges of the pixels."""
        return self.located(lon_deg, lat_deg)[0]

    def lonlat(self, column: ArrayLike, row: ArrayLike) -> tuple[Array, Array]:
        """Longitude (0..360) and latitude, degrees, of fractional pixels; rows beyond a pole give
        latitudes beyond +-90.
        """
        x = self.x0_m + np.asarray(column, dtype=np.float64) * self.pixel_m
        y = self.y0_m - np.asarray(row, dtype=np.float64) * self.pixel_m
        if self.pole:
            lat = self.pole * (90.0 - 2.0 * np.degrees(np.arctan2(np.hypot(x, y), self._rho_m)))
            lon = self.center_lon_deg + np.degrees(np.arctan2(x, -self.pole * y))
        else:
            lat, lon = y / _DEGREE_M, self.center_lon_deg + x / self._ring_m
        return turned_deg(lon), lat

    def cell_weight(self, column: ArrayLike, row: ArrayLike) -> Array:
        """Area of pixels on the surface relative to a pixel at true scale (of a cylinder: at the
        equator); broadcasts its arguments.

        A length on a polar map is 2 R / (k (1 + t^2)) times as long on the surface, where t is the
        tangent of half the colatitude and x^2 + y^2 = (k t)^2 (Snyder 1987, p. 157).
        """
        y = self.y0_m - np.asarray(row, dtype=np.float64) * self.pixel_m
        if self.pole:
            x = self.x0_m + np.asarray(column, dtype=np.float64) * self.pixel_m
            length = 2.0 * MOON_RADIUS_M / (self._rho_m * (1.0 + (x * x + y * y) / self._rho_m**2))
            return np.asarray(length * length)
        weight = np.cos(np.clip(y / MOON_RADIUS_M, -math.pi / 2, math.pi / 2)) + 0.0 * np.asarray(
            column
        )
        return np.maximum(weight, 1e-9)  # positive beyond a pole, where weights are divided by

    @property
    def bounds(self) -> Bounds:
        """The box of longitudes and latitudes around all pixels, to their outer edges."""
        right, bottom = self.width - 0.5, self.height - 0.5
        if not self.pole:
            west = self.center_lon_deg + (self.x0_m - 0.5 * self.pixel_m) / self._ring_m
            east = west + min(360.0, self.width * self.pixel_m / self._ring_m)
            turns = (
                360.0 * math.floor((west + 180.0 + 1e-9) / 360.0)
                if not -180.0 <= west <= 360.0
                else 0.0
            )
            _, (south, north) = self.lonlat(np.zeros(2), np.array([bottom, -0.5]))
            return Bounds(
                *map(_tidy, (west - turns, max(south, -90.0), east - turns, min(north, 90.0)))
            )
        along = np.linspace(0.0, 1.0, 65)
        column = np.concatenate(
            [
                -0.5 + along * self.width,
                np.full(65, right),
                -0.5 + along * self.width,
                np.full(65, -0.5),
            ]
        )
        row = np.concatenate(
            [
                np.full(65, -0.5),
                -0.5 + along * self.height,
                np.full(65, bottom),
                -0.5 + along * self.height,
            ]
        )
        lon, lat = self.lonlat(column, row)
        pole_column, pole_row = -self.x0_m / self.pixel_m, self.y0_m / self.pixel_m
        if -0.5 <= pole_column <= right and -0.5 <= pole_row <= bottom:
            low, high = (float(lat.min()), 90.0) if self.pole > 0 else (-90.0, float(lat.max()))
            return Bounds(0.0, low, 360.0, high)
        west, east = enclosing_arc(lon, lon)
        return Bounds(west, float(lat.min()), east, float(lat.max()))

    def same_lattice(self, other: Grid) -> tuple[int, int] | None:
        """(columns, rows) from this grid's pixel (0, 0) to that of the other if both belong to one
        unbounded lattice, else None.
        """
        mine = dataclasses.replace(self, width=1, height=1, x0_m=0.0, y0_m=0.0, center_lon_deg=0.0)
        if mine != dataclasses.replace(
            other, width=1, height=1, x0_m=0.0, y0_m=0.0, center_lon_deg=0.0
        ):
            return None
        if self.pole and self.center_lon_deg != other.center_lon_deg:
            return None
        turn = 0.0 if self.pole else (other.center_lon_deg - self.center_lon_deg) * self._ring_m
        columns = (other.x0_m + turn - self.x0_m) / self.pixel_m
        rows = (self.y0_m - other.y0_m) / self.pixel_m
        if abs(columns - round(columns)) > 1e-3 or abs(rows - round(rows)) > 1e-3:
            return None
        return round(columns), round(rows)


def _within(values: Array, low: float, high: float) -> bool:
    """True if all values, at least one, are known and within low..high."""
    return bool(values.size and values.min() >= low and values.max() <= high)


def _tidy(value: float) -> float:
    """The value without rounding errors of the last bits, so that an edge at 30 deg is 30."""
    return round(float(value), 10) + 0.0


def _cylinder_misstated(grid: Grid, label: Label) -> list[str]:
    """South and east; north and west were compared when the label was read."""
    box, south, east = grid.bounds, label.declared.south_deg, label.declared.east_deg
    slack = 1.5 * (box.north - box.south) / grid.height
    wrong = []
    if south is not None and abs(south - box.south) > slack:
        wrong.append(f"states MINIMUM_LATITUDE {south:g}, its last line ends at {box.south:.6g}")
    slack = 1.5 * (box.east - box.west) / grid.width
    if east is not None and abs(wrapped_deg(east - box.east)) > slack:
        end = f"its last column ends at {box.east:.6g}"
        wrong.append(f"states EASTERNMOST_LONGITUDE {east:g}, {end}")
    return wrong


def _polar_misstated(grid: Grid, label: Label) -> list[str]:
    """Labels of the archive give the latitude in the middle of an edge: it must lie between the
    nearest edge and the farthest corner. A pole that the label states must lie inside.
    """
    column, row = np.meshgrid(
        np.linspace(-0.5, grid.width - 0.5, 65), np.linspace(-0.5, grid.height - 0.5, 65)
    )
    edge = np.ones(column.shape, dtype=bool)
    edge[1:-1, 1:-1] = False
    away = 90.0 - grid.pole * grid.lonlat(column, row)[1]
    declared = label.declared
    ends = declared.south_deg, declared.north_deg
    inner, outer = ends[:: -grid.pole]  # from the pole outwards
    slack = 0.02 * float(away.max()) + 1e-3
    wrong = []
    has_pole = (
        0.0 <= -grid.x0_m / grid.pixel_m + 0.5 <= grid.width
        and 0.0 <= grid.y0_m / grid.pixel_m + 0.5 <= grid.height
    )
    if inner is not None and abs(inner) == 90.0 and not has_pole:
        wrong.append(f"states latitude {inner:g}, but the pole lies outside its lines and samples")
    if outer is not None:
        said = 90.0 - grid.pole * outer
        near, far = float(away[edge].min()), float(away.max())
        if not near - slack <= said <= far + slack:
            reach = f"between {grid.pole * (90.0 - near):.6g} and {grid.pole * (90.0 - far):.6g}"
            wrong.append(f"states latitude {outer:g} for its edge, which lies {reach}")
    return wrong
