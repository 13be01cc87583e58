"""Error messages of the command line and their exit codes."""

from __future__ import annotations

import errno
import signal

import click

from lcp_catalog.errors import ConfigError, LcpError, printable

from .messages import is_json, say
from .names import has_option
from .signals import Stopped

_NO_MEMORY = "failed to map segment", "Could not find/load shared object"
"""What the system, and llvmlite, say of a library that does not fit in memory."""

EXIT_FAILED = 1
EXIT_USAGE = 2


def exit_code_of(error: BaseException) -> int:
    """Print one line about ``error`` on stderr and return its exit code."""
    if isinstance(error, click.ClickException):
        if is_json():
            say(_shortened(error.format_message()), "error", exit_code=error.exit_code)
        else:
            # a file name can hold anything
            object.__setattr__(error, "message", _shortened(printable(error.message)))
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


_SAVING = {
    "--size": "a smaller area",
    "--bounds": "a smaller area",
    "--gsd": "a coarser --gsd",
    "--jobs": "fewer --jobs",
}
"""What takes less memory, by the options with which a command does it."""

_LONGEST_WORD, _LONGEST_TEXT = 300, 3000
"""Characters of a word and of a message that are shown."""


def _less_memory() -> str:
    ways = [*dict.fromkeys(way for flag, way in _SAVING.items() if has_option(flag))]
    last = ways.pop() if ways else ""
    first = f"{', '.join(ways)} or " if ways else ""
    return f"use {first}{last}" if last else "end other programs, or raise its limit of memory"


def _shortened(text: str) -> str:
    """The text, in which long words (names that a user gave) and many of them lack their middle."""
    for word in {one for one in text.split() if len(one) > _LONGEST_WORD}:
        text = text.replace(word, _cut(word, _LONGEST_WORD // 3))
    return _cut(text, _LONGEST_TEXT // 2) if len(text) > _LONGEST_TEXT else text


def _cut(text: str, side: int) -> str:
    return f"{text[:side]}...{text[-side:]}"


def _one_line(error: BaseException) -> str:
    if isinstance(error, LcpError):
        text = str(error)
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        text = f"the disk is full while writing {error.filename or 'the output'}; free some space and run again"
    elif isinstance(error, FileNotFoundError) and error.filename is None:
        text = "the working folder no longer exists; change to one that does, and run again"
    elif isinstance(error, MemoryError) or any(said in str(error) for said in _NO_MEMORY):
        text = f"out of memory; {_less_memory()}"
    elif isinstance(error, OSError) or (
        isinstance(error, ImportError) and error.name == "numba"
    ):  # is not there, or shall not compile
        text = str(error)
    else:
        text = f"unexpected {type(error).__name__}: {error} (run again with `lcp --debug ...` for the traceback)"
    return _shortened(" ".join(text.split()))
