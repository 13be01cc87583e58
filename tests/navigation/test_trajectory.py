"""Trajectories: their files, the answers along them, and the chart."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.navigable import everywhere_usable
from helpers.posed import camera
from scipy.spatial.transform import Rotation

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import CameraError, ConfigError, SunError
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.navigation import frame_points
from lcp_catalog.navigation.documents import TrajectoryChart
from lcp_catalog.navigation.expected_position import Answer, Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage
from lcp_catalog.navigation.trajectory_file import read_trajectory

SUN = SunChoice(100.0, 17.0)
TIMES = [f"2026-01-26T18:00:{k:02d}" for k in range(8)]


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return everywhere_usable()


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    """Along a parallel towards Hadley, descending; the first ones are far off."""
    found = []
    for k, time in enumerate(TIMES):
        over = camera(EnuFrame(-12.0 + 2.2 * k, 26.1), 140e3 - 5e3 * k, tilt=(0.0, 0.02 * k, 0.3))
        found.append(replace(over, time_utc=time))
    return found


def table(cameras: list[Camera], matrix: bool) -> str:
    """A CSV of cameras; quaternions by scipy, with other columns between."""
    names = [f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)] if matrix else ["qx", "qy", "qz", "qw"]  # fmt: skip
    lines = ["# made up", ",".join(["note", "z_m", "time_utc", "x_m", "y_m", *names]), ""]
    for one in cameras:
        turn = one.rotation_mcmf_to_camera
        numbers = turn.ravel() if matrix else Rotation.from_matrix(np.array(turn)).as_quat()
        x, y, z = one.position_mcmf_m
        first, *rest = (repr(float(number)) for number in (z, x, y))
        turns = (repr(float(number)) for number in numbers)
        lines.append(",".join(["a b", first, str(one.time_utc), *rest, *turns]))
    return "\n".join(lines)


@pytest.mark.parametrize("kind", ["quaternion", "matrix", "json"])
def test_a_trajectory_has_the_cameras_that_were_written(
    kind: str, cameras: list[Camera], tmp_path: Path
) -> None:
    path, own = tmp_path / "way", replace(cameras[0], time_utc="1971-01-01")
    if kind == "json":
        path.write_text(json.dumps([one.to_json() for one in cameras]), encoding="utf-8")
        found = read_trajectory(path)
    else:
        path.write_text(table(cameras, kind == "matrix"), encoding="utf-8")
        found = read_trajectory(path, own)
    assert len(found) == len(cameras)
    for one, wanted in zip(found, cameras, strict=True):
        np.testing.assert_allclose(one.position_mcmf_m, wanted.position_mcmf_m, atol=1e-6)
        np.testing.assert_allclose(one.rotation_mcmf_to_camera, wanted.rotation_mcmf_to_camera, atol=1e-12)  # fmt: skip
        assert one.time_utc == wanted.time_utc
        assert one.focal_length_px == wanted.focal_length_px


def test_a_csv_does_not_take_the_sun_of_its_camera(cameras: list[Camera], tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text(table(cameras, False), encoding="utf-8")
    lit = replace(cameras[0], sun_position_mcmf_m=np.array([1.5e11, 0.0, 0.0]))
    for one in read_trajectory(path, lit):
        assert one.sun_position_mcmf_m is None
        at_time = PlannedImage.lit(one, SunChoice()).sun
        np.testing.assert_array_equal(at_time, PlannedImage.lit(one, SunChoice(time_utc=one.time_utc)).sun)  # fmt: skip


HEAD = "time_utc,x_m,y_m,z_m,qw,qx,qy,qz\n"
GOOD = "2026-01-01,1.9e6,0,0,1,0,0,0\n"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "lacks qw, qx, qy, qz (or r11 ... r33)"),
        ("time_utc,x_m\n", "lacks qw, qx, qy, qz (or r11 ... r33)"),
        ("time_utc,x_m,qw,qx,qy,qz\n", "the header lacks y_m, z_m"),
        (HEAD.replace("qz", "qy"), "the header lacks qz"),
        (HEAD.replace("qz", "qz,x_m"), "the header has x_m twice"),
        (HEAD, "has no frame"),
        (HEAD + GOOD + "2026-01-01,1\n", "line 3: has 2 columns"),
        (HEAD + "# a note\n" + GOOD.replace("1.9e6", "abc"), "line 3: x_m is not a number: 'abc'"),
        (HEAD + GOOD.replace("1.9e6", "nan"), "line 2: position_mcmf_m must hold 3 finite"),
        (HEAD + GOOD.replace("1.9e6", "1900"), "line 2: position_mcmf_m lies deep inside"),
        (HEAD + GOOD.replace(",1,0,0,0", ",1,1,0,0"), "line 2: qw, qx, qy, qz have the length 1.41421, not 1"),
        (HEAD + GOOD.replace("2026-01-01", "yesterday"), "line 2: invalid time: 'yesterday'"),
        (HEAD + '2026,"1\n', "is not a CSV table"),
        ("[{]", "is not JSON"),
        ('[{"a": 1, "a": 1}]', "has the key 'a' twice"),
        ("{}", "leave out `camera`"),
        ("[]", "leave out `camera`"),
    ],
)  # fmt: skip
def test_a_bad_csv_is_one_line(text: str, why: str, cameras: list[Camera], tmp_path: Path) -> None:
    path = tmp_path / "way.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CameraError) as error:
        read_trajectory(path, None if text.startswith("[{") else cameras[0])
    assert why in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[]", "has no frame"),
        ("{}", "must be a list of cameras"),
        ("[1]", "camera 1: a camera file holds one JSON object"),
        ("[{}]", "camera 1: is no camera: has no key"),
        (HEAD + GOOD, "give its camera with `camera`"),
    ],
)
def test_a_bad_list_is_one_line(text: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "way.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CameraError, match=r"way\.json") as error:
        read_trajectory(path)
    assert why in str(error.value)


def test_a_list_with_a_time_that_is_none_is_refused(cameras: list[Camera], tmp_path: Path) -> None:
    path = tmp_path / "way.json"
    documents = [one.to_json() for one in cameras]
    documents[3]["time_utc"] = "noon"
    path.write_text(json.dumps(documents), encoding="utf-8")
    with pytest.raises(CameraError, match="camera 4: time_utc: invalid time: 'noon'"):
        read_trajectory(path)


def along(catalog: Catalog, cameras: list[Camera], query: Query) -> list[Answer]:
    return list(answers(catalog, [PlannedImage.lit(one, SUN) for one in cameras], query))


@pytest.mark.slow
@pytest.mark.parametrize("at_once", [1, 40, 50_000])
def test_every_frame_has_the_answer_that_it_has_alone(
    catalog: Catalog,
    cameras: list[Camera],
    at_once: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also from the file, whose claims are read for several frames at once."""
    monkeypatch.setattr(frame_points, "PAIRS_AT_ONCE", at_once)
    write_catalog(catalog, tmp_path / "c.h5")
    found = along(open_catalog(tmp_path / "c.h5", check=False), cameras, Query(most=9))
    assert len(found) == len(cameras)
    assert sum(len(one.rows) for one in found) > 15
    for one, taken in zip(found, cameras, strict=True):
        (alone,) = along(catalog, [taken], Query(most=9))
        assert one.rows.tolist() == alone.rows.tolist()
        assert one.counts == alone.counts
        np.testing.assert_allclose(one.probability, alone.probability, rtol=1e-6)
        np.testing.assert_allclose(one.sigma_px, alone.sigma_px, rtol=1e-4)
        assert (one.position.covariance is None) == (alone.position.covariance is None)


def test_the_chart_names_the_holes(catalog: Catalog, cameras: list[Camera], tmp_path: Path) -> None:
    chart, found = TrajectoryChart(), along(catalog, cameras, Query())
    for one in found:
        chart.add(one)
    few = [one.usable < 4 for one in found]
    assert few[0]
    assert not few[-1]
    first = few.index(False)
    assert chart.holes[0] == (TIMES[0], TIMES[first - 1], first)
    assert sum(count for _, _, count in chart.holes) == sum(few)
    lines = chart.summary()
    known = [one.position.position_sigma_m for one in found if one.position.position_sigma_m]
    assert f"in {len(known)} frames" in lines[0]
    assert f"hole: {first} frames with fewer than 4 usable points, {TIMES[0]} to {TIMES[first - 1]}" in lines[1]  # fmt: skip
    drawn = ET.fromstring(chart.encode("way.svg", "way"))
    kinds = [one.get("class") for one in drawn.iter() if one.get("class")]
    assert kinds.count("hole") == 2 * len(chart.holes)
    assert {"points", "free", "known", "height"} <= set(kinds)
    told = {one.text for one in drawn.iter() if one.text}
    assert {"red: fewer than 4 usable points", "position, 1 sigma, m", "altitude, km"} <= told
    page = chart.encode("way.HTML", "a <b>").decode()
    assert "<svg" in page
    assert "a &lt;b&gt;" in page
    assert "<script" not in page
    least, wide = (
        int(re.search(p, page)[1]) for p in (r"min-width: (\d+)px; height", r"0 0 (\d+) ")
    )
    assert (
        13.0 * least / wide >= 11.0
    )  # pixels of the text on a narrow screen, where the charts scroll
    with pytest.raises(ConfigError, match=r"\.svg or \.html"):
        chart.encode("way.png", "way")


@pytest.mark.parametrize("count", [1, 3])
def test_a_chart_of_few_frames_without_times_and_points(
    count: int, catalog: Catalog, cameras: list[Camera]
) -> None:
    chart = TrajectoryChart()
    for one in along(catalog, [replace(cameras[0], time_utc=None)] * count, Query()):
        chart.add(one)
    assert chart.holes == [("frame 1", f"frame {count}", count)]
    ET.fromstring(chart.encode("way.svg", "way"))


def test_a_frame_without_a_sun_is_refused(cameras: list[Camera]) -> None:
    with pytest.raises(SunError, match="no Sun"):
        PlannedImage.lit(replace(cameras[0], time_utc=None), SunChoice())
