"""A large catalogue read in bounded memory: processor time and peak memory of `lcp inspect`, of `lcp report`, of windows,
patches and conditions that are read from the file, of `lcp diff`, and of `lcp merge`.

    python benchmarks/large_catalog.py [POINTS]

Writes a synthetic catalogue of 200 000 points (patches of 5 x 5 nodes, 2 image scales, 2 views, 5 x
12 Suns) into a temporary folder; one with other heights and ids; and two parts that overlap by a ninth.
`docs/explanation/scale.md` holds the figures.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import numpy as np
from helpers import many_points, merges

from lcp_catalog.catalog.hdf5 import Catalog, open_catalog, write_catalog

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


CONFIG = """
[area]
bounds_deg = [{}, -60.0, {}, 60.0]
gsd_m = 118.0
[points]
patch_nodes = 9
spacing_m = 8000.0
search_m = 7552.0
"""


def measured(*arguments: str) -> str:
    """Exit code, processor time and peak memory of a command."""
    command = [sys.executable, "-c", CHILDREN, LCP, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def changed(catalog: Catalog) -> Catalog:
    """Higher patches; another id for each tenth point."""
    dem = catalog.dem + np.float32(1.0)
    dem[:, catalog.patch_nodes // 2, catalog.patch_nodes // 2] = 0.0
    other = np.arange(len(catalog)) % 10 == 0
    return replace(catalog, dem=dem, point_id=catalog.point_id + 10**9 * other)


def part(catalog: Catalog, west: float, east: float) -> Catalog:
    """The points between two meridians, under the ids of their places."""
    found = catalog.within(west, -60.0, east, 60.0)
    found = merges.moved(found, found.longitude, found.latitude)
    cells = replace(found.coverage, spacing_m=8000.0)
    return replace(found, coverage=cells, config=CONFIG.format(west, east))


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    with tempfile.TemporaryDirectory() as folder:
        path, other, west, east, merged, page = (
            str(Path(folder, name))
            for name in ("large.h5", "other.h5", "west.h5", "east.h5", "merged.h5", "report.html")
        )
        write_catalog(many_points.catalog(count), path)
        print(f"{count} points, {Path(path).stat().st_size / 1e6:.0f} MB")
        print(f"lcp inspect: {measured('inspect', path)}")
        print(f"lcp report: {measured('report', path, '-o', page)}")
        subprocess.run([sys.executable, "-c", WINDOWS, path], check=True)
        catalog = open_catalog(path, check=False)
        write_catalog(changed(catalog), other)
        print(f"lcp diff: {measured('diff', path, other)}")
        write_catalog(part(catalog, 0.0, 200.0), west)
        write_catalog(part(catalog, 160.0, 359.999), east)
        print(f"lcp merge: {measured('merge', west, east, '-o', merged)}")


if __name__ == "__main__":
    main()
