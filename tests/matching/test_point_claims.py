"""Claims in the matcher: the least covariance of a match, prior and posterior, and the choice of
points.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.linalg
from helpers.claiming import OTHERS_AT, USABLE_AT, claiming
from helpers.match_frames import GSD_M, LAW, hadley_camera, hadley_catalog, hadley_photo
from scipy.stats import norm

from lcp_catalog.cameras.sensor import Reduced, Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.landmarks.relief_signal import peak_height, probability_at
from lcp_catalog.matching.fix import LOCATED
from lcp_catalog.matching.matches import Matches
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_choice import (
    NO_CLAIM,
    PointClaims,
    at_least,
    choose_points,
    claimed,
    points_in_view,
    usable_points,
)
from lcp_catalog.matching.point_search import Criteria, find_points
from lcp_catalog.matching.position_fix import locate

ROWS = np.arange(49)


@cache
def hadley(sigma_m: float = 20.0) -> Catalog:
    """The patches of Hadley with claims: 1 sigma north, half as much east."""
    return claiming(hadley_catalog(), sigma_m, 2400.0)


def suns(catalog: Catalog, rows: np.ndarray = ROWS) -> np.ndarray:
    return hadley_photo().sun_directions(catalog.position_mcmf[rows])


def spread(seed: int, scale: float = 1.0) -> np.ndarray:
    """A random covariance matrix."""
    root = np.random.default_rng(seed).normal(size=(2, 2))
    return scale * (root @ root.T + 0.01 * np.eye(2))


# -- the least covariance


@pytest.mark.parametrize("seed", range(20))
def test_a_raised_covariance_is_the_least_one_above_both(seed: int) -> None:
    """By the generalised eigenvectors C v = w L v of scipy: in these directions the variances are
    those of C where w >= 1, and those of L elsewhere.
    """
    own, least = spread(seed), spread(seed + 100)
    raised = at_least(own[None], least[None])[0]
    ratios, axes = scipy.linalg.eigh(own, least)  # axes^T L axes = 1
    wanted = np.diag(np.maximum(ratios, 1.0))
    np.testing.assert_allclose(axes.T @ raised @ axes, wanted, atol=1e-9 * ratios.max())
    for part in (own, least):
        assert np.linalg.eigvalsh(raised - part).min() > -1e-9


def test_covariances_stay_where_nothing_is_claimed_or_the_claim_is_smaller() -> None:
    own, nothing = spread(3), np.full((2, 2), np.nan)
    flat = np.array([[1.0, 1.0], [1.0, 1.0]])
    given = np.array([own, own, nothing, own, own])
    least = np.array([nothing, 1e-3 * own, own, flat, 0.0 * own])
    np.testing.assert_allclose(at_least(given, least), given, rtol=1e-9)
    np.testing.assert_allclose(at_least(given[:1], 9.0 * given[:1]), 9.0 * given[:1], rtol=1e-9)


@pytest.mark.parametrize("factor", [1, 2])
def test_a_claimed_covariance_in_pixels_is_that_of_displaced_points(factor: int) -> None:
    """2000 displacements on the ground, drawn from the claimed ellipse, through the camera; 7 % smaller in an image at
    half resolution, which is sharper, and whose templates lose 0.63 and not 0.95 pixels at each edge, so that peaks are
    higher.
    """
    catalog, camera = hadley(), hadley_camera()
    fine = replace(
        camera,
        focal_length_px=factor * camera.focal_length_px,
        principal_point_px=tuple(factor * c for c in camera.principal_point_px),
        image_size_px=tuple(factor * n for n in camera.image_size_px),
    )
    sensor = Reduced(fine, factor)
    claims = PointClaims.of(catalog, ROWS, sensor, suns(catalog))
    rng = np.random.default_rng(0)
    for row in (5, 24, 40):
        east, north = 10.0 * rng.standard_normal(2000), 20.0 * rng.standard_normal(2000)
        enu = np.stack([east, north, np.zeros(2000)], axis=-1)
        places = catalog.position_mcmf[row] + enu @ catalog.rotation_mcmf_to_enu[row]
        wanted = {1: 1.0, 2: 0.93}[factor] ** 2 * np.cov(sensor.project(places).T)
        size = np.sqrt(np.linalg.det(wanted))
        np.testing.assert_allclose(claims.covariance_px2[row], wanted, atol=0.12 * size)
    higher = (32.0 - 1.26) / (32.0 - 1.90) if factor == 2 else 1.0
    claimed_at = probability_at(higher * peak_height(np.array([OTHERS_AT, USABLE_AT])))
    assert claims.some(slice(3, 5)).probability == pytest.approx(claimed_at, abs=0.003)


def test_no_match_is_better_than_its_claim() -> None:
    """1 sigma of 200 m north and 100 m east, several times that of the fit: covariances are those of
    the claims; with 1 m they are those of the fit.
    """
    photo = hadley_photo()
    plain = find_points(hadley_catalog(), photo, LAW, 20.0)
    for sigma_m, of in ((200.0, "claim"), (1.0, "fit")):
        catalog = hadley(sigma_m)
        found = find_points(catalog, photo, LAW, 20.0)
        both = found.found & plain.found
        assert both.sum() > 25
        np.testing.assert_array_equal(found.found_px[both], plain.found_px[both])
        claims = PointClaims.of(catalog, found.point, photo.sensor, suns(catalog, found.point))
        wanted = claims.covariance_px2 if of == "claim" else plain.covariance_px2
        good = both & (plain.covariance_px2[:, [0, 1], [0, 1]] < 0.1).all(axis=1)
        assert good.sum() > 15
        np.testing.assert_allclose(found.covariance_px2[good], wanted[good], rtol=1e-6)


@pytest.mark.parametrize("factor", [1, 2])
def test_noise_that_is_foreseen_counts_as_in_the_claim_and_more_counts_whole(factor: int) -> None:
    """A claim of 10 x 5 m, of which the place has 4 m, by a quarter of the noise: three times its part by noise is foreseen
    and displaces nothing. The ellipse on the ground through the full camera by finite differences.
    """
    full, plain = hadley_photo(), hadley_catalog()
    photo = full.reduced(factor)
    model = plain.errors | {"albedo_sigma": 0.0, "moving_share": 0.25, "position_sigma_m": 4.0}
    moved = replace(hadley(10.0), errors=model)
    rows = points_in_view(plain, photo.sensor)
    fit, own = (find_points(one, photo, LAW, 20.0 * factor, points=rows) for one in (plain, moved))
    sharper = {1: 1.0, 2: 0.93}[factor] ** 2
    np.testing.assert_array_equal(own.found_px, fit.found_px)
    noisy = 0
    for k in np.flatnonzero(fit.found & np.isfinite(own.prior)):
        axes, place = plain.rotation_mcmf_to_enu[rows[k]], plain.position_mcmf[rows[k]]
        ends = full.sensor.project(place + np.array([[1.0], [-1.0]])[..., None] * axes[:2])
        slope = 0.5 * (ends[0] - ends[1]).T  # pixels per metre east, north
        claim = sharper * slope @ np.diag([25.0, 100.0]) @ slope.T
        foreseen = sharper * slope @ np.diag([25.0 - 16.0, 100.0 - 16.0]) @ slope.T / 0.25
        wanted = fit.covariance_px2[k] - 0.75 * foreseen
        if np.linalg.eigvals(np.linalg.solve(claim, wanted)).min() > 1.0:
            noisy += 1
            np.testing.assert_allclose(
                own.covariance_px2[k], wanted, rtol=0.0, atol=0.04 * np.trace(claim)
            )
        least = np.linalg.eigvalsh(own.covariance_px2[k] - 0.97 * claim)  # sigmas are packed
        assert least.min() > 0.0
    assert noisy >= {1: 3, 2: 1}[factor]


# -- prior and posterior


def test_the_posterior_follows_from_the_prior_by_bayes_rule() -> None:
    """Odds of a right match are those of prior one half times p / (1 - p), in an image with much noise; p, that the
    true place is the highest, lies 0.57 probits above the claim that it is found.
    """
    catalog, photo = hadley(), hadley_photo()
    noise = np.random.default_rng(0).standard_normal(photo.signal.shape).astype(np.float32)
    photo = replace(photo, signal=photo.signal + 1.5 * photo.signal.std() * noise)
    told = find_points(catalog, photo, LAW, 20.0)
    even = find_points(catalog, photo, LAW, 20.0, criteria=Criteria(prior=0.5))
    without = find_points(hadley_catalog(), photo, LAW, 20.0)
    assert told.prior == pytest.approx(np.where(told.point % 2 == 0, 0.96, 0.2), abs=0.003)
    assert np.isnan(without.prior).all()
    np.testing.assert_array_equal(without.posterior, even.posterior)
    assert NO_CLAIM == 0.5
    with np.errstate(divide="ignore"):
        odds = {n: m.posterior / (1.0 - m.posterior) for n, m in (("told", told), ("even", even))}
    some = np.isfinite(told.second) & (even.posterior < 1.0 - 1e-6) & (even.posterior > 1e-6)
    assert some.sum() >= 10
    highest = np.clip(norm.cdf(norm.ppf(told.prior) + 0.57), 0.01, 0.99)
    ratio = highest / (1.0 - highest)
    np.testing.assert_allclose(odds["told"][some], odds["even"][some] * ratio[some], rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(told.posterior), np.isnan(told.found_px[:, 0]))


def test_a_prior_decides_between_two_equal_places() -> None:
    """The image beside itself: every point has an equal rival, and the prior is all there is."""
    from lcp_catalog.images.image import Image

    photo = hadley_photo()
    rows = np.array([16, 17, 23, 24, 25, 30, 31])
    part = photo.signal[60:260, 60:260]
    twice = np.concatenate([part, part], axis=1)
    middle = tuple(c - 60.0 for c in hadley_camera().principal_point_px)
    camera = replace(hadley_camera(), principal_point_px=middle, image_size_px=twice.shape[::-1])
    image: Image = replace(
        photo, signal=twice, weight=np.ones(twice.shape, np.float32), sensor=camera
    )
    whole = Criteria(min_area_share=0.0)
    found = find_points(hadley(), image, LAW, 230.0, points=rows, criteria=whole)
    placed = np.isfinite(found.second) & (found.second > found.correlation - 0.02)
    assert placed.sum() >= 4
    usable = rows % 2 == 0
    assert (found.posterior[placed & usable] > 0.9).all()
    assert (found.posterior[placed & ~usable] < 0.85).all()  # a fraction of a pixel adds a little
    assert np.median(found.posterior[placed & ~usable]) < 0.5


def test_matches_without_priors_have_none() -> None:
    nothing = np.full(3, np.nan)
    pixels = np.full((3, 2), np.nan)
    made = Matches(
        np.arange(3), pixels, pixels, np.full((3, 2, 2), np.nan), nothing, nothing, nothing,
        np.zeros(3, np.uint8),
    )  # fmt: skip
    assert np.isnan(made.prior).all()
    assert np.isnan(made.posterior).all()
    assert len(made.prior) == len(made.posterior) == 3
    assert len(Matches.none().prior) == 0


# -- the choice of points


def varied(seed: int = 2) -> Catalog:
    """Claims that differ from point to point, most of them above 0.9."""
    plain = hadley()
    rng = np.random.default_rng(seed)
    p = np.where(ROWS % 4 == 3, rng.uniform(0.1, 0.8, 49), rng.choice([0.92, 0.95, 0.98, 1.0], 49))
    sigma = rng.uniform(5.0, 40.0, 49)
    shape = plain.detection_probability.shape
    spread = np.broadcast_to(sigma[:, None, None, None, None], shape)
    condition = np.where(p >= 0.9, 31, 27).astype(np.uint8)
    return replace(
        plain,
        condition=np.broadcast_to(condition[:, None, None, None], plain.condition.shape),
        sun_elevation_min=np.where((p >= 0.9)[:, None, None], plain.sun_elevation_min[0], np.nan),
        sun_elevation_max=np.where((p >= 0.9)[:, None, None], plain.sun_elevation_max[0], np.nan),
        detection_probability=np.broadcast_to(p[:, None, None, None, None], shape),
        sigma_major=spread,
        sigma_minor=spread,
        coverage=replace(plain.coverage, usable=None),
    )


def in_turns(catalog: Catalog, rows: np.ndarray, most: int) -> list[int]:
    """The rule of `likeliest`, step by step."""
    photo = hadley_photo()
    stated = claimed(catalog, rows, photo.sensor, suns(catalog, rows))
    side = (photo.sensor.shape[0] * photo.sensor.shape[1] / most) ** 0.5
    cells: dict[tuple[int, int], list[tuple[float, float, int]]] = {}
    for k, row in enumerate(rows):
        x, y = photo.sensor.project(catalog.position_mcmf[row])
        cell = cells.setdefault((int(x // side), int(y // side)), [])
        cell.append(
            (
                -round(250.0 * stated.detection_probability[k] - 0.25),
                stated.sigma_major_m[k],
                int(row),
            )
        )
    chosen: list[int] = []
    for poor in (False, True):
        turns = {key: sorted(points) for key, points in cells.items()}
        for turn in range(len(rows)):
            best = sorted(points[turn] for points in turns.values() if len(points) > turn)
            chosen += [row for p, _, row in best if (-p < 125) == poor]
    return sorted(chosen[:most])


def test_the_best_points_are_taken_from_all_over_the_image() -> None:
    catalog, photo = varied(), hadley_photo()
    rows = points_in_view(catalog, photo.sensor)
    usable = rows[usable_points(catalog, rows, photo.sensor, suns(catalog, rows))]
    stated = claimed(catalog, rows, photo.sensor, suns(catalog, rows))
    np.testing.assert_array_equal(usable, rows[stated.usable])
    assert 16 < len(usable) < len(rows)
    direction = photo.sun_directions(catalog.position_mcmf.mean(axis=0))
    np.testing.assert_array_equal(choose_points(catalog, photo.sensor, direction), usable)
    for most in (1, 4, 9, 16, len(usable) - 1):
        chosen = choose_points(catalog, photo.sensor, direction, most)
        assert chosen.tolist() == in_turns(catalog, usable, most)
    # one point of each ninth of the image that has a usable one
    ninth = photo.sensor.shape[0] / 3.0
    pixels = photo.sensor.project(catalog.position_mcmf)
    cells = {tuple(np.floor(pixels[row] / ninth)) for row in choose_points(catalog, photo.sensor, direction, 9)}  # fmt: skip
    assert len(cells) == len({tuple(np.floor(pixels[row] / ninth)) for row in usable})


@pytest.mark.slow
def test_few_points_are_searched_first_and_all_if_these_do_not_agree() -> None:
    """With the right patches 16 points are enough; with wrong patches for every usable point the
    others have to be searched.
    """
    catalog, photo = hadley(), hadley_photo()
    wrong = catalog.dem.copy()
    wrong[::2] = wrong[::2][::-1, ::-1, ::-1]  # another point's, turned by 180 deg
    known = Uncertainty(3.0 * GSD_M)
    for tried in (catalog, replace(catalog, dem=wrong)):
        few, whole = (
            locate(tried, photo, known, LAW, Options(most_first=most, check_sun=False))
            for most in (16, 400)
        )
        assert few.verdict == whole.verdict == LOCATED
        np.testing.assert_array_equal(few.matches.point, whole.matches.point)
        assert few.matches.found.sum() >= whole.matches.found.sum() - 1
        np.testing.assert_allclose(
            few.pose.position_mcmf_m, whole.pose.position_mcmf_m, atol=0.2 * few.pose.sigma[0]
        )
