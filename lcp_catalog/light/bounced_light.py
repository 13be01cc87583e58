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

Light of an environment map's remainder (the sky) on terrain, by samples of equal power.

Stratified importance sampling: azimuth is divided into strata of equal power, and each stratum is
represented by the azimuth of its median power. The elevations of a stratum follow its own
distribution of power, with an offset that differs between strata (van der Corput sequence), so that
no two strata have the same elevations. Every sample has the same irradiance: the power over the
number of samples. All elevations of an azimuth share one pass over the terrain
(`terrain.occlusion.occluded_sweep`). There are no random numbers: the same panorama gives the same
bits.

The part of the panorama below the horizontal plane is an image of terrain and lights nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS, Accuracy
from ..arrays import Array, Mask
from ..cameras.view import CameraView, View
from ..geometry.frames import direction_enu_rad
from ..kernels.photometry import sky as kernel
from ..photometry.laws import Reflectance, radiance_factor, radiance_under
from ..terrain.far_terrain import HorizonPoints
from ..terrain.heightfield import Heightfield, Window
from ..terrain.occlusion import occluded_sweep
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .environment_map import Panorama
from .sources import Lighting, LightSource, SurfacePoints

BETWEEN_NODES_RMS = 0.009
"""Additional rms error of draft and standard in a camera's plane, as a share of the mean radiance:
the visible sky is interpolated between the nodes of a triangle."""

SKY_FLOOR_RAD = math.radians(1.0)
"""Terrain beyond the area's own cells that stays below this elevation is ignored: a uniform sky
sends sin^2 = 0.03 % of its light to a plane from below it."""

_BLOCK_NODES = 1 << 22


def sky_rms(accuracy: Accuracy, in_camera_plane: bool = False) -> float:
    """Bound on the rms error of the samples, in a camera's plane with that of the interpolation
    between nodes.
    """
    between = in_camera_plane and accuracy.sky_tier == "draft"
    return math.hypot(accuracy.sky_rms, BETWEEN_NODES_RMS if between else 0.0)


@dataclass(frozen=True, eq=False)
class SkySamples:
    """Directions that represent a sky: azimuths (a,) and elevations (a, e), radians; ``irradiance``
    of each on a surface perpendicular to it.
    """

    azimuths: Array
    elevations: Array
    irradiance: float

    def __len__(self) -> int:
        return self.elevations.size

    def directions(self, azimuth: int) -> Array:
        """Unit ENU vectors (e, 3) of the samples at one azimuth."""
        return direction_enu_rad(self.azimuths[azimuth], self.elevations[azimuth])


def samples_of(panorama: Panorama, accuracy: Accuracy) -> SkySamples:
    """Samples in the number of an accuracy tier."""
    return sky_samples(panorama, *accuracy.sky_directions)


def sky_samples(panorama: Panorama, azimuths: int, elevations: int) -> SkySamples:
    """Samples of equal power above the horizontal plane; empty for a black sky."""
    power = panorama.luminance * (panorama.solid_angles * panorama.above)[:, None]
    total = float(power.sum())
    if not total > 0.0:
        return SkySamples(np.zeros(0), np.zeros((0, elevations)), 0.0)
    columns = np.append(0.0, np.cumsum(power.sum(axis=0)))
    cuts = _places(columns, np.arange(azimuths + 1) / azimuths)
    middles = _places(columns, (np.arange(azimuths) + 0.5) / azimuths)
    inside = np.zeros((azimuths, panorama.rows))
    for k in range(azimuths):
        inside[k] = _between(power, cuts[k], cuts[k + 1])
    rise = np.empty((azimuths, elevations))
    for k in range(azimuths):
        offset = _van_der_corput(k) + 0.5 / azimuths
        shares = (np.arange(elevations) + offset) / elevations
        rows = _places(np.append(0.0, np.cumsum(inside[k])), shares)
        rise[k] = _elevation(panorama, rows)
    irradiance = total / (azimuths * elevations)
    return SkySamples(panorama.column_azimuth(middles), rise, irradiance)


def sky_at_nodes(
    terrain: Terrain,
    panorama: Panorama,
    view: View,
    model: Reflectance,
    accuracy: Accuracy,
    shadows: bool = True,
) -> NDArray[np.float32]:
    """Radiance (rows, cols) of the core's nodes under the sky alone, for nodes that face the view;
    NaN without a normal. ``shadows=False``: terrain hides no part of the sky.
    """
    row0, row1, col0, col1 = terrain.core
    out = np.zeros((row1 - row0, col1 - col0), dtype=np.float32)
    samples = samples_of(panorama, accuracy)
    hiding = TIERS[accuracy.sky_tier] if shadows else None
    step = max(1, _BLOCK_NODES // max(1, col1 - col0))
    for row in range(row0, row1, step):
        window = (row, min(row + step, row1), col0, col1)
        block = out[row - row0 : window[1] - row0]
        lights = _over_nodes(terrain, samples, window, hiding)
        normals, light = terrain.field.normals(window), samples.irradiance
        if not isinstance(view, CameraView) and not accuracy.float64:
            planes, camera = _planes(normals), np.asarray(view.direction, dtype=np.float64)
            for directions, dark in lights:
                kernel.add_to_planes(
                    planes, camera, directions, dark, light, model.code, model.numbers, block
                )
            block[np.isnan(planes[0])] = np.nan
            continue
        cameras = _cameras(view, nodes_enu(terrain.field, window))
        total, flat = np.zeros(block.size), normals.reshape(-1, 3)
        for directions, dark in lights:
            hidden = dark.reshape(len(dark), -1)
            kernel.add_to_nodes(
                flat, cameras, directions, hidden, light, model.code, model.numbers, total
            )
        block[...] = total.reshape(block.shape)
    return out


def sky_at_points(
    terrain: Terrain,
    panorama: Panorama,
    at: SurfacePoints,
    model: Reflectance,
    accuracy: Accuracy,
    shadows: bool = True,
) -> Array:
    """Radiance (n,) at n points of the surface, each seen in its own direction. In draft and standard,
    the visible sky is interpolated between the surrounding nodes; otherwise it is traced from each
    point.
    """
    total = np.zeros(len(at))
    if not len(at):
        return total
    samples, points_m = samples_of(panorama, accuracy), at.points_m
    code, numbers = model.code, model.numbers
    normals, towards = np.ascontiguousarray(at.normals), np.ascontiguousarray(at.towards)
    if shadows and accuracy.sky_tier == "draft":
        field = terrain.field
        u = (points_m[:, 0] - field.x0_m) / field.gsd_m
        v = (field.y0_m - points_m[:, 1]) / field.gsd_m
        window = (*_span(v, field.shape[0]), *_span(u, field.shape[1]))
        u, v = u - window[2], v - window[0]
        for directions, dark in _over_nodes(terrain, samples, window, TIERS["draft"]):
            kernel.add_to_points(
                u, v, normals, towards, directions, dark, samples.irradiance, code, numbers, total
            )
        return total
    points = HorizonPoints(terrain.field, points_m, terrain.far)
    for k in range(len(samples.azimuths)):
        directions = samples.directions(k)
        dark = np.zeros((len(directions), len(points)), dtype=np.uint8)
        for n, direction in enumerate(directions if shadows else ()):
            dark[n] = points.occluded(direction)
        kernel.add_to_nodes(
            normals, towards, directions, dark, samples.irradiance, code, numbers, total
        )
    return total


def _planes(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Components of normals (rows, cols, 3) as one raster each."""
    return np.ascontiguousarray(np.moveaxis(normals, -1, 0))


def _cameras(view: View, points_m: Array) -> Array:
    """Directions to the camera: one for all (1, 3), or one for each point (n, 3)."""
    towards = view.directions(points_m) if isinstance(view, CameraView) else view.direction
    return np.ascontiguousarray(towards, dtype=np.float64).reshape(-1, 3)


def _over_nodes(
    terrain: Terrain, samples: SkySamples, window: Window, hiding: Accuracy | None
) -> Iterator[tuple[Array, NDArray[np.uint8]]]:
    """For each azimuth: directions (e, 3), and a mask (e, rows, cols) of the nodes of the window
    from which terrain hides them; without ``hiding`` nothing is hidden.
    """
    row0, row1, col0, col1 = window
    nothing = np.zeros((samples.elevations.shape[1], row1 - row0, col1 - col0), dtype=np.uint8)
    for k, azimuth in enumerate(samples.azimuths):
        dark = nothing
        if hiding is not None:
            rise = samples.elevations[k]
            dark = occluded_sweep(terrain.field, float(azimuth), rise, hiding, window, terrain.far)
        yield samples.directions(k), np.ascontiguousarray(dark)


def _span(places: Array, count: int) -> tuple[int, int]:
    """First node, and the node after the last, of the cells that hold some positions."""
    first = min(max(math.floor(float(places.min())), 0), count - 2)
    return first, min(max(math.floor(float(places.max())) + 2, first + 2), count)


def _places(sums: Array, shares: Array) -> Array:
    """Positions where running sums (n + 1,), linear between their steps, reach shares of the last
    one.
    """
    goals = shares * sums[-1]
    step = np.clip(np.searchsorted(sums, goals, side="right") - 1, 0, sums.size - 2)
    size = sums[step + 1] - sums[step]
    into = np.divide(goals - sums[step], size, out=np.zeros_like(goals), where=size > 0.0)
    return np.asarray(step + np.clip(into, 0.0, 1.0))


def _between(power: Array, left: float, right: float) -> Array:
    """Power of each row between two positions in columns, (rows,)."""
    first, last = math.floor(left), min(math.floor(right), power.shape[1] - 1)
    if first == last:
        return np.asarray(power[:, first] * (right - left))
    whole = power[:, first + 1 : last].sum(axis=1)
    ends = power[:, first] * (first + 1 - left) + power[:, last] * (right - last)
    return np.asarray(whole + ends)


def _elevation(panorama: Panorama, rows: Array) -> Array:
    """Elevations (radians) at positions in rows from the zenith, by solid angle within a row; only
    the part of a row above the horizontal plane counts.
    """
    row = np.minimum(rows.astype(np.int64), panorama.rows - 1)
    upper = np.sin(panorama.elevations[row] + 0.5 * panorama.pixel_rad)
    lower = np.maximum(np.sin(panorama.elevations[row] - 0.5 * panorama.pixel_rad), 0.0)
    return np.asarray(np.arcsin(np.clip(upper - (rows - row) * (upper - lower), 0.0, 1.0)))


def _van_der_corput(number: int) -> float:
    """Van der Corput sequence: the binary digits of a number, mirrored at the point."""
    out, digit = 0.0, 0.5
    while number:
        out += digit * (number & 1)
        number, digit = number >> 1, 0.5 * digit
    return out


BOUNCE_RMS = {"draft": 0.25, "standard": 0.15, "high": 0.06, "reference": 0.06}
"""Bound on the rms error of the directions, by tier, as a share of the mean bounced light; measured
on a crater against 16 384 directions."""

SHOWS = 1.0 / 255.0
"""Bounced light shows from this share of the brightest ground on: one code of an 8-bit image that is
exposed for that ground."""

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

    @property
    def shows(self) -> bool:
        """True if the greatest exceeds `SHOWS` of the brightest ground."""
        return self.greatest > SHOWS * self.white


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
