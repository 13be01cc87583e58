"""The catalogue as an HDF5 file that is also netCDF-4: write, read, verify. Nothing else knows
HDF5.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._version import __version__
from .constants import FRAME, MOON_RADIUS_M
from .errors import CatalogError
from .files import check_output, write_bytes
from .schema import (
    COORDINATES,
    COVERAGE,
    COVERAGE_STATUS,
    EVALUATED,
    FLAG_MASKS,
    FLAG_MEANINGS,
    OVERVIEW,
    SCHEMA_VERSION,
    USABLE,
    VARIABLES,
    Variable,
)
from .sphere import enu_rotation, lonlat_to_mcmf

__all__ = [
    "SCHEMA_VERSION",
    "Catalog",
    "Coverage",
    "Overview",
    "evaluated",
    "read_catalog",
    "summarise_usable",
    "usable",
    "verify",
    "write_catalog",
]

CONVENTIONS = "CF-1.11"
SOFTWARE = "lcp-catalog"

TEXT = "str"

GROUPS: dict[str, dict[str, Variable]] = {
    "": COORDINATES | VARIABLES,
    "overview": OVERVIEW,
    "coverage": COVERAGE,
}
"""Every dataset of the file by group and name; the root group has no name."""

GROUP_ATTRIBUTES = {"overview": ("center_lon", "center_lat"), "coverage": ("spacing_m",)}

GLOBAL_ATTRIBUTES = (
    "Conventions",
    "title",
    "product_version",
    "schema_version",
    "software",
    "software_version",
    "body",
    "frame",
    "reference_radius_m",
    "config",
    "sources",
    "scene_plan",
    "content_sha256",
)

_FIXED = {"mcmf_axis": 3, "enu_axis": 3, "ellipse_axis": 2}
_PLACE_TOLERANCE_M = 1e-3
_ROTATION_TOLERANCE = 1e-9
_CENTRE_TOLERANCE_M = 0.01
_ELEVATION_LIMIT_M = 20_000.0

_CHUNK_BYTES = 2**18
_HDF5_ERRORS = (
    OSError,
    RuntimeError,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    OverflowError,
    MemoryError,
)
"""What h5py raises on a file that is damaged where it pleases."""

Array = NDArray[Any]
Values = Mapping[str, Array]
"""Every dataset of the file by its path in it."""


@dataclass(frozen=True, eq=False)
class Overview:
    """A coarse raster of the region in the east-north-up frame of its centre, for maps."""

    height: Array  # (y, x) float32 metres above the reference sphere; NaN: none
    x: Array  # (x,) metres east, rising
    y: Array  # (y,) metres north, falling
    center_lon: float
    center_lat: float


@dataclass(frozen=True, eq=False)
class Coverage:
    """Every spacing cell of the region: whether a point is near, or why there is none
    (`schema.COVERAGE_STATUS`).
    """

    longitude: Array  # (cell,) degrees
    latitude: Array
    status: Array  # (cell,) uint8
    spacing_m: float


@dataclass(frozen=True, eq=False)
class Catalog:
    """A catalogue in memory: the variables of the file under their own names (units in
    docs/catalogue.md).

    n points, patches of p x p nodes, v views, e Sun elevations, a Sun azimuths. Arrays become the
    schema's types; what does not fit together or is out of range is a CatalogError.
    ``sources`` (a list of name, size, sha256) and ``scene_plan`` may be given as JSON text.
    """

    sun_elevation: Array  # (e,) degrees, rising
    sun_azimuth: Array  # (a,) degrees, rising
    view_off_nadir: Array  # (v,) degrees
    view_azimuth: Array  # (v,) degrees
    view_altitude: Array  # (v,) kilometres, inf: parallel rays
    point_id: Array  # (n,) int64
    longitude: Array  # (n,) degrees, 0..360
    latitude: Array  # (n,) degrees
    elevation: Array  # (n,) metres above the reference sphere
    position_mcmf: Array  # (n, 3) metres
    rotation_mcmf_to_enu: Array  # (n, 3, 3)
    gsd: Array  # (n,) metres
    dem_product: Array  # (n,) text
    dem: Array  # (n, p, p) float32 metres
    condition: Array  # (n, v, e, a) uint8
    sun_elevation_min: Array  # (n, v, a) degrees, NaN: never usable
    sun_elevation_max: Array  # (n, v, a)
    harris_response: Array  # (n,)
    localization_sigma: Array  # (n, 2) metres, major and minor
    second_peak: Array  # (n,)
    false_match_probability: Array  # (n,)
    gsd_min: Array  # (n,) metres
    gsd_max: Array  # (n,) metres
    shadow_dependence: Array  # (n,)
    occlusion_dependence: Array  # (n,)
    config: str  # TOML
    sources: list[dict[str, Any]]
    scene_plan: Any
    overview: Overview
    coverage: Coverage
    title: str = "Lunar control points"
    product_version: str = "1"
    software_version: str = __version__

    def __post_init__(self) -> None:
        for name in ("sources", "scene_plan"):
            value = getattr(self, name)
            object.__setattr__(
                self, name, _from_json(name, value) if isinstance(value, str) else value
            )
        values = self.values()
        _require(_first_few(_shape_problems(values)))
        _require(_first_few(_value_problems(values)))
        for name in values.keys() & {f.name for f in dataclasses.fields(self)}:
            object.__setattr__(self, name, values[name])

    def __len__(self) -> int:
        return len(self.point_id)

    @property
    def patch_nodes(self) -> int:
        """Nodes along a patch's side."""
        return int(np.shape(self.dem)[1])

    def values(self) -> dict[str, Array]:
        """Every dataset of the file by its name there, in the schema's types."""
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
        found |= {"patch_row": _centred(shape[1]), "patch_col": _centred(shape[2])}
        found |= {name: np.arange(length) for name, length in _FIXED.items()}
        found["coverage/cell"] = np.arange(len(self.coverage.longitude))
        for group, variables in GROUPS.items():
            owner = getattr(self, group) if group else self
            for short, variable in variables.items():
                name = _key(group, short)
                found[name] = _typed(
                    name, found[name] if name in found else getattr(owner, short), variable.dtype
                )
        return found

    def attributes(self) -> dict[str, Any]:
        """The global attributes of the file, but for the digest of the content."""
        return {
            "Conventions": CONVENTIONS,
            "title": self.title,
            "product_version": self.product_version,
            "schema_version": SCHEMA_VERSION,
            "software": SOFTWARE,
            "software_version": self.software_version,
            "body": "MOON",
            "frame": FRAME,
            "reference_radius_m": MOON_RADIUS_M,
            "config": self.config,
            "sources": json.dumps(self.sources, sort_keys=True),
            "scene_plan": json.dumps(self.scene_plan, sort_keys=True),
        }

    def group_attributes(self) -> dict[str, dict[str, float]]:
        """Attributes of the groups by group and name."""
        return {
            group: {name: float(getattr(getattr(self, group), name)) for name in names}
            for group, names in GROUP_ATTRIBUTES.items()
        }


def _require(problem: str) -> None:
    if problem:
        raise CatalogError(f"not a catalogue: {problem}")


def _from_json(name: str, text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise CatalogError(f"not a catalogue: {name} is no JSON: {error}") from error


def _typed(name: str, value: Any, kind: str) -> Array:
    """The array in the schema's type; whole numbers are not made of others."""
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


def _digest(values: Values, attributes: dict[str, Any], groups: dict[str, dict[str, float]]) -> str:
    """SHA-256 over names, shapes and content, so that damage is noticed wherever HDF5 has no
    checksum of its own.
    """
    total = hashlib.sha256(json.dumps([attributes, groups], sort_keys=True).encode())
    for name in sorted(values):
        array = values[name]
        total.update(f"{name} {array.shape}".encode())
        text = array.dtype == object
        total.update(json.dumps(list(array.ravel())).encode() if text else array.tobytes())
    return total.hexdigest()


def _key(group: str, name: str) -> str:
    """Path of a variable inside the file."""
    return f"{group}/{name}" if group else name


def _variable_attributes(name: str, variable: Variable) -> dict[str, Any]:
    """Attributes of a variable: unit, meaning, and what CF readers need for flags, text and the
    views' angles.
    """
    found: dict[str, Any] = {"long_name": variable.long_name, "units": variable.units}
    if variable.dtype == TEXT:
        found["_Encoding"] = "utf-8"
    if name in ("longitude", "latitude"):
        found["standard_name"] = name
    if name == "condition":
        found |= {
            "flag_masks": np.array(FLAG_MASKS, np.uint8),
            "flag_meanings": " ".join(FLAG_MEANINGS),
        }
    if name == "status":
        codes = np.array(list(COVERAGE_STATUS), np.uint8)
        found |= {"flag_values": codes, "flag_meanings": " ".join(COVERAGE_STATUS.values())}
    if "view" in variable.dims and len(variable.dims) > 1:
        found["coordinates"] = "view_off_nadir view_azimuth view_altitude"
    return found


def _centred(count: int) -> NDArray[np.int32]:
    """Indices of a patch's nodes counted from its centre."""
    return np.arange(count, dtype=np.int32) - count // 2


def _first_few(lines: Iterable[str], count: int = 3) -> str:
    """Problems as one line."""
    lines = list(lines)
    rest = f"; and {len(lines) - count} more" if len(lines) > count else ""
    return "; ".join(lines[:count]) + rest


# -- conditions


def usable(condition: ArrayLike) -> NDArray[np.bool_]:
    """Where a condition has all five flags; any shape."""
    return np.asarray((np.asarray(condition) & USABLE) == USABLE)


def evaluated(condition: ArrayLike) -> NDArray[np.bool_]:
    """Where a condition was evaluated: the Sun comes there; any shape."""
    return np.asarray((np.asarray(condition) & EVALUATED) > 0)


def summarise_usable(condition: ArrayLike, sun_elevation: ArrayLike) -> tuple[Array, Array]:
    """Lowest and highest usable Sun elevation, each (point, view, sun_azimuth) in degrees; NaN
    where none is usable.

    condition: uint8 (point, view, sun_elevation, sun_azimuth).
    """
    works = usable(condition)
    elevation = np.asarray(sun_elevation, dtype=np.float64)[None, None, :, None]
    none = ~works.any(axis=2)
    lowest = np.where(works, elevation, np.inf).min(axis=2, initial=np.inf)
    highest = np.where(works, elevation, -np.inf).max(axis=2, initial=-np.inf)
    lowest[none] = highest[none] = np.nan
    return lowest, highest


# -- writing


def write_catalog(catalog: Catalog, path: Path | str, overwrite: bool = False) -> None:
    """Write the file; it appears under its name only when it is whole. Equal catalogues give
    equal bytes.

    Raises OutputExistsError and OutputError as `files.check_output` does.
    """
    check_output(path, overwrite)
    values, attributes, groups = catalog.values(), catalog.attributes(), catalog.group_attributes()
    attributes["content_sha256"] = _digest(values, attributes, groups)
    with _create() as file:
        file.attrs.update(attributes)
        for group, variables in GROUPS.items():
            _write_group(file, group, variables, values, groups)
        file.flush()
        image = file.id.get_file_image()
    write_bytes(path, image, overwrite)


def _write_group(
    file: h5py.File,
    group: str,
    variables: Mapping[str, Variable],
    values: Values,
    attributes: Mapping[str, Mapping[str, float]],
) -> None:
    place = file.create_group(group, track_order=True) if group else file
    place.attrs.update(attributes.get(group, {}))
    scales_first = sorted(variables, key=lambda name: variables[name].dims != (name,))
    for name in scales_first:
        _write_variable(place, name, variables[name], values[_key(group, name)])


def _create() -> h5py.File:
    """A file in memory: HDF5 leaves a file that it cannot write open, and crashes on it when the interpreter ends."""
    return h5py.File(
        "catalog",
        "w",
        driver="core",
        backing_store=False,
        libver=("earliest", "v110"),
        track_order=True,
    )


def _write_variable(place: h5py.Group, name: str, variable: Variable, array: Array) -> None:
    array = _as_bytes(array) if variable.dtype == TEXT else array
    dataset = place.create_dataset(
        name,
        data=array,
        chunks=_chunks(array),
        maxshape=tuple(
            length or None for length in array.shape
        ),  # HDF5 has no chunk for a fixed length of 0
        compression="gzip",
        compression_opts=4,
        shuffle=True,
        fletcher32=True,
        track_times=False,
    )
    for attribute, value in _variable_attributes(name, variable).items():
        dataset.attrs[attribute] = value
    if variable.dims == (name,):
        dataset.make_scale(name)
        return
    for axis, dim in enumerate(variable.dims):
        dataset.dims[axis].attach_scale(place[dim])


def _as_bytes(texts: Array) -> Array:
    """Text of a fixed length in bytes: unlike that of variable length it can be compressed and
    checksummed.
    """
    encoded = [text.encode() for text in texts]
    length = max((len(text) for text in encoded), default=1)
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(length, 1)))


def _chunks(array: Array) -> tuple[int, ...]:
    """Whole rows of the first axis, as many as fit into a chunk; long rows are halved along
    their longest axis.
    """
    shape = [max(1, length) for length in array.shape]
    shape[0] = max(
        1, min(shape[0], _CHUNK_BYTES // (array.itemsize * max(1, int(np.prod(shape[1:])))))
    )
    while int(np.prod(shape)) * array.itemsize > 4 * _CHUNK_BYTES:
        longest = shape.index(max(shape))
        shape[longest] = -(-shape[longest] // 2)
    return tuple(shape)


# -- reading


def read_catalog(path: Path | str) -> Catalog:
    """Read a catalogue whole. CatalogError, one line, when it is none or is damaged; `verify`
    says everything that is wrong.
    """
    with _opened(path) as file:
        problems = list(_identity_problems(file)) or list(_structure_problems(file))
        if problems:
            raise CatalogError(f"{path}: {_first_few(problems)}")
        try:
            values, attributes, groups = _values(file), _attributes(file), _group_attributes(file)
        except _HDF5_ERRORS as error:
            raise CatalogError(f"{path}: is damaged: {_line(error)}") from error
    problems = _shape_problems(values) or _value_problems(values)
    if problems:
        raise CatalogError(f"{path}: {_first_few(problems)}")
    try:
        return _catalog(values, attributes, groups)
    except CatalogError as error:
        raise CatalogError(f"{path}: {error}") from error


def _opened(path: Path | str) -> h5py.File:
    if not Path(path).is_file():
        raise CatalogError(f"{path}: there is no such file")
    try:
        return h5py.File(path, "r")
    except _HDF5_ERRORS as error:
        if isinstance(error, PermissionError):
            raise CatalogError(f"{path}: no permission to read it") from error
        raise CatalogError(f"{path}: not an HDF5 file, or cut short: {_line(error)}") from error


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _values(file: h5py.File) -> dict[str, Array]:
    return {
        _key(group, name): _read_variable(file[_key(group, name)], variable)
        for group, variables in GROUPS.items()
        for name, variable in variables.items()
    }


def _read_variable(dataset: h5py.Dataset, variable: Variable) -> Array:
    if variable.dtype != TEXT:
        return np.asarray(dataset[()])
    return np.array([bytes(text).decode("utf-8") for text in dataset[()]], dtype=object)


def _attributes(file: h5py.File) -> dict[str, Any]:
    found = {name: file.attrs[name] for name in GLOBAL_ATTRIBUTES}
    return {
        name: float(value) if name == "reference_radius_m" else str(value)
        for name, value in found.items()
    }


def _group_attributes(file: h5py.File) -> dict[str, dict[str, float]]:
    return {
        group: {name: float(file[group].attrs[name]) for name in names}
        for group, names in GROUP_ATTRIBUTES.items()
    }


def _catalog(
    values: Values, attributes: dict[str, Any], groups: dict[str, dict[str, float]]
) -> Catalog:
    texts = {
        name: attributes[name]
        for name in (
            "config",
            "sources",
            "scene_plan",
            "title",
            "product_version",
            "software_version",
        )
    }
    arrays: dict[str, Any] = {
        f.name: values[f.name] for f in dataclasses.fields(Catalog) if f.name in values
    }
    overview = Overview(
        height=values["overview/height"],
        x=values["overview/x"],
        y=values["overview/y"],
        **groups["overview"],
    )
    coverage = Coverage(
        longitude=values["coverage/longitude"],
        latitude=values["coverage/latitude"],
        status=values["coverage/status"],
        **groups["coverage"],
    )
    return Catalog(**arrays, **texts, overview=overview, coverage=coverage)


# -- verifying


def verify(path: Path | str) -> list[str]:
    """Everything that is wrong with a catalogue, one line each; empty when it is intact.

    Reads every dataset (and so checks its checksums), then looks at the schema, the digest of the
    content, and the values. Never raises for a bad file.
    """
    try:
        file = _opened(path)
    except CatalogError as error:
        return [str(error).removeprefix(f"{path}: ")]
    with file:
        return list(_identity_problems(file)) or _content_problems(file)


def _content_problems(file: h5py.File) -> list[str]:
    problems = list(_unreadable(file))
    structure = list(_structure_problems(file))
    if problems or structure:
        return problems + structure
    try:
        values, attributes, groups = _values(file), _attributes(file), _group_attributes(file)
        stated = attributes.pop("content_sha256")
        if _digest(values, attributes, groups) != stated:
            problems.append(
                "content_sha256: the content is not what was written (damaged or edited)"
            )
        shapes = _shape_problems(values)
        return problems + (shapes or _value_problems(values)) + list(_text_problems(attributes))
    except _HDF5_ERRORS as error:
        return [*problems, f"is damaged: {_line(error)}"]


def _identity_problems(file: h5py.File) -> Iterator[str]:
    """Whether the file is a catalogue of a version that is understood; when not, nothing else is
    worth saying.
    """
    try:
        version = file.attrs.get("schema_version")
        body = file.attrs.get("body")
    except _HDF5_ERRORS as error:
        yield f"its attributes cannot be read: {_line(error)}"
        return
    if not isinstance(version, str) or body is None:
        yield "not a catalogue of control points: it has no schema_version and body"
    elif version.split(".")[0] != SCHEMA_VERSION.split(".")[0]:
        yield f"schema version {version} is not understood here ({SCHEMA_VERSION}); use a newer lcp"


def _unreadable(file: h5py.File) -> Iterator[str]:
    """Datasets whose bytes do not pass their checksums, whether the schema knows them or not."""
    names: list[str] = []
    try:
        file.visit(names.append)
    except _HDF5_ERRORS as error:
        yield f"the file's structure is damaged: {_line(error)}"
    for name in names:
        try:
            item = file[name]
            if isinstance(item, h5py.Dataset):
                item[()]
        except _HDF5_ERRORS as error:
            yield f"{name}: cannot be read: {_line(error)}"


def _structure_problems(file: h5py.File) -> Iterator[str]:
    """Attributes and variables that are missing or are not what the schema says."""
    for name in GLOBAL_ATTRIBUTES:
        if not _has_attribute(file, name):
            yield f"the attribute {name} is missing"
    for group, variables in GROUPS.items():
        place = file.get(group) if group else file
        if not isinstance(place, h5py.Group):
            yield f"{group}: the group is missing"
            continue
        for name in GROUP_ATTRIBUTES.get(group, ()):
            if not _has_attribute(place, name):
                yield f"{group}: the attribute {name} is missing"
        for name, variable in variables.items():
            try:
                yield from _variable_problems(place, name, variable, _key(group, name))
            except _HDF5_ERRORS as error:
                yield f"{_key(group, name)}: is damaged: {_line(error)}"


def _has_attribute(place: h5py.Group, name: str) -> bool:
    try:
        return place.attrs.get(name) is not None
    except _HDF5_ERRORS:
        return False


def _variable_problems(
    place: h5py.Group, short: str, variable: Variable, name: str
) -> Iterator[str]:
    dataset = place.get(short)
    if not isinstance(dataset, h5py.Dataset):
        yield f"{name}: the variable is missing"
        return
    text = h5py.check_string_dtype(dataset.dtype)
    kind = TEXT if text is not None and text.length else dataset.dtype.str.lstrip("<|")
    if kind != variable.dtype:
        yield f"{name}: holds {kind} instead of {variable.dtype}"
    if not dataset.fletcher32:
        yield f"{name}: has no checksums"
    dims = _dims(dataset)
    if dims != variable.dims:
        wanted = ", ".join(variable.dims)
        yield f"{name}: has the dimensions ({', '.join(dims)}) instead of ({wanted})"
    for attribute, expected in _variable_attributes(short, variable).items():
        found = dataset.attrs.get(attribute)
        if not np.array_equal(found, expected):
            yield f"{name}: {attribute} is {found!s} instead of {expected!s}"


def _dims(dataset: h5py.Dataset) -> tuple[str, ...]:
    """Names of the dimension scales; a scale is its own, ``?`` where none is attached."""
    if dataset.is_scale:
        return (dataset.name.rsplit("/", 1)[-1],)
    return tuple(dim[0].name.rsplit("/", 1)[-1] if len(dim) else "?" for dim in dataset.dims)


def _text_problems(attributes: dict[str, Any]) -> Iterator[str]:
    if (
        attributes["reference_radius_m"] != MOON_RADIUS_M
        or attributes["body"] != "MOON"
        or attributes["frame"] != FRAME
    ):
        yield f"body, frame or reference_radius_m are not MOON, {FRAME}, {MOON_RADIUS_M:g}"
    for name in ("sources", "scene_plan"):
        try:
            json.loads(attributes[name])
        except json.JSONDecodeError:
            yield f"{name}: is no JSON"


# -- values


def _shape_problems(values: Values) -> list[str]:
    """Dimensions that have different lengths in different variables, or a wrong number of
    dimensions.
    """
    lines: list[str] = []
    for group, variables in GROUPS.items():
        lengths = dict(_FIXED)
        for short, variable in variables.items():
            name = _key(group, short)
            array = values[name]
            if array.ndim != len(variable.dims):
                lines.append(
                    f"{name}: {array.ndim} dimensions instead of ({', '.join(variable.dims)})"
                )
                continue
            for dim, length in zip(variable.dims, array.shape, strict=True):
                if lengths.setdefault(dim, length) != length:
                    lines.append(f"{name}: {length} along {dim} where others have {lengths[dim]}")
    return lines


def _value_problems(values: Values) -> list[str]:
    """What is wrong with the values, one line each; the shapes must fit together already."""
    return [line for check in _CHECKS for line in check(values)]


def _where(name: str, wrong: NDArray[np.bool_], text: str) -> list[str]:
    """A line about the values of a variable that are wrong, if any."""
    count = int(np.count_nonzero(wrong))
    if not count:
        return []
    first = ", ".join(str(int(index[0])) for index in np.nonzero(wrong))
    return [f"{name}: {text} ({count} of {wrong.size}; the first at [{first}])"]


def _outside(values: Values, name: str, low: float, high: float) -> list[str]:
    array = values[name]
    return _where(name, ~((array >= low) & (array <= high)), f"not in {low:g}..{high:g}")


def _check_axes(values: Values) -> Iterator[str]:
    for name in ("point", "view", "coverage/cell", *_FIXED):
        if not np.array_equal(values[name], np.arange(len(values[name]))):
            yield f"{name}: is not 0, 1, 2, ..."
    for name in ("patch_row", "patch_col"):
        if not np.array_equal(values[name], _centred(len(values[name]))):
            yield f"{name}: does not count from the patch's centre"
    for name, sign in (
        ("sun_elevation", 1),
        ("sun_azimuth", 1),
        ("overview/x", 1),
        ("overview/y", -1),
    ):
        if not (np.isfinite(values[name]).all() and (np.diff(values[name]) * sign > 0).all()):
            yield f"{name}: is not strictly {'rising' if sign > 0 else 'falling'}"
    yield from _outside(values, "sun_elevation", 0.0, 90.0)
    yield from _outside(values, "sun_azimuth", 0.0, 360.0)
    yield from _outside(values, "view_off_nadir", 0.0, 90.0)
    yield from _outside(values, "view_azimuth", 0.0, 360.0)
    yield from _where("view_altitude", ~(values["view_altitude"] > 0.0), "not above 0")


def _check_places(values: Values) -> Iterator[str]:
    lon, lat, height = values["longitude"], values["latitude"], values["elevation"]
    yield from _where("longitude", ~((lon >= 0.0) & (lon < 360.0)), "not in 0..360")
    yield from _outside(values, "latitude", -90.0, 90.0)
    yield from _outside(values, "elevation", -_ELEVATION_LIMIT_M, _ELEVATION_LIMIT_M)
    repeated = len(values["point_id"]) - len(np.unique(values["point_id"]))
    if repeated:
        yield f"point_id: {repeated} numbers occur more than once"
    away = np.abs(values["position_mcmf"] - lonlat_to_mcmf(lon, lat, height)).max(
        axis=1, initial=0.0
    )
    wrong = ~(away <= _PLACE_TOLERANCE_M)
    yield from _where(
        "position_mcmf", wrong, "is not the place of longitude, latitude and elevation"
    )


def _check_rotations(values: Values) -> Iterator[str]:
    rotation, places = values["rotation_mcmf_to_enu"], (values["longitude"], values["latitude"])
    expected = np.array([enu_rotation(lon, lat) for lon, lat in zip(*places, strict=True)]).reshape(
        -1, 3, 3
    )
    skew = np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    turned = np.abs(rotation - expected).max(axis=(1, 2), initial=0.0)
    yield from _where("rotation_mcmf_to_enu", ~(skew <= _ROTATION_TOLERANCE), "is not orthonormal")
    wrong = ~(turned <= _ROTATION_TOLERANCE)
    yield from _where("rotation_mcmf_to_enu", wrong, "is not the frame of longitude and latitude")


def _check_patches(values: Values) -> Iterator[str]:
    dem = values["dem"]
    rows, cols = dem.shape[1:]
    if not (rows == cols and rows % 2 == 1):
        yield f"dem: patches of {rows} x {cols} nodes have no centre node"
        return
    yield from _where("dem", ~np.isfinite(dem), "not a number")
    off = ~(np.abs(dem[:, rows // 2, cols // 2]) <= _CENTRE_TOLERANCE_M)
    yield from _where("dem", off, "the centre node is not at 0")
    yield from _where(
        "dem_product", np.array([not text for text in values["dem_product"]], bool), "is empty"
    )


def _check_resolutions(values: Values) -> Iterator[str]:
    for name in ("gsd", "gsd_min", "gsd_max"):
        yield from _where(
            name, ~((values[name] > 0.0) & np.isfinite(values[name])), "not a positive number"
        )
    slack = 1.0 + 1e-9
    yield from _where("gsd_min", values["gsd_min"] > values["gsd"] * slack, "above gsd")
    yield from _where("gsd_max", values["gsd_max"] * slack < values["gsd"], "below gsd")


def _check_conditions(values: Values) -> Iterator[str]:
    condition = values["condition"]
    yield from _where("condition", condition > USABLE, "has bits that mean nothing")
    yield from _where(
        "condition", (condition > 0) & ~evaluated(condition), "has flags without 'evaluated'"
    )
    summary = summarise_usable(condition, values["sun_elevation"])
    for name, expected in zip(("sun_elevation_min", "sun_elevation_max"), summary, strict=True):
        same = np.isclose(values[name], expected, rtol=0.0, atol=1e-9, equal_nan=True)
        yield from _where(name, ~same, "does not agree with condition")


def _check_figures(values: Values) -> Iterator[str]:
    """Figures are numbers in their ranges; NaN is allowed for a point that is usable under no
    condition.
    """
    some = usable(values["condition"]).any(axis=(1, 2, 3))
    shares = ("false_match_probability", "shadow_dependence", "occlusion_dependence")
    limits = {name: (0.0, 1.0) for name in shares} | {
        "second_peak": (-1.0, 1.0),
        "harris_response": (0.0, np.inf),
        "localization_sigma": (0.0, np.inf),
    }
    for name, (low, high) in limits.items():
        array = values[name]
        known = some.reshape(-1, *[1] * (array.ndim - 1))
        within = np.isfinite(array) & (array >= low - 1e-6) & (array <= high + 1e-6)
        yield from _where(name, ~within & ~(np.isnan(array) & ~known), f"not in {low:g}..{high:g}")
    sigma = values["localization_sigma"]
    yield from _where(
        "localization_sigma", sigma[:, 0] < sigma[:, 1], "the major axis is below the minor"
    )


def _check_groups(values: Values) -> Iterator[str]:
    unknown = ~np.isin(values["coverage/status"], list(COVERAGE_STATUS))
    yield from _where("coverage/status", unknown, "has no meaning")
    yield from _outside(values, "coverage/latitude", -90.0, 90.0)
    yield from _outside(values, "coverage/longitude", -360.0, 720.0)
    yield from _where("overview/height", np.isinf(values["overview/height"]), "infinite")


_CHECKS = (
    _check_axes,
    _check_places,
    _check_rotations,
    _check_patches,
    _check_resolutions,
    _check_conditions,
    _check_figures,
    _check_groups,
)
