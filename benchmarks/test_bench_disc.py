"""Cost of the finite Sun: the disc's share at every node relative to a point Sun's shadow, by tier;
measured figures are in docs/measurements/accuracy.md.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lcp_catalog.accuracy import TIERS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.light.solar_disc import sunlit_share
from lcp_catalog.terrain import occlusion
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.horizons import Nodes

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.synthetic import cratered

GSD = 20.0
ROUNDS = 5


@pytest.fixture(scope="module")
def terrain() -> Heightfield:
    """1024 x 1024: a cratered square, mirrored so that its copies join without a step."""
    z = cratered(512, GSD)
    return Heightfield(np.block([[z, z[:, ::-1]], [z[::-1], z[::-1, ::-1]]]), GSD)


def seconds(task, *arguments) -> float:
    start = time.perf_counter()
    task(*arguments)
    return time.perf_counter() - start


@pytest.mark.parametrize("tier", ["draft", "standard", "high"])
@pytest.mark.parametrize("elevation_deg", [0.5, 2, 5, 15])
def test_disc_against_point(benchmark, terrain, elevation_deg, tier):
    """Disc and point in turn, under the same load of the machine; ``ratio`` of the best times."""
    sun, accuracy = direction_enu(37, elevation_deg), TIERS[tier]
    sunlit_share(terrain, sun, accuracy)
    occlusion.occluded(terrain, sun, accuracy)
    point = min(seconds(occlusion.occluded, terrain, sun, accuracy) for _ in range(ROUNDS))
    benchmark.pedantic(sunlit_share, (terrain, sun, accuracy), rounds=ROUNDS)
    if benchmark.stats:
        best, count = benchmark.stats.stats.min, terrain.z_m.size
        benchmark.extra_info["Mnode/s"] = round(count / best / 1e6, 2)
        benchmark.extra_info["ratio"] = round(best / point, 1)


@pytest.mark.parametrize("elevation_deg", [0.5, 2, 5, 15])
def test_horizons(benchmark, terrain, elevation_deg):
    """One horizon for every node, within the height of the disc."""
    rows, cols = (k.ravel() for k in np.indices(terrain.shape))
    du, dv, slope = terrain.ray_in_cells(direction_enu(37, elevation_deg))
    planes = np.array([[du, dv, slope - 0.0047 * GSD, slope + 0.0047 * GSD]])
    benchmark.pedantic(Nodes(terrain, rows, cols).horizons, (planes,), rounds=3, warmup_rounds=1)
    if benchmark.stats:
        best = benchmark.stats.stats.min
        benchmark.extra_info["Mray/s"] = round(rows.size / best / 1e6, 2)
