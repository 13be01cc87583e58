"""Light of an environment map's remainder (the sky) on terrain, by samples of equal power.

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
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..accuracy import TIERS, Accuracy
from ..arrays import Array
from ..cameras.view import CameraView, View
from ..geometry.frames import direction_enu_rad
from ..kernels.photometry import sky as kernel
from ..photometry.laws import Reflectance, planes_of
from ..terrain.far_terrain import HorizonPoints
from ..terrain.heightfield import Window
from ..terrain.occlusion import occluded_sweep
from ..terrain.relief_bounds import nodes_enu
from ..terrain.terrain import Terrain
from .environment_map import Panorama
from .sources import SurfacePoints

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
) -> NDArray[np.float32]:
    """Radiance (rows, cols) of the core's nodes under the sky alone, for nodes that face the view;
    NaN without a normal.
    """
    row0, row1, col0, col1 = terrain.core
    out = np.zeros((row1 - row0, col1 - col0), dtype=np.float32)
    samples = samples_of(panorama, accuracy)
    step = max(1, _BLOCK_NODES // max(1, col1 - col0))
    for row in range(row0, row1, step):
        window = (row, min(row + step, row1), col0, col1)
        block = out[row - row0 : window[1] - row0]
        lights = _over_nodes(terrain, samples, window, TIERS[accuracy.sky_tier])
        normals, light = terrain.field.normals(window), samples.irradiance
        if not isinstance(view, CameraView) and not accuracy.float64:
            planes, camera = planes_of(normals), np.asarray(view.direction, dtype=np.float64)
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
    if accuracy.sky_tier == "draft":
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
        for n, direction in enumerate(directions):
            dark[n] = points.occluded(direction)
        kernel.add_to_nodes(
            normals, towards, directions, dark, samples.irradiance, code, numbers, total
        )
    return total


def _cameras(view: View, points_m: Array) -> Array:
    """Directions to the camera: one for all (1, 3), or one for each point (n, 3)."""
    towards = view.directions(points_m) if isinstance(view, CameraView) else view.direction
    return np.ascontiguousarray(towards, dtype=np.float64).reshape(-1, 3)


def _over_nodes(
    terrain: Terrain, samples: SkySamples, window: Window, hiding: Accuracy
) -> Iterator[tuple[Array, NDArray[np.uint8]]]:
    """For each azimuth: directions (e, 3), and a mask (e, rows, cols) of the nodes of the window
    from which terrain hides them, by the tier ``hiding``.
    """
    for k, azimuth in enumerate(samples.azimuths):
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
