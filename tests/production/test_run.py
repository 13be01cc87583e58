"""A small build on the sample's terrain: its content, reproducible bytes, and the state after an interrupted
run.
"""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.products import DEGREE_M, geotiff
from helpers.small_build import CONFIG, DEM
from helpers.verified import verify

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import (
    DETECTION_STEP,
    EVALUATED,
    LOCALIZABLE,
    UNIQUE,
    UNOCCLUDED,
    UNSHADOWED,
    USABLE,
)
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.error_maps import height_errors
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import EnuFrame, central_angle_deg, direction_enu, lonlat_to_mcmf
from lcp_catalog.landmarks.error_model import ErrorModel
from lcp_catalog.production import area_job, executor
from lcp_catalog.production import estimate as estimates
from lcp_catalog.production.area_job import AreaJob, AreaResult, area_sweep, run_area
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.error_config import ErrorConfig
from lcp_catalog.production.estimate import _seconds, estimate
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build, BuildRun
from lcp_catalog.rendering.plan import ScenePlan
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import build_terrain


@pytest.fixture(scope="module")
def catalog(built: Path) -> Catalog:
    return open_catalog(built)


def test_the_file_is_intact_and_has_points(built: Path, catalog: Catalog) -> None:
    assert verify(built) == []
    assert len(catalog.point_id) >= 5
    assert not built.with_name("small.h5.parts").exists()


def test_points_lie_on_the_dem(catalog: Catalog) -> None:
    heights, _ = DemSet.open([DEM]).heights(catalog.longitude, catalog.latitude, 474.0)
    np.testing.assert_allclose(catalog.elevation, heights, atol=2e-3)
    assert set(catalog.dem_product) == {"GLD100_256"}
    assert (catalog.elevation_sigma == 20.0).all()  # lcp_catalog/products.py
    assert (catalog.dem_resolution == Dem.open(DEM).effective_resolution.resolution_m).all()


def test_patches_are_the_dem_in_the_points_own_frame(catalog: Catalog) -> None:
    """Every node of a patch, taken back to longitude and latitude, has the DEM's height."""
    dems = DemSet.open([DEM])
    half = catalog.dem.shape[1] // 2
    step = np.arange(-half, half + 1) * 474.0
    x, y = np.meshgrid(step, -step)
    for i in range(len(catalog.point_id)):
        enu = np.stack([x, y, catalog.dem[i].astype(np.float64)], axis=-1)
        mcmf = enu @ catalog.rotation_mcmf_to_enu[i] + catalog.position_mcmf[i]
        lon, lat = (
            np.degrees(np.arctan2(mcmf[..., 1], mcmf[..., 0])),
            np.degrees(np.arctan2(mcmf[..., 2], np.hypot(mcmf[..., 0], mcmf[..., 1]))),
        )
        heights, _ = dems.heights(lon, lat, 474.0)
        np.testing.assert_allclose(np.linalg.norm(mcmf, axis=-1) - 1_737_400.0, heights, atol=5e-3)


def test_no_two_points_are_nearer_than_the_spacing(catalog: Catalog) -> None:
    away = central_angle_deg(
        catalog.longitude[:, None], catalog.latitude[:, None], catalog.longitude, catalog.latitude
    )
    np.fill_diagonal(away, np.inf)
    # by default two patches, 32 cells or 15 km, but at most 8 km: 17 cells
    assert np.radians(away.min()) * 1_737_400.0 >= 17 * 474.0 - 1.0
    assert tomllib.loads(catalog.config)["points"]["spacing_m"] == 17 * 474.0


def test_only_suns_that_can_happen_are_evaluated(catalog: Catalog) -> None:
    """At 26 N the Sun is never at an elevation of 60 deg in the east (its declination would be -10); at noon it
    reaches 62 to 66 deg.
    """
    evaluated = (catalog.condition & EVALUATED) > 0
    azimuth, elevation = list(catalog.sun_azimuth), list(catalog.sun_elevation)
    assert not evaluated[:, :, elevation.index(60.0), azimuth.index(60.0)].any()
    assert evaluated[:, :, elevation.index(60.0), azimuth.index(180.0)].all()
    assert evaluated[:, :, elevation.index(10.0), azimuth.index(90.0)].all()
    assert not evaluated[:, :, elevation.index(10.0), azimuth.index(180.0)].any()


def test_an_area_that_no_sun_reaches_has_no_candidates(plan: Build) -> None:
    """One of many areas of a region near a pole; a region with no other areas is refused."""
    night = dataclasses.replace(CONFIG, sun=SunConfig((0.0, 1.0), (80.0, 81.0)))
    recipe = dataclasses.replace(plan.recipe, config=night)
    assert len(run_area(dataclasses.replace(plan.jobs[0], recipe=recipe)).candidates) == 0
    with pytest.raises(SunError, match=r"at latitude 24\.6 deg its elevation is at most 67\.2 deg"):
        Build.plan((DEM,), night)


def test_a_patch_that_reaches_beyond_the_heights_is_no_candidate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nodes of a patch, in the frame of its own centre, can lie beyond an edge of the heights that the
    same nodes of the area's frame do not reach.
    """
    rng = np.random.default_rng(14)
    made = rng.normal(0.0, 40.0, (128, 256)).astype(np.float32)
    dem = geotiff(tmp_path / "edge.tif", made, 28.0 * DEGREE_M, 2.0 * DEGREE_M, DEGREE_M / 64.0)
    config = dataclasses.replace(
        CONFIG,
        area=AreaConfig(bounds_deg=(29.0, 0.0, 31.0, 0.6), gsd_m=474.0),
        sun=SunConfig((90.0, 270.0), (20.0, 30.0)),
        view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
        points=PointConfig(patch_nodes=33, spacing_m=2000.0, search_m=7600.0),
        model=ModelConfig(ring_max_km=5.0),
    )
    sampled: list[np.ndarray] = []
    patches = area_job._patches

    def noted(*given: object) -> object:
        found = patches(*given)
        sampled.append(np.isfinite(found.z_m).all(axis=(1, 2)))
        return found

    def southern(sweep: object, core: object, *_: object) -> tuple[np.ndarray, np.ndarray]:
        rows, cols = np.nonzero(core.mine & np.isfinite(core.z))
        near = rows >= rows.max(initial=0) - 20
        return rows[near][::4], cols[near][::4]

    monkeypatch.setattr(area_job, "_patches", noted)
    monkeypatch.setattr(area_job, "_find", southern)
    jobs = Build.plan((dem,), config).jobs
    found = [run_area(job).candidates for job in jobs[: len(jobs) // 2]]
    assert sum(int((~whole).sum()) for whole in sampled) >= 5
    for candidates, whole in zip(found, sampled, strict=True):
        assert len(candidates) == len(candidates.evaluation.condition) == whole.sum()
        assert np.isfinite(candidates.patch_m).all()


def test_conditions_differ_between_suns(catalog: Catalog) -> None:
    usable = catalog.condition == USABLE
    evaluated = (catalog.condition & EVALUATED) > 0
    per_sun = usable[:, 0].reshape(len(usable), -1)[:, evaluated[0, 0].ravel()]
    assert (per_sun.any(axis=1) & ~per_sun.all(axis=1)).any()


def test_independence_flags_mean_what_they_say(catalog: Catalog) -> None:
    """Each point's patch in its own frame, alone and in 40 km of terrain: an independent computation in another
    frame.
    """
    dems, half = DemSet.open([DEM]), catalog.dem.shape[1] // 2
    disagreements = checked = 0
    for i in range(len(catalog.point_id)):
        frame = EnuFrame(catalog.longitude[i], catalog.latitude[i])
        wide = build_terrain(
            dems, frame, NodeWindow(-half, half + 1, -half, half + 1), 474.0, ring_m=60e3
        ).field
        middle = wide.shape[0] // 2
        window = (middle - half, middle + half + 1, middle - half, middle + half + 1)
        patch = Heightfield(wide.z_m[window[0] : window[1], window[2] : window[3]], 474.0)
        for e, a in ((0, 1), (0, 5), (1, 1)):
            if not catalog.condition[i, 0, e, a] & EVALUATED:
                continue
            sun = direction_enu(catalog.sun_azimuth[a], catalog.sun_elevation[e])
            facing = wide.normals(window) @ sun > 0
            lost = np.mean(facing & wide.occluded_nodes(sun, window) & ~patch.occluded_nodes(sun))
            said = bool(catalog.condition[i, 0, e, a] & UNSHADOWED)
            checked += 1
            # frames differ by up to a degree, and nodes by a fraction of a cell: only clear cases must agree
            disagreements += bool((lost == 0.0 and not said) or (lost > 0.06 and said))
    assert checked > 10
    assert disagreements <= 0.05 * checked


def test_straight_down_nothing_hides(catalog: Catalog) -> None:
    evaluated = (catalog.condition[:, 0] & EVALUATED) > 0
    assert ((catalog.condition[:, 0] & UNOCCLUDED) > 0)[evaluated].all()


def test_summaries_cover_the_usable_conditions(catalog: Catalog) -> None:
    usable = catalog.condition == USABLE
    for point, view, elevation, azimuth in np.argwhere(usable):
        at = (point, view, azimuth)
        assert (
            catalog.sun_elevation_min[at]
            <= catalog.sun_elevation[elevation]
            <= catalog.sun_elevation_max[at]
        )
    assert (catalog.shadow_dependence <= CONFIG.points.max_dependence).all()
    # a point is found only where nothing else has a higher correlation
    assert (catalog.false_match_probability <= 1.0 - CONFIG.points.min_detection + 1e-6).all()
    worst = np.where(usable, catalog.sigma_major[:, 0], -np.inf).max(axis=(1, 2, 3))
    some = usable.any(axis=(1, 2, 3))
    assert some.any()
    np.testing.assert_allclose(
        catalog.localization_sigma[some, 0], worst[some], atol=catalog.sigma_step_m
    )


def test_claims_and_flags_agree(catalog: Catalog) -> None:
    """The file holds probabilities in steps of 1/250, and sigmas in steps of a thousandth of the cell."""
    least, most = CONFIG.points.min_detection, CONFIG.points.max_dependence
    evaluated = (catalog.condition & EVALUATED) > 0
    detection = catalog.detection_probability
    assert detection.shape[1] == len(catalog.image_scale) == 2
    for name in ("detection_probability", "sigma_major", "sigma_minor"):
        known = np.isfinite(getattr(catalog, name))
        np.testing.assert_array_equal(known, np.broadcast_to(evaluated[:, None], known.shape))
    unique = (catalog.condition & UNIQUE) > 0
    clear = evaluated & (np.abs(detection[:, 0] - least) > DETECTION_STEP)
    np.testing.assert_array_equal(unique[clear], detection[:, 0][clear] >= least)
    assert 0.02 < unique[evaluated].mean() < 0.98
    assert ((catalog.condition & LOCALIZABLE) > 0)[unique].all()
    free = UNSHADOWED | UNOCCLUDED
    usable = unique & ((catalog.condition & free) == free)
    np.testing.assert_array_equal(catalog.condition == USABLE, usable)
    assert (catalog.sigma_major[:, 0][usable] >= catalog.sigma_minor[:, 0][usable]).all()
    assert (catalog.shadow_dependence <= most).all()


def test_universal_points_are_usable_nearly_everywhere(catalog: Catalog) -> None:
    evaluated = ((catalog.condition & EVALUATED) > 0).sum(axis=(1, 2, 3))
    usable = (catalog.condition == USABLE).sum(axis=(1, 2, 3))
    np.testing.assert_array_equal(catalog.universal, usable >= 0.95 * evaluated)


def test_the_range_of_cells_follows_from_the_image_scales(catalog: Catalog) -> None:
    """From the file's own probabilities: the scales that work in half of the conditions that any does."""
    free = EVALUATED | UNSHADOWED | UNOCCLUDED
    clear = ((catalog.condition & free) == free)[:, None]
    works = clear & (catalog.detection_probability >= CONFIG.points.min_detection - 1e-6)
    checked = 0
    for i in range(len(catalog)):
        some = works[i].any(axis=0).sum()
        share = works[i].sum(axis=(1, 2, 3)) / max(some, 1)
        if np.abs(share - 0.5).min() < 0.1:  # the steps of the file's probabilities decide
            continue
        scales = catalog.image_scale[share >= 0.5] if some else np.ones(1)
        assert catalog.gsd_min[i] == pytest.approx(474.0 * scales.min())
        assert catalog.gsd_max[i] == pytest.approx(474.0 * scales.max())
        checked += 1
    assert checked >= 3


def test_the_error_model_is_stored(plan: Build, catalog: Catalog) -> None:
    assert catalog.errors == plan.recipe.errors.to_dict() | {"min_detection": 0.9}
    stored = tomllib.loads(catalog.config)["errors"]
    assert stored == plan.recipe.errors.to_dict()
    assert set(stored) == {field.name for field in dataclasses.fields(ErrorModel)}
    known = height_errors(DemSet.open([DEM]), [3.5], [26.0])
    assert (stored["height_sigma_m"], stored["height_length_m"]) == pytest.approx(
        [float(part[0]) for part in known]
    )


@pytest.mark.slow
def test_errors_of_the_configuration_decide(plan: Build) -> None:
    """Louder images and rougher errors are claimed with lower probabilities."""
    errors = ErrorConfig(sensor_noise=0.3, height_sigma_m=60.0, albedo_sigma=0.2)
    loud = Build.plan((DEM,), dataclasses.replace(CONFIG, errors=errors))
    assert loud.recipe.errors.height_length_m == plan.recipe.errors.height_length_m
    assert loud.facts() != plan.facts()
    middle = len(plan.jobs) // 2
    ours, theirs = (run_area(p.jobs[middle]).candidates.evaluation for p in (plan, loud))
    assert np.nanmean(theirs.detection) < 0.7 * np.nanmean(ours.detection)
    assert (theirs.condition == USABLE).sum() < (ours.condition == USABLE).sum()


def test_the_stored_plan_is_the_merged_plan_of_the_areas(plan: Build, catalog: Catalog) -> None:
    """Also of areas that were read back from their checkpoints."""
    plans = {job.task.name: area_sweep(job).plan for job in plan.jobs}
    assert len(plans) > 1
    assert catalog.scene_plan == ScenePlan.merged(plans.items()).to_json()
    assert all(ScenePlan.from_json(json.loads(str(one))) == one for one in plans.values())


def test_two_processes_give_the_same_bytes(plan: Build, built: Path, tmp_path: Path) -> None:
    BuildRun(plan, tmp_path / "two.h5", jobs=2).whole()
    assert (tmp_path / "two.h5").read_bytes() == built.read_bytes()


@pytest.mark.slow
def test_the_same_ground_has_the_same_id_in_another_region(catalog: Catalog) -> None:
    """A region shifted by 7 km finds the same candidates in the middle, at the same nodes."""
    other = dataclasses.replace(
        CONFIG, area=dataclasses.replace(CONFIG.area, center_deg=(3.7, 26.15))
    )
    task = Build.plan((DEM,), CONFIG).jobs[len(Build.plan((DEM,), CONFIG).jobs) // 2]
    twin = next(job for job in Build.plan((DEM,), other).jobs if job.task.name == task.task.name)
    ours, theirs = run_area(task).candidates, run_area(twin).candidates
    places = {tuple(p) for p in np.round(lonlat_to_mcmf(ours.lon_deg, ours.lat_deg), 1).tolist()}
    again = {tuple(p) for p in np.round(lonlat_to_mcmf(theirs.lon_deg, theirs.lat_deg), 1).tolist()}
    assert len(places & again) >= 0.5 * min(len(places), len(again)) > 0


@pytest.mark.slow
def test_the_stored_configuration_builds_the_same_points(catalog: Catalog, tmp_path: Path) -> None:
    path = tmp_path / "again.toml"
    path.write_text(catalog.config)
    BuildRun(Build.plan([str(DEM)], BuildConfig.from_toml(path)), tmp_path / "again.h5").whole()
    np.testing.assert_array_equal(open_catalog(tmp_path / "again.h5").point_id, catalog.point_id)


def test_without_a_cell_size_it_is_half_of_what_the_dem_resolves(
    caplog: pytest.LogCaptureFixture,
) -> None:
    config = dataclasses.replace(CONFIG, area=AreaConfig(center_deg=(3.5, 26.0), size_km=40.0))
    with caplog.at_level("INFO"):
        build = Build.plan((DEM,), config)
    assert build.recipe.gsd_m == 4.0 * build.recipe.dems.dems[0].gsd_m
    assert "cells of 473.8 m: 4 times the posting of hadley_gld100_256ppd.tif" in caplog.text
    assert Build.plan((DEM,), CONFIG).levels[0].cell.reason == "as configured"


@pytest.mark.slow
def test_maps_of_the_dems_errors_count_in_their_places(tmp_path: Path) -> None:
    """The error model takes the median over the region, every point its own."""
    here = tmp_path / "maps"
    here.mkdir()
    sigma = np.full((40, 40), 5.0, np.float32)
    sigma[:, 20:] = 9.0
    place = 3.0 * DEGREE_M, 27.0 * DEGREE_M, DEGREE_M / 20.0
    geotiff(here / "err.tif", sigma, *place)
    geotiff(here / "effres.tif", np.full((40, 40), 800.0, np.float32), *place)
    toml = "[dem]\nsigma_map = 'maps/err.tif'\nresolution_map = 'maps/effres.tif'\n"
    (tmp_path / "build.toml").write_text(toml)
    given = BuildConfig.from_toml(tmp_path / "build.toml").dem
    assert given.sigma_map == str(here / "err.tif")
    config = dataclasses.replace(
        CONFIG,
        area=AreaConfig(center_deg=(4.0, 26.0), size_km=44.0, gsd_m=474.0),
        dem=given,
        sun=SunConfig((90.0, 270.0), (20.0,)),
        view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    )
    build = Build.plan((DEM,), config)
    assert build.recipe.errors.height_sigma_m == pytest.approx(7.0)  # between the halves
    assert build.recipe.errors.height_length_m == 400.0
    assert set(build.files) == {DEM, here / "err.tif", here / "effres.tif"}
    assert all(job.recipe == build.recipe for job in build.jobs)
    BuildRun(build, tmp_path / "out.h5").whole()
    found = open_catalog(tmp_path / "out.h5")
    assert len(found) >= 3
    east = (found.longitude > 4.1) & (found.longitude < 4.9)
    west = (found.longitude > 3.1) & (found.longitude < 3.9)
    assert east.any()
    assert west.any()
    np.testing.assert_allclose(found.elevation_sigma[east], 9.0)
    np.testing.assert_allclose(found.elevation_sigma[west], 5.0)
    inside = (found.longitude > 3.05) & (found.latitude > 25.05) & (found.latitude < 26.95)
    np.testing.assert_allclose(found.dem_resolution[inside], 800.0)
    assert str(tmp_path) not in found.config
    assert 'sigma_map = "err.tif"' in found.config
    before = build.facts()
    geotiff(here / "err.tif", sigma + 1.0, *place)
    assert Build.plan((DEM,), config).facts() != before


@pytest.mark.slow
@pytest.mark.parametrize("given", [None, 33.0])
def test_heights_of_an_unknown_product_have_the_assumed_sigma(
    given: float | None, tmp_path: Path
) -> None:
    """A renamed file: 2.45 % of what its heights resolve, or the configuration's figure; a query counts it."""
    renamed = Path(shutil.copy(DEM, tmp_path / "renamed.tif"))
    config = dataclasses.replace(
        CONFIG,
        area=AreaConfig(center_deg=(4.0, 26.0), size_km=30.0, gsd_m=474.0),
        sun=SunConfig((90.0, 270.0), (20.0,)),
        view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
        errors=ErrorConfig(height_sigma_m=given),
    )
    BuildRun(Build.plan((renamed,), config), tmp_path / "out.h5").whole()
    found = open_catalog(tmp_path / "out.h5").elevation_sigma
    assumed = 0.0245 * Dem.open(renamed).effective_resolution.resolution_m
    np.testing.assert_allclose(found, assumed if given is None else given, rtol=1e-3)
    assert found.size


def test_the_time_is_estimated_from_a_large_and_a_small_area(plan: Build) -> None:
    """Areas that take a second and two seconds per million of own node and condition."""
    order = sorted(plan.jobs, key=lambda job: job.work)

    def seconds(job: AreaJob) -> float:
        return 1.0 + 2e-6 * job.work

    places = plan.jobs.index(order[3]), plan.jobs.index(order[0])
    measured = [seconds(plan.jobs[place]) for place in places]
    total = sum(seconds(job) for job in plan.jobs)
    alone, shared = (_seconds(plan.levels[0], places, measured, workers) for workers in (1, 2))
    assert alone == pytest.approx(total)
    assert shared == pytest.approx(total / 2.0)
    # a small area that took longer than the large one: no time is negative
    assert _seconds(plan.levels[0], places, [2.0, 3.0], 1) == pytest.approx(2.0 * len(plan.jobs))


def test_the_start_is_what_a_build_takes_beside_its_areas(
    plan: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that stands still but for steps: of all that is done it counts the plan, what is loaded with the first area, and
    the file.
    """
    now, loaded = [100.0], [False]
    areas, finish, planned = estimates.run_area, BuildRun.finish, Build.plan

    def area(job: AreaJob) -> AreaResult:
        now[0] += 5.0 if loaded[0] else 8.0
        loaded[0] = True
        return areas(job)

    def passed(seconds: float, function: Any) -> Any:
        def call(*arguments: Any) -> Any:
            now[0] += seconds
            return function(*arguments)

        return call

    clock = SimpleNamespace(process_time=lambda: now[0], monotonic=lambda: now[0])
    monkeypatch.setattr(estimates, "time", clock)
    monkeypatch.setattr(estimates.os, "times", lambda: (now[0] - 100.0, 0.0, 0.0, 0.0, 0.0))
    monkeypatch.setattr(estimates, "run_area", area)
    monkeypatch.setattr("lcp_catalog.production.run.run_area", area)
    monkeypatch.setattr(BuildRun, "finish", passed(7.0, finish))
    monkeypatch.setattr(Build, "plan", passed(11.0, planned))
    monkeypatch.setattr("logging.disable", lambda: None)
    level = dataclasses.replace(plan.levels[0], jobs=plan.jobs[:2])
    spent, own, again_s = estimates._small_build(level, 1, str(tmp_path))
    assert (own.seconds, own.cpu_s, again_s) == (10.0, 10.0, 20.0)
    assert spent - own.cpu_s == 11.0 + 3.0 + 7.0


def test_the_start_has_the_time_of_all_processes(plan: Build) -> None:
    """Also that of the process from which others are forked, which ends after this one."""
    before = os.times()
    executor.start_early()
    executor.stop_early()
    after = os.times()
    assert sum(after[2:4]) > sum(before[2:4]) or not executor.are_forked()


@pytest.mark.slow
def test_the_size_of_the_file_is_estimated(plan: Build, built: Path) -> None:
    """From one area's points, by measured shares for patches and claims."""
    said = estimate(plan, workers=1)
    assert said["bytes_estimate"] == pytest.approx(built.stat().st_size, rel=0.3)
    assert said["areas"] == len(plan.jobs)
    assert said["views"] == 2
    assert said["decisions"][0]["effect"] == "cell size"
