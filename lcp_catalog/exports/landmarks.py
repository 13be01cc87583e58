"""Landmark maps of NASA JPL's landmark_tools (``.lmk``, version 3), and landmarks and maplets of stereophotoclinometry (SPC,
Gaskell et al. 2008): a folder with ``LMKFILES`` (text) and ``MAPFILES`` (binary).

The layout of SPC is that of its own READ_MAP and WRITE_MAP. Lengths are in kilometres, heights in units of the cell. The
rows of a maplet run along UX, its columns along UY; here UX is south and UY east, as in SPC's own maplets, so that the
first node is the north-western one.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ..arrays import AnyArray, Array, Bytes
from ..errors import OutputError
from ..geometry.frames import direction_enu
from ..kernels.matching import draw_patch
from ..photometry.laws import DEFAULT_MODEL
from .points import Column, ExportedPoints
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


_LARGEST = 30_000
"""Stored number of the greatest height."""
_RECORD = 72
_CELL = np.dtype([("height", ">i2"), ("albedo", "u1")])
_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_NAMES = 36**5


def write_spc(points: ExportedPoints, folder: Path) -> None:
    """A landmark and a maplet of every point, and ``points.csv`` with the ``point_id`` of each name.
    OutputError for more points than there are names.
    """
    if len(points) > _NAMES:
        raise OutputError(f"SPC names {_NAMES} landmarks at most; choose some with `bounds`")
    maps, landmarks = folder / "MAPFILES", folder / "LMKFILES"
    maps.mkdir()
    landmarks.mkdir()
    names = [_name(k) for k in range(len(points))]
    sigma_km = _sigma_km(points)
    for k, heights, albedo in points.patches():
        east, north, up = points.rotation[k]
        axes = np.stack([-north, east, up])
        text = _landmark(names[k], points, k, axes, sigma_km[k])
        (landmarks / f"{names[k]}.LMK").write_text(text, encoding="ascii", newline="\n")
        content = _maplet(points, k, axes, sigma_km[k], heights, albedo)
        (maps / f"{names[k]}.MAP").write_bytes(content)
    name = Column("name", "", "name of the landmark", np.array(names, dtype=object))
    write_columns([name, *points.columns()], folder / "points.csv")


def _name(number: int) -> str:
    """Six characters: P and the number to the base 36."""
    found = ""
    for _ in range(5):
        number, digit = divmod(number, 36)
        found = _DIGITS[digit] + found
    return f"P{found}"


def _sigma_km(points: ExportedPoints) -> Array:
    """1 sigma of the places along the axes of the frame, (n, 3) kilometres; unknown ones count as 0."""
    across, up = (1e-3 * np.nan_to_num(sigma) for sigma in points.sigma_m)
    own = np.stack([across, across, up], axis=-1)
    return np.asarray(np.sqrt(np.einsum("nk,nki->ni", own**2, points.rotation**2)))


def _landmark(name: str, points: ExportedPoints, k: int, axes: Array, sigma_km: Array) -> str:
    """The text of a landmark. SPC stops reading at END FILE; the frame stands after it."""
    gsd_km = 1e-3 * points.gsd_m[k]

    def line(values: AnyArray, label: str) -> str:
        return "".join(f"{value:20.10E}" for value in values).replace("E", "D") + f"  {label}"

    lines = [
        f"{name}   T",
        f"{points.half:8d}{gsd_km:12.7f}{'':40}  SIZE, SCALE(KM)",
        f"{'':8}-1        -1        -1        -1{'':20}  HORIZON",
        line(np.array([np.linalg.norm(sigma_km), 0.0]), f"{'':20}SIGKM, RMSLMK"),
        line(1e-3 * points.position_m[k], "VLM"),
        *(line(axis, label) for axis, label in zip(axes, ("UX", "UY", "UZ"), strict=True)),
        line(sigma_km, "SIGMA_LMK"),
        "PICTURES",
        "MAP OVERLAPS",
        "LIMB FITS",
        "END FILE",
        f"{points.frame.name} {points.frame.meaning}; point_id {points.point_id[k]}",
    ]
    return "\n".join(lines) + "\n"


def _maplet(
    points: ExportedPoints,
    k: int,
    axes: Array,
    sigma_km: Array,
    heights: AnyArray,
    albedo: AnyArray | None,
) -> bytes:
    """The records of a maplet of 72 bytes; nodes without a height have height and albedo 0. The six
    bytes that SPC does not use name the frame.
    """
    gsd_km = 1e-3 * points.gsd_m[k]
    cells = np.asarray(heights, np.float64) / points.gsd_m[k]
    known = np.isfinite(cells)
    scale = float(np.float32(max(1.0, np.abs(cells[known]).max(initial=0.0)) / _LARGEST))
    total_km = float(np.linalg.norm(sigma_km))
    share = np.rint(255.0 * sigma_km / total_km).astype(int) if total_km else np.zeros(3, int)
    frame = points.frame.name.replace("_", "").encode("ascii")
    header = struct.pack(">6sf", frame, gsd_km) + struct.pack("<H", points.half)
    header += bytes(share.tolist())
    header += struct.pack(">12f", *(1e-3 * points.position_m[k]), *axes.ravel())
    header += struct.pack(">ffB", scale, total_km, 0)
    body = np.zeros(cells.shape, _CELL)
    body["height"][known] = np.rint(cells[known] / scale)
    bright = np.ones(cells.shape) if albedo is None else np.nan_to_num(albedo, nan=1.0)
    body["albedo"][known] = np.clip(np.rint(100.0 * bright[known]), 1, 199)
    content = header + body.tobytes()
    return content + bytes(-len(content) % _RECORD)
