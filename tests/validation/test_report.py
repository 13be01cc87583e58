"""The validation page: no outside references, every part with data, no text that becomes markup."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import verdicts
from helpers.pages import Page, beyond_paper, decoded, in_browser, measured, parsed

from lcp_catalog.plots.pictures import PIXELS_MAX, grey
from lcp_catalog.validation import report as page_of
from lcp_catalog.validation import report_pictures, result
from lcp_catalog.validation.advice import EncodingCheck
from lcp_catalog.validation.ground_comparison import of_patches
from lcp_catalog.validation.report import render
from lcp_catalog.validation.result import Pictures

BYTES_MAX = 5_000_000
"""Largest size of a page per image."""


@pytest.fixture(scope="module")
def html() -> str:
    return render(verdicts.whole(), [verdicts.pictures(), Pictures(), Pictures()])


def alone(image: result.ImageVerdict, shown: Pictures | None = None) -> str:
    """A page of one image, checked for valid nesting."""
    html = render(
        result.ValidationResult((image,), {"name": "c.h5"}, {}), [shown or verdicts.pictures()]
    )
    parsed(html)
    return html


def texts(html: str) -> str:
    """The visible text."""
    body = html[html.index("<body>") : html.index("<script>")]
    return re.sub(r"<[^>]*>", " ", body)


def pictures_of(page: Page) -> list[np.ndarray]:
    return [decoded(a) for a in page.addresses if a.startswith("data:")]


def test_the_page_refers_to_nothing_outside(html: str) -> None:
    page = parsed(html)
    assert all(a.startswith(("data:image/png;base64,", "#")) for a in page.addresses)
    assert not re.search(r"url\(|@import|https?://|//cdn|<link|<iframe", html)


def test_what_the_page_refers_to_it_holds(html: str) -> None:
    page = parsed(html)
    assert len(page.ids) == len(set(page.ids))
    wanted = {a[1:] for a in page.addresses if a.startswith("#")}
    wanted |= {attrs["for"] for tag, attrs in page.elements if tag == "label"}
    assert {"image-0", "image-1", "look-0-0"} <= wanted <= set(page.ids)


def test_the_pictures_are_those_given(html: str) -> None:
    image, render_, windows, under, photo = pictures_of(parsed(html))
    shown = verdicts.pictures()
    given = grey(shown.ground_image, shown.ground_render)
    np.testing.assert_array_equal(image[..., [0, 3]], given)
    np.testing.assert_array_equal(
        render_[..., 0], grey(shown.ground_render, shown.ground_image)[..., 0]
    )
    assert (image[:9, :17, 3] == 0).all()
    np.testing.assert_array_equal(under[..., 0], grey(shown.ground_image)[..., 0])
    assert photo.shape[:2] == shown.image.shape
    wanted = report_pictures.correlation_pixels(verdicts.image().windows.compared)
    np.testing.assert_array_equal(windows[..., [2, 1, 0, 3]], wanted)


def test_the_photo_covers_its_blocks(html: str) -> None:
    """Half as many pixels, drawn over the whole image; a column that is not a whole block stays
    empty.
    """
    *_, photo = re.findall(r'<image href="[^"]*" width="([\d.]+)" height="([\d.]+)"', html)
    assert photo == ("960.0", "720.0")
    image = verdicts.image()
    odd = replace(image, facts=replace(image.facts, width_px=641))
    *_, photo = re.findall(r'<image href="[^"]*" width="([\d.]+)" height="([\d.]+)"', alone(odd))
    assert photo == (f"{640 / 641 * 960:.1f}", f"{480 / 641 * 960:.1f}")


def test_points_are_marked_where_they_are() -> None:
    """At the prediction of the corrected sensor; without a pose at that of the given one."""
    for located in (True, False):
        image = verdicts.image(located=located)
        html = alone(image)
        places = image.points.corrected_px if located else image.matches.predicted_px
        scale = 960.0 / verdicts.WIDTH
        weak = image.matches.code == 7
        assert weak.any()
        for column, row in (places[weak] + 0.5) * scale:
            assert f'<g transform="translate({column:.1f} {row:.1f})"><g class="mark">' in html


def test_arrows_are_the_residuals() -> None:
    image = verdicts.image()
    html = alone(image)
    times = float(re.search(r"px; arrows magnified ([\d.]+) times", html)[1])
    found = image.matches.found
    start = (image.points.corrected_px[found] + 0.5) * 1.5
    ends = start + image.residual_px[found] * 1.5 * times
    shown = set(re.findall(r'd="(M[-\d.]+ [-\d.]+L[-\d.]+ [-\d.]+)', html))
    for (x, y), (to_x, to_y) in zip(start, ends, strict=True):
        assert f"M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}" in shown
    counts = [int(n) for n in re.findall(r"<b class='(?:within.|beyond3)'>[^<]*</b> (\d+)", html)]
    assert sum(counts) == found.sum()


def test_every_drawing_has_axes() -> None:
    """In kilometres of the terrain grid, 128 x 96 cells of 948 m; in pixels of the image."""
    html = alone(verdicts.image())
    *grounds, photo = re.findall(r'<svg class="over".*?</svg>', html, re.S)
    assert len(grounds) == 4
    for drawing in grounds:
        (at,) = re.findall(r'<text class="middle" x="([\d.]+)"[^>]*>100 km<', drawing)
        assert float(at) == pytest.approx(100 / 0.948 * 960 / 128, abs=0.06)
        assert re.search(r'<text class="end" x="-12" y="0.0"[^>]*>0 km<', drawing)
    assert re.search(r'<text class="middle" x="900.0"[^>]*>600 px<', photo)  # of 640
    assert re.search(r'<text class="end" x="-12" y="600.0"[^>]*>400<', photo)


def test_windows_that_correlate_say_where_they_lie() -> None:
    image = verdicts.image()
    w, html = image.windows.compared, alone(image)
    times = float(re.search(r"cells; arrows magnified ([\d.]+) times", html)[1])
    start = (
        (np.stack([w.col, w.row], axis=-1) + 8.0) * 960 / 128
    )  # 128 columns; the middle of 16 cells
    ends = start + w.offset_px * 960 / 128 * times
    sure = (w.correlation > 0.7) & np.isfinite(w.offset_px).all(axis=1)
    assert 5 < np.count_nonzero(sure) < w.count
    for (x, y), (to_x, to_y), drawn in zip(start, ends, sure, strict=True):
        assert (f'd="M{x:.1f} {y:.1f}L{to_x:.1f} {to_y:.1f}' in html) == drawn
    above = np.count_nonzero(w.correlation > 0.7)
    assert f"is above 0.7: {above} of {w.count} windows." in html


def test_the_caption_counts_all_windows_and_those_without_an_offset() -> None:
    image = verdicts.image()
    w = image.windows.compared
    offsets, correlation = np.full_like(w.offset_px, np.nan), np.full(w.count, 0.2)
    correlation[3:7], offsets[5] = 0.8, 0.5
    odd = replace(w, offset_px=offsets, correlation=correlation)
    html = alone(replace(image, windows=replace(image.windows, compared=odd)))
    assert (
        f"is above 0.7: 4 of {w.count} windows. Offsets of 3 of these lie beyond the search and are"
        " not drawn." in html
    )


def test_what_the_histogram_cannot_tell_its_caption_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_pictures, "MOST_BELOW", 0.2)
    image = verdicts.image()
    w = image.windows.compared
    assert "which the first bar includes" not in alone(image)
    odd = w.correlation.copy()
    odd[:5], odd[5:8], odd[8] = -0.5, 0.0, -0.1
    html = alone(
        replace(image, windows=replace(image.windows, compared=replace(w, correlation=odd)))
    )
    assert (
        "whose correlation is set to 0: 3. Windows below -0.2, which the first bar includes: 5."
        in html
    )


def test_windows_are_told_with_and_without_smoothing() -> None:
    image = verdicts.image()
    w = image.windows.compared
    plain = replace(w, correlation=np.where(np.arange(w.count) < w.count // 4, 0.95, 0.85))
    text = texts(alone(replace(image, windows=replace(image.windows, plain=plain))))
    share = 100.0 * (w.correlation > 0.9).mean()
    text = " ".join(text.split())
    assert f"{share:.1f} % of {w.count} windows of 16 x 16 cells, smoothed, correlate" in text
    assert f"above 0.9; without smoothing {100.0 * (w.count // 4) / w.count:.1f} %" in text
    assert "Image and render are smoothed by two cells" in text


def test_without_a_pose_arrows_are_offsets_and_there_is_no_pose() -> None:
    image = verdicts.image(located=False)
    html = alone(image)
    assert "from the position predicted by the given camera" in html
    assert "Pose" not in texts(html)
    assert "No windows were compared: without a place there is nothing to compare." in html
    first = np.flatnonzero(image.matches.found)[0]
    x, y = (image.matches.predicted_px[first] + 0.5) * 1.5
    assert f'd="M{x:.1f} {y:.1f}L' in html


def test_a_lower_sun_is_named_as_such() -> None:
    image = verdicts.whole().images[0]
    sun = replace(image.located.sun, turns_deg=((-20.0, 0.0), (0.0, -10.0)))
    html = alone(replace(image, located=replace(image.located, sun=sun)))
    assert "0.625 (turned -20°), – (lowered 10°)" in texts(html)


def test_the_figures_of_the_verdict_are_told(html: str) -> None:
    whole, text = verdicts.whole(), texts(html)
    image = whole.images[0]
    found = whole.document()["images"][0]
    assert f"{found['points_found']} of 60" in text
    assert "points in view were found" in text
    assert f"{result.number(found['offset_px']['median'])} px" in text
    assert f"{100 * found['windows']['share_above_0_9']:.1f} % above 0.9" in text
    assert f"{result.number(found['pose']['position_sigma_m'])} m" in text
    assert f"{result.number(found['pose']['position_error_m'])} m from the true position" in text
    assert (
        "fits: median correlation 0.9; with the Sun elsewhere 0.625 (turned -20°), – (raised 10°)"
        in text
    )
    for reason, count in image.matches.counts().items():
        assert re.search(rf"\b{reason}\s+{count}:", text)
    for word in result.VERDICTS:
        assert word in text
    turn = image.pose.pose.correction[3] * 180 * 3600 / np.pi
    assert f"{result.number(turn).replace('-', '−')} ″" in text
    assert not re.search(r"\b(nan|inf|None)\b", text)


def test_the_law_under_which_the_sun_was_judged_is_told() -> None:
    image = verdicts.image()
    assert "which fits the image better" not in texts(alone(image))
    light = replace(image.located.sun, law="hapke")
    other = replace(image, located=replace(image.located, sun=light))
    assert "fits (rendered with hapke, which fits the image better)" in texts(alone(other))
    assert (
        result.ValidationResult((other,), {}, {}).document()["images"][0]["light"]["law"] == "hapke"
    )


def test_the_check_of_the_encoding_is_told() -> None:
    image = verdicts.image()
    assert "<dt>encoding</dt>" not in alone(image)
    check = EncodingCheck("linear", 100, 0.803, 0.824, 0.72, 3.8)
    html = alone(replace(image, encoding=check))
    assert f"<dt>encoding</dt><dd>{check.sentence}</dd>" in html
    assert check.sentence.startswith(
        "samples taken as linear, but fit better as sRGB (encoding auto"
    )
    figures = (
        "median correlation 0.824 as sRGB (codes of a display image), 0.803 as linear values; "
        "72 % of 100 points correlate better as sRGB (mean gain of 3.8 sigma)"
    )
    assert check.sentence.endswith(f": {figures}")


@pytest.mark.parametrize(
    ("used", "sigmas", "said"),
    [
        ("srgb", 3.8, "decoded as sRGB, which fits better: "),
        ("srgb", 1.2, "decoded as sRGB: only so the image was located: "),
        ("linear", 1.2, "taken as linear; sRGB does not fit better: "),
    ],
)
def test_an_encoding_is_advised_only_where_it_fits_better(
    used: str, sigmas: float, said: str
) -> None:
    sentence = EncodingCheck(used, 100, 0.803, 0.824, 0.72, sigmas).sentence
    assert sentence.startswith(f"samples {said}median correlation")
    assert "auto" not in sentence


def test_the_table_has_every_point(html: str) -> None:
    image = verdicts.image()
    table = alone(image).split("<table class='sortable'>")[1].split("</table>")[0]
    rows = [
        re.findall(r"<td>(.*?)</td>", row) for row in table.split("<tbody>")[1].split("<tr")[1:]
    ]
    assert len(rows) == 60
    assert [int(row[0]) for row in rows] == image.points.point_id.tolist()
    i = int(np.flatnonzero(image.matches.found)[0])
    column, line = image.matches.found_px[i]
    assert rows[i][4] == f"{column:.2f}, {line:.2f}"
    assert rows[i][5] == f"{np.linalg.norm(image.residual_px[i]):.3f}"
    claimed = image.claims.probability
    assert rows[i][10] == (f"{claimed[i]:.2f}" if math.isfinite(claimed[i]) else "–")
    assert {row[10] for row in rows} > {"–"}
    assert rows[i][11] == "found"
    lost = int(np.flatnonzero(image.matches.code == 7)[0])
    assert rows[lost][4:7] == ["–", "–", "–"]
    assert len(re.findall("<th scope='col'><button", table)) == len(rows[0])


@pytest.mark.slow
def test_the_reliability_diagram_shows_every_bin_with_trials() -> None:
    """Marks at the predicted and observed share, a bar from limit to limit, and the counts."""
    images = verdicts.image(n=400), verdicts.image("other.png", n=200, seed=4)
    verdict = result.ValidationResult(images, {"name": "c.h5"}, {})
    html = render(verdict, [Pictures(), Pictures()])
    parsed(html)
    part = html.split("<section id='claims'>")[1].split("</section>")[0]
    side = 330.0
    marks = re.findall(
        r'<path d="M([\d.]+) ([\d.]+)V([\d.]+)"/><circle cx="([\d.]+)" cy="([\d.]+)" r="4.5"/>'
        r'<text class="middle" x="[\d.]+" y="-7">(\d+)</text>',
        part,
    )
    rows = [row for row in verdict.document()["claims"]["reliability"] if row[2]]
    assert len(marks) == len(rows) >= 6
    for mark, (_, _, count, predicted, observed) in zip(marks, rows, strict=True):
        x, low, high, cx, cy, shown = map(float, mark)
        assert x == cx == pytest.approx(side * predicted, abs=0.051)
        assert cy == pytest.approx(side * (1.0 - observed), abs=0.051)
        assert high <= cy <= low
        assert low - high > 0.0
        assert shown == count
    cells = re.findall(r"<td>(.*?)</td>", part)
    assert len(cells) == 3 * 7
    together = verdict.document()["claims"]
    assert cells[14] == str(together["count"])
    assert cells[15] == f"{100 * together['found_of_usable']:.1f} % of {together['usable']}"


def test_claims_that_were_not_scored_say_why() -> None:
    said = texts(alone(verdicts.image(located=False)))
    assert "The claims were not scored: the image was not located." in said
    assert "reliability diagram" not in said
    mixed = render(verdicts.whole(), [Pictures()] * 3)
    assert "<td class='reason' colspan='7'>the image was not located</td>" in mixed


def test_a_long_table_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_of, "ROWS_MAX", 10)
    html = alone(verdicts.image())
    assert len(re.findall(r"<tr class='(?:is|not)-found'", html)) == 10
    assert "Table of the 60 points in view. The first 10 are shown; the CSV file has all." in html


@pytest.mark.slow
@in_browser
@pytest.mark.parametrize("width", [400, 1200])
def test_texts_are_at_least_11_pixels_high(html: str, width: int, tmp_path: Path) -> None:
    found = measured(html, width, tmp_path)
    assert found["texts"] > 200
    assert found["smallest"][0][0] >= 11.0
    assert found["wide"] <= 0


@pytest.mark.slow
@in_browser
def test_tables_fit_on_paper(html: str, tmp_path: Path) -> None:
    assert beyond_paper(html, tmp_path) <= 0.0


def test_every_drawing_has_a_name(html: str) -> None:
    drawings = [attrs for tag, attrs in parsed(html).elements if tag == "svg"]
    assert len(drawings) > 15
    assert all(attrs.get("aria-label") or attrs.get("aria-hidden") == "true" for attrs in drawings)


def test_every_class_has_a_rule(html: str) -> None:
    style = html[html.index("<style>") : html.index("</style>")]
    used = {name for _, attrs in parsed(html).elements for name in attrs.get("class", "").split()}
    plain = {"within2", "cannot-say", "is-found", "for-side", "for-image", "for-render", "for-blink",
             "for-correlation", "frame", "to-side"}  # fmt: skip
    assert {name for name in used - plain if f".{name}" not in style} == set()


def test_ways_to_look_need_no_script(html: str) -> None:
    """One radio button per view, the first checked, and a rule for each."""
    page = parsed(html)
    radios = [attrs for _, attrs in page.elements if attrs.get("type") == "radio"]
    assert [attrs["class"] for attrs in radios] == [
        "to-side", "to-image", "to-render", "to-blink", "to-swipe", "to-correlation",
    ]  # fmt: skip
    assert [("checked" in attrs) for attrs in radios] == [True] + [False] * 5
    for layer in ("image", "render", "correlation"):
        assert f".to-{layer}:checked~.stack .{layer}" in html
        assert f"<figure class='layer {layer}'>" in html
    assert "animation: blink" in html


def test_what_is_chosen_outweighs_what_hides(html: str) -> None:
    """CSS specificity: first the number of classes and states, then of elements, then the order."""
    style = html[html.index("<style>") : html.index("</style>")]
    rules = re.findall(r"([^{}]+)\{[^{}]*visibility: (hidden|visible)(?!!)", style)
    ranks = [
        (word, len(re.findall(r"[.:](?!not)", one)), len(re.findall(r"(?:^|[>~ (])[a-z]", one)), at)
        for at, (selectors, word) in enumerate(rules)
        for one in selectors.strip().split(",")
    ]
    hidden = [rank[1:] for rank in ranks if rank[0] == "hidden"]
    shown = [rank[1:] for rank in ranks if rank[0] == "visible"]
    assert len(hidden) == 1
    assert len(shown) == 7
    assert min(shown) > max(hidden)


def test_texts_cannot_become_markup() -> None:
    bad = "<script>alert('1')&\"</script>"
    name = bad.replace("/", "|")
    image = verdicts.image(name)
    image = replace(
        image,
        facts=replace(image.facts, sensor=bad, sun_from=bad),
        located=replace(image.located, reason=bad),
        windows=replace(image.windows, resolution=bad, against=bad),
    )
    lost = replace(verdicts.nothing(name), windows_reason=bad)
    whole = result.ValidationResult((image, lost), {"name": bad, bad: bad}, {bad: [bad]})
    html = render(whole, [verdicts.pictures(), Pictures()])
    parsed(html)
    assert html.count("<script>") == 1
    assert "alert('1')" not in html


def test_equal_verdicts_are_equal_pages(html: str) -> None:
    again = render(verdicts.whole(), [verdicts.pictures(), Pictures(), Pictures()])
    assert again == html


@pytest.mark.slow
def test_large_pictures_do_not_make_large_pages() -> None:
    """Noise compresses worst."""
    dice = np.random.default_rng(8)
    noise = dice.normal(size=(1800, 2400)).astype(np.float32)
    html = alone(verdicts.image(), Pictures(noise, 1, noise, noise[::-1]))
    assert len(html) < BYTES_MAX
    image, _, _, under, photo = pictures_of(parsed(html))
    assert under.shape[0] * under.shape[1] <= report_pictures.UNDER_PIXELS
    assert 0.9 * PIXELS_MAX < image.shape[0] * image.shape[1] <= PIXELS_MAX
    assert photo.shape == image.shape


def test_without_pictures_there_are_still_figures() -> None:
    html = alone(verdicts.image(), Pictures())
    assert "data:" not in html
    assert "histogram of the correlation" in html
    assert "<figure class='layer" not in html


def of_patches_alone(count: int) -> tuple[result.ImageVerdict, Pictures]:
    """Patches with increasing noise."""
    dice = np.random.default_rng(9)
    renders = dice.normal(size=(count, 36, 36))
    noise = dice.normal(size=renders.shape) * np.linspace(0.01, 2.0, count)[:, None, None]
    compared = of_patches(renders + noise, renders, gsd_m=60.0)
    windows = replace(verdicts.figures_of(compared), point_id=7000 + compared.patch)
    return replace(verdicts.image(), windows=windows), Pictures(None, 1, renders + noise, renders)


def test_patches_are_shown_in_pairs_from_worst_to_best() -> None:
    image, shown = of_patches_alone(40)
    html = alone(image, shown)
    assert "<figure class='layer" not in html
    assert "18 of 40 patches" in html
    pairs = re.findall(r"<figcaption>([-\d.]+) (\d{4})</figcaption>", html)
    w = image.windows.compared
    medians = {7000 + k: np.median(w.correlation[w.patch == k]) for k in range(40)}
    worst_first = sorted(medians, key=medians.get)
    assert len(pairs) == 18
    assert [int(pairs[0][1]), int(pairs[-1][1])] == [worst_first[0], worst_first[-1]]
    for median, point in pairs:
        assert median == f"{medians[int(point)]:.3f}"
    first = pictures_of(parsed(html))[0]
    k = worst_first[0] - 7000
    np.testing.assert_array_equal(first[..., 0], grey(shown.ground_image[k])[..., 0])


def test_patches_without_pictures_have_a_histogram() -> None:
    image, _ = of_patches_alone(3)
    html = alone(image, Pictures())
    assert "histogram of the correlation of 12 windows" in html
    assert "data:" not in html


def test_nothing_at_all_has_a_page() -> None:
    text = texts(alone(verdicts.nothing(), Pictures()))
    assert "No control point is in view." in text
    assert "cannot say" in text
    assert "no point is in view" in text
    assert "<h2>All images</h2>" not in alone(verdicts.nothing(), Pictures())
    assert not re.search(r"\b(nan|inf|None)\b", text)


def test_of_an_image_that_was_not_opened_only_the_reason_is_told() -> None:
    text = texts(alone(verdicts.unopened(), Pictures())).split("lost.png")[-1]
    said = text.split("Claims of the catalogue")[0]
    assert said.split() == ["cannot", "say", "missing", "geometry"]


def test_points_and_pictures_belong_together() -> None:
    with pytest.raises(ValueError, match="zip"):
        render(verdicts.whole(), [Pictures()])
