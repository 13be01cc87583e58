"""Things that are timed in turn, and their tables in Markdown."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from build_areas import Package
from build_differences import ALL, FLAGS, Differences, share
from build_stages import Scripts, measured


@dataclass
class Subject:
    """One of the things that are timed in turn on a case."""

    name: str
    run: Callable[[], Any]
    nodes: int
    conditions: int
    package: Package
    job: Any
    watched: Package | Scripts
    """What holds the functions of its stages."""
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
            one.package.forget()
            with measured(one.watched) as clock:
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
    rows = []
    for stage in subjects[0].stages[0]:
        times = [_median(one, stage) for one in subjects]
        rows.append([stage, *(f"{1e3 * seconds:.1f}" for seconds in times)])
    totals = (statistics.median(sum(part.values()) for part in one.stages) for one in subjects)
    rows.append(["all", *(f"{1e3 * seconds:.1f}" for seconds in totals)])
    return table(["stage, ms", *(one.name for one in subjects)], rows)


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


# -- cases


FULL = "every search at full resolution"


@dataclass(frozen=True)
class Measured:
    """A case: what was timed, this package first, and the differences of this package's result from
    the others, by their names.
    """

    name: str
    subjects: Sequence[Subject]
    differences: Mapping[str, Differences]

    def text(self) -> str:
        """All tables of the case."""
        parts = [f"## {self.name}", sizes(self.subjects, self.subjects[0].job)]
        parts += [stage_table(self.subjects), ratio_text(self.subjects)]
        parts += [differences_text(found, name) for name, found in self.differences.items()]
        return "\n\n".join(parts) + "\n"


def summary(cases: Sequence[Measured]) -> str:
    """One row a case: rates, ratios, usable decisions that differ; and the stages of all cases."""
    rows = []
    for case in cases:
        now, *others = case.subjects
        row = [case.name, str(now.nodes), str(now.conditions), str(len(now.candidates))]
        row += [f"{one.rate:.3f}" for one in case.subjects]
        row += [f"{ratio(now, other):.1f}" for other in others]
        row += [f"{100.0 * found.usable:.3f}" for found in _columns(case, cases)]
        rows.append(row)
    first = cases[0].subjects
    head = ["case", "own nodes", "conditions", "candidates"]
    head += [f"{one.name}, M node-conditions / s" for one in first]
    head += [f"times {other.name}" for other in first[1:]]
    head += [f"decisions not as {name}, %" for name in _names(cases)]
    order = list(reversed(range(len(first))))
    stages = []
    for stage in first[0].stages[0]:
        cells = []
        for case in cases:
            times = [_median(case.subjects[k], stage) for k in order]
            cells.append(" / ".join(f"{1e3 * seconds:.0f}" for seconds in times))
        stages.append([stage, *cells])
    title = f"ms: {' / '.join(first[k].name for k in order)}"
    both = table(head, rows), table([title, *(case.name for case in cases)], stages)
    return f"## all cases\n\n{both[0]}\n\n{both[1]}\n"


def _names(cases: Sequence[Measured]) -> list[str]:
    """Names that any case was compared with, without those of searches at full resolution."""
    return list(dict.fromkeys(n for case in cases for n in case.differences if FULL not in n))


def _columns(case: Measured, cases: Sequence[Measured]) -> list[Differences]:
    """A case's differences in the order of `_names`; those of an older package with full searches
    where there are any, because the first searches of that package lose places.
    """
    found = case.differences
    return [found.get(f"{name}, {FULL}", found[name]) for name in _names(cases)]


def _median(one: Subject, stage: str) -> float:
    return statistics.median(part[stage] for part in one.stages)
