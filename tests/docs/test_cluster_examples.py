"""The programs of the page about clusters, run as they are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from lcp_cli.main import run

from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.run import Build, BuildRun

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs" / "examples"
DEM = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"
CONFIG = ROOT / "tests" / "data" / "nine_areas.toml"


def make_folder(folder: Path) -> Path:
    """The folder of a job: DEM, configuration, and ``lcp`` in ``bin``."""
    (folder / "bin").mkdir(parents=True)
    program = folder / "bin" / "lcp"
    program.write_text(
        f"#!{sys.executable}\nfrom lcp_cli.main import main\nif __name__ == '__main__':\n    main()\n"
    )
    program.chmod(0o755)
    shutil.copy(DEM, folder / "dem.tif")
    shutil.copy(CONFIG, folder / "tile.toml")
    return folder


@pytest.fixture
def shared_folder(tmp_path: Path) -> Path:
    return make_folder(tmp_path / "job")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The catalogue of the job, built by one process."""
    folder = make_folder(tmp_path_factory.mktemp("whole") / "job")
    config = BuildConfig.from_toml(folder / "tile.toml")
    BuildRun(Build.plan([folder / "dem.tif"], config), folder / "whole.h5").whole()
    return (folder / "whole.h5").read_bytes()


def start(folder: Path, script: str, **variables: str) -> subprocess.Popen[str]:
    path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    return subprocess.Popen(
        ["bash", str(EXAMPLES / script)],
        cwd=folder,
        env={**os.environ, "PATH": path, **variables},
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_an_array_job_runs_what_gives_the_bytes_of_one_build(
    shared_folder: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The programs write the arguments of `lcp` down, which are then run in this process."""
    program = shared_folder / "bin" / "lcp"
    program.write_text(
        '#!/bin/sh\nfor word; do echo "$word" >> arguments; done; echo >> arguments\n'
    )
    array = {"SLURM_ARRAY_TASK_COUNT": "2", "SLURM_CPUS_PER_TASK": "1"}
    for number in (1, 2):
        task = start(shared_folder, "array_job.sh", SLURM_ARRAY_TASK_ID=str(number), **array)
        assert task.communicate(timeout=120) == (None, "")
    assert start(shared_folder, "array_merge.sh").communicate(timeout=120) == (None, "")
    monkeypatch.chdir(shared_folder)
    commands = (shared_folder / "arguments").read_text().split("\n\n")[:-1]
    assert len(commands) == 3
    for command in commands:
        assert run(command.split("\n")) == 0
    assert (shared_folder / "tile.h5").read_bytes() == whole


@pytest.mark.slow
def test_an_array_job_gives_the_bytes_of_one_build(shared_folder: Path, whole: bytes) -> None:
    """SLURM is a loop here, which starts all tasks at once."""
    array = {"SLURM_ARRAY_TASK_COUNT": "3", "SLURM_CPUS_PER_TASK": "1"}
    tasks = [
        start(shared_folder, "array_job.sh", SLURM_ARRAY_TASK_ID=str(k), **array) for k in (1, 2, 3)
    ]
    said = [task.communicate(timeout=120)[1] for task in tasks]
    assert [task.returncode for task in tasks] == [0, 0, 0], said
    merge = start(shared_folder, "array_merge.sh")
    assert merge.wait(timeout=120) == 0
    lines = [one for one in merge.communicate()[1].splitlines() if not one.endswith("so far")]
    assert "not recognised as a product with a known error" in lines[0]  # dem.tif
    assert len(lines) == 2
    assert (shared_folder / "tile.h5").read_bytes() == whole
    assert not (shared_folder / "tile.h5.parts").exists()


@pytest.mark.slow
def test_a_dask_cluster_gives_the_bytes_of_one_build(shared_folder: Path, whole: bytes) -> None:
    pytest.importorskip("distributed", reason="an extra: pip install 'lcp-catalog[cluster]'")
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / "local_cluster.py")],
        cwd=shared_folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "points from" in done.stdout
    assert (shared_folder / "tile.h5").read_bytes() == whole
