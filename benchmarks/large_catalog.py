"""A large catalogue read in bounded memory: processor time and peak memory of `lcp inspect`, of `lcp report`, and of
windows, patches and conditions that are read from the file.

    python benchmarks/large_catalog.py [POINTS]

Writes a synthetic catalogue of 200 000 points (patches of 5 x 5 nodes, 2 image scales, 2 views, 5 x
12 Suns) into a temporary folder. `docs/explanation/scale.md` holds the figures.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from helpers import many_points

from lcp_catalog.catalog.hdf5 import write_catalog

LCP = str(Path(sys.executable).with_name("lcp"))

CHILDREN = """
import resource, subprocess, sys
code = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(f"exit {code}, {used.ru_utime + used.ru_stime:.1f} s, peak memory {used.ru_maxrss / 1e3:.0f} MB")
"""

WINDOWS = """
import sys
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
import lcp_catalog as lcp
from lcp_catalog.memory import peak_mb

lcp.open_catalog  # imports the module

def seconds():
    return sum(sum(getrusage(who)[:2]) for who in (RUSAGE_SELF, RUSAGE_CHILDREN))

def timed(name, function):
    start = seconds()
    found = function()
    print(f"{name}: {seconds() - start:.2f} s, peak memory {peak_mb():.0f} MB")
    return found

catalog = timed("open_catalog, structure alone", lambda: lcp.open_catalog(sys.argv[1], check=False))
box = timed("points within 10 x 10 degrees", lambda: catalog.within(-5.0, -5.0, 5.0, 5.0))
print(f"  {len(box)} points")
timed("one patch", lambda: catalog.part("dem", 1234))
timed("one condition of all points", lambda: catalog.part("condition", slice(None), 0, 1, 2))
"""


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "large.h5")
        write_catalog(many_points.catalog(count), path)
        print(f"{count} points, {path.stat().st_size / 1e6:.0f} MB")
        for command in (["inspect"], ["report", "-o", str(Path(folder, "r.html"))]):
            arguments = [sys.executable, "-c", CHILDREN, LCP, *command, str(path)]
            done = subprocess.run(arguments, capture_output=True, text=True, check=True)
            print(f"lcp {command[0]}: {done.stdout.strip()}")
        subprocess.run([sys.executable, "-c", WINDOWS, str(path)], check=True)


if __name__ == "__main__":
    main()
