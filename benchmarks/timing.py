"""Times of things that run in turn in one process: ratios hold on a machine that others use, too."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage

Task = Callable[[], object]
Times = dict[str, list[float]]
"""Seconds of each round, by the task's name."""


def processor_s() -> float:
    """Processor time of this process and of those that it waited for, seconds."""
    return sum(sum(getrusage(who)[:2]) for who in (RUSAGE_SELF, RUSAGE_CHILDREN))


def seconds(task: Task, clock: Callable[[], float] = time.process_time) -> float:
    """Seconds of one call by a clock."""
    start = clock()
    task()
    return clock() - start


def in_turn(
    tasks: Mapping[str, Task],
    rounds: int = 5,
    clock: Callable[[], float] = time.process_time,
    before: Task = lambda: None,
    warm: Sequence[str] | None = None,
) -> Times:
    """Time tasks in turn, every second round in the opposite order, after one untimed run of each, or of those that ``warm``
    names; ``before`` runs untimed before each.
    """
    for name in tasks if warm is None else warm:
        tasks[name]()
    times: Times = {name: [] for name in tasks}
    for number in range(rounds):
        for name in list(tasks)[:: 1 if number % 2 else -1]:
            before()
            times[name].append(seconds(tasks[name], clock))
    return times


def median(values: Iterable[float]) -> float:
    return float(statistics.median(values))


def ratio(first: Sequence[float], second: Sequence[float]) -> float:
    """Median over the rounds of the second's time over the first's."""
    return median(b / a for a, b in zip(first, second, strict=True))
