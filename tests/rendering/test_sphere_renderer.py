"""The sphere tier's bands, judged in plain loops, by brute force over pixels, and by the
heightfield of the same sphere.
"""

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.sphere_views import LAMBERT, SEELIGER, WHOLE, R, far_camera, lit_from, window_of
from helpers.twins_sphere import angle_between, exact_range
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.view import (
    CameraView,
    camera_view,
    looking_camera,
    oblique_view,
)
from lcp_catalog.errors import CameraError, SunError
from lcp_catalog.geometry import sphere_intersection
from lcp_catalog.geometry.frames import EnuFrame, direction_enu, lonlat_to_mcmf
from lcp_catalog.light.sources import Lighting
from lcp_catalog.rendering.renderer import Method, render_camera, render_enu
from lcp_catalog.rendering.sphere_renderer import (
    render_sphere_camera,
    render_sphere_enu,
    sphere_nodes,
)
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain

# ---- at nodes


def test_nodes_in_plain_arithmetic():
    """Every band of a window over half the Moon, from each node's longitude and latitude."""
    frame, gsd = EnuFrame(33.0, -21.0), 43e3
    sun, view = direction_enu(70.0, 25.0), oblique_view(30.0, 200.0, 2e6)
    result = render_sphere_enu(frame, WHOLE, gsd, Lighting.of_sun(sun), view, model=LAMBERT)
    camera = frame.to_mcmf(view.position_m)
    to_sun = frame.direction_to_mcmf(sun)
    checked = 0
    for i, j in ((0, 0), (40, 40), (12, 55), (70, 31), (40, 79), (5, 40), (66, 66), (20, 20)):
        x, y = (j - 40) * gsd, (40 - i) * gsd
        if x * x + y * y >= R * R:
            assert np.isnan(result.height_m[i, j])
            assert np.isnan(result.radiance[i, j])
            assert result.visible[i, j] == 0
            continue
        checked += 1
        up, north, east = (
            lonlat_to_mcmf(33.0, -21.0) / R,
            lonlat_to_mcmf(33.0, 69.0) / R,
            lonlat_to_mcmf(123.0, 0.0) / R,
        )
        normal = (x * east + y * north + math.sqrt(R * R - x * x - y * y) * up) / R
        towards = camera - R * normal
        incidence = angle_between(normal, to_sun)
        assert result.incidence_deg[i, j] == pytest.approx(incidence, rel=1e-6)
        assert result.emission_deg[i, j] == pytest.approx(angle_between(normal, towards), rel=1e-6)
        assert result.phase_deg[i, j] == pytest.approx(angle_between(to_sun, towards), rel=1e-6)
        seen = angle_between(normal, towards) < 90
        assert result.visible[i, j] == seen
        assert result.sunlit[i, j] == (incidence < 90)
        expected = 0.12 * max(0.0, math.cos(math.radians(incidence))) if seen else np.nan
        assert result.radiance[i, j] == pytest.approx(expected, rel=1e-6, nan_ok=True)
        assert result.height_m[i, j] == pytest.approx(R * (normal @ up) - R, rel=1e-6, abs=1e-2)
    assert checked >= 5


def smooth_terrain(frame, half, gsd):
    """The heightfield of the sphere itself, one node wider than its core."""
    x = np.arange(-half - 1, half + 2) * gsd
    z = sphere_nodes(*np.meshgrid(x, -x))[..., 2]
    field = Heightfield(z.astype(np.float32), gsd, float(x[0]), float(-x[0]))
    core = (1, 2 * half + 2, 1, 2 * half + 2)
    index = np.zeros((2 * half + 1, 2 * half + 1), np.int16)
    window = NodeWindow(-half - 1, half + 2, -half - 1, half + 2)
    return Terrain(field, frame, core, window, index, ("made",))


@pytest.mark.parametrize("disc", [False, True])
@pytest.mark.parametrize("model", [LAMBERT, SEELIGER])
def test_nodes_are_those_of_the_heightfield(disc, model):
    """The heightfield of the sphere, rendered by rays, against the sphere: its float32 heights tilt
    normals by 1e-6, and that is all that differs, but for the disc's part under a facet.
    """
    frame, gsd, half = EnuFrame(200.0, 48.0), 500.0, 24
    terrain = smooth_terrain(frame, half, gsd)
    light, view = lit_from(120.0, 8.0, disc), oblique_view(20.0, 310.0, 90e3)
    ours = render_sphere_enu(
        frame, NodeWindow(-half, half + 1, -half, half + 1), gsd, light, view, model=model
    )
    theirs = render_enu(terrain, light, view, Method(model=model, accuracy=TIERS["reference"]))
    assert (ours.visible == theirs.visible).all()
    for band in ("radiance", "sunlit", "incidence_deg", "emission_deg", "phase_deg", "height_m"):
        assert getattr(ours, band) == pytest.approx(getattr(theirs, band), rel=3e-5), band


def test_a_camera_limits_what_nodes_are_visible():
    frame = EnuFrame(0.0, 0.0)
    camera = looking_camera(frame, [0, 0, 2e5], 1000.0, (31e3, 21e3))
    result = render_sphere_enu(
        frame, window_of(60e3, 1000.0), 1000.0, lit_from(0, 60), camera_view(camera, frame)
    )
    rows, cols = np.nonzero(result.visible)
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (20, 40, 15, 45)


# ---- in the camera's plane


def test_pixels_in_sixty_digits():
    """Ranges in an image of the whole disc, and the bands at the points that its pixels see."""
    frame = EnuFrame(300.0, 17.0)
    camera, light = far_camera(frame, 4e6, 24), lit_from(80.0, 40.0)
    result = render_sphere_camera(frame, camera, light)
    to_sun, here = frame.direction_to_mcmf(light.first.direction), camera.position_mcmf_m
    whole = np.argwhere(result.visible == 1.0)
    assert len(whole) > 150
    for i, j in whole[::7]:
        place = result.position_mcmf_m[i, j]
        ray = camera.rays([float(j), float(i)])
        assert np.linalg.norm(place - here) == pytest.approx(
            float(exact_range(here, ray)), rel=1e-12
        )
        assert np.linalg.norm(place) == pytest.approx(R, rel=1e-15)
        assert camera.project(place) == pytest.approx([j, i], abs=1e-8)
        normal, towards = place / R, here - place
        angles = [
            angle_between(*pair)
            for pair in ((normal, to_sun), (normal, towards), (to_sun, towards))
        ]
        assert result.incidence_deg[i, j] == pytest.approx(angles[0], abs=1e-8)
        assert result.emission_deg[i, j] == pytest.approx(angles[1], abs=1e-8)
        assert result.phase_deg[i, j] == pytest.approx(angles[2], abs=1e-8)
        mu0, mu = (math.cos(math.radians(a)) for a in angles[:2])
        expected = 0.0525 * mu0 / (mu0 + mu) if mu0 > 0 else 0.0
        assert result.radiance[i, j] == pytest.approx(expected, rel=1e-9)
    sky = result.visible == 0.0
    assert np.isnan(result.radiance[sky]).all()
    assert np.isnan(result.position_mcmf_m[sky]).all()
    assert (result.sunlit[sky] == 0.0).all()


@pytest.mark.parametrize("disc", [False, True])
def test_pixels_are_those_of_the_heightfield(disc):
    frame, gsd, half = EnuFrame(10.0, -60.0), 500.0, 30
    terrain = smooth_terrain(frame, half, gsd)
    camera = looking_camera(frame, [20e3, -30e3, 80e3], 700.0, (40e3, 30e3))
    light = lit_from(15.0, 12.0, disc)
    theirs = render_camera(terrain, camera, light, Method(accuracy=TIERS["reference"]))
    reach = (half + 0.5) * gsd
    ours = render_sphere_camera(frame, camera, light, extent_m=(-reach, reach, -reach, reach))
    both = (ours.visible > 0) & theirs.visible
    assert both.sum() > 0.6 * both.size
    assert ((ours.visible > 0) != theirs.visible).sum() <= 4  # within rounding of the area's edge
    for band in ("radiance", "sunlit", "incidence_deg", "emission_deg", "phase_deg"):
        ours_, theirs_ = getattr(ours, band)[both], getattr(theirs, band)[both]
        # the outermost nodes' normals are one-sided: half a cell, 1.4e-4 rad
        assert ours_ == pytest.approx(theirs_, rel=5e-4), band
    # facets lie gsd^2 / 4 R = 4 cm under the sphere
    assert ours.position_mcmf_m[both] == pytest.approx(theirs.position_mcmf_m[both], abs=0.1)


def test_what_is_outside_an_extent_is_not_drawn():
    frame = EnuFrame(0.0, 0.0)
    camera = far_camera(frame, pixels=40)
    result = render_sphere_camera(
        frame, camera, lit_from(90, 60), extent_m=(-2 * R, 0.5 * R, -2 * R, 2 * R)
    )
    x = result.position_mcmf_m[..., 1]
    assert np.nanmax(x) <= 0.5 * R
    assert np.nanmin(x) < -0.9 * R
    assert (result.visible[:, 34:] == 0).all()


# ---- the limb


def test_the_limb_is_a_share_of_pixels():
    frame = EnuFrame(0.0, 0.0)
    camera = far_camera(frame, pixels=50)
    result = render_sphere_camera(frame, camera, lit_from(0, 90), model=LAMBERT)
    radius_px = camera.focal_length_px * math.tan(
        sphere_intersection.limb_angle(camera.position_mcmf_m)
    )
    assert result.visible.sum() == pytest.approx(math.pi * radius_px**2, rel=1e-4)
    cut = (result.visible > 0) & (result.visible < 1)
    assert cut.sum() > 100
    for i, j in np.argwhere(cut)[::9]:
        step = (np.arange(60) + 0.5) / 60 - 0.5
        rays = camera.rays(np.stack(np.meshgrid(j + step, i + step), -1))
        _, points = sphere_intersection.hits(camera.position_mcmf_m, rays)
        # Lambert under a Sun behind the camera: 0.12 cos(e), 0 in the sky
        mean = np.nan_to_num(0.12 * points @ frame.rotation[2] / R).mean()
        assert result.radiance[i, j] == pytest.approx(mean, rel=0.15, abs=5e-4)
        assert 70.0 < result.emission_deg[i, j] < 90.0


def test_the_whole_light_of_a_full_moon():
    """A Lambert sphere, seen full: its light is 2/3 of that of a disc of its radiance factor; with
    the limb's pixels counted as they are covered (Lambert 1760).
    """
    frame = EnuFrame(123.0, 45.0)
    for pixels in (17, 31, 64):
        camera = far_camera(frame, 1e10, pixels)
        result = render_sphere_camera(frame, camera, lit_from(0, 90), model=LAMBERT)
        radius_px = camera.focal_length_px * R / 1e10
        total = np.nansum(result.radiance) / (math.pi * radius_px**2 * 0.12)
        assert total == pytest.approx(2.0 / 3.0, rel=6.0 / pixels**2)


# ---- anywhere


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.0, 9.0),
    st.floats(0.0, 360.0),
    st.floats(-90.0, 90.0),
    st.floats(0.0, 110.0),
    st.floats(1.0, 3.0),
    st.booleans(),
)
def test_bands_are_sane_from_anywhere(log_height, lon, lat, off_nadir, log_focal, disc):
    position = lonlat_to_mcmf(lon, lat, 10.0**log_height)
    frame = EnuFrame(lon, lat)
    turn = math.radians(off_nadir)
    optical = math.sin(turn) * frame.rotation[1] - math.cos(turn) * frame.rotation[2]
    rotation = np.stack([frame.rotation[0], np.cross(optical, frame.rotation[0]), optical])
    camera = Camera(position, rotation, 10.0**log_focal, (7.5, 7.5), (16, 16))
    result = render_sphere_camera(frame, camera, lit_from(100.0, 60.0, disc))
    seen = result.visible > 0
    assert ((result.visible >= 0) & (result.visible <= 1 + 1e-12)).all()
    assert ((result.sunlit >= 0) & (result.sunlit <= 1)).all()
    assert (np.isfinite(result.radiance) == seen).all()
    assert (result.radiance[seen] >= 0).all()
    assert (result.radiance[seen] <= 0.0525 + 1e-12).all()
    assert (result.emission_deg[seen] <= 90.0 + 1e-5).all()
    away = np.linalg.norm(result.position_mcmf_m[seen], axis=-1)
    assert np.abs(away - R).max(initial=0.0) < 1e-9
    centre = sphere_intersection.ranges(position, camera.rays([[7.0, 7.0]]))
    if np.isfinite(centre[0]) and result.visible[7, 7] == 1.0:
        assert np.linalg.norm(result.position_mcmf_m[7, 7] - position) == pytest.approx(
            centre[0], abs=1e-6, rel=1e-9
        )


def test_refusals():
    frame = EnuFrame(0.0, 0.0)
    under = Camera([R - 5000.0, 0, 0], np.eye(3), 100.0, (1.5, 1.5), (4, 4), name="LOW.json")
    with pytest.raises(
        CameraError, match=r"LOW.json: the camera is 5000 m below the reference sphere"
    ):
        render_sphere_camera(frame, under, lit_from(0, 40))
    with pytest.raises(CameraError, match="the view: the camera is 1 m below"):
        render_sphere_enu(frame, WHOLE, 1e3, lit_from(0, 40), CameraView(np.array([0, 0, -1.0])))
    with pytest.raises(SunError, match="below the horizon at all visible points"):
        render_sphere_enu(frame, window_of(9e3, 1e3), 1e3, lit_from(0, -5), oblique_view(0.0, 0.0))
    with pytest.raises(SunError, match="below the horizon at all visible points"):
        render_sphere_camera(frame, far_camera(frame, pixels=8), lit_from(0, -90))


# ---- against the heightfield of real ground

GLD100 = (
    Path(__file__).resolve().parents[3]
    / "shared"
    / "data"
    / "dem"
    / "gld100"
    / "gld100_016ppd_global.tif"
)


@pytest.mark.skipif(not GLD100.exists(), reason="the global GLD100 (20 MB) is not shipped")
def test_no_shift_against_real_heights():
    """The Moon's real heights over 300 km, seen from 100 000 km straight above, against the sphere:
    what pixels see lies in the same place, but for what their height and slant shift it by.
    """
    from lcp_catalog.dem.mosaic import DemSet
    from lcp_catalog.terrain.area import Area
    from lcp_catalog.terrain.terrain import terrain_from_area

    area = Area(95.0, 34.0, 300.0)
    terrain = terrain_from_area(DemSet.open([GLD100]), area, 2000.0)
    camera = looking_camera(area.frame, [0, 0, 1e8], 4000.0, (280e3, 280e3))
    light = lit_from(60.0, 45.0)
    real = render_camera(terrain, camera, light, Method(accuracy=TIERS["draft"]))
    ours = render_sphere_camera(area.frame, camera, light)
    off = area.frame.direction_from_mcmf(real.position_mcmf_m - ours.position_mcmf_m)
    assert np.isfinite(off).all()
    x, y, _ = np.moveaxis(area.frame.from_mcmf(ours.position_mcmf_m), -1, 0)
    height = np.linalg.norm(real.position_mcmf_m, axis=-1) - R
    assert np.nanmax(np.abs(off[..., :2])) < 4.0  # 0.001 of a pixel; the slant is 1 in 700
    assert off[..., 0] == pytest.approx(-x / 1e8 * off[..., 2], abs=0.05)
    assert off[..., 1] == pytest.approx(-y / 1e8 * off[..., 2], abs=0.05)
    assert off[..., 2] == pytest.approx(height, rel=0.01, abs=1.0)
