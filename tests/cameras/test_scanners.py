"""Synthetic line scanners and push-frame cameras over a rotating Moon, compared with elementary
geometry and exhaustive search.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from lcp_catalog.cameras.distortion import FocalPlane, LroNac, NoLens, OnPlane
from lcp_catalog.cameras.scanners import BEYOND, LineScanner, PushFrame
from lcp_catalog.cameras.sensor import POSE, Reduced, Uncertainty, pixel_size_m
from lcp_catalog.cameras.trajectory import Attitude, Track, Trajectory
from lcp_catalog.cameras.view import footprint
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry import sphere_intersection
from lcp_catalog.matching.consensus import agreeing
from lcp_catalog.matching.pose import position_error, residuals_px, solve

RATE = np.sqrt(4.9028e12 / (MOON_RADIUS_M + 100e3) ** 3)  # circular orbit at 100 km


def flight(lat_deg=20.0, duration_s=40.0, wobble_rad=0.0, backwards=False):
    """A polar orbit that crosses a latitude at t = 0, looking down, with rows along the flight (or
    against it).
    """
    times = np.linspace(-duration_s, duration_s, 81)
    a = np.radians(lat_deg) + RATE * times
    radius = MOON_RADIUS_M + 100e3
    where = radius * np.stack([np.cos(a), 0 * a, np.sin(a)], -1)
    speed = radius * RATE * np.stack([-np.sin(a), 0 * a, np.cos(a)], -1)
    along = speed / np.linalg.norm(speed, axis=1)[:, None] * (-1 if backwards else 1)
    down = -where / radius
    axes = np.stack([np.cross(along, down), along, down], axis=1)  # right, down, ahead: rows
    shake = Rotation.from_rotvec(wobble_rad * np.sin(3.0 * times)[:, None] * [1.0, 0.7, -0.5])
    pointing = (shake * Rotation.from_matrix(axes)).as_quat()[:, [3, 0, 1, 2]]
    turn = Rotation.from_rotvec(2.66e-6 * times[:, None] * [0, 0, -1.0]).as_quat()[:, [3, 0, 1, 2]]
    return Trajectory(
        Track(times, where, speed),
        Attitude.of_table(times, turn, np.eye(3)),
        Attitude.of_table(times, pointing, np.eye(3)),
    )


def line_scanner(rows=2000, cols=500, **how):
    """Pixels of 10 m: 0.0065 s per line at 1.55 km/s over the surface."""
    times = 0.0065 * (np.arange(-BEYOND, rows + BEYOND) - rows / 2)
    focal = 1e4
    lens = OnPlane(((0.0, 70.0), (70.0, 0.0)), LroNac(1.81e-5), ((0.0, 1 / 70.0), (1 / 70.0, 0.0)))
    return LineScanner(
        name="scan",
        image_shape=(rows, cols),
        plane=FocalPlane(focal, (cols / 2, -0.5), lens),
        trajectory=flight(**how),
        times_s=times,
        line_px=-0.5,
    )


def push_frame(framelets=40, lines=14, overlap=4, **how):
    """Pixels of 100 m, framelets of 14 rows, each advanced by 10 rows: 0.65 s."""
    step = (lines - overlap) * 0.065
    return PushFrame(
        name="frames",
        image_shape=(framelets * lines, 300),
        plane=FocalPlane(1e3, (149.5, (lines - 1) / 2), NoLens()),
        trajectory=flight(**how),
        lines=lines,
        first_s=-step * (framelets - 1) / 2,
        step_s=step,
    )


def grid(sensor, n=23):
    rows, cols = sensor.shape
    return np.stack(
        np.meshgrid(np.linspace(-0.5, cols - 0.51, n), np.linspace(-0.5, rows - 0.51, n)), -1
    )


@given(
    st.floats(-80, 80),
    st.floats(0.0, 1e-3),
    st.booleans(),
    arrays(float, 6, elements=st.floats(-1, 1)),
)
@settings(max_examples=25, deadline=None)
def test_a_line_scanner_finds_its_own_pixels(lat, wobble, backwards, six):
    """At any place, with attitude changes of up to a hundred pixels per second, corrected or not."""
    scanner = line_scanner(lat_deg=lat, wobble_rad=wobble, backwards=backwards)
    scanner = scanner.moved(six * [500.0, 500, 500, 1e-2, 1e-2, 1e-2])
    pixels = grid(scanner)
    points = sphere_intersection.hits(*scanner.looks(pixels))[1]
    again = scanner.project(points)
    assert again.shape == (23, 23, 2)
    assert np.abs(again - pixels).max() < 1e-6
    assert scanner.in_image(again[1:-1, 1:-1]).all()
    assert np.abs(scanner.towards(points) + scanner.looks(pixels)[1]).max() < 1e-9


@given(arrays(float, 6, elements=st.floats(-1, 1)))
@settings(max_examples=20, deadline=None)
def test_all_lines_move_alike(six):
    """A correction shifts the position and turns the axes of every line like those of a framing
    camera.
    """
    scanner = line_scanner(wobble_rad=1e-4)
    correction = six * [5e3, 5e3, 5e3, 0.1, 0.1, 0.1]
    moved = scanner.moved(correction)
    pixels = grid(scanner, 5).reshape(-1, 2)
    turn = Rotation.from_rotvec(correction[3:])
    for pixel in pixels:
        (origin, ray), (there, turned) = scanner.looks(pixel), moved.looks(pixel)
        assert np.abs(there - origin - correction[:3]).max() < 1e-8
        time = scanner.times_s[BEYOND] + 0.0065 * pixel[1]
        axes = scanner.trajectory.to_mcmf(np.full(3, time), np.eye(3))  # rows: axes in MCMF
        expected = axes.T @ turn.inv().apply(axes @ ray)
        assert np.abs(turned - expected).max() < 1e-12
    assert moved.corrections == POSE
    assert (moved.name, moved.shape) == (scanner.name, scanner.shape)


def test_two_corrections_add_up():
    scanner = line_scanner()
    one, two = np.array([10.0, 20, 30, 1e-3, 0, 0]), np.array([1.0, 2, 3, 0, 2e-3, 0])
    both = scanner.moved(one).moved(two)
    turn = Rotation.from_rotvec(two[3:]) * Rotation.from_rotvec(one[3:])
    at_once = scanner.moved(np.concatenate([one[:3] + two[:3], turn.as_rotvec()]))
    pixels = grid(scanner, 4)
    for mine, other in zip(both.looks(pixels), at_once.looks(pixels), strict=True):
        assert np.abs(mine - other).max() < 1e-8


def test_lines_before_the_first_and_after_the_last():
    """Points up to `BEYOND` lines outside have pixels outside the image; points further out have
    none, and neither have points above the camera. (Like framing cameras, scanners do not test for
    the limb.)
    """
    scanner = line_scanner()
    rows = np.array([-60.0, -1.0, 2000.5, 2060.0])
    points = sphere_intersection.hits(*scanner.looks(np.stack([0 * rows + 20, rows], -1)))[1]
    found = scanner.project(points)
    assert found[:, 1] == pytest.approx(rows, abs=1e-6)
    assert not scanner.in_image(found).any()
    ends = sphere_intersection.hits(*scanner.looks([[20.0, -63.9], [20.0, 2062.9]]))[1]
    assert scanner.project(ends)[:, 1] == pytest.approx([-63.9, 2062.9], abs=1e-6)
    assert np.isnan(scanner.looks([[20.0, -64.1], [20.0, 2063.1]])[1]).all()
    along = points[1] - points[0]
    far = points[0] - 3 * BEYOND * along / np.linalg.norm(along) * 10.0
    assert np.isnan(scanner.project([far, 1.3 * points[0]])).all()
    assert np.isnan(scanner.towards(far)).all()
    assert not scanner.in_image(scanner.project(far))


def test_a_point_off_to_the_side_has_its_column():
    scanner = line_scanner()
    points = sphere_intersection.hits(*scanner.looks([[-300.0, 700.0], [900.0, 700.0]]))[1]
    found = scanner.project(points)
    assert found == pytest.approx(np.array([[-300.0, 700.0], [900.0, 700.0]]), abs=1e-6)
    assert not scanner.in_image(found).any()


def test_shapes_and_single_points():
    scanner = line_scanner()
    origin, ray = scanner.looks([3.0, 4.0])
    assert origin.shape == ray.shape == (3,)
    point = sphere_intersection.hits(origin, ray)[1]
    assert scanner.project(point).shape == (2,)
    assert scanner.project(np.empty((0, 3))).shape == (0, 2)
    assert scanner.project(np.full((2, 4, 3), np.nan)).shape == (2, 4, 2)
    assert scanner.towards(point).shape == (3,)


@pytest.mark.parametrize("make", [line_scanner, push_frame])
def test_many_points_are_taken_in_parts(make, monkeypatch):
    sensor = make()
    points = sphere_intersection.hits(*sensor.looks(grid(sensor)))[1]
    whole = sensor.project(points), sensor.towards(points)
    monkeypatch.setattr("lcp_catalog.cameras.scanners._AT_ONCE", 50)
    parts = sensor.project(points), sensor.towards(points)
    for one, other in zip(whole, parts, strict=True):
        assert np.array_equal(one, other, equal_nan=True)


# push-frame cameras


def by_trying(camera, point):
    """Pixel of a point in every framelet, in rows of the image, and the one nearest to its
    framelet's middle.
    """
    times = camera.first_s + camera.step_s * np.arange(camera.framelets)
    seen = camera.plane.pixels(
        camera.trajectory.to_camera(times, np.tile(point, (camera.framelets, 1)))
    )
    off = np.abs(seen[:, 1] - (camera.lines - 1) / 2)
    best = np.nanargmin(off)
    row = seen[best, 1]
    return seen[best, 0], row + best * camera.lines, -0.5 <= row < camera.lines - 0.5


@given(st.floats(-80, 80), st.floats(0.0, 2e-3), st.booleans(), st.booleans(), st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_framelets_against_trying_them_all(lat, wobble, backwards, reverse, seed):
    camera = push_frame(lat_deg=lat, wobble_rad=wobble, backwards=backwards)
    if reverse:
        last = camera.first_s + camera.step_s * (camera.framelets - 1)
        camera = PushFrame(**(vars(camera) | {"first_s": last, "step_s": -camera.step_s}))
    pixels = np.random.default_rng(seed).uniform([0, 30], [299, 529], (20, 2))
    points = sphere_intersection.hits(*camera.looks(pixels))[1]
    for point, found in zip(points, camera.project(points), strict=True):
        column, row, inside = by_trying(camera, point)
        assert inside
        assert found == pytest.approx([column, row], abs=1e-6)


def test_overlaps_use_the_framelet_nearest_the_middle():
    """Rows 0 and 13 of a framelet appear again, nearer to the middle, in its neighbours."""
    camera = push_frame()
    for row, other in ((14 * 20 + 0.5, 19), (14 * 20 + 12.5, 21), (14 * 20 + 6.0, 20)):
        point = sphere_intersection.hits(*camera.looks([150.0, row]))[1]
        found = camera.project(point)
        assert found[1] // 14 == other
        again = sphere_intersection.hits(*camera.looks(found))[1]
        assert np.linalg.norm(again - point) < 1e-4
        assert np.abs(camera.towards(point) + camera.looks(found)[1]).max() < 1e-9


def test_a_framelet_begins_half_a_row_before_its_first():
    camera = push_frame()
    first, before, last = (camera.looks([150.0, 14 * 20 + off])[0] for off in (0.0, -0.4, -0.6))
    assert np.array_equal(first, before)
    assert np.linalg.norm(first - last) > 900.0


def test_gaps_between_framelets_are_not_seen():
    """Framelets 16 rows apart with 14 rows each: two of sixteen rows are missing."""
    camera = push_frame(overlap=-2)
    for share in (20.45, 20.5, 20.55):  # just after a framelet, halfway, just before the next
        time = camera.first_s + share * camera.step_s
        under = camera.trajectory.positions(np.array([time]))[0]
        under *= MOON_RADIUS_M / np.linalg.norm(under)
        assert np.isnan(camera.project(under)).all()
        assert np.isnan(camera.towards(under)).all()
    seen = sphere_intersection.hits(*camera.looks([150.0, 14 * 20 + 3.0]))[1]
    assert camera.project(seen) == pytest.approx([150.0, 14 * 20 + 3.0], abs=1e-6)


def test_points_outside_the_first_and_last_framelet():
    camera = push_frame()
    points = sphere_intersection.hits(*camera.looks([[150.0, 0.0], [150.0, 559.0]]))[1]
    out = points + 3 * (
        points - sphere_intersection.hits(*camera.looks([[150.0, 1.0], [150.0, 558.0]]))[1]
    )
    found = camera.project(out)
    assert found[:, 1] == pytest.approx([-3.0, 562.0], abs=0.05)
    assert not camera.in_image(found).any()
    assert np.isnan(camera.project(1.3 * points)).all()


def test_projection_in_the_framelet_of_the_found_pixel():
    """In its own framelet every pixel is reproduced, also where `project` chooses another framelet."""
    camera = push_frame(wobble_rad=1e-3)
    pixels = grid(camera).reshape(-1, 2)
    points = sphere_intersection.hits(*camera.looks(pixels))[1]
    jumped = np.abs(camera.project(points) - pixels)[:, 1] > 1.0
    assert 0.2 < jumped.mean() < 0.9
    assert camera.project_near(points, pixels) == pytest.approx(pixels, abs=1e-6)
    of_five = (pixels + 0.5) / 5 - 0.5
    assert Reduced(camera, 5).project_near(points, of_five) == pytest.approx(of_five, abs=1e-6)
    scanner = line_scanner()
    assert np.array_equal(
        scanner.project_near(points, pixels), scanner.project(points), equal_nan=True
    )


# poses, footprints and pixel sizes


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_pose_does_not_stop_at_the_edges_of_framelets(seed):
    """Pose half a kilometre off; every point found, to a tenth of a pixel, in any framelet that
    sees it.
    """
    rng = np.random.default_rng(seed)
    camera = push_frame()
    pixels = rng.uniform([0.0, 14.0], [299.0, 545.0], (60, 2))
    points = sphere_intersection.hits(*camera.looks(pixels))[1]
    found = pixels + rng.normal(0.0, 0.1, pixels.shape)
    given = camera.moved([*rng.normal(0.0, 500.0, 3), *rng.normal(0.0, 2e-3, 3)])
    covariance = np.broadcast_to(0.01 * np.eye(2), (60, 2, 2))
    everything = np.ones(60, dtype=bool)
    pose = solve(given, points, found, covariance, Uncertainty(500.0, 2e-3), everything)
    assert (
        pose.normalised_error < 1.6
    )  # 120 numbers minus about 6: exceeded by chance once in 20 000
    assert position_error(pose, camera).squared < 18.0  # 3 expected, chance of more 4e-4
    assert (
        np.abs(residuals_px(pose.sensor, points, found)).max() < 0.7
    )  # 0.1 each axis, and no jump of three rows
    assert agreeing(camera, points, found, covariance, tolerance_px=0.5).all()
    assert not agreeing(
        camera, points, np.add(found, [0.0, 3.0]), covariance, tolerance_px=0.5
    ).any()


def test_footprints_of_scanners():
    """The bounds contain what the pixels see, with little margin."""
    for sensor in (line_scanner(), push_frame(lat_deg=-50.0, backwards=True)):
        bounds = footprint(sensor)
        lon, lat = sphere_intersection.lonlat(
            sphere_intersection.hits(*sensor.looks(grid(sensor, 60)))[1]
        )
        lon = np.where(lon < bounds.west, lon + 360.0, lon)
        assert (lat >= bounds.south - 1e-3).all()
        assert (lat <= bounds.north + 1e-3).all()
        assert (lon >= bounds.west - 1e-3).all()
        assert (lon <= bounds.east + 1e-3).all()
        assert bounds.north - bounds.south < np.ptp(lat) + 0.05
        assert bounds.east - bounds.west < np.ptp(lon) + 0.05


def test_a_scanner_over_the_pole_sees_all_longitudes():
    bounds = footprint(line_scanner(lat_deg=89.9))
    assert (bounds.west, bounds.east, bounds.north) == (-180.0, 180.0, 90.0)


def test_a_scanner_that_looks_away():
    away = Rotation.from_rotvec([np.pi, 0.0, 0.0]).as_rotvec()
    with pytest.raises(CameraError, match="scan: the camera does not see the Moon"):
        footprint(line_scanner().moved(np.concatenate([np.zeros(3), away])))


def test_pixels_of_a_scanner_and_of_a_reduced_one():
    """10 m at 100 km; ten pixels are 100 m."""
    scanner = line_scanner()
    points = sphere_intersection.hits(*scanner.looks([[250.0, 1000.0], [30.0, 60.0]]))[1]
    width = np.linalg.norm(
        np.diff(sphere_intersection.hits(*scanner.looks([[250, 1000.0], [251, 1000.0]]))[1], axis=0)
    )
    length = np.linalg.norm(
        np.diff(sphere_intersection.hits(*scanner.looks([[250, 1000.0], [250, 1001.0]]))[1], axis=0)
    )
    assert pixel_size_m(scanner, points)[0] == pytest.approx(np.sqrt(width * length), rel=1e-4)
    assert pixel_size_m(Reduced(scanner, 10), points) == pytest.approx(
        10 * pixel_size_m(scanner, points), rel=1e-6
    )


def test_pixel_sizes_across_the_borders_of_framelets():
    """A step of a metre into another framelet is not a slope: sizes are as smooth as the surface."""
    camera = push_frame()
    rows = np.linspace(20.0, 540.0, 4001)
    points = sphere_intersection.hits(*camera.looks(np.stack([0 * rows + 150.0, rows], -1)))[1]
    near = np.concatenate([points + 0.4 * step for step in np.eye(3)])
    jumps = np.abs(camera.project(near + np.array([0, 0, 1.0])) - camera.project(near))[:, 1] > 1.0
    assert jumps.sum() > 3
    assert np.ptp(pixel_size_m(camera, near)) < 0.5  # of 100 m
