"""Cells between Suns: what is needed at the corners is enough under every Sun in the cell."""

from __future__ import annotations

import numpy as np
import pytest

from lcp_catalog.catalog.prediction import BETWEEN_MARGIN, BEYOND_MARGIN
from lcp_catalog.catalog.sun_cells import SunCells
from lcp_catalog.ephemeris.solar_position import reachable_suns

ELEVATIONS, AZIMUTHS = np.array([5.0, 10.0, 15.0, 20.0, 30.0, 45.0]), np.arange(0.0, 360.0, 15.0)


def logit(p: float) -> float:
    return float(np.log(p / (1.0 - p)))


@pytest.mark.parametrize("latitude", [0.0, 26.0, -45.0, 80.0])
def test_the_least_probability_is_enough_under_random_suns(latitude: float) -> None:
    """A point with exactly the least probability at the corners that count, and nothing known at the
    others, by the rule of the claims written out here; and it is no more than 3 % too high.
    """
    rng = np.random.default_rng(5)
    cells = SunCells.of(ELEVATIONS, AZIMUTHS)
    known = reachable_suns(latitude, AZIMUTHS, ELEVATIONS)
    claims = cells.claims(latitude, known, 0.9)
    corners = cells.corners()
    for row, column in np.argwhere(claims.exists):
        slack = []
        for up, on in rng.random((400, 2)):
            e = np.radians(ELEVATIONS[row] + up * (ELEVATIONS[row + 1] - ELEVATIONS[row]))
            a, lat = np.radians(AZIMUTHS[column] + on * 15.0), np.radians(latitude)
            sine = np.sin(lat) * np.sin(e) + np.cos(lat) * np.cos(e) * np.cos(a)
            if abs(sine) > np.sin(np.radians(1.54)):
                continue
            weights = np.array([(1 - up) * (1 - on), (1 - up) * on, up * (1 - on), up * on])
            there = np.array(
                [known[r[row, column], c[row, column]] for r, c in zip(*corners, strict=True)]
            )
            own = weights * there
            if own.sum() < 0.5:
                continue
            assert claims.counts[:, row, column][there & (weights > 0.02)].all()
            margin = BETWEEN_MARGIN * (1 - (own**2).sum()) + BEYOND_MARGIN * (1 - own.sum())
            slack.append(logit(claims.least[row, column] / 250.0) - margin - logit(0.9))
        if slack:
            assert min(slack) > -0.03
        if len(slack) > 300:
            assert min(slack) < 0.15


def test_steps_that_are_too_wide_have_no_cell_between_them() -> None:
    wide = SunCells.of([10.0, 30.0, 75.0], [60.0, 90.0, 270.0])
    assert wide.above.tolist() == [1, -1, 2]
    assert wide.after.tolist() == [1, -1, 2]
    around = SunCells.of([10.0], [0.0, 60.0, 120.0, 180.0, 240.0, 300.0])
    assert around.above.tolist() == [0]
    assert around.after.tolist() == [1, 2, 3, 4, 5, 0]


def test_a_direction_alone_counts_where_it_is_evaluated() -> None:
    """Its probability needs no margin."""
    cells = SunCells.of([10.0], [90.0, 270.0])
    known = np.array([[True, False]])
    claims = cells.claims(26.0, known, 0.9)
    assert claims.exists.tolist() == [[True, False]]
    assert claims.least[0, 0] == 225
