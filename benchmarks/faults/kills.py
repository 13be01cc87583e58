"""Kills of builds at random moments: in the end the catalogue has the bytes of an undisturbed build.

    python -m benchmarks.faults kills --kills 200
    python -m benchmarks.faults kills --kills 5 --ways jobs --seed 7

A build of nine small areas runs in one of three ways: `jobs` (two processes), `parts` (two parts at the same time, then the merge),
`cluster` (a dask scheduler and two workers, if dask.distributed is installed). At a random moment of the time that the build takes
undisturbed, one of its processes gets a signal: the one that runs `lcp`, one of its workers, or the cluster's scheduler. The same
command is then run again, and killed again, until it ends by itself. A kill is survived if no process of the build is left five
seconds later, no incomplete catalogue is there, and the finished catalogue has the same bytes. Linux only.
"""

from __future__ import annotations

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

from benchmarks import sections
from benchmarks.commands import children
from benchmarks.faults.processes import CONFIG, is_gone, wait_for
from benchmarks.markdown import table
from benchmarks.places import DEM

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
LIMIT_S = 300.0
"""Time in which a build must end, however it was disturbed."""


@dataclass
class Kill:
    """A kill: way of the build, victim and signal; and what went wrong then, if anything did."""

    name: str
    fault: str = ""


@dataclass
class Result:
    """All kills of a run."""

    kills: list[Kill] = field(default_factory=list)

    @property
    def survived(self) -> int:
        return sum(not kill.fault for kill in self.kills)

    def text(self) -> str:
        tried = Counter(kill.name for kill in self.kills)
        good = Counter(kill.name for kill in self.kills if not kill.fault)
        rows = [[name, good[name], tried[name]] for name in sorted(tried)]
        rows.append(["all", self.survived, len(self.kills)])
        faults = [f"{kill.name}: {kill.fault}" for kill in self.kills if kill.fault]
        return "\n".join([table(["kill", "survived", "tried"], rows), *faults])


class Site:
    """A folder with the inputs of a build, and its commands in one of the ways."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder, self.output = folder, folder / "x.h5"
        self.log = folder.with_suffix(".log")
        shutil.copy(DEM, folder / "dem.tif")
        shutil.copy(CONFIG, folder / "x.toml")

    def lcp(self, *options: str) -> subprocess.Popen[bytes]:
        code = "from lcp_cli.main import main\nif __name__ == '__main__': main()"
        command = ["build-catalog", "dem.tif", "-o", "x.h5", "--config", "x.toml", "--overwrite"]
        return self._start("-c", code, *command, *options)

    def _start(self, *arguments: str) -> subprocess.Popen[bytes]:
        with open(self.log, "ab") as log:
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
                scheduler = "distributed.cli.dask_scheduler"
                made["scheduler"] = self._start("-m", scheduler, "--port", "0", *place)
                while not file.exists() and made["scheduler"].poll() is None:
                    time.sleep(0.02)
                made["workers"] = self._workers()
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

    def _workers(self) -> subprocess.Popen[bytes]:
        """The command that starts the workers of a cluster."""
        place = ["--scheduler-file", str(self.folder.with_suffix(".json")), "--no-dashboard"]
        two = ["--nworkers", "2", "--nthreads", "1"]
        return self._start("-m", "distributed.cli.dask_worker", *two, *place)

    def keep_workers(self, processes: dict[str, subprocess.Popen[bytes]]) -> None:
        """Start a cluster's workers again if their command has ended, as what runs a cluster does: dask
        ends it if a worker is killed while it starts.
        """
        workers, scheduler = processes.get("workers"), processes.get("scheduler")
        if workers and workers.poll() is not None and scheduler and scheduler.poll() is None:
            processes["workers"] = self._workers()

    def catalogue(self, way: str) -> bytes:
        """The finished catalogue; of parts, after their merge."""
        if way == "parts" and not self.output.exists():
            self.lcp("--merge").wait(timeout=LIMIT_S)
        return self.output.read_bytes() if self.output.exists() else b""

    def difference(self, way: str, whole: bytes) -> str:
        """What is wrong with the finished build, if anything is."""
        if self.catalogue(way) != whole:
            return "the catalogue has other bytes"
        known = {"dem.tif", "x.toml", "x.h5"}
        left = sorted(path.name for path in self.folder.iterdir() if path.name not in known)
        return f"{left} are left" if left else ""


def undisturbed(site: Site, way: str) -> None:
    """Run a build to its end; what is finished already is kept."""
    with site.running(way) as processes:
        codes = [build.wait(timeout=LIMIT_S) for build in builds_of(processes)]
    if any(codes):
        raise SystemExit(f"{way}: the undisturbed build gave {codes}\n{site.log.read_text()}")


def builds_of(processes: dict[str, subprocess.Popen[bytes]]) -> list[subprocess.Popen[bytes]]:
    """The processes that run `lcp`."""
    return [process for name, process in processes.items() if name.startswith("lcp")]


def disturbed(
    site: Site, way: str, seconds: float, dice: random.Random
) -> tuple[Kill | None, bool]:
    """Run a build and kill one of its processes, unless it is over before; the kill, and True if the
    build was finished nevertheless.
    """
    with site.running(way) as processes:
        moment = time.monotonic() + dice.uniform(0.0, seconds)
        builds = builds_of(processes)

        def ended() -> bool:
            site.keep_workers(processes)
            return all(build.poll() is not None for build in builds)

        wait_for(ended, moment - time.monotonic())
        kill = None if ended() else _kill(way, processes, dice)
        if not wait_for(ended, LIMIT_S):
            fault = "the build did not end"
        elif not wait_for(lambda: all(is_gone(build.pid) for build in builds), 30.0):
            fault = "processes are left"
        else:
            fault = ""
        codes = [build.returncode for build in builds]
    if kill is None and (fault or any(codes)):
        raise SystemExit(f"{way}: without a kill: {fault or codes}\n{site.log.read_text()}")
    if kill is not None and fault:
        kill.fault = fault
    return kill, all(code == 0 for code in codes)


def _kill(
    way: str, processes: dict[str, subprocess.Popen[bytes]], dice: random.Random
) -> Kill | None:
    """Send a signal to one of the processes or, as often, to one that it has started."""
    name, process = dice.choice(sorted(processes.items()))
    sent, target, victim = dice.choice(SIGNALS), process.pid, name.partition(" ")[0]
    below = sorted(children(process.pid))
    if below and (name == "workers" or dice.random() < 0.5):
        sent, target, victim = signal.SIGKILL, dice.choice(below), "worker"
    elif name == "workers":  # without any worker a build waits for one, and says so
        return None
    try:
        os.kill(target, sent)
    except ProcessLookupError:
        return None
    return Kill(f"{way}: {victim}, {sent.name}")


def chain(
    site: Site, way: str, whole: bytes, seconds: float, dice: random.Random, most: int
) -> list[Kill]:
    """Disturb one build again and again until it is finished or has had ``most`` kills, and compare."""
    site.output.unlink(missing_ok=True)
    kills: list[Kill] = []
    finished = False
    while not finished and len(kills) < most:
        kill, finished = disturbed(site, way, seconds, dice)
        kills += [kill] if kill else []
        if kill and site.output.exists() and site.output.read_bytes() != whole:
            kill.fault = "a catalogue that is not whole"
    if not finished:
        undisturbed(site, way)
    for kill in kills:
        if found := site.difference(way, whole):
            kill.fault = kill.fault or found
    return kills


def run(kills: int, ways: Sequence[str], seed: int) -> Result:
    """Kill builds in the given ways in turn."""
    dice, result = random.Random(seed), Result()
    with tempfile.TemporaryDirectory() as folder:
        sites = {way: Site(Path(folder) / way) for way in ways}
        undisturbed(sites[ways[0]], ways[0])  # compiles the kernels, if they are not
        whole = sites[ways[0]].catalogue(ways[0])
        times: dict[str, float] = {}
        for way, site in sites.items():
            site.output.unlink(missing_ok=True)
            start = time.monotonic()
            undisturbed(site, way)
            times[way] = time.monotonic() - start
            if found := site.difference(way, whole):
                raise SystemExit(f"{way}: {found} without any kill")
        while (left := kills - len(result.kills)) > 0:
            for way, site in sites.items():
                result.kills += chain(site, way, whole, times[way], dice, min(left, 10))
            print(result.text(), file=sys.stderr, flush=True)
    return result


def main(words: Sequence[str]) -> int:
    parser = sections.parser("faults kills", __doc__)
    has_dask = importlib.util.find_spec("distributed") is not None
    ways = ["jobs", "parts", *(["cluster"] if has_dask else [])]
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--ways", nargs="+", choices=ways, default=ways)
    parser.add_argument("--seed", type=int, default=16)
    given = parser.parse_args(words)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    result = run(given.kills, given.ways, given.seed)
    print(result.text())
    return 0 if result.survived == len(result.kills) else 1
