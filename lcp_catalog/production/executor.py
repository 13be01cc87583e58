"""Execution of independent tasks in this process, in other processes, or on a dask cluster.

The thread pools of numba and OpenCV do not survive a fork: this process is not forked. On Linux,
workers are forked from a process of one thread that has imported what a build needs (`preloaded`);
it ends with this process. Elsewhere they are spawned (`are_forked`). Each worker uses one thread. If a worker
dies, only its own task fails; the others are run again. If this process dies, however that happens,
its workers end too.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import forkserver
from multiprocessing.connection import wait as wait_for_connections
from pathlib import Path
from typing import Any, TypeVar

from ..child_process import safe_path
from ..errors import ConfigError
from ..threads import limit_threads
from .cluster import run_on_cluster

Task = TypeVar("Task")
Result = TypeVar("Result")

log = logging.getLogger(__name__)

START_METHOD: str | None = None
"""The method of `multiprocessing` by which workers start; None: see `are_forked`. A program that must start each of its processes
itself may set "fork"; it must have one thread.
"""

_SOCKET = "/pymp-......../listener-........"
"""The form of the name, in the folder for temporary files, of the socket by which a worker is asked for."""

_LONGEST_SOCKET = 107
"""Bytes that Linux takes as the name of a socket (unix(7))."""

_PATIENCE_S = 10.0
"""Time in which a process must end that is asked to."""

_START_TRIES, _PAUSE_S = 100, 0.1
"""Tries to start a process, and the time between them: a process from which workers are forked can be
asked for one while it is killed.
"""


class _NotStartedError(RuntimeError):
    """A task for which no process could be started; it was not begun."""


class SharedWorkers:
    """Processes that calls of `run_tasks` in the block share, one after the other: in later ones kernels are loaded, which takes
    a new process half a second. They end with the block; after a task that killed its worker or was not awaited there are new ones.
    """

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> SharedWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool:
            _stop(self._pool)

    @property
    def wait(self) -> bool:
        """True if processes wait for tasks."""
        return self._pool is not None

    def taken(self) -> ProcessPoolExecutor | None:
        """The processes that wait, which are the caller's from now on."""
        pool, self._pool = self._pool, None
        return pool

    def keep(self, pool: ProcessPoolExecutor) -> None:
        """Keep idle processes for the next call."""
        self._pool = pool


def run_tasks(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int = 1,
    scheduler: str | None = None,
    inputs: Sequence[Path] = (),
    workers: SharedWorkers | None = None,
) -> Iterator[tuple[int, Result | Exception]]:
    """Yield (index of the task, its result or its exception) in the order in which tasks end.

    ``jobs``: number of processes; with 1, the tasks run in this process. ``scheduler``: address or file
    of a dask scheduler (`cluster.run_on_cluster`), whose workers must have the same ``inputs``: files
    that the tasks read. ``workers``: processes that are shared with other calls of as many ``jobs``. Results depend on
    none of them. ConfigError for invalid ``jobs``; errors of
    `cluster.run_on_cluster`.
    """
    if jobs < 1:
        raise ConfigError(f"`jobs` must be at least 1, not {jobs}")
    if scheduler is not None:
        yield from run_on_cluster(function, tasks, scheduler, inputs)
    elif jobs == 1 or (len(tasks) == 1 and not (workers and workers.wait)):
        yield from _here(function, tasks)
    elif workers:
        yield from _in_processes(function, tasks, jobs, workers)
    else:
        yield from _in_processes(function, tasks, min(jobs, len(tasks)))


def are_forked() -> bool:
    """Whether workers are forked: on macOS system libraries do not survive it; Linux asks for a worker by a
    socket, whose name is too long in some folders for temporary files.
    """
    name = os.fsencode(tempfile.gettempdir() + _SOCKET)
    return sys.platform == "linux" and len(name) <= _LONGEST_SOCKET


def start_early() -> None:
    """Start the process that workers are forked from, which takes two seconds, while this one goes on."""
    if START_METHOD is None and are_forked():
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload([f"{__package__}.preloaded"])
        with children_start():
            forkserver.ensure_running()


def stop_early() -> None:
    """End that process, whose time then counts as that of a child."""
    if are_forked():
        # no public call ends it before this process ends, and mypy does not know the private one
        forkserver._forkserver._stop()  # type: ignore[attr-defined]


@contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Fresh processes that end with the block, at once, and with this process."""
    pool = _new_pool(count, "spawn")
    try:
        yield pool
    finally:
        _stop(pool)


def _here(
    function: Callable[[Task], Result], tasks: Sequence[Task]
) -> Iterator[tuple[int, Result | Exception]]:
    with limit_threads(1):
        for index, task in enumerate(tasks):
            yield index, _outcome(function, task)


def _outcome(function: Callable[[Task], Result], task: Task) -> Result | Exception:
    try:
        return function(task)
    except Exception as error:  # the caller decides about the other tasks
        log.debug("task failed", exc_info=True)
        return error


def _on_one_thread(function: Callable[[Task], Result], task: Task) -> Result | Exception:
    """Run a task in a worker. The function's module, and with it OpenCV, has been imported by now."""
    limit_threads(1)
    return _outcome(function, task)


def _in_processes(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int,
    workers: SharedWorkers | None = None,
) -> Iterator[tuple[int, Result | Exception]]:
    pending, tries = list(range(len(tasks))), _START_TRIES
    while pending:
        done: set[int] = set()
        suspects: set[int] = set()
        pool = (workers and workers.taken()) or _new_pool(jobs)
        for index, outcome in _one_pool(pool, function, tasks, pending, jobs, workers):
            if isinstance(outcome, BrokenProcessPool):
                suspects.add(index)
            elif not isinstance(outcome, _NotStartedError) or not tries:
                done.add(index)
                yield index, outcome
        # The task that killed the worker is not known: run each suspect once in a process of its own.
        for index in sorted(suspects):
            yield index, _alone(function, tasks, index)
        pending = [index for index in pending if index not in done | suspects]
        if pending and not done | suspects:
            time.sleep(_PAUSE_S)
            tries -= 1


def _alone(
    function: Callable[[Task], Result], tasks: Sequence[Task], index: int
) -> Result | Exception:
    """The outcome of a task in a process of its own."""
    outcome: Result | Exception = _NotStartedError()
    for _ in range(_START_TRIES):
        ((_, outcome),) = _one_pool(_new_pool(1), function, tasks, [index], 1)
        if not isinstance(outcome, _NotStartedError):
            break
        time.sleep(_PAUSE_S)
    return _died(outcome)


def _died(outcome: Result | Exception) -> Result | Exception:
    if isinstance(outcome, BrokenProcessPool):
        return RuntimeError(
            "its process died (killed, or out of memory); try fewer `jobs` or a smaller area"
        )
    return outcome


def _new_pool(jobs: int, method: str | None = None) -> ProcessPoolExecutor:
    method = method or START_METHOD or ("forkserver" if are_forked() else "spawn")
    if method == "forkserver":
        start_early()
    context = multiprocessing.get_context(method)
    with children_start():  # multiprocessing starts a process of its own
        return ProcessPoolExecutor(max_workers=jobs, mp_context=context, initializer=_begin_worker)


def _submit(
    pool: ProcessPoolExecutor, function: Callable[..., Any], *arguments: Any
) -> Future[Any]:
    """Give a pool a task, for which it may start a process. The future of a broken pool, or if no process
    can be started (the one to fork was killed), has failed as `_NotStartedError`.
    """
    with children_start():
        try:
            return pool.submit(function, *arguments)
        except (BrokenProcessPool, OSError, EOFError) as error:
            failed: Future[Any] = Future()
            failed.set_exception(_NotStartedError(f"no process could be started for it: {error}"))
            return failed


@contextmanager
def children_start() -> Iterator[None]:
    """Processes that start in the block import neither from the working folder nor the program that runs, which
    need not guard its first lines (``if __name__ == "__main__"``). They never get Ctrl-C or the end of the terminal, which
    their parent handles (a signal that comes meanwhile: after the block).
    """
    with safe_path(), _unnamed_program():
        if not hasattr(signal, "pthread_sigmask"):  # Windows
            yield
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _unnamed_program() -> Iterator[None]:
    """By these two names multiprocessing finds the program, to import it in each process."""
    program = vars(sys.modules["__main__"])
    named: dict[str, Any] = {n: program[n] for n in ("__spec__", "__file__") if n in program}
    program.update(dict.fromkeys(named))
    try:
        yield
    finally:
        program.update(named)


def _begin_worker() -> None:
    """Ignore Ctrl-C, which the parent handles, and end by SIGTERM and with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a fork has the parent's handler
    if "fork" in multiprocessing.get_all_start_methods():
        # numba makes a lock of the default method; of the others it is a named semaphore, which a
        # process that is ended leaves behind, and Python warns of it
        multiprocessing.set_start_method("fork", force=True)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    """End this process when the process of the sentinel has ended. Kernels leave the interpreter's lock
    to this thread.
    """
    wait_for_connections([sentinel])
    os._exit(1)


def _one_pool(
    pool: ProcessPoolExecutor,
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    indices: Sequence[int],
    jobs: int,
    workers: SharedWorkers | None = None,
) -> Iterator[tuple[int, Result | Exception]]:
    """Give the pool one task per worker at a time, and one that waits for the first to be free, so that a
    broken pool has few suspects; shut it down in the end, unless ``workers`` keep it.
    """
    waiting = list(indices)
    running: dict[Future[Any], int] = {}
    broken, idle = False, False
    try:
        _fill(running, waiting, jobs, pool, function, tasks)
        while running:
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            outcomes = {running.pop(future): _result_of(future) for future in ended}
            ends = (BrokenProcessPool, _NotStartedError)
            broken = broken or any(isinstance(v, ends) for v in outcomes.values())
            # Before the results are taken: the caller may write files for them, and no worker waits.
            if not broken:
                _fill(running, waiting, jobs, pool, function, tasks)
            for index in sorted(outcomes):
                yield index, outcomes[index]
        idle = not broken
    finally:
        if workers and idle:
            workers.keep(pool)
        else:  # idle workers have nothing to finish: half a second less than their own end
            _stop(pool)


def _fill(
    running: dict[Future[Any], int],
    waiting: list[int],
    jobs: int,
    pool: ProcessPoolExecutor,
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
) -> None:
    """Give a pool tasks that wait until ``jobs`` are running and another one is ready."""
    while waiting and len(running) <= jobs:
        index = waiting.pop(0)
        running[_submit(pool, _on_one_thread, function, tasks[index])] = index


def _result_of(future: Future[Any]) -> Any:
    try:
        return future.result()
    except Exception as error:  # a result that cannot be pickled, or a broken pool
        return error


def _stop(pool: ProcessPoolExecutor) -> None:
    """End the pool at once, without waiting for running tasks."""
    processes = list((getattr(pool, "_processes", None) or {}).values())
    results = getattr(pool, "_result_queue", None)
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(_PATIENCE_S)
        if process.is_alive():
            process.kill()
            process.join()
    if (
        results is not None
    ):  # of a worker that has ended within a result: its reader would wait for the rest for ever
        results._writer.close()
