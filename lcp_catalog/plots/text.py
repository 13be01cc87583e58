"""Small text in pictures of pixels (OpenCV's Hershey font: ASCII only)."""

from __future__ import annotations

import cv2

from ..arrays import Bytes

HEIGHT_PX = 9
"""Height of a capital letter."""
LINE_PX = 14
"""Distance of two lines of text."""

_FONT, _SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.4


def width_px(text: str) -> int:
    """Width of a line of text."""
    return int(cv2.getTextSize(text, _FONT, _SCALE, 1)[0][0])


def draw_text(picture: Bytes, left: int, top: int, text: str, colour: tuple[int, int, int]) -> None:
    """Draw a line of text into a picture (rows, columns, 3), its capitals from row ``top`` down; parts outside the picture are
    cut off.
    """
    cv2.putText(picture, text, (left, top + HEIGHT_PX), _FONT, _SCALE, colour, 1, cv2.LINE_AA)
