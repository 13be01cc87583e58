"""Progress and messages where stderr is no terminal: lines now and then, or one JSON object a line."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers import navigable
from lcp_cli import main, messages
from lcp_cli import progress as module
from lcp_cli.progress import duration_text, progress

from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import DemError


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """The time in seconds, to be set."""
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
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
    """60 areas of which 20 were there before, 3 s each: a line every 12 s, from 10 s on."""
    run_areas(clock, 3.0, 20, 60)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "areas: 24 of 60, 20 a minute, 1 min 48 s left"
    assert lines[-1] == "areas: 60 of 60, 20 a minute, 0 s left"
    assert len(lines) == 10
    run_areas(clock, 0.1, 0, 60)
    assert capsys.readouterr().err == ""


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
    """Before the first step and within a step; each line at least 10 s after another."""
    monkeypatch.setattr(module, "_BEAT_S", 1e9)
    lines = module._Lines("areas", ())
    for seconds in range(25):
        clock[0] = 100.0 + seconds
        lines.beat()
    lines.update(0, 7)
    clock[0] += 40.0
    lines.beat()
    assert capsys.readouterr().err.splitlines() == [
        "areas: preparing, 10 s so far",
        "areas: preparing, 20 s so far",
        "areas: 0 of 7, 1 min 04 s so far",
    ]


def test_the_heart_beats_while_a_step_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "_BEAT_S", 0.01)
    monkeypatch.setattr(module, "_EVERY_S", {False: 0.05, True: 0.05})
    with progress("areas") as update:
        update(0, 3)
        time.sleep(0.5)
    assert capsys.readouterr().err.count("areas: 0 of 3, ") >= 2


CHECKED = """
import sys
from lcp_catalog import child_process
from lcp_cli.main import run
child_process._fresh = None
sys.exit(run(sys.argv[1:]))
"""


def test_a_catalogue_is_checked_before_progress_starts_a_thread(tmp_path: Path) -> None:
    """A process of two threads is not forked, and a fresh interpreter takes 0.3 s for the check's imports."""
    write_catalog(navigable.everywhere_usable(2), tmp_path / "c.h5")
    words = ["windows", "c.h5", "--center", "3.5", "26"]
    words += ["--range", "2026-01-27", "2026-01-29", "12h"]
    command = [sys.executable, "-c", CHECKED, *words]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
