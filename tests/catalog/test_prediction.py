"""Prediction between the evaluated conditions, against scipy's interpolators and matrix logarithms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers import catalogs
from helpers.twins_relief import by_facets, chance, height
from scipy.interpolate import LinearNDInterpolator, RegularGridInterpolator

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.prediction import CAUSES, Prediction, ViewMesh, predict, view_plane
from lcp_catalog.catalog.schema import UNOCCLUDED, UNSHADOWED, summarise_usable
from lcp_catalog.geometry.frames import direction_enu

NADIR = [0.0, 0.0, 1.0]
FLAT = {"albedo_sigma": 0.0}
"""Of an error model without brightness that no map holds: relief shows alike under every Sun."""


def everywhere(count: int = 3, seed: int = 4, **spoilt: Any) -> Catalog:
    """A catalogue whose conditions are all evaluated, unshadowed and unoccluded."""
    given = catalogs.arrays(count) | {"errors": catalogs.ERRORS | FLAT} | spoilt
    rng = np.random.default_rng(seed)
    views = len(given["view_off_nadir"])
    shape = (count, 3, views, 8, 24)
    p = rng.uniform(0.3, 1.0, shape)
    condition = np.where(p[:, 0] >= 0.9, 31, 25).astype(np.uint8)
    lowest, highest = summarise_usable(condition, given["sun_elevation"])
    major = rng.uniform(1.0, 30.0, shape)
    return Catalog(
        **given
        | {
            "condition": condition,
            "sun_elevation_min": lowest,
            "sun_elevation_max": highest,
            "detection_probability": p,
            "sigma_major": major,
            "sigma_minor": major * rng.uniform(0.2, 1.0, shape),
            "sigma_angle": rng.uniform(0.0, 180.0, shape),
            "coverage": catalogs.cells(count),
        }
    )


def asked(
    catalog: Catalog,
    elevation: Any,
    azimuth: Any,
    scale: Any = 1.0,
    view: Any = NADIR,
    point: int = 0,
) -> Prediction:
    """Predictions of one point under Suns in degrees."""
    elevation, azimuth, scale = np.broadcast_arrays(*(np.atleast_1d(v) for v in (elevation, azimuth, scale)))  # fmt: skip
    rows = np.full(len(elevation), point)
    sun = direction_enu(azimuth, elevation)
    return predict(
        catalog, rows, sun, np.broadcast_to(view, (len(rows), 3)), scale * catalogs.GSD_M
    )


def test_at_a_grid_angle_it_is_what_the_catalogue_says() -> None:
    catalog = everywhere()
    for point, view, e, a in ((0, 0, 0, 0), (1, 1, 7, 23), (2, 2, 4, 11)):
        towards = direction_enu(catalog.view_azimuth[view], catalog.view_off_nadir[view])
        off = np.radians(catalog.view_off_nadir[view])
        az = np.radians(catalog.view_azimuth[view])
        towards = [np.sin(off) * np.sin(az), np.sin(off) * np.cos(az), np.cos(off)]
        for s, scale in enumerate(catalog.image_scale):
            sun = catalog.sun_elevation[e], catalog.sun_azimuth[a]
            found = asked(catalog, *sun, scale, towards, point)
            at = (point, s, view, e, a)
            assert found.detection_probability[0] == pytest.approx(catalog.detection_probability[at], abs=0.0021)  # fmt: skip
            assert found.sigma_major_m[0] == pytest.approx(catalog.sigma_major[at], rel=1e-5)
            assert found.sigma_minor_m[0] == pytest.approx(catalog.sigma_minor[at], rel=1e-5)
            away = (found.sigma_angle_deg[0] - catalog.sigma_angle[at] + 90.0) % 180.0 - 90.0
            assert abs(away) < 1e-4
            if s == 0:
                assert found.usable[0] == (catalog.condition[point, view, e, a] == 31)


def test_between_suns_and_scales_against_scipy() -> None:
    """All azimuths, also those between the last and the first of the grid."""
    catalog, rng = everywhere(), np.random.default_rng(1)
    p = np.clip(catalog.detection_probability[1, :, 0].astype(float), 0.002, 0.998)
    wrapped = np.concatenate([p, p[..., :1]], axis=-1)
    axes = ([0.0, 1.0, 2.0], catalog.sun_elevation, np.append(catalog.sun_azimuth, 360.0))
    reference = RegularGridInterpolator(axes, height(wrapped))
    log_scale, elevation, azimuth = (
        rng.uniform(0.0, 2.0, 400),
        rng.uniform(5.0, 75.0, 400),
        rng.uniform(0.0, 360.0, 400),
    )
    found = asked(catalog, elevation, azimuth, 2.0**log_scale, point=1)
    want = chance(reference(np.stack([log_scale, elevation, azimuth], axis=-1)))
    np.testing.assert_allclose(found.detection_probability, want, atol=1e-8)


@pytest.mark.parametrize(("factor", "spread_px"), [(2, 0.25), (3, 1 / 6), (8, 0.125)])
def test_a_reduced_image_has_larger_templates(factor: int, spread_px: float) -> None:
    """The peak is higher by the root of the number of its pixels: of a patch 8 cells wide 8 - b a side, b by the point spread."""
    catalog = everywhere()
    suns, view = (catalog.sun_elevation[[0, 4]], catalog.sun_azimuth[[3, 11]]), [NADIR, NADIR]
    given = np.array([1, 1]), direction_enu(suns[1], suns[0]), np.array(view), [catalogs.GSD_M] * 2
    found = predict(catalog, *given, factor=factor).detection_probability
    side, usual = (8 - 2 * 1.644854 * np.sqrt(s**2 + 1 / 12) for s in (spread_px, 0.5))
    plain = np.clip(catalog.detection_probability[1, 0, 0, [0, 4], [3, 11]], 0.002, 0.998)
    np.testing.assert_allclose(found, chance(height(plain) * side / usual), atol=1e-6)
    assert (found > plain).all()


def _of_matrix(function: Any, matrix: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(matrix)
    return (vectors * function(values)) @ vectors.T


def test_ellipses_are_means_of_matrix_logarithms() -> None:
    catalog = everywhere()
    found = asked(catalog, 12.0, 20.0, point=2)  # elevations 10 and 15, azimuths 15 and 30
    total = np.zeros((2, 2))
    for e, we in ((1, 0.6), (2, 0.4)):
        for a, wa in ((1, 2 / 3), (2, 1 / 3)):
            at = (2, 0, 0, e, a)
            angle = np.radians(float(catalog.sigma_angle[at]))
            axis, across = (
                np.array([np.sin(angle), np.cos(angle)]),
                np.array([np.cos(angle), -np.sin(angle)]),
            )
            covariance = float(catalog.sigma_major[at]) ** 2 * np.outer(axis, axis)
            covariance += float(catalog.sigma_minor[at]) ** 2 * np.outer(across, across)
            total += we * wa * _of_matrix(np.log, covariance)
    values, vectors = np.linalg.eigh(_of_matrix(np.exp, total))
    assert found.sigma_minor_m[0] == pytest.approx(np.sqrt(values[0]), rel=1e-6)
    assert found.sigma_major_m[0] == pytest.approx(np.sqrt(values[1]), rel=1e-6)
    angle = np.degrees(np.arctan2(vectors[0, 1], vectors[1, 1])) % 180.0
    assert found.sigma_angle_deg[0] == pytest.approx(angle, abs=1e-4)


def test_only_evaluated_neighbours_count() -> None:
    """An unevaluated neighbour leaves the others' mean; without half of the weight nothing is claimed."""
    whole = everywhere()
    given = {n: getattr(whole, n) for n in ("detection_probability", "sigma_major", "sigma_minor", "sigma_angle")}  # fmt: skip
    gone = (slice(None), slice(None), slice(None), 1, 1)
    condition = whole.condition.copy()
    condition[:, :, 1, 1] = 0
    lowest, highest = summarise_usable(condition, whole.sun_elevation)
    spoilt = {n: v.copy() for n, v in given.items()}
    for values in spoilt.values():
        values[gone] = np.nan
    catalog = Catalog(
        **catalogs.arrays(3)
        | {"errors": catalogs.ERRORS | FLAT}
        | spoilt
        | {
            "condition": condition,
            "sun_elevation_min": lowest,
            "sun_elevation_max": highest,
            "coverage": catalogs.cells(3),
        }
    )
    p = height(np.clip(whole.detection_probability[0, 0, 0].astype(float), 0.002, 0.998))
    found = asked(catalog, 11.0, 27.0)  # weights of elevation 10: 0.8, of azimuth 15: 0.2
    shares = {(1, 2): 0.64, (2, 1): 0.04, (2, 2): 0.16}
    want = chance(sum(p[at] * w for at, w in shares.items()) / 0.84)
    assert found.detection_probability[0] == pytest.approx(want, abs=1e-9)
    both = asked(catalog, 11.0, [17.0, 27.0])
    assert np.isnan(both.detection_probability).tolist() == [True, False]
    assert np.isnan(both.sigma_major_m).tolist() == [True, False]
    assert not both.usable[0]


def steady(count: int, **changed: np.ndarray) -> Catalog:
    """A catalogue whose conditions are all usable, with the same claims, but for what is ``changed``."""
    given = catalogs.arrays(count) | {"errors": catalogs.ERRORS | FLAT} | changed
    grid = tuple(len(given[n]) for n in ("view_off_nadir", "sun_elevation", "sun_azimuth"))
    same = {"detection_probability": 0.99, "sigma_major": 9.0, "sigma_minor": 3.0, "sigma_angle": 45.0}  # fmt: skip
    given |= {name: np.full((count, 3, *grid), value) for name, value in same.items()}
    given |= {"condition": np.full((count, *grid), 31, np.uint8)} | changed
    lowest, highest = summarise_usable(given["condition"], given["sun_elevation"])
    summed = {"sun_elevation_min": lowest, "sun_elevation_max": highest}
    return Catalog(**given | summed | {"coverage": catalogs.cells(count)})


@pytest.mark.parametrize("names", [("sigma_major", "sigma_minor"), ("sigma_angle",)])
def test_an_ellipse_that_is_not_known_leaves_the_mean_to_the_others(names: tuple[str, ...]) -> None:
    whole = steady(1)
    gaps = {name: getattr(whole, name).copy() for name in names}
    for values in gaps.values():
        values[:, :, :, 1, 1] = np.nan  # 10 and 15 degrees
    gaps["condition"] = whole.condition.copy()
    gaps["condition"][:, :, 1, 1] = 31 - UNSHADOWED
    found = asked(steady(1, **gaps), [11.0, 12.0], [27.0, 24.0])
    np.testing.assert_allclose(found.sigma_major_m, whole.sigma_major[0, 0, 0, 0, 0], rtol=1e-5)
    np.testing.assert_allclose(found.sigma_minor_m, whole.sigma_minor[0, 0, 0, 0, 0], rtol=1e-5)
    np.testing.assert_allclose(found.sigma_angle_deg, 45.0, atol=1e-4)


def test_shadows_at_neighbours_with_much_weight_make_it_unusable() -> None:
    """Up to 0.3 of the weight may be shadowed."""
    condition = np.full((2, 3, 8, 24), 31, np.uint8)
    condition[0, 0, 2, 3] = 31 - 8
    catalog = steady(2, condition=condition)
    # the shadowed condition: elevation 15, azimuth 45; its weights: 1, 0.36, 0.24, 0, 0.6, 0, 0.3, 0.31
    elevation = [15.0, 13.0, 12.0, 12.0, 17.0, 10.0, 11.5, 11.55]
    azimuth = [45.0, 39.0, 54.0, 70.0, 45.0, 45.0, 45.0, 45.0]
    found = asked(catalog, elevation, azimuth)
    np.testing.assert_allclose(found.detection_probability, 0.992, atol=1e-3)
    assert found.usable.tolist() == [False, False, True, True, False, True, True, False]
    assert asked(catalog, 15.0, 45.0, point=1).usable.tolist() == [True]


def test_what_is_shadowed_and_hidden_is_called_shadowed() -> None:
    condition = np.full((1, 3, 8, 24), 31 - UNSHADOWED - UNOCCLUDED, np.uint8)
    assert CAUSES[asked(steady(1, condition=condition), 15.0, 45.0).cause[0]] == "shadow"


def test_between_the_angles_a_usable_point_needs_more() -> None:
    """A margin of half of 1 - (sum of squared weights): 0 at a grid angle, 0.375 logits amid four
    corners.
    """
    p = np.full(steady(3).detection_probability.shape, 0.916)
    p[1:] = np.array([0.96, 0.924]).reshape(2, 1, 1, 1, 1)
    catalog = steady(3, detection_probability=p)
    azimuth = [45.0, 45.0, 52.5, 45.001]
    for point, works in ((0, [True, False, False, True]), (1, [True] * 4), (2, [True, True, False, True])):  # fmt: skip
        found = asked(catalog, [15.0, 12.5, 12.5, 15.0], azimuth, point=point)
        assert found.usable.tolist() == works
        # logits 2.389, 3.178 and 2.498, of 0.9 (0.898 as stored): 2.197 (2.175); margins 0, 0.25, 0.375, 0
        np.testing.assert_allclose(found.detection_probability, p[point, 0, 0, 0, 0], atol=1e-6)


def test_beyond_the_evaluated_conditions_a_usable_point_needs_more_or_is_none() -> None:
    given = catalogs.arrays(1) | {"errors": catalogs.ERRORS | FLAT}
    shape = given["detection_probability"].shape
    condition = np.full(given["condition"].shape, 31, np.uint8)
    condition[:, :, 7] = 0  # the Sun never reaches 75 degrees
    lowest, highest = summarise_usable(condition, given["sun_elevation"])
    fill = {"detection_probability": 0.94, "sigma_major": 9.0, "sigma_minor": 3.0, "sigma_angle": 4.0}  # fmt: skip
    planes = {name: np.full(shape, value) for name, value in fill.items()}
    for plane in planes.values():
        plane[:, :, :, 7] = np.nan
    summed = {"sun_elevation_min": lowest, "sun_elevation_max": highest, "condition": condition}
    catalog = Catalog(**given | planes | summed | {"coverage": catalogs.cells(1)})
    # 0.94: logit 2.752, 0.577 above that of 0.898. At 62 and 66 degrees weights of 13/15 and 9/15 are known:
    # margins (1 - w^2) / 2 + 1.5 (1 - w) of 0.32 and 0.92
    found = asked(catalog, [60.0, 62.0, 66.0, 5.0, 4.9, 3.0], 45.0)
    np.testing.assert_allclose(found.detection_probability, 0.94, atol=1e-6)
    assert found.usable.tolist() == [True, True, False, True, False, False]
    # straight down and 6 or 18 degrees to the north of it: weights 0.85 and 0.55, margins 0.36 and 1.02
    for off, works in ((6.0, True), (18.0, False)):
        tilt = np.radians(off)
        seen = asked(catalog, 20.0, 45.0, view=[0.0, np.sin(tilt), np.cos(tilt)])
        assert seen.usable.tolist() == [works]


@pytest.mark.parametrize(
    ("elevation", "scale", "known"),
    [(2.6, 1.0, True), (2.4, 1.0, False), (77.4, 1.0, True), (77.6, 1.0, False), (-1.0, 1.0, False),
     (30.0, 0.1, True), (30.0, 4.0, True), (30.0, 4.1, False), (30.0, np.nan, False)],
)  # fmt: skip
def test_outside_the_grid_nothing_is_claimed(elevation: float, scale: float, known: bool) -> None:
    found = asked(everywhere(), elevation, 100.0, scale)
    for name in ("detection_probability", "sigma_major_m", "sigma_minor_m", "sigma_angle_deg"):
        assert np.isfinite(getattr(found, name)[0]) == known
    if not known:
        assert not found.usable[0]


def test_images_finer_than_the_cell_count_as_the_cell() -> None:
    catalog = everywhere()
    fine, own = asked(catalog, 33.0, 100.0, 0.2), asked(catalog, 33.0, 100.0, 1.0)
    assert fine.detection_probability[0] == own.detection_probability[0]
    assert fine.sigma_major_m[0] == own.sigma_major_m[0]


@pytest.mark.parametrize(
    ("grid", "low", "high"),
    [([20.0, 24.0, 40.0], 18.0, 42.5), ([20.0, 24.0], 18.0, 26.0), ([20.0], 17.5, 22.5), ([1.0, 6.0], 0.0, 8.5)],
)  # fmt: skip
def test_elevations_end_half_a_step_beyond(grid: list[float], low: float, high: float) -> None:
    """At most 2.5 deg beyond, and none below the horizon."""
    catalog = steady(1, sun_elevation=np.array(grid))
    found = asked(catalog, [low - 0.1, low + 0.1, high - 0.1, high + 0.1], 45.0)
    assert np.isfinite(found.detection_probability).tolist() == [False, True, True, False]
    found = asked(catalog, [grid[0] - 0.5, grid[0], grid[-1], grid[-1] + 0.5], 45.0)
    assert [CAUSES[k] for k in found.cause] == ["sun", "usable", "usable", "sun"]


def test_beyond_the_grid_the_claims_of_its_end_hold() -> None:
    catalog = everywhere()
    for beyond, end in ((3.0, 5.0), (77.0, 75.0)):
        found, expected = (asked(catalog, elevation, 45.0) for elevation in (beyond, end))
        for name in ("detection_probability", "sigma_major_m", "sigma_minor_m", "sigma_angle_deg"):
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9)


@pytest.mark.parametrize(
    ("grid", "low", "high"),
    [
        (np.arange(60.0, 121.0, 15.0), 52.5, 127.5),
        ([300.0, 304.0, 330.0], 298.0, 343.0),
        ([90.0, 94.0], 88.0, 96.0),
        ([90.0], 85.0, 95.0),
        (
            [10.0, 50.0, 100.0, 150.0, 200.0, 280.0],
            350.0,
            320.0,
        ),  # wide, but the gap is the widest step
        ([10.0, 90.0, 140.0, 190.0, 240.0, 280.0], 330.0, 300.0),
        ([0.0, 179.6], 270.2, 269.4),
    ],
)
def test_azimuths_that_do_not_go_round_end_half_a_step_beyond(
    grid: list[float], low: float, high: float
) -> None:
    catalog = steady(1, sun_azimuth=np.array(grid))
    found = asked(catalog, 30.0, [low - 0.1, low + 0.1, grid[0], grid[-1], high - 0.1, high + 0.1])
    assert np.isfinite(found.detection_probability).tolist() == [False, True, True, True, True, False]  # fmt: skip
    assert [CAUSES[k] for k in found.cause] == ["sun", *["usable"] * 4, "sun"]


@pytest.mark.parametrize("grid", [np.arange(60.0, 121.0, 15.0), np.array([60.0])])
def test_beyond_the_end_of_the_azimuths_a_point_needs_no_less(grid: np.ndarray) -> None:
    p = np.full((1, 3, 3, 8, len(grid)), 0.896)
    condition = np.full((1, 3, 8, len(grid)), 31 - 4, np.uint8)
    catalog = steady(1, sun_azimuth=grid, detection_probability=p, condition=condition)
    found = asked(catalog, 30.0, [grid[0] - 4.0, grid[0], grid[-1], grid[-1] + 4.0])
    assert [CAUSES[k] for k in found.cause] == ["detection"] * 4


@pytest.mark.parametrize("grid", [np.arange(20.0, 360.0, 60.0), np.array([10.0, 190.0])])
def test_azimuths_that_go_round_need_not_begin_in_the_north(grid: np.ndarray) -> None:
    """Heights of peaks against numpy's periodic interpolation."""
    p = np.linspace(0.92, 0.992, len(grid)) * np.ones((1, 3, 3, 8, 1))
    catalog = steady(1, sun_azimuth=grid, detection_probability=p)
    stored = height(np.asarray(catalog.detection_probability[0, 0, 0, 0], np.float64))
    at = np.arange(0.0, 360.0, 7.3)
    expected = chance(np.interp(at, grid, stored, period=360.0))
    np.testing.assert_allclose(asked(catalog, 30.0, at).detection_probability, expected, atol=1e-8)


def test_a_camera_below_the_horizon_is_not_claimed() -> None:
    catalog = steady(1, view_off_nadir=np.array([0.0, 30.0, 85.0]))  # the last towards 270
    for off, known in ((89.5, True), (90.5, False)):
        found = asked(catalog, 30.0, 45.0, view=direction_enu(270.0, 90.0 - off))
        assert np.isfinite(found.detection_probability[0]) == known


def test_a_catalogue_without_claims_predicts_nothing() -> None:
    found = predict(catalogs.catalog(3), [0, 1], np.tile(NADIR, (2, 1)), np.tile(NADIR, (2, 1)), [100.0, 100.0])  # fmt: skip
    assert np.isnan(found.detection_probability).all()
    assert not found.usable.any()
    assert predict(everywhere(), [], np.zeros((0, 3)), np.zeros((0, 3)), []).usable.shape == (0,)
    with pytest.raises(ValueError, match="differ in length"):
        predict(everywhere(), [0, 1], NADIR, NADIR, 1.0)


class TestViews:
    @pytest.mark.parametrize("seed", range(6))
    def test_scattered_views_against_scipy(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        places = np.concatenate([[[0.0, 0.0]], rng.uniform(-30.0, 30.0, (7, 2))])
        values = rng.normal(size=8)
        at = rng.uniform(-35.0, 35.0, (500, 2))
        corners, weights, away = ViewMesh.of(places).weights(at)
        want = LinearNDInterpolator(places, values)(at)
        inside = np.isfinite(want)
        assert inside.sum() > 50
        np.testing.assert_array_equal(away == 0.0, inside)
        np.testing.assert_allclose((values[corners] * weights).sum(axis=1)[inside], want[inside], atol=1e-9)  # fmt: skip
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        assert (weights >= 0.0).all()
        # outside: no place of the hull is nearer than the one stated (hull sampled densely)
        mixes = rng.dirichlet(np.full(8, 0.2), 60_000) @ places
        for place, far in zip(at[~inside][:20], away[~inside][:20], strict=True):
            assert far <= np.linalg.norm(mixes - place, axis=1).min() + 1e-9

    @pytest.mark.parametrize("side", [0.1, 10.0])
    def test_three_views_span_a_triangle_however_near(self, side: float) -> None:
        mesh = ViewMesh.of(side * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
        corners, weights, away = mesh.weights(side * np.array([[0.5, 0.25]]))
        assert away[0] == 0.0
        assert dict(zip(corners[0].tolist(), weights[0], strict=True)) == pytest.approx({0: 0.25, 1: 0.5, 2: 0.25})  # fmt: skip

    @pytest.mark.parametrize("turn", [0.0, 90.0, 120.0])
    def test_views_on_one_line(self, turn: float) -> None:
        """Straight down, and 30 deg to one side and to the other, as in the sample."""
        mesh = ViewMesh.of(view_plane([0.0, 30.0, 30.0], [0.0, turn, turn + 180.0]))
        at = view_plane([15.0, 15.0, 9.0, 40.0], turn + np.array([0.0, 180.0, -90.0, 180.0]))
        corners, weights, away = mesh.weights(at)
        dense = np.zeros((4, 3))
        np.add.at(dense, (np.arange(4)[:, None], corners), weights)
        expected = [[0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
        np.testing.assert_allclose(dense, expected, atol=1e-12)
        np.testing.assert_allclose(away, [0.0, 0.0, 9.0, 10.0], atol=1e-9)

    def test_a_view_alone_and_four_on_a_circle(self) -> None:
        corners, weights, away = ViewMesh.of(view_plane([0.0], [0.0])).weights(view_plane([7.0], [33.0]))  # fmt: skip
        assert (corners[0, weights[0] > 0.0].tolist(), away[0]) == ([0], pytest.approx(7.0))
        mesh = ViewMesh.of(view_plane([30.0] * 4, [0.0, 90.0, 180.0, 270.0]))
        _, weights, away = mesh.weights(view_plane([0.0, 20.0, 25.0], [0.0, 45.0, 10.0]))
        assert (away == 0.0).all()
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)

    def test_views_far_from_the_catalogues_are_not_claimed(self) -> None:
        catalog = everywhere()
        for off, azimuth, known in ((19.0, 0.0, True), (21.0, 0.0, False), (49.0, 90.0, True), (51.0, 90.0, False)):  # fmt: skip
            t, a = np.radians([off, azimuth])
            towards = [np.sin(t) * np.sin(a), np.sin(t) * np.cos(a), np.cos(t)]
            found = asked(catalog, 30.0, 100.0, view=towards)
            assert np.isfinite(found.detection_probability[0]) == known, (off, azimuth)


def test_a_point_that_is_not_usable_has_a_cause() -> None:
    given = catalogs.arrays(1)
    shape = given["detection_probability"].shape
    condition = np.full(given["condition"].shape, 31, np.uint8)
    condition[:, :, 1] &= 31 - UNSHADOWED  # a Sun at 10 degrees
    condition[:, :, 2] &= 31 - UNOCCLUDED  # 15
    condition[:, :, 3] = 0  # 20
    detection = np.full(shape, 0.95)
    detection[:, :, :, 3] = np.nan
    detection[:, :, :, 4] = 0.5  # 30
    condition[:, :, 4] &= 31 - 4
    lowest, highest = summarise_usable(condition, given["sun_elevation"])
    planes = {
        name: np.where(np.isnan(detection), np.nan, value)
        for name, value in (("sigma_major", 9.0), ("sigma_minor", 3.0), ("sigma_angle", 4.0))
    }
    summed = {"sun_elevation_min": lowest, "sun_elevation_max": highest, "condition": condition}
    catalog = Catalog(
        **given
        | planes
        | summed
        | {"detection_probability": detection, "coverage": catalogs.cells(1)}
    )
    low, aside = np.radians([5.0, 60.0])
    for elevation, scale, view, cause in (
        (5.0, 1.0, NADIR, "usable"),
        (10.0, 1.0, NADIR, "shadow"),
        (15.0, 1.0, NADIR, "occlusion"),
        (20.0, 1.0, NADIR, "not evaluated"),
        (30.0, 1.0, NADIR, "detection"),
        (3.0, 1.0, NADIR, "sun"),  # evaluated half a step down, but not usable there
        (-5.0, 1.0, NADIR, "sun"),
        (-5.0, 9.0, [0.0, np.sin(aside), np.cos(aside)], "sun"),
        (5.0, 9.0, [0.0, np.sin(aside), np.cos(aside)], "view"),
        (5.0, 9.0, [0.0, np.sin(low), np.cos(low)], "scale"),
    ):
        found = asked(catalog, elevation, 45.0, scale, view)
        assert CAUSES[found.cause[0]] == cause
        assert bool(found.usable[0]) == (cause == "usable")


def altitudes() -> Catalog:
    """The same direction from 15 km, 60 km and from infinity; straight down from infinity alone."""
    views = {
        "view_off_nadir": np.array([0.0, 40.0, 40.0, 40.0]),
        "view_azimuth": np.array([0.0, 90.0, 90.0, 90.0]),
        "view_altitude": np.array([np.inf, np.inf, 15.0, 60.0]),
    }
    return everywhere(**views)


def seen_at(catalog: Catalog, altitude_km: Any, off_nadir: float) -> np.ndarray:
    heights = np.atleast_1d(altitude_km)
    many = np.ones((len(heights), 1))
    found = predict(
        catalog, np.zeros(len(heights), int), many * direction_enu(45.0, 30.0),
        many * direction_enu(90.0, 90.0 - off_nadir), np.full(len(heights), catalogs.GSD_M), heights,
    )  # fmt: skip
    return found.detection_probability


def test_between_altitudes_weights_are_linear_in_one_over_the_altitude() -> None:
    """Logits at the grid's Sun, against numpy's interpolation; constant below the lowest."""
    catalog = altitudes()
    elevation, azimuth = (
        list(values).index(v)
        for values, v in ((catalog.sun_elevation, 30.0), (catalog.sun_azimuth, 45.0))
    )
    p = np.asarray(catalog.detection_probability[0, 0, :, elevation, azimuth], np.float64)
    heights = np.array([1.0, 15.0, 20.0, 40.0, 60.0, 100.0, 3000.0, np.inf])
    expected = chance(np.interp(1.0 / heights, [0.0, 1 / 60.0, 1 / 15.0], height(p[[1, 3, 2]])))
    np.testing.assert_allclose(seen_at(catalog, heights, 40.0), expected, atol=0.005)
    assert np.ptp(expected) > 0.05


def test_an_altitude_without_a_view_in_that_direction_leaves_it_to_the_others() -> None:
    """Straight down only parallel rays were evaluated: their claims hold at all altitudes."""
    catalog = altitudes()
    found = seen_at(catalog, [1.0, 15.0, 60.0, np.inf], 0.0)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, found[-1], rtol=1e-12)
    assert np.isnan(seen_at(catalog, [15.0], 65.0)).all()  # 25 deg from all views


def test_an_altitude_leaves_it_to_the_nearest_one_and_costs_no_margin() -> None:
    """From 15 km straight down alone: 40 degrees off, the claims of 60 km hold, not those of infinity."""
    p = np.full((1, 3, 3, 8, 24), 0.5)
    p[:, :, 1] = 0.924  # from 60 km; just above the least one
    views = {
        "view_off_nadir": np.array([40.0, 40.0, 0.0]),
        "view_azimuth": np.array([90.0, 90.0, 0.0]),
        "view_altitude": np.array([np.inf, 60.0, 15.0]),
    }
    condition = np.full((1, 3, 8, 24), 31, np.uint8)
    condition[:, [0, 2]] = 31 - 4
    catalog = steady(1, detection_probability=p, condition=condition, **views)
    for altitude in (10.0, 24.0):
        found = predict(
            catalog, [0], direction_enu(45.0, 30.0), direction_enu(90.0, 50.0), [catalogs.GSD_M], altitude
        )  # fmt: skip
        assert found.detection_probability[0] == pytest.approx(0.924, abs=1e-6)
        assert found.usable[0]


def test_claims_follow_the_signal_between_conditions() -> None:
    """Straight down, between views of 30 deg to the east and to the west: heights over signals are averaged."""
    catalog = everywhere(errors=catalogs.ERRORS | {"albedo_sigma": 0.09})
    assert catalog.view_off_nadir[1:].tolist() == [30.0, 30.0]
    sun, here = direction_enu(45.0, 75.0), direction_enu(0.0, 90.0)
    e, a = len(catalog.sun_elevation) - 1, int(np.argmin(np.abs(catalog.sun_azimuth - 45.0)))
    assert (catalog.sun_elevation[e], catalog.sun_azimuth[a]) == (75.0, 45.0)
    slope = catalogs.ERRORS["height_sigma_m"] / catalogs.ERRORS["height_length_m"]

    def signal(view: np.ndarray) -> float:
        slopes = by_facets(sun, view)
        return float(np.log(slopes / np.hypot(0.09, slope * slopes)))

    ends = [signal(direction_enu(azimuth, 60.0)) for azimuth in catalog.view_azimuth[1:].tolist()]
    gains = signal(here) - np.array(ends)
    assert np.abs(gains).max() > 0.1
    stored = catalog.detection_probability[0, 0, 1:, e, a].astype(float)
    found = predict(catalog, [0], [sun], [here], [catalogs.GSD_M], catalog.view_altitude[1])
    want = chance(np.mean(height(stored) * np.exp(gains)))
    assert found.detection_probability[0] == pytest.approx(want, abs=1e-6)
    area = np.log(catalog.sigma_major[0, 0, 1:, e, a] * catalog.sigma_minor[0, 0, 1:, e, a])
    size = np.log(found.sigma_major_m * found.sigma_minor_m)[0]
    assert size == pytest.approx(
        np.mean(area) - 2.0 * gains.mean(), abs=1e-5
    )  # the trace of a logarithm
