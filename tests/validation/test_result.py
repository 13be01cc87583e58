"""The content of report.json: its names, its values, and its reproducibility."""

from __future__ import annotations

import json
import math
import statistics
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import verdicts
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.matching.matches import FOUND, REASONS
from lcp_catalog.validation import result

CONTRACT = {
    "image": str,
    "points_in_view": int,
    "points_found": int,
    "offset_px": {"median", "p95"},
    "offset_m": {"median", "p95"},
    "correlation": {"median", "p05"},
    "windows": {"size", "count", "share_above_0_9", "share_above_0_7", "median", "mode"},
    "pose": {"position_error_m", "position_sigma_m"},
    "claims": {
        "count",
        "brier",
        "brier_of_the_mean",
        "found_of_usable",
        "found_of_unusable",
        "usable_of_found",
        "reliability",
        "normalised_squared_error",
        "expected_calibration_error",
    },
}
"""Names in the entry of an image, as documented."""


@pytest.fixture(scope="module")
def whole() -> result.ValidationResult:
    return verdicts.whole()


def refused(text: str) -> float:
    raise AssertionError(f"{text} is no JSON")


def read(whole: result.ValidationResult) -> dict:
    """The text read by a strict parser."""
    return json.loads(whole.to_json(), parse_constant=refused)


def test_every_image_has_what_the_contract_promises(whole: result.ValidationResult) -> None:
    located, elsewhere, blank = read(whole)["images"]
    for image in (located, elsewhere, blank):
        for name, kind in CONTRACT.items():
            assert name in image
            if isinstance(kind, type):
                assert type(image[name]) is kind
            elif image[name] is None:
                assert name == "pose"
            else:
                assert kind <= set(image[name])
    assert located["pose"] is not None
    assert elsewhere["pose"] is blank["pose"] is None
    assert [image["verdict"] for image in (located, elsewhere, blank)] == list(result.VERDICTS)


def test_figures_are_those_of_the_rows(whole: result.ValidationResult) -> None:
    image = whole.images[0]
    rows = [i for i in range(len(image.matches)) if REASONS[image.matches.code[i]] == FOUND]
    offsets = [math.dist(image.matches.found_px[i], image.matches.predicted_px[i]) for i in rows]
    metres = [o * image.points.pixel_m[i] for o, i in zip(offsets, rows, strict=True)]
    residuals = [math.dist(image.matches.found_px[i], image.points.corrected_px[i]) for i in rows]
    found = read(whole)["images"][0]
    assert found["points_in_view"] == 60
    assert found["points_found"] == len(rows)
    for name, values in (("offset_px", offsets), ("offset_m", metres), ("residual_px", residuals)):
        twentieths = statistics.quantiles(values, n=20, method="inclusive")
        assert found[name]["median"] == pytest.approx(statistics.median(values), rel=1e-9)
        assert found[name]["p95"] == pytest.approx(twentieths[-1], rel=1e-9)
    seen = [image.matches.correlation[i] for i in rows]
    assert found["correlation"]["median"] == pytest.approx(statistics.median(seen), rel=1e-9)
    twentieths = statistics.quantiles(seen, n=20, method="inclusive")
    assert found["correlation"]["p05"] == pytest.approx(twentieths[0], rel=1e-9)


def test_what_was_not_found_is_counted_by_reason(whole: result.ValidationResult) -> None:
    found = read(whole)["images"][0]
    codes = whole.images[0].matches.code.tolist()
    assert FOUND not in found["not_found"]
    assert found["not_found"] == {
        reason: codes.count(k) for k, reason in enumerate(REASONS) if k and codes.count(k)
    }
    assert sum(found["not_found"].values()) + found["points_found"] == found["points_in_view"]


def test_windows_are_those_compared(whole: result.ValidationResult) -> None:
    compared = whole.images[0].windows.compared
    found = read(whole)["images"][0]["windows"]
    values = compared.correlation.tolist()
    assert found["count"] == len(values) > 20
    assert found["share_above_0_9"] == pytest.approx(sum(c > 0.9 for c in values) / len(values))
    assert found["share_above_0_7"] == pytest.approx(sum(c > 0.7 for c in values) / len(values))
    assert 0.0 < found["share_above_0_9"] < found["share_above_0_7"] < 1.0
    assert found["median"] == pytest.approx(statistics.median(values))
    limit = statistics.median(compared.contrast.tolist())
    rough = [c for c, t in zip(values, compared.contrast, strict=True) if t >= limit]
    share = sum(c > 0.9 for c in rough) / len(rough)
    assert found["textured"]["share_above_0_9"] == pytest.approx(share)
    share = sum(c > 0.7 for c in rough) / len(rough)
    assert found["textured"]["share_above_0_7"] == pytest.approx(share)
    assert (found["size"], found["step"], found["gsd_m"]) == (16, 16, 948.0)
    assert found["offset"] == "kept"
    assert found["resolution"] == "from the heights' spectrum"


def test_claims_are_those_of_the_rows(whole: result.ValidationResult) -> None:
    """Of an image and of all images together; null where nothing was scored."""
    document = read(whole)
    located, elsewhere, blank = (image["claims"] for image in document["images"])
    claims = whole.images[0].claims
    trials = [
        (p, o) for p, o, t in zip(claims.probability, claims.found, claims.tried, strict=True) if t
    ]
    assert located["count"] == len(trials) == sum(row[2] for row in located["reliability"])
    assert located["brier"] == pytest.approx(statistics.fmean((p - o) ** 2 for p, o in trials))
    assert [row[:2] for row in located["reliability"]] == [
        [k / 10, (k + 1) / 10] for k in range(10)
    ]
    assert [row[3] for row in located["reliability"] if not row[2]].count(None) > 0
    assert list(elsewhere) == list(blank) == list(located) == list(document["claims"])
    assert elsewhere["brier"] is None
    assert elsewhere["reason"] == "the image was not located"
    assert document["claims"]["brier"] == located["brier"]
    assert document["claims"]["unclaimed"] == located["unclaimed"] + 60


def test_two_images_are_scored_together() -> None:
    """By points, not by images: the mean of both images weighted with their trials."""
    images = verdicts.image(n=40), verdicts.image("other.png", n=400, seed=2)
    document = result.ValidationResult(images, {}, {}).document()
    one, two = (image["claims"] for image in document["images"])
    whole = document["claims"]
    assert whole["count"] == one["count"] + two["count"]
    total = one["count"] * one["brier"] + two["count"] * two["brier"]
    assert whole["brier"] == pytest.approx(total / whole["count"])
    assert whole["brier"] != pytest.approx((one["brier"] + two["brier"]) / 2.0)


def test_without_windows_the_same_names_have_no_values(whole: result.ValidationResult) -> None:
    located, elsewhere, _ = read(whole)["images"]
    assert list(elsewhere["windows"]) == list(located["windows"])
    assert elsewhere["windows"]["count"] == 0
    assert elsewhere["windows"]["share_above_0_9"] is None
    assert elsewhere["windows"]["reason"] == "without a place there is nothing to compare"


def test_a_pose_says_where_and_how_well(whole: result.ValidationResult) -> None:
    figures = whole.images[0].pose
    found = read(whole)["images"][0]["pose"]
    covariance = np.array(found["covariance"])
    np.testing.assert_allclose(covariance, figures.pose.covariance, rtol=1e-9)
    assert found["position_sigma_m"] == pytest.approx(math.sqrt(np.trace(covariance[:3, :3])))
    major, middle, minor = found["position_sigma_axes_m"]
    assert major > middle > minor > 0.0
    assert major**2 * middle**2 * minor**2 == pytest.approx(np.linalg.det(covariance[:3, :3]))
    off = np.array(found["position_mcmf_m"]) - verdicts.camera().position_mcmf_m
    assert found["position_error_m"] == pytest.approx(np.linalg.norm(off), rel=1e-4)
    assert found["position_error_across_m"] == pytest.approx(np.linalg.norm(off[1:]), rel=1e-4)
    assert list(found["correction"]) == list(found["sigma"])
    assert found["correction"]["z_m"] == pytest.approx(figures.pose.correction[2])
    assert found["sigma"]["turn_y_rad"] == pytest.approx(math.sqrt(covariance[4, 4]))


def test_what_was_checked_is_told(whole: result.ValidationResult) -> None:
    located, elsewhere, _ = read(whole)["images"]
    assert located["log10_false_alarms"] == -40.25
    assert located["log10_false_alarms_rival"] == -0.5
    assert elsewhere["light"] is None
    turned = {
        "turned_deg": -20.0,
        "raised_deg": 0.0,
        "correlation": 0.625,
        "preferred_share": 0.125,
    }
    raised = {"turned_deg": 0.0, "raised_deg": 10.0, "correlation": None, "preferred_share": None}
    assert located["light"] == {
        "fits": True,
        "elevation_fits": True,
        "points": 30,
        "law": None,
        "correlation": 0.9,
        "others": [turned, raised],
    }


def test_a_map_has_two_axes_and_no_position() -> None:
    found = result.PoseFigures(verdicts.on_map()).figures()
    assert found["position_mcmf_m"] is found["position_error_m"] is None
    assert found["correction"] == {"east_m": 3.0, "north_m": -4.0}
    assert found["position_sigma_m"] == pytest.approx(math.sqrt(13.0))
    trace, det = 13.0, 35.0  # axes by the characteristic polynomial
    root = math.sqrt(trace**2 - 4 * det)
    wanted = [math.sqrt((trace + root) / 2), math.sqrt((trace - root) / 2)]
    assert found["position_sigma_axes_m"] == pytest.approx(wanted)


def test_a_scanner_stands_where_its_middle_line_saw() -> None:
    """A scanner that moves 10 m per line, and 1 m sideways per column."""

    def looks(pixel: list[float]) -> tuple[np.ndarray, np.ndarray]:
        column, row = pixel
        return np.array([2e6, 10.0 * row, 1.0 * column]), np.array([-1.0, 0.0, 0.0])

    posed = verdicts.image().pose
    assert posed is not None
    scan = SimpleNamespace(corrections=posed.pose.sensor.corrections, shape=(401, 101), looks=looks)
    found = result.PoseFigures(replace(posed.pose, sensor=scan)).position_mcmf_m
    assert found.tolist() == [2e6, 2000.0, 50.0]


def test_what_is_not_known_is_no_part_of_a_median() -> None:
    located = verdicts.image()
    rows = np.flatnonzero(located.matches.found)
    correlation = located.matches.correlation.copy()
    correlation[rows[::3]] = np.nan
    kept = np.delete(rows, np.s_[::3])
    matches = replace(located.matches, correlation=correlation)
    found = replace(located, located=replace(located.located, matches=matches)).figures()
    assert found["correlation"]["median"] == statistics.median(correlation[kept].tolist())
    nothing = replace(matches, correlation=np.full(len(correlation), np.nan))
    found = replace(located, located=replace(located.located, matches=nothing)).figures()
    assert math.isnan(found["correlation"]["median"])
    assert math.isnan(found["correlation"]["p05"])


def test_equal_verdicts_are_equal_bytes(whole: result.ValidationResult) -> None:
    assert verdicts.whole().to_json() == whole.to_json()
    assert whole.to_json().endswith("}\n")


@pytest.mark.slow
@settings(max_examples=40)
@given(
    st.recursive(
        st.floats() | st.integers() | st.text() | st.none() | st.booleans(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        max_leaves=12,
    )
)
def test_anything_plain_is_json(value: object) -> None:
    text = json.dumps(result.plain(value), allow_nan=False)
    assert result.plain(json.loads(text)) == result.plain(value)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_ten_digits(value: float) -> None:
    found = result.plain(np.float64(value))
    assert type(found) is float
    assert abs(found - value) <= 0.51e-9 * abs(value)


def test_arrays_and_their_numbers_become_plain() -> None:
    found = result.plain(
        {"a": np.array([[1.0, np.nan], [np.inf, -0.0]]), 3: (np.int64(2), np.bool_(True))}
    )
    assert found == {"a": [[1.0, None], [None, 0.0]], "3": [2, True]}
    assert math.copysign(1.0, found["a"][1][1]) == 1.0
    assert type(found["3"][0]) is int


def test_what_does_not_fit_together_is_refused() -> None:
    located, elsewhere = verdicts.image(), verdicts.image(located=False)
    for wrong in (
        lambda: replace(located, located=replace(located.located, verdict="perhaps")),
        lambda: replace(located, located=replace(located.located, pose=None)),
        lambda: replace(elsewhere, located=replace(elsewhere.located, pose=located.located.pose)),
        lambda: replace(located, points=result.PointFigures.none()),
        lambda: replace(located.facts, name="/folder/frame.png"),
    ):
        with pytest.raises(ValueError, match=r"frame\.png|perhaps"):
            wrong()


# -- in a terminal


def test_a_few_lines_say_it(whole: result.ValidationResult) -> None:
    lines = result.summary_lines(whole)
    image, figures = whole.images[0], read(whole)["images"][0]
    assert lines[0] == "frame.png: located"
    assert f"error {result.number(image.pose.position_error_m)} m" in lines[1]
    assert lines[2].startswith(f"  points   {figures['points_found']} of 60 in view found; ")
    assert f"{figures['not_found']['weak']} weak" in lines[2]
    assert f"median {result.number(figures['offset_px']['median'])} px" in lines[3]
    assert f"95 % within {result.number(figures['offset_px']['p95'])} px" in lines[3]
    assert f"after the pose {result.number(figures['residual_px']['median'])} px" in lines[3]
    claims = figures["claims"]
    assert f"{100 * claims['found_of_usable']:.1f} % of {claims['usable']} usable" in lines[4]
    assert f"{100 * claims['usable_of_found']:.1f} % of {claims['found']} found" in lines[4]
    assert f"Brier score {result.number(claims['brier'])} (constant: " in lines[4]
    assert f"stated {result.number(claims['normalised_squared_error'])}" in lines[4]
    unclaimed = f"; {claims['unclaimed']} in view without a claim"
    assert lines[4].endswith(unclaimed) == (claims["unclaimed"] > 0)
    share = 100 * figures["windows"]["share_above_0_9"]
    assert f"{share:.1f} % above 0.9" in lines[5]
    assert "offset: none was removed" in lines[5]
    assert lines[6].startswith("other.png: not this place: 3 of 30")
    assert lines[7].startswith("  points   32 of 60 that may be in view found; ")
    assert "  claims   not scored: the image was not located" in lines
    assert "  windows  none compared: without a place there is nothing to compare" in lines
    assert lines[-5:-1] == [
        "blank.png: cannot say: no point is in view",
        "  points   none in view",
        "  claims   not scored: no point is in view",
        "  windows  none compared",
    ]
    assert lines[-1] == f"all images: claims: {result.claims_text(whole.scores)}"
    assert not any("nan" in line for line in lines)
    assert result.image_lines(verdicts.unopened()) == ["lost.png: cannot say: missing geometry"]


def test_a_removed_offset_is_said() -> None:
    windows = verdicts.image().windows
    moved = replace(
        windows, compared=replace(windows.compared, offset="removed", shift_px=(1.5, -2.0))
    )
    assert moved.offset_sentence == (
        "1.5 cells right and -2 down, removed from the whole image before the comparison"
    )
