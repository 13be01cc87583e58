"""Cost of shading: share of a render, and of a sweep's images, for each reflectance model; measured
figures are in docs/measurements/speed.md.

Each share is a ratio of CPU times in one process, measured in turn, as medians; no absolute time is
tested. Shading is the model's own time: `images.add_light` in a render, `images.shade_nodes` in a
sweep.
"""

from __future__ import annotations

import math
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import nadir_view, oblique_view
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.kernels.photometry.images import add_light, shade_nodes
from lcp_catalog.kernels.photometry.laws import factors
from lcp_catalog.photometry.laws import Reflectance, reflectance_model
from lcp_catalog.rendering.renderer import render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.occlusion import occluded_sweep
from lcp_catalog.terrain.terrain import Terrain
from lcp_catalog.threads import limit_threads

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.synthetic import cratered

GSD = 20.0
SIZE = 1024
ROUNDS = 7
LIMITS = {"lommel-seeliger": 0.1, "hapke": 0.5}
"""Upper limits of the share of shading in a render's time."""
LAWS = ("lommel-seeliger", "lambert", "lunar-lambert", "minnaert", "hapke")
ELEVATIONS_DEG = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0)


@cache
def terrain() -> Terrain:
    z = cratered(SIZE // 2, GSD)
    field = Heightfield(np.block([[z, z[:, ::-1]], [z[::-1], z[::-1, ::-1]]]), GSD)
    window = NodeWindow(0, SIZE, 0, SIZE)
    index = np.zeros(field.z_m.shape, np.int16)
    return Terrain(field, EnuFrame(12.0, 34.0), field.whole, window, index, ("made",))


@cache
def planes() -> np.ndarray:
    field = terrain().field
    return np.ascontiguousarray(np.moveaxis(field.normals(field.whole), -1, 0))


def median_s(*tasks) -> list[float]:
    """CPU seconds of each task, measured in turn on one thread: waiting threads spin and would
    count.
    """
    times = [[] for _ in tasks]
    with limit_threads(1):
        for _ in range(ROUNDS + 1):
            for task, taken in zip(tasks, times, strict=True):
                start = time.process_time()
                task()
                taken.append(time.process_time() - start)
    return [float(np.median(taken[1:])) for taken in times]


def note(benchmark, law: Reflectance, **figures) -> None:
    benchmark.extra_info.update({name: round(value, 4) for name, value in figures.items()})
    share = figures["share"]
    if law.name in LIMITS:
        assert share < LIMITS[law.name]


@pytest.mark.parametrize("view", ["nadir", "oblique"])
@pytest.mark.parametrize("name", LAWS)
def test_share_of_a_render(benchmark, name, view):
    """`render_enu` of a million nodes in standard, the Sun at 20 deg."""
    law, sun = reflectance_model(name), direction_enu(30.0, 20.0)
    seen_from = nadir_view() if view == "nadir" else oblique_view(40.0, 100.0)
    shot = render_enu(terrain(), sun, seen_from, model=law, accuracy=TIERS["standard"])
    radiance, weight = np.zeros_like(shot.sunlit), shot.sunlit
    camera = np.asarray(seen_from.direction)

    def shade() -> None:
        add_light(radiance, planes(), sun, camera, weight, law.code, law.numbers)

    def render() -> None:
        render_enu(terrain(), sun, seen_from, model=law, accuracy=TIERS["standard"])

    benchmark.pedantic(render, rounds=1, warmup_rounds=1)
    whole, part = median_s(render, shade)
    note(benchmark, law, share=part / whole, ns_a_node=1e9 * part / SIZE**2)


@pytest.mark.parametrize("tier", ["standard", "high"])
@pytest.mark.parametrize("name", LAWS)
def test_share_of_a_sweep(benchmark, name, tier):
    """Shadows of six elevations at one azimuth, and the six images."""
    law, field = reflectance_model(name), terrain().field
    suns = [direction_enu(30.0, e) for e in ELEVATIONS_DEG]
    camera, unseen = direction_enu(0.0, 90.0), np.zeros(field.z_m.shape, np.bool_)
    elevations = np.radians(ELEVATIONS_DEG)
    azimuth = math.radians(30.0)
    dark = occluded_sweep(field, azimuth, elevations, TIERS[tier])

    def shadows() -> None:
        occluded_sweep(field, azimuth, elevations, TIERS[tier])

    def shade() -> None:
        for sun, shadow in zip(suns, dark, strict=True):
            shade_nodes(planes(), sun, camera, shadow, unseen, law.code, law.numbers)

    benchmark.pedantic(shade, rounds=1, warmup_rounds=1)
    light, part = median_s(shadows, shade)
    count = len(suns) * SIZE**2
    note(benchmark, law, share=part / (light + part), ns_a_node=1e9 * part / count)


@pytest.mark.parametrize("name", LAWS)
def test_lanes_against_the_law_in_double(benchmark, name):
    """Speed of the image of lit nodes in single precision relative to the model in double
    precision.
    """
    law, sun, camera = reflectance_model(name), direction_enu(30.0, 50.0), direction_enu(0.0, 90.0)
    none = np.zeros(planes().shape[1:], np.bool_)
    normals = planes().reshape(3, -1).astype(float)
    mu0, mu = sun @ normals, camera @ normals
    cos_g = np.full(mu0.size, float(sun @ camera))

    def single() -> None:
        shade_nodes(planes(), sun, camera, none, none, law.code, law.numbers)

    def double() -> None:
        factors(mu0, mu, cos_g, law.code, law.numbers)

    benchmark.pedantic(single, rounds=1, warmup_rounds=1)
    quick, exact = median_s(single, double)
    benchmark.extra_info.update(
        {
            "times": round(exact / quick, 1),
            "ns single": round(1e9 * quick / mu0.size, 2),
            "ns double": round(1e9 * exact / mu0.size, 1),
        }
    )
