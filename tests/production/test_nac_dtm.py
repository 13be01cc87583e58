"""The steps of docs/howto/nac-dtm.md: a DTM of 2 m from its label to validated points, and ground that is too flat."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from helpers.nac_dtm import nac_dtm
from lcp_cli.main import run

import lcp_catalog as lcp

SUNS = ["--sun-elevations", "30", "--sun-azimuths", "90,105", "--view", "0:0", "--jobs", "1"]


def _built(folder: Path, label: Path, *words: str) -> int:
    (folder / "errors.toml").write_text("[errors]\nheight_sigma_m = 0.3\n")
    config = ["--config", str(folder / "errors.toml")]
    return run(["build-catalog", str(label), *config, *SUNS, "-o", str(folder / "c.h5"), *words])


@pytest.mark.slow
def test_from_the_label_to_validated_points(tmp_path: Path) -> None:
    label = nac_dtm(tmp_path, 320)
    assert run(["dem", "check", str(label)]) == 0
    assert _built(tmp_path, label) == 0
    assert len(lcp.open_catalog(tmp_path / "c.h5")) >= 10
    frame, sun = str(tmp_path / "f.png"), ["--sun-azimuth", "95", "--sun-elevation", "28"]
    place = ["--center", "23.3828", "1.226", "--fov", "1.6", "--altitude", "20"]
    size = ["--image-size", "384", "384", "--seed", "1", "-o", frame]
    assert run(["simulate", str(label), *place, *size, *sun]) == 0
    known = ["--known-pose", "--position-sigma", "30m", "--attitude-sigma", "0.05"]
    words = ["--camera", str(tmp_path / "f_camera.json"), "--dem", str(label), *known]
    assert run(["validate", str(tmp_path / "c.h5"), frame, *words, "-o", str(tmp_path / "v")]) == 0
    image = json.loads((tmp_path / "v" / "report.json").read_text())["images"][0]
    assert image["verdict"] == "located"
    assert image["points_found"] >= 8
    assert image["pose"]["position_error_m"] < 3.0 * image["pose"]["position_sigma_m"]
    assert image["offset_m"]["median"] < 0.5
    assert image["claims"]["found_of_usable"] is None or image["claims"]["found_of_usable"] >= 0.95


@pytest.mark.slow
def test_flat_ground_has_no_point_and_says_why(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert _built(tmp_path, nac_dtm(tmp_path, 320, relief=0.02)) == 0
    assert "holds no point" in caplog.text
    assert "featureless" in caplog.text


@pytest.mark.slow
def test_a_real_dtm_of_eight_bits_locates_a_real_image(shared_data: Path, tmp_path: Path) -> None:
    """The pit in Mare Tranquillitatis, by default: for the image's high Sun alone there are 3 points, too few."""
    pair = shared_data / "images" / "nac-tranqpit1-pair"
    dem, out = str(pair / "tranqpit1_dtm_2m.tif"), str(tmp_path / "c.h5")
    assert run(["build-catalog", dem, "--jobs", "1", "-o", out]) == 0
    image = str(pair / "tranqpit1_ortho_M152662021_0p5m.tif")
    words = ["--dem", dem, "--time", "2011-02-18T09:52:33", "--position-sigma", "10m"]
    assert run(["validate", out, image, *words, "-o", str(tmp_path / "v")]) == 0
    found = json.loads((tmp_path / "v" / "report.json").read_text())["images"][0]
    assert (found["verdict"], found["pose"]["position_sigma_m"] < 2.0) == ("located", True)
