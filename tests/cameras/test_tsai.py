"""Cameras of the Ames Stereo Pipeline, compared with the formulas of its manual, its sample files
and OpenCV.
"""

import cv2
import numpy as np
import pytest

from lcp_catalog.cameras.camera_file import camera_from_tsai, is_tsai, read_camera, read_sensor
from lcp_catalog.cameras.frame_camera import camera_from_json
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry.frames import EnuFrame

FRAME = EnuFrame(30.0, -15.0)
TO_WORLD = (np.diag([1.0, -1.0, -1.0]) @ FRAME.rotation).T
PLACE = FRAME.to_mcmf([0.0, 0.0, 90e3])
LENS = {"k1": -0.094, "k2": 0.115, "k3": -0.032, "p1": -0.00026, "p2": -0.00035}


def text(lens="NULL", header="VERSION_4\nPINHOLE\n", **changes):
    values = {
        "fu": 28.429,
        "fv": 28.429,
        "cu": 17.9712,
        "cv": 11.9808,
        "u_direction": "1 0 0",
        "v_direction": "0 1 0",
        "w_direction": "0 0 1",
        "C": " ".join(map(repr, PLACE.tolist())),
        "R": " ".join(map(repr, TO_WORLD.ravel().tolist())),
        "pitch": 0.0064,
    } | changes
    numbers = {key: value for key, value in values.items() if value is not None}
    body = "".join(f"{key} = {value}\n" for key, value in numbers.items())
    return header + body + lens + "\n"


def tsai(name, **numbers):
    return "\n".join([name, *(f"{key} = {value}" for key, value in numbers.items())])


def points(n=60):
    offsets = np.random.default_rng(2).uniform([-50e3, -35e3, -3e3], [50e3, 35e3, 3e3], (n, 3))
    return FRAME.to_mcmf(offsets)


def read(content, shape=(3744, 5616)):
    return camera_from_tsai(content, "x.tsai", shape)


def by_manual(lens=lambda x, y: (x, y), units=28.429):
    """P = R Q + C; f Q / Q3 through a lens, plus the principal point, divided by the pitch."""
    x, y, z = ((points() - PLACE) @ TO_WORLD).T
    u, v = lens(units * x / z, units * y / z)
    scale = 28.429 / units
    return np.stack([(scale * u + 17.9712) / 0.0064, (scale * v + 11.9808) / 0.0064], -1)


def test_a_pinhole():
    camera = read(text())
    assert camera.lens is None
    assert not camera.distortion.any()
    assert np.abs(camera.project(points()) - by_manual()).max() < 1e-8
    assert camera.image_size_px == (5616, 3744)
    assert camera.sun_position_mcmf_m is None


def test_tsai_is_opencv():
    """The sample of the manual, with k3 last; named values may be in any order."""
    camera = read(text(tsai("TSAI", **LENS)))
    assert camera.distortion.tolist() == [LENS[key] for key in ("k1", "k2", "p1", "p2", "k3")]
    f, cx, cy = (value / 0.0064 for value in (28.429, 17.9712, 11.9808))
    matrix = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])
    turned = cv2.Rodrigues(TO_WORLD.T)[0]
    theirs, _ = cv2.projectPoints(points(), turned, -TO_WORLD.T @ PLACE, matrix, camera.distortion)
    assert np.abs(camera.project(points()) - theirs[:, 0]).max() < 1e-6
    without = {key: value for key, value in LENS.items() if key != "k3"}
    assert read(text(tsai("Tsai", **without))).distortion[4] == 0.0


def test_photometrix_and_brown_conrady_in_millimetres():
    """Both go from distorted to ideal; the manual's formulas, solved by fixed-point iteration."""
    k = {"xp": 0.004, "yp": -0.191, "k1": 1.3e-5, "k2": -2e-8, "k3": -5e-11, "p1": 7e-6, "p2": 2e-6}

    def photometrix(x, y):
        u, v = x.copy(), y.copy()
        for _ in range(200):
            a, b = u - k["xp"], v - k["yp"]
            r2 = a * a + b * b
            dr = k["k1"] * r2 + k["k2"] * r2**2 + k["k3"] * r2**3
            u = x - a * dr - k["p1"] * (r2 + 2 * a * a) - 2 * k["p2"] * a * b
            v = y - b * dr - k["p2"] * (r2 + 2 * b * b) - 2 * k["p1"] * a * b
        return u, v

    camera = read(text(tsai("Photometrix", **k, b1=0.0, b2=0.0)))
    assert np.abs(camera.project(points()) - by_manual(photometrix)).max() < 1e-7
    pixels = camera.project(points())
    ranges = np.linalg.norm(points() - PLACE, axis=1)
    assert np.abs(PLACE + ranges[:, None] * camera.rays(pixels) - points()).max() < 1e-4

    k |= {"phi": 0.6}

    def brown(x, y):
        u, v = x.copy(), y.copy()
        for _ in range(200):
            a, b = u - k["xp"], v - k["yp"]
            r2 = a * a + b * b
            dr = k["k1"] * r2 + k["k2"] * r2**2 + k["k3"] * r2**3
            aside = k["p1"] * r2 + k["p2"] * r2**2
            u = x - a * dr + aside * np.sin(0.6) + k["xp"]
            v = y - b * dr - aside * np.cos(0.6) + k["yp"]
        return u, v

    camera = read(text(tsai("BrownConrady", **k)))
    assert np.abs(camera.project(points()) - by_manual(brown)).max() < 1e-7
    again = camera_from_json(camera.to_json())
    assert np.abs(again.project(points()) - camera.project(points())).max() < 1e-9


def test_oblong_pixels():
    camera = read(text(fv=29.0))
    expected = by_manual()
    expected[:, 1] = (expected[:, 1] - 11.9808 / 0.0064) * 29.0 / 28.429 + 11.9808 / 0.0064
    assert np.abs(camera.project(points()) - expected).max() < 1e-8


@pytest.mark.parametrize(
    ("directions", "columns", "rows"),
    [
        (("0 1 0", "-1 0 0", "0 0 1"), (1, 1), (0, -1)),  # u along y, v along -x
        (("1 0 0", "0 -1 0", "0 0 1"), (0, 1), (1, -1)),  # v upwards: a mirror image
        (("-1 0 0", "0 -1 0", "0 0 1"), (0, -1), (1, -1)),
    ],
)
def test_directions_of_the_axes(directions, columns, rows):
    """Each of u and v is an axis of the camera, or its negative."""
    u, v, w = directions
    camera = read(text(u_direction=u, v_direction=v, w_direction=w))
    middle = np.array([17.9712, 11.9808]) / 0.0064
    plain = by_manual() - middle
    expected = middle + np.stack([sign * plain[:, axis] for axis, sign in (columns, rows)], -1)
    assert np.abs(camera.project(points()) - expected).max() < 1e-8


def test_versions():
    """VERSION_3 has no line PINHOLE; the oldest version has no header and no pitch, and the lens
    has no name.
    """
    assert read(text(header="VERSION_3\n")).focal_length_px == pytest.approx(28.429 / 0.0064)
    old = text("k1 = -0.33\nk2 = 0.125\np1 = -0.0004\np2 = 0.0011", header="", pitch=None)
    camera = read(old)
    assert camera.focal_length_px == pytest.approx(28.429)
    assert camera.distortion.tolist() == [-0.33, 0.125, -0.0004, 0.0011, 0.0]


def test_asps_own_sample():
    """StereoPipelineTest, ss_camera_solve_mt_sidley/camera_info.tsai: R written with six digits."""
    stated = (
        "0.0825447 0.996303 -0.0238243 -0.996008 0.0832884 0.0321213 0.0339869 0.0210777 0.9992"
    )
    camera = read(text(R=stated, fu=3057.67, fv=3057.67, cu=4457, cv=4417, pitch=1.0))
    rotation = camera.rotation_mcmf_to_camera
    assert np.abs(rotation - np.fromstring(stated, sep=" ").reshape(3, 3).T).max() < 1e-5
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
    assert camera.principal_point_px == (4457.0, 4417.0)


def test_the_image_size_comes_from_the_image_or_from_a_line(tmp_path):
    path = tmp_path / "a.tsai"
    path.write_text(text())
    assert read_sensor(path, (40, 50)).shape == (40, 50)
    with pytest.raises(CameraError, match=r"a\.tsai: .*add a line image_size = WIDTH HEIGHT"):
        read_camera(path)
    path.write_text(text(image_size="5616 3744"))
    assert read_camera(path).shape == (3744, 5616)
    assert read_sensor(path, (40, 50)).shape == (40, 50)


def test_recognition_of_tsai_files():
    assert is_tsai(text())
    assert is_tsai(text(header=""))
    assert not is_tsai('{"fu": 1}')
    assert not is_tsai("a = 1\nb = 2\n")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (text(fu=None), "lacks fu"),
        (text(fu="long"), "fu is 'long', which are not numbers"),
        (text(fv=-1.0), "fv must be at least 1e-12, is -1"),
        (text(pitch=0.0), "pitch must be at least 1e-12"),
        (text(cu="1 2"), "cu must hold 1 finite number$"),
        (text(C="1 2"), "C must hold 3 finite numbers"),
        (text(C="nan 1 2"), "C must hold 3 finite numbers"),
        (text(C="266.943 -105.583 -2.14189"), "position_mcmf_m lies deep inside the Moon"),
        (text(R="1 0 0 0 1 0 0 0 2"), "R is not a rotation"),
        (text(R="1 0 0 0 1 0 0 0 -1"), "R is not a rotation"),
        (text(R=None), "lacks R"),
        (text(u_direction="1 1 0"), "u_direction, v_direction and w_direction are not orthonormal"),
        (text("FISHEYE"), "FISHEYE is a lens that is not supported; supported are NULL, TSAI"),
        (text("Lensbaby"), "LENSBABY is a lens that is unknown"),
        (text(tsai("TSAI", k1=0.1)), "lacks k2"),
        (text("Photometrix", fv=29.0), "fv must be fu for the lens PHOTOMETRIX"),
        (text(tsai("BrownConrady", xp=0, yp=0, k1=0, k2=0, k3=0, p1=0, p2=0)), "lacks phi"),
    ],
)
def test_errors_name_the_field(content, says):
    with pytest.raises(CameraError, match=rf"^x\.tsai: {says}"):
        read(content)


ODD = ["", "x", "nan", "inf", "-1", "0", "1e300", "1 2 3 4", "1e308 1e308 1e308", " ".join("0" * 9)]


@pytest.mark.parametrize(
    "lens", ["NULL", tsai("TSAI", **LENS), tsai("Photometrix", xp=0, yp=0, **LENS)]
)
def test_oddities_anywhere_are_read_or_refused_in_one_line(lens):
    """An odd value in any line, or a missing line: CameraError, or a working camera."""
    lines, said = text(lens).splitlines(), []
    for i, line in enumerate(lines):
        key = line.split("=")[0].strip()
        for value in [*(f"{key} = {odd}" if "=" in line else odd for odd in ODD), ""]:
            try:
                camera = read("\n".join([*lines[:i], value, *lines[i + 1 :]]), (10, 20))
                camera.project([1.7e6, 0.0, 0.0])
                camera.rays([1.0, 2.0])
            except CameraError as error:
                said.append(str(error))
    assert len(said) > 60
    assert all(line.startswith("x.tsai: ") and "\n" not in line for line in said)
