"""``compare_points``: points lost, gained and moved, counted by hand."""

from __future__ import annotations

import dataclasses
import math

import pytest
from helpers.trades import CONFIG, candidates

from lcp_catalog.catalog.schema import EVALUATED, USABLE
from lcp_catalog.landmarks.selection import stable_id
from lcp_catalog.production.area_job import Candidates
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.tradeoff.point_changes import compare_points


def test_lost_gained_and_moved_points_by_hand() -> None:
    """Spacing 16 km. A stays, B is lost, C moves by one cell, D is gained; E is a candidate in both
    and chosen in neither.
    """
    a, b, c, c2, d, e = (0.0, 0.0), (3.0, 0.0), (6.0, 0.0), (6.02, 0.0), (9.0, 0.0), (12.0, 0.0)
    off = EVALUATED
    before = Candidates(
        *candidates([a, b, c, e], [[USABLE, USABLE], [USABLE, off], [USABLE, USABLE], [off, off]])
    )
    states = [[USABLE, USABLE], [off, 0], [USABLE, USABLE], [off, off], [USABLE, off]]
    after = Candidates(*candidates([d, e, c2, b, a], states))
    before.evaluation.sigma_major_m[0, 0, 0, :, 0] = [20.0, 30.0]
    after.evaluation.sigma_major_m[4, 0, 0, :, 0] = [
        21.0,
        99.0,
    ]  # 99 where A is not usable any more
    # at two image scales: of A 0.2 and 0.04 more, of E unknown in one; of D, which is new, it does not count
    before.evaluation.detection[:] = 0.5
    after.evaluation.detection[:] = 0.5
    after.evaluation.detection[4, 0, 0, 1, 0], after.evaluation.detection[4, 1, 0, 0, 0] = 0.7, 0.46
    after.evaluation.detection[0] = 0.9
    before.evaluation.detection[3] = math.nan
    points = PointConfig(spacing_m=16_000.0)
    found = compare_points(before, after, dataclasses.replace(CONFIG, points=points))
    assert (found.points, found.points_lost, found.points_gained, found.points_moved) == (3, 2, 2, 1)  # fmt: skip
    # A, B and E are in both: 2 + 2 + 1 conditions evaluated in both, of which one each of A and B changed
    assert found.conditions_changed_share == pytest.approx(2 / 5)
    assert found.detection_changed_share == pytest.approx(1 / 8)  # of A and B
    assert found.detection_change_max == pytest.approx(0.2)
    assert found.localization_sigma_change_m.median == pytest.approx(9.0)
    assert found.localization_sigma_change_share.p95 == pytest.approx(9.0 / 30.0)


def test_equal_sets_in_another_order_differ_in_nothing() -> None:
    places = [(0.0, 0.0), (3.0, 1.0), (6.0, -1.0)]
    states = [[USABLE, EVALUATED], [USABLE, USABLE], [EVALUATED, USABLE]]
    one = Candidates(*candidates(places, states))
    other = Candidates(*candidates(places[::-1], states[::-1]))
    found = compare_points(one, other, CONFIG)
    assert (found.points, found.points_lost, found.points_gained) == (3, 0, 0)
    assert found.conditions_changed_share == 0.0
    assert len(set(stable_id(one.lon_deg, one.lat_deg).tolist())) == 3


def test_nothing_in_common_has_no_shares() -> None:
    one = Candidates(*candidates([(0.0, 0.0)], [[USABLE, USABLE]]))
    none = Candidates(*candidates([], []))
    found = compare_points(one, none, CONFIG)
    assert (found.points, found.points_lost, found.points_gained) == (0, 1, 0)
    assert found.conditions_changed_share is None
    assert found.detection_changed_share is None
    assert found.localization_sigma_change_m.median is None
