"""Digital shape kernels of SPICE (``.bds``), type 2: the patches of a site as triangular plates."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array, Index
from ..child_process import call_apart
from ..errors import AreaError, package
from ..geometry.bounds import enclosing_arc
from ..geometry.frames import mcmf_to_lonlat
from .frames import LunarFrame, frame_named
from .points import ExportedPoints, write_checked

PLATES_MAX = 250_000
"""Most plates without a box: about 12 MB."""

_MOON = 301
_SURFACE = 1
_LATITUDINAL = 1
_SINGLE_VALUED = 1
_FINE_SCALE = 5.0
_COARSE_SCALE = 4
_WORK = 4_000_000
_VOXELS_AND_LISTS = 4_000_000
_INDEX = 10_000_000
_CENTURY_S = 36_525 * 86_400.0
_LONGEST_S, _MOST_MB = 3600.0, 16_000.0
"""Processor time and memory that SPICE may use."""


def write_dsk(points: ExportedPoints, path: Path) -> None:
    """One segment of the Moon's surface 1, in the frame's name of NAIF's kernels, valid 1900 to 2100.

    The plates are the patches' own triangles, seen from outside in counter-clockwise order; patches
    that overlap give plates above each other. AreaError for more than `PLATES_MAX` plates unless
    the points were chosen by a box. MissingPackageError without spiceypy.
    """
    count = 2 * len(points) * (points.catalog.patch_nodes - 1) ** 2
    if count > PLATES_MAX and points.box is None:
        raise AreaError(
            f"{count} plates are too many for a site ({PLATES_MAX}); choose it with `bounds`"
        )
    package("spiceypy", "spice", "a .bds file")
    vertices = path.with_name("vertices")
    vertices.write_bytes(_vertices_km(points).data)
    shape = [len(points), points.catalog.patch_nodes, points.frame.name]

    def write(files: tuple[Path, Path]) -> None:
        given = json.dumps([list(map(str, files)), str(vertices), *shape])
        call_apart(write_segments, given, _LONGEST_S, _MOST_MB)

    write_checked(write, path)


def write_segments(given: str) -> None:
    """Write kernels of JSON: their files, that of the vertices, patches, nodes along a side, and frame; in a
    process of its own, since SPICE ends its process where it cannot write.
    """
    files, vertices_path, count, side, frame_name = json.loads(given)
    spice, frame = import_module("spiceypy"), frame_named(frame_name)
    vertices, plates = np.fromfile(vertices_path).reshape(-1, 3), _plates(count, side)
    none = np.zeros(10)
    with _frame_known(spice, frame):
        index = spice.dskmi2(
            vertices, plates, _FINE_SCALE, _COARSE_SCALE, _WORK,
            _VOXELS_AND_LISTS, _VOXELS_AND_LISTS, True, _INDEX,
        )  # fmt: skip
        low, high = spice.dskrb2(vertices, plates, _LATITUDINAL, none)
        for file in files:
            handle = spice.dskopn(file, "lcp landmark patches", 0)
            spice.dskw02(
                handle, _MOON, _SURFACE, _SINGLE_VALUED, frame.spice_name, _LATITUDINAL, none,
                *_bounds_rad(vertices), low, high, -_CENTURY_S, _CENTURY_S,
                vertices, plates, *index,
            )  # fmt: skip
            spice.dskcls(handle, True)


def _vertices_km(points: ExportedPoints) -> Array:
    parts = [points.nodes_m(block, dem).reshape(-1, 3) for block, dem in points.blocks("dem")]
    return np.ascontiguousarray(1e-3 * np.concatenate(parts))


def _plates(count: int, side: int) -> Index:
    """Numbers of the vertices, from 1, of two plates a cell, split from north-west to south-east."""
    node = np.arange(side * side).reshape(side, side) + 1
    nw, ne = node[:-1, :-1].ravel(), node[:-1, 1:].ravel()
    sw, se = node[1:, :-1].ravel(), node[1:, 1:].ravel()
    one = np.concatenate([np.stack([nw, se, ne], -1), np.stack([nw, sw, se], -1)])
    shift = np.arange(count)[:, None, None] * side * side
    return np.ascontiguousarray((one + shift).reshape(-1, 3))


def _bounds_rad(vertices_km: Array) -> tuple[float, float, float, float]:
    """Least and greatest longitude, least and greatest latitude, with a margin; all longitudes and the
    pole for a site around one.
    """
    lon, lat, _ = mcmf_to_lonlat(1e3 * vertices_km)
    margin = 1e-6
    south, north = max(lat.min() - margin, -90.0), min(lat.max() + margin, 90.0)
    west, east = enclosing_arc(lon, lon)
    if east - west > 180.0:
        west, east = margin - 180.0, 180.0 - margin  # SPICE takes at most a full turn
        south, north = (south, 90.0) if lat.mean() > 0.0 else (-90.0, north)
    found = np.radians([max(west - margin, -360.0), min(east + margin, 360.0), south, north])
    return tuple(found.tolist())


@contextmanager
def _frame_known(spice: Any, frame: LunarFrame) -> Iterator[None]:
    """SPICE knows the frame's name within the block, without a kernel of the user's."""
    number = f"FRAME_{frame.spice_id}"
    known = spice.namfrm(frame.spice_name) != 0
    whole = {
        f"FRAME_{frame.spice_name}": frame.spice_id,
        f"{number}_CENTER": _MOON,
        f"{number}_CLASS": 4,
        f"{number}_CLASS_ID": frame.spice_id,
    }
    if not known:
        spice.pcpool(f"{number}_NAME", [frame.spice_name])
        for name, value in whole.items():
            spice.pipool(name, [value])
    try:
        yield
    finally:
        if not known:
            for name in (f"{number}_NAME", *whole):
                spice.dvpool(name)
