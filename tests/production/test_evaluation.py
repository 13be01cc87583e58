"""Evaluation of candidates: coarser images, ellipses, turned areas, flags, and patches that only
terrain around them shadows.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from statistics import NormalDist

import numpy as np
import pytest
from helpers.random_scenes import ground, make

from lcp_catalog.catalog.schema import (
    EVALUATED,
    LOCALIZABLE,
    UNIQUE,
    UNOCCLUDED,
    UNSHADOWED,
    USABLE,
)
from lcp_catalog.geometry.frames import direction_enu, enu_rotation, mcmf_to_lonlat
from lcp_catalog.landmarks.error_model import ErrorModel
from lcp_catalog.production import evaluation
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.evaluation import evaluate
from lcp_catalog.production.patch_light import PatchLight
from lcp_catalog.production.point_config import PointConfig, image_scales
from lcp_catalog.production.sweep import Conditions, Sweep, law_of_build, plan_area
from lcp_catalog.rendering.decisions import Decision
from lcp_catalog.rendering.plan import ring_decision

pytestmark = pytest.mark.usefixtures("one_thread")

CELL_M = 20.0
CONFIG = BuildConfig(
    area=AreaConfig(gsd_m=CELL_M),
    sun=SunConfig((0.0, 90.0, 180.0, 270.0), (10.0, 40.0)),
    view=ViewConfig((0.0, 30.0), (0.0, 90.0), (math.inf, math.inf)),
    points=PointConfig(patch_nodes=17, search_m=12 * CELL_M),
)
ERRORS = ErrorModel(0.03, 0.6, 40.0, 0.05, 100.0)


def swept(z: np.ndarray, turn_rad: float = 0.0, config: BuildConfig = CONFIG) -> Sweep:
    """The sweep of heights at the equator, where every Sun can occur."""
    terrain = make(z, core=(4, len(z) - 4, 4, len(z) - 4))
    conditions, choice = Conditions.at(0.0, config), law_of_build(config, 0.0)
    everywhere = np.ones_like(conditions.reachable)
    conditions = dataclasses.replace(conditions, reachable=everywhere)
    plan = plan_area(terrain, conditions, config, choice, ring_decision(terrain, 0.0, 0.0), None)
    return Sweep(terrain, conditions, plan, choice.model, config.model.precision, turn_rad)


def judged(z: np.ndarray, turn_rad: float = 0.0, config: BuildConfig = CONFIG, at=((36,), (36,))):
    rows, cols = (np.array(a) for a in at)
    return evaluate(swept(z, turn_rad, config), rows, cols, config, ERRORS)


@pytest.mark.parametrize(
    ("nodes", "scales"),
    [(9, (1,)), (13, (1, 2)), (17, (1, 2)), (33, (1, 2, 4)), (65, (1, 2, 4, 8))],
)
def test_image_scales_end_at_seven_pixels(nodes, scales):
    assert image_scales(nodes) == scales
    sides = [2 * (nodes // 2 // scale) + 1 for scale in (*scales, 2 * scales[-1])]
    assert min(sides[:-1]) >= 7 > sides[-1]


def test_results_are_those_in_the_points_own_north():
    """An area whose north is a quarter turn from the point's: as the terrain turned the other way. The
    triangles' diagonals turn with the terrain, so that normals differ a little.
    """
    z = ground(1)
    turned = judged(z, math.radians(90.0))  # the point's north is the area's east
    plain = judged(np.rot90(z))
    assert (turned.condition == plain.condition).mean() > 0.9
    for name, tolerance in (("detection", 0.05), ("sigma_major_m", 0.5), ("sigma_minor_m", 0.5)):
        one, other = getattr(turned, name), getattr(plain, name)
        assert np.median(np.abs(one - other)) < tolerance
    off = (turned.sigma_angle_deg - plain.sigma_angle_deg + 90.0) % 180.0 - 90.0
    long = turned.sigma_major_m > 1.3 * turned.sigma_minor_m
    assert long.sum() >= 8
    assert np.median(np.abs(off[long])) < 5.0


def test_flags_follow_from_the_probabilities_and_shares():
    found = judged(ground(2), at=((30, 36, 40), (33, 40, 36)))
    least, most = CONFIG.points.min_detection, CONFIG.points.max_dependence

    def flag(bit):
        return (found.condition & bit) > 0

    assert flag(EVALUATED).all()
    np.testing.assert_array_equal(flag(UNIQUE), found.detection[:, 0] >= least)
    np.testing.assert_array_equal(flag(UNSHADOWED), found.shadow_dependence <= most)
    np.testing.assert_array_equal(flag(UNOCCLUDED), found.occlusion_dependence <= most)
    assert (flag(LOCALIZABLE) | ~flag(UNIQUE)).all()  # detection implies a match
    usable = (found.detection[:, 0] >= least) & flag(UNSHADOWED) & flag(UNOCCLUDED)
    np.testing.assert_array_equal(found.condition == USABLE, usable)
    assert flag(UNIQUE).any()
    assert not flag(UNIQUE).all()
    assert (found.sigma_major_m >= found.sigma_minor_m).all()


@pytest.mark.slow
@pytest.mark.parametrize(("nodes", "search"), [(17, 12), (17, 24), (33, 24)])
def test_the_quick_search_and_its_check_give_the_flags_of_the_exhaustive_search(
    monkeypatch, nodes, search
):
    """Rugged and gentle ground, 16 candidates, 8 Suns. Where the first search alone gives another flag, its
    probability is nearer to the limit than the limits of doubt. The tier high searches exhaustively.
    """
    points = PointConfig(patch_nodes=nodes, search_m=search * CELL_M)
    view = ViewConfig((0.0,), (0.0,), (math.inf,))
    config = dataclasses.replace(CONFIG, points=points, view=view)
    high = dataclasses.replace(config, model=dataclasses.replace(config.model, accuracy="high"))
    quick, least, unlike, sure = evaluation.other_places, points.min_detection, 0, set()
    for seed, sigma in ((0, 6.0), (0, 1.5), (1, 6.0), (1, 1.5)):
        edge = nodes // 2 + search + 4
        line = np.linspace(edge, 112 - edge, 4).astype(int)
        at = tuple(a.ravel() for a in np.meshgrid(line, line))
        z = ground(seed, 121, sigma=sigma)
        found = judged(z, config=config, at=at)
        with monkeypatch.context() as patch:
            patch.setattr(evaluation, "SEARCH_DOUBT", (-1.0, -1.0))
            unchecked = judged(z, config=config, at=at)
            # the code gives `exact` by name, which a partial would not override
            patch.setattr(
                evaluation, "other_places", lambda *a, **how: quick(*a, **(how | {"exact": True}))
            )
            exact = judged(z, config=config, at=at)
            exact_high = judged(z, config=high, at=at)
        np.testing.assert_array_equal(found.condition, exact.condition)
        for name, values in dataclasses.asdict(judged(z, config=high, at=at)).items():
            np.testing.assert_array_equal(values, getattr(exact_high, name), err_msg=name)
        one, other = found.detection[:, 0], exact.detection[:, 0]
        doubtful = (one > least - evaluation.SEARCH_DOUBT[0]) & (
            one < least + evaluation.SEARCH_DOUBT[1]
        )
        np.testing.assert_allclose(one[doubtful], other[doubtful], atol=1e-6)
        under, over = (one < least) & (other >= least), (one >= least) & (other < least)
        assert (least - one)[under].max(initial=0.0) < evaluation.SEARCH_DOUBT[0]
        assert (one - least)[over].max(initial=0.0) < evaluation.SEARCH_DOUBT[1]
        unlike += (unchecked.detection[:, 0] != other).sum()
        sure |= set(np.unique(found.condition & UNIQUE).tolist())
    assert unlike > 10  # the searches differ
    assert sure == {0, UNIQUE}


def test_terrain_that_repeats_itself_is_localizable_and_not_unique():
    """A period of 9 nodes in a search of 12: eight places and more are like the true one."""
    tiles = np.tile(ground(8, nodes=9, length=1.5, sigma=3.0), (9, 9))
    found = judged(tiles)
    clear = (found.condition & LOCALIZABLE) > 0
    assert clear.sum() >= 4
    assert not ((found.condition & UNIQUE) > 0)[clear].any()
    assert (found.detection[:, 0][clear] < 0.2).all()
    assert (found.second_peak[clear] > 0.99).all()
    # a false match is only asked for where a point is found often enough
    points = dataclasses.replace(CONFIG.points, min_detection=1e-6)
    asked = judged(tiles, config=dataclasses.replace(CONFIG, points=points))
    assert (asked.false_match[clear] > 0.8).all()


def test_more_noise_is_never_better():
    rows, cols = np.array([36]), np.array([36])
    sweep = swept(ground(3))
    quiet, loud = (
        evaluate(sweep, rows, cols, CONFIG, dataclasses.replace(ERRORS, sensor_noise=noise))
        for noise in (0.01, 0.2)
    )
    assert (loud.detection <= quiet.detection + 1e-6).all()
    assert (loud.sigma_major_m >= quiet.sigma_major_m).all()
    assert (loud.detection < quiet.detection - 0.1).any()


def test_the_error_of_place_adds_to_both_axes():
    rows, cols = np.array([36]), np.array([36])
    sweep = swept(ground(3))
    one, other = (
        evaluate(sweep, rows, cols, CONFIG, dataclasses.replace(ERRORS, position_sigma_m=s))
        for s in (3.0, 7.0)
    )
    for name in ("sigma_major_m", "sigma_minor_m"):
        expected = np.hypot(getattr(one, name), math.sqrt(7.0**2 - 3.0**2))
        np.testing.assert_allclose(getattr(other, name), expected, rtol=1e-5)
    np.testing.assert_array_equal(one.detection, other.detection)


def test_the_error_of_place_is_no_smaller_than_its_share_of_a_cell():
    """At every scale of the image: it is the ground's cell that counts."""
    rows, cols = np.array([36]), np.array([36])
    sweep = swept(ground(3))
    least = dataclasses.replace(ERRORS, position_sigma_m=3.0, position_sigma_cells=0.7)
    wide = dataclasses.replace(ERRORS, position_sigma_m=0.7 * CELL_M)
    one, other = (evaluate(sweep, rows, cols, CONFIG, model) for model in (least, wide))
    np.testing.assert_array_equal(one.sigma_major_m, other.sigma_major_m)


@pytest.mark.parametrize("contrast", [None, 0.02, 0.1, 0.4])
def test_a_match_is_displaced_by_a_part_of_the_noise(contrast):
    """The part of the covariance by noise is that of all noise times the share, by hand from the contrast of the
    brightness that a map gives the patch's nodes; what is found does not know of it.
    """
    rows, cols = np.array([36]), np.array([36])
    sweep, part, power = swept(ground(3)), 0.25, 0.9
    if contrast is not None:
        side = sweep.planes.shape[1]
        bright = np.where(np.indices((side, side)).sum(axis=0) % 2, 1.0 + contrast, 1.0 - contrast)
        sweep = dataclasses.replace(sweep, brightness=bright.astype(np.float32))
    models = [
        ERRORS,
        *(dataclasses.replace(ERRORS, moving_share=s, contrast_power=power) for s in (0.0, part)),
    ]
    whole, none, some = (evaluate(sweep, rows, cols, CONFIG, model) for model in models)
    np.testing.assert_array_equal(whole.detection, some.detection)
    every, rest, moved = (
        np.square(one.sigma_major_m) + np.square(one.sigma_minor_m) for one in (whole, none, some)
    )
    # a checkerboard of 17 x 17 nodes has one more of one colour
    expected = part
    if contrast is not None:
        light, dark = 1.0 + contrast, 1.0 - contrast
        values = np.array([light] * 144 + [dark] * 145)
        expected = part * (np.clip(values.std() / values.mean(), 0.03, 0.15) / 0.06) ** (
            2.0 * power
        )
    known = np.isfinite(every)
    assert known.any()
    np.testing.assert_allclose((moved - rest)[known], expected * (every - rest)[known], rtol=1e-2)


def test_a_kind_of_images_moves_the_probabilities_by_probits():
    """And what is usable with them; the ellipses stay."""
    rows, cols = np.array([36, 44]), np.array([36, 44])
    config = CONFIG.replaced(
        {"model.whole_search": True}
    )  # half resolution looks again near the limit
    sweep = swept(ground(3), config=config)
    models = [dataclasses.replace(ERRORS, detection_shift=shift) for shift in (0.0, 0.4, -0.4)]
    plain, up, down = (evaluate(sweep, rows, cols, config, model) for model in models)
    normal, known = NormalDist(), (plain.detection > 0.01) & (plain.detection < 0.99)
    assert known.sum() > 5
    for moved, shift in ((up, 0.4), (down, -0.4)):
        wanted = [normal.cdf(normal.inv_cdf(p) + shift) for p in plain.detection[known].tolist()]
        np.testing.assert_allclose(moved.detection[known], wanted, atol=1e-4)
        np.testing.assert_array_equal(moved.sigma_major_m, plain.sigma_major_m)
        assert (((moved.condition & UNIQUE) > 0) == (moved.detection[:, 0] >= 0.9)).all()
    usable = [int(((one.condition & UNIQUE) > 0).sum()) for one in (down, plain, up)]
    assert usable[0] < usable[2]
    again = (up.condition & UNIQUE) > 0
    assert np.isfinite(up.false_match[again]).all()


def test_what_the_views_of_a_sun_share_is_computed_once_and_is_the_same_image_by_image(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three views, two of which hide nodes, of ground with shadows that fall into patches."""
    views = ViewConfig((0.0, 50.0, 50.0), (0.0, 90.0, 270.0), (math.inf,) * 3)
    config = dataclasses.replace(CONFIG, view=views)
    z = ground(3, sigma=6.0)
    z[:, 52:55] += 60.0
    together = judged(z, config=config, at=((30, 40), (36, 42)))
    suns: list[tuple[int, int]] = []
    traced = PatchLight.shadow_dependence

    def counted(light: PatchLight, *sun: int) -> tuple[np.ndarray, np.ndarray]:
        suns.append(sun)
        return traced(light, *sun)

    monkeypatch.setattr(evaluation, "_BATCH_NODES", 1)
    monkeypatch.setattr(PatchLight, "shadow_dependence", counted)
    alone = judged(z, config=config, at=((30, 40), (36, 42)))
    assert len(suns) == len(set(suns)) == together.condition[0, 0].size
    for field in dataclasses.fields(alone):
        np.testing.assert_array_equal(getattr(alone, field.name), getattr(together, field.name))
    assert (together.shadow_dependence > 0.0).any()
    assert (together.occlusion_dependence[:, 1:] > 0.0).any()


def test_a_moved_top_and_another_place_are_one_noise(monkeypatch):
    """The lesser of their probabilities counts, not the product: a claim below a top's stays, one above is the top's."""
    found = {}
    for top in (1.0, 0.6):
        monkeypatch.setattr(
            evaluation,
            "top_probability",
            lambda match, *_, top=top: np.full(match.pixels.shape, top),
        )
        monkeypatch.setattr(evaluation, "settling_probability", lambda match: 1.0)
        found[top] = judged(ground(3), config=CONFIG.replaced({"model.whole_search": True}))
    free, held = (found[top].detection[found[1.0].detection > 0.0] for top in (1.0, 0.6))
    assert (free < 0.6).sum() > 3
    assert (free > 0.7).sum() > 3
    np.testing.assert_allclose(held, np.minimum(free, 0.6), atol=1e-6)


def test_a_claim_compares_what_a_template_shows(monkeypatch):
    """At each scale the image's window without its outermost nodes, V over W - 1.9 by W cos e - 1.9 pixels for W cells, and
    0.2 of the clearance at which a search without a prior refuses a place that is right with a probability of 0.8.
    """
    sweep, seen = swept(ground(3)), []
    real = evaluation.detection_probability

    def noted(match, *args, **how):
        seen.append((match.pixels, how["clear_by"]))
        return real(match, *args, **how)

    shown = evaluation.other_places

    def places(images, patches, rows, cols, *args, **how):
        half = patches.shape[1] // 2
        for k in range(len(rows)):
            own = np.s_[rows[k] - half : rows[k] + half + 1, cols[k] - half : cols[k] + half + 1]
            sides.add(patches.shape[1])
            windows.append(np.abs(patches[k] - images.images[args[1][k]][own]).std())
        return shown(images, patches, rows, cols, *args, **how)

    sides, windows = set(), []
    monkeypatch.setattr(evaluation, "detection_probability", noted)
    monkeypatch.setattr(evaluation, "other_places", places)
    evaluate(sweep, np.array([36]), np.array([36]), CONFIG, ERRORS)
    assert sides == {15, 7}
    assert np.median(windows) < 1e-6  # the images of a search have no mean
    border_px = 2 * 1.644854 * math.sqrt(0.5**2 + 1 / 12)
    wanted = [
        (wide - border_px) * (wide * math.cos(math.radians(off)) - border_px)
        for wide in (16, 8)
        for off in CONFIG.view.off_nadir_deg
    ]
    counts = np.concatenate([pixels for pixels, _ in seen])
    away = np.abs(counts[:, None] - wanted)
    assert (away.min(axis=1) < 1e-3).all()
    assert set(away.argmin(axis=1)) == {0, 1, 2, 3}
    assert {round(clear_by, 6) for _, clear_by in seen} == {round(0.2 * 0.8416212, 6)}


def test_flat_and_dark_patches_are_found_nowhere():
    """A plain, and a patch in the shadow of a wall."""
    plain = judged(np.zeros((81, 81)))
    assert (plain.detection == 0.0).all()
    assert np.isinf(plain.sigma_major_m).all()
    assert np.isnan(plain.sigma_angle_deg).all()
    assert not ((plain.condition & (LOCALIZABLE | UNIQUE)) > 0).any()
    wall = ground(4, sigma=2.0)
    wall[:, 58:62] += 300.0  # east of the patch, which is dark under a Sun of 10 deg in the east
    found = judged(wall)
    assert (found.detection[0, :, :, 0, 1] == 0.0).all()
    assert (found.shadow_dependence[0, :, 0, 1] > 0.5).all()
    assert (found.detection[0, 0, 0, 0, 3] > 0.0).all()


def test_a_coarse_image_of_an_open_patch_differs_by_nothing_from_the_patch_alone():
    """Places at even and odd nodes: the correlation at the true place is 1 at every scale, so that
    probabilities of nearly noiseless images are 1.
    """
    high = dataclasses.replace(CONFIG, sun=SunConfig((180.0,), (60.0,)))
    at = (36, 36, 37, 37), (36, 37, 36, 37)
    sweep = swept(ground(5, sigma=4.0), config=high)
    quiet = ErrorModel(1e-4, 0.0, 40.0, 0.0, 100.0)
    found = evaluate(sweep, *(np.array(a) for a in at), high, quiet)
    assert found.shadow_dependence.max() == 0.0
    np.testing.assert_allclose(found.detection, 1.0, atol=1e-6)


def slopes_by_renders(z, step, config):
    """Radiances of the terrain and of the same terrain tilted to the east and to the south."""
    y, x = (a * CELL_M for a in np.mgrid[0 : len(z), 0 : len(z)])
    one, east, south = (
        list(swept(a, config=config).images()) for a in (z, z + step * x, z + step * y)
    )
    return zip(one, east, south, strict=True)


@pytest.mark.parametrize("law", ["lommel-seeliger", "lambert", "hapke"])
def test_sensitivities_are_the_change_of_renders_of_tilted_terrain(law):
    """Forward differences of the same step, where the node is lit in all renders."""
    config = dataclasses.replace(CONFIG, model=dataclasses.replace(CONFIG.model, reflectance=law))
    z = ground(6, nodes=41, sigma=3.0)
    step, compared = 0.01, 0
    stacks = list(swept(z, config=config).stacks(5))
    radiance = np.concatenate([stack.radiance for stack in stacks])
    slopes = np.concatenate([stack.slopes for stack in stacks], axis=1)
    conditions = np.concatenate([stack.conditions for stack in stacks]).tolist()
    assert max(len(stack.radiance) for stack in stacks) == 5
    for k, (one, *tilted) in enumerate(slopes_by_renders(z, step, config)):
        assert tuple(conditions[k]) == (one.view, one.elevation, one.azimuth)
        np.testing.assert_array_equal(radiance[k], one.radiance)
        for found, other in zip(slopes[:, k], tilted, strict=True):
            lit = (one.radiance > 0.0) & (other.radiance > 0.0)
            expected = (other.radiance - one.radiance) / step
            rounding = 3e-4 * one.radiance[lit].max(initial=0.0)
            np.testing.assert_allclose(found[lit], expected[lit], atol=rounding)
            assert (found[~(one.radiance > 0.0)] == 0.0).all()
            compared += lit.sum()
    assert compared > 2 * 10_000


def test_sensitivities_scale_with_the_albedo():
    z = ground(7, nodes=41)
    sweep = swept(z)
    shape = sweep.normals.shape[:2]
    factors = (1.0 + 0.3 * np.random.default_rng(0).normal(size=shape)).astype(np.float32)
    decision = Decision("albedo", True, "made", None, "1")
    plan = dataclasses.replace(sweep.plan, albedo=decision)
    bright = dataclasses.replace(sweep, plan=plan, brightness=factors)
    for one, other in zip(sweep.stacks(4), bright.stacks(4), strict=True):
        np.testing.assert_allclose(other.radiance, one.radiance * factors, rtol=1e-6)
        np.testing.assert_allclose(other.slopes, one.slopes * factors, rtol=1e-6)


def test_equal_views_are_rendered_once_and_have_equal_results(monkeypatch):
    """Straight down at any azimuth, and one direction from two altitudes."""
    views = ViewConfig((0.0, 0.0, 30.0, 30.0), (0.0, 90.0, 90.0, 90.0), (math.inf,) * 4)
    four = dataclasses.replace(CONFIG, view=views)
    shaded, shade = [], Sweep.stacks

    def counted(self, *args, **how):
        for images in shade(self, *args, **how):
            shaded.extend(images.conditions.tolist())
            yield images

    monkeypatch.setattr(Sweep, "stacks", counted)
    one, other = (judged(ground(9), config=config) for config in (CONFIG, four))
    assert len(shaded) == 2 * one.condition.size
    for field in dataclasses.fields(one):
        a, b = (np.moveaxis(getattr(e, field.name), -3, 0) for e in (one, other))
        np.testing.assert_array_equal(b, a[[0, 0, 1, 1]])


def test_a_doubtful_point_may_be_judged_under_its_own_sun() -> None:
    """`model.own_sun_deg`: a dependence on shadows near its limit is that under the Sun of the point's own frame, here
    by way of MCMF; all others stay those of the area's centre.
    """
    terrain = make(30.0 * ground(4, 161), core=(4, 157, 4, 157), gsd=500.0)
    config = CONFIG.replaced({"area.gsd_m": 500.0, "sun.elevations_deg": (4.0, 30.0)})
    low = config.replaced({"model.own_sun_deg": 7.5})
    conditions, choice = Conditions.at(34.0, config), law_of_build(config, 34.0)
    everywhere = np.ones_like(conditions.reachable)
    conditions = dataclasses.replace(conditions, reachable=everywhere)
    plan = plan_area(terrain, conditions, config, choice, ring_decision(terrain, 0.0, 0.0), None)
    sweep = Sweep(terrain, conditions, plan, choice.model, config.model.precision)
    rows, cols = (
        part.ravel() for part in np.meshgrid(*2 * [np.arange(15, 140, 12)], indexing="ij")
    )
    area, own = (PatchLight.of(sweep, rows, cols, one) for one in (config, low))
    again = differs = 0
    for azimuth in range(len(config.sun.azimuths_deg)):
        given, found = (light.shadow_dependence(0, azimuth)[0] for light in (area, own))
        for k in np.flatnonzero((given >= 0.05) & (given <= 0.2)).tolist():
            row, col = rows[k] + 4, cols[k] + 4
            lon, lat, _ = mcmf_to_lonlat(
                terrain.frame.to_mcmf(terrain.field.nodes_m(row, col)[None])
            )
            sun = direction_enu(config.sun.azimuths_deg[azimuth], 4.0) @ enu_rotation(lon, lat)[0]
            sun = terrain.frame.direction_from_mcmf(sun)
            window = (row - 8, row + 9, col - 8, col + 9)
            cast = terrain.field.occluded_nodes(sun, window) & (
                terrain.field.normals(window) @ sun > 0.0
            )
            cast &= ~terrain.field.occluded_alone(row, col, 8, sun)[0]
            assert found[k] == pytest.approx(cast.mean(), abs=1e-6)
            again, differs = again + 1, differs + (found[k] != given[k])
        calm = (given < 0.05) | (given > 0.2)
        np.testing.assert_array_equal(found[calm], given[calm])
        tiers = {
            tier: PatchLight.of(sweep, rows, cols, config.replaced({"model.accuracy": tier}))
            for tier in ("standard", "high")
        }
        for tier, wanted in (("standard", given), ("high", found)):
            np.testing.assert_array_equal(tiers[tier].shadow_dependence(0, azimuth)[0], wanted)
        high = (light.shadow_dependence(1, azimuth)[0] for light in (area, own))
        np.testing.assert_array_equal(*high)
    assert again > 20
    assert differs > 10


def test_an_evaluation_without_a_shift_needs_no_scipy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its import takes 0.1 s and 31 MB in each worker."""
    monkeypatch.setitem(sys.modules, "scipy.special", None)
    rng = np.random.default_rng(3)
    heights = np.cumsum(rng.normal(0.0, 1.0, (80, 80)), axis=0)
    assert (judged(heights).detection > 0.0).any()
    moved = dataclasses.replace(ERRORS, detection_shift=0.3)
    rows = cols = np.array([36])
    with pytest.raises(ImportError):
        evaluate(swept(heights), rows, cols, CONFIG, moved)
