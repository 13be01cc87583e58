"""Photographs that do not show what is said of them: wrong Suns, mirrored, turned, other ground, noise; what `locate` says.

    python -m benchmarks.evidence wrong [-o FOLDER] [--data FOLDER] [--only NAME ...]

Frames with a camera are offered 5 km and 0.5 deg from their place, maps with their own uncertainty. WRONG counts positions that are
given and false: beyond their own 3 sigma, or 3 pixels. Catalogues are those of `photographs`. Half an hour of one core.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.evidence.cases import Case, chosen
from benchmarks.evidence.catalogues import LAW
from benchmarks.markdown import table
from benchmarks.sections import evidence_parser
from lcp_catalog import Fix, locate
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.images.image import Image
from lcp_catalog.matching.sun_check import with_sun
from lcp_catalog.photometry.laws import reflectance_model
from tests.helpers import apollo_maps, located_frames

SUNS_DEG = (
    (10, 0),
    (-10, 0),
    (20, 0),
    (-20, 0),
    (45, 0),
    (90, 0),
    (180, 0),
    (0, 10),
    (0, -10),
    (0, 20),
)
"""Turns of the azimuth, and rises of the elevation."""
OUTSIDE = 14.2
"""Squared error of three unknowns that 0.27 % exceed."""


def main(words: Sequence[str]) -> int:
    parser = evidence_parser("wrong", __doc__)
    parser.add_argument("--only", nargs="*", default=["AS15-M-0", "AS15-M-1134", "AS16"])
    asked = parser.parse_args(words)
    some = [
        case
        for case in chosen(asked.data, asked.output / "catalogues", asked.only)
        if case.name in located_frames.FRAMES or case.name.startswith("AS16")
    ]
    said: dict[str, Counter[str]] = {}
    for case in some:
        for name, told in verdicts(case, asked.data):
            said.setdefault(name, Counter())[told] += 1
        print(case.name, file=sys.stderr, flush=True)
    rows = [
        [name, ", ".join(f"{n} {told}" for told, n in count.most_common())]
        for name, count in said.items()
    ]
    text = table(["input", f"what is said of {len(some)} images"], rows)
    (asked.output / "wrong.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    return 0


def verdicts(case: Case, data: Path) -> Iterator[tuple[str, str]]:
    """Names of the altered images of a photograph, and what is said of each."""
    path = case.catalog()
    if path is None:
        return
    catalog = open_catalog(path)
    is_frame = case.name in located_frames.FRAMES
    photo = (located_frames if is_frame else apollo_maps).frame(data, case.name)
    middle = catalog.position_mcmf if is_frame else apollo_maps.middle(photo)
    right = _located(case, catalog, photo)
    yield "as it is", _told(right)
    for turn, up in SUNS_DEG:
        fix = _located(case, catalog, with_sun(photo, middle, turn, up))
        yield (
            f"Sun {turn:+d} deg azimuth, {up:+d} deg elevation",
            _judged(fix, right, catalog, photo),
        )
    if is_frame:
        altered = [one for one in located_frames.spoilt(photo, catalog) if "Sun" not in one[0]]
    else:
        altered = list(apollo_maps.not_this_place(photo, [], int(case.name[-4:])))
    for name, image in altered:
        yield name, _judged(_located(case, catalog, image), right, catalog, photo)


def _located(case: Case, catalog: Catalog, photo: Image) -> Fix:
    is_frame = case.name in located_frames.FRAMES
    offered = located_frames.displaced(photo, 0) if is_frame else photo
    return locate(catalog, offered, case.uncertainty, reflectance_model(LAW))


def _judged(fix: Fix, right: Fix, catalog: Catalog, known: Image) -> str:
    """The result, and WRONG if a position is false."""
    if fix.pose is None:
        return _told(fix)
    if isinstance(known.sensor, Camera):
        wrong = located_frames.is_wrong(fix, catalog, known.sensor)
    else:
        off = fix.pose.correction - (right.pose.correction if right.pose else apollo_maps.NET_M)
        wrong = bool(off @ np.linalg.solve(fix.pose.covariance, off) > OUTSIDE)
    return _told(fix) + (" WRONG" if wrong else "")


def _told(fix: Fix) -> str:
    """The result, and if the Sun was the reason."""
    return fix.verdict + (", Sun" if "Sun" in fix.reason else "")
