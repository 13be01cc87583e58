"""A catalogue: its parts, checked when they are put together in memory, and what is taken from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Index
from ..errors import CatalogError
from ..geometry.bounds import Bounds
from .checks import first_few, shape_problems, text_problems, value_problems
from .content import attributes, group_attributes, require, values
from .layout import GROUPS, axis_direction, packing, sigma_step_m
from .model import BLOCK_BYTES, CatalogParts, StoredArray, held
from .schema import OPTIONAL, PACKED, universal


@dataclass(frozen=True, eq=False, kw_only=True)
class Catalog(CatalogParts):
    """A catalogue with the variables of its file under their own names, with their units.

    One in memory has its arrays in the schema's types; CatalogError for variables that do not fit together or
    are out of range. One of a file (`verification.open_catalog`) reads each variable when it is used, and was
    checked there: CatalogError where the file is damaged, or was changed since it was opened.

    Examples
    --------
    >>> opened = lcp.open_catalog(catalog)
    >>> opened.dem.shape == (len(opened), opened.patch_nodes, opened.patch_nodes)
    True
    """

    def __post_init__(self) -> None:
        if isinstance(held(self, "point_id"), StoredArray):
            return
        if self.sigma_step_m is None:
            object.__setattr__(self, "sigma_step_m", sigma_step_m(self.gsd))
        object.__setattr__(self, "sigma_angle", axis_direction(self.sigma_angle))
        require(
            ""
            if (self.albedo is None) == (self.albedo_map is None)
            else "albedo and albedo_map go together"
        )
        content = values(self)
        require(first_few(shape_problems({name: array.shape for name, array in content.items()})))
        require(first_few(value_problems(content, self.errors)))
        require(first_few(text_problems(attributes(self), group_attributes(self))))
        for name in content.keys() & {field.name for field in dataclasses.fields(self)}:
            array = content[name]
            array = self.packing(name).unpacked(array) if name in PACKED else array
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        """The sizes alone: no value is read for it."""
        suns = len(self.sun_elevation) * len(self.sun_azimuth)
        size = self.patch_nodes
        return (
            f"<Catalog: {len(self)} points, patches of {size} x {size} nodes, "
            f"{len(self.view_off_nadir)} views, {suns} Suns>"
        )

    def packing(self, name: str) -> Any:
        """How a variable of `schema.PACKED` is stored."""
        return packing(name, self.sigma_step_m or 1.0)

    def __len__(self) -> int:
        return int(np.shape(held(self, "point_id"))[0])

    @property
    def patch_nodes(self) -> int:
        """Nodes along a patch's side."""
        return int(np.shape(held(self, "dem"))[1])

    @property
    def min_detection(self) -> float:
        """Least detection probability of a usable condition."""
        return float(self.errors["min_detection"])

    @cached_property
    def universal(self) -> NDArray[np.bool_]:
        """True for points that are usable in at least 95 % of their evaluated conditions, (n,)."""
        parts = [universal(self.part("condition", rows)) for rows in self.blocks("condition")]
        return np.concatenate(parts or [np.zeros(0, bool)])

    @property
    def point_variables(self) -> tuple[str, ...]:
        """Names of the variables of points that the file has, but for ``point``, the row."""
        without = () if self.albedo_map is not None else OPTIONAL
        return tuple(
            name
            for name, variable in GROUPS[""].items()
            if variable.dims[0] == "point" and name != "point" and name not in without
        )

    # -- parts of a variable

    def part(self, name: str, *index: Any) -> AnyArray:
        """What NumPy's basic indexing selects of a variable, by its path in the file; the first index
        may be an array of rows.

        One patch is ``part("dem", row)``, one condition of all points
        ``part("condition", slice(None), view, elevation, azimuth)``. CatalogError for a variable
        that the catalogue is without.
        """
        group, _, short = name.rpartition("/")
        owner = self.groups().get(group)
        value: Any = None if owner is None else held(owner, short)
        require("" if value is not None else f"has no {name}")
        return np.asarray(value[index])

    def at(self, name: str, rows: Index, index: Sequence[Index]) -> AnyArray:
        """Values (n, m) of a variable of the points ``rows`` (n,), with indices (n, m) along each of
        its other axes.
        """
        value = held(self, name)
        if isinstance(value, StoredArray):
            return value.at(rows, index)
        return np.asarray(value[(rows[:, None], *index)])

    def row_bytes(self, name: str) -> int:
        """Bytes of a point's values of a variable."""
        value = held(self, name)
        if isinstance(value, StoredArray):
            return value.row_bytes
        return int(value.nbytes // max(1, len(value)))

    def blocks(self, name: str) -> Iterator[slice]:
        """All points in blocks of rows whose values of a variable take `BLOCK_BYTES` at most."""
        step = max(1, BLOCK_BYTES // max(1, self.row_bytes(name)))
        for start in range(0, len(self), step):
            yield slice(start, min(start + step, len(self)))

    # -- some of the points

    def take(self, rows: Index, cells: Index | None = None) -> Catalog:
        """The catalogue in memory of the points ``rows`` and of these coverage cells (None: all), with
        the whole overview. What the whole catalogue promises is left out.
        """
        some = cells if cells is not None else np.arange(len(self.coverage.longitude))
        parts: dict[str, Any] = {
            name: self.part(f"coverage/{name}", some)
            for name in ("longitude", "latitude", "status")
        }
        if held(self.coverage, "usable") is not None:
            parts["usable"] = self.part("coverage/usable", some)
        own: dict[str, Any] = {
            name: self.part(name, rows) for name in self.point_variables if name != "universal"
        }
        return dataclasses.replace(
            self,
            **own,
            coverage=dataclasses.replace(self.coverage, **parts),
            coverage_levels=None,
            coverage_map=None,
            promise=None,
        )

    def within(self, west: float, south: float, east: float, north: float) -> Catalog:
        """The catalogue in memory of the points and coverage cells within a box, degrees; longitudes
        may cross the antimeridian. CatalogError for a box without latitudes.
        """
        box = Bounds(west, south, east, north)
        return self.take(self.rows_within(box), self.cells_within(box))

    def rows_within(self, box: Bounds) -> Index:
        """Rows of the points within a box, degrees. Raises as `within`."""
        return _inside(self.longitude, self.latitude, box)

    def cells_within(self, box: Bounds) -> Index:
        """Numbers of the coverage cells within a box, degrees. Raises as `within`."""
        return _inside(self.coverage.longitude, self.coverage.latitude, box)


def _inside(lon_deg: AnyArray, lat_deg: AnyArray, box: Bounds) -> Index:
    """Rows of the places within a box, degrees; CatalogError for a box without latitudes."""
    west, south, east, north = box
    if not south <= north:
        raise CatalogError(f"no box: the south {south:g} is above the north {north:g}")
    width = 360.0 if east - west >= 360.0 else (east - west) % 360.0
    inside = ((lon_deg - west) % 360.0 <= width) & (lat_deg >= south) & (lat_deg <= north)
    return np.flatnonzero(inside)
