"""Renders compared with analytical cases: level terrain, hills, holes, cameras."""

import numpy as np
import pytest
from helpers.random_scenes import without_shadows
from helpers.twins import in_cells, node_margins, node_margins_to
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.cameras.frame_camera import camera_from_json
from lcp_catalog.cameras.view import (
    CameraView,
    camera_view,
    looking_camera,
    oblique_view,
)
from lcp_catalog.errors import CameraError, SunError
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.rendering.plan import plan_scene
from lcp_catalog.rendering.renderer import Method, render_camera, render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.relief_bounds import ring_needed_m, steepness
from lcp_catalog.terrain.terrain import Terrain

GSD = 20.0


def make(z, core=None, frame=None):
    """A terrain of heights, its middle node near the frame's origin."""
    z = np.asarray(z, dtype=np.float32)
    rows, cols = z.shape
    field = Heightfield(z, GSD, -(cols // 2) * GSD, (rows // 2) * GSD)
    window = NodeWindow(-(rows // 2), rows - rows // 2, -(cols // 2), cols - cols // 2)
    index = np.zeros(z.shape, np.int16)
    core = core or (0, rows, 0, cols)
    return Terrain(field, frame or EnuFrame(12.0, 34.0), core, window, index, ("made",))


def hills(rows=61, cols=75, seed=4, height=60.0):
    """Smooth hills, steep enough to cast shadows and to hide terrain."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:cols]
    z = np.zeros((rows, cols))
    for _ in range(25):
        r, c, s = rng.uniform(0, rows), rng.uniform(0, cols), rng.uniform(2, 6)
        z += rng.uniform(-height, height) * np.exp(-((y - r) ** 2 + (x - c) ** 2) / (2 * s * s))
    return z


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 10.0), (123.0, 45.0), (300.0, 89.0)])
def test_level_ground(azimuth, elevation):
    sun, view = direction_enu(azimuth, elevation), oblique_view(40.0, 200.0)
    result = render_enu(make(np.zeros((9, 11))), sun, view)
    assert result.sunlit.all()
    assert result.visible.all()
    assert result.incidence_deg == pytest.approx(90 - elevation, abs=1e-5)
    assert result.emission_deg == pytest.approx(40.0)
    # spherical law of cosines for the angle between two directions
    e, i, da = np.radians([40.0, 90 - elevation, azimuth - 200.0])
    phase = np.degrees(np.arccos(np.cos(e) * np.cos(i) + np.sin(e) * np.sin(i) * np.cos(da)))
    assert result.phase_deg == pytest.approx(phase, abs=1e-4)
    mu0, mu = np.sin(np.radians(elevation)), np.cos(np.radians(40.0))
    assert result.radiance == pytest.approx(0.21 / 4 * mu0 / (mu0 + mu), rel=1e-6)
    assert result.radiance.dtype == np.float32


@pytest.mark.parametrize(("azimuth", "step"), [(90.0, (0, -1)), (270.0, (0, 1)), (180.0, (-1, 0))])
def test_a_walls_shadow_is_as_long_as_the_textbook_says(azimuth, step):
    """A wall of height h casts a shadow of length h / tan(elevation) away from the Sun: to the west for a Sun
    in the east.
    """
    height, elevation, middle = 100.0, 12.0, 40
    z = np.zeros((81, 81))
    if step[0]:
        z[middle] = height
    else:
        z[:, middle] = height
    result = render_enu(make(z), direction_enu(azimuth, elevation), oblique_view(0.0, 0.0))
    line = result.sunlit[:, 40] > 0 if step[0] else result.sunlit[40] > 0
    away = np.arange(81) - middle
    length = height / np.tan(np.radians(elevation)) / GSD
    behind = away * sum(step) > 1  # the wall's own slope left out
    expected = (away * sum(step)) < length
    assert (~line[behind] == expected[behind]).all()
    assert line[away * sum(step) < -1].all()  # the Sun's side is lit
    assert 20 < length < 30


def test_a_hill_hides_what_is_behind_it():
    z = np.zeros((41, 81))
    z[:, 40] = 100.0
    terrain = make(z)
    view = oblique_view(70.0, 90.0)  # the camera stands in the east, 20 deg high
    result = render_enu(terrain, direction_enu(0.0, 60.0), view)
    behind = 40 - np.arange(81)
    hidden = (behind > 1) & (behind * GSD < 100.0 / np.tan(np.radians(20.0)))
    assert not result.visible[20][hidden].any()
    assert np.isnan(result.radiance[20][hidden]).all()
    assert result.visible[20][
        (behind < -1) | (behind * GSD > 100.0 / np.tan(np.radians(20.0)))
    ].all()


def test_north_and_south_are_alike():
    """The mirrored scene in the mirrored light is the mirrored picture (cells are split along the
    other diagonal).
    """
    z, azimuth, elevation = hills(), 70.0, 15.0
    north = make(z, frame=EnuFrame(12.0, 34.0))
    south = make(z[::-1], frame=EnuFrame(12.0, -34.0))
    a = render_enu(north, direction_enu(azimuth, elevation), oblique_view(30.0, 10.0))
    b = render_enu(south, direction_enu(180 - azimuth, elevation), oblique_view(30.0, 170.0))
    assert (a.sunlit == b.sunlit[::-1]).mean() > 0.97
    both = (a.sunlit * b.sunlit[::-1] > 0) & a.visible & b.visible[::-1]
    assert 0.3 < both.mean() < 0.99
    assert np.allclose(a.radiance[both], b.radiance[::-1][both], rtol=1e-5)
    assert np.allclose(a.incidence_deg, b.incidence_deg[::-1], atol=1e-4)


def test_lit_slopes_face_the_sun():
    y, x = np.mgrid[0:41, 0:41] - 20.0
    dome = make(100.0 * np.exp(-(x**2 + y**2) / 50.0))
    result = render_enu(dome, direction_enu(90.0, 30.0), oblique_view(0.0, 0.0))
    assert result.radiance[20, 25] > result.radiance[0, 0] > result.radiance[20, 15]
    bowl = make(-100.0 * np.exp(-(x**2 + y**2) / 50.0))
    result = render_enu(bowl, direction_enu(90.0, 30.0), oblique_view(0.0, 0.0))
    assert result.radiance[20, 25] < result.radiance[0, 0] < result.radiance[20, 15]


def test_nodata_is_never_rendered():
    z = hills()
    z[20:25, 30:36] = np.nan
    terrain = make(z)
    camera = looking_camera(terrain.frame, [0, 0, 3000.0], GSD, (1400.0, 1100.0))
    sun = direction_enu(100.0, 40.0)
    for view in (
        oblique_view(0.0, 0.0),
        oblique_view(50.0, 300.0),
        camera_view(camera, terrain.frame),
    ):
        result = render_enu(terrain, sun, view)
        hole = np.isnan(terrain.field.z_m)
        assert not result.sunlit[hole].any()
        assert not result.visible[hole].any()
        for band in (result.radiance, result.incidence_deg, result.height_m):
            assert np.isnan(band[hole]).all()
        assert np.isfinite(result.radiance[result.visible]).all()
    seen = render_camera(terrain, camera, sun)
    row, col = np.round(camera.project(terrain.frame.to_mcmf([[-90.0, 160.0, 0]]))[0][::-1]).astype(
        int
    )
    assert not seen.visible[row, col]
    assert np.isnan(seen.position_mcmf_m[row, col]).all()


def test_dark_is_zero_and_unseen_is_nan():
    result = render_enu(make(hills()), direction_enu(100.0, 8.0), oblique_view(75.0, 250.0))
    dark, unseen = result.visible & (result.sunlit == 0), ~result.visible
    assert dark.sum() > 100
    assert unseen.sum() > 100
    assert (result.radiance[dark] == 0).all()
    assert np.isnan(result.radiance[unseen]).all()
    assert (result.radiance[result.visible & (result.sunlit > 0)] > 0).all()


def test_without_cast_shadows_attached_ones_stay():
    terrain, sun = make(hills()), direction_enu(100.0, 8.0)
    full = render_enu(terrain, sun, oblique_view(0.0, 0.0))
    attached = render_enu(
        terrain,
        sun,
        oblique_view(0.0, 0.0),
        Method(plan=without_shadows(terrain, sun, oblique_view(0.0, 0.0))),
    )
    assert (attached.sunlit == (attached.incidence_deg < 90)).all()
    assert (full.sunlit <= attached.sunlit).all()
    assert (full.sunlit < attached.sunlit).sum() > 50
    assert set(np.unique(full.sunlit)) == {0.0, 1.0}  # of a point Sun


def test_holes_forbid_leaving_effects_out():
    z = np.zeros((20, 20))
    z[:, 12:] = 500.0
    z[:, 10:12] = np.nan  # a step that no facet shows
    terrain = make(z)
    plan = plan_scene(terrain, direction_enu(90.0, 20.0), oblique_view(0.0, 0.0))
    assert steepness(terrain.field).tangent == 0.0
    assert plan.cast_shadows.modelled
    lit = render_enu(terrain, direction_enu(90.0, 20.0), oblique_view(0.0, 0.0)).sunlit
    assert not lit[10, 5]


def test_steepness_is_that_of_the_triangles():
    z = np.zeros((4, 4))
    z[1, 1] = 30.0
    # the steepest facet drops 30 m along both of its legs
    assert steepness(make(z).field).tangent == pytest.approx(30.0 * np.sqrt(2) / GSD)


# ---- the camera's plane


def camera_over(terrain, position, size=(1200.0, 900.0), gsd=10.0):
    return looking_camera(terrain.frame, position, gsd, size)


@pytest.mark.parametrize("position", [[0, 0, 4000.0], [2500.0, -1500.0, 3000.0]])
def test_hits_lie_on_the_ground_under_their_pixels(position):
    terrain = make(hills())
    camera = camera_over(terrain, position)
    result = render_camera(terrain, camera, direction_enu(80.0, 30.0))
    seen = result.visible
    assert 0.3 < seen.mean() <= 1.0
    row, col = np.nonzero(seen)
    pixels = camera.project(result.position_mcmf_m[seen])
    assert np.abs(pixels - np.stack([col, row], -1)).max() < 1e-5
    x, y, z = np.moveaxis(terrain.frame.from_mcmf(result.position_mcmf_m[seen]), -1, 0)
    assert np.abs(terrain.field.heights_at(x, y) - z).max() < 1e-5


def test_both_frames_show_the_same():
    """Bands at nodes projected into the camera's plane equal those of the pixels there."""
    terrain, sun = make(hills(height=30.0)), direction_enu(80.0, 20.0)
    camera = camera_over(terrain, [1500.0, 800.0, 3000.0], gsd=2.0)
    plane = render_camera(terrain, camera, sun)
    nodes = render_enu(terrain, sun, camera_view(camera, terrain.frame))
    y, x = np.mgrid[0:61, 0:75]
    enu = np.stack([(x - 37) * GSD, (30 - y) * GSD, terrain.field.z_m], -1)
    pixels = camera.project(terrain.frame.to_mcmf(enu))
    inner = nodes.visible & (x > 3) & (x < 70) & (y > 3) & (y < 57)
    col, row = np.round(pixels[inner]).astype(int).T
    assert inner.sum() > 1000
    assert plane.visible[row, col].mean() > 0.99
    same = (plane.sunlit[row, col] * nodes.sunlit[inner] > 0) & plane.visible[row, col]
    assert (plane.sunlit[row, col] == nodes.sunlit[inner]).mean() > 0.97
    for band, tolerance in (("incidence_deg", 2.0), ("emission_deg", 2.0), ("phase_deg", 0.1)):
        difference = getattr(plane, band)[row, col] - getattr(nodes, band)[inner]
        assert np.quantile(np.abs(difference[same]), 0.95) < tolerance


def test_level_ground_in_the_cameras_plane():
    terrain = make(np.zeros((101, 101)))
    camera = camera_over(terrain, [0, 0, 5000.0])
    result = render_camera(terrain, camera, direction_enu(200.0, 25.0))
    assert result.visible.all()
    assert result.sunlit.all()
    assert result.incidence_deg == pytest.approx(65.0)
    assert np.sqrt(result.emission_deg[45, 0] ** 2) == pytest.approx(
        np.degrees(np.arctan(59.5 * 10 / 5000)), abs=0.01
    )


def test_a_hits_shadow_is_the_walls():
    z = np.zeros((81, 121))
    z[:, 60] = 100.0
    terrain = make(z)
    camera = camera_over(terrain, [0, 0, 1e6], size=(1000.0, 200.0), gsd=5.0)
    result = render_camera(terrain, camera, direction_enu(90.0, 12.0))
    x = terrain.frame.from_mcmf(result.position_mcmf_m)[20, :, 0]
    length = 100.0 / np.tan(np.radians(12.0))
    dark = result.sunlit[20] == 0
    assert dark[(x < -GSD) & (x > -length + 3)].all()
    assert not dark[(x < -length - 3) | (x > 2 * GSD)].any()


def test_sky_is_not_seen():
    terrain = make(hills())
    frame = terrain.frame
    level = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # looks north, level
    camera = camera_from_json(
        {
            "position_mcmf_m": frame.to_mcmf([0, -300.0, 200.0]).tolist(),
            "rotation_mcmf_to_camera": (level @ frame.rotation).tolist(),
            "focal_length_px": 60.0,
            "principal_point_px": [39.5, 29.5],
            "image_size_px": [80, 60],
        }
    )
    result = render_camera(terrain, camera, direction_enu(100.0, 30.0))
    assert not result.visible[:20].any()
    assert np.isnan(result.radiance[:20]).all()
    assert result.visible[-10:].any()


def test_only_the_area_is_drawn_but_all_terrain_hides():
    z = np.zeros((81, 81))
    z[:, 60] = 200.0  # a wall outside the core
    whole, part = make(z), make(z, core=(20, 60, 20, 50))
    sun = direction_enu(90.0, 20.0)
    nodes = render_enu(part, sun, oblique_view(0.0, 0.0))
    assert nodes.sunlit.shape == (40, 30)
    assert np.array_equal(
        nodes.sunlit, render_enu(whole, sun, oblique_view(0.0, 0.0)).sunlit[20:60, 20:50]
    )
    assert not nodes.sunlit[:, -1].any()
    plane = render_camera(part, camera_over(part, [0, 0, 5000.0], size=(1600, 1600)), sun)
    x, y, _ = np.moveaxis(part.frame.from_mcmf(plane.position_mcmf_m[plane.visible]), -1, 0)
    half = GSD / 2 + 1e-6
    assert -20 * GSD - half <= x.min() < x.max() <= 9 * GSD + half
    assert -19 * GSD - half <= y.min() < y.max() <= 20 * GSD + half


def test_only_nodes_inside_the_image_are_visible():
    terrain = make(np.zeros((81, 81)))
    camera = camera_over(terrain, [0, 0, 5000.0], size=(590.0, 390.0))
    seen = render_enu(terrain, direction_enu(0, 45), camera_view(camera, terrain.frame)).visible
    rows, cols = np.nonzero(seen)
    assert (cols.min(), cols.max()) == (40 - 14, 40 + 14)  # 295 m to either side
    assert (rows.min(), rows.max()) == (40 - 9, 40 + 9)


# ---- what cannot be rendered


def test_a_camera_under_the_ground():
    terrain = make(hills() + 500.0)
    camera = camera_over(terrain, [0, 0, 300.0])
    with pytest.raises(CameraError, match="below the surface"):
        render_camera(terrain, camera, direction_enu(0, 45))
    with pytest.raises(CameraError, match=r"the view: .* below the surface"):
        render_enu(terrain, direction_enu(0, 45), CameraView(np.array([0, 0, 300.0])))


def test_a_sun_below_every_horizon():
    terrain = make(hills())
    with pytest.raises(SunError, match="below the horizon"):
        render_enu(terrain, direction_enu(0, -3.0), oblique_view(0.0, 0.0))


def test_a_peak_sees_the_sun_below_its_horizontal():
    """From 3 km up the horizon dips by acos(R / (R + h)) = 3.4 deg."""
    y, x = np.mgrid[0:61, 0:61] - 30.0
    peak = make(3000.0 * np.exp(-(x**2 + y**2) / 20.0))
    lit = render_enu(peak, direction_enu(90.0, -2.0), oblique_view(0.0, 0.0)).sunlit
    assert lit[30, 32]
    assert not lit[30, 20]
    with pytest.raises(SunError):
        render_enu(peak, direction_enu(90.0, -4.0), oblique_view(0.0, 0.0))


def test_the_ring_reaches_what_can_shadow():
    z = np.zeros((101, 101))
    z[50, 90] = 100.0
    coarse = make(z, core=(45, 56, 45, 56))
    # 35 cells of 20 m to the peak: it shadows the core below atan(100 / 700) = 8.1 deg
    assert ring_needed_m(coarse, np.tan(np.radians(6.0)), 0.0) == pytest.approx(36 * GSD)
    assert ring_needed_m(coarse, np.tan(np.radians(10.0)), 0.0) < 10 * GSD


def twin_normals(z):
    """Central differences in plain NumPy, one-sided at the border and beside NaN."""
    padded = np.pad(z.astype(np.float64), 1, constant_values=np.nan)
    here = padded[1:-1, 1:-1]

    def slope(before, after):
        both = (after - before) / (2 * GSD)
        one = np.where(np.isnan(before), (after - here) / GSD, (here - before) / GSD)
        return np.where(np.isnan(before) | np.isnan(after), one, both)

    a, b = slope(padded[1:-1, :-2], padded[1:-1, 2:]), slope(padded[2:, 1:-1], padded[:-2, 1:-1])
    normal = np.stack([-a, -b, np.ones_like(a)], axis=-1)
    return np.where(
        np.isnan(here)[..., None], np.nan, normal / np.linalg.norm(normal, axis=-1)[..., None]
    )


@settings(deadline=None, max_examples=100)
@given(
    seed=st.integers(0, 2**32 - 1),
    azimuths=st.tuples(*[st.integers(0, 3599).map(lambda tenths: tenths / 10 + 0.05)] * 2),
    elevation=st.sampled_from([0.5, 5.0, 20.0, 45.0, 80.0]),
    off_nadir=st.sampled_from([10.0, 45.0, 80.0]),
    near=st.booleans(),
    holes=st.booleans(),
)
def test_sunlit_and_visible_equal_brute_force(seed, azimuths, elevation, off_nadir, near, holes):
    """Every node of random terrain; nodes that the judge itself cannot tell (within 1e-7) are left out.

    No azimuth along a grid line: sin(pi) is not 0 in floating point, and on the raster's last column that
    decides whether there is ground under a ray (test_heightfield.py has the exact directions).
    """
    rng = np.random.default_rng(seed)
    z = (rng.normal(size=rng.integers(2, 13, 2)) * rng.choice([1.0, 8.0, 60.0])).astype(np.float32)
    if holes:
        z[rng.random(z.shape) < 0.15] = np.nan
    if not np.isfinite(z).any():
        z[0, 0] = 0.0
    terrain = make(z)
    sun = direction_enu(azimuths[0], elevation)
    view = oblique_view(off_nadir, azimuths[1], 3000.0 if near else None)
    result = render_enu(terrain, sun, view)
    normals = twin_normals(z)
    field = terrain.field
    y, x = np.mgrid[0 : z.shape[0], 0 : z.shape[1]]
    points = np.stack([field.x0_m + x * GSD, field.y0_m - y * GSD, z.astype(np.float64)], axis=-1)
    towards = view.directions(points)
    shade = node_margins(z, in_cells(sun, GSD))
    if near:
        u, v = (view.position_m[0] - field.x0_m) / GSD, (field.y0_m - view.position_m[1]) / GSD
        hidden = node_margins_to(z, (u, v, view.position_m[2]))
    else:
        hidden = node_margins(z, in_cells(view.direction, GSD))
    with np.errstate(invalid="ignore"):
        for band, margin, cosine in (
            (result.sunlit, shade, normals @ sun),
            (result.visible, hidden, np.sum(normals * towards, axis=-1)),
        ):
            expected = ~(margin > 0) & (cosine > 0)
            sure = ~(np.abs(margin) < 1e-7) & ~(np.abs(cosine) < 1e-6)
            np.testing.assert_array_equal(np.asarray(band)[sure] > 0, expected[sure])
