"""Boxes of longitude and latitude, and arcs of longitude.

Angles of a circle brought into one turn: longitudes, azimuths and their differences, in degrees.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array

Angle = TypeVar("Angle", float, Array)


def turned_deg(angle_deg: Angle) -> Angle:
    """Angles in 0 <= angle < 360. A tiny negative angle, of which ``% 360`` rounds to 360, gives 0.

    >>> turned_deg(-90.0), turned_deg(-1e-17)
    (270.0, 0.0)
    """
    turned = angle_deg % 360.0
    if isinstance(turned, float):
        return 0.0 if turned >= 360.0 else turned
    return np.where(turned >= 360.0, 0.0, turned)


def wrapped_deg(angle_deg: Angle) -> Angle:
    """Angles in -180 <= angle < 180, such as the difference of two longitudes the shorter way around.

    >>> wrapped_deg(190.0), wrapped_deg(180.0)
    (-170.0, -180.0)
    """
    return turned_deg(angle_deg + 180.0) - 180.0


class Bounds(NamedTuple):
    """A box in degrees; ``east`` is greater than ``west`` and may pass 180 or 360 where the box
    crosses the antimeridian or the prime meridian.
    """

    west: float
    south: float
    east: float
    north: float

    def __str__(self) -> str:
        lon, lat = f"{self.west:.6g}..{self.east:.6g}", f"{self.south:.6g}..{self.north:.6g}"
        return f"longitude {lon}, latitude {lat}"

    def contains(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> NDArray[np.bool_]:
        """True for places, degrees, in the box or on its edge; longitudes of any turn. Shape as the places.

        >>> Bounds(350.0, -5.0, 370.0, 5.0).contains([-10.0, 10.0, 11.0], 5.0).tolist()
        [True, True, False]
        """
        lon, lat = np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
        along = turned_deg(lon - self.west) <= self.east - self.west
        return np.asarray(along & (lat >= self.south) & (lat <= self.north))

    def meets(self, other: Bounds) -> bool:
        """True if the two boxes share at least a point."""
        apart = (other.west - self.west) % 360.0
        along = apart <= self.east - self.west or 360.0 - apart <= other.east - other.west
        return along and self.south <= other.north and other.south <= self.north

    def common(self, limit: Bounds) -> Bounds | None:
        """The intersection with another box, its longitudes as those of the narrower one; None if it is empty. Of two
        common parts the wider one.
        """
        south, north = max(self.south, limit.south), min(self.north, limit.north)
        if south >= north:
            return None
        if limit.east - limit.west >= 360.0 - 1e-9:
            return Bounds(self.west, south, self.east, north)
        if self.east - self.west >= 360.0 - 1e-9:
            return Bounds(limit.west, south, limit.east, north)
        shared = []
        for turn in (-720.0, -360.0, 0.0, 360.0, 720.0):
            west, east = max(self.west + turn, limit.west), min(self.east + turn, limit.east)
            if west < east:
                shared.append((east - west, Bounds(west, south, east, north)))
        return max(shared)[1] if shared else None


def enclosing_arc(west_deg: ArrayLike, east_deg: ArrayLike) -> tuple[float, float]:
    """Ends (west, east >= west), degrees, of the shortest arc of longitudes that contains all given
    arcs (n,), each from its ``west_deg`` to its ``east_deg`` >= ``west_deg``. For points give them twice.

    ``west`` lies in 0..360; in -180..0 where the arc crosses the prime meridian. A full turn is the
    first given arc that is one, else 0..360.
    """
    west, east = (np.asarray(ends, dtype=np.float64) for ends in (west_deg, east_deg))
    if (whole := np.flatnonzero(east - west >= 360.0 - 1e-9)).size:
        return float(west[whole[0]]), float(west[whole[0]]) + 360.0
    start = west % 360.0
    order = np.argsort(start, kind="stable")
    start, width = start[order], (east - west)[order]
    reach = np.maximum.accumulate(start + width)
    free = np.append(start[1:], start[0] + 360.0) - np.maximum(reach, reach[-1] - 360.0)
    widest = free.size - 1 - int(np.argmax(free[::-1]))
    gap, first = float(free[widest]), float(start[(widest + 1) % start.size])
    if gap <= 1e-9:
        return 0.0, 360.0
    if first >= 180.0 and first - gap > 1e-9:  # it ends beyond 360
        first -= 360.0
    return first, first + 360.0 - gap


def enclosing_bounds(
    west_deg: ArrayLike, east_deg: ArrayLike, south_deg: float, north_deg: float
) -> Bounds:
    """The smallest box around arcs of longitude (`enclosing_arc`) between two parallels, rounded to
    1e-9 degrees.
    """
    west, east = enclosing_arc(west_deg, east_deg)
    return Bounds(*(round(float(edge), 9) + 0.0 for edge in (west, south_deg, east, north_deg)))
