"""Catalogues that are merged, and whether two that show the same ground agree about its heights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import AnyArray, Array
from ..catalog.catalogue import Catalog
from ..catalog.patch_terrain import nodes_mcmf
from ..catalog.schema import levels
from ..dem.mosaic import FACTOR, UNKNOWN_SIGMA_M
from ..landmarks.selection import Places, nearest
from ..terrain.area import Area

_NODES_MOST = 20_000
_PAIRS_MOST = 256
"""Nodes of an overview, and pairs of patches, that are compared at most."""

_PLACES_MIN = 30
"""Places that two must share to be compared, as `dem.mosaic` has it."""


@dataclass(frozen=True, eq=False)
class MergedPart:
    """A catalogue that is merged, and the regions of its builds."""

    catalog: Catalog
    regions: Sequence[Area]

    @cached_property
    def step_m(self) -> float:
        """Distance of the overview's nodes."""
        view = self.catalog.overview
        steps = [*np.diff(view.x), *-np.diff(view.y)]
        return float(steps[0]) if steps else self.catalog.coverage.spacing_m

    def contains(self, lon_deg: Array, lat_deg: Array) -> AnyArray:
        """True for places in any of the regions."""
        inside = [region.contains(lon_deg, lat_deg) for region in self.regions]
        return np.asarray(np.any(inside, axis=0))

    def heights(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Heights of its overview at places (n,), bilinear between the nodes, NaN outside."""
        view = self.catalog.overview
        x, y = view.plane.at(lon_deg, lat_deg)
        col, row = (x - view.x[0]) / self.step_m, (view.y[0] - y) / self.step_m
        rows, cols = view.height.shape
        inside = (np.abs(col - (cols - 1) / 2.0) <= cols / 2.0) & (
            np.abs(row - (rows - 1) / 2.0) <= rows / 2.0
        )
        r = np.clip(np.where(inside, row, 0.0), 0.0, rows - 1.0)
        c = np.clip(np.where(inside, col, 0.0), 0.0, cols - 1.0)
        return np.where(inside, _bilinear(view.height[None], r[None], c[None])[0], np.nan)

    @property
    def sigma_m(self) -> float:
        """The stated error of its heights, 1 sigma: of several DEMs the largest."""
        return float(np.max(self.catalog.errors.get("height_sigma_m", UNKNOWN_SIGMA_M)))


def _bilinear(z: AnyArray, row: Array, col: Array) -> Array:
    """Heights between the nodes of rasters (n, rows, cols) at their places (n, m)."""
    number = np.arange(len(z))[:, None]
    r0, c0 = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    r1, c1 = np.minimum(r0 + 1, z.shape[1] - 1), np.minimum(c0 + 1, z.shape[2] - 1)
    down, right, z = row - r0, col - c0, z.astype(np.float64)
    upper = z[number, r0, c0] * (1.0 - right) + z[number, r0, c1] * right
    lower = z[number, r1, c0] * (1.0 - right) + z[number, r1, c1] * right
    return np.asarray(upper * (1.0 - down) + lower * down)


def contradiction(one: MergedPart, other: MergedPart) -> str:
    """How the heights of two catalogues differ beyond their errors; empty if they do not, or share no ground.

    Compared are the overviews, at nodes of the coarser one, and the patches of points of one level near to
    each other, at nodes of one. They contradict each other if the median absolute difference is above `FACTOR`
    times the root of the sum of squares of both stated height errors (1 sigma), as in `dem.mosaic`, and of what
    heights change between nodes: the medians of the difference of a node from the mean of its four neighbours.
    """
    for name, compared in (("overviews", _overviews), ("patches", _patches)):
        away, rough_m = compared(one, other)
        away = away[np.isfinite(away)]
        if len(away) < _PLACES_MIN:
            continue
        median_m = float(np.median(np.abs(away)))
        limit_m = FACTOR * math.hypot(one.sigma_m, other.sigma_m, *rough_m)
        if median_m > limit_m:
            return (
                f"its heights differ by {median_m:.1f} m (median of {len(away)} places of the {name}), "
                f"beyond the {limit_m:.1f} m that height errors and cell sizes explain"
            )
    return ""


Compared = tuple[Array, tuple[float, float]]
"""Differences at places, metres, NaN where one has no height; and how rough both are between nodes."""


def _overviews(one: MergedPart, other: MergedPart) -> Compared:
    fine, coarse = sorted((one, other), key=lambda part: part.step_m)
    view = coarse.catalog.overview
    step = math.ceil(math.sqrt(view.height.size / _NODES_MOST)) or 1
    some = (slice(None, None, step),) * 2
    lon, lat = (place[some].ravel() for place in view.plane.lonlat(*np.meshgrid(view.x, view.y)))
    height = view.height[some].ravel().astype(np.float64)
    known = np.isfinite(lon) & np.isfinite(height)
    away = height[known] - fine.heights(lon[known], lat[known])
    return away, (_roughness_m(fine.catalog.overview.height), _roughness_m(view.height))


def _patches(one: MergedPart, other: MergedPart) -> Compared:
    mine, its = one.catalog, other.catalog
    half = (mine.patch_nodes - 1) // 2
    here, there = (Places(c.longitude, c.latitude) for c in (mine, its))
    nearby, away_m = nearest(here, there)
    level = levels(np.concatenate([mine.gsd, its.gsd]))
    rows = np.flatnonzero(away_m <= half * mine.gsd)
    rows = rows[level[rows] == level[len(mine) + nearby[rows]]]
    rows = rows[:: math.ceil(len(rows) / _PAIRS_MOST) or 1]
    if not len(rows):
        return np.zeros(0), (0.0, 0.0)
    found = nearby[rows]
    nodes = nodes_mcmf(mine, rows).reshape(len(rows), -1, 3) - its.position_mcmf[found, None]
    east, north, up = np.moveaxis(nodes @ its.rotation_mcmf_to_enu[found].swapaxes(1, 2), -1, 0)
    row, col = (half + place / its.gsd[found, None] for place in (-north, east))
    inside = (np.minimum(row, col) >= 0.0) & (np.maximum(row, col) <= 2.0 * half)
    patch, ours = its.part("dem", found), mine.part("dem", rows)
    height = _bilinear(patch, np.where(inside, row, 0.0), np.where(inside, col, 0.0))
    return (up - height)[inside], (_roughness_m(ours), _roughness_m(patch))


def _roughness_m(z: AnyArray) -> float:
    """Median difference of a node from the mean of its four neighbours, of rasters (..., rows, cols)."""
    z = z.astype(np.float64)
    mean = z[..., :-2, 1:-1] + z[..., 2:, 1:-1] + z[..., 1:-1, :-2] + z[..., 1:-1, 2:]
    away = np.abs(z[..., 1:-1, 1:-1] - mean / 4.0)
    return float(np.median(away[np.isfinite(away)])) if np.isfinite(away).any() else 0.0
