"""Search for points in images: the whole search on simulated frames of real terrain, and why points
are not found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.claiming import claiming
from helpers.lone_hill import EAST, above_it, bump_catalog, picture, plain_photo
from helpers.match_frames import GSD_M, LAW, hadley_camera, hadley_catalog, hadley_photo, taken
from helpers.twins_match import catalog_of_patches, looking_at

from lcp_catalog.errors import SunError
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.matching.matches import REASONS
from lcp_catalog.matching.point_choice import (
    choose_points,
    points_in_view,
    usable_points,
    working_image,
)
from lcp_catalog.matching.point_search import Criteria, find_points
from lcp_catalog.matching.templates import render_patches

catalog = pytest.fixture(hadley_catalog, scope="module")
camera = pytest.fixture(hadley_camera, scope="module")
photo = pytest.fixture(hadley_photo, scope="module")
bump = pytest.fixture(bump_catalog, scope="module")
above = pytest.fixture(above_it, scope="module")


@pytest.fixture(scope="module")
def found(catalog, photo):
    return find_points(catalog, photo, LAW, 20.0)


# -- the whole


def test_finds_points_where_they_are(found):
    good = found.found
    assert good.sum() >= 30
    off = np.hypot(*found.offset_px[good].T)
    assert np.median(off) < 0.08
    assert (off < 1.0).mean() > 0.93
    assert np.abs(np.median(found.offset_px[good], axis=0)).max() < 0.02
    assert np.median(found.correlation[good]) > 0.9


@pytest.mark.slow
def test_errors_agree_with_their_covariance(catalog, camera, found):
    squares = []
    for seed, (azimuth, elevation, noise) in enumerate([(100, 20, 0.03), (250, 30, 0.05)]):
        result = (
            found
            if seed == 0
            else find_points(
                catalog, taken(camera, azimuth, elevation, noise, seed=seed), LAW, 10.0
            )
        )
        good = result.found & (np.hypot(*result.offset_px.T) < 1.0)
        e, c = result.offset_px[good], result.covariance_px2[good]
        squares += np.einsum("ni,nij,nj->n", e, np.linalg.inv(c), e).tolist()
    squares = np.sort(squares)
    assert np.median(squares) == pytest.approx(1.386, rel=0.35)
    assert squares[: int(0.95 * len(squares))].mean() == pytest.approx(
        1.66, rel=0.35
    )  # of chi2_2 below its 95 %


def test_halves_find_what_the_whole_search_finds(catalog, photo):
    quick, whole = (find_points(catalog, photo, LAW, 40.0, whole_search=w) for w in (False, True))
    both = quick.found & whole.found
    assert both.sum() >= 0.95 * whole.found.sum() > 20
    np.testing.assert_allclose(quick.found_px[both], whole.found_px[both], atol=1e-6)
    rivals = [np.nan_to_num(m.second[both], nan=-1.0) for m in (quick, whole)]
    assert (rivals[0] <= rivals[1] + 1e-4).mean() > 0.95


def test_gain_and_offset_of_the_image_do_not_matter(catalog, photo, found):
    other = find_points(catalog, replace(photo, signal=photo.signal * 250.0 - 3.0), LAW, 20.0)
    np.testing.assert_array_equal(other.code, found.code)
    np.testing.assert_allclose(other.found_px[found.found], found.found_px[found.found], atol=2e-3)


@pytest.mark.slow
def test_answers_are_in_the_pixels_of_the_image_as_it_came(catalog, camera):
    fine = looking_at(
        EnuFrame(3.5, 26.0, -1000.0), 300e3, 15, 60, 37, 2 * 300e3 / GSD_M, (400, 400)
    )
    reduced = taken(fine).reduced(2)
    result = find_points(catalog, reduced, LAW, 20.0)
    good = result.found
    np.testing.assert_allclose(
        result.predicted_px, fine.project(catalog.position_mcmf[result.point]), atol=1e-6
    )
    assert good.sum() >= 8
    assert np.abs(np.median(result.offset_px[good], axis=0)).max() < 0.06
    near = find_points(
        catalog, reduced, LAW, 10.0, offset_px=(16.0, 0.0)
    )  # sought where nothing is
    apart = (near.offset_px - (16.0, 0.0))[near.found]
    assert np.abs(apart).max(initial=0.0) <= 10.0 + 2 * 2
    sigma = np.sqrt(result.covariance_px2[good][:, [0, 1], [0, 1]])
    assert sigma.min() >= 2 * Criteria().floor_px


def test_search_starts_at_the_offset(catalog, camera, photo, found):
    moved = replace(
        camera,
        principal_point_px=(
            camera.principal_point_px[0] - 30.4,
            camera.principal_point_px[1] + 21.7,
        ),
    )
    wrong = photo.with_sensor(moved)
    rows = found.point[found.found][:12]
    offset = np.tile((30.4, -21.7), (len(rows), 1))
    result = find_points(
        catalog, wrong, LAW, np.full(len(rows), 3.0), points=rows, offset_px=offset
    )
    assert result.found.sum() >= 10
    np.testing.assert_allclose(
        result.found_px[result.found],
        found.found_px[np.isin(found.point, rows[result.found])],
        atol=0.05,  # another fraction of a pixel, the same noise
    )


def test_points_at_once_change_nothing(catalog, photo, found, monkeypatch):
    from lcp_catalog.matching import point_search

    monkeypatch.setattr(point_search, "_CHUNK_PX", 20_000)
    again = find_points(catalog, photo, LAW, 20.0)
    np.testing.assert_array_equal(again.code, found.code)
    np.testing.assert_allclose(again.found_px[found.found], found.found_px[found.found], atol=1e-6)


def test_threads_change_nothing(catalog, photo, found):
    from lcp_catalog.threads import limit_threads

    with limit_threads(1):
        again = find_points(catalog, photo, LAW, 20.0)
    for name in found.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


# -- what was not found says why


def reasons(catalog, photo, reach=8.0, **more):
    result = find_points(catalog, photo, LAW, reach, points=np.arange(len(catalog)), **more)
    return [REASONS[code] for code in result.code]


def test_a_picture_of_the_patch_is_found(bump, above):
    photo = plain_photo(picture(above, [(3, -5)]), above, EAST)
    result = find_points(bump, photo, LAW, 8.0)
    assert REASONS[result.code[0]] == "found"
    assert result.offset_px[0] == pytest.approx((3, -5), abs=0.01)


def test_reasons(bump, above):
    signal = picture(above)
    photo = plain_photo(signal, above, EAST)
    down = EnuFrame(0.0, 0.0).direction_to_mcmf(direction_enu(100, -5))
    assert reasons(bump, replace(photo, sun_direction_mcmf=down)) == ["not lit"]
    assert reasons(bump, photo, criteria=Criteria(min_lit_share=1.1)) == ["not lit"]
    grazing = looking_at(EnuFrame(0.0, 0.0), 60e3, 84, 0, 0, 600.0, (160, 160))
    assert reasons(bump, photo.with_sensor(grazing)) == ["not seen"]
    assert reasons(bump, photo, criteria=Criteria(min_contrast=5.0)) == ["low contrast"]
    noise = np.random.default_rng(0).standard_normal(signal.shape)
    assert reasons(bump, plain_photo(noise, above, EAST)) == ["weak"]
    rough = signal + 0.3 * signal.mean() * noise
    assert reasons(bump, plain_photo(rough, above, EAST)) == ["found"]
    strict = Criteria(min_correlation=0.9)
    assert reasons(bump, plain_photo(rough, above, EAST), criteria=strict) == ["weak"]
    twice = picture(above, [(0, 0), (45, 4)])
    assert reasons(bump, plain_photo(twice, above, EAST), 50.0) == ["ambiguous"]
    assert reasons(bump, photo, criteria=Criteria(max_back_px=-1.0)) == ["not confirmed"]
    side = replace(above, principal_point_px=(2.0, 79.5))
    assert reasons(bump, photo.with_sensor(side)) == ["at the edge"]


def test_missing_and_saturated_pixels_are_told_apart(bump, above):
    signal = picture(above)
    hole = np.s_[55:105, 58:100]
    weight = np.ones(signal.shape, np.float32)
    weight[hole] = 0.0
    gone = signal.copy()
    gone[hole] = np.nan
    assert reasons(bump, plain_photo(gone, above, EAST, weight), 4.0) == ["no data"]
    assert reasons(bump, plain_photo(signal, above, EAST, weight), 4.0) == ["saturated"]


def test_a_few_bad_pixels_do_not_matter(bump, above):
    rng = np.random.default_rng(4)
    signal, weight = picture(above, [(2, 1)]), np.ones(above.shape, np.float32)
    bad = rng.random(above.shape) < 0.08
    signal[bad], weight[bad] = 50.0, 0.0
    result = find_points(bump, plain_photo(signal, above, EAST, weight), LAW, 6.0)
    assert REASONS[result.code[0]] == "found"
    assert result.offset_px[0] == pytest.approx((2, 1), abs=0.02)


def test_a_photo_without_a_valid_pixel_is_refused(bump, above):
    nothing = np.zeros(above.shape, np.float32)
    with pytest.raises(ValueError, match="no pixel of it is valid"):
        find_points(bump, plain_photo(nothing, above, EAST, nothing), LAW)


def test_no_points_no_matches(bump, photo):
    assert len(find_points(bump, photo, LAW)) == 0  # the hill is not at Hadley


# -- which points, which scale


def test_points_in_view_are_in_the_image_and_face_it(catalog, photo):
    rows = points_in_view(catalog, photo.sensor)
    inside = photo.sensor.in_image(photo.sensor.project(catalog.position_mcmf))
    np.testing.assert_array_equal(rows, np.flatnonzero(inside))
    far = catalog_of_patches(catalog.dem[:1], [EnuFrame(183.5, -26.0)], GSD_M)  # behind the Moon
    assert far.position_mcmf.shape == (1, 3)
    assert len(points_in_view(far, photo.sensor)) == 0


def test_chosen_points_are_in_view_and_usable(catalog, photo):
    catalog = claiming(catalog, 40.0, 5000.0)
    rows = points_in_view(catalog, photo.sensor)
    suns = photo.sun_directions(catalog.position_mcmf[rows])
    usable = rows[usable_points(catalog, rows, photo.sensor, suns)]
    assert 0 < len(usable) < len(rows)
    middle = photo.sun_directions(catalog.position_mcmf.mean(axis=0))
    np.testing.assert_array_equal(choose_points(catalog, photo.sensor, middle), usable)
    for most in (0, 1, len(usable) - 1, len(usable), 1000):
        chosen = choose_points(catalog, photo.sensor, middle, most)
        assert len(chosen) == min(most, len(usable)) == len(np.unique(chosen))
        assert np.isin(chosen, usable).all()
        assert (np.diff(chosen) > 0).all()


def test_the_sun_of_a_camera_is_used_where_no_other_is_given(catalog, camera):
    with pytest.raises(SunError, match="has no position of the Sun"):
        choose_points(catalog, camera)
    with pytest.raises(SunError, match="has no position of the Sun"):
        render_patches(catalog, [0], camera)
    direction = catalog.rotation_mcmf_to_enu[0].T @ direction_enu(130.0, 30.0)
    lit = replace(
        camera, sun_position_mcmf_m=1.5e11 * direction
    )  # so far away that its rays are parallel
    np.testing.assert_array_equal(
        choose_points(catalog, lit), choose_points(catalog, lit, direction)
    )
    own, given = (
        render_patches(catalog, [0, 1], lit),
        render_patches(catalog, [0, 1], lit, direction),
    )
    np.testing.assert_allclose(own.values, given.values, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("pixel_m", "factor"), [(200.0, 1), (100.0, 2), (20.0, 12)])
def test_templates_keep_sixteen_pixels(catalog, pixel_m, factor):
    """The DEM resolves 1 km: half of it would leave 8 pixels of a patch of 33 nodes of 118.45 m."""
    assert catalog.patch_nodes * catalog.gsd[0] / 16.0 == pytest.approx(244.3, abs=0.5)
    coarse = replace(catalog, dem_resolution=np.full(len(catalog), 1000.0))
    camera = looking_at(EnuFrame(3.5, 26.0, -1000.0), 100e3, 0, 0, 0, 100e3 / pixel_m, (144, 144))
    blank = plain_photo(np.ones((144, 144)), camera, EAST)
    rows = points_in_view(catalog, blank.sensor)
    assert working_image(coarse, blank, rows).signal.shape == (144 // factor, 144 // factor)


@pytest.mark.parametrize(("pixel_m", "factor"), [(150.0, 1), (75.0, 2), (20.0, 7), (400.0, 1)])
def test_working_image_has_half_the_resolution_of_the_dem(catalog, pixel_m, factor):
    # the DEM resolves 300 m: pixels up to 150 m are searched
    camera = looking_at(EnuFrame(3.5, 26.0, -1000.0), 100e3, 0, 0, 0, 100e3 / pixel_m, (140, 140))
    blank = plain_photo(np.ones((140, 140)), camera, EAST)
    rows = points_in_view(catalog, blank.sensor)
    assert working_image(catalog, blank, rows).signal.shape == (140 // factor, 140 // factor)
