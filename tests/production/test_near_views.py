"""Views at finite altitude: images, occlusion and dependence seen from each point's own camera, against
brute force over all triangles and reference formulas in float64; the decision and its limit.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from helpers import twins
from helpers.random_scenes import ground, make
from helpers.twins import node_margins, node_margins_to

from lcp_catalog.landmarks.error_model import ErrorModel
from lcp_catalog.photometry.laws import radiance_factor, reflectance_model
from lcp_catalog.production.config import AreaConfig, BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.evaluation import Evaluation, evaluate
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.patch_light import PatchLight
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.production.sweep import (
    Conditions,
    Sweep,
    law_of_build,
    lowest_off_nadir_deg,
    plan_area,
    view_angles_rad,
)
from lcp_catalog.rendering.plan import ring_decision

pytestmark = pytest.mark.usefixtures("one_thread")

CELL_M = 20.0
ERRORS = ErrorModel(0.03, 0.6, 40.0, 0.05, 100.0)
HALF, SEARCH = 4, 6
MARGIN = HALF + SEARCH + 4
OFF_DEG = 60.0
NEAR_KM = 0.6
"""Three times as far as a patch and its search region reach."""

LAWS = ("lommel-seeliger", "lommel-seeliger:rolo", "lambert", "lunar-lambert", "minnaert", "hapke")


def config(altitudes_km, off_nadir=OFF_DEG, **model) -> BuildConfig:
    """Views 60 deg off nadir, towards the east, at several altitudes."""
    count = len(altitudes_km)
    return BuildConfig(
        area=AreaConfig(gsd_m=CELL_M),
        sun=SunConfig((90.0, 270.0), (10.0, 40.0)),
        view=ViewConfig((off_nadir,) * count, (90.0,) * count, tuple(altitudes_km)),
        points=PointConfig(patch_nodes=2 * HALF + 1, search_m=SEARCH * CELL_M),
        model=ModelConfig(**model),
    )


def swept(z, made: BuildConfig, law: str | None = None) -> Sweep:
    """The sweep of heights, all Suns in it."""
    terrain = make(z, core=(4, len(z) - 4, 4, len(z) - 4))
    conditions, choice = Conditions.at(0.0, made), law_of_build(made, 0.0)
    conditions = dataclasses.replace(
        conditions, reachable=np.ones_like(conditions.reachable, dtype=bool)
    )
    plan = plan_area(terrain, conditions, made, choice, ring_decision(terrain, 0.0, 0.0), None)
    model = reflectance_model(law) if law else choice.model
    return Sweep(terrain, conditions, plan, model, made.model.precision)


def hill() -> np.ndarray:
    """Rough ground with slopes that hide some nodes from a camera 60 deg off nadir."""
    return ground(3, nodes=49, length=4.0, sigma=50.0)


def camera_over(sweep: Sweep, row: int, col: int, altitude_m: float) -> np.ndarray:
    """The camera 60 deg off nadir in the east of a node of the core: where a line meets the sphere of
    its altitude.
    """
    field, radius = sweep.field, 1737400.0
    r, c = sweep.window[0] + row, sweep.window[2] + col
    point = np.array([field.x0_m + c * CELL_M, field.y0_m - r * CELL_M, float(field.z_m[r, c])])
    off = math.radians(OFF_DEG)
    along = np.roots([1.0, 2.0 * radius * math.cos(off), radius**2 - (radius + altitude_m) ** 2])
    return point + along.max() * np.array([math.sin(off), 0.0, math.cos(off)])


def in_cells(sweep: Sweep, place: np.ndarray) -> tuple[float, float, float]:
    """An ENU place in columns, rows and metres."""
    x0, y0 = sweep.field.x0_m, sweep.field.y0_m
    return (place[0] - x0) / CELL_M, (y0 - place[1]) / CELL_M, place[2]


def nodes(sweep: Sweep, window: tuple[slice, slice]) -> np.ndarray:
    """ENU places (rows, cols, 3) of nodes of the field."""
    y, x = np.mgrid[window]
    x0, y0, z = sweep.field.x0_m, sweep.field.y0_m, sweep.field.z_m.astype(np.float64)
    return np.stack([x0 + x * CELL_M, y0 - y * CELL_M, z[window]], axis=-1)


@pytest.fixture(scope="module")
def seen() -> tuple[np.ndarray, dict[tuple[int, int], np.ndarray]]:
    """By how much the triangles rise above the lines from every second node around node (20, 19) of the core to
    a camera over it, and above those to each Sun; brute force.
    """
    sweep = swept(hill(), config([NEAR_KM]))
    z = sweep.field.z_m.astype(np.float64)
    top, bottom, left, right = sweep.over(20, 19, MARGIN)[0].window
    part = np.s_[top:bottom, left:right:2]
    hides = node_margins_to(z, in_cells(sweep, camera_over(sweep, 20, 19, 1e3 * NEAR_KM)), part)
    shades = {
        (i, j): node_margins(z, twins.in_cells(sweep.sun_directions[i, j], CELL_M), part)
        for i, j in np.ndindex(2, 2)
    }
    return hides, shades


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_an_image_from_a_near_camera_is_that_of_brute_force(seen, law: str) -> None:
    """Every node's own direction to the camera; hidden nodes and shadows by all triangles; the law's
    formula in float64.
    """
    sweep = swept(hill(), config([NEAR_KM], accuracy="high"), law)
    own, row0, col0 = sweep.over(20, 19, MARGIN)
    top, bottom, left, right = own.window
    assert (top, left) == (sweep.window[0] + row0, sweep.window[2] + col0)
    part = np.s_[top:bottom, left:right:2]
    towards = camera_over(sweep, 20, 19, 1e3 * NEAR_KM) - nodes(own, part)
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    normals, hides = own.normals[:, ::2].astype(np.float64), seen[0]
    mu, some_hidden = np.sum(normals * towards, axis=-1), 0
    images = list(own.images())
    assert len(images) == 4
    for image in images:
        sun, shades = own.sun_directions[image.elevation, image.azimuth], seen[1][image.sun]
        mu0 = np.sum(normals * sun, axis=-1)
        angles = (np.arccos(np.clip(v, -1, 1)) for v in (mu0, mu, np.sum(sun * towards, axis=-1)))
        expected = radiance_factor(own.model, *angles)
        expected = np.where((mu0 > 0.0) & (shades <= 0.0), expected, 0.0)
        expected = np.where((mu > 0.0) & (hides <= 0.0), expected, np.nan)
        clear = (abs(hides) > 1e-3) & (abs(shades) > 1e-3) & (abs(mu) > 1e-4) & (abs(mu0) > 1e-4)
        some_hidden += int((np.isnan(expected) & clear).sum())
        assert clear.mean() > 0.9
        found = image.radiance[:, ::2]
        np.testing.assert_allclose(found[clear], expected[clear], rtol=2e-5, atol=2e-6)
    assert some_hidden > 20


def test_what_only_terrain_outside_the_patch_hides_from_a_near_camera() -> None:
    """Share of the patch's nodes, by all triangles of the terrain and of the patch alone."""
    sweep = swept(hill(), config([NEAR_KM], accuracy="high"))
    z, found, expected, parallel = sweep.field.z_m.astype(np.float64), [], [], []
    for row, col in ((15, 15), (20, 19), (24, 26), (26, 16), (18, 25)):
        own, row0, col0 = sweep.over(row, col, MARGIN)
        light = PatchLight(own, np.array([row - row0]), np.array([col - col0]), HALF)
        found.append(float(light.occlusion_dependence(0)[0]))
        plain = PatchLight(sweep, np.array([row]), np.array([col]), HALF)
        parallel.append(float(plain.occlusion_dependence(0)[0]))
        camera = camera_over(sweep, row, col, 1e3 * NEAR_KM)
        at = in_cells(sweep, camera)
        r, c = sweep.window[0] + row - HALF, sweep.window[2] + col - HALF
        patch = np.s_[r : r + 2 * HALF + 1, c : c + 2 * HALF + 1]
        whole = node_margins_to(z, at, patch) > 1e-9
        alone = node_margins_to(z[patch], (at[0] - c, at[1] - r, at[2])) > 1e-9
        normals = sweep.field.normals().astype(np.float64)[patch]
        faces = np.sum(normals * (camera - nodes(sweep, patch)), axis=-1) > 0.0
        expected.append(float((whole & faces & ~alone).mean()))
    assert found == pytest.approx(expected, abs=1e-6)
    assert max(expected) > 0.03
    assert found != pytest.approx(parallel, abs=1e-6)


def results(altitudes_km, **model) -> Evaluation:
    made = config(altitudes_km, **model)
    rows, cols = np.array([18, 22]), np.array([20, 23])
    return evaluate(swept(hill(), made), rows, cols, made, ERRORS)


def test_a_near_view_differs_and_a_high_one_does_not() -> None:
    """The same direction from 0.6 km, from infinity and, twice, from far: within the tolerance of
    directions a view has parallel rays and the same bytes.
    """
    found = results([NEAR_KM, math.inf, 2000.0, NEAR_KM])
    for f in dataclasses.fields(found):
        near, parallel, high, again = np.moveaxis(getattr(found, f.name), -3, 0)
        np.testing.assert_array_equal(near, again, err_msg=f.name)
        if f.name not in ("condition", "shadow_dependence"):
            assert not np.array_equal(near, parallel, equal_nan=True), f.name
        if f.name == "detection":
            assert near.max() > 0.5
            assert np.abs(high - parallel).max() < 0.01 < np.abs(near - parallel).max()
    alone = results([2000.0])
    plain = results([math.inf])
    for f in dataclasses.fields(found):
        np.testing.assert_array_equal(getattr(alone, f.name), getattr(plain, f.name))


def test_the_decision_is_by_the_tolerance_of_directions() -> None:
    """Half a patch and the search region, 10 nodes of 20 m, to the corner: 283 m."""
    limit_m = 10 * CELL_M * math.sqrt(2.0) / math.sin(math.radians(0.5))
    for share, modelled in ((1.01, False), (0.99, True)):
        made = config([1e-3 * share * limit_m], off_nadir=0.0)
        plan = swept(hill(), made).plan
        assert plan.perspective.modelled == modelled
        assert (plan.perspective.error_bound == 0.0) == modelled
        assert view_angles_rad(made) == pytest.approx([math.radians(0.5) / share], rel=1e-3)
        lowest = math.degrees(view_angles_rad(made)[0]) if modelled else 0.0
        assert lowest_off_nadir_deg(made) == pytest.approx(lowest)
    assert not swept(hill(), config([math.inf])).plan.perspective.modelled
    assert lowest_off_nadir_deg(config([0.1])) == 89.0  # beside its camera a node looks up


def test_a_camera_below_the_terrain_sees_nothing() -> None:
    made = config([0.01])
    slope = np.tile(2.0 * CELL_M * np.arange(49), (49, 1)) + ground(
        3, nodes=49
    )  # rises to the camera
    at = np.array([20])
    found = evaluate(swept(slope, made), at, at, made, ERRORS)
    assert (found.condition > 0).all()
    assert (found.detection == 0.0).all()
