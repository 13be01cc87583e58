"""Points sought in photographs: each part against a plain twin, and the whole on simulated frames of real terrain."""

from __future__ import annotations

from dataclasses import replace

import cv2
import mpmath
import numpy as np
import pytest
from catalogs import HADLEY
from hypothesis import given, settings
from hypothesis import strategies as st
from twins_match import catalog_of_dem, catalog_of_patches, looking_at

from lcp_catalog import simulate
from lcp_catalog.coarse_match import _log10_gamma_tail, coarse_shift
from lcp_catalog.detector import Detector
from lcp_catalog.kernels import correlate, register, search, spread
from lcp_catalog.kernels.way_back import seek_back
from lcp_catalog.match import Criteria, match, points_in_view, usable_now, working_photo
from lcp_catalog.matches import REASONS
from lcp_catalog.photo import Photo
from lcp_catalog.reflectance import reflectance_model
from lcp_catalog.request import Request, SunChoice, ViewChoice
from lcp_catalog.search_image import SearchImage
from lcp_catalog.sphere import EnuFrame, direction_enu

LAW = reflectance_model("lunar-lambert")
GSD_M = 118.45


@pytest.fixture(scope="module")
def catalog():
    """Patches of 33 x 33 nodes on a grid of 4.5 km around Hadley: they do not overlap, good and bad points alike."""
    lon, lat = np.meshgrid(np.linspace(3.02, 3.98, 7), np.linspace(25.56, 26.44, 7))
    return catalog_of_dem(lon.ravel(), lat.ravel(), 33, GSD_M)


@pytest.fixture(scope="module")
def camera():
    """300 km above, 15 degrees off the vertical, turned by 37 degrees; a pixel is a cell."""
    frame = EnuFrame(3.5, 26.0, -1000.0)
    return looking_at(frame, 300e3, 15, 60, 37, 300e3 / GSD_M, (320, 320), (159.7, 159.1))


def taken(camera, azimuth=100.0, elevation=20.0, noise=0.03, blur=0.5, seed=1):
    request = Request(
        [HADLEY], sun=SunChoice(azimuth, elevation), view=ViewChoice(camera), model=LAW, disc=False
    )
    return simulate.photo(request, Detector(blur_px=blur, noise=noise, bits=12, seed=seed))


@pytest.fixture(scope="module")
def photo(camera):
    return taken(camera)


@pytest.fixture(scope="module")
def found(catalog, photo):
    return match(catalog, photo, LAW, 20.0)


def plain_photo(signal, camera, sun, weight=None):
    weight = np.ones(signal.shape, np.float32) if weight is None else weight
    return Photo("made up", signal.astype(np.float32), weight, camera, sun_direction_mcmf=sun)


# -- correlation


def brute_correlation(window, values, mask):
    a, b = window[mask].astype(np.float64), values[mask].astype(np.float64)
    a, b = a - a.mean(), b - b.mean()
    return (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(2, 9),
    cols=st.integers(2, 11),
    level=st.floats(-1e3, 1e3),
)
def test_correlations_are_the_masked_normalised_ones(seed, rows, cols, level):
    rng = np.random.default_rng(seed)
    image = (rng.standard_normal((26, 31)) + level).astype(np.float32)
    values, mask = (
        rng.standard_normal((rows, cols)).astype(np.float32),
        rng.random((rows, cols)) < 0.7,
    )
    if mask.sum() < 3:
        return
    template = np.empty(values.shape, np.float32)
    count = correlate.centred(values, mask, template)
    ones = np.ones(image.shape, np.float32)
    score, real = correlate.correlations(image, ones, template, mask, count, 3, 4, 7, 6, 0.7)
    expected = [
        [brute_correlation(image[r : r + rows, c : c + cols], values, mask) for c in range(4, 10)]
        for r in range(3, 10)
    ]
    np.testing.assert_allclose(score, expected, atol=2e-4)
    assert (count, real) == (mask.sum(), 1.0)


def test_correlations_are_those_of_opencv(photo):
    image = SearchImage.of(photo)
    values = np.ascontiguousarray(image.fine[100:121, 90:109])
    template = np.empty(values.shape, np.float32)
    whole = np.ones(values.shape, bool)
    count = correlate.centred(values, whole, template)
    ones = np.ones(image.fine.shape, np.float32)
    score, _ = correlate.correlations(image.fine, ones, template, whole, count, 60, 50, 81, 81, 0.7)
    expected = cv2.matchTemplate(image.fine[60:161, 50:149], values, cv2.TM_CCOEFF_NORMED)
    np.testing.assert_allclose(score, expected, atol=1e-5)
    assert np.unravel_index(np.argmax(score), score.shape) == (40, 40)


def test_places_with_too_little_that_is_real_are_not_looked_at():
    rng = np.random.default_rng(3)
    image, weight = rng.standard_normal((20, 20)).astype(np.float32), np.ones((20, 20), np.float32)
    weight[:, :8] = 0.0
    values, mask = rng.standard_normal((5, 5)).astype(np.float32), np.ones((5, 5), bool)
    template = np.empty((5, 5), np.float32)
    count = correlate.centred(values, mask, template)
    score, real = correlate.correlations(image, weight, template, mask, count, 0, 0, 16, 16, 0.7)
    # of 5 columns 0.7 are 3.5: from column 7 on four of them are real
    assert (score[:, :7] == correlate.NOWHERE).all()
    assert (score[:, 7:] >= -1.0).all()
    assert real == 1.0


def test_halves_find_what_the_whole_search_finds(catalog, photo):
    quick, whole = (match(catalog, photo, LAW, 40.0, whole_search=w) for w in (False, True))
    both = quick.found & whole.found
    assert both.sum() >= 0.95 * whole.found.sum() > 20
    np.testing.assert_allclose(quick.found_px[both], whole.found_px[both], atol=1e-6)
    rivals = [np.nan_to_num(m.second[both], nan=-1.0) for m in (quick, whole)]
    assert (rivals[0] <= rivals[1] + 1e-4).mean() > 0.95


def test_a_peak_at_the_edge_of_the_search_counts_and_reach_is_kept():
    rng = np.random.default_rng(8)
    image = cv2.GaussianBlur(rng.standard_normal((90, 90)).astype(np.float32), (0, 0), 1.5)
    half = cv2.resize(image, (45, 45), interpolation=cv2.INTER_AREA)
    ones, half_ones = np.ones((90, 90), np.float32), np.ones((45, 45), np.float32)
    values, mask = image[40:60, 31:51][None].copy(), np.ones((1, 20, 20), bool)
    for reach, (right, down), coarse in [
        (6, (6, -4), True),
        (5, (5, 3), False),
        (9, (-9, 9), True),
    ]:
        out = np.full((1, search.NUMBERS), np.nan)
        origin = np.array([[31 - right, 40 - down]])
        search.seek(
            image, ones, half, half_ones, values, mask, origin, np.array([reach]), np.array([10.0]), 0.7,
            np.array([coarse]), out,
        )  # fmt: skip
        assert (out[0, 0], out[0, 1]) == (right, down)
        assert out[0, 2] == pytest.approx(1.0, abs=1e-5)
        assert out[0, 4] == 1.0


# -- the fraction of a pixel


def drawn(seed, size=30, sub=4, smooth=1.3):
    """A drawing with texture, its corner missing."""
    rng = np.random.default_rng(seed)
    fine = 2.0 + cv2.GaussianBlur(
        rng.standard_normal((size * sub, size * sub)), (0, 0), smooth * sub
    )
    fine = 2.0 + (fine - 2.0) / fine.std() * 0.2
    fine[: 6 * sub, : 8 * sub] = np.nan
    return fine.astype(np.float32)[None]


def shifted(fine, sub, sigma, right, down):
    """What `spread.see` makes of a drawing that is moved; 0 where nothing is seen."""
    light, known = np.empty_like(fine[0]), np.empty_like(fine[0])
    spread.unveil(fine[0], sub, light, known)
    rows, cols = fine.shape[1] // sub, fine.shape[2] // sub
    out = np.empty((4, rows, cols), np.float32)
    spread.see(light, known, sub, sigma, right, down, False, out)
    return out[0], out[3]


def refined(fine, sub, sigma, image, weight):
    out = np.full((1, register.NUMBERS), np.nan)
    start = np.zeros((1, 2), np.int64)
    register.refine(fine, sub, sigma, 0.95, image, weight, start, np.zeros((1, 2)), out)
    return out[0]


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000), right=st.floats(-0.6, 0.6), down=st.floats(-0.6, 0.6),
    gain=st.floats(0.01, 1e4), offset=st.floats(-10, 10),
)  # fmt: skip
def test_any_fraction_is_found_under_any_gain_and_offset(seed, right, down, gain, offset):
    fine = drawn(seed)
    image, cover = shifted(fine, 4, 0.6, right, down)
    result = refined(
        fine,
        4,
        0.6,
        (gain * (image + offset)).astype(np.float32),
        (cover > 0.99).astype(np.float32),
    )
    assert result[:2] == pytest.approx((right, down), abs=2e-3)
    assert result[2] == pytest.approx(1.0, abs=1e-4)
    assert result[6] == pytest.approx(gain, rel=1e-2)


def test_covariance_is_that_of_many_noisy_images_at_every_fraction_of_a_pixel():
    rng = np.random.default_rng(11)
    errors, squares = [], []
    for k in range(400):
        fine = drawn(k % 20)
        right, down = rng.uniform(-0.5, 0.5, 2)
        image, _ = shifted(fine, 4, 0.5, right, down)
        noisy = (image + 0.1 * rng.standard_normal(image.shape)).astype(np.float32)
        result = refined(fine, 4, 0.5, noisy, np.ones(image.shape, np.float32))
        error = result[:2] - (right, down)
        covariance = np.array([[result[3], result[4]], [result[4], result[5]]])
        errors.append([*error, right, down])
        squares.append(error @ np.linalg.solve(covariance, error))
        assert result[7] == pytest.approx(0.1, rel=0.2)
    errors = np.array(errors)
    assert np.mean(squares) == pytest.approx(2.0, rel=0.2)  # Monte Carlo: 2 / sqrt(400) = 0.1
    for axis in (0, 1):  # no locking: the error says nothing of the fraction
        sigma = errors[:, axis].std()
        assert abs(errors[:, axis].mean()) < 4 * sigma / 20
        for low in (-0.5, -0.25, 0.0, 0.25):
            part = (errors[:, 2 + axis] >= low) & (errors[:, 2 + axis] < low + 0.25)
            assert abs(errors[part, axis].mean()) < 4.5 * sigma / np.sqrt(part.sum())


def test_smooth_mismatch_widens_the_covariance():
    rng = np.random.default_rng(5)
    fine, squares, plain = drawn(3), [], []
    image, _ = shifted(fine, 4, 0.5, 0.2, -0.3)
    for _ in range(120):
        wrong = cv2.GaussianBlur(rng.standard_normal(image.shape), (0, 0), 1.5)
        bad = (image + 0.05 * wrong / wrong.std()).astype(np.float32)
        result = refined(fine, 4, 0.5, bad, np.ones(image.shape, np.float32))
        error = result[:2] - (0.2, -0.3)
        covariance = np.array([[result[3], result[4]], [result[4], result[5]]])
        squares.append(error @ np.linalg.solve(covariance, error))
        plain.append(result[9])
    assert np.median(plain) > 0.5
    assert 0.6 < np.mean(squares) < 3.4


def test_the_way_back_ends_where_it_began():
    fine = drawn(7, size=36)
    image, cover = shifted(fine, 4, 0.5, 0.0, 0.0)
    mask = (cover > 0.95)[None]
    values = np.where(mask, image[None], 0).astype(np.float32)
    whole = np.zeros((60, 60), np.float32)
    whole[10:46, 12:48] = image
    ones = np.ones(whole.shape, np.float32)
    for right, down in [(0, 0), (2, -1), (-3, 3)]:
        out = np.full((1, 3), np.nan)
        places = np.array([[12 + right, 10 + down]])
        seek_back(values, mask, whole, ones, places, 0.6, 5, 0.8, out)
        assert out[0, :2] == pytest.approx((right, down), abs=0.05)
        assert out[0, 2] > 0.99


# -- the whole


def test_finds_points_where_they_are(found):
    good = found.found
    assert good.sum() >= 30
    off = np.hypot(*found.offset_px[good].T)
    assert np.median(off) < 0.08
    assert (off < 1.0).mean() > 0.93
    assert np.abs(np.median(found.offset_px[good], axis=0)).max() < 0.02
    assert np.median(found.correlation[good]) > 0.9


def test_errors_agree_with_their_covariance(catalog, camera, found):
    squares = []
    for seed, (azimuth, elevation, noise) in enumerate([(100, 20, 0.03), (250, 30, 0.05)]):
        result = (
            found
            if seed == 0
            else match(catalog, taken(camera, azimuth, elevation, noise, seed=seed), LAW, 10.0)
        )
        good = result.found & (np.hypot(*result.offset_px.T) < 1.0)
        e, c = result.offset_px[good], result.covariance_px2[good]
        squares += np.einsum("ni,nij,nj->n", e, np.linalg.inv(c), e).tolist()
    squares = np.sort(squares)
    assert np.median(squares) == pytest.approx(1.386, rel=0.35)
    assert squares[: int(0.95 * len(squares))].mean() == pytest.approx(
        1.66, rel=0.35
    )  # of chi2_2 below its 95 %


def test_gain_and_offset_of_the_image_do_not_matter(catalog, photo, found):
    other = match(catalog, replace(photo, signal=photo.signal * 250.0 - 3.0), LAW, 20.0)
    np.testing.assert_array_equal(other.code, found.code)
    np.testing.assert_allclose(other.found_px[found.found], found.found_px[found.found], atol=2e-3)


def test_answers_are_in_the_pixels_of_the_image_as_it_came(catalog, camera):
    fine = looking_at(
        EnuFrame(3.5, 26.0, -1000.0), 300e3, 15, 60, 37, 2 * 300e3 / GSD_M, (400, 400)
    )
    reduced = taken(fine).reduced(2)
    result = match(catalog, reduced, LAW, 20.0)
    good = result.found
    np.testing.assert_allclose(
        result.predicted_px, fine.project(catalog.position_mcmf[result.point]), atol=1e-6
    )
    assert good.sum() >= 8
    assert np.abs(np.median(result.offset_px[good], axis=0)).max() < 0.06
    near = match(catalog, reduced, LAW, 10.0, offset_px=(16.0, 0.0))  # sought where nothing is
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
    result = match(catalog, wrong, LAW, np.full(len(rows), 3.0), points=rows, offset_px=offset)
    assert result.found.sum() >= 10
    np.testing.assert_allclose(
        result.found_px[result.found],
        found.found_px[np.isin(found.point, rows[result.found])],
        atol=0.05,  # another fraction of a pixel, the same noise
    )


def test_points_at_once_change_nothing(catalog, photo, found, monkeypatch):
    from lcp_catalog import match as module

    monkeypatch.setattr(module, "_CHUNK_PX", 20_000)
    again = match(catalog, photo, LAW, 20.0)
    np.testing.assert_array_equal(again.code, found.code)
    np.testing.assert_allclose(again.found_px[found.found], found.found_px[found.found], atol=1e-6)


def test_threads_change_nothing(catalog, photo, found):
    from lcp_catalog.threads import limit_threads

    with limit_threads(1):
        again = match(catalog, photo, LAW, 20.0)
    for name in found.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


# -- what was not found says why


def reasons(catalog, photo, reach=8.0, **more):
    result = match(catalog, photo, LAW, reach, points=np.arange(len(catalog)), **more)
    return [REASONS[code] for code in result.code]


@pytest.fixture(scope="module")
def bump():
    """One patch with a lone hill, at 0 N 0 E."""
    step = (np.arange(33) - 16) * 100.0
    east, north = np.meshgrid(step, -step)
    z = 250.0 * np.exp(-((east - 100) ** 2 + (north + 300) ** 2) / 7e5) + 60 * np.sin(
        east / 230
    ) * np.cos(north / 310)
    z -= z[16, 16]
    return catalog_of_patches(z[None].astype(np.float32), [EnuFrame(0.0, 0.0)], 100.0)


@pytest.fixture(scope="module")
def above():
    return looking_at(EnuFrame(0.0, 0.0), 60e3, 0, 0, 0, 600.0, (160, 160))


EAST = EnuFrame(0.0, 0.0).direction_to_mcmf(direction_enu(100, 30))


def picture(bump, above, places=((0, 0),)):
    """The patch's own render at some offsets, on noise."""
    from lcp_catalog.patch_render import render_patches

    template = render_patches(bump, [0], above, EAST[None], LAW)
    level = template.values[template.mask].mean()
    signal = level * (1 + 0.02 * np.random.default_rng(2).standard_normal(above.shape))
    for right, down in places:
        col, row = template.origin[0] + (right, down)
        box = signal[row : row + template.shape[0], col : col + template.shape[1]]
        box[template.mask[0]] = template.values[template.mask]
    return signal.astype(np.float32)


def test_a_picture_of_the_patch_is_found(bump, above):
    photo = plain_photo(picture(bump, above, [(3, -5)]), above, EAST)
    result = match(bump, photo, LAW, 8.0)
    assert REASONS[result.code[0]] == "found"
    assert result.offset_px[0] == pytest.approx((3, -5), abs=0.01)


def test_reasons(bump, above):
    signal = picture(bump, above)
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
    twice = picture(bump, above, [(0, 0), (45, 4)])
    assert reasons(bump, plain_photo(twice, above, EAST), 50.0) == ["ambiguous"]
    assert reasons(bump, photo, criteria=Criteria(max_back_px=-1.0)) == ["not confirmed"]
    side = replace(above, principal_point_px=(2.0, 79.5))
    assert reasons(bump, photo.with_sensor(side)) == ["out of frame"]


def test_missing_and_saturated_pixels_are_told_apart(bump, above):
    signal = picture(bump, above)
    hole = np.s_[55:105, 58:100]
    weight = np.ones(signal.shape, np.float32)
    weight[hole] = 0.0
    gone = signal.copy()
    gone[hole] = np.nan
    assert reasons(bump, plain_photo(gone, above, EAST, weight), 4.0) == ["no data"]
    assert reasons(bump, plain_photo(signal, above, EAST, weight), 4.0) == ["saturated"]


def test_a_few_bad_pixels_do_not_matter(bump, above):
    rng = np.random.default_rng(4)
    signal, weight = picture(bump, above, [(2, 1)]), np.ones(above.shape, np.float32)
    bad = rng.random(above.shape) < 0.08
    signal[bad], weight[bad] = 50.0, 0.0
    result = match(bump, plain_photo(signal, above, EAST, weight), LAW, 6.0)
    assert REASONS[result.code[0]] == "found"
    assert result.offset_px[0] == pytest.approx((2, 1), abs=0.02)


def test_a_photo_without_a_valid_pixel_is_refused(bump, above):
    nothing = np.zeros(above.shape, np.float32)
    with pytest.raises(ValueError, match="no pixel of it is valid"):
        match(bump, plain_photo(nothing, above, EAST, nothing), LAW)


def test_no_points_no_matches(bump, photo):
    assert len(match(bump, photo, LAW)) == 0  # the hill is not at Hadley


# -- which points, which scale


def test_points_in_view_are_in_the_image_and_face_it(catalog, photo):
    rows = points_in_view(catalog, photo)
    inside = photo.sensor.in_image(photo.sensor.project(catalog.position_mcmf))
    np.testing.assert_array_equal(rows, np.flatnonzero(inside))
    far = catalog_of_patches(catalog.dem[:1], [EnuFrame(183.5, -26.0)], GSD_M)  # behind the Moon
    assert far.position_mcmf.shape == (1, 3)
    assert len(points_in_view(far, photo)) == 0


def test_usable_points_come_first(catalog, photo):
    rows = points_in_view(catalog, photo)
    usable = usable_now(catalog, photo, rows)
    count = int(usable.sum())
    for most in (1, count - 1, count, count + 3, len(rows) - 1, len(rows), 1000):
        chosen = points_in_view(catalog, photo, most)
        assert len(chosen) == min(most, len(rows)) == len(np.unique(chosen))
        assert (np.diff(chosen) > 0).all()
        assert np.isin(chosen, rows[usable]).sum() == min(most, count)


def test_usable_is_the_nearest_condition(catalog, photo):
    towards = photo.sensor.towards(catalog.position_mcmf)
    suns = photo.sun_directions(catalog.position_mcmf)
    for row, answer in enumerate(usable_now(catalog, photo)):
        turn = catalog.rotation_mcmf_to_enu[row]
        views = [
            turn @ towards[row] @ direction_enu(a, 90 - o)
            for o, a in zip(catalog.view_off_nadir, catalog.view_azimuth, strict=True)
        ]
        best = max(
            (turn @ suns[row] @ direction_enu(a, e), i, j)
            for i, e in enumerate(catalog.sun_elevation)
            for j, a in enumerate(catalog.sun_azimuth)
        )
        assert answer == (catalog.condition[row, int(np.argmax(views)), best[1], best[2]] == 31)
    assert 0 < usable_now(catalog, photo).sum() < len(catalog)


@pytest.mark.parametrize(("pixel_m", "factor"), [(150.0, 1), (75.0, 2), (20.0, 7), (400.0, 1)])
def test_working_photo_has_half_the_resolution_of_the_dem(catalog, pixel_m, factor):
    # the DEM resolves 300 m: pixels up to 150 m are searched
    camera = looking_at(EnuFrame(3.5, 26.0, -1000.0), 100e3, 0, 0, 0, 100e3 / pixel_m, (140, 140))
    blank = plain_photo(np.ones((140, 140)), camera, EAST)
    rows = points_in_view(catalog, blank)
    assert working_photo(catalog, blank, rows).signal.shape == (140 // factor, 140 // factor)


# -- where the whole image lies


def test_the_coarse_offset_is_found_and_chance_is_not(catalog, camera, photo):
    moved = replace(
        camera,
        principal_point_px=(
            camera.principal_point_px[0] + 70.3,
            camera.principal_point_px[1] - 41.0,
        ),
    )
    wrong = photo.with_sensor(moved)
    rows = points_in_view(catalog, wrong)
    for reach, grid in ((90.0, 128), (160.0, 64)):
        shift = coarse_shift(catalog, wrong, LAW, reach, points=rows, grid_px=grid)
        assert (
            np.hypot(shift.offset_px[0] + 70.3, shift.offset_px[1] - 41.0)
            <= 1.5 * shift.precision_px
        )
        assert shift.log10_false_alarms < -8
        assert shift.rival_log10 > -3
    for turned in (photo.signal[::-1], photo.signal[:, ::-1], np.rot90(photo.signal)):
        other = replace(wrong, signal=np.ascontiguousarray(turned))
        assert (
            coarse_shift(catalog, other, LAW, 90.0, points=rows, grid_px=128).log10_false_alarms
            > -3
        )


def test_an_offset_of_each_point_is_added_before(catalog, camera, photo):
    rows = points_in_view(catalog, photo)
    known = np.random.default_rng(1).integers(-9, 10, (len(catalog), 2)).astype(float)
    # a function of the rows; points sought where they are not agree on nothing
    apart = coarse_shift(catalog, photo, LAW, 30.0, points=rows, offset_px=lambda r: 3.0 * known[r])
    together = coarse_shift(catalog, photo, LAW, 30.0, points=rows, offset_px=(12.0, -7.0))
    assert together.offset_px == pytest.approx((-12.0, 7.0), abs=1.0)
    assert together.log10_false_alarms < apart.log10_false_alarms - 5


def test_slack_bears_points_that_do_not_lie_together(catalog, photo):
    rows = points_in_view(catalog, photo)
    rng = np.random.default_rng(6)
    apart = rng.integers(-8, 9, (len(catalog), 2)).astype(float)
    without, with_slack = (
        coarse_shift(
            catalog, photo, LAW, 40.0, points=rows, offset_px=lambda r: apart[r], slack_px=s
        )
        for s in (0.0, 8.0)
    )
    assert with_slack.log10_false_alarms < -6
    assert np.hypot(*with_slack.offset_px) < 1.5
    assert np.hypot(*without.offset_px) > 2.0
    assert with_slack.precision_px == 9.0


def test_with_nothing_around_the_peak_nothing_is_said(catalog, photo):
    rows = points_in_view(catalog, photo)
    assert coarse_shift(catalog, photo, LAW, 4.0, points=rows) is None
    assert coarse_shift(catalog, photo, LAW, 90.0, points=[]) is None


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 400), share=st.floats(0.3, 8.0))
def test_the_tail_of_a_sum_of_votes(n, share):
    exact = mpmath.log10(mpmath.gammainc(n, n * share, mpmath.inf, regularized=True))
    assert _log10_gamma_tail(n, n * share) == pytest.approx(float(exact), rel=1e-6, abs=1e-9)
