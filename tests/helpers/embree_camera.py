"""Photographs that no code of ours took: a DEM's own nodes as triangles in MCMF, a pinhole written from the
contract alone, light and shadow by Embree.

Nothing here uses the library. Of the contract it takes CAMERA.json: camera axes right, down, ahead; column = cx + f x / z,
row = cy + f y / z; pixel centres at whole numbers. Places and triangles are `embree_mesh`'s. A pixel is a mean over
random places in it, each moved by a random Gaussian where the image is blurred: no grid of rays, no kernel. Ground reflects
after Lommel and Seeliger, cos i / (cos i + cos e), with the means of its triangles' normals at the nodes, interpolated
within a triangle.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("embreex", reason="Embree has wheels for Linux and Windows on x86-64 only")

from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from lcp_catalog.arrays import Array

from .embree_mesh import Nodes, enu_axes, mcmf, read_nodes, triangles

SUN_M = 1.496e11
LIFT_M = 0.5
"""A ray to the Sun starts so far above the mesh, along its normal; float32 places within 400 km are good to 0.02 m."""
RAYS_AT_ONCE = 400_000


@dataclass(frozen=True, eq=False)
class Pinhole:
    """A camera without distortion; rows of ``axes`` are right, down and ahead in MCMF."""

    position_m: Array
    axes: Array
    focal_px: float
    principal_px: tuple[float, float]  # column, row
    size_px: tuple[int, int]  # width, height

    @classmethod
    def looking(
        cls,
        target_m: Array,
        position_m: Array,
        roll_deg: float,
        fov_deg: float,
        size_px: tuple[int, int],
    ) -> Pinhole:
        """With a target in its middle, ``fov_deg`` wide; rolled about its axis, clockwise as the camera looks, from north
        up (of the target's meridian) in the image.
        """
        ahead = target_m - position_m
        ahead /= np.linalg.norm(ahead)
        down = np.cross(ahead, np.cross(ahead, [0.0, 0.0, 1.0]))  # away from the north pole
        down *= -np.sign(down @ [0.0, 0.0, 1.0]) / np.linalg.norm(down)
        right = np.cross(down, ahead)
        cos, sin = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
        axes = np.stack([cos * right + sin * down, cos * down - sin * right, ahead])
        focal = 0.5 * size_px[0] / np.tan(np.radians(fov_deg) / 2.0)
        return cls(position_m, axes, focal, ((size_px[0] - 1) / 2, (size_px[1] - 1) / 2), size_px)

    def directions(self, column: Array, row: Array) -> Array:
        """Unit MCMF directions (..., 3)."""
        x = (column - self.principal_px[0]) / self.focal_px
        y = (row - self.principal_px[1]) / self.focal_px
        right, down, ahead = self.axes
        looks = x[..., None] * right + y[..., None] * down + ahead
        return looks / np.linalg.norm(looks, axis=-1, keepdims=True)

    def pixels(self, points_m: Array) -> Array:
        """Columns and rows (..., 2) of MCMF points (..., 3)."""
        away = points_m - self.position_m
        x, y, z = (away @ axis for axis in self.axes)
        return np.stack(
            [
                self.principal_px[0] + self.focal_px * x / z,
                self.principal_px[1] + self.focal_px * y / z,
            ],
            axis=-1,
        )

    def document(self, sun_m: Array) -> dict[str, Any]:
        """CAMERA.json."""
        return {
            "position_mcmf_m": self.position_m.tolist(),
            "rotation_mcmf_to_camera": self.axes.tolist(),
            "focal_length_px": self.focal_px,
            "principal_point_px": list(self.principal_px),
            "image_size_px": list(self.size_px),
            "sun_position_mcmf_m": sun_m.tolist(),
        }

    def write(self, path: Path, sun_m: Array) -> Path:
        path.write_text(json.dumps(self.document(sun_m)), encoding="utf-8")
        return path


def above(
    lon_deg: float, lat_deg: float, off_nadir_deg: float, azimuth_deg: float, range_m: float
) -> Array:
    """The place from which a target on the sphere is seen, so far from the vertical there, from an azimuth."""
    up, azimuth = np.radians(90.0 - off_nadir_deg), np.radians(azimuth_deg)
    enu = [np.cos(up) * np.sin(azimuth), np.cos(up) * np.cos(azimuth), np.sin(up)]
    return mcmf(lon_deg, lat_deg) + range_m * (np.array(enu) @ enu_axes(lon_deg, lat_deg))


def sun_position(lon_deg: float, lat_deg: float, azimuth_deg: float, elevation_deg: float) -> Array:
    """Where the Sun stands, seen at these angles from a place."""
    return above(lon_deg, lat_deg, 90.0 - elevation_deg, azimuth_deg, SUN_M)


class Ground:
    """A DEM's surface around a place, with normals at its nodes; axes are MCMF's, the origin the place.

    ``brightness`` (rows, cols): factor of the light that each node reflects, interpolated within a triangle.
    """

    def __init__(self, nodes: Nodes, origin_m: Array, brightness: Array | None = None) -> None:
        self.brightness = None if brightness is None else np.append(brightness.ravel(), 1.0)
        corners, top = triangles(nodes)
        places = mcmf(nodes.lon_deg, nodes.lat_deg, nodes.height_m).reshape(-1, 3)
        pole = mcmf(0.0, 90.0 * (nodes.pole or 1), np.nan_to_num(top))
        self.origin_m, self.corners = origin_m, corners
        self.points_m = np.nan_to_num(np.append(places, pole[None], axis=0) - origin_m)
        self.normals = self._normals()
        self.scene = EmbreeScene(robust=True)
        TriangleMesh(self.scene, self.points_m.astype(np.float32), corners)

    @classmethod
    def of(cls, path: Path, lon_deg: float, lat_deg: float, reach_m: float) -> Ground:
        """The DEM within ``reach_m`` of a place."""
        return cls(read_nodes(path, lon_deg, lat_deg, reach_m), mcmf(lon_deg, lat_deg))

    def _normals(self) -> Array:
        """Of the nodes, outwards: the sum of their triangles' normals, each as long as the triangle is wide."""
        a, b, c = (self.points_m[self.corners[:, i]] for i in range(3))
        face = np.cross(b - a, c - a)
        face *= np.sign(np.sum(face * (a + self.origin_m), axis=-1, keepdims=True))
        out = np.zeros_like(self.points_m)
        for axis in range(3):
            for corner in range(3):
                out[:, axis] += np.bincount(
                    self.corners[:, corner], face[:, axis], minlength=len(out)
                )
        return out / np.maximum(np.linalg.norm(out, axis=-1, keepdims=True), 1e-30)

    def light(self, start_m: Array, looks: Array, sun_m: Array) -> Array:
        """Radiance along rays from one place (3,) in directions (n, 3), (n,); NaN where they miss."""
        origin = np.broadcast_to(start_m - self.origin_m, looks.shape).astype(np.float32)
        hit = self.scene.run(origin, looks.astype(np.float32), output=True)
        met = np.flatnonzero(hit["primID"] >= 0)
        out = np.full(len(looks), np.nan)
        corners = self.corners[hit["primID"][met]]
        share = np.stack([1.0 - hit["u"][met] - hit["v"][met], hit["u"][met], hit["v"][met]], -1)
        points = np.einsum("nk,nkj->nj", share, self.points_m[corners])
        normals = np.einsum("nk,nkj->nj", share, self.normals[corners])
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        to_sun = sun_m - self.origin_m - points
        to_sun /= np.linalg.norm(to_sun, axis=-1, keepdims=True)
        mu0, mu = np.sum(normals * to_sun, axis=-1), -np.sum(normals * looks[met], axis=-1)
        lifted = (points + LIFT_M * normals).astype(np.float32)
        free = self.scene.run(lifted, to_sun.astype(np.float32), query="OCCLUDED") < 0
        mu = np.maximum(mu, 0.0)
        out[met] = np.where(free & (mu0 > 0.0), mu0 / np.maximum(mu0 + mu, 1e-9), 0.0)
        if self.brightness is not None:
            out[met] *= np.sum(share * self.brightness[corners], axis=-1)
        return out


def photograph(
    ground: Ground, camera: Pinhole, sun_m: Array, *, blur_px: float, samples: int, seed: int
) -> Array:
    """Mean radiance of ``samples`` x ``samples`` random places in each pixel, one in each of as many equal parts,
    (rows, cols); what is missed does not count, NaN where all is.
    """
    dice = np.random.default_rng(seed)
    width, height = camera.size_px
    out = np.full((height, width), np.nan)
    for rows in _strips(height, width * samples**2):
        row, column = (values.astype(float) for values in np.mgrid[rows, 0:width])
        total, count = np.zeros(row.shape), np.zeros(row.shape)
        for part in range(samples**2):
            place = np.array([part % samples, part // samples])[:, None, None]
            inside = (place + dice.random((2, *row.shape))) / samples - 0.5
            at = np.stack([column, row]) + inside + blur_px * dice.normal(size=inside.shape)
            looks = camera.directions(at[0].ravel(), at[1].ravel())
            light = ground.light(camera.position_m, looks, sun_m).reshape(row.shape)
            total += np.nan_to_num(light)
            count += np.isfinite(light)
        out[rows] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return out


def _strips(height: int, rays_a_row: int) -> Iterator[slice]:
    step = max(1, RAYS_AT_ONCE // rays_a_row)
    for first in range(0, height, step):
        yield slice(first, min(first + step, height))


def read_out(light: Array, snr: float, bits: int, seed: int) -> Array:
    """Numbers of a detector: white noise of the mean over ``snr``, the brightest 0.5 % above 80 % of full scale."""
    lit = light[light > 0.0]
    noisy = light + lit.mean() / snr * np.random.default_rng(seed).normal(size=light.shape)
    top = 2**bits - 1
    return np.clip(np.round(0.8 * top * noisy / np.percentile(lit, 99.5)), 0, top)
