"""Which effects a render models, at what error, and why.

Effects are left out only where the result is provably the same: on a connected surface no point
rises above a ray that climbs more steeply than the steepest facet.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from .constants import ASTRONOMICAL_UNIT_M, SOLAR_RADIUS_RAD
from .heightfield import Heightfield, Window
from .terrain import Terrain
from .view import View

Array = NDArray[np.float64]

COARSE_NODES = 8
"""A support ring is looked for on nodes so many times coarser."""

COARSE_SLOPE = 0.35
"""Height that coarse nodes smooth away at most, in coarse cells: half of one at 35 deg."""

_BLOCK_ROWS = 512
_ROUNDING = (
    1e-6  # of a slope: a skipped ray clears the steepest facet by more than rounding can take
)


@dataclass(frozen=True)
class Decision:
    """What was decided about an effect; ``error_bound`` is None where nothing bounds it here."""

    effect: str
    modelled: bool
    reason: str
    error_bound: float | None
    unit: str


@dataclass(frozen=True)
class ScenePlan:
    """All decisions of a render."""

    cast_shadows: Decision
    occlusion: Decision
    others: tuple[Decision, ...] = ()

    @property
    def decisions(self) -> tuple[Decision, ...]:
        return (self.cast_shadows, self.occlusion, *self.others)

    def to_json(self) -> dict[str, list[dict[str, object]]]:
        """The document of ``lcp render --explain``."""
        return {"decisions": [asdict(decision) for decision in self.decisions]}

    def __str__(self) -> str:
        return json.dumps(self.to_json(), sort_keys=True)


@dataclass(frozen=True)
class Steepness:
    """Tangent of the steepest facet of a surface, and whether the surface is connected (no node
    lacks a height).
    """

    tangent: float
    connected: bool

    def clears(self, tangent: float) -> bool:
        """Whether rays that climb with a tangent can nowhere be met by the surface."""
        return self.connected and tangent > self.tangent * (1 + _ROUNDING)


def steepness(field: Heightfield) -> Steepness:
    """The steepest facet of all a heightfield's triangles; 0 where there are none."""
    z, steepest, connected = field.z_m, 0.0, True
    for first in range(0, max(z.shape[0] - 1, 1), _BLOCK_ROWS):
        block = z[first : first + _BLOCK_ROWS + 1].astype(np.float64)
        connected &= bool(np.isfinite(block).all())
        right, down = np.diff(block, axis=1), np.diff(block, axis=0)
        for facets in (right[:-1] ** 2 + down[:, 1:] ** 2, right[1:] ** 2 + down[:, :-1] ** 2):
            steepest = max(steepest, float(np.nanmax(facets, initial=0.0)))
    return Steepness(math.sqrt(steepest) / field.gsd_m, connected)


def nodes_enu(field: Heightfield, window: Window, step: int = 1) -> Array:
    """ENU positions (rows, cols, 3) of every ``step``-th node of a window; z is NaN without a
    height.
    """
    row0, row1, col0, col1 = window
    y, x = np.meshgrid(
        field.y0_m - np.arange(row0, row1, step) * field.gsd_m,
        field.x0_m + np.arange(col0, col1, step) * field.gsd_m,
        indexing="ij",
    )
    z = field.z_m[row0:row1:step, col0:col1:step].astype(np.float64)
    return np.stack([x, y, z], axis=-1)


def lowest_view_tangent(view: View, points_m: Array) -> float:
    """Tangent of the least elevation at which ENU points (..., 3) see the camera; inf without a
    point.
    """
    if view.direction is not None:
        return _tangent(view.direction)
    assert view.position_m is not None
    height = view.position_m[2] - points_m[..., 2]
    away = np.hypot(view.position_m[0] - points_m[..., 0], view.position_m[1] - points_m[..., 1])
    with np.errstate(divide="ignore"):
        tangents = np.where(away > 0, height / np.where(away > 0, away, 1.0), np.inf)
    known = tangents[np.isfinite(height)]
    return float(known.min()) if known.size else math.inf


def plan_scene(
    terrain: Terrain,
    sun: Array,
    view: View,
    in_camera_plane: bool = False,
    ring: Decision | None = None,
) -> ScenePlan:
    """Decide for a terrain, an ENU direction to the Sun and a view."""
    slope = steepness(terrain.field)
    others = (ring,) if ring is not None else ()
    return ScenePlan(
        cast_shadows=_shadow_decision(slope, sun),
        occlusion=_occlusion_decision(slope, view, terrain, in_camera_plane),
        others=(*others, *_constant_decisions(terrain)),
    )


def _shadow_decision(slope: Steepness, sun: Array) -> Decision:
    tangent = _tangent(sun)
    modelled = not slope.clears(tangent)
    reason = _comparison(slope, "the Sun's elevation", tangent, modelled)
    return Decision("cast shadows", modelled, reason, 0.0, "share of the Sun's disc")


def _occlusion_decision(
    slope: Steepness, view: View, terrain: Terrain, in_camera_plane: bool
) -> Decision:
    unit = "share of visible nodes"
    if in_camera_plane:
        reason = "every pixel's ray is traced to its first hit"
        return Decision("occlusion", True, reason, 0.0, unit)
    row0, row1, col0, col1 = terrain.core
    tangent = min(
        lowest_view_tangent(
            view, nodes_enu(terrain.field, (row, min(row + _BLOCK_ROWS, row1), col0, col1))
        )
        for row in range(row0, row1, _BLOCK_ROWS)
    )
    modelled = not slope.clears(tangent)
    reason = _comparison(slope, "the camera's least elevation", tangent, modelled)
    return Decision("occlusion", modelled, reason, 0.0, unit)


def _comparison(slope: Steepness, what: str, tangent: float, modelled: bool) -> str:
    steepest = f"{math.degrees(math.atan(slope.tangent)):.3f} deg"
    above = f"{what} of {math.degrees(math.atan(tangent)):.3f} deg"
    if not modelled:
        return f"the steepest facet, {steepest}, is below {above}: nothing can come between"
    if not slope.connected:
        return f"some nodes have no height, so that steps beside them are not known; {above}"
    return f"the steepest facet, {steepest}, reaches {above}; traced exactly"


def _constant_decisions(terrain: Terrain) -> tuple[Decision, ...]:
    row0, row1, col0, col1 = terrain.core
    half = 0.5 * terrain.field.gsd_m * math.hypot(row1 - row0, col1 - col0)
    parallax = math.degrees(half / ASTRONOMICAL_UNIT_M)
    return (
        Decision("curvature", True, "heights are ENU z of the area's frame", 0.0, "m"),
        Decision(
            "solar disc",
            False,
            "--sun point: a shadow's edge is sharp; the penumbra lies within the bound of it",
            round(math.degrees(SOLAR_RADIUS_RAD), 4),
            "deg of Sun elevation",
        ),
        Decision("parallax of the Sun", False, "one direction for the whole area", parallax, "deg"),
        Decision(
            "scattered light",
            False,
            "what the Sun does not reach is black",
            None,
            "radiance factor",
        ),
        Decision("albedo", False, "one albedo for the whole area", None, "radiance factor"),
    )


def ring_needed_m(coarse: Terrain, tangent: float, margin_m: float) -> float:
    """How far beyond the core terrain can rise above rays that climb with a tangent from the core,
    seen on coarse heights.

    ``margin_m`` is allowed for what the coarse heights smooth away, once above and once below.
    """
    z, (r0, r1, c0, c1) = coarse.field.z_m, coarse.core
    inside = z[r0:r1, c0:c1]
    if not np.isfinite(inside).any():
        return 0.0
    floor = float(np.nanmin(inside)) - margin_m
    row, col = np.ogrid[0 : z.shape[0], 0 : z.shape[1]]
    rows_off = np.maximum(np.maximum(r0 - row, row - r1 + 1), 0)
    cols_off = np.maximum(np.maximum(c0 - col, col - c1 + 1), 0)
    away = np.hypot(rows_off, cols_off) * coarse.field.gsd_m
    climb = np.maximum(away - coarse.field.gsd_m, 0.0) * tangent
    reach = (away > 0) & (z + margin_m - floor > climb)
    if not reach.any():
        return 0.0
    return float(np.maximum(rows_off, cols_off)[reach].max() + 1) * coarse.field.gsd_m


def ring_decision(terrain: Terrain, ring_m: float, needed_m: float) -> Decision:
    """What the support ring holds, and what it does not."""
    row0, row1, col0, col1 = terrain.core
    known = np.isfinite(terrain.field.z_m)
    inside = int(known[row0:row1, col0:col1].sum())
    around = known.size - (row1 - row0) * (col1 - col0)
    missing = 1.0 - (int(known.sum()) - inside) / around if around else 0.0
    reason = f"terrain up to {ring_m / 1e3:.1f} km beyond the area can shadow or hide it"
    if needed_m > ring_m:
        reason += f"; {needed_m / 1e3:.1f} km would be needed: capped"
    if missing > 0:
        reason += f"; {missing:.1%} of that ring has no height in the DEM and hides nothing"
    whole = needed_m <= ring_m and missing == 0
    return Decision(
        "terrain beyond the area", True, reason, 0.0 if whole else None, "share of nodes"
    )


def _tangent(direction: Array) -> float:
    level = math.hypot(direction[0], direction[1])
    return math.inf if level == 0 and direction[2] > 0 else float(direction[2]) / max(level, 1e-300)
