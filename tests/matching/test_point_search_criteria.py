"""Requirements for a match: each decides at its own threshold, in pixels of the full-resolution
image.
"""

from __future__ import annotations

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from helpers.lone_hill import EAST, HERE, above_it, bump_catalog, drawn, picture, plain_photo
from helpers.match_frames import GSD_M, LAW, hadley_catalog, hadley_photo
from helpers.twins_match import catalog_of_patches, correlation_at, looking_at

from lcp_catalog.cameras.sensor import Reduced
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.images.image import Image
from lcp_catalog.matching import point_search
from lcp_catalog.matching.matches import REASONS, Matches
from lcp_catalog.matching.point_choice import points_in_view
from lcp_catalog.matching.point_search import Criteria, find_points
from lcp_catalog.matching.templates import render_patches

bump = pytest.fixture(bump_catalog, scope="module")
above = pytest.fixture(above_it, scope="module")


def sought(bump, photo: Image, reach: float = 6.0, **more) -> Matches:
    return find_points(bump, photo, LAW, reach, points=[0], **more)


def said(bump, photo: Image, reach: float = 6.0, **criteria: float) -> str:
    found = sought(bump, photo, reach, criteria=Criteria(**criteria))
    return REASONS[found.code[0]]


def noisy(signal: np.ndarray, share: float, seed: int = 0) -> np.ndarray:
    return signal + share * signal.mean() * np.random.default_rng(seed).standard_normal(
        signal.shape
    )


# -- every criterion is a bound


def test_correlation_and_the_way_back_are_bounds(bump, above) -> None:
    photo = plain_photo(noisy(picture(above, ((3, -5),)), 0.2), above)
    found = sought(bump, photo)
    assert REASONS[found.code[0]] == "found"
    correlation, back = float(found.correlation[0]), float(found.back_px[0])
    assert 0.3 < correlation < 0.95
    assert back > 0.01
    assert said(bump, photo, min_correlation=correlation - 1e-6) == "found"
    assert said(bump, photo, min_correlation=correlation + 1e-6) == "weak"
    assert said(bump, photo, max_back_px=1.01 * back) == "found"
    assert said(bump, photo, max_back_px=0.99 * back) == "not confirmed"


def test_what_a_template_must_be_is_a_bound(bump, above) -> None:
    """Number of pixels, contrast of the render, and lit share, under a low Sun."""
    photo = plain_photo(picture(above), above)
    template = drawn(above)
    values = template.values[template.mask].astype(np.float64)
    assert said(bump, photo, min_pixels=len(values)) == "found"
    assert said(bump, photo, min_pixels=len(values) + 1) == "low contrast"
    contrast = values.std() / values.mean()
    assert said(bump, photo, min_contrast=0.999 * contrast) == "found"
    assert said(bump, photo, min_contrast=1.001 * contrast) == "low contrast"
    low = HERE.direction_to_mcmf(direction_enu(100, 5))
    dim = drawn(above, low)
    share = (dim.values[dim.mask] > 0.0).mean()
    assert 0.4 < share < 0.9
    photo = plain_photo(picture(above, sun=low), above, low)
    assert said(bump, photo, min_lit_share=share - 1e-4) == "found"
    assert said(bump, photo, min_lit_share=share + 1e-4) == "not lit"


def test_how_obliquely_a_point_is_seen_is_a_bound(bump) -> None:
    tilted = above_it(off_nadir_deg=40.0, azimuth_deg=30.0)
    photo = plain_photo(picture(tilted), tilted)
    assert said(bump, photo, max_emission_deg=40.01) == "found"
    assert said(bump, photo, max_emission_deg=39.99) == "not seen"


@pytest.mark.parametrize("side", [(2, 0), (0, 3), (-4, 0), (0, -1), (3, 2)])
def test_the_part_of_the_search_that_lies_in_the_image_is_a_bound(bump, above, side) -> None:
    """The patch lies some pixels beyond a border of the image: the offsets of the search inside the
    image are counted.
    """
    template = drawn(above)
    rows, cols = np.nonzero(template.mask[0])
    first = template.origin[0] + (cols.min(), rows.min())
    high, wide = np.ptp(rows) + 1, np.ptp(cols) + 1
    goal = [-s if s >= 0 else 160 - n - s - 1 for s, n in zip(side, (wide, high), strict=True)]
    away = [g - f if s else 0 for g, f, s in zip(goal, first, side, strict=True)]
    middle = tuple(m + a for m, a in zip(above.principal_point_px, away, strict=True))
    moved = replace(above, principal_point_px=middle)
    offsets = np.arange(-6, 7)
    share = 1.0
    for place, n, add in zip(first, (wide, high), away, strict=True):
        there = (place + add + offsets >= 0) & (place + add + offsets + n <= 160)
        share *= there.mean()
    photo = plain_photo(np.random.default_rng(0).random((160, 160)), moved)
    assert 0.1 < share < 1.0
    assert said(bump, photo, min_area_share=1.001 * share) == "at the edge"
    assert said(bump, photo, min_area_share=0.999 * share) == "weak"


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["no data", "saturated"])
def test_the_real_share_is_a_bound(bump, above, lost) -> None:
    """40 % and some of the patch's pixels are missing; a search of one place."""
    template, signal = drawn(above), picture(above)
    weight = np.ones(signal.shape, np.float32)
    weight[:, : template.origin[0, 0] + 14] = 0.0
    box = np.s_[
        template.origin[0, 1] : template.origin[0, 1] + template.shape[0],
        template.origin[0, 0] : template.origin[0, 0] + template.shape[1],
    ]
    share = weight[box][template.mask[0]].mean()
    assert 0.5 < share < 0.7
    if lost == "no data":
        signal[weight == 0.0] = np.nan
    photo = plain_photo(signal, above, EAST, weight)
    for bound, answer in ((share - 1e-4, "found"), (share + 1e-4, lost)):
        criteria = Criteria(min_real_share=bound, max_back_px=9.0)
        found = sought(bump, photo, 0.0, criteria=criteria, whole_search=True)
        assert REASONS[found.code[0]] == answer


@pytest.mark.parametrize(("bright", "answer"), [(0.45, "no data"), (0.55, "saturated")])
def test_most_of_what_is_lost_says_why(bump, above, bright, answer) -> None:
    """Some of the missing pixels in a box about the patch are saturated, the others have no data."""
    template, signal = drawn(above), picture(above)
    weight = np.ones(signal.shape, np.float32)
    middle = template.origin[0] + np.array(template.shape[::-1]) // 2
    high, wide = (n // 2 for n in template.shape)
    rows = np.arange(middle[1] - high, middle[1] + high + 1)
    box = np.s_[rows[0] : rows[-1] + 1, middle[0] - wide : middle[0] + wide + 1]
    weight[box] = 0.0
    none = np.zeros(signal.shape, bool)
    none[rows[round(bright * len(rows)) :]] = True
    signal[none & (weight == 0.0)] = np.nan
    assert said(bump, plain_photo(signal, above, EAST, weight), 0.0) == answer
    # what lies beside the box has no say
    signal[: rows[0]], weight[: rows[0]] = np.nan, 0.0
    signal[:, : middle[0] - wide], weight[:, : middle[0] - wide] = np.nan, 0.0
    assert said(bump, plain_photo(signal, above, EAST, weight), 0.0) == answer


def test_the_chance_of_a_false_match_is_a_bound(bump, above) -> None:
    photo = plain_photo(noisy(picture(above, ((0, 0), (45, 4))), 0.25), above)
    found = sought(bump, photo, 50.0, criteria=Criteria(max_false_match=1.0))
    chance = 1.0 - found.posterior[0]
    assert 0.005 < chance < 0.5
    # noise of a pixel is white, so that the two correlations differ by the variance of two of N pixels
    best, other, count = found.correlation[0], found.second[0], drawn(above).mask.sum()
    variance = (1.0 - best**2) * (2.0 - best**2 - other**2) / count
    assert chance == pytest.approx(NormalDist().cdf((other - best) / variance**0.5), rel=0.25)
    assert said(bump, photo, 50.0, max_false_match=1.001 * chance) == "found"
    assert said(bump, photo, 50.0, max_false_match=0.999 * chance) == "ambiguous"


def test_a_place_that_is_the_patch_s_negative_is_no_peak_not_missing(bump, above) -> None:
    signal = picture(above)
    negative = plain_photo(signal.max() - signal, above)
    found = sought(bump, negative, 0.0)
    assert REASONS[found.code[0]] == "no peak"
    assert np.isnan(found.correlation[0])


# -- the search


@pytest.mark.parametrize(("away", "counts"), [(12, False), (15, False), (18, True), (24, True)])
def test_a_rival_lies_half_a_template_away(bump, above, away, counts) -> None:
    """The patch covers about 32 x 32 pixels; a copy nearer than 16 counts as the same place."""
    signal = noisy(picture(above, ((0, 0), (away, 0))), 0.02)  # the later copy lies on top
    found = sought(bump, plain_photo(signal, above), 30.0, whole_search=True)
    template = drawn(above)
    col, row = template.origin[0]
    other = correlation_at(signal, template.values[0], template.mask[0], row, col)
    assert 0.3 < other < 0.9
    assert (np.nan_to_num(found.second[0], nan=-1.0) > other - 2e-3) == counts


@pytest.mark.parametrize(("reach", "there"), [(6.0, True), (5.2, True), (5.0, False)])
def test_a_reach_is_rounded_up(bump, above, reach, there) -> None:
    """The search ends at whole pixels, where a place may be 1.5 pixels off."""
    found = sought(bump, plain_photo(picture(above, ((7, 0),)), above), reach)
    assert (found.correlation[0] > 0.99) == there


def test_small_templates_are_searched_at_full_resolution() -> None:
    """Templates of about 11 x 11 pixels have too few at half resolution: the results are those of
    the whole search, rivals included.
    """
    camera = looking_at(EnuFrame(3.5, 26.0), 300e3, 0, 0, 0, 300e3 / 350.0, (110, 110))
    rng = np.random.default_rng(3)
    photo = plain_photo(rng.standard_normal((110, 110)).cumsum(0).cumsum(1), camera)
    loose = Criteria(min_correlation=0.0, max_false_match=1.0, min_contrast=0.0)
    quick, whole = (
        find_points(hadley_catalog(), photo, LAW, 20.0, whole_search=w, criteria=loose)
        for w in (False, True)
    )
    assert np.isfinite(whole.second).sum() > 20
    for name in ("found_px", "correlation", "second", "code"):
        np.testing.assert_array_equal(getattr(quick, name), getattr(whole, name))


# -- figures


@pytest.mark.slow
def test_a_reduced_photo_answers_as_one_that_came_so() -> None:
    """The same pixels as a reduced image and with a camera of their own: places (p + 1/2) 2 - 1/2,
    lengths twice as large, the point spread, too, and all else the same.
    """
    full = hadley_photo()
    fine = looking_at(
        EnuFrame(3.5, 26.0, -1000.0), 300e3, 15, 60, 37, 2 * 300e3 / GSD_M, (640, 640)
    )
    middle = tuple((c + 0.5) * 2.0 - 0.5 for c in full.sensor.principal_point_px)
    fine = replace(fine, principal_point_px=middle)
    reduced = replace(full, sensor=Reduced(fine, 2))
    rows = points_in_view(hadley_catalog(), full.sensor)[::2]
    offset = np.random.default_rng(0).choice([-6.0, 6.0], (len(rows), 2))  # twice that is beyond
    native = find_points(hadley_catalog(), full, LAW, 7.0, points=rows, offset_px=offset)
    twice = {"offset_px": 2.0 * offset, "criteria": Criteria(psf_sigma_px=1.0)}
    found = find_points(hadley_catalog(), reduced, LAW, 14.0, points=rows, **twice)
    np.testing.assert_array_equal(found.code, native.code)
    assert native.found.sum() >= 10
    for name in ("correlation", "second"):
        np.testing.assert_allclose(getattr(found, name), getattr(native, name), atol=1e-5)
    for name in ("predicted_px", "found_px"):
        wanted = (getattr(native, name) + 0.5) * 2.0 - 0.5
        np.testing.assert_allclose(getattr(found, name), wanted, atol=1e-3)
    np.testing.assert_allclose(found.back_px, 2.0 * native.back_px, atol=1e-3)
    np.testing.assert_allclose(found.covariance_px2, 4.0 * native.covariance_px2, rtol=1e-3)


def test_a_fraction_of_a_pixel_is_in_the_correlation_too(bump, above) -> None:
    """A patch half a pixel off correlates by 1 at its own place, and by less at any whole pixel."""
    cx, cy = above.principal_point_px
    off = replace(above, principal_point_px=(cx + 0.5, cy - 0.5))
    signal = picture(off, nodes=65)
    found = sought(bump, plain_photo(signal, above))
    assert found.offset_px[0] == pytest.approx((0.5, -0.5), abs=0.01)
    assert (
        found.back_px[0] < 0.5
    )  # parabolas through whole pixels are good to a fifth, on either axis
    template = drawn(above)
    whole = max(
        correlation_at(signal, template.values[0], template.mask[0], template.origin[0, 1] + r, template.origin[0, 0] + c)
        for r in (-1, 0) for c in (0, 1)
    )  # fmt: skip
    assert whole < 0.995
    assert found.correlation[0] > 0.9999


@pytest.mark.parametrize("roll_deg", [0.0, 35.0, 90.0, 125.0])
def test_stripes_are_sure_across_and_unsure_along(roll_deg) -> None:
    """Ridges along north with little relief along them: the covariance is long in the image
    direction of north.
    """
    step = (np.arange(33) - 16) * 100.0
    east, north = np.meshgrid(step, -step)
    z = 60.0 * np.sin(east / 230) + 30.0 * np.cos(north / 400 + east / 900)
    ridges = catalog_of_patches((z - z[16, 16])[None].astype(np.float32), [HERE], 100.0)
    camera = above_it(roll_deg=roll_deg)
    template = render_patches(ridges, [0], camera, EAST[None], LAW)
    signal = np.full(camera.shape, template.values[template.mask].mean())
    col, row = template.origin[0]
    box = signal[row : row + template.shape[0], col : col + template.shape[1]]
    box[template.mask[0]] = template.values[template.mask]
    found = sought(ridges, plain_photo(noisy(signal, 0.03), camera), 2.0)
    variances, axes = np.linalg.eigh(found.covariance_px2[0])
    assert variances[1] > 4.0 * variances[0]
    ends = camera.project(HERE.to_mcmf([[0.0, -1e3, 0.0], [0.0, 1e3, 0.0]]))
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    assert abs(axes[:, 1] @ along) > np.cos(np.radians(8.0))


def test_no_match_is_better_than_the_floor(bump, above) -> None:
    photo = plain_photo(picture(above), above)
    plain, raised = (
        sought(bump, photo, criteria=Criteria(floor_px=f)).covariance_px2[0] for f in (0.02, 0.3)
    )
    np.testing.assert_allclose(raised - plain, (0.3**2 - 0.02**2) * np.eye(2), atol=1e-9)


# -- which points, how many at once


def test_a_point_on_the_far_side_is_not_in_view_though_it_lies_in_the_image(bump) -> None:
    camera = above_it()
    antipode = catalog_of_patches(bump.dem, [EnuFrame(179.0, 1.0)], 100.0)
    pixel = camera.project(antipode.position_mcmf)
    assert camera.in_image(pixel).all()
    blank = plain_photo(np.ones(camera.shape), camera)
    assert len(points_in_view(antipode, blank.sensor)) == 0
    assert points_in_view(bump, blank.sensor).tolist() == [0]


@pytest.mark.parametrize("roll_deg", [0.0, 45.0])
def test_what_is_rendered_at_once_is_bounded(bump, roll_deg) -> None:
    """Patches of 320 pixels a side: as many as have templates of two million pixels together, in
    any orientation.
    """
    camera = above_it(roll_deg=roll_deg, focal_px=6000.0)
    size = np.prod(drawn(camera).shape)
    count = point_search._at_once(
        bump, plain_photo(np.ones(camera.shape), camera), np.zeros(500, int)
    )
    assert size > 1e5
    assert 0.3e6 < count * size < 2.1e6
    near, far = (
        point_search._at_once(bump, plain_photo(np.ones((160, 160)), above_it(focal_px=f)), np.zeros(9, int))
        for f in (60000.0, 60.0)
    )  # fmt: skip
    assert (near, far) == (1, 128)


def test_a_point_without_an_exact_place_is_not_called_weak(bump, above) -> None:
    """The search may look at one place only, 2 px from the peak: it correlates above the limit there."""
    photo = plain_photo(picture(above, [(2, 0)]), above, EAST)
    found = sought(bump, photo, 0.0)
    assert REASONS[found.code[0]] == "no exact place"
    assert found.correlation[0] > Criteria().min_correlation
    assert said(bump, photo, 0.0, min_correlation=found.correlation[0] + 0.01) == "weak"
