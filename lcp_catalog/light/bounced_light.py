"""Light that reaches ground by way of other ground: one bounce.

The radiance of a point P under the ground around it is a sum over directions: the ray from P in a
direction meets the ground at Q; the radiance factor F of Q under the sources, seen from P, times the
solid angle over pi is the irradiance of P from there, relative to the unit of the sources (radiance
= F E / pi). The reflectance model gives the light that P sends to the camera. Nothing is
interpolated: Q is the first hit on the surface, its light has the cast shadows of the sources.

The directions are strata of equal solid angle between the depression and the elevation of the
steepest facet, beyond which no ray from a connected surface meets it. There are no random numbers.

Left out: a second bounce, the light of a panorama's sky on Q, penumbrae at Q, and ground beyond the
field's own cells.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..accuracy import TIERS, Accuracy
from ..arrays import Array, Mask
from ..geometry.frames import direction_enu_rad
from ..photometry.laws import Reflectance, radiance_factor, radiance_under
from ..terrain.far_terrain import HorizonPoints
from ..terrain.heightfield import Heightfield
from ..terrain.terrain import Terrain
from .sources import Lighting, LightSource, SurfacePoints

BOUNCE_RMS = {"draft": 0.25, "standard": 0.15, "high": 0.06, "reference": 0.06}
"""Bound on the rms error of the directions, by tier, as a share of the mean bounced light; measured
on a crater against 16 384 directions."""

_CODE = 1.0 / 255.0
SHOWS = {"draft": 0.02, "standard": 0.02, "high": _CODE, "reference": _CODE}
"""Share of the brightest ground from which on bounced light shows, by tier: one code of an 8-bit image that is exposed for that
ground; in the fast tiers, whose laws err by more, above what craters give (0.35 to 1.06 %)."""

Brightness = Callable[[Array], Array]
"""Albedo factors (n,) of surface points (n, 3)."""

_RAYS = 1 << 20
_GOLDEN = 0.6180339887498949
_SAMPLED = 24  # nodes per side of a sample
_WHITE_PERCENTILE = 99.5


@dataclass(frozen=True)
class BouncedSample:
    """Bounced light on a sample of an area's nodes: number of nodes that the first source does not
    reach, greatest and mean radiance factor that bounced light gives them, and the radiance factor
    of the brightest ground.
    """

    nodes: int
    greatest: float
    mean: float
    white: float


def bounced_at_points(
    terrain: Terrain,
    light: Lighting,
    at: SurfacePoints,
    model: Reflectance,
    accuracy: Accuracy,
    brightness: Brightness | None = None,
) -> Array:
    """Radiance (n,) that one bounce gives n points of the surface. ``brightness``: albedo of the ground
    that reflects; that of the points themselves is not applied.
    """
    total = np.zeros(len(at))
    directions, solid_sr = _directions(terrain.field, accuracy)
    step = max(1, _RAYS // len(directions))
    for first in range(0, len(at), step):
        part = slice(first, first + step)
        found = _gathered(terrain, light, at.some(part), directions, model, brightness)
        total[part] = (solid_sr / math.pi) * found
    return total


def bounced_sample(
    terrain: Terrain, light: Lighting, towards: Array, model: Reflectance
) -> BouncedSample:
    """Bounced light on a grid of the core's nodes that the first source does not reach, seen in a
    direction (3,) that every node is taken to face.
    """
    row0, row1, col0, col1 = terrain.core
    rows, cols = (
        np.unique(np.linspace(first, last - 1, _SAMPLED).round().astype(np.int64))
        for first, last in ((row0, row1), (col0, col1))
    )
    field = terrain.field
    x, y = np.meshgrid(field.x0_m + cols * field.gsd_m, field.y0_m - rows * field.gsd_m)
    points = np.stack([x, y, field.z_m[np.ix_(rows, cols)].astype(np.float64)], -1).reshape(-1, 3)
    normals = field.normals_at(points[:, 0], points[:, 1])
    known = np.isfinite(normals).all(axis=-1)
    at = SurfacePoints(points[known], normals[known], towards)
    direct = _direct(terrain, light, at, model, None)
    lit = _reached(terrain, light.first, at)
    white = float(np.percentile(direct[lit], _WHITE_PERCENTILE)) if lit.any() else 0.0
    found = bounced_at_points(terrain, light, at.some(~lit), model, TIERS["draft"])
    if not found.size:
        return BouncedSample(0, 0.0, 0.0, white)
    return BouncedSample(found.size, float(found.max()), float(found.mean()), white)


def bounced_bound(field: Heightfield, model: Reflectance) -> float:
    """Upper bound of the radiance factor from one bounce, under light of irradiance 1: R^2 Omega / pi,
    R the model's greatest radiance factor (over a grid of angles), Omega the solid angle that terrain
    can fill above a facet.

    With facets up to s steep, terrain rises at most s above the horizontal, and the plane of a facet
    falls at most s below it: Omega <= 2 pi sin(2 s). 2 pi if the surface is not connected.
    """
    lift = 2.0 * math.atan(field.steepest_tangent)
    filled = 1.0 if field.has_holes or lift > math.pi / 2.0 else math.sin(lift)
    angles = np.radians(np.linspace(0.0, 89.5, 60))
    incidence, emission = np.meshgrid(angles, angles)
    least = radiance_factor(model, incidence, emission, np.abs(incidence - emission))
    across = radiance_factor(model, incidence, emission, incidence + emission)
    return 2.0 * float(max(least.max(), across.max())) ** 2 * filled


def _directions(field: Heightfield, accuracy: Accuracy) -> tuple[Array, float]:
    """Unit directions (n, 3) of one solid angle, and that."""
    azimuths, elevations = min(accuracy.sky_directions, TIERS["high"].sky_directions)
    steepest = math.pi / 2.0 if field.has_holes else math.atan(field.steepest_tangent)
    reach = math.sin(steepest)
    turn, rise = np.meshgrid(np.arange(azimuths), np.arange(elevations))
    shift = (turn * _GOLDEN) % 1.0  # another elevation at every azimuth
    sine = reach * (2.0 * (rise + shift) / elevations - 1.0)
    azimuth = 2.0 * math.pi * (turn + 0.5) / azimuths
    directions = direction_enu_rad(azimuth.ravel(), np.arcsin(sine).ravel())
    return directions, 4.0 * math.pi * reach / len(directions)


def _gathered(
    terrain: Terrain,
    light: Lighting,
    at: SurfacePoints,
    directions: Array,
    model: Reflectance,
    brightness: Brightness | None,
) -> Array:
    """Sum over the directions of the radiance of points, (n,), by the ground there, times pi over the
    solid angle of a direction.
    """
    cosines = at.normals @ directions.T
    point, k = np.nonzero(cosines > 0.0)
    hits = terrain.field.meetings(at.points_m[point], directions[k])
    met = np.isfinite(hits[:, 2])
    point, k, hits = point[met], k[met], hits[met]
    faces = terrain.field.normals_at(hits[:, 0], hits[:, 1])
    back = -directions[k]
    met = np.sum(faces * back, axis=-1) > 0.0  # False without a normal
    point, k, hits, faces, back = point[met], k[met], hits[met], faces[met], back[met]
    arriving = _direct(terrain, light, SurfacePoints(hits, faces, back), model, brightness)
    lit = arriving > 0.0
    point, k, arriving = point[lit], k[lit], arriving[lit]
    emission = np.sum(at.normals * at.towards, axis=-1)[point]
    phase = np.sum(directions[k] * at.towards[point], axis=-1)
    i, e, g = (
        np.arccos(np.clip(cosine, -1.0, 1.0)) for cosine in (cosines[point, k], emission, phase)
    )
    factors = radiance_factor(model, i, e, g)
    return np.asarray(np.bincount(point, arriving * factors, len(at)), dtype=np.float64)


def _direct(
    terrain: Terrain,
    light: Lighting,
    at: SurfacePoints,
    model: Reflectance,
    brightness: Brightness | None,
) -> Array:
    """Radiance factor (n,) of points under the sources."""
    total = np.zeros(len(at))
    for source in light.sources:
        if source.irradiance > 0.0:
            lit, sun = _reached(terrain, source, at), source.direction.vector
            total += source.irradiance * radiance_under(at.normals, sun, at.towards, lit, model)
    return total if brightness is None else total * brightness(at.points_m)


def _reached(terrain: Terrain, source: LightSource, at: SurfacePoints) -> Mask:
    """True for points that a source's centre reaches, (n,)."""
    sun = source.direction.vector
    lit = at.normals @ sun > 0.0
    lit[lit] = ~HorizonPoints(terrain.field, at.points_m[lit], terrain.far).occluded(sun)
    return np.asarray(lit)
