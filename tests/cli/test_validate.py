"""``lcp validate`` as a user runs it: on a simulated frame of the sample's terrain, and with
invalid input.
"""

import csv
import json
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
from helpers.claiming import claiming
from helpers.environment_maps import Lamp, room
from helpers.twins_match import catalog_of_dem, looking_at
from lcp_cli.main import run
from lcp_cli.value_types import Distance

from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.verification import open_catalog
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import ConfigError
from lcp_catalog.geometry.frames import EnuFrame, lonlat_to_mcmf
from lcp_catalog.images.image_file import open_image
from lcp_catalog.landmarks.error_model import ErrorModel
from lcp_catalog.matching.matches import SEARCHED
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.production.config import BuildConfig
from lcp_catalog.validation.error_fit import fit_errors, residuals_of
from lcp_catalog.validation.public import image_files
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
    """A folder with a catalogue of 25 places of the sample's DEM, a frame of them, and a camera
    file with an error of 700 m.
    """
    folder = tmp_path_factory.mktemp("validate")
    along = np.linspace(-0.26, 0.26, 5)
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
    assert "stated to be known" in page  # where a reader would look for the position's error
    assert "http://" not in page.replace("http://www.w3.org", "")
    with open(place / "whole" / "windows.csv", newline="") as file:
        assert len(list(csv.DictReader(file))) == report["windows"]["count"]


def test_the_depfile_names_what_was_read(place, report) -> None:
    rule = (place / "report.d").read_text()
    assert rule.startswith(f"{place / 'whole' / 'report.json'}:")
    for name in ("points.h5", "frame.png", "believed.json", DEM.name):
        assert name in rule


@pytest.mark.slow
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


@pytest.mark.slow
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
        (["--camera", __file__, "--camera", __file__], 2, "2 --camera for 1 images"),
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


@pytest.mark.slow
def test_the_rule_for_make_is_none_of_the_reports_files(place, tmp_path, capsys) -> None:
    """The make rule may be in the report's folder, which need not exist yet."""
    files = [str(place / "points.h5"), str(place / "frame.png"), "-o", str(tmp_path / "out")]
    own = str(tmp_path / "out" / "report.json")
    assert run(["validate", *files, "--depfile", own]) == 2
    assert "is the same file as" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    rule = tmp_path / "out" / "rule.d"
    camera = ["--camera", str(place / "true.json"), "--position-sigma", "0.1"]
    assert run(["validate", *files, *camera, "--depfile", str(rule)]) == 0
    assert rule.read_text().startswith(str(tmp_path / "out" / "report.json"))


@pytest.mark.parametrize(
    ("given", "called"),
    [
        (["a/frame.png", "a/other.png"], ["frame.png", "other.png"]),
        (["a/frame.png", "b/frame.png", "b/c.png"], ["a/frame.png", "b/frame.png", "c.png"]),
        (["frame.png", "b/frame.png"], ["frame.png", "b/frame.png"]),
        (["x/a/f.png", "y/a/f.png", "z/f.png"], ["x/a/f.png", "y/a/f.png", "z/f.png"]),
        (["frame.png", "frame.png", "frame.png"], ["frame.png", "frame.png (2)", "frame.png (3)"]),
        (["/a/b/f.png", "/a/b/f.png", "/a/c/f.png"], ["b/f.png", "b/f.png (2)", "c/f.png"]),
    ],
)
def test_images_of_one_name_are_told_apart(given, called) -> None:
    """With as few folders as needed; the same image may be given twice, with two cameras."""
    assert told_apart([ImageFiles(Path(name)) for name in given]) == called


def test_an_image_may_stand_twice_with_two_cameras() -> None:
    """With one it is refused, also by another name of it."""
    assert len(image_files(["f.png", "f.png"], ["a.json", "b.json"])) == 2
    for images, cameras in (
        (["f.png", "./f.png"], ["a.json"]),
        (["f.png", "f.png"], ["a.json", "b/../a.json"]),
        (["e.png", "f.png", "f.png"], None),
    ):
        with pytest.raises(ConfigError, match=r"f\.png: stands twice among the images"):
            image_files(images, cameras)


def test_a_single_image_that_cannot_be_opened_ends_it(place, tmp_path, capsys) -> None:
    """Exit code 1, one line, and no page: without geometry, of another size than the camera, a
    camera file that is none.
    """
    other = json.loads((place / "true.json").read_text()) | {"image_size_px": [640, 480]}
    (tmp_path / "other.json").write_text(json.dumps(other))
    for flags, says in (
        ([], "missing geometry"),
        (["--camera", str(tmp_path / "other.json")], "640 x 480"),
        (["--camera", str(DEM)], "is a TIFF image, such as a DEM, not a camera file"),
    ):
        files = [str(place / "points.h5"), str(place / "frame.png"), "-o", str(tmp_path / "out")]
        assert run(["validate", *files, *flags]) == 1
        error = capsys.readouterr().err.strip().splitlines()
        assert says in error[-1]
        assert "Traceback" not in error
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_beside_an_image_the_broken_ones_are_results(place, tmp_path, capsys) -> None:
    """Their reason is all that the report and the terminal say of them."""
    other = json.loads((place / "true.json").read_text()) | {"image_size_px": [640, 480]}
    (tmp_path / "other.json").write_text(json.dumps(other))
    (tmp_path / "broken.json").write_text("{")
    (tmp_path / "frame.png").write_bytes((place / "frame.png").read_bytes())
    images = [str(folder / "frame.png") for folder in (place, place, tmp_path)]
    cameras = [place / "true.json", tmp_path / "other.json", tmp_path / "broken.json"]
    flags = [word for camera in cameras for word in ("--camera", str(camera))]
    out = tmp_path / "out"
    assert run(["validate", str(place / "points.h5"), *images, *flags, "-o", str(out)]) == 4
    text = (out / "report.json").read_text()
    good, *bad = json.loads(text)["images"]
    assert good["verdict"] == "located"
    names = [f"{place.name}/frame.png", f"{place.name}/frame.png (2)", f"{tmp_path.name}/frame.png"]
    assert [image["image"] for image in (good, *bad)] == names
    for image, says in zip(bad, ("640 x 480", "not JSON"), strict=True):
        assert image["verdict"] == "cannot say"
        assert says in image["reason"]
        assert image["pose"] is None
        assert image["points_found"] == 0
    assert str(tmp_path) not in text  # no folder in a result
    assert str(place) not in text
    assert " 0 x 0 " not in (out / "report.html").read_text()
    assert "0 of 0" not in capsys.readouterr().out


@pytest.fixture(scope="module")
def claims(place):
    """The same catalogue with claims: 1 sigma 40 m north and 20 m east."""
    with_claims = claiming(open_catalog(place / "points.h5"), 40.0, 5000.0)
    write_catalog(with_claims, place / "claiming.h5")
    return place / "claiming.h5"


def scored(place, claims, out, camera, *more):
    """Entry of the report and rows of the points of a validation of the catalogue with claims."""
    files = [str(claims), str(place / "frame.png"), "--camera", str(place / camera), "-o", str(out)]
    assert run(["validate", *files, "--attitude-sigma", "0", *more]) == 0
    with open(out / "points.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    return json.loads((out / "report.json").read_text()), rows


@pytest.mark.slow
def test_claims_are_scored(place, claims, tmp_path, capsys) -> None:
    """By the located camera: figures of the report are those of the table's rows."""
    require = "claims.count>=20 and brier<=1 and found_of_usable>=0.8, normalised_squared_error>0"
    report, rows = scored(place, claims, tmp_path / "out", "believed.json", "--require", require)
    printed = capsys.readouterr().out
    entry = report["images"][0]["claims"]
    assert report["claims"] == entry
    tried = [row for row in rows if row["found"] and row["detection_probability"]]
    usable = [row for row in tried if row["usable"] == "1"]
    assert entry["count"] == len(tried)
    assert entry["usable"] == len(usable)
    for row in usable:
        assert float(row["detection_probability"]) == pytest.approx(0.96)
    square = [(float(row["detection_probability"]) - int(row["found"])) ** 2 for row in tried]
    assert entry["brier"] == pytest.approx(sum(square) / len(square))
    share = sum(int(row["found"]) for row in usable) / len(usable)
    assert entry["found_of_usable"] == pytest.approx(share)
    assert f"{100 * share:.1f} % of {len(usable)} usable points found" in printed
    sure = sum(float(row["detection_probability"]) > 0.9 for row in tried)
    assert [row[2] for row in entry["reliability"] if row[2]] == [len(tried) - sure, sure]
    assert "reliability diagram" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.slow
def test_a_known_camera_is_the_reference_of_errors(place, claims, tmp_path) -> None:
    """With the true camera errors are small; with a camera some 700 m off that is stated to be the
    true one they are as large as its error.
    """
    right, rows = scored(place, claims, tmp_path / "true", "true.json", "--known-pose")
    wrong, far = scored(place, claims, tmp_path / "wrong", "believed.json", "--known-pose")
    plain, near = scored(place, claims, tmp_path / "plain", "believed.json")

    def median_m(table):
        found = [row for row in table if row["found"] == "1"]
        assert len(found) > 20
        return (
            np.median(
                [
                    float(row["error_east_m"]) ** 2 + float(row["error_north_m"]) ** 2
                    for row in found
                ]
            )
            ** 0.5
        )

    assert median_m(rows) < 50.0
    assert median_m(near) < 50.0
    assert 400.0 < median_m(far) < 900.0
    for report in (right, plain):
        assert report["claims"]["normalised_squared_error"] < 5.0
    assert wrong["claims"]["normalised_squared_error"] > 50.0
    assert wrong["claims"]["count"] == plain["claims"]["count"]


@pytest.mark.slow
def test_a_known_camera_is_scored_where_the_image_is_not_located(
    place, claims, tmp_path, caplog
) -> None:
    """A wrong Sun: nothing is found that agrees, and with a known camera that counts against the
    claims, and for the fit of errors.
    """
    files = [str(claims), str(place / "frame.png"), "--camera", str(place / "true.json")]
    dark = ["--sun-azimuth", "300", "--sun-elevation", "60"]  # the wrong Sun: not located
    for more, count in (([], 0), (["--known-pose"], 20)):
        out = tmp_path / f"out{count}"
        assert run(["validate", *files, "-o", str(out), "--attitude-sigma", "0", *dark, *more]) == 4
        image = json.loads((out / "report.json").read_text())["images"][0]
        assert image["pose"] is None
        assert image["claims"]["count"] >= count
        if not count:
            assert image["claims"]["count"] == 0
            assert image["claims"]["reason"] == "the image was not located"
        fitted = tmp_path / f"errors{count}.toml"
        fit = [
            *files,
            "-o",
            str(tmp_path / f"fit{count}"),
            "--fit-errors",
            str(fitted),
            *dark,
            *more,
        ]
        assert run(["validate", *fit]) == (4 if count else 1)
        assert fitted.exists() == bool(count)
        assert ("frame.png is not located and counts" in caplog.text) == bool(count)


@pytest.mark.slow
def test_errors_are_fitted_to_the_points_found(place, tmp_path, capsys, monkeypatch) -> None:
    """The file is a section of a BUILD.toml and holds the library's fit, of the residuals at the found place. The
    frame is rendered from the catalogue's own DEM, so that the fit finds small errors of heights and places.
    """
    out, errors, fits = tmp_path / "out", tmp_path / "errors.toml", []

    def fit(samples, stated):
        fits.append((samples, stated, fit_errors(samples, stated)))
        return fits[-1][-1]

    monkeypatch.setattr("lcp_catalog.validation.error_fit.fit_errors", fit)
    assert validated(place, "--fit-errors", str(errors), out=str(out)) == 0
    printed = capsys.readouterr()
    found = json.loads((out / "report.json").read_text())["images"][0]["points_found"]
    assert f"{errors}: errors fitted to " in printed.err
    first, section = errors.read_text().split("\n", 1)
    fitted = int(first.removeprefix("# fitted to ").split()[0])
    assert fitted >= found >= 20
    assert first.endswith("points searched for in frame.png (framing camera)")
    assert section.startswith("[errors]\n")
    model = BuildConfig.from_toml(errors).errors
    catalog = open_catalog(place / "points.h5")
    image = open_image(place / "frame.png", read_sensor(place / "believed.json"))
    law = reflectance_model("lunar-lambert")
    fix = locate(catalog, image, Uncertainty(1000.0), law)
    sight, matches = image.with_sensor(fix.pose.sensor), fix.matches
    kept = [k for k, code in enumerate(matches.code) if code in SEARCHED]
    pixels = [matches.found_px[k] if matches.found[k] else (np.nan, np.nan) for k in kept]
    sample = residuals_of(catalog, sight, matches.point[kept], np.array(pixels), law)
    (((given,), stated, wanted),) = fits
    assert stated == ErrorModel.from_dict(catalog.errors)
    for name in ("residual", "valid", "patches", "place_m"):
        np.testing.assert_allclose(
            getattr(given, name), getattr(sample, name), atol=1e-6, err_msg=name
        )
    for name, value in wanted.to_dict().items():
        assert getattr(model, name) == pytest.approx(value, rel=1e-3, abs=1e-12), name
    assert model.position_sigma_m < 30.0  # a pixel is 240 m
    assert not list(tmp_path.glob(".*"))
    again = tmp_path / "again"
    assert validated(place, "--fit-errors", str(errors), out=str(again)) == 1
    assert f"{errors} exists; use --overwrite" in capsys.readouterr().err
    assert not again.exists()


def test_too_few_points_for_a_fit_leave_no_file(place, tmp_path, capsys) -> None:
    """An image that is not located has no points found."""
    out, errors = tmp_path / "out", tmp_path / "errors.toml"
    files = [str(place / "points.h5"), str(place / "frame.png"), "-o", str(out)]
    night = ["--camera", str(place / "true.json"), "--sun-azimuth", "90", "--sun-elevation", "-30"]
    assert run(["validate", *files, *night, "--fit-errors", str(errors)]) == 1
    assert capsys.readouterr().err.startswith("lcp: 0 points were found in the images, ")
    assert not errors.exists()
    assert not out.exists()


def test_the_file_of_fitted_errors_is_no_other_output(place, tmp_path, capsys) -> None:
    out = tmp_path / "out"
    files = [str(place / "points.h5"), str(place / "frame.png"), "-o", str(out)]
    for name, more, code, said in (
        (out / "points.csv", [], 2, "is the same file as"),
        (tmp_path / "r.d", ["--depfile", str(tmp_path / "r.d")], 2, "is the same file as"),
        (tmp_path / "none" / "e.toml", [], 1, "none does not exist"),
    ):
        assert run(["validate", *files, "--fit-errors", str(name), *more]) == code
        assert said in capsys.readouterr().err
        assert not out.exists()


def test_a_dem_is_no_image(place, tmp_path, capsys) -> None:
    """Before anything is searched or written."""
    out = tmp_path / "out"
    files = [str(place / "points.h5"), str(place / "frame.png"), str(DEM), "-o", str(out)]
    assert run(["validate", *files, "--camera", str(place / "believed.json")]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "hadley_gld100_256ppd.tif: holds heights (GLD100_256: -2688 to 1970 m)" in said
    assert "--dem" in said
    assert not out.exists()


@pytest.fixture(scope="module")
def panorama(place):
    """A lamp and a bright sky in the north."""
    lamp = room(60, [Lamp(100.0, 30.0, 1.0)], ambient=0.02)
    light = lamp.luminance.copy()
    light[15:30, 40:80] += 0.3
    path = place / "lamp.hdr"
    cv2.imwrite(str(path), np.repeat(light.astype(np.float32)[:, :, None], 3, axis=2))
    return path


@pytest.mark.slow
def test_a_frame_under_a_panorama(place, panorama):
    """Windows of a frame of the same place agree with renders under the panorama, less with those under its strongest source."""
    taken = ["simulate", str(DEM), "--camera", str(place / "true.json"), "--samples", "1"]
    lit = ["--environment", str(panorama), "--accuracy", "draft", "-o", str(place / "lamps.png")]
    assert run([*taken, *lit]) == 0
    how = ["--camera", str(place / "lamps_camera.json"), "--dem", str(DEM), "--accuracy", "draft"]
    start = ["validate", str(place / "points.h5"), str(place / "lamps.png"), *how]
    light = ["--environment", str(panorama), "--sun-sky-ratio", "found"]
    assert run([*start, "-o", str(place / "lit"), *light, "--depfile", str(place / "lit.d")]) == 0
    assert run([*start, "-o", str(place / "unlit")]) in {0, 4}
    lit, unlit = (
        json.loads((place / name / "report.json").read_text()) for name in ("lit", "unlit")
    )
    assert lit["options"]["environment"] == "lamp.hdr"
    assert str(panorama) in (place / "lit.d").read_text()
    (lit,), (unlit,) = lit["images"], unlit["images"]
    assert lit["verdict"] == "located"
    assert lit["sun"]["from"] == "the middle of the panorama's light"
    assert lit["windows"]["median"] > 0.98
    assert lit["windows"]["median"] > unlit["windows"]["median"] + 0.01


def test_a_panorama_beside_a_sun(place, panorama, capsys):
    files = ["validate", str(place / "points.h5"), str(place / "frame.png")]
    start = [*files, "-o", str(place / "no"), "--environment", str(panorama)]
    assert run([*start, "--sun-azimuth", "1", "--sun-elevation", "5"]) == 2
    assert "--environment replaces the Sun" in capsys.readouterr().err
    assert not (place / "no").exists()


@pytest.mark.parametrize("given", ["0.7", "700m", "0.7km", "700 M"])
def test_a_length_has_a_unit(given) -> None:
    assert Distance().convert(given, None, None) == pytest.approx(0.7)


@pytest.mark.parametrize("given", ["-3m", "m", "3 miles", "nanm"])
def test_other_lengths_are_refused(given) -> None:
    with pytest.raises(click.BadParameter):
        Distance().convert(given, None, None)


def eight_bits(place: Path, name: str, gamma: float) -> Path:
    """The frame with 8 bits a pixel, proportional to radiance or as the codes of a display."""
    codes = cv2.imread(str(place / "frame.png"), cv2.IMREAD_UNCHANGED).astype(np.float64)
    light = codes / np.iinfo(np.uint16).max if codes.max() > 255 else codes / 255
    light = np.clip(light / np.percentile(light, 99.5), 0.0, 1.0)
    if gamma > 1.0:
        light = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    assert cv2.imwrite(str(place / name), np.round(254 * light).astype(np.uint8))
    return place / name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "gamma", "better"), [("s.png", 2.4, "srgb"), ("l.png", 1.0, "linear")]
)
def test_the_encoding_that_fits_is_named_and_chosen(place, capsys, name, gamma, better) -> None:
    eight_bits(place, name, gamma)
    used = {}
    for encoding in ("linear", "auto") if better == "srgb" else ("auto",):
        out = f"{name}-{encoding}"
        assert validated(place, "--encoding", encoding, image=name, out=out) == 0
        document = json.loads((place / out / "report.json").read_text())
        assert document["options"]["encoding"] == encoding
        found = document["images"][0]["encoding"]
        assert found["better"] == better
        both = found["correlation"]
        assert both[better] == max(both.values())
        used[encoding] = found["used"]
    assert used.pop("auto") == better
    assert set(used.values()) <= {"linear"}
    text = capsys.readouterr().out
    assert ("but fit better as sRGB (encoding auto or srgb)" in text) == (better == "srgb")


@pytest.mark.slow
def test_an_image_that_neither_encoding_locates_keeps_the_search_of_its_samples(place) -> None:
    """Points, windows and pictures are then of one and the same search: those of ``linear``."""
    eight_bits(place, "n.png", 2.4)
    found = {}
    for encoding in ("linear", "auto"):
        out = f"neither-{encoding}"
        wrong = ["--sun-azimuth", "300", "--sun-elevation", "60", "--encoding", encoding]
        assert validated(place, *wrong, image="n.png", out=out) == 4
        document = json.loads((place / out / "report.json").read_text())
        found[encoding] = document["images"], (place / out / "points.csv").read_bytes()
    assert found["auto"][0][0]["encoding"] is None
    assert found["auto"] == found["linear"]
