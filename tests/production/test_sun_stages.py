"""What stops candidates under the Suns of a cell: the worst corner, and the margin between the corners; and what they claim."""

from __future__ import annotations

import dataclasses

import numpy as np
from helpers.small_build import CONFIG

from lcp_catalog.catalog.schema import EVALUATED, LOCALIZABLE, UNOCCLUDED, UNSHADOWED, USABLE, Cause
from lcp_catalog.kernels.sun_moments import UNKNOWN
from lcp_catalog.production.area_job import Candidates
from lcp_catalog.production.config import SunConfig, ViewConfig
from lcp_catalog.production.evaluation import Evaluation
from lcp_catalog.production.finished_area import cell_stages

PLAN = dataclasses.replace(
    CONFIG,
    sun=SunConfig((75.0, 90.0), (5.0, 10.0)),
    view=ViewConfig((0.0,), (0.0,), (float("inf"),)),
)


def candidates(condition: list[int], detection: list[float], sigma: list[float]) -> Candidates:
    """Candidates at the equator: flags, detection and sigma under the Sun at 10 deg and azimuth 90; under
    the other three all are usable for sure.
    """
    n = len(condition)
    result = Evaluation.empty(n, 1, (1, 2, 2))
    result.condition[:], result.detection[:], result.sigma_major_m[:] = USABLE, 1.0, 30.0
    result.condition[:, 0, 1, 1] = condition
    result.detection[:, 0, 0, 1, 1] = detection
    result.sigma_major_m[:, 0, 0, 1, 1] = sigma
    place = np.zeros(n)
    return Candidates(
        place, place, place, np.zeros((n, 1, 1), np.float32), np.zeros(n, np.int16), result
    )


def test_the_worst_corner_decides() -> None:
    free = EVALUATED | UNSHADOWED | UNOCCLUDED
    flags = [USABLE, USABLE, EVALUATED, EVALUATED, free | LOCALIZABLE, USABLE - UNOCCLUDED]
    chances = [1.0, 0.91, 0.0, 0.0, 0.5, 1.0]
    sigmas = [30.0, 30.0, np.inf, 30.0, 30.0, 30.0]
    found = cell_stages(candidates(flags, chances, sigmas), PLAN)
    assert found[:, 0].tolist() == [
        Cause.FEW,
        Cause.MARGINAL,  # 0.91 is enough at the corner, but not for the rule between the corners
        Cause.DARK,
        Cause.FEATURELESS,
        Cause.AMBIGUOUS,
        Cause.DEPENDENT,
    ]
    assert (found[:, 1:4] == 0).all()  # the last of each axis begins no cell
    # in steps of 0.004; only where it can be a point
    assert found[:, 7].tolist() == [250, 228, 0, 0, 125, 0]
    assert (found[:, 4:7] == 250).all()


def test_points_that_are_not_usable_count_where_a_probability_is_promised() -> None:
    """Not where the patch is hidden; a Sun that is not evaluated is known as such."""
    points = dataclasses.replace(PLAN.points, per_view=None, located_probability=0.99)
    plan = dataclasses.replace(PLAN, points=points)
    flags = [EVALUATED | UNSHADOWED | UNOCCLUDED] * 5 + [USABLE - UNOCCLUDED]
    chances = [1.0, 0.8, 0.4, 0.2, np.nan, 1.0]
    given = candidates(flags, chances, [30.0] * 6)
    given.evaluation.condition[:, 0, 0, 0] = 0
    found = cell_stages(given, plan)
    assert found[:, 7].tolist() == [250, 200, 100, 50, 0, 0]
    assert (found[:, 4] == UNKNOWN).all()


def test_without_candidates_there_are_no_rows() -> None:
    assert cell_stages(candidates([], [], []), PLAN).shape == (0, 8)
