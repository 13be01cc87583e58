"""The choice of points by promise on the sample: number of points, lower bound, share of the promise that is
kept, and processor time of the choice.

    .venv/bin/python benchmarks/promise.py [JOBS]

The areas of ``sample_data/hadley.toml`` are computed once (67 areas: 40 s on two quiet cores, 4 minutes on
a busy machine).
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from lcp_catalog.catalog.schema import NO_CELL, Cause
from lcp_catalog.production.assembly import choose
from lcp_catalog.production.checkpoints import Checkpoints
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.guarantee import Promise
from lcp_catalog.production.joined_areas import JoinedAreas
from lcp_catalog.production.run import Build, compute_areas

SAMPLE = Path(__file__).parent.parent / "sample_data"
VARIANTS: tuple[dict[str, Any], ...] = (
    {"per_view": 8},
    {"per_view": 24},
    {"per_view": 8, "footprint_km": 50.0},
    {"per_view": 8, "max_points": 40},
)


def with_points(config: BuildConfig, **given: Any) -> BuildConfig:
    """The configuration with other settings of points."""
    return dataclasses.replace(config, points=dataclasses.replace(config.points, **given))


def report(build: Build, checkpoints: Checkpoints, given: dict[str, Any]) -> None:
    """Print the figures of a choice."""
    start = time.process_time()
    promise = Promise.of(build.region, with_points(build.config, **given), build.gsd_m)
    assert promise is not None
    names = [job.task.name for job in build.jobs]
    areas = JoinedAreas.read(checkpoints, names, promise.see)
    held = np.ones(len(promise.best), np.bool_)
    rows, told = promise.choose(areas.table, held, given.get("max_points"))
    seconds = time.process_time() - start
    counts = np.bincount(told.cause[told.cause != NO_CELL], minlength=len(Cause))
    shares = {cause.name.lower(): f"{counts[cause] / counts.sum():.3f}" for cause in Cause}
    print(f"promise: {given}: {len(rows)} points of {len(areas.table)} candidates, {seconds:.1f} s")
    print(f"promise:   lower bound {told.lower_bound:.1f}, places {len(promise.best)}, {shares}")


def main() -> None:
    """Compute the areas, then choose."""
    config = BuildConfig.from_toml(SAMPLE / "hadley.toml")
    jobs = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    build = Build.plan((SAMPLE / "hadley_gld100_256ppd.tif",), with_points(config, per_view=8))
    with tempfile.TemporaryDirectory() as folder:
        checkpoints = Checkpoints.beside(Path(folder) / "hadley.h5", "promise")
        checkpoints.folder.mkdir()
        none: dict[str, Any] = {"scheduler": None, "keep_going": False, "started": None}
        compute_areas(
            build, build.jobs, checkpoints, jobs, progress=lambda done, total: None, **none
        )
        for given in VARIANTS:
            report(build, checkpoints, given)
        table = JoinedAreas.read(checkpoints, [job.task.name for job in build.jobs]).table
        print(f"promise: by spacing {len(choose(table, config, build.gsd_m))} points")


if __name__ == "__main__":
    main()
