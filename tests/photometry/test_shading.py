"""Images of nodes in single precision compared with the models in double precision, node by node."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.twins_reflectance import SPECS, of_hapke
from hypothesis import given, settings
from hypothesis import strategies as st
from rendering.test_renderer import hills, make

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import oblique_view
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.kernels.elementary import exp_lane, gap_lane, log_lane
from lcp_catalog.kernels.photometry.images import add_light, angles_deg, shade_nodes
from lcp_catalog.kernels.photometry.laws import factors
from lcp_catalog.light.sources import Lighting, LightSource
from lcp_catalog.photometry.hapke_sets import HapkeSet
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.renderer import Method, render_enu

SHAPE = (23, 1100)
"""More than two runs of 512 a row, the last one short."""

MADE = [
    of_hapke(HapkeSet("full", 0.5, 0.3, 0.2, 1.2, 0.08, 0.6, 0.02, 0.3, 25.0)),
    of_hapke(HapkeSet("smooth", 0.4, 0.2, 0.3, 1.7, 0.07, theta_bar_deg=0.0)),
    of_hapke(HapkeSet("rough", 0.95, 0.4, -0.1, 0.5, 0.1, 0.4, 0.1, 0.5, 50.0)),
]
LAWS = [*(reflectance_model(spec) for spec in SPECS), *MADE]
EACH = pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
LIGHTS = [
    (direction_enu(30.0, 20.0), direction_enu(0.0, 90.0)),
    (direction_enu(30.0, 3.0), direction_enu(100.0, 50.0)),
    (direction_enu(30.0, 25.0), direction_enu(210.0, 30.0)),
    (direction_enu(30.0, 40.0), direction_enu(30.5, 41.0)),
]


def nodes(seed: int = 0, steep: float = 0.5, shape=SHAPE) -> np.ndarray:
    """Normals (rows, cols, 3) float32 in random directions, a few of them NaN."""
    rng = np.random.default_rng(seed)
    normals = rng.normal((0, 0, 1), steep, size=(*shape, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals.astype(np.float32)
    normals[rng.random(shape) < 0.01] = np.nan
    return normals


def assert_near(
    found: np.ndarray, expected: np.ndarray, rel: float = 0.0, abs_: float = 0.0
) -> None:
    """Equal within the larger of the two tolerances, and NaN in the same places; pytest.approx
    takes seconds for images.
    """
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    off = np.abs(found.astype(np.float64) - expected)
    within = np.maximum(rel * np.abs(expected), abs_)
    assert not (off > within).any(), np.nanmax(off - within)


def planes(normals: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.moveaxis(normals, -1, 0))


def in_double(normals, sun, camera, dark, unseen, law) -> np.ndarray:
    """The image by the model in double precision."""
    mu0, mu = (normals.astype(float).reshape(-1, 3) @ v for v in (sun, camera))
    seen = ~unseen.ravel() & (mu > 0)
    lit = seen & ~dark.ravel() & (mu0 > 0)
    image = np.where(seen, 0.0, np.nan)
    cos_g = np.full(int(lit.sum()), min(1.0, max(-1.0, float(sun @ camera))))
    image[lit] = factors(mu0[lit], mu[lit], cos_g, law.code, law.numbers)
    return image.reshape(normals.shape[:2])


@EACH
def test_images_are_the_law_node_by_node(law):
    for light, (sun, camera) in enumerate(LIGHTS):
        compare_image(law, nodes(light), sun, camera)


def compare_image(law, normals, sun, camera):
    rng = np.random.default_rng(9)
    dark, unseen = rng.random((2, *SHAPE)) < 0.25
    dark[3:5] = True  # whole rows without light
    image = shade_nodes(
        planes(normals), sun, camera, dark.view(np.uint8), unseen, law.code, law.numbers
    )
    expected = in_double(normals, sun, camera, dark, unseen, law)
    assert image.dtype == np.float32
    assert (np.isnan(image) == np.isnan(expected)).all()
    assert ((image == 0) == (expected == 0)).all()
    clear = (normals.astype(float) @ sun > 0.02) & (normals.astype(float) @ camera > 0.02)
    ratio = image[clear & (expected > 0)] / expected[clear & (expected > 0)]
    assert np.abs(ratio - 1).max() < 1.5e-6
    assert np.nanmax(np.abs(image - expected)) < 1e-6


@EACH
def test_near_the_limb_and_the_terminator(law):
    """Cosines down to 1e-6, and views along the normal."""
    sun, camera = LIGHTS[1]
    rng, around = np.random.default_rng(4), np.cross(LIGHTS[1][0], LIGHTS[1][1])
    edges = []
    for axis in (sun, camera):
        aside = np.cross(axis, rng.normal(size=(300, 3)))
        aside /= np.linalg.norm(aside, axis=1)[:, None]
        lean = 10.0 ** rng.uniform(-6, -1, size=(300, 1))
        edges += [aside + lean * axis, axis + lean * aside, aside + lean * around]
    normals = np.concatenate(edges)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = normals.astype(np.float32)[None]
    none = np.zeros(normals.shape[:2], dtype=np.bool_)
    image = shade_nodes(
        planes(normals), sun, camera, none.view(np.uint8), none, law.code, law.numbers
    )
    expected = in_double(normals, sun, camera, none, none, law)
    assert_near(image, expected, rel=1.5e-6, abs_=1e-12)
    assert np.nanmin(image) >= 0.0


@EACH
def test_in_exact_opposition(law):
    """Source and camera in one direction, where grazing facets depend on the last digits of the
    azimuth.
    """
    sun, normals = direction_enu(30.0, 10.0), nodes(3, 1.0)
    none = np.zeros(SHAPE, dtype=np.bool_)
    image = shade_nodes(planes(normals), sun, sun, none.view(np.uint8), none, law.code, law.numbers)
    expected = in_double(normals, sun, sun, none, none, law)
    mu = normals.astype(float) @ sun
    for least, within in ((0.02, 3e-6), (1e-3, 4e-5), (0.0, 2e-3)):
        clear = mu > least
        assert np.abs(image[clear] / expected[clear] - 1).max() < within


@settings(deadline=None, max_examples=60)
@given(
    vectors=st.lists(
        st.tuples(*[st.sampled_from([0.0, 1.0, -1.0, 1e-9, -1e-17, 1e-30, 0.6, 0.8])] * 3).filter(
            lambda v: max(map(abs, v)) > 1e-10
        ),
        min_size=3,
        max_size=3,
    ),
    law=st.sampled_from(LAWS),
)
def test_never_nan_nor_negative_where_seen(vectors, law):
    normal, sun, camera = (np.array(v) / np.linalg.norm(v) for v in vectors)
    image = np.tile(normal.astype(np.float32)[:, None, None], (1, 1, 3))
    none = np.zeros((1, 3), dtype=np.bool_)
    shaded = shade_nodes(image, sun, camera, none.view(np.uint8), none, law.code, law.numbers)
    mu = float(normal.astype(np.float32).astype(float) @ camera)
    if abs(mu) > 1e-15:  # across, rounding says whether it is seen
        assert (np.isfinite(shaded) == (mu > 0)).all()
    known = shaded[~np.isnan(shaded)]
    assert ((known >= 0.0) & (known < 20.0)).all()


@EACH
def test_lights_add_up(law):
    rng, normals = np.random.default_rng(2), nodes(8)
    sun, camera = LIGHTS[0]
    weight = rng.uniform(0, 2, SHAPE).astype(np.float32)
    weight[rng.random(SHAPE) < 0.3] = 0.0
    radiance = np.full(SHAPE, 0.25, dtype=np.float32)
    add_light(radiance, planes(normals), sun, camera, weight, law.code, law.numbers)
    none = np.zeros(SHAPE, dtype=np.bool_)
    image = np.nan_to_num(in_double(normals, sun, camera, none, none, law))
    assert np.abs(radiance - (0.25 + weight * image)).max() < 4e-6


def test_angles_are_arc_tangents_of_lengths():
    normals = nodes(5).astype(np.float32)
    direction = direction_enu(200.0, 35.0)
    normals[0, 0], normals[0, 1], normals[0, 2] = (
        direction,
        -direction,
        np.cross(direction, (0, 0, 1)),
    )
    normals[0, 3] = 3.0 * normals[0, 4]  # of any length
    degrees, faces = np.empty(SHAPE, np.float32), np.empty(SHAPE, np.bool_)
    angles_deg(planes(normals), direction, degrees, faces)
    aside = np.linalg.norm(np.cross(normals.astype(float), direction), axis=-1)
    along = normals.astype(float) @ direction
    expected = np.degrees(np.arctan2(aside, along))
    assert np.nanmax(np.abs(degrees - expected)) < 1e-5
    assert degrees[0, 0] == pytest.approx(0.0, abs=1e-5)
    assert degrees[0, 1] == 180.0
    assert (faces == (along > 0)).all()
    assert np.isnan(degrees[np.isnan(along)]).all()


def test_perpendicular_and_zero_normals():
    """A normal of length 0 (t = 0/0) is nodata; exact values at 0, 90 and 180 deg."""
    few = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, -1]], np.float32)[None]
    degrees, faces = np.empty((1, 4), np.float32), np.empty((1, 4), np.bool_)
    angles_deg(planes(few), np.array([1.0, 0.0, 0.0]), degrees, faces)
    assert degrees[0].tolist() == [0.0, 180.0, 90.0, 90.0]
    assert faces[0].tolist() == [True, False, False, False]


# -- the elementary functions


def test_exponentials_and_logarithms_of_lanes():
    x = np.concatenate([-np.geomspace(1e-30, 80, 2000), [0.0]]).astype(np.float32)
    ours = np.array([exp_lane(v) for v in x])
    exact = np.exp(x.astype(float))
    assert (np.abs(ours / exact - 1) < 1.5e-7 * (1 - x)).all()  # the argument's own rounding
    gaps = np.array([gap_lane(v) for v in x])
    assert gaps == pytest.approx(-np.expm1(x.astype(float)), rel=4e-7)
    assert [float(exp_lane(np.float32(v))) for v in (-100.0, -1e30)] == pytest.approx(
        [0, 0], abs=1e-37
    )
    y = np.geomspace(1e-30, 1e30, 3000).astype(np.float32)
    logs = np.array([log_lane(v) for v in y])
    assert logs == pytest.approx(np.log(y.astype(float)), rel=3e-7, abs=2e-7)


# -- whole renders


@EACH
@pytest.mark.parametrize("view", ["nadir", "oblique"])
def test_a_render_in_single_precision_is_the_one_in_double(law, view):
    """The tiers differ in the precision of the bands alone, where no hill casts a shadow on another."""
    seen_from = oblique_view(0.0, 0.0) if view == "nadir" else oblique_view(35.0, 250.0)
    z = hills(height=120.0)
    z[4, 7] = np.nan
    terrain = make(z)
    light = Lighting(
        (
            LightSource(direction_enu(100.0, 30.0)),
            LightSource(direction_enu(300.0, 60.0), 0.4, name="lamp"),
        )
    )
    quick = render_enu(terrain, light, seen_from, Method(accuracy=TIERS["high"], model=law))
    exact = render_enu(terrain, light, seen_from, Method(accuracy=TIERS["reference"], model=law))
    assert (quick.visible == exact.visible).all()
    assert (quick.sunlit == exact.sunlit).all()
    assert_near(quick.radiance, exact.radiance, rel=1e-5, abs_=2e-6)
    for band in ("incidence_deg", "emission_deg", "phase_deg"):
        ours, theirs = getattr(quick, band), getattr(exact, band)
        assert ours.dtype == np.float32
        assert_near(ours, theirs, abs_=2e-5)
    assert math.isfinite(float(np.nanmax(quick.radiance)))
