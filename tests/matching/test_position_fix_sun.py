"""The Sun in the search for a position: one that is wrong is noticed, on synthetic terrain."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers import small_world
from helpers.posed import spread_px2
from helpers.small_world import LAW, UNCERTAIN, believed, overhead
from helpers.suns import far_light, light

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.images.image import Image
from lcp_catalog.matching.fix import CANNOT_SAY, LOCATED
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_choice import PointClaims, points_in_view
from lcp_catalog.matching.point_search import Criteria, FoundPlaces, SearchImage, find_points
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.matching.sun_check import MatchedPoints, with_sun
from lcp_catalog.matching.sun_verdict import FAR_TURNS_DEG, SunCheck

QUICK = Options(check_sun=False)
WHOLE = Options(whole_sun_check=True)


@pytest.fixture(scope="module")
def points() -> Catalog:
    return small_world.world().catalog()


@pytest.fixture(scope="module")
def photo() -> Image:
    return small_world.world().photo(overhead())


@pytest.mark.parametrize(
    "turn", [-10.0, 20.0, *(pytest.param(t, marks=pytest.mark.slow) for t in (-20.0, 10.0))]
)
def test_a_sun_that_is_wrong_is_noticed(points: Catalog, photo: Image, turn: float) -> None:
    lied = with_sun(believed(photo), points.position_mcmf, turn, 0.0)
    answer = locate(points, lied, UNCERTAIN, LAW)
    assert answer.verdict == CANNOT_SAY
    assert answer.pose is None
    assert f"turned by {-turn:+.0f} deg" in answer.reason


def test_the_right_sun_fits_best(points: Catalog, photo: Image) -> None:
    rows = points_in_view(points, photo.sensor)
    check = MatchedPoints(
        points, SearchImage.of(photo), LAW, rows, np.zeros((len(rows), 2)), Criteria()
    ).check()
    assert check.fits
    assert check.complaint == ""
    assert check.correlation > max(check.correlations)
    assert check.points == len(rows)


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.0, 15.0])
def test_a_glance_ends_the_check_only_under_the_right_sun(
    points: Catalog, photo: Image, turn: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the law of the image alone: by Hapke's a lower Sun is as good."""
    if not turn:
        doubted = locate(points, believed(photo), UNCERTAIN, LAW)
        assert doubted.sun == locate(points, believed(photo), UNCERTAIN, LAW, WHOLE).sun
    monkeypatch.setattr("lcp_catalog.matching.sun_check.LAWS", ())
    given = with_sun(believed(photo), points.position_mcmf, turn, 0.0)
    glanced, whole = (locate(points, given, UNCERTAIN, LAW, o) for o in (Options(), WHOLE))
    assert (glanced.verdict, glanced.reason) == (whole.verdict, whole.reason)
    assert glanced.sun is not None
    assert whole.sun is not None
    if turn:
        assert glanced.sun == whole.sun
    else:
        assert (glanced.sun.points, glanced.sun.doubt_px, whole.sun.doubt_px) == (24, 0.0, 0.0)
        assert whole.sun.points > 24
        assert np.array_equal(glanced.pose.covariance, whole.pose.covariance)


def test_a_glance_finds_what_a_search_finds(points: Catalog, photo: Image) -> None:
    """Correlations and places under three Suns, by the fit alone and by the whole search."""
    rows = points_in_view(points, photo.sensor)[::3]
    found = find_points(points, photo, LAW, 8.0, points=rows)
    rows, off = rows[found.found], (found.found_px - found.predicted_px)[found.found]
    known = FoundPlaces.of(points, SearchImage.of(photo), rows, off, Criteria())
    for turn, up in ((0.0, 0.0), (20.0, 0.0), (0.0, 10.0)):
        moved = with_sun(photo, points.position_mcmf[rows], turn, up)
        correlation, place = known.under(moved, LAW)
        again = find_points(points, moved, LAW, 3.0, points=rows, offset_px=off)
        np.testing.assert_allclose(correlation, again.correlation, atol=2e-4)
        np.testing.assert_allclose(place, again.found_px, atol=0.02)


def test_an_image_is_prepared_once_for_all_its_searches(
    points: Catalog, photo: Image, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the Sun is checked; what a coarse search prepares is a reduced image."""
    prepared, of = [], SearchImage.of

    def counted(image: Image) -> SearchImage:
        prepared.append(image.signal.shape)
        return of(image)

    monkeypatch.setattr(SearchImage, "of", counted)
    assert locate(points, believed(photo), UNCERTAIN, LAW, WHOLE).verdict == LOCATED
    assert prepared.count(photo.signal.shape) == 1


def torn(photo: Image) -> Image:
    """The image with a gap of 5 x 5 pixels in every 30 x 30, one in two of NaN."""
    signal, weight = photo.signal.copy(), photo.weight.copy()
    rows, cols = np.indices(signal.shape) // 30
    gap = (np.indices(signal.shape) % 30 < 5).all(axis=0)
    signal[gap & ((rows + cols) % 2 == 0)] = np.nan
    weight[gap] = 0.0
    return replace(photo, signal=signal, weight=weight)


def test_places_are_searched_again_as_all_points_are(points: Catalog, photo: Image) -> None:
    """Under other Suns, one of them low, bit by bit; with the brightness to a power as in an
    image of that power, gaps filled alike, to rounding.
    """
    photo = torn(photo)
    rows = points_in_view(points, photo.sensor)[::3]
    off = np.random.default_rng(2).normal(0.0, 1.0, (len(rows), 2))
    known = FoundPlaces.of(points, SearchImage.of(photo), rows, off, Criteria(), 1.0)
    for turn, up in ((0.0, 0.0), (20.0, 0.0), (0.0, -60.0)):
        moved = with_sun(photo, points.position_mcmf[rows], turn, up)
        again = find_points(points, moved, LAW, 1.0, points=rows, offset_px=off)
        correlation, place = known.under(moved, LAW)
        np.testing.assert_array_equal(correlation, np.nan_to_num(again.correlation))
        np.testing.assert_array_equal(place, again.found_px)
        assert np.isnan(again.correlation).any()  # at the edge, or in the dark
        assert np.isfinite(again.correlation).any()
    for power in (0.45, 2.2):
        signal = np.maximum(photo.signal, 0.0) ** np.float32(power)
        bent = replace(photo, signal=signal.astype(np.float32))
        again = find_points(points, bent, LAW, 1.0, points=rows, offset_px=off)
        correlation, place = known.to_power(power).under(photo, LAW)
        np.testing.assert_allclose(correlation, np.nan_to_num(again.correlation), atol=1e-6)
        np.testing.assert_allclose(place, again.found_px, atol=1e-4)


def test_a_preferred_sun_is_a_doubt_about_the_place(
    points: Catalog, photo: Image, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pose's covariance grows by the effect of a shift of all matches; the pose is the same."""
    plain = locate(points, believed(photo), UNCERTAIN, LAW, QUICK)
    monkeypatch.setattr(MatchedPoints, "check", lambda *_: light(0.9, gain=0.02))
    doubted = locate(points, believed(photo), UNCERTAIN, LAW, WHOLE)
    assert doubted.verdict == LOCATED
    assert np.array_equal(doubted.pose.correction, plain.pose.correction)
    assert (doubted.pose.sigma > plain.pose.sigma).all()
    middle = points.position_mcmf[[len(points) // 2]]
    before, after = (
        spread_px2(photo.sensor, middle, a.pose.covariance)[0] for a in (plain, doubted)
    )
    assert np.allclose(np.diag(after - before), 0.4**2, rtol=0.3)


@pytest.mark.parametrize(("few", "verdict"), [(0.5, LOCATED), (1.0, CANNOT_SAY)])
def test_where_few_agree_far_suns_are_tried(
    points: Catalog, photo: Image, monkeypatch: pytest.MonkeyPatch, few: float, verdict: str
) -> None:
    """The near Suns are all worse; one of the far ones is better. More than half of the points agree."""
    asked = []

    def better(*how: Any) -> SunCheck:
        asked.append(how[-1])
        return replace(far_light(1.0, gain=0.1), correlations=(0.4, 0.9, 0.9))

    monkeypatch.setattr(MatchedPoints, "check", better)
    monkeypatch.setattr(MatchedPoints, "glance", lambda *_: light(0.1))
    monkeypatch.setattr("lcp_catalog.matching.position_fix._FEW", few)
    answer = locate(points, believed(photo), UNCERTAIN, LAW)
    assert answer.verdict == verdict
    assert asked == ([FAR_TURNS_DEG] if verdict == CANNOT_SAY else [])
    assert ("turned by -90 deg" in answer.reason) == (verdict == CANNOT_SAY)


def test_the_sun_is_held_against_all_points_that_agree(
    points: Catalog, photo: Image, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of high Suns few are usable, and few say little about the Sun; the pose is solved with those."""
    claims, asked = PointClaims.of, []

    def some_usable(catalog: Catalog, rows: np.ndarray, *how: object) -> PointClaims:
        known = np.full(len(rows), 0.6)
        return replace(claims(catalog, rows, *how), probability=known, usable=rows % 3 == 0)

    def check(given: MatchedPoints, *_: Any) -> SunCheck:
        asked.append(len(given.rows))
        return light(0.1)

    monkeypatch.setattr(PointClaims, "of", some_usable)
    monkeypatch.setattr(MatchedPoints, "check", check)
    answer = locate(points, believed(photo, 3), UNCERTAIN, LAW, WHOLE)
    assert asked == [answer.matches.found.sum()]
    assert answer.pose.used.sum() < 0.5 * asked[0]


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.0, 120.0, 180.0, -135.0])
def test_a_sun_is_told_from_far_ones(points: Catalog, photo: Image, turn: float) -> None:
    rows = points_in_view(points, photo.sensor)
    lied = with_sun(photo, points.position_mcmf[rows], turn, 0.0)
    matched = MatchedPoints(
        points, SearchImage.of(lied), LAW, rows, np.zeros((len(rows), 2)), Criteria()
    )
    check = matched.check(turns_deg=FAR_TURNS_DEG)
    assert check.fits == (turn == 0.0)
