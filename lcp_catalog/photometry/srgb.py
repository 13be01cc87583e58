"""The sRGB encoding of pixel values, and luminance."""

from __future__ import annotations

import numpy as np

from ..arrays import Array

ALBEDO_ENCODINGS = ("linear", "srgb")
"""Encodings of pixel values: proportional to radiance, or sRGB codes of a display image."""

REC_709 = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue in luminance (ITU-R BT.709)."""


def decode_srgb(codes: Array) -> Array:
    """Linear values of sRGB codes of full scale 1 (IEC 61966-2-1:1999, 5.2); NaN stays NaN.

    C / 12.92 for codes C up to 0.04045, ((C + 0.055) / 1.055)^2.4 above.
    """
    steep = ((codes + 0.055) / 1.055) ** 2.4
    return np.where(codes <= 0.04045, codes / 12.92, steep)
