"""Kills of builds at random moments: in the end the catalogue has the bytes of an undisturbed build.

    .venv/bin/python benchmarks/soak.py --kills 200            (make soak: an hour)
    .venv/bin/python benchmarks/soak.py --kills 5 --ways jobs --seed 7

A build of nine small areas runs in one of three ways: `jobs` (two processes), `parts` (two parts at the same time, then the merge),
`cluster` (a dask scheduler and two workers, if dask.distributed is installed). At a random moment of the time that the build takes
undisturbed, one of its processes gets a signal: the one that runs `lcp`, one of its workers, or the cluster's scheduler. The same
command is then run again, and killed again, until it ends by itself. A kill is survived if no process of the build is left five
seconds later, no incomplete catalogue is there, and the finished catalogue has the same bytes. Linux only.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DEM = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"

CONFIG = """
[area]
center_deg = [3.5, 26.0]
size_km = 60.0
gsd_m = 474.0
[sun]
azimuths_deg = [90.0, 270.0]
elevations_deg = [10.0, 30.0]
[view]
off_nadir_deg = [0.0]
azimuth_deg = [0.0]
altitude_km = [inf]
[points]
patch_nodes = 17
search_m = 5000.0
[model]
direction_tolerance_deg = 0.7
ring_max_km = 20.0
"""

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
LIMIT_S = 300.0
"""Time in which a build must end, however it was disturbed."""


@dataclass
class Result:
    """Kills tried and survived by victim and signal, and what went wrong."""

    tried: Counter[str] = field(default_factory=Counter)
    survived: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def text(self) -> str:
        rows = [
            f"| {name} | {self.survived[name]} | {n} |" for name, n in sorted(self.tried.items())
        ]
        total = f"| all | {sum(self.survived.values())} | {sum(self.tried.values())} |"
        return "\n".join(
            ["| kill | survived | tried |", "| --- | --- | --- |", *rows, total, *self.faults]
        )


class Site:
    """A folder with the inputs of a build, and its commands in one of the ways."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder, self.output = folder, folder / "x.h5"
        shutil.copy(DEM, folder / "dem.tif")
        (folder / "x.toml").write_text(CONFIG)

    def lcp(self, *options: str) -> subprocess.Popen[bytes]:
        code = "from lcp_cli.main import main\nif __name__ == '__main__': main()"
        command = ["build-catalog", "dem.tif", "-o", "x.h5", "--config", "x.toml", "--overwrite"]
        return self._start("-c", code, *command, *options)

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        with open(self.folder.with_suffix(".log"), "ab") as log:
            return subprocess.Popen(
                [sys.executable, *arguments],
                cwd=self.folder,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    @contextmanager
    def running(self, way: str) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
        """Processes of a build by name; those named ``lcp...`` must end by themselves with code 0."""
        made: dict[str, subprocess.Popen[bytes]] = {}
        try:
            if way == "cluster":
                file = self.folder.with_suffix(".json")
                file.unlink(missing_ok=True)
                place = ["--scheduler-file", str(file), "--no-dashboard"]
                run = ["-m", "distributed.cli"]
                made["scheduler"] = self._start(
                    f"{run[0]}", f"{run[1]}.dask_scheduler", "--port", "0", *place
                )
                while not file.exists() and made["scheduler"].poll() is None:
                    time.sleep(0.02)
                two = ["--nworkers", "2", "--nthreads", "1"]
                made["workers"] = self._start(run[0], f"{run[1]}.dask_worker", *two, *place)
                made["lcp"] = self.lcp("--resume", "--scheduler", str(file))
            elif way == "parts":
                made |= {
                    f"lcp part {k}": self.lcp("--part", f"{k}/2", "--jobs", "1") for k in (1, 2)
                }
            else:
                made["lcp"] = self.lcp("--resume", "--jobs", "2")
            yield made
        finally:
            for process in made.values():
                if not is_gone(process.pid):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def leftovers(self) -> list[str]:
        """Files that a finished build should not leave."""
        known = {"dem.tif", "x.toml", "x.h5"}
        return sorted(path.name for path in self.folder.iterdir() if path.name not in known)


def is_gone(group: int) -> bool:
    """True if no process of a group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


def children(pid: int) -> list[int]:
    """The processes that a process has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def wait_for(condition: object, seconds: float) -> bool:
    """True as soon as the function gives True, False after the time."""
    end = time.monotonic() + seconds
    while not condition():  # type: ignore[operator]  # a function
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def undisturbed(site: Site, way: str) -> tuple[float, bytes]:
    """Time and bytes of a build."""
    start = time.monotonic()
    with site.running(way) as processes:
        builds = [p for name, p in processes.items() if name.startswith("lcp")]
        codes = [p.wait(timeout=LIMIT_S) for p in builds]
    seconds = time.monotonic() - start
    if way == "parts":
        codes.append(site.lcp("--merge").wait(timeout=LIMIT_S))
    if any(codes) or site.leftovers():
        log = site.folder.with_suffix(".log").read_text()
        raise SystemExit(f"{way}: the undisturbed build gave {codes}, {site.leftovers()}\n{log}")
    return seconds, site.output.read_bytes()


def disturbed(site: Site, way: str, seconds: float, dice: random.Random) -> str | None:
    """Start a build and kill one of its processes; the victim's name, or None if it was over before."""
    with site.running(way) as processes:
        moment = time.monotonic() + dice.uniform(0.0, seconds)
        builds = [p for name, p in processes.items() if name.startswith("lcp")]
        wait_for(lambda: all(p.poll() is not None for p in builds), moment - time.monotonic())
        if all(p.poll() is not None for p in builds):
            return None
        name, process = dice.choice(sorted(processes.items()))
        sent, target = dice.choice(SIGNALS), process.pid
        victim = name.partition(" ")[0]
        below = children(process.pid)
        if below and (name == "workers" or dice.random() < 0.5):
            sent, target, victim = signal.SIGKILL, dice.choice(sorted(below)), "worker"
        try:
            os.kill(target, sent)
        except ProcessLookupError:
            return None
        victim = f"{way}: {victim}, {sent.name}"
        if not wait_for(lambda: all(p.poll() is not None for p in builds), LIMIT_S):
            return f"{victim}; the build did not end"
        if not wait_for(lambda: all(is_gone(p.pid) for p in builds), 5.0):
            return f"{victim}; processes are left"
    return victim


def chain(
    site: Site,
    way: str,
    whole: bytes,
    seconds: float,
    dice: random.Random,
    most: int,
    result: Result,
) -> None:
    """Disturb one build again and again until it is finished or has had ``most`` kills; compare."""
    victims: list[str] = []
    while len(victims) < most:
        victim = disturbed(site, way, seconds, dice)
        if victim is None:
            break
        victims.append(victim)
        if site.output.exists() and site.output.read_bytes() != whole:
            victims[-1] += "; the catalogue differs or is not whole"
    undisturbed_bytes = undisturbed(site, way)[1]
    equal = undisturbed_bytes == whole
    for victim in victims:
        name, _, fault = victim.partition("; ")
        result.tried[name] += 1
        result.survived[name] += equal and not fault
        if fault or not equal:
            result.faults.append(f"{name}: {fault or 'the bytes of the resumed build differ'}")


def soak(kills: int, ways: Sequence[str], seed: int) -> Result:
    """Kill builds in the given ways in turn."""
    dice, result = random.Random(seed), Result()
    with tempfile.TemporaryDirectory() as folder:
        sites = {way: Site(Path(folder) / way) for way in ways}
        times: dict[str, float] = {}
        whole = b""
        for way, site in sites.items():
            times[way], found = undisturbed(site, way)
            whole = whole or found
            if found != whole:
                raise SystemExit(f"{way}: other bytes than {ways[0]} without any kill")
        while (left := kills - sum(result.tried.values())) > 0:
            for way, site in sites.items():
                site.output.unlink(missing_ok=True)
                chain(site, way, whole, times[way], dice, min(left, 10), result)
            print(
                f"{sum(result.survived.values())} of {sum(result.tried.values())}", file=sys.stderr
            )
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    has_dask = importlib.util.find_spec("distributed") is not None
    ways = ["jobs", "parts", *(["cluster"] if has_dask else [])]
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--ways", nargs="+", choices=ways, default=ways)
    parser.add_argument("--seed", type=int, default=16)
    given = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    result = soak(given.kills, given.ways, given.seed)
    print(result.text())
    return 0 if result.tried == result.survived and not result.faults else 1


if __name__ == "__main__":
    sys.exit(main())
