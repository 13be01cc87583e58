"""Builds by another commit's package beside those of the working tree: both by the command, in processes of their own."""

from __future__ import annotations

import io
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from benchmarks.commands import Ran, ran
from benchmarks.markdown import percent, table
from benchmarks.places import ROOT
from benchmarks.speed.areas import sample
from benchmarks.timing import median, ratio
from lcp_catalog.catalog.schema import USABLE

RUN = "from lcp_cli.main import main\nif __name__ == '__main__': main()"


@dataclass(frozen=True)
class Commit:
    """A folder with the packages `lcp_catalog` and `lcp_cli` of a commit, or the working tree's (None)."""

    name: str
    folder: Path | None

    @classmethod
    def extracted(cls, revision: str, folder: Path) -> Commit:
        """The packages of a commit; compiled kernels stay in the folder. CalledProcessError for an unknown revision."""
        commit = _git("rev-parse", "--verify", f"{revision}^{{commit}}").decode().strip()
        place = folder / commit[:12]
        if not place.exists():
            aside = folder / f"{commit[:12]}.part"
            with tarfile.open(
                fileobj=io.BytesIO(_git("archive", commit, "lcp_catalog", "cli", "sample_data"))
            ) as tar:
                tar.extractall(aside, filter="data")
            (aside / "cli").rename(aside / "lcp_cli")
            (aside / "sample_data").rename(aside / "lcp_catalog" / "sample_data")
            aside.rename(place)
        return cls(revision, place)

    def build(self, output: Path, size_km: float, *options: str) -> Ran:
        """The build of the sample's middle."""
        found = {"PYTHONPATH": str(self.folder)} if self.folder else {}
        command = [sys.executable, "-c", RUN, *sample(size_km, output, *options)]
        return ran(command, self.folder or output.parent, found)


def compared(revision: str, size_km: float, rounds: int, folder: Path) -> str:
    """Processor time, points and usable conditions of both, as Markdown."""
    both = [Commit("now", None), Commit.extracted(revision, folder / "commits")]
    runs: dict[str, list[Ran]] = {one.name: [] for one in both}
    for number in range(rounds + 1):
        for one in both if number % 2 else reversed(both):
            done = one.build(folder / f"{one.name}.h5", size_km, "--jobs", "1")
            runs[one.name] += [done] if number else []  # the first compiles
    rows = []
    for name, some in runs.items():
        points, conditions, usable = counted(folder / f"{name}.h5")
        times = [
            f"{median(run.processor_s for run in some):.1f}",
            f"{median(run.seconds for run in some):.1f}",
        ]
        peak_mb = max(max(run.parent_mb, run.worker_mb) for run in some)
        rows.append([name, points, usable, percent(usable / conditions), *times, f"{peak_mb:.0f}"])
    head = [
        "sample's middle",
        "points",
        "usable conditions",
        "of all",
        "processor, s",
        "wall, s",
        "peak, MB",
    ]
    now, before = ([run.processor_s for run in runs[one.name]] for one in both)
    return (
        f"## commit\n\n{table(head, rows)}\n\nTimes as fast as {revision}: {ratio(now, before):.2f}"
    )


def counted(path: Path) -> tuple[int, int, int]:
    """Points, evaluated conditions and usable ones of a catalogue of any schema."""
    with h5py.File(path) as file:
        flags = np.asarray(file["condition"])
    return len(flags), int((flags > 0).sum()), int((flags == USABLE).sum())


def _git(*arguments: str) -> bytes:
    return subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, check=True).stdout
