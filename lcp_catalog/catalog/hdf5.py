"""The catalogue as an HDF5 file that is also netCDF-4: write, open, verify. The only module that
uses h5py.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..arrays import AnyArray
from ..atomic_files import check_output, write_bytes
from ..errors import CatalogError
from .catalogue import Catalog, Coverage, Overview, catalog_of
from .checks import claim_problems, first_few, shape_problems, text_problems, value_problems
from .layout import (
    CLAIM_ATTRIBUTES,
    GLOBAL_ATTRIBUTES,
    GROUP_ATTRIBUTES,
    GROUPS,
    NUMBERS,
    OPTIONAL_ATTRIBUTES,
    TEXT,
    Values,
    digest,
    is_claim,
    key,
    split,
    variable_attributes,
)
from .schema import ADDED_IN_1_1, FORMER_NAMES, OPTIONAL, SCHEMA_VERSION, Variable

__all__ = [
    "SCHEMA_VERSION",
    "Catalog",
    "Coverage",
    "Overview",
    "open_catalog",
    "verify",
    "write_catalog",
]

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
"""Errors that h5py raises for damaged files."""


# -- writing


def write_catalog(catalog: Catalog, path: Path | str, overwrite: bool = False) -> None:
    """Write the file; it appears under its name only when it is complete. Equal catalogues give
    equal bytes.

    Raises OutputExistsError and OutputError as `atomic_files.check_output` does.
    """
    check_output(path, overwrite)
    values, attributes, groups = catalog.values(), catalog.attributes(), catalog.group_attributes()
    attributes |= _digests(values, attributes, groups, catalog.optional_attributes())
    with _create() as file:
        file.attrs.update(attributes)
        for group, variables in GROUPS.items():
            step = float(attributes.get("sigma_step_m", 1.0))
            _write_group(file, group, variables, values, groups, step)
        file.flush()
        image = file.id.get_file_image()
    write_bytes(path, image, overwrite)


def _write_group(
    file: h5py.File,
    group: str,
    variables: Mapping[str, Variable],
    values: Values,
    attributes: Mapping[str, Mapping[str, float]],
    sigma_step_m: float,
) -> None:
    place = file.create_group(group, track_order=True) if group else file
    place.attrs.update(attributes.get(group, {}))
    present = [name for name in variables if key(group, name) in values]
    scales_first = sorted(present, key=lambda name: variables[name].dims != (name,))
    for name in scales_first:
        found = variable_attributes(name, variables[name], sigma_step_m)
        _write_variable(place, name, variables[name], values[key(group, name)], found)


def _create() -> h5py.File:
    """A file in memory: HDF5 leaves a file that it cannot write open, and crashes on it when the
    interpreter exits.
    """
    return h5py.File(
        "catalog",
        "w",
        driver="core",
        backing_store=False,
        libver=("earliest", "v110"),
        track_order=True,
    )


def _write_variable(
    place: h5py.Group,
    name: str,
    variable: Variable,
    array: AnyArray,
    attributes: Mapping[str, Any],
) -> None:
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
        fillvalue=attributes.get("_FillValue"),
    )
    for attribute, value in attributes.items():
        dataset.attrs[attribute] = value
    if variable.dims == (name,):
        dataset.make_scale(name)
        return
    for axis, dim in enumerate(variable.dims):
        dataset.dims[axis].attach_scale(place[dim] if dim in place else place.file[dim])


def _as_bytes(texts: AnyArray) -> AnyArray:
    """Text of fixed length in bytes, which, unlike text of variable length, can be compressed and
    checksummed.
    """
    encoded = [text.encode() for text in texts]
    length = max((len(text) for text in encoded), default=1)
    return np.array(encoded, dtype=h5py.string_dtype("utf-8", max(length, 1)))


def _chunks(array: AnyArray) -> tuple[int, ...]:
    """Whole rows of the first axis, as many as fit into a chunk; long rows are halved along their
    longest axis.
    """
    shape = [max(1, length) for length in array.shape]
    shape[0] = max(
        1, min(shape[0], _CHUNK_BYTES // (array.itemsize * max(1, int(np.prod(shape[1:])))))
    )
    while int(np.prod(shape)) * array.itemsize > 4 * _CHUNK_BYTES:
        longest = shape.index(max(shape))
        shape[longest] = -(-shape[longest] // 2)
    return tuple(shape)


def _digests(
    values: Values,
    attributes: dict[str, Any],
    groups: dict[str, dict[str, float]],
    optional: dict[str, Any],
) -> dict[str, Any]:
    """The attributes that only some catalogues have, and the digests of the common and of the
    optional content.
    """
    plain, extra = split(values)
    found: dict[str, Any] = {"content_sha256": digest(plain, attributes, groups)}
    if optional:
        found |= optional | {"albedo_sha256": digest(extra, optional, {})}
    return found


# -- reading


def open_catalog(path: Path | str) -> Catalog:
    """Read a whole catalogue into memory. CatalogError, one line, for a file that is no catalogue
    or is damaged; `verify` lists all its problems.
    """
    with _opened(path) as file:
        problems = list(_identity_problems(file)) or list(_structure_problems(file))
        if problems:
            raise CatalogError(f"{path}: {first_few(problems)}")
        try:
            values, attributes, groups = _values(file), _attributes(file), _group_attributes(file)
        except _HDF5_ERRORS as error:
            raise CatalogError(f"{path}: is damaged: {_line(error)}") from error
    values = _completed(values)
    problems = shape_problems(values) or _all_value_problems(values, attributes)
    if problems:
        raise CatalogError(f"{path}: {first_few(problems)}")
    try:
        return catalog_of(values, attributes, groups)
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


def _values(file: h5py.File) -> dict[str, AnyArray]:
    return {
        key(group, name): _read_variable(file[key(group, name)], variable)
        for group, variables in GROUPS.items()
        for name, variable in variables.items()
        if not _is_absent(file, key(group, name))
    }


def _is_absent(file: h5py.File, name: str) -> bool:
    """True for a variable that the file lacks because of its schema version, or because the
    catalogue was built without it.
    """
    if name in OPTIONAL:
        return not (_has_variable(file, name) or _has_attribute(file, "albedo_map"))
    if is_claim(name):
        return not _states_claims(file)
    return name in ADDED_IN_1_1 and file.attrs.get("schema_version") == "1.0"


def _states_claims(file: h5py.File) -> bool:
    return not str(file.attrs.get("schema_version")).startswith("1.")


def _completed(values: dict[str, AnyArray]) -> dict[str, AnyArray]:
    """The values, with NaN for variables that an older file lacks."""
    unknown = np.full(len(values["point_id"]), np.nan)
    return dict.fromkeys(ADDED_IN_1_1, unknown) | values


def _read_variable(dataset: h5py.Dataset, variable: Variable) -> AnyArray:
    if variable.dtype != TEXT:
        return np.asarray(dataset[()])
    return np.array([bytes(text).decode("utf-8") for text in dataset[()]], dtype=object)


def _attributes(file: h5py.File) -> dict[str, Any]:
    found = {name: file.attrs[name] for name in GLOBAL_ATTRIBUTES}
    some = (*OPTIONAL_ATTRIBUTES, *CLAIM_ATTRIBUTES)
    found |= {name: file.attrs[name] for name in some if name in file.attrs}
    return {name: float(value) if name in NUMBERS else str(value) for name, value in found.items()}


def _group_attributes(file: h5py.File) -> dict[str, dict[str, float]]:
    return {
        group: {name: float(file[group].attrs[name]) for name in names}
        for group, names in GROUP_ATTRIBUTES.items()
    }


# -- verifying


def verify(path: Path | str) -> list[str]:
    """All problems of a catalogue, one line each; empty if it is intact.

    Reads every dataset, which checks its checksums, then checks the schema, the digest of the
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
        problems += _digest_problems(values, attributes, groups)
        values = _completed(values)
        shapes = shape_problems(values)
        texts = list(text_problems(attributes))
        return problems + (shapes or _all_value_problems(values, attributes)) + texts
    except _HDF5_ERRORS as error:
        return [*problems, f"is damaged: {_line(error)}"]


def _all_value_problems(values: Values, attributes: Mapping[str, Any]) -> list[str]:
    """Problems of the values, of the claims too if the file has them."""
    problems = value_problems(values)
    if "detection_probability" in values:
        problems += claim_problems(values, _errors(attributes))
    return problems


def _errors(attributes: Mapping[str, Any]) -> Any:
    """The error model, None if it is not JSON."""
    try:
        return json.loads(attributes["errors"])
    except json.JSONDecodeError:
        return None


def _digest_problems(
    values: Values, attributes: dict[str, Any], groups: dict[str, dict[str, float]]
) -> list[str]:
    """Digests that differ from those of the content."""
    optional = {name: attributes[name] for name in ("albedo_map",) if name in attributes}
    own = ("content_sha256", *OPTIONAL_ATTRIBUTES)
    plain = {name: value for name, value in attributes.items() if name not in own}
    return [
        f"{name}: the content is not what was written (damaged or edited)"
        for name, found in _digests(values, plain, groups, optional).items()
        if name.endswith("_sha256") and found != attributes.get(name)
    ]


def _identity_problems(file: h5py.File) -> Iterator[str]:
    """A problem if the file is no catalogue of a supported version; then nothing else is checked."""
    try:
        version = file.attrs.get("schema_version")
        body = file.attrs.get("body")
    except _HDF5_ERRORS as error:
        yield f"its attributes cannot be read: {_line(error)}"
        return
    if not isinstance(version, str) or body is None:
        yield "not a catalogue of control points: it has no schema_version and body"
    elif version.split(".")[0] not in ("1", SCHEMA_VERSION.split(".")[0]):
        yield f"schema version {version} is not understood here ({SCHEMA_VERSION}); use a newer lcp"


def _unreadable(file: h5py.File) -> Iterator[str]:
    """Datasets whose bytes do not match their checksums, in the schema or not."""
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
    """Attributes and variables that are missing or differ from the schema."""
    wanted = (
        *GLOBAL_ATTRIBUTES,
        *(OPTIONAL_ATTRIBUTES if _has_variable(file, "albedo") else ()),
        *(CLAIM_ATTRIBUTES if _states_claims(file) else ()),
    )
    yield from (f"the attribute {n} is missing" for n in wanted if not _has_attribute(file, n))
    for group, variables in GROUPS.items():
        place = file.get(group) if group else file
        if not isinstance(place, h5py.Group):
            yield f"{group}: the group is missing"
            continue
        for name in GROUP_ATTRIBUTES.get(group, ()):
            if not _has_attribute(place, name):
                yield f"{group}: the attribute {name} is missing"
        for name, variable in variables.items():
            if _is_absent(file, key(group, name)):
                continue
            try:
                expected = variable_attributes(name, variable, _sigma_step(file))
                yield from _variable_problems(place, name, variable, expected)
            except _HDF5_ERRORS as error:
                yield f"{key(group, name)}: is damaged: {_line(error)}"


def _has_variable(file: h5py.File, name: str) -> bool:
    """True if the variable exists, damaged or not."""
    try:
        return name in file
    except _HDF5_ERRORS:
        return True


def _has_attribute(place: h5py.Group, name: str) -> bool:
    try:
        return place.attrs.get(name) is not None
    except _HDF5_ERRORS:
        return False


def _sigma_step(file: h5py.File) -> float:
    """Step of stored sigmas, 1 for a file without claims or with a damaged attribute."""
    try:
        return float(file.attrs["sigma_step_m"])
    except _HDF5_ERRORS:
        return 1.0


def _variable_problems(
    place: h5py.Group, short: str, variable: Variable, attributes: Mapping[str, Any]
) -> Iterator[str]:
    name = key(place.name.strip("/"), short)
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
    for attribute, expected in attributes.items():
        found = dataset.attrs.get(attribute)
        former = FORMER_NAMES.get(name, ()) if attribute == "long_name" else ()
        if isinstance(found, str) and found in former:
            continue
        if not np.array_equal(found, expected):
            yield f"{name}: {attribute} is {found!s} instead of {expected!s}"


def _dims(dataset: h5py.Dataset) -> tuple[str, ...]:
    """Names of the dimension scales; a scale is its own, ``?`` if none is attached."""
    if dataset.is_scale:
        return (dataset.name.rsplit("/", 1)[-1],)
    return tuple(dim[0].name.rsplit("/", 1)[-1] if len(dim) else "?" for dim in dataset.dims)
