"""A function in a process of its own, with limits of time and memory: whatever a damaged file does to
the library that reads it (a crash, an endless loop, an allocation of what the file claims), the
caller goes on with one line of text.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

MEMORY_MB = 1000
"""Memory that the function may allocate, 10^6 bytes."""

_WALL_FACTOR = 10.0
"""Elapsed time that is allowed, as a multiple of the processor time: the machine may be busy."""

_OUT_OF_MEMORY = 3

_LINE = 300
"""Characters of an error's last line that are told."""

_FRESH = """\
import json, os, sys
sys.path[:] = json.loads(sys.argv[1])
sys.excepthook = lambda kind, error, _: os.write(1, f"{kind.__name__}: {error}".encode())
from lcp_catalog.child_process import run_by_name
run_by_name(json.loads(sys.argv[2]))
"""


_SAFE_PATH = "PYTHONSAFEPATH"
"""Variable of the environment of a Python that never imports from the working folder, which can hold a file
like ``random.py``."""


@contextmanager
def safe_path() -> Iterator[None]:
    """A context in which processes start that never import from the working folder."""
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE_PATH, None)
        else:
            os.environ[_SAFE_PATH] = before


resting: Callable[[], AbstractContextManager[None]] = nullcontext
"""A context without the threads of the program that calls this library, in which this process may be forked."""


class ChildFailedError(Exception):
    """The function did not come to an end in its process; the text says how it ended."""


def call_apart(
    function: Callable[[Any], Any], argument: Any, seconds: float, memory_mb: float = MEMORY_MB
) -> Any:
    """``function(argument)`` in another process; JSON can hold the argument and the result.

    ``function``: a public function of a module of this package. ``seconds``: processor time that it
    may use. The process is a fork of this one if this one has a single thread, and otherwise a
    fresh interpreter, which takes 0.1 s more than the imports of the function's module.
    ChildFailedError if it ends without a result.
    """
    reader, writer = os.pipe()
    try:
        given = (function.__module__, function.__name__, argument, seconds, memory_mb)
        with resting():
            process = _forked(given, reader, writer) if _single_thread() else _fresh(given, writer)
    finally:
        os.close(writer)
    try:
        content, late = _received(reader, time.monotonic() + _WALL_FACTOR * seconds)
    except BaseException:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        raise
    finally:
        os.close(reader)
    if late:
        os.kill(process, signal.SIGKILL)
    return _result(content, os.waitpid(process, 0)[1], seconds, memory_mb)


def run_by_name(given: Sequence[Any]) -> NoReturn:
    """Call a function (module, name, its argument, seconds, megabytes) under limits, write its result to
    stdout as JSON, and end this process.
    """
    code = 1
    module, name, argument, seconds, memory_mb = given
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent gets it too, and ends this one
        function = getattr(import_module(module), name)
        _limit(seconds, memory_mb)
        content = json.dumps(function(argument)).encode()
        while content:
            content = content[os.write(1, content) :]
        code = 0
    except MemoryError:
        code = _OUT_OF_MEMORY
    except Exception as error:  # whatever it is: the process ends here, its parent tells why
        os.write(1, f"\n{type(error).__name__}: {' '.join(str(error).split())}".encode())
    finally:
        os._exit(code)


def _single_thread() -> bool:
    """True if this process certainly has one thread, so that a fork of it holds no locks. One that was joined (`resting`) may
    be listed for a moment.
    """
    with suppress(OSError):
        for wait_s in (0.0, 0.001, 0.01):
            time.sleep(wait_s)
            if len(os.listdir("/proc/self/task")) == 1:
                return True
    return False


def _forked(given: tuple[Any, ...], reader: int, writer: int) -> int:
    process = os.fork()
    if process:
        return process
    os.close(reader)
    os.dup2(writer, 1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    faulthandler.disable()
    run_by_name(given)


def _fresh(given: tuple[Any, ...], writer: int) -> int:
    arguments = [sys.executable, "-c", _FRESH, json.dumps(sys.path), json.dumps(given)]
    variables = os.environ | {"OPENBLAS_NUM_THREADS": "1", _SAFE_PATH: "1"}
    streams = [
        (os.POSIX_SPAWN_DUP2, writer, 1),
        (os.POSIX_SPAWN_OPEN, 2, os.devnull, os.O_WRONLY, 0),
    ]
    return os.posix_spawn(sys.executable, arguments, variables, file_actions=streams)


def _limit(seconds: float, memory_mb: float) -> None:
    """Limit the processor time and the memory beyond what imports have taken, and dumps of crashes."""
    used = 0
    with suppress(OSError, ValueError):
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    for kind, most in (
        (resource.RLIMIT_CPU, int(seconds + time.process_time()) + 1),
        (resource.RLIMIT_AS, used + int(memory_mb * 1e6)),
        (resource.RLIMIT_CORE, 0),
    ):
        with suppress(OSError, ValueError):  # a system that lacks this limit
            resource.setrlimit(kind, (_least(kind, most), resource.getrlimit(kind)[1]))


def _least(kind: int, most: int) -> int:
    """The smaller of a limit and that of this process."""
    limit = resource.getrlimit(kind)[0]
    return most if limit == resource.RLIM_INFINITY else min(most, limit)


def _received(reader: int, deadline: float) -> tuple[bytes, bool]:
    """What the process wrote, and whether it was late."""
    parts: list[bytes] = []
    while select.select([reader], [], [], max(0.0, deadline - time.monotonic()))[0]:
        part = os.read(reader, 2**20)
        if not part:
            return b"".join(parts), False
        parts.append(part)
    return b"", True


def _result(content: bytes, status: int, seconds: float, memory_mb: float) -> Any:
    code = os.waitstatus_to_exitcode(status)
    if code == 0:
        return json.loads(content)
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        raise ChildFailedError(
            f"takes more than {seconds:.0f} s of processor time or {_WALL_FACTOR * seconds:.0f} s in all, "
            "or was killed"
        )
    if code == _OUT_OF_MEMORY:
        most = _least(resource.RLIMIT_AS, int(memory_mb * 1e6))
        raise ChildFailedError(f"needs more than {most / 1e6:.0f} MB of memory")
    if code < 0:
        raise ChildFailedError(f"crashed with signal {-code}")
    lines = content.decode("utf-8", "replace").splitlines()
    why = f" ({lines[-1][:_LINE]})" if lines else ""
    raise ChildFailedError(f"ended with code {code}{why}")
