"""Damaged catalogues: whether `lcp inspect` notices every change of what is read, survives, and stays
within its memory and time.

    PYTHONPATH=tests python benchmarks/damage.py [FLIPS [RANGES [SEED]]]

Damages copies of a small catalogue with claims at random: 1000 times one bit, 9000 times a range of
bytes (cleared, replaced, copied from elsewhere, erased pages, cut files). Prints survived / tried.
`docs/explanation/reliability.md` holds the figures.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

from helpers import catalogs, damaged_catalogs

from lcp_catalog.catalog.hdf5 import write_catalog


def main() -> None:
    given = [int(text) for text in sys.argv[1:]]
    flips, ranges, seed = (*given, *(1000, 9000, 1)[len(given) :])
    with tempfile.TemporaryDirectory() as folder:
        whole, copy = Path(folder, "whole.h5"), Path(folder, "copy.h5")
        write_catalog(catalogs.claimed(12), whole)
        for name, damages, count in (
            ("bits", (damaged_catalogs.flip,), flips),
            ("ranges", damaged_catalogs.RANGES, ranges),
        ):
            start = time.monotonic()
            for found in damaged_catalogs.tried(whole, copy, damages, seed, count):
                if found["tried"] % 100 == 0 or found["tried"] == count:
                    _print(name, found, time.monotonic() - start)
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    print(f"largest process of a check: {most:.0f} MB")


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
