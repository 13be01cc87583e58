"""A working folder that is gone, a limit of memory, kernels that shall not be compiled: one line that says what to do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import click
import pytest
from helpers.small_build import DEM
from lcp_cli import main, names
from lcp_cli.failures import exit_code_of

from lcp_catalog.errors import LcpError

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


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [["render", str(DEM), "-o", "x.tif"], ["export", str(DEM), "-o", "x.csv"]]
)
def test_a_working_folder_that_is_gone(tmp_path: Path, words: list[str]) -> None:
    (tmp_path / "gone").mkdir()
    said = told(GONE, str(tmp_path / "gone"), *words)
    assert "the working folder no longer exists; change to one that does" in said


@pytest.mark.slow
@pytest.mark.parametrize("limit_mb", [300, 400])
def test_libraries_that_do_not_fit_in_memory(tmp_path: Path, limit_mb: int) -> None:
    said = told(LIMITED, str(limit_mb), "render", str(DEM), "-o", str(tmp_path / "x.tif"))
    assert said.startswith("lcp: out of memory; ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "advice"),
    [
        ("query", "end other programs, or raise its limit of memory"),
        ("diff", "end other programs, or raise its limit of memory"),
        ("render", "use a smaller area or a coarser --gsd"),
        ("build-catalog", "use a smaller area, a coarser --gsd or fewer --jobs"),
    ],
)
def test_advice_for_memory_is_what_a_command_can_do(
    command: str, advice: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = main.cli.get_command(click.Context(main.cli), command)
    names.runs(found)
    assert exit_code_of(MemoryError()) == 1
    names.runs(None)
    assert capsys.readouterr().err == f"lcp: out of memory; {advice}\n"


LONG = "x" * 5000


@pytest.mark.parametrize(
    "error",
    [
        LcpError(f"no figure {LONG}; there are a, b"),
        click.UsageError(f"no figure {LONG}"),
        ValueError("y " * 5000),
    ],
)
def test_what_a_user_gave_is_not_printed_whole(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    exit_code_of(error)
    said = capsys.readouterr().err
    assert len(said) < 3200
    assert "..." in said


@pytest.mark.slow
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
