"""The sRGB encoding of pixel values, and luminance."""

from __future__ import annotations

ALBEDO_ENCODINGS = ("linear", "srgb")
"""What the numbers of a map may be: proportional to brightness, or codes of a display image."""
