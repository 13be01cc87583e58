"""Landmarks and maplets of stereophotoclinometry (SPC, Gaskell et al. 2008): a folder with
``LMKFILES`` (text) and ``MAPFILES`` (binary).

The layout is that of SPC's own READ_MAP and WRITE_MAP. Lengths are in kilometres, heights in units
of the cell. The rows of a maplet run along UX, its columns along UY; here UX is south and UY east, as
in SPC's own maplets, so that the first node is the north-western one.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ..arrays import AnyArray, Array
from ..errors import OutputError
from .points import Column, ExportedPoints
from .tables import write_columns

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
