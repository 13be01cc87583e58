"""Faults of disks and inputs while a catalogue is built, at random moments from a seed.

Each case must end in the catalogue of an undisturbed build, byte for byte, or in one line that refuses
it, with nothing half-written and no process left. Signals to processes: `kills`.

``python -m benchmarks.faults disks [--seed N] [--only KIND...] [--cases N]`` prints for each kind
survived / tried, and the cases that did not survive; it exits 1 if there are any.

| kind | fault | must end in |
| --- | --- | --- |
| disk | a file system of random size is full; then --resume with room | one line; equal bytes |
| limit | no file may grow beyond a random size; then --resume without limit | one line; equal bytes |
| builds | two builds of one output, the second at a random moment | one line from one; equal bytes |
| inputs | the DEM is replaced by another at a random moment | one line; or the bytes of either DEM |
| reading | the DEM is cut at a random moment | one line, no output; or equal bytes |
| checkpoints | a random bit of a checkpoint of a killed build is turned; then --resume | equal bytes |
"""

from __future__ import annotations

import contextlib
import os
import random
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import rasterio

from benchmarks import sections
from benchmarks.commands import LCP
from benchmarks.faults.processes import CONFIG, is_gone, wait_for
from benchmarks.places import DEM

LONGEST_S = 120.0
"""A build that takes longer hangs."""
END_S = 5.0
"""Time in which all processes of a build must have ended after it."""


class CaseError(Exception):
    """A case that did not end as it must."""


@dataclass
class Cases:
    """The folder of the cases, and the bytes of undisturbed builds with the DEM and with another one."""

    folder: Path
    rng: random.Random
    whole: bytes = b""
    other: bytes = b""
    seconds: float = 0.0
    count: int = 0

    @property
    def dem(self) -> Path:
        return self.folder / "dem.tif"

    @property
    def other_dem(self) -> Path:
        return self.folder / "other.tif"

    def prepare(self) -> None:
        """Write the configuration and both DEMs; build both catalogues."""
        shutil.copy(CONFIG, self.folder / "build.toml")
        with rasterio.open(DEM) as source:
            heights, profile = source.read(), source.profile
        for path, factor in ((self.dem, 1), (self.other_dem, 2)):
            with rasterio.open(path, "w", **profile) as target:
                target.write((heights / factor).astype(heights.dtype))
        self.other = self._undisturbed(self.other_dem)
        start = time.monotonic()
        self.whole = self._undisturbed(self.dem)
        self.seconds = time.monotonic() - start

    def _undisturbed(self, dem: Path) -> bytes:
        case = self.case()
        shutil.copy(dem, case / "dem.tif")
        ended = self.build(case)
        if ended.returncode:
            raise SystemExit(f"the undisturbed build fails: {ended.stderr}")
        found = (case / "x.h5").read_bytes()
        shutil.rmtree(case)
        return found

    def case(self) -> Path:
        """A new folder with the DEM."""
        self.count += 1
        path = self.folder / f"case{self.count}"
        path.mkdir()
        shutil.copy(self.dem, path / "dem.tif")
        return path

    def start(
        self, case: Path, *options: str, limit: int | None = None, output: Path | None = None
    ) -> subprocess.Popen[str]:
        """A build in a session of its own; ``limit``: greatest size of a file, bytes."""

        def prepare() -> None:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            if limit is not None:
                signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        command = [
            LCP, "build-catalog", str(case / "dem.tif"), "-o", str(output or case / "x.h5"),
            "--config", str(self.folder / "build.toml"), "--jobs", "2", *options,
        ]  # fmt: skip
        return subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            start_new_session=True, env=os.environ | {"PYTHONFAULTHANDLER": "1"},
            preexec_fn=prepare,  # noqa: PLW1509  # this program has no threads
        )  # fmt: skip

    def build(self, case: Path, *options: str, **how: object) -> subprocess.CompletedProcess[str]:
        """A build, to its end."""
        return finished(self.start(case, *options, **how))  # type: ignore[arg-type]  # as `start`

    def moment(self, share: float = 1.1) -> float:
        """A random time within a build, seconds."""
        return self.rng.uniform(0.0, share * self.seconds)

    def same(self, output: Path, *allowed: bytes) -> None:
        """CaseError unless the output has the bytes of an undisturbed build."""
        if output.read_bytes() not in (allowed or (self.whole,)):
            raise CaseError("the catalogue differs from that of an undisturbed build")

    def resumed(self, ended: subprocess.CompletedProcess[str], output: Path) -> None:
        """CaseError unless a build that went on has the output of an undisturbed one."""
        if ended.returncode:
            raise CaseError(f"not resumed: {ended.stderr.strip()[-200:]}")
        self.same(output)

    def refused_or_same(
        self, ended: subprocess.CompletedProcess[str], output: Path, *allowed: bytes
    ) -> None:
        """CaseError unless a build was refused in a line, or has one of the allowed outputs."""
        if ended.returncode:
            refused(ended, output)
        else:
            self.same(output, *allowed)


def finished(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    """The end of a build; CaseError if it hangs, leaves a process, or says more than lines for people."""
    try:
        _, error = process.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGABRT)  # each process writes where its threads are
        _, error = process.communicate(timeout=END_S)
        raise CaseError(f"the build hangs:\n{error}") from None
    if not wait_for(lambda: is_gone(process.pid), END_S):
        os.killpg(process.pid, signal.SIGKILL)
        raise CaseError(f"processes are left {END_S:g} s after the end")
    for word in ("Traceback", "unexpected"):
        if word in error:
            raise CaseError(f"{word}: {error.strip()[-1500:]}")
    return subprocess.CompletedProcess(process.args, process.returncode, "", error)


def refused(ended: subprocess.CompletedProcess[str], output: Path) -> None:
    """CaseError unless a build failed with a line and without an output."""
    if ended.returncode != 1 or not ended.stderr.strip():
        raise CaseError(f"exit {ended.returncode} instead of 1: {ended.stderr.strip()[-200:]}")
    if output.exists():
        raise CaseError("an output stands after a failure")


@contextlib.contextmanager
def small_file_system(folder: Path, kilobytes: int) -> Iterator[Callable[[int], None]]:
    """A file system in memory at ``folder``, and the function that gives it another size.
    PermissionError where this is not permitted.
    """
    folder.mkdir()
    size = f"size={kilobytes}k"
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", size, "tmpfs", folder], check=False
    ).returncode:
        raise PermissionError("a file system cannot be mounted: run as root, or by `unshare -rm`")

    def resize(new: int) -> None:
        subprocess.run(["mount", "-o", f"remount,size={new}k", folder], check=True)

    try:
        yield resize
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


def disk(cases: Cases, case: Path) -> None:
    """A full file system, then room."""
    disk = case / "disk"
    with small_file_system(disk, cases.rng.randrange(4, 2 * len(cases.whole) // 1000)) as resized:
        output = disk / "x.h5"
        ended = cases.build(case, output=output)
        if ended.returncode:
            refused(ended, output)
            resized(100_000)
            ended = cases.build(case, "--resume", output=output)
        cases.resumed(ended, output)


def limit(cases: Cases, case: Path) -> None:
    """A limit on the size of files, then none."""
    ended = cases.build(case, limit=cases.rng.randrange(100, int(1.1 * len(cases.whole))))
    if ended.returncode:
        refused(ended, case / "x.h5")
        ended = cases.build(case, "--resume")
    cases.resumed(ended, case / "x.h5")


def builds(cases: Cases, case: Path) -> None:
    """Two builds of one output."""
    first = cases.start(case)
    time.sleep(cases.moment(0.9))
    second = cases.start(case)
    ends = [finished(second), finished(first)]
    codes = sorted(ended.returncode for ended in ends)
    if codes != [0, 1]:
        raise CaseError(
            f"exits {codes} instead of 0 and 1: {[ended.stderr[-200:] for ended in ends]}"
        )
    cases.same(case / "x.h5")


def inputs(cases: Cases, case: Path) -> None:
    """A DEM that another one replaces."""
    process = cases.start(case)
    time.sleep(cases.moment())
    aside = case / "new.tif"
    shutil.copy(cases.other_dem, aside)
    aside.replace(case / "dem.tif")
    cases.refused_or_same(finished(process), case / "x.h5", cases.whole, cases.other)


def reading(cases: Cases, case: Path) -> None:
    """A DEM that is cut while it is read."""
    process = cases.start(case)
    time.sleep(cases.moment())
    size = (case / "dem.tif").stat().st_size
    os.truncate(case / "dem.tif", cases.rng.randrange(size))
    cases.refused_or_same(finished(process), case / "x.h5")


def checkpoints(cases: Cases, case: Path) -> None:
    """A checkpoint with one wrong bit."""
    process = cases.start(case)
    while process.poll() is None and not list((case / "x.h5.parts").glob("*.area")):
        time.sleep(0.02)
    time.sleep(cases.moment(0.3))
    with contextlib.suppress(ProcessLookupError):
        os.kill(process.pid, signal.SIGKILL)
    finished(process)
    files = sorted(path for path in (case / "x.h5.parts").glob("*.*") if path.stat().st_size)
    if files:
        file = cases.rng.choice(files)
        content = bytearray(file.read_bytes())
        content[cases.rng.randrange(len(content))] ^= 1 << cases.rng.randrange(8)
        file.write_bytes(content)
    ended = cases.build(case, "--resume", "--overwrite")
    if ended.returncode == 1 and "run.json" in ended.stderr:
        ended = cases.build(case, "--overwrite")
    cases.resumed(ended, case / "x.h5")


KINDS = {f.__name__: f for f in (disk, limit, builds, inputs, reading, checkpoints)}


def run_kind(name: str, kind: Callable[[Cases, Path], None], cases: Cases, count: int) -> bool:
    """Run the cases and print the kind's line; True if all survived."""
    survived, start = 0, time.monotonic()
    for number in range(count):
        case = cases.case()
        try:
            kind(cases, case)
            survived += 1
            shutil.rmtree(case)
        except CaseError as fault:
            print(f"  {name} {number}: {fault}", flush=True)
        except PermissionError as error:
            print(f"{name:12s} not tried: {error}", flush=True)
            return True
    print(f"{name:12s} {survived} / {count} survived, {time.monotonic() - start:.0f} s", flush=True)
    return survived == count


def main(words: Sequence[str]) -> int:
    parser = sections.parser("faults disks", __doc__)
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--cases", type=int, default=30, help="cases of every kind")
    parser.add_argument("--only", nargs="+", choices=list(KINDS), default=list(KINDS))
    options = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="lcp-soak-") as folder:
        cases = Cases(Path(folder), random.Random(options.seed))
        cases.prepare()
        print(f"an undisturbed build takes {cases.seconds:.1f} s", flush=True)
        good = [run_kind(name, KINDS[name], cases, options.cases) for name in options.only]
    return 0 if all(good) else 1
