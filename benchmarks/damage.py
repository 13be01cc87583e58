"""Damaged catalogues: whether `lcp inspect` notices every change of what is read, survives, and stays
within its memory and time.

    PYTHONPATH=tests python benchmarks/damage.py [FLIPS [RANGES [SEED]]]

Damages copies of a small catalogue with claims, levels of maps and promises at random: 1000 times one bit, 9000 times a range of
bytes (cleared, replaced, copied from elsewhere, erased pages, cut files); and as often the checkpoint of
a finished area, which a build must then compute again. Prints survived / tried.
`docs/explanation/reliability.md` holds the figures.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from helpers import catalogs, damaged_catalogs, finished_areas

from lcp_catalog.catalog.hdf5 import write_catalog
from lcp_catalog.production.checkpoints import Checkpoints


def main() -> None:
    given = [int(text) for text in sys.argv[1:]]
    flips, ranges, seed = (*given, *(1000, 9000, 1)[len(given) :])
    with tempfile.TemporaryDirectory() as folder:
        whole, copy = Path(folder, "whole.h5"), Path(folder, "copy.h5")
        write_catalog(catalogs.full(12), whole)
        for name, damages, count in (
            ("bits", (damaged_catalogs.flip,), flips),
            ("ranges", damaged_catalogs.RANGES, ranges),
        ):
            start = time.monotonic()
            for found in damaged_catalogs.tried(whole, copy, damages, seed, count):
                if found["tried"] % 100 == 0 or found["tried"] == count:
                    _print(name, found, time.monotonic() - start)
    for name, damages, count in (
        ("bits", (damaged_catalogs.flip,), flips),
        ("ranges", damaged_catalogs.RANGES, ranges),
    ):
        noticed = _damaged_checkpoints(damages, seed, count)
        print(f"checkpoints, {name}: noticed {noticed} / tried {count}")
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    print(f"largest process of a check: {most:.0f} MB")


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


if __name__ == "__main__":
    main()
