"""An area of the Moon, and windows of nodes in the east-north-up frame of a centre."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array
from ..choices import HEIGHTFIELD_SIZE_MAX_KM
from ..constants import MOON_RADIUS_M
from ..errors import AreaError
from ..geometry.bounds import Bounds, turned_deg, wrapped_deg
from ..geometry.frames import EnuFrame, central_angle_deg, lonlat_to_mcmf, mcmf_to_lonlat

LOCAL_MAX_DEG = 20.0
"""Distance from the centre up to which a tangent plane shows an area: it shortens lengths by 6 % there."""

_EDGE = 129


@dataclass(frozen=True)
class Area:
    """A rectangle of the tangent plane at a centre (``size_km``: east-west, north-south), or a box
    of longitudes and latitudes.

    ``Area(lon, lat, size_km)`` or ``Area.from_bounds``. Longitudes -180..360 degrees. ``AreaError``
    for a centre, a size or bounds out of range.
    """

    lon_deg: float
    lat_deg: float
    size_km: tuple[float, float] | float | None
    box: Bounds | None = None

    def __post_init__(self) -> None:
        require_place(self.lon_deg, self.lat_deg)
        if (self.size_km is None) == (self.box is None):
            raise AreaError("an area needs either a size or bounds")
        if self.size_km is not None:
            size = self.size_km if isinstance(self.size_km, tuple) else (self.size_km, self.size_km)
            if not all(math.isfinite(s) and 0.0 < s <= HEIGHTFIELD_SIZE_MAX_KM for s in size):
                raise AreaError(
                    f"`size_km` of {size[0]:g} x {size[1]:g} km: it must be above 0 and at most "
                    f"{HEIGHTFIELD_SIZE_MAX_KM:g} km"
                )
            object.__setattr__(self, "size_km", (float(size[0]), float(size[1])))

    @classmethod
    def chosen(
        cls,
        center: tuple[float, float] | None,
        size_km: float | None,
        bounds: tuple[float, float, float, float] | None,
    ) -> Area | None:
        """The area of a centre and a size, or of bounds, degrees; None for neither. AreaError for both,
        and for a centre without a size.
        """
        if (center is None) != (size_km is None):
            raise AreaError("the centre and the size of an area go together")
        if center is None:
            if bounds is None:
                return None
            west, south, east, north = bounds
            return cls.from_bounds(west, south, east, north)
        if bounds is not None:
            raise AreaError("the centre and the bounds of an area exclude each other")
        return cls(center[0], center[1], size_km)

    @classmethod
    def from_bounds(cls, west: float, south: float, east: float, north: float) -> Area:
        """A box in degrees; it crosses the antimeridian (or the prime meridian) if ``east`` is not
        greater than ``west``. ``AreaError`` for an empty box or one out of range.
        """
        for lon in (west, east):
            if not -360.0 <= lon <= 720.0:
                raise AreaError(f"longitude {lon:g} is not in -180..360 degrees")
        if not (-90.0 <= south <= 90.0 and -90.0 <= north <= 90.0):
            raise AreaError(f"latitudes {south:g} and {north:g} are not in -90..90 degrees")
        if not south < north:
            raise AreaError(f"south {south:g} must lie below north {north:g}")
        if west == east:
            raise AreaError(f"west and east are both {west:g}: the area has no width")
        east = east if east > west else east + 360.0
        if not west < east <= west + 360.0:
            raise AreaError(f"longitudes {west:g}..{east:g} go around the Moon more than once")
        west, east = (west - 360.0, east - 360.0) if west >= 360.0 else (west, east)
        middle = (west + east) / 2.0
        middle = middle - 360.0 if middle > 360.0 else middle
        return cls(middle, (south + north) / 2.0, None, Bounds(west, south, east, north))

    @property
    def frame(self) -> EnuFrame:
        """The frame at the area's centre, its origin on the reference sphere."""
        return EnuFrame(turned_deg(self.lon_deg), self.lat_deg)

    def contains(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> NDArray[np.bool_]:
        """True for positions (on the sphere) inside the area."""
        if self.box is not None:
            return self.box.contains(lon_deg, lat_deg)
        lon, lat = np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
        x, y, z = np.moveaxis(self.frame.from_mcmf(lonlat_to_mcmf(lon, lat)), -1, 0)
        width, height = self._half_m
        return np.asarray((np.abs(x) <= width) & (np.abs(y) <= height) & (z > -MOON_RADIUS_M))

    @cached_property
    def is_local(self) -> bool:
        """True if every place of the area lies within `LOCAL_MAX_DEG` of its centre, so that the
        tangent plane there shows it without much distortion.
        """
        if self.box is None:
            half = math.hypot(*self._half_m) / MOON_RADIUS_M
            return half <= math.sin(math.radians(LOCAL_MAX_DEG))
        west, south, east, north = self.box
        lon, lat = np.array([west, west, self.lon_deg]), np.array([south, north, self.lat_deg])
        away = central_angle_deg(self.lon_deg, self.lat_deg, lon, lat)
        return east - west < 180.0 and float(away.max()) <= LOCAL_MAX_DEG

    def lattice(self, side: int) -> tuple[Array, Array]:
        """Longitudes and latitudes (n,), degrees, of the places inside the area of a regular lattice
        of ``side`` x ``side`` over its extent, on the sphere; over a box that is not local, even in
        longitude and in the sine of latitude.
        """
        if self.box is not None and not self.is_local:
            return self._zone_lattice(side)
        x0, x1, y0, y1 = self.extent_m
        x, y = np.meshgrid(np.linspace(x0, x1, side), np.linspace(y0, y1, side))
        away2 = np.minimum(x * x + y * y, MOON_RADIUS_M**2)
        z = np.sqrt(MOON_RADIUS_M**2 - away2) - MOON_RADIUS_M
        lon, lat, _ = mcmf_to_lonlat(self.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
        inside = self.contains(lon, lat)
        return lon[inside], lat[inside]

    def _zone_lattice(self, side: int) -> tuple[Array, Array]:
        west, south, east, north = self.bounds
        share = (np.arange(side) + 0.5) / side
        low, high = math.sin(math.radians(south)), math.sin(math.radians(north))
        lon, lat = np.meshgrid(
            west + share * (east - west), np.degrees(np.arcsin(low + share * (high - low)))
        )
        return lon.ravel(), lat.ravel()

    def covering(self, side: int) -> tuple[Array, Array, float]:
        """Longitudes and latitudes (n,), degrees, of places of the area, and the distance on the sphere, metres, within which
        each place of the area has one of them: those of `lattice`, or of one even in angles over a box that is not local.
        """
        if self.box is not None and not self.is_local:
            west, south, east, north = self.bounds
            share = (np.arange(side) + 0.5) / side
            lon, lat = np.meshgrid(west + share * (east - west), south + share * (north - south))
            widest = math.cos(math.radians(max(south, -north, 0.0)))
            half = np.radians(math.hypot((east - west) * widest, north - south)) / 2.0 / side
            return lon.ravel(), lat.ravel(), MOON_RADIUS_M * float(half)
        x0, x1, y0, y1 = self.extent_m
        farthest = math.hypot(max(-x0, x1), max(-y0, y1)) / MOON_RADIUS_M
        # the border of a box may cut off three corners of a mesh
        mesh = math.hypot(x1 - x0, y1 - y0) / (side - 1) / (2.0 if self.box is None else 1.0)
        gap_m = mesh / math.sqrt(1.0 - min(farthest, 1.0) ** 2)
        return *self.lattice(side), gap_m

    @property
    def _half_m(self) -> tuple[float, float]:
        assert isinstance(self.size_km, tuple)
        return 500.0 * self.size_km[0], 500.0 * self.size_km[1]

    @property
    def bounds_m2(self) -> float:
        """Area of the sphere within the bounds, square metres."""
        west, south, east, north = (math.radians(angle) for angle in self.bounds)
        return MOON_RADIUS_M**2 * (east - west) * (math.sin(north) - math.sin(south))

    @cached_property
    def bounds(self) -> Bounds:
        """The box of longitudes and latitudes that encloses the area; all longitudes if a pole lies
        inside.
        """
        if self.box is not None:
            return self.box
        width, height = self._half_m
        along = np.linspace(-1.0, 1.0, _EDGE)
        x = np.concatenate(
            [along * width, along * width, np.full(_EDGE, width), np.full(_EDGE, -width)]
        )
        y = np.concatenate(
            [np.full(_EDGE, height), np.full(_EDGE, -height), along * height, along * height]
        )
        z = np.sqrt(MOON_RADIUS_M**2 - x**2 - y**2) - MOON_RADIUS_M
        lon, lat, _ = mcmf_to_lonlat(self.frame.to_mcmf(np.stack([x, y, z], axis=-1)))
        south, north = float(lat.min()), float(lat.max())
        poles = [bool(self.contains(0.0, pole)) for pole in (-90.0, 90.0)]
        if any(poles):
            return Bounds(0.0, -90.0 if poles[0] else south, 360.0, 90.0 if poles[1] else north)
        away = wrapped_deg(lon - self.lon_deg)
        return Bounds(
            self.lon_deg + float(away.min()), south, self.lon_deg + float(away.max()), north
        )

    @cached_property
    def extent_m(self) -> tuple[float, float, float, float]:
        """Least x, greatest x, least y, greatest y of the area in its frame, on the sphere."""
        if self.box is None:
            width, height = self._half_m
            return -width, width, -height, height
        west, south, east, north = self.box
        lon, lat = np.meshgrid(np.linspace(west, east, _EDGE), np.linspace(south, north, _EDGE))
        x, y, z = np.moveaxis(self.frame.from_mcmf(lonlat_to_mcmf(lon, lat)), -1, 0)
        near = z > -MOON_RADIUS_M
        return (
            float(x[near].min()),
            float(x[near].max()),
            float(y[near].min()),
            float(y[near].max()),
        )


@dataclass(frozen=True)
class NodeWindow:
    """Nodes of a frame, counted from its origin and half open: x = column * gsd, y = -row * gsd
    (row 0 through the origin).

    All windows of one frame and cell size share their nodes.
    """

    row0: int
    row1: int
    col0: int
    col1: int

    def __post_init__(self) -> None:
        if self.row1 <= self.row0 or self.col1 <= self.col0:
            raise AreaError(
                f"a window of {self.row1 - self.row0} x {self.col1 - self.col0} nodes is empty"
            )

    @classmethod
    def covering(cls, extent_m: tuple[float, float, float, float], gsd_m: float) -> NodeWindow:
        """The nodes that enclose least x, greatest x, least y, greatest y."""
        x0, x1, y0, y1 = (value / gsd_m for value in extent_m)
        slack = 1e-6  # rounding: an edge at a node is that node
        return cls(
            row0=math.floor(-y1 + slack),
            row1=math.ceil(-y0 - slack) + 1,
            col0=math.floor(x0 + slack),
            col1=math.ceil(x1 - slack) + 1,
        )

    @property
    def shape(self) -> tuple[int, int]:
        return self.row1 - self.row0, self.col1 - self.col0

    def grown(self, nodes: int) -> NodeWindow:
        """This window with ``nodes`` more nodes on every side."""
        return self.extended(nodes, nodes, nodes, nodes)

    def extended(self, north: int, south: int, west: int, east: int) -> NodeWindow:
        """This window with so many more nodes on its sides."""
        return NodeWindow(self.row0 - north, self.row1 + south, self.col0 - west, self.col1 + east)


def require_place(lon_deg: float, lat_deg: float) -> None:
    """AreaError unless the longitude lies in -360..720 and the latitude in -90..90 degrees."""
    if not (math.isfinite(lon_deg) and -360.0 <= lon_deg <= 720.0):
        raise AreaError(f"longitude {lon_deg:g} is not in -180..360 degrees")
    if not (math.isfinite(lat_deg) and -90.0 <= lat_deg <= 90.0):
        raise AreaError(f"latitude {lat_deg:g} is not in -90..90 degrees")
