"""Error messages of the command line and their exit codes."""

from __future__ import annotations

import errno
import signal

import click

from lcp_catalog.errors import ConfigError, LcpError, printable

from .messages import is_json, say
from .signals import Stopped

_NO_MEMORY = "failed to map segment", "Could not find/load shared object"
"""What the system, and llvmlite, say of a library that does not fit in memory."""

EXIT_FAILED = 1
EXIT_USAGE = 2


def exit_code_of(error: BaseException) -> int:
    """Print one line about ``error`` on stderr and return its exit code."""
    if isinstance(error, click.ClickException):
        if is_json():
            say(error.format_message(), "error", exit_code=error.exit_code)
        else:
            # a file name can hold anything
            object.__setattr__(error, "message", printable(error.message))
            error.show()
        return error.exit_code
    if isinstance(error, KeyboardInterrupt | click.Abort):
        stopped = error if isinstance(error, Stopped) else Stopped(signal.SIGINT)
        code = stopped.exit_code
        say(f"lcp: {stopped.how}; no incomplete output was left", "error", exit_code=code)
        return code
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else EXIT_FAILED
    code = EXIT_USAGE if isinstance(error, ConfigError) else EXIT_FAILED
    say(f"lcp: {_one_line(error)}", "error", exit_code=code)
    return code


def _one_line(error: BaseException) -> str:
    if isinstance(error, LcpError):
        text = str(error)
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        text = f"the disk is full while writing {error.filename or 'the output'}; free some space and run again"
    elif isinstance(error, FileNotFoundError) and error.filename is None:
        text = "the working folder no longer exists; change to one that does, and run again"
    elif isinstance(error, MemoryError) or any(said in str(error) for said in _NO_MEMORY):
        text = "out of memory; use a smaller area, a coarser --gsd or fewer --jobs"
    elif isinstance(error, OSError) or (
        isinstance(error, ImportError) and error.name == "numba"
    ):  # is not there, or shall not compile
        text = str(error)
    else:
        text = f"unexpected {type(error).__name__}: {error} (run again with `lcp --debug ...` for the traceback)"
    return " ".join(text.split())
