"""Expected accuracy of a position, against OpenCV's projection, numerical derivatives and positions
solved by scipy.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from helpers import catalogs
from helpers.navigable import everywhere_usable
from helpers.posed import HADLEY, camera, ground, turned
from scipy.optimize import least_squares

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.prediction import predict
from lcp_catalog.geometry.frames import EnuFrame, enu_rotation, mcmf_to_lonlat
from lcp_catalog.light.sun_choice import SunChoice
from lcp_catalog.navigation.documents import position_text, result_line
from lcp_catalog.navigation.expected_position import Answer, Query, answers
from lcp_catalog.navigation.frame_points import CAUSES, PlannedImage
from lcp_catalog.navigation.information import Information, best_points

SUN, ALL = SunChoice(100.0, 17.0), Query()
BENT = (-0.08, 0.02, 0.001, -0.0008, 0.0)


def asked(catalog: Catalog, taken: Camera, query: Query = ALL) -> Answer:
    (answer,) = answers(catalog, [PlannedImage.lit(taken, SUN)], query)
    return answer


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return everywhere_usable()


def test_a_sun_below_the_horizon_is_said_after_the_causes(catalog: Catalog) -> None:
    """With points in view, which have a cause, and with none."""
    night = r"the Sun is \d+\.\d deg below the horizon, towards azimuth \d+\);"
    causes = r"\d+ Sun outside the catalogue's; "
    for place, before in ((HADLEY, causes), (EnuFrame(40.0, 0.0), "")):
        frame = PlannedImage.lit(camera(place), SunChoice(90.0, -18.0))
        (answer,) = answers(catalog, [frame], ALL)
        assert (answer.counts["in_view"] > 0) == bool(before)
        assert re.search(rf"points in view usable \({before}{night}", result_line(answer))


def test_points_whose_sun_is_outside_the_table_locate_by_the_claims_of_its_end(
    catalog: Catalog,
) -> None:
    """Half a step beyond the lowest Sun its claims are stated, and no point is usable by them; farther there are none."""
    lowest, step = np.asarray(catalog.sun_elevation)[0], np.diff(catalog.sun_elevation)[0]
    inside, beside, beyond = (
        catalog.query(camera(EnuFrame(*catalogs.CENTER)), SunChoice(100.0, float(lowest + above)))
        for above in (3.0, -0.4 * step, -0.9 * step)
    )
    assert inside.joint.located > 0.9
    assert beside.usable == 0
    assert beside.joint.located > 0.9
    assert (beyond.usable, beyond.joint.expected, beyond.joint.located) == (0, 0.0, 0.0)


@pytest.fixture(scope="module")
def taken() -> Camera:
    """A metric camera with a bent lens, a little tilted."""
    return replace(camera(tilt=(0.03, -0.05, 0.4)), distortion=np.array(BENT))


@pytest.mark.parametrize(
    ("product", "tie_m"), [("GLD100_256", 30.0), ("SLDEM2015_512", 10.0), ("made_59m", 0.0)]
)
def test_without_a_stated_one_the_maps_error_is_that_of_its_product(
    catalog: Catalog, taken: Camera, product: str, tie_m: float
) -> None:
    names = np.full(len(catalog), "made_59m", object)
    names[len(names) // 2] = product  # the largest of several counts
    cut = replace(catalog, dem_product=names)
    own, stated = (asked(cut, taken, Query(map_sigma_m=m)).position for m in (None, tie_m))
    assert own.budget_m == stated.budget_m
    np.testing.assert_array_equal(own.covariance, stated.covariance)
    assert (own.map_sigma_m, own.untied) == (tie_m, ("made_59m",))  # what is not counted is named
    assert stated.untied == ()
    named = "no error of the map's place is published for made_59m, and none counted"
    assert (named in position_text(own), named in position_text(stated)) == (True, False)


def by_opencv(taken: Camera, points: np.ndarray, correction: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of the camera moved by a shift and a turn."""
    rotation = turned(correction[3:]) @ taken.rotation_mcmf_to_camera
    shift = -rotation @ (taken.position_mcmf_m + correction[:3])
    f, (cx, cy) = taken.focal_length_px, taken.principal_point_px
    matrix = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1.0]])
    pixels, _ = cv2.projectPoints(
        points, cv2.Rodrigues(rotation)[0], shift, matrix, taken.distortion
    )
    return pixels[:, 0]


def slopes_by_opencv(taken: Camera, points: np.ndarray) -> np.ndarray:
    """Derivatives (n, 2, 6) of OpenCV's pixels by central differences."""
    columns = []
    for step in np.diag([10.0] * 3 + [1e-4] * 3):
        apart = by_opencv(taken, points, step) - by_opencv(taken, points, -step)
        columns.append(apart / (2.0 * step.sum()))
    return np.stack(columns, axis=-1)


def ground_covariance(major: float, minor: float, angle_deg: float) -> np.ndarray:
    """Covariance (2, 2) east and north of an ellipse."""
    t = np.radians(angle_deg)
    axes = np.array([[np.sin(t), np.cos(t)], [np.cos(t), -np.sin(t)]])
    return axes.T @ np.diag([major**2, minor**2]) @ axes


def test_the_points_are_those_of_a_loop_over_all(catalog: Catalog, taken: Camera) -> None:
    """Pixels by OpenCV, and claims asked for one point alone; views from the east, which points seen from the
    west are too far from.
    """
    east = {"view_off_nadir": np.array([15.0, 20.0, 25.0]), "view_azimuth": np.full(3, 90.0)}
    catalog = replace(catalog, **east)
    answer = asked(catalog, taken)
    pixels = by_opencv(taken, catalog.position_mcmf, np.zeros(6))
    height, width = taken.shape
    rows, causes = [], []
    for i in range(len(catalog)):
        if not (-0.5 <= pixels[i, 0] < width - 0.5 and -0.5 <= pixels[i, 1] < height - 0.5):
            continue
        frame = catalog.rotation_mcmf_to_enu[i]
        away = taken.position_mcmf_m - catalog.position_mcmf[i]
        view = frame @ away / np.linalg.norm(away)
        flat = catalog.position_mcmf[i] + np.cross(np.eye(3)[:2], away / np.linalg.norm(away))
        around = by_opencv(taken, flat, np.zeros(6)) - pixels[i]
        sine = np.linalg.norm(np.cross(flat[0] - catalog.position_mcmf[i], flat[1] - catalog.position_mcmf[i]))  # fmt: skip
        pixel_m = np.sqrt(sine / abs(np.linalg.det(around)))
        sun = frame @ SUN.direction_mcmf(HADLEY, None)
        high_m = np.linalg.norm(taken.position_mcmf_m) - np.linalg.norm(catalog.position_mcmf[i])
        claim = predict(catalog, [i], sun, view, pixel_m, 1e-3 * high_m)
        half = 4 * catalogs.GSD_M
        corners = [
            catalog.position_mcmf[i] + half * (a * frame[0] + b * frame[1])
            for a, b in itertools.product((-1, 1), (-1, 1))
        ]
        at = by_opencv(taken, np.array(corners), np.zeros(6))
        inside = ((at >= -0.5) & (at < [width - 0.5, height - 0.5])).all()
        cause = CAUSES[claim.cause[0]]
        causes.append(cause if inside or cause != "usable" else "edge")
        rows += [i] if causes[-1] == "usable" else []
    assert answer.rows.tolist() == rows
    assert len(rows) >= 15
    assert answer.counts["in_view"] == len(causes)
    assert {name: answer.counts[name] for name in CAUSES} == {n: causes.count(n) for n in CAUSES}
    assert answer.counts["view"] > 0
    np.testing.assert_allclose(answer.pixel, pixels[rows], atol=1e-6)


def test_a_patch_that_the_image_cuts_at_any_side_is_not_usable() -> None:
    """Patches of 3.8 km, and cameras around Hadley whose image is 16 km wide."""
    catalog, half = everywhere_usable(60, 33), 16 * catalogs.GSD_M
    sides = np.zeros(4, int)
    for lon, lat in itertools.product((3.1, 3.4, 3.9), (25.7, 25.95, 26.1, 26.25)):
        over = camera(EnuFrame(lon, lat), 80e3, 1024.0, 205)
        wide = replace(over, image_size_px=(2005, 2005), principal_point_px=(1002.0, 1002.0))
        cut = 0
        for i in asked(catalog, wide).rows:
            frame = catalog.rotation_mcmf_to_enu[i, :2]
            corners = [
                catalog.position_mcmf[i] + half * (np.array(s) @ frame)
                for s in itertools.product((-1, 1), (-1, 1))
            ]
            at = by_opencv(over, np.array([catalog.position_mcmf[i], *corners]), np.zeros(6))
            beyond = [*(at < -0.5).any(axis=0), *(at >= 204.5).any(axis=0)]
            if (at[0] >= -0.5).all() and (at[0] < 204.5).all() and any(beyond):
                cut += 1
                sides += beyond
        assert asked(catalog, over).counts["edge"] == cut
    assert (sides > 0).all()


def test_the_covariance_is_that_of_the_collinearity_equations(
    catalog: Catalog, taken: Camera
) -> None:
    answer = asked(catalog, taken, Query(height_sigma_m=30.0, map_sigma_m=11.0))
    places = catalog.position_mcmf[answer.rows]
    slopes = slopes_by_opencv(taken, places)
    normal = np.zeros((6, 6))
    for i, row in enumerate(answer.rows):
        east, north, up = catalog.rotation_mcmf_to_enu[row]
        on_ground = -slopes[i, :, :3] @ np.stack([east, north, up], axis=-1)
        spread = ground_covariance(*answer.sigma_m[i], answer.angle_deg[i])
        match = on_ground[:, :2] @ spread @ on_ground[:, :2].T + 0.02**2 * np.eye(2)
        weight = np.linalg.inv(match + 900.0 * np.outer(on_ground[:, 2], on_ground[:, 2]))
        normal += answer.probability[i] * slopes[i].T @ weight @ slopes[i]
        values, axes = np.linalg.eigh(match)
        np.testing.assert_allclose(answer.sigma_px[i], np.sqrt(values[::-1]), rtol=1e-4)
        tilt = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
        assert abs((answer.angle_px_deg[i] - tilt + 90) % 180 - 90) < 0.1
    wanted = np.linalg.inv(normal)
    wanted[:3, :3] += 121.0 * np.eye(3)
    unit = np.sqrt(np.diag(wanted))
    found = answer.position
    assert found.covariance is not None
    np.testing.assert_allclose(found.covariance / np.outer(unit, unit), wanted / np.outer(unit, unit), atol=2e-5)  # fmt: skip
    known = np.linalg.inv(normal[:3, :3]) + 121.0 * np.eye(3)
    np.testing.assert_allclose(found.known_attitude_m2, known, rtol=1e-4, atol=1e-3)
    assert found.position_sigma_m == pytest.approx(np.sqrt(np.trace(wanted[:3, :3])), rel=1e-4)
    to_enu = enu_rotation(*mcmf_to_lonlat(taken.position_mcmf_m)[:2])
    turned_to = to_enu @ wanted[:3, :3] @ to_enu.T
    np.testing.assert_allclose(found.sigma_enu_m, np.sqrt(np.diag(turned_to)), rtol=1e-4)
    assert found.expected_points == pytest.approx(answer.probability.sum())
    # one metre across the line of sight is 1 / pixel_m pixels
    rows = (slopes * answer.pixel_m[:, None, None]).reshape(-1, 6)
    cofactors = to_enu @ np.linalg.inv(rows.T @ rows)[:3, :3] @ to_enu.T
    assert found.dop is not None
    assert found.dop["vertical"] == pytest.approx(np.sqrt(cofactors[2, 2]), rel=1e-3)
    assert found.dop["position"] == pytest.approx(np.sqrt(np.trace(cofactors)), rel=1e-3)
    assert np.hypot(found.dop["horizontal"], found.dop["vertical"]) == pytest.approx(found.dop["position"])  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("attitude_deg", [np.inf, 0.02, 0.0])
def test_positions_solved_from_noisy_points_err_as_expected(
    catalog: Catalog, taken: Camera, attitude_deg: float
) -> None:
    """120 positions by scipy: each point is found or not, its place and height err as stated."""
    height_m, rounds, sigma = 40.0, 120, np.radians(attitude_deg)
    answer = asked(catalog, taken, Query(attitude_sigma_rad=sigma, height_sigma_m=height_m))
    places, dice = catalog.position_mcmf[answer.rows], np.random.default_rng(11)
    slopes, frames = slopes_by_opencv(taken, places), catalog.rotation_mcmf_to_enu[answer.rows]
    on_ground = -slopes[:, :, :3] @ np.swapaxes(frames, -1, -2)
    spread = np.array([ground_covariance(*s, a) for s, a in zip(answer.sigma_m, answer.angle_deg, strict=True)])  # fmt: skip
    errors = np.zeros((len(places), 3, 3))
    errors[:, :2, :2], errors[:, 2, 2] = spread, height_m**2
    in_image = on_ground @ errors @ np.swapaxes(on_ground, -1, -2) + 0.02**2 * np.eye(2)
    whitening = np.linalg.inv(np.linalg.cholesky(in_image))
    unit = np.repeat([1e3, 1e-2], 3)
    free = 6 if sigma > 0.0 else 3
    assert answer.position.position_covariance_m2 is not None
    inverse = np.linalg.inv(answer.position.position_covariance_m2)
    squared = []
    for _ in range(rounds):
        moved = np.einsum("nij,nj->ni", np.linalg.cholesky(errors), dice.normal(size=(len(places), 3)))  # fmt: skip
        true = places + np.einsum("nji,nj->ni", frames, moved)
        tilt = dice.normal(0.0, sigma, 3) if np.isfinite(sigma) else np.zeros(3)
        seen = by_opencv(taken, true, np.concatenate([np.zeros(3), tilt]))
        seen += dice.normal(0.0, 0.02, seen.shape)
        found = dice.random(len(places)) < answer.probability

        def residual(u: np.ndarray, seen=seen, found=found) -> np.ndarray:
            correction = np.zeros(6)
            correction[:free] = u * unit[:free]
            off = np.einsum("nij,nj->ni", whitening, seen - by_opencv(taken, places, correction))
            prior = correction[3:] / sigma if np.isfinite(sigma) and sigma > 0.0 else []
            return np.concatenate([off[found].ravel(), prior])

        def slope(_: np.ndarray, found=found) -> np.ndarray:
            rows = -(whitening @ slopes)[found].reshape(-1, 6)
            prior = np.eye(6)[3:] / sigma if np.isfinite(sigma) and sigma > 0.0 else np.zeros((0, 6))  # fmt: skip
            return (np.concatenate([rows, prior]) * unit)[:, :free]

        error = least_squares(residual, np.zeros(free), slope).x[:3] * unit[:3]
        squared.append(error @ inverse @ error / 3.0)
    # mean of 120 chi-square numbers of 3 degrees: 1 sigma is sqrt(2 / 3 / 120) = 0.075
    assert abs(np.mean(squared) - 1.0) < 3.0 * np.sqrt(2.0 / 3.0 / rounds)


def test_attitude_known_better_gives_a_better_position(catalog: Catalog, taken: Camera) -> None:
    sigmas = [
        asked(catalog, taken, Query(attitude_sigma_rad=s)).position for s in (np.inf, 1e-3, 1e-4, 0)
    ]
    found = [one.position_sigma_m for one in sigmas]
    assert found == sorted(found, reverse=True)
    assert found[-1] == pytest.approx(sigmas[0].known_attitude_sigma_m)
    assert found[0] > 3.0 * found[-1]
    assert sigmas[-1].dop["position"] < sigmas[0].dop["position"]


def test_the_budget_is_that_of_each_error_alone(catalog: Catalog, taken: Camera) -> None:
    """Each source drawn alone, 20 000 times, through the linear solution with the weights of all."""
    sigma, height_m, map_m, place_m = 3e-4, 60.0, 11.0, 5.0
    catalog = replace(catalog, errors=catalog.errors | {"position_sigma_m": place_m})
    answer = asked(catalog, taken, Query(None, sigma, height_m, map_m))
    places, dice = catalog.position_mcmf[answer.rows], np.random.default_rng(3)
    slopes, frames = slopes_by_opencv(taken, places), catalog.rotation_mcmf_to_enu[answer.rows]
    on_ground = -slopes[:, :, :3] @ np.swapaxes(frames, -1, -2)
    spread = np.array([ground_covariance(*s, a) for s, a in zip(answer.sigma_m, answer.angle_deg, strict=True)])  # fmt: skip
    place = place_m**2 * np.eye(2)
    count, draws = len(places), 20_000
    normal = dice.normal(size=(draws, count, 2))
    pixels = {
        "match": (on_ground[:, :, :2] @ np.linalg.cholesky(spread - place), normal),
        "place": (on_ground[:, :, :2] * place_m, normal),
        "pixel": (np.broadcast_to(0.02 * np.eye(2), (count, 2, 2)), normal),
        "height": (on_ground[:, :, 2:] * height_m, normal[:, :, :1]),
    }
    whole = sum(part @ np.swapaxes(part, -1, -2) for part, _ in pixels.values())
    pull = answer.probability[:, None, None] * np.swapaxes(slopes, -1, -2) @ np.linalg.inv(whole)
    prior = np.diag(np.repeat([0.0, sigma**-2], 3))
    gain = np.linalg.inv(np.einsum("nia,naj->ij", pull, slopes) + prior)
    # a found point counts once: the variance of its error is over its probability
    root = np.sqrt(answer.probability)[:, None, None]
    budget = answer.position.budget_m
    assert budget is not None
    for name, (part, drawn) in pixels.items():
        paths = (gain, pull / root, part, drawn)
        off = np.einsum("ij,nja,nab,dnb->di", *paths, optimize=True)[:, :3]
        assert budget[name] == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()), rel=0.03), name
    tilt = dice.normal(0.0, sigma, (draws, 3)) @ (gain @ prior)[:3, 3:].T
    assert budget["attitude"] == pytest.approx(np.sqrt((tilt**2).sum(axis=1).mean()), rel=0.03)
    assert budget["map"] == pytest.approx(map_m * np.sqrt(3.0))
    together = np.sqrt(sum(value**2 for value in budget.values()))
    assert together == pytest.approx(answer.position.position_sigma_m, rel=1e-6)


@pytest.mark.parametrize("cells", [0.5, 1.6, 3.0])
def test_a_pixels_error_is_one_of_the_searched_image(
    catalog: Catalog, taken: Camera, cells: float
) -> None:
    """An error of 20 pixels outweighs all others; pixels are not finer than the cells."""
    pixel_m = np.median(asked(catalog, taken).pixel_m)
    catalog = replace(catalog, gsd=np.full(len(catalog), cells * pixel_m))
    answer = asked(catalog, taken, Query(pixel_sigma_px=20.0))
    searched = np.maximum(cells * pixel_m / answer.pixel_m, 1.0)
    slopes = slopes_by_opencv(taken, catalog.position_mcmf[answer.rows])
    weight = answer.probability / (20.0 * searched) ** 2
    variance = np.linalg.inv(np.einsum("n,nki,nkj->ij", weight, slopes, slopes))
    budget = answer.position.budget_m
    assert budget is not None
    assert budget["pixel"] == pytest.approx(np.sqrt(np.trace(variance[:3, :3])), rel=0.01)


def test_heights_of_the_catalogue_count_unless_others_are_given(taken: Camera) -> None:
    known = everywhere_usable(elevation_sigma=np.full(60, 200.0))
    unknown = everywhere_usable(elevation_sigma=np.full(60, np.nan))
    of = [
        asked(known, taken).position.known_attitude_sigma_m,
        asked(known, taken, Query(height_sigma_m=0.0)).position.known_attitude_sigma_m,
        asked(unknown, taken).position.known_attitude_sigma_m,
        asked(unknown, taken, Query(height_sigma_m=200.0)).position.known_attitude_sigma_m,
    ]
    assert of[1] == of[2]
    assert of[0] == of[3]
    assert of[0] > 1.2 * of[1]


def test_few_points_give_no_position(catalog: Catalog, taken: Camera) -> None:
    answer = asked(catalog, taken)
    three = catalog.take(answer.rows[:3])
    found = asked(three, taken).position
    assert found.covariance is None
    assert found.position_sigma_m is None
    assert found.dop is None
    assert found.reason == "3 usable points: a position needs 4"
    assert asked(three.take(np.arange(0)), taken).position.reason.startswith("no usable point")
    five, first = catalog.take(answer.rows[:5]), np.zeros(5, np.int64)
    where = ("longitude", "latitude", "elevation", "position_mcmf", "rotation_mcmf_to_enu")
    one_place = replace(five, **{name: getattr(five, name)[first] for name in where})
    found = asked(one_place, taken).position
    assert found.position_covariance_m2 is None
    assert found.reason == "the points do not determine position and attitude"


class TestBestPoints:
    @staticmethod
    def information(count: int, seed: int = 3, attitude: float = np.inf) -> tuple[Information, float]:  # fmt: skip
        dice, taken = np.random.default_rng(seed), camera()
        points = ground(taken, count, dice)
        shape = dice.normal(size=(count, 2, 2)) * dice.uniform(0.1, 1.0, (count, 1, 1))
        covariance = shape @ np.swapaxes(shape, -1, -2) + 1e-3 * np.eye(2)
        away = np.linalg.norm(points - taken.position_mcmf_m, axis=1).mean()
        slopes = slopes_by_opencv(taken, points)
        return Information(slopes, covariance, dice.uniform(0.5, 1.0, count), attitude), float(away)

    @staticmethod
    def worth(information: Information, away: float, rows: list[int]) -> float:
        """Gain of the log determinant, from the definition."""
        prior = np.diag(np.repeat([(3.0 * away) ** -2.0, 1.0 / 9.0], 3))
        normal = prior.copy()
        for i in rows:
            slope, inverse = information.slopes[i], np.linalg.inv(information.covariance_px2[i])
            normal += information.probability[i] * slope.T @ inverse @ slope
        return float(np.linalg.slogdet(normal)[1] - np.linalg.slogdet(prior)[1])

    def test_each_is_the_one_that_adds_most(self) -> None:
        information, away = self.information(40)
        chosen: list[int] = []
        for _ in range(12):
            free = [i for i in range(40) if i not in chosen]
            chosen.append(max(free, key=lambda i: self.worth(information, away, [*chosen, i])))
        assert best_points(information, away, 12).tolist() == chosen
        assert len(best_points(information, away, 99)) == 40

    def test_it_comes_near_the_best_of_all_choices(self) -> None:
        information, away = self.information(10)
        best = max(self.worth(information, away, list(some)) for some in itertools.combinations(range(10), 5))  # fmt: skip
        found = self.worth(information, away, best_points(information, away, 5).tolist())
        assert found > 0.98 * best

    def test_the_position_from_the_best_is_better_than_from_others(
        self, catalog: Catalog, taken: Camera
    ) -> None:
        whole, few = asked(catalog, taken), asked(catalog, taken, Query(most=8))
        assert len(few.rows) == 8
        assert few.usable == whole.usable == len(whole.rows)
        assert set(few.rows) < set(whole.rows)
        first = asked(catalog.take(whole.rows[:8]), taken).position.position_sigma_m
        assert whole.position.position_sigma_m < few.position.position_sigma_m < first
