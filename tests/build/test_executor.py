"""Tasks in this process and in others: equal results; an error or a dead worker affects only its own task."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from lcp_catalog.build import executor
from lcp_catalog.build.executor import run_tasks, starting_workers
from lcp_catalog.errors import ConfigError


def square(value: int) -> int:
    if value == 13:
        raise ValueError("unlucky")
    return value * value


def square_or_die(value: int) -> int:
    if value == 3:
        os._exit(9)
    return value * value


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_task_gives_its_own_result(jobs: int) -> None:
    outcomes = dict(run_tasks(square, [5, 13, 7], jobs))
    assert (outcomes[0], outcomes[2]) == (25, 49)
    assert isinstance(outcomes[1], ValueError)


def test_a_dying_worker_takes_only_its_own_task() -> None:
    outcomes = dict(run_tasks(square_or_die, [1, 2, 3, 4, 5], jobs=2))
    assert {index: outcomes[index] for index in (0, 1, 3, 4)} == {0: 1, 1: 4, 3: 16, 4: 25}
    assert isinstance(outcomes[2], RuntimeError)
    assert "process died" in str(outcomes[2])


def write_name(path: Path) -> Path:
    path.touch()
    return path


def test_no_worker_waits_while_a_result_is_taken(tmp_path: Path) -> None:
    """Two processes have begun a third task while the caller still holds the result of the first."""
    files = [tmp_path / f"{k}" for k in range(4)]
    outcomes = run_tasks(write_name, files, 2)
    next(outcomes)
    deadline = time.monotonic() + 60.0
    while sum(path.exists() for path in files) < 3 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert sum(path.exists() for path in files) >= 3
    assert len(list(outcomes)) == 3


def test_no_jobs_is_refused() -> None:
    with pytest.raises(ConfigError, match="--jobs"):
        list(run_tasks(square, [1], jobs=0))


def prepare() -> None:
    """The state of a worker that was prepared."""
    os.environ["PREPARED"] = "yes"


def was_prepared(value: int) -> str | None:
    return os.environ.get("PREPARED") if value != 3 else os._exit(9)


def test_workers_start_before_their_tasks_are_known() -> None:
    with starting_workers(2, prepare) as started:
        assert started is not None
        assert set(dict(run_tasks(was_prepared, [1, 2], 2, started=started)).values()) == {"yes"}
    with starting_workers(2, prepare) as started:
        outcomes = dict(run_tasks(was_prepared, [1, 3, 2], 2, started=started))
    assert isinstance(outcomes[1], RuntimeError)  # the others may run again in new processes
    assert "PREPARED" not in os.environ
    with starting_workers(1, prepare) as started:
        assert started is None


PARENT = """
import os, sys, time
from lcp_catalog.build.executor import processes
if __name__ == "__main__":
    with processes(2) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(60.0)
"""


def test_processes_end_with_their_parent_however_it_ends(tmp_path: Path) -> None:
    program = tmp_path / "parent.py"
    program.write_text(PARENT)
    parent = subprocess.Popen(
        [sys.executable, str(program)], stdout=subprocess.PIPE, start_new_session=True
    )
    assert parent.stdout is not None
    assert int(parent.stdout.readline()) != parent.pid
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 5.0
    while True:
        try:
            os.killpg(parent.pid, 0)
        except ProcessLookupError:
            break
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_workers_without_tasks_end_with_their_context() -> None:
    processes = []

    def without_tasks() -> None:
        with starting_workers(2, prepare) as started:
            assert started is not None
            processes.extend(started._processes.values())
            raise ValueError("no plan")

    with pytest.raises(ValueError, match="no plan"):
        without_tasks()
    assert processes
    deadline = time.monotonic() + 5.0  # the pool's thread may take note of an end a moment later
    while any(process.is_alive() for process in processes):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def ignore_the_end() -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def test_a_worker_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executor, "_PATIENCE_S", 0.2)
    with executor.processes(1) as pool:
        pool.submit(ignore_the_end).result()
        asleep = pool.submit(time.sleep, 60.0)
        while not asleep.running():  # a task that has not begun is cancelled
            time.sleep(0.01)
        (worker,) = pool._processes.values()
        start = time.monotonic()
    assert time.monotonic() - start < 10.0
    assert worker.exitcode == -signal.SIGKILL


def die() -> None:
    os._exit(9)


def test_workers_that_died_before_the_first_task_are_replaced() -> None:
    with starting_workers(2, die) as started:
        assert started is not None
        with contextlib.suppress(BrokenProcessPool):
            started.submit(square, 1).result()  # by now the pool knows
        assert dict(run_tasks(square, [1, 2, 3], 2, started=started)) == {0: 1, 1: 4, 2: 9}
