"""Copies of a catalogue's file, damaged at random, and whether the damage is noticed. What tests and
`benchmarks/faults/damage.py` share.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np

from lcp_catalog.catalog import file_structure
from lcp_catalog.catalog.summary import describe

Damage = Callable[[bytearray, np.random.Generator], None]


def _place(content: bytearray, rng: np.random.Generator, length: int) -> slice:
    """A range of bytes, in every second case among the first 16 kB and thus in HDF5's own records."""
    end = max(1, len(content) - length)
    start = int(rng.integers(min(end, 2**14) if rng.random() < 0.5 else end))
    return slice(start, start + length)


def flip(content: bytearray, rng: np.random.Generator) -> None:
    """Turn one bit."""
    content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))


def flip_record(content: bytearray, rng: np.random.Generator) -> None:
    """Turn one bit, often of HDF5's own records."""
    content[_place(content, rng, 1)] = bytes([content[_place(content, rng, 1)][0] ^ 0x10])


def zero(content: bytearray, rng: np.random.Generator) -> None:
    """Clear 16 bytes."""
    content[_place(content, rng, 16)] = bytes(16)


def scatter(content: bytearray, rng: np.random.Generator) -> None:
    """Replace 1 to 64 bytes by others."""
    length = int(rng.integers(1, 65))
    content[_place(content, rng, length)] = rng.bytes(length)


def exchange(content: bytearray, rng: np.random.Generator) -> None:
    """Copy 8 to 512 bytes to another place."""
    length = int(rng.integers(8, 513))
    content[_place(content, rng, length)] = content[_place(content, rng, length)]


def erase(content: bytearray, rng: np.random.Generator) -> None:
    """Fill a page of 4096 bytes with 0 or 255."""
    place = _place(content, rng, 4096)
    content[place] = bytes([int(rng.integers(2)) * 255]) * len(content[place])


def cut(content: bytearray, rng: np.random.Generator) -> None:
    """Cut the end off."""
    del content[int(rng.integers(len(content))) :]


RANGES: tuple[Damage, ...] = (flip_record, zero, scatter, exchange, erase, cut)


RECORDS = (b"OHDR", b"OCHK", b"FRHP", b"FHDB", b"BTHD", b"BTLF", b"FAHD", b"FADB", b"EAHD", b"EAIB")
"""How the records of HDF5 1.10 begin: headers of objects, names, and indices of chunks."""


def flip_index(content: bytearray, rng: np.random.Generator) -> None:
    """Turn one bit near one of HDF5's records."""
    starts = [m.start() for name in RECORDS for m in re.finditer(re.escape(name), bytes(content))]
    place = int(rng.choice(starts)) + int(rng.integers(-16, 160))
    content[min(max(place, 0), len(content) - 1)] ^= 1 << int(rng.integers(8))


# -- edits by h5py, whose checksums hold

Change = Callable[[np.ndarray], np.ndarray]


def _first_bit(values: np.ndarray) -> np.ndarray:
    values.reshape(-1).view(np.uint8)[0] ^= 1
    return values


CHANGES: dict[str, Change] = {
    "a bit": _first_bit,
    "mirrored": lambda values: values[..., ::-1],
    "rows exchanged": lambda values: values[::-1],
    "cleared": np.zeros_like,
}


def edits(path: Path) -> list[tuple[str, str]]:
    """Names of members and of their changes: values of each variable, attributes of it and of the groups."""
    with h5py.File(path) as file:
        found = []
        for name in file_structure.variables(file):
            values = file[name][()]
            for change, apply in CHANGES.items():
                if values.size and apply(values.copy()).tobytes() != values.tobytes():
                    found.append((name, change))
            found += [
                (name, f"attribute {own}")
                for own in ("units", "scale_factor")
                if own in file[name].attrs
            ]
        for place in (file, *(file[name] for name in file if isinstance(file[name], h5py.Group))):
            found += [(place.name, f"attribute {own}") for own in place.attrs]
    return found


def edit(path: Path, name: str, change: str) -> None:
    """Change a file in place by h5py, which renews Fletcher's checksums, but no digest."""
    with h5py.File(path, "r+") as file:
        if not change.startswith("attribute "):
            file[name][()] = CHANGES[change](file[name][()])
            return
        own, attributes = change.removeprefix("attribute "), file[name].attrs
        value = attributes[own]
        attributes[own] = value + " " if isinstance(value, str) else value + value.dtype.type(1)


def _values(path: Path) -> dict[str, np.ndarray]:
    """Every variable of a file, read by h5py alone."""
    with h5py.File(path) as file:
        return {name: file[name][()] for name in file_structure.variables(file)}


def tried(
    whole: Path, copy: Path, damages: tuple[Damage, ...], seed: int, count: int
) -> Iterator[Counter[str]]:
    """Outcomes of so many damaged files: ``tried``; ``noticed`` by `describe`, of these ``crashed``
    and ``limited`` those that ended the process of the check; ``harmless``, if what is read is as
    before. AssertionError for a file that is taken as intact with other values.
    """
    content, sound = whole.read_bytes(), _values(whole)
    rng, found = np.random.default_rng(seed), Counter[str]()
    for number in range(count):
        damaged = bytearray(content)
        damages[number % len(damages)](damaged, rng)
        copy.write_bytes(damaged)
        said = describe(copy)
        outcome = "harmless" if said["intact"] else "noticed"
        text = " ".join(said["problems"])
        found.update(
            {
                "tried": 1,
                outcome: 1,
                "crashed": "reading it crashed" in text,
                "limited": "reading it takes" in text or "reading it needs" in text,
            }
        )
        assert "reading it ended" not in text, (number, seed)
        if said["intact"]:
            for name, array in _values(copy).items():
                np.testing.assert_array_equal(array, sound[name], err_msg=f"{name} {number} {seed}")
        yield found
