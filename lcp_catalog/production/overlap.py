"""Catalogues that are merged, and whether two that show the same ground agree about its heights and where it lies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..arrays import AnyArray, Array
from ..catalog.catalogue import Catalog
from ..catalog.patch_terrain import nodes_mcmf
from ..catalog.schema import levels
from ..dem.mosaic import UNKNOWN_SIGMA_M
from ..dem.products import facts_of, tie_of
from ..dem.shared_ground import SharedGround, Sigmas, blocks, roughness_m, sampled
from ..geometry.frames import enu_rotation, lonlat_to_mcmf, mcmf_to_lonlat
from ..landmarks.selection import Places, nearest
from ..terrain.area import Area

_NODES_MOST = 20_000
_PAIRS_MOST = 256
"""Nodes of an overview, and pairs of patches, that are compared at most."""

_BALL_NODES = 33
"""Nodes along a side of an overview by which a sphere around it is found."""


class Agreement(NamedTuple):
    """Of two catalogues: how their heights of the same ground contradict each other, empty if they do not; and what could
    not be seen, because the ground that both show is too small or too flat, empty if all could or they share none.
    """

    fault: str = ""
    unseen: str = ""


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

    def nodes(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Row and column (2, 1, n) of places (n,) in its overview."""
        view = self.catalog.overview
        x, y = view.plane.at(lon_deg, lat_deg)
        return np.stack([view.y[0] - y, x - view.x[0]])[:, None] / self.step_m

    def heights(self, lon_deg: Array, lat_deg: Array) -> Array:
        """Heights of its overview at places (n,), bilinear between the nodes, NaN outside."""
        found = sampled(self.catalog.overview.height[None], self.nodes(lon_deg, lat_deg), 0.5)
        return np.asarray(found[0])

    @cached_property
    def ball(self) -> tuple[Array, float]:
        """A sphere around the places that the overview shows and those of the points with their patches: centre (3,), MCMF, and
        radius, metres; infinite for an overview that goes beyond the Moon.
        """
        catalog, view = self.catalog, self.catalog.overview
        x, y = (
            axis[np.linspace(0, len(axis) - 1, min(len(axis), _BALL_NODES)).astype(np.int64)]
            for axis in (view.x, view.y)
        )
        nodes = lonlat_to_mcmf(*view.plane.lonlat(*np.meshgrid(x, y)))
        steps = [
            np.linalg.norm(np.diff(nodes, axis=axis), axis=2).max(initial=0.0) for axis in (0, 1)
        ]
        points = lonlat_to_mcmf(catalog.longitude, catalog.latitude)
        patch_m = catalog.patch_nodes * float(catalog.gsd.max(initial=0.0))
        places = np.concatenate([nodes.reshape(-1, 3), points])
        center = (places.min(axis=0) + places.max(axis=0)) / 2.0
        # what lies between the nodes and half a step beyond them is nearer to one of them than the diagonal of a mesh
        margin_m = max(2.0 * sum(steps) + self.step_m, patch_m)
        radius_m = np.linalg.norm(places - center, axis=1).max() + margin_m
        return center, math.inf if np.isnan(radius_m) else float(radius_m)

    def near(self, position_mcmf_m: Array) -> AnyArray:
        """False for places (n, 3) on the sphere, metres, that its overview certainly does not show."""
        center, radius_m = self.ball
        if math.isinf(radius_m):
            return np.ones(len(position_mcmf_m), bool)
        return np.asarray(np.linalg.norm(position_mcmf_m - center, axis=1) <= radius_m)

    def same_files(self, other: MergedPart) -> bool:
        """Whether both were made from the same DEM files."""
        one, two = ({file["sha256"] for file in part.catalog.sources} for part in (self, other))
        return one == two

    @cached_property
    def sigmas(self) -> Sigmas:
        """The errors of its ground: of a height as stated, of several DEMs the largest; of where it lies, that of the map in
        the Moon's frame and of a patch in the map; of the level of all heights as published of the DEMs, or as `dem.mosaic`
        has it where nothing is: errors that are alike over a correlation length only are gone in the mean.
        """
        stated, size_m = self.catalog.errors, float(self.catalog.gsd.max(initial=0.0))
        products = {*self.catalog.part("dem_product", slice(None)).tolist()}
        ties = [tie_of(name) for name in products]
        known = [facts_of(name).sigma_m or UNKNOWN_SIGMA_M for name in products]
        patch_m = float(np.max(stated.get("position_sigma_m", 0.0)))
        cells_m = float(np.max(stated.get("position_sigma_cells", 0.0))) * size_m
        tie_m = max((tie[0] for tie in ties if tie), default=0.0)
        return Sigmas(
            height_m=float(np.max(stated.get("height_sigma_m", UNKNOWN_SIGMA_M))),
            place_m=math.hypot(tie_m, max(patch_m, cells_m)),
            level_m=max(known, default=UNKNOWN_SIGMA_M),
        )


def near_pairs(parts: Sequence[MergedPart]) -> Iterator[tuple[int, int]]:
    """The pairs of parts (numbers, ascending) that may show the same ground: of thousands of neighbours few for each."""
    centers = np.array([part.ball[0] for part in parts])
    radii = np.array([part.ball[1] for part in parts])
    for one in range(len(parts)):
        away = np.linalg.norm(centers[one + 1 :] - centers[one], axis=1)
        # not "<=": an infinite sphere has no centre, and meets all
        for other in np.flatnonzero(~(away > radii[one + 1 :] + radii[one])).tolist():
            yield one, one + 1 + other


def agreement(one: MergedPart, other: MergedPart) -> Agreement:
    """Whether two catalogues agree about the ground that both show (`SharedGround.fault`).

    Compared are the overviews, at nodes of the coarser one, and the patches of points of one level near to
    each other, at nodes of one. Of catalogues from the same files it is not said what could not be seen.
    """
    unseen = []
    for name, compared in (("overviews", _overviews), ("patches", _patches)):
        shared = compared(one, other)
        if shared is None or not (count := shared.count):
            continue
        if text := shared.fault(one.sigmas, other.sigmas, f"the {name}"):
            return Agreement(fault=text)
        if not one.same_files(other):
            least_m = shared.unseen_m(one.sigmas, other.sigmas)
            unseen.append((least_m, f"{count} places of the {name}"))
    if not unseen:
        return Agreement()
    seen_m, where = min(unseen)
    if seen_m == 0.0:
        return Agreement()
    size = f"of less than {seen_m:.0f} m" if math.isfinite(seen_m) else "of any size"
    return Agreement(
        unseen=f"a shift of the ground {size} could not be seen: {where} are too few, or too flat"
    )


def _overviews(one: MergedPart, other: MergedPart) -> SharedGround | None:
    """At the nodes of the coarser one; of equally coarse ones at those of which more lie in the other."""
    fine, coarse = sorted((one, other), key=lambda part: part.step_m)
    both = [_at_nodes(fine, coarse)]
    if math.isclose(coarse.step_m, fine.step_m):
        both.append(_at_nodes(coarse, fine))
    return max(filter(None, both), key=lambda shared: shared.place.shape[2], default=None)


def _at_nodes(fine: MergedPart, coarse: MergedPart) -> SharedGround | None:
    view = coarse.catalog.overview
    x, y = (place.ravel() for place in np.meshgrid(view.x, view.y))
    lon, lat = view.plane.lonlat(x, y)
    height = view.height.ravel().astype(np.float64)
    known = np.flatnonzero(np.isfinite(lon) & np.isfinite(height))
    known = known[np.isfinite(fine.heights(lon[known], lat[known]))]
    if not len(known):
        return None
    known = known[np.linspace(0, len(known) - 1, min(len(known), _NODES_MOST)).astype(np.int64)]
    lon, lat, x, y, height = (values[known] for values in (lon, lat, x, y, height))
    place = fine.nodes(lon, lat)
    return SharedGround(
        height[None],
        fine.catalog.overview.height[None],
        place,
        (_beside(fine, lon, lat, coarse.step_m) - place) / coarse.step_m,
        blocks(x, y)[None],
        coarse.step_m,
        (roughness_m(fine.catalog.overview.height), roughness_m(view.height)),
    )


def _beside(part: MergedPart, lon_deg: Array, lat_deg: Array, step_m: float) -> Array:
    """Rows and columns (2, 2, 1, n) of places a step east and a step north, in the frame at the middle of all places: a shift
    is one vector also where meridians meet.
    """
    position = lonlat_to_mcmf(lon_deg, lat_deg)
    lon, lat, _ = mcmf_to_lonlat(position.mean(axis=0))
    moved = position + step_m * enu_rotation(lon, lat)[:2, None]
    lon, lat, _ = mcmf_to_lonlat(moved)
    return np.stack([part.nodes(lon[axis], lat[axis]) for axis in (0, 1)])


def _patches(one: MergedPart, other: MergedPart) -> SharedGround | None:
    mine, its = one.catalog, other.catalog
    half = (mine.patch_nodes - 1) // 2
    here, there = (Places(c.longitude, c.latitude) for c in (mine, its))
    nearby, away_m = nearest(here, there)
    level = levels(np.concatenate([mine.gsd, its.gsd]))
    rows = np.flatnonzero(away_m <= half * mine.gsd)
    rows = rows[level[rows] == level[len(mine) + nearby[rows]]]
    rows = rows[:: math.ceil(len(rows) / _PAIRS_MOST) or 1]
    if not len(rows):
        return None
    found = nearby[rows]
    nodes = nodes_mcmf(mine, rows).reshape(len(rows), -1, 3) - its.position_mcmf[found, None]
    east, north, up = np.moveaxis(nodes @ its.rotation_mcmf_to_enu[found].swapaxes(1, 2), -1, 0)
    patch, ours, cell_m = its.part("dem", found), mine.part("dem", rows), its.gsd[found, None]
    place = half + np.stack([-north, east]) / cell_m
    zero = np.zeros_like(cell_m)
    along = np.stack([np.stack([zero, 1.0 / cell_m]), np.stack([-1.0 / cell_m, zero])])
    block = np.broadcast_to(blocks(mine.longitude[rows], mine.latitude[rows])[:, None], up.shape)
    step_m = float(max(cell_m.max(), mine.gsd[rows].max()))
    return SharedGround(
        up, patch, place, along, block, step_m, (roughness_m(ours), roughness_m(patch))
    )
