"""The page of ``lcp trade`` from given rows: recommendations, Pareto front, images."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from scipy import stats

from lcp_catalog.accuracy import TIERS
from lcp_catalog.tradeoff import report
from lcp_catalog.tradeoff.charts import front, knobs_chart, number_or_dash, pareto, share_text


def row(accuracy: str, seconds: float, error: float = 0.0, **more: Any) -> dict[str, Any]:
    nothing = {"median": 0.0, "p95": 0.0}
    return {
        "accuracy": accuracy,
        "bound": TIERS[accuracy].node_error,
        "seconds": seconds,
        "seconds_relative": seconds / 10.0,
        "seconds_relative_range": [seconds / 11.0, seconds / 9.0],
        "cpu_seconds": seconds,
        "cpu_relative": seconds / 10.0,
        "render_seconds": seconds / 4.0,
        "render_relative": seconds / 10.0,
        "memory_mb": 400.0,
        "memory_base_mb": 150.0,
        "sunlit_error_share": error,
        "sunlit_error_near_edge_share": 1.0 if error else None,
        "visible_error_share": 0.0,
        "radiance_rmse": error,
        "points": 100,
        "points_lost": 0,
        "points_gained": 0,
        "points_moved": 0,
        "conditions_changed_share": 0.0,
        "detection_changed_share": 0.0,
        "detection_change_max": 0.001,
        "localization_sigma_change_m": nothing,
        "localization_sigma_change_share": nothing,
    } | more


def named(sentences: list[str]) -> list[str]:
    """The word after the first colon of each sentence."""
    return [re.findall(r": (\w+)", sentence)[0] for sentence in sentences]


def test_advice_follows_its_rules() -> None:
    draft = row("draft", 3.0, 3e-3, points_lost=3, points_gained=2, conditions_changed_share=0.004)
    standard = row("standard", 4.0, 1e-4, points_lost=1, points_gained=1, conditions_changed_share=1e-3)  # fmt: skip
    rows = [draft, standard, row("high", 6.0), row("reference", 10.0)]
    assert named(report.advice(rows)) == ["high", "standard", "draft", "high", "draft", "100"]
    # a catalogue whose probabilities differ is not equal
    rows[2] = row("high", 6.0, detection_changed_share=1e-4)
    assert named(report.advice(rows))[0] == "reference"
    # a tier that saves less than a tenth is not named
    rows[2] = row("high", 9.5)
    assert named(report.advice(rows))[0] == "reference"
    rows[0] = draft | {"cpu_seconds": 3.8}
    assert named(report.advice(rows))[2] == "standard"
    # too many changed conditions are not the same catalogue, however few points are lost
    rows[1] = standard | {"conditions_changed_share": 0.02}
    assert named(report.advice(rows))[1] == "reference"


@pytest.mark.parametrize(("points", "told"), [(1, "95 %"), (28, "10 %"), (400, "0.75 %")])
def test_advice_says_what_few_points_do_not_show(points: int, told: str) -> None:
    """The upper end of Clopper and Pearson's interval for no lost point, by the beta distribution."""
    assert told == share_text(float(stats.beta.ppf(0.95, 1, points)))
    rows = [row(tier, 3.0, points=points) for tier in TIERS]
    assert (
        f"compared: {points}. Where none of them is lost, up to {told} of"
        in report.advice(rows)[-1]
    )


def test_few_points_name_no_tier_but_reference_for_a_catalogue() -> None:
    """Also where every tier gives the same, as under load one area may; the quickest is named for a first look all the same."""
    assert (
        stats.beta.ppf(0.95, 1, report.LEAST_POINTS - 1)
        > 0.15
        > stats.beta.ppf(0.95, 1, report.LEAST_POINTS)
    )
    for points, tier in ((1, "reference"), (18, "reference"), (19, "draft")):
        rows = [row(one, 3.0 + k, points=points) for k, one in enumerate(TIERS)]
        said = report.advice(rows)
        assert named(said)[:3] == [tier, tier, "draft"]
        assert (f"few points ({points})" in said[0]) == (tier == "reference")


def test_small_figures_have_raised_powers() -> None:
    """Of every column of the table of approximations, as a shift of 3.4e-05 cells."""
    assert number_or_dash(3.4e-5) == "3.4 × 10⁻⁵"
    assert number_or_dash(0.25) == "0.25"


@pytest.mark.parametrize(
    ("tiers", "rows", "said"),
    [
        (1, [], "1 of 67 areas"),
        (4, [4, 4], "4 of 67 areas"),
        (1, [2, 2], "tiers on 1, alternatives on 2 of 67 areas"),
        (4, [4, 1], "tiers on 4, alternatives on 1 to 4 of 67 areas"),
    ],
)
def test_areas_are_those_of_tiers_and_of_every_row(tiers: int, rows: list[int], said: str) -> None:
    compared = {"areas": tiers, "areas_of": 67}
    assert report.areas_said(compared, [{"areas": count} for count in rows]) == said


def test_only_tiers_that_nobody_beats_are_on_the_front() -> None:
    rows = [row("draft", 3.0, 1e-3), row("standard", 12.0, 1e-4), row("high", 6.0), row("reference", 10.0)]  # fmt: skip
    assert [r["accuracy"] for r in front(rows)] == ["draft", "high"]


def test_the_name_of_a_tier_at_the_greatest_error_is_not_cut() -> None:
    svg = str(pareto([row("draft", 3.0, 1e-3), row("standard", 4.0, 1e-4), row("reference", 10.0)]))
    (top,) = map(float, re.findall(r'viewBox="\S+ (\S+) ', svg))
    (baseline,) = map(float, re.findall(r'y="(\S+)">draft</text>', svg))
    assert baseline - 14.0 >= top  # the height of its letters


def test_an_alternative_whose_saving_is_not_certain_is_not_on_the_front() -> None:
    def alternative(knob: str, time: float, to: float, changed: float) -> dict[str, Any]:
        around = {"seconds_relative": time, "seconds_interval": [time, to]}
        changes = {"conditions_changed_share": changed, "interval": None}
        return {"knob": knob, "value": "x", **around, **changes}

    some = [("", 1.0, 1.1, 0.0), ("sure", 0.8, 0.9, 0.01), ("unsure", 0.9, 1.03, 0.0)]
    plot = str(knobs_chart([alternative(*one) for one in some]))
    assert re.findall(r"<text [^>]*>([^<]*: x|your configuration)<", plot) == [
        "your configuration",
        "sure: x",
    ]


def test_a_tier_without_errors_stands_below_the_axis() -> None:
    plot = pareto([row("draft", 3.0, 1e-3), row("standard", 5.0, 1e-5), row("high", 6.0), row("reference", 10.0)])  # fmt: skip
    at = [float(y) for y in re.findall(r'class="whole" cx="[^"]*" cy="([^"]*)"', plot)]
    assert at[0] < at[1] < at[2] == at[3]
    left = [float(x) for x in re.findall(r'class="whole" cx="([^"]*)"', plot)]
    assert left == sorted(left)


def test_pictures_show_which_way_a_node_is_wrong() -> None:
    lit = np.zeros((9, 9), np.int8)
    lit[0, 0] = -1
    wrong = np.zeros((9, 9), np.int8)
    wrong[2, 2], wrong[6, 6] = 1, -1
    pixels = report._wrong_pixels(lit, wrong)
    assert pixels[0, 0, 3] == 0
    over, under = pixels[2, 2].astype(int), pixels[6, 6].astype(int)
    assert over[0] > 2 * over[2]  # red: lit where it should be dark
    assert under[2] > 2 * under[0]
    assert (pixels[1:4, 1:4] == pixels[2, 2]).all()
    assert (pixels[4, 4, :3] == pixels[8, 0, :3]).all()
