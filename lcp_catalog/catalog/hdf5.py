"""The catalogue as an HDF5 file that is also netCDF-4: written here; `verification` opens and checks
it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..arrays import AnyArray
from ..atomic_files import check_output, write_bytes
from ..geometry.map_plane import ORTHOGRAPHIC
from .catalogue import Catalog, Coverage, Overview
from .layout import GROUPS, TEXT, Groups, Values, digests, key, variable_attributes
from .schema import SCHEMA_VERSION, Variable
from .verification import open_catalog, verify

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


def write_catalog(catalog: Catalog, path: Path | str, overwrite: bool = False) -> None:
    """Write the file; it appears under its name only when it is complete. Equal catalogues give
    equal bytes.

    Raises OutputExistsError and OutputError as `atomic_files.check_output` does.
    """
    check_output(path, overwrite)
    values, attributes, groups = catalog.values(), catalog.attributes(), catalog.group_attributes()
    optional = catalog.optional_attributes()
    attributes |= digests(values, attributes, groups, optional)
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
    attributes: Groups,
    sigma_step_m: float,
) -> None:
    place = file.create_group(group, track_order=True) if group else file
    place.attrs.update(attributes.get(group, {}))
    present = [name for name in variables if key(group, name) in values]
    scales_first = sorted(present, key=lambda name: variables[name].dims != (name,))
    for name in scales_first:
        projection = str(attributes.get(group, {}).get("projection", ORTHOGRAPHIC))
        found = variable_attributes(name, variables[name], sigma_step_m, projection)
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
