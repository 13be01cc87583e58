"""Cost of an environment map relative to a point Sun, and of its parts; measured figures are in
docs/measurements/accuracy.md.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import nadir_view
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light.environment_sources import split_sources
from lcp_catalog.light.sky_sampling import sky_at_nodes
from lcp_catalog.light.sources import Lighting
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.renderer import render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.environment_maps import Lamp, cie_sky, with_lamps
from helpers.synthetic import cratered

GSD, SIDE = 20.0, 1024


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    """1024 x 1024: a cratered square, mirrored so that its copies join without a step."""
    z = cratered(SIDE // 2, GSD)
    field = Heightfield(np.block([[z, z[:, ::-1]], [z[::-1], z[::-1, ::-1]]]), GSD)
    window = NodeWindow(0, SIDE, 0, SIDE)
    index = np.zeros((SIDE, SIDE), np.int16)
    return Terrain(field, EnuFrame(0.0, 0.0), field.whole, window, index, ("made",))


@pytest.fixture(scope="module")
def light() -> Lighting:
    """A clear sky with its Sun and a lamp."""
    sky = with_lamps(cie_sky(512, 120.0, 30.0), [Lamp(120, 30, 8, 0.3), Lamp(300, 50, 1, 2)])
    return Lighting.of_panorama(split_sources(sky))


def seconds(task, *arguments, **how) -> float:
    start = time.perf_counter()
    task(*arguments, **how)
    return time.perf_counter() - start


@pytest.mark.parametrize("law", ["lommel-seeliger", "hapke"])
@pytest.mark.parametrize("tier", ["draft", "standard", "high"])
def test_panorama_against_a_sun(benchmark, terrain, light, tier, law):
    """Whole renders in turn; ``ratio`` of the best times, ``share`` of the sky in the time with a
    panorama.
    """
    how = {"model": reflectance_model(law), "accuracy": TIERS[tier]}
    sun = Lighting.of_sun(direction_enu(120.0, 30.0))
    render_enu(terrain, sun, nadir_view(), **how)
    one = min(seconds(render_enu, terrain, sun, nadir_view(), **how) for _ in range(3))
    asked = terrain, light, nadir_view()
    benchmark.pedantic(render_enu, asked, how, rounds=2, warmup_rounds=1)
    if benchmark.stats:
        best = benchmark.stats.stats.min
        sky = seconds(sky_at_nodes, terrain, light.sky, nadir_view(), how["model"], TIERS[tier])
        benchmark.extra_info["ratio"] = round(best / one, 1)
        benchmark.extra_info["share"] = round(sky / best, 2)


def test_finding_the_sources(benchmark):
    """Sources of a panorama of 8192 x 4096."""
    sky = with_lamps(cie_sky(4096, 120.0, 30.0), [Lamp(120, 30, 8, 0.3), Lamp(300, 50, 1, 2)])
    benchmark.pedantic(split_sources, (sky,), rounds=2)
