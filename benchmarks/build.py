"""Time of the main job: areas of three terrains through `run_area`, by stage, beside another commit's package and a straightforward
pipeline in the same process.

    .venv/bin/python benchmarks/build.py areas roofline memory jobs        (make bench-build; default: areas)
    .venv/bin/python benchmarks/build.py --case highland --rounds 1 --no-pipeline  (a quick check against the older commit)

Areas run on one thread, in turn; the ratios are medians over the rounds. Their seconds are processor time (`time.process_time`), so
that other processes of the machine count less; those of `jobs` are wall time. The output is Markdown. All
sections take half an hour; the tables of the page are those of `all cases`.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]
for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from build_areas import CASES, Case, Package, conditions_of, own_nodes
from build_differences import Places, differences
from build_processes import jobs_text, memory_text
from build_roofline import Machine, roofline_table, work_of
from build_stages import Scripts, measured
from build_tables import FULL, Measured, Subject, in_turn, summary
from subnormals import flush_subnormals

from lcp_catalog.production.evaluation import image_scales
from lcp_catalog.threads import limit_threads

BEFORE = "faf736b"
"""The commit before the evaluation became kernels."""
ROUNDS = 5
COARSE_REACH = 24
"""Nodes of search radius from which the older package searched at half resolution first."""


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=", ".join(SECTIONS))
    parser.add_argument("--case", action="append", choices=CASES, help="default: all")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--against", default=BEFORE, metavar="REV", help="none: no other commit")
    parser.add_argument("--no-pipeline", action="store_true", help="without the pipeline")
    parser.add_argument(
        "--flush", action="store_true", help="numbers below 1e-38 count as 0 (`subnormals`)"
    )
    parser.add_argument(
        "--size", type=float, default=150.0, metavar="KM", help="jobs: of the build"
    )
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "bench-build")
    asked = parser.parse_args(argv)
    for name in asked.sections:
        if name not in SECTIONS:
            parser.error(f"no section {name!r}; there are {', '.join(SECTIONS)}")
    if asked.flush:
        flush_subnormals()
    with limit_threads(1):
        for name in asked.sections or ["areas"]:
            for text in SECTIONS[name](asked):
                print(text, flush=True)


def cases(asked: argparse.Namespace) -> list[Case]:
    return [CASES[name] for name in asked.case or CASES]


def packages(asked: argparse.Namespace) -> dict[str, Package]:
    """The working tree's package, and that of the other commit."""
    found = {"now": Package("lcp_catalog")}
    if asked.against != "none":
        found[asked.against] = Package.of_commit(asked.against, asked.output / "packages")
    return found


# -- areas


def areas(asked: argparse.Namespace) -> Iterator[str]:
    """Sizes, stages, ratios and differences of each case, and all cases in one."""
    found = []
    for case in cases(asked):
        found.append(measured_case(case, asked))
        yield found[-1].text()
    if len(found) > 1:
        yield summary(found)


def measured_case(case: Case, asked: argparse.Namespace) -> Measured:
    """A case's subjects timed in turn, and the differences between their results."""
    subjects = [subject(name, package, case, asked) for name, package in packages(asked).items()]
    now, *others = subjects
    if not asked.no_pipeline:
        subjects.append(straightforward(now))
    in_turn(subjects, asked.rounds)
    found = {one.name: one.candidates for one in subjects[1:]}
    for other in others:
        exact = exhaustive(other)
        if exact is not None:
            found[f"{other.name}, {FULL}"] = exact
    cell_m = now.job.gsd_m
    compared = {name: differences(each, now.candidates, cell_m) for name, each in found.items()}
    return Measured(case.name, subjects, compared)


def subject(name: str, package: Package, case: Case, asked: argparse.Namespace) -> Subject:
    """`run_area` of a package on a case."""
    job = package.job(case, asked.output)
    nodes, count = own_nodes(package, job), conditions_of(package, job)
    return Subject(name, partial(package.run, job), nodes, count, package, job, package)


def straightforward(area: Subject) -> Subject:
    """The pipeline on an area, with the candidates of the area's result."""
    from build_pipeline import Pipeline

    area.result = area.run()
    found = area.candidates

    def run() -> Places:
        made = Pipeline(area.package, area.job, found)
        return Places(found.lon_deg, found.lat_deg, made.run())

    return Subject("pipeline", run, area.nodes, area.conditions, area.package, area.job, Scripts())


def exhaustive(area: Subject) -> Any:
    """The candidates of an older package's area with every search for rivals at full resolution; None
    where its searches are so anyway, or where the package has no such switch."""
    evaluation = area.package.module("production.evaluation")
    search = getattr(evaluation, "other_places", None)
    if search is None or area.job.config.points.search_nodes(area.job.gsd_m) < COARSE_REACH:
        return None
    evaluation.other_places = partial(search, exact=True)
    try:
        return area.run().candidates
    finally:
        evaluation.other_places = search


# -- other sections


def roofline(asked: argparse.Namespace) -> Iterator[str]:
    """The machine's peak, and each case's stages beside it."""
    machine = Machine.measured()
    yield f"## roofline\n\n{machine.text()}"
    for case in cases(asked):
        one = subject("now", Package("lcp_catalog"), case, asked)
        one.result = one.run()
        stages = []
        for _ in range(asked.rounds):
            one.package.forget()
            with measured(one.package) as clock:
                one.run()
            stages.append(clock.stop())
        works = work_of(one.job, one.result, image_scales(one.job.config.points.patch_nodes))
        yield f"**{case.name}**\n\n{roofline_table(works, stages, machine)}\n"


def memory(asked: argparse.Namespace) -> Iterator[str]:
    yield memory_text(packages(asked), cases(asked), asked.output)


def jobs(asked: argparse.Namespace) -> Iterator[str]:
    yield jobs_text(asked.output, asked.size, asked.rounds)


SECTIONS: dict[str, Callable[[argparse.Namespace], Iterator[str]]] = {
    "areas": areas,
    "roofline": roofline,
    "memory": memory,
    "jobs": jobs,
}


if __name__ == "__main__":
    main()
