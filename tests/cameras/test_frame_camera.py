"""Framing cameras and views, compared with cv2 and elementary geometry."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.cameras.distortion import OpenCV, UsgsRadial
from lcp_catalog.cameras.frame_camera import camera_from_json
from lcp_catalog.cameras.sensor import POSE
from lcp_catalog.cameras.view import (
    camera_view,
    footprint,
    looking_camera,
    oblique_view,
    slant_range_m,
)
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry.frames import EnuFrame, central_angle_deg, direction_enu, lonlat_to_mcmf

LENS = [-0.11, 0.03, 0.002, -0.0015, -0.004]


def document(**changes):
    """A camera 100 km above 10 E, 20 N that looks straight down, north up."""
    frame = EnuFrame(10.0, 20.0)
    base = {
        "position_mcmf_m": frame.to_mcmf([0, 0, 100e3]).tolist(),
        "rotation_mcmf_to_camera": (np.diag([1.0, -1.0, -1.0]) @ frame.rotation).tolist(),
        "focal_length_px": 400.0,
        "principal_point_px": [150.3, 99.1],
        "image_size_px": [300, 200],
    }
    return {key: value for key, value in (base | changes).items() if value is not None}


def points_in_view(n=300):
    rng = np.random.default_rng(1)
    offsets = rng.uniform([-35e3, -25e3, -3e3], [35e3, 25e3, 3e3], size=(n, 3))
    return EnuFrame(10.0, 20.0).to_mcmf(offsets)


@pytest.mark.parametrize("distortion", [[0.0] * 5, LENS])
def test_projection_against_opencv(distortion):
    camera = camera_from_json(document(distortion=distortion))
    points = points_in_view()
    rotation = camera.rotation_mcmf_to_camera
    cx, cy = camera.principal_point_px
    matrix = np.array([[400.0, 0, cx], [0, 400.0, cy], [0, 0, 1]])
    turned = cv2.Rodrigues(rotation)[0]
    theirs, _ = cv2.projectPoints(
        points, turned, -rotation @ camera.position_mcmf_m, matrix, np.array(distortion)
    )
    assert np.abs(camera.project(points) - theirs[:, 0]).max() < 1e-6


def test_pixel_centres_are_whole_numbers():
    camera = camera_from_json(document(principal_point_px=[149.5, 99.5]))
    middle = camera.project(camera.position_mcmf_m + camera.rotation_mcmf_to_camera[2])
    assert middle == pytest.approx([149.5, 99.5])  # the middle of 300 x 200 pixels
    inside = camera.in_image([[-0.5, -0.5], [299.49, 199.49], [299.5, 0], [0, -0.51], [np.nan, 0]])
    assert inside.tolist() == [True, True, False, False, False]


@pytest.mark.parametrize("distortion", [[0.0] * 5, LENS, [0.2, 0.1, -0.003, 0.002, 0.05]])
def test_rays_and_projection_undo_each_other(distortion):
    camera = camera_from_json(document(distortion=distortion))
    row, column = np.mgrid[0:200:9, 0:300:9].astype(float)
    pixels = np.stack([column, row], axis=-1)
    rays = camera.rays(pixels)
    assert np.linalg.norm(rays, axis=-1) == pytest.approx(1.0)
    assert np.abs(camera.project(camera.position_mcmf_m + 5e4 * rays) - pixels).max() < 1e-8


def test_undistort_against_opencv():
    u, v = np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-0.3, 0.3, 7))
    lens = OpenCV(*LENS)
    x, y = lens.undistort(u, v)
    ideal = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
    theirs, _ = cv2.projectPoints(ideal, np.zeros(3), np.zeros(3), np.eye(3), np.array(LENS))
    assert np.abs(theirs[:, 0] - np.stack([u.ravel(), v.ravel()], -1)).max() < 1e-14
    assert np.allclose(lens.distort(x, y), [u, v], atol=1e-14)


def test_a_lens_that_cannot_be_undone_is_refused():
    camera = camera_from_json(document(distortion=[-3.0, 0, 0, 0, 0]))
    with pytest.raises(CameraError, match="distortion has no inverse"):
        camera.rays(np.array([[0.0, 0.0], [150.0, 100.0]]))


def test_points_past_the_fold_of_the_lens_are_not_seen():
    """r + k1 r^3 has its maximum at r = 1/sqrt(3 |k1|): points further out would be projected into
    the image again.
    """
    camera = camera_from_json(document(distortion=[-0.5, 0, 0, 0, 0]))
    far = EnuFrame(10.0, 20.0).to_mcmf([[141e3, 0, 0], [50e3, 0, 0]])
    assert np.isnan(camera.project(far)[0]).all()
    assert np.isfinite(camera.project(far)[1]).all()


def test_behind_the_camera_is_nan():
    camera = camera_from_json(document())
    up = camera.position_mcmf_m - camera.rotation_mcmf_to_camera[2] * [[1.0], [0.0]]
    assert np.isnan(camera.project(up)).all()


def test_up_in_the_image_is_north_and_right_is_east():
    frame = EnuFrame(10.0, 20.0)
    camera = camera_from_json(document())
    north, east = camera.project(frame.to_mcmf([[0, 10e3, 0], [10e3, 0, 0]]))
    assert north == pytest.approx([150.3, 99.1 - 40.0])
    assert east == pytest.approx([150.3 + 40.0, 99.1])
    position, rays = camera.rays_enu(frame)
    assert position == pytest.approx([0, 0, 100e3], abs=1e-6)
    assert rays.shape == (200, 300, 3)
    assert rays[0, 150, 1] > 0
    assert (rays[..., 2] < 0).all()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"focal_length_px": -1.0}, "focal_length_px must be positive"),
        ({"focal_length_px": "long"}, "focal_length_px does not consist of numbers"),
        ({"focal_length_px": None}, "lacks focal_length_px"),
        ({"image_size_px": [300.5, 200]}, "image_size_px must be two whole"),
        ({"image_size_px": [0, 200]}, "image_size_px must be two whole"),
        ({"principal_point_px": [1, 2, 3]}, "principal_point_px must hold 2"),
        ({"position_mcmf_m": [1, 2, float("nan")]}, "position_mcmf_m must hold 3 finite"),
        ({"position_mcmf_m": [1800.0, 0, 0]}, "position_mcmf_m .*metres"),
        ({"rotation_mcmf_to_camera": np.diag([1, 1, -1.0]).tolist()}, "rotation_mcmf.*left-handed"),
        ({"rotation_mcmf_to_camera": (2 * np.eye(3)).tolist()}, "rotation_mcmf.*not orthonormal"),
        ({"distortion": [1, 2]}, "distortion must hold 5"),
        ({"sun_position_mcmf_m": [1, 2]}, "sun_position_mcmf_m must hold 3"),
        ({"sun_position_mcmf_m": [0, 0, 0]}, "sun_position_mcmf_m .*too near"),
        ({"sun_position_mcmf_m": [1.5e8, 0, 0]}, "sun_position_mcmf_m .*metres"),
        ({"time_utc": 5}, "time_utc must be text"),
    ],
)
def test_errors_name_the_field(tmp_path, changes, says):
    path = tmp_path / "CAMERA.json"
    path.write_text(json.dumps(document(**changes)))
    with pytest.raises(CameraError, match=rf"CAMERA\.json: {says}"):
        read_camera(path)


def test_files_that_are_no_cameras(tmp_path):
    with pytest.raises(CameraError, match=r"none\.json: there is no such file"):
        read_camera(tmp_path / "none.json")
    for text, says in (
        ("{", "is not JSON"),
        ("[1]", "one JSON object"),
        ('{"name_model": "X"}', "name_model is X"),
        ("\xff", "is not JSON"),
    ):
        (tmp_path / "c.json").write_bytes(text.encode("latin-1"))
        with pytest.raises(CameraError, match=says):
            read_camera(tmp_path / "c.json")


def test_a_camera_survives_its_own_json():
    camera = camera_from_json(document(distortion=LENS, time_utc="1971-07-31T00:00:00"))
    again = camera_from_json(camera.to_json())
    assert again.to_json() == camera.to_json()


def test_a_camera_with_a_lens_of_its_own_survives_its_json():
    """``lens`` holds what the five numbers of CAMERA.json cannot express; ``distortion`` is then
    absent.
    """
    lens = UsgsRadial(0.01, -0.02, 0.003)
    camera = camera_from_json(document(lens=lens.to_json()))
    assert camera.lens == lens
    stated = camera.to_json()
    assert "distortion" not in stated
    again = camera_from_json(json.loads(json.dumps(stated)))
    assert again.to_json() == stated
    pixels = np.array([[0.0, 0.0], [299.0, 10.0]])
    assert again.rays(pixels) == pytest.approx(camera.rays(pixels), abs=1e-15)
    plain = camera_from_json(document())
    assert np.abs(camera.rays(pixels) - plain.rays(pixels)).max() > 1e-3


def test_one_lens_at_most():
    with pytest.raises(CameraError, match="distortion and a lens are given"):
        camera_from_json(document(distortion=LENS, lens={"model": "none"}))
    with pytest.raises(CameraError, match="camera: lens lacks k"):
        camera_from_json(document(lens={"model": "lro-nac"}))


sixes = arrays(float, 6, elements=st.floats(-1.0, 1.0))


@given(sixes, st.sampled_from([1.0, 1e-3, 1e-6]))
@settings(deadline=None)
def test_a_moved_camera(six, small):
    """Shifted in MCMF, then rotated about its own axes: compared with cv2's Rodrigues and with
    explicit sums.
    """
    camera = camera_from_json(document(distortion=LENS))
    correction = six * [5e3, 5e3, 5e3, 0.2 * small, 0.2 * small, 0.2 * small]
    moved = camera.moved(correction)
    turn, _ = cv2.Rodrigues(correction[3:])
    rotation = turn @ camera.rotation_mcmf_to_camera
    assert np.abs(moved.rotation_mcmf_to_camera - rotation).max() < 1e-13
    points = points_in_view(40)
    by_hand = camera_from_json(
        document(distortion=LENS)
        | {
            "position_mcmf_m": (camera.position_mcmf_m + correction[:3]).tolist(),
            "rotation_mcmf_to_camera": rotation.tolist(),
        }
    )
    assert moved.project(points) == pytest.approx(by_hand.project(points), abs=1e-7, nan_ok=True)
    assert moved.corrections == POSE
    assert moved.name == camera.name


def test_a_turn_about_each_axis_goes_the_right_way():
    """R' = exp([turn]x) R rotates the scene in camera axes: about x (right) from ahead (z) to up
    (-y), about y (down) from ahead to right (x), about z (ahead) from right to down (y).
    """
    camera = camera_from_json(document())
    ahead = camera.position_mcmf_m + 5e4 * camera.rotation_mcmf_to_camera[2]
    beside = ahead + 1e4 * camera.rotation_mcmf_to_camera[0]
    middle = np.array(camera.principal_point_px)
    up = camera.moved([0, 0, 0, 0.01, 0, 0]).project(ahead) - middle
    assert up == pytest.approx([0.0, -400 * np.tan(0.01)], abs=1e-6)
    right = camera.moved([0, 0, 0, 0, 0.01, 0]).project(ahead) - middle
    assert right == pytest.approx([400 * np.tan(0.01), 0.0], abs=1e-6)
    rolled = camera.moved([0, 0, 0, 0, 0, 0.01]).project(beside) - middle
    assert rolled == pytest.approx([80 * np.cos(0.01), 80 * np.sin(0.01)], abs=1e-6)


@given(st.integers(0, 10_000))
@settings(deadline=None)
def test_a_camera_looks_where_it_projects(seed):
    camera = camera_from_json(document(distortion=LENS))
    pixels = np.random.default_rng(seed).uniform([-0.5, -0.5], [299.5, 199.5], (3, 5, 2))
    origins, rays = camera.looks(pixels)
    assert origins.shape == rays.shape == (3, 5, 3)
    points = origins + 8e4 * rays
    assert np.abs(camera.project(points) - pixels).max() < 1e-8
    assert np.abs(camera.towards(points) + rays).max() < 1e-14


def test_footprint_of_a_small_image():
    bounds = footprint(camera_from_json(document()))
    # flat-earth: 300 px of 250 m wide and 200 px high, 0.6 px and 0.8 px from the centre;
    # at the corners the sphere is up to 0.6 km below the plane, at a distance of 100 km
    metres_per_degree = np.radians(1.0) * MOON_RADIUS_M
    assert (bounds.north - bounds.south) * metres_per_degree == pytest.approx(50e3, rel=0.02)
    width = (bounds.east - bounds.west) * metres_per_degree * np.cos(np.radians(20.3))
    assert width == pytest.approx(75e3, rel=0.02)
    assert bounds.west < 10.0 < bounds.east


def moon_from_afar(lon, lat, focal=100.0, distance=1e8, tilt_deg=0.0):
    frame = EnuFrame(lon, lat)
    turn, _ = cv2.Rodrigues(np.radians([tilt_deg, 0.0, 0.0]))
    return camera_from_json(
        {
            "position_mcmf_m": frame.to_mcmf([0, 0, distance]).tolist(),
            "rotation_mcmf_to_camera": (turn @ np.diag([1.0, -1, -1]) @ frame.rotation).tolist(),
            "focal_length_px": focal,
            "principal_point_px": [49.5, 49.5],
            "image_size_px": [100, 100],
        }
    )


def test_footprint_of_the_whole_disc():
    """From 100 000 km above the equator the disc ends acos(R/d) from its centre; it covers 3
    pixels.
    """
    bounds = footprint(moon_from_afar(350.0, 0.0))
    reach = np.degrees(np.arccos(MOON_RADIUS_M / (MOON_RADIUS_M + 1e8)))
    assert bounds.east - bounds.west == pytest.approx(2 * reach, abs=0.05)
    assert bounds.west == pytest.approx(350.0 - reach, abs=0.05)
    assert bounds.north == pytest.approx(reach, abs=0.05)
    assert bounds.south == pytest.approx(-reach, abs=0.05)


def test_footprint_over_a_pole_is_all_around():
    bounds = footprint(moon_from_afar(0.0, 90.0, focal=3e4, distance=1e6))
    assert (bounds.west, bounds.east, bounds.north) == (-180.0, 180.0, 90.0)
    assert bounds.south > 85.0


def test_footprint_across_the_prime_meridian():
    bounds = footprint(moon_from_afar(0.0, 10.0, focal=1e4, distance=1e6))
    assert bounds.west > 350.0
    assert 360.0 < bounds.east < 370.0


def test_a_camera_that_looks_away():
    with pytest.raises(CameraError, match="does not see the Moon"):
        footprint(moon_from_afar(0.0, 0.0, tilt_deg=180.0))


def test_views():
    assert oblique_view(0.0, 0.0).direction.tolist() == [0, 0, 1]
    far = oblique_view(30.0, 90.0)
    assert far.direction == pytest.approx([0.5, 0.0, np.sqrt(0.75)])
    near = oblique_view(30.0, 90.0, 50e3)
    frame = EnuFrame(33.0, -70.0)
    assert np.linalg.norm(frame.to_mcmf(near.position_m)) == pytest.approx(MOON_RADIUS_M + 50e3)
    assert near.position_m / np.linalg.norm(near.position_m) == pytest.approx(far.direction)
    assert slant_range_m(0.0, 1000.0) == pytest.approx(1000.0)
    for wrong in ((90.0, 0.0, None), (-1.0, 0.0, None), (10.0, 0.0, -5.0), (10.0, np.nan, None)):
        with pytest.raises(CameraError):
            oblique_view(*wrong)


def test_directions_of_a_near_view_point_at_it():
    view = oblique_view(20.0, 45.0, 10e3)
    points = np.random.default_rng(2).normal(size=(4, 5, 3)) * 1e3
    along = view.directions(points)
    distance = np.linalg.norm(view.position_m - points, axis=-1)
    assert points + along * distance[..., None] == pytest.approx(
        np.broadcast_to(view.position_m, points.shape)
    )


@pytest.mark.parametrize(("off_nadir", "azimuth"), [(0.0, 0.0), (40.0, 250.0), (60.0, 0.0)])
def test_a_looking_camera_is_centred_and_scaled(off_nadir, azimuth):
    frame = EnuFrame(120.0, -35.0)
    view = oblique_view(off_nadir, azimuth, 80e3)
    camera = looking_camera(frame, view.position_m, 50.0, (10e3, 6e3))
    assert camera.image_size_px == (200, 120)
    middle = camera.project(frame.origin_mcmf_m)
    assert middle == pytest.approx([99.5, 59.5])
    assert camera_view(camera, frame).position_m == pytest.approx(view.position_m, abs=1e-6)
    across = np.cross(direction_enu(azimuth, 90 - off_nadir), [0, 1.0, 0])
    step = camera.project(frame.to_mcmf(across / np.linalg.norm(across) * 50.0)) - middle
    assert np.linalg.norm(step) == pytest.approx(1.0, rel=1e-3)
    north = camera.project(frame.to_mcmf([0, 1000.0, 0]))
    assert north[1] < middle[1]
    assert north[0] == pytest.approx(middle[0], abs=1e-6)


def test_visible_side():
    camera = moon_from_afar(0.0, 0.0)
    lon, lat = 100.0, 0.0
    point = lonlat_to_mcmf(lon, lat)
    assert central_angle_deg(0, 0, lon, lat) == pytest.approx(100.0)
    assert camera.in_image(camera.project(point))  # `project` does not test for the limb
