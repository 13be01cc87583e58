"""Landmark maps of NASA JPL's landmark_tools (``.lmk``, version 3): a file a point, in a folder."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ..arrays import AnyArray, Array, Bytes
from ..geometry.frames import direction_enu
from ..kernels.matching import draw_patch
from ..photometry.laws import DEFAULT_MODEL
from .points import ExportedPoints
from .tables import write_columns

_HEADER = struct.Struct(">32s32s3i3d3d9d")
_VERSION = b"#! LVS Map v3.0"
_MOON = 1
_UNKNOWN = 100
"""Surface reflectance of a map without one."""


def write_landmark_maps(
    points: ExportedPoints, folder: Path, sun_deg: tuple[float, float] | None = None
) -> None:
    """A map ``<point_id>.lmk`` of every point, and ``points.csv`` with what the maps have no field
    for.

    The map plane is the patch's east and north, its anchor the patch's centre. ``sun_deg``: azimuth
    and elevation of the Sun at the point; the surface reflectance is then that of the default law
    seen from straight above, with the shadows of the patch on itself, 255 for its brightest node;
    without a Sun it is 100, the format's value for unknown.
    """
    sun = None if sun_deg is None else direction_enu(sun_deg[0], sun_deg[1])
    for k, heights, albedo in points.patches():
        name = f"{points.point_id[k]} {points.frame.name}".encode("ascii")
        rows, columns = heights.shape
        gsd_m = points.gsd_m[k]
        header = _HEADER.pack(
            _VERSION, name, _MOON, columns, rows,
            0.5 * (columns - 1), 0.5 * (rows - 1), gsd_m,
            *points.position_m[k], *points.rotation[k].ravel(),
        )  # fmt: skip
        seen = np.full(heights.shape, _UNKNOWN, np.uint8)
        if sun is not None:
            seen = reflectance(heights, gsd_m, sun, albedo)
        content = header + seen.tobytes() + heights.astype(">f4").tobytes()
        (folder / f"{points.point_id[k]}.lmk").write_bytes(content)
    write_columns(points.columns(), folder / "points.csv")


def reflectance(heights: AnyArray, gsd_m: float, sun: Array, albedo: AnyArray | None) -> Bytes:
    """Radiance of a patch's nodes (p, p) seen from straight above, 0 in shadow, 255 the brightest.

    ``sun``: direction (3,) in the patch's frame; ``albedo`` (p, p): factor on the radiance, NaN for
    1.
    """
    dem = np.ascontiguousarray(heights, np.float32)
    light, clear = np.empty(dem.shape, np.float32), np.empty(dem.shape, np.float32)
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    model = DEFAULT_MODEL
    draw_patch.shade(dem, gsd_m, sun, up, model.code, model.numbers, light)
    draw_patch.clearances(dem, gsd_m, sun, clear)
    light = np.where((clear >= 0.0) & (light > 0.0), light, 0.0)
    if albedo is not None:
        light = light * np.nan_to_num(albedo, nan=1.0)
    grey = np.rint(255.0 * light / max(float(light.max()), 1e-30))
    return np.asarray(grey.astype(np.uint8))
