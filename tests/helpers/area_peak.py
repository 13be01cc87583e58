"""Memory of a process that computes one area."""

from __future__ import annotations

from lcp_catalog.build.area_job import AreaJob, prepare, run_area
from lcp_catalog.build.finished_area import finished_area
from lcp_catalog.dem import block_cache
from lcp_catalog.memory import peak_mb
from lcp_catalog.threads import limit_threads


def peak_and_tiles(job: AreaJob) -> tuple[float, int]:
    """Peak memory of this process after an area, MB, and the limit of its tiles of the DEM, bytes."""
    limit_threads(1)
    prepare()
    finished_area(run_area(job), job.config, job.gsd_m)
    return peak_mb(), block_cache._store.limit_bytes
