"""`lcp query` and `lcp windows`: outputs, and refusals in one line."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from helpers import catalogs
from helpers.commands import refusal
from helpers.navigable import everywhere_usable
from helpers.posed import camera
from lcp_cli.main import run
from pyproj import CRS

from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.geometry.frames import EnuFrame

SUN = ["--sun-azimuth", "100", "--sun-elevation", "17"]
HEAD = "time_utc,x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """c.h5, old.h5 (of schema 2.5), cam.json with a time, far.json, and way.csv of 3 frames."""
    folder = tmp_path_factory.mktemp("query")
    write_catalog(everywhere_usable(), folder / "c.h5")
    write_catalog(catalogs.catalog(), folder / "old.h5")
    with h5py.File(folder / "old.h5", "r+") as file:
        file.attrs["schema_version"] = "2.5"
    own = camera(EnuFrame(*catalogs.CENTER))
    dated = replace(own, time_utc="2026-01-27T02:00:00").to_json()
    (folder / "cam.json").write_text(json.dumps(dated), encoding="utf-8")
    away = camera(EnuFrame(120.0, -5.0)).to_json()
    (folder / "far.json").write_text(json.dumps(away), encoding="utf-8")
    sky = replace(own, rotation_mcmf_to_camera=np.diag([1.0, -1.0, -1.0]) @ own.rotation_mcmf_to_camera)  # fmt: skip
    (folder / "sky.json").write_text(json.dumps(sky.to_json()), encoding="utf-8")
    lines = [HEAD]
    for k, lon in enumerate((-20.0, 3.0, 4.0)):
        one = camera(EnuFrame(lon, 26.0))
        numbers = [*one.position_mcmf_m, *one.rotation_mcmf_to_camera.ravel()]
        lines.append(f"2026-01-27T02:00:0{k}," + ",".join(map(repr, map(float, numbers))))
    (folder / "way.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.fixture
def here(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for path in files.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(line: str, capsys: Any, code: int = 0) -> tuple[str, str]:
    assert run(line.split()) == code
    captured = capsys.readouterr()
    return captured.out, captured.err


def test_json_has_the_fields_of_the_contract(here: Path, capsys: Any) -> None:
    out, err = said(f"query c.h5 --camera cam.json --json {' '.join(SUN)}", capsys)
    found = json.loads(out)
    points = found["points"]
    assert len(points) == found["counts"]["usable"] == found["counts"]["listed"] > 10
    for one in points:
        assert isinstance(one["point_id"], int)
        assert one["level"] == 0
        assert 0.9 < one["detection_probability"] <= 1.0
        assert len(one["pixel"]) == 2
        for name in ("sigma_px", "sigma_m"):
            major, minor, angle = one[name]
            assert major >= minor > 0.0
            assert 0.0 <= angle <= 180.0
    covariance = np.array(found["position_covariance_m2"])
    assert covariance.shape == (3, 3)
    assert found["position_sigma_m"] == pytest.approx(np.sqrt(np.trace(covariance)))
    assert (np.linalg.eigvalsh(np.array(found["covariance_6x6"])) > 0.0).all()
    assert np.hypot.reduce(found["position_sigma_enu_m"]) == pytest.approx(found["position_sigma_m"])  # fmt: skip
    assert found["dop"].keys() == {"position", "horizontal", "vertical"}
    assert found["reason"] is None
    assert found["sun"]["azimuth_deg"] == pytest.approx(100.0, abs=0.01)
    assert "points in view usable" in err


def test_the_stated_sun_counts_before_the_cameras_own(here: Path, capsys: Any) -> None:
    suns = [
        json.loads(said(f"query c.h5 --camera cam.json --json {more}", capsys)[0])["sun"]
        for more in ("", "--time 2026-01-27T02:00:00", "--time 2026-01-30", " ".join(SUN))
    ]
    assert suns[0] == suns[1]
    assert suns[2] != suns[0] != suns[3]


def test_azimuths_wrap(here: Path, capsys: Any) -> None:
    found = []
    for azimuth in (-3.0, 357.0, 360.0, 0.0):
        line = f"query c.h5 --camera cam.json --json --sun-azimuth {azimuth} --sun-elevation 17"
        found.append(json.loads(said(line, capsys)[0])["points"])
    assert found[0] == found[1] != []
    assert found[2] == found[3] != []


def test_text_is_a_table_and_one_line(here: Path, capsys: Any) -> None:
    out, err = said(f"query c.h5 --camera cam.json {' '.join(SUN)}", capsys)
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["point_id", "level", "probability"]
    assert len(lines) <= 15
    assert "position to" in lines[-1]
    assert "with an exact attitude" in lines[-1]
    assert err == ""


def test_points_as_csv_and_geojson(here: Path, capsys: Any) -> None:
    line = f"query c.h5 --camera cam.json --max 7 {' '.join(SUN)}"
    best = json.loads(said(f"{line} --json", capsys)[0])
    said(f"{line} -o out.csv", capsys)
    rows = list(csv.DictReader(Path("out.csv").read_text(encoding="utf-8").splitlines()))
    assert [int(row["point_id"]) for row in rows] == [one["point_id"] for one in best["points"]]
    assert len(rows) == 7 == best["counts"]["listed"] < best["counts"]["usable"]
    said(f"{line} -o out.geojson", capsys)
    whole = json.loads(Path("out.geojson").read_text(encoding="utf-8"))
    moon = CRS.from_user_input(whole["crs"]["properties"]["name"])
    assert moon.ellipsoid.semi_major_metre == 1737400.0
    for feature, row in zip(whole["features"], rows, strict=True):
        assert feature["properties"]["point_id"] == int(row["point_id"])
        lon, lat, _ = feature["geometry"]["coordinates"]
        assert (lon % 360.0, lat) == (pytest.approx(float(row["longitude_deg"])), float(row["latitude_deg"]))  # fmt: skip
    assert "exists" in refusal(f"{line} -o out.csv".split(), 1, capsys)
    said(f"{line} -o out.csv --overwrite", capsys)


def test_nothing_in_view_is_an_answer(here: Path, capsys: Any) -> None:
    out, _ = said(f"query c.h5 --camera far.json --json {' '.join(SUN)}", capsys)
    found = json.loads(out)
    assert found["points"] == []
    assert found["position_covariance_m2"] is None
    assert found["position_sigma_m"] is None
    assert found["reason"] == "no usable point: a position needs 4"
    text, _ = said(f"query c.h5 --camera far.json {' '.join(SUN)}", capsys)
    assert "0 of 0 points in view usable; no position" in text


def test_a_trajectory_is_a_list_by_time(here: Path, capsys: Any) -> None:
    line = "query c.h5 --camera cam.json --trajectory way.csv"
    out, err = said(f"{line} --json", capsys)
    found = json.loads(out)
    assert [one["time_utc"] for one in found] == [f"2026-01-27T02:00:0{k}" for k in range(3)]
    assert [one["position_sigma_m"] is None for one in found] == [True, False, False]
    assert "hole: 1 frame with fewer than 4" in err
    said(f"{line} -o way_out.csv --plot way.svg", capsys)
    rows = list(csv.DictReader(Path("way_out.csv").read_text(encoding="utf-8").splitlines()))
    for row, one in zip(rows, found, strict=True):
        assert row["time_utc"] == one["time_utc"]
        assert int(row["usable"]) == one["counts"]["usable"]
        if one["position_sigma_m"]:
            assert float(row["position_sigma_m"]) == pytest.approx(one["position_sigma_m"], rel=1e-5)  # fmt: skip
    assert Path("way.svg").read_text(encoding="utf-8").startswith("<svg xmlns")
    text, _ = said(line, capsys)
    assert len(text.splitlines()) == 1 + 3 + 3
    assert (
        "2026-01-27T02:00:00: a catalogue of what the image shows: lcp build-catalog --bounds "
        in text
    )
    both, _ = said(f"{line} --json -o again.csv", capsys)
    assert json.loads(both) == found
    assert Path("again.csv").read_bytes() == Path("way_out.csv").read_bytes()


@pytest.mark.parametrize(
    ("line", "code", "why"),
    [
        ("query c.h5", 2, "give --camera CAMERA.json or --trajectory FILE"),
        ("query c.h5 --camera cam.json --plot a.svg", 2, "--plot needs --trajectory"),
        ("query c.h5 --camera cam.json -o a.txt", 2, "must end in .csv or .geojson"),
        ("query c.h5 --camera cam.json --trajectory way.csv -o a.geojson", 2, "must end in .csv"),
        ("query c.h5 --camera cam.json --trajectory way.csv --plot a.png", 2, "must end in .svg or .html"),
        ("query c.h5 --camera cam.json --sun-azimuth 3", 2, "go together"),
        ("query c.h5 --camera cam.json --max 0", 2, "0 is not in the range"),
        ("query c.h5 --camera cam.json --attitude-sigma nan", 2, "not a finite number"),
        ("query c.h5 --camera nothing.json", 1, "nothing.json: there is no such file"),
        ("query c.h5 --camera c.h5", 1, "is an HDF5 file, such as a catalogue, not a camera"),
        ("query cam.json --camera cam.json", 1, "is a JSON file, such as a camera, not a catalogue"),
        ("query none.h5 --camera cam.json", 1, "there is no such file"),
        ("query old.h5 --camera cam.json", 1, "old.h5: made by lcp 0.2; build it again"),
        ("query c.h5 --camera far.json", 1, "no Sun"),
        ("query c.h5 --camera sky.json --sun-azimuth 3 --sun-elevation 3", 1, "OpenGL or Blender"),
        ("query c.h5 --trajectory way.csv", 1, "give its camera with --camera"),
        ("query c.h5 --camera cam.json --trajectory cam.json", 1, "leave out --camera"),
        ("query c.h5 --trajectory cam.json", 1, "must be a list of cameras"),
        ("query c.h5 --camera cam.json -o c.csv/a.csv", 1, "does not exist"),
        ("windows c.h5 --center 3.5 26 --range 2026-01-02 2026-01-01 1d", 2, "before it starts"),
        ("windows c.h5 --center 3.5 26 --range 1800-01-02 2026-01-01 1d", 2, "1800"),
        ("windows c.h5 --center 3.5 26 --range 2026-01-01 2026-01-02 1d -o w.txt", 2, "must end in .csv"),
        ("windows c.h5 --center 3.5 26 --range 2026-01-01 2026-01-02 1d --off-nadir 9", 2, "--view-azimuth go together"),
        ("windows c.h5 --center 3.5 26 --range 2026-01-01 2026-01-02 1d --camera cam.json --size 9", 2, "--camera excludes"),
        ("windows c.h5 --center 93.5 26 --range 2026-01-01 2026-01-02 1d", 1, "no point of the catalogue lies within"),
        ("windows old.h5 --center 3.5 26 --range 2026-01-01 2026-01-02 1d", 1, "old.h5: made by lcp 0.2; build it again"),
    ],
)  # fmt: skip
def test_what_does_not_work_is_one_line(
    line: str, code: int, why: str, here: Path, capsys: Any
) -> None:
    before = sorted(path.name for path in here.iterdir())
    assert why in refusal(line.split(), code, capsys)
    assert sorted(path.name for path in here.iterdir()) == before


def test_windows_of_a_site(here: Path, capsys: Any) -> None:
    line = "windows c.h5 --center 3.5 26 --range 2026-01-20 2026-02-14 12h --size 60"
    out, _ = said(f"{line} --json", capsys)
    found = json.loads(out)
    assert found["points"] > 10
    (one,) = found["intervals"]
    counts = [instant["usable"] for instant in found["instants"]]
    assert one["instants"] == sum(count >= 4 for count in counts)
    assert one["from"] == next(i["time_utc"] for i in found["instants"] if i["usable"] >= 4)
    said(f"{line} -o w.csv", capsys)
    rows = list(csv.DictReader(Path("w.csv").read_text(encoding="utf-8").splitlines()))
    assert [int(row["usable"]) for row in rows] == counts
    text, _ = said(f"{line} --min-points 999", capsys)
    assert text.startswith(f"{found['points']} points; at least 999 of them usable at 0 of 51")
    text, _ = said("windows c.h5 --center 3.5 26 --range 2026-01-26 2026-01-28 12h --camera cam.json", capsys)  # fmt: skip
    assert "points; at least 4 of them usable at" in text
