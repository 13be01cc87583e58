"""Drawings of matches and windows: positions and lengths agree with the figures."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from helpers import verdicts
from helpers.pages import parsed
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.matching.matches import MEANINGS, REASONS
from lcp_catalog.validation import report_pictures
from lcp_catalog.validation.ground_comparison import WindowComparison, compare
from lcp_catalog.validation.report_pictures import (
    BOTTOM,
    CANVAS,
    LEFT,
    RIGHT,
    SYMBOLS,
    TOP,
    Arrows,
    ImageDrawing,
)

TEMPLATES = files("lcp_catalog.plots") / "templates"
STYLE = "".join((TEMPLATES / name).read_text("utf-8") for name in ("page.css", "validation.css"))


def comparison(correlation: np.ndarray, **other: object) -> WindowComparison:
    """Adjoining windows in one row of the grid."""
    n = len(correlation)
    rows, ones = np.zeros(n, np.int64), np.ones(n)
    found = WindowComparison(
        16, 16, 474.0, rows, np.arange(n) * 16, correlation, ones, ones, "kept"
    )
    return replace(found, **other)


def numbers(text: str) -> list[float]:
    return [float(value) for value in re.findall(r"-?\d+(?:\.\d+)?", text)]


# -- over an image


def test_pixels_are_drawn_where_they_are() -> None:
    frame = ImageDrawing(480, 320)
    assert frame.at([[-0.5, -0.5], [479.5, 319.5], [0.0, 0.0]]).tolist() == [
        [0, 0],
        [CANVAS, 640],
        [1, 1],
    ]
    inside = [[-0.5, 0.0], [-0.51, 0.0], [479.5, 319.5], [479.6, 3.0], [3.0, 319.6], [np.nan, 3.0]]
    assert frame.holds(inside).tolist() == [True, False, True, False, False, False]


def test_a_strip_is_no_taller_than_a_page() -> None:
    """A tenth as wide as high, with a space beside it for a line of text."""
    frame = ImageDrawing(100, 1000)
    drawn = frame.drawing(frame.picture("data:,"), "strip", 40.0)
    left, right, top, bottom = LEFT, RIGHT, TOP, BOTTOM
    box = f"{-left:g} {-top:g} {480 + left + right:.1f} {1440 + top + bottom + 40:.1f}"
    assert f'viewBox="{box}"' in drawn
    assert '<image href="data:," width="144.0" height="1440.0"' in drawn
    assert '<rect class="edge" width="144.0" height="1440.0"/>' in drawn
    assert frame.at([99.5, 999.5]) == pytest.approx([144.0, 1440.0])


def test_arrows_are_as_long_as_they_are_said_to_be() -> None:
    frame = ImageDrawing(480, 320)
    start, by = np.array([[10.0, 20.0], [100.0, 50.0]]), np.array([[0.5, -0.25], [0.001, 0.0]])
    drawn = report_pictures.arrow_marks(frame, Arrows(start, by, ["", ""], ["a<b", "c"]), 100.0)
    parsed(drawn)
    assert "a&lt;b" in drawn
    first, second = re.findall(r'<path d="([^"]*)"', drawn)
    x, y, to_x, to_y = numbers(first)[:4]
    assert (x, y) == (21.0, 41.0)  # (10 + 0.5) x 2
    assert (to_x - x, to_y - y) == pytest.approx((0.5 * 2 * 100, -0.25 * 2 * 100))
    assert first.count("M") == 2  # with a head
    assert second.count("M") == 1  # too short for one
    tip = numbers(first)[4:]
    assert all(math.dist(tip[i : i + 2], (to_x, to_y)) <= 9.1 for i in (0, 2, 4))


@given(st.floats(1e-4, 1e3), st.integers(20, 6000))
def test_magnification_is_a_round_number_that_fits(length: float, width: int) -> None:
    frame = ImageDrawing(width, width)
    by = np.full((20, 2), [length, 0.0])
    times = report_pictures.magnification(frame, Arrows(by, by, [""] * 20, [""] * 20))
    assert float(f"{times:.0e}"[0]) in (1.0, 2.0, 5.0)
    assert 56.0 / 2.51 <= length * times * frame.scale <= 56.01


def test_without_arrows_nothing_is_magnified() -> None:
    none = Arrows(np.empty((0, 2)), np.empty((0, 2)), [], [])
    assert report_pictures.magnification(ImageDrawing(10, 10), none) == 1.0
    still = Arrows(np.zeros((1, 2)), np.zeros((1, 2)), [""], [""])
    parsed(report_pictures.quiver(ImageDrawing(10, 10), still, "q", "px"))


def test_the_scale_arrow_is_what_it_says() -> None:
    frame = ImageDrawing(1000, 500)
    by = np.full((5, 2), [0.03, 0.04])
    arrows = Arrows(np.zeros((5, 2)), by, [""] * 5, [""] * 5)
    times = report_pictures.magnification(frame, arrows)
    drawn = report_pictures.scale_arrow(frame, times, arrows, "px")
    said = re.search(r">([\d.]+) px; arrows magnified ([\d.]+) times", drawn)
    assert said is not None
    assert float(said[2]) == times
    x, y, to_x, to_y = numbers(re.search(r'<path d="([^"]*)"', drawn)[1])[:4]
    assert to_y == y > 500 * frame.scale
    assert to_x - x == pytest.approx(float(said[1]) * times * frame.scale, abs=0.1)


def test_arrows_of_their_own_length_are_said_to_be() -> None:
    by = np.full((5, 2), [40.0, 0.0])
    drawn = report_pictures.quiver(
        ImageDrawing(960, 960), Arrows(by, by, [""] * 5, [""] * 5), "q", "px"
    )
    assert "px; arrows to scale<" in drawn
    assert "magnified" not in drawn


def test_residuals_are_judged_by_their_covariances() -> None:
    dice = np.random.default_rng(1)
    root = dice.normal(size=(4000, 2, 2))
    covariance = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(2)
    residual = (np.linalg.cholesky(covariance) @ dice.normal(size=(4000, 2, 1)))[..., 0]
    over, css = report_pictures.error_classes(residual, covariance)
    wanted = [
        math.sqrt(0.5 * r @ np.linalg.inv(c) @ r) for r, c in zip(residual, covariance, strict=True)
    ]
    np.testing.assert_allclose(over, wanted, rtol=1e-9)
    shares = [css.count(name) / 4000 for _, name in report_pictures.ERROR_CLASSES]
    expected = [
        1 - math.exp(-1),
        math.exp(-1) - math.exp(-4),
        math.exp(-4) - math.exp(-9),
        math.exp(-9),
    ]
    np.testing.assert_allclose(shares, expected, atol=0.025)  # as the page's caption says
    assert report_pictures.error_classes(np.ones((1, 2)), np.full((1, 2, 2), np.nan))[1] == [
        "beyond3"
    ]


def test_every_reason_has_its_own_symbol_and_meaning() -> None:
    assert set(SYMBOLS) == set(REASONS)
    assert len({symbol for symbol in SYMBOLS.values()}) == len(REASONS)
    filled = [reason for reason, (path, css) in SYMBOLS.items() if css == "found"]
    assert filled == ["found"]
    for _, css in SYMBOLS.values():
        assert f".mark .{css} {{" in STYLE
    for _, css in report_pictures.ERROR_CLASSES:
        assert css == "within2" or f".{css} path {{" in STYLE


def test_marks_stand_in_the_image_alone() -> None:
    pixels = np.array([[10.0, 10.0], [-5.0, 10.0], [np.nan, np.nan]])
    drawn = report_pictures.reason_marks(
        ImageDrawing(96, 96), pixels, ["weak", "found", "found"], ["a", "b", "c"]
    )
    parsed(drawn)
    assert drawn.count("<title>") == 1
    assert 'transform="translate(105.0 105.0)"' in drawn
    assert SYMBOLS["weak"][0] in drawn


# -- correlation


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=200))
def test_bars_hold_every_window(values: list[float]) -> None:
    """From -0.2, or from -1 if more than 2 % of the windows lie below."""
    found = comparison(np.array(values))
    shares, edges = report_pictures.bars_shown(found)
    assert shares.sum() == pytest.approx(1.0)
    below = sum(value < -0.2 for value in values)
    lowest = -0.2 if below <= 0.02 * len(values) else -1.0
    assert edges.tolist() == pytest.approx(np.arange(round(100 * lowest), 101) / 100)
    low = sum(value < edges[1] for value in values) / len(values)
    assert shares[0] == pytest.approx(low, abs=1e-9 + np.isin(edges[1], values))


def test_bars_are_numpys_away_from_their_edges() -> None:
    values = np.random.default_rng(2).uniform(-0.19, 1.0, 5000)
    counts, _ = np.histogram(values, np.linspace(-0.2, 1.0, 121))
    shares, _ = report_pictures.bars_shown(comparison(values))
    np.testing.assert_allclose(shares, counts / 5000)


@given(st.lists(st.floats(-0.19, 1.0), min_size=1, max_size=40))
def test_the_mode_is_the_middle_of_the_highest_bar(values: list[float]) -> None:
    found = comparison(np.array(values))
    shares, edges = report_pictures.bars_shown(found)
    (fullest,) = np.flatnonzero((edges[:-1] < found.mode) & (found.mode < edges[1:]))
    assert shares[fullest] == shares.max()
    assert found.mode == pytest.approx((edges[fullest] + edges[fullest + 1]) / 2)


def test_the_histogram_shows_its_shares() -> None:
    dice = np.random.default_rng(4)
    found = comparison(np.clip(1.0 - dice.exponential(0.1, 400), -0.1, 0.9999))
    drawn = report_pictures.correlation_histogram(found)
    parsed(drawn)
    bars = re.findall(
        r'<rect class="(h\d)" x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"><title>(.*?) to ([\d.]+): ([\d.]+) %',
        drawn,
    )
    shares = 100.0 * report_pictures.bars_shown(found)[0]
    assert len(bars) == np.count_nonzero(shares)
    assert sum(float(bar[-1]) for bar in bars) == pytest.approx(100.0, abs=0.3)
    tallest = max(bars, key=lambda bar: float(bar[-1]))
    for css, x, y, width, height, low, high, share in bars:
        assert float(height) / float(tallest[4]) == pytest.approx(
            float(share) / float(tallest[-1]), abs=0.01
        )
        assert float(y) + float(height) == pytest.approx(220.0, abs=0.11)
        assert float(x) == pytest.approx((float(low) + 0.2) / 1.2 * 420, abs=0.6)
        assert float(x) + float(width) == pytest.approx((float(high) + 0.2) / 1.2 * 420, abs=0.6)
        assert css == ("h9" if float(low) >= 0.9 else "h7" if float(low) >= 0.7 else "h0")
    assert f"{100 * found.share_above(0.9):.1f} % above 0.9<" in drawn
    assert f"{100 * found.share_above(0.7):.1f} % above 0.7<" in drawn
    (mode_x,) = re.findall(r'class="mode" d="M([\d.]+) ', drawn)
    assert float(mode_x) == pytest.approx((found.mode + 0.2) / 1.2 * 420, abs=0.06)
    assert f">mode {found.mode:.3f}<" in drawn


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30))
def test_the_highest_bar_fits_below_a_named_line(values: list[float]) -> None:
    drawn = report_pictures.correlation_histogram(comparison(np.array(values)))
    heights = [float(h) for h in re.findall(r'height="([\d.]+)"><title>', drawn)]
    assert 110.0 <= max(heights) <= 220.1
    lines = re.findall(r'M0 ([\d.]+)H420"/><text class="end" x="-7" y="[\d.]+">([\d.e+]+)<', drawn)
    top = max(float(name) for _, name in lines)
    share = 100.0 * report_pictures.bars_shown(comparison(np.array(values)))[0].max()
    assert top >= share * (1 - 1e-6)
    assert max(heights) == pytest.approx(220.0 * share / top, abs=0.06)
    assert 3 <= len(lines) <= 7
    names = [float(y) for y in re.findall(r'<text class="name" x="31" y="([\d.]+)"', drawn)]
    for x, y in re.findall(r'<rect class="h\d" x="([\d.]+)" y="([\d.]+)" [^>]*><title>', drawn):
        assert float(x) > 160.0 or float(y) > max(names)  # bars are below them, or beside


def test_colours_change_at_their_limits() -> None:
    boxes = re.findall(r'<rect fill="(rgb[^"]*)"', report_pictures.colour_scale())
    classes = [
        (-1.0, 0),
        (0.0, 0),
        (0.01, 1),
        (0.3, 1),
        (0.69, 3),
        (0.7, 3),
        (0.71, 4),
        (0.9, 5),
        (0.91, 6),
        (0.951, 7),
        (1.0, 7),
    ]
    for value, k in classes:
        assert report_pictures.correlation_class(value) == k
        assert boxes[k] == f"rgb{report_pictures.COLOURS[k]}"


def test_the_map_has_one_pixel_a_window() -> None:
    dice = np.random.default_rng(6)
    image, render = dice.normal(size=(2, 70, 90))
    weight = np.ones((70, 90))
    weight[:30, :30] = 0.0
    found = compare(image, render, weight, gsd_m=1.0)
    pixels = report_pictures.correlation_pixels(found)
    assert pixels.shape == (4, 5, 4)
    assert np.count_nonzero(pixels[..., 3]) == found.count < 20
    for row, col, value in zip(found.row, found.col, found.correlation, strict=True):
        colour = report_pictures.COLOURS[int(report_pictures.correlation_class(value))]
        assert tuple(pixels[row // 16, col // 16]) == (*colour, 255)


@pytest.mark.parametrize(
    ("step", "left", "wide"), [(16, 16.0, 96.0), (8, 20.0, 88.0), (32, 8.0, 112.0)]
)
def test_the_map_lies_where_its_windows_do(step: int, left: float, wide: float) -> None:
    """Windows that begin at columns 16 to 96: each pixel covers one step around the centre of its
    window.
    """
    cols = np.arange(16, 97, step)
    ones = np.ones(len(cols))
    rows = np.zeros(len(cols), np.int64)
    found = WindowComparison(16, step, 1.0, rows, cols, ones, ones, ones, "kept")
    drawn = report_pictures.correlation_map(ImageDrawing(480, 240), found, "data:,")
    wanted = re.search(r'x="([-\d.]+)" y="([-\d.]+)" width="([\d.]+)" height="([\d.]+)"', drawn)
    x, _, width, height = (float(value) / 2.0 for value in wanted.groups())
    assert (x, width, height) == pytest.approx((left, (len(cols) - 1) * step + step, step))
    middles = x + (np.arange(len(cols)) + 0.5) * width / len(cols)
    np.testing.assert_allclose(middles, cols + 8.0)
    assert wide == pytest.approx(width) or step != 16


def test_every_class_of_a_drawing_has_a_rule() -> None:
    image = verdicts.image()
    drawn = (
        report_pictures.correlation_histogram(image.windows.compared)
        + report_pictures.colour_scale()
    )
    legend = report_pictures.reason_key([(reason, 1) for reason in REASONS], MEANINGS)
    drawn += "".join(entry["symbol"] for entry in legend)
    used = {
        name for names in re.findall(r'class=["\']([^"\']*)["\']', drawn) for name in names.split()
    }
    assert {name for name in used if f".{name}" not in STYLE} == set()
