"""The whole Moon at 512 pixels a degree, on virtual files that take 14 MB: time and memory of planning,
of the maps, and of some random areas, and what the areas make of a build of all of them.

    python benchmarks/moon.py [plan] [maps] [areas [COUNT]]

Prints a table for each. Times are those of the processor, of one process with one thread in the areas.
"""

from __future__ import annotations

import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]

import numpy as np
from build_tables import table
from helpers.virtual_moon import virtual_moon

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.memory import peak_mb
from lcp_catalog.production.area_job import run_area
from lcp_catalog.production.assembly import choose
from lcp_catalog.production.config import AreaConfig, BuildConfig
from lcp_catalog.production.finished_area import table_of
from lcp_catalog.production.region_maps import region_coverage, region_overview
from lcp_catalog.production.run import Build
from lcp_catalog.terrain.area import Area
from lcp_catalog.threads import limit_threads

PIXELS_PER_DEGREE = 512
REGIONS = {
    "60 S to 60 N": (-180.0, -60.0, 180.0, 60.0),
    "north of 60 N": (-180.0, 60.0, 180.0, 90.0),
    "whole Moon": (-180.0, -90.0, 180.0, 90.0),
}
CORES = (1, 2, 64, 1000)
POINTS = 1_000_000
"""Points of the coverage that is timed."""


def main() -> None:
    words = sys.argv[1:] or ["plan", "maps", "areas"]
    count = next((int(word) for word in words if word.isdigit()), 6)
    with tempfile.TemporaryDirectory() as folder:
        files = virtual_moon(Path(folder), PIXELS_PER_DEGREE)
        if "plan" in words:
            rows = [[name, *_apart(_planned, files, box)] for name, box in REGIONS.items()]
            print(table(["region", "areas", "plan, s", "peak memory, MB"], rows))
        if "maps" in words:
            heads = ["region", "overview, s", "cells", "step, km", "coverage, s", "peak memory, MB"]
            print(table(heads, []))
            for name, box in REGIONS.items():
                print(f"| {' | '.join([name, *_apart(_mapped, files, box)])} |", flush=True)
        if "areas" in words:
            _areas(files, count)


def _apart(function: Callable[..., list[str]], *arguments: object) -> list[str]:
    """The result of a function in a process of its own, whose memory is the function's."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def _config(bounds: tuple[float, ...]) -> BuildConfig:
    return BuildConfig(area=AreaConfig(bounds_deg=bounds))


def _planned(files: list[Path], bounds: tuple[float, ...]) -> list[str]:
    start = time.process_time()
    build = Build.plan(files, _config(bounds))
    return [f"{len(build.jobs)}", f"{time.process_time() - start:.1f}", f"{peak_mb():.0f}"]


def _mapped(files: list[Path], bounds: tuple[float, float, float, float]) -> list[str]:
    """Overview, and coverage for random points with 40 conditions, with as many candidates."""
    dems, region = DemSet.open(files), Area.from_bounds(*bounds)
    start = time.process_time()
    region_overview(dems, region, 60.0)
    seen = time.process_time()
    rng = np.random.default_rng(7)
    south, north = np.sin(np.radians([bounds[1], bounds[3]]))
    lon, lat = (
        rng.uniform(0.0, 360.0, POINTS),
        np.degrees(np.arcsin(rng.uniform(south, north, POINTS))),
    )
    condition = rng.choice(np.array([0, 1, 31], np.uint8), (POINTS, 1, 5, 8))
    places, stages = (lon, lat), np.full(POINTS, 3)
    start_coverage = time.process_time()
    cells = region_coverage(
        dems, region, places, stages, places, condition, 3800.0, range(len(dems.dems))
    )
    assert cells.step_m is not None
    return [
        f"{seen - start:.1f}",
        f"{len(cells.longitude)}",
        f"{cells.step_m / 1e3:.1f}",
        f"{time.process_time() - start_coverage:.1f}",
        f"{peak_mb():.0f}",
    ]


def _areas(files: list[Path], count: int) -> None:
    """Seconds and points of random areas of the belt, alone, and the build of all areas from them."""
    build = Build.plan(files, _config(REGIONS["60 S to 60 N"]))
    rng = np.random.default_rng(16)
    chosen = rng.choice(len(build.jobs), count, replace=False)
    seconds, points, held, rows = [], [], [], []
    with limit_threads(1):
        run_area(build.jobs[int(chosen[0])])  # loads the kernels
        for index in chosen.tolist():
            job = build.jobs[index]
            start = time.process_time()
            found = run_area(job).candidates
            seconds.append(time.process_time() - start)
            points.append(len(choose(table_of(found, build.config), build.config, build.gsd_m)))
            held.append(len(found))
            at, took = f"{job.task.lat_deg:.1f}", f"{seconds[-1]:.1f}"
            rows.append([job.task.name, at, took, str(held[-1]), str(points[-1])])
    print(table(["area", "latitude", "s", "candidates", "points"], rows))
    areas, mean = len(build.jobs), float(np.mean(seconds))
    print(f"\npeak memory {peak_mb():.0f} MB; mean {mean:.1f} s, {np.mean(points):.1f} points\n")
    days = [[str(cores), f"{areas * mean / cores / 3600.0:.1f}"] for cores in CORES]
    print(table(["cores", "hours for all areas"], days))
    print(f"{areas} areas, about {areas * float(np.mean(points)):,.0f} points")


if __name__ == "__main__":
    main()
