"""What a long call is doing, for who shows it: the library says it as it goes on, `lcp` prints it now and then; and what
each part of it takes, for who asks.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec, TypeVar

Progress = Callable[[int, int], None]
"""Takes how many parts of a call are done, and how many there are."""


def unseen(done: int, total: int) -> None:
    """Nobody watches."""


class Steps:
    """Counts the steps of a call whose parts become known one after the other: a part's steps join all when it begins, and
    those that the part before left out go.
    """

    def __init__(self, progress: Progress = unseen) -> None:
        self._progress, self._done, self._total = progress, 0, 0

    def begin(self, count: int = 0) -> None:
        """A part begins, of so many steps as far as that is known."""
        self._total = self._done
        if count:
            self.more(count)

    def more(self, count: int) -> None:
        """The part has so many more steps."""
        self._total += count
        self._progress(self._done, self._total)

    def one(self, count: int = 1) -> None:
        """A step is done, or several at once."""
        self._done += count
        self._progress(self._done, self._total)


_P = ParamSpec("_P")
_R = TypeVar("_R")


def _unheard(text: str) -> None:
    """Nobody asks."""


told: Callable[[str], None] = _unheard
"""Takes each new stage; replaced by who shows it."""

_within = ""


def stage(text: str) -> None:
    """Say what is done from now on, within the part that `part` named last."""
    told(_within + text)


def part(text: str) -> None:
    """Name the part of the work to which the next stages belong; empty: the whole."""
    global _within  # noqa: PLW0603  one process computes one thing at a time
    _within = f"{text}, " if text else ""


_SPENT: ContextVar[dict[str, float] | None] = ContextVar("spent", default=None)


def timed(effect: str, is_stage: bool = True) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """The time of a function, without that of others which it calls, counts as the effect's in `shares_of_time`; it is a
    stage of its own, or, one of many short calls, none.
    """

    def around(function: Callable[_P, _R]) -> Callable[_P, _R]:
        @wraps(function)
        def watched(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            if is_stage:
                stage(effect)
            book = _SPENT.get()
            if book is None:
                return function(*args, **kwargs)
            start, counted = time.perf_counter(), sum(book.values())
            found = function(*args, **kwargs)
            within = sum(book.values()) - counted
            book[effect] = book.get(effect, 0.0) + time.perf_counter() - start - within
            return found

        return watched

    return around


@contextmanager
def shares_of_time() -> Iterator[dict[str, float]]:
    """Measures what is done in the context: after it, the share of its time that each `timed` effect took."""
    book: dict[str, float] = {}
    token, start = _SPENT.set(book), time.perf_counter()
    try:
        yield book
    finally:
        _SPENT.reset(token)
    whole = time.perf_counter() - start
    for effect in book:
        book[effect] /= whole
