"""The whole search on synthetic terrain: right images are located, from near and far; wrong ones
never are.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from helpers import small_world
from helpers.claiming import claiming
from helpers.posed import PlainMap
from helpers.small_world import GSD_M, LAW, UNCERTAIN, World, believed, mirrored, overhead

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty, pixel_size_m
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.matching import position_fix
from lcp_catalog.matching.consensus import Consensus
from lcp_catalog.matching.fix import CANNOT_SAY, LOCATED, NOT_HERE, Fix
from lcp_catalog.matching.matches import CODE, REASONS, SEARCHED, Matches
from lcp_catalog.matching.options import Options
from lcp_catalog.matching.point_choice import PointClaims, points_in_view
from lcp_catalog.matching.pose import Pose, jacobian, position_error
from lcp_catalog.matching.position_fix import locate, nothing_in
from lcp_catalog.matching.search_area import CoarseShift, narrowed, perhaps_in_view

QUICK = Options(check_sun=False)


@pytest.fixture(scope="module")
def world() -> World:
    return small_world.world()


@pytest.fixture(scope="module")
def points(world: World) -> Catalog:
    return world.catalog()


@pytest.fixture(scope="module")
def photo(world: World) -> Image:
    return world.photo(overhead())


def off_px(answer: Fix, points: Catalog, known: Camera) -> np.ndarray:
    """Distance of the inliers from the known sensor's projections."""
    matches = answer.matches
    true = known.project(points.position_mcmf[matches.point])
    return np.hypot(*(matches.found_px - true)[matches.found].T)


def is_right(answer: Fix, points: Catalog, known: Camera) -> bool:
    """True for a pose within its own sigmas (in three dimensions, 0.1 % of right ones exceed 16.3)
    whose accepted matches all lie within 1.5 cells on the surface.
    """
    assert answer.pose is not None
    error = position_error(answer.pose, known)
    pixel_m = float(pixel_size_m(known, points.position_mcmf[len(points) // 2]))
    return error.squared < 16.3 and off_px(answer, points, known).max() * pixel_m < 1.5 * GSD_M


# -- found


@pytest.mark.parametrize(
    "camera",
    [
        pytest.param(overhead(), marks=pytest.mark.slow),
        overhead(turns=(0.15, -0.1, 2.5)),
        overhead(pixel_m=200.0, size_px=360),
    ],
    ids=["overhead", "turned", "fine"],
)
def test_a_camera_comes_back(world: World, points: Catalog, camera: Camera) -> None:
    given = believed(world.photo(camera, seed=3), 3)
    answer = locate(points, given, UNCERTAIN, LAW)
    assert answer.verdict == LOCATED
    assert "points agree" in answer.reason
    assert is_right(answer, points, camera)
    assert answer.matches.found.sum() == answer.pose.used.sum() >= 20
    assert answer.pose.position_sigma_m < 150.0
    assert answer.log10_false_alarms < -20.0
    assert answer.sun is not None
    assert answer.sun.fits
    expected = given.sensor.project(points.position_mcmf[answer.matches.point])
    assert np.array_equal(answer.matches.predicted_px, expected)


def test_a_search_is_the_last_if_others_would_change_nothing(
    points: Catalog, photo: Image, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against as many searches as are allowed; from a camera that is right one is enough."""
    searches, near = [], position_fix._FixSearch.near

    def counted(self: position_fix._FixSearch, pose: Pose) -> Matches:
        searches.append(pose)
        return near(self, pose)

    monkeypatch.setattr(position_fix._FixSearch, "near", counted)
    for image, enough in ((photo, 1), (believed(photo), 2)):
        searches.clear()
        found = locate(points, image, UNCERTAIN, LAW, QUICK).pose
        assert len(searches) == enough
        with monkeypatch.context() as patient:
            patient.setattr(position_fix, "_SETTLED", 0.0)
            best = locate(points, image, UNCERTAIN, LAW, QUICK).pose
        assert len(searches) == enough + QUICK.passes
        assert found is not None
        assert best is not None
        assert (np.abs(found.correction - best.correction) < 0.005 * best.sigma).all()


def test_from_far_off_the_whole_image_is_shifted_first(points: Catalog, photo: Image) -> None:
    far = Uncertainty(9000.0, np.radians(0.5))
    given = photo.with_sensor(photo.sensor.moved([9e3, -1.2e4, 5e3, 0.01, -0.008, 0.005]))
    area = perhaps_in_view(points, given.sensor, far, 3.0)
    assert np.median(area.reach_px) > QUICK.most_reach_px
    narrow, chance, slack = narrowed(area, points, given, given.sensor, far, LAW, 3.0, 16.0)
    true = photo.sensor.project(points.position_mcmf[area.points])
    off = true - given.sensor.project(points.position_mcmf[area.points]) - narrow.offset_px
    assert (np.abs(off) <= narrow.reach_px[:, None]).mean() > 0.95
    assert np.median(narrow.reach_px) < 0.6 * np.median(area.reach_px)
    assert narrow.log10_places > 0.4
    assert narrow.reach_px.min() >= 16.0
    assert chance < -10.0
    assert slack < 33.0
    answer = locate(points, given, far, LAW, QUICK)
    assert answer.verdict == LOCATED
    assert is_right(answer, points, photo.sensor)


def test_points_too_few_for_a_significant_shift_are_searched_for_one_by_one(
    points: Catalog, photo: Image
) -> None:
    """12 points: a quarter of them agreeing on a shift would be no evidence, so none is no evidence
    against the place.
    """
    far = Uncertainty(9000.0, np.radians(0.5))
    few = points.take(np.linspace(0, len(points) - 1, 12).astype(int))
    given = photo.with_sensor(photo.sensor.moved([9e3, -1.2e4, 5e3, 0.01, -0.008, 0.005]))
    area = perhaps_in_view(few, given.sensor, far, 3.0)
    assert np.median(area.reach_px) > QUICK.most_reach_px
    _, chance, _ = narrowed(area, few, given, given.sensor, far, LAW, 3.0, 16.0)
    assert chance == -math.inf
    answer = locate(few, given, far, LAW, QUICK)
    assert answer.verdict == LOCATED
    assert is_right(answer, few, photo.sensor)
    for how in ("left-right", "180"):
        assert locate(few, mirrored(given, how), far, LAW, QUICK).verdict != LOCATED


def test_a_shift_of_the_image_leaves_what_it_does_not_decide(
    points: Catalog, photo: Image, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sensor that may only be turned, by 0.05 rad: a shift gives its sideways attitude, with a
    tenth more effect 18 deg off the axis; the roll stays, which moves a place by 0.05 of its
    distance from the middle.
    """
    uncertain, sensor = Uncertainty(0.0, 0.05), photo.sensor
    area = perhaps_in_view(points, sensor, uncertain, 3.0)
    slope = jacobian(sensor, points.position_mcmf[area.points])
    aside = slope @ [0.0, 0.0, 0.0, 0.06, -0.04, 0.0]
    shift = CoarseShift((aside[:, 0].mean(), aside[:, 1].mean()), -30.0, -1.0, 0.2, 50)
    monkeypatch.setattr("lcp_catalog.matching.search_area.coarse_shift", lambda *_, **__: shift)
    narrow, chance, _ = narrowed(area, points, photo, sensor, uncertain, LAW, 3.0, 4.0)
    assert chance == -30.0
    assert np.ptp(aside, axis=0).max() > 4.0
    assert np.abs(narrow.offset_px - aside).max() < 0.5
    away = np.abs(sensor.project(points.position_mcmf[area.points]) - 99.5).max(-1)
    assert np.allclose(narrow.reach_px, np.maximum(3.0 * 0.05 * away, 4.0), atol=1.5)
    assert narrow.reach_px.min() == 4.0
    ratio = np.median(area.reach_px) / np.median(narrow.reach_px)
    assert narrow.log10_places == pytest.approx(2.0 * np.log10(ratio))


def test_tolerances_are_in_the_searched_photographs_pixels(
    world: World, points: Catalog, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pixels of 100 m with cells of 400 m are searched at a quarter: one searched pixel is four of
    the full-resolution image.
    """
    asked = {}

    def listen(*_: object, **options: float) -> Consensus:
        asked.update(options)
        return Consensus(None, 0.0, 0.0)

    monkeypatch.setattr("lcp_catalog.matching.position_fix.agree", listen)
    camera = overhead(pixel_m=100.0, size_px=400)
    locate(points, world.photo(camera), Uncertainty(200.0), LAW, replace(QUICK, tolerance_px=0.7))
    assert asked["tolerance_px"] == pytest.approx(4.0 * 0.7)
    assert asked["width_px"] == pytest.approx(4.0 * 32.0, rel=0.05)


@pytest.mark.slow
def test_a_map_is_shifted_onto_its_ground(world: World, points: Catalog) -> None:
    sheet = PlainMap(world.frame, 700.0, -1300.0)
    image = world.photo(sheet)
    answer = locate(
        points, image.with_sensor(PlainMap(world.frame)), Uncertainty(1500.0), LAW, QUICK
    )
    assert answer.verdict == LOCATED
    assert np.abs(answer.pose.correction - [700.0, -1300.0]).max() < 30.0
    assert np.abs(answer.pose.correction - [700.0, -1300.0]).max() < 4.0 * answer.pose.sigma.max()


def test_a_match_that_is_off_by_itself_is_inconsistent(points: Catalog, photo: Image) -> None:
    """A piece of the image about one point is moved by 4 px: the point is found there, and does not
    count.
    """
    place = photo.sensor.project(points.position_mcmf)
    row = int(np.argmin(np.hypot(*(place - 99.5).T)))
    c, r = place[row].round().astype(int)
    signal = photo.signal.copy()
    signal[r - 24 : r + 25, c - 20 : c + 29] = photo.signal[r - 24 : r + 25, c - 24 : c + 25]
    answer = locate(points, believed(replace(photo, signal=signal)), UNCERTAIN, LAW, QUICK)
    assert answer.verdict == LOCATED
    assert answer.matches.code[answer.matches.point == row] == CODE["inconsistent"]
    assert np.array_equal(answer.matches.found, answer.pose.used)
    assert is_right(answer, points, photo.sensor)


def test_the_position_alone(points: Catalog, photo: Image) -> None:
    given = photo.with_sensor(photo.sensor.moved([900.0, 1500.0, -1100.0, 0.0, 0.0, 0.0]))
    answer = locate(points, given, Uncertainty(1500.0), LAW, QUICK)
    assert answer.verdict == LOCATED
    assert (answer.pose.correction[3:] == 0.0).all()
    assert is_right(answer, points, photo.sensor)
    assert position_error(answer.pose, photo.sensor).error.across_m < 0.3 * GSD_M


def test_the_same_again_is_the_same(points: Catalog, photo: Image) -> None:
    one, two = (locate(points, believed(photo), UNCERTAIN, LAW, QUICK) for _ in range(2))
    assert np.array_equal(one.pose.correction, two.pose.correction)
    assert np.array_equal(one.matches.code, two.matches.code)


# -- not believed


@pytest.mark.parametrize(
    "how",
    [
        "left-right",
        "90",
        *(pytest.param(h, marks=pytest.mark.slow) for h in ("up-down", "180", "270")),
    ],
)
def test_a_turned_or_mirrored_image_is_no_place(points: Catalog, photo: Image, how: str) -> None:
    answer = locate(points, believed(mirrored(photo, how)), UNCERTAIN, LAW, QUICK)
    assert answer.verdict == NOT_HERE
    assert answer.pose is None
    assert "agree on no place" in answer.reason


def test_another_place_is_not_this_one(points: Catalog) -> None:
    elsewhere = World(seed=2).photo(overhead())
    near = locate(points, believed(elsewhere), UNCERTAIN, LAW, QUICK)
    far = locate(points, believed(elsewhere), Uncertainty(9000.0, np.radians(0.5)), LAW, QUICK)
    assert near.verdict == far.verdict == NOT_HERE
    assert near.pose is far.pose is None
    assert len(far.matches) > 0
    assert not far.matches.found.any()


@pytest.mark.slow
def test_half_saturated_is_located_by_the_rest_or_not_at_all(points: Catalog, photo: Image) -> None:
    level = np.nanmedian(photo.signal)
    weight = np.where(photo.signal >= level, 0.0, photo.weight).astype(np.float32)
    cut = replace(photo, signal=np.minimum(photo.signal, level), weight=weight)
    for image in (cut, replace(cut, weight=photo.weight)):
        answer = locate(points, believed(image), UNCERTAIN, LAW)
        assert answer.pose is None or is_right(answer, points, photo.sensor)


def test_noise_is_nothing(points: Catalog, photo: Image) -> None:
    dice = np.random.default_rng(0)
    grain = dice.normal(0.1, 0.02, photo.signal.shape).astype(np.float32)
    blank = np.full(photo.signal.shape, 0.1, dtype=np.float32)
    for signal in (grain, blank, blank + 1e-4 * grain):
        answer = locate(points, believed(replace(photo, signal=signal)), UNCERTAIN, LAW)
        assert answer.verdict == CANNOT_SAY
        assert "blank or nothing but noise" in answer.reason


def test_clouds_are_no_place(points: Catalog, photo: Image) -> None:
    """Noise with the spectrum of terrain."""
    dice = np.random.default_rng(1)
    wave = np.hypot(*np.meshgrid(np.fft.fftfreq(200), np.fft.rfftfreq(200), indexing="ij"))
    spectrum = np.fft.rfft2(dice.normal(size=(200, 200))) / np.maximum(wave, 0.01)
    signal = (1.0 + 0.2 * np.fft.irfft2(spectrum, s=(200, 200))).astype(np.float32)
    answer = locate(points, believed(replace(photo, signal=signal)), UNCERTAIN, LAW, QUICK)
    assert answer.verdict == NOT_HERE


def test_no_valid_pixel(points: Catalog, photo: Image) -> None:
    image = replace(photo, weight=np.zeros_like(photo.weight))
    assert locate(points, image, UNCERTAIN, LAW).reason == "the image has no valid pixel"
    assert nothing_in(photo) is None


# -- what cannot be said


def test_another_side_of_the_moon(points: Catalog, world: World, photo: Image) -> None:
    image = photo.with_sensor(overhead(EnuFrame(world.frame.lon_deg + 150.0, -10.0)))
    answer = locate(points, image, UNCERTAIN, LAW)
    assert answer.verdict == CANNOT_SAY
    said = re.fullmatch(
        rf"none of the catalogue's {len(points)} points can be in view: the image's centre shows longitude "
        r"([\d.]+), latitude (-?[\d.]+), (\d+) km from the nearest point; the points lie at longitude "
        r"([\d.]+) \.\. ([\d.]+), latitude (-?[\d.]+) \.\. (-?[\d.]+)",
        answer.reason,
    )
    assert said is not None
    lon, lat, away_km, west, east, south, north = map(float, said.groups())
    assert (lon, lat) == pytest.approx(((world.frame.lon_deg + 150.0) % 360.0, -10.0), abs=0.0051)
    assert (west, east) == pytest.approx(
        (points.longitude.min(), points.longitude.max()), abs=0.0051
    )
    assert (south, north) == pytest.approx(
        (points.latitude.min(), points.latitude.max()), abs=0.0051
    )
    east_deg, here, there = (
        np.radians(at) for at in (points.longitude - lon, lat, points.latitude)
    )
    cosine = np.sin(here) * np.sin(there) + np.cos(here) * np.cos(there) * np.cos(east_deg)
    assert away_km == pytest.approx(1737.4 * math.acos(cosine.max()), abs=0.8)
    assert len(answer.matches) == 0


def test_at_night_it_says_so(points: Catalog, photo: Image, world: World) -> None:
    night = replace(photo, sun_direction_mcmf=-world.frame.rotation[2])
    answer = locate(points, believed(night), UNCERTAIN, LAW)
    assert answer.verdict == CANNOT_SAY
    assert "not lit" in answer.reason


@pytest.mark.slow
def test_few_points_refute_no_place(world: World, photo: Image) -> None:
    few = world.catalog(step_m=8e3, half_m=20e3)
    answer = locate(few, believed(mirrored(photo, "180")), UNCERTAIN, LAW)
    assert answer.verdict == CANNOT_SAY
    said = re.fullmatch(
        r"too few points can be searched for: (\d+), and at least (\d+) are needed; "
        r"of (\d+) that may be in view (.*)",
        answer.reason,
    )
    assert said is not None
    searched, needed, in_view = map(int, said.groups()[:3])
    counts = answer.matches.counts()
    assert searched == sum(counts.get(REASONS[code], 0) for code in SEARCHED) < needed
    assert in_view == sum(counts.values())
    assert said[4] == ", ".join(f"{count} {reason}" for reason, count in counts.items())
    more = world.catalog(step_m=6.5e3, half_m=20e3)
    refuted = locate(more, believed(mirrored(photo, "180")), UNCERTAIN, LAW)
    assert np.isin(refuted.matches.code, SEARCHED).sum() >= needed
    assert refuted.verdict == NOT_HERE


def test_points_that_are_not_expected_to_be_found_refute_no_place(
    points: Catalog, photo: Image
) -> None:
    """The verdict on the image of another place depends on what the catalogue claims for its Sun. Half of the
    points about which it claims nothing count as expected.
    """
    sure = claiming(points, 40.0, 5000.0)
    hardly = replace(
        sure,
        detection_probability=0.02 * np.asarray(sure.detection_probability),
        errors=dict(sure.errors) | {"min_detection": 0.01},
    )
    turned = believed(mirrored(photo, "180"))
    refuted, undecided = (locate(one, turned, UNCERTAIN, LAW, QUICK) for one in (sure, hardly))
    assert refuted.verdict == NOT_HERE
    assert undecided.verdict == CANNOT_SAY
    searched = np.isin(undecided.matches.code, SEARCHED)
    expected = np.nan_to_num(undecided.matches.prior[searched], nan=0.5).sum()
    assert f"only {expected:.3g} are expected to be found" in undecided.reason
    assert 0.0 < expected < 0.25 * searched.sum()


def test_an_uncertainty_beyond_any_search(points: Catalog, photo: Image) -> None:
    answer = locate(points, photo, Uncertainty(60e3, np.radians(4.0)), LAW)
    assert answer.verdict == CANNOT_SAY
    assert "state a smaller one" in answer.reason


def test_a_place_beyond_the_stated_uncertainty_is_not_taken(points: Catalog, photo: Image) -> None:
    """A search reaches 16 pixels for any stated uncertainty; a position 6 stated sigmas away is
    reported, not accepted.
    """
    given = photo.with_sensor(photo.sensor.moved([0.0, 1200.0, 0.0, 0.0, 0.0, 0.0]))
    answer = locate(points, given, Uncertainty(250.0), LAW, QUICK)
    assert answer.pose is None
    assert answer.verdict == CANNOT_SAY
    assert "stated sigmas away" in answer.reason


# -- which points


def test_points_that_may_be_in_view_hold_those_that_are(points: Catalog, photo: Image) -> None:
    for seed in range(20):
        given = believed(photo, seed)
        area = perhaps_in_view(points, given.sensor, UNCERTAIN, 3.0)
        assert set(points_in_view(points, photo.sensor)) <= set(area.points)
        true = photo.sensor.project(points.position_mcmf[area.points])
        off = np.abs(true - given.sensor.project(points.position_mcmf[area.points])).max(-1)
        assert (off <= area.reach_px).mean() > 0.9
        assert (area.at_least(30.0).reach_px >= 30.0).all()


def test_a_narrow_camera_far_off_may_see_points_that_it_does_not_expect(points: Catalog) -> None:
    """An image of 4 km, a sensor 30 km off: within 3 sigma of 12 km the points about the true place
    may be in view.
    """
    known = overhead(size_px=20, pixel_m=200.0)
    given = known.moved([0.0, 30e3, 0.0, 0.0, 0.0, 0.0])
    area = perhaps_in_view(points, given, Uncertainty(12e3), 3.0)
    assert set(points_in_view(points, known)) <= set(area.points)
    assert len(area) < len(points)


@pytest.mark.slow
@pytest.mark.parametrize("every", [3, 40])
def test_a_pose_is_solved_with_the_usable_points_if_they_are_enough(
    points: Catalog, photo: Image, monkeypatch: pytest.MonkeyPatch, every: int
) -> None:
    """Every third point usable, the next one without claims: these; every fortieth (fewer than 6): all that
    agree.
    """
    claims = PointClaims.of

    def some_usable(catalog: Catalog, rows: np.ndarray, *how: object) -> PointClaims:
        known = np.where(rows % every == 1, np.nan, 0.6)
        return replace(claims(catalog, rows, *how), probability=known, usable=rows % every == 0)

    monkeypatch.setattr(PointClaims, "of", some_usable)
    answer = locate(points, believed(photo, 3), UNCERTAIN, LAW)
    assert answer.pose is not None
    found, usable = answer.matches.found, answer.matches.point % every < 2
    enough = (found & usable).sum() >= 6
    assert enough == (every == 3)
    np.testing.assert_array_equal(answer.pose.used, found & usable if enough else found)
