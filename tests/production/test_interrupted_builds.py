"""Builds that are interrupted, resumed, disturbed by others or by changed files."""

from __future__ import annotations

import dataclasses
import os
import shutil
from pathlib import Path

import pytest
import rasterio.shutil
from helpers.areas_once import run_area
from helpers.small_build import CONFIG, DEM
from helpers.verified import verify

from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.errors import AreaFailedError, OutputError, OutputExistsError
from lcp_catalog.production import area_job, run
from lcp_catalog.production.area_job import AreaJob, AreaResult
from lcp_catalog.production.checkpoints import Checkpoints
from lcp_catalog.production.finished_area import finished_area
from lcp_catalog.production.run import Build, BuildRun

pytestmark = pytest.mark.usefixtures("areas_once")


@pytest.mark.slow
def test_a_broken_run_is_resumed(
    plan: Build, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "broken.h5"
    largest_first = sorted(plan.jobs, key=lambda job: -job.work)
    victim = largest_first[-1].task.name
    begun: list[str] = []

    def fails_at_the_end(job: AreaJob) -> AreaResult:
        begun.append(job.task.name)
        if begun[-1] == victim:
            raise RuntimeError("a bit fell over")
        return run_area(job)

    monkeypatch.setattr(run, "run_area", fails_at_the_end)
    with pytest.raises(AreaFailedError, match=rf"{victim}.*a bit fell over.*`resume`"):
        BuildRun(plan, output).whole()
    assert not output.exists()
    kept = sorted(output.with_name("broken.h5.parts").glob("*.area"))
    assert len(kept) == len(plan.jobs) - 1
    assert begun == [job.task.name for job in largest_first]

    done: list[str] = []

    def counts(job: AreaJob) -> AreaResult:
        done.append(job.task.name)
        return run_area(job)

    monkeypatch.setattr(run, "run_area", counts)
    BuildRun(plan, output, resume=True).whole()
    assert done == [victim]
    assert output.read_bytes() == built.read_bytes()


@pytest.mark.slow
def test_keep_going_writes_what_there_is(
    plan: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    victim = plan.jobs[0].task.name

    def fails_first(job: AreaJob) -> AreaResult:
        if job.task.name == victim:
            raise RuntimeError("no")
        return run_area(job)

    monkeypatch.setattr(run, "run_area", fails_first)
    report = BuildRun(plan, tmp_path / "partly.h5", keep_going=True).whole()
    assert list(report.failed) == [victim]
    assert verify(tmp_path / "partly.h5") == []


@pytest.mark.slow
def test_checkpoints_of_another_run_are_refused(plan: Build, built: Path, tmp_path: Path) -> None:
    output = tmp_path / "mixed.h5"
    parts = tmp_path / "mixed.h5.parts"
    parts.mkdir()
    (parts / "run.json").write_text('{"fingerprint": "another"}')
    with pytest.raises(OutputExistsError, match="another configuration"):
        BuildRun(plan, output, resume=True).whole()
    BuildRun(plan, output).whole()
    assert output.read_bytes() == built.read_bytes()


@pytest.mark.slow
def test_resume_and_overwrite_together(
    plan: Build, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a rule of Make needs: finished areas that fit are kept, others removed, the output replaced."""
    output, computed = tmp_path / "made.h5", []
    output.write_bytes(b"an older one")

    def counted(job: AreaJob) -> AreaResult:
        computed.append(job.task.name)
        return run_area(job)

    monkeypatch.setattr(run, "run_area", counted)
    checkpoints = Checkpoints.beside(output, plan.facts())
    checkpoints.folder.mkdir()
    checkpoints.begin(resume=False)
    checkpoints.write(
        plan.jobs[0].task.name, finished_area(run_area(plan.jobs[0]), plan.recipe.config)
    )
    BuildRun(plan, output, resume=True, overwrite=True).whole()
    assert plan.jobs[0].task.name not in computed
    assert len(computed) == len(plan.jobs) - 1
    assert output.read_bytes() == built.read_bytes()
    other = Checkpoints.beside(output, {"source code": "another"})
    other.folder.mkdir()
    other.begin(resume=False)
    other.write(plan.jobs[0].task.name, finished_area(run_area(plan.jobs[0]), plan.recipe.config))
    computed.clear()
    BuildRun(plan, output, resume=True, overwrite=True).whole()
    assert len(computed) == len(plan.jobs)
    assert output.read_bytes() == built.read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no flock")
def test_a_second_build_of_the_same_output_is_refused(
    plan: Build, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the first runs; the first is not disturbed, and after it the output is free again."""
    output, refused = tmp_path / "one.h5", []
    points = dataclasses.replace(CONFIG.points, min_detection=0.5)
    other = Build.plan((DEM,), dataclasses.replace(CONFIG, points=points))

    def interrupted(job: AreaJob) -> AreaResult:
        if not refused:
            with pytest.raises(OutputExistsError, match="another build of this output is running"):
                BuildRun(other, output).whole()
            refused.append(job)
        return run_area(job)

    monkeypatch.setattr(run, "run_area", interrupted)
    BuildRun(plan, output).whole()
    assert len(refused) == 1
    assert output.read_bytes() == built.read_bytes()
    assert sorted(tmp_path.iterdir()) == [output]
    BuildRun(plan, output, overwrite=True).whole()


@pytest.mark.parametrize("how", ["removed", "of another run"])
def test_a_checkpoint_that_is_lost_while_the_build_runs_is_an_error(
    plan: Build, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    output, names = tmp_path / "lost.h5", [job.task.name for job in plan.jobs]
    seen: list[str] = []

    def careless(job: AreaJob) -> AreaResult:
        seen.append(job.task.name)
        if len(seen) == len(names):
            lost = tmp_path / "lost.h5.parts" / f"{seen[0]}.area"
            if how == "removed":
                lost.unlink()
            else:
                Checkpoints(lost.parent, "another").write(
                    seen[0], finished_area(run_area(plan.jobs[0]), plan.recipe.config)
                )
        return run_area(job)

    monkeypatch.setattr(run, "run_area", careless)
    with pytest.raises(AreaFailedError, match=r"no longer there.*`resume`"):
        BuildRun(plan, output).whole()
    assert not output.exists()
    monkeypatch.setattr(run, "run_area", run_area)
    BuildRun(plan, output, resume=True).whole()
    assert output.read_bytes() == built.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["replaced", "changed", "removed", "after the areas", "touched"])
def test_an_input_that_changes_while_the_build_runs_is_refused(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """Between two areas, or when all are done; no area that may have read the new file is kept. The same
    content with another time is accepted.
    """
    dem, output = tmp_path / DEM.name, tmp_path / "x.h5"  # the name states the product
    shutil.copy(DEM, dem)
    plan = Build.plan((dem,), CONFIG)
    at, last = (len(plan.jobs), len(plan.jobs)) if how == "after the areas" else (2, 1)

    def change(done: int, total: int) -> None:
        if done != at:
            return
        if how == "removed":
            dem.unlink()
        elif how == "touched":
            os.utime(dem, ns=(0, 0))
        elif how == "replaced":
            beside = tmp_path / "new.tif"
            shutil.copy(DEM, beside)
            flip(beside)
            os.replace(beside, dem)
        else:
            flip(dem)

    def flip(path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.write_bytes(content)

    if how == "touched":
        BuildRun(plan, output, progress=change).whole()
        return
    if how == "removed":
        monkeypatch.setattr(run, "run_area", area_job.run_area)  # cannot read the file
    with pytest.raises(AreaFailedError, match=r"\.tif: was changed.*`resume`"):
        BuildRun(plan, output, progress=change).whole()
    assert not output.exists()
    assert len(list((tmp_path / "x.h5.parts").glob("*.area"))) <= at
    monkeypatch.setattr(run, "run_area", run_area)
    shutil.copy(DEM, dem)
    begun = []
    BuildRun(
        Build.plan((dem,), CONFIG), output, resume=True, progress=lambda *n: begun.append(n)
    ).whole()
    assert begun[0][0] >= last
    assert open_catalog(output).point_id.tolist() == open_catalog(built).point_id.tolist()


def test_other_files_in_the_folder_of_checkpoints_stay(
    plan: Build, built: Path, tmp_path: Path
) -> None:
    parts = tmp_path / "mine.h5.parts"
    parts.mkdir()
    for name in ("notes.txt", "measurements.npz"):
        (parts / name).write_text("mine")
    BuildRun(plan, tmp_path / "mine.h5").whole()
    assert sorted(file.name for file in parts.iterdir()) == ["measurements.npz", "notes.txt"]


def test_an_existing_output_is_left_alone(plan: Build, built: Path, tmp_path: Path) -> None:
    output = tmp_path / "mine.h5"
    shutil.copy(built, output)
    with pytest.raises(OutputExistsError, match="`overwrite`"):
        BuildRun(plan, output).whole()
    assert not output.with_name("mine.h5.parts").exists()


@pytest.mark.parametrize("how", ["itself", "a link", "a hard link"])
def test_an_output_that_is_an_input_is_refused(tmp_path: Path, how: str) -> None:
    dem = tmp_path / DEM.name
    shutil.copy(DEM, dem)
    output = dem if how == "itself" else tmp_path / "out.h5"
    if how == "a link":
        output.symlink_to(dem)
    elif how == "a hard link":
        output.hardlink_to(dem)
    with pytest.raises(OutputError, match="is read, too"):
        BuildRun(Build.plan((dem,), CONFIG), output, overwrite=True).whole()
    assert dem.read_bytes() == DEM.read_bytes()


@pytest.mark.slow
def test_a_file_behind_a_vrt_of_a_vrt_is_an_input(tmp_path: Path) -> None:
    """It is in the list of sources, it is no output, and a change of it is noticed, now and on resuming."""
    dem, output = tmp_path / "dem.tif", tmp_path / "x.h5"
    shutil.copy(DEM, dem)
    rasterio.shutil.copy(dem, tmp_path / "one.vrt", driver="VRT")
    text = (tmp_path / "one.vrt").read_text()
    (tmp_path / "two.vrt").write_text(text.replace("dem.tif", "one.vrt"))
    plan = Build.plan((tmp_path / "two.vrt",), CONFIG)
    names = [source["name"] for source in plan.recipe.dems.sources()]
    assert names == ["two.vrt", "one.vrt", "dem.tif"]
    with pytest.raises(OutputError, match="is read, too"):
        BuildRun(plan, dem, overwrite=True).whole()
    checkpoints = Checkpoints.beside(output, plan.facts())
    with checkpoints.locked(shared=True):
        checkpoints.begin(resume=False)
    with rasterio.open(dem, "r+") as file:
        file.write(file.read(1) + 1, 1)
    with pytest.raises(AreaFailedError, match=r"dem\.tif: was changed"):
        plan.inputs.require_unchanged()
    with pytest.raises(OutputExistsError, match="from a run with another content of the files"):
        BuildRun(Build.plan((tmp_path / "two.vrt",), CONFIG), output, resume=True).whole()
