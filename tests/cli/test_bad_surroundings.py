"""A working folder that is gone, a limit of memory, kernels that shall not be compiled: one line that says what to do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from helpers.small_build import DEM

GONE = "import os, sys; from lcp_cli.main import main; os.chdir(sys.argv[1]); os.rmdir(sys.argv[1]); main(sys.argv[2:])"
LIMITED = (
    "import resource, sys; from lcp_cli.main import main\n"
    "resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]) * 10**6,) * 2)\n"
    "main(sys.argv[2:])"
)


def told(*words: str) -> str:
    """The line that a command says, which fails."""
    run = [sys.executable, "-c", *words]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    said = [line for line in done.stderr.splitlines() if not line.endswith("so far")]
    assert (done.returncode, done.stdout, len(said)) == (1, "", 1), done.stderr
    return done.stderr


@pytest.mark.parametrize(
    "words", [["render", str(DEM), "-o", "x.tif"], ["export", str(DEM), "-o", "x.csv"]]
)
def test_a_working_folder_that_is_gone(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "gone").mkdir()
    said = told(GONE, str(tmp_path / "gone"), *words)
    assert "the working folder no longer exists; change to one that does" in said


@pytest.mark.parametrize("limit_mb", [300, 400])
def test_libraries_that_do_not_fit_in_memory(tmp_path: Path, limit_mb: int) -> None:
    said = told(LIMITED, str(limit_mb), "render", str(DEM), "-o", str(tmp_path / "x.tif"))
    assert said.startswith("lcp: out of memory; ")
    assert list(tmp_path.iterdir()) == []


def test_kernels_that_shall_not_be_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    run = "from lcp_cli.main import main; import sys; main(sys.argv[1:])"
    place = [
        "--center",
        "3.5",
        "26",
        "--size",
        "8",
        "--sun-azimuth",
        "100",
        "--sun-elevation",
        "17",
    ]
    said = told(run, "render", str(DEM), "-o", str(tmp_path / "x.tif"), *place)
    assert said.endswith("lcp: NUMBA_DISABLE_JIT is set, and kernels only run compiled: unset it\n")
