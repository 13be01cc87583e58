"""Camera files: one camera in three formats, recognition of the format, and use by ``lcp render``."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.renders import camera_file, read, write_dem
from helpers.scan_files import scan
from lcp_cli.main import run
from scipy.spatial.transform import Rotation

from lcp_catalog.cameras.camera_file import read_camera, read_sensor, require_pixels
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.scanners import LineScanner, PushFrame
from lcp_catalog.errors import CameraError

LENS = [-0.05, 0.01, 0.002, -0.001, 0.003]


@pytest.fixture
def camera_json(tmp_path):
    return camera_file(tmp_path / "CAMERA.json", distortion=LENS)


def isd_of(camera, model="FRAME", **changes):
    """The same camera as an ISD: 50 mm, body-fixed axes equal to inertial ones, pixels counted from
    the corner of the first one.
    """
    quaternion = Rotation.from_matrix(np.array(camera.rotation_mcmf_to_camera)).as_quat()[
        [3, 0, 1, 2]
    ]
    scale = camera.focal_length_px / 50.0
    (cx, cy), (width, height) = camera.principal_point_px, camera.image_size_px
    k1, k2, p1, p2, k3 = camera.distortion
    radtan = [k1 / 50**2, k2 / 50**4, p1 / 50, p2 / 50, k3 / 50**6]  # in millimetres
    table = {"ephemeris_times": [7e8], "reference_frame": 1}
    return {
        "name_model": f"USGS_ASTRO_{model}_SENSOR_MODEL",
        "center_ephemeris_time": 7e8,
        "radii": {"semimajor": 1737.4, "semiminor": 1737.4, "unit": "km"},
        "image_lines": height,
        "image_samples": width,
        "detector_center": {"line": cy + 0.5, "sample": cx + 0.5},
        "detector_line_summing": 1,
        "detector_sample_summing": 1,
        "starting_detector_line": 0,
        "starting_detector_sample": 0,
        "focal2pixel_lines": [0.0, 0.0, scale],
        "focal2pixel_samples": [0.0, scale, 0.0],
        "focal_length_model": {"focal_length": 50.0},
        "optical_distortion": {"radtan": {"coefficients": radtan}},
        "body_rotation": table
        | {"quaternions": [[1.0, 0, 0, 0]], "time_dependent_frames": [31001]},
        "instrument_pointing": table | {"quaternions": [quaternion.tolist()]},
        "instrument_position": table | {"positions": [(camera.position_mcmf_m / 1e3).tolist()]},
        "sun_position": table | {"positions": [(camera.sun_position_mcmf_m / 1e3).tolist()]},
    } | changes


def tsai_of(camera):
    (cx, cy), (width, height) = camera.principal_point_px, camera.image_size_px
    k1, k2, p1, p2, k3 = camera.distortion
    numbers = {
        "fu": camera.focal_length_px,
        "fv": camera.focal_length_px,
        "cu": cx,
        "cv": cy,
        "C": " ".join(map(repr, camera.position_mcmf_m.tolist())),
        "R": " ".join(map(repr, camera.rotation_mcmf_to_camera.T.ravel().tolist())),
        "pitch": 1,
        "image_size": f"{width} {height}",
    }
    lens = f"TSAI\nk1 = {k1}\nk2 = {k2}\np1 = {p1}\np2 = {p2}\nk3 = {k3}\n"
    return "VERSION_4\nPINHOLE\n" + "".join(f"{k} = {v}\n" for k, v in numbers.items()) + lens


@pytest.fixture
def all_three(camera_json, tmp_path):
    camera = read_camera(camera_json)
    (tmp_path / "isd.json").write_text(json.dumps(isd_of(camera)))
    (tmp_path / "camera.tsai").write_text(tsai_of(camera))
    return camera_json, str(tmp_path / "isd.json"), str(tmp_path / "camera.tsai")


def test_one_camera_in_three_formats(all_three):
    first, *others = (read_camera(path) for path in all_three)
    pixels = np.random.default_rng(0).uniform(-0.5, [99.5, 79.5], (50, 2))
    points = first.position_mcmf_m + 5e4 * first.rays(pixels)
    for other in others:
        assert other.shape == first.shape
        assert np.abs(other.project(points) - pixels).max() < 1e-6
        assert np.abs(other.rays(pixels) - first.rays(pixels)).max() < 1e-11
    assert others[0].sun_position_mcmf_m == pytest.approx(first.sun_position_mcmf_m, rel=1e-12)


def test_formats_are_recognised_by_content(all_three, tmp_path):
    for path in all_three:
        other = tmp_path / "a.txt"
        other.write_bytes(Path(path).read_bytes())
        assert isinstance(read_sensor(other), Camera)


def test_the_image_has_the_cameras_size(all_three):
    for path in all_three:
        assert read_sensor(path, (80, 100)).shape == (80, 100)
    for path in all_three[:2]:
        with pytest.raises(
            CameraError,
            match=r"json: is the camera of an image of 100 x 80 pixels, not of 80 x 100",
        ):
            read_sensor(path, (100, 80))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is not JSON"),
        (b"[1, 2]", "one JSON object"),
        (b'{"size": 1, "lens": {"a": 1, "b": 2, "a": 3}}', "has the key 'a' twice: remove one"),
        (b"\xff\xfe", "is not JSON"),
        (b"[" * 100_000, "is not JSON"),
        (b'{"instrument_pointing": {}}', "lacks name_model"),
        (b"VERSION_4\n", "lacks fu"),
        (
            b'{"images": [], "claims": {}}',
            r'is no camera: has the keys \["images", "claims"\], a camera has position_mcmf_m, .*; give a CAMERA',
        ),
        (b"{}", "is no camera: has no key, a camera has position_mcmf_m, .*; give a CAMERA"),
    ],
)
def test_refused_camera_files(tmp_path, content, says):
    (tmp_path / "c").write_bytes(content)
    with pytest.raises(CameraError, match=rf"/c: .*{says}") as raised:
        read_sensor(tmp_path / "c")
    assert str(raised.value).count("/c: ") == 1


def test_a_folder_is_no_camera(tmp_path):
    with pytest.raises(CameraError, match="cannot be read"):
        read_sensor(tmp_path)


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    y, x = np.mgrid[0:256, 0:256]
    z = 150 * np.sin(x / 7.0) * np.cos(y / 9.0)
    return write_dem(tmp_path_factory.mktemp("dem") / "hills.tif", z, 30.0, 11.0)


def test_render_takes_them_all(dem, all_three, tmp_path):
    """Each file renders the same scene, pixel for pixel; a .tsai file has no Sun."""
    sun = ["--subsolar", "80", "0"]
    images = []
    for i, path in enumerate(all_three):
        out = str(tmp_path / f"{i}.tif")
        assert run(["render", dem, "-o", out, "--camera", path, "--frame", "camera", *sun]) == 0
        images.append(read(out))
    (first, _, _), *others = images
    assert np.isfinite(first["radiance"]).all()
    for other, _, tags in others:
        assert np.abs(other["x"] - first["x"]).max() < 1e-3
        assert np.nanmedian(np.abs(other["radiance"] - first["radiance"])) < 1e-6
        assert json.loads(tags["camera"])["focal_length_px"] == pytest.approx(400.0)
    assert "lens" in json.loads(images[1][2]["camera"])


@pytest.mark.parametrize(
    ("name", "kind"),
    [("lrolroc_isd", "line scanner"), ("lrolrocwac_isd", "push-frame camera")],
)
def test_a_scanner_is_no_framing_camera(shared_data, name, kind):
    path = shared_data / "cameras" / f"{name}.json"
    assert isinstance(read_sensor(path), LineScanner | PushFrame)
    with pytest.raises(CameraError, match=f"{name}.json: is a {kind}; give a framing camera"):
        read_camera(path)


def test_an_image_too_large_to_render_is_refused(tmp_path):
    scanner = read_sensor(scan(tmp_path / "scan.json"))
    require_pixels(scanner)
    with pytest.raises(
        CameraError, match=r"scan\.json: image_size_px of 5064 x 52224: at most 100"
    ):
        require_pixels(replace(scanner, image_shape=(52224, 5064)))


def test_a_broken_isd_is_one_line(dem, camera_json, tmp_path, capsys):
    camera = read_camera(camera_json)
    path = tmp_path / "isd.json"
    path.write_text(json.dumps(isd_of(camera, radii={"semimajor": 3396.19, "semiminor": 3376.2})))
    assert run(["render", dem, "-o", str(tmp_path / "o.tif"), "--camera", str(path)]) == 1
    error = capsys.readouterr().err.strip()
    assert error.count("\n") == 0
    assert "isd.json: radii.semimajor is 3396.19 km, not that of the Moon" in error
