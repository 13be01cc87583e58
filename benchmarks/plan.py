"""What ``lcp build-catalog --plan`` states beside what a build takes: time, bytes, memory; the overhead of the
engine beside the areas; the speed of several workers; and the memory under ``--memory``.

    python benchmarks/plan.py [plan] [overhead] [workers] [memory] [small]

``small``: areas of half the size and a fifth of the Suns. The times of ``plan`` and ``workers`` are wall times:
the machine must have nothing else to do. With all Suns ``plan`` takes about 10 min on two cores, the
others 5 min each.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]

from build_tables import table

LCP = Path(sys.executable).with_name("lcp")
SAMPLE = ROOT / "sample_data"
DEM = SAMPLE / "hadley_gld100_256ppd.tif"
SMALL = "small" in sys.argv
SIZES_KM = {"sample": 75.0 if SMALL else 140.0, "four times as large": 150.0 if SMALL else 280.0}
"""Sides of two regions in the middle of the DEM."""

SUNS = ["--sun-azimuths", "0:330:30", "--sun-elevations", "10,30"] if SMALL else []
VIEWS = ["--view", "0", "--view", "30:90", "--view", "30:270"]
MEMORIES_GB = (0.45, 0.6, 1.0)


@dataclass(frozen=True)
class Run:
    """A command that has ended: wall seconds, standard output and error, and greatest memory of its process and of its
    child processes, MB."""

    seconds: float
    output: str
    said: str
    parent_mb: float
    worker_mb: float


def run(*words: str) -> Run:
    """Run ``lcp`` and watch the memory of its processes, five times a second."""
    start, peaks = time.perf_counter(), {}
    process = subprocess.Popen([str(LCP), *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(0.2):
            for number in _family(process.pid):
                peaks[number] = max(peaks.get(number, 0.0), _peak_mb(number))

    watcher = threading.Thread(target=watch)
    watcher.start()
    output, said = process.communicate()
    seconds = time.perf_counter() - start
    ended.set()
    watcher.join()
    if process.returncode:
        raise SystemExit(said.decode(errors="replace"))
    workers = [peak for number, peak in peaks.items() if number != process.pid]
    text = said.decode(errors="replace")
    return Run(
        seconds, output.decode(), text, peaks.get(process.pid, 0.0), max(workers, default=0.0)
    )


def _family(number: int) -> list[int]:
    """A process and all below it: workers are forked by a child. Nothing of those that have ended."""
    try:
        words = Path(f"/proc/{number}/task/{number}/children").read_text().split()
    except OSError:
        words = []
    return [number, *(each for word in words for each in _family(int(word)))]


def _peak_mb(number: int) -> float:
    try:
        lines = Path(f"/proc/{number}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(x.split()[1]) * 1.024e-3 for x in lines if x.startswith("VmHWM:")), 0.0)


def command(size_km: float, *more: str) -> list[str]:
    """The build of a region around the middle of the DEM."""
    place = ["--center", "5", "25", "--size", f"{size_km:g}"]
    points = ["--spacing", "7.5", "--gsd", "474"]
    return ["build-catalog", str(DEM), *place, *points, *VIEWS, *SUNS, *more]


def plans(folder: Path) -> str:
    """Stated over measured, of both regions with one and two jobs."""
    rows = []
    for name, size_km in SIZES_KM.items():
        for jobs in ("1", "2"):
            planned = json.loads(run(*command(size_km, "--plan", "--json", "--jobs", jobs)).output)
            output = folder / "plan.h5"
            done = run(*command(size_km, "-o", str(output), "--jobs", jobs, "--overwrite"))
            worker_mb = done.parent_mb if jobs == "1" else done.worker_mb
            pairs = [
                (planned["seconds_estimate"], done.seconds),
                (planned["bytes_estimate"] / 1e6, output.stat().st_size / 1e6),
                (planned["memory_mb_per_worker"], worker_mb),
                (planned["memory_mb_parent"], done.parent_mb),
            ]
            texts = [
                f"{stated:.1f} / {found:.1f} = {stated / found:.2f}" for stated, found in pairs
            ]
            rows.append([name, str(planned["areas"]), jobs, *texts])
            print(*rows[-1], sep=", ", file=sys.stderr, flush=True)
    heads = ["stated / measured", "areas", "jobs", "s", "MB of file", "worker, MB", "parent, MB"]
    return table(heads, rows)


_OVERHEAD = """
import json, sys, time
from pathlib import Path
from lcp_catalog.production import assembly, run
spent = {"areas": 0.0, "merge": 0.0}
def timed(name, function):
    def call(*given, **named):
        start = time.process_time()
        try:
            return function(*given, **named)
        finally:
            spent[name] += time.process_time() - start
    return call
run.run_area = timed("areas", run.run_area)
run.finish = timed("merge", run.finish)
dem, output, config = sys.argv[1], Path(sys.argv[2]), run.BuildConfig.from_toml(Path(sys.argv[3]))
build = run.Build.plan([dem], config)
run.run_area(build.jobs[0])  # loads the kernels
spent["areas"] = 0.0
start = time.process_time()
run.run_build(build, output)
print(json.dumps(spent | {"all": time.process_time() - start, "count": len(build.jobs)}))
"""


def overhead(folder: Path) -> str:
    """Processor time of a build in one process beside that inside the areas, without the start and the plan."""
    config = folder / "build.toml"
    size_km = SIZES_KM["sample"]
    azimuths = list(range(0, 360, 30 if SMALL else 15))
    config.write_text(
        f"[area]\ncenter_deg = [5.0, 25.0]\nsize_km = {size_km}\ngsd_m = 474.0\n"
        f"[sun]\nazimuths_deg = {[float(a) for a in azimuths]}\n"
        "[view]\noff_nadir_deg = [0.0, 30.0, 30.0]\nazimuth_deg = [0.0, 90.0, 270.0]\n"
        "altitude_km = [inf, inf, inf]\n[points]\nspacing_m = 7500.0\n"
    )
    words = [sys.executable, "-c", _OVERHEAD, str(DEM), str(folder / "one.h5"), str(config)]
    found: dict[str, Any] = json.loads(
        subprocess.run(words, check=True, capture_output=True).stdout
    )
    engine = found["all"] - found["areas"] - found["merge"]
    row = [str(found["count"]), *(f"{found[name]:.2f}" for name in ("areas", "merge"))]
    row += [f"{engine:.2f}", f"{100.0 * engine / found['areas']:.1f} %"]
    return table(["areas", "inside, s", "merge, s", "engine, s", "of the areas"], [row])


def workers(folder: Path) -> str:
    """Wall time of a region's build by 1, 2, 4 and 8 workers, up to twice the number of cores."""
    rows, one = [], 0.0
    for jobs in (1, 2, 4, 8):
        if jobs > 2 * (os.cpu_count() or 1):
            break
        words = command(SIZES_KM["sample"], "-o", str(folder / "jobs.h5"), "--overwrite")
        seconds = run(*words, "--jobs", str(jobs)).seconds
        one = one or seconds
        rows.append([str(jobs), f"{seconds:.1f}", f"{one / seconds:.2f}"])
    return table([f"workers on {os.cpu_count()} cores", "s", "speed"], rows)


def memory(folder: Path) -> str:
    """Greatest memory of two workers in cells of 59 m, by what was promised."""
    rows = []
    few = [
        "--sun-azimuths",
        "0,180" if SMALL else "0:315:45",
        "--sun-elevations",
        "30",
        "--view",
        "0",
    ]
    config = folder / "large.toml"
    config.write_text("[model]\narea_nodes_max = 1024\ndirection_tolerance_deg = 2.0\n")
    for promise in (*MEMORIES_GB, None):
        place = ["--center", "5", "25", "--size", "60" if SMALL else "120", "--gsd", "59"]
        words = [str(DEM), "--config", str(config), *place, *few, "--jobs", "2", "--overwrite"]
        words += ["--memory", f"{promise:g}"] if promise else []
        output = folder / "memory.h5"
        done = run("build-catalog", *words, "-o", str(output))
        rows.append(
            [
                f"{promise:g} GB" if promise else "none",
                done.said.split(" points from ")[1].split()[0],
                f"{done.worker_mb:.0f}",
                f"{done.parent_mb:.0f}",
                f"{done.seconds:.0f}",
            ]
        )
    return table(["`--memory`", "areas", "worker, MB", "parent, MB", "s"], rows)


def main() -> None:
    known = {"plan": plans, "overhead": overhead, "workers": workers, "memory": memory}
    wanted = [word for word in sys.argv[1:] if word in known] or list(known)
    with tempfile.TemporaryDirectory() as folder:
        for word in wanted:
            print(f"## {word}\n\n{known[word](Path(folder))}\n", flush=True)


if __name__ == "__main__":
    main()
