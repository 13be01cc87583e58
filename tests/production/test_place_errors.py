"""Error models by place: each candidate is evaluated as alone with its own model."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.products import DEGREE_M, geotiff
from helpers.random_scenes import make

from lcp_catalog.dem.error_maps import errors_of_file
from lcp_catalog.landmarks.error_model import ErrorModel
from lcp_catalog.landmarks.selection import Places
from lcp_catalog.production.area_job import _place_errors
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.error_config import ErrorConfig
from lcp_catalog.production.evaluation import STEP, PlaceErrors, evaluate
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build
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


def test_figures_are_rounded_to_a_fortieth_of_metres_whatever_the_model_is() -> None:
    """So a place has the same model in every build; NaN: the model's own."""
    rng = np.random.default_rng(2)
    sigma, length = rng.uniform(0.1, 30.0, 200), rng.uniform(5.0, 900.0, 200)
    sigma[:5], length[:5] = np.nan, np.nan
    found = PlaceErrors.of_heights(ERRORS, sigma, length)
    assert all(found.models[k] == ERRORS for k in found.which[:5])
    for place in range(5, 200):
        model = found.models[found.which[place]]
        assert abs(np.log(model.height_sigma_m / sigma[place])) <= 0.5001 * STEP
        assert abs(np.log(model.height_length_m / length[place])) <= 0.5001 * STEP
        own = {"height_sigma_m": ERRORS.height_sigma_m, "height_length_m": ERRORS.height_length_m}
        assert dataclasses.replace(model, **own) == ERRORS
    assert len(set(found.models)) == len(found.models)
    other = dataclasses.replace(ERRORS, height_sigma_m=7.1, height_length_m=333.0)
    again = PlaceErrors.of_heights(other, sigma, length)
    for place in range(5, 200):
        assert again.models[again.which[place]] == found.models[found.which[place]]


def test_few_figures_are_kept_as_they_are() -> None:
    sigma, length = np.array([2.0, 24.5, 2.0]), np.array([4.1, 530.0, 4.1])
    found = PlaceErrors.of_heights(ERRORS, sigma, length, step=None)
    own = [(found.models[k].height_sigma_m, found.models[k].height_length_m) for k in found.which]
    assert own == [(2.0, 4.1), (24.5, 530.0), (2.0, 4.1)]


def test_a_place_has_its_own_error_of_place(sweep: Sweep) -> None:
    """It adds to both axes, in squares, and changes nothing else."""
    rows, cols = np.array([30, 34]), np.array([36, 30])
    nan = np.full(2, np.nan)
    base = evaluate(sweep, rows, cols, CONFIG, PlaceErrors.of_heights(ERRORS, nan, nan))
    places = PlaceErrors.of_heights(ERRORS, nan, nan, place_m=np.array([3.0, np.nan]))
    found = evaluate(sweep, rows, cols, CONFIG, places.rows(np.array([0, 1])))
    np.testing.assert_allclose(found.sigma_major_m[0], np.hypot(base.sigma_major_m[0], 3.0), 1e-5)
    np.testing.assert_array_equal(found.sigma_major_m[1], base.sigma_major_m[1])
    np.testing.assert_array_equal(found.detection, base.detection)


def two_products(folder: Path) -> list[Path]:
    """Two maps of no known product, side by side at 4 E: rough ground, and the same four times as smooth."""
    rough = np.random.default_rng(5).normal(size=(400, 800)).astype(np.float32)
    step = DEGREE_M / 100.0
    return [
        geotiff(
            folder / f"{name}.tif", 60.0 * px * cv2.GaussianBlur(rough, (0, 0), px)[:, part],
            (4.0 * k) * DEGREE_M, 28.0 * DEGREE_M, step,
        )
        for k, (name, px, part) in enumerate(
            [("west", 1.5, np.s_[:400]), ("east", 6.0, np.s_[400:])]
        )
    ]  # fmt: skip


@pytest.mark.parametrize("given", [None, 10.0])
def test_errors_of_a_place_do_not_follow_the_region(tmp_path: Path, given: float | None) -> None:
    """Of two regions in which one and the other of two products has the larger part."""
    dems = two_products(tmp_path)
    recipes = []
    for west, east in ((2.0, 4.6), (3.4, 6.0)):
        area = AreaConfig(bounds_deg=(west, 25.0, east, 27.0), gsd_m=1000.0)
        errors = ErrorConfig(height_sigma_m=given)
        config = dataclasses.replace(CONFIG, area=area, points=PointConfig(), errors=errors)
        recipes.append(Build.plan(dems, config).recipe)
    one, other = recipes
    assert one.errors.position_sigma_m != other.errors.position_sigma_m
    at = Places(np.array([3.5, 3.9, 4.1, 4.5]), np.full(4, 26.0))
    product = one.dems.product_at(at.lon_deg, at.lat_deg)
    assert len(set(product.tolist())) == 2
    found = [_place_errors(recipe, at, product) for recipe in recipes]
    models = [[places.models[k] for k in places.which] for places in found]
    for a, b in zip(*models, strict=True):
        assert (a.height_sigma_m, a.height_length_m) == (b.height_sigma_m, b.height_length_m)
    np.testing.assert_array_equal(found[0].place_sigma_m(1.0), found[1].place_sigma_m(1.0))
    length = np.array([errors_of_file(one.dems.dems[k]).length_m for k in product])
    np.testing.assert_allclose(found[0].place_sigma_m(1.0), 38.0 / 530.0 * length)
    if given:
        assert {model.height_sigma_m for model in models[0]} == {given}


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
