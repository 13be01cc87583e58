"""Cameras from SPICE kernels, against SPICE's own chain of positions and frames, with kernels that are made here."""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import spiceypy
from helpers.spice_kernels import CENTER, TIME, mission
from lcp_cli.main import run

import lcp_catalog as lcp
from lcp_catalog.cameras.scanners import LineScanner
from lcp_catalog.cameras.spice import KEYWORDS, kernel_files, loaded
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.errors import CameraError, InputError
from lcp_catalog.geometry.frames import lonlat_to_mcmf

START, STOP, LINE_S = "2026-03-01T00:00:01.5", "2026-03-01T00:00:21.5", 0.05


@pytest.fixture(scope="module")
def meta(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return mission(tmp_path_factory.mktemp("kernels"))


def _in_frame(meta: Path, frame: str, when: str | float, points: np.ndarray) -> np.ndarray:
    """Points (n, 3), MOON_ME metres, from the orbiter in a frame: by SPICE alone."""
    with loaded(meta):
        et = spiceypy.str2et(when) if isinstance(when, str) else when
        there, _ = spiceypy.spkpos("MY_ORBITER", et, "MOON_ME", "NONE", "MOON")
        turn = spiceypy.pxform("MOON_ME", frame, et)
    return (points - 1e3 * np.asarray(there)) @ np.asarray(turn).T


@pytest.mark.parametrize("when", [TIME, "2026-03-01T00:01:07.250000", "2026-02-28T23:58:11"])
def test_a_framing_camera_sees_what_spice_sees(meta: Path, when: str) -> None:
    """Pixels by the instrument kernel's documentation: ISIS's radial lens gives the ideal from the
    distorted place, CCD_CENTER counts from the centre of the first pixel.
    """
    camera = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", when, kernels=[meta])
    assert (camera.shape, camera.time_utc) == ((300, 400), f"{when}Z")
    lon, lat = _below(camera.position_mcmf_m)
    around = np.random.default_rng(3).uniform(-0.25, 0.25, (40, 2)) + np.array([lon, lat])
    points = lonlat_to_mcmf(*around.T)
    x, y, z = _in_frame(meta, "MY_CAMERA", when, points).T
    ideal = 50.0 * np.stack([x / z, y / z], axis=-1)
    bent = ideal.copy()
    for _ in range(60):
        r2 = (bent**2).sum(axis=-1, keepdims=True)
        bent = ideal / (1.0 - 1e-3 - 2e-6 * r2)
    expected = [201.25, 147.5] + bent / 0.05
    seen = camera.in_image(expected)
    assert seen.sum() > 10
    np.testing.assert_allclose(camera.project(points)[seen], expected[seen], atol=2e-6)


def _below(position: np.ndarray) -> tuple[float, float]:
    x, y, z = position
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, np.hypot(x, y)))


@pytest.mark.parametrize("symbol", [False, True])
def test_a_meta_kernel_that_names_a_pipe_is_refused(tmp_path: Path, symbol: bool) -> None:
    """SPICE would wait for its writer; the name may begin with a path symbol."""
    os.mkfifo(tmp_path / "p.bsp")
    named = "$HERE/p.bsp" if symbol else f"{tmp_path}/p.bsp"
    path = tmp_path / "m.tm"
    path.write_text(
        f"KPL/MK\n\\begindata\nPATH_VALUES = ( '{tmp_path}' )\nPATH_SYMBOLS = ( 'HERE' )\n"
        f"KERNELS_TO_LOAD = ( '{named}' )\n\\begintext\n"
    )
    with (
        pytest.raises(CameraError, match=r"m\.tm: names .*p\.bsp, which is no plain file"),
        loaded(path),
    ):
        pass


def test_the_camera_is_over_the_place_of_the_orbit(meta: Path) -> None:
    camera = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, kernels=meta)
    assert _below(camera.position_mcmf_m) == pytest.approx(CENTER, abs=1e-6)
    assert np.linalg.norm(camera.position_mcmf_m) == pytest.approx(MOON_RADIUS_M + 100e3, abs=1e-3)


def test_a_line_scanner_looks_where_spice_looks(meta: Path) -> None:
    orbiter = lcp.SpiceCamera("MY_ORBITER", "MY_SCANNER", meta)
    scanner = orbiter.scanner(START, STOP, LINE_S)
    assert isinstance(scanner, LineScanner)
    assert scanner.shape == (400, 500)
    pixels = np.array([[0.0, 0.0], [239.0, 137.0], [499.0, 399.0], [17.25, 200.5], [480.0, -0.5]])
    origins, rays = scanner.looks(pixels)
    for (column, row), origin, ray in zip(pixels, origins, rays, strict=True):
        with loaded(meta):
            et = spiceypy.str2et(START) + (row + 0.5) * LINE_S
        off = _in_frame(meta, "MY_SCANNER", et, origin[None])
        assert np.linalg.norm(off) < 1e-3
        there = _in_frame(meta, "MY_SCANNER", et, (origin + 1e5 * ray)[None])[0]
        expected = np.array([0.0, (column + 0.5 - 239.5) / 20.0, 100.0])
        np.testing.assert_allclose(there / 1e5, expected / np.linalg.norm(expected), atol=1e-7)


def test_the_document_of_a_scan_is_read_as_it_is_made(meta: Path, tmp_path: Path) -> None:
    orbiter = lcp.SpiceCamera("MY_ORBITER", "MY_SCANNER", meta, summing=2)
    (tmp_path / "s.json").write_text(json.dumps(orbiter.scanner_isd(START, STOP, LINE_S)))
    read, made = lcp.read_sensor(tmp_path / "s.json"), orbiter.scanner(START, STOP, LINE_S)
    assert read.shape == made.shape == (400, 250)
    whole = lcp.SpiceCamera("MY_ORBITER", "MY_SCANNER", meta).scanner(START, STOP, LINE_S)
    for one in (read, made):
        np.testing.assert_allclose(
            one.looks([100.0, 9.0])[1], whole.looks([200.5, 9.0])[1], atol=1e-12
        )


def test_a_trajectory_is_its_cameras(meta: Path) -> None:
    orbiter = lcp.SpiceCamera("MY_ORBITER", "MY_CAMERA", meta)
    along = orbiter.along(lcp.instant_range("2026-03-01", "2026-03-01T00:02", "40s"))
    assert [one.time_utc for one in along][-1] == "2026-03-01T00:02:00Z"
    assert along[2].to_json() == orbiter.at("2026-03-01T00:01:20").to_json()
    assert not np.allclose(along[0].position_mcmf_m, along[1].position_mcmf_m, atol=1e3)


def test_stated_keywords_have_precedence(meta: Path) -> None:
    stated = {"FOCAL_LENGTH": 100.0, "CCD_CENTER": (10.0, 20.0), "OD_K": 0.0, "PIXEL_LINES": 30}
    camera = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, meta, ik=stated)
    assert camera.focal_length_px == pytest.approx(2000.0, rel=1e-12)
    assert camera.principal_point_px == pytest.approx((10.0, 20.0))
    assert (camera.shape, camera.lens) == ((30, 400), None)


def test_numbers_are_names_too_and_kernels_of_the_program_serve(meta: Path) -> None:
    spiceypy.furnsh(str(meta))
    try:
        by_number = lcp.Camera.from_spice("-900", "-900100", TIME)
    finally:
        spiceypy.unload(str(meta))
    by_name = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, [meta])
    assert by_number.to_json() == by_name.to_json()


def test_another_frame_of_the_moon_is_used_with_a_warning(
    meta: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        there = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, meta, body_frame="IAU_MOON")
    assert "155 m" in caplog.text
    here = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, meta)
    assert 50.0 < np.linalg.norm(there.position_mcmf_m - here.position_mcmf_m) < 300.0


def _made(meta: Path, **changes: Any) -> Any:
    given = {"observer": "MY_ORBITER", "instrument": "MY_CAMERA", "kernels": [meta]} | changes
    when = given.pop("time", TIME)
    scan = given.pop("scan", None)
    camera = lcp.SpiceCamera(**given)
    return camera.scanner(*scan) if scan else camera.at(when)


def _without(*endings: str) -> Callable[[Path], list[Path]]:
    return lambda meta: [
        one for one in sorted(meta.parent.iterdir()) if one.suffix not in {*endings, ".tm"}
    ]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"observer": "NOBODY"}, "`observer` NOBODY is not known .* they name MY_ORBITER, MY_"),
        ({"instrument": "HAZCAM"}, "`instrument` HAZCAM is not known .*load the FK"),
        (
            {"time": "2027-01-01"},
            "no position of MY_ORBITER at 2027-01-01T00:00:00.000Z: they cover 2026-02-28T23:50:00.000Z to "
            r"2026-03-01T00:10:00.000Z \(SPICE\(SPKINSUFFDATA\)\); load kernels of this time",
        ),
        ({"kernels": _without(".bc")}, "no orientation of MY_CAMERA at .*: none of them has it"),
        ({"kernels": _without(".tsc")}, r"orientation of MY_CAMERA at .*: the spacecraft clock \(SCLK\) is missing"),
        ({"kernels": _without(".tls")}, "load a leap seconds kernel, such as naif0012.tls"),
        ({"kernels": _without(".ti")}, "INS-900100_PIXEL_SAMPLES is not in the kernels: load"),
        ({"kernels": _without(".tpc")}, "no orientation of MOON_ME at .*load kernels of this time"),
        ({"body_frame": "MOON_PA"}, "lack the Moon's frame MOON_PA: load NAIF's moon_de440"),
        ({"body_frame": "J2000"}, r"`body_frame` J2000 is a frame of body 0, not of the Moon \(301\)"),
        (
            {"scan": (START, STOP, LINE_S)},
            r"MY_CAMERA has 300 lines \(PIXEL_LINES\), so it is no line scanner: .* push-frame camera the ISD of ALE",
        ),
        ({"instrument": "MY_SCANNER"}, r"INS-900200_PIXEL_LINES is not in .* `ik` PIXEL_LINES=\.\.\."),
        ({"ik": {"PIXEL_SIZE": 13.5}}, "INS-900100_PIXEL_SIZE is 13.5 mm; these are micrometres"),
        ({"ik": {"PIXEL_SIZ": 13.5}}, r"no key PIXEL_SIZ \(PIXEL_SIZE is meant\?\)"),
        ({"ik": {"OD_K": 1e-5}}, "OD_K is one number, which is the lens of LROC NAC only"),
        ({"ik": {"ITRANSS": (0.0, 1.0)}}, "ITRANSS has 2 numbers, not 3"),
        ({"ik": {"FOCAL_LENGTH": -50.0}}, "FOCAL_LENGTH is -50"),
        ({"ik": {"BORESIGHT": (1.0, 0.0, 0.0)}}, r"not near \+z or -z of MY_CAMERA"),
        (
            {"instrument": "MY_SCANNER", "scan": (START, STOP, LINE_S), "ik": {"BORESIGHT": (0, 0, -1)}},
            "MY_SCANNER looks away from the Moon at 2026",
        ),
        (
            {"instrument": "MY_SCANNER", "scan": (STOP, START, LINE_S)},
            "`stop` is -20 s after `start`: -400 lines",
        ),
    ],
)  # fmt: skip
def test_refusals_say_what_is_missing(meta: Path, changes: dict[str, Any], said: str) -> None:
    changes = {k: v(meta) if callable(v) else v for k, v in changes.items()}
    with pytest.raises(CameraError) as refused:
        _made(meta, **changes)
    assert re.search(said, str(refused.value)), str(refused.value)
    assert "\n" not in str(refused.value)
    assert spiceypy.ktotal("ALL") == 0


def test_kernels_that_are_none(meta: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no\.tm: there is no such file"):
        _made(meta, kernels=tmp_path / "no.tm")
    lost = tmp_path / "lost.tm"
    lost.write_text("KPL/MK\n\\begindata\nKERNELS_TO_LOAD = ( 'away.bsp' )\n", encoding="ascii")
    with pytest.raises(CameraError, match=r"lost.tm: SPICE cannot load it: .*away.bsp.*working"):
        _made(meta, kernels=[meta, lost])
    assert spiceypy.ktotal("ALL") == 0
    assert {one.name for one in kernel_files(meta)} >= {"META.tm", "orbiter.bsp", "moon.tpc"}


@pytest.mark.parametrize(
    ("once", "said"), [(True, "gives two answers"), (False, "at the centre of the Moon")]
)
def test_zeros_of_a_kernel_that_is_not_read_are_no_position(
    meta: Path, monkeypatch: pytest.MonkeyPatch, once: bool, said: str
) -> None:
    """SPICE gave them without an error where one read of its SPK failed (`benchmarks.faults calls`)."""
    asked, real = [], spiceypy.spkez

    def zeros(*given: Any) -> Any:
        asked.append(given)
        return real(*given) if once and len(asked) > 1 else (np.zeros(6), 0.0)

    monkeypatch.setattr(spiceypy, "spkez", zeros)
    with pytest.raises(CameraError, match=said):
        _made(meta)


def test_a_camera_that_looks_up_is_not_turned_round(meta: Path) -> None:
    """An ISD is taken to look at the Moon; a kernel's boresight is believed."""
    camera = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, meta)
    up = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, meta, ik={"BORESIGHT": (0, 0, -1)})
    middle = camera.rays([201.25, 147.5])
    np.testing.assert_allclose(up.rays([201.25, 147.5]), -middle, atol=1e-9)


def test_the_command_writes_files_that_the_others_read(
    meta: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["camera", "from-spice", "--kernels", str(meta), "--observer", "MY_ORBITER"]
    rule = ["--depfile", str(tmp_path / "rule.d")]
    one, many, scan = (str(tmp_path / name) for name in ("one.json", "many.json", "scan.json"))
    camera = [*words, "--instrument", "MY_CAMERA"]
    scanner = [*words, "--instrument", "MY_SCANNER"]
    assert run([*camera, "--time", TIME, "-o", one, *rule]) == 0
    assert run([*camera, "--range", TIME, "2026-03-01T00:02", "1m", "-o", many]) == 0
    lines = ["--start", START, "--stop", STOP, "--line-time", str(LINE_S)]
    assert run([*scanner, *lines, "--ik", "FOCAL_LENGTH=90", "-o", scan]) == 0
    expected = lcp.Camera.from_spice("MY_ORBITER", "MY_CAMERA", TIME, meta)
    assert lcp.read_camera(one).to_json() == expected.to_json()
    assert len(json.loads(Path(many).read_text())) == 3
    assert lcp.read_sensor(scan).shape == (400, 500)
    assert "orbiter.bsp" in (tmp_path / "rule.d").read_text()
    assert run(["camera", "info", scan]) == 0
    capsys.readouterr()
    for wrong in ([], ["--time", TIME, "--start", START], ["--start", START, "--stop", STOP]):
        assert run([*scanner, *wrong, "-o", str(tmp_path / "x.json")]) == 2
        assert "--line-time of a line scanner" in capsys.readouterr().err
    assert run([*scanner, "--time", TIME, "-o", str(tmp_path / "x.json")]) == 1
    assert "--ik PIXEL_LINES=... (pixels)" in capsys.readouterr().err
    assert run([*scanner, "--time", TIME, "--ik", "FOCAL", "-o", str(tmp_path / "x.json")]) == 2


def test_the_page_lists_every_keyword() -> None:
    page = Path(__file__).parents[2] / "docs" / "reference" / "cameras.md"
    text = page.read_text(encoding="utf-8")
    assert {key for key in KEYWORDS if f"`{key}`" not in text} == set()
