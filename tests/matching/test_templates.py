"""Renders of patches: compared with exact rays, one by one, and with closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.catalogs import ALBEDO_MAP
from helpers.twins_match import catalog_of_dem, catalog_of_patches, looking_at, traced_image
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lcp_catalog.cameras.sensor import FullSensor, Reduced
from lcp_catalog.catalog.patch_terrain import nodes_mcmf
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.kernels.matching import draw_patch, point_spread, subpixel_fit
from lcp_catalog.landmarks.point_spread import BORDER_NODES, border_px, template_pixels
from lcp_catalog.matching.templates import TOLERANCE_PX, node_pixels, render_patches
from lcp_catalog.photometry.laws import DEFAULT_MODEL, photometry, reflectance_model
from lcp_catalog.terrain.heightfield import Heightfield

GSD_M = 100.0
MODELS = ("lommel-seeliger", "lambert", "lunar-lambert", "minnaert:0.7", "hapke")


def frame_of(catalog, row=0):
    return EnuFrame(
        float(catalog.longitude[row]), float(catalog.latitude[row]), float(catalog.elevation[row])
    )


def hill(height_m=300.0, width_m=500.0, nodes=33, at_m=(130.0, -70.0)):
    """Heights of a Gaussian hill, 0 at the middle node."""
    step = (np.arange(nodes) - nodes // 2) * GSD_M
    east, north = np.meshgrid(step, -step)
    z = height_m * np.exp(-((east - at_m[0]) ** 2 + (north - at_m[1]) ** 2) / (2 * width_m**2))
    return (z - z[nodes // 2, nodes // 2]).astype(np.float32)


def rendered(catalog, frame, camera, sun, model=DEFAULT_MODEL, sigma=0.0):
    return render_patches(
        catalog, [0], camera, frame.direction_to_mcmf(sun)[None], model, psf_sigma_px=sigma
    )


def beside_rays(catalog, frame, camera, sun, model=DEFAULT_MODEL, rays=6):
    """A template, the exact rays' image of it, and the pixels that both see completely."""
    template = rendered(catalog, frame, camera, sun, model)
    rows, cols = template.shape
    window = (*template.origin[0], cols, rows)
    traced, share = traced_image(
        catalog.dem[0], float(catalog.gsd[0]), frame, camera, sun, window, rays, model
    )
    return template, traced, share, template.mask[0] & (share > 0.999)


def shift_between(template, traced, both):
    """Shift of the rays' image from the template, pixels (2,)."""
    out = np.full((1, subpixel_fit.NUMBERS), np.nan)
    subpixel_fit.refine(
        template.drawing, template.sub, template.sigma_px, 0.95, traced.astype(np.float32),
        both.astype(np.float32), np.zeros((1, 2), np.int64), np.zeros((1, 2)), True, out,
    )  # fmt: skip
    return out[0, :2]


@pytest.fixture(scope="module")
def hadley():
    """Real patches, 33 x 33 nodes of 118 m: the second is smooth, the first has a deep shadow under
    a Sun in the east.
    """
    rng = np.random.default_rng(0)
    return catalog_of_dem(rng.uniform(1, 6, 10)[:2], rng.uniform(23, 28, 10)[:2], 33, 118.45)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pixel_m", "off_nadir", "roll"),
    [(390.0, 0, 0), (118.0, 40, 77), (60.0, 20, 200), (40.0, 0, 300)],
)
def test_real_patch_is_what_exact_rays_see(hadley, pixel_m, off_nadir, roll):
    catalog = replace_rows(hadley, [1])
    frame = frame_of(catalog)
    camera = looking_at(
        frame, 80e3, off_nadir, 130, roll, 80e3 / pixel_m, (4000, 4000), (1999.3, 1998.8)
    )
    sun = direction_enu(200, 12)
    template, traced, share, both = beside_rays(catalog, frame, camera, sun)
    difference = (template.values[0] - traced)[both]
    assert np.sqrt(np.mean(difference**2)) < 0.01 * traced[both].std()
    assert both.sum() > 0.9 * (share > 0.999).sum()
    assert not (template.mask[0] & (share < 0.75)).any()  # nine samples a pixel are what it knows
    assert np.abs(shift_between(template, traced, both)).max() < 0.01 * max(1.0, 60.0 / pixel_m)


def replace_rows(catalog, rows):
    frames = [frame_of(catalog, row) for row in rows]
    return catalog_of_patches(catalog.dem[rows], frames, float(catalog.gsd[0]))


@pytest.mark.parametrize("factor", [1, 2, 4])
def test_a_reduced_image_shows_means_of_the_full_one(hadley, factor):
    """The template for an image that is reduced: the area means of that for the full one, which the point spread of full
    pixels has passed.
    """
    catalog = replace_rows(hadley, [1])
    frame = frame_of(catalog)
    camera = looking_at(frame, 80e3, 20, 130, 70, 80e3 / 40.0, (4000, 4000), (1999.3, 1998.8))
    sun = frame.direction_to_mcmf(direction_enu(200, 12))[None]
    full = render_patches(catalog, [0], camera, sun)
    small = render_patches(catalog, [0], Reduced(camera, factor), sun)
    rows, cols = small.shape
    wide = np.full((rows * factor, cols * factor), np.nan)
    col, row = factor * small.origin[0] - full.origin[0]
    down, right = (np.arange(rows * factor) + row, np.arange(cols * factor) + col)
    inside = np.ix_((down >= 0) & (down < full.shape[0]), (right >= 0) & (right < full.shape[1]))
    seen = np.where(full.mask[0], full.values[0], np.nan)
    wide[inside] = seen[np.ix_(down[inside[0][:, 0]], right[inside[1][0]])]
    means = wide.reshape(rows, factor, cols, factor).mean(axis=(1, 3))
    both = small.mask[0] & np.isfinite(means)
    assert both.sum() > 0.7 * small.mask[0].sum() > 200
    off = (small.values[0] - means)[both]
    assert np.sqrt(np.mean(off**2)) < 0.012 * means[both].std()


def test_deep_shadow_has_its_edge_between_nodes(hadley):
    # with edges at the nodes the rms would be three times as large
    catalog = replace_rows(hadley, [0])
    frame = frame_of(catalog)
    camera = looking_at(frame, 80e3, 0, 0, 0, 80e3 / 118.0, (4000, 4000), (1999.3, 1998.8))
    template, traced, _, both = beside_rays(catalog, frame, camera, direction_enu(90, 20))
    assert (traced[both] == 0.0).mean() > 0.1
    difference = (template.values[0] - traced)[both]
    assert np.sqrt(np.mean(difference**2)) < 0.015 * traced[both].std()
    assert np.abs(shift_between(template, traced, both)).max() < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("latitude", [-63.0, 0.0, 41.0])
def test_no_bias_at_any_roll(latitude):
    frame = EnuFrame(170.0, latitude, 900.0)
    catalog = catalog_of_patches(hill()[None], [frame], GSD_M)
    sun = direction_enu(60, 35)
    shifts = []
    for roll in range(0, 360, 45):
        camera = looking_at(
            frame,
            60e3,
            15,
            70,
            roll,
            60e3 / GSD_M,
            (500, 500),
            (249.5 + roll / 97, 248 - roll / 89),
        )
        template, traced, _, both = beside_rays(catalog, frame, camera, sun)
        shifts.append(shift_between(template, traced, both))
    assert np.abs(np.mean(shifts, axis=0)).max() < 0.002
    assert np.abs(shifts).max() < 0.01


@pytest.mark.parametrize("name", MODELS)
def test_level_ground_has_the_radiance_of_the_law(name):
    frame = EnuFrame(12.0, -35.0, -1200.0)
    catalog = catalog_of_patches(np.zeros((1, 21, 21), np.float32), [frame], GSD_M)
    camera = looking_at(frame, 70e3, 33, 250, 20, 700.0, (400, 400))
    sun, model = direction_enu(40, 25), reflectance_model(name)
    template = rendered(catalog, frame, camera, sun, model)
    towards = direction_enu(250, 57)
    one = photometry(
        np.array([[0.0, 0.0, 1.0]]), sun, towards[None], np.ones(1, bool), np.ones(1, bool), model
    )
    row, col = (
        int(v)
        for v in np.round(camera.project(frame.origin_mcmf_m))[::-1] - template.origin[0, ::-1]
    )
    assert template.mask[0, row, col]
    assert template.values[0, row, col] == pytest.approx(one.radiance[0], rel=2e-3)


@pytest.mark.parametrize("name", ["lunar-lambert", "hapke"])
def test_other_laws_are_what_exact_rays_see(name):
    # a wide view from low above: directions and phases differ by 6 degrees over the patch
    frame = EnuFrame(12.0, 5.0, 0.0)
    catalog = catalog_of_patches(hill()[None], [frame], GSD_M)
    camera = looking_at(frame, 25e3, 20, 300, 10, 250.0, (200, 200))
    template, traced, _, both = beside_rays(
        catalog, frame, camera, direction_enu(110, 30), reflectance_model(name)
    )
    assert template.values[0][both] == pytest.approx(traced[both], rel=0.01)


def test_covers_the_pixels_that_the_patch_covers():
    # 20 cells of 100 m seen from straight above, pixels of 50 m: 40 x 40, the patch's middle on a corner of pixels
    frame = EnuFrame(0.0, 0.0)
    catalog = catalog_of_patches(np.zeros((1, 21, 21), np.float32), [frame], GSD_M)
    camera = looking_at(frame, 50e3, 0, 0, 0, 1000.0, (600, 600), (300.5, 280.5))
    template = rendered(catalog, frame, camera, direction_enu(0, 45))
    rows, cols = np.nonzero(template.mask[0])
    assert (cols.min() + template.origin[0, 0], cols.max() + template.origin[0, 0]) == (281, 320)
    assert (rows.min() + template.origin[0, 1], rows.max() + template.origin[0, 1]) == (261, 300)
    assert template.mask[0].sum() == 1600
    np.testing.assert_allclose(template.predicted_px[0], (300.5, 280.5), atol=1e-9)


@pytest.mark.parametrize("factor", [1, 2, 3, 8])
def test_a_template_has_the_pixels_that_a_claim_counts(factor):
    """Of a patch W pixels wide W - b by W cos e - b, seen from many sides and in pixels of 1 to 4 cells; what a claim evaluates
    for each scale is as near to that as whole nodes are.
    """
    frame, dice = EnuFrame(30.0, 10.0), np.random.default_rng(factor)
    catalog = catalog_of_patches(0.0 * hill()[None], [frame], GSD_M)
    sun, border = frame.direction_to_mcmf(direction_enu(90, 30))[None], border_px(factor)
    for cells in (1.0, 1.4, 2.0, 2.8, 4.0):
        shares = []
        for off in np.tile([0.0, 20.0, 40.0], 20):
            focal = 2e6 * factor / (cells * GSD_M)
            middle = 2000.0 * np.ones(2) + dice.uniform(-factor, factor, 2)
            angles = off, dice.uniform(0, 360), dice.uniform(0, 360)
            camera = looking_at(frame, 2e6, *angles, focal, (4000, 4000), tuple(middle))
            mask = render_patches(catalog, [0], Reduced(camera, factor), sun).mask
            wide = 32.0 / cells
            counted = (wide - border) * (wide * np.cos(np.radians(off)) - border)
            shares.append(mask.sum() / counted)
        assert np.mean(shares) == pytest.approx(1.0, abs=0.04), cells
    for nodes in (9, 17, 33, 65):
        wanted = float(template_pixels(nodes, np.ones(1))[0])
        nearest = min(range(nodes % 2, nodes + 1, 2), key=lambda side: abs(side**2 - wanted))
        assert nodes - 2 * BORDER_NODES == nearest


def test_north_is_up_and_the_sun_comes_from_its_side():
    # a hill lit from the east, seen with north up: bright on the right, and where the hill is
    frame = EnuFrame(30.0, 10.0)
    catalog = catalog_of_patches(hill(at_m=(600.0, 900.0))[None], [frame], GSD_M)
    camera = looking_at(frame, 50e3, 0, 0, 0, 500.0, (300, 300))
    values = rendered(catalog, frame, camera, direction_enu(90, 30)).values[0]
    row, col = np.unravel_index(np.argmax(values), values.shape)
    middle = (np.array(values.shape) - 1) / 2
    assert (col - middle[1], row - middle[0]) == pytest.approx((6 + 5, -9), abs=1.5)


def test_hides_what_stands_behind_a_hill():
    frame = EnuFrame(30.0, 10.0)
    catalog = catalog_of_patches(hill(900.0, 400.0)[None], [frame], GSD_M)
    camera = looking_at(frame, 60e3, 62, 180, 0, 600.0, (300, 300))
    template, traced, _, both = beside_rays(catalog, frame, camera, direction_enu(100, 40))
    seen = traced[both]
    assert both.sum() > 300
    off = np.abs(template.values[0][both] - seen) / seen.std()
    assert off.mean() < 0.02
    assert (off > 0.1).mean() < 0.05  # along the crest


def test_albedo_multiplies():
    frame = EnuFrame(0.0, 0.0)
    catalog = catalog_of_patches(hill()[None], [frame], GSD_M)
    albedo = np.ones((1, 33, 33), np.float32)
    albedo[:, :, 17:] = 1.4
    brighter = replace(catalog, albedo=albedo, albedo_map=ALBEDO_MAP)
    camera = looking_at(frame, 50e3, 0, 0, 0, 500.0, (300, 300))
    plain, bright = (rendered(c, frame, camera, direction_enu(90, 30)) for c in (catalog, brighter))
    ratio = bright.values[0] / np.where(plain.mask[0], plain.values[0], np.nan)
    middle = plain.predicted_px[0, 0] - plain.origin[0, 0]
    cols = np.arange(ratio.shape[1])
    np.testing.assert_allclose(ratio[5:-5, cols < middle - 2][:, 2:], 1.0, rtol=1e-5)
    np.testing.assert_allclose(ratio[5:-5, cols > middle + 2][:, :-3], 1.4, rtol=1e-5)


def test_what_the_camera_cannot_see_is_empty():
    frame = EnuFrame(0.0, 0.0)
    catalog = catalog_of_patches(np.array([hill(), hill()]), [frame, EnuFrame(0.0, 30.0)], GSD_M)
    camera = looking_at(frame, 50e3, 0, 0, 0, 500.0, (300, 300))
    turned = replace(
        camera,
        rotation_mcmf_to_camera=-camera.rotation_mcmf_to_camera @ np.diag([-1.0, -1.0, -1.0]),
    )
    behind = replace(
        camera, rotation_mcmf_to_camera=np.diag([1.0, -1.0, -1.0]) @ camera.rotation_mcmf_to_camera
    )
    sun = np.repeat(frame.direction_to_mcmf(direction_enu(90, 30))[None], 2, axis=0)
    assert render_patches(catalog, [0, 1], turned, sun).mask[0].any()
    empty = render_patches(catalog, [0, 1], behind, sun)
    assert not empty.mask.any()
    assert len(render_patches(catalog, [], camera, sun[:0])) == 0


def test_a_patch_right_before_the_camera_is_not_drawn():
    # 33 nodes of 100 m from 100 m above: tens of thousands of pixels
    frame = EnuFrame(0.0, 0.0)
    catalog = catalog_of_patches(np.zeros((1, 33, 33), np.float32), [frame], GSD_M)
    camera = looking_at(frame, 100.0, 0, 0, 0, 2000.0, (300, 300))
    template = rendered(catalog, frame, camera, direction_enu(90, 30))
    assert not template.mask.any()
    assert template.shape == (1, 1)


def test_the_back_of_a_slope_is_not_drawn():
    # ground that falls to the south by 50 degrees, seen from the south and, from within, from the north
    frame = EnuFrame(0.0, 0.0)
    step = (np.arange(21) - 10) * GSD_M
    slope = np.repeat(np.tan(np.radians(50.0)) * -step[:, None], 21, axis=1).astype(np.float32)
    catalog = catalog_of_patches(slope[None], [frame], GSD_M)
    south, north = (looking_at(frame, 60e3, 60, a, 0, 600.0, (300, 300)) for a in (180, 0))
    assert rendered(catalog, frame, south, direction_enu(170, 40)).mask.sum() > 200
    assert not rendered(catalog, frame, north, direction_enu(170, 40)).mask.any()


def test_missing_nodes_are_not_drawn():
    frame = EnuFrame(0.0, 0.0)
    z = hill()
    z[:8, :8] = np.nan
    camera = looking_at(frame, 50e3, 0, 0, 0, 500.0, (300, 300))
    catalog = catalog_of_patches(hill()[None], [frame], GSD_M)
    object.__setattr__(catalog, "dem", z[None])  # a catalogue refuses gaps; other callers may not
    template = rendered(catalog, frame, camera, direction_enu(90, 30))
    assert not template.mask[0, :7, :7].any()
    assert template.mask[0, 12:-2, 12:-2].all()


def test_nodes_lie_where_the_frame_puts_them():
    frame = EnuFrame(211.0, -77.0, 3000.0)
    catalog = catalog_of_patches(hill()[None], [frame], GSD_M)
    step = (np.arange(33) - 16) * GSD_M
    east, north = np.meshgrid(step, -step)
    expected = frame.to_mcmf(np.stack([east, north, catalog.dem[0]], axis=-1))
    np.testing.assert_allclose(nodes_mcmf(catalog, [0])[0], expected, atol=1e-6)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@example(seed=2447, azimuth=243.0, elevation=0.5)  # hidden by the border's own edge alone
@given(
    seed=st.integers(0, 10**6),
    azimuth=st.one_of(
        st.sampled_from([0, 45, 90, 135, 180, 225, 270, 315]),
        st.floats(0, 360).map(lambda a: round(a, 3)),
    ),
    elevation=st.floats(0.5, 60),
)
def test_clearance_is_negative_exactly_where_the_patch_shades_itself(seed, azimuth, elevation):
    rng = np.random.default_rng(seed)
    z = (rng.standard_normal((14, 11)).cumsum(0) * 40.0).astype(np.float32)
    sun = np.round(direction_enu(azimuth, elevation), 15)
    out = np.empty(z.shape, np.float32)
    draw_patch.clearances(z, GSD_M, sun, out)
    np.testing.assert_array_equal(out < 0.0, Heightfield(z, GSD_M).occluded_nodes(sun))


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    cycles=st.floats(0.02, 0.3),
    sigma=st.floats(0.2, 1.0),
    shift=st.floats(-0.8, 0.8),
    sub=st.integers(4, 8),
    down=st.booleans(),
)
def test_a_wave_is_damped_as_square_and_gaussian_damp_it(cycles, sigma, shift, sub, down):
    # box of one pixel: sinc(f); Gaussian: exp(-2 pi^2 f^2 sigma^2); the samples hold the wave at their middles
    rows = cols = 24
    place = (np.arange(cols * sub) + 0.5) / sub - 0.5
    wave = np.broadcast_to(2.0 + np.cos(2 * np.pi * cycles * place), (rows * sub, cols * sub))
    wave = np.ascontiguousarray(wave.T if down else wave, dtype=np.float32)
    margin = point_spread.margin_for(sub, sigma, 1.0)
    light, known = point_spread.unpack_drawing(wave, sub, margin)
    out = np.empty((4, rows, cols), np.float32)
    moves = (0.3, shift) if down else (shift, 0.3)
    point_spread.blurred(light, known, margin, sub, sigma, *moves, out)
    damped = np.sinc(cycles) * np.exp(-2 * (np.pi * cycles * sigma) ** 2)
    turn = 2 * np.pi * cycles * (np.arange(cols) - shift)
    inner = slice(6, -6)
    value, slope = (out[0].T, out[2].T) if down else (out[0], out[1])
    tolerance = 2e-3 + 0.5 * (2 * np.pi * cycles / sub) ** 2 / 12
    np.testing.assert_allclose(value[8, inner], (2 + damped * np.cos(turn))[inner], atol=tolerance)
    expected = 2 * np.pi * cycles * damped * np.sin(turn)
    np.testing.assert_allclose(slope[8, inner], expected[inner], atol=4 * tolerance)
    assert out[3, 8, 8] == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("sub", [3, 4, 8])
@pytest.mark.parametrize(("cycles", "sigma"), [(0.1, 0.5), (0.3, 0.45), (0.3, 0.7)])
def test_a_samples_own_square_is_taken_out_of_the_spread(sub, cycles, sigma):
    # squares of 1/sub for the samples: sinc(f / sub), for which the Gaussian's variance is 1 / (12 sub^2) less
    place = (np.arange(24 * sub) + 0.5) / sub - 0.5
    wave = np.tile(np.cos(2 * np.pi * cycles * place), (24 * sub, 1)).astype(np.float32)
    values, mask = np.empty((1, 24, 24), np.float32), np.empty((1, 24, 24), np.bool_)
    point_spread.templates(wave[None], sub, sigma, 0.9, values, mask)
    narrow2 = sigma**2 - 1.0 / (12.0 * sub**2)
    left = np.sinc(cycles) * np.sinc(cycles / sub) * np.exp(-2 * (np.pi * cycles) ** 2 * narrow2)
    wanted = left * np.cos(2 * np.pi * cycles * np.arange(24))
    np.testing.assert_allclose(values[0, 12, 6:18], wanted[6:18], atol=5e-4)


def test_nodes_far_closer_than_pixels_are_drawn():
    # 97 nodes of 100 m in pixels of 1200 m: 8 x 8 pixels, triangles of a fifth of a sample
    frame = EnuFrame(0.0, 0.0)
    catalog = catalog_of_patches(hill(nodes=97)[None], [frame], GSD_M)
    camera = looking_at(frame, 60e3, 0, 0, 0, 50.0, (61, 61), (30.5, 30.5))
    template = rendered(catalog, frame, camera, direction_enu(60, 35))
    assert template.mask[0].sum() == 64


def test_the_point_spread_stays_within_the_patch():
    # half a drawing is missing: its edge is not darkened, and pixels that see less than the share asked for are left out
    drawing = np.full((1, 60, 60), 5.0, np.float32)
    drawing[:, :, :30] = np.nan
    values, mask = np.empty((1, 20, 20), np.float32), np.empty((1, 20, 20), np.bool_)
    point_spread.templates(drawing, 3, 0.7, 0.9, values, mask)
    assert not mask[0, :, :10].any()
    assert mask[0, 5:15, 11:17].all()
    np.testing.assert_allclose(values[mask], 5.0, rtol=1e-5)
    np.testing.assert_array_equal(values[~mask], 0.0)


class Slow(FullSensor):
    """A sensor with a camera's geometry, and a jump if one is given. Counts what it projects."""

    def __init__(self, camera, jump_px=0.0):
        self.camera, self.jump_px, self.projected = camera, jump_px, 0

    def project(self, points):
        self.projected += np.size(points) // 3
        pixels = self.camera.project(points)
        return pixels + self.jump_px * (pixels[..., :1] > 255.0)

    def towards(self, points):
        return self.camera.towards(points)


@pytest.mark.parametrize(
    ("away_m", "jump_px", "share"), [(100e3, 0.0, 0.1), (8e3, 0.0, 1.1), (100e3, 2.0, 1.1)]
)
def test_slow_sensors_are_asked_for_few_nodes_if_that_is_exact(away_m, jump_px, share):
    # from 8 km above 3.2 km of ground are no polynomial; a sensor that jumps is none either
    frames = [EnuFrame(10.0, 40.0), EnuFrame(10.05, 40.05)]
    catalog = catalog_of_patches(np.array([hill(), hill(500.0, 350.0)]), frames, GSD_M)
    camera = looking_at(frames[0], away_m, 25, 40, 33, away_m / 100.0, (500, 500))
    slow, rows = Slow(camera, jump_px), np.arange(2)
    nodes = nodes_mcmf(catalog, rows)
    pixels = node_pixels(catalog, rows, nodes, slow)
    assert np.abs(pixels - Slow(camera, jump_px).project(nodes)).max() < 2 * TOLERANCE_PX
    assert slow.projected <= share * nodes.size / 3
    np.testing.assert_array_equal(node_pixels(catalog, rows, nodes, camera), camera.project(nodes))
