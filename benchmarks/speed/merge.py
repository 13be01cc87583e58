"""The end and the resumption of a large build, on made checkpoints: peak memory and rate of the merge of a
million points, and the time of the check of 100 000 finished areas.

    python -m benchmarks.speed merge [--full] [--points N] [--areas N]

The points have patches of 9 x 9 nodes and 4 conditions (``--full``: patches of 33 x 33 nodes and the
conditions of the sample's build); beside every second stands a candidate that cannot become a
point. The checkpoints are made in a process of their own, so that the peak is that of the merge.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import sections
from lcp_catalog.catalog.schema import EVALUATED, USABLE
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.memory import peak_mb
from lcp_catalog.production.assembly import Assembly
from lcp_catalog.production.checkpoints import Checkpoints
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.finished_area import TABLE, FinishedArea, checksums, record_type
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.recipe import Recipe
from lcp_catalog.production.sweep import law_of_build
from lcp_catalog.rendering.decisions import Decision
from lcp_catalog.rendering.plan import ScenePlan
from lcp_catalog.terrain.area import Area
from tests.helpers.virtual_moon import virtual_moon

GSD_M, SPACING_M, STEP_M = 250.0, 1000.0, 1200.0
SIDE = 25  # points along the side of an area
DEGREE_M = 30323.35
SMALL = BuildConfig(
    area=AreaConfig(gsd_m=GSD_M),
    sun=SunConfig((90.0, 270.0), (10.0, 30.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    points=PointConfig(patch_nodes=9, spacing_m=SPACING_M, search_m=2000.0),
)
FULL = BuildConfig(
    area=SMALL.area,
    points=PointConfig(spacing_m=SPACING_M, search_m=2000.0),
    view=ViewConfig((0.0, 30.0, 30.0), (0.0, 90.0, 270.0), (float("inf"),) * 3),
)


def area(config: BuildConfig, row: int, column: int) -> FinishedArea:
    """An area whose points all are further apart than the spacing; a third of the candidates is unusable."""
    rng = np.random.default_rng([row, column])
    count = SIDE * SIDE
    table = np.zeros(count + count // 2, TABLE)
    east, north = np.meshgrid(np.arange(SIDE) + column * SIDE, np.arange(SIDE) + row * SIDE)
    jitter = rng.uniform(-0.05, 0.05, (2, count))
    table["lon_deg"][:count] = (east.ravel() + jitter[0]) * STEP_M / DEGREE_M * 1.1 + 1.0
    table["lat_deg"][:count] = (north.ravel() + jitter[1]) * STEP_M / DEGREE_M - 20.0
    table[count:] = table[: count // 2]
    records = np.zeros(count, record_type(config))
    records["dem"] = rng.normal(0.0, 30.0, records["dem"].shape)
    middle = config.points.half
    records["dem"][:, middle, middle] = 0.0
    works = rng.random(records["condition"].shape) < 0.8
    works[:, 0, 0, 0] = True
    records["condition"] = np.where(works, USABLE, EVALUATED)
    records["detection_probability"][:, 0] = np.where(works, 250, 0)
    records["sigma_minor"] = rng.integers(50, 100, records["sigma_minor"].shape)
    records["sigma_major"] = records["sigma_minor"] + 10
    records["localization_sigma"] = 2.0, 1.0
    records["gsd_min"] = records["gsd_max"] = GSD_M
    table["worth"][:count] = works.sum(axis=(1, 2, 3))
    table["stage"] = np.where(table["worth"] > 0, 3, 1)
    table["quality"] = rng.normal(size=len(table))
    table["checksum"][:count] = checksums(records)
    reason = f"the terrain of area {row}, {column} is like that of the others, but not the same"
    effects = [Decision(f"effect {k}", k % 2 > 0, reason, rng.random(), "m") for k in range(9)]
    return FinishedArea(table, records, ScenePlan.of(effects))


def make(config: BuildConfig, folder: Path, areas: int) -> None:
    """Checkpoints of a square of areas."""
    checkpoints = Checkpoints.beside(folder / "moon.h5", {"source code": "merge"})
    checkpoints.folder.mkdir()
    for k in range(areas):
        checkpoints.write(name(k), area(config, k // 40, k % 40))


def name(number: int) -> str:
    """Name of the checkpoint of an area."""
    return f"r{number // 1000:05d}c{number % 1000:05d}"


def merge(config: BuildConfig, folder: Path, areas: int) -> None:
    """Print the rate and the peak memory of the merge."""
    dems = DemSet.open(virtual_moon(folder / "moon", 8, tile_px=512)[:1])
    rows = -(-areas // 40) * SIDE * STEP_M / DEGREE_M
    width = min(areas, 40) * SIDE * STEP_M / DEGREE_M * 1.1 + 1.0
    region = Area.from_bounds(1.0, -20.0, 1.0 + width, -20.0 + rows)
    errors = config.errors.model(5.0, 500.0)
    recipe = Recipe(config.at_cell(GSD_M), dems, region, law_of_build(config, -20.0), errors)
    checkpoints = Checkpoints.beside(folder / "moon.h5", {"source code": "merge"})
    before, start, own = peak_mb(), time.perf_counter(), time.process_time()
    names = [name(k) for k in range(areas)]
    assembly = Assembly(recipe, checkpoints, names)
    points = assembly.write(folder / "moon.h5", overwrite=True, check=lambda: None)
    seconds, own = time.perf_counter() - start, time.process_time() - own
    size = (folder / "moon.h5").stat().st_size
    each = record_type(config).itemsize
    print(f"merge: {areas} areas, {points} points with records of {each} bytes")
    print(
        f"merge: {seconds:.1f} s, {own:.1f} s of processor time, {points / own:.0f} points/s of it"
    )
    print(f"merge: peak {peak_mb():.0f} MB, {before:.0f} MB before; file of {size / 1e6:.0f} MB")


def resume(config: BuildConfig, folder: Path, areas: int) -> None:
    """Print the time of the check of so many small checkpoints."""
    checkpoints = Checkpoints.beside(folder / "tiny.h5", {"source code": "merge"})
    checkpoints.folder.mkdir()
    whole = area(config, 0, 0)
    some = FinishedArea(whole.table[:4], whole.records[:4], whole.plan)
    checkpoints.write(name(0), some)
    content = checkpoints.path(name(0)).read_bytes()
    for k in range(1, areas):
        checkpoints.path(name(k)).write_bytes(content)
    start, own = time.perf_counter(), time.process_time()
    found = sum(checkpoints.is_whole(name(k)) for k in range(areas))
    seconds, own = time.perf_counter() - start, time.process_time() - own
    print(
        f"resume: {found} of {areas} checkpoints of {len(content)} bytes whole, {seconds:.1f} s "
        f"({own:.1f} s of processor time)"
    )


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed merge", __doc__)
    parser.add_argument("--full", action="store_true", help="points as large as the sample's")
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--areas", type=int, default=100_000, help="that are checked")
    given = parser.parse_args(words)
    config, count = FULL if given.full else SMALL, given.points // SIDE**2
    folder = Path(tempfile.mkdtemp(prefix="lcp-merge-", dir=os.environ.get("TMPDIR")))
    context = multiprocessing.get_context("spawn")
    codes = []
    try:
        for task, areas in ((make, count), (merge, count), (resume, given.areas)):
            process = context.Process(target=task, args=(config, folder, areas))
            process.start()
            process.join()
            codes.append(process.exitcode or 0)
    finally:
        shutil.rmtree(folder)
    return max(codes)
