"""Small terrains for tests and benchmarks: the same bits for the same arguments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def cratered(
    size: int, gsd_m: float = 20.0, seed: int = 1, relief_m: float = 1.0
) -> NDArray[np.float32]:
    """A fractal highland with craters, float32 (size, size).

    Power-law noise (amplitude ~ k^-1.85) of 600 m per 4096 nodes of 20 m, and craters of 3 to
    size/3 nodes with N(>D) ~ D^-2, depth 0.02-0.13 D and a rim that falls off as the cube; slopes
    are then cut to 32 deg at the 99.5th percentile, as on the Moon. ``relief_m`` scales all heights
    afterwards.
    """
    rng = np.random.default_rng(seed)
    z = _fractal(size, rng) * 600.0 * (size * gsd_m / 81920.0) ** 0.85
    _stamp_craters(z, gsd_m, rng)
    slope = np.hypot(*np.gradient(z, gsd_m))
    z *= min(1.0, np.tan(np.radians(32.0)) / np.percentile(slope, 99.5))
    return ((z - z.mean()) * relief_m).astype(np.float32)


def _fractal(size: int, rng: np.random.Generator) -> NDArray[np.float64]:
    k = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None, :])
    k[0, 0] = 1.0
    amplitude = k**-1.85
    amplitude[0, 0] = 0.0
    z = np.fft.irfft2(
        amplitude * (rng.normal(size=k.shape) + 1j * rng.normal(size=k.shape)), s=(size, size)
    )
    return z / z.std()


def _stamp_craters(z: NDArray[np.float64], gsd_m: float, rng: np.random.Generator) -> None:
    size = len(z)
    smallest, largest = 3.0, max(size / 3.0, 4.0)
    count = int(0.05 * (smallest**-2 - largest**-2) * size * size)
    diameter = (smallest**-2 - rng.random(count) * (smallest**-2 - largest**-2)) ** -0.5
    age = rng.random(count) ** 1.5
    for d, a, row, col in zip(diameter, age, *(rng.random((2, count)) * size), strict=True):
        depth, rim, reach = (0.02 + 0.11 * a) * d * gsd_m, 0.03 * a * d * gsd_m, 1.5 * d
        i0, i1 = max(int(row - reach), 0), min(int(row + reach) + 2, size)
        j0, j1 = max(int(col - reach), 0), min(int(col + reach) + 2, size)
        r = np.hypot(np.arange(i0, i1)[:, None] - row, np.arange(j0, j1) - col) / (d / 2.0)
        outside = rim * (np.maximum(r, 1.0) ** -3 - 1.0 / 27.0) * (27.0 / 26.0)
        z[i0:i1, j0:j1] += np.where(
            r < 1.0, (depth + rim) * r * r - depth, np.maximum(outside, 0.0)
        )
