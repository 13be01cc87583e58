"""The structure of a catalogue's file, judged by known names and by sizes before any value is read:
what it links to, how it is stored, and how much it claims to hold.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import prod
from typing import Any

import h5py
import numpy as np

from ..geometry.map_plane import ORTHOGRAPHIC
from .checks import shape_problems
from .integrity import DIGESTS, HDF5_ERRORS, INTEGRITY, TABLE, Known, dimensions, line_of
from .layout import (
    CRS,
    GLOBAL_ATTRIBUTES,
    GROUP_ATTRIBUTES,
    GROUPS,
    NUMBERS,
    OPTIONAL_ATTRIBUTES,
    OPTIONAL_GROUP_ATTRIBUTES,
    TEXT,
    grid_mapping,
    key,
    variable_attributes,
)
from .schema import OLD_FILE, OPTIONAL, OPTIONAL_GROUPS, SCHEMA_VERSION, Variable
from .shards import SHARDS

_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}

_DEFLATE_MOST = 1100
"""Bytes that a byte of deflated data can hold, 1032, and some."""

_CHUNK_BYTES_MAX = 2**26

_OF_HDF5 = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST")
"""Attributes by which HDF5 knows dimensions."""

_ATTRIBUTE_BYTES_MAX = 2**16
"""Most bytes of an attribute in its object; HDF5 keeps long texts elsewhere."""


def structure_problems(file: h5py.File, file_bytes: int, known: Known) -> list[str]:
    """All problems of the structure, one line each. Of a file that is no catalogue of this schema the only one. What is
    read more than once is kept in ``known``.
    """
    foreign = list(_identity_problems(file))
    if foreign:
        return foreign
    problems: list[str] = []
    shapes: dict[str, tuple[int, ...]] = {}
    step, wanted = _sigma_step(file), variables(file)
    for group, members in (GROUPS | {INTEGRITY: {TABLE: DIGESTS}}).items():
        place = _member(file, group) if group else file
        if place is None and group in OPTIONAL_GROUPS:
            continue
        if not isinstance(place, h5py.Group):
            problems.append(f"{group}: the group is {_kind(place)}")
            continue
        stated = group_names(place, group) if group else global_names(file)
        problems += _attribute_problems(place, group, stated, known.attributes[group])
        names = [name for name in members if group == INTEGRITY or key(group, name) in wanted]
        problems += _list_problems(place, group, names)
        projection = _projection(known.attributes[group])
        for short in names:
            try:
                dataset = _member(place, short)
                if not isinstance(dataset, h5py.Dataset):
                    problems.append(f"{key(group, short)}: the variable is {_kind(dataset)}")
                    continue
                h5py.h5o.get_info(dataset.id)
                shapes[key(group, short)] = dataset.shape
                expected = variable_attributes(group, short, members[short], step, projection)
                path = key(group, short)
                faults = [
                    *_type_faults(dataset, members[short], dimensions(dataset, path, known)),
                    *_attribute_faults(dataset, expected, known.attributes[path]),
                ]
                faults += [fault] if (fault := _storage_fault(dataset, file_bytes)) else []
                problems += [f"{path}: {fault}" for fault in faults]
            except HDF5_ERRORS as error:
                problems.append(f"{key(group, short)}: is damaged: {line_of(error)}")
        problems += _bare_problems(place, group)
    return problems + shape_problems(shapes)


def _bare_problems(place: h5py.Group, group: str) -> Iterator[str]:
    """Faults of the datasets of a group that have no content."""
    if group == INTEGRITY:
        for name in DIGESTS.dims:
            if not isinstance(_member(place, name), h5py.Dataset):
                yield f"{key(group, name)}: the dimension is {_kind(_member(place, name))}"
        return
    yield from _crs_problems(place, group)


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
        for fault in _attribute_faults(found, expected, {}):
            yield f"{key(group, CRS)}: {fault}"
    elif expected:
        yield f"{key(group, CRS)}: the variable is {_kind(found)}"


def variables(file: h5py.File) -> dict[str, Variable]:
    """The variables that the file must have, by their path in it: all but those that the catalogue was built
    without.
    """
    albedo = has_group(file, OPTIONAL[0]) or "albedo_map" in file.attrs
    return {
        key(group, name): variable
        for group, members in GROUPS.items()
        if group not in OPTIONAL_GROUPS or has_group(file, group)
        for name, variable in members.items()
        if albedo or key(group, name) not in OPTIONAL
    }


def group_names(place: h5py.Group, group: str) -> tuple[str, ...]:
    """Names of the attributes of a group: those of every file, and the optional one if it is there."""
    optional = OPTIONAL_GROUP_ATTRIBUTES.get(group)
    here = optional is not None and optional in place.attrs
    return (*GROUP_ATTRIBUTES.get(group, ()), *([optional] if optional and here else []))


def _projection(known: Mapping[str, Any]) -> str:
    """Projection of the overview, of the attributes of a group; orthographic for one that does not say it or says no text."""
    found = known.get(OPTIONAL_GROUP_ATTRIBUTES["overview"])
    return found if isinstance(found, str) else ORTHOGRAPHIC


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
    elif version.startswith(("1.", "2.")):
        yield OLD_FILE
    elif version != SCHEMA_VERSION:
        text = _shown(version)
        yield f"schema version {text} is not understood here ({SCHEMA_VERSION}); use a newer lcp"


def global_names(file: h5py.File) -> tuple[str, ...]:
    """Names of the global attributes that the file must have, but the digest of its content."""
    optional = OPTIONAL_ATTRIBUTES if has_group(file, OPTIONAL[0]) else ()
    return (*GLOBAL_ATTRIBUTES, *optional, *([SHARDS] if SHARDS in file.attrs else []))


def _attribute_problems(
    place: h5py.Group, group: str, names: tuple[str, ...], known: dict[str, Any]
) -> Iterator[str]:
    """Faults of the attributes of the file or of a group, which are texts and numbers; they become ``known``."""
    before = f"{group}: " if group else ""
    for name in _unknown_attributes(place, names):
        yield f"{before}the attribute {name} does not belong to a catalogue"
    for name in names:
        try:
            fault = _attribute_fault(place, name)
            value = None if fault else place.attrs[name]
            known |= {} if fault else {name: value}
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


def has_group(file: h5py.File, name: str) -> bool:
    """True if there is a group or a variable of this name, damaged or not."""
    try:
        return bool(file.id.links.exists(name.encode()))
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


def _list_problems(place: h5py.Group, group: str, names: Sequence[str]) -> Iterator[str]:
    """Faults of the list of members, of which unknown ones are not opened, and unknown attributes."""
    known = {*names, *(DIGESTS.dims if group == INTEGRITY else [CRS] if group else [])}
    known |= set() if group else {*GROUPS, INTEGRITY}
    try:
        h5py.h5o.get_info(place.id)
        found: list[str] = []
        place.id.links.iterate(lambda name: found.append(name.decode(errors="replace")))
        next(iter(place))
    except HDF5_ERRORS as error:
        yield f"{group or 'root'}: its members cannot be listed: {line_of(error)}"
        return
    for name in sorted({*found} - known):
        yield f"{key(group, _shown(name))}: does not belong to a catalogue"


def _kind(member: Any) -> str:
    """What stands in the place of a group or variable."""
    return member if isinstance(member, str) else "missing"


def _sigma_step(file: h5py.File) -> float:
    """Step of stored sigmas, 1 for a damaged attribute."""
    try:
        return float(file.attrs["sigma_step_m"])
    except HDF5_ERRORS:
        return 1.0


def _type_faults(dataset: h5py.Dataset, variable: Variable, dims: tuple[str, ...]) -> Iterator[str]:
    """Faults of the type and of the dimensions ``dims``."""
    text = h5py.check_string_dtype(dataset.dtype)
    kind = TEXT if text is not None and text.length else dataset.dtype.str.lstrip("<|")
    if kind != variable.dtype:
        yield f"holds {_shown(kind)} instead of {variable.dtype}"
    if dims != variable.dims:
        wanted = ", ".join(variable.dims)
        yield f"has the dimensions ({', '.join(map(_shown, dims))}) instead of ({wanted})"


def _attribute_faults(
    dataset: h5py.Dataset, attributes: Mapping[str, Any], known: dict[str, Any]
) -> Iterator[str]:
    """Attributes of a variable that are not those of the schema; what is read becomes ``known``."""
    stored = dataset.attrs
    for name, expected in attributes.items():
        found: Any = None
        if not _attribute_fault(dataset, name):
            found = known[name] = stored[name]
        if not _alike(found, expected):
            yield f"{name} is {_shown(found)} instead of {expected!s}"
    for name in _unknown_attributes(dataset, attributes):
        yield f"the attribute {name} does not belong to a catalogue"


def _unknown_attributes(place: Any, known: Collection[str]) -> list[str]:
    """Names of attributes that are neither of the schema nor HDF5's own."""
    return sorted(_shown(name) for name in {*place.attrs} - {*known, *_OF_HDF5})


def _alike(found: Any, expected: Any) -> bool:
    """True for equal values, and for two that are NaN. NumPy 2.0 cannot compare a text with a number."""
    numbers = isinstance(found, np.floating) and isinstance(expected, np.floating)
    texts = isinstance(found, str) == isinstance(expected, str)
    return texts and np.array_equal(found, expected, equal_nan=numbers)


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
    along = [-(-length // step) for length, step in zip(dataset.shape, chunk, strict=True)]
    if chunk_bytes > _CHUNK_BYTES_MAX or prod(along) > file_bytes:
        return f"claims {dataset.size * dataset.dtype.itemsize} bytes of a file of {file_bytes}"
    found: list[tuple[int, ...]] = []
    masked = False

    def look(info: Any) -> None:
        nonlocal masked
        found.append((info.byte_offset, info.size, *info.chunk_offset))
        masked = masked or bool(info.filter_mask)

    if prod(along):
        dataset.id.chunk_iter(look)
    if len(found) != prod(along):
        return f"has {len(found)} chunks of {prod(along)}"
    table = np.array(found, dtype=np.uint64).reshape(-1, 2 + len(chunk))
    offset, size, starts, sides = *table.T[:2], table[:, 2:], np.array(chunk, np.uint64)
    places = starts // sides
    inside = (places * sides == starts) & (places < np.array(along, np.uint64))
    if not inside.all() or len({one[2:] for one in found}) != len(found):
        return "has chunks that are not each in a place of their own"
    order = np.argsort(offset)
    ends = offset + size
    if masked or (ends > file_bytes).any() or (ends[order][:-1] > offset[order][1:]).any():
        return "has chunks that are outside the file, overlap, or are not checksummed"
    if (size * np.uint64(_DEFLATE_MOST) < chunk_bytes).any():
        return "has chunks that claim more than they can hold"
    return ""
