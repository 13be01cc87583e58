"""Images at reduced resolution: means of blocks, with sensors that see the same terrain."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from helpers import image_files as files
from helpers.image_files import HOLE, opened, scene
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.geometry.frames import lonlat_to_mcmf
from lcp_catalog.images.image import Image


def blocks(found: Image, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Means block by block, pixel by pixel."""
    rows, cols = (n // factor for n in found.signal.shape)
    signal, weight = np.full((rows, cols), np.nan), np.zeros((rows, cols))
    for row in range(rows):
        for col in range(cols):
            total = light = 0.0
            for r in range(row * factor, (row + 1) * factor):
                for c in range(col * factor, (col + 1) * factor):
                    w = float(found.weight[r, c])
                    total += w
                    light += w * float(found.signal[r, c]) if w > 0 else 0.0
            weight[row, col] = total / factor**2
            signal[row, col] = light / total if total > 0 else math.nan
    return signal, weight


@given(
    shape=st.tuples(st.integers(7, 23), st.integers(7, 23)), factor=st.integers(1, 7),
    seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_reduced_images_are_means_of_blocks(shape: tuple[int, int], factor: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    weight = rng.choice([0.0, 0.5, 1.0], shape).astype(np.float32)
    weight[: shape[0] // 2, : shape[1] // 2] = 0.0
    signal = np.where(weight > 0, rng.normal(100, 30, shape), np.nan).astype(np.float32)
    whole = Image("x", signal, weight, files.camera_over(shape), np.array([1.5e11, 0, 0]))
    small = whole.reduced(factor)
    wanted = blocks(whole, factor)
    np.testing.assert_allclose(small.weight, wanted[1], rtol=1e-6)
    np.testing.assert_allclose(small.signal, wanted[0], rtol=1e-6)
    assert small.sensor.shape == small.signal.shape


@given(factor=st.integers(2, 6), seed=st.integers(0, 2**32 - 1))
def test_reduced_sensors_see_the_same_ground(factor: int, seed: int) -> None:
    """The centre of a block of pixels is the pixel of the reduced image, without a shift of half a
    pixel.
    """
    camera = files.camera_over((50, 70))
    whole = Image(
        "x", np.zeros((50, 70), np.float32), np.ones((50, 70), np.float32), camera, np.ones(3)
    )
    small = whole.reduced(factor).sensor
    rows, cols = small.shape
    pixel = np.random.default_rng(seed).integers(0, [cols, rows], (5, 2)).astype(float)
    middle = pixel * factor + (factor - 1) / 2
    for a, b in zip(small.looks(pixel), camera.looks(middle), strict=True):
        np.testing.assert_allclose(a, b)
    point = lonlat_to_mcmf(20.05, -10.05)
    np.testing.assert_allclose(
        camera.project(point), small.project(point) * factor + (factor - 1) / 2
    )


def test_reducing_twice_is_reducing_once(tmp_path: Path) -> None:
    samples = scene()
    samples[HOLE] = 255
    found = opened(files.write_image(tmp_path / "a.tif", samples))
    twice, once = found.reduced(2).reduced(2), found.reduced(4)
    np.testing.assert_allclose(twice.signal, once.signal, rtol=1e-5)
    np.testing.assert_allclose(twice.weight, once.weight)
    point = lonlat_to_mcmf(20.1, -10.1)
    np.testing.assert_allclose(twice.sensor.project(point), once.sensor.project(point))
