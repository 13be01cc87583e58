"""Numbers out of a JSON document, checked, with errors that name the file and the field."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from ..arrays import Array
from ..errors import CameraError

LARGEST = 1e12
"""No number of a camera file is larger: the Sun stands 1.5e11 m away, an ephemeris time reaches 3e9 s."""


@dataclass(frozen=True)
class JsonFields:
    """A JSON object of a camera file. ``path`` of a field is its name, or names with dots between for a field of a field.

    Every method raises CameraError for a field that is not there or holds something else.
    """

    document: Mapping[str, Any]
    name: str

    def refuse(self, path: str, why: str) -> NoReturn:
        """Raise: this field is wrong."""
        raise CameraError(f"{self.name}: {path} {why}")

    def find(self, path: str) -> Any:
        """What stands there, None if nothing does."""
        value: Any = self.document
        for part in path.split("."):
            value = value.get(part) if isinstance(value, Mapping) else None
        return value

    def need(self, path: str) -> Any:
        """What stands there."""
        value = self.find(path)
        if value is None:
            raise CameraError(f"{self.name}: lacks {path}")
        return value

    def numbers(self, path: str, shape: tuple[int | None, ...]) -> Array:
        """Finite numbers of a shape; None is any length but 0."""
        stated = self.need(path)
        try:
            values = np.array(stated, dtype=np.float64)
            if isinstance(stated, bool):
                raise TypeError
        except (TypeError, ValueError):
            self.refuse(path, "is not made of numbers")
        fits = len(values.shape) == len(shape) and all(
            n == wanted or (wanted is None and n > 0)
            for n, wanted in zip(values.shape, shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("n" if n is None else str(n) for n in shape) or "one number"
            got = " x ".join(map(str, values.shape)) or "one number"
            self.refuse(path, f"must be {wanted}, is {got}")
        if not np.isfinite(values).all():
            self.refuse(path, "holds what is not a finite number")
        if (np.abs(values) > LARGEST).any():
            self.refuse(path, f"holds a number beyond {LARGEST:g}")
        return values

    def text(self, path: str) -> str:
        """Some text."""
        value = self.need(path)
        if not isinstance(value, str):
            self.refuse(path, "is not a text")
        return value

    def flag(self, path: str) -> bool:
        """True or false; false where nothing is stated."""
        value = self.find(path)
        if value is not None and not isinstance(value, bool):
            self.refuse(path, "is neither true nor false")
        return bool(value)

    def codes(self, path: str) -> list[int]:
        """Whole numbers, as many as there are; none where nothing is stated."""
        value = self.find(path) or []
        if not isinstance(value, list) or not all(type(code) is int for code in value):
            self.refuse(path, "is not a list of whole numbers")
        return value

    def number(self, path: str) -> float:
        """One finite number."""
        return float(self.numbers(path, ()))

    def positive(self, path: str) -> float:
        """One number above 0."""
        value = self.number(path)
        if not value > 0.0:
            self.refuse(path, f"must be positive, is {value:g}")
        return value

    def whole(self, path: str) -> int:
        """One whole number above 0, below a million."""
        value = self.positive(path)
        if value != round(value) or value > 1e6:
            self.refuse(path, f"must be a whole number up to a million, is {value:g}")
        return int(value)


def parsed(text: str, name: str) -> JsonFields:
    """The fields of a file's text; CameraError for what is not one JSON object."""
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise CameraError(f"{name}: is not JSON: {error}") from error
    if not isinstance(document, Mapping):
        raise CameraError(f"{name}: a camera file holds one JSON object")
    return JsonFields(document, name)
