"""Trials of claims in a simulated frame of Hadley: what is found, where, and what is no trial."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers.claiming import claiming
from helpers.match_frames import GSD_M, LAW, hadley_camera, hadley_catalog, hadley_photo, taken

from lcp_catalog.cameras.sensor import ground_errors_m, pixel_size_m
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.patch_terrain import nodes_mcmf
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.matching.matches import CODE
from lcp_catalog.matching.point_search import Criteria, find_points
from lcp_catalog.validation.claims import ClaimSearch, search_radius_m

ROWS = np.arange(49)
SIGMA_M = 20.0


@cache
def hadley(search_m: float = 2400.0) -> Catalog:
    """The patches of Hadley with claims."""
    return claiming(hadley_catalog(), SIGMA_M, search_m)


def shifted_east(metres: float):
    """The frame's camera, moved east along the ground."""
    frame = EnuFrame(3.5, 26.0)
    return hadley_camera().moved([*(metres * frame.rotation[0]), 0.0, 0.0, 0.0])


def test_claims_are_those_of_the_catalogue_and_trials_those_of_a_search() -> None:
    """The trial of each point, repeated by one search of the same reach."""
    catalog, photo = hadley(), hadley_photo()
    claims = ClaimSearch(catalog, photo, LAW, Criteria()).claims(ROWS, searched=True)
    assert (claims.usable == (ROWS % 2 == 0)).all()
    np.testing.assert_allclose(claims.probability, np.where(ROWS % 2 == 0, 0.96, 0.2), atol=0.003)
    np.testing.assert_allclose(
        claims.sigma_m, np.tile([SIGMA_M, SIGMA_M / 2.0], (49, 1)), rtol=0.01
    )
    sensor, places = photo.sensor, catalog.position_mcmf
    reach = 2400.0 / pixel_size_m(sensor, places)
    alone = find_points(catalog, photo, LAW, reach, points=ROWS)
    off = np.linalg.norm(alone.found_px - sensor.project(places), axis=-1)
    no_trial = {CODE[reason] for reason in ("at the edge", "no data", "saturated")}
    corners = nodes_mcmf(catalog, ROWS)[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    whole = sensor.in_image(sensor.project(corners)).all(axis=1)
    searched = ~np.isin(alone.code, list(no_trial))
    assert claims.tried.tolist() == (whole & searched).tolist()
    assert 0 < (~whole & searched).sum() < claims.tried.sum()
    at_place = (alone.code == 0) & (off < 1.5)
    assert (claims.found >= at_place).all()
    assert claims.found.sum() > 35
    error = np.linalg.norm(claims.error_m, axis=-1)
    assert (error[claims.found] < 1.5 * GSD_M * 1.1).all()
    assert np.median(error[claims.found]) < 0.2 * GSD_M


def test_a_displaced_camera_shows_in_errors_and_loses_the_claims() -> None:
    """By 700 m, some six pixels: the points are found, but elsewhere than the camera says. With the
    true camera as reference the errors vanish; the trials are still those of the searching camera.
    """
    catalog, photo = hadley(), hadley_photo()
    wrong = photo.with_sensor(shifted_east(700.0))
    plain = ClaimSearch(catalog, wrong, LAW, Criteria()).claims(ROWS, searched=True)
    assert not plain.found.any()
    assert plain.tried.sum() > 40
    right = ClaimSearch(catalog, wrong, LAW, Criteria(), photo.sensor).claims(ROWS, searched=True)
    assert not right.found.any()
    placed = np.isfinite(right.error_m).all(axis=1)
    good = placed & (np.linalg.norm(np.nan_to_num(right.error_m), axis=-1) < 150.0)
    assert good.sum() > 30
    np.testing.assert_allclose(np.median(plain.error_m[good], axis=0), [700.0, 0.0], atol=25.0)
    assert np.abs(np.median(right.error_m[good], axis=0)).max() < 25.0


def test_nothing_is_found_beyond_the_search_radius() -> None:
    """The radius of the build limits the search: 120 m of 700 m."""
    catalog = hadley(120.0)
    wrong = hadley_photo().with_sensor(shifted_east(700.0))
    near = ClaimSearch(catalog, wrong, LAW, Criteria(), hadley_camera()).claims(ROWS, searched=True)
    assert not (np.linalg.norm(np.nan_to_num(near.error_m, nan=1e9), axis=-1) < 80.0).any()
    np.testing.assert_allclose(search_radius_m(catalog, ROWS[:3]), 120.0)
    np.testing.assert_allclose(search_radius_m(hadley_catalog(), ROWS[:3]), 64 * GSD_M, rtol=1e-6)


def test_what_the_image_does_not_show_is_no_trial() -> None:
    """Points over missing pixels, and points outside the image."""
    catalog, photo = hadley(), hadley_photo()
    weight = photo.weight.copy()
    weight[:, :140] = 0.0
    half = ClaimSearch(catalog, replace(photo, weight=weight), LAW, Criteria())
    claims = half.claims(ROWS, searched=True)
    column = photo.sensor.project(catalog.position_mcmf)[:, 0]
    assert not claims.tried[column < 90.0].any()
    assert claims.tried[column > 230.0].sum() > 5
    assert not (claims.found & ~claims.tried).any()
    away = photo.with_sensor(shifted_east(14e3))
    outside = ~away.sensor.in_image(away.sensor.project(catalog.position_mcmf))
    assert 5 < outside.sum() < 45
    far = ClaimSearch(catalog, away, LAW, Criteria()).claims(ROWS, searched=True)
    assert not far.tried[outside].any()


def test_without_a_place_or_claims_there_are_no_trials() -> None:
    photo = hadley_photo()
    lost = ClaimSearch(hadley(), photo, LAW, Criteria()).claims(ROWS, searched=False)
    assert lost.claimed.all()
    assert not lost.tried.any()
    assert lost.reason == "the image was not located"
    old = ClaimSearch(hadley_catalog(), photo, LAW, Criteria()).claims(ROWS, searched=True)
    assert not old.claimed.any()
    assert old.reason == "the catalogue claims nothing for this Sun, view and scale"
    none = ClaimSearch(hadley(), photo, LAW, Criteria()).claims(ROWS[:0], searched=True)
    assert (len(none), none.reason) == (0, "no point is in view")


@pytest.mark.slow
def test_a_fine_image_is_searched_and_gated_in_its_reduced_pixels() -> None:
    """Half the pixel size, so that the search takes blocks of 2 x 2 pixels: 1.5 of these are 178 m."""
    fine = hadley_camera()
    fine = replace(
        fine,
        focal_length_px=2.0 * fine.focal_length_px,
        principal_point_px=(319.9, 318.7),
        image_size_px=(640, 640),
    )
    photo, catalog = taken(fine), hadley()
    frame = EnuFrame(3.5, 26.0)
    for metres, found in ((140.0, True), (220.0, False)):
        near = photo.with_sensor(fine.moved([*(metres * frame.rotation[0]), 0.0, 0.0, 0.0]))
        claims = ClaimSearch(catalog, near, LAW, Criteria()).claims(ROWS, searched=True)
        assert (claims.found.sum() > 35) == found
        assert found or claims.found.sum() < 5
        median = np.nanmedian(claims.error_m, axis=0)
        np.testing.assert_allclose(median, [metres, 0.0], atol=10.0)


def test_a_coarse_image_is_searched_and_claimed_at_its_scale() -> None:
    """Pixels of two cells are claimed, of four not."""
    coarse = hadley_photo().reduced(4)
    found = ClaimSearch(hadley(), coarse, LAW, Criteria()).claims(ROWS, searched=True)
    assert not found.claimed.any()
    assert found.reason.startswith("the catalogue claims nothing")


def test_ground_errors_are_where_the_rays_meet_the_horizontal_plane() -> None:
    """Offsets of some pixels, by intersection of the pixel's ray with the plane of each point."""
    catalog, camera = hadley_catalog(), hadley_camera()
    dice = np.random.default_rng(5)
    places, rotation = catalog.position_mcmf, catalog.rotation_mcmf_to_enu
    offset = dice.uniform(-4.0, 4.0, (len(places), 2))
    start, ahead = camera.looks(camera.project(places) + offset)
    up = rotation[:, 2]
    along = ((places - start) * up).sum(-1) / (ahead * up).sum(-1)
    met = np.einsum("nij,nj->ni", rotation, start + along[:, None] * ahead - places)
    found = ground_errors_m(camera, places, rotation, offset)
    assert np.abs(met[:, 2]).max() < 1e-6
    second_order_m = (met**2).sum(-1).max() / 300e3  # the camera is 300 km away
    np.testing.assert_allclose(found, met[:, :2], rtol=0.0, atol=second_order_m)
    assert np.linalg.norm(met, axis=-1).max() > 400.0
    unknown = ground_errors_m(camera, places, rotation, np.full(offset.shape, np.nan))
    assert np.isnan(unknown).all()


@pytest.mark.parametrize("sigma", [GSD_M, 10.0])
def test_the_gate_follows_the_claimed_sigma(sigma: float) -> None:
    """A camera 260 m off, 2.2 pixels: within three claimed sigmas of 118 m, not of 10 m."""
    catalog = hadley()
    shape = catalog.sigma_major.shape
    wide = replace(catalog, sigma_major=np.full(shape, sigma), sigma_minor=np.full(shape, sigma))
    near = hadley_photo().with_sensor(shifted_east(260.0))
    found = ClaimSearch(wide, near, LAW, Criteria()).claims(ROWS, searched=True).found
    assert found.sum() > 35 if sigma > 100.0 else found.sum() < 5
