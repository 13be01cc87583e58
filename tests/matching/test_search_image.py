"""An image prepared for the search: filled gaps, weights, half resolution, conversion of pixels."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.posed import camera

from lcp_catalog.cameras.sensor import Reduced
from lcp_catalog.images.image import Image
from lcp_catalog.matching.point_search import SearchImage, full_pixels, nothing_in


def made(signal: np.ndarray, weight: np.ndarray | None = None) -> Image:
    side = signal.shape[0]
    weight = np.ones(signal.shape) if weight is None else weight
    return Image(
        "made", signal.astype(np.float32), weight.astype(np.float32), camera(size_px=side),
        sun_direction_mcmf=np.array([1.0, 0.0, 0.0]),
    )  # fmt: skip


def test_gaps_hold_what_lies_around_them_and_weigh_nothing() -> None:
    """A slope of 1 per column from 1000 on, with gaps at either end, one of NaN and one of invalid
    values.
    """
    signal = 1000.0 + np.broadcast_to(np.arange(80.0), (80, 80)).copy()
    weight = np.full(signal.shape, 0.5)
    for col, value in ((8, np.nan), (64, 1e6)):
        hole = np.s_[30:36, col : col + 6]
        signal[hole], weight[hole] = value, 0.0 if value > 0.0 else 0.5
    image = SearchImage.of(made(signal, weight))
    gone = np.zeros(signal.shape, bool)
    gone[30:36, 8:14] = gone[30:36, 64:70] = True
    np.testing.assert_array_equal(image.weight, np.where(gone, 0.0, 0.5))
    mean = signal[~gone].mean()
    np.testing.assert_allclose(image.fine[~gone], signal[~gone] - mean, atol=1e-3)
    for col in (8, 64):
        filled = image.fine[30:36, col : col + 6]
        assert np.abs(filled - (1002.5 + col - mean)).max() < 12.0  # not 0, the whole image's mean
    assert abs(float(image.fine[~gone].mean())) < 1e-3


@pytest.mark.parametrize("power", [0.45, 2.2])
def test_a_power_of_the_brightness_is_that_of_its_image(power: float) -> None:
    """In boxes, two of them across the border: up to a constant as the image that is raised whole; gaps lie across the
    edges of one. Elsewhere nothing is computed.
    """
    signal = np.random.default_rng(3).uniform(-0.1, 1.0, (150, 150))
    signal[50:60, 70:80] = signal[85:95, 35:45] = signal[5:9, 5:9] = np.nan
    photo = made(signal)
    raised = np.maximum(photo.signal.astype(float), 0.0) ** power
    whole, image = SearchImage.of(made(raised)), SearchImage.of(photo)
    boxes = [np.s_[55:90, 40:76], np.s_[0:30, 0:20], np.s_[140:160, 100:170]]
    bent, read = image.to_power(power, boxes), np.zeros(signal.shape, bool)
    for box in boxes:
        off = bent.fine[box] - whole.fine[box]
        np.testing.assert_allclose(off, off[0, 0], atol=1e-6)
        read[box] = True
    assert not bent.fine[~read].any()
    np.testing.assert_array_equal(bent.weight, whole.weight)


def test_half_resolution_is_the_mean_of_blocks() -> None:
    rng = np.random.default_rng(0)
    signal, weight = rng.normal(size=(21, 21)), rng.random((21, 21))
    image = SearchImage.of(made(signal, weight))
    for whole, half in ((image.fine, image.half), (image.weight, image.half_weight)):
        assert half.shape == (10, 10)
        assert half[3, 7] == pytest.approx(whole[6:8, 14:16].astype(float).mean(), abs=1e-6)
        assert half.mean() == pytest.approx(whole[:20, :20].mean(dtype=float), abs=1e-6)


def test_pixels_of_a_reduced_photo_in_those_that_came() -> None:
    """The centre of a reduced pixel is that of its block: of 3 x 3 pixels the middle one."""
    known = camera()
    nested = Reduced(Reduced(known, 2), 3)
    assert [s.factor for s in (known, Reduced(known, 2), nested)] == [1, 2, 6]
    np.testing.assert_array_equal(full_pixels(np.array([0.0, 5.0]), 3), [1.0, 16.0])
    ground = known.looks([100.25, 37.5])[0] + 110e3 * known.looks([100.25, 37.5])[1]
    np.testing.assert_allclose(full_pixels(nested.project(ground), 6), [100.25, 37.5], atol=1e-6)


def test_no_valid_pixel_is_refused() -> None:
    with pytest.raises(ValueError, match="no pixel of it is valid"):
        SearchImage.of(made(np.ones((9, 9)), np.zeros((9, 9))))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("share", "told"), [(0.0, False), (0.2, False), (0.27, False), (0.4, True), (1.0, True)])  # fmt: skip
def test_neighbours_that_are_alike_one_way_are_enough(axis: int, share: float, told: bool) -> None:
    """Noise plus a share of the next pixel's: neighbours correlate by c / (1 + c^2); 0.3 is
    required.
    """
    noise = np.random.default_rng(0).normal(size=(300, 300))
    signal = noise + share * np.roll(noise, 1, axis)
    likeness = share / (1.0 + share**2)
    assert (likeness > 0.3) == told
    said = nothing_in(made(100.0 + signal))
    assert (said is None) == told
    if not told:
        assert float(said.rsplit(" ", 1)[1]) == pytest.approx(likeness, abs=0.02)


def test_pixels_that_do_not_count_make_no_image() -> None:
    """Bright lines marked as invalid, on noise."""
    signal = np.random.default_rng(1).normal(size=(200, 200))
    weight = np.ones(signal.shape)
    signal[::2], weight[::2] = 1e4 * np.arange(100.0)[:, None], 0.0
    assert "nothing but noise" in nothing_in(made(signal, weight))
    assert nothing_in(made(signal)) is None
