"""Coverage and overview of catalogues that are merged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import AnyArray, Array
from ..catalog.catalogue import Catalog
from ..catalog.maps import usable_nearby
from ..catalog.model import Coverage, Overview
from ..geometry.bounds import enclosing_bounds, turned_deg
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane
from ..landmarks.selection import Places, Status, nearest
from ..terrain.area import Area
from .region_maps import COVERAGE_BYTES, COVERAGE_CELLS, OVERVIEW_NODES, middles, ring_cells

_RANK = np.array([6, 2, 3, 4, 1, 5])
"""Order of the codes of `Status`: of several reports on a cell the highest holds."""

_CODE = np.array([Status.NODATA, *np.argsort(_RANK)], np.uint8)
"""The code of each rank; 0: no report."""


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
        r0, c0 = r.astype(np.int64), c.astype(np.int64)
        r1, c1 = np.minimum(r0 + 1, rows - 1), np.minimum(c0 + 1, cols - 1)
        down, right = r - r0, c - c0
        z = view.height.astype(np.float64)
        upper = z[r0, c0] * (1.0 - right) + z[r0, c1] * right
        lower = z[r1, c0] * (1.0 - right) + z[r1, c1] * right
        return np.where(inside, upper * (1.0 - down) + lower * down, np.nan)


@dataclass(frozen=True, eq=False)
class MergedMaps:
    """The maps of catalogues together."""

    parts: Sequence[MergedPart]

    @property
    def spacing_m(self) -> float:
        """Spacing of the coverage: the largest of the parts."""
        return max(part.catalog.coverage.spacing_m for part in self.parts)

    @property
    def regions(self) -> list[Area]:
        """Every region once, in an order that does not depend on that of the parts."""
        return sorted({region for part in self.parts for region in part.regions}, key=repr)

    def coverage(self, points: Places, condition: AnyArray) -> Coverage:
        """Coverage on latitude rings (`region_maps.ring_cells`): whether a point, a longitude and a latitude
        in degrees, lies within the spacing of a cell's centre, or else the status of the nearest
        cell of an input whose region contains the centre; of several the one that came furthest
        towards a point. ``condition``: flags of the points, as in `usable_nearby`.
        """
        most = min(COVERAGE_CELLS, COVERAGE_BYTES // max(1, math.prod(condition.shape[1:])))
        lon, lat, step_m = ring_cells(self.regions, self.spacing_m, most)
        if not len(lon):  # narrower than a cell
            lon, lat = np.array([[turned_deg(one.lon_deg), one.lat_deg] for one in self.regions]).T
        rank = np.zeros(len(lon), np.int64)
        for part in self.parts:
            mine = np.flatnonzero(part.contains(lon, lat))
            cells = part.catalog.coverage
            cell, _ = nearest(Places(lon[mine], lat[mine]), Places(cells.longitude, cells.latitude))
            if len(cells.status):
                rank[mine] = np.maximum(rank[mine], _RANK[cells.status[cell]])
        rank[nearest(Places(lon, lat), points)[1] <= self.spacing_m] = _RANK[Status.POINT]
        nearby = usable_nearby(Places(lon, lat), points, condition, self.spacing_m)
        return Coverage(lon, lat, _CODE[rank], self.spacing_m, nearby, step_m)

    def overview(self) -> Overview:
        """The heights of all overviews in one raster; where several show a place, of the finest."""
        boxes = [region.bounds for region in self.regions]
        west, south, east, north = np.array(boxes).T
        box = enclosing_bounds(west, east, float(south.min()), float(north.max()))
        whole = Area.from_bounds(box.west, box.south, box.east, box.north)
        if whole.is_local:
            frame, extent_m = whole.frame, whole.extent_m
            plane = MapPlane(ORTHOGRAPHIC, frame.lon_deg, frame.lat_deg)
        else:
            plane = MapPlane.showing(box)
            extent_m = plane.extent_m(box)
        x0, x1, y0, y1 = extent_m
        finest = sorted(self.parts, key=lambda part: part.step_m)
        step = max(finest[0].step_m, max(x1 - x0, y1 - y0) / OVERVIEW_NODES)
        x, y = middles(x0, x1, step), middles(y0, y1, step)[::-1]
        lon, lat = plane.lonlat(*np.meshgrid(x, y))
        height = np.full(lon.shape, np.nan)
        for part in finest:
            todo = np.isnan(height) & np.isfinite(lon)
            height[todo] = part.heights(lon[todo], lat[todo])
        return Overview(
            height.astype(np.float32), x, y, plane.center_lon, plane.center_lat, plane.projection
        )
