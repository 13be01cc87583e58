"""``lcp build-catalog`` from the outside: files, exit codes, one line for every mistake, nothing half-written."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.commands import refusal
from helpers.verified import verify
from lcp_cli import build_catalog
from lcp_cli.main import run

from lcp_catalog.errors import ConfigError
from lcp_catalog.photometry import moon_map
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.production.run import Build, BuildReport

DEM = str(Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif")

SMALL = """
[area]
center_deg = [3.5, 26.0]
size_km = 40.0
gsd_m = 474.0
[sun]
azimuths_deg = [90.0, 180.0, 270.0]
elevations_deg = [10.0, 30.0]
[view]
off_nadir_deg = [0.0]
azimuth_deg = [0.0]
altitude_km = [inf]
[points]
patch_nodes = 17
search_m = 9000.0
[model]
direction_tolerance_deg = 1.0
ring_max_km = 30.0
"""


@pytest.fixture
def config(tmp_path: Path) -> str:
    path = tmp_path / "build.toml"
    path.write_text(SMALL)
    return str(path)


def lcp(*arguments: str) -> list[str]:
    return [sys.executable, "-c", "from lcp_cli.main import main; main()", *arguments]


def test_it_writes_a_catalogue_and_what_it_read(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output, rule = tmp_path / "a catalogue.h5", tmp_path / "rule.d"
    arguments = [DEM, "-o", str(output), "--config", config, "--jobs", "1", "--depfile", str(rule)]
    assert run(["-v", "build-catalog", *arguments]) == 0
    told = "accuracy standard: about 1.2 % of the unshadowed flags at 10 deg of Sun are others than"
    assert told in " ".join(capsys.readouterr().err.split())
    assert verify(output) == []
    assert rule.read_text() == f"{str(output).replace(' ', chr(92) + ' ')}: {DEM} {moon_map.FILE}\n"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a catalogue.h5", "build.toml", "rule.d"]


@pytest.mark.parametrize(
    ("points", "areas", "said"),
    [(0, 1, "0 control points from 1 area"), (1, 2, "1 control point from 2 areas")],
)
def test_it_says_what_it_has_written(
    points: int,
    areas: int,
    said: str,
    config: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    done = BuildReport(points, areas, {}, ())
    monkeypatch.setattr("lcp_cli.build_catalog._build", lambda *_: done)
    assert run(["build-catalog", DEM, "-o", "x.h5", "--config", config]) == 0
    assert capsys.readouterr().err.splitlines()[-1] == f"x.h5: {said}"


def test_plan_writes_nothing_and_speaks_json(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["build-catalog", DEM, "--config", config, "--plan", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document) == {
        "areas",
        "suns",
        "views",
        "cell_renders",
        "memory_mb_per_worker",
        "memory_mb_parent",
        "seconds_estimate",
        "bytes_estimate",
        "decisions",
        "albedo_worth",
        "located_by_sun",
        "promise_kept",
        "one_direction",
        "matching_cost",
    }
    assert document["one_direction"].keys() == {"sun_elevation", "flags_changed"}
    own = ["--accuracy", "high", "--sun-elevations", "5,10"]  # each Sun is a point's own
    own += ["--center", "3.5", "26", "--size", "12"]
    assert run(["build-catalog", DEM, "--config", config, "--plan", "--json", *own]) == 0
    turned = json.loads(capsys.readouterr().out)["one_direction"]
    assert turned == {"sun_elevation": None, "flags_changed": 0.0}
    assert document["areas"] >= 1
    assert document["views"] == 1
    told = {"effect", "modelled", "reason", "error_bound", "unit", "switch", "cost"}
    decisions = {one["effect"]: one for one in document["decisions"]}
    for one in decisions.values():
        assert set(one) == told | ({"cost_reason"} if one["cost"] is None else set())
        assert one["modelled"] or one["cost"] is not None
    shares = [one["cost"] or 0.0 for one in decisions.values()]
    assert min(shares) >= 0.0
    assert sum(shares) + document["matching_cost"] == pytest.approx(1.0)
    assert document["matching_cost"] > 0.2
    own = "cast shadows", "reflectance", "relief", "terrain beyond the area", "dependence"
    assert all(decisions[effect]["cost"] > 0.0 for effect in own)
    assert decisions["solar disc"]["cost"] == 0.0
    switches = {effect: one["switch"] for effect, one in decisions.items()}
    assert switches["cell size"] == "--gsd"
    assert (switches["Suns"], switches["cast shadows"]) == ("--sun-elevations", "--accuracy")
    # fields without an option are keys of BUILD.toml
    assert (switches["scattered light"], switches["dependence"]) == (
        "model.bounce",
        "points.max_dependence",
    )
    assert switches["curvature"] is None
    assert [p.name for p in tmp_path.iterdir()] == ["build.toml"]


CAMERA = str(Path(DEM).parent / "AS15-M-0414_camera.json")


def test_a_camera_gives_views_suns_and_region(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the file and the options state stays; the plan says how many of the camera's pixels get claims."""
    small = ["build-catalog", DEM, "--center", "3.5", "26", "--size", "12", "--plan", "--json"]
    assert run([*small, "--camera", CAMERA]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["views"], document["suns"]) == (5, 6)  # at 10, 15, 20 deg from 90 and 105 deg
    assert document["claimed_share"] == 1.0
    assert run([*small, "--config", config, "--camera", CAMERA]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["views"], document["suns"]) == (
        5,
        4,
    )  # those of the file, of which two never occur


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--field-of-view", "40"], "go together"),
        (["--altitude", "40"], "go together"),
        (["--field-of-view", "40", "--altitude", "100", "--camera", CAMERA], "exclude each other"),
        (["--trajectory", CAMERA, "--camera", CAMERA, "--camera", CAMERA], "takes one --camera"),
    ],
)
def test_images_of_several_kinds(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["build-catalog", DEM, "--plan", *words]) == 2
    assert said in capsys.readouterr().err


def test_a_camera_that_sees_other_ground(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = json.loads(Path(CAMERA).read_text())
    other["position_mcmf_m"] = [-v for v in other["position_mcmf_m"]]
    other["rotation_mcmf_to_camera"] = [
        [-v for v in row] for row in other["rotation_mcmf_to_camera"]
    ]
    other["rotation_mcmf_to_camera"][0] = [-v for v in other["rotation_mcmf_to_camera"][0]]
    path = tmp_path / "other.json"
    path.write_text(json.dumps(other))
    assert run(["build-catalog", DEM, "--plan", "--camera", str(path)]) == 1
    assert "the camera sees longitude" in capsys.readouterr().err


def test_plan_is_seven_lines(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without an albedo map six, with own Suns for all five. The decisions are shown with -v, also after the command."""
    small = ["build-catalog", DEM, "--config", config, "--size", "12", "--plan"]
    small += ["--center", "3.5", "26"]
    assert run(small) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 7
    assert re.match(r"1 area x 4 Suns x 1 view, [\d,]+ cells rendered$", lines[0])
    assert re.match(r"\d+ s with --jobs 1$", lines[1])
    assert re.match(
        r"0\.\d MB of catalogue, [\d,]+ MB of memory a job, [\d,]+ MB to merge$", lines[2]
    )
    worth = r"usable candidates .* without the albedo map: 10 deg [\d.]+ \([\d.]+\); 30 deg "
    turned = r"one Sun direction an area: about 1\.2 % of the unshadowed flags at 10 deg of Sun are others "
    assert re.match(turned, lines[3])
    assert re.match(worth, lines[4])
    assert re.match(
        r"about how probably a frame .* is located, .*: 10 deg [\d.]+, [\d.]+; 30 deg ", lines[5]
    )
    kept = r"of the promise for all places, views and Suns, also between .*, roughly \d+ % is kept$"
    assert re.match(kept, lines[6])
    assert run([*small, "--albedo", "none", "--accuracy", "high"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 5
    (alone,) = build_catalog._by_sun({"promise_kept": 0.3})  # of usable points
    assert re.match(kept, alone)
    for words in (["-v", *small], [*small, "-v"]):
        assert run(words) == 0
        assert "cast shadows" in capsys.readouterr().out


@pytest.mark.slow
def test_two_passes_in_parts(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The commands of the page, and the bytes of one build."""
    words = ["build-catalog", DEM, "--config", config, "--passes", "2", "-o"]
    whole, output = str(tmp_path / "whole.h5"), str(tmp_path / "x.h5")
    assert run([*words, whole]) == 0
    for then in ("run the parts again", "run the parts again", "nothing is left to evaluate"):
        for part in ("1/2", "2/2"):
            assert run([*words, output, "--part", part, "--jobs", "1"]) == 0
        capsys.readouterr()
        assert run([*words, output, "--select"]) == 0
        assert then in capsys.readouterr().err
    assert run([*words, output, "--merge", "--jobs", "1"]) == 0
    assert Path(output).read_bytes() == Path(whole).read_bytes()


def test_list_parts_names_missing_areas(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of 100 km there are more areas than are named; nothing is written."""
    many = [DEM, "-o", str(tmp_path / "x.h5"), "--config", config, "--list-parts"]
    many += ["--center", "3.5", "26", "--size", "150"]
    assert run(["build-catalog", *many, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    (part,) = document["parts"]
    assert part["part"] == "1/1"
    assert len(part["missing"]) == part["areas"] == document["areas"] == document["missing"] > 8
    assert run(["build-catalog", *many]) == 0
    first, last = capsys.readouterr().out.splitlines()
    names = " ".join(part["missing"][:8])
    count = part["areas"]
    more = f"{names} and {count - 8} more (all with --json)"
    assert first == f"part 1/1: {count} of {count} missing: {more}"
    assert last == f"0 of {count} areas are computed"
    assert [p.name for p in tmp_path.iterdir()] == ["build.toml"]


def test_messages_are_json_lines(
    tmp_path: Path,
    config: str,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a whole build: progress and the result. How often a slow machine tells it is tested with `progress`."""
    monkeypatch.setattr("lcp_cli.progress._EVERY_S", {False: 600.0, True: 600.0})
    small = [DEM, "-o", str(tmp_path / "x.h5"), "--config", config, "--center", "3.5", "26"]
    assert (
        run(["build-catalog", *small, "--size", "12", "--jobs", "1", "--log-format", "json"]) == 0
    )
    printed = capfd.readouterr()
    events = [json.loads(line) for line in printed.err.splitlines()]
    assert [event["event"] for event in events if event["event"] != "log"] == [
        "progress",
        "progress",
        "done",
    ]
    assert events[-1]["areas"] == 1
    assert printed.out == ""


@pytest.mark.slow
def test_flags_override_the_file(config: str, capsys: pytest.CaptureFixture[str]) -> None:
    flags = [
        "--view",
        "0",
        "--view",
        "30:90:100",
        "--sun-elevations",
        "10:30:10",
        "--center",
        "3.4",
        "26.1",
        "--size",
        "20",
    ]
    assert run(["build-catalog", DEM, "--config", config, "--plan", "--json", *flags]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["views"] == 2
    assert document["suns"] == 6  # three elevations at east and at west; none at south below 60 deg


def test_noise_is_the_sensors(
    tmp_path: Path, config: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``--noise`` overrides errors.sensor_noise of the file and nothing else; a key of version 1 names
    its replacement.
    """
    seen: list[BuildConfig] = []

    def stop(paths: object, given: BuildConfig, *_: object) -> None:
        seen.append(given)
        raise ConfigError("enough")

    monkeypatch.setattr(Build, "plan", stop)
    Path(config).write_text(SMALL + "[errors]\nsensor_noise = 0.2\nalbedo_sigma = 0.01\n")
    for more in ([], ["--noise", "0.07"]):
        assert run(["build-catalog", DEM, "-o", "x.h5", "--config", config, *more]) != 0
    plain, louder = seen
    assert (plain.errors.sensor_noise, plain.errors.albedo_sigma) == (0.2, 0.01)
    expected = dataclasses.replace(plain.errors, sensor_noise=0.07)
    assert louder == dataclasses.replace(plain, errors=expected)
    Path(config).write_text(SMALL.replace("[points]", "[points]\nimage_noise = 0.15"))
    arguments = ["build-catalog", DEM, "-o", str(tmp_path / "x.h5"), "--config", config]
    capsys.readouterr()
    said = refusal(arguments, 2, capsys)
    assert "[points] has no key image_noise" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["nowhere.tif", "-o", "x.h5"], 1, "nowhere.tif"),
        ([DEM], 2, "-o CATALOG.h5"),
        ([DEM, "-o", "x.h5", "--center", "3", "26"], 2, "--size"),
        (
            [DEM, "-o", "x.h5", "--center", "100", "26", "--size", "20"],
            1,
            "no height in the DEM, which covers",
        ),
        (
            [DEM, "-o", "x.h5", "--sun-azimuths", "0,1", "--sun-elevations", "80,81"],
            1,
            "give lower ones",
        ),
        ([DEM, "-o", "no/such/folder/x.h5", "--center", "3", "26", "--size", "20"], 1, "folder"),
        ([DEM, "-o", "x.h5", "--config", "nowhere.toml"], 1, "nowhere.toml"),
        ([DEM, "-o", "x.h5", "--sun-elevations", "5,5"], 2, "--sun-elevations must rise"),
        ([DEM, "-o", "x.h5", "--sun-elevations", "5;6"], 2, "A,B,C"),
        ([DEM, "-o", "x.h5", "--view", "30"], 2, "OFF_NADIR:AZIMUTH"),
        ([DEM, "-o", "x.h5", "--jobs", "0"], 2, "--jobs"),
        ([DEM, "-o", "x.h5", "--part", "1/2", "--merge"], 2, "--part and --merge exclude"),
        ([DEM, "-o", "x.h5", "--select", "--merge"], 2, "--select and --merge exclude"),
        ([DEM, "-o", "x.h5", "--select", "--gsd", "474"], 2, "needs --passes 2"),
        (
            [DEM, "-o", "x.h5", "--select", "--gsd", "474", "--passes", "2"],
            1,
            "run the parts first",
        ),
        ([DEM, "-o", "x.h5", "--part", "3/2"], 2, "from 1 to N"),
        ([DEM, "-o", "x.h5", "--part", "2"], 2, "K/N"),
        ([DEM, "-o", "x.h5", "--merge", "--gsd", "474"], 1, "run the parts first"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str],
    code: int,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refusal(["build-catalog", *arguments], code, capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sent", "to_all", "code", "says"),
    [
        (signal.SIGINT, True, 130, "interrupted"),  # Ctrl-C: the terminal's whole process group
        (signal.SIGTERM, False, 143, "stopped by SIGTERM"),
        (signal.SIGKILL, False, -9, ""),
    ],
)
def test_a_signal_leaves_finished_areas_and_nothing_else(
    sent: int, to_all: bool, code: int, says: str, tmp_path: Path, config: str
) -> None:
    """81 small areas, of which the first is soon done and the others are not. Five seconds after the
    signal no process is left, however the first one ended.
    """
    output, many = tmp_path / "x.h5", Path(config)
    text = SMALL.replace("size_km = 40.0", "size_km = 100.0")
    many.write_text(text.replace("tolerance_deg = 1.0", "tolerance_deg = 0.3"))
    process = subprocess.Popen(
        lcp("build-catalog", DEM, "-o", str(output), "--config", config, "--jobs", "2"),
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    parts = tmp_path / "x.h5.parts"
    deadline = time.monotonic() + 120.0
    while not list(parts.glob("*.area")):
        assert time.monotonic() < deadline
        assert process.poll() is None, process.stderr and process.stderr.read()
        time.sleep(0.05)
    (os.killpg if to_all else os.kill)(process.pid, sent)
    process.wait(timeout=60)
    _wait_for_end_of_group(process.pid, 5.0)
    _, error = process.communicate()
    assert process.returncode == code
    assert says in error
    assert ("--resume" in error) == (sent != signal.SIGKILL)
    assert "Traceback" not in error
    assert sorted(p.name for p in tmp_path.iterdir()) == ["build.toml", "x.h5.parts"]
    assert len(list(parts.glob("*.area"))) < 81


def _wait_for_end_of_group(group: int, seconds: float) -> None:
    deadline = time.monotonic() + seconds
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        assert time.monotonic() < deadline, "processes are left"
        time.sleep(0.05)


def test_a_file_that_cannot_grow_is_one_line(
    tmp_path: Path, config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A limit on file sizes stands for the full disk: both come back from the system when a file is written.

    The limit lets the areas' files pass and meets the catalogue.
    """
    output = tmp_path / "x.h5"
    line = ["build-catalog", DEM, "-o", str(output), "--config", config, "--jobs", "1"]
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    assert signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN  # Python's own choice
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, limits[1]))
    try:
        code = run(line)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert code == 1
    error = capsys.readouterr().err
    assert "cannot be written" in error
    assert "Traceback" not in error
    assert not output.exists()
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]
