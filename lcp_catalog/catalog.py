"""The catalogue as an HDF5 file that is also netCDF-4: write, read, verify. Nothing else knows HDF5."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ._version import __version__
from .constants import FRAME, MOON_RADIUS_M
from .errors import CatalogError
from .files import check_output, write_aside
from .schema import (
    AXES,
    GLOBAL_ATTRIBUTES,
    GROUP_ATTRIBUTES,
    GROUPS,
    SCHEMA_VERSION,
    TEXT,
    Values,
    Variable,
    centred,
    first_few,
    key,
    shape_problems,
    summarise_usable,
    usable,
    value_problems,
)

__all__ = [
    "SCHEMA_VERSION",
    "Catalog",
    "Coverage",
    "Overview",
    "read_catalog",
    "summarise_usable",
    "usable",
    "verify",
    "write_catalog",
]

CONVENTIONS = "CF-1.11"
SOFTWARE = "lcp-catalog"

_CHUNK_BYTES = 2**18
_HDF5_ERRORS = (OSError, RuntimeError, ValueError, KeyError, TypeError, AttributeError, OverflowError, MemoryError)
"""What h5py raises on a file that is damaged where it pleases."""

Array = NDArray[Any]


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
    """Every spacing cell of the region: whether a point is near, or why there is none (`schema.STATUSES`)."""

    longitude: Array  # (cell,) degrees
    latitude: Array
    status: Array  # (cell,) uint8
    spacing_m: float


@dataclass(frozen=True, eq=False)
class Catalog:
    """A catalogue in memory: the variables of the file under their own names (units in docs/catalogue.md).

    n points, patches of p x p nodes, v views, e Sun elevations, a Sun azimuths. Arrays are converted to the schema's types; what does
    not fit together or is out of range is a CatalogError. ``sources`` (a list of name, size, sha256) and ``scene_plan`` may be given
    as JSON text.
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
    sun_elevation_min: Array  # (n, v, a) float32 degrees, NaN: never usable
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
            object.__setattr__(self, name, _from_json(name, value) if isinstance(value, str) else value)
        values = self.values()
        _require(first_few(shape_problems(values)))
        _require(first_few(value_problems(values)))
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
        found: dict[str, Any] = {"point": np.arange(len(self.point_id)), "view": np.arange(len(self.view_off_nadir))}
        shape = np.shape(self.dem)
        _require("" if len(shape) == 3 else f"dem: {len(shape)} dimensions instead of (point, patch_row, patch_col)")
        found |= {"patch_row": centred(shape[1]), "patch_col": centred(shape[2])}
        found |= {name: np.array(labels, dtype=object) for name, labels in AXES.items()}
        found["coverage/cell"] = np.arange(len(self.coverage.longitude))
        for group, variables in GROUPS.items():
            owner = getattr(self, group) if group else self
            for variable in variables:
                name = key(group, variable.name)
                found[name] = _typed(name, found[name] if name in found else getattr(owner, variable.name), variable.kind)
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
        return np.array([str(text) for text in np.asarray(value).ravel()], dtype=object).reshape(np.shape(value))
    array = np.asarray(value)
    target = np.dtype(kind)
    _require("" if array.dtype.kind in "biuf" else f"{name}: holds {array.dtype}, not numbers")
    if target.kind in "iu" and array.size:
        info = np.iinfo(target)
        _require("" if array.dtype.kind in "biu" else f"{name}: holds {array.dtype}, not whole numbers")
        fits = info.min <= int(array.min()) and int(array.max()) <= info.max
        _require("" if fits else f"{name}: does not fit into {kind}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array.astype(target))


def _digest(values: Values, attributes: dict[str, Any], groups: dict[str, dict[str, float]]) -> str:
    """SHA-256 over names, shapes and content, so that damage is noticed wherever HDF5 has no checksum of its own."""
    total = hashlib.sha256(json.dumps([attributes, groups], sort_keys=True).encode())
    for name in sorted(values):
        array = values[name]
        total.update(f"{name} {array.shape}".encode())
        text = array.dtype == object
        total.update(json.dumps(list(array.ravel())).encode() if text else array.tobytes())
    return total.hexdigest()


# -- writing


def write_catalog(catalog: Catalog, path: Path | str, overwrite: bool = False) -> None:
    """Write the file; it appears under its name only when it is whole. Equal catalogues give equal bytes.

    Raises OutputExistsError and OutputError as `files.check_output` does.
    """
    check_output(path, overwrite)
    values, attributes, groups = catalog.values(), catalog.attributes(), catalog.group_attributes()
    attributes["content_sha256"] = _digest(values, attributes, groups)
    with write_aside(path, overwrite) as aside, _create(aside) as file:
        file.attrs.update(attributes)
        for group, variables in GROUPS.items():
            place = file.create_group(group, track_order=True) if group else file
            place.attrs.update(groups.get(group, {}))
            for variable in variables:
                _write_variable(place, variable, values[key(group, variable.name)])


def _create(path: Path) -> h5py.File:
    return h5py.File(path, "w", libver=("earliest", "v110"), track_order=True)


def _write_variable(place: h5py.Group, variable: Variable, array: Array) -> None:
    array = _as_bytes(array) if variable.kind == TEXT else array
    dataset = place.create_dataset(
        variable.name,
        data=array,
        chunks=_chunks(array),
        maxshape=tuple(length or None for length in array.shape),  # HDF5 has no chunk for a fixed length of 0
        compression="gzip",
        compression_opts=4,
        shuffle=True,
        fletcher32=True,
        track_times=False,
    )
    for name, value in variable.attributes.items():
        dataset.attrs[name] = value
    if variable.dims == (variable.name,):
        dataset.make_scale(variable.name)
        return
    for axis, dim in enumerate(variable.dims):
        dataset.dims[axis].attach_scale(place[dim])


def _as_bytes(texts: Array) -> Array:
    """Text of a fixed length in bytes: unlike that of variable length it can be compressed and checksummed."""
    encoded = [text.encode() for text in texts]
    length = max((len(text) for text in encoded), default=1)
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(length, 1)))


def _chunks(array: Array) -> tuple[int, ...]:
    """Whole rows of the first axis, as many as fit into a chunk; long rows are halved along their longest axis."""
    shape = [max(1, length) for length in array.shape]
    shape[0] = max(1, min(shape[0], _CHUNK_BYTES // (array.itemsize * max(1, int(np.prod(shape[1:]))))))
    while int(np.prod(shape)) * array.itemsize > 4 * _CHUNK_BYTES:
        longest = shape.index(max(shape))
        shape[longest] = -(-shape[longest] // 2)
    return tuple(shape)


# -- reading


def read_catalog(path: Path | str) -> Catalog:
    """Read a catalogue whole. CatalogError, one line, when it is none or is damaged; `verify` says everything that is wrong."""
    with _opened(path) as file:
        problems = list(_identity_problems(file)) or list(_structure_problems(file))
        if problems:
            raise CatalogError(f"{path}: {first_few(problems)}")
        try:
            values, attributes, groups = _values(file), _attributes(file), _group_attributes(file)
        except _HDF5_ERRORS as error:
            raise CatalogError(f"{path}: is damaged: {_line(error)}") from error
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
        key(group, variable.name): _read_variable(file[key(group, variable.name)], variable)
        for group, variables in GROUPS.items()
        for variable in variables
    }


def _read_variable(dataset: h5py.Dataset, variable: Variable) -> Array:
    if variable.kind != TEXT:
        return np.asarray(dataset[()])
    return np.array([bytes(text).decode("utf-8") for text in dataset[()]], dtype=object)


def _attributes(file: h5py.File) -> dict[str, Any]:
    found = {name: file.attrs[name] for name in GLOBAL_ATTRIBUTES}
    return {name: float(value) if name == "reference_radius_m" else str(value) for name, value in found.items()}


def _group_attributes(file: h5py.File) -> dict[str, dict[str, float]]:
    return {group: {name: float(file[group].attrs[name]) for name in names} for group, names in GROUP_ATTRIBUTES.items()}


def _catalog(values: Values, attributes: dict[str, Any], groups: dict[str, dict[str, float]]) -> Catalog:
    texts = {name: attributes[name] for name in ("config", "sources", "scene_plan", "title", "product_version", "software_version")}
    arrays = {f.name: values[f.name] for f in dataclasses.fields(Catalog) if f.name in values}
    overview = Overview(
        height=values["overview/height"], x=values["overview/x"], y=values["overview/y"], **groups["overview"]
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

    Reads every dataset (and so checks its checksums), then schema, digest of the content, and values. Never raises for a bad file.
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
            problems.append("content_sha256: the content is not what was written (damaged or edited)")
        shapes = shape_problems(values)
        return problems + (shapes or value_problems(values)) + list(_text_problems(attributes))
    except _HDF5_ERRORS as error:
        return [*problems, f"is damaged: {_line(error)}"]


def _identity_problems(file: h5py.File) -> Iterator[str]:
    """Whether the file is a catalogue of a version that is understood; when not, nothing else is worth saying."""
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
        for variable in variables:
            try:
                yield from _variable_problems(place, variable, key(group, variable.name))
            except _HDF5_ERRORS as error:
                yield f"{key(group, variable.name)}: is damaged: {_line(error)}"


def _has_attribute(place: h5py.Group, name: str) -> bool:
    try:
        return place.attrs.get(name) is not None
    except _HDF5_ERRORS:
        return False


def _variable_problems(place: h5py.Group, variable: Variable, name: str) -> Iterator[str]:
    dataset = place.get(variable.name)
    if not isinstance(dataset, h5py.Dataset):
        yield f"{name}: the variable is missing"
        return
    text = h5py.check_string_dtype(dataset.dtype)
    kind = TEXT if text is not None and text.length else str(dataset.dtype)
    if kind != variable.kind:
        yield f"{name}: holds {kind} instead of {variable.kind}"
    if not dataset.fletcher32:
        yield f"{name}: has no checksums"
    dims = _dims(dataset)
    if dims != variable.dims:
        yield f"{name}: has the dimensions ({', '.join(dims)}) instead of ({', '.join(variable.dims)})"
    for attribute, expected in variable.attributes.items():
        found = dataset.attrs.get(attribute)
        if not np.array_equal(found, expected):
            yield f"{name}: {attribute} is {found!s} instead of {expected!s}"


def _dims(dataset: h5py.Dataset) -> tuple[str, ...]:
    """Names of the dimension scales; a scale is its own, ``?`` where none is attached."""
    if dataset.is_scale:
        return (dataset.name.rsplit("/", 1)[-1],)
    return tuple(dim[0].name.rsplit("/", 1)[-1] if len(dim) else "?" for dim in dataset.dims)


def _text_problems(attributes: dict[str, Any]) -> Iterator[str]:
    if attributes["reference_radius_m"] != MOON_RADIUS_M or attributes["body"] != "MOON" or attributes["frame"] != FRAME:
        yield f"body, frame or reference_radius_m are not MOON, {FRAME}, {MOON_RADIUS_M:g}"
    for name in ("sources", "scene_plan"):
        try:
            json.loads(attributes[name])
        except json.JSONDecodeError:
            yield f"{name}: is no JSON"
