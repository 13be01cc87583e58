"""The samples of a label's image: how they are stored, and which of them mean "nothing here"."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..errors import LabelError
from . import pvl
from .pvl import Pvl, Quantity

_SAMPLES = {
    ("LSB_INTEGER", 16): "<i2",
    ("PC_INTEGER", 16): "<i2",
    ("MSB_INTEGER", 16): ">i2",
    ("INTEGER", 16): ">i2",
    ("SUN_INTEGER", 16): ">i2",
    ("LSB_INTEGER", 32): "<i4",
    ("MSB_INTEGER", 32): ">i4",
    ("PC_REAL", 32): "<f4",
    ("IEEE_REAL", 32): ">f4",
    ("REAL", 32): ">f4",
    ("SUN_REAL", 32): ">f4",
    ("PC_REAL", 64): "<f8",
    ("IEEE_REAL", 64): ">f8",
}


@dataclass(frozen=True)
class Samples:
    """What a label's tables say about the numbers in its image; refusals are ``LabelError``."""

    image: Pvl
    compressed: Pvl | None  # the table of the compressed file, which is looked at first

    def dtype(self) -> str:
        """numpy's name of the type in which an uncompressed image is stored."""
        kind, bits = (
            pvl.text(self.image, "SAMPLE_TYPE"),
            int(pvl.wanted(self.image, "SAMPLE_BITS")),
        )
        if (kind, bits) not in _SAMPLES:
            raise LabelError(f"samples of type {kind} with {bits} bits are not supported")
        return _SAMPLES[kind, bits]

    def tables(self) -> Iterator[Pvl]:
        """Where a key of the pixels may stand, the file at hand first."""
        if self.compressed is not None:
            yield self.compressed
        yield self.image

    def missing(self) -> Iterator[float]:
        """Sample values that mean "nothing here"; "N/A" and silence mean that there are none."""
        for table in self.tables():
            for key in ("MISSING_CONSTANT", "MISSING", "INVALID_CONSTANT", "CORE_NULL", "NULL"):
                yield from self._constants(table.get(key), key)
            for key in table:
                if re.fullmatch(r"CORE_(LOW|HIGH)_(REPR|INSTR)_SATURATION", key):
                    yield from self._constants(table[key], key)

    def _constants(self, value: Any, key: str) -> Iterator[float]:
        for item in value if isinstance(value, list) else [value]:
            number = item.value if isinstance(item, Quantity) else item
            if isinstance(number, float):
                yield number
            elif isinstance(number, str) and re.fullmatch(r"16#[0-9A-Fa-f]+#", number):
                yield _from_hex(number[3:-1], self.dtype() if self.compressed is None else "<i2")
            elif isinstance(number, str) and number.upper() not in (
                "N/A",
                "UNK",
                "NULL",
                "NONE",
                "",
            ):
                raise LabelError(f"{key} = {number} is not understood")


def _from_hex(digits: str, dtype: str) -> float:
    """A missing constant given by its bits, most significant first."""
    import numpy as np  # noqa: PLC0415  # only labels with such a constant

    kind = np.dtype(dtype).newbyteorder(">")
    return float(np.frombuffer(bytes.fromhex(digits.zfill(2 * kind.itemsize)), dtype=kind)[0])
