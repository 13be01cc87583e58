"""PNG images, read back by OpenCV."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest

from lcp_catalog.plots.pictures import encode_png


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_png_is_read_by_others(channels: int) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, channels), dtype=np.uint8)
    found = cv2.imdecode(np.frombuffer(encode_png(pixels), np.uint8), cv2.IMREAD_UNCHANGED)
    assert io.BytesIO(encode_png(pixels)).read(4) == b"\x89PNG"
    if channels == 1:
        np.testing.assert_array_equal(found, pixels[..., 0])
    elif channels == 2:  # OpenCV gives grey and alpha as four channels
        np.testing.assert_array_equal(found[..., [0, 3]], pixels)
    else:
        order = [2, 1, 0, 3][:channels]
        np.testing.assert_array_equal(found[..., order], pixels)


@pytest.mark.parametrize(
    "pixels", [np.zeros((2, 2)), np.zeros((0, 3), np.uint8), np.zeros((1, 1, 5), np.uint8)]
)
def test_invalid_pixels_are_refused(pixels: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"image"):
        encode_png(pixels)
