"""Time of a whole area through the pipeline, time to read its terrain, and memory of the terrain for each cell."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.production.area_job import run_area
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.run import Build
from lcp_catalog.production.sweep import Conditions
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.terrain import build_terrain
from lcp_catalog.threads import limit_threads

SAMPLE = Path(__file__).resolve().parents[1] / "sample_data"
DEM = SAMPLE / "hadley_gld100_256ppd.tif"
GSD_M = 118.45


def test_area(benchmark):
    """The middle area of the sample's build on one thread: terrain, sweep, candidates, evaluation."""
    build = Build.plan((DEM,), BuildConfig.from_toml(SAMPLE / "hadley.toml"))
    job = build.jobs[len(build.jobs) // 2 - 3]
    with limit_threads(1):
        result = benchmark.pedantic(run_area, (job,), rounds=3, warmup_rounds=1).candidates
    if benchmark.stats:
        conditions = Conditions.at(job.task.lat_deg, build.config).count
        seconds = benchmark.stats.stats.min
        benchmark.extra_info["candidates"] = len(result)
        benchmark.extra_info["conditions"] = conditions
        benchmark.extra_info["ms a candidate and condition"] = round(
            1e3 * seconds / (len(result) * conditions), 3
        )


@pytest.mark.parametrize("nodes", [1024, 2048])
def test_terrain(benchmark, nodes):
    """From the GeoTIFF to a heightfield; bytes per cell that are kept, and the peak meanwhile."""
    dems, frame = DemSet.open([DEM]), EnuFrame(5.0, 25.0)
    window = NodeWindow(-nodes // 2, nodes // 2, -nodes // 2, nodes // 2)

    def make():
        terrain = build_terrain(dems, frame, window, GSD_M)
        terrain.field.occluded_nodes([1.0, 0.0, 0.1], (0, 2, 0, 2))  # makes the pyramid
        return terrain

    benchmark.pedantic(make, rounds=3, warmup_rounds=1)
    tracemalloc.start()
    terrain = make()
    kept, peak = (size / nodes**2 for size in tracemalloc.get_traced_memory())
    tracemalloc.stop()
    del terrain
    if benchmark.stats:
        benchmark.extra_info["Mnode/s"] = round(nodes**2 / benchmark.stats.stats.min / 1e6, 2)
        benchmark.extra_info["bytes a cell kept"] = round(kept, 2)
        benchmark.extra_info["bytes a cell at most"] = round(peak, 1)
