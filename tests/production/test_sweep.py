"""The images of an area, compared with renders of the same terrain, and the scene plan that they follow."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.random_scenes import STANDARD, make

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import ParallelView, oblique_view
from lcp_catalog.choices import REFLECTANCE_MODELS
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.light.bounced_light import bounced_bound
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.production import sweep as module
from lcp_catalog.production.area_job import area_sweep
from lcp_catalog.production.build_decisions import of_a_build
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.run import Build
from lcp_catalog.production.sweep import Conditions, Sweep, law_of_build, plan_area
from lcp_catalog.rendering.decisions import DISC_SHIFT, Decision, MergedDecision
from lcp_catalog.rendering.plan import ScenePlan, plan_scene, ring_decision
from lcp_catalog.rendering.renderer import Method, render_enu

pytestmark = pytest.mark.usefixtures("one_thread")

DEM = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"

CONFIG = BuildConfig(
    area=AreaConfig(center_deg=(3.5, 26.0), size_km=20.0, gsd_m=474.0),
    sun=SunConfig((90.0, 270.0), (5.0, 30.0)),
    view=ViewConfig((0.0, 40.0), (0.0, 90.0), (math.inf, 100.0)),
    points=PointConfig(patch_nodes=9, search_m=4000.0),
    model=ModelConfig(direction_tolerance_deg=0.3, ring_max_km=40.0, albedo="none"),
)


@pytest.fixture(scope="module")
def build() -> Build:
    return Build.plan((DEM,), CONFIG)


def swept(terrain, config=CONFIG) -> Sweep:
    """The sweep of a terrain that was not read from a DEM."""
    conditions, choice = Conditions.at(26.0, config), law_of_build(config, 26.0)
    beyond = ring_decision(terrain, 0.0, 0.0)
    plan = plan_area(terrain, conditions, config, choice, beyond, None)
    return Sweep(terrain, conditions, plan, choice.model, config.model.precision)


def rough(seed=1, scale=30.0):
    return make(np.random.default_rng(seed).normal(size=(21, 23)) * scale, core=(4, 17, 4, 19))


def test_an_image_of_a_build_is_the_render_of_the_same_scene(build: Build) -> None:
    """All Suns and views, every reflectance model, every tier that a render shades in float32."""
    job = build.jobs[0]
    given = area_sweep(job)
    for tier in ("draft", "standard", "high"):
        for model in map(reflectance_model, REFLECTANCE_MODELS):
            sweep = dataclasses.replace(given, accuracy=TIERS[tier], model=model)
            for image in sweep.images():
                sun = sweep.conditions.sun_directions()[image.elevation, image.azimuth]
                view = ParallelView(sweep.conditions.view_directions()[image.view])
                how = {"model": model, "accuracy": sweep.accuracy, "disc": False}
                for plan in (sweep.plan, None):  # the area's, and the render's own
                    render = render_enu(sweep.terrain, sun, view, Method(plan=plan, **how))
                    np.testing.assert_array_equal(image.radiance, render.radiance)


@pytest.mark.slow
def test_a_sweep_with_bounced_light_is_the_render_with_it() -> None:
    """`model.bounce`: dark nodes get the light of other ground, of an oblique view and in stacks, too."""
    config = CONFIG.replaced({"model.bounce": "on"})
    job = Build.plan((DEM,), config.replaced({"area.size_km": 6.0})).jobs[0]
    sweep, dim = area_sweep(job), job.recipe.config.replaced({"model.bounce": "off"})
    plain = area_sweep(dataclasses.replace(job, recipe=dataclasses.replace(job.recipe, config=dim)))
    assert sweep.plan.bounces
    assert not plain.plan.bounces
    how = Method(plan=sweep.plan, model=sweep.model, accuracy=sweep.accuracy, disc=False)
    brighter = 0
    for image, without in zip(sweep.images(), plain.images(), strict=True):
        sun = sweep.conditions.sun_directions()[image.elevation, image.azimuth]
        view = ParallelView(sweep.conditions.view_directions()[image.view])
        np.testing.assert_array_equal(
            image.radiance, render_enu(sweep.terrain, sun, view, how).radiance
        )
        other = image.radiance != without.radiance
        other &= np.isfinite(image.radiance)
        assert (without.radiance[other] == 0.0).all()
        brighter += np.count_nonzero(other)
    assert brighter > 100
    (stack,) = sweep.stacks(1000)
    np.testing.assert_array_equal(stack.radiance, [i.radiance for i in sweep.images()])


@pytest.mark.parametrize(
    ("scale", "shadows", "occlusion"), [(0.0, False, False), (0.5, True, False), (30.0, True, True)]
)
def test_a_sweep_computes_what_its_plan_says(monkeypatch, scale, shadows, occlusion) -> None:
    sweep = swept(rough(scale=scale))
    assert sweep.plan.cast_shadows.modelled == shadows
    assert sweep.plan.occlusion.modelled == occlusion
    called = set()
    for name in ("occluded", "occluded_sweep"):
        original = getattr(module, name)
        monkeypatch.setattr(
            module, name, lambda *a, n=name, f=original, **k: (called.add(n), f(*a, **k))[1]
        )
    images = list(sweep.images())
    expected = {"occluded_sweep": shadows, "occluded": occlusion}
    assert called == {name for name, computed in expected.items() if computed}
    everything = [
        dataclasses.replace(getattr(sweep.plan, name), modelled=True)
        for name in ("cast_shadows", "occlusion")
    ]
    full = dataclasses.replace(
        sweep,
        accuracy=TIERS["reference"],
        plan=dataclasses.replace(sweep.plan, cast_shadows=everything[0], occlusion=everything[1]),
    )
    for image, exact in zip(images, full.images(), strict=True):
        np.testing.assert_array_equal(image.radiance, exact.radiance)


def test_a_sweep_under_a_disc_is_the_render_under_a_disc(build: Build) -> None:
    """`model.sun`: penumbras of the same share; the images differ from those under a point."""
    (job,) = build.jobs[:1]
    config = job.recipe.config.replaced({"model.sun": "disc"})
    disc = area_sweep(
        dataclasses.replace(job, recipe=dataclasses.replace(job.recipe, config=config))
    )
    assert disc.plan.solar_disc.modelled
    how = Method(plan=disc.plan, model=disc.model, accuracy=disc.accuracy, disc=True)
    differs = 0
    for image, point in zip(disc.images((0,)), area_sweep(job).images((0,)), strict=True):
        sun = disc.conditions.sun_directions()[image.elevation, image.azimuth]
        view = ParallelView(disc.conditions.view_directions()[image.view])
        render = render_enu(disc.terrain, sun, view, how)
        np.testing.assert_allclose(image.radiance, render.radiance, rtol=1e-5, atol=1e-7)
        differs += int((image.radiance != point.radiance).sum())
    assert differs > 10
    (stack,) = disc.stacks(1000, (0,))
    np.testing.assert_array_equal(stack.radiance, [i.radiance for i in disc.images((0,))])


def test_the_plan_of_an_area_is_a_renders_under_its_lowest_sun_and_view() -> None:
    terrain, parallel = rough(), ViewConfig((0.0, 40.0), (0.0, 90.0), (math.inf, math.inf))
    plan = swept(terrain, dataclasses.replace(CONFIG, view=parallel)).plan
    json.dumps(plan.to_json(), allow_nan=False)
    found = {decision.effect: decision for decision in plan.decisions}
    render = plan_scene(terrain, direction_enu(0, 5.0), oblique_view(40.0, 90.0), accuracy=STANDARD)
    for decision in render.decisions:
        there = found[decision.effect]
        if decision.effect not in ("perspective", "solar disc"):
            assert (there.modelled, there.unit) == (decision.modelled, decision.unit)
        # the cost of the reflectance model is that of the whole build, not of one image
        if decision.effect not in ("perspective", "reflectance", "solar disc", "scattered light"):
            assert there.error_bound == decision.error_bound
    assert "0.3 to 1.0 % of the usable conditions" in found["scattered light"].reason
    bound = bounced_bound(terrain.field, law_of_build(CONFIG, 26.0).model)
    assert found["scattered light"].error_bound == bound > 0.0
    # a single node is dark or lit; matches shift by what was measured, not below 0.5 deg
    assert found["solar disc"].error_bound == DISC_SHIFT
    lower = dataclasses.replace(CONFIG, view=parallel, sun=SunConfig((90.0,), (0.4, 30.0)))
    assert swept(terrain, lower).plan.solar_disc.error_bound is None
    assert swept(rough(scale=0.0), lower).plan.solar_disc.error_bound == 0.0
    assert "5.000 deg" in plan.cast_shadows.reason
    assert "50.000 deg" in plan.occlusion.reason
    above = dataclasses.replace(CONFIG, view=ViewConfig((0.0,), (0.0,), (math.inf,)))
    plan = swept(terrain, above).plan
    assert not plan.occlusion.modelled
    assert plan.perspective.error_bound == 0.0


def test_the_merged_plan_of_areas_that_differ() -> None:
    flat, hilly, hillier = (swept(rough(scale=scale)).plan for scale in (0.0, 30.0, 60.0))
    assert ScenePlan.merged([("a", flat), ("b", flat)]) == flat
    merged = ScenePlan.merged([("a", flat), ("b", hilly), ("c", hillier)])
    shadows = merged.cast_shadows
    assert (shadows.modelled, shadows.error_bound) == (True, STANDARD.node_error)
    assert shadows.reason == (
        f"modelled in 2 of 3 areas, for example b: {hilly.cast_shadows.reason}; "
        f"not modelled in 1 of 3 areas, for example a: {flat.cast_shadows.reason}"
    )
    assert merged.float_width == flat.float_width


def merged_decision(by_area: dict[str, Decision]) -> Decision:
    merged = MergedDecision()
    for area, decision in by_area.items():
        merged.add(area, decision)
    return merged.decision


def test_a_merged_decision_has_the_largest_error_bound() -> None:
    bounds = {"a": 0.1, "b": 0.3, "c": 0.2}
    by_area = {
        name: Decision("e", False, f"of {name}", bound, "m") for name, bound in bounds.items()
    }
    merged = merged_decision(by_area)
    assert (merged.modelled, merged.error_bound, merged.unit) == (False, 0.3, "m")
    assert merged.reason == "all 3 areas, the largest error bound in b: of b"
    by_area["d"] = Decision("e", True, "of d", None, "m")
    merged = merged_decision(by_area)
    assert (merged.modelled, merged.error_bound) == (True, None)
    assert merged.reason.startswith("modelled in 1 of 4 areas, for example d: of d; not modelled")


def test_terrain_beyond_the_configured_limit_is_stated() -> None:
    terrain = rough()
    whole, cut = ring_decision(terrain, 100.0, 100.0), ring_decision(terrain, 100.0, 100.0, 40e3)
    assert whole.error_bound == 0.0
    assert cut.error_bound > 5.0  # the highest terrain of the Moon, 40 km away
    assert "more than 40 km away" in cut.reason


@pytest.mark.parametrize(
    ("tolerance_deg", "own_deg", "suns_deg", "said"),
    [
        (0.5, 0.0, (5.0, 10.0), "about 2.3 % of the unshadowed flags at 5 deg"),
        (0.5, 0.0, (5.0, 10.0), "at most 0.5 % with own Suns up to 12 deg"),
        (1.0, 0.0, (5.0, 10.0), "about 4.6 % of the unshadowed flags at 5 deg"),
        (0.25, 0.0, (5.0, 10.0), "own Suns up to 7 deg"),
        (0.5, 7.0, (5.0, 10.0), "about 0.6 % of the unshadowed flags at 10 deg"),
        (0.5, 12.0, (5.0, 10.0), "there no unshadowed flag is another"),
        (
            0.5,
            0.0,
            (0.5, 4.0),
            "about 4.7 % of the unshadowed flags at 0.5 deg of Sun are others than under the points' own Suns (measured)",
        ),
        (0.5, 0.0, (0.2, 4.0), "own Suns (extrapolated from 0.5 deg)"),
    ],
)
def test_a_plan_says_what_one_direction_changes_at_the_lowest_sun(
    tolerance_deg: float, own_deg: float, suns_deg: tuple[float, ...], said: str
) -> None:
    """The measured shares, proportional to the tolerance, of the lowest Sun that is not a point's own."""
    decision = of_a_build(tolerance_deg, own_deg, suns_deg)[1]
    assert (decision.effect, decision.error_bound) == ("one direction per area", tolerance_deg)
    assert said in decision.reason
    enough = own_deg == 12.0 or suns_deg[0] >= 12.0
    assert ("are others" in decision.reason) != enough
    assert "are others" not in of_a_build(tolerance_deg, own_deg, (60.0,))[1].reason


def test_tiers_with_own_suns_change_no_flag() -> None:
    """`high` and `reference` have them up to the elevation from which one direction changes at most 0.5 %."""
    for tier in TIERS.values():
        said = of_a_build(0.5, tier.own_sun_deg, (4.0, 5.0, 10.0, 15.0))[1].reason
        assert ("are others" in said) == (tier.tier in ("draft", "standard"))
