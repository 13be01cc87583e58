"""Points from catalogue to covariance, and their search beside OpenCV's masked one at every place.

    python -m benchmarks.speed matching [--rounds N]

One thread, processor time, medians of interleaved rounds; Markdown. Heights, shadows and shading: `build`; rays: `peers`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np

from benchmarks import sections
from benchmarks.markdown import percent, table
from benchmarks.places import DEM
from benchmarks.timing import Task, in_turn, median, ratio
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.kernels.matching import search
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import SearchImage, find_points
from lcp_catalog.matching.templates import render_patches
from lcp_catalog.photometry.laws import DEFAULT_MODEL
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.threads import limit_threads
from tests.helpers.match_frames import simulated_image
from tests.helpers.twins_match import catalog_of_dem, looking_at

CELL_M = 118.45
PATCH, REACH_PX, POINTS, SEARCHED = 33, 64, 1000, 40


def main(words: Sequence[str]) -> int:
    parser = sections.parser("speed matching", __doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args(words).rounds
    with limit_threads(1):
        print(table(["matching", "points/s", "beside"], rows(rounds)))
    return 0


def rows(rounds: int) -> list[list[str]]:
    """All stages of a point, and its search: points a second, and the time of other searches over that."""
    lon, lat = np.meshgrid(np.linspace(2.7, 4.3, 12), np.linspace(25.3, 26.7, 12))
    catalog = catalog_of_dem(lon.ravel(), lat.ravel(), PATCH, CELL_M)
    frame = EnuFrame(3.5, 26.0, -1000.0)
    camera = looking_at(frame, 300e3, 0, 0, 20, 300e3 / CELL_M, (640, 640))
    request = Request(
        DemSet.open([DEM]), sun=SunChoice(90, 20), view=ViewChoice(camera), disc=False
    )
    photo = simulated_image(request, Detector(blur_px=0.5, noise=0.02, bits=12, seed=1))
    points = np.resize(points_in_view(catalog, photo.sensor), POINTS)
    some = points[:SEARCHED]
    image = SearchImage.of(photo)
    made = render_patches(
        catalog, some, photo.sensor, photo.sun_directions(catalog.position_mcmf[some])
    )
    found = {coarse: np.full((SEARCHED, search.NUMBERS), np.nan) for coarse in (True, False)}

    def ours(coarse: bool) -> None:
        search.find_templates(
            image.fine, image.weight, image.half, image.half_weight, made.values, made.mask, made.origin,
            np.full(SEARCHED, REACH_PX), np.full(SEARCHED, PATCH / 2.0), 0.7, np.full(SEARCHED, coarse), found[coarse],
        )  # fmt: skip

    def theirs() -> None:
        for values, mask, (column, line) in zip(made.values, made.mask, made.origin, strict=True):
            top, left = max(line - REACH_PX, 0), max(column - REACH_PX, 0)
            bottom, right = line + REACH_PX + len(values), column + REACH_PX + values.shape[1]
            region = image.fine[top:bottom, left:right]
            cv2.matchTemplate(region, values, cv2.TM_CCOEFF_NORMED, mask=mask.astype(np.float32))

    tasks: dict[str, Task] = {
        "all": partial(find_points, catalog, photo, DEFAULT_MODEL, REACH_PX, points=points),
        "by halves": partial(ours, True),
        "at every place": partial(ours, False),
        "OpenCV": theirs,
    }
    times = in_turn(tasks, rounds)
    told = [f"{n} {ratio(times['by halves'], times[n]):.2f}" for n in ("at every place", "OpenCV")]
    same = float(np.all(found[True][:, :2] == found[False][:, :2], axis=1).mean())
    rates = [POINTS / median(times["all"]), SEARCHED / median(times["by halves"])]
    return [
        ["all stages", f"{rates[0]:.0f}", ""],
        [
            f"search of +-{REACH_PX} px",
            f"{rates[1]:.0f}",
            f"{', '.join(told)}; same place {percent(same)}",
        ],
    ]
