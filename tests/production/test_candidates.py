"""Candidates of an area: a place that is good under a few Suns is found beside those that are good under
all.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.random_scenes import make

from lcp_catalog.landmarks.corners import candidates
from lcp_catalog.production import area_job
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.sweep import Conditions, Sweep, law_of_build, plan_area
from lcp_catalog.rendering.plan import ring_decision

pytestmark = pytest.mark.usefixtures("one_thread")

CELL_M, NODES, HALO = 20.0, 120, 8
FLANK = np.s_[72:82]
"""Columns of the east flank of a ridge."""


def ridge() -> np.ndarray:
    """Cones on a plain, and a ridge from north to south, 30 deg steep in the east, with cones on its
    flank.
    """
    row, col = np.mgrid[:NODES, :NODES].astype(float)
    z = 2.0 * np.sin(0.35 * col) * np.sin(0.35 * row) * (col < 55)  # texture under all Suns
    height = np.interp(col, [55.0, 71.0, 83.0], [0.0, 140.0, 0.0])
    for middle in (20, 40, 60, 80, 100):
        away = np.hypot(row - middle, col - 77.0)
        height += np.maximum(0.0, 16.0 - 5.0 * away)
    return (z + height).astype(np.float32)


def swept() -> Sweep:
    """One Sun in the east and three in the west, all 20 deg high."""
    made = BuildConfig(
        area=AreaConfig(gsd_m=CELL_M),
        sun=SunConfig((90.0, 255.0, 270.0, 285.0), (20.0,)),
        view=ViewConfig((0.0,), (0.0,), (math.inf,)),
        points=PointConfig(patch_nodes=9, search_m=4 * CELL_M),
    )
    terrain = make(ridge(), core=(4, NODES - 4, 4, NODES - 4))
    conditions = Conditions.at(0.0, made)
    conditions = replace(conditions, reachable=np.ones_like(conditions.reachable, dtype=bool))
    choice = law_of_build(made, 0.0)
    plan = plan_area(terrain, conditions, made, choice, ring_decision(terrain, 0.0, 0.0), None)
    return Sweep(terrain, conditions, plan, choice.model, made.model.precision)


def on_the_flank(cols: np.ndarray) -> int:
    return int(((cols + 4 >= FLANK.start) & (cols + 4 < FLANK.stop)).sum())


def test_texture_that_one_sun_shows_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = swept()
    shape = sweep.planes.shape[1:]
    lit = {image.azimuth: (image.radiance[:, 68:76] > 0.0).mean() for image in sweep.images()}
    assert lit[0] > 0.9  # the flank; under the Suns in the west it is dark
    assert max(lit[k] for k in (1, 2, 3)) < 0.4
    every = np.ones(shape, np.bool_)
    core = SimpleNamespace(
        z=np.zeros(shape, np.float32), halo=HALO, inner=np.s_[HALO:-HALO, HALO:-HALO], mine=every,
        useful=every, origin=(0, 0),
    )  # fmt: skip
    points = PointConfig(patch_nodes=9, spacing_m=112 * CELL_M, per_view=0)
    found = area_job._find(sweep, core, BuildConfig(AreaConfig(gsd_m=CELL_M), points=points))
    assert on_the_flank(found[1]) == 1

    def of_the_mean(score, groups, **how):
        return candidates(score, **how)

    monkeypatch.setattr(area_job, "candidates_of_groups", of_the_mean)
    assert (
        on_the_flank(
            area_job._find(sweep, core, BuildConfig(AreaConfig(gsd_m=CELL_M), points=points))[1]
        )
        == 0
    )


def test_groups_of_suns() -> None:
    """Low, middle and high, each in the north, east, south and west, by hand."""
    config = BuildConfig(
        sun=SunConfig((0.0, 44.0, 46.0, 134.0, 180.0, 226.0, 316.0), (5.0, 12.5, 60.0))
    )
    found = Conditions.at(0.0, config).sun_groups
    assert found.tolist() == [
        [0, 0, 1, 1, 2, 3, 0],
        [4, 4, 5, 5, 6, 7, 4],
        [8, 8, 9, 9, 10, 11, 8],
    ]
