"""Type aliases of NumPy arrays, and short texts of what holds arrays."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Index = NDArray[np.int64]
Int16 = NDArray[np.int16]
Bytes = NDArray[np.uint8]
Mask = NDArray[np.bool_]
AnyArray = NDArray[Any]


def sizes(one: Any) -> str:
    """A dataclass in short: the shapes of its arrays, its numbers and texts, and of other fields their kind; without
    those that are None.
    """
    told = []
    for field in fields(one):
        value = getattr(one, field.name)
        if isinstance(value, np.ndarray):
            told.append(f"{field.name} {value.shape}")
        elif isinstance(value, str | int | float):
            told.append(f"{field.name} {value!r:.100}")
        elif value is not None:
            told.append(f"{field.name} {type(value).__name__}")
    return f"<{type(one).__name__}: {', '.join(told)}>"
