"""Error models by place: each candidate is evaluated as alone with its own model."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest
from helpers.random_scenes import make

from lcp_catalog.landmarks.error_model import ErrorModel
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.evaluation import STEP, PlaceErrors, evaluate
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.sweep import Conditions, Sweep, law_of_build, plan_area
from lcp_catalog.rendering.plan import ring_decision

pytestmark = pytest.mark.usefixtures("one_thread")

CELL_M = 20.0
CONFIG = BuildConfig(
    area=AreaConfig(gsd_m=CELL_M),
    sun=SunConfig((0.0, 90.0), (40.0,)),
    view=ViewConfig((0.0,), (0.0,), (math.inf,)),
    points=PointConfig(patch_nodes=17, search_m=12 * CELL_M),
)
ERRORS = ErrorModel(0.03, 0.6, 40.0, 0.05, 100.0)


@pytest.fixture(scope="module")
def sweep() -> Sweep:
    """Hills of 6 m and three nodes at the equator."""
    rough = cv2.GaussianBlur(np.random.default_rng(4).normal(size=(81, 81)), (0, 0), 3.0)
    terrain = make(6.0 * rough / rough.std(), core=(4, 77, 4, 77))
    conditions, choice = Conditions.at(0.0, CONFIG), law_of_build(CONFIG, 0.0)
    everywhere = np.ones_like(conditions.reachable)
    conditions = dataclasses.replace(conditions, reachable=everywhere)
    plan = plan_area(terrain, conditions, CONFIG, choice, ring_decision(terrain, 0.0, 0.0), None)
    return Sweep(terrain, conditions, plan, choice.model, CONFIG.model.precision)


def test_figures_are_rounded_to_a_fortieth_and_the_models_own_is_kept() -> None:
    rng = np.random.default_rng(2)
    sigma, length = rng.uniform(0.1, 30.0, 200), rng.uniform(5.0, 900.0, 200)
    sigma[:3], length[:3] = ERRORS.height_sigma_m, ERRORS.height_length_m
    sigma[3:5], length[3:5] = np.nan, np.nan
    found = PlaceErrors.of_heights(ERRORS, sigma, length)
    assert all(found.models[k] == ERRORS for k in found.which[:5])
    for place in range(5, 200):
        model = found.models[found.which[place]]
        assert abs(np.log(model.height_sigma_m / sigma[place])) <= 0.5001 * STEP
        assert abs(np.log(model.height_length_m / length[place])) <= 0.5001 * STEP
        own = {"height_sigma_m": ERRORS.height_sigma_m, "height_length_m": ERRORS.height_length_m}
        assert dataclasses.replace(model, **own) == ERRORS
    assert len(set(found.models)) == len(found.models)


def test_a_sigma_of_nothing_has_a_model() -> None:
    """A map may state 0 m; the build's own median may be 0, too."""
    for base in (ERRORS, dataclasses.replace(ERRORS, height_sigma_m=0.0)):
        found = PlaceErrors.of_heights(base, np.array([0.0, 5.0]), np.array([np.nan, np.nan]))
        sigma = [found.models[k].height_sigma_m for k in found.which]
        assert sigma[0] <= 1e-3
        assert sigma[1] == pytest.approx(5.0, rel=0.03)


def test_every_candidate_is_evaluated_with_its_own_model(sweep: Sweep) -> None:
    """As a run of all candidates with one model at a time."""
    rows, cols = np.array([30, 34, 38, 42]), np.array([36, 30, 41, 37])
    sigma = np.array([0.6, 3.0, 0.6, 3.0])
    places = PlaceErrors.of_heights(ERRORS, sigma, np.full(4, np.nan))
    assert len(places.models) == 2
    mixed = evaluate(sweep, rows, cols, CONFIG, places)
    for number, model in enumerate(places.models):
        here = places.which == number
        alone = evaluate(sweep, rows, cols, CONFIG, model)
        for field in dataclasses.fields(mixed):
            one, other = getattr(mixed, field.name)[here], getattr(alone, field.name)[here]
            np.testing.assert_array_equal(one, other)
    better, worse = mixed.sigma_major_m[0], mixed.sigma_major_m[3]
    assert np.nanmedian(worse) > np.nanmedian(better)


def test_a_selection_keeps_each_ones_model() -> None:
    places = PlaceErrors.of_heights(ERRORS, np.array([1.0, 9.0, 1.0, 4.0]), np.full(4, 50.0))
    some = places.rows(np.array([3, 1]))
    assert [some.models[k].height_sigma_m for k in some.which] == pytest.approx(
        [4.0, 9.0], rel=0.03
    )
