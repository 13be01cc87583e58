"""The points that an export writes: those of the catalogue in a box and of a level, in a frame."""

from __future__ import annotations

import errno
import filecmp
import math
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..arrays import AnyArray, Array, Index
from ..catalog.catalogue import Catalog
from ..catalog.patch_terrain import patch_nodes
from ..catalog.schema import FIGURES, VARIABLES, evaluated, usable
from ..child_process import ChildFailedError
from ..errors import AreaError
from ..geometry.bounds import Bounds, wrapped_deg
from ..geometry.frames import lonlat_to_mcmf, mcmf_to_lonlat
from .frames import LunarFrame

_BLOCK_BYTES = 2**24


class Column(NamedTuple):
    """A figure of every point; ``unit`` is empty for text, 1 for numbers without a unit."""

    name: str
    unit: str
    meaning: str
    values: AnyArray


@dataclass(frozen=True, eq=False)
class ExportedPoints:
    """Points of a catalogue (rows ``rows`` (n,)), their places in ``frame``; ``box``: the limits, in MOON_ME,
    within which they were chosen.
    """

    catalog: Catalog
    rows: Index
    frame: LunarFrame
    box: Bounds | None = None

    @classmethod
    def chosen(
        cls,
        catalog: Catalog,
        frame: LunarFrame,
        box: Bounds | None = None,
        level: int | None = None,
    ) -> ExportedPoints:
        """The points within a box of longitude and latitude in MOON_ME, and of a level; None: all.
        AreaError if there is none.
        """
        rows = np.arange(len(catalog)) if box is None else catalog.rows_within(box)
        if level is not None:
            rows = rows[catalog.part("level", rows) == level]
        if not len(rows):
            where = "" if box is None else f" within {box}"
            what = "" if level is None else f" of level {level}"
            raise AreaError(f"the catalogue has no points{what}{where}")
        return cls(catalog, rows, frame, box)

    def __len__(self) -> int:
        return len(self.rows)

    def part(self, name: str) -> AnyArray:
        """A variable of these points."""
        return self.catalog.part(name, self.rows)

    @cached_property
    def point_id(self) -> Index:
        """Identifiers, (n,)."""
        return np.asarray(self.part("point_id"))

    @cached_property
    def position_m(self) -> Array:
        """Places of the patches' centres in the frame, (n, 3) metres."""
        return np.asarray(self.part("position_mcmf") @ self.frame.from_me.T)

    @cached_property
    def rotation(self) -> Array:
        """Rotations from the frame to the patches' axes, (n, 3, 3): rows east, north, up of MOON_ME."""
        return np.asarray(self.part("rotation_mcmf_to_enu") @ self.frame.from_me.T)

    @cached_property
    def lonlat_deg(self) -> tuple[Array, Array]:
        """Longitudes (-180..180) and latitudes of the patches' centres in the frame, each (n,)."""
        lon, lat, _ = mcmf_to_lonlat(self.position_m)
        return wrapped_deg(lon), lat

    @cached_property
    def lonlat_height(self) -> Array:
        """Longitude and latitude as `lonlat_deg`, and the height above the sphere in metres, (n, 3)."""
        [height] = (one.values for one in self.columns() if one.name == "elevation_m")
        return np.stack([*self.lonlat_deg, height], -1)

    @cached_property
    def gsd_m(self) -> Array:
        """Cell sizes, (n,)."""
        return np.asarray(self.part("gsd"))

    @property
    def half(self) -> int:
        """Nodes from the centre of a patch to its border."""
        return self.catalog.patch_nodes // 2

    @cached_property
    def sigma_m(self) -> tuple[Array, Array]:
        """1 sigma of the places, horizontal along each axis and vertical, each (n,); NaN: unknown."""
        place = self.catalog.place_sigma_m(self.rows)
        return np.where(place > 0.0, place, np.nan), np.asarray(self.part("elevation_sigma"))

    def blocks(self, name: str) -> Iterator[tuple[slice, AnyArray]]:
        """The values of a variable, a block of points at a time, with the block's place in ``rows``."""
        step = max(1, _BLOCK_BYTES // max(1, self.catalog.row_bytes(name)))
        for start in range(0, len(self), step):
            block = slice(start, start + step)
            yield block, self.catalog.part(name, self.rows[block])

    def patches(self) -> Iterator[tuple[int, AnyArray, AnyArray | None]]:
        """Number in ``rows``, heights (p, p) in metres, and albedo (p, p) or None, of each patch."""
        mapped = self.catalog.albedo_map is not None
        for block, heights in self.blocks("dem"):
            albedo = self.catalog.part("albedo", self.rows[block]) if mapped else None
            for k, dem in enumerate(heights):
                yield block.start + k, dem, None if albedo is None else albedo[k]

    def nodes_m(self, block: slice, dem: AnyArray) -> Array:
        """Places of the nodes of a block's patches in the frame, (k, p, p, 3) metres."""
        return patch_nodes(dem, self.gsd_m[block], self.position_m[block], self.rotation[block])

    def columns(self) -> list[Column]:
        """The figures of every point that do not depend on a Sun or a view."""
        lon, lat = self.lonlat_deg
        x, y, z = self.position_m.T
        return [
            Column("point_id", "1", "identifier of the ground, the same in every build", self.point_id),
            Column("longitude_deg", "degree", "longitude of the patch's centre, -180..180", lon),
            Column("latitude_deg", "degree", "planetocentric latitude of the patch's centre", lat),
            *self._stored(),
            Column("x_m", "m", f"position of the patch's centre, {self.frame.name}", x),
            Column("y_m", "m", f"position of the patch's centre, {self.frame.name}", y),
            Column("z_m", "m", f"position of the patch's centre, {self.frame.name}", z),
            Column("usable_share", "1", "share of the evaluated conditions that are usable", self._usable_share()),
            Column("frame", "", "Moon-fixed frame of the place", np.full(len(self), self.frame.name, object)),
        ]  # fmt: skip

    def _stored(self) -> Iterator[Column]:
        for name in _STORED:
            variable = VARIABLES[name]
            suffix = "_m" if variable.units == "m" else ""
            unit = "" if variable.dtype == "str" else variable.units
            yield Column(name + suffix, unit, variable.long_name, self.part(name))
        for k, axis in enumerate(("major", "minor")):
            values = self.part("localization_sigma")[:, k]
            meaning = f"{VARIABLES['localization_sigma'].long_name}, {axis} axis"
            yield Column(f"localization_sigma_{axis}_m", "m", meaning, values)

    def _usable_share(self) -> Array:
        share = np.full(len(self), np.nan)
        for block, flags in self.blocks("condition"):
            known = evaluated(flags).sum(axis=(1, 2, 3))
            good = usable(flags).sum(axis=(1, 2, 3))
            share[block] = np.where(known > 0, good / np.maximum(known, 1), np.nan)
        return share


_STORED = (
    "elevation",
    "gsd",
    "level",
    "dem_product",
    "elevation_sigma",
    "dem_resolution",
    *FIGURES,
)
"""Variables that a table has as they are."""


def plain(values: AnyArray, missing: str | None) -> list[Any]:
    """Values as Python's own, whose shortest text gives the same number again; ``missing`` for NaN."""
    found = np.asarray(values)
    if found.dtype.kind != "f" or not np.isnan(found).any():
        return list(found.tolist())
    return [missing if math.isnan(value) else value for value in found.tolist()]


def cells(points: ExportedPoints) -> dict[str, AnyArray]:
    """Coverage cells within the points' box: ``longitude_deg``, ``latitude_deg`` in the frame, ``status``."""
    catalog, box = points.catalog, points.box
    rows = catalog.cells_within(box) if box else np.arange(len(catalog.coverage.status))
    lon, lat, status = (
        catalog.part(f"coverage/{name}", rows) for name in ("longitude", "latitude", "status")
    )
    turned = lonlat_to_mcmf(lon, lat) @ points.frame.from_me.T
    lon, lat, _ = mcmf_to_lonlat(turned)
    return {"longitude_deg": wrapped_deg(lon), "latitude_deg": lat, "status": status}


_ROOM_BYTES = 2**16


def write_checked(write: Callable[[tuple[Path, Path]], object], path: Path) -> None:
    """Write a file by a library that does not report every failed write: ``write`` gets two paths, and must
    give both the same bytes. OSError if they differ, if an error was reported, or if the disk has no room for some bytes more (then
    both may be cut alike).
    """
    again, why = path.with_name(f"again-{path.name}"), "what was written cannot be read back"
    try:
        write((path, again))
        same = filecmp.cmp(path, again, shallow=False)
    except (RuntimeError, ChildFailedError) as error:
        same, why = False, " ".join(str(error).split())
    with again.open("ab") as file:
        file.write(bytes(_ROOM_BYTES))
        file.flush()
        os.fsync(file.fileno())
    if not same:
        raise OSError(errno.EIO, why)
