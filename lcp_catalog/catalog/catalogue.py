"""A catalogue in memory: its contents by name, in the schema's types, checked when it is made."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._version import __version__
from ..arrays import AnyArray, Index
from ..constants import FRAME, MOON_RADIUS_M
from ..errors import CatalogError
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane
from .checks import first_few, shape_problems, text_problems, value_problems
from .layout import FIXED, GROUP_ATTRIBUTES, GROUPS, TEXT, centred, is_claim, key
from .packing import Packing, axis_direction, packing, sigma_step_m
from .schema import (
    ADDED_IN_1_1,
    CLAIMS,
    COVERAGE_UNKNOWN,
    OPTIONAL,
    PACKED,
    SCHEMA_VERSION,
    UNCLAIMED_VERSION,
    universal,
)

BLOCK_BYTES = 2**24
"""Most bytes of a variable in a block of `Catalog.blocks`."""

CONVENTIONS = "CF-1.11"
SOFTWARE = "lcp-catalog"


@dataclass(frozen=True, eq=False)
class Overview:
    """A coarse raster of the region, for maps: in the east-north-up frame of its centre, or in another
    projection of `geometry.map_plane`.
    """

    height: AnyArray  # (y, x) float32 metres above the reference sphere; NaN: none
    x: AnyArray  # (x,) metres to the right of the centre, rising
    y: AnyArray  # (y,) metres up from the centre, falling
    center_lon: float
    center_lat: float
    projection: str = ORTHOGRAPHIC

    @property
    def plane(self) -> MapPlane:
        """The plane of ``x`` and ``y``."""
        return MapPlane(self.projection, self.center_lon, self.center_lat)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Every spacing cell of the region, or an even sample of them: point nearby, or the reason for none
    (`schema.COVERAGE_STATUS`).
    """

    longitude: AnyArray  # (cell,) degrees
    latitude: AnyArray
    status: AnyArray  # (cell,) uint8
    spacing_m: float
    usable: AnyArray | None = (
        None  # (cell, v, e, a) uint8 of `coverage.usable_nearby`; None: unknown
    )
    step_m: float | None = None  # distance of the cells on latitude rings; None: a plane's cells


@dataclass(frozen=True, eq=False)
class Guarantee:
    """How many usable points a camera over any place of the region sees, and why not as many as
    promised; v views, e elevations and a azimuths of `sun_cells.SunCells`.
    """

    longitude: AnyArray  # (place,) degrees
    latitude: AnyArray
    demand: AnyArray  # (place,) uint8 points promised
    points: AnyArray  # (place, v, e, a) uint8 usable within ``radius_m``; 255: nothing is promised
    cause: AnyArray  # (place, v, e, a) uint8 `schema.Cause`; 255 likewise
    size: AnyArray  # (step,) points in the order of the greedy choice
    met: AnyArray  # (step,) share of places and conditions with as many points as candidates allow
    served: AnyArray  # (step,) share of all points asked for
    per_view: float
    footprint_m: float  # diameter of the ground that a camera sees
    radius_m: float  # around a place that every camera sees whose nearest place it is
    lower_bound: float  # points that every choice with the same promise has at least; 0: unknown


@dataclass(frozen=True, eq=False)
class Promises:
    """The promises of several builds, for several cell sizes or regions, in one `Guarantee`: its places are
    theirs, one promise after the other. Its ``footprint_m`` and ``radius_m`` are the largest, its
    ``lower_bound`` is the sum. p promises.
    """

    places: AnyArray  # (p,) number of places of each
    gsd: AnyArray  # (p,) cell size, metres, of the points that are counted
    per_view: AnyArray  # (p,)
    footprint: AnyArray  # (p,) metres
    radius: AnyArray  # (p,) metres
    lower_bound: AnyArray  # (p,)

    def parts(self) -> list[slice]:
        """The places of each promise in the guarantee."""
        ends = np.cumsum(self.places).tolist()
        return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]


@dataclass(frozen=True, eq=False)
class OverviewLevels:
    """The overview of a large region in levels: means of 2 x 2, 4 x 4 and 8 x 8 of its nodes, without NaN;
    x and y of each as in `Overview`.
    """

    height_2: AnyArray  # (y_2, x_2) float32 metres above the reference sphere; NaN: none
    x_2: AnyArray
    y_2: AnyArray
    height_4: AnyArray
    x_4: AnyArray
    y_4: AnyArray
    height_8: AnyArray
    x_8: AnyArray
    y_8: AnyArray
    center_lon: float
    center_lat: float
    projection: str

    def level(self, factor: int) -> Overview:
        """The level whose nodes are means of ``factor`` x ``factor`` nodes (2, 4 or 8)."""
        height, x, y = (getattr(self, f"{name}_{factor}") for name in ("height", "x", "y"))
        return Overview(height, x, y, self.center_lon, self.center_lat, self.projection)


@dataclass(frozen=True, eq=False)
class CoverageLevels:
    """The coverage of a large region in cells that are 2, 4 and 8 times as wide and high, on latitude rings of
    their own.
    """

    factor: AnyArray  # (block,) 2, 4 or 8
    longitude: AnyArray  # (block,) degrees, of the centre
    latitude: AnyArray
    cells: AnyArray  # (block, status) number of cells of the coverage whose centre lies in it
    usable_share: AnyArray  # (block,) of their known conditions, NaN: none is known
    step_m: (
        float  # distance of the cells of the coverage; that of these is ``factor`` times as long
    )


@dataclass(frozen=True, eq=False)
class CoverageMap:
    """The coverage as a raster in the plane of the overview: each node is the nearest cell."""

    status: AnyArray  # (y_cell, x_cell) uint8 of the cell; 255: no cell is near
    usable_share: AnyArray  # (y_cell, x_cell) of its known conditions; NaN: none is known
    x_cell: AnyArray  # metres, rising
    y_cell: AnyArray  # metres, falling
    center_lon: float
    center_lat: float
    projection: str


@dataclass(frozen=True, eq=False)
class Catalog:
    """A catalogue in memory: the variables of the file under their own names, with their units.

    n points, patches of p x p nodes, v views, e Sun elevations, a Sun azimuths. Arrays are
    converted to the schema's types. CatalogError for variables that do not fit together or are out
    of range. ``sources`` (a list of name, size, sha256), ``scene_plan``, ``albedo_map`` and
    ``errors`` may be given as JSON text.

    A catalogue with claims (schema 2) has ``image_scale``, ``detection_probability``, the three
    sigmas and ``errors``, for s image scales; they are rounded to the steps in which they are stored
    (`packing`), and sigmas end at 65534 steps, which stands for everything above. A catalogue
    without claims has none of them (None).

    Examples
    --------
    >>> opened = lcp.open_catalog(catalog)
    >>> opened.dem.shape == (len(opened), opened.patch_nodes, opened.patch_nodes)
    True
    """

    sun_elevation: AnyArray  # (e,) degrees, rising
    sun_azimuth: AnyArray  # (a,) degrees, rising
    view_off_nadir: AnyArray  # (v,) degrees
    view_azimuth: AnyArray  # (v,) degrees
    view_altitude: AnyArray  # (v,) kilometres, inf: parallel rays
    point_id: AnyArray  # (n,) int64
    longitude: AnyArray  # (n,) degrees, 0..360
    latitude: AnyArray  # (n,) degrees
    elevation: AnyArray  # (n,) metres above the reference sphere
    position_mcmf: AnyArray  # (n, 3) metres
    rotation_mcmf_to_enu: AnyArray  # (n, 3, 3)
    gsd: AnyArray  # (n,) metres
    dem_product: AnyArray  # (n,) text
    dem: AnyArray  # (n, p, p) float32 metres
    condition: AnyArray  # (n, v, e, a) uint8
    sun_elevation_min: AnyArray  # (n, v, a) degrees, NaN: never usable
    sun_elevation_max: AnyArray  # (n, v, a)
    harris_response: AnyArray  # (n,)
    localization_sigma: AnyArray  # (n, 2) metres, major and minor
    second_peak: AnyArray  # (n,)
    false_match_probability: AnyArray  # (n,)
    gsd_min: AnyArray  # (n,) metres
    gsd_max: AnyArray  # (n,) metres
    shadow_dependence: AnyArray  # (n,)
    occlusion_dependence: AnyArray  # (n,)
    config: str  # TOML
    sources: list[dict[str, Any]]
    scene_plan: Any
    overview: Overview
    coverage: Coverage
    title: str = "Lunar control points"
    product_version: str = "1"
    software_version: str = __version__
    schema_version: str = ""  # of the file that was read, or else of the file that is written
    elevation_sigma: AnyArray | None = None  # (n,) metres, NaN or None: unknown
    dem_resolution: AnyArray | None = None  # (n,) metres, NaN or None: unknown
    albedo: AnyArray | None = None  # (n, p, p) float32, NaN outside the map; None: no map
    albedo_map: Any = None  # source of ``albedo``: name, encoding, reference, files

    image_scale: AnyArray | None = None  # (s,) pixel over cell, 1 first, rising
    detection_probability: AnyArray | None = None  # (n, s, v, e, a) float32, NaN: not evaluated
    sigma_major: AnyArray | None = None  # (n, s, v, e, a) float32 metres, NaN: not evaluated
    sigma_minor: AnyArray | None = None  # (n, s, v, e, a)
    sigma_angle: AnyArray | None = None  # (n, s, v, e, a) degrees clockwise from north
    errors: Any = None  # dict: the error model of the claims, and min_detection
    level: AnyArray | None = None  # (n,) index of the cell size, None: 0
    sigma_step_m: float | None = None  # step of stored sigmas, None: from the smallest cell
    guarantee: Guarantee | None = None  # None: no promise was made
    promises: Promises | None = None  # None: one promise, or none
    overview_levels: OverviewLevels | None = None  # None: a region that a tangent plane shows
    coverage_levels: CoverageLevels | None = None
    coverage_map: CoverageMap | None = None

    def __post_init__(self) -> None:
        self._complete_claims()
        for name in ADDED_IN_1_1:
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.full(len(self.point_id), np.nan))
        _require(
            ""
            if (self.albedo is None) == (self.albedo_map is None)
            else "albedo and albedo_map go together"
        )
        for name in ("sources", "scene_plan", "albedo_map", "errors"):
            value = getattr(self, name)
            object.__setattr__(
                self, name, _from_json(name, value) if isinstance(value, str) else value
            )
        values = self.values()
        _require(first_few(shape_problems({name: array.shape for name, array in values.items()})))
        _require(first_few(value_problems(values, self.errors)))
        texts = self.attributes() | self.optional_attributes()
        _require(first_few(text_problems(texts, self.group_attributes())))
        for name in values.keys() & {f.name for f in dataclasses.fields(self)}:
            value = self._packing(name).unpacked(values[name]) if name in PACKED else values[name]
            object.__setattr__(self, name, value)

    def _complete_claims(self) -> None:
        """Fill what follows from other fields; CatalogError for a part of the claims."""
        wanted = ("image_scale", *PACKED, "errors")
        absent = [name for name in wanted if getattr(self, name) is None]
        _require("" if len(absent) in (0, len(wanted)) else f"{absent[0]}: missing beside others")
        if not self.schema_version:
            object.__setattr__(self, "schema_version", self._written_version)
        if self.level is None:
            object.__setattr__(self, "level", np.zeros(len(self.point_id), np.int32))
        if self.has_claims and self.sigma_step_m is None:
            object.__setattr__(self, "sigma_step_m", sigma_step_m(self.gsd))
        if self.sigma_angle is not None:
            object.__setattr__(self, "sigma_angle", axis_direction(self.sigma_angle))

    @property
    def _written_version(self) -> str:
        """Schema of the file that is written."""
        return SCHEMA_VERSION if self.has_claims else UNCLAIMED_VERSION

    def _packing(self, name: str) -> Packing:
        return packing(name, self.sigma_step_m or 1.0)

    def __len__(self) -> int:
        return len(self.point_id)

    def part(self, name: str, *index: Any) -> AnyArray:
        """What NumPy's basic indexing selects of a variable, by its path in the file; the first index
        may be an array of rows.

        One patch is ``part("dem", row)``, one condition of all points
        ``part("condition", slice(None), view, elevation, azimuth)``. CatalogError for a variable
        that the catalogue is without.
        """
        group, _, short = name.rpartition("/")
        value = getattr(getattr(self, group) if group else self, short)
        _require("" if value is not None else f"has no {name}")
        return np.asarray(value)[index]

    @property
    def point_variables(self) -> tuple[str, ...]:
        """Names of the variables of points that the file has, but for ``point``, the row."""
        without: tuple[str, ...] = () if self.has_claims else CLAIMS
        without += () if self.albedo_map is not None else OPTIONAL
        return tuple(
            name
            for name, variable in GROUPS[""].items()
            if variable.dims[0] == "point" and name != "point" and name not in without
        )

    def at(self, name: str, rows: Index, *index: Index) -> AnyArray:
        """Values (n, m) of a variable of the points ``rows`` (n,), with indices (n, m) along each of
        its other axes.
        """
        return np.asarray(getattr(self, name))[(rows[:, None], *index)]

    def row_bytes(self, name: str) -> int:
        """Bytes of a point's values of a variable."""
        array = np.asarray(getattr(self, name))
        return array.nbytes // max(1, len(array))

    def blocks(self, name: str) -> Iterator[slice]:
        """All points in blocks of rows whose values of a variable take `BLOCK_BYTES` at most."""
        step = max(1, BLOCK_BYTES // max(1, self.row_bytes(name)))
        for start in range(0, len(self), step):
            yield slice(start, min(start + step, len(self)))

    def take(self, rows: Index, cells: Index | None = None) -> Catalog:
        """The catalogue in memory of the points ``rows`` and of these coverage cells (None: all), with
        the whole overview. What the whole catalogue promises is left out.
        """
        some = cells if cells is not None else np.arange(len(self.coverage.longitude))
        names = ["longitude", "latitude", "status", *(["usable"] if self.has_claims else [])]
        parts = {name: self.part(f"coverage/{name}", some) for name in names}
        spacing_m, step_m = self.coverage.spacing_m, self.coverage.step_m
        coverage = Coverage(**parts, spacing_m=spacing_m, step_m=step_m)
        absent = {*PACKED, *OPTIONAL} - {*self.point_variables}
        given: dict[str, Any] = {}
        for field in dataclasses.fields(self):
            variable = GROUPS[""].get(field.name)
            own = variable is not None and variable.dims[0] == "point"
            value = (
                None
                if field.name in absent
                else self.part(field.name, rows)
                if own
                else getattr(self, field.name)
            )
            given[field.name] = value
        without = dict.fromkeys(("guarantee", "promises", "coverage_levels", "coverage_map"))
        return Catalog(**given | {"coverage": coverage} | without)

    def within(self, west: float, south: float, east: float, north: float) -> Catalog:
        """The catalogue in memory of the points and coverage cells within a box, degrees; longitudes
        may cross the antimeridian. CatalogError for a box without latitudes.
        """
        box = (west, south, east, north)
        return self.take(self.rows_within(*box), self.cells_within(*box))

    def rows_within(self, west: float, south: float, east: float, north: float) -> Index:
        """Rows of the points within a box, degrees. Raises as `within`."""
        return _inside(self.longitude, self.latitude, west, south, east, north)

    def cells_within(self, west: float, south: float, east: float, north: float) -> Index:
        """Numbers of the coverage cells within a box, degrees. Raises as `within`."""
        places = self.coverage.longitude, self.coverage.latitude
        return _inside(*places, west, south, east, north)

    @property
    def has_claims(self) -> bool:
        """True if the catalogue states detection probabilities and sigmas (schema 2)."""
        return self.image_scale is not None

    @cached_property
    def universal(self) -> NDArray[np.bool_]:
        """True for points that are usable in at least 95 % of their evaluated conditions, (n,)."""
        parts = [universal(self.part("condition", rows)) for rows in self.blocks("condition")]
        return np.concatenate(parts or [np.zeros(0, bool)])

    @property
    def min_detection(self) -> float | None:
        """Least detection probability of a usable condition; None without claims."""
        return None if self.errors is None else float(self.errors["min_detection"])

    @property
    def patch_nodes(self) -> int:
        """Nodes along a patch's side."""
        return int(np.shape(self.dem)[1])

    def values(self) -> dict[str, AnyArray]:
        """Every dataset of the file by its name there, in the schema's types; claims are packed."""
        found: dict[str, Any] = {
            "point": np.arange(len(self.point_id)),
            "view": np.arange(len(self.view_off_nadir)),
        }
        shape = np.shape(self.dem)
        _require(
            ""
            if len(shape) == 3
            else f"dem: {len(shape)} dimensions instead of (point, patch_row, patch_col)"
        )
        found |= {"patch_row": centred(shape[1]), "patch_col": centred(shape[2])}
        found |= {name: np.arange(length) for name, length in FIXED.items()}
        found["coverage/cell"] = np.arange(len(self.coverage.longitude))
        if self.guarantee is not None:
            found["guarantee/place"] = np.arange(len(self.guarantee.longitude))
            found["guarantee/step"] = np.arange(len(self.guarantee.size))
        if self.promises is not None:
            found["promises/promise"] = np.arange(len(self.promises.gsd))
        if self.coverage_levels is not None:
            found["coverage_levels/block"] = np.arange(len(self.coverage_levels.factor))
            found["coverage_levels/code"] = np.arange(np.shape(self.coverage_levels.cells)[1])
        if self.has_claims:
            found["coverage/usable"] = self._coverage_usable()
        for group, variables in GROUPS.items():
            owner = getattr(self, group) if group else self
            if owner is None:
                continue
            for short, variable in variables.items():
                name = key(group, short)
                if (name in OPTIONAL and getattr(self, name) is None) or (
                    is_claim(name) and not self.has_claims
                ):
                    continue
                value = found[name] if name in found else getattr(owner, short)
                if name in PACKED:
                    value = self._packing(name).packed(value)
                found[name] = _typed(name, value, variable.dtype)
        return found

    def _coverage_usable(self) -> AnyArray:
        """Coverage by condition, unknown where nobody computed it."""
        if self.coverage.usable is not None:
            return self.coverage.usable
        shape = (len(self.coverage.longitude), *np.shape(self.condition)[1:])
        return np.full(shape, COVERAGE_UNKNOWN, np.uint8)

    def attributes(self) -> dict[str, Any]:
        """The global attributes of the file, without the digest of the content."""
        return {
            "Conventions": CONVENTIONS,
            "title": self.title,
            "product_version": self.product_version,
            "schema_version": self._written_version,
            "software": SOFTWARE,
            "software_version": self.software_version,
            "body": "MOON",
            "frame": FRAME,
            "reference_radius_m": MOON_RADIUS_M,
            "config": self.config,
            "sources": json.dumps(self.sources, sort_keys=True),
            "scene_plan": json.dumps(self.scene_plan, sort_keys=True),
            **self._claim_attributes(),
        }

    def _claim_attributes(self) -> dict[str, Any]:
        if not self.has_claims:
            return {}
        return {
            "errors": json.dumps(self.errors, sort_keys=True),
            "sigma_step_m": float(self.sigma_step_m or 1.0),
        }

    def optional_attributes(self) -> dict[str, Any]:
        """The global attributes of catalogues with albedo, without their digest; else empty."""
        if self.albedo_map is None:
            return {}
        return {"albedo_map": json.dumps(self.albedo_map, sort_keys=True)}

    def group_attributes(self) -> dict[str, dict[str, float | str]]:
        """Attributes of the groups by group and name."""
        found: dict[str, dict[str, float | str]] = {
            group: {name: _plain(getattr(getattr(self, group), name)) for name in names}
            for group, names in GROUP_ATTRIBUTES.items()
            if getattr(self, group) is not None
        }
        if self.overview.projection != ORTHOGRAPHIC:
            found["overview"]["projection"] = self.overview.projection
        if self.coverage.step_m is not None:
            found["coverage"]["step_m"] = float(self.coverage.step_m)
        return found


def _inside(
    lon_deg: AnyArray, lat_deg: AnyArray, west: float, south: float, east: float, north: float
) -> Index:
    """Rows of the places within a box, degrees; CatalogError for a box without latitudes."""
    if not south <= north:
        raise CatalogError(f"no box: the south {south:g} is above the north {north:g}")
    width = 360.0 if east - west >= 360.0 else (east - west) % 360.0
    inside = ((lon_deg - west) % 360.0 <= width) & (lat_deg >= south) & (lat_deg <= north)
    return np.flatnonzero(inside)


def _plain(value: Any) -> float | str:
    """An attribute of a group: a text or a number."""
    return value if isinstance(value, str) else float(value)


def _require(problem: str) -> None:
    if problem:
        raise CatalogError(f"not a catalogue: {problem}")


def _from_json(name: str, text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise CatalogError(f"not a catalogue: {name} is not JSON: {error}") from error


def _typed(name: str, value: Any, kind: str) -> AnyArray:
    """The array in the schema's type; integers are not made from floats."""
    if kind == TEXT:
        return np.array([str(text) for text in np.asarray(value).ravel()], dtype=object).reshape(
            np.shape(value)
        )
    array = np.asarray(value)
    target = np.dtype(kind)
    _require("" if array.dtype.kind in "biuf" else f"{name}: holds {array.dtype}, not numbers")
    if target.kind in "iu" and array.size:
        info = np.iinfo(target)
        _require(
            "" if array.dtype.kind in "biu" else f"{name}: holds {array.dtype}, not whole numbers"
        )
        fits = info.min <= int(array.min()) and int(array.max()) <= info.max
        _require("" if fits else f"{name}: does not fit into {kind}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array.astype(target))
