"""Several cell sizes in one catalogue: each is a build of its own from the DEMs that resolve it."""

from __future__ import annotations

import dataclasses
import json
import logging
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.areas_once import AreasOnce
from helpers.two_dems import COARSE_M, CONFIG, FINE_M, SITE_KM, two_dems
from helpers.verified import verify
from lcp_cli.main import run as command

from lcp_catalog.catalog.comparison import compare
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.errors import AreaError, AreaFailedError, ConfigError
from lcp_catalog.landmarks.selection import Status
from lcp_catalog.production import estimate as build_estimate
from lcp_catalog.production import run
from lcp_catalog.production.area_job import AreaJob, AreaResult, run_area
from lcp_catalog.production.config import AreaConfig, BuildConfig
from lcp_catalog.production.estimate import estimate
from lcp_catalog.production.merging import merge_catalogs
from lcp_catalog.production.run import Build, BuildPart, BuildRun
from lcp_catalog.production.worker_memory import CACHES_MIN_MB, MARGIN_MB, START_MB


@pytest.fixture(scope="module", autouse=True)
def areas_once() -> Iterator[None]:
    """An area of a configuration is computed once for all builds of this module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "run_area", AreasOnce())
        yield


@pytest.fixture(scope="module")
def dems(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return two_dems(tmp_path_factory.mktemp("dems"))


@pytest.fixture(scope="module")
def plan(dems: tuple[Path, Path]) -> Build:
    return Build.plan(dems, CONFIG)


@pytest.fixture(scope="module")
def built(plan: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("levels") / "levels.h5"
    BuildRun(plan, output).whole()
    return output


@pytest.fixture(scope="module")
def singles(dems: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A build of each level alone, from fine to coarse, named as in the folder of a build of both."""
    folder = tmp_path_factory.mktemp("singles")
    files = [folder / f"level{number:02d}.h5" for number in range(2)]
    for cell_m, file in zip((FINE_M, COARSE_M), files, strict=True):
        BuildRun(Build.plan(dems, with_cells(levels_m=(cell_m,))), file).whole()
    return files


def with_cells(**cells: object) -> BuildConfig:
    return dataclasses.replace(
        CONFIG, area=AreaConfig(CONFIG.area.center_deg, CONFIG.area.size_km, **cells)
    )


# -- cell sizes


@pytest.mark.parametrize(
    ("low_km", "high_km", "cells"),
    [
        (1.0, 8.0, [1.0, 2.0, 4.0, 8.0]),
        (1.0, 9.0, [9.0 ** (k / 4) for k in range(5)]),  # 3 steps would be a factor of 2.08
        (5.0, 6.0, [5.0, 6.0]),
        (5.0, 5.0, [5.0]),
        (5.0, 5.4, [5.4]),  # too close for two levels
    ],
)
def test_levels_derive_from_the_pixel_at_both_altitudes(
    low_km: float, high_km: float, cells: list[float]
) -> None:
    area = AreaConfig(altitudes_km=(low_km, high_km), ifov_rad=1e-3)
    assert area.derived_levels_m == pytest.approx(cells)


@pytest.mark.parametrize(
    ("cells", "says"),
    [
        (
            {"levels_m": (60.0, 10.0, 20.0)},
            "20 and 60 m are more than a factor of 2 apart; add 34.64 m",
        ),
        ({"levels_m": (474.0, 2000.0)}, "more than a factor of 2 apart; add 765.9, 1238 m"),
        ({"levels_m": (10.0, 10.5)}, "10 and 10.5 m are too close for two levels"),
        ({"levels_m": (10.0, -1.0)}, "above 0"),
        ({"levels_m": (10.0, float("inf"))}, "at most 50000 m"),
        ({"levels_m": tuple(1.2**k for k in range(40))}, "40 cell sizes, at most 32"),
        (
            {"levels_m": (10.0,), "gsd_m": 10.0},
            "`area.gsd_m` and `area.levels_m` exclude each other",
        ),
        ({"altitudes_km": (1.0, 2.0)}, "go together"),
        ({"ifov_rad": 1e-3}, "go together"),
        ({"altitudes_km": (2.0, 1.0), "ifov_rad": 1e-3}, "the lowest and the highest"),
        ({"altitudes_km": (1.0, 1e9), "ifov_rad": 1e-3}, "cells of 1 to 1e[+]09 m"),
        ({"altitudes_km": (5e-324, 1.0), "ifov_rad": 1e-3}, "1075 levels of cells are too many"),
    ],
)
def test_cell_sizes_that_make_no_levels(cells: dict[str, object], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        AreaConfig(**cells)


def test_a_given_level_that_no_dem_resolves_is_refused(dems: tuple[Path, Path]) -> None:
    with pytest.raises(
        AreaError, match=r"levels of 120 m: .*the finest are 240 m, the posting of site"
    ):
        Build.plan(dems, with_cells(levels_m=(120.0, FINE_M, COARSE_M)))
    with pytest.raises(AreaError, match=r"240 m: .*the finest are 480 m, the posting of wide"):
        Build.plan(dems[:1], CONFIG)


def test_derived_levels_that_no_dem_resolves_are_left_out(
    dems: tuple[Path, Path], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    build = Build.plan(dems, with_cells(altitudes_km=(60.0, 480.0), ifov_rad=1e-3))
    assert [level.recipe.gsd_m for level in build.levels] == pytest.approx([FINE_M, COARSE_M])
    assert "left out: 60, 120 m: no DEM" in caplog.text
    assert "240 m, the posting of site.tif" in caplog.text


# -- the catalogue


@pytest.mark.slow
def test_a_build_of_two_levels_is_the_merge_of_two_builds(
    built: Path, singles: list[Path], tmp_path: Path
) -> None:
    """But for the names of areas in the scene plan, which say the level, and so for the digests."""
    merge_catalogs(singles, tmp_path / "merged.h5")
    found = compare(built, tmp_path / "merged.h5")
    counts = found.counts()
    assert counts["matched"] == counts["first"] == counts["second"] > 50
    assert counts["moved"] == counts["changed"] == 0
    assert not found.not_compared
    summary = found.summary()
    assert summary["maps"] == []
    assert {fact["name"] for fact in summary["attributes"]} == {
        "config.merged",
        "scene_plan.decisions",
    }
    plans = [
        sorted(re.sub("l0[01](r[0-9]{5}c)", r"\1", json.dumps(one)) for one in plan["decisions"])
        for plan in (
            open_catalog(built).scene_plan,
            open_catalog(tmp_path / "merged.h5").scene_plan,
        )
    ]
    assert plans[0] == plans[1]
    assert list(built.parent.iterdir()) == [built]
    assert verify(built) == []
    catalog = open_catalog(built)
    cell_m = np.array([FINE_M, COARSE_M])
    assert set(catalog.level.tolist()) == {0, 1}
    assert (catalog.gsd == cell_m[catalog.level]).all()
    assert catalog.patch_nodes == CONFIG.points.patch_nodes


@pytest.mark.slow
def test_one_level_is_a_build_of_its_cell(dems: tuple[Path, Path], singles: list[Path]) -> None:
    build = Build.plan(dems, with_cells(levels_m=(COARSE_M,)))
    same = Build.plan(dems, with_cells(gsd_m=COARSE_M))
    assert len(build.levels) == 1
    assert [job.task for job in build.jobs] == [job.task for job in same.jobs]
    BuildRun(same, output := singles[1].with_name("alone.h5")).whole()
    one, two = open_catalog(singles[1]), open_catalog(output)
    for name in one.point_variables:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.slow
def test_an_interrupted_build_resumes_with_any_number_of_jobs(
    plan: Build, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is interrupted between two levels; the bytes are those of an uninterrupted build by one process."""
    output, begun = tmp_path / "broken.h5", []

    def fails_midway(job: AreaJob) -> AreaResult:
        begun.append(job.task.level)
        if len(begun) > len(plan.jobs) // 2:
            raise RuntimeError("a bit fell over")
        return run_area(job)

    monkeypatch.setattr(run, "run_area", fails_midway)
    with pytest.raises(AreaFailedError, match="a bit fell over"):
        BuildRun(plan, output).whole()
    assert set(begun) == {0, 1}
    monkeypatch.undo()
    steps: list[tuple[int, int]] = []
    BuildRun(plan, output, jobs=2, resume=True, progress=lambda *step: steps.append(step)).whole()
    assert steps[0] == (len(plan.jobs) // 2, len(plan.jobs))
    assert output.read_bytes() == built.read_bytes()
    assert list(tmp_path.iterdir()) == [output]


def test_parts_share_the_areas_of_all_levels(
    plan: Build, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Their merge is interrupted while it joins the levels, and run again."""
    output = tmp_path / "parts.h5"
    BuildRun(plan, output).part(BuildPart(1, 2))
    half, rest = BuildRun(plan, output).list_parts()
    assert half.missing == ()
    assert len(rest.missing) == len(plan.jobs) // 2
    BuildRun(plan, output).part(BuildPart(2, 2))
    with monkeypatch.context() as patch:
        patch.setattr(run, "merge_catalogs", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            BuildRun(plan, output).merge()
    assert not output.exists()
    BuildRun(plan, output).merge()
    assert output.read_bytes() == built.read_bytes()
    assert list(tmp_path.iterdir()) == [output]


# -- the DEMs of a level


@pytest.mark.slow
def test_a_level_has_points_only_where_a_dem_resolves_it(
    singles: list[Path], dems: tuple[Path, Path]
) -> None:
    fine, coarse = (open_catalog(file) for file in singles)
    assert set(fine.dem_product) == {"site"}
    assert len(fine) > 5
    assert set(coarse.dem_product) == {"wide", "site"}
    half_deg = np.degrees((SITE_KM * 500.0 - FINE_M * 8) / 1_737_400.0)  # patches lie in the site
    assert np.abs(fine.latitude - 9.0).max() < half_deg
    anywhere = Build.plan(dems, with_cells(gsd_m=FINE_M))
    assert len(fine) < len(open_catalog(_built(anywhere, singles[0].with_name("any.h5")))) / 2


def test_cells_without_such_a_dem_have_no_data(singles: list[Path]) -> None:
    cover = open_catalog(singles[0]).coverage
    away = np.hypot(cover.longitude - 1.0, cover.latitude - 9.0)
    outside = away > np.degrees(SITE_KM * 1e3 / 1_737_400.0)
    assert outside.any()
    assert (cover.status[outside] == Status.NODATA).all()
    assert (cover.status[~outside] == Status.POINT).any()
    assert not (open_catalog(singles[1]).coverage.status == Status.NODATA).any()


def test_areas_without_such_a_dem_are_not_computed(dems: tuple[Path, Path]) -> None:
    config = dataclasses.replace(CONFIG, model=dataclasses.replace(CONFIG.model, area_nodes_max=24))
    build = Build.plan(dems, config)
    fine, coarse = build.levels
    same = Build.plan(dems, dataclasses.replace(config, area=with_cells(gsd_m=FINE_M).area))
    assert len(fine.jobs) < len(same.jobs) / 2
    assert {job.task.name for job in same.jobs} > {job.task.name[3:] for job in fine.jobs}
    assert len({job.task.name for job in build.jobs}) == len(fine.jobs) + len(coarse.jobs)


def _built(build: Build, output: Path) -> Path:
    BuildRun(build, output).whole()
    return output


# -- the plan and the command


def test_the_plan_adds_up_the_levels(plan: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    """With areas that take 10 s each: those of this build take less than the tenth of a second that is stated."""
    of_areas = build_estimate._measured

    def slow(*given: Any) -> Any:
        seconds, *others = of_areas(*given)
        return [10.0] * len(seconds), *others

    monkeypatch.setattr(build_estimate, "_measured", slow)
    found = estimate(plan, 2)
    fine, coarse = found["levels"]
    assert (fine["gsd_m"], coarse["gsd_m"]) == (FINE_M, COARSE_M)
    for key in ("areas", "cell_renders"):
        assert found[key] == fine[key] + coarse[key]
    for key in ("suns", "views", "memory_mb_per_worker"):
        assert found[key] == max(fine[key], coarse[key])
    assert found["matching_cost"] == fine["matching_cost"] < 1.0
    for key in ("seconds_estimate", "bytes_estimate"):
        assert max(fine[key], coarse[key]) < found[key] < fine[key] + coarse[key]


@pytest.mark.slow
def test_the_command_builds_the_same(
    built: Path, dems: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options replace the file's cell, and a build of derived levels has the same points."""
    toml, output = tmp_path / "build.toml", tmp_path / "out.h5"
    toml.write_text(with_cells(gsd_m=1000.0).to_toml())
    given = ["build-catalog", *map(str, dems), "--config", str(toml), "--jobs", "1"]
    assert command([*given, "--levels", "480,240", "-o", str(output)]) == 0
    assert output.read_bytes() == built.read_bytes()
    pixels = ["--altitudes", "240-480", "--ifov", "1e-3", "--list-parts", "--json"]
    capsys.readouterr()
    assert command([*given, *pixels, "-o", str(output)]) == 0
    names = json.loads(capsys.readouterr().out)["parts"][0]["missing"]
    assert {name[:3] for name in names} == {"l00", "l01"}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--levels", "10", "--gsd", "10"], "--gsd and --levels exclude each other"),
        (["--levels", "10", "--altitudes", "1-2", "--ifov", "1"], "--levels and --altitudes"),
        (["--altitudes", "1-2"], "--altitudes and --ifov go together"),
        (["--ifov", "1e-3"], "--altitudes and --ifov go together"),
        (["--altitudes", "2-1", "--ifov", "1e-3"], "'2-1' is not KM-KM"),
        (["--altitudes", "1", "--ifov", "1e-3"], "'1' is not KM-KM"),
        (["--levels", "10,60"], "add 18.17, 33.02 m"),
    ],
)
def test_wrong_options(
    options: list[str],
    says: str,
    dems: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = tmp_path / "never.h5"
    assert command(["build-catalog", str(dems[0]), "-o", str(output), *options]) in (1, 2)
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_less_memory_divides_every_level(dems: tuple[Path, Path]) -> None:
    """The areas then are others, and none of a build with more memory is kept for them."""
    model = dataclasses.replace(CONFIG.model, area_nodes_max=512)
    wide = Build.plan(dems, config := dataclasses.replace(CONFIG, model=model))
    tight = Build.plan(dems, config, memory_gb=(START_MB + MARGIN_MB + CACHES_MIN_MB + 7.0) / 1e3)
    for less, level in zip(tight.levels, wide.levels, strict=True):
        assert less.recipe.config.model.area_nodes_max < level.recipe.config.model.area_nodes_max
        assert len(less.jobs) > len(level.jobs)
    assert tight.facts() != wide.facts()
