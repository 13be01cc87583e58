"""Frames that a plan expects to be located: against sets of points counted one by one, and patches that are strewn."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lcp_catalog.catalog.schema import DETECTION_STEP
from lcp_catalog.landmarks.ground_votes import VoteTable, ground_shows, independent_share
from lcp_catalog.landmarks.located import WEIGHTS, chance_of, needed
from lcp_catalog.matching.joint_detection import at_least_found
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.planned_frames import SampledPoints, planned_frames

CLAIMS = (0.05, 0.3, 0.6, 0.9)
OFFSETS = 67**2
FOOTPRINT_M, GSD_M = 150e3, 474.0


@pytest.fixture(scope="module")
def config() -> BuildConfig:
    return BuildConfig.from_dict(
        {
            "area": {"center_deg": [3.5, 26.0], "size_km": 150.0, "gsd_m": GSD_M},
            "sun": {"elevations_deg": [10.0, 20.0, 30.0, 45.0], "azimuths_deg": [90.0, 105.0]},
        }
    )


@pytest.mark.parametrize("numbers", [(0, 0, 0, 13), (8, 20, 6, 0), (40, 30, 0, 0), (5, 5, 5, 5)])
def test_numbers_of_points_are_as_points_one_by_one(numbers: tuple[int, ...]) -> None:
    points, table = np.repeat(CLAIMS, numbers), VoteTable(CLAIMS, OFFSETS)
    given = np.array([numbers], np.float64)
    shown = table.shows(given, np.array([0.6]))[0]
    np.testing.assert_allclose(shown, ground_shows(points, OFFSETS, 0.6), atol=1e-12)
    chance = chance_of(GSD_M)
    least = needed(len(points), float(points.mean()), chance)
    assert table.found(given, chance)[0] @ WEIGHTS == pytest.approx(
        at_least_found(points)[least], abs=0.03
    )


def test_strewn_patches_overlap_as_assumed() -> None:
    """Points at random in a circle: their independent number by their overlaps."""
    rng, side = np.random.default_rng(1), 32 * GSD_M
    for count in (40, 120):
        shares = []
        for _ in range(20):
            away, turn = FOOTPRINT_M / 2 * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
            places = np.stack([away * np.cos(turn), away * np.sin(turn)], axis=1)
            shares.append(independent_share(places, side))
        area = math.pi / 4.0 * FOOTPRINT_M**2
        assert 1.0 / (1.0 + count * side**2 / area) == pytest.approx(np.mean(shares), rel=0.12)


def test_a_footprint_holds_as_many_as_its_area_says(config: BuildConfig) -> None:
    """Two areas of half a footprint (less its border) with 12 and 18 points of 0.5 are as one footprint with 30; where terrain
    hides them none is located, and Suns that do not occur have no row.
    """
    area = math.pi / 4.0 * (FOOTPRINT_M - math.hypot(32, 32) * GSD_M) ** 2
    elevations = len(config.sun.elevations_deg)
    shape = (len(config.view), elevations, len(config.sun.azimuths_deg))
    occurs = np.ones(shape, bool)
    occurs[:, 3:] = False

    def sample(count: int) -> SampledPoints:
        detection = np.full((count, *shape), 0.5)
        detection[:, :, 1] = 0.0
        return SampledPoints(detection, occurs, 1.0)

    found = planned_frames([sample(12), sample(18)], area, FOOTPRINT_M, config)
    assert [row["sun_elevation"] for row in found] == list(config.sun.elevations_deg[:3])
    share = 1.0 / (1.0 + 30 * (32 * GSD_M) ** 2 / area)
    ground = ground_shows(np.full(30, 0.5), OFFSETS, share) @ WEIGHTS
    by_points = at_least_found(np.full(30, 0.5))[needed(30, 0.5, chance_of(GSD_M))]
    for k in (0, 2):
        assert found[k]["by_points"] == pytest.approx(by_points, abs=0.02)
        assert found[k]["with_ground"] >= max(found[k]["by_points"], ground - 1e-4)
        assert found[k]["with_ground"] <= found[k]["by_points"] + ground
    assert found[1] == {
        "sun_elevation": config.sun.elevations_deg[1],
        "by_points": 0.0,
        "with_ground": pytest.approx(0.0, abs=1e-3),
    }
    assert DETECTION_STEP * round(0.5 / DETECTION_STEP) == 0.5
