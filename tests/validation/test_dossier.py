"""The dossier: its verdict and its numbers, against the answers that they come from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.navigable import everywhere_usable
from helpers.pages import in_browser, measured, parsed
from helpers.posed import camera
from lcp_cli.main import run

from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.errors import ConfigError, OutputError
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.navigation.expected_position import Answer, Query, answers
from lcp_catalog.navigation.frame_points import PlannedImage
from lcp_catalog.validation.dossier import Evidence, RequirementVerdict, point_budget, write_dossier

FRAME = PlannedImage.lit(camera(), SunChoice(100.0, 17.0))
IMAGE = {
    "image": "a<b.png",
    "verdict": "located",
    "reason": "",
    "points_found": 9,
    "points_in_view": 12,
    "windows": {"share_above_0_9": 0.5, "reason": ""},
    "claims": {"found_of_usable": 0.93, "normalised_squared_error": None, "reason": ""},
    "pose": None,
}


@pytest.fixture(scope="module")
def answer() -> Answer:
    (found,) = answers(everywhere_usable(), [FRAME], Query())
    return found


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """A catalogue and a report of a validation."""
    write_catalog(everywhere_usable(), tmp_path / "c.h5")
    (tmp_path / "report.json").write_text(json.dumps({"images": [IMAGE]}))
    return tmp_path / "c.h5", tmp_path / "report.json"


def test_a_requirement_is_about_every_frame_and_image(answer: Answer) -> None:
    sigma, evidence = answer.position.position_sigma_m, [Evidence("r.json", {"images": [IMAGE]})]
    assert sigma is not None
    met = f"position_sigma_m<{sigma + 0.1:.3f}, found_of_usable>=0.93 and usable>=4"
    assert RequirementVerdict.of(met, [answer, answer], evidence).failures == ()
    blind = replace(answer.position, covariance=None, reason="no light")
    dark = replace(answer, position=blind)
    text = f"position_sigma_m<{sigma - 0.1:.3f} and claims.found_of_usable>0.93"
    short, none, image = RequirementVerdict.of(text, [answer, dark], evidence).failures
    assert short.startswith("frame 1: position_sigma_m is ")
    assert none.startswith("frame 2: no position_sigma_m (no light)")
    assert image == "a<b.png: claims.found_of_usable is 0.93; required: claims.found_of_usable>0.93"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("usable>=4", "needs `camera` or `trajectory`"),
        ("found_of_usable>=0.9", "needs `evidence`"),
        ("sharpness>1", "unknown name sharpness"),
        ("usable", "is not a condition"),
    ],
)
def test_a_requirement_that_cannot_be_judged_is_refused(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        RequirementVerdict.of(text, [], [])


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"images": []}', '{"images": [{"image": 1}]}']
)
def test_what_is_no_report_is_no_evidence(tmp_path: Path, content: str) -> None:
    path = tmp_path / "r.json"
    path.write_text(content)
    with pytest.raises(ConfigError, match=r"r\.json: is not a report\.json of lcp validate"):
        Evidence.read(path)


def test_errors_of_a_point_are_those_of_the_usable_conditions() -> None:
    catalog = everywhere_usable()
    catalog = replace(catalog, errors=catalog.errors | {"position_sigma_m": 12.0})
    rows = {name.split(",")[0]: values for name, *values in point_budget(catalog, Query())}
    major = np.concatenate([
        catalog.sigma_major[i, 0][catalog.condition[i] == 31] for i in range(len(catalog))
    ])  # fmt: skip
    stated = [np.median(major), np.quantile(major, 0.95)]
    for found, want in zip(rows["both together"], stated, strict=True):
        assert float(found) == pytest.approx(want, rel=0.01)
    for found, want in zip(rows["match"], stated, strict=True):
        assert float(found) == pytest.approx(np.sqrt(want**2 - 144.0), rel=0.01)
    assert rows["tie of the map"] == ["not stated", "not stated"]
    gld = replace(catalog, dem_product=np.full(len(catalog), "GLD100_256", object))
    for query, metres in ((Query(), "30"), (Query(map_sigma_m=7.0), "7")):
        (row,) = (row for row in point_budget(gld, query) if row[0].startswith("tie"))
        assert row[1:] == (metres, metres)


@pytest.mark.slow
def test_the_page_shows_verdict_budget_and_evidence(
    files: tuple[Path, Path], tmp_path: Path, answer: Answer
) -> None:
    catalog, report = files
    page = tmp_path / "d.html"
    verdict = write_dossier(catalog, page, [FRAME], None, "usable>=4000", [report])
    assert verdict is not None
    assert len(verdict.failures) == 1
    html = page.read_text(encoding="utf-8")
    parsed(html)
    assert "Not met" in html
    assert "a&lt;b.png" in html
    assert "a<b.png" not in html
    assert f"{answer.usable} of {answer.counts['in_view']}" in html
    assert write_dossier(catalog, tmp_path / "plain.html") is None
    assert "No requirement was given" in (tmp_path / "plain.html").read_text(encoding="utf-8")
    with pytest.raises(OutputError, match="is read, too"):
        write_dossier(catalog, report, evidence=[report], overwrite=True)


@pytest.mark.slow
@in_browser
def test_the_page_is_as_wide_as_a_phone(files: tuple[Path, Path], tmp_path: Path) -> None:
    """With evidence whose path is longer than a line."""
    (far := tmp_path / ("a" * 80)).mkdir()
    evidence = files[1].rename(far / "report.json")
    write_dossier(files[0], tmp_path / "d.html", [FRAME], evidence=[evidence])
    html = (tmp_path / "d.html").read_text(encoding="utf-8")
    assert "a" * 80 in html
    assert measured(html, 400, tmp_path)["wide"] <= 0


def test_the_command_says_no_with_exit_code_4(
    files: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    catalog, report = files
    given = ["report", catalog, "-o", tmp_path / "d.html", "--overwrite", "--evidence", report]
    command = [str(word) for word in given]
    for text, code in (("found_of_usable>=0.9", 0), ("found_of_usable>=0.99", 4)):
        assert run([*command, "--dossier", "--require", text]) == code
    assert run(command) == 2
    assert "--evidence needs --dossier" in capsys.readouterr().err
