"""Time of the main job: areas of three terrains through `run_area`, by stage, beside another commit's package and a straightforward
pipeline in the same process.

    .venv/bin/python benchmarks/build.py [--case highland] [--rounds 1] [--against REV] [--no-pipeline]     (make bench-build)

Everything runs on one thread, in turn; the ratios are medians over the rounds. The output is Markdown. Seconds are processor time
(`time.process_time`), so that other processes of the machine count less.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]
for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from build_areas import CASES, Case, Package, conditions_of, own_nodes
from build_differences import Places, differences
from build_stages import measured
from build_tables import Subject, differences_text, in_turn, ratio_text, sizes, stage_table

from lcp_catalog.threads import limit_threads

BEFORE = "faf736b"
"""The commit before the evaluation became kernels."""
ROUNDS = 5


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", action="append", choices=CASES, help="default: all")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--against", default=BEFORE, metavar="REV", help="none: no other commit")
    parser.add_argument("--no-pipeline", action="store_true", help="without the pipeline")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "bench-build")
    asked = parser.parse_args(argv)
    with limit_threads(1):
        for name in asked.case or CASES:
            print(case_text(CASES[name], asked), flush=True)


def case_text(case: Case, asked: argparse.Namespace) -> str:
    """The tables of a case."""
    packages = [Package("lcp_catalog")]
    if asked.against != "none":
        packages.append(Package.of_commit(asked.against, asked.output / "packages"))
    jobs = [package.job(case, asked.output) for package in packages]
    areas = [subject(package, job, asked) for package, job in zip(packages, jobs, strict=True)]
    subjects = (
        areas if asked.no_pipeline else [*areas, straightforward(packages[0], jobs[0], areas[0])]
    )
    in_turn(subjects, asked.rounds)
    for package, job, one in zip(packages, jobs, areas, strict=True):
        for _ in range(asked.rounds):
            with measured(package) as clock:
                package.run(job)
            one.stages.append(clock.stop())
    text = f"## {case.name}\n\n{sizes(subjects, jobs[0])}\n\n{stage_table(subjects)}\n"
    text += f"\n{ratio_text(subjects)}\n"
    now, *others = subjects
    for other in others:
        found = differences(other.candidates, now.candidates, jobs[0].gsd_m)
        text += f"\n{differences_text(found, other.name)}\n"
    return text


def subject(package: Package, job: Any, asked: argparse.Namespace) -> Subject:
    """`run_area` of a package."""
    name = "now" if package.name == "lcp_catalog" else asked.against
    nodes, count = own_nodes(package, job), conditions_of(package, job)
    return Subject(name, lambda: package.run(job), nodes, count)


def straightforward(package: Package, job: Any, area: Subject) -> Subject:
    """The pipeline, with the candidates of the area's result."""
    from build_pipeline import Pipeline

    area.result = area.run()
    found = area.result.candidates

    def run() -> Places:
        return Places(found.lon_deg, found.lat_deg, Pipeline(package, job, found).run())

    return Subject("pipeline", run, area.nodes, area.conditions)


if __name__ == "__main__":
    main()
