"""Progress on stderr: a bar on a terminal, a line now and then elsewhere; with rate and time left."""

from __future__ import annotations

import math
import sys
import threading
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate

import click

from .messages import is_json, say

_EVERY_S = {False: 10.0, True: 1.0}
"""Least time between two lines, of text and of JSON."""

_BEAT_S = 1.0
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
        if not done:
            return f"{duration_text(time.monotonic() - began)} so far"
        return f"{duration_text(pace.left_s)} left" if weights else pace.text

    bar = click.progressbar(
        length=1,
        label=label,
        file=sys.stderr,
        show_pos=True,
        show_eta=not weights,
        item_show_func=shown,
    )
    with bar, _beating(bar.render_progress):

        def update(done: int, total: int) -> None:
            pace.update(done, total)
            bar.length = max(total, 1)
            bar.update(done - bar.pos, done)

        yield update


@contextmanager
def _beating(beat: Callable[[], None]) -> Iterator[None]:
    """Call ``beat`` every second in the block, also while nothing ends."""
    ended = threading.Event()

    def beats() -> None:
        while not ended.wait(_BEAT_S):
            beat()

    thread = threading.Thread(target=beats, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


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
        self._said_at: float | None = None
        self._began = self._heard_at = time.monotonic()
        self._state = "preparing"

    def beat(self) -> None:
        """Say the time that has passed, if nothing was said for long."""
        now = time.monotonic()
        if now - max(self._heard_at, self._said_at or 0.0) >= _EVERY_S[False]:
            self._heard_at = now
            passed = now - self._began
            say(
                f"{self._label}: {self._state}, {duration_text(passed)} so far",
                "progress",
                label=self._label,
                seconds=passed,
            )

    def update(self, done: int, total: int) -> None:
        pace, now = self._pace, time.monotonic()
        pace.update(done, total)
        self._state = f"{done} of {total}"
        if self._said_at is None:
            self._said_at = now if not is_json() else -1e9
        last = is_json() and done == total
        if now - self._said_at < _EVERY_S[is_json()] and not last:
            return
        self._said_at = now
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
