"""Requirements on a validation: parsing, errors, and comparison with figures."""

from __future__ import annotations

from typing import Any

import pytest
from helpers import verdicts
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.errors import ConfigError
from lcp_catalog.validation.requirement import NUMBERS, OPERATORS, VERDICT, Requirement


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """Three images: located, not this place, cannot say."""
    return verdicts.whole().document()


def only(document: dict[str, Any], k: int) -> dict[str, Any]:
    """One image of a report."""
    return document | {"images": [document["images"][k]]}


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Every path in an entry and its value."""
    if not isinstance(value, dict):
        return {path[1:]: value}
    found: dict[str, Any] = {}
    for name, inner in value.items():
        found |= leaves(inner, f"{path}.{name}")
    return found


def test_every_number_of_an_image_may_be_required(document: dict[str, Any]) -> None:
    """All single numbers except counts of reasons, corrections, and booleans."""
    left_out = ("not_found.", "pose.correction.", "pose.sigma.", "claims.unclaimed_by_cause.")
    numbers = {
        path
        for path, value in leaves(document["images"][0]).items()
        if type(value) in (int, float) and not path.startswith(left_out)
    }
    assert numbers == set(NUMBERS)


def test_a_whole_path_refers_to_itself() -> None:
    for path in NUMBERS:
        assert Requirement.parse(f"{path}>=1").terms[0].path == path
        assert Requirement.parse(f"images.{path} >= 1").terms[0].path == path


def test_the_end_of_a_path_is_enough() -> None:
    paths = {
        "share_above_0_9": "windows.share_above_0_9",
        "textured.share_above_0_9": "windows.textured.share_above_0_9",
        "points_found": "points_found",
        "position_error_m": "pose.position_error_m",
        "mode": "windows.mode",
        "p05": "correlation.p05",
        "count": "windows.count",
        "elevation_deg": "sun.elevation_deg",
        "brier": "claims.brier",
        "found_of_usable": "claims.found_of_usable",
        "usable_of_found": "claims.usable_of_found",
        "normalised_squared_error": "claims.normalised_squared_error",
        "claims.count": "claims.count",
    }
    for name, path in paths.items():
        assert Requirement.parse(f"{name}<1").terms[0].path == path


def test_an_ambiguous_name_lists_the_paths() -> None:
    with pytest.raises(ConfigError) as said:
        Requirement.parse("median>0.9")
    for path in ("offset_px.median", "offset_m.median", "correlation.median", "windows.median"):
        assert path in str(said.value)
    assert "\n" not in str(said.value)


def test_an_unknown_name_lists_the_known_ones() -> None:
    for name in ("shares", "pose", "ove_0_9", "windows", "images", "p0", "size_px"):
        said = rf"unknown name {name}( \(\S+ is meant\?\))?; known names: verdict, points_in_view"
        with pytest.raises(ConfigError, match=said):
            Requirement.parse(f"{name}>=0")


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        ("points", "points_found"),
        ("point_found", "points_found"),
        ("offset_px.medain", "offset_px.median"),
        ("position_eror_m", "pose.position_error_m"),
        ("breir", "claims.brier"),
    ],
)
def test_a_misspelt_name_is_told_the_nearest(wrong: str, meant: str) -> None:
    with pytest.raises(
        ConfigError, match=rf"unknown name {wrong} \({meant} is meant\?\); known names: "
    ):
        Requirement.parse(f"{wrong}>=0")


INVALID = ("", " ", "mode", "mode>", ">0.9", "mode=0.9", "mode=>0.9", "mode>0.9,", "mode>0.9 or count>3",
     "mode>0.9 count>3", "mode>nan", "mode>85%", "mode>__import__('os')", "(mode>0.9)", "mode>0.9 and and count>1",
     "verdict>located", "verdict==lost", "1<mode<2")  # fmt: skip


def test_invalid_conditions_are_refused() -> None:
    for text in INVALID:
        with pytest.raises(ConfigError, match=r"^`require`: .") as said:
            Requirement.parse(text)
        assert "\n" not in str(said.value)


@given(
    st.sampled_from([path for path in NUMBERS if path.startswith("windows.")]),
    st.sampled_from(sorted(OPERATORS)),
    st.floats(-1e6, 1e6) | st.sampled_from([0.0, 0.25, 16.0, 948.0]),
    st.floats(-1e6, 1e6) | st.sampled_from([0.0, 0.25, 16.0, 948.0]),
)
def test_conditions_agree_with_python(path: str, symbol: str, found: float, wanted: float) -> None:
    entry: dict[str, Any] = {"image": "a.png", "points_found": 3, "windows": {"reason": ""}}
    *_, last = names = path.split(".")[1:]
    entry["windows"] |= {names[0]: {last: found}} if len(names) > 1 else {last: found}
    truth = eval(f"{found!r} {symbol} {wanted!r}")
    said = Requirement.parse(f"{path}{symbol}{wanted!r}").failures({"images": [entry]})
    assert said == [] if truth else len(said) == 1


def test_every_image_and_every_term_must_hold(document: dict[str, Any]) -> None:
    located = only(document, 0)
    found = located["images"][0]["points_found"]
    assert Requirement.parse(f"points_found>={found}").failures(located) == []
    assert (
        Requirement.parse(f"points_found>={found} and mode>-1, count > 1").failures(located) == []
    )
    said = Requirement.parse(f"points_found>{found} AND mode>2 and count>1").failures(located)
    assert said == [
        f"frame.png: points_found is {found}; required: points_found>{found}",
        f"frame.png: windows.mode is {located['images'][0]['windows']['mode']:.6g}; required: mode>2",
    ]
    said = Requirement.parse(f"points_found>={found}").failures(document)
    assert said == [f"blank.png: points_found is 0; required: points_found>={found}"]


def test_claims_may_be_required(document: dict[str, Any]) -> None:
    located, elsewhere = only(document, 0), only(document, 1)
    brier = located["images"][0]["claims"]["brier"]
    assert Requirement.parse("brier<=0.9 and claims.count>=30").failures(located) == []
    assert Requirement.parse("brier<=0.01").failures(located) == [
        f"frame.png: claims.brier is {brier:.6g}; required: brier<=0.01"
    ]
    assert Requirement.parse("found_of_usable>=0").failures(elsewhere) == [
        "other.png: claims.found_of_usable was not measured (the image was not located); "
        "required: found_of_usable>=0"
    ]


def test_what_was_not_measured_fails_with_its_reason(document: dict[str, Any]) -> None:
    said = Requirement.parse("share_above_0_9>=0,position_error_m<1e9,offset_px.median<1e9")
    _, elsewhere, blank = (said.failures(only(document, k)) for k in range(3))
    assert elsewhere == [
        "other.png: windows.share_above_0_9 was not measured (without a place there is nothing to compare); "
        "required: share_above_0_9>=0",
        "other.png: pose.position_error_m was not measured (not this place: 3 of 30 points agree, as many as chance "
        "would give); required: position_error_m<1e9",
    ]
    assert blank[1].startswith("blank.png: pose.position_error_m was not measured (cannot say: no")
    assert blank[2].startswith("blank.png: offset_px.median was not measured (no point was found)")
    assert Requirement.parse("offset_px.median!=0").failures(only(document, 2))


def test_an_unknown_place_says_so(document: dict[str, Any]) -> None:
    entry = document["images"][0]
    entry = entry | {"pose": entry["pose"] | {"position_error_m": None}}
    (said,) = Requirement.parse("position_error_m<1").failures({"images": [entry]})
    assert "(the true position is unknown)" in said


def test_a_verdict_may_be_required(document: dict[str, Any]) -> None:
    assert Requirement.parse("verdict==located").terms[0].path == VERDICT
    assert len(Requirement.parse("verdict==located").failures(document)) == 2
    assert Requirement.parse("verdict == 'not this place'").failures(only(document, 1)) == []
    assert Requirement.parse("verdict!=located and count==0").failures(only(document, 1)) == []


def test_without_an_image_every_requirement_fails(document: dict[str, Any]) -> None:
    none = document | {"images": []}
    assert Requirement.parse("count>=0").failures(none) == ["no image was validated"]
