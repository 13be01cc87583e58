"""Check of the stated Sun: correlations under other Suns, from synthetic correlations, and when
another Sun is preferred.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.lone_hill import EAST, HERE, above_it, bump_catalog, plain_photo
from helpers.match_frames import LAW
from helpers.suns import far_light, light
from helpers.twins_match import catalog_of_patches

from lcp_catalog.geometry.frames import azimuth_elevation
from lcp_catalog.matching.point_search import Criteria, SearchImage
from lcp_catalog.matching.sun_check import MatchedPoints, best_turn, with_sun
from lcp_catalog.matching.sun_verdict import TURNS_DEG, SunCheck, near_or_far


def test_when_a_sun_is_preferred_and_when_it_is_refused() -> None:
    """25 independent points: one half and two sigmas of 0.1 is 0.7."""
    assert light(0.71).preferred == 1
    assert light(0.69).preferred is None
    assert light(0.95, points=4).preferred is None
    assert light(0.71, independent=10.0).preferred is None
    assert light(0.95, gain_z=-0.1).preferred is None
    assert not light(0.71).fits
    assert light(0.69).fits
    assert light(0.95, gain=0.02).fits
    assert not light(0.95, gain=0.02, gain_z=0.26).fits
    assert light(0.71).doubt_px == light(0.71, gain=0.02).doubt_px == 0.4
    assert light(0.69).doubt_px == light(0.5).doubt_px == 0.4  # as good as the stated one
    assert light(0.49).doubt_px == 0.0
    assert light(0.69).complaint == light(0.95, gain=0.02).complaint == ""
    assert light(0.95).complaint == (
        "the stated Sun does not fit the image: 95 % of 50 points correlate better under one turned by +20 deg"
    )


@pytest.mark.parametrize(("share", "fits"), [(0.49, True), (0.51, False)])
def test_half_of_the_points_under_a_far_sun_refuse_the_stated_one(share: float, fits: bool) -> None:
    """However little they gain: near Suns need a majority and a gain."""
    near = light(share, points=12, gain=0.01, gain_z=0.01)
    far = far_light(share, points=12, gain=0.01, gain_z=0.01)
    assert near.fits
    assert far.fits == fits
    assert ("12 points correlate better under one turned by -90 deg" in far.complaint) != fits


@pytest.mark.parametrize(("shift", "fits"), [(0.09, True), (0.11, False), (0.0, False)])
def test_a_far_sun_that_moves_no_match_refuses_nothing(shift: float, fits: bool) -> None:
    """The position is the same under both; 0: nothing is known of the matches' places."""
    far = far_light(0.6)
    assert replace(far, shifts_px=(shift,) * len(far.shifts_px)).fits == fits
    assert not replace(light(0.95), shifts_px=(shift,) * 4).fits  # a near one does


def test_far_suns_are_asked_where_near_ones_fit() -> None:
    near, refused = light(0.1), light(0.95)
    assert near_or_far(near, lambda: refused) is refused
    assert near_or_far(near, lambda: light(0.2)) is near
    assert near_or_far(refused, lambda: pytest.fail("the near ones refuse")) is refused


@pytest.mark.parametrize(
    ("gain", "gain_z", "fits"), [(0.07, 0.4, True), (0.09, 0.4, False), (0.07, 0.51, False)]
)
def test_a_lower_sun_is_refused_only_by_far(gain: float, gain_z: float, fits: bool) -> None:
    """Roughness below the DEM's cells looks like a lower Sun."""
    check = replace(
        light(0.9), correlations=(0.7, 0.8, 0.8 + gain, 0.7), gains=(-0.2, 0.3, gain_z, -0.2)
    )
    assert check.preferred == 2
    assert check.fits == fits
    assert check.complaint.endswith("correlate better under one lowered by 10 deg") != fits


@pytest.mark.parametrize("turn_deg", [-13.0, 0.0, 4.0])
def test_the_best_turn_is_the_vertex_of_a_parabola(turn_deg: float) -> None:
    """Points that lose the square of the Sun's distance, each by its own factor."""
    rng = np.random.default_rng(0)
    loss = rng.uniform(1e-4, 3e-3, 40)
    z = [-loss * (at - turn_deg) ** 2 for at in (-20.0, 0.0, 20.0)]
    turn, sigma = best_turn(z[0] - z[1], z[2] - z[1], 20.0, 40)
    assert turn == pytest.approx(turn_deg)
    assert sigma == pytest.approx(0.0, abs=1e-9)
    assert best_turn(z[1] - z[0], z[1] - z[2], 20.0, 40) == (0.0, math.inf)
    nearer = -loss * (-7.0 - turn_deg) ** 2
    turn, sigma = best_turn(nearer - z[1], z[2] - z[1], 20.0, 40, 7.0)
    assert (turn, sigma) == (pytest.approx(turn_deg), pytest.approx(0.0, abs=1e-9))


def test_the_best_turns_sigma_is_its_scatter() -> None:
    """Over 4000 draws of 60 points; half as many independent ones scatter by the root of 2 more."""
    rng = np.random.default_rng(1)
    draws = [
        best_turn(*(rng.normal(mean, 0.4, 60) for mean in (-0.3, -0.5)), 20.0, 60)
        for _ in range(4000)
    ]
    turns, sigmas = np.array(draws).T
    assert turns.std() == pytest.approx(sigmas.mean(), rel=0.05)
    assert turns.mean() == pytest.approx(-2.5, abs=0.1)
    back, ahead = rng.normal(-0.5, 0.4, (2, 60))
    whole, half = (best_turn(back, ahead, 20.0, n)[1] for n in (60, 30))
    assert half == pytest.approx(math.sqrt(2.0) * whole)


@pytest.mark.parametrize(
    ("turn", "sigma", "fits"),
    [(5.9, 0.1, True), (-6.1, 0.1, False), (9.0, 3.1, True), (9.0, 2.9, False)],
)
def test_a_best_turn_is_refused_if_far_and_sure(turn: float, sigma: float, fits: bool) -> None:
    check = replace(light(0.2), best_turn_deg=turn, best_turn_sigma_deg=sigma)
    assert check.preferred is None
    assert check.fits == fits
    assert (f"turned by {turn:+.0f} deg +- {sigma:.1f}" in check.complaint) != fits
    assert replace(check, points=4, independent=4.0).fits


@pytest.mark.parametrize(
    ("share", "turn", "sigma", "sure"),
    [
        (0.25, 0.0, 1.9, True),
        (0.26, 0.0, 1.9, False),
        (0.25, 0.0, 2.1, False),
        (0.1, -3.0, 1.0, True),
        (0.1, 3.1, 1.0, False),
        (0.1, 0.0, math.inf, False),
    ],
)
def test_a_glance_is_sure_if_few_points_and_no_turn_speak_for_another_sun(
    share: float, turn: float, sigma: float, sure: bool
) -> None:
    assert replace(light(share), best_turn_deg=turn, best_turn_sigma_deg=sigma).is_sure == sure


def test_points_on_the_same_ground_refuse_no_turn() -> None:
    """AS16-M-2801, Sun 52 deg: 7 points on the ground of 3.9 said -22 deg +- 6.8; 50 on that of 25 said -10 +- 6.5."""
    check = replace(light(0.2), best_turn_deg=-22.0, best_turn_sigma_deg=6.8)
    assert not replace(check, points=50, independent=25.4).fits
    assert replace(check, points=7, independent=3.9).fits


def test_a_sun_is_turned_and_raised() -> None:
    """About the vertical of the terrain; a Sun that is not moved stays the same."""
    camera = above_it()
    photo, ground = plain_photo(np.ones(camera.shape), camera), HERE.origin_mcmf_m[None]
    for turn, up in ((20.0, 0.0), (-35.0, 12.0), (0.0, -10.0)):
        moved = with_sun(photo, ground, turn, up).sun_direction_mcmf
        azimuth, elevation = azimuth_elevation(HERE.direction_from_mcmf(moved))
        assert float(azimuth) == pytest.approx(100.0 + turn, abs=1e-6)
        assert float(elevation) == pytest.approx(30.0 + up, abs=1e-6)
        assert np.linalg.norm(moved) == pytest.approx(1.0)
    assert with_sun(photo, ground, 0.0, 0.0) is photo


# -- what the points say


class Listener:
    """Replacement of the search: returns a table of correlations and places for each Sun in turn, then by the Sun's
    elevation, and records its arguments.
    """

    def __init__(self, correlations: np.ndarray, places: np.ndarray) -> None:
        self.answers = list(zip(correlations, places, strict=True))
        self.asked: list[dict] = []

    def of(self, catalog, image, rows, offset_px, criteria, reach_px=None):
        """Points that are found: what is asked of them."""
        known = {"reach": reach_px, "points": rows, "offset": offset_px, "criteria": criteria}
        return SimpleNamespace(
            under=partial(self.under, known),
            to_power=lambda _: self.of(catalog, image, rows, offset_px, criteria, reach_px),
        )

    def under(self, known, photo, law):
        self.asked.append(known | {"photo": photo})
        row, count = len(self.asked) - 1, len(known["points"])
        if row >= len(self.answers):
            sun = HERE.direction_from_mcmf(photo.sun_directions(HERE.origin_mcmf_m))
            row = {30: 0, 20: 3, 40: 4}[round(float(azimuth_elevation(sun)[1]))]
        correlation, place = self.answers[row]
        return correlation[:count], place[:count]


@pytest.fixture
def hills():
    """A catalogue of 150 times the same patch."""
    one = bump_catalog()
    return catalog_of_patches(np.repeat(one.dem, 150, axis=0), [HERE] * 150, 100.0)


def listened(monkeypatch, hills, correlations, places, count, **how):
    listener = Listener(correlations, places)
    monkeypatch.setattr("lcp_catalog.matching.sun_check.FoundPlaces", listener)
    monkeypatch.setattr("lcp_catalog.matching.sun_check.LAWS", ())  # other laws: test_light_laws
    camera = above_it()
    rng = np.random.default_rng(1)
    points = rng.permutation(150)[:count]
    offset = rng.normal(size=(count, 2))
    photo = plain_photo(np.ones(camera.shape), camera)
    criteria = Criteria(min_correlation=0.1)
    found = MatchedPoints(hills, SearchImage.of(photo), LAW, points, offset, criteria).check(**how)
    return found, listener, points, offset


def test_every_point_is_asked_under_every_sun(monkeypatch, hills) -> None:
    """Medians of correlations and of gains in z; share of points that gain; common shift of the
    matches. A point in the dark has correlation 0.
    """
    rng = np.random.default_rng(0)
    correlations = rng.uniform(0.3, 0.95, (5, 41))
    correlations[2] = np.minimum(correlations[0] + rng.normal(0.02, 0.03, 41), 0.99)
    correlations[3, 5:12] = 0.0
    correlations[0, 7] = 0.0
    places = rng.uniform(0.0, 100.0, (1, 41, 2)) + rng.normal(0.0, 0.3, (5, 41, 2))
    places[3] += [4.0, -3.0]
    places[3, 5:12] = np.nan
    places[4] = np.nan
    found, listener, points, offset = listened(
        monkeypatch, hills, correlations, places, 41, independent_share=0.5, reach_px=4.5
    )
    assert found.turns_deg == TURNS_DEG == ((-20.0, 0.0), (20.0, 0.0), (0.0, -10.0), (0.0, 10.0))
    for asked, (turn, up) in zip(listener.asked[:5], ((0.0, 0.0), *TURNS_DEG), strict=True):
        np.testing.assert_array_equal(asked["points"], points)
        np.testing.assert_array_equal(asked["offset"], offset)
        assert asked["reach"] == 4.5
        assert asked["criteria"].min_correlation == 0.1
        sun = HERE.direction_from_mcmf(asked["photo"].sun_directions(HERE.origin_mcmf_m))
        azimuth, elevation = azimuth_elevation(sun)
        assert (float(azimuth), float(elevation)) == pytest.approx((100.0 + turn, 30.0 + up), abs=1e-6)  # fmt: skip
    assert (found.points, found.independent) == (41, 20.5)
    assert found.correlation == np.median(correlations[0])
    assert found.correlations == pytest.approx([np.median(row) for row in correlations[1:]])
    z = 0.5 * np.log((1.0 + correlations) / (1.0 - correlations))
    gain = z[1:] - z[0]
    assert found.gains == pytest.approx([np.median(row) for row in gain])
    assert found.shares == pytest.approx([(row > 0.0).mean() for row in gain])
    for k in range(3):
        off = (places[k + 1] - places[0])[np.isfinite(places[k + 1][:, 0])]
        wanted = math.hypot(np.median(off[:, 0]), np.median(off[:, 1]))
        assert found.shifts_px[k] == pytest.approx(wanted)
    assert found.shifts_px[2] == pytest.approx(5.0, abs=0.3)
    assert found.shifts_px[3] == 0.0


def test_a_hundred_of_many_points_are_asked_evenly(monkeypatch, hills) -> None:
    correlations, places = np.full((5, 150), 0.8), np.zeros((5, 150, 2))
    found, listener, points, offset = listened(monkeypatch, hills, correlations, places, 150)
    assert found.points == found.independent == 100
    asked = listener.asked[0]
    rows = [points.tolist().index(p) for p in asked["points"]]
    assert (rows[0], rows[-1]) == (0, 149)
    assert set(np.diff(rows)) == {1, 2}
    np.testing.assert_array_equal(asked["offset"], offset[rows])
    assert asked["reach"] == 3.0
    found, *_ = listened(monkeypatch, hills, correlations, places, 4, independent_share=0.1)
    assert (found.points, found.independent) == (4, 1.0)


def test_correlations_of_one_are_no_infinite_gain(monkeypatch, hills) -> None:
    """artanh is limited to correlations of +-0.999."""
    correlations, places = np.full((5, 9), 1.0), np.zeros((5, 9, 2))
    correlations[1:] = 0.5
    correlations[4] = -1.0
    found, *_ = listened(monkeypatch, hills, correlations, places, 9)
    edge = math.atanh(0.999)
    assert found.gains == pytest.approx((*(math.atanh(0.5) - edge,) * 3, -2.0 * edge))


@pytest.mark.parametrize(("up", "elevation"), [(30.0, 60.0), (58.0, 88.0), (75.0, 89.0), (-28.0, 2.0), (-50.0, 1.0)])  # fmt: skip
def test_a_sun_stays_above_the_horizon_and_off_the_zenith(up: float, elevation: float) -> None:
    camera = above_it()
    photo = plain_photo(np.ones(camera.shape), camera, EAST)
    moved = with_sun(photo, HERE.origin_mcmf_m[None], 15.0, up)
    azimuth, height = azimuth_elevation(HERE.direction_from_mcmf(moved.sun_direction_mcmf))
    assert (float(azimuth), float(height)) == pytest.approx((115.0, elevation), abs=1e-6)


# -- the elevation


def elevated(
    elevation_deg: float,
    best_deg: float,
    sigma_deg: float = 0.5,
    share: float = 0.4,
) -> SunCheck:
    """A check with a best elevation, and a share of points that prefer the lowered Sun."""
    return replace(
        light(0.2), shares=(0.1, 0.1, share, 0.1), elevation_deg=elevation_deg,
        best_raise_deg=best_deg, best_raise_sigma_deg=sigma_deg,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("check", "fits"),
    [
        (elevated(30.0, -3.8), True),  # AS15-M-1134 under its Sun
        (elevated(20.0, 10.6), False),  # the same, stated 10 deg too low
        (elevated(40.0, -16.9), False),  # and 10 deg too high
        (elevated(10.0, 3.4), True),
        (elevated(10.0, 3.6), False),
        (elevated(33.5, -7.9, 2.0), True),  # lower by less than the sigma
        (elevated(33.5, -8.1, 2.0), False),
        (
            elevated(30.0, 0.0, math.inf),
            True,
        ),  # no best one between the Suns tried, and no majority
        (elevated(30.0, 0.0, math.inf, share=0.6), False),
        (elevated(50.0, -5.0, share=0.89), False),
        (replace(elevated(20.0, 4.8), independent=4.0), True),
        (elevated(math.nan, 9.0), True),  # other Suns than these were tried
    ],
)
def test_when_an_elevation_is_named(check: SunCheck, fits: bool) -> None:
    assert check.elevation_fits == fits
    assert check.fits  # it refuses nothing
    assert (check.elevation_advice == "") == fits


def test_the_advice_gives_the_elevations() -> None:
    assert elevated(20.0, 4.8).elevation_advice == (
        "the Sun's elevation, 20 deg, may be wrong: 50 points correlate best at 25 deg +- 0.5, under a right Sun "
        "between 14 and 24 deg; 40 % correlate better at 10 deg: check the Sun and the time"
    )
    assert (
        "correlate best below 20 deg, under" in elevated(30.0, 0.0, math.inf, 0.9).elevation_advice
    )
    assert "correlate better at 1 deg" in elevated(6.0, -9.0, share=0.9).elevation_advice


def test_the_elevation_of_a_check_is_measured(monkeypatch, hills) -> None:
    """Points whose correlation falls with the square of the distance, in log tan, from a Sun 4 deg above the stated 30 deg."""
    turn = np.array([0.0, -20.0, 20.0, 0.0, 0.0])
    elevation = np.radians([30.0, 30.0, 30.0, 20.0, 40.0])
    off = np.log(np.tan(elevation) / np.tan(np.radians(34.0)))
    z = 1.0 - off**2 - 1e-4 * turn**2
    correlations = np.tanh(np.repeat(z[:, None], 20, axis=1))
    check, *_ = listened(monkeypatch, hills, correlations, np.zeros((5, 20, 2)), 20)
    assert check.elevation_deg == pytest.approx(30.0, abs=0.1)
    assert check.best_raise_deg == pytest.approx(4.0)
    assert check.best_raise_sigma_deg == pytest.approx(0.0, abs=1e-6)
    assert not check.elevation_fits
