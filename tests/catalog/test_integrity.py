"""Digests of chunks and of the content: nothing is used that is not what was written."""

from __future__ import annotations

import hashlib
import itertools
import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import catalogs, damaged_catalogs
from helpers.verified import verify

from lcp_catalog.catalog import catalogue, integrity
from lcp_catalog.catalog.stored import StoredFile, stored_catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CatalogError


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue with all groups, some of its variables in several chunks."""
    path = tmp_path_factory.mktemp("catalog") / "sound.h5"
    write_catalog(catalogs.full(80), path)
    return path


@pytest.fixture
def copy(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path / "copy.h5"))


def unchecked(path: Path) -> Any:
    """The reader alone, without the check of the whole file before."""
    return stored_catalog(StoredFile.of(path))


# -- the form that docs/reference/catalogue-format.md describes, written anew


def described(value: Any) -> Any:
    if isinstance(value, str):
        return value
    value = np.asarray(value)
    return [value.dtype.str, list(value.shape), value.tobytes().hex()]


def attributes_of(item: Any) -> dict[str, Any]:
    left_out = {"DIMENSION_LIST", "REFERENCE_LIST", "content_sha256"}
    return {name: described(item.attrs[name]) for name in set(item.attrs) - left_out}


@pytest.mark.slow
def test_the_digest_of_the_content_is_that_of_the_documented_form(written: Path) -> None:
    with h5py.File(written) as file:
        groups, variables = {"": attributes_of(file)}, {}
        table: list[bytes] = []

        def look(path: str, item: Any) -> None:
            if isinstance(item, h5py.Group):
                groups[path] = attributes_of(item)
                return
            text = h5py.check_string_dtype(item.dtype)
            names = [dim[0].name.split("/")[-1] for dim in item.dims if len(dim)]
            plist = item.id.get_create_plist()
            variables[path] = {
                "type": item.dtype.str + (" utf-8" if text else ""),
                "shape": list(item.shape),
                "chunks": list(item.chunks or []),
                "filters": [plist.get_filter(k)[0] for k in range(plist.get_nfilters())],
                "dimensions": [path.rsplit("/", maxsplit=1)[-1]] if item.is_scale else names,
                "attributes": attributes_of(item),
            }

        file.visititems(look)
        for path in sorted(variables):
            sides = variables[path]["chunks"]
            if not sides or path == "integrity/chunk_sha256":
                continue
            axes = (range(0, n, k) for n, k in zip(variables[path]["shape"], sides, strict=True))
            for offset in itertools.product(*axes):
                mask, stored = file[path].id.read_direct_chunk(offset)
                table.append(hashlib.sha256(np.uint32(mask).tobytes() + stored).digest())
        assert file["integrity/chunk_sha256"][()].tobytes() == b"".join(table)
        whole = {
            "groups": groups,
            "variables": variables,
            "chunks": hashlib.sha256(b"".join(table)).hexdigest(),
        }
        expected = hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()
        assert file.attrs["content_sha256"] == expected
        assert file["sigma_major"].id.get_num_chunks() > 1


# -- what the reader refuses


def flipped(path: Path, place: int, bit: int) -> None:
    whole = bytearray(path.read_bytes())
    whole[place] ^= 1 << bit
    path.write_bytes(whole)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["dem", "longitude", "dem_product", "coverage/usable", "promise/cause", "overview_4/x"]
)
def test_a_bit_of_a_chunk_is_refused_when_a_value_of_it_is_used(copy: Path, name: str) -> None:
    with h5py.File(copy) as file:
        chunks = file[name].id.get_num_chunks()
        place = file[name].id.get_chunk_info(chunks - 1)
    flipped(copy, place.byte_offset + place.size // 3, 2)
    found = unchecked(copy)
    if name != "longitude":
        assert len(found.longitude) == 80
    with pytest.raises(CatalogError, match=rf"copy\.h5: {name}: is damaged: the chunk at \["):
        catalogue.values(found)
    if chunks > 1:
        assert found.part(name, 0).size  # the first chunk is sound
    assert any(line.startswith(f"{name}: ") for line in verify(copy))


def test_a_chunk_in_the_place_of_another_is_refused(copy: Path) -> None:
    """Each is intact by its checksum and stands in the file; the digest's row belongs to the place."""
    with h5py.File(copy, "r+") as file:
        dataset = file["sigma_major"]
        one, other = (dataset.id.get_chunk_info(k).chunk_offset for k in (0, 1))
        (_, first), (_, second) = (dataset.id.read_direct_chunk(k) for k in (one, other))
        dataset.id.write_direct_chunk(one, second)
        dataset.id.write_direct_chunk(other, first)
    with pytest.raises(CatalogError, match="sigma_major: is damaged"):
        _ = unchecked(copy).sigma_major
    (problem,) = [line for line in verify(copy) if "chunks are not" in line]
    assert problem.startswith("sigma_major: 2 of ")


CHANGES = {
    "a digest": lambda file: file["integrity/chunk_sha256"].__setitem__((3, 4), 9),
    "an attribute": lambda file: file["dem"].attrs.__setitem__("comment", "mine"),
    "an attribute of a group": lambda file: file["coverage"].attrs.__setitem__("more", 1.0),
    "a global attribute": lambda file: file.attrs.__setitem__("history", "another"),
    "a new global attribute": lambda file: file.attrs.__setitem__("institution", "none"),
    "an attribute of the CRS": lambda file: file["overview/crs"].attrs.__setitem__("more", 1.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_what_describes_the_content_is_digested(copy: Path, change: str) -> None:
    with h5py.File(copy, "r+") as file:
        CHANGES[change](file)
    with pytest.raises(CatalogError, match=r"copy\.h5: content_sha256: the content is not"):
        unchecked(copy)
    with pytest.raises(CatalogError):
        open_catalog(copy, check=False)
    problems = " ".join(verify(copy))
    assert "content_sha256: " in problems or "does not belong to a catalogue" in problems
    with h5py.File(copy, "r+") as file:
        catalogs.sign(file)
    assert (verify(copy) == []) == (change in ("a global attribute", "a digest"))


def test_a_missing_table_is_refused(copy: Path) -> None:
    with h5py.File(copy, "r+") as file:
        del file["integrity/chunk_sha256"]
    assert "integrity/chunk_sha256: the variable is missing" in verify(copy)
    with h5py.File(copy, "r+") as file:
        del file["integrity"]
    assert verify(copy) == ["integrity: the group is missing"]


def test_values_come_from_the_bytes_that_were_checked(
    written: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5, which would look a chunk up and read it once more, decodes none; one that is not touched is not read."""
    found, seen = unchecked(written), []
    expected = catalogue.values(catalogs.full(80))

    def counted(stored: bytes, mask: int = 0) -> bytes:
        seen.append(len(stored))
        return digest(stored, mask)

    digest = integrity.chunk_digest
    monkeypatch.setattr(integrity, "chunk_digest", counted)
    monkeypatch.delattr(h5py.Dataset, "__getitem__")
    assert len(found.part("dem", 0)) == 9
    assert len(seen) == 1
    for name in ("dem", "dem_product", "condition", "coverage/status", "gsd", "promise/cause"):
        np.testing.assert_array_equal(found.part(name), expected[name], err_msg=name)
    before = len(seen)
    rows, scale = np.array([77, 3, 3, 40]), slice(0, None, 2)
    sigma, step = catalogs.full(80).sigma_major, catalogs.full(80).packing("sigma_major").step
    part = found.part("sigma_major", rows, scale, 1, slice(2, 5))
    np.testing.assert_allclose(part, sigma[rows, scale, 1, 2:5], atol=step)
    assert found.part("sigma_major", slice(0, 0), 1).shape == (0, *sigma.shape[2:])
    assert len(seen) - before == 2


@pytest.mark.slow
def test_a_bit_near_an_index_of_chunks_changes_no_value(written: Path, tmp_path: Path) -> None:
    """With the format of HDF5 1.8, whose records have no checksums, 4 of 400 such bits changed values
    silently.
    """
    whole, turned = written.read_bytes(), tmp_path / "turned.h5"
    assert {b"FAHD", b"FADB"} <= {name for name in damaged_catalogs.RECORDS if name in whole}
    rng, refused, count = np.random.default_rng(300), 0, 300
    sound = catalogue.values(unchecked(written))
    for _ in range(count):
        damaged = bytearray(whole)
        damaged_catalogs.flip_index(damaged, rng)
        turned.write_bytes(damaged)
        try:
            read = catalogue.values(open_catalog(turned, check=False))
        except CatalogError:
            refused += 1
            continue
        for name, array in sound.items():
            np.testing.assert_array_equal(read[name], array, err_msg=name)
    assert refused > count // 2


def test_dimensions_that_cannot_be_read_are_an_error(copy: Path) -> None:
    copy.write_bytes(copy.read_bytes().replace(b"GCOL", b"COAL"))
    with h5py.File(copy) as file, pytest.raises(OSError, match="heap"):
        integrity.dimensions(file["longitude"], "longitude", integrity.Known())
