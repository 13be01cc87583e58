"""Damaged catalogues: whether `lcp inspect` notices every change of what is read, survives, and stays
within its memory and time.

    python -m benchmarks.faults damage [--flips 1000] [--ranges 1000] [--indices 312] [--seed 1]

Damages copies of a small catalogue with claims, levels of maps and promises at random: so many times one bit, and a range of
bytes (cleared, replaced, copied from elsewhere, erased pages, cut files); and as often the checkpoint of
a finished area, which a build must then compute again. Bits near indices of chunks, and each edit by h5py, are tried in
every use (`tests/helpers/catalog_uses.py`). Prints survived / tried.
`docs/explanation/reliability.md` holds the figures.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import sections
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.production.checkpoints import Checkpoints
from tests.helpers import catalog_uses, catalogs, damaged_catalogs, finished_areas


def main(words: Sequence[str]) -> int:
    parser = sections.parser("faults damage", __doc__)
    parser.add_argument("--flips", type=int, default=1000, help="copies with one wrong bit")
    parser.add_argument("--ranges", type=int, default=1000, help="copies with other damage")
    parser.add_argument("--indices", type=int, default=312, help="bits near indices of chunks")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(words)
    kinds = (
        ("bits", (damaged_catalogs.flip,), given.flips),
        ("ranges", damaged_catalogs.RANGES, given.ranges),
    )
    good = True
    with tempfile.TemporaryDirectory() as folder:
        whole, copy = Path(folder, "whole.h5"), Path(folder, "copy.h5")
        write_catalog(catalogs.full(12), whole)
        for name, damages, count in kinds:
            start = time.monotonic()
            for found in damaged_catalogs.tried(whole, copy, damages, given.seed, count):
                if found["tried"] % 100 == 0 or found["tried"] == count:
                    _print(name, found, time.monotonic() - start)
                good = good and found["noticed"] + found["harmless"] == found["tried"]
    with tempfile.TemporaryDirectory() as folder:
        for found in catalog_uses.tried(Path(folder), given.indices, [*catalog_uses.USES]):
            if found["tried"] % 900 == 0:
                print("uses of edited and turned files:", dict(found), flush=True)
        print("all uses of edited and turned files:", dict(found))
    for name, damages, count in kinds:
        noticed = _damaged_checkpoints(damages, given.seed, count)
        print(f"checkpoints, {name}: noticed {noticed} / tried {count}")
        good = good and noticed == count
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    print(f"largest process of a check: {most:.0f} MB")
    return 0 if good else 1


def _damaged_checkpoints(
    damages: tuple[damaged_catalogs.Damage, ...], seed: int, count: int
) -> int:
    """Of so many checkpoints whose bytes were changed, how many are not taken as whole."""
    rng, noticed = np.random.default_rng(seed), 0
    with tempfile.TemporaryDirectory() as folder:
        found = Checkpoints(Path(folder), "ab" * 32)
        found.write("r00001c00001", finished_areas.area(1, (3, 2, 0, 1) * 50))
        path = found.path("r00001c00001")
        whole = path.read_bytes()
        for number in range(count):
            damaged = bytearray(whole)
            while damaged == whole:
                damages[number % len(damages)](damaged, rng)
            path.write_bytes(damaged)
            noticed += not found.is_whole("r00001c00001")
    return noticed


def _print(name: str, found: dict[str, int], seconds: float) -> None:
    survived = found["noticed"] + found["harmless"]
    print(
        f"{name}: survived {survived} / tried {found['tried']}; noticed {found['noticed']}, no value"
        f" changed {found['harmless']}; the check's process crashed {found['crashed']} and met a"
        f" limit {found['limited']} times; {seconds:.0f} s",
        flush=True,
    )
