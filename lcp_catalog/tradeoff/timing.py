"""Areas computed in processes of their own, with their time and memory."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import AreaFailedError
from ..memory import peak_mb
from ..production.area_job import AreaJob, Candidates, run_area
from ..production.executor import processes
from ..threads import limit_threads


@dataclass(frozen=True)
class TimedArea:
    """Candidates of an area, their wall and CPU time, and the peak memory of the process before and
    after, MB.
    """

    seconds: float
    cpu_seconds: float
    candidates: Candidates
    before_mb: float
    peak_mb: float


def timed_area(job: AreaJob) -> TimedArea:
    """Run `area_job.run_area` on one thread and measure wall time and CPU time; other load on the
    machine affects CPU time less.
    """
    before_mb = peak_mb()
    with limit_threads(1):
        wall, own = time.perf_counter(), time.process_time()
        result = run_area(job)
        wall, own = time.perf_counter() - wall, time.process_time() - own
    return TimedArea(wall, own, result.candidates, before_mb, peak_mb())


class Workers:
    """A spawned process for each name, or this process for all."""

    def __init__(self, isolated: bool) -> None:
        self._isolated, self._stack = isolated, ExitStack()
        self._pools: dict[str, ProcessPoolExecutor] = {}

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function in the named process. Raises its errors, and AreaFailedError if the
        process dies.
        """
        if not self._isolated:
            return function(*arguments)
        if name not in self._pools:
            self._pools[name] = self._stack.enter_context(processes(1))
        try:
            return self._pools[name].submit(function, *arguments).result()
        except BrokenProcessPool as error:
            raise AreaFailedError(
                f"the process of {name} died (killed or out of memory); use a coarser `gsd_m` or a smaller area"
            ) from error


@dataclass
class Runs:
    """Results of the process of one tier."""

    areas: dict[str, list[TimedArea]] = field(default_factory=dict)  # by name, one per round
    base_mb: float = 0.0

    def add(self, area: str, outcome: TimedArea) -> None:
        self.areas.setdefault(area, []).append(outcome)

    def total(self, clock: str) -> float:
        """Seconds of all areas by a clock (a field of `TimedArea`), each the median over its
        rounds.
        """
        areas = self.areas.values()
        return sum(float(statistics.median(getattr(r, clock) for r in runs)) for runs in areas)

    @property
    def by_round(self) -> list[float]:
        """Wall time of all areas in each round."""
        return [sum(run.seconds for run in turn) for turn in zip(*self.areas.values(), strict=True)]

    @property
    def peak_mb(self) -> float:
        return max(run.peak_mb for runs in self.areas.values() for run in runs)

    @property
    def candidates(self) -> Candidates:
        everything: Candidates = _joined([runs[-1].candidates for runs in self.areas.values()])
        return everything


def _joined(parts: list[Any]) -> Any:
    """Concatenate dataclasses of arrays of the same type."""
    columns: dict[str, Any] = {}
    for field_ in dataclasses.fields(parts[0]):
        values = [getattr(part, field_.name) for part in parts]
        nested = dataclasses.is_dataclass(values[0])
        columns[field_.name] = (
            None if values[0] is None else _joined(values) if nested else np.concatenate(values)
        )
    return dataclasses.replace(parts[0], **columns)
