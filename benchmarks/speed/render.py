"""`lcp render` as a whole process beside a minimal Embree script (`embree_render.py`), in turn, one thread each:

    python -m benchmarks.speed render [--rounds N]

The script writes two bands without overviews, for one kind of map; lcp seven bands with overviews, statistics and its scene plan.
Quote the ratios.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks import sections
from benchmarks.commands import LCP, Ran, ran
from benchmarks.markdown import table
from benchmarks.places import DEM, OUTPUT
from benchmarks.timing import median, ratio

NODES, CELL_M = 1024, 118.4505876
PLACE, SUN = ("5", "25"), ("96", "14")


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed render", __doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args(words).rounds
    OUTPUT.mkdir(parents=True, exist_ok=True)
    out, size = str(OUTPUT / "render.tif"), str(1e-3 * NODES * CELL_M)
    script = str(Path(__file__).with_name("embree_render.py"))
    own = [LCP, "render", str(DEM), "-o", out, "--overwrite", "--center", *PLACE, "--size", size]
    own += ["--sun-azimuth", SUN[0], "--sun-elevation", SUN[1]]
    commands = {
        "Embree script": [sys.executable, script, str(DEM), out, *PLACE, str(NODES), *SUN],
        "standard": own,
        "draft": [*own, "--accuracy", "draft"],
    }
    found: dict[str, list[Ran]] = {name: [] for name in commands}
    for _ in range(rounds + 1):
        for name, command in commands.items():
            found[name].append(ran(command))
    cpu = {name: [one.processor_s for one in runs[1:]] for name, runs in found.items()}
    wall = {name: [one.seconds for one in runs[1:]] for name, runs in found.items()}
    theirs = next(iter(commands))
    rows = [
        [
            name,
            *(f"{median(kind[name]):.2f}" for kind in (cpu, wall)),
            *(f"{ratio(kind[name], kind[theirs]):.2f}" for kind in (cpu, wall)),
        ]
        for name in commands
    ]
    head = ["1024 x 1024 nodes", "processor s", "wall s", "times", "times, wall"]
    print(table(head, rows))
    return 0
