"""Boxes of longitude and latitude, and arcs of longitude."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Array


class Bounds(NamedTuple):
    """Degrees; ``east`` is greater than ``west`` and may pass 180 or 360 when the antimeridian or
    the prime meridian is crossed.
    """

    west: float
    south: float
    east: float
    north: float

    def __str__(self) -> str:
        lon, lat = f"{self.west:.6g}..{self.east:.6g}", f"{self.south:.6g}..{self.north:.6g}"
        return f"longitude {lon}, latitude {lat}"


def enclosing_arc(arcs: list[tuple[float, float]]) -> tuple[float, float]:
    """The shortest arc of longitudes (west, east >= west) that holds all of the given ones,
    degrees.
    """
    if any(east - west >= 360.0 - 1e-9 for west, east in arcs):
        return next((west, west + 360.0) for west, east in arcs if east - west >= 360.0 - 1e-9)
    starts = sorted((west % 360.0, west % 360.0 + (east - west)) for west, east in arcs)
    merged = [list(starts[0])]
    for west, east in starts[1:]:
        if west <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], east)
        else:
            merged.append([west, east])
    gaps = [
        (
            merged[(i + 1) % len(merged)][0]
            + (360.0 if i + 1 == len(merged) else 0.0)
            - merged[i][1],
            i,
        )
        for i in range(len(merged))
    ]
    gap, last = max(gaps)
    west = merged[(last + 1) % len(merged)][0]
    if gap <= 1e-9:
        return west, west + 360.0
    west = west - 360.0 if last + 1 < len(merged) and west >= 180.0 + 1e-9 else west
    return west, west + 360.0 - gap


def around(west_deg: Array, east_deg: Array, south_deg: float, north_deg: float) -> Bounds:
    """The narrowest box around arcs of longitude (east >= west); all the way around when no meridian is free."""
    start = west_deg % 360.0
    order = np.argsort(start)
    start, width = start[order], (east_deg - west_deg)[order]
    reach = np.maximum.accumulate(start + width)
    free = np.append(start[1:], start[0] + 360.0) - np.maximum(reach, reach[-1] - 360.0)
    widest = int(np.argmax(free))
    south, north = (round(lat, 9) + 0.0 for lat in (south_deg, north_deg))
    if free[widest] <= 1e-9:
        return Bounds(0.0, south, 360.0, north)
    west = float(start[(widest + 1) % start.size])
    east = west + 360.0 - float(free[widest])
    turn = 360.0 if west >= 180.0 and east > 360.0 + 1e-9 else 0.0
    return Bounds(round(west - turn, 9) + 0.0, south, round(east - turn, 9) + 0.0, north)


def _shortest_arc(lon_deg: Array) -> tuple[float, float]:
    """West and east end (west < 360, west <= east) of the shortest arc with all longitudes."""
    ordered = np.sort(lon_deg)
    gaps = np.diff(np.append(ordered, ordered[0] + 360.0))
    widest = int(np.argmax(gaps))
    west = ordered[(widest + 1) % ordered.size]
    east = ordered[widest]
    return float(west), float(east if east >= west else east + 360.0)
