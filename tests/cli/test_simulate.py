"""``lcp simulate`` as a command: the frame, its camera, refused options, and the files that remain."""

from __future__ import annotations

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from helpers.environment_maps import Lamp, uniform, with_lamps
from helpers.products import cylinder
from helpers.scan_files import scan
from lcp_cli.main import run
from simulation.test_frame import APART, CELL_M, PLACE, camera, patches, rolling

from lcp_catalog.cameras.camera_file import read_camera, read_sensor
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry.frames import EnuFrame, azimuth_elevation
from lcp_catalog.simulation.detector import BITS_MAX, BLUR_MAX_PX

POINT = ["--sun", "point"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A DEM, a camera with a Sun, one without, a catalogue of two patches."""
    made = tmp_path_factory.mktemp("simulate")
    dem = cylinder(made / "dem.tif", 199.65, -29.85, (96, 96), 64, rolling)
    document = camera(CELL_M, 48).to_json()
    (made / "camera.json").write_text(json.dumps(document))
    del document["sun_position_mcmf_m"]
    (made / "no_sun.json").write_text(json.dumps(document))
    write_catalog(patches(dem, APART), made / "points.h5")
    return made


def simulate(folder: Path, out: Path, *options: str, source: str = "dem.tif", **how: str) -> int:
    taken_by = how.get("camera", "camera.json")
    where = [str(folder / source), "--camera", str(folder / taken_by), "-o", str(out)]
    return run(["simulate", *where, *POINT, *options])


def pixels(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.read(1)


@pytest.mark.parametrize(("bits", "kind"), [("8", "uint8"), ("12", "uint16"), ("16", "uint16")])
def test_a_png_holds_the_detectors_numbers(folder, tmp_path, bits, kind):
    out = tmp_path / "f.png"
    assert simulate(folder, out, "--bits", bits) == 0
    with rasterio.open(out) as file:
        assert (file.driver, file.count, file.dtypes[0]) == ("PNG", 1, kind)
        numbers = file.read(1)
    assert numbers.shape == (48, 48)
    top = 2 ** int(bits) - 1
    assert np.percentile(numbers[numbers > 0], 99.5) == pytest.approx(0.8 * top, rel=0.02)
    assert sorted(os.listdir(tmp_path)) == ["f.png", "f_camera.json"]


def test_the_camera_beside_it_took_the_frame(folder, tmp_path):
    """The given camera, with the stated Sun and the settings of the simulation."""
    sun = ["--sun-azimuth", "250", "--sun-elevation", "20"]
    options = ["--noise", "0.02", "--blur", "0.5", "--seed", "9", "--exposure", "0.04"]
    assert simulate(folder, tmp_path / "f.png", *sun, *options) == 0
    given, beside = (read_camera(p) for p in (folder / "camera.json", tmp_path / "f_camera.json"))
    for name in ("position_mcmf_m", "rotation_mcmf_to_camera", "focal_length_px", "image_size_px"):
        np.testing.assert_array_equal(getattr(beside, name), getattr(given, name))
    towards = PLACE.direction_from_mcmf(beside.sun_position_mcmf_m - PLACE.origin_mcmf_m)
    np.testing.assert_allclose(azimuth_elevation(towards), [250.0, 20.0], atol=0.2)
    said = json.loads((tmp_path / "f_camera.json").read_text())["simulated"]
    assert said["sources"] == ["dem.tif"]
    assert said["rays_per_pixel"] == 4
    assert said["detector"] == {
        "blur_px": 0.5,
        "noise": 0.02,
        "shot_share": 0.5,
        "full_scale": 0.04,
        "bits": 8,
        "seed": 9,
    }


def test_a_tif_holds_radiance(folder, tmp_path):
    """The numbers times their step, as a render in the camera's plane gives it; NaN for unknown
    terrain.
    """
    wide = camera(CELL_M, 160).to_json()
    (tmp_path / "wide.json").write_text(json.dumps(wide))
    camera_of = ["--camera", str(tmp_path / "wide.json")]
    out, law = tmp_path / "f.tif", ["--reflectance", "lommel-seeliger"]
    dem = str(folder / "dem.tif")
    exact = ["--samples", "1", "--bits", "16", "--exposure", "0.08"]
    assert run(["simulate", dem, *camera_of, "-o", str(out), *POINT, *law, *exact]) == 0
    render = ["render", dem, *camera_of, "--frame", "camera", "--accuracy", "reference"]
    assert run([*render, "-o", str(tmp_path / "r.tif"), *POINT, *law]) == 0
    with rasterio.open(out) as file:
        assert (file.driver, file.dtypes[0], file.descriptions) == (
            "GTiff",
            "float32",
            ("radiance",),
        )
        assert np.isnan(file.nodata)
        found, tags = file.read(1), file.tags()
    assert json.loads(tags["detector"])["bits"] == 16
    judged = pixels(tmp_path / "r.tif")
    both = np.isfinite(found) & np.isfinite(judged)
    assert np.isnan(found).any()
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(judged))
    np.testing.assert_allclose(found[both], judged[both], atol=0.5001 * 0.08 / 65535)
    steps = found[both] * (65535 / 0.08)
    np.testing.assert_allclose(steps, np.rint(steps), atol=0.02)


def test_a_seed_gives_the_same_bytes(folder, tmp_path):
    for name, seed in (("a.png", "1"), ("b.png", "1"), ("c.png", "2")):
        assert simulate(folder, tmp_path / name, "--noise", "0.05", "--seed", seed) == 0
    a, b, c = ((tmp_path / f"{name}.png").read_bytes() for name in "abc")
    assert a == b
    assert a != c
    assert (tmp_path / "a_camera.json").read_bytes() == (tmp_path / "b_camera.json").read_bytes()


def test_noise_and_blur_are_those_of_the_flags(folder, tmp_path):
    bits = ["--bits", "16", "--exposure", "0.06"]
    for name, options in (
        ("plain.png", []),
        ("noisy.png", ["--noise", "0.1", "--shot-share", "0"]),
        ("blurred.png", ["--blur", "2"]),
        ("fine.png", ["--samples", "5"]),
    ):
        assert simulate(folder, tmp_path / name, *bits, *options) == 0
    plain, noisy, blurred, fine = (
        pixels(tmp_path / f"{name}.png").astype(float)
        for name in ("plain", "noisy", "blurred", "fine")
    )
    assert (noisy - plain).std() / plain.mean() == pytest.approx(0.1, rel=0.05)
    assert np.abs(np.diff(blurred)).mean() < 0.6 * np.abs(np.diff(plain)).mean()
    assert 0.0 < np.abs(fine - plain).mean() / plain.mean() < 0.05


def test_the_suns_shape_and_the_tier_are_asked_for(folder, tmp_path, monkeypatch):
    """The reference tier unless another one is stated; a disc or a point by the option, else by the
    tier.
    """
    asked = []

    def seen(request, margin_px=0):
        asked.append((request.accuracy.tier, request.disc))
        raise CameraError("seen enough")

    monkeypatch.setattr("lcp_catalog.simulation.frame.DemSurface.seen", seen)
    plain = [str(folder / "dem.tif"), "--camera", str(folder / "camera.json")]
    for options in ([], ["--sun", "point"], ["--sun", "disc", "--accuracy", "draft"]):
        assert run(["simulate", *plain, "-o", str(tmp_path / "f.png"), *options]) == 1
    assert asked == [("reference", None), ("reference", False), ("draft", True)]


def test_a_catalogue_alone_is_islands(folder, tmp_path):
    assert simulate(folder, tmp_path / "f.png", source="points.h5") == 0
    shown = pixels(tmp_path / "f.png") > 0
    assert 0.05 < shown.mean() < 0.5
    said = json.loads((tmp_path / "f_camera.json").read_text())["simulated"]
    assert said["sources"] == ["points.h5"]


def test_what_was_read(folder, tmp_path):
    rule = tmp_path / "f.d"
    assert simulate(folder, tmp_path / "f.png", "--depfile", str(rule)) == 0
    target, sources = rule.read_text().split(": ")
    assert target == str(tmp_path / "f.png")
    assert sources.split() == [str(folder / "dem.tif"), str(folder / "camera.json")]


WRONG = [
    ({}, ["--bits", "9"], 2, "--bits"),
    ({}, ["--blur", "-1"], 2, "--blur"),
    ({}, ["--noise", "nan"], 2, "--noise"),
    ({}, ["--exposure", "0"], 2, "--exposure"),
    ({}, ["--sun-azimuth", "10"], 2, "go together"),
    ({}, ["--tolerance", "0.1", "--accuracy", "high"], 2, "exclude"),
    ({}, ["--albedo-reference", "1"], 2, "needs --albedo"),
    ({"camera": "no_sun.json"}, [], 2, "no Sun"),
    ({"camera": "nothing.json"}, [], 1, "nothing.json"),
    ({"source": "nothing.tif"}, [], 1, "nothing.tif"),
    ({"source": "camera.json"}, [], 1, "camera.json"),
    ({"source": "points.h5"}, ["--gsd", "100"], 2, "catalogue"),
    ({"source": "points.h5"}, ["--albedo", __file__], 2, "catalogue"),
]


@pytest.mark.parametrize(("how", "options", "code", "said"), WRONG)
def test_what_is_refused_leaves_nothing(folder, tmp_path, capsys, how, options, code, said):
    assert simulate(folder, tmp_path / "f.png", *options, **how) == code
    errors = capsys.readouterr().err
    assert said in errors
    assert "Traceback" not in errors
    assert os.listdir(tmp_path) == []


def test_other_endings_are_refused(folder, tmp_path, capsys):
    assert simulate(folder, tmp_path / "f.jpg") == 2
    assert ".png or .tif" in capsys.readouterr().err


def test_a_rule_is_not_written_over_the_frame(folder, tmp_path, capsys):
    assert simulate(folder, tmp_path / "f.png", "--depfile", str(tmp_path / "f.png")) == 2
    assert "is the same file as" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_two_catalogues_are_refused(folder, tmp_path, capsys):
    points = str(folder / "points.h5")
    where = ["--camera", str(folder / "camera.json"), "-o", str(tmp_path / "f.png")]
    assert run(["simulate", points, points, *where]) == 2
    assert "alone" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["f.png", "f_camera.json"])
def test_what_exists_stays_unless_it_may_go(folder, tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    assert simulate(folder, tmp_path / "f.png") == 1
    assert "--overwrite" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "mine"
    assert os.listdir(tmp_path) == [name]
    assert simulate(folder, tmp_path / "f.png", "--overwrite") == 0


def test_a_dem_elsewhere_is_one_line(folder, tmp_path, capsys):
    far = cylinder(tmp_path / "far.tif", 20.0, 10.0, (64, 64), 64, rolling)
    where = ["--camera", str(folder / "camera.json"), "-o", str(tmp_path / "f.png")]
    assert run(["simulate", str(far), *where, *POINT]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert os.listdir(tmp_path) == ["far.tif"]


def test_flags_bounds_are_the_librarys():
    from lcp_cli.simulate import BITS, command

    blur = next(p for p in command.params if p.name == "blur_px")
    assert blur.type.max == BLUR_MAX_PX
    assert max(int(bits) for bits in BITS) == BITS_MAX


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["LINE_SCANNER", "PUSH_FRAME"])
def test_a_scanners_frame_and_the_isd_beside_it(folder, tmp_path, kind):
    """The given ISD, with the stated Sun: what took the frame; the same pixels as of ``lcp render``."""
    where = (PLACE.lon_deg, PLACE.lat_deg)
    how = {"shape": (36, 40), "pixel_m": CELL_M, "altitude_m": 80e3}
    isd = scan(tmp_path / "isd.json", kind, place=where, **how)
    sun = ["--sun-azimuth", "250", "--sun-elevation", "35"]
    made = ["--reflectance", "lommel-seeliger", "--accuracy", "reference", *sun, *POINT]
    given = [str(folder / "dem.tif"), "--camera", str(isd), *made]
    exact = ["--samples", "1", "--bits", "16", "--exposure", "0.2"]
    assert run(["simulate", *given, "-o", str(tmp_path / "f.tif"), *exact]) == 0
    first, beside = read_sensor(isd), read_sensor(tmp_path / "f_camera.json")
    towards = PLACE.direction_from_mcmf(beside.sun_position_mcmf_m - PLACE.origin_mcmf_m)
    np.testing.assert_allclose(azimuth_elevation(towards), [250.0, 35.0], atol=0.3)
    for looks in zip(first.looks([[3.0, 7.0]]), beside.looks([[3.0, 7.0]]), strict=True):
        np.testing.assert_array_equal(*looks)
    said = json.loads((tmp_path / "f_camera.json").read_text())["simulated"]
    assert said["rays_per_pixel"] == 1
    assert run(["render", *given, "--frame", "camera", "-o", str(tmp_path / "r.tif")]) == 0
    found, judged = pixels(tmp_path / "f.tif"), pixels(tmp_path / "r.tif")
    assert np.isfinite(judged).all()
    np.testing.assert_allclose(found, judged, atol=0.2 / 65535)
    with rasterio.open(tmp_path / "r.tif") as file:
        camera = json.loads(file.tags()["camera"])
    assert camera["file"] == "isd.json"
    assert camera["image_size_px"] == [40, 36]


@pytest.fixture(scope="module")
def panorama(folder: Path) -> Path:
    """A lamp in the north-west and a sky that is half as strong, on a horizontal plane."""
    lamp = Lamp(310.0, 40.0, 1.0)
    sky = uniform(60, 0.5 * np.sin(np.radians(40.0)) / np.pi)
    image = with_lamps(sky, [lamp]).luminance.astype(np.float32)
    path = folder / "lamp.hdr"
    cv2.imwrite(str(path), np.repeat(image[:, :, None], 3, axis=2))
    return path


@pytest.mark.parametrize("source", ["dem.tif", "points.h5"])
def test_a_frame_under_a_panorama(folder, panorama, tmp_path, source):
    """As many times as bright as its render under the same panorama; the strongest source stands for
    the Sun in the camera file beside it, and the depfile names the panorama.
    """
    out, deps = tmp_path / "f.tif", tmp_path / "f.d"
    light = ["--environment", str(panorama), "--environment-azimuth", "20", "--accuracy", "draft"]
    exact = ["--samples", "1", "--bits", "16", "--exposure", "0.08", "--depfile", str(deps)]
    law = ["--reflectance", "lommel-seeliger"]
    taken_by = ["--camera", str(folder / "no_sun.json")]
    where = ["simulate", str(folder / source), *taken_by, "-o", str(out)]
    assert run([*where, *light, *exact, *law]) == 0
    assert str(panorama) in deps.read_text()
    beside = read_camera(tmp_path / "f_camera.json")
    middle = PLACE
    if source == "points.h5":  # the angles are those at the middle of the catalogue's map
        overview = open_catalog(folder / source).overview
        middle = EnuFrame(overview.center_lon, overview.center_lat)
    towards = middle.direction_from_mcmf(beside.sun_position_mcmf_m - middle.origin_mcmf_m)
    np.testing.assert_allclose(azimuth_elevation(towards), [330.0, 40.0], atol=2.0)
    if source == "points.h5":
        found = pixels(out)
        assert np.isfinite(found).any()
        assert (found[np.isfinite(found)] > 0.0).all()  # a sky leaves nothing black
        return
    render = ["render", str(folder / source), *taken_by, "--frame", "camera", *light, *law]
    assert run([*render, "-o", str(tmp_path / "r.tif")]) == 0
    judged, found = pixels(tmp_path / "r.tif"), pixels(out)
    both = np.isfinite(found) & np.isfinite(judged)
    assert both.mean() > 0.5
    np.testing.assert_allclose(found[both], judged[both], atol=0.5001 * 0.08 / 65535)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--sun-azimuth", "1", "--sun-elevation", "5"], "--environment replaces the Sun"),
        (["--sun", "disc"], "--environment replaces the Sun"),
        (["--sun-sky-ratio", "many"], "--sun-sky-ratio"),
    ],
)
def test_lights_that_exclude_each_other(folder, panorama, tmp_path, capsys, options, says):
    where = ["simulate", str(folder / "dem.tif"), "--camera", str(folder / "camera.json")]
    how = ["-o", str(tmp_path / "f.png"), "--environment", str(panorama), *options]
    assert run([*where, *how]) == 2
    assert says in capsys.readouterr().err
    assert not os.listdir(tmp_path)
