"""What digests of chunks add: to a query of a catalogue of 100 000 points (33 x 33 nodes, 5 views, 40 Suns), all of them
within 300 km, and to what `lcp inspect` checks of one of 200 000 points (5 x 5 nodes, 2 views, 60 Suns).

    python -m benchmarks.speed digests [--points 100000] [--inspected 200000] [--rounds 7]

Processor time of one process, with digests and without in turn; the ratio is the median of those of neighbours in time.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from unittest.mock import patch

import h5py

from benchmarks.markdown import table
from benchmarks.speed.query import SUN, camera, near, usable
from benchmarks.timing import in_turn, median, ratio
from lcp_catalog.catalog.integrity import ChunkDigests, ChunkGrid
from lcp_catalog.catalog.stored import StoredFile, stored_catalog
from lcp_catalog.catalog.verification import judge
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.navigation.documents import document
from lcp_catalog.navigation.expected_position import Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage
from tests.helpers import many_points


def _write(asked: Path, points: int, inspected: Path, count: int) -> None:
    whole = many_points.catalog(points, nodes=33, views=5, sun_azimuths=8)
    write_catalog(near(usable(whole)), asked)
    write_catalog(many_points.catalog(count), inspected)


def _query(path: Path) -> None:
    catalog = stored_catalog(StoredFile.of(path))
    for answer in answers(catalog, [PlannedImage.lit(camera(1.0, 2.0, 100.0), SUN)], Query()):
        document(answer, catalog)


def _inspect(path: Path) -> None:
    if problems := judge(StoredFile.of(path))[0]:
        raise SystemExit(problems[0])


def _unchecked(task: Callable[[Path], None], path: Path) -> None:
    """The same, with every chunk believed: none is digested, and none read again to be."""

    def believed(_: ChunkDigests, dataset: h5py.Dataset, grid: ChunkGrid, number: int) -> bytes:
        return bytes(dataset.id.read_direct_chunk(grid.offset(number))[1])

    with (
        patch.object(ChunkDigests, "_sound_chunk", believed),
        patch.object(ChunkDigests, "problems", lambda *_: ()),
    ):
        task(path)


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser("python -m benchmarks.speed digests", description=__doc__)
    parser.add_argument(
        "--points", type=int, default=100_000, help="of the catalogue that is asked"
    )
    parser.add_argument("--inspected", type=int, default=200_000, help="of the other")
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        asked, inspected = Path(folder, "asked.h5"), Path(folder, "inspected.h5")
        process = multiprocessing.get_context("spawn").Process(
            target=_write, args=(asked, given.points, inspected, given.inspected)
        )  # its memory goes with it
        process.start()
        process.join()
        rows = []
        for name, task, path in (("query", _query, asked), ("inspect", _inspect, inspected)):
            tasks = {"without": partial(_unchecked, task, path), "with": partial(task, path)}
            times = in_turn(tasks, given.rounds)
            without, checked = times["without"], times["with"]
            added = median(b - a for a, b in zip(without, checked, strict=True))
            figures = median(without), median(checked), added, ratio(without, checked)
            size = f"{path.stat().st_size / 1e6:.0f}"
            rows.append([f"`lcp {name}`", size, *[f"{figure:.3f}" for figure in figures]])
    print(table(["", "MB", "without, s", "with, s", "added, s", "times"], rows))
    return 0
