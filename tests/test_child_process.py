"""Functions in processes of their own: results, crashes, and limits, by fork and by a fresh interpreter."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers import misbehaviour

from lcp_catalog import child_process
from lcp_catalog.child_process import ChildFailedError, call_apart


@pytest.fixture(params=["fork", "fresh"], autouse=True)
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child_process, "_single_thread", lambda: request.param == "fork")


def test_a_result_of_many_bytes_comes_back() -> None:
    found = call_apart(misbehaviour.repeat, "ä", 20.0)
    assert found == {"text": "ä" * 300_000, "process": found["process"]}
    assert found["process"] != os.getpid()


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (misbehaviour.crash, "crashed with signal 11"),
        pytest.param(misbehaviour.loop, "takes more than 1 s", marks=pytest.mark.slow),
        (misbehaviour.hoard, "needs more than 200 MB of memory"),
        (
            misbehaviour.fail,
            r"ended with code 1 \(ValueError: invalid literal for int\(\) with base 10: 'x'\)$",
        ),
        (misbehaviour.leave, "ended with code 7$"),
    ],
)
def test_what_goes_wrong_is_said(
    function: Any, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(ChildFailedError, match=says):
        call_apart(function, "x", 1.0, memory_mb=200.0)
    assert capfd.readouterr() == ("", "")


def test_a_child_that_lacks_this_package_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child_process, "_single_thread", lambda: False)
    monkeypatch.setattr(sys, "path", [])
    with pytest.raises(ChildFailedError, match=r"code 1 \(ModuleNotFoundError: No module named"):
        call_apart(misbehaviour.leave, "x", 5.0)


_LIMITED = """
import resource
from helpers import misbehaviour
from lcp_catalog.child_process import ChildFailedError, call_apart
resource.setrlimit(resource.RLIMIT_AS, (600_000_000, 600_000_000))
try:
    call_apart(misbehaviour.hoard, "x", 1.0, memory_mb=16_000.0)
except ChildFailedError as error:
    print(error)
"""


def test_the_smaller_limit_is_the_one_that_is_said() -> None:
    tests = str(Path(__file__).parent)
    variables = os.environ | {"PYTHONPATH": tests, "OPENBLAS_NUM_THREADS": "1"}
    run = [sys.executable, "-c", _LIMITED]
    said = subprocess.run(run, env=variables, capture_output=True, text=True, check=True).stdout
    assert said == "needs more than 600 MB of memory\n"


@pytest.mark.slow
def test_a_function_that_waits_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child_process, "_WALL_FACTOR", 1.0)
    with pytest.raises(ChildFailedError, match="takes more than 1 s"):
        call_apart(misbehaviour.wait, "x", 1.0)
