"""What the machine can do (multiplications with additions in single precision, copying), and the least
time that the arithmetic and the traffic of an area's stages would take at that rate.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from benchmarks.markdown import percent, table
from lcp_catalog.kernels.vectors import LANES, load, splat, store

CHAINS = 10
"""Independent sums of vectors: enough for the latency of the vector units."""
COPIED = 32 * 1024 * 1024
"""Elements of the array that is copied (128 MB): more than the last cache holds."""


@njit(nogil=True)
def _chains(sums, count):
    """Multiply ten vectors by 0.5 and add 1, ``count`` times."""
    x, y = splat(np.float32(0.5)), splat(np.float32(1.0))
    a = b = c = d = e = f = g = h = i = j = load(sums, 0)
    for _ in range(count):
        a, b, c, d, e = a * x + y, b * x + y, c * x + y, d * x + y, e * x + y
        f, g, h, i, j = f * x + y, g * x + y, h * x + y, i * x + y, j * x + y
    store(sums, 0, a + b + c + d + e + f + g + h + i + j)


@njit(nogil=True)
def _copy(source, target):
    for k in range(source.size):
        target[k] = source[k]


@dataclass(frozen=True)
class Machine:
    """One core: 10^9 operations in single precision a second (a multiplication with its addition is
    two), and 10^9 bytes read or written a second in a copy."""

    operations: float
    copy: float

    @classmethod
    def measured(cls, rounds: int = 7) -> Machine:
        """The best of the rounds."""
        sums, count = np.zeros(LANES, np.float32), 10_000_000
        source, target = np.ones(COPIED, np.float32), np.zeros(COPIED, np.float32)
        _chains(sums, 1)
        _copy(source, target)
        rates: tuple[list[float], list[float]] = ([], [])
        for _ in range(rounds):
            start = time.process_time()
            _chains(sums, count)
            middle = time.process_time()
            _copy(source, target)
            end = time.process_time()
            rates[0].append(2.0 * CHAINS * LANES * count / (middle - start))
            rates[1].append(2.0 * source.nbytes / (end - middle))
        return cls(*(max(each) / 1e9 for each in rates))

    def text(self) -> str:
        return (
            f"Peak of a core: {self.operations:.0f} G operations/s in single precision, "
            f"{self.copy:.1f} GB/s read and written in a copy.\n"
        )


@dataclass(frozen=True)
class Work:
    """Operations and bytes of a stage in its direct form."""

    stage: str
    what: str
    operations: float = 0.0
    bytes_moved: float = 0.0

    def least_seconds(self, machine: Machine) -> float:
        """At the machine's peak."""
        return max(self.operations / machine.operations, self.bytes_moved / machine.copy) / 1e9


def search_operations(patch: int, reach: int) -> float:
    """Of the products of a patch with every window of a search square."""
    return 2.0 * patch**2 * (2 * reach + 1) ** 2


def covariance_operations(patch: int) -> float:
    """Of products with the noise covariance: four fields through ten products with p x p matrices."""
    return 4 * 10 * 2.0 * patch**3


def work_of(job: Any, result: Any, scales: tuple[int, ...]) -> list[Work]:
    """The work of an area: searches and covariances of the candidate-conditions that are lit, shadows
    of every node and Sun and the shading of every node and condition once."""
    points, found = job.recipe.config.points, result.candidates.evaluation
    lit = int(np.isfinite(found.second_peak).sum())
    views, *suns = found.condition.shape[1:]
    halo = points.search_nodes(job.recipe.gsd_m) + points.half
    nodes = int(np.prod(job.task.window.grown(halo).shape))
    dark = nodes * int(
        (found.condition.any(axis=(0, 1)) if len(result.candidates) else np.ones(suns)).sum()
    )
    patches = [2 * (points.half // scale) + 1 for scale in scales]
    reaches = [max(1, points.search_nodes(job.recipe.gsd_m) // scale) for scale in scales]
    searched = sum(search_operations(p, r) for p, r in zip(patches, reaches, strict=True))
    spread = sum(covariance_operations(p) for p in patches)
    return [
        Work("uniqueness", f"{lit} patches, {searched / 1e6:.1f} M operations each", lit * searched),
        Work("localization, detection", f"{lit} patches, {spread / 1e6:.1f} M each", lit * spread),
        Work("shadows", f"{dark / 1e6:.2f} M nodes and Suns, 5 bytes each", bytes_moved=5.0 * dark),
        Work("shading", f"{views * dark / 1e6:.2f} M nodes and conditions, 54 bytes each", bytes_moved=54.0 * views * dark),
    ]  # fmt: skip


def roofline_table(works: list[Work], stages: list[dict[str, float]], machine: Machine) -> str:
    """Least times beside the measured ones, medians."""
    rows = []
    for work in works:
        least = work.least_seconds(machine)
        took = statistics.median(part[work.stage] for part in stages)
        share = percent(least / took, 0) if took > 0.0 else ""
        rows.append([work.stage, work.what, f"{1e3 * least:.1f}", f"{1e3 * took:.1f}", share])
    return table(["stage", "direct form", "at the peak, ms", "measured, ms", "share"], rows)
