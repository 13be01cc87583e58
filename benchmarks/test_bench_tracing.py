"""Speed of exact shadows, camera rays and sweeps, and the memory that they keep."""

from __future__ import annotations

import math
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lcp_catalog.accuracy import TIERS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import occluded, occluded_sweep
from lcp_catalog.threads import limit_threads, thread_limit

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.synthetic import cratered

GSD = 20.0
SIZES = (1024, 2048, 4096)
ROUNDS = 3


@cache
def terrain(size: int) -> Heightfield:
    """Tiles of one cratered square, mirrored so that they join (the generator is slow)."""
    z = cratered(512, GSD)
    block = np.block([[z, z[:, ::-1]], [z[::-1], z[::-1, ::-1]]])
    return Heightfield(np.tile(block, (size // 1024, size // 1024)), GSD)


def timed(benchmark, count: int, unit: str, task, *arguments) -> None:
    benchmark.pedantic(task, arguments, rounds=ROUNDS, warmup_rounds=1)
    if benchmark.stats:
        benchmark.extra_info[unit] = round(count / benchmark.stats.stats.min / 1e6, 2)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("elevation_deg", [0.5, 5, 15])
@pytest.mark.parametrize("size", SIZES)
def test_exact_shadow(benchmark, size, elevation_deg, threads):
    with limit_threads(min(threads, thread_limit())):
        timed(
            benchmark,
            size * size,
            "Mray/s",
            terrain(size).occluded_nodes,
            direction_enu(37, elevation_deg),
        )


@pytest.mark.parametrize("tier", ["draft", "standard", "high"])
@pytest.mark.parametrize("elevation_deg", [0.5, 5, 15])
@pytest.mark.parametrize("size", SIZES)
def test_tier(benchmark, size, elevation_deg, tier):
    field, direction = terrain(size), direction_enu(17, elevation_deg)
    timed(benchmark, size * size, "Mnode/s", occluded, field, direction, TIERS[tier])


@pytest.mark.parametrize("size", SIZES)
def test_camera(benchmark, size):
    """A square pinhole image from 100 km, 30 deg from the vertical, one pixel per cell in the middle."""
    pixels, away = 1024, 1e5
    axis = np.array([math.sin(math.radians(30)), 0.0, math.cos(math.radians(30))])
    middle = np.array([0.5 * size * GSD, -0.5 * size * GSD, 0.0])
    right, up = np.array([0.0, 1.0, 0.0]), np.cross(axis, [0.0, 1.0, 0.0])
    a = (np.arange(pixels) - 0.5 * pixels) * GSD / away
    rays = -axis + a[None, :, None] * right + a[:, None, None] * up
    timed(
        benchmark, pixels * pixels, "Mray/s", terrain(size).first_hits, middle + away * axis, rays
    )


@pytest.mark.parametrize("size", SIZES)
def test_sweep(benchmark, size):
    """16 azimuths of 8 elevations."""
    field, elevations = terrain(size), np.radians([0.5, 1, 2, 5, 8, 12, 20, 40])

    def sweep() -> None:
        for step in range(16):
            occluded_sweep(field, 2.0 * math.pi * (step + 0.1) / 16, elevations, TIERS["draft"])

    timed(benchmark, 128 * size * size, "Msun-cells/s", sweep)


def test_fragments(benchmark):
    rng = np.random.default_rng(1)
    rows, cols = rng.integers(0, 1024, (2, 200))
    timed(
        benchmark,
        200 * 33 * 33,
        "Mray/s",
        terrain(1024).occluded_alone,
        rows,
        cols,
        16,
        direction_enu(37, 5),
    )


def test_bytes_a_cell(benchmark):
    """Bytes per cell of the arrays that a heightfield keeps after every kind of query; the limit is 12."""
    field = terrain(2048)
    benchmark.pedantic(field.occluded_nodes, (direction_enu(37, 45),), rounds=1)
    occluded(field, direction_enu(90, 5), TIERS["draft"])  # the transposed copy
    kept = sum(_bytes(value) for value in vars(field).values())
    benchmark.extra_info["bytes a cell"] = round(kept / field.z_m.size, 2)
    assert kept / field.z_m.size <= 12.0


def _bytes(value: object) -> int:
    if isinstance(value, tuple):
        return sum(_bytes(part) for part in value)
    return value.nbytes if isinstance(value, np.ndarray) else 0
