"""Cameras along CCSDS messages, against SPICE's own positions and attitudes of the same mission."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import spiceypy
from helpers.ccsds_files import aem, oem
from helpers.spice_kernels import mission
from lcp_cli.main import run

import lcp_catalog as lcp
from lcp_catalog.cameras.spice import loaded
from lcp_catalog.errors import CameraError

WHEN = ["2026-03-01T00:00:05", "2026-03-01T00:00:40", "2026-03-01T00:01:17.500000"]


@pytest.fixture(scope="module")
def meta(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return mission(tmp_path_factory.mktemp("kernels"))


@pytest.fixture(scope="module")
def truth(meta: Path) -> list[lcp.Camera]:
    return lcp.SpiceCamera("MY_ORBITER", "MY_CAMERA", meta).along(WHEN)


def _same(found: list[lcp.Camera], truth: list[lcp.Camera]) -> None:
    for one, other in zip(found, truth, strict=True):
        assert one.time_utc == other.time_utc
        np.testing.assert_allclose(one.position_mcmf_m, other.position_mcmf_m, rtol=0, atol=0.02)
        np.testing.assert_allclose(
            one.rotation_mcmf_to_camera, other.rotation_mcmf_to_camera, rtol=0, atol=1e-8
        )


@pytest.mark.parametrize("frame", ["EME2000", "ICRF", "MOON_ME"])
@pytest.mark.parametrize("system", ["UTC", "TAI", "TT", "TDB"])
def test_positions_and_attitudes_are_spices(
    meta: Path, truth: list[lcp.Camera], tmp_path: Path, frame: str, system: str
) -> None:
    """The attitude is of the camera itself. The Moon's orientation is needed in inertial frames only."""
    with loaded(meta):
        orbit = oem(tmp_path / "o.oem", frame, system)
        attitude = aem(tmp_path / "a.aem", "MY_CAMERA", frame, system)
    kernels = () if frame == "MOON_ME" else [meta]
    _same(lcp.cameras_from_ccsds(orbit, attitude, truth[0], WHEN, kernels), truth)


@pytest.mark.parametrize(
    "how", [{"first": True}, {"direction": "B2A"}, {"swapped": True}, {"ordinal": True}]
)
def test_conventions_of_attitudes(
    meta: Path, truth: list[lcp.Camera], tmp_path: Path, how: dict[str, bool | str]
) -> None:
    with loaded(meta):
        orbit, attitude = oem(tmp_path / "o"), aem(tmp_path / "a", "MY_CAMERA", **how)
    _same(lcp.cameras_from_ccsds(orbit, attitude, truth[0], WHEN, meta), truth)


def test_the_mounting_turns_the_bus_to_the_camera(
    meta: Path, truth: list[lcp.Camera], tmp_path: Path
) -> None:
    with loaded(meta):
        orbit, attitude = oem(tmp_path / "o"), aem(tmp_path / "a", "MY_BUS")
        mounting = spiceypy.m2q(spiceypy.pxform("MY_BUS", "MY_CAMERA", spiceypy.str2et(WHEN[0])))
    (tmp_path / "c.json").write_text(json.dumps(truth[0].to_json()))
    words = ["--oem", orbit, "--aem", attitude, "--camera", tmp_path / "c.json", "--kernels", meta]
    words += ["--range", "2026-03-01T00:00:05", "2026-03-01T00:00:40", "35s"]
    words += ["--mounting", *(f"{x:.17g}" for x in mounting), "-o", tmp_path / "t.json"]
    assert run(["camera", "from-ccsds", *map(str, words)]) == 0
    from lcp_catalog.navigation.trajectory_file import read_trajectory

    _same(read_trajectory(tmp_path / "t.json"), truth[:2])
    assert run(["camera", "from-ccsds", *map(str, words[:8]), "-o", str(tmp_path / "x.json")]) == 2


def test_rows_far_apart_are_told(
    meta: Path, truth: list[lcp.Camera], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with loaded(meta):
        orbit, attitude = oem(tmp_path / "o", step=150.0), aem(tmp_path / "a", "MY_CAMERA")
    found = lcp.cameras_from_ccsds(orbit, attitude, truth[0], WHEN, meta)
    said = re.search(r"err by about (\d+) m", caplog.text)
    off = max(np.linalg.norm(a.position_mcmf_m - b.position_mcmf_m) for a, b in zip(found, truth, strict=True))  # fmt: skip
    assert said is not None
    assert 0.5 < off < 2.0 * int(said[1])


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("o", ("CENTER_NAME = MOON", "CENTER_NAME = EARTH"), "CENTER_NAME is EARTH; supported: MOON"),
        ("o", ("REF_FRAME = EME2000", "REF_FRAME = TEME"), "REF_FRAME is TEME; supported: EME2000"),
        ("o", ("TIME_SYSTEM = UTC", "TIME_SYSTEM = GPS"), "o: the time system GPS: UTC, TAI, TT"),
        ("a", ("= QUATERNION", "= EULER_ANGLE"), "ATTITUDE_TYPE is EULER_ANGLE; supported: QUAT"),
        ("a", ("META_START", "META"), "a: has no META_START and rows"),
        ("o", ("CCSDS_OEM_VERS", "<?xml"), "o: is XML; give the message as text"),
        ("o", ("\n2026-03-01T00:00:20", "\n2026-03-01T00:00:20 1 2"), "unequal numbers of columns"),
        ("o", ("\n2026-03-01T00:00:20", "\n2026-02-01T00:00:20"), "times must increase"),
    ],
)  # fmt: skip
def test_refusals(
    meta: Path,
    truth: list[lcp.Camera],
    tmp_path: Path,
    file: str,
    change: tuple[str, str],
    said: str,
) -> None:
    with loaded(meta):
        oem(tmp_path / "o"), aem(tmp_path / "a", "MY_CAMERA")
    text = (tmp_path / file).read_text()
    assert change[0] in text
    (tmp_path / file).write_text(text.replace(*change, 1))
    with pytest.raises(CameraError, match=re.escape(said)):
        lcp.cameras_from_ccsds(tmp_path / "o", tmp_path / "a", truth[0], WHEN, meta)


def test_times_and_kernels_that_are_missing(
    meta: Path, truth: list[lcp.Camera], tmp_path: Path
) -> None:
    with loaded(meta):
        files = oem(tmp_path / "o"), aem(tmp_path / "a", "MY_CAMERA")
    with pytest.raises(CameraError, match=r"o: does not cover 2026-03-02T.* it has 2026-03-01T"):
        lcp.cameras_from_ccsds(*files, truth[0], "2026-03-02", meta)
    with pytest.raises(CameraError, match="lack the Moon's frame MOON_ME: load NAIF's"):
        lcp.cameras_from_ccsds(*files, truth[0], WHEN)
    with pytest.raises(CameraError, match=r"`mounting` .* is no unit quaternion"):
        lcp.cameras_from_ccsds(*files, truth[0], WHEN, meta, (1.0, 1.0, 0.0, 0.0))
