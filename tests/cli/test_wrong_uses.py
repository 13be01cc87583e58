"""Wrong uses that a beginner makes: each ends in a line that says what is wrong, where, and what to do, with the
exit code of wrong usage or of a refusal, without a traceback and without an output.
"""

# ruff: noqa: E501  a use and its answer stand in one row

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import navigable
from lcp_cli.main import run

from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.geometry.frames import EnuFrame

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
B = "build-catalog DEM.tif -o a.h5"
AT = "--center 3.5 26 --size 30"
R = "render DEM.tif -o r.tif --center 3.5 26"

WRONG = [
    # words, exit code, what is said
    (f"{B} --center 26 3.5 --size 30", 1, r"the area \(.*\) has no height in the DEM, which covers .*: are longitude and latitude exchanged\?"),
    (f"{B} --center 26 3.5 --size 30 --gsd 474", 1, r"the area \(.*\) has no height in the DEM, which covers .*: are longitude and latitude exchanged\?"),
    (f"{B} --center 26 3.5 --size 30 --levels 237,474", 1, r"the area \(.*\) has no height in the DEM, which covers .*: are longitude and latitude exchanged\?"),
    (f"{B} --center -3.5 26 --size 30 --gsd 474", 1, r"the area \(longitude -?\d.*\) has no height in the DEM, which covers longitude \S+, latitude \S+$"),
    (f"{B} --center 3.5 26 --size 0", 2, r"'--size': 0.0 is not in the range x>0"),
    (f"{B} --center 3.5 26 --size 30000", 1, r"--size of 30000 x 30000 km: it must be above 0 and at most 2000 km"),
    (f"{B} --center 3.5", 2, r"'--center' requires 2 arguments"),
    (f"{B} --size 30", 2, r"--size needs --center"),
    (f"build-catalog DEM.tf -o a.h5 {AT}", 1, r"DEM.tf: there is no such file"),
    (f"build-catalog DEM.tif {AT}", 2, r"-o CATALOG.h5 is missing \(or --plan\)"),
    (f"build-catalog DEM.tif -o a.hdf {AT} --plan", 2, r"-o a.hdf: the output must end in .h5"),
    (f"build-catalog DEM.tif -o nowhere/a.h5 {AT}", 1, r"nowhere/a.h5: the folder .*nowhere does not exist; make it first"),
    ("build-catalog hadley.toml -o a.h5", 1, r"hadley.toml: is a configuration \(TOML\), which is given with --config, not a DEM"),
    (f"build-catalog a.h5 DEM.tif {AT}", 2, r"-o CATALOG.h5 is missing"),
    (f"build-catalog hadley.h5 DEM.tif -o a.h5 {AT}", 1, r"hadley.h5: is an HDF5 file, such as a catalogue, not a DEM"),
    (f"{B} {AT} --gsd 0.5", 1, r"--gsd of 0.5 m: the pixels of the DEM are 237 times as large \(118.5 m\).*leave it out, or give a finer DEM"),
    (f"{B} --bounds 24 2 28 4", 1, r"has no height in the DEM, which covers .*: are longitude and latitude exchanged\?"),
    (f"{B} --bounds 4 28 2 24", 2, r"--bounds W S E N: the south must be below the north"),
    (f"{B} {AT} --sun-elevation 10", 2, r"'--sun-elevation'.*'--sun-elevations'"),
    (f"{B} {AT} --sun-elevations -10", 2, r"--sun-elevations must lie in 0..90 degrees, not -10"),
    (f"{B} {AT} --view 30", 2, r"'--view': '30' is not OFF_NADIR:AZIMUTH"),
    (f"{B} {AT} --view 95:0", 2, r"--view must be at least 0 and below 90 degrees, not 95"),
    (f"{B} {AT} --spacing 5000", 2, r"^lcp: --spacing: 5000 km is more than the longer side of the area, 30 km; give a smaller spacing \(in km as an option"),
    (f"{B} --config t4.toml", 2, r"--spacing: 5000 km is more than the longer side of the area, 30 km; .*in metres in a BUILD.toml"),
    (f"{B} {AT} --footprint 3000", 2, r"the ground that a frame sees, 3000 km wide \(--footprint\), is too large for this region: .*; give a smaller --footprint, or a larger region"),
    (f"{B} {AT} --field-of-view 60 --altitude 3000", 2, r"the ground that a frame sees, 3\d\d\d[.\d]* km wide \(--footprint\), is too large for this region: .*; give a smaller --footprint, or a larger region"),
    (f"{B} {AT} --albedo PHOTO.png", 1, r"PHOTO.png: has no map projection; a map of the Moon is needed"),
    (f"{B} {AT} --reflectance hapk", 2, r"'hapk' is not a reflectance model; valid names: .*hapke"),
    (f"{B} {AT} --levels 59,470", 2, r"--levels: 59 and 470 m are more than a factor of 2 apart; add 117.8, 235.3 m"),
    (f"{B} {AT} --altitudes 5-100", 2, r"--altitudes and --ifov go together"),
    (f"{B} {AT} --altitudes 100-5 --ifov 1.1", 2, r"'100-5' is not KM-KM, lowest and highest, for example 5-100"),
    (f"{B} --config t1.toml", 2, r"t1.toml: \[area\] has no key size \(size_km is meant\?\); there are center_deg, size_km"),
    (f"{B} --config t2.toml", 2, r"t2.toml: not TOML: Expected newline .* \(at line 2, column 17\)"),
    (f"{B} --config t3.toml", 2, r"t3.toml: area.size_km must be a number, not '30'"),
    (f"{B} --config t5.toml", 2, r"t5.toml: view.off_nadir_deg, azimuth_deg and altitude_km must be of one length, a value of each for a view, not of 2, \d and \d values"),
    (f"{B} --config t6.toml", 1, r"missing.tif: there is no such file"),
    (f"{B} --config hadley.tml", 1, r"hadley.tml: there is no such file"),
    (f"{R.replace('r.tif', 'r.png')} --size 10 --sun-azimuth 90 --sun-elevation 10", 2, r"-o r.png: the output must end in .tif"),
    (f"{R} --size 10 --sun-azimuth 90 --sun-elevation 100", 2, r"'--sun-elevation': 100.0 is not in the range -90<=x<=90"),
    (f"{R} --size 10 --sun-elevation 10", 2, r"--sun-azimuth and --sun-elevation go together"),
    (f"{R} --size 1 --sun-azimuth 90 --sun-elevation -3", 1, r"the Sun is 0.87 deg below the horizon of the area's highest terrain, so nothing is lit; state another Sun"),
    (f"{R} --size 1 --sun-azimuth 90 --sun-elevation -3 --overwrite", 1, r"the Sun is 0.87 deg below the horizon .*; state another Sun"),
    ("render DEM.tif -o r.tif --camera PHOTO.png --frame camera", 1, r"PHOTO.png: is a PNG image, not a camera file \(CAMERA.json, USGS ISD or .tsai\)"),
    ("sun --center 26 93 --time 1971-07-31T01:25:52", 2, r"'--center': 93.0 is not in the range -90<=x<=90"),
    ("sun --center 3 26 --time 3026-07-31", 2, r"'--time': the year 3026 is outside 1900-2099"),
    ("sun --center 3 26 --range 2026-01-01 2025-01-01 6h", 2, r"the range stops at 2025-01-01, before it starts at 2026-01-01"),
    ("dem check missing.LBL", 1, r"missing.LBL: there is no such file"),
    ("dem check cut.tif", 4, r"cut.tif: cannot be read; the file is damaged or truncated"),
    ("dem info DEM.tif --at 26 3.5", 0, r"lcp: --at 26 3.5: outside the file: are longitude and latitude exchanged\?; give a place within its bounds\n$"),
    ("query hadley.h5 --camera nofile.json", 1, r"nofile.json: there is no such file"),
    ("query CAMERA.json --camera hadley.h5", 1, r"hadley.h5: is an HDF5 file, such as a catalogue, not a camera file"),
    ("query CAMERA.json --camera CAMERA.json", 1, r"CAMERA.json: is a JSON file, such as a camera, not a catalogue"),
    ("query hadley.h5", 2, r"give --camera CAMERA.json or --trajectory FILE"),
    ("query hadley.h5 --camera CAMERA.json --max 0", 2, r"'--max': 0 is not in the range 1<=x"),
    ("query hadley.h5 --camera CAMERA.json --max 3", 0, r"only 3 points asked for: a position needs 4 \(three fit up to four positions.*ask for more"),
    ("query hadley.h5 --camera CAMERA.json -o pts.xlsx", 2, r"-o pts.xlsx: the output must end in .csv or .geojson"),
    ("sun --center 3 26 --time 2026-01-01 -o s.xlsx", 2, r"-o s.xlsx: the output must end in .csv"),
    ("sun --center 3 26 --time 2026-01-01T00:00+25:00", 2, r"invalid time: '2026-01-01T00:00\+25:00' \(like 2024-01-01T00:00:00\)\.$"),
    (f"{B} --config DEM.tif", 2, r"DEM.tif: is a TIFF image, such as a DEM, not TOML"),
    (f"{B} {AT} --select", 2, r"a choice between two passes needs --passes 2"),
    ("inspect DEM.tif", 4, r"is a TIFF image, such as a DEM, not a catalogue\n  of a DEM: lcp dem info DEM.tif\n$"),
    ("export hadley.h5 -o x.kml", 2, r"-o x.kml: the output must end in .csv or .parquet"),
    ("export hadley.h5 -o x.shp", 2, r"-o x.shp: the output must end in .csv or .parquet"),
    ("windows hadley.h5 --center 26 3.5 --range 2026-01-01 2026-02-01 1d", 1, r"no point of the catalogue lies within the 20 km around .*: give a larger --size, or another --center \(the first of 20 lies at"),
    ("windows hadley.h5 --center 3.5 26 --range 2026-01-01 2026-02-01 1", 2, r"invalid step: '1' \(like 30m, 6h, 1d or PT6H\)"),
    ("validate hadley.h5 PHOTO.png ./PHOTO.png --camera CAMERA.json -o e0", 2, r"PHOTO.png: stands twice among the images and would count twice; name each image once"),
    ("validate hadley.h5 PHOTO.png -o e1", 1, r"PHOTO.png: missing geometry: the image is not map-projected; give its --camera"),
    ("validate PHOTO.png hadley.h5 --camera CAMERA.json -o e3", 1, r"PHOTO.png: is a PNG image, not a catalogue"),
    ("validate hadley.h5 hadley.h5 --camera CAMERA.json -o e3", 1, r"hadley.h5: is an HDF5 file, such as a catalogue, not an image"),
    ("validate hadley.h5 PHOTO.png --camera CAMERA.json -o e4 --require points>=3", 2, r"--require: unknown name points \(points_found is meant\?\); known names: verdict"),
    ("report hadley.h5", 2, r"Missing option '-o'"),
    ("merge hadley.h5 -o m.h5", 2, r"name at least two catalogues"),
    ("diff hadley.h5", 2, r"Missing argument 'B.h5'"),
    ("sample full", 1, r"full/PROVENANCE.txt.*exists.*--overwrite"),
    ("build DEM.tif -o a.h5", 2, r"No such command 'build'\. Did you mean 'build-catalog'\?"),
    ("buildcatalog DEM.tif -o a.h5", 2, r"No such command 'buildcatalog'\. Did you mean 'build-catalog'\?"),
]  # fmt: skip
"""The list of the project (58 of its 60 commands; the other two, `RIGHT`, are right uses), and a few of its kind."""

RIGHT = [
    # a day at the site, and a format that there is
    (f"{R} --size 10 --time 1971-07-15T00:00", "r.tif"),
    ("export hadley.h5 -o x.gpkg", "x.gpkg"),
]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wrong")
    names = {"DEM.tif": "hadley_gld100_256ppd.tif", "PHOTO.png": "AS15-M-0414.png", "hadley.toml": "hadley.toml"}  # fmt: skip
    for name, source in names.items() | {("CAMERA.json", "AS15-M-0414_camera.json")}:
        shutil.copy(SAMPLE / source, folder / name)
    write_catalog(navigable.everywhere_usable(20), folder / "hadley.h5")
    (folder / "cut.tif").write_bytes((folder / "DEM.tif").read_bytes()[:200_000])
    area = "[area]\ncenter_deg = [3.5, 26]\n"
    (folder / "t1.toml").write_text(f"{area}size = 30\n")
    (folder / "t2.toml").write_text("[area]\ncenter_deg = 3.5, 26\n")
    (folder / "t3.toml").write_text(f'{area}size_km = "30"\n')
    (folder / "t4.toml").write_text(f"{area}size_km = 30\n[points]\nspacing_m = 5e6\n")
    (folder / "t5.toml").write_text(f"{area}size_km = 30\n[view]\noff_nadir_deg=[0,30]\n")
    (folder / "t6.toml").write_text(f'{area}size_km = 30\n[model]\nalbedo="missing.tif"\n')
    run(["sample", str(folder / "full")])
    return folder


def said(words: list[str], code: int, capsys: pytest.CaptureFixture[str]) -> str:
    """What a command prints that ends with an exit code and leaves no output."""
    capsys.readouterr()
    before = sorted(Path().iterdir())
    found = run(words)
    text = "".join(capsys.readouterr())
    assert found == code, text
    assert "Traceback" not in text
    assert sorted(Path().iterdir()) == before
    return text


@pytest.mark.slow
@pytest.mark.parametrize(("line", "code", "says"), WRONG, ids=[line for line, _, _ in WRONG])
def test_a_wrong_use_is_explained(
    line: str,
    code: int,
    says: str,
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(files)
    assert re.search(says, said(line.split(), code, capsys))


@pytest.mark.slow
@pytest.mark.parametrize(("line", "output"), RIGHT)
def test_a_right_use_of_the_list_does_what_it_says(
    line: str, output: str, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    assert run(line.split()) == 0
    assert Path(output).stat().st_size > 1000
    Path(output).unlink()


def test_the_list_is_held() -> None:
    """60 commands of the project's list, six of ours; fifteen kinds of wrong cameras in 30 changes, each by two commands."""
    assert len({line for line, _, _ in WRONG}) >= 66
    assert len(CAMERAS) >= 30


# -- cameras: the sample's, changed


def _moved(document: dict[str, Any], lon: float, lat: float, height_m: float) -> list[float]:
    del document
    return EnuFrame(lon, lat).to_mcmf([0.0, 0.0, height_m]).tolist()


def _rotation(by: list[list[float]], transposed: bool = False) -> Callable[[dict[str, Any]], Any]:
    def changed(document: dict[str, Any]) -> dict[str, Any]:
        rotation = np.array(by) @ np.array(document["rotation_mcmf_to_camera"])
        return {"rotation_mcmf_to_camera": (rotation.T if transposed else rotation).tolist()}

    return changed


def _field(key: str, value: Any) -> Callable[[dict[str, Any]], Any]:
    return lambda document: {key: value(document) if callable(value) else value}


GL = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
SUN, AT_MCMF = "sun_position_mcmf_m", "position_mcmf_m"
CAMERAS: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "a misspelt optional key": (_field("distorsion", [0.1, 0, 0, 0, 0]), r"no key distorsion \(distortion is meant\?\)"),
    "a misspelt key": (lambda d: {"focal_lenght_px": d.pop("focal_length_px")}, r"no key focal_lenght_px \(focal_length_px is meant\?\)"),
    "OpenGL": (_rotation(GL), r"axes of OpenGL or Blender .*: multiply it from the left by \[\[1, 0, 0\], \[0, -1, 0\], \[0, 0, -1\]\] \(then it looks at longitude 3.41"),
    "OpenGL, camera to world": (_rotation(GL, True), r"OpenGL or Blender .*: multiply its transpose from the left"),
    "transposed": (_rotation(np.eye(3).tolist(), True), r"seems to take camera axes to MCMF: give its transpose \(then it looks at longitude 3.41"),
    "a body": (_rotation([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), r"axes of a body \(ahead, left, up\): multiply"),
    "millimetres": (_field("focal_length_px", 76.2), r"focal_length_px 76.2 makes a field of view of 139 deg .*millimetres"),
    "offset of the centre": (_field("principal_point_px", [0, 0]), r"principal_point_px \[0, 0\] is 285 pixels from the image's centre .* offset from the centre"),
    "kilometres": (_field(AT_MCMF, lambda d: [x / 1e3 for x in d[AT_MCMF]]), r"deep inside the Moon \(are these kilometres, 102 km above the Moon\? give metres\)"),
    "exchanged": (_field(AT_MCMF, lambda d: _moved(d, 25.916, 3.394, 101.9e3)), r"lies above longitude 25.92, latitude 3.39: exchange the two"),
    "another site": (_field(AT_MCMF, lambda d: _moved(d, 49.2, 8.7, 101.9e3)), r"centre shows longitude \d+.\d+, latitude \d+.\d+, 1\d\d\d km from the nearest point"),
    "underground": (_field(AT_MCMF, lambda d: _moved(d, 3.4, 26.0, -300e3)), r"300.0 km below the reference sphere"),
    "degrees": (lambda d: {"rotation_mcmf_to_camera": np.degrees(d["rotation_mcmf_to_camera"]).tolist()}, r"not orthonormal: they have lengths 57.29"),
    "not orthonormal": (_rotation([[1, 0.01, 0], [0, 1, 0], [0, 0, 1]]), r"not orthonormal: they have lengths 1.00005, 1, 1"),
    "left-handed": (_rotation([[1, 0, 0], [0, 1, 0], [0, 0, -1]]), r"left-handed \(its determinant is -1\)"),
    "height and width": (lambda d: {"image_size_px": [404, 1024], "principal_point_px": [511.0, 201.0]}, r"are width and height exchanged in image_size_px\?"),
    "a larger image": (_field("image_size_px", [800, 800]), r"281 pixels from the image's centre .* or image_size_px that of another image"),
    "true": (_field("focal_length_px", True), r"focal_length_px does not consist of numbers, but is true"),
    "text": (_field("focal_length_px", "1024"), r'focal_length_px does not consist of numbers, but is "1024"'),
    "null": (_field("focal_length_px", None), r"focal_length_px must hold one finite number, not null"),
    "negative": (_field("focal_length_px", -5), r"focal_length_px must be positive, not -5"),
    "NaN": (_field("focal_length_px", math.nan), r"focal_length_px must hold one finite number, not NaN"),
    "a Sun in kilometres": (_field(SUN, lambda d: [x / 1e3 for x in d[SUN]]), r"too near for the Sun.*kilometres; give metres"),
    "a Sun at the camera": (_field(SUN, lambda d: d[AT_MCMF]), r"too near for the Sun.*the camera's own place"),
    "a Sun below": (_field(SUN, lambda d: [-x for x in d[SUN]]), r"13.\d deg below the horizon"),
    "no Sun": (lambda d: d.pop(SUN) and d.pop("time_utc", None) and {}, r"no Sun: give --time, or --sun-azimuth and --sun-elevation, or --subsolar|Sun +none"),
    "a day": (_field("time_utc", "31/07/1971"), r"json: time_utc: invalid time: '31/07/1971' \(like 2024-01-01T00:00:00\)"),
    "a word": (_field("time_utc", "yesterday"), r"json: time_utc: invalid time: 'yesterday'"),
    "another time": (_field("time_utc", "1971-08-07T01:25:52"), r"sun_position_mcmf_m is 8\d.\d deg from the Sun at time_utc"),
    "a year": (_field("time_utc", "3026-01-01T00:00"), r"json: time_utc: the year 3026 is outside 1900-2099"),
}  # fmt: skip
"""What is changed, and what must be said."""


@pytest.mark.slow
@pytest.mark.parametrize("command", ["query hadley.h5 --camera", "camera info --catalog hadley.h5"])
@pytest.mark.parametrize("kind", CAMERAS)
def test_a_wrong_camera_is_not_taken_silently(
    kind: str,
    command: str,
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.chdir(files)
    change, says = CAMERAS[kind]
    document = json.loads(Path("CAMERA.json").read_text())
    changed = change(document) or {}
    Path("wrong.json").write_text(json.dumps(document | changed))
    code = run([*command.split(), "wrong.json"])
    text = "".join([*capsys.readouterr(), *(one.getMessage() for one in caplog.records)])
    assert code in (0, 1, 4)
    assert re.search(says, text), text


@pytest.mark.parametrize("command", ["query hadley.h5 --camera", "camera info --catalog hadley.h5"])
def test_a_turn_that_does_not_see_the_catalogue_is_not_named(
    command: str,
    files: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A camera far from the catalogue that looks at the sky: its transpose, or OpenGL's axes, would look at the ground there,
    which is not the catalogue's.
    """
    monkeypatch.chdir(files)
    there = EnuFrame(-60.0, 10.0)
    up = np.array(GL) @ np.diag([1.0, -1.0, -1.0]) @ there.rotation
    document = json.loads(Path("CAMERA.json").read_text())
    document |= {
        AT_MCMF: there.to_mcmf([0.0, 0.0, 1e5]).tolist(),
        "rotation_mcmf_to_camera": up.tolist(),
    }
    Path("wrong.json").write_text(json.dumps(document))
    code = run([*command.split(), "wrong.json"])
    text = "".join([*capsys.readouterr(), *(one.getMessage() for one in caplog.records)])
    assert code in (1, 4)
    assert "OpenGL" not in text
    assert "transpose" not in text
    assert re.search(
        r"the camera does not see the Moon|the image's centre shows no ground; the points lie at longitude",
        text,
    )


def test_a_stated_sun_that_is_not_the_cameras_is_said(
    files: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.chdir(files)
    for words in (
        "query hadley.h5 --camera CAMERA.json",
        "render DEM.tif --camera CAMERA.json --explain --size 2",
    ):
        for sun, said_ in (
            ("--time 1971-08-07T01:25:52", True),
            ("--sun-azimuth 96.5 --sun-elevation 13.7", False),
        ):
            caplog.clear()
            assert run([*words.split(), *sun.split()]) == 0
            found = [
                one.getMessage()
                for one in caplog.records
                if "the stated Sun is" in one.getMessage()
            ]
            assert bool(found) == said_
            assert all("CAMERA.json: the stated Sun is 8" in one for one in found)


def test_the_camera_of_another_image_is_refused(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(files)
    document = json.loads(Path("CAMERA.json").read_text())
    Path("wrong.json").write_text(json.dumps(document | {"image_size_px": [404, 400]}))
    text = said(
        ["validate", "hadley.h5", "PHOTO.png", "--camera", "wrong.json", "-o", "v"], 1, capsys
    )
    assert "camera of an image of 404 x 400 pixels, not of 404 x 404: give the camera of" in text
