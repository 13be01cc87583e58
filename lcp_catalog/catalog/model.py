"""The model of a catalogue: small frozen parts, each of one thing, with the variables of the file under their own
names and in their units. Their arrays are in memory, or are read from a file when they are used (`StoredArray`).

n points, patches of p x p nodes, s image scales, v views, e Sun elevations, a Sun azimuths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from .._version import __version__
from ..arrays import AnyArray, Index
from ..geometry.map_plane import ORTHOGRAPHIC, MapPlane
from .layout import LEVELS
from .shards import Shard

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Part = TypeVar("Part", bound="DataclassInstance")

BLOCK_BYTES = 2**24
"""Most bytes of a variable that are read together."""


class Source(Protocol):
    """Where variables are that are not in memory; ``name``: the file's."""

    name: str

    def read(self, path: str, index: tuple[Any, ...], *, keep: bool = False) -> AnyArray:
        """What NumPy's basic indexing selects of a variable, by its path in the file; the first index may be
        an array of rows. ``keep``: the same will probably be read again.
        """


@dataclass(frozen=True, eq=False)
class StoredArray:
    """A variable that stays in its source; what an index selects is read."""

    source: Source
    path: str
    shape: tuple[int, ...]
    row_bytes: int

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: Any) -> AnyArray:
        return self.source.read(self.path, index if isinstance(index, tuple) else (index,))

    def at(self, rows: Index, index: Sequence[Index]) -> AnyArray:
        """Values (n, m) of the rows (n,), with indices (n, m) along each other axis. Of the file those chunks
        are read that hold the rows, and kept is the box of the indices.
        """
        if not len(rows):
            return np.empty((0, index[0].shape[1]), self[0:0].dtype)
        low = [int(along.min()) for along in index]
        box = [slice(k, int(along.max()) + 1) for k, along in zip(low, index, strict=True)]
        wanted, place = np.unique(rows, return_inverse=True)
        step = max(1, BLOCK_BYTES // max(1, self.row_bytes))
        parts, order = [], np.argsort(place, kind="stable")
        for start in range(0, len(wanted), step):
            some = (wanted[start : start + step], *box)
            values = self.source.read(self.path, some, keep=True)
            first, last = np.searchsorted(place[order], [start, start + step])
            here = order[first:last]
            inner = (along[here] - k for k, along in zip(low, index, strict=True))
            parts.append(values[(place[here, None] - start, *inner)])
        return np.asarray(np.concatenate(parts)[np.argsort(order)])


class _ArrayField:
    """A field with an array: a `StoredArray` is read whole when it is used for the first time."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, part: Any, owner: type) -> Any:
        if part is None:
            return self
        value = part.__dict__[self._name]
        if isinstance(value, StoredArray):
            value = part.__dict__[self._name] = value[()]
        return value

    def __set__(self, part: Any, value: Any) -> None:
        part.__dict__[self._name] = value


def _reads_arrays(part: type[Part]) -> type[Part]:
    """Class decorator: every field that is an array may be given as a `StoredArray`."""
    for field in fields(part):
        if "AnyArray" in str(field.type):
            setattr(part, field.name, _ArrayField(field.name))
    part.__repr__ = _sizes  # type: ignore[method-assign]  # what a class decorator is for
    return part


def _sizes(part: Any) -> str:
    """The sizes of a part's arrays, and its numbers and texts: no value is read."""
    values = {field.name: held(part, field.name) for field in fields(part)}
    shown = (f"{name} {np.shape(value) or value}" for name, value in values.items())
    return f"<{type(part).__name__}: {', '.join(shown)}>"


def held(part: Any, name: str) -> Any:
    """A field of a part as it is held: a `StoredArray` is not read."""
    return part.__dict__[name] if name in part.__dict__ else getattr(part, name)


# -- maps


@_reads_arrays
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


@_reads_arrays
@dataclass(frozen=True, eq=False)
class Coverage:
    """Every spacing cell of the region, or an even sample of them: point nearby, or the reason for none
    (`schema.COVERAGE_STATUS`).
    """

    longitude: AnyArray  # (cell,) degrees
    latitude: AnyArray
    status: AnyArray  # (cell,) uint8
    spacing_m: float
    usable: AnyArray | None = None  # (cell, v, e, a) uint8 of `maps.usable_nearby`; None: unknown
    step_m: float | None = None  # distance of the cells on latitude rings; None: a plane's cells


@_reads_arrays
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


@_reads_arrays
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


# -- the promise


@_reads_arrays
@dataclass(frozen=True, eq=False)
class Promise:
    """What the points that a camera over any place of the region sees are worth, in units (`landmarks.located`), and why
    not as much as promised; v views, e elevations and a azimuths of `sun_cells.SunCells`.

    A catalogue that joins cell sizes or regions has the promises of all its builds: q of them, whose places
    stand one promise after the other, and no curve against the number of points.
    """

    longitude: AnyArray  # (place,) degrees
    latitude: AnyArray
    demand: AnyArray  # (place,) uint8 units promised
    points: AnyArray  # (place, v, e, a) uint8 units within ``radius``; 255: nothing is promised
    cause: AnyArray  # (place, v, e, a) uint8 `schema.Cause`; 255 likewise
    size: AnyArray  # (step,) points in the order of the greedy choice
    met: AnyArray  # (step,) share of places and conditions with as many units as candidates allow
    served: AnyArray  # (step,) share of all units asked for
    places: AnyArray  # (q,) number of places of each promise
    gsd: AnyArray  # (q,) cell size, metres, of the points that are counted
    located_probability: AnyArray  # (q,) promised to a frame; 0: usable points are promised
    per_view: AnyArray  # (q,) usable points promised in a footprint; 0: `located_probability` is
    units: AnyArray  # (q,) units of a point that is as good as certain; 1: each usable point is one
    located: AnyArray  # (q, 255) probability, at least, that a frame is located by 0, 1, ... units
    footprint: AnyArray  # (q,) metres, diameter of the ground that a camera sees
    radius: AnyArray  # (q,) metres around a place, in which every camera whose nearest place it is shows patches whole
    lower_bound: AnyArray  # (q,) points that every choice with the same promise has; 0: unknown

    def parts(self) -> list[slice]:
        """The places of each promise."""
        ends = np.cumsum(self.places).tolist()
        return [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]

    @property
    def least_points(self) -> float:
        """Points that every choice with the same promises has at least; 0: unknown."""
        return float(self.lower_bound.sum()) if (self.lower_bound > 0.0).all() else 0.0


# -- the catalogue


@_reads_arrays
@dataclass(frozen=True, eq=False, kw_only=True)
class ConditionGrid:
    """The conditions that were evaluated."""

    sun_elevation: AnyArray  # (e,) degrees, rising
    sun_azimuth: AnyArray  # (a,) degrees, rising
    view_off_nadir: AnyArray  # (v,) degrees
    view_azimuth: AnyArray  # (v,) degrees
    view_altitude: AnyArray  # (v,) kilometres, inf: parallel rays
    image_scale: AnyArray  # (s,) pixel over cell, 1 first, rising


@_reads_arrays
@dataclass(frozen=True, eq=False, kw_only=True)
class ControlPoints:
    """The points: their places and patches, and their figures over all conditions."""

    point_id: AnyArray  # (n,) int64
    longitude: AnyArray  # (n,) degrees, 0..360
    latitude: AnyArray  # (n,) degrees
    elevation: AnyArray  # (n,) metres above the reference sphere
    position_mcmf: AnyArray  # (n, 3) metres
    rotation_mcmf_to_enu: AnyArray  # (n, 3, 3)
    gsd: AnyArray  # (n,) metres
    level: AnyArray  # (n,) index of the cell size
    dem_product: AnyArray  # (n,) text
    elevation_sigma: AnyArray  # (n,) metres, NaN: unknown
    dem_resolution: AnyArray  # (n,) metres, NaN: unknown
    dem: AnyArray  # (n, p, p) float32 metres
    albedo: AnyArray | None = None  # (n, p, p) float32, NaN outside the map; None: no map
    harris_response: AnyArray  # (n,)
    localization_sigma: AnyArray  # (n, 2) metres, major and minor
    second_peak: AnyArray  # (n,)
    false_match_probability: AnyArray  # (n,)
    gsd_min: AnyArray  # (n,) metres
    gsd_max: AnyArray  # (n,) metres
    shadow_dependence: AnyArray  # (n,)
    occlusion_dependence: AnyArray  # (n,)


@_reads_arrays
@dataclass(frozen=True, eq=False, kw_only=True)
class PointConditions:
    """What is claimed of each point by condition. The claims are rounded to the steps in which they are stored
    (`schema.packing`), and sigmas end at 65534 steps, which stands for everything above.
    """

    condition: AnyArray  # (n, v, e, a) uint8
    sun_elevation_min: AnyArray  # (n, v, a) degrees, NaN: never usable
    sun_elevation_max: AnyArray  # (n, v, a)
    detection_probability: AnyArray  # (n, s, v, e, a) float32, NaN: not evaluated
    sigma_major: AnyArray  # (n, s, v, e, a) float32 metres, NaN: not evaluated
    sigma_minor: AnyArray  # (n, s, v, e, a)
    sigma_angle: AnyArray  # (n, s, v, e, a) degrees clockwise from north


@dataclass(frozen=True, eq=False, kw_only=True)
class Provenance:
    """What the catalogue was made from, and how."""

    config: str  # TOML
    sources: list[dict[str, Any]]  # name, size and sha256 of each DEM file
    scene_plan: Any
    errors: dict[str, Any]  # the error model of the claims, and min_detection
    albedo_map: dict[str, Any] | None = (
        None  # source of ``albedo``: name, encoding, reference, files
    )
    sigma_step_m: float | None = None  # step of stored sigmas, None: from the smallest cell
    shards: tuple[Shard, ...] = ()  # of an index that is written (`catalog.shards`)
    history: str = ""  # what determines the content, in one line
    title: str = "Lunar control points"
    product_version: str = "1"
    software_version: str = __version__


@dataclass(frozen=True, eq=False, kw_only=True)
class CatalogParts(ConditionGrid, ControlPoints, PointConditions, Provenance):
    """All parts of a catalogue together."""

    overview: Overview
    overview_levels: tuple[Overview, ...] = ()  # means of 2 x 2, 4 x 4 and 8 x 8 nodes, or none
    coverage: Coverage
    coverage_levels: CoverageLevels | None = None
    coverage_map: CoverageMap | None = None
    promise: Promise | None = None

    def groups(self) -> dict[str, Any]:
        """The parts by the names of their groups in the file; the root group has no name."""
        found = {
            "": self,
            "overview": self.overview,
            "coverage": self.coverage,
            "promise": self.promise,
            **dict(zip(LEVELS, self.overview_levels, strict=False)),
            "coverage_levels": self.coverage_levels,
            "coverage_map": self.coverage_map,
        }
        return {group: part for group, part in found.items() if part is not None}
