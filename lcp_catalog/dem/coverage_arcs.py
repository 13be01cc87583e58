"""The ground under a set of DEM footprints, cut into arcs of parallels, so that areas are integrals and no counts of samples.

A cylinder ends at meridians and parallels. A polar map ends at straight lines of the stereographic plane, and there a meridian
is a line through the pole. With t = tan(colatitude / 2) as radius of that plane, the line at distance d from the pole whose
normal lies at longitude phi is t cos(lon - phi) = d; a parallel meets it at phi +- acos(d / t) (Snyder 1987 p. 157 on the
sphere). Between the latitudes where edges begin, end or cross, the arcs change smoothly, and a few Gauss nodes give their areas:
to 1e-7 against closed forms, to 1e-5 where there are more crossings than are kept (tests/test_set_coverage.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..constants import MOON_RADIUS_M
from ..geometry.bounds import Bounds
from .grid import Grid

RADIUS_KM = MOON_RADIUS_M / 1000.0
_ROWS = 5000  # of all segments together, about
_NODES = (2, 24)  # of one segment, at least and at most
_NARROW_DEG = 1e-9  # an arc or a segment below it is a rounding error
_CROSSINGS = 1000


@dataclass(frozen=True)
class Arcs:
    """Arcs of parallels that fill a box, sorted by row (south to north) and from west to east; no footprint ends inside one.

    Each stands for ``area_km2`` of ground between its row's latitudes ``south_deg`` and ``north_deg``. ``segment`` counts the
    spans of latitude within which the edges keep their order. Longitudes grow from the box's west edge and may pass 360.
    """

    row: NDArray[np.int64]
    segment: NDArray[np.int64]
    west_deg: Array
    east_deg: Array
    lat_deg: Array
    south_deg: Array
    north_deg: Array
    area_km2: Array

    @property
    def lon_deg(self) -> Array:
        """Middles of the arcs."""
        return 0.5 * (self.west_deg + self.east_deg)


@dataclass(frozen=True)
class _Lines:
    """Edges of polar maps around one pole: longitude of the normal, degrees, and distance, in t."""

    normal_deg: Array
    distance: Array

    def breaks(self, t: Array) -> Array:
        """Longitudes (rows, 2 lines) where the parallels ``t`` meet the lines; NaN where they do not."""
        ratio = self.distance / t[:, None]
        away = np.degrees(np.arccos(np.where(ratio <= 1.0, ratio, np.nan)))
        return np.concatenate([self.normal_deg - away, self.normal_deg + away], axis=1)

    def crossings(self, other: _Lines) -> Array:
        """Distances t from the pole where lines meet those of ``other``; parallel ones do not."""
        angle = np.radians(self.normal_deg[:, None] - other.normal_deg)
        sine, product = np.sin(angle), self.distance[:, None] * other.distance
        square = self.distance[:, None] ** 2 + other.distance**2 - 2.0 * product * np.cos(angle)
        met = np.abs(sine) > 1e-9
        return np.sqrt(np.maximum(square[met], 0.0)) / np.abs(sine[met])


def cut(grids: Sequence[Grid], box: Bounds, latitudes_deg: Iterable[float] = ()) -> Arcs:
    """The arcs of a box at the edges of the grids' footprints; ``latitudes_deg`` are further latitudes to cut at."""
    boxes = [grid.bounds for grid in grids]
    lines = {pole: _lines([g for g in grids if g.pole == pole]) for pole in (1, -1)}
    meridians = np.unique(
        [e for g, b in zip(grids, boxes, strict=True) if not g.pole for e in b[::2]]
    )
    edges = [*latitudes_deg, *(edge for b in boxes for edge in (b.south, b.north))]
    for pole in (1, -1):
        reach = [b for g, b in zip(grids, boxes, strict=True) if g.pole == pole]
        edges += [
            lat
            for lat in _turns(lines[pole], meridians, box.west, pole)
            if any(b.south < lat < b.north for b in reach)
        ]
    rows = _rows(np.array([lat for lat in edges if box.south < lat < box.north]), box)
    return _arcs(rows, meridians, lines, box)


def _lines(grids: Iterable[Grid]) -> _Lines:
    """The outer edges of polar grids, each line once."""
    found = set()
    for grid in grids:
        rho_m = MOON_RADIUS_M * (1.0 + math.sin(math.radians(abs(grid.true_lat_deg))))
        left, top = grid.x0_m - 0.5 * grid.pixel_m, grid.y0_m + 0.5 * grid.pixel_m
        right, bottom = left + grid.width * grid.pixel_m, top - grid.height * grid.pixel_m
        up = grid.center_lon_deg + (180.0 if grid.pole > 0 else 0.0)  # where y grows
        for normal, at_m in (
            (up - grid.pole * 90.0, left),
            (up - grid.pole * 90.0, right),
            (up, bottom),
            (up, top),
        ):
            turned = normal if at_m >= 0.0 else normal + 180.0
            found.add((round(turned % 360.0, 9), round(abs(at_m) / rho_m, 12)))
    normal_deg, distance = np.array(sorted(found)).reshape(-1, 2).T
    return _Lines(normal_deg, distance)


def _turns(lines: _Lines, meridians: Array, west: float, pole: int) -> list[float]:
    """Latitudes where edges of polar maps touch a parallel, or meet each other, a meridian's edge or the seam at ``west``."""
    if lines.distance.size == 0:
        return []
    through = np.unique(np.append(meridians, west)) + 90.0
    crossings = np.concatenate(
        [lines.crossings(lines), lines.crossings(_Lines(through, np.zeros(through.size)))]
    )
    lats = np.unique(np.round(_latitude(crossings, pole), 9))
    for digits in range(6, 0, -1):
        if lats.size <= _CROSSINGS:
            break
        lats = np.unique(np.round(lats, digits))
    return [*_latitude(lines.distance, pole).tolist(), *lats.tolist()]


def _latitude(t: Array, pole: int) -> Array:
    return pole * (90.0 - 2.0 * np.degrees(np.arctan(t)))


def _rows(edges: Array, box: Bounds) -> tuple[Array, Array, Array, Array, NDArray[np.int64]]:
    """Nodes of all segments from south to north: latitude, south, north, width in sin(latitude), segment.

    Gauss-Legendre in the angle of z = middle - half cos(angle): arcs begin and end like a square root of z, which is smooth
    in that angle.
    """
    edges = np.unique(np.concatenate([edges, [box.south, box.north]]))
    edges = edges[np.append(True, np.diff(edges) > _NARROW_DEG)]
    z = np.sin(np.radians(edges))
    nodes = int(np.clip(_ROWS // max(len(z) - 1, 1), *_NODES))
    x, w = np.polynomial.legendre.leggauss(nodes)
    angle, weight = 0.5 * math.pi * (x + 1.0), 0.5 * math.pi * w
    middle, half = 0.5 * (z[1:] + z[:-1])[:, None], 0.5 * np.diff(z)[:, None]
    ends = np.append(0.0, np.cumsum(weight))
    lat = np.degrees(np.arcsin(np.clip(middle - half * np.cos(angle), -1.0, 1.0)))
    between = np.degrees(np.arcsin(np.clip(middle - half * np.cos(ends), -1.0, 1.0)))
    between[:, 0], between[:, -1] = edges[:-1], edges[1:]
    wide = half * np.sin(angle) * weight
    wide *= np.diff(z)[:, None] / wide.sum(axis=1, keepdims=True)
    segment = np.repeat(np.arange(len(z) - 1), nodes)
    return lat.ravel(), between[:, :-1].ravel(), between[:, 1:].ravel(), wide.ravel(), segment


def _arcs(rows: tuple[Any, ...], meridians: Array, lines: dict[int, _Lines], box: Bounds) -> Arcs:
    lat, south, north, wide, segment = rows
    width = box.east - box.west
    cuts = [np.broadcast_to(meridians, (lat.size, meridians.size))]
    for pole, some in lines.items():
        if some.distance.size:
            cuts.append(some.breaks(np.tan(np.radians(90.0 - pole * lat) / 2.0)))
    away = (np.concatenate(cuts, axis=1) - box.west) % 360.0
    away = np.where(away < width, away, np.nan)
    ends = np.broadcast_to([0.0, width], (lat.size, 2))
    away = np.sort(np.concatenate([away, ends], axis=1), axis=1)  # NaN last
    with np.errstate(invalid="ignore"):
        row, order = np.nonzero(np.diff(away, axis=1) > _NARROW_DEG)
    west, east = away[row, order], away[row, order + 1]
    area = RADIUS_KM**2 * wide[row] * np.radians(east - west)
    return Arcs(
        row, segment[row], box.west + west, box.west + east, lat[row], south[row], north[row], area
    )
