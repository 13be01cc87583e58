"""Checked access to the numbers of a JSON document; errors name the file and the field."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from ..arrays import Array
from ..errors import CameraError

LARGEST = 1e12
"""Largest number allowed in a camera file; the Sun is at 1.5e11 m, an ephemeris time is up to 3e9
s.
"""


def numbers(stated: Any) -> Array:
    """An array of numbers. TypeError, ValueError or OverflowError for others, such as true and texts, also
    where NumPy would convert them.
    """
    if not isinstance(stated, np.ndarray):
        for one in np.array(stated, dtype=object).ravel():
            if isinstance(one, bool | str | bytes):
                raise TypeError("not a number")
    return np.array(stated, dtype=np.float64)


@dataclass(frozen=True)
class JsonFields:
    """A JSON object of a camera file. The ``path`` of a field is its name, or the names of nested
    fields with dots between them.

    Every method raises CameraError for a field that is missing or has another type.
    """

    document: Mapping[str, Any]
    name: str

    def refuse(self, path: str, why: str) -> NoReturn:
        """Raise CameraError for an invalid field."""
        raise CameraError(f"{self.name}: {path} {why}")

    def find(self, path: str) -> Any:
        """Value of a field; None if it is missing."""
        value: Any = self.document
        for part in path.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return value

    def need(self, path: str) -> Any:
        """Value of a field; CameraError if it is missing."""
        value = self.find(path)
        if value is None:
            raise CameraError(f"{self.name}: lacks {path}")
        return value

    def numbers(self, path: str, shape: tuple[int | None, ...]) -> Array:
        """Finite numbers of a shape; None stands for any length but 0."""
        stated = self.need(path)
        try:
            values = numbers(stated)
        except (TypeError, ValueError, OverflowError):
            self.refuse(path, "does not consist of numbers")
        fits = len(values.shape) == len(shape) and all(
            n == wanted or (wanted is None and n > 0)
            for n, wanted in zip(values.shape, shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("n" if n is None else str(n) for n in shape) or "one number"
            got = " x ".join(map(str, values.shape)) or "one number"
            self.refuse(path, f"must be {wanted}, is {got}")
        if not np.isfinite(values).all():
            self.refuse(path, "holds a number that is not finite")
        if (np.abs(values) > LARGEST).any():
            self.refuse(path, f"holds a number beyond {LARGEST:g}")
        return values

    def text(self, path: str) -> str:
        """Text of a field."""
        value = self.need(path)
        if not isinstance(value, str):
            self.refuse(path, "is not text")
        return value

    def flag(self, path: str) -> bool:
        """True or false; false if the field is missing."""
        value = self.find(path)
        if value is not None and not isinstance(value, bool):
            self.refuse(path, "is neither true nor false")
        return bool(value)

    def codes(self, path: str) -> list[int]:
        """List of whole numbers; empty if the field is missing."""
        value = self.find(path) or []
        if not isinstance(value, list) or not all(type(code) is int for code in value):
            self.refuse(path, "is not a list of whole numbers")
        return value

    def number(self, path: str) -> float:
        """One finite number."""
        return float(self.numbers(path, ()))

    def positive(self, path: str) -> float:
        """One positive number."""
        value = self.number(path)
        if not value > 0.0:
            self.refuse(path, f"must be positive, is {value:g}")
        return value

    def whole(self, path: str) -> int:
        """One whole number, 1 to a million."""
        value = self.positive(path)
        if value != round(value) or value > 1e6:
            self.refuse(path, f"must be a whole number up to a million, is {value:g}")
        return int(value)


def parsed(text: str, name: str) -> JsonFields:
    """Fields of a file's text; CameraError for text that is not one JSON object."""
    document = json_value(text, name)
    if not isinstance(document, Mapping):
        raise CameraError(f"{name}: a camera file holds one JSON object")
    return JsonFields(document, name)


def json_value(text: str, name: str) -> Any:
    """What a JSON text holds; CameraError for text that is not JSON, and for an object with a key twice."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            twice = next(key for k, (key, _) in enumerate(pairs) if key in dict(pairs[:k]))
            raise CameraError(f"{name}: has the key {twice!r} twice: remove one")
        return found

    try:
        return json.loads(text, object_pairs_hook=once)
    except CameraError:
        raise
    except (ValueError, RecursionError) as error:
        raise CameraError(f"{name}: is not JSON: {error}") from error
