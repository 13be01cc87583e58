"""The Moon's belt at 512 pixels a degree, on virtual files that take 14 MB: time and memory of planning,
and of some random areas, and what the areas make of a build of all of them. And the commands that read
a large catalogue.

    python -m benchmarks.speed scale [plan] [areas] [catalog] [--count AREAS] [--points POINTS]

Prints a table for each. Times are those of the processor, of one process with one thread in the areas.
"""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import sections
from benchmarks.commands import lcp
from benchmarks.markdown import table
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.memory import peak_mb
from lcp_catalog.production.area_job import run_area
from lcp_catalog.production.assembly import choose
from lcp_catalog.production.config import AreaConfig, BuildConfig
from lcp_catalog.production.finished_area import table_of
from lcp_catalog.production.run import Build
from lcp_catalog.threads import limit_threads
from tests.helpers import many_points
from tests.helpers.virtual_moon import virtual_moon

PIXELS_PER_DEGREE = 512
BELT = BuildConfig(area=AreaConfig(bounds_deg=(-180.0, -60.0, 180.0, 60.0)))
"""60 S to 60 N."""


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed scale", __doc__)
    parts = ("plan", "areas", "catalog")
    parser.add_argument("parts", nargs="*", choices=[[], *parts], metavar="PART")
    parser.add_argument("--count", type=int, default=6, help="areas: so many random ones")
    parser.add_argument("--points", type=int, default=200_000, help="catalog: of the catalogue")
    given = parser.parse_args(words)
    asked = given.parts or parts
    with tempfile.TemporaryDirectory() as folder:
        files = virtual_moon(Path(folder), PIXELS_PER_DEGREE)
        if "plan" in asked:
            rows = [["60 S to 60 N", *_apart(_planned, files)]]
            print(table(["region", "areas", "plan, s", "peak memory, MB"], rows))
        if "areas" in asked:
            _areas(files, given.count)
        if "catalog" in asked:
            print(_catalog(Path(folder), given.points))
    return 0


def _apart(function: Callable[..., list[str]], *arguments: object) -> list[str]:
    """The result of a function in a process of its own, whose memory is the function's."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def _planned(files: list[Path]) -> list[str]:
    start = time.process_time()
    build = Build.plan(files, BELT)
    return [f"{len(build.jobs)}", f"{time.process_time() - start:.1f}", f"{peak_mb():.0f}"]


def _areas(files: list[Path], count: int) -> None:
    """Seconds and points of random areas of the belt, alone, and the build of all areas from them."""
    build = Build.plan(files, BELT)
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
            points.append(len(choose(table_of(found, build.recipe.config), build.recipe.config)))
            held.append(len(found))
            at, took = f"{job.task.lat_deg:.1f}", f"{seconds[-1]:.1f}"
            rows.append([job.task.name, at, took, str(held[-1]), str(points[-1])])
    print(table(["area", "latitude", "s", "candidates", "points"], rows))
    areas, mean = len(build.jobs), float(np.mean(seconds))
    print(f"\npeak memory {peak_mb():.0f} MB; mean {mean:.1f} s, {np.mean(points):.1f} points\n")
    total = f"{areas * mean / 3600.0:.1f} h of one core, about {areas * float(np.mean(points)):,.0f} points"
    print(f"{areas} areas, {total}")


def _catalog(folder: Path, points: int) -> str:
    """Processor time and peak memory of commands that read a synthetic catalogue (patches of 5 x 5 nodes, 2 image scales,
    2 views, 5 x 12 Suns), and another with other heights and ids.
    """
    path, other = folder / "large.h5", folder / "other.h5"
    _apart(_written, path, other, points)
    page = str(folder / "report.html")
    commands: list[tuple[int, list[object]]] = [
        (0, ["inspect", path]),
        (0, ["report", path, "-o", page]),
        (0, ["export", path, "-o", folder / "x.csv"]),
        (4, ["diff", path, other]),
    ]
    rows = []
    for good, words in commands:
        done = lcp(*map(str, words), good=good)
        peak_mb = max(done.parent_mb, done.worker_mb)
        rows.append([f"`lcp {words[0]}`", f"{done.processor_s:.1f}", f"{peak_mb:.0f}"])
    size_mb = path.stat().st_size / 1e6
    return table([f"{points} points, {size_mb:.0f} MB", "s", "peak memory, MB"], rows)


def _written(path: Path, other: Path, points: int) -> list[str]:
    """Write both catalogues."""
    write_catalog(many_points.catalog(points), path)
    catalog = open_catalog(path, check=False)
    dem = catalog.dem + np.float32(1.0)
    dem[:, catalog.patch_nodes // 2, catalog.patch_nodes // 2] = 0.0
    moved = np.arange(len(catalog)) % 10 == 0
    write_catalog(replace(catalog, dem=dem, point_id=catalog.point_id + 10**9 * moved), other)
    return []
