"""Type aliases of NumPy arrays."""

from __future__ import annotations

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
