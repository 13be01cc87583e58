"""Whole processes of the main job: peak memory of a worker, two jobs beside one, and the estimate of
``--plan`` beside the build's time. Times are wall time: the machine must have nothing else to do.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import pickle
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from build_areas import CONFIG, ROOT, SAMPLE, Case, Package
from build_tables import table

LCP = Path(sys.executable).with_name("lcp")

_SET_CHILD_SUBREAPER = 36
"""PR_SET_CHILD_SUBREAPER of <sys/prctl.h>."""

_WORKER = """
import pickle, sys
from importlib import import_module
sys.path[:0] = {paths!r}
run_area = import_module("{package}.build.area_job").run_area
import_module("{package}.threads").limit_threads(1)
peak_mb = import_module("{package}.memory").peak_mb
job = pickle.load(sys.stdin.buffer)
before = peak_mb()
for _ in range(2):
    run_area(job)
print(before, peak_mb())
"""


def peaks_mb(package: Package, job: Any, folder: Path) -> tuple[float, float]:
    """Greatest resident memory of a new process that has only imported the job's module, and of one
    that has run it twice."""
    paths = [str(ROOT), str(folder)]
    done = subprocess.run(
        [sys.executable, "-c", _WORKER.format(package=package.name, paths=paths)],
        input=pickle.dumps(job),
        capture_output=True,
        check=True,
    )
    before, peak = done.stdout.split()
    return float(before), float(peak)


def memory_text(packages: dict[str, Package], cases: list[Case], output: Path) -> str:
    """Peak memory of a worker, by case and package."""
    rows = []
    for case in cases:
        for name, package in packages.items():
            found = peaks_mb(package, package.job(case, output), output / "packages")
            rows.append([case.name, name, *(f"{value:.0f}" for value in found)])
    return f"## memory\n\n{table(['worker, MB', '', 'imports', 'peak'], rows)}\n"


def build_seconds(output: Path, size_km: float, jobs: int) -> tuple[float, float]:
    """Wall time and processor time, workers included, of a build of the sample's middle by the command."""
    _adopt_orphans()
    start, before = time.perf_counter(), os.times()
    subprocess.run(_command(size_km, jobs, output), capture_output=True, check=True)
    seconds = time.perf_counter() - start
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    after = os.times()
    used = (
        after.children_user - before.children_user + after.children_system - before.children_system
    )
    return seconds, used


def _adopt_orphans() -> None:
    """Let processes whose parent has ended become this one's: the workers' is ended after the command,
    and its processor time and theirs count here when this process waits for it.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def planned_seconds(output: Path, size_km: float) -> tuple[float, int]:
    """Time that ``--plan`` estimates for one job, and the number of areas."""
    command = [*_command(size_km, 1, output), "--plan", "--json"]
    printed = subprocess.run(command, capture_output=True, check=True).stdout
    document = json.loads(printed)
    return float(document["seconds_estimate"]), int(document["areas"])


def _command(size_km: float, jobs: int, output: Path) -> list[str]:
    place = ["--center", "3.5", "26", "--size", f"{size_km:g}"]
    build = [str(LCP), "build-catalog", str(SAMPLE), "--config", str(CONFIG), *place]
    return [*build, "-o", str(output / "jobs.h5"), "--jobs", str(jobs), "--overwrite"]


def jobs_text(output: Path, size_km: float, rounds: int) -> str:
    """One and two jobs in turn, and the estimate."""
    output.mkdir(parents=True, exist_ok=True)
    build_seconds(output, size_km, 1)  # compiles and reads the files
    planned, areas = planned_seconds(output, size_km)
    took: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
    for number in range(rounds):
        for jobs in (1, 2) if number % 2 else (2, 1):
            took[jobs].append(build_seconds(output, size_km, jobs))
    (one, used), (two, both) = (
        tuple(statistics.median(values) for values in zip(*took[jobs], strict=True))
        for jobs in (1, 2)
    )
    pairs = zip(took[1], took[2], strict=True)
    gain = statistics.median(a / b for (a, _), (b, _) in pairs)
    rows = [
        ["one job, s", f"{one:.1f}"],
        ["two jobs, s", f"{two:.1f}"],
        ["one job over two", f"{gain:.2f}"],
        ["processor time of one job, s", f"{used:.1f}"],
        ["processor time of two jobs, s", f"{both:.1f}"],
        ["one job over two by processor time, at most", f"{2.0 * used / both:.2f}"],
        ["`--plan` for one job, s", f"{planned:.1f}"],
        ["`--plan` over one job", f"{planned / one:.2f}"],
    ]
    title = f"{areas} areas of the sample, the whole command, {os.cpu_count()} cores"
    return f"## jobs\n\n{table([title, 'median'], rows)}\n"
