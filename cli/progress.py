"""Progress on stderr: a bar on a terminal, a line now and then elsewhere; with rate and time left. No command is
silent for more than two seconds: not before its first step, not within one, and not if it has none.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import accumulate

import click

from lcp_catalog import child_process, stages

from . import messages
from .messages import is_json, say

_FIRST_S = 1.0
"""Time after which a task says its first line; a command has needed some for its start."""

_EVERY_S = {False: 1.7, True: 1.0}
"""Least time between two lines, of text and of JSON."""

_SLOWER, _SLOWEST_S = 1.0 / 150.0, 60.0
"""Part of the time of a task so far that is between two lines, and the most of it: a log of hours stays short."""

_BEAT_S = 0.25
"""Time between two looks whether something must be said although no step has ended."""

_FEWEST = 3


@contextmanager
def progress(label: str, weights: Sequence[float] = ()) -> Iterator[Callable[[int, int], None]]:
    """Yield a callback ``(done, total)``. The rate counts from its first call, because a resumed run
    begins with what is done. ``weights``: shares of the time that the steps take in their order, by which the time left is told.
    """
    if is_json() or not sys.stderr.isatty():
        lines = _Lines(label, weights)
        with _beating(lines.beat):
            yield lines.update
        return
    pace, began = _Pace(weights), time.monotonic()

    def shown(done: int | None) -> str:
        passed = (
            f"{duration_text(time.monotonic() - began)} so far"  # changes, so that the bar is drawn
        )
        if not done:
            return passed
        return (
            f"{duration_text(pace.left_s)} left, {passed}" if weights else f"{pace.text}, {passed}"
        )

    messages.clear()
    bar = click.progressbar(
        length=1,
        label=label,
        file=sys.stderr,
        show_pos=True,
        show_eta=not weights,
        item_show_func=shown,
    )

    def draw() -> None:
        bar.render_progress()
        messages.drawn()

    def update(done: int, total: int) -> None:
        pace.update(done, total)
        bar.length = max(total, 1)
        bar.update(done - bar.pos, done)
        messages.drawn()

    with bar, _beating(draw):
        yield update
        messages.drawn(False)


@contextmanager
def alive(name: str) -> Iterator[None]:
    """Say in the block how long a command has been at work, until it prints something: a line that is replaced on a
    terminal, lines now and then elsewhere.
    """
    lines = _Lines(name, ())
    lines.enter("working")
    before, stages.told = stages.told, lines.enter
    try:
        with _beating(lines.beat):
            yield
    finally:
        stages.told = before
        messages.clear()


_beats: list[Callable[[], None]] = []
"""What the tasks say that run, the innermost last: only that one speaks."""

_heart: list[tuple[threading.Thread, threading.Event]] = []
"""The thread that lets it speak, while a task runs."""


@contextmanager
def _beating(beat: Callable[[], None]) -> Iterator[None]:
    """Call ``beat`` at short intervals in the block, also while nothing ends."""
    _beats.append(beat)
    _start()
    try:
        yield
    finally:
        if len(_beats) == 1:
            _stop()
        _beats.remove(beat)


def _start() -> None:
    """Start the thread if there is none."""
    if _heart:
        return
    ended = threading.Event()

    def beats() -> None:
        with suppress(MemoryError, OSError):  # then it is silent
            while not ended.wait(_BEAT_S):
                _beats[-1]()

    thread = threading.Thread(target=beats, daemon=True)
    with suppress(RuntimeError, MemoryError):  # without the memory for its stack: silence
        thread.start()
        _heart.append((thread, ended))


def _stop() -> None:
    """End the thread."""
    for thread, ended in _heart:
        ended.set()
        thread.join()
    _heart.clear()


@contextmanager
def _resting() -> Iterator[None]:
    """A block without the thread, in which a process may be forked."""
    beats = bool(_heart)
    _stop()
    yield
    if beats:
        _start()


child_process.resting = _resting


class _Pace:
    """Rate of a task, per second, and its time left; both 0 until a step is done. The rate is that of the later
    half of the steps: the first ones may wait for kernels that are compiled. So the time left is told only when
    `_FEWEST` steps are done.
    """

    per_second = left_s = 0.0

    def __init__(self, weights: Sequence[float] = ()) -> None:
        self._seen: list[tuple[int, float]] = []
        self._work = [0.0, *accumulate(weights)]

    def update(self, done: int, total: int) -> None:
        now = time.monotonic()
        self._seen.append((done, now))
        middle = (self._seen[0][0] + done) // 2
        since = self._seen[bisect_left(self._seen, (middle, -math.inf))]
        steps, seconds = done - since[0], now - since[1]
        if steps > 0 and seconds > 0.0:
            self.per_second = steps / seconds
            self.left_s = (total - done) / self.per_second
            if len(self._work) > 1:
                work = self._work
                self.left_s = seconds * (work[total] - work[done]) / (work[done] - work[since[0]])

    @property
    def text(self) -> str:
        """The rate in words."""
        return f"{60.0 * self.per_second:.3g} a minute"

    @property
    def is_known(self) -> bool:
        """As many steps are done as tell the time left."""
        return bool(self._seen) and self._seen[-1][0] >= self._seen[0][0] + _FEWEST


class _Lines:
    """Lines about a task's progress: none in text for one that is soon done; in JSON also the first and
    the last step. While no step ends, the time that has passed.
    """

    def __init__(self, label: str, weights: Sequence[float]) -> None:
        self._label, self._pace = label, _Pace(weights)
        self._said_at = -math.inf if is_json() else 0.0
        self._began = time.monotonic()
        self.state, self._lone = "preparing", False

    def enter(self, stage: str) -> None:
        """A task without counted steps is at another stage."""
        self.state, self._lone = stage, True

    def _is_due(self, least_s: float) -> bool:
        """So much time has passed since the last line that there is another one."""
        now = time.monotonic()
        passed = now - self._began
        if self._said_at <= 0.0:  # the task before may have ended without a line
            return passed >= _FIRST_S or messages.silent_s() >= _EVERY_S[False]
        return now - self._said_at >= max(least_s, min(_SLOWER * passed, _SLOWEST_S))

    def beat(self) -> None:
        """Say the time that has passed, if nothing was said for long."""
        if not self._is_due(_EVERY_S[False]):
            return
        self._said_at = time.monotonic()
        passed = self._said_at - self._began
        text = f"{self._label}: {self.state}, {duration_text(passed)} so far"
        if self._lone and not is_json() and sys.stderr.isatty():
            messages.replace_line(text)
        else:
            say(text, "progress", label=self._label, seconds=passed)

    def update(self, done: int, total: int) -> None:
        self._pace.update(done, total)
        self.state = f"{done} of {total}"
        told = is_json() or self._pace.per_second > 0.0
        ends = is_json() and (done == total or self._said_at < 0.0)
        if not (ends or (told and self._is_due(_EVERY_S[is_json()]))):
            return
        pace, self._said_at = self._pace, time.monotonic()
        left = f", {duration_text(pace.left_s)} left" if pace.is_known else ""
        say(
            f"{self._label}: {done} of {total}, {pace.text}{left}",
            "progress",
            label=self._label,
            done=done,
            total=total,
            per_second=pace.per_second,
            seconds_left=pace.left_s,
        )


def duration_text(seconds: float) -> str:
    """Hours and minutes, minutes and seconds, or seconds."""
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"
