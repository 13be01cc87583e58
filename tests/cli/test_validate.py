"""``lcp validate`` as a user runs it: on a simulated frame of the sample's terrain, and with
invalid input.
"""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from helpers.twins_match import catalog_of_dem, looking_at
from lcp_cli.main import run

from lcp_catalog.catalog.hdf5 import write_catalog
from lcp_catalog.geometry.frames import EnuFrame, lonlat_to_mcmf
from lcp_catalog.validation.run import ImageFiles, told_apart

DEM = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
CENTRE = (3.6, 26.1)
SUN_M = 1.5e11
CONTRACT = {
    "image": str, "points_in_view": int, "points_found": int, "offset_px": dict, "offset_m": dict,
    "correlation": dict, "windows": dict, "pose": dict,
}  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a catalogue of 49 places of the sample's DEM, a frame of them, and a camera
    file with an error of 700 m.
    """
    folder = tmp_path_factory.mktemp("validate")
    along = np.linspace(-0.32, 0.32, 7)
    lon, lat = (grid.ravel() for grid in np.meshgrid(CENTRE[0] + 1.1 * along, CENTRE[1] + along))
    write_catalog(catalog_of_dem(lon, lat, 33, 118.45, DEM), folder / "points.h5")
    camera = looking_at(EnuFrame(*CENTRE, -1500.0), 60e3, 12.0, 250.0, 35.0, 300.0, (220, 200))
    sun = SUN_M * lonlat_to_mcmf(CENTRE[0] + 65.0, 1.0) / 1737400.0
    (folder / "true.json").write_text(
        json.dumps(camera.to_json() | {"sun_position_mcmf_m": sun.tolist()})
    )
    simulated = [
        "simulate",
        str(DEM),
        "--camera",
        str(folder / "true.json"),
        "-o",
        str(folder / "frame.png"),
    ]
    assert run([*simulated, "--sun", "point", "--noise", "0.02", "--seed", "3"]) == 0
    document = json.loads((folder / "true.json").read_text())
    document["position_mcmf_m"] = np.add(camera.position_mcmf_m, [400.0, -500.0, 300.0]).tolist()
    (folder / "believed.json").write_text(json.dumps(document))
    return folder


def validated(
    folder: Path, *more: str, image: str = "frame.png", camera: str = "believed.json", out: str
) -> int:
    files = [str(folder / "points.h5"), str(folder / image), "-o", str(folder / out)]
    return run(
        ["validate", *files, "--camera", str(folder / camera), "--attitude-sigma", "0", *more]
    )


@pytest.fixture(scope="module")
def report(place):
    assert (
        validated(place, "--dem", str(DEM), "--depfile", str(place / "report.d"), out="whole") == 0
    )
    return json.loads((place / "whole" / "report.json").read_text())["images"][0]


def test_the_report_holds_what_the_contract_names(report) -> None:
    for name, kind in CONTRACT.items():
        assert isinstance(report[name], kind), name
    assert {"median", "p95"} <= report["offset_px"].keys() & report["offset_m"].keys()
    assert {"median", "p05"} <= report["correlation"].keys()
    wanted = {"size", "count", "share_above_0_9", "share_above_0_7", "median", "mode"}
    assert wanted <= report["windows"].keys()
    assert {"position_error_m", "position_sigma_m"} <= report["pose"].keys()


def test_the_camera_comes_back(place, report) -> None:
    assert report["verdict"] == "located"
    assert report["points_found"] >= 20
    true = json.loads((place / "true.json").read_text())["position_mcmf_m"]
    error = np.linalg.norm(np.subtract(report["pose"]["position_mcmf_m"], true))
    assert error < 4.0 * report["pose"]["position_sigma_m"]
    assert error < 100.0  # half a pixel's 200 m of ground; it was 707 m wrong
    assert (
        report["pose"]["position_error_m"] is None
    )  # nobody said that the camera file is the truth
    assert report["windows"]["share_above_0_9"] > 0.9  # image and render are of the same DEM


def test_tables_and_page_tell_of_the_same_points(place, report) -> None:
    with open(place / "whole" / "points.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == report["points_in_view"]
    assert sum(row["reason"] == "found" for row in rows) == report["points_found"]
    page = (place / "whole" / "report.html").read_text()
    assert "frame.png" in page
    assert "with --known-pose" in page  # where a reader would look for the position's error
    assert "http://" not in page.replace("http://www.w3.org", "")
    with open(place / "whole" / "windows.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == report["windows"]["count"]


def test_the_depfile_names_what_was_read(place, report) -> None:
    rule = (place / "report.d").read_text()
    assert rule.startswith(f"{place / 'whole' / 'report.json'}:")
    for name in ("points.h5", "frame.png", "believed.json", DEM.name):
        assert name in rule


def test_without_a_dem_the_patches_are_compared(place, capsys) -> None:
    require = "share_above_0_7>=0.99 and points_found>=1000"
    assert validated(place, "--json", "--require", require, out="patches") == 4
    printed = capsys.readouterr()
    document = json.loads(printed.out)  # nothing else on stdout
    assert "points_found is" in printed.err
    assert "required: points_found>=1000" in printed.err
    windows = document["images"][0]["windows"]
    assert windows["count"] >= 4 * 20  # four of 16 x 16 in a patch of 33 x 33
    assert windows["gsd_m"] == pytest.approx(118.45)
    assert "patches" in windows["against"]


def test_the_wrong_place_is_refused(place, capsys) -> None:
    """The same frame, stated to be half a degree further west, where there are also points."""
    document = json.loads((place / "true.json").read_text())
    camera = looking_at(
        EnuFrame(CENTRE[0] - 0.25, CENTRE[1] + 0.2, -1500.0),
        60e3,
        12.0,
        250.0,
        35.0,
        300.0,
        (220, 200),
    )
    document |= camera.to_json() | {"sun_position_mcmf_m": document["sun_position_mcmf_m"]}
    (place / "elsewhere.json").write_text(json.dumps(document))
    assert (
        validated(place, "--position-sigma", "0.3", camera="elsewhere.json", out="elsewhere") == 4
    )
    image = json.loads((place / "elsewhere" / "report.json").read_text())["images"][0]
    assert image["verdict"] in ("not this place", "cannot say")
    assert image["pose"] is None
    assert image["verdict"] in capsys.readouterr().out


def test_what_is_there_is_not_replaced(place, report, capsys) -> None:
    before = (place / "whole" / "report.json").read_bytes()
    assert validated(place, out="whole") == 1
    assert "--overwrite" in capsys.readouterr().err
    assert (place / "whole" / "report.json").read_bytes() == before


@pytest.mark.parametrize(
    ("flags", "code", "says"),
    [
        (["--camera", "a.json", "--camera", "b.json"], 2, "2 --camera for 1 images"),
        (["--require", "share_above=0.9"], 2, "--require"),
        (["--require", "beauty>1"], 2, "beauty"),
        (["--require", ""], 2, "'' is not a condition"),
        (["--require", "position_error_m<100"], 2, "known only with --known-pose"),
        (["--dem", "none.tif"], 1, "none.tif: there is no such file"),
        (["--dem", __file__], 1, "not a DEM that can be read here"),
        (["--depfile", "nowhere/report.d"], 1, "nowhere does not exist"),
        (["--camera", "none.json"], 1, "none.json: there is no such file"),
        (["--window", "2"], 2, "--window"),
        (["--sun-azimuth", "90"], 2, "go together"),
    ],
)
def test_wrong_flags_say_which(place, tmp_path, capsys, monkeypatch, flags, code, says) -> None:
    """Before an image is opened."""
    monkeypatch.setattr("lcp_catalog.validation.run._opened", None)
    out = tmp_path / "out"
    assert (
        run(
            ["validate", str(place / "points.h5"), str(place / "frame.png"), "-o", str(out), *flags]
        )
        == code
    )
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error
    assert not out.exists()


def test_the_rule_for_make_is_none_of_the_reports_files(place, tmp_path, capsys) -> None:
    """The make rule may be in the report's folder, which need not exist yet."""
    files = [str(place / "points.h5"), str(place / "frame.png"), "-o", str(tmp_path / "out")]
    own = str(tmp_path / "out" / "report.json")
    assert run(["validate", *files, "--depfile", own]) == 1
    assert "is a file of the report" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    rule = tmp_path / "out" / "rule.d"
    assert run(["validate", *files, "--depfile", str(rule)]) == 4  # no camera: missing geometry
    assert rule.read_text().startswith(str(tmp_path / "out" / "report.json"))


@pytest.mark.parametrize(
    ("given", "called"),
    [
        (["a/frame.png", "a/other.png"], ["frame.png", "other.png"]),
        (["a/frame.png", "b/frame.png", "b/c.png"], ["a/frame.png", "b/frame.png", "c.png"]),
        (["frame.png", "b/frame.png"], ["frame.png", "b/frame.png"]),
        (["x/a/f.png", "y/a/f.png", "z/f.png"], ["x/a/f.png", "y/a/f.png", "z/f.png"]),
        (["frame.png", "frame.png", "frame.png"], ["frame.png", "frame.png (2)", "frame.png (3)"]),
    ],
)
def test_images_of_one_name_are_told_apart(given, called) -> None:
    """With as few folders as needed; the same image may be given twice, with two cameras."""
    assert told_apart([ImageFiles(Path(name)) for name in given]) == called


def test_what_cannot_be_tried_says_what_is_missing(place, tmp_path, capsys) -> None:
    """Invalid images are results in the report beside a valid one: without geometry, of another
    size than the camera, empty.
    """
    other = json.loads((place / "true.json").read_text()) | {"image_size_px": [640, 480]}
    (tmp_path / "other.json").write_text(json.dumps(other))
    said = []
    for name, flags in (
        ("none", []),
        ("size", ["--camera", str(tmp_path / "other.json")]),
        ("broken", ["--camera", str(DEM)]),
    ):
        files = [str(place / "points.h5"), str(place / "frame.png"), "-o", str(tmp_path / name)]
        assert run(["validate", *files, *flags]) == 4
        text = (tmp_path / name / "report.json").read_text()
        image = json.loads(text)["images"][0]
        assert image["verdict"] == "cannot say"
        assert image["pose"] is None
        assert image["points_found"] == 0
        assert str(tmp_path) not in text  # no folder in a result
        assert str(place) not in text
        said.append(image["reason"])
    assert "missing geometry" in said[0]
    assert "640 x 480" in said[1]
    assert "not JSON" in said[2]
    assert "Traceback" not in capsys.readouterr().err
