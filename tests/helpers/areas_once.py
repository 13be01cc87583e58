"""Areas of small builds, computed once for all builds of a test process: for tests of what builds do with them."""

from __future__ import annotations

from copy import deepcopy

from lcp_catalog.production import area_job
from lcp_catalog.production.area_job import AreaJob, AreaResult


class AreasOnce:
    """Stands in for `area_job.run_area` in this process, not in others, for builds on DEMs with the same heights."""

    def __init__(self) -> None:
        self._results: dict[tuple[object, ...], AreaResult] = {}

    def __call__(self, job: AreaJob) -> AreaResult:
        """The result for the same area, step, candidates and configuration; a copy, which a test may change."""
        sites = None if job.sites is None else job.sites.tobytes()
        key = repr(job.task), job.step, sites, job.keeps, job.recipe.config.to_toml()
        if key not in self._results:
            self._results[key] = area_job.run_area(job)
        return deepcopy(self._results[key])


run_area = AreasOnce()
"""Of builds on the sample's DEM."""
