"""Messages on stderr: lines of text or, with ``--log-format json``, one JSON object a line."""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, TypeVar

import click

from lcp_catalog.errors import printable

from .names import in_options, runs

EXIT_NO = 4
"""Exit code of a command that ran and says no: not intact, not the place, not equal, not as required."""

Command = TypeVar("Command", bound=Callable[..., Any])


class _State:
    """How the messages of this run are written."""

    as_json = False
    replaced = False
    """The last line on the terminal is one that is to be replaced, or that will be drawn again."""
    progress_at = math.inf
    """When the last line of progress was written (`time.monotonic`), if there was one."""


def echo(text: str, err: bool = False, nl: bool = True) -> None:
    """Print a text that may hold parts of a file or of its name: control characters are shown as escapes."""
    clear()
    click.echo(printable(text), err=err, nl=nl)


def replace_line(text: str) -> None:
    """Show a line on the terminal in place of the last one of its kind."""
    click.echo(f"\r{text}\x1b[K", err=True, nl=False)
    _State.replaced = True


def drawn(line: bool = True) -> None:
    """A ``line`` of progress was drawn, which a message takes away; or it stays as it is."""
    _State.replaced = line


def clear() -> None:
    """Take such a line away."""
    if _State.replaced:
        _State.replaced = False
        click.echo("\r\x1b[K", err=True, nl=False)


def say(text: str, event: str = "message", **facts: Any) -> None:
    """Write a `line` on stderr."""
    if event == "progress":
        _State.progress_at = time.monotonic()
    echo(line(text, event, facts), err=True)


def line(text: str, event: str, facts: Mapping[str, Any]) -> str:
    """A line for stderr; as JSON with the time, the kind of ``event`` and its facts. Names of the
    library's parameters become options.
    """
    text = in_options(text)
    if _State.as_json:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        text = json.dumps({"time_utc": now, "event": event, "text": text, **facts})
    return text


def silent_s() -> float:
    """Seconds since the run's last line of progress; below 0 if there was none."""
    return time.monotonic() - _State.progress_at


def is_json() -> bool:
    """True if messages are JSON."""
    return _State.as_json


class _LogHandler(logging.Handler):
    """Records of the library's log as messages."""

    def emit(self, record: logging.LogRecord) -> None:
        level, text = record.levelname, self.format(record)
        if not _State.as_json:
            text = f"{level} {record.name}: {text}"
        say(text, "log", level=level.lower(), logger=record.name)


class _LastResort(logging.Handler):
    """Warnings of a run without ``-v``: the text alone, once."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        if (text := self.format(record)) not in self._said:
            self._said.add(text)
            say(text)


_HANDLER = _LogHandler()

OURS = ("lcp_catalog", "lcp_cli")
"""Loggers of the program; other libraries log warnings only."""


def show_log(level: int) -> None:
    """Write the program's own records of the log from a level on, and warnings of other libraries. Without
    this only warnings are written, as plain text.
    """
    logging.getLogger().addHandler(_HANDLER)
    for name in OURS:
        logging.getLogger(name).setLevel(level)


def reset() -> None:
    """Begin a run: messages are text, and of the log only warnings."""
    _State.as_json, _State.progress_at = False, math.inf
    runs(None)
    logging.captureWarnings(False)
    logging.lastResort = _LastResort(logging.WARNING)
    logging.getLogger().removeHandler(_HANDLER)
    logging.getLogger().setLevel(logging.WARNING)
    for name in OURS:
        logging.getLogger(name).setLevel(logging.NOTSET)


def _set_format(context: click.Context, option: click.Parameter, value: str | None) -> None:
    if value == "json":
        _State.as_json = True
        logging.captureWarnings(True)
        show_log(logging.getLogger(OURS[0]).level)


log_format_option = click.option(
    "--log-format",
    type=click.Choice(["text", "json"]),
    expose_value=False,
    is_eager=True,
    callback=_set_format,
    help="Form of the messages on stderr: text (default), or one JSON object a line.",
)
"""For `lcp` itself, and for a command that runs long."""
