"""Gaps in the coverage of a set of files, against flood fill and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.bare_files import R_KM, covered, cylinder, plane_rectangle, polar, rectangle
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.dem.coverage import POLAR_ERROR
from lcp_catalog.geometry.bounds import enclosing_bounds


@settings(deadline=None, max_examples=40)
@given(st.lists(st.booleans(), min_size=24, max_size=24))
def test_gaps_are_those_of_flood_fill(present: list[bool]) -> None:
    """Tiles of 45 x 15 degrees all around the Moon, the lowest row whole; gaps by flood fill over the tiles."""
    there = np.vstack([np.reshape(present, (3, 8)), np.ones((1, 8), bool)])  # north to south
    tiles = [(row, col) for row in range(4) for col in range(8) if there[row, col]]
    dems = [cylinder(45 * c + 7, 45 - 15 * r, 45 * c + 52, 60 - 15 * r, 4) for r, c in tiles]
    found = covered(*dems)
    assert found.is_full_ring
    first = int(np.flatnonzero(there.any(axis=1))[0])
    left = {(r, c) for r in range(first, 4) for c in range(8) if not there[r, c]}
    expected = []
    while left:
        todo, piece = [left.pop()], []
        while todo:
            r, c = todo.pop()
            piece.append((r, c))
            near = {(r - 1, c), (r + 1, c), (r, (c + 1) % 8), (r, (c - 1) % 8)} & left
            left -= near
            todo += near
        expected.append(
            (
                sum(rectangle(0, 45 - 15 * r, 45, 60 - 15 * r) for r, _ in piece),
                any(r == first for r, _ in piece),
            )
        )
    assert [gap.area_km2 for gap in found.gaps] == pytest.approx(
        sorted((a for a, _ in expected), reverse=True), rel=1e-9
    )
    key = [(round(a), edge) for a, edge in expected]
    assert sorted((round(gap.area_km2), gap.at_edge) for gap in found.gaps) == sorted(key)


def test_a_gap_over_the_meridian_of_the_box_is_one_piece() -> None:
    ring = [cylinder(0, -20, 360, -10), cylinder(0, 10, 360, 20), cylinder(20, -10, 340, 10)]
    (gap,) = covered(*ring).gaps
    assert tuple(gap.bounds) == pytest.approx((-20, -10, 20, 10))
    assert gap.area_km2 == pytest.approx(rectangle(-20, -10, 20, 10), rel=1e-9)
    assert not gap.at_edge


@pytest.mark.slow
def test_a_narrow_gap_that_runs_aslant_is_one_piece() -> None:
    """A strip of 2 x 200 km beside the pole between two polar maps: its longitudes change by 53 degrees."""
    found = covered(
        polar(-149, -100, 198, 200),
        polar(51, -100, 49, 200),
        polar(-149, -150, 249, 50),
        polar(-149, 100, 249, 50),
    )
    (gap,) = [gap for gap in found.gaps if not gap.at_edge]
    assert gap.area_km2 == pytest.approx(
        plane_rectangle(49, -100, 51, 100), abs=POLAR_ERROR * 49 * 200
    )  # of the narrowest file
    away = math.degrees(math.atan2(49, 100))
    assert (gap.bounds.west, gap.bounds.east) == pytest.approx((away, 180.0 - away), abs=0.2)
    assert gap.bounds.north == pytest.approx(
        90.0 - 2.0 * math.degrees(math.atan(49 / 2 / R_KM)), abs=0.01
    )


def test_a_gap_that_holds_the_pole_is_not_at_the_edge() -> None:
    (gap,) = covered(cylinder(0, 60, 360, 70), cylinder(0, 60, 90, 90)).gaps
    assert gap.area_km2 == pytest.approx(rectangle(90, 70, 360, 90), rel=1e-9)
    assert tuple(gap.bounds) == pytest.approx((90, 70, 360, 90))
    assert not gap.at_edge


def test_the_box_around_arcs_knows_those_that_come_round() -> None:
    """300..500 covers 300..360 and 0..140, so that nothing is free between 101 and 140."""
    box = enclosing_bounds(
        np.array([300.0, 155.0, 100.0]), np.array([500.0, 290.0, 101.0]), -1.0, 1.0
    )
    assert tuple(box) == (155.0, -1.0, 500.0, 1.0)
    assert tuple(enclosing_bounds(np.array([350.0, 0.0]), np.array([360.0, 5.0]), -1.0, 1.0)) == (
        -10.0,
        -1.0,
        5.0,
        1.0,
    )
    assert tuple(
        enclosing_bounds(np.array([10.0, 200.0]), np.array([210.0, 370.0]), -1.0, 1.0)
    ) == (
        0.0,
        -1.0,
        360.0,
        1.0,
    )
