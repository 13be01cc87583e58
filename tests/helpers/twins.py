"""Slow judges of the ray kernels. They share no code and no idea with the kernels: no traversal, no
pyramid, no edge walking.

`blocking` clips the vertical plane of a ray with *every* triangle of the raster; `blocked_exactly`
does the same in rational arithmetic. `textbook_hit` is Amanatides and Woo 1987 with Moeller and
Trumbore 1997, written from the papers. All take heights (rows, cols), and rays in cell units: u =
column, v = row (down), z in metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from lcp_catalog.arrays import Array

FAR = 1e30


def in_cells(direction: Array, gsd_m: float) -> tuple[float, float, float]:
    """An ENU direction in cell units, scaled so that the longer of du and dv is 1 (or as it is when
    vertical).
    """
    east, north, up = (float(c) for c in direction)
    longest = max(abs(east), abs(north))
    if longest == 0.0:
        return 0.0, 0.0, up
    return east / longest, -north / longest, up / longest * gsd_m


def triangles(z: Array) -> Array:
    """All existing triangles, (n, 3, 3): corner, (u, v, z)."""
    found = []
    for i in range(z.shape[0] - 1):
        for j in range(z.shape[1] - 1):
            for middle in ((i, j + 1), (i + 1, j)):
                corners = ((i, j), middle, (i + 1, j + 1))
                if all(np.isfinite(z[c]) for c in corners):
                    found.append([(b, a, float(z[a, b])) for a, b in corners])
    return np.array(found, dtype=np.float64).reshape(-1, 3, 3)


def blocking(
    corners: Array,
    origin: tuple[float, float, float],
    ray: tuple[float, float, float],
    s_max: float = FAR,
) -> float:
    """By how much the triangles rise above the ray at most, over 0 < s <= s_max, metres; -inf where
    none is under it.

    Within one triangle the ray's footprint is a segment and both heights are linear along it: the
    largest rise is at an end. Each triangle is clipped by itself with the half planes of its three
    sides (Cyrus and Beck 1978). A rise at s = 0 itself does not count.
    """
    return float(_blockings(corners, np.array([origin]), np.array([ray]), s_max)[0])


def _blockings(corners: Array, origins: Array, rays: Array, s_max: float) -> Array:
    """`blocking` of rays (n, 3) from origins (n, 3), every ray with every triangle."""
    if len(corners) == 0:
        return np.full(len(origins), -math.inf)
    (ou, ov, oz), (du, dv, dz) = origins.T[:, :, None], rays.T[:, :, None]
    near = np.zeros((len(origins), len(corners)))
    far = np.full(near.shape, float(s_max))
    a, b, c = corners[:, 0, :2], corners[:, 1, :2], corners[:, 2, :2]
    turn = np.sign(
        (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    )
    for p, q in ((a, b), (b, c), (c, a)):
        nu, nv = -(q[:, 1] - p[:, 1]) * turn, (q[:, 0] - p[:, 0]) * turn  # inwards
        inside = nu * (ou - p[:, 0]) + nv * (ov - p[:, 1])
        rate = nu * du + nv * dv
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -inside / rate
        near = np.where(rate > 0, np.maximum(near, s), near)
        far = np.where(rate < 0, np.minimum(far, s), far)
        far = np.where((rate == 0) & (inside < 0), -1.0, far)
    ray, hit = np.nonzero(near <= far)
    (zu, zv), z0 = _gradients(corners[hit]), corners[hit, 0]
    most = np.full(len(origins), -math.inf)
    for s in (near[ray, hit], far[ray, hit]):
        u, v, z = (o[ray, 0] + d[ray, 0] * s for o, d in ((ou, du), (ov, dv), (oz, dz)))
        over = z0[:, 2] + zu * (u - z0[:, 0]) + zv * (v - z0[:, 1]) - z
        np.maximum.at(most, ray[s > 0], over[s > 0])
    return most


def _gradients(corners: Array) -> tuple[Array, Array]:
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    det = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    return (e[:, 2] * f[:, 1] - f[:, 2] * e[:, 1]) / det, (
        e[:, 0] * f[:, 2] - f[:, 0] * e[:, 2]
    ) / det


Window = tuple[slice, slice]
WHOLE: Window = (slice(None), slice(None))


def node_margins(z: Array, ray: tuple[float, float, float], part: Window = WHOLE) -> Array:
    """`blocking` of the parallel rays from all nodes of a part; NaN at nodata."""
    return _margins(z, lambda origins: np.broadcast_to(np.array(ray), origins.shape), FAR, part)


def node_margins_to(z: Array, camera: tuple[float, float, float], part: Window = WHOLE) -> Array:
    """`blocking` of the segments from all nodes of a part to a camera; NaN at nodata."""
    return _margins(z, lambda origins: np.array(camera) - origins, 1.0, part)


def _margins(z: Array, rays_from: Callable[[Array], Array], s_max: float, part: Window) -> Array:
    """Vertical rays touch their own node alone: blocked where they look down into a triangle's corner."""
    corners, out, there = triangles(z), np.full(z.shape, np.nan), np.zeros(z.shape, bool)
    there[part] = np.isfinite(z[part])
    i, j = np.nonzero(there)
    origins = np.stack([j, i, z[there]], axis=1).astype(np.float64)
    rays = rays_from(origins)
    margins = _blockings(corners, origins, rays, s_max)
    for n in np.flatnonzero((rays[:, 0] == 0.0) & (rays[:, 1] == 0.0)):
        touches = (corners[:, :, :2] == origins[n, :2]).all(axis=2)
        margins[n] = math.inf if rays[n, 2] < 0 and touches.any() else -math.inf
    out[there] = margins
    return out[part]


def textbook_hit(
    z: Array, origin: tuple[float, float, float], ray: tuple[float, float, float]
) -> float:
    """First hit at s > 1e-9 of a ray with the triangles, from either side, cell after cell; NaN for
    none. The start may lie outside.
    """
    rows, cols = z.shape
    start = _enter(rows, cols, origin, ray)
    if start is None:
        return math.nan
    cells = _CellHits(z.tolist(), tuple(map(float, origin)), tuple(map(float, ray)))
    (ou, ov, _), (du, dv, _) = origin, ray
    j = min(max(math.floor(ou + du * start), 0), cols - 2)
    i = min(max(math.floor(ov + dv * start), 0), rows - 2)
    t_u = ((j + (du > 0)) - ou) / du if du else math.inf
    t_v = ((i + (dv > 0)) - ov) / dv if dv else math.inf
    while 0 <= i <= rows - 2 and 0 <= j <= cols - 2:
        hits = [h for a in (-1, 0, 1) for b in (-1, 0, 1) for h in cells[i + a, j + b] if h > 1e-9]
        if hits and min(hits) <= min(t_u, t_v) + 1e-9:
            return min(hits)
        if math.isinf(min(t_u, t_v)):
            return min(hits, default=math.nan)
        if t_u < t_v:
            j, t_u = (j + 1, t_u + 1 / du) if du > 0 else (j - 1, t_u - 1 / du)
        else:
            i, t_v = (i + 1, t_v + 1 / dv) if dv > 0 else (i - 1, t_v - 1 / dv)
    return math.nan


def _enter(rows: int, cols: int, origin: tuple, ray: tuple) -> float | None:
    near, far = 0.0, math.inf
    for o, d, limit in ((origin[0], ray[0], cols - 1), (origin[1], ray[1], rows - 1)):
        if d == 0.0:
            if not 0.0 <= o <= limit:
                return None
            continue
        a, b = sorted((-o / d, (limit - o) / d))
        near, far = max(near, a), min(far, b)
    return near if near <= far else None


class _CellHits(dict):
    """Where a ray meets the triangles of a cell, by the cell, each looked at once."""

    def __init__(self, z: list[list[float]], origin: tuple, ray: tuple) -> None:
        super().__init__()
        self.z, self.origin, self.ray = z, origin, ray

    def __missing__(self, cell: tuple[int, int]) -> list[float]:
        self[cell] = list(_cell_hits(self.z, *cell, self.origin, self.ray))
        return self[cell]


def _cell_hits(z: list, i: int, j: int, origin: tuple, ray: tuple) -> Iterator[float]:
    if not (0 <= i < len(z) - 1 and 0 <= j < len(z[0]) - 1):
        return
    for a, b in ((i, j + 1), (i + 1, j)):
        corners = ((j, i, z[i][j]), (b, a, z[a][b]), (j + 1, i + 1, z[i + 1][j + 1]))
        if all(math.isfinite(c[2]) for c in corners):
            t = _moeller_trumbore(origin, ray, *corners)
            if t is not None:
                yield t


def _cross(a: tuple, b: tuple) -> tuple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: tuple, b: tuple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _less(a: tuple, b: tuple) -> tuple:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _moeller_trumbore(origin: tuple, ray: tuple, v0: tuple, v1: tuple, v2: tuple) -> float | None:
    e1, e2 = _less(v1, v0), _less(v2, v0)
    g = _cross(ray, e2)
    det = _dot(e1, g)
    if abs(det) < 1e-14:
        return None
    s = _less(origin, v0)
    q = _cross(s, e1)
    d1, d2 = _dot(s, g) / det, _dot(ray, q) / det
    slack = 1e-11  # the edges belong to both sides
    return _dot(e2, q) / det if d1 >= -slack and d2 >= -slack and d1 + d2 <= 1 + slack else None
