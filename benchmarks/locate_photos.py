"""Locate Apollo 15 Metric frames with catalogues built from the DEM alone, and images that were altered on purpose.

    .venv/bin/python benchmarks/locate_photos.py [-o build/locate-photos] [--draws 10] [--frames AS15-M-0414 ...]

The shared lunar data are needed (see `tests/conftest.py`). The command line builds the catalogues into the folder (kept for the
next run). The output is `tables.md`, the tables of the page on pose.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
from helpers import located_frames as frames

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.hdf5 import Catalog
from lcp_catalog.images.image import Image
from lcp_catalog.matching.pose import position_error
from lcp_catalog.matching.position_fix import LOCATED, Options, PositionFix, locate

UNCERTAIN = Uncertainty(frames.OFF_M, frames.OFF_RAD)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "locate-photos")
    here = os.environ.get("LCP_SHARED_DATA", ROOT.parent / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(here))
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--inputs", default="", help="only those whose names begin so")
    parser.add_argument("--frames", nargs="*", default=list(frames.FRAMES))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    data = options.data
    lines = [*located(data, options), ""] if options.draws else []
    lines += spoilt(data, options)
    (options.output / "tables.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


def located(data: Path, options: argparse.Namespace) -> Iterator[str]:
    """One row for each frame: the largest and the median error of its draws."""
    yield (
        "| frame | points in view | agree | located | position error, m: median, worst | stated 1 sigma, m | "
        "error^2 / covariance (of 3): median, worst | chi2 / dof | worst accepted match, DEM pixels | s |"
    )
    yield "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    for key in options.frames:
        catalog = frames.built(data, frames.FRAMES[key], options.output)
        photo = frames.frame(data, key)
        cells = row(key, catalog, photo, options.draws)
        print(cells, file=sys.stderr)
        yield cells


def row(key: str, catalog: Catalog, photo: Image, draws: int) -> str:
    answers, seconds = [], []
    for seed in range(draws):
        start = time.perf_counter()
        answers.append(locate(catalog, frames.displaced(photo, seed), UNCERTAIN, frames.LAW))
        seconds.append(time.perf_counter() - start)
        print(key, seed, answers[-1].verdict, answers[-1].reason, file=sys.stderr)
    good = [a for a in answers if a.verdict == LOCATED]
    if not good:
        return f"| {key} | - | - | 0 of {draws} |" + " - |" * 6
    errors = [position_error(a.pose, photo.sensor) for a in good]
    whole = [e.error.whole_m for e in errors]
    squared = [e.squared for e in errors]
    worst = max(frames.worst_off_m(a, catalog, photo.sensor) for a in good) / frames.DEM_PIXEL_M
    cells = [
        key,
        f"{len(good[0].matches)}",
        f"{min(a.matches.found.sum() for a in good)}-{max(a.matches.found.sum() for a in good)}",
        f"{len(good)} of {draws}",
        f"{np.median(whole):.0f}, {max(whole):.0f}",
        f"{np.median([e.sigma.whole_m for e in errors]):.0f}",
        f"{np.median(squared):.1f}, {max(squared):.1f}",
        f"{np.median([a.pose.normalised_error for a in good]):.1f}",
        f"{worst:.2f}",
        f"{np.median(seconds):.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


def spoilt(data: Path, options: argparse.Namespace) -> Iterator[str]:
    """One row for each input, one column for each frame."""
    columns: dict[str, dict[str, str]] = {}
    for key in options.frames:
        catalog = frames.built(data, frames.FRAMES[key], options.output)
        photo = frames.frame(data, key)
        cells = columns.setdefault(key, {})
        for other in frames.FRAMES if not options.inputs else ():
            if frames.FRAMES[other] is not frames.FRAMES[key]:
                offered = frames.transplanted(frames.frame(data, other), photo)
                cells["another place's image"] = verdict(catalog, offered, photo)
        for name, image in frames.spoilt(photo, catalog):
            if not name.startswith(options.inputs):
                continue
            cells[name] = verdict(catalog, image, photo)
            print(key, name, cells[name], file=sys.stderr)
    names = list(dict.fromkeys(name for cells in columns.values() for name in cells))
    yield "| input | " + " | ".join(columns) + " |"
    yield "| --- |" + " --- |" * len(columns)
    for name in names:
        yield f"| {name} | " + " | ".join(c.get(name, "-") for c in columns.values()) + " |"


def verdict(catalog: Catalog, image: Image, known: Image) -> str:
    """The result and the position error; WRONG if a position is false."""
    answer: PositionFix = locate(
        catalog, frames.displaced(image, 0), UNCERTAIN, frames.LAW, Options()
    )
    if answer.pose is None:
        return answer.verdict + (", Sun" if "Sun" in answer.reason else "")
    error = position_error(answer.pose, known.sensor)
    wrong = " WRONG" if frames.is_wrong(answer, catalog, known.sensor) else ""
    return f"located, {error.error.whole_m:.0f} m off (sigma {error.sigma.whole_m:.0f}){wrong}"


if __name__ == "__main__":
    main()
