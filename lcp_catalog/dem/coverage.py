"""Coverage of a set of DEM files: areas by band of latitude and by product, overlaps, gaps.

The box of the set is divided by the outer edges of all files, and each cell is assigned by its
centre. Cylindrical files end at meridians and parallels, so their areas are exact. The edges of
polar files cross cells: their areas, overlaps and gaps are good to `POLAR_ERROR` of the area of the
file, for up to 30 polar files (tests/dem/test_coverage.py measures it); a gap between polar files
that is narrower than a cell can be missed or split. Only `set_disagreements` reads pixels, in some
hundred small windows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from ..arrays import Array, Index, Int16, Mask
from ..constants import MOON_RADIUS_M
from ..geometry.bounds import Bounds, enclosing_bounds
from .disagreements import Disagreement, disagreements
from .grid import Grid
from .mosaic import DemSet
from .pixel_statistics import Region, connected_regions

BAND_EDGES_DEG = (-90.0, -85.0, -80.0, -75.0, -60.0, 0.0, 60.0, 75.0, 80.0, 85.0, 90.0)
"""Latitudes at which the method's choice of products changes, north and south."""
RADIUS_KM = MOON_RADIUS_M / 1000.0
MOON_KM2 = 4.0 * math.pi * RADIUS_KM**2

POLAR_ERROR = 1e-3
"""Error bound of areas in sets with polar files, as a share of the area of the file."""

_EDGE_POINTS, _EDGE_POINTS_OF_SIDE = 4000, (12, 400)
"""Points along the edges of all polar files, and along one side of a file (at least, at most), whose longitudes and latitudes
are edges of cells.
"""
_NARROW_DEG = 1e-9  # a cell below it is a rounding error
_PAIRS = 20  # of products that are compared


@dataclass(frozen=True)
class Band:
    """Surface between two parallels, km2: all of it, and its parts in a file, in two or more files,
    and in gaps of the set's box; ``used_km2`` by product, where that product is used.
    """

    south_deg: float
    north_deg: float
    area_km2: float
    covered_km2: float
    overlap_km2: float
    gap_km2: float
    used_km2: dict[str, float]


@dataclass(frozen=True)
class Overlap:
    """Surface in two files, by their index in the set, and the box around it."""

    first: int
    second: int
    area_km2: float
    bounds: Bounds


@dataclass(frozen=True)
class Gap(Region):
    """A connected part of the set's box in no file; ``at_edge`` is True if it reaches the edge of
    the box, so that files do not enclose it.
    """

    at_edge: bool


@dataclass(frozen=True)
class SetCoverage:
    """Coverage of a set. Areas are on the sphere of 1737.4 km.

    ``file_km2`` is the footprint of each file, ``used_km2`` the part of it where that file is used.
    Gaps are the parts of the box ``bounds`` in no file. Gaps and overlaps are sorted, largest
    first. Missing pixels do not count.
    """

    bounds: Bounds
    covered_km2: float
    box_km2: float
    bands: tuple[Band, ...]
    file_km2: tuple[float, ...]
    used_km2: tuple[float, ...]
    overlaps: tuple[Overlap, ...]
    gaps: tuple[Gap, ...]
    has_north_pole: bool
    has_south_pole: bool
    is_full_ring: bool
    crosses_antimeridian: bool


@dataclass(frozen=True)
class _Cells:
    """Cells of a box: edges of the columns (longitudes from the west edge of the box, up to 360
    more) and of the rows (latitudes from south to north), degrees.
    """

    lon_edges: Array
    lat_edges: Array

    @property
    def lon_deg(self) -> Array:
        """Centres of the columns."""
        return np.asarray(0.5 * (self.lon_edges[1:] + self.lon_edges[:-1]))

    @property
    def lat_deg(self) -> Array:
        """Centres of the rows."""
        return np.asarray(0.5 * (self.lat_edges[1:] + self.lat_edges[:-1]))

    @property
    def area_km2(self) -> Array:
        """Exact areas of the cells, (rows, columns)."""
        height = np.diff(np.sin(np.radians(self.lat_edges)))
        return np.outer(RADIUS_KM**2 * height, np.diff(np.radians(self.lon_edges)))

    @property
    def is_ring(self) -> bool:
        """True if the last column touches the first."""
        return bool(self.lon_edges[-1] - self.lon_edges[0] > 360.0 - 1e-9)

    def box_around(self, cells: Mask) -> Bounds:
        """The box around cells (rows, columns)."""
        rows, columns = np.flatnonzero(cells.any(axis=1)), np.flatnonzero(cells.any(axis=0))
        south, north = self.lat_edges[rows[0]], self.lat_edges[rows[-1] + 1]
        west, east = self.lon_edges[columns], self.lon_edges[columns + 1]
        return enclosing_bounds(west, east, float(south), float(north))


@dataclass(frozen=True)
class _Footprint:
    """Cells of one file: True inside, for the rows of the file's latitudes from ``first`` on (rows,
    columns).
    """

    first: int
    inside: Mask

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + len(self.inside))

    def shared(self, other: _Footprint, rows: int) -> Mask:
        """Cells in both, (``rows``, columns)."""
        out = np.zeros((rows, self.inside.shape[1]), np.bool_)
        out[self.rows] = self.inside
        both = np.zeros_like(out)
        both[other.rows] = other.inside & out[other.rows]
        return both


def rectangle_km2(box: Bounds) -> float:
    """Area between two meridians and two parallels, degrees."""
    height = math.sin(math.radians(box.north)) - math.sin(math.radians(box.south))
    return RADIUS_KM**2 * math.radians(box.east - box.west) * height


def set_coverage(dems: DemSet) -> SetCoverage:
    """Areas, overlaps and gaps of a set. No pixel is read."""
    box = Bounds(*(float(edge) for edge in dems.bounds))
    ranked = [lat for zone in dems.zones for lat in (-zone.high, zone.high)]
    cells = _divided([dem.grid for dem in dems.dems], box, [*BAND_EDGES_DEG, *ranked])
    footprints = [_footprint(dem.grid, cells) for dem in dems.dems]
    area, depth = cells.area_km2, np.zeros((cells.lat_deg.size, cells.lon_deg.size), np.int16)
    for one in footprints:
        depth[one.rows] += one.inside
    used = _used(dems, cells, footprints)
    pixel_km2 = [(dem.gsd_m / 1000.0) ** 2 for dem in dems.dems]
    poles = np.asarray(dems.candidates_at([0.0, 0.0], [-90.0, 90.0]).any(axis=0))
    return SetCoverage(
        bounds=box,
        covered_km2=float(area[used >= 0].sum()),
        box_km2=rectangle_km2(box),
        bands=tuple(_bands(dems, cells, depth, used)),
        file_km2=tuple(float(area[one.rows][one.inside].sum()) for one in footprints),
        used_km2=tuple(_by_file(used, area, len(footprints)).tolist()),
        overlaps=tuple(_overlaps(dems, cells, footprints, pixel_km2)),
        gaps=tuple(_gaps(cells, used < 0, box, min(pixel_km2))),
        has_north_pole=bool(poles[1]),
        has_south_pole=bool(poles[0]),
        is_full_ring=bool((used >= 0).all(axis=1).any()) and cells.is_ring,
        crosses_antimeridian=_crosses(dems, cells.lat_deg),
    )


def set_disagreements(dems: DemSet, covered: SetCoverage) -> list[Disagreement]:
    """Products that differ by more than their uncertainties where files overlap, each pair in its
    largest overlap.
    """
    found: list[Disagreement] = []
    compared: set[frozenset[str]] = set()
    for one in covered.overlaps:
        pair = dems.dems[one.first], dems.dems[one.second]
        names = frozenset(dem.product for dem in pair)
        if names not in compared and len(compared) < _PAIRS:
            compared.add(names)
            found += disagreements(DemSet(pair), one.bounds)
    return found


def _divided(grids: Sequence[Grid], box: Bounds, latitudes_deg: Iterable[float]) -> _Cells:
    """Cells of a box that end at ``latitudes_deg``, at the edges of cylindrical files, and at
    longitudes and latitudes of points along the edges of polar files, so that cells are small where
    such an edge crosses them.
    """
    boxes = [grid.bounds for grid in grids]
    lons = [edge for b in boxes for edge in (b.west, b.east)]
    lats = [*latitudes_deg, *(edge for b in boxes for edge in (b.south, b.north))]
    polar = [grid for grid in grids if grid.pole]
    count = int(np.clip(_EDGE_POINTS // 4 // max(len(polar), 1), *_EDGE_POINTS_OF_SIDE))
    for grid in polar:
        lons += _outline(grid, count, 0.0)[0].tolist()
        lats += _outline(grid, count, 0.5)[1].tolist()  # else all errors would have one sign
    columns = _between((np.array(lons) - box.west) % 360.0, box.east - box.west)
    rows = _between(np.array(lats) - box.south, box.north - box.south)
    return _Cells(box.west + columns, box.south + rows)


def _between(at: Array, length: float) -> Array:
    """Edges of cells: 0, the values of ``at`` between, and ``length``."""
    edges = np.unique([0.0, *at[(at > 0.0) & (at < length)], length])
    return np.asarray(edges[np.append(True, np.diff(edges) > _NARROW_DEG)])


def _outline(grid: Grid, count: int, offset: float) -> tuple[Array, Array]:
    """Longitudes and latitudes of ``count`` points at equal distances along each outer edge, the
    first ``offset`` distances from a corner.
    """
    along = (np.arange(count) + offset) / count
    across, down = along * grid.width - 0.5, along * grid.height - 0.5
    right, bottom = np.full(count, grid.width - 0.5), np.full(count, grid.height - 0.5)
    first = np.full(count, -0.5)
    return grid.lonlat(
        np.concatenate([across, right, right - across - 0.5, first]),
        np.concatenate([first, down, bottom, bottom - down - 0.5]),
    )


def _footprint(grid: Grid, cells: _Cells) -> _Footprint:
    box, lat = grid.bounds, cells.lat_deg
    rows = np.flatnonzero((lat >= box.south - 1e-6) & (lat <= box.north + 1e-6))
    return _Footprint(int(rows[0]), grid.holds(cells.lon_deg[None, :], lat[rows, None]))


def _used(dems: DemSet, cells: _Cells, footprints: Sequence[_Footprint]) -> Int16:
    """Index of the file that is used in each cell, -1 without a file, (rows, columns)."""
    used = np.full((cells.lat_deg.size, cells.lon_deg.size), -1, np.int16)
    away = np.abs(cells.lat_deg)
    for low, high, files in dems.rankings:
        rows = (away > low) & (away < high)
        for number in files:
            one = footprints[number]
            part = used[one.rows]
            part[(part < 0) & one.inside & rows[one.rows, None]] = number
    return used


def _by_file(used: Int16, area_km2: Array, files: int) -> Array:
    """Area where each file is used, (files,)."""
    there = used >= 0
    return np.asarray(np.bincount(used[there], area_km2[there], files), np.float64)


def _bands(dems: DemSet, cells: _Cells, depth: Int16, used: Int16) -> list[Band]:
    """Bands that the set's box reaches into, from north to south."""
    found, areas = [], cells.area_km2
    for south, north in pairwise(BAND_EDGES_DEG):
        here = (cells.lat_deg > south) & (cells.lat_deg < north)
        if not here.any():
            continue
        area, one, files = areas[here], used[here], depth[here]
        by_product: dict[str, float] = {}
        by_file = _by_file(one, area, len(dems.dems)).tolist()
        for product, km2 in zip(dems.products, by_file, strict=True):
            if km2 > 0.0:
                by_product[product] = by_product.get(product, 0.0) + km2
        whole = rectangle_km2(Bounds(0.0, south, 360.0, north))
        covered, overlap, gap = (float(area[m].sum()) for m in (one >= 0, files > 1, one < 0))
        found.append(Band(south, north, whole, covered, overlap, gap, by_product))
    return found[::-1]


def _overlaps(
    dems: DemSet, cells: _Cells, footprints: Sequence[_Footprint], pixel_km2: Sequence[float]
) -> list[Overlap]:
    """Pairs of files that share more than the area of a pixel."""
    found, area = [], cells.area_km2
    boxes = [dem.grid.bounds for dem in dems.dems]
    for i, j in combinations(range(len(footprints)), 2):
        if boxes[i].meets(boxes[j]):
            both = footprints[i].shared(footprints[j], len(area))
            if (km2 := float(area[both].sum())) > min(pixel_km2[i], pixel_km2[j]):
                found.append(Overlap(i, j, km2, cells.box_around(both)))
    return sorted(found, key=lambda one: -one.area_km2)


def _gaps(cells: _Cells, free: Mask, box: Bounds, least_km2: float) -> Iterator[Gap]:
    """Connected parts of the box in no file that are larger than a pixel, largest first."""
    label: Index = connected_regions(free, cells.is_ring)
    area = np.bincount(label.ravel(), cells.area_km2.ravel())
    area[0] = 0.0  # in a file
    for number in np.argsort(-area, kind="stable"):
        if area[number] > least_km2:
            yield _gap(cells, label == number, float(area[number]), box)


def _gap(cells: _Cells, gap: Mask, area_km2: float, box: Bounds) -> Gap:
    at_edge = (gap[0].any() and box.south > -90.0) or (gap[-1].any() and box.north < 90.0)
    if not cells.is_ring:
        at_edge = at_edge or gap[:, 0].any() or gap[:, -1].any()
    return Gap(cells.box_around(gap), area_km2, bool(at_edge))


def _crosses(dems: DemSet, lat_deg: Array) -> bool:
    """True if some parallel is covered on both sides of longitude 180."""
    sides = [
        dems.candidates_at(np.full(lat_deg.size, lon), lat_deg).any(axis=0)
        for lon in (180.0 - 1e-6, 180.0 + 1e-6)
    ]
    return bool((sides[0] & sides[1]).any())
