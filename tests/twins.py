"""Slow judges of the ray kernels. They share no code and no idea with the kernels: no traversal, no
pyramid, no edge walking.

`blocking` clips the vertical plane of a ray with *every* triangle of the raster; `blocking_exact`
does the same in rational arithmetic. `textbook_hit` is Amanatides and Woo 1987 with Moeller and
Trumbore 1997, written from the papers. All take heights (rows, cols), and rays in cell units: u =
column, v = row (down), z in metres.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
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
    (ou, ov, oz), (du, dv, dz) = origin, ray
    if len(corners) == 0:
        return -math.inf
    near, far = np.zeros(len(corners)), np.full(len(corners), float(s_max))
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
    hit = near <= far
    if not hit.any():
        return -math.inf
    (zu, zv), z0 = _gradients(corners[hit]), corners[hit, 0]
    rises = []
    for s in (near[hit], far[hit]):
        over = (
            z0[:, 2] + zu * (ou + du * s - z0[:, 0]) + zv * (ov + dv * s - z0[:, 1]) - (oz + dz * s)
        )
        rises.append(np.where(s > 0, over, -math.inf))
    return float(np.max(rises))


def _gradients(corners: Array) -> tuple[Array, Array]:
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    det = e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]
    return (e[:, 2] * f[:, 1] - f[:, 2] * e[:, 1]) / det, (
        e[:, 0] * f[:, 2] - f[:, 0] * e[:, 2]
    ) / det


def node_margins(z: Array, ray: tuple[float, float, float]) -> Array:
    """`blocking` of the parallel rays from all nodes; NaN at nodata."""
    corners, out = triangles(z), np.full(z.shape, np.nan)
    for i, j in np.argwhere(np.isfinite(z)):
        out[i, j] = _margin(corners, (float(j), float(i), float(z[i, j])), ray)
    return out


def node_margins_to(z: Array, camera: tuple[float, float, float]) -> Array:
    """`blocking` of the segments from all nodes to a camera; NaN at nodata."""
    corners, out = triangles(z), np.full(z.shape, np.nan)
    for i, j in np.argwhere(np.isfinite(z)):
        start = (float(j), float(i), float(z[i, j]))
        out[i, j] = _margin(
            corners, start, tuple(c - o for c, o in zip(camera, start, strict=True)), 1.0
        )
    return out


def _margin(corners: Array, start: tuple, ray: tuple, s_max: float = FAR) -> float:
    if ray[0] != 0.0 or ray[1] != 0.0:
        return blocking(corners, start, ray, s_max)
    touches = (corners[:, :, 0] == start[0]) & (corners[:, :, 1] == start[1])
    return math.inf if ray[2] < 0 and touches.any() else -math.inf


def blocked_exactly(
    z: NDArray, node: tuple[int, int], ray: tuple[Fraction | int, Fraction | int, Fraction | int]
) -> bool:
    """Whether some existing triangle lies strictly above the ray from a node at s > 0, in rational
    arithmetic: ties are decided.
    """
    du, dv, dz = (Fraction(c) for c in ray)
    origin = (Fraction(node[1]), Fraction(node[0]), Fraction(float(z[node])))
    return any(_above_exactly(t, origin, (du, dv, dz)) for t in _exact_triangles(z))


def _exact_triangles(z: NDArray) -> Iterator[list[tuple[Fraction, ...]]]:
    for corners in triangles(np.asarray(z, dtype=np.float64)):
        yield [tuple(Fraction(float(c)) for c in corner) for corner in corners]


def _above_exactly(corners: list, origin: tuple, ray: tuple) -> bool:
    (ou, ov, oz), (du, dv, dz) = origin, ray
    (au, av, az), (bu, bv, bz), (cu, cv, cz) = corners
    det = (bu - au) * (cv - av) - (cu - au) * (bv - av)
    zu = ((bz - az) * (cv - av) - (cz - az) * (bv - av)) / det
    zv = ((bu - au) * (cz - az) - (cu - au) * (bz - az)) / det
    near, far = Fraction(0), None
    for (pu, pv, _), (qu, qv, _) in zip(corners, corners[1:] + corners[:1], strict=True):
        nu, nv = (-(qv - pv), qu - pu) if det > 0 else (qv - pv, -(qu - pu))
        inside, rate = nu * (ou - pu) + nv * (ov - pv), nu * du + nv * dv
        if rate > 0:
            near = max(near, -inside / rate)
        elif rate < 0:
            far = -inside / rate if far is None else min(far, -inside / rate)
        elif inside < 0:
            return False
    return (
        far is not None
        and near <= far
        and any(
            s > 0 and az + zu * (ou + du * s - au) + zv * (ov + dv * s - av) > oz + dz * s
            for s in (near, far)
        )
    )


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
    (ou, ov, _), (du, dv, _) = origin, ray
    j = min(max(math.floor(ou + du * start), 0), cols - 2)
    i = min(max(math.floor(ov + dv * start), 0), rows - 2)
    t_u = ((j + (du > 0)) - ou) / du if du else math.inf
    t_v = ((i + (dv > 0)) - ov) / dv if dv else math.inf
    while 0 <= i <= rows - 2 and 0 <= j <= cols - 2:
        hits = [
            h
            for a in (-1, 0, 1)
            for b in (-1, 0, 1)
            for h in _cell_hits(z, i + a, j + b, origin, ray)
        ]
        hits = [h for h in hits if h > 1e-9]
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


def _cell_hits(z: Array, i: int, j: int, origin: tuple, ray: tuple) -> Iterator[float]:
    if not (0 <= i < z.shape[0] - 1 and 0 <= j < z.shape[1] - 1):
        return
    for a, b in ((i, j + 1), (i + 1, j)):
        corners = [(j, i, z[i, j]), (b, a, z[a, b]), (j + 1, i + 1, z[i + 1, j + 1])]
        if all(math.isfinite(c[2]) for c in corners):
            t = _moeller_trumbore(
                np.array(origin), np.array(ray), *np.array(corners, dtype=np.float64)
            )
            if t is not None:
                yield t


def _moeller_trumbore(origin: Array, ray: Array, v0: Array, v1: Array, v2: Array) -> float | None:
    e1, e2 = v1 - v0, v2 - v0
    g = np.cross(ray, e2)
    det = e1 @ g
    if abs(det) < 1e-14:
        return None
    s = origin - v0
    q = np.cross(s, e1)
    d1, d2 = (s @ g) / det, (ray @ q) / det
    slack = 1e-11  # the edges belong to both sides
    return float(e2 @ q / det) if d1 >= -slack and d2 >= -slack and d1 + d2 <= 1 + slack else None
