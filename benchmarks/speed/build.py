"""Time of the main job: areas of three terrains by stage beside two pipelines in the same process, a strong one (`strong`) and
a straightforward one (`pipeline`), regions, and whole builds beside another commit.

    python -m benchmarks.speed build areas regions commit        (make bench-build; default: areas)
    python -m benchmarks.speed build --case highland --rounds 1
    python -m benchmarks.speed build commit --against 4e256b5 --size 60

Areas run on one thread, in turn; ratios are medians over the rounds. Seconds are processor time, so that other processes of the
machine count less. The output is Markdown. All parts take an hour and a half.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import sections
from benchmarks.markdown import percent, table
from benchmarks.places import OUTPUT
from benchmarks.speed.areas import CASES, Case, own_nodes
from benchmarks.speed.commit import compared, counted
from benchmarks.speed.differences import Differences, Places, differences, share
from benchmarks.speed.stages import LIBRARY, PIPELINE, STAGES, measured
from benchmarks.timing import Task, in_turn, median, ratio
from lcp_catalog.catalog.schema import USABLE
from lcp_catalog.production.area_job import AreaJob, Candidates, area_sweep, run_area
from lcp_catalog.production.run import BuildRun
from lcp_catalog.threads import limit_threads

BEFORE = "4e256b5"
"""The commit before the issues of November 2026: the last of the names of 0.2."""


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed build", __doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--case", action="append", choices=CASES, help="default: all")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--against", default=BEFORE, metavar="REV", help="commit: which")
    parser.add_argument("--size", type=float, default=150.0, metavar="KM", help="commit")
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
        theirs = {
            name: Timed(partial(_places, pipeline, job, ours.candidates), PIPELINE)
            for name, pipeline in (("strong", Strong), ("plain", Pipeline))
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


def _each(tasks: Sequence[Task]) -> None:
    for task in tasks:
        task()


def _places(pipeline: Any, job: AreaJob, found: Candidates) -> Places:
    return Places(found.lon_deg, found.lat_deg, pipeline(job, found).run())


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


# -- regions

WAYS: dict[str, dict[str, Any]] = {
    "spread, one pass": {"passes": 1},
    "spread, two": {"passes": 2},
    "promise, one pass": {"passes": 1, "spacing_m": None},
    "promise, two": {"passes": 2, "spacing_m": None},
}
"""Settings of ``points``: evenly spread, and with the default promise. Two passes follow the same in one."""


def regions(asked: argparse.Namespace) -> Iterator[str]:
    """Regions around the cases' areas by whole builds, but their plans, beside the strong pipeline on the same areas, which
    makes no choice.
    """
    from benchmarks.speed.strong import Strong  # Embree is not everywhere

    for case in cases(asked):
        builds = {name: case.region(asked.output, **points) for name, points in WAYS.items()}
        runs = {
            name: BuildRun(build, asked.output / f"{name}.h5", overwrite=True, advises=False)
            for name, build in builds.items()
        }
        jobs = builds["spread, one pass"].jobs
        strong = [partial(_places, Strong, job, run_area(job).candidates) for job in jobs]
        strong[0]()  # compiles
        tasks: dict[str, Task] = {name: run.whole for name, run in runs.items()}
        tasks["strong"] = partial(_each, strong)
        times = in_turn(tasks, asked.rounds, warm=["promise, two"])
        rows, one = [["strong", f"{median(times['strong']):.1f}", "", "", "", ""]], 0
        for name, run in runs.items():
            points, _, usable = counted(run.output)
            one = one if "two" in name else usable
            own = [f"{median(times[name]):.1f}", f"{ratio(times[name], times['strong']):.1f}"]
            kept = f"{usable / one:.3f}" if one else ""
            rows.append([name, *own, f"{points}", f"{usable}", kept])
        head = [f"{case.name}, {len(jobs)} areas", "s", "times", "points", "usable", "kept"]
        yield table(head, rows)


# -- other parts


def commit(asked: argparse.Namespace) -> Iterator[str]:
    """Whole builds of the sample's middle, now and by another commit, in turn."""
    yield compared(asked.against, asked.size, asked.rounds, asked.output)


PARTS: dict[str, Callable[[argparse.Namespace], Iterator[str]]] = {
    f.__name__: f for f in (areas, regions, commit)
}
