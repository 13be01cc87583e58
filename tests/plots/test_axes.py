"""Numbers, ticks and axes of charts."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers.pages import parsed
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup

from lcp_catalog.plots.axes import Axes, Axis, round_ticks
from lcp_catalog.plots.numbers import nice_step, number, typeset


def test_numbers_have_few_digits() -> None:
    texts = [
        (0.0, "0"),
        (118.0, "118"),
        (1.23456, "1.23"),
        (1e-7, "1.00e-07"),
        (100.0, "100"),
        (np.nan, "–"),
    ]
    for value, text in texts:
        assert number(value) == text


def test_powers_are_raised() -> None:
    for text, wanted in (
        ("the number of false alarms is 10^-140", "the number of false alarms is 10⁻¹⁴⁰"),
        (
            "random matches: 10^-128; for the second 10^0",
            "random matches: 10⁻¹²⁸; for the second 1",
        ),
        ("10^-0, 10^12", "1, 10¹²"),
        ("1.50e-07 m", "1.5 × 10⁻⁷ m"),
        ("1.00e+05", "10⁵"),
        ("2e-03 and 4.2 m", "2 × 10⁻³ and 4.2 m"),
        ("frame-a1e-05.png, sha 31e05, x10^2", "frame-a1e-05.png, sha 31e05, x10^2"),
    ):
        assert typeset(text) == wanted


@given(st.floats(1e-6, 1e9), st.integers(1, 12))
def test_a_step_is_round_and_the_smallest(span: float, parts: int) -> None:
    step = nice_step(span, parts)
    mantissa = float(f"{step:.6e}".split("e")[0])
    assert mantissa in (1.0, 2.0, 2.5, 5.0)
    assert span / step <= parts * (1 + 1e-6)
    smaller = step * {1.0: 0.5, 2.0: 0.5, 2.5: 0.8, 5.0: 0.5}[mantissa]
    assert span / smaller > parts * (1 - 1e-6)


def test_ticks_are_round_and_inside() -> None:
    assert round_ticks(-0.3, 0.7, 5) == [
        (-0.2, "-0.2"),
        (0.0, "0"),
        (0.2, "0.2"),
        (0.4, "0.4"),
        (pytest.approx(0.6), "0.6"),
    ]
    assert [value for value, _ in round_ticks(7.0, -1.0, 4)] == [0.0, 2.0, 4.0, 6.0]


def test_values_are_placed_on_linear_and_logarithmic_axes() -> None:
    axes = Axes(Axis(1.0, 1000.0, log=True), Axis(5.0, -5.0), width=300.0, height=100.0)
    x, y = axes.at([1.0, 10.0, 1000.0], [5.0, 0.0, -5.0])  # the y axis decreases upwards
    np.testing.assert_allclose(x, [0.0, 100.0, 300.0])
    np.testing.assert_allclose(y, [100.0, 50.0, 0.0])


def test_a_chart_has_ticks_titles_and_bars_in_place() -> None:
    axes = Axes(
        Axis(0.0, 4.0, [(0.0, "0"), (4.0, "4")], "x < 5"),
        Axis(0.0, 2.0, [(2.0, "2")], "y", grid=True),
        width=400.0,
        height=200.0,
    )
    drawn = axes.draw(axes.bars([(1.0, 2.0, 1.5, "bar", "a & b")], gap=0.0), 'a "chart"')
    parsed(drawn)
    assert '<rect class="bar" x="100.0" y="50.0" width="100.0" height="150.0">' in drawn
    assert "<title>a &amp; b</title>" in drawn
    assert "x &lt; 5" in drawn
    assert re.findall(r'd="M(\S+) 200v5"', drawn) == ["0.0", "400.0"]
    assert 'd="M0 0.0H400"' in drawn
    assert 'aria-label="a &#34;chart&#34;"' in drawn
    alone = axes.draw(Markup(""), "c", style=".bar{fill:red}")
    assert alone.startswith('<svg xmlns="http://www.w3.org/2000/svg"')
    assert "<style>.bar{fill:red}</style>" in alone
