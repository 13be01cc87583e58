"""Tasks in this process and in others: equal results; an error or a dead worker affects only its own task."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from multiprocessing import forkserver
from pathlib import Path

import pytest

from lcp_catalog.errors import ConfigError
from lcp_catalog.production import executor
from lcp_catalog.production.executor import SharedWorkers, run_tasks


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


@pytest.mark.slow
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


def worker(value: int) -> int:
    if value == 3:
        os._exit(9)
    return os.getpid()


def test_shared_workers_take_the_tasks_of_later_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one task, too; new ones where a call was left before its end. They end with the block."""
    made = []
    new_pool = executor._new_pool
    monkeypatch.setattr(executor, "_new_pool", lambda jobs: made.append(new_pool(jobs)) or made[-1])
    with SharedWorkers() as workers:
        assert dict(run_tasks(worker, [0], 2, workers=workers)) == {0: os.getpid()}
        first = {pid for _, pid in run_tasks(worker, [0, 1, 2, 4], 2, workers=workers)}
        assert len(first) <= 2
        assert os.getpid() not in first
        for count in (1, 3):
            later = dict(run_tasks(worker, [*range(count)], 2, workers=workers))
            assert len(later) == count
            assert {*later.values()} <= first | {*made[0]._processes}
        assert len(made) == 1
        begun = run_tasks(worker, [0, 1, 2], 2, workers=workers)
        next(begun)
        begun.close()
        assert not workers.wait
        again = {pid for _, pid in run_tasks(worker, [0, 1], 2, workers=workers)}
        assert not again & first
        assert len(made) == 2
    for pid in (*first, *again):
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


@pytest.mark.slow
def test_shared_workers_of_which_one_dies_are_new_ones_in_the_next_call() -> None:
    with SharedWorkers() as workers:
        outcomes = dict(run_tasks(worker, [1, 2, 3, 4], 2, workers=workers))
        assert isinstance(outcomes[2], RuntimeError)
        assert sum(isinstance(pid, int) for pid in outcomes.values()) == 3
        assert all(isinstance(pid, int) for _, pid in run_tasks(worker, [1, 2], 2, workers=workers))


def test_no_jobs_is_refused() -> None:
    with pytest.raises(ConfigError, match="`jobs`"):
        list(run_tasks(square, [1], jobs=0))


def known_modules(_: int) -> tuple[int, bool]:
    return os.getppid(), "lcp_catalog.production.area_job" in sys.modules


PARALLEL_KERNELS = """
import numpy as np
from lcp_catalog.kernels.matching.patches import halved

def half(k):
    out = np.empty((1, 2, 2), np.float32)
    halved(np.full((1, 4, 4), k, np.float32), out)
    return float(out[0, 0, 0])
"""
PROGRAM = """
from lcp_catalog.production.executor import run_tasks
from parallel_kernels import half

print(sorted(run_tasks(half, [1, 2, 3], 2)))
"""


@pytest.mark.slow
def test_workers_with_parallel_kernels_leave_nothing_behind(tmp_path: Path) -> None:
    """Python would warn of named semaphores that ended workers leave."""
    script = tmp_path / "run.py"
    script.write_text(PROGRAM)
    (tmp_path / "parallel_kernels.py").write_text(PARALLEL_KERNELS)
    known = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, check=True, env=known
    )
    assert done.stdout == "[(0, 1.0), (1, 2.0), (2, 3.0)]\n"
    said = [line for line in done.stderr.splitlines() if "compiling kernels" not in line]
    assert said == []


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")
def test_workers_are_forked_from_a_process_that_has_imported_what_they_need() -> None:
    executor.start_early()
    found = dict(run_tasks(known_modules, [1, 2], 2))
    assert {known for _, known in found.values()} == {True}
    assert {parent for parent, _ in found.values()} == {forkserver._forkserver._forkserver_pid}


PRELOADED = """
import sys
from lcp_catalog.production import preloaded
from numba.np.ufunc import parallel
print(parallel._is_initialized, "lcp_catalog.production.area_job" in sys.modules,
      "scipy.ndimage" in sys.modules, "scipy.special" in sys.modules)
"""


@pytest.mark.slow
@pytest.mark.skipif(not executor.are_forked(), reason="workers are spawned on this system")
def test_a_killed_server_costs_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is killed while it is asked for the first worker, and while the workers run. The servers that replace it
    import what these tasks need, and not all that an area needs.
    """
    executor.start_early()
    context = multiprocessing.get_context("forkserver")
    monkeypatch.setattr(context, "set_forkserver_preload", lambda names: None)
    monkeypatch.setattr(forkserver._forkserver, "_preload_modules", [executor.__name__, "pytest"])
    first = forkserver._forkserver._forkserver_pid
    os.kill(first, signal.SIGSTOP)  # it accepts a connection and does not answer
    killer = threading.Timer(0.5, os.kill, (first, signal.SIGKILL))
    killer.start()
    found = dict(run_tasks(square, [2, 3, 4, 5], 2))
    killer.join()
    assert found == {0: 4, 1: 9, 2: 16, 3: 25}
    second = forkserver._forkserver._forkserver_pid
    assert second != first
    found = {}
    for index, result in run_tasks(square, [2, 3, 4, 5], 2):
        if not found:
            os.kill(second, signal.SIGKILL)
        found[index] = result
    assert found == {0: 4, 1: 9, 2: 16, 3: 25}
    executor.stop_early()  # the next tests' workers are forked from one that imports all


SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    "length", [pytest.param(40, marks=SLOW), 75, 76, pytest.param(200, marks=SLOW)]
)
def test_a_long_name_of_the_folder_for_temporary_files(tmp_path: Path, length: int) -> None:
    """The socket of the process that forks has a name of at most 107 bytes (unix(7)) in that folder."""
    folder = tempfile.mkdtemp(dir="/tmp")
    try:
        inside = Path(folder, "x" * (length - len(folder) - 1))
        inside.mkdir()
        program = (
            f"from {executor.__name__} import run_tasks, are_forked\n"
            "print(are_forked(), sorted(dict(run_tasks(abs, [-2, -3], 2)).values()))"
        )
        done = subprocess.run(
            [sys.executable, "-c", program],
            check=True,
            env=os.environ | {"TMPDIR": str(inside)},
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        forked = sys.platform == "linux" and length <= 75
        assert (done.stdout, done.stderr) == (f"{forked} [2, 3]\n", "")
        assert not list(inside.iterdir())
    finally:
        shutil.rmtree(folder)


def no_process(*_: object, **__: object) -> None:
    raise OSError("no process")


def test_processes_that_cannot_be_started_fail_every_task(monkeypatch: pytest.MonkeyPatch) -> None:
    """After the tries, not for ever."""
    monkeypatch.setattr(executor, "_START_TRIES", 3)
    monkeypatch.setattr(executor.ProcessPoolExecutor, "submit", no_process)
    outcomes = dict(run_tasks(square, [1, 2, 3], 2))
    assert sorted(outcomes) == [0, 1, 2]
    assert {type(outcome) for outcome in outcomes.values()} == {executor._NotStartedError}
    assert "no process could be started for it: no process" in str(outcomes[0])


@pytest.mark.slow
def test_no_threads_of_kernels_are_started_before_the_fork() -> None:
    """OpenMP ends a forked process that uses it after its parent has. Nor is SciPy imported, which takes a quarter of a second."""
    done = subprocess.run(
        [sys.executable, "-c", PRELOADED], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "True", "False", "False"]


@pytest.mark.slow
def test_nothing_is_compiled_by_the_process_that_is_forked(tmp_path: Path) -> None:
    """On a machine without kernels others compile them meanwhile, once, and say so."""
    own = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "own"), "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", PRELOADED]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=own)
    assert done.stderr == ""
    assert not list(tmp_path.rglob("*.kernel"))


PARENT = """
import os, sys, time
from lcp_catalog.production.executor import {pool}
if __name__ == "__main__":
    with {pool}(2) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(60.0)
"""


@pytest.mark.slow
@pytest.mark.parametrize("pool", ["processes", "_new_pool"])
def test_processes_end_with_their_parent_however_it_ends(tmp_path: Path, pool: str) -> None:
    program = tmp_path / "parent.py"
    program.write_text(PARENT.format(pool=pool))
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


def ignore_the_end() -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


@pytest.mark.slow
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
    while worker.exitcode is None and time.monotonic() - start < 10.0:
        time.sleep(0.01)  # a thread of the pool may be the one that learns of the end
    assert worker.exitcode == -signal.SIGKILL


@pytest.mark.slow
def test_a_pool_that_is_stopped_within_a_result_ends() -> None:
    """Its thread reads a result of which the worker has sent a part; a process that has such a thread never ends."""
    code = (
        "from lcp_catalog.production.executor import run_tasks\n"
        "if __name__ == '__main__':\n"
        "    some = run_tasks(bytes, [200_000_000] * 6, 2)\n"
        "    next(some)\n"
        "    some.close()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], timeout=60, check=False)
    assert done.returncode == 0
