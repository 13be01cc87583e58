"""Things that are timed in turn, and their tables in Markdown."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from build_areas import Package
from build_differences import ALL, FLAGS, Differences, share
from build_stages import measured


@dataclass
class Subject:
    """One of the things that are timed in turn on a case."""

    name: str
    run: Callable[[], Any]
    nodes: int
    conditions: int
    package: Package
    job: Any
    staged: bool = True
    """True if its stages are timed, too."""
    seconds: list[float] = field(default_factory=list)
    stages: list[dict[str, float]] = field(default_factory=list)
    result: Any = None

    @property
    def candidates(self) -> Any:
        """The candidates of the result."""
        return getattr(self.result, "candidates", self.result)

    @property
    def usable(self) -> float:
        """Share of the evaluated candidate-conditions that are usable."""
        condition = self.candidates.evaluation.condition
        return share(condition[condition > 0] == ALL)

    @property
    def rate(self) -> float:
        """Own nodes times conditions a second and core, millions."""
        return self.nodes * self.conditions / statistics.median(self.seconds) / 1e6


def in_turn(subjects: Sequence[Subject], rounds: int) -> None:
    """Time the subjects in turn, as a whole and by stage, after one run of each that compiles its
    kernels; every second round in the opposite order.
    """
    for one in subjects:
        one.result = one.run()
    for number in range(rounds):
        for one in subjects if number % 2 else list(reversed(subjects)):
            one.package.forget()
            start = time.process_time()
            one.run()
            one.seconds.append(time.process_time() - start)
            if one.staged:
                one.package.forget()
                with measured(one.package) as clock:
                    one.run()
                one.stages.append(clock.stop())


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, the columns behind the first aligned to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def sizes(subjects: Sequence[Subject], job: Any) -> str:
    """Size of the area, and the rates."""
    rows = [
        [
            one.name,
            str(one.nodes),
            str(one.conditions),
            str(len(one.candidates)),
            f"{100.0 * one.usable:.1f}",
            f"{statistics.median(one.seconds):.3f}",
            f"{one.rate:.3f}",
        ]
        for one in subjects
    ]
    head = [
        "",
        "own nodes",
        "conditions",
        "candidates",
        "usable, %",
        "seconds",
        "million node-conditions / s",
    ]
    return f"Area {job.task.name}, cells of {job.gsd_m:.0f} m.\n\n{table(head, rows)}"


def stage_table(subjects: Sequence[Subject]) -> str:
    """Milliseconds by stage, medians."""
    timed = [one for one in subjects if one.stages]
    rows = []
    for stage in timed[0].stages[0]:
        times = [statistics.median(part[stage] for part in one.stages) for one in timed]
        rows.append([stage, *(f"{1e3 * seconds:.1f}" for seconds in times)])
    totals = (statistics.median(sum(part.values()) for part in one.stages) for one in timed)
    rows.append(["all", *(f"{1e3 * seconds:.1f}" for seconds in totals)])
    return table(["stage, ms", *(one.name for one in timed)], rows)


def ratio(first: Subject, second: Subject) -> float:
    """Median over the rounds of the second's time over the first's, per own node and condition."""
    share = (first.nodes * first.conditions) / (second.nodes * second.conditions)
    each = (b / a for a, b in zip(first.seconds, second.seconds, strict=True))
    return share * statistics.median(each)


def ratio_text(subjects: Sequence[Subject]) -> str:
    first, *others = subjects
    return "\n".join(
        f"Times faster than {other.name}: {ratio(first, other):.2f}" for other in others
    )


def differences_text(found: Differences, name: str) -> str:
    """The differences, with the flags that differ."""
    flags = ", ".join(
        f"{name} {100.0 * part:.3f} %" for name, part in zip(FLAGS, found.flags, strict=True)
    )
    rows = [
        ["candidates at the same places / only there / only now",
         f"{found.paired} / {found.alone[0]} / {found.alone[1]}"],
        ["candidate-conditions", str(found.evaluated)],
        ["any of the five flags differs", f"{100.0 * found.any_flag:.3f} %"],
        ["usable decision differs", f"{100.0 * found.usable:.3f} %"],
        ["detection probability, largest / mean difference",
         f"{found.detection[0]:.4f} / {found.detection[1]:.2g}"],
        ["sigma_major, largest / mean relative difference",
         f"{found.sigma[0]:.4f} / {found.sigma[1]:.2g}"],
        ["sigma_major finite in one only", f"{100.0 * found.sigma_lost:.3f} %"],
    ]  # fmt: skip
    return f"{table([f'now against {name}', 'difference'], rows)}\n\nFlags: {flags}."
