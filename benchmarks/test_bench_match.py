"""Speed of the matcher: points per second from catalogue to covariance, by stages, and its search compared with OpenCV's
masked one. Times are processor times of all threads together, so that other work on the machine does not count.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.kernels.matching import draw_patch, point_spread, search, subpixel_fit
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.matching import point_search, templates
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import find_points
from lcp_catalog.matching.search_image import SearchImage
from lcp_catalog.photometry.laws import DEFAULT_MODEL
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation import frame as simulate
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.threads import limit_threads, thread_limit

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.catalogs import HADLEY
from helpers.twins_match import catalog_of_dem, looking_at

NODES = 33
GSD_M = 118.45
REACH_PX = 64
POINTS = 1000
ROUNDS = 5


@pytest.fixture(scope="module")
def scene():
    """Patches of 33 x 33 nodes on a grid, and a frame of 640 x 640 pixels of one node each, turned by 20 degrees."""
    lon, lat = np.meshgrid(np.linspace(2.7, 4.3, 12), np.linspace(25.3, 26.7, 12))
    catalog = catalog_of_dem(lon.ravel(), lat.ravel(), NODES, GSD_M)
    frame = EnuFrame(3.5, 26.0, -1000.0)
    camera = looking_at(frame, 300e3, 0, 0, 20, 300e3 / GSD_M, (640, 640))
    request = Request([HADLEY], sun=SunChoice(90, 20), view=ViewChoice(camera), disc=False)
    photo = simulate.simulated_image(request, Detector(blur_px=0.5, noise=0.02, bits=12, seed=1))
    return catalog, photo, np.resize(points_in_view(catalog, photo.sensor), POINTS)


def processor_seconds(task) -> float:
    """The median time over some rounds, after a warm-up."""
    task()
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        task()
        times.append(time.process_time() - start)
    return statistics.median(times)


def test_points_a_second(benchmark, scene):
    """All stages: render, search within +-64 px, sub-pixel fit, covariance, backward search."""
    catalog, photo, rows = scene
    with limit_threads(1):
        spent = processor_seconds(
            lambda: find_points(catalog, photo, DEFAULT_MODEL, REACH_PX, points=rows)
        )
    with limit_threads(thread_limit()):
        start = time.perf_counter()
        found = find_points(catalog, photo, DEFAULT_MODEL, REACH_PX, points=rows)
        wall = time.perf_counter() - start
    benchmark.extra_info["found"] = int(found.found.sum())
    benchmark.extra_info["points_a_second_of_one_core"] = round(POINTS / spent)
    benchmark.extra_info["points_a_second_here"] = round(POINTS / wall)
    print(
        f"\n{POINTS / spent:.0f} points a second and core; {POINTS / wall:.0f} with {thread_limit()} threads now"
    )
    benchmark.pedantic(
        find_points, (catalog, photo, DEFAULT_MODEL, REACH_PX), {"points": rows}, rounds=1
    )


def test_stages(benchmark, scene, monkeypatch):
    """Microseconds of one core for each point."""
    catalog, photo, rows = scene
    spent: dict[str, float] = {}
    for module, name in (
        (point_search, "render_patches"),
        (templates, "nodes_mcmf"),
        (draw_patch, "draw_patches"),
        (point_spread, "templates"),
        (search, "find_templates"),
        (subpixel_fit, "refine"),
        (point_search, "find_backwards"),
    ):
        monkeypatch.setattr(module, name, timed(getattr(module, name), name, spent))
    with limit_threads(1):
        find_points(catalog, photo, DEFAULT_MODEL, REACH_PX, points=rows)
        spent.clear()
        start = time.process_time()
        find_points(catalog, photo, DEFAULT_MODEL, REACH_PX, points=rows)
        spent["match"] = time.process_time() - start
    for name, seconds in spent.items():
        benchmark.extra_info[name] = round(1e6 * seconds / POINTS)
        print(f"\n{name:>16} {1e6 * seconds / POINTS:7.0f} us", end="")
    benchmark.pedantic(SearchImage.of, (photo,), rounds=1)


def timed(task, name, spent):
    """Run the task and add its processor time to ``spent``."""

    def run(*arguments, **more):
        start = time.process_time()
        result = task(*arguments, **more)
        spent[name] = spent.get(name, 0.0) + time.process_time() - start
        return result

    return run


def test_search_beside_opencv(benchmark, scene):
    """One thread, the same templates and masks, the same +-64 px; OpenCV correlates every position at full resolution."""
    catalog, photo, rows = scene
    rows = rows[:40]
    image = SearchImage.of(photo)
    suns = photo.sun_directions(catalog.position_mcmf[rows])
    made = templates.render_patches(catalog, rows, photo.sensor, suns)
    size = np.full(len(rows), NODES / 2.0)
    out = {coarse: np.full((len(rows), search.NUMBERS), np.nan) for coarse in (True, False)}

    def ours(coarse: bool) -> None:
        search.find_templates(
            image.fine, image.weight, image.half, image.half_weight, made.values, made.mask, made.origin,
            np.full(len(rows), REACH_PX), size, 0.7, np.full(len(rows), coarse), out[coarse],
        )  # fmt: skip

    def theirs() -> None:
        for values, mask, (col, row) in zip(made.values, made.mask, made.origin, strict=True):
            top, left = max(row - REACH_PX, 0), max(col - REACH_PX, 0)
            region = image.fine[
                top : row + REACH_PX + values.shape[0], left : col + REACH_PX + values.shape[1]
            ]
            cv2.matchTemplate(region, values, cv2.TM_CCOEFF_NORMED, mask=mask.astype(np.float32))

    with limit_threads(1):
        halves, whole, opencv = (
            processor_seconds(t) for t in (lambda: ours(True), lambda: ours(False), theirs)
        )
    for name, value in (("halves", halves), ("whole", whole), ("opencv", opencv)):
        benchmark.extra_info[name + "_us"] = round(1e6 * value / len(rows))
    same = np.all(out[True][:, :2] == out[False][:, :2], axis=1).mean()
    print(
        f"\nOpenCV {1e6 * opencv / len(rows):.0f} us a point, ours whole {1e6 * whole / len(rows):.0f}, by halves "
        f"{1e6 * halves / len(rows):.0f}: {opencv / halves:.0f} times as fast; same place {same:.1%}"
    )
    benchmark.pedantic(ours, (True,), rounds=1)
