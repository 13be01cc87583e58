"""The structure of a catalogue's file, judged by known names and by sizes before any value is read:
what it links to, how it is stored, and how much it claims to hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import prod
from typing import Any

import h5py
import numpy as np

from ..geometry.map_plane import ORTHOGRAPHIC
from .checks import shape_problems
from .layout import (
    CLAIM_ATTRIBUTES,
    CRS,
    GLOBAL_ATTRIBUTES,
    GROUP_ATTRIBUTES,
    GROUPS,
    LEVEL,
    NUMBERS,
    OPTIONAL_ATTRIBUTES,
    OPTIONAL_GROUP_ATTRIBUTES,
    TEXT,
    former_attributes,
    grid_mapping,
    key,
    variable_attributes,
    without_level,
)
from .schema import (
    ADDED_IN_1_1,
    CLAIMS,
    FORMER_NAMES,
    OPTIONAL,
    OPTIONAL_GROUPS,
    SCHEMA_VERSION,
    WITHOUT_PLACES,
    Variable,
)

HDF5_ERRORS = (
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

_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}

_DEFLATE_MOST = 1100
"""Bytes that a byte of deflated data can hold, 1032, and some."""

_CHUNK_BYTES_MAX = 2**26

_ATTRIBUTE_BYTES_MAX = 2**16
"""Most bytes of an attribute in its object; HDF5 keeps long texts elsewhere."""


def line_of(error: BaseException) -> str:
    """An error as one line."""
    return " ".join(str(error).split()) or type(error).__name__


def structure_problems(file: h5py.File, file_bytes: int) -> list[str]:
    """All problems of the structure, one line each. Of a file that is no catalogue of a supported
    version the only one.
    """
    foreign = list(_identity_problems(file))
    if foreign:
        return foreign
    problems = list(_attribute_problems(file, "", _wanted(file)))
    shapes: dict[str, tuple[int, ...]] = {}
    step, wanted = _sigma_step(file), variables(file)
    placed = file.attrs["schema_version"] not in WITHOUT_PLACES
    scales: dict[Any, str] = {}
    for group, members in GROUPS.items():
        place = _member(file, group) if group else file
        if place is None and group in OPTIONAL_GROUPS:
            continue
        if not isinstance(place, h5py.Group):
            problems.append(f"{group}: the group is {_kind(place)}")
            continue
        problems += _attribute_problems(place, group, group_names(place, group))
        problems += _list_problems(place, group)
        names = [name for name in members if key(group, name) in wanted]
        for short in sorted(names, key=lambda name: members[name].dims != (name,)):
            try:
                dataset = _member(place, short)
                if not isinstance(dataset, h5py.Dataset):
                    problems.append(f"{key(group, short)}: the variable is {_kind(dataset)}")
                    continue
                h5py.h5o.get_info(dataset.id)
                shapes[key(group, short)] = dataset.shape
                if dataset.is_scale:
                    scales[dataset.id] = short
                expected = variable_attributes(
                    group, short, members[short], step, _projection(place)
                )
                faults = [
                    *_type_faults(dataset, members[short], scales),
                    *_attribute_faults(dataset, short, _of_version(expected, dataset, placed)),
                ]
                faults += [fault] if (fault := _storage_fault(dataset, file_bytes)) else []
                problems += [f"{key(group, short)}: {fault}" for fault in faults]
            except HDF5_ERRORS as error:
                problems.append(f"{key(group, short)}: is damaged: {line_of(error)}")
        problems += _crs_problems(place, group) if placed else []
    return problems + shape_problems(shapes)


def _crs_problems(place: h5py.Group, group: str) -> Iterator[str]:
    """Faults of the variable that holds the CRS of a group for maps."""
    try:
        names = group_names(place, group)
        if any(_attribute_fault(place, name) for name in names):
            return  # named already
        numbers = {name: place.attrs[name] for name in names}
        try:
            expected = grid_mapping(group, numbers)
        except ValueError:
            return  # a plane that does not exist is named with the values
        yield from _crs_faults(place, group, expected)
    except HDF5_ERRORS as error:
        yield f"{key(group, CRS)}: is damaged: {line_of(error)}"


def _crs_faults(place: h5py.Group, group: str, expected: Mapping[str, Any]) -> Iterator[str]:
    found = _member(place, CRS) if expected else None
    if isinstance(found, h5py.Dataset):
        h5py.h5o.get_info(found.id)
        for fault in _attribute_faults(found, CRS, expected):
            yield f"{key(group, CRS)}: {fault}"
    elif expected:
        yield f"{key(group, CRS)}: the variable is {_kind(found)}"


def variables(file: h5py.File) -> dict[str, Variable]:
    """The variables that the file must have, by their path in it: all but those of other schema
    versions, and those that the catalogue was built without.
    """
    claims, oldest = states_claims(file), file.attrs.get("schema_version") == "1.0"
    albedo = _has_variable(file, "albedo") or "albedo_map" in file.attrs
    absent = {
        *(() if albedo else OPTIONAL),
        *(() if claims else CLAIMS),
        *(ADDED_IN_1_1 if oldest else ()),
    }
    return {
        key(group, name): variable
        for group, members in GROUPS.items()
        if group not in OPTIONAL_GROUPS or _has_variable(file, group)
        for name, variable in members.items()
        if key(group, name) not in absent
    }


def group_names(place: h5py.Group, group: str) -> tuple[str, ...]:
    """Names of the attributes of a group: those of every file, and the optional one if it is there."""
    optional = OPTIONAL_GROUP_ATTRIBUTES.get(group)
    here = optional is not None and optional in place.attrs
    return (*GROUP_ATTRIBUTES.get(group, ()), *([optional] if optional and here else []))


def _projection(place: h5py.Group) -> str:
    """Projection of the overview; orthographic for a group that does not say it or says no text."""
    name = OPTIONAL_GROUP_ATTRIBUTES["overview"]
    found = None if _attribute_fault(place, name) else place.attrs[name]
    return found if isinstance(found, str) else ORTHOGRAPHIC


def states_claims(file: h5py.File) -> bool:
    """True for a file of schema 2."""
    return not str(file.attrs.get("schema_version")).startswith("1.")


def _identity_problems(file: h5py.File) -> Iterator[str]:
    """A problem if the file is no catalogue of a supported version; then nothing else is checked."""
    try:
        sound = all(_attribute_fault(file, name) == "" for name in ("schema_version", "body"))
        version = file.attrs["schema_version"] if sound else None
    except HDF5_ERRORS as error:
        yield f"its attributes (schema_version, body) cannot be read: {line_of(error)}"
        return
    if not isinstance(version, str):
        yield "not a catalogue of control points: it has no schema_version and body"
    elif version.split(".")[0] not in ("1", SCHEMA_VERSION.split(".")[0]):
        text = _shown(version)
        yield f"schema version {text} is not understood here ({SCHEMA_VERSION}); use a newer lcp"


def _wanted(file: h5py.File) -> tuple[str, ...]:
    """Names of the global attributes that the file must have."""
    return (
        *GLOBAL_ATTRIBUTES,
        *(OPTIONAL_ATTRIBUTES if _has_variable(file, "albedo") else ()),
        *(CLAIM_ATTRIBUTES if states_claims(file) else ()),
    )


def _attribute_problems(place: h5py.Group, group: str, names: tuple[str, ...]) -> Iterator[str]:
    """Faults of the attributes of the file or of a group, which are texts and numbers."""
    before = f"{group}: " if group else ""
    for name in names:
        try:
            fault = _attribute_fault(place, name)
            value = None if fault else place.attrs[name]
        except HDF5_ERRORS as error:
            fault, value = f"cannot be read: {line_of(error)}", None
        number = (bool(group) and name != "projection") or name in NUMBERS
        if not fault and not isinstance(value, np.number if number else str):
            fault = "is not a number" if number else "is not a text"
        if fault:
            yield f"{before}the attribute {name} {fault}"


def _attribute_fault(place: h5py.Group, name: str) -> str:
    """What speaks against reading an attribute; empty if nothing does."""
    if not h5py.h5a.exists(place.id, name.encode()):
        return "is missing"
    found = h5py.h5a.open(place.id, name.encode())
    if found.get_storage_size() > _ATTRIBUTE_BYTES_MAX:
        return f"claims {found.get_storage_size()} bytes"
    return ""


def _has_variable(file: h5py.File, name: str) -> bool:
    """True if the variable exists, damaged or not."""
    try:
        return file.id.links.exists(name.encode())
    except HDF5_ERRORS:
        return True


def _member(place: h5py.Group, name: str) -> Any:
    """A member of a group, a text for one that is not to be followed, None for one that is missing."""
    links = place.id.links
    if not links.exists(name.encode()):
        return None
    if links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
        return "a link to another place, which is not followed"
    return place[name]


def _list_problems(place: h5py.Group, group: str) -> Iterator[str]:
    """A fault of the list of members, which other programs need; unknown members are not opened."""
    try:
        h5py.h5o.get_info(place.id)
        place.id.links.iterate(lambda _: None)
        next(iter(place))
    except HDF5_ERRORS as error:
        yield f"{group or 'root'}: its members cannot be listed: {line_of(error)}"


def _kind(member: Any) -> str:
    """What stands in the place of a group or variable."""
    return member if isinstance(member, str) else "missing"


def _sigma_step(file: h5py.File) -> float:
    """Step of stored sigmas, 1 for a file without claims or with a damaged attribute."""
    try:
        return float(file.attrs["sigma_step_m"])
    except HDF5_ERRORS:
        return 1.0


def _type_faults(
    dataset: h5py.Dataset, variable: Variable, scales: Mapping[Any, str]
) -> Iterator[str]:
    """Faults of the type and the dimensions; ``scales``: names of the dimension scales, which are read
    first.
    """
    text = h5py.check_string_dtype(dataset.dtype)
    kind = TEXT if text is not None and text.length else dataset.dtype.str.lstrip("<|")
    if kind != variable.dtype:
        yield f"holds {_shown(kind)} instead of {variable.dtype}"
    if dataset.id in scales:
        dims: tuple[str, ...] = (scales[dataset.id],)
    else:
        dims = tuple(scales.get(dim[0].id, "?") if len(dim) else "?" for dim in dataset.dims)
    if dims != variable.dims:
        wanted = ", ".join(variable.dims)
        yield f"has the dimensions ({', '.join(dims)}) instead of ({wanted})"


def _attribute_faults(
    dataset: h5py.Dataset, short: str, attributes: Mapping[str, Any]
) -> Iterator[str]:
    """Attributes of a variable that are not those of the schema."""
    for name, expected in attributes.items():
        found: Any = None if _attribute_fault(dataset, name) else dataset.attrs[name]
        former = FORMER_NAMES.get(short, ()) if name == "long_name" else ()
        if isinstance(found, str) and found in former:
            continue
        if not (
            np.array_equal(found, expected)
            or _both_nan(found, expected)
            or _has_fewer_codes(short, name, found, expected)
        ):
            yield f"{name} is {_shown(found)} instead of {expected!s}"


def _both_nan(found: Any, expected: Any) -> bool:
    numbers = isinstance(found, np.floating) and isinstance(expected, np.floating)
    return bool(numbers and np.isnan(found) and np.isnan(expected))


def _of_version(expected: dict[str, Any], dataset: h5py.Dataset, placed: bool) -> dict[str, Any]:
    """Attributes of a variable as a file of its version has them: before schema 2.2 (not ``placed``) without
    coordinates, before 2.5 without the level among them.
    """
    if not placed:
        return former_attributes(expected)
    found = None if _attribute_fault(dataset, "coordinates") else dataset.attrs["coordinates"]
    named = not isinstance(found, str) or LEVEL in found.split()
    return expected if named else without_level(expected)


def _has_fewer_codes(short: str, name: str, found: Any, expected: Any) -> bool:
    """True for the codes of ``coverage/status`` of earlier versions: the first of today's."""
    if short != "status" or not isinstance(found, str | np.ndarray):
        return False
    if name == "flag_meanings":
        return str(expected).startswith(f"{found} ")
    return name == "flag_values" and np.array_equal(found, expected[: np.size(found)])


def _shown(value: Any) -> str:
    """Text from a file in a message: short, and without characters that cannot be printed."""
    return "".join(c if c.isprintable() else "?" for c in str(value)[:80])


def _storage_fault(dataset: h5py.Dataset, file_bytes: int) -> str:
    """What is wrong with the way a variable is stored; empty if nothing is."""
    stored = dataset.id.get_create_plist()
    if stored.get_layout() == h5py.h5d.VIRTUAL or stored.get_external_count():
        return "is stored in another file, which is not followed"
    filters = {stored.get_filter(k)[0] for k in range(stored.get_nfilters())}
    if stored.get_layout() != h5py.h5d.CHUNKED or h5py.h5z.FILTER_FLETCHER32 not in filters:
        return "has no checksums"
    if not filters <= _FILTERS:
        return "is packed by an unknown filter"
    return _chunk_fault(dataset, stored.get_chunk(), file_bytes)


def _chunk_fault(dataset: h5py.Dataset, chunk: tuple[int, ...], file_bytes: int) -> str:
    """What is wrong with the places and sizes of the chunks; empty if nothing is."""
    chunk_bytes = prod(chunk) * dataset.dtype.itemsize
    wanted = prod(-(-length // step) for length, step in zip(dataset.shape, chunk, strict=True))
    if chunk_bytes > _CHUNK_BYTES_MAX or wanted > file_bytes:
        return f"claims {dataset.size * dataset.dtype.itemsize} bytes of a file of {file_bytes}"
    places: list[tuple[int, int]] = []
    masked = False

    def look(info: Any) -> None:
        nonlocal masked
        places.append((info.byte_offset, info.size))
        masked = masked or bool(info.filter_mask)

    if wanted:
        dataset.id.chunk_iter(look)
    if len(places) != wanted:
        return f"has {len(places)} chunks of {wanted}"
    offset, size = np.array(places, dtype=np.uint64).reshape(-1, 2).T
    order = np.argsort(offset)
    ends = offset + size
    if masked or (ends > file_bytes).any() or (ends[order][:-1] > offset[order][1:]).any():
        return "has chunks that are outside the file, overlap, or are not checksummed"
    if (size * np.uint64(_DEFLATE_MOST) < chunk_bytes).any():
        return "has chunks that claim more than they can hold"
    return ""
