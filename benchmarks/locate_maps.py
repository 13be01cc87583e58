"""Locate the map-projected frames of the Apollo 16 series (Sun elevation 6 to 58 deg) with a catalogue of GLD100, and maps
that were altered on purpose.

    .venv/bin/python benchmarks/locate_maps.py [-o build/locate-maps] [--frames 53]

The shared lunar data are needed (see `tests/conftest.py`). The command line builds the catalogue into the folder (kept for the next
run). The output is `tables.md`, the figures of the page on pose.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
from helpers import apollo_maps as maps
from helpers.apollo_frames import series_keys

from lcp_catalog.catalog.hdf5 import Catalog
from lcp_catalog.images.image import Image
from lcp_catalog.matching.position_fix import BY_ALL_POINTS, BY_POINTS, PositionFix, locate
from lcp_catalog.matching.sun_check import with_sun
from lcp_catalog.photometry.laws import reflectance_model

LAW = reflectance_model("lunar-lambert")
TURNS_DEG = (10, -10, 20, -20, 45, -45, 90, -90, 180)
OTHERS = 4
APART_DEG = 4.5


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build" / "locate-maps")
    here = os.environ.get("LCP_SHARED_DATA", ROOT.parent / "shared" / "data")
    parser.add_argument("--data", type=Path, default=Path(here))
    parser.add_argument("--frames", type=int, default=999, help="so many of the series, spread")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    catalog = maps.built(options.data, options.output)
    keys = series_keys(options.data)
    photos = {
        key: maps.frame(options.data, key) for key in keys[:: max(1, len(keys) // options.frames)]
    }
    right = {key: found(catalog, photo) for key, photo in photos.items()}
    lines = [
        f"{len(catalog)} points",
        "",
        *frames(right),
        "",
        *spread(right),
        "",
        *wrong(catalog, photos, right),
    ]
    (options.output / "tables.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


def found(catalog: Catalog, photo: Image) -> PositionFix:
    return locate(catalog, photo, maps.UNCERTAIN, LAW)


def frames(right: dict[str, PositionFix]) -> list[str]:
    lines = ["| frame | verdict | by | points found | log10 of false alarms | east, m | north, m |"]
    lines.append("| --- | --- | --- | ---: | ---: | ---: | ---: |")
    for key, answer in right.items():
        place = "| | "
        if answer.pose is not None:
            pairs = zip(answer.pose.correction, answer.pose.sigma, strict=True)
            place = "| ".join(f"{at:.0f} +- {sigma:.0f} " for at, sigma in pairs)
        lines.append(
            f"| {key} | {answer.verdict} | {answer.by} | {answer.matches.found.sum()} "
            f"| {answer.log10_false_alarms:.1f} | {place}|"
        )
    return lines


def spread(right: dict[str, PositionFix]) -> list[str]:
    """Medians and robust spreads of the corrections of located frames, by points and by the joint offset."""
    lines = []
    for by in (BY_POINTS, BY_ALL_POINTS):
        located = [a.pose for a in right.values() if a.pose is not None and a.by == by]
        if located:
            at = np.array([pose.correction for pose in located])
            middle = np.median(at, axis=0)
            wide = 1.48 * np.median(np.abs(at - middle), axis=0)
            sigma = np.median([pose.sigma for pose in located], axis=0)
            lines.append(
                f"by {by}: {len(at)} frames, median {middle.round()} m, spread {wide.round()} m, median sigma {sigma.round()} m"
            )
    return lines


def wrong(catalog: Catalog, photos: dict[str, Image], right: dict[str, PositionFix]) -> list[str]:
    """Results for altered maps, and for Suns turned by known angles."""
    said: dict[str, Counter[str]] = {}
    for key, photo in photos.items():
        lon = photo.sensor.center_deg[0]
        others = [p for p in photos.values() if abs(p.sensor.center_deg[0] - lon) > APART_DEG]
        for name, image in maps.not_this_place(photo, others[:OTHERS], int(key[-4:])):
            answer = found(catalog, image)
            said.setdefault(name, Counter())[told(answer)] += 1
        for turn in TURNS_DEG:
            answer = found(catalog, with_sun(photo, maps.middle(photo), turn, 0.0))
            count = said.setdefault(f"Sun turned by {turn:+d} deg", Counter())
            count[told(answer)] += 1
            if answer.pose is not None and right[key].pose is not None:
                off = answer.pose.correction - right[key].pose.correction
                count["(3 sigma off)"] += off @ np.linalg.solve(answer.pose.covariance, off) > 14.2
        print(key, file=sys.stderr)
    lines = ["| input | verdicts |", "| --- | --- |"]
    for name, count in said.items():
        lines.append(f"| {name} | {', '.join(f'{n} {what}' for what, n in count.most_common())} |")
    return lines


def told(answer: PositionFix) -> str:
    """The result, the method that gave it, and if the Sun was the reason."""
    by = f" by {answer.by}" if answer.pose is not None or answer.by == BY_ALL_POINTS else ""
    return answer.verdict + by + (", Sun" if "Sun" in answer.reason else "")


if __name__ == "__main__":
    main()
