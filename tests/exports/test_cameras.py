"""Exports of cameras: kernels read by SPICE, ISDs by the twin that is written from their documentation."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from helpers.scan_files import scan
from helpers.spice_kernels import CAMERA, OBSERVER, TEXTS, TIME, mission
from helpers.twins_isd import TwinIsd
from lcp_cli.main import run

import lcp_catalog as lcp
from lcp_catalog.cameras.distortion import Photometrix
from lcp_catalog.cameras.isd_writing import isd_of_camera
from lcp_catalog.cameras.sensor import POSE
from lcp_catalog.ephemeris.times import ephemeris_time
from lcp_catalog.errors import CameraError, ConfigError

SHIFT = np.array([120.0, -80.0, 55.0, 2e-3, -1e-3, 4e-3])
TIMES = [TIME, "2026-03-01T00:01:00", "2026-03-01T00:02:00", "2026-03-01T00:03:00"]


@pytest.fixture(scope="module")
def meta(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return mission(tmp_path_factory.mktemp("kernels"))


@pytest.fixture(scope="module")
def files(meta: Path) -> list[Path]:
    """Cameras on an orbit of four minutes, and one ten hours before it."""
    cameras = lcp.SpiceCamera("MY_ORBITER", "MY_CAMERA", meta).along(TIMES)
    cameras.append(replace(cameras[0], time_utc="2026-02-28T14:00:00"))
    paths = [meta.parent / f"c{k}.json" for k in range(len(cameras))]
    for path, camera in zip(paths, cameras, strict=True):
        path.write_text(json.dumps(camera.to_json()), encoding="utf-8")
    return paths


def report(path: Path, *corrections: np.ndarray | None) -> Path:
    poses = [one if one is None else {"correction": dict(zip(POSE, one, strict=True))} for one in corrections]  # fmt: skip
    path.write_text(json.dumps({"images": [{"pose": one} for one in poses]}), encoding="utf-8")
    return path


def _spice(meta: Path, *kernels: Path) -> list[str]:
    """Kernels without the mission's own trajectory, and those that were written."""
    return [str(meta.parent / name) for name in TEXTS] + [str(one) for one in kernels]


@pytest.mark.slow
@pytest.mark.parametrize("solved", [False, True])
def test_spice_finds_the_cameras_in_their_kernels(
    meta: Path, files: list[Path], tmp_path: Path, solved: bool
) -> None:
    """Position and attitude at the cameras' times, of a solved one with the corrections."""
    shift = SHIFT if solved else np.zeros(6)
    given = {"kernels": meta, "observer": "MY_ORBITER", "instrument": "MY_CAMERA"}
    if solved:
        given["report"] = report(tmp_path / "report.json", *[shift] * 4, None)
    for name in ("s.bsp", "s.bc"):
        assert lcp.export_cameras(files, tmp_path / name, **given) == (4 if solved else 5)
    kernels = _spice(meta, tmp_path / "s.bsp", tmp_path / "s.bc")
    spiceypy.furnsh(kernels)
    try:
        for path in files[: 4 if solved else 5]:
            camera = lcp.read_camera(path).moved(shift)
            et = spiceypy.str2et(camera.time_utc.removesuffix("Z"))
            there, _ = spiceypy.spkpos("MY_ORBITER", et, "MOON_ME", "NONE", "MOON")
            np.testing.assert_allclose(1e3 * there, camera.position_mcmf_m, rtol=0, atol=1e-3)
            turn = spiceypy.pxform("MOON_ME", "MY_CAMERA", et)
            np.testing.assert_allclose(turn, camera.rotation_mcmf_to_camera, rtol=0, atol=2e-9)
    finally:
        spiceypy.unload(kernels)


@pytest.mark.slow
def test_between_cameras_the_orbit_goes_on(meta: Path, files: list[Path], tmp_path: Path) -> None:
    """A minute apart: type 13 with the kernels' velocities, and with those of the positions alone."""
    halfway = "2026-03-01T00:01:30"
    truth = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", halfway, meta).position_mcmf_m
    text = [meta.parent / name for name in TEXTS]
    for name, kernels, near in (("a.bsp", [meta], 0.01), ("b.bsp", text, 30.0)):
        lcp.export_cameras(files[:4], tmp_path / name, None, kernels, "MY_ORBITER", "MY_CAMERA")
        spiceypy.furnsh(_spice(meta, tmp_path / name))
        try:
            et = spiceypy.str2et(halfway)
            there, _ = spiceypy.spkpos("MY_ORBITER", et, "MOON_ME", "NONE", "MOON")
            window = spiceypy.spkcov(str(tmp_path / name), OBSERVER)
            assert list(window) == pytest.approx([et - 90.0, et + 90.0])
        finally:
            spiceypy.unload(_spice(meta, tmp_path / name))
        assert np.linalg.norm(1e3 * np.asarray(there) - truth) < near


@pytest.mark.slow
def test_a_scan_has_its_trajectory_in_the_kernels(meta: Path, tmp_path: Path) -> None:
    """What is read from the written kernels looks where the scanner looks; solved and not."""
    orbiter = lcp.SpiceCamera("MY_ORBITER", "MY_SCANNER", meta)
    span = ("2026-03-01T00:00:01", "2026-03-01T00:00:21", 0.05)
    (tmp_path / "s.json").write_text(json.dumps(orbiter.scanner_isd(*span)))
    found = report(tmp_path / "report.json", SHIFT)
    for name in ("s.bsp", "s.bc"):
        lcp.export_cameras(
            tmp_path / "s.json", tmp_path / name, found, meta, "MY_ORBITER", "MY_SCANNER"
        )
    inner = ("2026-03-01T00:00:02", "2026-03-01T00:00:20", 0.05)
    kernels = _spice(meta, tmp_path / "s.bsp", tmp_path / "s.bc")
    again = lcp.SpiceCamera("MY_ORBITER", "MY_SCANNER", kernels).scanner(*inner)
    moved = lcp.read_sensor(tmp_path / "s.json").moved(SHIFT)
    pixels = np.array([[0.0, 3.0], [250.0, 100.0], [499.0, 350.0]])
    origins, rays = again.looks(pixels)
    expected = moved.looks(pixels + np.array([0.0, 20.0]))
    np.testing.assert_allclose(origins, expected[0], rtol=0, atol=2e-3)
    np.testing.assert_allclose(rays, expected[1], rtol=0, atol=2e-8)


@pytest.mark.parametrize("kind", ["LINE_SCANNER", "PUSH_FRAME"])
@pytest.mark.parametrize("mounted", [False, True])
def test_an_isd_is_moved_as_its_sensor(tmp_path: Path, kind: str, mounted: bool) -> None:
    path = scan(tmp_path / "isd.json", kind, (30.5, 10.5))
    if (
        mounted
    ):  # a constant rotation stands in the file already: half a turn about the optical axis
        document = json.loads(path.read_text())
        document["instrument_pointing"]["constant_rotation"] = [-1, 0, 0, 0, -1, 0, 0, 0, 1]
        document["focal2pixel_samples"] = [-x for x in document["focal2pixel_samples"]]
        path.write_text(json.dumps(document))
    lcp.export_cameras(path, tmp_path / "moved.json", report(tmp_path / "r.json", SHIFT))
    moved, expected = lcp.read_sensor(tmp_path / "moved.json"), lcp.read_sensor(path).moved(SHIFT)
    pixels = np.array([[0.0, 0.0], [40.0, 30.0], [79.0, 59.0]])
    (origins, rays), looks = moved.looks(pixels), expected.looks(pixels)
    np.testing.assert_allclose(origins, looks[0], rtol=0, atol=1e-4)
    np.testing.assert_allclose(rays, looks[1], rtol=0, atol=1e-10)


@pytest.mark.parametrize("lens", ["none", "kernel", "opencv"])
def test_the_isd_of_a_camera_is_that_camera(
    meta: Path, files: list[Path], tmp_path: Path, lens: str
) -> None:
    camera = lcp.read_camera(files[1])
    if lens == "none":
        camera = replace(camera, lens=None)
    elif lens == "opencv":
        camera = replace(camera, lens=None, distortion=np.array([-0.05, 0.01, 1e-3, -2e-3, 0.0]))
    (tmp_path / "c.json").write_text(json.dumps(camera.to_json()))
    shift = report(tmp_path / "r.json", SHIFT)
    words = ["camera", "export", str(tmp_path / "c.json"), "--report", str(shift)]
    assert run([*words, "-o", str(tmp_path / "i.json")]) == 0
    read, expected = lcp.read_camera(tmp_path / "i.json"), camera.moved(SHIFT)
    pixels = np.array([[0.0, 0.0], [201.0, 147.0], [399.0, 299.0], [20.5, 250.0]])
    np.testing.assert_allclose(read.rays(pixels), expected.rays(pixels), rtol=0, atol=1e-12)
    np.testing.assert_allclose(read.position_mcmf_m, expected.position_mcmf_m, atol=1e-6)
    assert str(read.time_utc).startswith("2026-03-01T00:01:00.00")
    if lens == "opencv":
        return  # the twin has no such lens
    twin = TwinIsd(tmp_path / "i.json")
    for column, row in pixels:
        _, ray = twin.ray(row + 0.5, column + 0.5)
        np.testing.assert_allclose(expected.rays([column, row]), ray, rtol=0, atol=1e-9)


def test_ephemeris_times_are_spices(meta: Path) -> None:
    spiceypy.furnsh(str(meta.parent / "leap.tls"))
    try:
        for text in ("2026-03-01T12:34:56.789012", "2017-01-01", "2016-12-31T23:59:60"):
            assert ephemeris_time(text) == pytest.approx(spiceypy.str2et(text), abs=3e-7)
    finally:
        spiceypy.unload(str(meta.parent / "leap.tls"))


def test_a_kernel_that_is_not_read_gives_no_other_velocity(
    meta: Path, files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only where the kernels do not cover a camera is its velocity taken from elsewhere."""

    def unread(*given: object) -> None:
        raise spiceypy.utils.exceptions.SpiceyError(short="SPICE(DAFREADFAIL)")

    monkeypatch.setattr(spiceypy, "spkez", unread)
    with pytest.raises(CameraError, match="DAFREADFAIL"):
        lcp.export_cameras(files[0], tmp_path / "x.bsp", None, meta, "MY_ORBITER", "MY_CAMERA")
    assert not (tmp_path / "x.bsp").exists()


def test_refusals(
    meta: Path, files: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"kernels": meta, "observer": "MY_ORBITER", "instrument": "MY_CAMERA"}
    with pytest.raises(ConfigError, match=r"the output must end in \.json or \.bsp or \.bc"):
        lcp.export_cameras(files, tmp_path / "x.txt")
    with pytest.raises(ConfigError, match="an ISD is of one camera, not of 5"):
        lcp.export_cameras(files, tmp_path / "x.json")
    two = report(tmp_path / "two.json", SHIFT, None)
    with pytest.raises(ConfigError, match="is of 2 images, and 5 cameras are given"):
        lcp.export_cameras(files, tmp_path / "x.bsp", two, **names)
    none = report(tmp_path / "none.json", None)
    with pytest.raises(ConfigError, match="no image is located"):
        lcp.export_cameras(files[0], tmp_path / "x.bsp", none, **names)
    with pytest.raises(CameraError, match=r"is no report\.json of a validation"):
        lcp.export_cameras(files[0], tmp_path / "x.bsp", files[0], **names)
    camera = lcp.read_camera(files[0])
    timeless = tmp_path / "t.json"
    timeless.write_text(json.dumps(replace(camera, time_utc=None).to_json()))
    for ending in ("json", "bsp"):
        with pytest.raises(CameraError, match="lacks time_utc"):
            lcp.export_cameras(timeless, tmp_path / f"x.{ending}", **names)
    odd = replace(camera, lens=Photometrix(0.0, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(CameraError, match="an ISD has no lens photometrix"):
        isd_of_camera(odd)
    without = [one for one in _spice(meta, meta.parent / "orbiter.bsp") if ".tsc" not in one]
    with pytest.raises(CameraError, match="load the spacecraft's SCLK kernel"):
        lcp.export_cameras(files[0], tmp_path / "x.bc", None, without, "MY_ORBITER", "MY_CAMERA")
    assert run(["camera", "export", str(files[0]), "-o", str(tmp_path / "x.bc")]) == 2
    assert "needs --kernels, --observer and --instrument" in capsys.readouterr().err
    assert not [one for one in tmp_path.iterdir() if one.name.startswith("x.")]
    assert CAMERA == -900100
