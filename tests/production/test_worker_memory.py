"""Areas are made so small that a worker keeps the memory that was promised."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.area_peak import area_peak, build_peak_mb, stated_mb
from helpers.small_build import CONFIG, DEM

from lcp_catalog.errors import ConfigError
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.executor import processes, run_tasks
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.run import Build
from lcp_catalog.production.worker_memory import MARGIN_MB, area_mb, divided, worker_mb
from lcp_catalog.terrain.area import Area

FINE = BuildConfig(
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=50.0, gsd_m=59.0),
    sun=SunConfig((90.0, 270.0), (10.0, 30.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    model=ModelConfig(area_nodes_max=1024, direction_tolerance_deg=2.0),
)
REGION = Area(3.5, 26.0, 50.0)
GENEROUS_GB, TIGHT_GB = 2.0, 0.425


@pytest.mark.parametrize("latitude", [26.0, -88.0])
def test_areas_follow_the_promise(latitude: float) -> None:
    region, sizes = Area(3.5, latitude, 50.0), []
    for memory_gb in (GENEROUS_GB, 0.575, TIGHT_GB):
        config, _, tasks = divided(region, FINE, memory_gb)
        assert worker_mb(tasks, config, memory_gb) <= memory_gb * 1e3
        assert (config.model.area_nodes_max, tasks) == (
            config.model.area_nodes_max,
            divided(region, config, None)[2],
        )  # the size alone determines the areas
        sizes.append(config.model.area_nodes_max)
    assert sizes[0] > sizes[1] > sizes[2] >= 16


def test_areas_that_are_small_enough_stay() -> None:
    assert divided(REGION, FINE, GENEROUS_GB) == divided(REGION, FINE, None)


def test_too_little_memory_is_refused_with_what_it_takes() -> None:
    with pytest.raises(ConfigError, match="is too small") as refusal:
        divided(REGION, FINE, 0.3)
    found = re.search(r"needs ([\d.]+) GB", str(refusal.value))
    assert found
    config, _, _ = divided(REGION, FINE, float(found[1]))
    assert 16 <= config.model.area_nodes_max < 200


def test_many_conditions_and_close_candidates_take_smaller_areas() -> None:
    def nodes(config: BuildConfig) -> int:
        return divided(REGION, config, 0.5)[0].model.area_nodes_max

    close = replace(FINE, points=replace(FINE.points, spacing_m=8 * 59.0))
    suns = replace(FINE, sun=SunConfig(tuple(float(k) for k in range(0, 360, 2)), (10.0, 30.0)))
    assert nodes(close) < nodes(FINE)
    assert nodes(suns) < nodes(FINE)


@pytest.mark.slow
def test_a_worker_keeps_its_promise() -> None:
    """Without the promise, an area of 1024 nodes takes 553 MB."""
    build = Build.plan((DEM,), FINE, TIGHT_GB)
    assert build.facts() != Build.plan((DEM,), FINE).facts()
    assert (
        f"area_nodes_max = {build.recipe.config.model.area_nodes_max}\n"
        in build.recipe.config.to_toml()
    )
    job = max(build.jobs, key=lambda job: job.work)
    for _ in range(2):  # the first process may compile kernels, which takes memory, too
        with processes(1) as pool:
            found = pool.submit(area_peak, job).result()
    # as the promise counts (`worker_memory.START_MB`): after an installation 100 MB more of the libraries' files are mapped
    assert found.counted_mb < TIGHT_GB * 1e3
    assert found.tiles < 20e6
    stated = area_mb(job.task.window, job.task.lat_deg, build.recipe.config)
    assert stated - 2.0 * MARGIN_MB < found.counted_mb < stated


@pytest.fixture(scope="module")
def compiled() -> None:
    """Kernels that an area needs: their compilation takes memory, too."""
    with processes(1) as pool:
        pool.submit(area_peak, Build.plan([DEM], CONFIG).jobs[0]).result()


@pytest.mark.slow
@pytest.mark.usefixtures("compiled")
def test_a_plan_states_the_memory_of_the_process_that_merges(tmp_path: Path) -> None:
    """One process that computes the areas too; the larger merges are measured by benchmarks/speed/merge.py."""
    with processes(1) as planning, processes(1) as building:
        stated = planning.submit(stated_mb, DEM, CONFIG, "parent", 1).result()
        peak = building.submit(build_peak_mb, DEM, CONFIG, tmp_path / "a.h5", 1).result()
    assert 0.85 < stated / peak < 1.15


@pytest.mark.slow
@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("cluster", [False, True])
def test_a_plan_states_the_memory_of_a_worker(cluster: bool) -> None:
    """A cluster's workers import the package themselves."""
    jobs = Build.plan([DEM], CONFIG).jobs
    with processes(1) as planning, processes(1) as worker:
        stated = planning.submit(stated_mb, DEM, CONFIG, "per_worker", 2, cluster).result()
        apart = enumerate(worker.map(area_peak, jobs))
        found = dict(apart if cluster else run_tasks(area_peak, jobs, 2))
    peak = max(one.peak_mb for one in found.values())
    assert 0.8 < stated / peak < 1.25
