"""Tasks on the workers of a dask cluster.

A worker refuses tasks if its package or one of its files differs from those of the process that sends
them. Only a few tasks for each worker are in the cluster at a time; a result is fetched as soon as it is
there, and dropped.
"""

from __future__ import annotations

import gc
import io
import json
import logging
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from .._version import __version__
from ..atomic_files import content_of, file_facts, know_sums, known_sums
from ..errors import ClusterError, ConfigError
from ..memory import keep_memory
from ..remote_files import absolute
from ..threads import limit_threads
from .code_facts import code_facts, differences

if TYPE_CHECKING:
    from distributed import Client, Future

Task = TypeVar("Task")
Result = TypeVar("Result")

log = logging.getLogger(__name__)

_AHEAD = 2
"""Tasks in the cluster for each of its threads: one runs, one waits."""

_CONNECT_S = 10
_PATIENCE_S = 60.0
"""Time without a result after which a cluster without workers is reported."""


def run_on_cluster(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    scheduler: str,
    inputs: Sequence[Path],
) -> Iterator[tuple[int, Result | Exception]]:
    """Yield (index of the task, its result or its exception) in the order in which tasks end.

    ``scheduler``: address of a dask scheduler, or its scheduler file. ``inputs``: the files that tasks
    read. A task whose workers die again and again is run once more alone, and then fails. ConfigError
    without dask.distributed; ClusterError if the scheduler cannot be reached or is lost, and if a worker
    has another package or other files.
    """
    with _connected(scheduler) as client:
        expected = Expected.here(inputs)

        def send(index: int) -> Future[Any]:
            task = _with_absolute_paths(tasks[index])
            sent: Future[Any] = client.submit(run_on_worker, function, task, expected, pure=False)
            return sent

        suspects = []
        for index, outcome in _outcomes(client, send, range(len(tasks))):
            if _is_killed(outcome):
                suspects.append(index)  # or a task that was on the same worker
            else:
                yield index, outcome
        for suspect in suspects:
            for index, outcome in _outcomes(client, send, [suspect]):
                yield index, _died() if _is_killed(outcome) else outcome


@dataclass(frozen=True)
class Expected:
    """What a worker must have: the code (`code_facts`), and the SHA-256 sums of files by absolute path. ``sums``: those
    of files in a state, which need not be read again.
    """

    code: dict[str, str]
    files: dict[str, str]
    sums: list[list[int | str]]

    @classmethod
    def here(cls, inputs: Sequence[Path]) -> Expected:
        """What this process has."""
        facts = zip(inputs, file_facts(inputs), strict=True)
        files = {absolute(path): content_of(found) for path, found in facts}
        return cls(code_facts(), files, known_sums())

    def difference(self) -> str | None:
        """What is different in this process, in words; None if nothing is."""
        if others := differences(self.code, code_facts()):
            return f"has another {others} than the process that sends the areas"
        know_sums(self.sums)
        for name, wanted in self.files.items():
            try:
                (found,) = file_facts([Path(name)])
            except OSError as error:
                return f"{name}: {error.strerror or error}"
            if content_of(found) != wanted:
                return f"{name}: has other content than the file that `lcp` was given"
        return None


def run_on_worker(
    function: Callable[[Any], Result], task: bytes, expected: Expected
) -> Result | Exception:
    """The result or the exception of a pickled task, on one thread; ClusterError if this worker differs
    from what the task expects.
    """
    from distributed import get_worker

    if difference := expected.difference():
        return ClusterError(f"worker {get_worker().address}: {difference}")
    limit_threads(1)
    keep_memory()  # dask's nanny sets `MALLOC_TRIM_THRESHOLD_`: every large array would go back
    try:
        return function(pickle.loads(task))
    except Exception as error:  # the sender decides about the other tasks
        return error


class _AbsolutePaths(pickle.Pickler):
    """Pickler of objects whose relative paths become absolute: workers have other working folders."""

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, Path):
            return type(value), (absolute(value),)
        return NotImplemented


def _with_absolute_paths(task: Any) -> bytes:
    stream = io.BytesIO()
    _AbsolutePaths(stream).dump(task)
    return stream.getvalue()


def _connected(scheduler: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError(
            "`scheduler` needs dask.distributed: pip install 'lcp-catalog[cluster]'"
        ) from error
    if not log.isEnabledFor(
        logging.DEBUG
    ):  # what it logs as an error, `ClusterError` says in one line
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    address = _address(scheduler)
    try:
        return Client(address, timeout=_CONNECT_S, name="lcp")
    except (OSError, ValueError, TypeError) as error:
        cause = (str(error) or type(error).__name__).splitlines()[0]
    gc.collect()  # closes what has failed; while another client starts, dask would wait for ever
    raise ClusterError(f"`scheduler` {scheduler}: cannot connect: {cause}")


def _address(scheduler: str) -> str:
    """The address itself, or the one in a scheduler file of dask."""
    if not Path(scheduler).exists():
        if ":" not in scheduler:
            raise ClusterError(
                f"`scheduler` {scheduler}: neither a file nor an address such as tcp://HOST:8786"
            )
        return scheduler
    try:
        return str(json.loads(Path(scheduler).read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ClusterError(
            f"`scheduler` {scheduler}: is not a scheduler file of dask: it has no address"
        ) from error


def _outcomes(
    client: Client, send: Callable[[int], Future[Any]], indices: Sequence[int]
) -> Iterator[tuple[int, Any]]:
    """Send the tasks, a few for each thread of the cluster at a time; yield what comes back."""
    waiting, running = deque(indices), dict[Any, int]()
    try:
        while waiting or running:
            room = max(1, _AHEAD * sum(client.ncores().values()))
            while waiting and len(running) < room:
                index = waiting.popleft()
                running[send(index)] = index
            for future in _ended(client, list(running)):
                outcome, index = _fetched(future), running.pop(future)
                future.release()
                yield index, outcome
    except ClusterError:
        raise
    except (CancelledError, OSError) as error:
        raise ClusterError(
            "the connection to the dask scheduler is lost; finished areas are kept: run again with `resume`"
        ) from error


def _ended(client: Client, running: list[Future[Any]]) -> list[Future[Any]]:
    """Those that have ended, at least one."""
    from distributed import wait

    while True:
        try:
            return list(wait(running, timeout=_PATIENCE_S, return_when="FIRST_COMPLETED").done)
        except TimeoutError:
            if not client.ncores():
                log.warning("the dask cluster has no worker; waiting for one")


def _fetched(future: Future[Any]) -> Any:
    """The result or the exception. ClusterError if the worker cannot take part, CancelledError if the
    scheduler is lost.
    """
    try:
        outcome = future.result()
    except CancelledError:
        raise
    except (ImportError, AttributeError) as error:
        raise ClusterError(
            f"a worker of the cluster cannot run lcp-catalog {__version__}: {error}"
        ) from error
    except Exception as error:  # the caller decides about the other tasks
        return error
    if isinstance(outcome, ClusterError):
        raise outcome
    return outcome


def _is_killed(outcome: object) -> bool:
    from distributed import KilledWorker

    return isinstance(outcome, KilledWorker)


def _died() -> RuntimeError:
    return RuntimeError(
        "the workers that computed it died (killed, or out of memory); try more memory or a smaller area"
    )
