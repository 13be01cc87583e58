"""Areas of small builds, computed once for all builds of a test process: for tests of what builds do with them."""

from __future__ import annotations

from copy import deepcopy

from lcp_catalog.production import area_job
from lcp_catalog.production.area_job import AreaJob, AreaResult

_RESULTS: dict[tuple[object, ...], AreaResult] = {}


def run_area(job: AreaJob) -> AreaResult:
    """The result for the same area, step, candidates and configuration on the sample's DEM, or on one with the same
    heights; a copy, which a test may change. Stands in for `area_job.run_area` in this process, not in others.
    """
    sites = None if job.sites is None else job.sites.tobytes()
    key = repr(job.task), job.step, sites, job.keeps, job.recipe.config.to_toml()
    if key not in _RESULTS:
        _RESULTS[key] = area_job.run_area(job)
    return deepcopy(_RESULTS[key])
