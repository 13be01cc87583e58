"""Builds of the whole Moon, on virtual files of coarse cells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.virtual_moon import virtual_moon

from lcp_catalog.build.config import AreaConfig, BuildConfig, ModelConfig, SunConfig, ViewConfig
from lcp_catalog.build.estimate import estimate
from lcp_catalog.build.run import Build

NADIR = ViewConfig((0.0,), (0.0,), (float("inf"),))
COARSE = BuildConfig(
    area=AreaConfig(bounds_deg=(-180.0, -90.0, 180.0, 90.0)),
    sun=SunConfig((88.0, 90.0), (18.0, 20.0)),
    view=NADIR,
    model=ModelConfig(direction_tolerance_deg=10.0),
)
"""Areas of 14 degrees; at those azimuths the Sun is low near the equator only."""


@pytest.fixture(scope="module")
def moon(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return virtual_moon(tmp_path_factory.mktemp("moon"), 4, tile_px=256)


def test_the_estimate_is_taken_from_areas_that_the_sun_reaches(moon: list[Path]) -> None:
    build = Build.plan(moon, COARSE)
    lit = [job for job in build.jobs if job.work]
    assert 0 < len(lit) < len(build.jobs) / 2
    belt = (-180.0, -6.0, 180.0, 6.0)
    alone = Build.plan(moon, replace(COARSE, area=AreaConfig(bounds_deg=belt)))
    whole, part = estimate(build, 1), estimate(alone, 1)
    assert whole["bytes_estimate"] > 0.3 * part["bytes_estimate"]
    assert whole["seconds_estimate"] < 30.0 * part["seconds_estimate"]
