"""A rational judge of rays over extreme terrain, and the terrains themselves.

Everything is a fraction: float32 heights, positions and directions are taken as the numbers that
they are, so that a ray along a grid line, through a node or level with the ground is decided, not
rounded. Like `twins` it clips the ray with every facet and knows no traversal. Rays live in cell
units (u = column, v = row, z in metres); nothing here is fast: keep terrains below 50 nodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Ray = tuple[Fraction, Fraction, Fraction]
Stretch = tuple[Fraction, Fraction | None, Fraction, Fraction | None]
"""Where a ray is over a facet: from s, to s, and its height above the facet there."""

KILOMETRES_20 = 20_000.0


def exact(values) -> Ray:
    """Three floats as the fractions that they are."""
    return tuple(Fraction(float(v)) for v in values)


def stretches(z: NDArray, origin: Ray, ray: Ray) -> Iterator[Stretch]:
    """The stretches s >= 0 of a ray over each existing facet; for a vertical ray the one point,
    as (0, None, height above the facet, None).
    """
    (ou, ov, oz), (du, dv, dz) = origin, ray
    for i, j, upper, corner, zu, zv in _planes(z.tobytes(), z.shape):
        x, y = ou - j, ov - i
        across = x - y, du - dv
        sides = (
            ((1 - x, -du), (y, dv), across) if upper else ((x, du), (1 - y, -dv), (y - x, dv - du))
        )
        near, far, outside = Fraction(0), None, False
        for inside, rate in sides:
            if rate > 0:
                if inside < 0:
                    near = max(near, -inside / rate)
            elif inside < 0:
                outside = True
                break
            elif rate < 0:
                far = -inside / rate if far is None else min(far, -inside / rate)
        if outside or (far is not None and near > far):
            continue
        rise, above = dz - zu * du - zv * dv, oz - corner - zu * x - zv * y
        yield near, far, above + rise * near, None if far is None else above + rise * far


@lru_cache
def _planes(heights: bytes, shape: tuple[int, int]) -> list[tuple[Any, ...]]:
    """Every facet's place, half, height at its north-west corner and slopes along u and v."""
    z = np.frombuffer(heights, dtype=np.float32).reshape(shape)
    planes = []
    for i, j, upper in facets(z):
        corner, other, last = (Fraction(float(z[n])) for n in corners(i, j, upper))
        slopes = (other - corner, last - other) if upper else (last - other, other - corner)
        planes.append((i, j, upper, corner, *slopes))
    return planes


def corners(i: int, j: int, upper: bool) -> tuple[tuple[int, int], ...]:
    """The nodes of a facet: north-west, then the one off the diagonal, then south-east."""
    return (i, j), (i, j + 1) if upper else (i + 1, j), (i + 1, j + 1)


def facets(z: NDArray) -> Iterator[tuple[int, int, bool]]:
    for i in range(z.shape[0] - 1):
        for j in range(z.shape[1] - 1):
            for upper in (True, False):
                if all(math.isfinite(z[n]) for n in corners(i, j, upper)):
                    yield i, j, upper


def blocked(z: NDArray, origin: Ray, ray: Ray, end: Fraction | None = None) -> bool:
    """Whether a facet lies strictly above the ray somewhere in 0 < s <= end."""
    for near, far, gap_near, gap_far in stretches(z, origin, ray):
        if far is None:
            if ray[2] < 0:  # straight down: through the ground that it stands on
                return True
            continue
        if end is not None and near > end:
            continue
        last, gap_last = far, gap_far
        if end is not None and far > end:
            last = end
            gap_last = gap_near + (gap_far - gap_near) * (end - near) / (far - near)
        if (near > 0 and gap_near < 0) or (last > 0 and gap_last < 0):
            return True
    return False


def first_hit(z: NDArray, origin: Ray, ray: Ray) -> float:
    """Where a ray first comes under the surface, NaN for never, and NaN where it does so from the
    side (under a border, through a hole, from below).
    """
    best: tuple[Fraction, int] | None = None
    for near, far, gap_near, gap_far in stretches(z, origin, ray):
        if far is None:
            s = gap_near / -ray[2] if ray[2] < 0 and gap_near >= 0 else None
            if s is not None:
                best = min(best or (s, 0), (s, 0))
        elif gap_near < 0:
            best = min(best or (near, 1), (near, 1))
        elif gap_far < 0:
            s = near + (far - near) * gap_near / (gap_near - gap_far)
            best = min(best or (s, 0), (s, 0))
    return math.nan if best is None or best[1] else float(best[0])


def judged(z: NDArray, ray: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Which nodes' parallel rays are blocked; nodata is not."""
    return _settled(z, lambda starts: np.broadcast_to(ray, starts.shape), exact(ray), None)


def judged_from(z: NDArray, camera: tuple[float, float, float]) -> NDArray[np.bool_]:
    """Which nodes' segments to a camera are blocked."""
    return _settled(z, lambda starts: np.array(camera) - starts, None, exact(camera))


def margins_from(z: NDArray, camera: tuple[float, float, float]) -> NDArray:
    """By how much facets rise above each node's segment to a camera, float64; NaN at nodata."""
    i, j = np.nonzero(np.isfinite(z))
    starts = np.stack([j, i, z[i, j].astype(np.float64)], axis=-1)
    out = np.full(z.shape, np.nan)
    out[i, j] = _margins(z, starts, np.array(camera) - starts, 1.0)
    return out


def _settled(
    z: NDArray, rays: Callable[[NDArray], NDArray], ray: Ray | None, camera: Ray | None
) -> NDArray[np.bool_]:
    """Floats where they are sure, fractions for the others."""
    i, j = np.nonzero(np.isfinite(z))
    starts = np.stack([j, i, z[i, j].astype(np.float64)], axis=-1)
    directions = rays(starts)
    margins = _margins(z, starts, directions, math.inf if camera is None else 1.0)
    doubtful = np.abs(margins) <= (1e-9 if camera is None else 1e-5)
    doubtful |= (directions[:, :2] == 0).all(axis=1)
    answer, sure = np.zeros(z.shape, dtype=bool), margins > 0
    for k in np.flatnonzero(doubtful):
        start = exact(starts[k])
        if camera is None:
            sure[k] = blocked(z, start, ray)
        else:
            towards = tuple(c - o for c, o in zip(camera, start, strict=True))
            sure[k] = blocked(z, start, towards, Fraction(1))
    answer[i, j] = sure
    return answer


def _margins(z: NDArray, starts: NDArray, rays: NDArray, end: float) -> NDArray:
    """By how much facets rise above each ray at most, over 0 < s <= end, in float64; (n,)."""
    planes = [[float(v) for v in plane] for plane in _planes(z.tobytes(), z.shape)]
    if not planes:
        return np.full(len(starts), -math.inf)
    i, j, upper, corner, zu, zv = np.array(planes).T
    (ou, ov, oz), (du, dv, dz) = starts.T[:, :, None], rays.T[:, :, None]
    x, y = ou - j, ov - i
    turn = np.where(upper > 0, 1.0, -1.0)
    first = np.where(upper > 0, 1 - x, x), np.where(upper > 0, -du, du)
    second = np.where(upper > 0, y, 1 - y), np.where(upper > 0, dv, -dv)
    near, far = np.zeros(x.shape), np.full(x.shape, end)
    with np.errstate(divide="ignore", invalid="ignore"):
        for inside, rate in (first, second, (turn * (x - y), turn * (du - dv))):
            s = -inside / rate
            near = np.where(rate > 0, np.fmax(near, s), near)
            far = np.where(rate < 0, np.fmin(far, s), far)
            far = np.where((rate == 0) & (inside < 0), -1.0, far)
        rises = [
            np.where(
                (near <= far) & (s > 0),
                corner + zu * (x + du * s) + zv * (y + dv * s) - oz - dz * s,
                -np.inf,
            )
            for s in (near, far)
        ]
    return np.max(rises, axis=(0, 2))


def terrains() -> dict[str, NDArray[np.float32]]:
    """Small terrains at their extremes, by name; heights are whole numbers."""
    i, j = np.mgrid[:5, :6]
    high = KILOMETRES_20
    spike, corner, ridge = np.zeros((3, 5, 6))
    spike[2, 3] = corner[0, 0] = high
    ridge[i == j] = high
    whole = np.random.default_rng(7).integers(-3, 4, (5, 6))
    holes, islands = whole * 1.0, np.full((7, 7), np.nan)
    holes[1:3, 2:4] = np.nan
    islands[:2, :3], islands[4:6, 4:6], islands[4:, 0], islands[2, 5] = 5, high, -high, 7
    infinite = whole * 1.0
    infinite[1, 1], infinite[3, 4] = np.inf, -np.inf
    made = {
        "level": np.zeros((5, 6)),
        "20 km up": np.full((5, 6), high),
        "20 km down": np.full((5, 6), -high),
        "plane": 3.0 * j - 2.0 * i,
        "cliff to the east": np.where(j > 2, high, -high),
        "cliff to the south": np.where(i > 2, high, -high),
        "cliff on the diagonal": np.where(j > i, high, -high),
        "chequered": np.where((i + j) % 2, high, -high),
        "ridge on the diagonal": ridge,
        "spike": spike,
        "pit": -spike,
        "spike in the corner": corner,
        "whole numbers": whole,
        "holes": holes,
        "islands": islands,
        "infinite": infinite,
        "nothing": np.full((5, 6), np.nan),
        "one facet": np.array([[1.0, 2.0], [np.nan, 4.0]]),
        "2 x 2 ridge": np.array([[9.0, 0.0], [0.0, 9.0]]),
        "2 x 2 valley": np.array([[0.0, 9.0], [9.0, 0.0]]),
        "1 x 1": np.array([[3.0]]),
        "1 x 6": whole[:1],
        "5 x 1": whole[:, :1],
    }
    return {name: np.asarray(z, dtype=np.float32) for name, z in made.items()}
