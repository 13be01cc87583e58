"""A small closed loop: frames of real terrain, rendered by the product and by Embree, located from
a camera 2 km off per axis. `closed_loop.py` of c896266 was the complete run, for
docs/measurements/matching-and-pose.md. ``-rP`` shows every frame's figures.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.closed_loops import (
    ATTITUDE_SIGMA_RAD,
    OPTIONS,
    POSITION_SIGMA_M,
    Draw,
    Row,
    Shot,
    Site,
    _squared,
    _turn,
    by_embree,
    by_product,
    cut,
    fly,
)
from scipy.spatial.transform import Rotation

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.matching.fix import LOCATED
from lcp_catalog.matching.position_fix import locate

DEM = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
MIDDLE = (3.5, 26.0)
SMALL = Draw(pixel_cells=(0.8, 1.3), size_px=240, sun_elevation_deg=(8.0, 45.0))
"""Frames of 45 to 75 km, not under the highest Suns: quick, with some dozens of points."""


@pytest.fixture(scope="module")
def site() -> Site:
    """Patches every 6 km over 100 km of Hadley, of any quality, without a catalogue's choice."""
    step_deg = 0.2
    steps = np.arange(-8, 9) * step_deg
    places = [(MIDDLE[0] + x / 0.9, MIDDLE[1] + y) for y in steps for x in steps]
    return Site("hadley", DEM, cut(DEM, places, 33, 237.0))


@pytest.fixture(scope="module")
def taken() -> Callable[[Site, int], tuple[Shot, Camera, Image]]:
    """A site's first frame of a seed, made once."""
    made: dict[int, tuple[Shot, Camera, Image]] = {}

    def take(site: Site, seed: int) -> tuple[Shot, Camera, Image]:
        if seed not in made:
            shot, camera = next(site.shots(1, seed, SMALL))
            made[seed] = shot, camera, by_product(DEM)(camera, shot)
        return made[seed]

    return take


def show(rows: list[Row]) -> None:
    for row in rows:
        shot = row.shot
        print(
            f"{shot.number}: Sun {shot.sun_elevation_deg:.0f}, off nadir {shot.off_nadir_deg:.0f}, field {shot.fov_deg:.0f}; "
            f"{row.verdict}, {row.found} of {row.points}, across {row.across_px:.3f} px, squared {row.squared:.1f} of "
            f"{row.unknowns}, bias {row.bias_px} ({row.reason})"
        )


@pytest.mark.slow
@pytest.mark.parametrize("attitude", [False, True])
def test_a_frame_comes_back_to_its_place(site, taken, attitude):
    shot, camera, photo = taken(site, 5)
    row = fly(site, shot, camera, photo, attitude)
    show([row])
    assert row.located
    assert not row.is_false
    assert row.across_px < (0.6 if attitude else 0.3)
    assert row.position_m < POSITION_SIGMA_M / 10
    assert row.unknowns == (6 if attitude else 3)
    assert row.squared < 30.0


@pytest.mark.slow
def test_a_frame_from_elsewhere_is_not_located(site, taken):
    """With a camera 60 km further east or west, thirty sigmas, over terrain of the catalogue."""
    shot, camera, photo = taken(site, 5)
    east = EnuFrame(shot.lon_deg, shot.lat_deg).rotation[0]
    sign = 1.0 if shot.lon_deg < MIDDLE[0] else -1.0
    wrong = camera.moved([*(sign * 60e3 * east), 0.0, 0.0, 0.0])
    found = locate(site.catalog, photo.with_sensor(wrong), Uncertainty(POSITION_SIGMA_M))
    assert found.verdict != LOCATED
    assert found.pose is None


@pytest.mark.slow
@pytest.mark.parametrize("renderer", ["product", "embree"])
def test_a_dozen_frames(site, renderer):
    """12 frames: all but one solved, none false; the mean of 12 x 3 or 12 x 6 squared errors is
    known to 24 or 17 %.
    """
    take = by_product(DEM) if renderer == "product" else by_embree(DEM, MIDDLE, 120e3)
    rows: dict[bool, list[Row]] = {False: [], True: []}
    for shot, camera in site.shots(12, 8, SMALL):
        photo = take(camera, shot)
        for attitude in (False, True):
            rows[attitude].append(fly(site, shot, camera, photo, attitude, not attitude))
    show(rows[False] + rows[True])
    for attitude, some in rows.items():
        good = [row for row in some if row.located]
        assert len(good) >= 11
        assert not any(row.is_false for row in some)
        squared = np.mean([row.squared / row.unknowns for row in good])
        assert 0.4 < squared < 1.8
        if not attitude:
            assert np.median([row.across_px for row in good]) < 0.3
    bias = np.mean([row.bias_px for row in rows[False]], axis=0)
    assert np.abs(bias).max() < 0.05


# The judge judged


@pytest.mark.slow
def test_frames_are_drawn_over_all_that_was_asked_for(site):
    """Completely on the DEM, and still as oblique and as wide as drawn; the Sun as its angles say."""
    drawn = list(site.shots(60, 3, Draw(size_px=128)))
    for name, low, high in (
        ("off_nadir_deg", 0, 40),
        ("fov_deg", 10, 60),
        ("roll_deg", 0, 360),
        ("sun_elevation_deg", 5, 60),
    ):
        values = np.array([getattr(shot, name) for shot, _ in drawn])
        assert low <= values.min()
        assert values.max() <= high
        assert np.ptp(values) > 0.8 * (high - low)
    for shot, camera in drawn:
        place = EnuFrame(shot.lon_deg, shot.lat_deg)
        away = place.from_mcmf(camera.position_mcmf_m)
        off = np.degrees(np.arccos(away[2] / np.linalg.norm(away)))
        assert off == pytest.approx(shot.off_nadir_deg)
        sun = place.from_mcmf(camera.sun_position_mcmf_m)
        phase = np.degrees(np.arccos(away @ sun / np.linalg.norm(away) / np.linalg.norm(sun)))
        assert phase == pytest.approx(shot.phase_deg, abs=1e-3)
        np.testing.assert_allclose(camera.project(place.origin_mcmf_m), [63.5, 63.5], atol=1e-6)


def test_errors_are_squared_by_their_covariance():
    """Draws from a covariance of metres and radians have the number of solved unknowns as their
    mean; fixed ones do not count.
    """
    dice = np.random.default_rng(4)
    root = dice.normal(size=(6, 6)) * np.array([[30, 50, 9, 1e-4, 3e-5, 2e-4]]).T
    draws = dice.normal(size=(4000, 6)) @ root.T
    covariance = root @ root.T
    solved = np.ones(6, dtype=bool)
    assert np.mean([_squared(e, covariance, solved) for e in draws]) == pytest.approx(6, rel=0.05)
    held = np.array([True] * 3 + [False] * 3)
    covariance[3:] = covariance[:, 3:] = 0.0
    assert np.mean([_squared(e, covariance, held) for e in draws]) == pytest.approx(3, rel=0.05)


def test_a_small_rotations_vector():
    vector = np.array([2e-4, -1e-4, 3e-4])
    np.testing.assert_allclose(_turn(Rotation.from_rotvec(vector).as_matrix()), vector, rtol=1e-6)


@pytest.mark.slow
def test_the_truth_is_what_the_believed_camera_was_moved_from(site):
    """A camera that is moved, and moved back by the correction found, is the same camera; sigmas
    are the stated ones.
    """
    assert np.degrees(ATTITUDE_SIGMA_RAD) * 3600.0 == pytest.approx(20.0)
    assert OPTIONS.check_sun
    _, camera = next(site.shots(1, 5, SMALL))
    wrong = camera.moved([100.0, -50.0, 30.0, 1e-4, -2e-4, 5e-5])
    turn = _turn(camera.rotation_mcmf_to_camera @ wrong.rotation_mcmf_to_camera.T)
    back = wrong.moved([-100.0, 50.0, -30.0, *turn])
    np.testing.assert_allclose(back.position_mcmf_m, camera.position_mcmf_m)
    np.testing.assert_allclose(
        back.rotation_mcmf_to_camera, camera.rotation_mcmf_to_camera, atol=1e-10
    )
