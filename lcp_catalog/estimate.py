"""What a build would do and cost; its time is measured on one of its areas, not guessed."""

from __future__ import annotations

import time
from typing import Any

from .assemble import decisions
from .build import Build
from .job import Candidates, run_area
from .sweep import Conditions
from .threads import limit_threads

BYTES_A_NODE = 16
"""Heights, pyramid, normals and product of a node of terrain (measured: benchmarks)."""

WORKER_MB = 260
"""A worker's interpreter with the libraries and compiled kernels loaded (measured: VmRSS after imports and one small area)."""

COMPRESSION = 0.35
"""Bytes in the file for each byte of the arrays (measured on the sample)."""


def estimate(build: Build, workers: int) -> dict[str, Any]:
    """The document of ``lcp build-catalog --plan``: areas, conditions, memory and, from one measured area, time and size."""
    config, gsd_m = build.config, build.gsd_m
    conditions = [Conditions.at(job.task.lat_deg, config) for job in build.jobs]
    halo = config.points.search_nodes(gsd_m) + config.points.half
    nodes = [rows * cols for rows, cols in (job.task.window.grown(halo).shape for job in build.jobs)]
    ring = int(config.model.ring_max_km * 1e3 / gsd_m)
    widest = max((r + 2 * ring) * (c + 2 * ring) for r, c in (job.task.window.grown(halo).shape for job in build.jobs))
    cost = [n * c.count for n, c in zip(nodes, conditions, strict=True)]
    sample = sorted(range(len(cost)), key=cost.__getitem__)[len(cost) // 2]
    seconds, result = _measured(build, sample)
    per_area = len(build.jobs) / max(1, min(workers, len(build.jobs)))
    a_point = config.points.patch_nodes**2 * 4 + max(c.count for c in conditions)
    cells = sum(r * c for r, c in (job.task.window.shape for job in build.jobs)) / config.points.spacing_nodes(gsd_m) ** 2
    return {
        "areas": len(build.jobs),
        "suns": max(int(c.reachable.sum()) for c in conditions),
        "views": len(config.view),
        "cell_renders": int(sum(cost)),
        "memory_mb_per_worker": round(WORKER_MB + widest * BYTES_A_NODE / 1e6),
        "seconds_estimate": round(seconds * sum(cost) / max(cost[sample], 1) / len(build.jobs) * per_area, 1),
        "bytes_estimate": int(min(cells, len(result) * len(build.jobs)) * a_point * COMPRESSION),
        "decisions": decisions(config),
    }


def _measured(build: Build, index: int) -> tuple[float, Candidates]:
    """Seconds of one area after a first run that compiles the kernels."""
    with limit_threads(1):
        run_area(build.jobs[index])
        start = time.perf_counter()
        result = run_area(build.jobs[index])
        return time.perf_counter() - start, result
