"""Memory of processes that compute an area or a build."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from lcp_catalog.dem import block_cache
from lcp_catalog.memory import mapped_mb, peak_mb
from lcp_catalog.production.area_job import AreaJob, run_area
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.estimate import estimate
from lcp_catalog.production.finished_area import finished_area
from lcp_catalog.production.run import Build, BuildRun
from lcp_catalog.threads import limit_threads

LIBRARIES_MB = 150.0
"""Mapped files of libraries that the estimate counts."""


class AreaPeak(NamedTuple):
    """Peak memory of this process after an area, MB; that of mapped files; and the limit of its tiles of the
    DEM, bytes.
    """

    peak_mb: float
    mapped_mb: float
    tiles: int

    @property
    def counted_mb(self) -> float:
        """The peak with so much of the libraries' files as the estimate counts (`run.START_MB`)."""
        return self.peak_mb - max(0.0, self.mapped_mb - LIBRARIES_MB)


def area_peak(job: AreaJob) -> AreaPeak:
    """Compute an area on one thread."""
    limit_threads(1)
    finished_area(run_area(job), job.recipe.config)
    return AreaPeak(peak_mb(), mapped_mb(), block_cache._store.limit_bytes)


def build_peak_mb(dem: str, config: BuildConfig, output: Path, jobs: int) -> float:
    """Peak memory of this process after a build, MB."""
    BuildRun(Build.plan([dem], config), output, jobs=jobs).whole()
    return peak_mb()


def stated_mb(dem: str, config: BuildConfig, of: str, jobs: int, cluster: bool = False) -> float:
    """What a plan, made in this process, states for the process that merges (``of`` "parent") or for a
    worker ("per_worker"), MB.
    """
    return float(estimate(Build.plan([dem], config), jobs, cluster)[f"memory_mb_{of}"])
