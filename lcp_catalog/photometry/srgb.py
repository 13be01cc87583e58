"""The sRGB encoding of pixel values, and luminance."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array

_Real = TypeVar("_Real", bound=np.floating)

REC_709 = (0.2126, 0.7152, 0.0722)
"""Luminance of red, green and blue (ITU-R BT.709)."""


def luminance(bands: NDArray[_Real]) -> NDArray[_Real]:
    """Luminance (...) of linear red, green and blue (3, ...), in their precision."""
    red, green, blue = (weight * band for weight, band in zip(REC_709, bands, strict=True))
    return np.asarray(red + green + blue, dtype=bands.dtype)


def decode_srgb(codes: Array) -> Array:
    """Linear light of sRGB codes of full scale 1; NaN stays NaN.

    IEC 61966-2-1:1999, 5.2: C / 12.92 up to 0.04045, above that ((C + 0.055) / 1.055)^2.4.
    """
    steep = ((codes + 0.055) / 1.055) ** 2.4
    return np.where(codes <= 0.04045, codes / 12.92, steep)
