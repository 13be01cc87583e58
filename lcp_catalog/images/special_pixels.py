"""Samples that are not brightness: ISIS special pixels, and plateaus at the ends of a scale.

ISIS reserves codes at the ends of each sample type (its SpecialPixel): NULL (missing), LRS and LIS
(below the range of the file or of the instrument), HRS and HIS (above). They are stored codes: base
and multiplier do not apply to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..arrays import Mask

_FLOAT_CODES = {
    # null, low, low, high, high: bits of the five most negative finite numbers, from NULL on
    "float32": (0xFF7FFFFB, 0xFF7FFFFC, 0xFF7FFFFD, 0xFF7FFFFE, 0xFF7FFFFF),
    "float64": tuple(0xFFEFFFFFFFFFFFFB + step for step in range(5)),
}
_INTEGER_CODES = {
    # null, lrs, lis, his, hrs, and the valid range
    "uint8": ((0, 0, 0, 255, 255), (1, 254)),
    "int16": ((-32768, -32767, -32766, -32765, -32764), (-32752, 32767)),
    "uint16": ((0, 1, 2, 65534, 65535), (3, 65522)),
    "int32": (tuple(-(2**31) + step for step in range(5)), (-(2**31) + 16, 2**31 - 1)),
    "uint32": ((0, 1, 2, 2**32 - 2, 2**32 - 1), (3, 2**32 - 14)),
}

PLATEAU_NEIGHBOURS = 4
PLATEAU_FACTOR = 3.0
PLATEAU_LEAST = 8


@dataclass(frozen=True, eq=False)
class SpecialPixels:
    """Masks (rows, cols) of samples that are not brightness: ``missing``, below the range
    (``low``), above the range (``high``).
    """

    missing: Mask
    low: Mask
    high: Mask

    def __or__(self, other: SpecialPixels) -> SpecialPixels:
        return SpecialPixels(
            self.missing | other.missing, self.low | other.low, self.high | other.high
        )


@dataclass(frozen=True)
class Codes:
    """Stored samples that a label defines as not brightness; whole numbers above 2^31 are the bits
    of floats.
    """

    missing: tuple[float | int, ...] = ()
    low: tuple[float | int, ...] = ()
    high: tuple[float | int, ...] = ()

    def among(self, samples: NDArray[Any]) -> SpecialPixels:
        """Masks of the codes in samples (rows, cols)."""
        return SpecialPixels(
            *(_any_of(samples, codes) for codes in (self.missing, self.low, self.high))
        )


NO_CODES = Codes()


def _any_of(samples: NDArray[Any], codes: tuple[float | int, ...]) -> Mask:
    found = np.zeros(samples.shape, dtype=bool)
    bits = None
    if samples.dtype.kind == "f":
        bits = np.ascontiguousarray(samples).view(f"u{samples.dtype.itemsize}")
    for code in codes:
        if bits is not None and isinstance(code, int) and code > 2**31:
            found |= bits == code
        else:
            found |= samples == code
    return found


def isis_special(samples: NDArray[Any]) -> SpecialPixels:
    """Special pixels of a cube's samples (rows, cols). 8-bit samples have one code for NULL and
    both low codes, which is taken as NULL.

    Codes between the special ones and the valid range are reserved by ISIS and taken as missing.
    """
    if samples.dtype.kind == "f":
        return _special_floats(samples)
    if samples.dtype.name not in _INTEGER_CODES:
        nothing = np.zeros(samples.shape, dtype=bool)
        return SpecialPixels(nothing, nothing, nothing)
    (null, lrs, lis, his, hrs), (least, most) = _INTEGER_CODES[samples.dtype.name]
    low = ((samples == lrs) | (samples == lis)) & (samples != null)
    high = (samples == his) | (samples == hrs)
    return SpecialPixels(((samples < least) | (samples > most)) & ~low & ~high, low, high)


def _special_floats(samples: NDArray[Any]) -> SpecialPixels:
    bits = np.ascontiguousarray(samples).view(f"u{samples.dtype.itemsize}")
    null, lrs, lis, his, hrs = _FLOAT_CODES[samples.dtype.name]
    low, high = (bits == lrs) | (bits == lis), (bits == his) | (bits == hrs)
    return SpecialPixels((bits == null) | ~np.isfinite(samples), low, high)


def plateau_ends(samples: NDArray[Any], valid: Mask) -> tuple[float | None, float | None]:
    """The lowest and the highest value of samples where ``valid``, each only if it is a plateau;
    else None.

    At the end of a scale without clipping, values become rare. A plateau is an end value that
    occurs at least `PLATEAU_LEAST` times, and more than `PLATEAU_FACTOR` times as often as the
    average neighbouring value. Neighbouring values are those next to the end that make up
    `PLATEAU_NEIGHBOURS` times its count of pixels.
    """
    values = samples[valid]
    if values.size == 0:
        return None, None
    low, high = values.min(), values.max()
    if low == high:
        return None, None
    return (
        float(low) if _is_plateau(values, low, 1.0) else None,
        float(high) if _is_plateau(values, high, -1.0) else None,
    )


def _is_plateau(values: NDArray[Any], end: Any, towards: float) -> bool:
    others = values[values != end]
    count = values.size - others.size
    if count < PLATEAU_LEAST:
        return False
    next_to = min(others.size, PLATEAU_NEIGHBOURS * count)
    kth = next_to - 1 if towards > 0 else others.size - next_to
    parted = np.partition(others, kth)
    nearest = parted[:next_to] if towards > 0 else parted[kth:]
    return bool(count > PLATEAU_FACTOR * next_to / np.unique(nearest).size)


def touching_edge(mask: Mask) -> Mask:
    """The parts of a mask (rows, cols), connected by sides, that touch the edge of the image."""
    labels, count = ndimage.label(mask)
    at_edge = np.zeros(count + 1, dtype=np.bool_)
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        at_edge[edge] = True
    at_edge[0] = False  # the label of the background
    return np.asarray(at_edge[labels])
