"""Parts of a build in one folder: each computes its own areas, at the same time as others, and the merge
writes the bytes of one build.
"""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import cast

import pytest

from lcp_catalog.errors import AreaFailedError, ConfigError, OutputExistsError
from lcp_catalog.production import code_facts as facts
from lcp_catalog.production import run
from lcp_catalog.production.area_job import AreaJob, AreaResult, run_area
from lcp_catalog.production.checkpoints import Checkpoints
from lcp_catalog.production.code_facts import code_facts
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build, BuildPart, BuildRun

DEM = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"

CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=60.0, gsd_m=474.0),
    sun=SunConfig((90.0, 270.0), (10.0, 30.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
    points=PointConfig(patch_nodes=17, search_m=5000.0),
    model=ModelConfig(direction_tolerance_deg=0.7, ring_max_km=20.0, albedo="none"),
)


@pytest.fixture(scope="module")
def plan() -> Build:
    return Build.plan((DEM,), CONFIG)


@pytest.fixture(scope="module")
def built(plan: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("whole") / "whole.h5"
    BuildRun(plan, output).whole()
    return output


def test_parts_share_all_areas(plan: Build) -> None:
    assert len(plan.jobs) >= 4
    for count in (1, 2, 3, 50):
        shares = [BuildPart(k + 1, count).share(plan.jobs) for k in range(count)]
        assert sorted(job.task.name for share in shares for job in share) == sorted(
            job.task.name for job in plan.jobs
        )
    for wrong in ((0, 2), (3, 2), (1, 0)):
        with pytest.raises(ConfigError, match="between 1 and N"):
            BuildPart(*wrong)


@pytest.mark.slow
def test_parts_at_the_same_time_give_the_bytes_of_one_build(
    plan: Build, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second part runs while the first one does; a whole build and a merge are refused meanwhile."""
    output, inner = tmp_path / "x.h5", []

    def during(job: AreaJob) -> AreaResult:
        if not inner:
            inner.append(job)
            for attempt in (BuildRun(plan, output).whole, BuildRun(plan, output).merge):
                with pytest.raises(OutputExistsError, match="another build of this output"):
                    attempt()
            assert BuildRun(plan, output).part(BuildPart(2, 2)) == {}
        return run_area(job)

    monkeypatch.setattr(run, "run_area", during)
    assert BuildRun(plan, output).part(BuildPart(1, 2)) == {}
    report = BuildRun(plan, output).merge()
    assert report.areas == len(plan.jobs)
    assert output.read_bytes() == built.read_bytes()
    assert list(tmp_path.iterdir()) == [output]


@pytest.mark.slow
def test_the_merge_names_what_is_missing(plan: Build, built: Path, tmp_path: Path) -> None:
    output, areas = tmp_path / "x.h5", len(plan.jobs)
    (state,) = BuildRun(plan, output).list_parts()
    assert (str(state.part), state.areas, len(state.missing)) == ("1/1", areas, areas)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(AreaFailedError, match="run the parts first"):
        BuildRun(plan, output).merge()
    BuildRun(plan, output).part(BuildPart(1, 3))
    missing = [job.task.name for job in plan.jobs if job not in plan.jobs[::3]]
    for _ in range(2):  # a refused merge leaves all as it is
        with pytest.raises(AreaFailedError, match=f"{len(missing)} of {areas} areas are missing"):
            BuildRun(plan, output).merge()
        states = BuildRun(plan, output).list_parts()
        assert [str(state.part) for state in states] == ["1/3", "2/3", "3/3"]
        assert sorted(name for state in states for name in state.missing) == missing
    report = BuildRun(plan, output, keep_going=True).merge()
    assert sorted(report.failed) == missing
    BuildRun(plan, output, overwrite=True).whole()
    assert output.read_bytes() == built.read_bytes()


def test_a_part_computes_only_what_is_missing(
    plan: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "x.h5"
    BuildRun(plan, output).part(BuildPart(1, 2))

    def unwanted(job: AreaJob) -> AreaResult:
        raise AssertionError(f"{job.task.name} is computed again")

    monkeypatch.setattr(run, "run_area", unwanted)
    assert BuildRun(plan, output).part(BuildPart(1, 2)) == {}
    with pytest.raises(AreaFailedError, match="computed again"):
        BuildRun(plan, output).part(BuildPart(2, 2))


def test_parts_of_another_build_are_refused(plan: Build, tmp_path: Path) -> None:
    output = tmp_path / "x.h5"
    BuildRun(plan, output).part(BuildPart(1, 50))
    points = dataclasses.replace(CONFIG.points, min_detection=0.5)
    other = Build.plan((DEM,), dataclasses.replace(CONFIG, points=points))
    kept = sorted(output.with_name("x.h5.parts").iterdir())
    for attempt in (
        lambda: BuildRun(other, output).part(BuildPart(1, 50)),
        lambda: BuildRun(other, output).list_parts(),
        lambda: BuildRun(other, output).merge(),
    ):
        with pytest.raises(OutputExistsError, match="another configuration"):
            attempt()
    assert sorted(output.with_name("x.h5.parts").iterdir()) == kept


def test_two_parts_of_different_builds_that_start_together(tmp_path: Path) -> None:
    """Whoever notes its run first has the folder; the other one has seen it empty before."""
    output = tmp_path / "x.h5"
    one, two = (
        Checkpoints.beside(output, {"source code": "one"}),
        Checkpoints.beside(output, {"source code": "two"}),
    )

    class Late(Checkpoints):
        def _write_note(self, parts: int | None, overwrite: bool = True) -> None:
            one.join(2)
            super()._write_note(parts, overwrite)

    with one.locked(shared=True), two.locked(shared=True):
        with pytest.raises(
            OutputExistsError, match=r"another source code \(one, here two\); go on"
        ):
            Late(two.folder, two.fingerprint, two.facts).join(2)
        one.join(2)


def test_an_area_in_the_place_of_another_is_computed_again(
    plan: Build, built: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Its file is whole, and of the same run."""
    output, (one, other) = tmp_path / "x.h5", [job.task.name for job in plan.jobs[:2]]
    part, folder = BuildPart(1, 1), tmp_path / "x.h5.parts"
    BuildRun(plan, output).part(part)
    shutil.copy(folder / f"{one}.area", folder / f"{other}.area")
    with pytest.raises(AreaFailedError, match=f"1 of {len(plan.jobs)} areas are missing.*{other}"):
        BuildRun(plan, output).merge()
    assert f"{other}.area: is damaged, or of another area or run" in caplog.text
    BuildRun(plan, output).part(part)
    BuildRun(plan, output).merge()
    assert output.read_bytes() == built.read_bytes()


FACTS = {
    "source code": "another source code; go on with the same",
    "numba": r"another numba \(0\.1, here \d",
    "NumPy": r"another NumPy \(0\.1, here \d",
    "processor level": r"another processor level \(0\.1, here .* kernels for \S+\)",
}


@pytest.mark.parametrize("fact", FACTS)
def test_parts_of_other_code_or_of_another_level_are_refused(
    fact: str, plan: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a part, by the merge and by `resume`; what was computed stays."""
    output = tmp_path / "x.h5"
    with monkeypatch.context() as patch:
        other = "0" * 64 if fact == "source code" else "0.1"
        patch.setattr(run, "code_facts", lambda: code_facts() | {fact: other})
        BuildRun(plan, output).part(BuildPart(1, len(plan.jobs)))
    kept = sorted(output.with_name("x.h5.parts").iterdir())
    for attempt in (
        lambda: BuildRun(plan, output).part(BuildPart(2, len(plan.jobs))),
        BuildRun(plan, output).merge,
        BuildRun(plan, output, resume=True).whole,
    ):
        with pytest.raises(OutputExistsError, match=FACTS[fact]) as raised:
            attempt()
        assert "\n" not in str(raised.value)
    assert sorted(output.with_name("x.h5.parts").iterdir()) == kept


def test_the_level_is_that_of_the_features(monkeypatch: pytest.MonkeyPatch) -> None:
    """A processor of more features of the same level, and of another name, is of the same level."""
    own = {"SSE42": True, "POPCNT": True, "AVX": True, "AVX2": True, "FMA3": True}
    monkeypatch.setattr(facts, "cpu_features", own)
    level = facts.processor_level()
    assert level.startswith("AVX2, ")
    monkeypatch.setattr(facts, "cpu_features", own | {"VAES": True, "AVX512F": True})
    assert facts.processor_level() == level
    monkeypatch.setattr(facts, "cpu_features", own | {"FMA3": False})
    assert facts.processor_level().startswith("AVX, ")
    wide = dict.fromkeys(("X86_V4", *facts._LEVELS["AVX-512"], *facts._LEVELS["AVX2"]), True)
    for off, expected in (
        (set(), "AVX-512, "),
        ({"X86_V4"}, "AVX2, "),
        ({"X86_V4", "X86_V3"}, facts.platform.machine()),
    ):  # by NPY_DISABLE_CPU_FEATURES: NumPy's exp and log have other last digits, the processor's own features stay
        monkeypatch.setattr(facts, "cpu_features", wide | dict.fromkeys(off, False))
        assert facts.processor_level().startswith(expected)
    monkeypatch.setattr(facts, "cpu_features", {"NEON": True, "ASIMD": True})
    assert facts.processor_level().startswith("NEON, ")


def test_a_killed_part_leaves_nothing_in_the_end(plan: Build, built: Path, tmp_path: Path) -> None:
    """A process that is killed while it writes leaves a file, which the finished build removes."""
    output = tmp_path / "x.h5"
    folder = tmp_path / "x.h5.parts"
    BuildRun(plan, output).part(BuildPart(1, 1))
    left = folder / f".{plan.jobs[0].task.name}.area.0.part"
    left.mkdir()
    (left / "lcp.lock").touch()
    (left / f"{plan.jobs[0].task.name}.area").write_bytes(b"half")
    BuildRun(plan, output).merge()
    assert list(tmp_path.iterdir()) == [output]
    assert output.read_bytes() == built.read_bytes()


def test_a_run_needs_a_job(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="`jobs` must be at least 1"):
        BuildRun(cast(Build, None), tmp_path / "a.h5", jobs=0)
