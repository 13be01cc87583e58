"""A catalogue: its parts, checked when they are put together in memory, and what is taken from them.

What a catalogue's file holds, from the model: every variable in the schema's type, and all attributes.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array, Index
from ..constants import FRAME, MOON_RADIUS_M
from ..errors import CatalogError, ConfigError, not_a, package, unknown_keys
from ..geometry.bounds import Bounds, turned_deg, wrapped_deg
from ..landmarks.error_model import ErrorModel, local_contrast
from .checks import first_few, shape_problems, text_problems, value_problems
from .layout import (
    FIXED,
    GROUP_ATTRIBUTES,
    GROUPS,
    OPTIONAL_GROUP_ATTRIBUTES,
    TEXT,
    axis_direction,
    centred,
    key,
    packing,
    sigma_step_m,
)
from .model import BLOCK_BYTES, CatalogParts, StoredArray, held
from .point_errors import error_figure
from .schema import COVERAGE_UNKNOWN, NO_CELL, OPTIONAL, PACKED, SCHEMA_VERSION, universal, usable
from .shards import SHARDS

if TYPE_CHECKING:
    from .. import Answer, Fix, Uncertainty

CONVENTIONS = "CF-1.11"
SOFTWARE = "lcp-catalog"


def values(catalog: CatalogParts) -> dict[str, AnyArray]:
    """Every variable by its path in the file, in the schema's types; claims are packed. CatalogError for an
    array that does not fit into its type.
    """
    found: dict[str, Any] = _numbers(catalog)
    if catalog.coverage.usable is None:
        shape = (len(catalog.coverage.longitude), *np.shape(catalog.condition)[1:])
        found["coverage/usable"] = np.full(shape, COVERAGE_UNKNOWN, np.uint8)
    step_m = catalog.sigma_step_m or sigma_step_m(catalog.gsd)
    for group, owner in catalog.groups().items():
        for short, variable in GROUPS[group].items():
            name = key(group, short)
            if name in OPTIONAL and getattr(owner, short) is None:
                continue
            value = found[name] if name in found else getattr(owner, short)
            if name in PACKED:
                value = packing(name, step_m).packed(value)
            found[name] = typed(name, value, variable.dtype)
    return found


def _numbers(catalog: CatalogParts) -> dict[str, AnyArray]:
    """The variables that only number what stands in others, and what follows from them."""
    shape = np.shape(catalog.dem)
    require(
        ""
        if len(shape) == 3
        else f"dem: {len(shape)} dimensions instead of (point, patch_row, patch_col)"
    )
    found: dict[str, Any] = {
        "point": np.arange(len(catalog.point_id)),
        "view": np.arange(len(catalog.view_off_nadir)),
        "patch_row": centred(shape[1]),
        "patch_col": centred(shape[2]),
        "coverage/cell": np.arange(len(catalog.coverage.longitude)),
        "universal": universal(np.asarray(catalog.condition)),
    } | {name: np.arange(length) for name, length in FIXED.items()}
    if catalog.promise is not None:
        found["promise/place"] = np.arange(len(catalog.promise.longitude))
        found["promise/step"] = np.arange(len(catalog.promise.size))
        found["promise/part"] = np.arange(len(catalog.promise.gsd))
        found["promise/unit"] = np.arange(NO_CELL)
    if catalog.coverage_levels is not None:
        found["coverage_levels/block"] = np.arange(len(catalog.coverage_levels.factor))
        found["coverage_levels/code"] = np.arange(np.shape(catalog.coverage_levels.cells)[1])
    return found


def attributes(catalog: CatalogParts) -> dict[str, Any]:
    """The global attributes, without the digest of the content."""
    found = {
        "Conventions": CONVENTIONS,
        "title": catalog.title,
        "product_version": catalog.product_version,
        "schema_version": SCHEMA_VERSION,
        "software": SOFTWARE,
        "software_version": catalog.software_version,
        "history": catalog.history,
        "body": "MOON",
        "frame": FRAME,
        "reference_radius_m": MOON_RADIUS_M,
        "config": catalog.config,
        "sources": json.dumps(catalog.sources, sort_keys=True),
        "scene_plan": json.dumps(catalog.scene_plan, sort_keys=True),
        "errors": json.dumps(catalog.errors, sort_keys=True),
        "sigma_step_m": float(catalog.sigma_step_m or sigma_step_m(catalog.gsd)),
    }
    if catalog.albedo_map is not None:
        found["albedo_map"] = json.dumps(catalog.albedo_map, sort_keys=True)
    if catalog.shards:
        found[SHARDS] = json.dumps([one.stated for one in catalog.shards], sort_keys=True)
    return found


def group_attributes(catalog: CatalogParts) -> dict[str, dict[str, float | str]]:
    """Attributes of the groups by group and name."""
    found: dict[str, dict[str, float | str]] = {}
    parts = catalog.groups()
    for group in parts.keys() & GROUP_ATTRIBUTES.keys():
        found[group] = {
            name: _plain(getattr(parts[group], name)) for name in GROUP_ATTRIBUTES[group]
        }
        if (name := OPTIONAL_GROUP_ATTRIBUTES.get(group, "")) and _is_stated(parts[group], name):
            found[group][name] = _plain(getattr(parts[group], name))
    return found


def _is_stated(part: Any, name: str) -> bool:
    """True for an attribute that is not the default of its part."""
    return bool(getattr(part, name) != type(part).__dataclass_fields__[name].default)


def _plain(value: Any) -> float | str:
    """An attribute of a group: a text or a number."""
    return value if isinstance(value, str) else float(value)


def require(problem: str) -> None:
    """CatalogError for a problem, if there is one."""
    if problem:
        raise CatalogError(f"not a catalogue: {problem}")


def typed(name: str, value: Any, kind: str) -> AnyArray:
    """The array in the schema's type; integers are not made from floats."""
    if kind == TEXT:
        return np.array([str(text) for text in np.asarray(value).ravel()], dtype=object).reshape(
            np.shape(value)
        )
    array = np.asarray(value)
    target = np.dtype(kind)
    require("" if array.dtype.kind in "biuf" else f"{name}: holds {array.dtype}, not numbers")
    if target.kind in "iu" and array.size:
        info = np.iinfo(target)
        require(
            "" if array.dtype.kind in "biu" else f"{name}: holds {array.dtype}, not whole numbers"
        )
        fits = info.min <= int(array.min()) and int(array.max()) <= info.max
        require("" if fits else f"{name}: does not fit into {kind}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array.astype(target))


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
    >>> near = opened.within(3.0, 25.0, 4.0, 26.0)
    >>> low = near.sel(sun_elevation=15.0, sun_azimuth=90.0, view=0)
    >>> len(low) <= len(near) < len(opened)
    True
    >>> opened[0]["point_id"] == next(iter(opened))["point_id"], len(opened[:3])
    (True, 3)
    >>> opened.to_dataframe().index.name, opened["condition"].dims
    ('point_id', ('point', 'view', 'sun_elevation', 'sun_azimuth'))
    >>> near.export(folder / "near.csv") == len(near), opened.query(camera, max=5).usable > 5
    (True, True)
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
        suns = f"{len(self.sun_elevation)} x {len(self.sun_azimuth)}"
        size = self.patch_nodes
        return (
            f"<Catalog: {len(self)} points, patches of {size} x {size} nodes, "
            f"{len(self.view_off_nadir)} views, Suns of {suns} elevations x azimuths>"
        )

    def _repr_html_(self) -> str:
        """For a notebook a short table, counts, region and the usable share by Sun (which reads the conditions), and a small
        map; below 60 kB.
        """
        from .notebook import small_map
        from .summary import summary, summary_rows

        found = summary(self)
        rows = summary_rows(found) + [
            (
                f"Sun at {row['sun_elevation_deg']:g}°",
                "█" * round(20 * row["usable_share"])
                + f" {100.0 * row['usable_share']:.0f} % usable",
            )
            for row in found["usable_by_sun_elevation"]
        ]
        cells = (f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows)
        return f"<table>{''.join(cells)}</table>{small_map(self)}"

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """The figures of each point, as `[i]` gives them; the columns are read once."""
        columns = self._columns()
        return (dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))

    def __getitem__(self, which: Any) -> Any:
        """Of a row its figures by name, a dict; of a slice, rows or a mask (n,) the `Catalog` in memory of these
        points; of the name of a variable an xarray.DataArray with its coordinates.

        Raises
        ------
        IndexError
            For a row that is not there.
        CatalogError
            For a variable that the catalogue is without.
        MissingPackageError
            For a variable, without xarray.
        """
        if isinstance(which, str):
            return self._labelled(which)
        if isinstance(which, int | np.integer):
            row = self.row(which)
            found = {name: self.part(name, np.array([row]))[0] for name in self.column_names}
            return {
                name: value.item() if isinstance(value, np.generic) else value
                for name, value in found.items()
            }
        if isinstance(which, float):
            raise not_a(which, "which", "a row, a slice, rows, a mask, or the name of a variable")
        return self.take(np.arange(len(self))[which])

    def row(self, which: int | np.integer) -> int:
        """A row, from 0; a negative one counts from the end. IndexError for one that is not there."""
        if not -len(self) <= which < len(self):
            raise IndexError(f"no point {which}: the catalogue has {len(self)}, from 0")
        return range(len(self))[which]

    @property
    def column_names(self) -> tuple[str, ...]:
        """Variables with one value for each point."""
        return tuple(name for name in self.point_variables if GROUPS[""][name].dims == ("point",))

    def _columns(self) -> dict[str, list[Any]]:
        return {name: self.part(name).tolist() for name in self.column_names}

    def _labelled(self, name: str) -> Any:
        if unknown := unknown_keys([name], GROUPS[""]):
            raise CatalogError(f"the catalogue has {unknown}")
        return self.to_xarray()[name]

    def to_xarray(self) -> Any:
        """The variables of the points and conditions as an xarray.Dataset, with their axes, units and the file's
        attributes. Those of a file are read when they are used, the part that is selected, and checked.
        MissingPackageError without xarray.
        """
        from .notebook import dataset

        return dataset(self)

    def to_geodataframe(self) -> Any:
        """`to_dataframe` as a geopandas.GeoDataFrame: points of longitude (-180..180), latitude and elevation (m) in
        IAU_2015:30100, the sphere of the Moon. MissingPackageError without geopandas.
        """
        from .notebook import geodataframe

        return geodataframe(self)

    def plot(
        self,
        what: str | int = "usable_share",
        ax: Any = None,
        *,
        sun: tuple[float, float] | None = None,
        view: int = 0,
    ) -> Any:
        """Draw a map of the points, the claims by Sun, or a patch, into a matplotlib axis, which is returned.

        Parameters
        ----------
        what:
            ``usable_share`` or a variable with one figure a point: map, coloured by it, kilometres from the map's
            centre. ``claims``: the share of the points that is usable, by Sun. A row: that point's patch.
        ax:
            The axis; None: a new one.
        sun, view:
            For a patch: azimuth and elevation of the Sun, degrees (None: 90 and 20), and the number of the view; for
            ``claims`` the view.

        Raises
        ------
        CatalogError
            For a name that is no figure of the points.
        MissingPackageError
            Without matplotlib.
        """
        from .notebook import plot

        return plot(self, what, ax, sun, view)

    # -- short for the functions of the package, which are above this module

    def query(
        self,
        camera: Any,
        sun: Any = None,
        *,
        max: int | None = None,  # noqa: A002  # the option of `lcp query`
    ) -> Answer:
        """`lcp_catalog.query` with ``most`` points at the ``max``, for a camera, or its file, and a Sun."""
        from .. import query

        if max is not None and max < 1:
            raise ConfigError(f"`max` must be at least 1, not {max}")
        return query(self, camera, sun, most=max)

    def locate(
        self, image: Any, uncertainty: Uncertainty | None = None, *, camera: Any = None
    ) -> Fix:
        """`lcp_catalog.locate` for an image, or its file; without an uncertainty 1 km and 0.1 deg, 1 sigma."""
        from .. import locate

        return locate(self, image, uncertainty, camera=camera)

    def windows(
        self,
        center: tuple[float, float],
        start: Any,
        stop: Any,
        step: float | str = "6h",
        *,
        camera: Any = None,
    ) -> Any:
        """`lcp_catalog.windows` from ``start`` to ``stop`` in steps (`lcp_catalog.instant_range`)."""
        from .. import instant_range, windows

        return windows(self, center, instant_range(start, stop, step), camera=camera)

    def export(self, output: Path | str, *, overwrite: bool = False) -> int:
        """`lcp_catalog.export` of these points, in the format of the output's ending; their number."""
        from .. import export

        return export(self, output, overwrite=overwrite)

    def report(self, output: Path | str, *, overwrite: bool = False) -> None:
        """`lcp_catalog.report`: the page of this catalogue."""
        from .. import report

        report(self, output, overwrite=overwrite)

    def to_dataframe(self) -> Any:
        """The points as a pandas.DataFrame with a column for each figure of a point, indexed by ``point_id``;
        units as in the file (metres, degrees). MissingPackageError without pandas.
        """
        pandas = package("pandas", "notebook", "a data frame")
        return pandas.DataFrame(self._columns()).set_index("point_id")

    def sel(
        self,
        *,
        view: int | None = None,
        sun_elevation: float | None = None,
        sun_azimuth: float | None = None,
    ) -> Catalog:
        """The catalogue in memory of the points that are usable in a condition, or in any of several.

        Parameters
        ----------
        view:
            Number of the view; None: any.
        sun_elevation, sun_azimuth:
            Angles of the Sun at the point, degrees; the nearest of the catalogue's are taken. None: any.

        Raises
        ------
        CatalogError
            For a view that the catalogue is without, and an elevation beyond the catalogue's.
        """
        views = len(self.view_off_nadir)
        if view is not None and not 0 <= view < views:
            raise CatalogError(f"the catalogue has no view {view}, but {views}, from 0 on")
        e = a = slice(None)
        if sun_elevation is not None:
            low, high = float(self.sun_elevation.min()), float(self.sun_elevation.max())
            if not low <= sun_elevation <= high:
                raise CatalogError(
                    f"`sun_elevation` {sun_elevation:g} is outside the catalogue's {low:g} .. {high:g} deg"
                )
            e = _one(np.abs(self.sun_elevation - sun_elevation))
        if sun_azimuth is not None:
            a = _one(np.abs(wrapped_deg(self.sun_azimuth - sun_azimuth)))
        v = slice(None) if view is None else slice(view, view + 1)
        good = usable(self.part("condition", slice(None), v, e, a))
        return self.take(np.flatnonzero(good.any(axis=(1, 2, 3))))

    def packing(self, name: str) -> Any:
        """How a variable of `schema.PACKED` is stored."""
        return packing(name, self.sigma_step_m or 1.0)

    def __len__(self) -> int:
        return int(np.shape(held(self, "point_id"))[0])

    @property
    def path(self) -> str | None:
        """The file that variables are read from; None for a catalogue in memory."""
        stored = held(self, "point_id")
        return stored.source.name if isinstance(stored, StoredArray) else None

    @property
    def patch_nodes(self) -> int:
        """Nodes along a patch's side."""
        return int(np.shape(held(self, "dem"))[1])

    @property
    def min_detection(self) -> float:
        """Least detection probability of a usable condition."""
        return float(self.errors["min_detection"])

    def place_sigma_m(self, rows: Index) -> Array:
        """1 sigma (n,), for each axis, of the places on the ground of points (rows (n,)): the part of their error ellipses
        that is no match's.
        """
        least = ErrorModel.from_dict(self.errors).position_sigma_cells * self.gsd[rows]
        return np.maximum(error_figure(self, "position_sigma_m", rows), least)

    def moving(self, rows: Index) -> Array:
        """Share (n,) of the covariance of matches in an image's noise by which points (rows (n,)) are displaced
        (`ErrorModel.moving`).
        """
        unknown = np.full(len(rows), np.nan)
        contrast = unknown if self.albedo is None else local_contrast(self.albedo[rows])
        return ErrorModel.from_dict(self.errors).moving(contrast)

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


def _one(away: AnyArray) -> slice:
    """The place of the smallest of some distances, as a slice."""
    at = int(np.argmin(away))
    return slice(at, at + 1)


def _inside(lon_deg: AnyArray, lat_deg: AnyArray, box: Bounds) -> Index:
    """Rows of the places within a box, degrees; CatalogError for a box without latitudes."""
    west, south, east, north = box
    if not south <= north:
        raise CatalogError(f"no box: the south {south:g} is above the north {north:g}")
    east = east if east >= west else west + turned_deg(east - west)
    return np.flatnonzero(Bounds(west, south, east, north).contains(lon_deg, lat_deg))
