"""The stripes of the sample's DEM that sample_data/PROVENANCE.txt explains: a beat with a grid of 100 m."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from scipy.ndimage import uniform_filter1d

DEM = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
BEAT_PX = 1.0 / (118.4505876 / 100.0 - 1.0)


def swing(heights: np.ndarray, axis: int, period_px: float) -> float:
    """Amplitude of the slope along an axis over its running mean, folded at a period; the median of
    each phase, of slopes above 25 m a pixel.
    """
    slope = np.diff(heights, axis=axis)
    mean = uniform_filter1d(slope, 13, axis=axis)
    steep = np.abs(mean) > 25.0
    phase = (np.indices(slope.shape)[axis] / period_px % 1.0 * 12).astype(int)
    of = [np.median(slope[steep & (phase == k)] / mean[steep & (phase == k)]) for k in range(12)]
    return (max(of) - min(of)) / (max(of) + min(of))


def test_slopes_swing_with_the_beat_of_the_two_grids() -> None:
    with rasterio.open(DEM) as file:
        heights = file.read(1)[:, ::6].astype(np.float64), file.read(1)[::6].astype(np.float64)
    for axis in (0, 1):
        assert swing(heights[axis], axis, BEAT_PX) == pytest.approx(0.09, abs=0.015)
        assert swing(heights[axis], axis, 1.02 * BEAT_PX) < 0.03
