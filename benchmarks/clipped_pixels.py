"""The effect of clipped pixels on the matches: AS15-M-0414 clipped at the dark or bright end, clipped pixels with weights 0 to 1.

    make catalog
    .venv/bin/python benchmarks/clipped_pixels.py [build/hadley.h5]

A match is correct if it is within 1.25 pixels of the point's position by the frame's camera.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.catalog.hdf5 import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.images.image_file import open_image
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import find_points

FRAME = ROOT / "sample_data" / "AS15-M-0414.png"
RIGHT_PX = 1.25
REACH_PX = 16.0
DARK, BRIGHT = (15.0, 40.0), (170.0, 140.0)
WEIGHTS = (1.0, 0.5, 0.25, 0.0)


def clipped(photo: Image, below: float, above: float, weight: float) -> tuple[Image, float]:
    """The image with clipped values and their weight, and the share of clipped pixels."""
    hit = (photo.signal <= below) | (photo.signal >= above)
    signal = np.clip(photo.signal, below, above).astype(np.float32)
    weights = (photo.weight * np.where(hit, weight, 1.0)).astype(np.float32)
    return replace(photo, signal=signal, weight=weights), float(hit.mean())


def main() -> None:
    catalog = open_catalog(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build" / "hadley.h5")
    photo = open_image(FRAME, read_camera(FRAME.with_name("AS15-M-0414_camera.json")))
    points = points_in_view(catalog, photo.sensor)
    lines = [
        "| clipped | pixels | weight | found | right | median offset, px |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    cases = [(-np.inf, np.inf)] + [(d, np.inf) for d in DARK] + [(-np.inf, b) for b in BRIGHT]
    for below, above in cases:
        for weight in WEIGHTS:
            changed, share = clipped(photo, below, above, weight)
            found = find_points(catalog, changed, reach_px=REACH_PX, points=points)
            off = np.linalg.norm(found.offset_px[found.found], axis=1)
            what = f"below {below:g}" if np.isfinite(below) else f"above {above:g}"
            what = what if share else "nothing"
            lines.append(
                f"| {what} | {100 * share:.0f} % | {weight:g} | {len(off)} | {(off < RIGHT_PX).sum()} | {np.median(off):.2f} |"
            )
            if not share:
                break
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
