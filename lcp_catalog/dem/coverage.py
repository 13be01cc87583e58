"""What a set of DEM files covers: by bands of latitude, by product, where files overlap and where none is.

All of it is geometry; only `set_disagreements` reads pixels, some hundred small windows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..geometry.bounds import Bounds, around
from .connected_regions import Region, components
from .consistency import Disagreement, disagreements
from .coverage_arcs import RADIUS_KM, Arcs, cut
from .mosaic import DemSet

BAND_EDGES_DEG = (-90.0, -85.0, -80.0, -75.0, -60.0, 0.0, 60.0, 75.0, 80.0, 85.0, 90.0)
"""The method's table of products (method.md section 1), north and south."""
MOON_KM2 = 4.0 * math.pi * RADIUS_KM**2

_CHUNK = 50_000  # places asked at once
_PAIRS = 20  # of products that are compared


@dataclass(frozen=True)
class Band:
    """Ground between two parallels: all of it, and what of it is covered, is in two or more files, is a gap of the set's box."""

    south_deg: float
    north_deg: float
    area_km2: float
    covered_km2: float
    overlap_km2: float
    gap_km2: float
    used_km2: dict[str, float]  # by product: where it is the one that is used


@dataclass(frozen=True)
class Overlap:
    """Ground that two files share, by their index in the set, and the box around it."""

    first: int
    second: int
    area_km2: float
    bounds: Bounds


@dataclass(frozen=True)
class Gap(Region):
    """Ground of the set's box in no file; ``at_edge`` when it reaches the box's edge, so that files do not enclose it."""

    at_edge: bool


@dataclass(frozen=True)
class SetCoverage:
    """What the files of a set cover together. Areas are ground of the sphere of 1737.4 km.

    ``file_km2`` is each file's own footprint, ``used_km2`` the part of it where that file is the one that is used. Gaps are
    ground of the box ``bounds`` in no file; gaps and overlaps are sorted, largest first. Missing pixels do not count here.
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

    @property
    def gap_km2(self) -> float:
        return sum(band.gap_km2 for band in self.bands)


def rectangle_km2(west: float, south: float, east: float, north: float) -> float:
    """Ground between two meridians and two parallels, degrees."""
    height = math.sin(math.radians(north)) - math.sin(math.radians(south))
    return RADIUS_KM**2 * math.radians(east - west) * height


def set_coverage(dems: DemSet) -> SetCoverage:
    """Cut the set's box at every edge of its files and add up; no pixel is read."""
    box = Bounds(*(float(edge) for edge in dems.bounds))
    ranked = [lat for zone in dems.zones for lat in (-zone.high, zone.high)]
    arcs = cut([dem.grid for dem in dems.dems], box, [*BAND_EDGES_DEG, *ranked])
    inside, used = _ask(dems, arcs)
    shared = _shared(inside, arcs.area_km2)
    pixel_km2 = [(dem.gsd_m / 1000.0) ** 2 for dem in dems.dems]
    poles = np.asarray(dems.candidates_at([0.0, 0.0], [-90.0, 90.0]).any(axis=0))
    return SetCoverage(
        bounds=box,
        covered_km2=float(arcs.area_km2[used >= 0].sum()),
        box_km2=rectangle_km2(*box),
        bands=tuple(_bands(dems, arcs, inside.sum(axis=0), used)),
        file_km2=tuple(np.diag(shared).tolist()),
        used_km2=tuple(
            np.bincount(used[used >= 0], arcs.area_km2[used >= 0], len(dems.dems)).tolist()
        ),
        overlaps=tuple(_overlaps(arcs, inside, shared, pixel_km2)),
        gaps=tuple(_gaps(arcs, used < 0, box, min(pixel_km2))),
        has_north_pole=bool(poles[1]),
        has_south_pole=bool(poles[0]),
        is_full_ring=bool((np.bincount(arcs.row, used < 0) == 0).any())
        and box.east - box.west > 360.0 - 1e-9,
        crosses_antimeridian=_crosses(dems, arcs.lat_deg),
    )


def set_disagreements(dems: DemSet, covered: SetCoverage) -> list[Disagreement]:
    """Products that differ by more than their uncertainties where their files overlap, each pair in its largest overlap."""
    found: list[Disagreement] = []
    asked: set[frozenset[str]] = set()
    for one in covered.overlaps:
        pair = dems.dems[one.first], dems.dems[one.second]
        names = frozenset(dem.product for dem in pair)
        if names not in asked and len(asked) < _PAIRS:
            asked.add(names)
            found += disagreements(DemSet(pair), one.bounds)
    return found


def _ask(dems: DemSet, arcs: Arcs) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """For every arc the files whose footprint holds it (files, arcs), and the one that is used, -1 for none."""
    inside = np.empty((len(dems.dems), arcs.row.size), np.bool_)
    used = np.empty(arcs.row.size, np.int64)
    for start in range(0, arcs.row.size, _CHUNK):
        part = slice(start, start + _CHUNK)
        inside[:, part] = dems.candidates_at(arcs.lon_deg[part], arcs.lat_deg[part])
        used[part] = dems.product_at(arcs.lon_deg[part], arcs.lat_deg[part])
    return inside, used


def _shared(inside: NDArray[np.bool_], area_km2: Array) -> Array:
    """Ground of every pair of files, (files, files)."""
    shared = np.zeros((len(inside), len(inside)))
    for number, one in enumerate(inside):
        where = np.flatnonzero(one)
        for start in range(0, where.size, _CHUNK):
            part = where[start : start + _CHUNK]
            shared[number] += np.sum(inside[:, part] * area_km2[part], axis=1)
    return shared


def _bands(
    dems: DemSet, arcs: Arcs, depth: NDArray[np.int64], used: NDArray[np.int64]
) -> list[Band]:
    """The bands that the set's box reaches into, from north to south."""
    found = []
    for south, north in pairwise(BAND_EDGES_DEG):
        here = (arcs.lat_deg > south) & (arcs.lat_deg < north)
        area, one, files = arcs.area_km2[here], used[here], depth[here]
        if not one.size:
            continue
        by_file = np.bincount(one[one >= 0], area[one >= 0], len(dems.dems))
        by_product: dict[str, float] = {}
        for product, km2 in zip(dems.products, by_file.tolist(), strict=True):
            if km2 > 0.0:
                by_product[product] = by_product.get(product, 0.0) + km2
        whole = rectangle_km2(0.0, south, 360.0, north)
        covered, overlap, gap = (float(area[m].sum()) for m in (one >= 0, files > 1, one < 0))
        found.append(Band(south, north, whole, covered, overlap, gap, by_product))
    return found[::-1]


def _overlaps(
    arcs: Arcs, inside: NDArray[np.bool_], shared: Array, pixel_km2: Sequence[float]
) -> list[Overlap]:
    """Pairs of files that share more than a pixel."""
    found = []
    for i in range(len(pixel_km2)):
        for j in range(i + 1, len(pixel_km2)):
            if shared[i, j] > min(pixel_km2[i], pixel_km2[j]):
                both = np.flatnonzero(inside[i] & inside[j])
                found.append(Overlap(i, j, float(shared[i, j]), _box_around(arcs, both)))
    return sorted(found, key=lambda one: -one.area_km2)


def _box_around(arcs: Arcs, some: NDArray[np.int64]) -> Bounds:
    south, north = float(arcs.south_deg[some].min()), float(arcs.north_deg[some].max())
    return around(arcs.west_deg[some], arcs.east_deg[some], south, north)


def _gaps(arcs: Arcs, free: NDArray[np.bool_], box: Bounds, least_km2: float) -> list[Gap]:
    """Pieces of the box in no file, but for slivers below a pixel."""
    rows, west, east = arcs.row[free], arcs.west_deg[free], arcs.east_deg[free]
    if rows.size == 0:
        return []
    turn = 360.0 if box.east - box.west > 360.0 - 1e-9 else 0.0
    label = components(rows, west - box.west, east - box.west, turn, _follow(arcs, free))
    area = np.bincount(label, arcs.area_km2[free])
    order = [k for k in np.argsort(-area, kind="stable") if area[k] > least_km2]
    return [_gap(arcs, np.flatnonzero(free)[label == k], float(area[k]), box) for k in order]


def _gap(arcs: Arcs, some: NDArray[np.int64], area_km2: float, box: Bounds) -> Gap:
    near, found = 1e-6, _box_around(arcs, some)
    at_edge = found.south <= box.south + near and box.south > -90.0
    at_edge |= found.north >= box.north - near and box.north < 90.0
    if box.east - box.west < 360.0 - near:
        west, east = arcs.west_deg[some].min(), arcs.east_deg[some].max()
        at_edge |= bool(west <= box.west + near or east >= box.east - near)
    return Gap(found, area_km2, at_edge)


def _follow(arcs: Arcs, free: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Pairs of free arcs that are one and the same gap in neighbouring rows: edges keep their order within a segment, so the
    k-th arc of a row goes on as the k-th of the next. A narrow gap that runs aslant would fall to pieces without.
    """
    count = np.bincount(arcs.row)
    like_next = np.append(count[1:] == count[:-1], False)
    arc = np.flatnonzero(free & like_next[arcs.row])
    above = arc + count[arcs.row[arc]]  # the arc of the next row with the same number
    goes_on = (arcs.segment[above] == arcs.segment[arc]) & free[above]
    number = np.cumsum(free) - 1
    return np.stack([number[arc[goes_on]], number[above[goes_on]]], axis=1)


def _crosses(dems: DemSet, lats: Array) -> bool:
    """Whether some parallel is covered on both sides of longitude 180."""
    lat = np.unique(lats)
    sides = [
        dems.candidates_at(np.full(lat.size, lon), lat).any(axis=0)
        for lon in (180.0 - 1e-6, 180.0 + 1e-6)
    ]
    return bool((sides[0] & sides[1]).any())
