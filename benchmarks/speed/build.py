"""Time of the main job: areas of three terrains by stage beside two pipelines in the same process, a strong one (`strong`) and
a straightforward one (`pipeline`), and whole builds beside another commit.

    python -m benchmarks.speed build areas commit jobs        (make bench-build; default: areas)
    python -m benchmarks.speed build --case highland --rounds 1
    python -m benchmarks.speed build commit --against 4e256b5 --size 60

Areas run on one thread, in turn; ratios are medians over the rounds. Seconds are processor time, so that other processes of the
machine count less; those of `jobs` are wall time, too. The output is Markdown. All parts take half an hour.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from benchmarks import sections
from benchmarks.commands import lcp
from benchmarks.markdown import percent, table
from benchmarks.places import OUTPUT
from benchmarks.speed.areas import CASES, Case, own_nodes, sample
from benchmarks.speed.differences import Differences, Places, differences, share
from benchmarks.speed.stages import LIBRARY, PIPELINE, STAGES, measured
from benchmarks.timing import Task, in_turn, median, ratio
from lcp_catalog.catalog.schema import USABLE
from lcp_catalog.production.area_job import area_sweep, run_area
from lcp_catalog.threads import limit_threads

BEFORE = "4e256b5"
"""The commit before the issues of November 2026: the last of the names of 0.2."""


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed build", __doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--case", action="append", choices=CASES, help="default: all")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--against", default=BEFORE, metavar="REV", help="commit: which")
    parser.add_argument("--size", type=float, default=150.0, metavar="KM", help="commit, jobs")
    parser.add_argument("-o", "--output", type=Path, default=OUTPUT / "build")
    asked = parser.parse_args(words)
    for name in asked.parts:
        if name not in PARTS:
            parser.error(f"no part {name!r}; there are {', '.join(PARTS)}")
    asked.output.mkdir(parents=True, exist_ok=True)
    with limit_threads(1):
        for name in asked.parts or ["areas"]:
            for text in PARTS[name](asked):
                print(f"{text}\n", flush=True)
    return 0


def cases(asked: argparse.Namespace) -> list[Case]:
    return [CASES[name] for name in asked.case or CASES]


# -- areas


@dataclass
class Timed:
    """One way to compute an area: its result, its times, and its times by stage."""

    run: Callable[[], Any]
    stages_of: dict[str, str]
    result: Any = None
    seconds: list[float] = field(default_factory=list)
    stages: list[dict[str, float]] = field(default_factory=list)

    @property
    def candidates(self) -> Any:
        return getattr(self.result, "candidates", self.result)

    def once(self) -> None:
        self.result = self.run()

    def staged(self) -> None:
        with measured(self.stages_of) as found:
            self.run()
        self.stages.append(found)


@dataclass(frozen=True)
class Area:
    """A case's area: the library's run of it and the pipelines', timed in turn."""

    case: Case
    name: str
    cell_m: float
    nodes: int
    conditions: int
    ours: Timed
    theirs: dict[str, Timed]

    @classmethod
    def timed(cls, case: Case, folder: Path, rounds: int) -> Area:
        from benchmarks.speed.pipeline import Pipeline  # Embree is not everywhere
        from benchmarks.speed.strong import Strong

        job, other = case.jobs(folder)
        ours = Timed(partial(run_area, job), LIBRARY, run_area(job))
        found = ours.candidates

        def run(pipeline: type[Pipeline]) -> Places:
            return Places(found.lon_deg, found.lat_deg, pipeline(job, found).run())

        theirs = {
            "strong": Timed(partial(run, Strong), PIPELINE),
            "plain": Timed(partial(run, Pipeline), PIPELINE),
        }
        every = {"now": ours, **theirs}
        elsewhere = partial(area_sweep, other)  # in a build, the last area was another one
        tasks: dict[str, Task] = {name: one.once for name, one in every.items()}
        for name, seconds in in_turn(tasks, rounds, before=elsewhere).items():
            every[name].seconds = seconds
        in_turn({name: one.staged for name, one in every.items()}, rounds, before=elsewhere)
        conditions = job.conditions.count
        return cls(case, job.task.name, job.recipe.gsd_m, own_nodes(job), conditions, ours, theirs)

    def times_faster(self, name: str) -> float:
        return ratio(self.ours.seconds, self.theirs[name].seconds)

    @property
    def rate(self) -> float:
        """Own nodes times conditions a second and core, millions."""
        return self.nodes * self.conditions / median(self.ours.seconds) / 1e6

    def differences(self, name: str) -> Differences:
        return differences(self.theirs[name].candidates, self.ours.candidates, self.cell_m)

    def text(self) -> str:
        """Sizes, stages and differences."""
        both = {"now": self.ours, **self.theirs}
        sizes = [
            [name, self.nodes, self.conditions, len(one.candidates), _usable(one.candidates),
             f"{median(one.seconds):.3f}"]
            for name, one in both.items()
        ]  # fmt: skip
        head = ["", "own nodes", "conditions", "candidates", "usable", "seconds"]
        stages = [
            [stage, *(f"{1e3 * median(s[stage] for s in one.stages):.1f}" for one in both.values())]
            for stage in STAGES
        ]
        return (
            f"## {self.case.name}\n\nArea {self.name}, cells of {self.cell_m:.0f} m: {self.rate:.3f} million node-conditions a "
            f"second, {self.times_faster('strong'):.2f} times as fast as the strong pipeline, "
            f"{self.times_faster('plain'):.2f} as the plain one.\n\n{table(head, sizes)}\n\n"
            f"{table(['stage, ms', *both], stages)}\n\n"
            + "\n".join(f"- {name}: {_told(self.differences(name))}" for name in self.theirs)
        )


def _usable(candidates: Any) -> str:
    """Share of the evaluated candidate-conditions that are usable."""
    condition = candidates.evaluation.condition
    return percent(share(condition[condition > 0] == USABLE))


def _told(found: Differences) -> str:
    return (
        f"{found.paired} candidates at the same places, {found.alone[0]} only there, {found.alone[1]} only now; of "
        f"{found.evaluated} candidate-conditions {percent(found.usable, 3)} decided otherwise"
    )


def summary(areas: Sequence[Area]) -> str:
    """One row a case."""
    rows = [
        [a.case.name, a.nodes, a.conditions, len(a.ours.candidates), f"{a.rate:.3f}",
         *(text for name in a.theirs for text in (f"{a.times_faster(name):.1f}", percent(a.differences(name).usable, 3)))]
        for a in areas
    ]  # fmt: skip
    head = ["case", "own nodes", "conditions", "candidates", "M node-conditions / s"]
    more = [
        "times the strong pipeline",
        "decisions not alike",
        "times the plain one",
        "decisions not alike",
    ]
    return f"## all cases\n\n{table([*head, *more], rows)}"


def areas(asked: argparse.Namespace) -> Iterator[str]:
    """Each case, and all cases in one table."""
    found = []
    for case in cases(asked):
        found.append(Area.timed(case, asked.output, asked.rounds))
        yield found[-1].text()
    yield summary(found)


# -- other parts


def commit(asked: argparse.Namespace) -> Iterator[str]:
    """Whole builds of the sample's middle, now and by another commit, in turn."""
    from benchmarks.speed.commit import compared

    yield compared(asked.against, asked.size, asked.rounds, asked.output)


def jobs(asked: argparse.Namespace) -> Iterator[str]:
    """One and two jobs in turn, and what ``--plan`` states of one."""
    output = asked.output / "jobs.h5"
    plan = SimpleNamespace(
        **json.loads(lcp(*sample(asked.size, output, "--plan", "--json")).output)
    )
    runs: dict[int, list[Any]] = {1: [], 2: []}
    for number in range(asked.rounds + 1):
        for count in (1, 2) if number % 2 else (2, 1):
            done = lcp(*sample(asked.size, output, "--jobs", str(count)))
            runs[count] += [done] if number else []  # the first compiles and reads the files
    wall = {count: [run.seconds for run in some] for count, some in runs.items()}
    used = {count: median(run.processor_s for run in some) for count, some in runs.items()}
    one = median(wall[1])
    rows = [
        ["one job, s", f"{one:.1f}"],
        ["two jobs, s", f"{median(wall[2]):.1f}"],
        ["one job over two", f"{ratio(wall[2], wall[1]):.2f}"],
        ["processor time of one job, two jobs, s", f"{used[1]:.1f}, {used[2]:.1f}"],
        ["`--plan`, s, and over one job", f"{plan.seconds_estimate:.1f}, {plan.seconds_estimate / one:.2f}"],
        ["`--plan`, bytes over the file's", f"{plan.bytes_estimate / output.stat().st_size:.2f}"],
        ["`--plan`, MB of a worker over its peak",
         f"{plan.memory_mb_per_worker / max(run.worker_mb for run in runs[2]):.2f}"],
    ]  # fmt: skip
    title = f"{plan.areas} areas of the sample, the whole command, {os.cpu_count()} cores"
    yield f"## jobs\n\n{table([title, 'median'], rows)}"


PARTS: dict[str, Callable[[argparse.Namespace], Iterator[str]]] = {
    f.__name__: f for f in (areas, commit, jobs)
}
