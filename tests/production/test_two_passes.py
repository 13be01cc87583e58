"""Builds of two passes against one pass: equal values bit by bit, the choice by complete evaluation, equal bytes."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.areas_once import run_area
from helpers.small_build import CONFIG, DEM
from helpers.verified import verify

from lcp_catalog.catalog.schema import NO_CELL, Cause
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.errors import AreaFailedError, ConfigError
from lcp_catalog.landmarks.selection import Places, select
from lcp_catalog.production import area_job, executor, finished_area, run, two_passes
from lcp_catalog.production.area_job import FIRST, AreaJob, AreaResult
from lcp_catalog.production.assembly import spacing_m
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.evaluation import Evaluation
from lcp_catalog.production.first_look import nearest_suns, straight_down, suns_looked_at
from lcp_catalog.production.kept_ground import KEPT_MB
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build, BuildPart, BuildRun
from lcp_catalog.production.worker_memory import worker_mb
from lcp_catalog.rendering.decisions import Decision
from lcp_catalog.terrain.terrain import Terrain

pytestmark = pytest.mark.usefixtures("areas_once")

TWO = replace(CONFIG, points=replace(CONFIG.points, passes=2))
PROMISED = replace(
    TWO,
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=40.0, gsd_m=474.0),
    sun=SunConfig((75.0, 90.0, 105.0, 255.0, 270.0, 285.0), (5.0, 10.0, 20.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    points=replace(
        TWO.points, per_view=3, footprint_km=26.0, candidates_per_cell=12, search_m=4000.0
    ),
)


@pytest.fixture(scope="module")
def job(plan: Build) -> AreaJob:
    """The area with most work, whose points have one turn or several."""
    return max(plan.jobs, key=lambda job: job.work)


@cache
def _whole(config: BuildConfig) -> bytes:
    """The file of a build of two passes in one process, built once."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "whole.h5"
        BuildRun(Build.plan((DEM,), config), output).whole()
        return output.read_bytes()


@pytest.fixture(scope="module")
def whole(job: AreaJob) -> AreaResult:
    return run_area(job)


def _values(one: Evaluation) -> dict[str, np.ndarray]:
    return {f.name: getattr(one, f.name) for f in dataclasses.fields(one)}


@pytest.mark.slow
def test_chosen_candidates_have_the_values_of_one_pass(job: AreaJob, whole: AreaResult) -> None:
    every = whole.candidates
    assert every.sites is not None
    assert len(every) >= 4
    some = np.arange(1, len(every), 2)
    found = run_area(replace(job, step="b", sites=every.sites[some])).candidates
    for name, values in _values(found.evaluation).items():
        np.testing.assert_array_equal(values, _values(every.evaluation)[name][some], name)
    np.testing.assert_array_equal(found.patch_m, every.patch_m[some])
    np.testing.assert_array_equal(found.lon_deg, every.lon_deg[some])


def test_the_first_pass_has_the_values_of_one_pass_where_it_looks(
    job: AreaJob, whole: AreaResult
) -> None:
    found = run_area(replace(job, step=FIRST)).candidates
    view, reachable = straight_down(job.conditions), job.conditions.reachable
    suns = suns_looked_at(reachable)
    assert 0 < suns.sum() < reachable.sum()
    every = _values(whole.candidates.evaluation)
    for name, values in _values(found.evaluation).items():
        own = np.s_[:, 0, view] if values.ndim == 5 else np.s_[:, view]
        np.testing.assert_array_equal(values[own][:, suns], every[name][own][:, suns], name)
        # elsewhere those of a Sun that it looks at, in every view and at every scale
        if values.ndim == 5:
            assert np.array_equal(values[:, 0], values[:, -1], equal_nan=True)
    assert (found.evaluation.condition[..., reachable] > 0).all()
    assert (found.evaluation.condition[..., ~reachable] == 0).all()
    np.testing.assert_array_equal(found.lon_deg, whole.candidates.lon_deg)


def test_every_sun_is_near_one_that_is_looked_at() -> None:
    conditions = Build.plan((DEM,), CONFIG).jobs[0].conditions
    directions = conditions.sun_directions()
    some, every = suns_looked_at(conditions.reachable), conditions.reachable
    found = nearest_suns(directions, some, every)
    flat = directions.reshape(-1, 3)
    for sun, near in zip(np.flatnonzero(every), found, strict=True):
        angles = np.arccos(np.clip(flat[some.ravel()] @ flat[sun], -1.0, 1.0))
        own = np.arccos(np.clip(flat[near] @ flat[sun], -1.0, 1.0))
        assert own <= angles.min() + 1e-4
        assert some.ravel()[near]
    lone = np.zeros((2, 2), bool)
    lone[0, 1] = True  # no Sun of the chessboard occurs
    assert (suns_looked_at(lone) == lone).all()


def test_every_point_has_the_claims_of_one_pass(built: Path, tmp_path: Path) -> None:
    """And no point is missing that complete evaluation of the chosen candidates would give."""
    output = tmp_path / "two.h5"
    output.write_bytes(_whole(TWO))
    assert verify(output) == []
    ours, theirs = open_catalog(output), open_catalog(built)
    assert abs(len(ours) - len(theirs)) <= 0.1 * len(theirs) + 1
    ids = np.asarray(ours.point_id), np.asarray(theirs.point_id)
    _, here, there = np.intersect1d(*ids, return_indices=True)
    assert len(here) >= 5
    for name in ("detection_probability", "sigma_major", "sigma_angle", "condition", "dem"):
        pair = np.asarray(getattr(ours, name))[here], np.asarray(getattr(theirs, name))[there]
        np.testing.assert_array_equal(*pair, name)
    usable = [(np.asarray(one.condition) == 31).sum() for one in (ours, theirs)]
    assert usable[0] >= 0.8 * usable[1]


@pytest.mark.slow
def test_a_first_look_that_sees_all_chooses_as_one_pass(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Brute force: with every condition in the first pass, so that no candidate is in doubt, the catalogue is that of one
    pass.
    """

    def seen(job: AreaJob) -> AreaResult:
        return run_area(job if job.sites is not None else replace(job, step=""))

    monkeypatch.setattr(run, "run_area", seen)
    monkeypatch.setattr(finished_area, "_keep_doubtful", lambda table, evaluation: None)
    output = tmp_path / "all.h5"
    BuildRun(Build.plan((DEM,), TWO), output).whole()
    ours, theirs = open_catalog(output), open_catalog(built)
    for name in ("point_id", "detection_probability", "condition", "dem", "second_peak"):
        pair = (np.asarray(getattr(one, name)) for one in (ours, theirs))
        np.testing.assert_array_equal(*pair, name)
    np.testing.assert_array_equal(ours.coverage.status, theirs.coverage.status)


def test_what_fails_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Candidates that the first pass takes to be usable and that are not leave their place to others near."""
    plan, rounds = Build.plan((DEM,), TWO), []

    def fails_first(job: AreaJob) -> AreaResult:
        result = run_area(job)
        if job.sites is not None:
            rounds.append(job.step)
        if job.step == two_passes.ROUNDS[0]:
            result.candidates.evaluation.condition[...] &= np.uint8(1)
        return result

    monkeypatch.setattr(run, "run_area", fails_first)
    output = tmp_path / "replaced.h5"
    report = BuildRun(plan, output).whole()
    assert set(rounds) == set(two_passes.ROUNDS)
    assert report.points > 0
    assert verify(output) == []
    catalog = open_catalog(output)
    places = Places(np.asarray(catalog.longitude), np.asarray(catalog.latitude))
    count = np.ones(len(catalog), np.int64)
    apart = select(places, count, count.astype(float), spacing_m(plan.recipe.config))
    assert len(apart) == len(catalog)


@pytest.mark.slow
@pytest.mark.parametrize("config", [TWO, PROMISED], ids=["spacing", "promise"])
def test_bytes_are_the_same_for_jobs_and_after_an_interruption(
    config: BuildConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = Build.plan((DEM,), config)
    two, resumed = (tmp_path / f"{name}.h5" for name in ("two", "resumed"))
    begin, pools = executor._new_pool, []

    def new_pool(jobs: int, method: str | None = None) -> ProcessPoolExecutor:
        pools.append((jobs, method))
        return begin(jobs, method)

    monkeypatch.setattr(executor, "_new_pool", new_pool)
    BuildRun(plan, two, jobs=2).whole()
    # the processes of the first pass, which have loaded kernels, make the rounds
    assert pools.count((2, None)) == 1
    for stop in (FIRST, two_passes.ROUNDS[0]):
        begun: list[str] = []

        def breaks(job: AreaJob, stop: str = stop, begun: list[str] = begun) -> AreaResult:
            begun.append(job.step)
            if begun.count(stop) == 2:
                raise RuntimeError("the power went")
            return run_area(job)

        monkeypatch.setattr(run, "run_area", breaks)
        with pytest.raises(AreaFailedError, match="the power went"):
            BuildRun(plan, resumed, resume=True).whole()
        assert begun[-1] == stop
        left = sorted(p.name for p in resumed.with_name("resumed.h5.parts").glob("*.area"))
        assert left
    monkeypatch.setattr(run, "run_area", run_area)
    BuildRun(plan, resumed, resume=True).whole()
    assert [path.read_bytes() == _whole(config) for path in (two, resumed)] == [True, True]
    assert not resumed.with_name("resumed.h5.parts").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "little_mb"),
    [(TWO, 2.0), (PROMISED, 0.7)],
    ids=["spacing", "promise"],
)
def test_ground_is_made_once_where_there_is_room_and_changes_no_byte(
    config: BuildConfig, little_mb: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    terrain = area_job._terrain

    def counted(job: AreaJob) -> tuple[Terrain, Decision]:
        made.append(job.step)
        return terrain(job)

    monkeypatch.setattr(area_job, "_terrain", counted)
    monkeypatch.setattr(run, "run_area", area_job.run_area)
    plan = Build.plan((DEM,), config)
    areas = len(plan.jobs)
    found, again = [], []
    for room_mb in (KEPT_MB, little_mb, 0.0):
        made.clear()
        output = tmp_path / f"{room_mb}.h5"
        levels = (replace(plan.levels[0], kept_mb=room_mb),)
        BuildRun(replace(plan, levels=levels), output).whole()
        found.append(output.read_bytes())
        assert made.count(FIRST) == areas
        again.append(len(made) - areas)
    assert again[0] == 0 < again[1] < again[2]
    assert found[1:] == found[:1] * 2


def test_kept_ground_leaves_an_area_its_memory() -> None:
    plan = Build.plan((DEM,), TWO, memory_gb=0.5)
    (level,) = plan.levels
    tasks, config = [job.task for job in level.jobs], level.recipe.config
    assert level.kept_mb + worker_mb(tasks, config, 0.5) <= 500.0 + 1e-9


@pytest.mark.slow
def test_a_promise_of_two_passes_is_kept_by_its_points(tmp_path: Path) -> None:
    """The file's own checks count the units of the points near each place."""
    outputs = [tmp_path / f"{passes}.h5" for passes in (1, 2)]
    config = replace(PROMISED, points=replace(PROMISED.points, passes=1))
    BuildRun(Build.plan((DEM,), config), outputs[0]).whole()
    outputs[1].write_bytes(_whole(PROMISED))
    assert [verify(output) for output in outputs] == [[], []]
    one, two = (open_catalog(path).promise for path in outputs)
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.demand, two.demand)
    kept = [(np.asarray(p.cause) == 0).sum() for p in (one, two)]
    assert kept[1] >= 0.95 * kept[0]


@pytest.mark.slow
def test_a_choice_that_does_not_stand_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without rounds no candidate is evaluated: what seems usable was not examined, and nothing is promised by it."""
    monkeypatch.setattr(two_passes, "ROUNDS", "b")
    chosen = two_passes._SecondPass.wanted
    monkeypatch.setattr(
        two_passes._SecondPass, "wanted", lambda self: dict(list(chosen(self).items())[:1])
    )
    output = tmp_path / "short.h5"
    BuildRun(Build.plan((DEM,), PROMISED), output).whole()
    assert verify(output) == []
    catalog = open_catalog(output)
    assert catalog.promise is not None
    cause = np.asarray(catalog.promise.cause)
    assert (cause == Cause.NOT_EXAMINED).sum() > 0.2 * (cause != NO_CELL).sum()
    with h5py.File(output) as file:
        assert file["promise/cause"].attrs["flag_meanings"].split()[-1] == "not_examined"


def test_areas_that_all_fail_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(job: AreaJob) -> AreaResult:
        raise ValueError(f"step {job.step}")

    monkeypatch.setattr(run, "run_area", fails)
    with pytest.raises(AreaFailedError, match=r"all .* areas failed; the first: .* step a"):
        BuildRun(Build.plan((DEM,), TWO), tmp_path / "x.h5", keep_going=True).whole()


@pytest.mark.slow
def test_an_area_that_fails_in_the_second_pass_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, seen = Build.plan((DEM,), TWO), []
    victim = max(plan.jobs, key=lambda job: job.work).task.name

    def fails(job: AreaJob) -> AreaResult:
        if job.task.name == victim and job.sites is not None:
            raise ValueError("a bit fell over")
        return run_area(job)

    monkeypatch.setattr(run, "run_area", fails)
    output = tmp_path / "x.h5"
    report = BuildRun(plan, output, keep_going=True, progress=lambda *at: seen.append(at)).whole()
    assert list(report.failed) == [victim]
    assert report.areas == len(plan.jobs) - 1
    assert verify(output) == []
    assert seen == sorted(seen)
    assert seen[-1] == (2 * len(plan.jobs), 2 * len(plan.jobs))


LEVELS = replace(
    TWO,
    area=AreaConfig((3.5, 26.0), 40.0, levels_m=(474.0, 900.0)),
    points=replace(TWO.points, search_m=None),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "jobs"),
    [(TWO, 1), (TWO, 2), (PROMISED, 2), (LEVELS, 1)],
    ids=["spacing", "spacing-2", "promise-2", "levels"],
)
def test_parts_give_the_bytes_of_one_build(config: BuildConfig, jobs: int, tmp_path: Path) -> None:
    plan = Build.plan((DEM,), config)
    paths = [tmp_path / f"{name}.h5" for name in ("parts", "once")]

    def parts(output: Path) -> None:
        for k in (2, 1, 3):
            assert BuildRun(plan, output, jobs).part(BuildPart(k, 3)) == {}

    for rounds, output in ((3, paths[0]), (1, paths[1])):  # the merge does what is left of one
        parts(output)
        for number in range(rounds):
            left = BuildRun(plan, output, jobs).select()
            missing = [state.missing for state in BuildRun(plan, output).list_parts()]
            assert sum(map(len, missing)) == left.areas
            assert (left.candidates > 0) or number > 0
            parts(output)
        BuildRun(plan, output, jobs).merge()
        assert output.read_bytes() == _whole(config)
    assert sorted(tmp_path.iterdir()) == sorted(paths)


@pytest.mark.slow
def test_a_second_choice_gives_the_parts_what_replaces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two parts, or of the merge after one choice: the bytes of one build in which all of the first round fails."""

    def fails_first(job: AreaJob) -> AreaResult:
        result = run_area(job)
        if job.step == two_passes.ROUNDS[0]:
            result.candidates.evaluation.condition[...] &= np.uint8(1)
        steps.append(job.step)
        return result

    monkeypatch.setattr(run, "run_area", fails_first)
    plan, outputs = Build.plan((DEM,), TWO), [tmp_path / f"{k}.h5" for k in range(3)]
    steps: list[str] = []
    BuildRun(plan, outputs[0]).whole()
    for choices, output in ((1, outputs[1]), (2, outputs[2])):
        for _ in range(choices):
            for k in (1, 2):
                BuildRun(plan, output).part(BuildPart(k, 2))
            assert BuildRun(plan, output).select().areas > 0
        for k in (1, 2):
            BuildRun(plan, output).part(BuildPart(k, 2))
        steps.clear()
        BuildRun(plan, output).merge()
        assert set(steps) == set(two_passes.ROUNDS[choices:])
        assert output.read_bytes() == outputs[0].read_bytes()


def test_passes_in_the_wrong_order_are_refused_in_one_line(tmp_path: Path) -> None:
    plan, output = Build.plan((DEM,), TWO), tmp_path / "x.h5"
    build = BuildRun(plan, output)
    areas = len(plan.jobs)

    def refused(attempt: Callable[[], object], match: str) -> None:
        with pytest.raises(AreaFailedError, match=match) as raised:
            attempt()
        assert "\n" not in str(raised.value)

    for attempt in (build.select, build.merge):
        refused(attempt, "no area is computed; run the parts first")
    build.part(BuildPart(1, 2))
    for attempt in (build.select, build.merge):
        refused(attempt, f"{areas - (areas + 1) // 2} of {areas} areas are missing")
    build.part(BuildPart(2, 2))
    refused(build.merge, "only the first of two passes is computed; run `select`")
    left = build.select()
    refused(build.merge, f"{left.areas} of {left.areas} areas are missing")
    assert build.select() == left
    with pytest.raises(ConfigError, match=r"needs `points\.passes` 2"):
        BuildRun(Build.plan((DEM,), CONFIG), output).select()


@pytest.mark.slow
def test_damaged_files_between_the_passes_are_made_again(tmp_path: Path) -> None:
    plan, output = Build.plan((DEM,), TWO), tmp_path / "x.h5"
    build, part = BuildRun(plan, output), BuildPart(1, 1)
    build.part(part)
    left = build.select()
    chosen = build.checkpoints.folder / "chosen.json"
    good = chosen.read_bytes()
    for bad in (b"", b"[]", b"{}", good.replace(b"[", b"[0, ", 1), good[:-9]):
        chosen.write_bytes(bad)
        assert build.checkpoints.chosen() is None
        with pytest.raises(AreaFailedError, match="run `select`"):
            build.merge()
    assert build.select() == left
    assert chosen.read_bytes() == good
    victim = next(iter(build.checkpoints.chosen()["b"]))
    looked = build.checkpoints.path(victim + FIRST)
    looked.write_bytes(looked.read_bytes()[:-1])
    build.part(part)
    evaluated = build.checkpoints.path(victim + "b")
    evaluated.write_bytes(evaluated.read_bytes()[:-1])
    build.part(part)
    build.merge()
    assert output.read_bytes() == _whole(TWO)


@pytest.mark.slow
def test_what_was_evaluated_for_a_choice_without_an_area_is_not_taken(tmp_path: Path) -> None:
    """An area that was missing when the choice was made changes it, also in the areas beside."""
    plan, output = Build.plan((DEM,), TWO), tmp_path / "x.h5"
    build = BuildRun(plan, output, keep_going=True)
    part = BuildPart(1, 1)
    build.part(part)
    for job in plan.jobs[::2]:
        build.checkpoints.path(job.task.name + FIRST).unlink()
    build.select()
    build.part(part)
    before = {job.task.name for job in plan.jobs} - {job.task.name for job in plan.jobs[::2]}
    assert set(build.checkpoints.chosen()["b"]) <= before
    BuildRun(plan, output, resume=True).whole()
    assert output.read_bytes() == _whole(TWO)


@pytest.mark.parametrize("passes", [0, 3])
def test_other_numbers_of_passes_are_refused(passes: int) -> None:
    with pytest.raises(ConfigError, match="passes"):
        PointConfig(passes=passes)
