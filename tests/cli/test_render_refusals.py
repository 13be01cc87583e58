"""``lcp render`` that cannot: what it says in a line, and that it leaves nothing behind."""

import os
from pathlib import Path

import pytest
from helpers.renders import AREA, SUN, camera_file, read, rolling, write_dem
from lcp_cli.main import run

from lcp_catalog import atomic_files
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.rendering import pipeline, public


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    """One degree square at 30..31 E, 10..11 N, rolling hills."""
    return write_dem(tmp_path_factory.mktemp("dem") / "hills.tif", rolling(256, 256), 30.0, 11.0)


@pytest.fixture
def out(tmp_path):
    return tmp_path / "OUT.tif"


def test_an_output_is_replaced_only_when_told(dem, out, capsys):
    out.write_text("mine")
    arguments = ["render", dem, "-o", str(out), *AREA, *SUN]
    assert run(arguments) == 1
    assert "OUT.tif exists; use --overwrite" in capsys.readouterr().err
    assert out.read_text() == "mine"
    assert run([*arguments, "--overwrite"]) == 0
    assert read(out)[1]["count"] == 7


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (AREA, 2, "--sun-azimuth and --sun-elevation, or --time, or --subsolar"),
        ([*AREA, "--sun-azimuth", "10"], 2, "go together"),
        ([*AREA, *SUN, "--time", "2024-01-01"], 2, "state the Sun once"),
        ([*AREA, *SUN, "--sun", "square"], 2, "--sun"),
        ([*AREA, *SUN, "--accuracy", "sloppy"], 2, "--accuracy"),
        ([*AREA, *SUN, "--off-nadir", "20"], 2, "--view-azimuth"),
        ([*AREA, *SUN, "--view-azimuth", "20"], 2, "--off-nadir and --view-azimuth go together"),
        (
            [*AREA, *SUN, "--camera", __file__, "--altitude", "9"],
            2,
            "--camera excludes --off-nadir, --view-azimuth and --altitude",
        ),
        ([*AREA, *SUN, "--frame", "camera"], 2, "--frame camera needs"),
        (["--center", "30.5", "10.5", *SUN], 2, "--center needs --size"),
        ([*AREA, "--bounds", "30", "10", "31", "11", *SUN], 2, "exclude each other"),
        (["--bounds", "30", "11", "31", "10", *SUN], 2, "south must be below"),
        ([*AREA, *SUN, "--gsd", "0"], 2, "--gsd"),
        ([*AREA, *SUN, "--gsd", "nan"], 2, "--gsd"),
        (["--center", "50", "10", "--size", "5", *SUN], 1, "no height in the DEM"),
        ([*AREA, "--sun-azimuth", "10", "--sun-elevation", "-20"], 1, "below the horizon"),
        ([*AREA, "--time", "soon"], 2, "--time"),
        (["--center", "nan", "10.5", "--size", "8", *SUN], 2, "--center"),
        ([*AREA, *SUN, "--camera", "none.json"], 1, "none.json"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_line(dem, out, capsys, arguments, code, says):
    assert run(["render", dem, "-o", str(out), *arguments]) == code
    error = capsys.readouterr().err
    assert says in error
    if code == 1:
        assert error.startswith("lcp: ")
        assert error.count("\n") == 1
    assert os.listdir(out.parent) == []


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (
            {"position_mcmf_m": EnuFrame(30.5, 10.5).to_mcmf([0, 0, -5000]).tolist()},
            "below the surface",
        ),
        ({"rotation_mcmf_to_camera": EnuFrame(30.5, 10.5).rotation.tolist()}, "see"),
        ({"focal_length_px": -1}, "focal_length_px must be positive"),
    ],
)
def test_cameras_that_cannot(dem, tmp_path, capsys, changes, says):
    camera = camera_file(tmp_path / "CAMERA.json", **changes)
    target = str(tmp_path / "OUT.tif")
    assert run(["render", dem, "-o", target, *AREA, "--camera", camera]) == 1
    error = capsys.readouterr().err
    assert "CAMERA.json" in error
    assert says in error
    assert os.listdir(tmp_path) == ["CAMERA.json"]


def test_a_camera_without_a_sun_is_a_usage_error(dem, tmp_path, out, capsys):
    camera = camera_file(tmp_path / "CAMERA.json", sun_position_mcmf_m=None)
    assert run(["render", dem, "-o", str(out), "--camera", camera]) == 2
    assert "--sun-azimuth" in capsys.readouterr().err
    camera = camera_file(tmp_path / "CAMERA.json", sun_position_mcmf_m=None, time_utc="2024-01-20")
    assert run(["render", dem, "-o", str(out), "--camera", camera]) == 0


@pytest.mark.parametrize(
    ("owner", "broken"), [(public, "encode"), (pipeline.HeightfieldScene, "expose")]
)
def test_an_interrupt_leaves_nothing(dem, tmp_path, monkeypatch, capsys, owner, broken):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(owner, broken, interrupt)
    target = str(tmp_path / "OUT.tif")
    assert run(["render", dem, "-o", target, *AREA, *SUN]) == 130
    assert os.listdir(tmp_path) == []
    assert "interrupted" in capsys.readouterr().err


def test_a_full_disk_leaves_nothing(dem, tmp_path, monkeypatch, capsys):
    def full(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic_files, "_sync", full)
    target, preview = tmp_path / "OUT.tif", tmp_path / "OUT.png"
    arguments = ["render", dem, "-o", str(target), *AREA, *SUN, "--preview", str(preview)]
    assert run(arguments) == 1
    assert "the disk is full" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_a_damaged_dem_is_named(tmp_path, out, capsys):
    bad = tmp_path / "bad.tif"
    bad.write_bytes(b"II*\0" + bytes(50))
    assert run(["render", str(bad), "-o", str(out), *AREA, *SUN]) == 1
    assert "bad.tif" in capsys.readouterr().err
    assert not Path(out).exists()
