"""Sky light on terrain: closed forms of sky view factors, and a sum over all pixels as parallel
lights with exact shadows.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.environment_maps import Lamp, cie_sky, directions, room, uniform
from helpers.synthetic import cratered

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.view import CameraView, ParallelView, looking_camera, oblique_view
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light.environment_map import Panorama
from lcp_catalog.light.sky_sampling import (
    BETWEEN_NODES_RMS,
    samples_of,
    sky_at_nodes,
    sky_at_points,
    sky_rms,
    sky_samples,
)
from lcp_catalog.light.sources import Lighting, SurfacePoints, split_sources
from lcp_catalog.photometry.laws import radiance_factor, reflectance_model
from lcp_catalog.rendering.renderer import Method, render_camera, render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.relief_bounds import nodes_enu
from lcp_catalog.terrain.terrain import Terrain

GSD = 20.0
LAMBERT, LOMMEL = reflectance_model("lambert"), reflectance_model("lommel-seeliger")
ALBEDO = LAMBERT.law[0]


def make(z, core=None):
    z = np.asarray(z, dtype=np.float32)
    rows, cols = z.shape
    field = Heightfield(z, GSD, -(cols // 2) * GSD, (rows // 2) * GSD)
    window = NodeWindow(-(rows // 2), rows - rows // 2, -(cols // 2), cols - cols // 2)
    index = np.zeros(z.shape, np.int16)
    return Terrain(field, EnuFrame(0.0, 0.0), core or (0, rows, 0, cols), window, index, ("made",))


def even(rows=64):
    """A uniform sky of irradiance 1."""
    return uniform(rows, 1.0 / (2.0 * math.pi))


def lit(z, panorama=None, model=LAMBERT, tier="standard", view=None, **how):
    return sky_at_nodes(
        make(z, **how), panorama or even(), view or oblique_view(0.0, 0.0), model, TIERS[tier]
    )


@pytest.mark.slow
@pytest.mark.parametrize("tier", ["draft", "standard", "high"])
def test_a_plain_under_a_uniform_sky(tier):
    """Lambert A / 2 and Lommel-Seeliger w/4 (1 - ln 2) of I / E: integrals of A mu0 and w/4 mu0 / (mu0 + 1) over the
    hemisphere, over 2 pi.
    """
    plain = np.zeros((4, 5))
    assert lit(plain, tier=tier) == pytest.approx(0.5 * ALBEDO, rel=1e-6)
    w = LOMMEL.law[0]
    expected = 0.25 * w * (1.0 - math.log(2.0))
    assert lit(plain, model=LOMMEL, tier=tier) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("slope_deg", [10.0, 25.0, 45.0])
@pytest.mark.parametrize("azimuth", [0.0, 90.0, 225.0])
def test_a_slope_sees_half_of_one_plus_its_cosine(slope_deg, azimuth):
    """An infinite slope: its own plane hides the sky behind it."""
    y, x = np.mgrid[20:-21:-1, -20:21] * GSD
    down = direction_enu(azimuth, 0.0)
    z = -math.tan(math.radians(slope_deg)) * (x * down[0] + y * down[1])
    expected = 0.5 * ALBEDO * (1.0 + math.cos(math.radians(slope_deg))) / 2.0
    found = lit(z)[5:-5, 5:-5]
    assert found == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("steep_deg", [15.0, 30.0])
def test_the_walls_of_a_trench(steep_deg):
    """An infinite V-shaped trench, 40 nodes along each side. By the crossed-strings method a wall
    sees (1 + cos(b + e)) / 2, with its slope b and the elevation e of the opposite edge.
    """
    slope, nodes = math.radians(steep_deg), np.arange(1, 12)
    z = np.tile(math.tan(slope) * np.abs(np.arange(-40, 41)) * GSD, (401, 1))
    found = lit(z, core=(198, 203, 0, 81))[2] / (0.5 * ALBEDO)
    top = np.arctan(math.tan(slope) * (40 - nodes) / (40 + nodes))
    expected = 0.5 * (1.0 + np.cos(slope + top))
    for side in (1, -1):
        assert found[40 + side * nodes] == pytest.approx(expected, rel=0.01)


def test_a_bowl_is_lit_evenly():
    """A spherical bowl of radius R and depth d sees 1 - d / (2 R) of the sky from any inner point:
    the view factor between two parts of a sphere is the area of the second over the sphere's area.
    """
    radius, reach = 2000.0, 1400.0
    y, x = np.mgrid[90:-91:-1, -90:91] * GSD
    r = np.hypot(x, y)
    depth = radius - math.sqrt(radius**2 - reach**2)
    z = np.where(r < reach, radius - depth - np.sqrt(np.maximum(radius**2 - r**2, 0.0)), 0.0)
    found = lit(z)[r < 0.85 * reach] / (0.5 * ALBEDO)
    assert found.mean() == pytest.approx(1.0 - depth / (2.0 * radius), rel=5e-3)
    assert found == pytest.approx(1.0 - depth / (2.0 * radius), rel=0.03)


@pytest.fixture(scope="module")
def many_lights():
    """Every pixel above the horizon as a parallel light from its centre, with exact shadows:
    directions (k, 3), irradiances (k,), and visibility, bool (k, rows, cols).
    """
    terrain, sky = make(cratered(32, GSD, seed=3, relief_m=2.0)), cie_sky(36, 250.0, 25.0)
    sky = sky.times(1.0 / sky.power_above)
    towards = directions(36)[:18].reshape(-1, 3)
    irradiance = (sky.luminance * sky.solid_angles[:, None])[:18].ravel()
    free = np.array([~terrain.field.occluded_nodes(one) for one in towards])
    return terrain, sky, towards, irradiance, free


@pytest.mark.parametrize("altitude_m", [None, 1500.0])
@pytest.mark.parametrize(
    "name", ["lommel-seeliger", "lambert", pytest.param("hapke", marks=pytest.mark.slow)]
)
def test_against_the_sum_over_all_pixels(many_lights, name, altitude_m):
    """From infinity, and from a near camera with a different direction for every node."""
    terrain, sky, towards, irradiance, free = many_lights
    model, looking = reflectance_model(name), direction_enu(100.0, 60.0)
    view = ParallelView(looking) if altitude_m is None else CameraView(looking * altitude_m)
    cameras = view.directions(nodes_enu(terrain.field, terrain.core))
    normals = terrain.field.normals().astype(np.float64)
    emission = np.arccos(np.clip((normals * cameras).sum(-1), -1, 1))
    expected = np.zeros(emission.shape)
    for one, power, lit in zip(towards, irradiance, free, strict=True):
        cosine = normals @ one
        angles = [np.arccos(np.clip(c, -1, 1)) for c in (cosine, cameras @ one)]
        factor = radiance_factor(model, angles[0], emission, angles[1])
        expected += power * np.where(lit & (cosine > 0), factor, 0.0)
    faces = emission < math.pi / 2
    found = sky_at_nodes(terrain, sky, view, model, TIERS["high"])
    assert rms(found[faces], expected[faces]) < 0.006
    assert found[faces].mean() == pytest.approx(expected[faces].mean(), rel=0.003)


def skies():
    lamps = [Lamp(45, 40, 1, 4), Lamp(300, 60, 0.05, 8)]
    return cie_sky(128, 120, 30), split_sources(room(128, lamps, 0.01)).remainder


def many_samples(terrain, sky, counts, shadows):
    tier = replace(TIERS["reference"], sky_directions=counts, sky_tier=shadows)
    return sky_at_nodes(terrain, sky, oblique_view(0.0, 0.0), LOMMEL, tier)


def rms(found, best):
    return float(np.sqrt(np.mean((found - best) ** 2)) / best.mean())


@pytest.mark.slow
@pytest.mark.parametrize("sky", skies(), ids=["clear", "room"])
def test_the_stated_error(sky):
    """Compared with twice the samples of `reference`, over natural terrain; and the error of draft
    shadows.
    """
    terrain = make(cratered(96, GSD, seed=11))
    best = many_samples(terrain, sky, (256, 32), "draft")
    for tier in ("draft", "standard"):
        found = sky_at_nodes(terrain, sky, oblique_view(0.0, 0.0), LOMMEL, TIERS[tier])
        assert rms(found, best) < TIERS[tier].sky_rms
    exact = many_samples(terrain, sky, TIERS["standard"].sky_directions, "high")
    assert rms(found, exact) < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("sky", skies(), ids=["clear", "room"])
@pytest.mark.parametrize("seed", [3, 11])
def test_the_stated_error_of_exact_tiers(sky, seed):
    terrain = make(cratered(128, GSD, seed=seed))
    best = many_samples(terrain, sky, (512, 32), "high")
    for tier in TIERS:
        found = sky_at_nodes(terrain, sky, oblique_view(0.0, 0.0), LOMMEL, TIERS[tier])
        assert rms(found, best) < TIERS[tier].sky_rms


def test_samples_share_the_power_and_follow_it():
    sky = cie_sky(64, 80.0, 20.0)
    samples = sky_samples(sky, 16, 8)
    assert len(samples) == 128
    assert samples.irradiance * 128 == pytest.approx(sky.power_above)
    towards = np.concatenate([samples.directions(k) for k in range(16)])
    assert np.linalg.norm(towards, axis=1) == pytest.approx(np.ones(128))
    assert (towards[:, 2] > 0).all()
    level = samples.irradiance * towards[:, 2].sum()
    assert level == pytest.approx(sky.horizontal_irradiance, rel=5e-3)
    mean = towards.mean(axis=0)
    assert mean / np.linalg.norm(mean) == pytest.approx(sky.middle_above, abs=0.01)
    assert len({round(e, 9) for e in samples.elevations.ravel()}) > 100  # no two strata alike


def test_samples_of_a_lone_pixel_are_in_it():
    light = np.zeros((32, 64))
    light[5, 50] = 3.0
    sky = Panorama(light, azimuth_deg=10.0)
    samples = sky_samples(sky, 8, 4)
    half = 0.5 * sky.pixel_rad
    assert samples.azimuths == pytest.approx(np.full(8, sky.azimuths[50]), abs=half)
    assert samples.elevations == pytest.approx(np.full((8, 4), sky.elevations[5]), abs=half)
    assert np.ptp(samples.elevations) > half


@pytest.mark.parametrize("rows", [32, 33])
def test_the_ground_of_a_panorama_lights_nothing(rows):
    sky = uniform(rows, 1.0)
    bright = Panorama(np.where(np.arange(rows)[:, None] > rows // 2, 1e6, sky.luminance))
    z = cratered(32, GSD, relief_m=3.0)
    assert (lit(z, bright) == lit(z, sky)).all()


def test_a_sky_with_light_only_below_the_horizon():
    light = np.zeros((16, 32))
    light[12] = 1.0
    assert len(samples_of(Panorama(light), TIERS["draft"])) == 0
    assert (lit(np.zeros((4, 4)), Panorama(light)) == 0).all()


def test_results_are_reproducible():
    z = cratered(64, GSD)
    assert (lit(z, cie_sky(32, 10, 20)) == lit(z, cie_sky(32, 10, 20))).all()


def test_turning_the_image_or_its_columns_is_the_same_light():
    """A quarter turn, by azimuth and by rolled columns: different samples of the same sky."""
    z = cratered(64, GSD)
    sky = cie_sky(64, 30.0, 20.0)
    turned = Panorama(sky.luminance, azimuth_deg=90.0)
    rolled = Panorama(np.roll(sky.luminance, 32, axis=1))
    one, other = lit(z, turned), lit(z, rolled)
    assert rms(one, other) < math.sqrt(2.0) * TIERS["standard"].sky_rms  # each has its own samples
    assert rms(lit(z, sky), one) > 0.02  # it does turn


def test_nodata_and_unseen_nodes():
    z = cratered(32, GSD)
    z[10:12, 5:9] = np.nan
    found = lit(z)
    assert np.isnan(found[10:12, 5:9]).all()
    assert np.isfinite(found[20:]).all()
    light = Lighting.of_panorama(split_sources(uniform(16)))
    whole = render_enu(
        make(z), light, oblique_view(0.0, 0.0), Method(model=LAMBERT, accuracy=TIERS["draft"])
    )
    assert np.isnan(whole.radiance[~whole.visible]).all()
    assert (whole.radiance[whole.visible] > 0).all()


def test_without_shadows_only_the_slope_counts():
    plane, z = np.arange(48.0) * 0.5 * GSD + np.zeros((48, 1)), cratered(48, GSD, relief_m=3.0)
    up = make(plane).field.normals()[..., 2]
    assert lit(plane) == pytest.approx(0.25 * ALBEDO * (1.0 + up), rel=0.01)
    free = 0.25 * ALBEDO * (1.0 + make(z).field.normals()[..., 2])
    assert (lit(z) <= 1.01 * free).all()
    assert lit(z).mean() < 0.99 * free.mean()


def camera_over(terrain, off_nadir_deg=20.0, size=64):
    towards = direction_enu(150.0, 90.0 - off_nadir_deg) * 20000.0
    return looking_camera(terrain.frame, towards, GSD, (size * GSD, size * GSD))


def test_a_cameras_pixels_agree_with_the_nodes():
    """Points on nodes have the nodes' radiance."""
    terrain = make(cratered(64, GSD, relief_m=2.0))
    sky = cie_sky(64, 200.0, 30.0)
    field = terrain.field
    rows, cols = (a.ravel() for a in np.mgrid[5:60:3, 4:60:5])
    x, y = field.x0_m + cols * GSD, field.y0_m - rows * GSD
    points = np.stack([x, y, field.z_m[rows, cols].astype(float)], axis=-1)
    normals = field.normals()[rows, cols].astype(np.float64)
    towards = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    at, standard = SurfacePoints(points, normals, towards), TIERS["standard"]
    at_points = sky_at_points(terrain, sky, at, LOMMEL, standard)
    at_nodes = sky_at_nodes(terrain, sky, oblique_view(0.0, 0.0), LOMMEL, TIERS["standard"])[
        rows, cols
    ]
    # the window is a ring of cells around the points; drafts of different windows differ slightly
    assert at_points == pytest.approx(at_nodes, rel=0.02)
    assert np.abs(at_points / at_nodes - 1).mean() < 2e-3
    assert len(sky_at_points(terrain, sky, at.some(slice(0)), LOMMEL, standard)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("tier", ["standard", "high"])
def test_in_the_cameras_plane_against_exact_rays(tier):
    terrain = make(cratered(64, GSD, seed=5))
    sky = cie_sky(64, 200.0, 30.0)
    light = Lighting((Lighting.of_sun(np.array([0.0, 0.0, 1.0])).first,), sky)
    dark = Lighting(light.sources)
    camera = camera_over(terrain, size=20)
    how = {"model": LAMBERT, "accuracy": TIERS[tier]}
    found = render_camera(terrain, camera, light, Method(**how))
    without = render_camera(terrain, camera, dark, Method(**how))
    points = terrain.frame.from_mcmf(found.position_mcmf_m[found.visible])
    normals = terrain.field.normals_at(points[:, 0], points[:, 1])
    expected = np.zeros(len(points))
    samples = samples_of(sky, TIERS[tier])
    for k in range(len(samples.azimuths)):
        for direction in samples.directions(k):
            free = ~terrain.field.occluded_points(points, direction)
            cosine = np.maximum(normals @ direction, 0.0)
            expected += ALBEDO * cosine * free * samples.irradiance
    got = (found.radiance - without.radiance)[found.visible]
    bound = BETWEEN_NODES_RMS if tier == "standard" else 1e-5
    assert np.sqrt(np.mean((got - expected) ** 2)) < bound * expected.mean()


def test_the_error_in_the_plan():
    assert sky_rms(TIERS["standard"]) == TIERS["standard"].sky_rms
    assert sky_rms(TIERS["high"], True) == TIERS["high"].sky_rms
    both = math.hypot(TIERS["draft"].sky_rms, BETWEEN_NODES_RMS)
    assert sky_rms(TIERS["draft"], True) == pytest.approx(both)
