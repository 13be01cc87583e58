"""Progress and messages where stderr is no terminal: lines now and then, or one JSON object a line."""

from __future__ import annotations

import itertools
import json
import logging
import os
import pty
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers import navigable
from helpers.catalogs import HADLEY
from lcp_cli import main, messages
from lcp_cli import progress as module
from lcp_cli.progress import _FIRST_S, alive, duration_text, progress

from lcp_catalog import child_process
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import DemError


@pytest.fixture(autouse=True)
def _told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here tasks say how long they run, as for users."""
    monkeypatch.setattr(module, "_FIRST_S", _FIRST_S)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """The time in seconds, to be set."""
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    messages.reset()  # as a run begins
    yield now
    messages.reset()


def run_areas(clock: list[float], seconds: float, done: int, total: int) -> None:
    with progress("areas") as update:
        for k in range(done, total + 1):
            update(k, total)
            clock[0] += seconds


def test_a_pipe_gets_a_line_now_and_then(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    """60 areas of which 20 were there before, 3 s each; of short ones a line every 1.7 s; none of a short task."""
    run_areas(clock, 3.0, 20, 60)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "areas: 21 of 60, 20 a minute"
    assert lines[3] == "areas: 24 of 60, 20 a minute, 1 min 48 s left"
    assert lines[-1] == "areas: 60 of 60, 20 a minute, 0 s left"
    assert len(lines) == 40
    messages.reset()  # of other runs
    run_areas(clock, 0.1, 0, 60)
    assert len(capsys.readouterr().err.splitlines()) == 3
    messages.reset()
    run_areas(clock, 0.01, 0, 60)
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_the_log_of_a_long_task_is_short(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    """No silence of 2 s in the first five minutes; a line a minute after two and a half hours."""
    lines, told = module._Lines("areas", ()), []
    for quarter in range(4 * 12 * 3600):
        clock[0] = 100.0 + 0.25 * quarter
        lines.beat()
        if capsys.readouterr().err:
            told.append(clock[0] - 100.0)
    assert told[0] == 1.0
    steps = [after - before for before, after in itertools.pairwise(told)]
    assert max(step for at, step in zip(told, steps, strict=False) if at < 300.0) <= 2.25
    assert max(step for at, step in zip(told, steps, strict=False) if at < 250.0) <= 2.0
    assert max(steps) <= 60.25
    assert len(told) < 1250


def test_a_slow_first_step_does_not_count_in_the_time_left(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    """The first area takes 200 s, because kernels are compiled, and each other one 11 s."""
    with progress("areas") as update:
        update(0, 12)
        for done in range(1, 6):
            clock[0] += 200.0 if done == 1 else 11.0
            update(done, 12)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "areas: 1 of 12, 0.3 a minute"
    assert lines[1] == "areas: 2 of 12, 5.45 a minute"
    assert lines[2] == "areas: 3 of 12, 5.45 a minute, 1 min 39 s left"
    assert lines[-1] == "areas: 5 of 12, 5.45 a minute, 1 min 17 s left"


def test_the_time_left_follows_the_weights_of_the_steps(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    """Six kernels, the long ones first, each as many seconds long as its weight says twice over."""
    weights = [20.0, 20.0, 10.0, 5.0, 5.0, 5.0]
    with progress("kernels", weights) as update:
        update(0, 6)
        for done, weight in enumerate(weights, 1):
            clock[0] += 2.0 * weight
            update(done, 6)
    lines = capsys.readouterr().err.splitlines()
    left = [line.split(", ")[-1] for line in lines]
    assert left[2:] == ["30 s left", "20 s left", "10 s left", "0 s left"]
    assert lines[2].startswith("kernels: 3 of 6, ")


def test_json_has_rate_and_time_left(
    clock: list[float], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(main.cli, "invoke", lambda context: run_areas(clock, 2.0, 0, 3))
    assert main.run(["--log-format", "json", "dem"]) == 0
    events = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [event["event"] for event in events] == ["progress"] * 4
    assert [event["done"] for event in events] == [0, 1, 2, 3]
    assert (events[2]["per_second"], events[2]["seconds_left"]) == (0.5, 2.0)
    assert events[2]["total"] == 3


def test_json_lines_are_all_that_is_said(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages, the log, warnings and errors, also a usage error; the next run is text again."""

    def fails(context: object) -> None:
        logging.getLogger("lcp_catalog.some").warning("a %s", "warning")
        logging.getLogger("lcp_catalog.some").info("not shown")
        messages.say("two\nlines")
        raise DemError("no such file")

    monkeypatch.setattr(main.cli, "invoke", fails)
    assert main.run(["--log-format", "json", "dem"]) == 1
    lines = capsys.readouterr().err.splitlines()
    events = [json.loads(line) for line in lines]
    assert [event["event"] for event in events] == ["log", "message", "error"]
    assert events[0] | {"time_utc": ""} == {
        "time_utc": "",
        "event": "log",
        "text": "a warning",
        "level": "warning",
        "logger": "lcp_catalog.some",
    }
    assert events[2]["exit_code"] == 1
    monkeypatch.undo()
    assert main.run(["--log-format", "json", "build-catalog", "x.tif", "--nonsense"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert json.loads(line)["exit_code"] == 2
    assert main.run(["build-catalog", "x.tif", "--nonsense"]) == 2
    assert capsys.readouterr().err.startswith("Usage:")


def test_durations() -> None:
    said = [duration_text(seconds) for seconds in (0.4, 59.6, 61.0, 3600.0, 100_000.0)]
    assert said == ["0 s", "1 min 00 s", "1 min 01 s", "1 h 00 min", "27 h 46 min"]


def test_a_long_step_is_not_silent(
    clock: list[float], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before the first step and within a step."""
    lines = module._Lines("areas", ())
    for seconds in range(6):
        clock[0] = 100.0 + seconds
        lines.beat()
    lines.update(0, 7)
    clock[0] += 40.0
    lines.beat()
    assert capsys.readouterr().err.splitlines() == [
        "areas: preparing, 1 s so far",
        "areas: preparing, 3 s so far",
        "areas: preparing, 5 s so far",
        "areas: 0 of 7, 45 s so far",
    ]


def test_tasks_in_turn_are_not_silent_between(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    """A task ends 1.5 s after its last line: the next one does not wait for its own first second."""
    first = module._Lines("kernels", ())
    clock[0] += 2.0
    first.beat()
    clock[0] += 1.5
    second = module._Lines("areas", ())
    for _ in range(3):
        clock[0] += 0.15
        second.beat()
    assert capsys.readouterr().err.splitlines() == [
        "kernels: preparing, 2 s so far",
        "areas: preparing, 0 s so far",
    ]


def test_the_heart_beats_while_a_step_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "_BEAT_S", 0.01)
    monkeypatch.setattr(
        module, "_FIRST_S", 0.2
    )  # the second one starts before the first says anything
    monkeypatch.setattr(module, "_EVERY_S", {False: 0.05, True: 0.05})
    others = threading.active_count()  # of tests that ran before
    with alive("build"), progress("areas") as update:
        update(0, 3)
        time.sleep(0.5)
        assert threading.active_count() == others + 1
        before = capsys.readouterr().err
        with child_process.resting():
            assert threading.active_count() == others
        time.sleep(0.5)
    assert before.count("areas: 0 of 3, ") >= 2
    assert capsys.readouterr().err.count("areas: 0 of 3, ") >= 2
    assert "working" not in before  # the innermost speaks


SLOW = """
import time
from lcp_catalog.rendering import pipeline
from lcp_cli.main import main
prepare = pipeline.prepare
pipeline.prepare = lambda request: time.sleep(2.5) or prepare(request)
main()
"""
"""A render that takes 2.5 s longer: a beat may be late on a busy machine."""


@pytest.mark.slow
def test_a_command_without_steps_says_that_it_works(tmp_path: Path) -> None:
    """On a pipe and on a terminal, where the line is replaced and taken away."""
    words = ["render", HADLEY, "--center", "3.5", "26", "--size", "9", "--gsd", "474"]
    words += ["--sun-azimuth", "90", "--sun-elevation", "2", "-o"]
    command = [sys.executable, "-c", SLOW, *map(str, words)]
    ended = subprocess.run([*command, tmp_path / "a.tif"], capture_output=True, check=True)
    assert re.match(rb"render: [a-z ]+, [12] s so far\n", ended.stderr)
    ours, theirs = pty.openpty()
    ended = subprocess.run([*command, tmp_path / "b.tif"], stderr=theirs, check=True)
    os.close(theirs)
    seen = os.read(ours, 100_000)
    assert re.match(rb"\rrender: [a-z ]+, [12] s so far\x1b\[K", seen)
    assert seen.endswith(b"\r\x1b[K")


WARNED = """
import logging
from lcp_cli import messages
from lcp_cli.progress import progress
messages.reset()
with progress("areas") as update:
    update(1, 3)
    logging.getLogger("lcp_catalog").warning("a doubt")
    update(2, 3)
"""


def test_a_warning_stands_on_a_line_of_its_own() -> None:
    """On a terminal the bar is taken away for it, and drawn again."""
    ours, theirs = pty.openpty()
    subprocess.run([sys.executable, "-c", WARNED], stderr=theirs, check=True)
    os.close(theirs)
    seen = os.read(ours, 100_000).decode()
    before, after = seen.split("\r\x1b[Ka doubt\r\n")
    assert before.rpartition("\r")[2].endswith("so far")
    assert "  2/3  " in after
    assert after.endswith("\r\n")


CHECKED = """
import sys
from lcp_catalog import child_process
from lcp_cli.main import run
child_process._fresh = None
sys.exit(run(sys.argv[1:]))
"""


@pytest.mark.slow
def test_a_catalogue_is_checked_before_progress_starts_a_thread(tmp_path: Path) -> None:
    """A process of two threads is not forked, and a fresh interpreter takes 0.3 s for the check's imports."""
    write_catalog(navigable.everywhere_usable(2), tmp_path / "c.h5")
    words = ["windows", "c.h5", "--center", "3.5", "26"]
    words += ["--range", "2026-01-27", "2026-01-29", "12h"]
    command = [sys.executable, "-c", CHECKED, *words]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_a_warning_is_written_once_in_a_run(capsys: pytest.CaptureFixture[str]) -> None:
    """`lcp trade` plans a build for every alternative, each with the same doubts about the DEM."""
    for _ in range(2):
        messages.reset()
        for name in ("a.tif", "a.tif", "b.tif"):
            record = logging.makeLogRecord({"msg": f"{name}: unknown", "levelno": logging.WARNING})
            assert logging.lastResort is not None
            logging.lastResort.handle(record)
        assert capsys.readouterr().err.splitlines() == ["a.tif: unknown", "b.tif: unknown"]
