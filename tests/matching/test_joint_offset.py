"""Low-contrast terrain: synthetic terrain under an albedo stronger than its shading is located by
all points together, with a right covariance; other terrain, or other light, is not.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
import pytest
from helpers import small_world
from helpers.posed import PlainMap
from helpers.small_world import LAW, World, mirrored, overhead
from helpers.suns import far_light, light

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.images.image import Image
from lcp_catalog.landmarks.ground_votes import FEWEST
from lcp_catalog.matching import joint_offset, position_fix
from lcp_catalog.matching.consensus import Consensus
from lcp_catalog.matching.fix import BY_ALL_POINTS, BY_POINTS, CANNOT_SAY, LOCATED, NOT_HERE
from lcp_catalog.matching.joint_offset import SHOWS, JointOffset, find_joint_offset
from lcp_catalog.matching.matches import SEARCHED
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_choice import working_image
from lcp_catalog.matching.position_fix import locate
from lcp_catalog.matching.search_area import CoarseShift, SearchArea, coarse_shift
from lcp_catalog.matching.sun_check import with_sun
from lcp_catalog.matching.sun_verdict import FAR_TURNS_DEG, SunCheck
from lcp_catalog.matching.templates import render_patches

MOVED_M = (700.0, -1300.0)
UNCERTAIN = Uncertainty(1500.0)
QUICK = Options(check_sun=False)
WIDE_PX = 128.0
"""Side of a patch in the map's pixels of 100 m."""


@cache
def world() -> World:
    return small_world.world()


@cache
def points() -> Catalog:
    return world().catalog()


@cache
def clear() -> Image:
    """A map of the synthetic terrain, shifted, without noise."""
    return world().photo(PlainMap(world().frame, *MOVED_M), noise=0.0)


@lru_cache(maxsize=4)
def clouds(shape: tuple[int, int], seed: int) -> np.ndarray:
    """Noise with the spectrum of terrain, of unit variance."""
    dice = np.random.default_rng(seed)
    waves = np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1]), indexing="ij")
    spectrum = np.fft.rfft2(dice.normal(size=shape)) / np.maximum(np.hypot(*waves), 0.01)
    found = np.fft.irfft2(spectrum, s=shape)
    return found / found.std()


@lru_cache(maxsize=4)
def faint(photo: Image, seed: int, times: float = 6.0) -> Image:
    """The image with albedo variations ``times`` as strong as its shading."""
    shading = photo.signal + times * np.nanstd(photo.signal) * clouds(photo.signal.shape, seed)
    return replace(photo, signal=shading.astype(np.float32))


def believed(photo: Image) -> Image:
    """The image with a map that does not contain the shift."""
    return photo.with_sensor(PlainMap(world().frame))


def together(
    photo: Image,
    rows: np.ndarray | None = None,
    uncertainty: Uncertainty = UNCERTAIN,
    log10_places: float = 0.0,
    **options: bool,
) -> JointOffset | None:
    rows = np.arange(len(points())) if rows is None else rows
    reach = np.full(len(rows), 64.0)
    area = SearchArea(rows, np.zeros((len(rows), 2)), reach, log10_places)
    searched = working_image(points(), photo, rows)
    return find_joint_offset(
        points(), searched, photo.sensor, uncertainty, LAW, area, WIDE_PX, **options
    )


def squared(found: JointOffset, true: tuple[float, float] = MOVED_M) -> float:
    """Squared error in units of the stated covariance; its expectation is 2."""
    off = found.pose.correction - true
    return float(off @ np.linalg.solve(found.pose.covariance, off))


# -- located


@pytest.mark.slow
def test_what_single_points_do_not_show_all_of_them_do() -> None:
    answer = locate(points(), believed(faint(clear(), 0)), UNCERTAIN, LAW)
    assert answer.verdict == LOCATED
    assert answer.by == BY_ALL_POINTS
    assert answer.reason.startswith("all 81 points together show this place")
    off = answer.pose.correction - MOVED_M
    assert (np.abs(off) < 3.5 * answer.pose.sigma).all()
    assert (answer.pose.sigma < 150.0).all()
    assert answer.pose.sigma[0] < answer.pose.sigma[1]  # the Sun stands in the east
    assert answer.log10_false_alarms < -8.0
    assert np.array_equal(answer.matches.found, answer.pose.used)
    assert answer.pose.used.sum() < 20
    place = answer.pose.sensor.project(points().position_mcmf[answer.matches.point])
    residual = (answer.matches.found_px - place)[answer.pose.used]
    assert np.hypot(*residual.T).max() < 15.0


def test_where_points_agree_they_are_taken() -> None:
    answer = locate(points(), believed(faint(clear(), 0, 2.0)), UNCERTAIN, LAW, QUICK)
    assert answer.verdict == LOCATED
    assert answer.by == BY_POINTS


def test_a_camera_that_is_known_well() -> None:
    """The prior and one place for all points: across the view, the error is a fraction of a pixel
    of 400 m.
    """
    seed, known, unsure = 4, overhead(), Uncertainty(300.0, 5e-4)
    image = faint(world().photo(known, noise=0.0), seed, 3.0)
    draw = unsure.sigmas(known) * np.random.default_rng(seed).normal(size=6)
    answer = locate(points(), image.with_sensor(known.moved(draw)), unsure, LAW, QUICK)
    assert answer.verdict == LOCATED
    assert answer.by == BY_ALL_POINTS
    ground = points().position_mcmf[len(points()) // 2]
    assert np.abs(answer.pose.sensor.project(ground) - known.project(ground)).max() < 0.6
    off = (answer.pose.correction + draw)[:3]
    assert off @ np.linalg.solve(answer.pose.covariance[:3, :3], off) < 16.3


@pytest.mark.slow
def test_the_stated_covariance_is_right() -> None:
    """60 terrains: the squared error over its covariance has mean 2 (its standard error is 0.26)."""
    found = [together(believed(faint(clear(), seed)), check_sun=False) for seed in range(100, 160)]
    assert all(one.pose is not None for one in found)
    errors = np.array([squared(one) for one in found])
    assert 1.2 < errors.mean() < 2.8
    assert errors.max() < 16.0


@pytest.mark.slow
def test_it_stands_where_the_mean_correlation_is_highest() -> None:
    """Compared with correlations by NumPy one by one and a paraboloid by least squares."""
    photo = believed(faint(clear(), 3))
    found = together(photo, check_sun=False)
    searched = working_image(points(), photo, np.arange(81))
    corrected = searched.sensor.moved(found.pose.correction)
    suns = searched.sun_directions(points().position_mcmf)
    templates = render_patches(points(), np.arange(81), corrected, suns, LAW)
    total = np.zeros((5, 5))
    for values, mask, (left, top) in zip(
        templates.values, templates.mask, templates.origin, strict=True
    ):
        for i in range(5):
            for j in range(5):
                row, col = top + i - 2, left + j - 2
                seen = searched.signal[row : row + mask.shape[0], col : col + mask.shape[1]]
                total[i, j] += np.arctanh(np.corrcoef(seen[mask], values[mask])[0, 1])
    at = np.array(np.unravel_index(total.argmax(), total.shape))
    assert (at == 2).all()
    row, col = np.mgrid[-1:2, -1:2].reshape(2, -1).astype(float)
    design = np.stack([np.ones(9), col, row, col**2, row**2, col * row], axis=1)
    c = np.linalg.lstsq(design, total[1:4, 1:4].ravel(), rcond=None)[0]
    away = np.linalg.solve([[2 * c[3], c[5]], [c[5], 2 * c[4]]], -c[1:3])
    assert (np.abs(away) * 400.0 < 0.2 * found.pose.sigma).all()


def test_gaps_do_not_pull() -> None:
    """Half of the points have a gap of 4.1 km at their eastern edge: one pixel further, too little
    of them is valid.
    """
    catalog, rows = world().catalog(step_m=20e3), np.arange(25)
    photo = believed(clear())
    weight = photo.weight.copy()
    for column, row in clear().sensor.project(catalog.position_mcmf)[rows // 5 % 2 == 0][:12]:
        right = int(column) + 66
        weight[max(int(row) - 70, 0) : int(row) + 70, max(right - 41, 0) : right + 8] = 0.0
    searched = working_image(catalog, replace(photo, weight=weight), rows)
    area = SearchArea(rows, np.zeros((25, 2)), np.full(25, 64.0))
    found = find_joint_offset(
        catalog, searched, photo.sensor, UNCERTAIN, LAW, area, WIDE_PX, check_sun=False
    )
    assert np.abs(found.pose.correction - MOVED_M).max() < 30.0
    assert squared(found) < 14.0


# -- counted


@pytest.mark.slow
def test_the_same_ground_twice_says_no_more() -> None:
    photo, rows = believed(faint(clear(), 0)), np.arange(81)
    once, twice = (together(photo, r, check_sun=False) for r in (rows, np.tile(rows, 2)))
    assert twice.log10_false_alarms == pytest.approx(once.log10_false_alarms, abs=0.6)
    np.testing.assert_allclose(twice.pose.sigma, once.pose.sigma, rtol=0.25)


def test_a_share_of_the_votes_counts() -> None:
    """Every point twice, each counted half: the Gamma tail of the points once."""
    photo, rows = believed(faint(clear(), 0)), np.arange(81)
    searched = working_image(points(), photo, rows)
    once = coarse_shift(points(), searched, LAW, 64.0, points=rows)
    half = coarse_shift(points(), searched, LAW, 64.0, points=np.tile(rows, 2), share=0.5)
    both = coarse_shift(points(), searched, LAW, 64.0, points=np.tile(rows, 2))
    assert half.offset_px == once.offset_px
    assert half.log10_false_alarms == pytest.approx(once.log10_false_alarms, abs=1e-9)
    assert both.log10_false_alarms < 1.5 * once.log10_false_alarms


@pytest.mark.slow
def test_chance_shows_as_often_as_it_says() -> None:
    """200 images of clouds: a share of at most 10^-k, plus three sigma, lies below 10^-k."""
    log10 = []
    for seed in range(200):
        image = clouds((250, 250), seed).repeat(4, axis=0).repeat(4, axis=1)
        found = together(
            believed(replace(clear(), signal=image.astype(np.float32))), check_sun=False
        )
        log10.append(found.log10_false_alarms)
    for level in (1, 2, 3):
        share = 10.0**-level
        assert np.mean(np.array(log10) < -level) <= share + 3.0 * np.sqrt(share / len(log10))


@pytest.mark.slow
def test_places_that_were_chosen_among_count() -> None:
    photo = believed(faint(clear(), 0))
    one, many = (together(photo, log10_places=places, check_sun=False) for places in (0.0, 3.0))
    assert many.log10_false_alarms == pytest.approx(one.log10_false_alarms + 3.0)


@pytest.mark.slow
def test_of_many_points_some_are_enough() -> None:
    found = together(believed(faint(clear(), 0)), np.repeat(np.arange(81), 4), check_sun=False)
    assert 150 < found.points <= 200


def test_a_rival_is_not_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    photo = believed(faint(clear(), 0))
    for rival, sure in ((-6.1, False), (-5.9, True)):
        shift = CoarseShift((-8.0, -12.0), -12.0, rival, 4.0, 81)
        monkeypatch.setattr(joint_offset, "coarse_shift", lambda *_, shift=shift, **__: shift)
        found = together(photo, check_sun=False)
        assert (found.pose is not None) == sure
        assert sure or found.reason == "another place is about as significant"


def test_ranks_and_correlations_show_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """A maximum of the mean correlation 5 searched pixels from that of the votes is rejected."""
    photo = believed(faint(clear(), 0))
    shift = CoarseShift((-8.0 + 20.0, -12.0), -12.0, 0.0, 4.0, 81)
    monkeypatch.setattr(joint_offset, "coarse_shift", lambda *_, **__: shift)
    found = together(photo, check_sun=False)
    assert found.pose is None
    assert "uncertain" in found.reason


def test_what_is_too_far_is_not_sought() -> None:
    photo, rows = believed(faint(clear(), 0)), np.arange(81)
    searched = working_image(points(), photo, rows)
    for reach, told in ((250.0, True), (260.0, False)):
        area = SearchArea(rows, np.zeros((81, 2)), np.full(81, reach))
        found = find_joint_offset(
            points(), searched, photo.sensor, UNCERTAIN, LAW, area, WIDE_PX, check_sun=False
        )
        assert (found is not None) == told


# -- not located


@pytest.mark.parametrize(
    "how",
    [
        "left-right",
        "90",
        *(pytest.param(h, marks=pytest.mark.slow) for h in ("up-down", "180", "270")),
    ],
)
def test_turned_or_mirrored_it_is_no_place(how: str) -> None:
    answer = locate(points(), believed(mirrored(faint(clear(), 0, 3.0), how)), UNCERTAIN, LAW)
    assert answer.verdict == NOT_HERE
    assert answer.pose is None


@pytest.mark.slow
def test_other_ground_is_no_place() -> None:
    other = World(seed=2).photo(PlainMap(world().frame, *MOVED_M), noise=0.0)
    for image in (
        faint(other, 1),
        replace(clear(), signal=clouds((1000, 1000), 7).astype(np.float32)),
    ):
        answer = locate(points(), believed(image), UNCERTAIN, LAW)
        assert answer.verdict == NOT_HERE


@cache
def under_its_own_sun() -> JointOffset | None:
    return together(believed(faint(clear(), 0, 3.0)))


@pytest.mark.slow
@pytest.mark.parametrize("turn", [-45.0, 45.0, 90.0])
def test_under_a_wrong_sun_it_is_not_taken(turn: float) -> None:
    """Where the place is significant at all, another Sun correlates better."""
    photo = believed(faint(clear(), 0, 3.0))
    found = together(with_sun(photo, points().position_mcmf, turn, 0.0))
    assert found.pose is None
    assert abs(turn) > 45.0 or "the stated Sun does not fit" in found.reason
    assert under_its_own_sun().pose is not None


@pytest.mark.parametrize("far_fits", [True, False])
def test_all_points_are_held_against_far_suns(
    monkeypatch: pytest.MonkeyPatch, far_fits: bool
) -> None:
    """Brightness that a map knows shows a place under any Sun (test_apollo_maps)."""

    def check(*how: Any) -> SunCheck:
        one = far_light(0.6) if how[-1] == FAR_TURNS_DEG else light(0.6)
        return replace(one, shifts_px=(0.05 if far_fits else 0.2,) * 4)

    monkeypatch.setattr(joint_offset, "check_sun", check)
    found = together(believed(faint(clear(), 0)))
    assert (found.pose is not None) == far_fits
    assert ("turned by -90 deg" in found.reason) != far_fits


@pytest.mark.slow
def test_a_sun_that_does_as_well_is_a_doubt() -> None:
    """Turned by 20 deg it is not refused in so faint an image, but the shift under the better Sun
    is in the covariance.
    """
    photo = with_sun(believed(faint(clear(), 0)), points().position_mcmf, -20.0, 0.0)
    sure, unsure = (together(photo, check_sun=check) for check in (False, True))
    assert unsure.pose is not None
    np.testing.assert_allclose(unsure.pose.correction, sure.pose.correction)
    assert unsure.pose.position_sigma_m > 1.05 * sure.pose.position_sigma_m


def test_too_few_points_say_nothing_together() -> None:
    photo = believed(faint(clear(), 0, 2.0))
    assert together(photo, np.arange(FEWEST - 1)) is None
    assert together(photo, np.arange(FEWEST)) is not None


def test_an_image_that_may_be_turned_shows_without_a_place() -> None:
    known, unsure = overhead(), Uncertainty(2000.0, 5e-3)
    image = faint(world().photo(known, noise=0.0), 2, 2.3)
    answer = locate(points(), image.with_sensor(known.moved(unsure.sigmas(known))), unsure, LAW)
    assert answer.verdict == CANNOT_SAY
    assert answer.pose is None
    assert "show this place" in answer.reason
    assert "turns and scales the image" in answer.reason


def test_a_sensor_that_is_held_is_not_where_it_shows() -> None:
    found = together(believed(faint(clear(), 0)), uncertainty=Uncertainty(0.0), check_sun=False)
    away = float(found.reason.split(" px")[0].removeprefix("it lies "))
    assert found.pose is None
    assert away == pytest.approx(np.hypot(*MOVED_M) / 100.0, abs=1.5)
    here = faint(clear(), 0)
    assert together(here, uncertainty=Uncertainty(0.0), check_sun=False).pose is not None


@pytest.mark.slow
def test_a_place_beyond_the_stated_uncertainty_is_told() -> None:
    answer = locate(points(), believed(faint(clear(), 0)), Uncertainty(200.0), LAW, QUICK)
    assert answer.verdict == CANNOT_SAY
    assert answer.by == BY_ALL_POINTS
    assert "stated sigmas away" in answer.reason


def test_weak_evidence_refutes_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    said = JointOffset(81, SHOWS - 1.0, 0.0, reason="not significant enough for a position")
    monkeypatch.setattr(position_fix, "find_joint_offset", lambda *_, **__: said)
    photo = believed(replace(clear(), signal=clouds((1000, 1000), 7).astype(np.float32)))
    answer = locate(points(), photo, UNCERTAIN, LAW)
    assert answer.verdict == CANNOT_SAY
    assert "10^-4, but not significant enough for a position" in answer.reason
    monkeypatch.setattr(
        position_fix, "find_joint_offset", lambda *_, **__: replace(said, log10_false_alarms=SHOWS)
    )
    assert locate(points(), photo, UNCERTAIN, LAW).verdict == NOT_HERE


def test_points_that_cannot_be_looked_for_have_no_vote(monkeypatch: pytest.MonkeyPatch) -> None:
    """The western half of the image is missing, and the points on it do not count."""
    asked = []
    monkeypatch.setattr(
        position_fix, "find_joint_offset", lambda *given, **_: asked.append(given[5].points)
    )
    photo = faint(clear(), 0)
    weight = photo.weight.copy()
    weight[:, :500] = 0.0
    answer = locate(points(), believed(replace(photo, weight=weight)), UNCERTAIN, LAW)
    there = np.isin(answer.matches.code, SEARCHED)
    assert np.array_equal(asked[0], answer.matches.point[there])
    assert 30 < there.sum() < 50


def test_a_shift_that_showed_at_a_coarse_scale_is_not_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Far off, the coarse offset is found first; if the points then agree on nothing, the place is
    not refuted.
    """
    nobody = Consensus(None, 0.0, 0.0)
    monkeypatch.setattr(position_fix, "agree", lambda *_, **__: nobody)
    monkeypatch.setattr(position_fix, "find_joint_offset", lambda *_, **__: None)
    far, known = Uncertainty(9000.0, 0.009), overhead()
    photo = world().photo(known)
    given = photo.with_sensor(known.moved([9e3, -1.2e4, 5e3, 0.01, -0.008, 0.005]))
    answer = locate(points(), given, far, LAW)
    assert answer.verdict == CANNOT_SAY
    assert "only at a coarse scale" in answer.reason
