"""Speed of rays against the sphere, compared with the textbook's formula in NumPy and with rays through a heightfield; and
of whole images of the sphere.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lcp_catalog.cameras.view import looking_camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry import sphere_intersection
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light.sources import Lighting
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering import limb
from lcp_catalog.rendering.sphere_renderer import render_sphere_camera, sphere_nodes
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.threads import limit_threads

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.twins_sphere import naive_ranges

FRAME = EnuFrame(0.0, 0.0)
PIXELS = 512
ROUNDS = 7


def seconds(task, *arguments) -> float:
    start = time.process_time()
    task(*arguments)
    return time.process_time() - start


def in_turn(*tasks) -> list[float]:
    """The median time of each task; the tasks run in turn, so that all see the same machine."""
    for task in tasks:
        task()
    times = [[seconds(task) for task in tasks] for _ in range(ROUNDS)]
    return [statistics.median(column) for column in zip(*times, strict=True)]


@pytest.mark.parametrize("altitude_km", [10, 2000, 400_000])
def test_rays(benchmark, altitude_km):
    """One thread; the heightfield is that of the sphere, 512 x 512 nodes under the same camera."""
    distance = altitude_km * 1e3
    gsd = 0.4 * min(distance, MOON_RADIUS_M) / PIXELS
    camera = looking_camera(FRAME, [0, 0, distance], gsd, (PIXELS * gsd, PIXELS * gsd))
    row, col = np.mgrid[0:PIXELS, 0:PIXELS].astype(float)
    rays = camera.rays(np.stack([col, row], -1))
    x = (np.arange(PIXELS) - PIXELS / 2) * gsd * 1.05
    field = Heightfield(sphere_nodes(*np.meshgrid(x, -x))[..., 2].astype(np.float32), gsd * 1.05)
    origin, enu = camera.rays_enu(FRAME)
    field = Heightfield(field.z_m, field.gsd_m, float(x[0]), float(-x[0]))
    with limit_threads(1):
        ours, naive, traced = in_turn(
            lambda: sphere_intersection.ranges(camera.position_mcmf_m, rays),
            lambda: naive_ranges(camera.position_mcmf_m, rays),
            lambda: field.first_hits(origin, enu),
        )
        benchmark.pedantic(
            sphere_intersection.ranges, (camera.position_mcmf_m, rays), rounds=ROUNDS
        )
    benchmark.extra_info["Mray/s"] = round(PIXELS**2 / ours / 1e6, 1)
    benchmark.extra_info["naive / ours"] = round(naive / ours, 2)
    benchmark.extra_info["heightfield / ours"] = round(traced / ours, 1)


@pytest.mark.parametrize("model", ["lommel-seeliger", "hapke"])
def test_whole_moon(benchmark, model):
    """An image of the whole disc with its limb: the shares of its time spent on pixels at the limb and on rays."""
    size = 2.1 * MOON_RADIUS_M
    camera = looking_camera(FRAME, [0, 0, 3.8e8], size / PIXELS, (size, size))
    light = Lighting.of_sun(direction_enu(90, 40))
    row, col = np.mgrid[0:PIXELS, 0:PIXELS]
    rays = camera.rays(np.stack([col, row], -1).astype(float))
    near = limb.limb_pixels(camera, rays, limb.pixel_angle(camera))
    law = reflectance_model(model)
    with limit_threads(1):
        whole, edge, ranges = in_turn(
            lambda: render_sphere_camera(FRAME, camera, light, model=law),
            lambda: limb.coverage(camera, col[near], row[near]),
            lambda: sphere_intersection.ranges(camera.position_mcmf_m, rays),
        )
        benchmark.pedantic(
            render_sphere_camera, (FRAME, camera, light), {"model": law}, rounds=ROUNDS
        )
    benchmark.extra_info["Mpixel/s"] = round(PIXELS**2 / whole / 1e6, 2)
    benchmark.extra_info["limb share"] = round(edge / whole, 3)
    benchmark.extra_info["ray share"] = round(ranges / whole, 3)
