"""Pose from real images: Apollo 15 Metric frames with GLD100 at 474 m, from 5 km and 0.5 deg off.
Limits: 1 km, the pose's own 3 sigma, and 1.5 DEM pixels for every accepted match; a frame with the
camera of another is refused. `locate_photos.py` of c896266 made the figures of
docs/measurements/matching-and-pose.md. The command builds the catalogues, from the DEM alone. Skipped without
the shared data.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import located_frames as frames

from lcp_catalog.cameras.sensor import Uncertainty
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.matching.fix import CANNOT_SAY, LOCATED, NOT_HERE
from lcp_catalog.matching.point_choice import PointClaims, working_image
from lcp_catalog.matching.pose import position_error
from lcp_catalog.matching.position_fix import locate

pytestmark = pytest.mark.slow

UNCERTAIN = Uncertainty(frames.OFF_M, frames.OFF_RAD)
SQUARED_3_SIGMA = 14.2
"""chi2 of three degrees of freedom at the 99.73 % of 3 sigma."""

NEAR = {"AS15-M-0414": (1.0, 22.0, 8.0, 29.0), "AS15-M-0295": (143.8, -24.8, 150.8, -18.0)}
"""Bounds of the built area, degrees."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("catalogues")


def of(key: str, data: Path, folder: Path) -> Catalog:
    """The catalogue of a frame's area, built once."""
    if not (data / "images" / frames.FRAMES[key].folder).is_dir():
        pytest.skip(f"{key} and its DEM are not among the shared data")
    return frames.built(data, frames.FRAMES[key], folder, NEAR[key])


@pytest.mark.parametrize("key", NEAR)
def test_the_camera_comes_back(key: str, shared_data: Path, folder: Path) -> None:
    catalog, photo = of(key, shared_data, folder), frames.frame(shared_data, key)
    for seed in range(2):
        answer = locate(catalog, frames.displaced(photo, seed), UNCERTAIN, frames.LAW)
        assert answer.verdict == LOCATED, answer.reason
        error = position_error(answer.pose, photo.sensor)
        assert error.error.whole_m < 1000.0
        assert error.squared < SQUARED_3_SIGMA
        assert error.sigma.whole_m < 500.0
        assert answer.matches.found.sum() > 50
        assert frames.worst_off_m(answer, catalog, photo.sensor) < 1.5 * frames.DEM_PIXEL_M


@pytest.mark.parametrize("key", NEAR)
def test_matches_have_the_covariances_that_are_claimed(
    key: str, shared_data: Path, folder: Path
) -> None:
    """So `query` states what `locate` reaches (1.5 times the claimed sigmas while all of the noise counted)."""
    catalog, photo = of(key, shared_data, folder), frames.frame(shared_data, key)
    fix = locate(catalog, frames.displaced(photo, 0), UNCERTAIN, frames.LAW)
    used = fix.matches.found & fix.matches.usable
    rows = fix.matches.point[used]
    image = working_image(catalog, photo.with_sensor(fix.pose.sensor), rows)
    suns = image.sun_directions(catalog.position_mcmf[rows])
    claim = PointClaims.of(catalog, rows, image.sensor, suns).covariance_px2
    own = fix.matches.covariance_px2[used] / image.sensor.factor**2
    times = (np.linalg.det(own) / np.linalg.det(claim)) ** 0.25
    assert len(times) > 20
    assert np.median(times) < 1.25


def test_another_place_is_refused(shared_data: Path, folder: Path) -> None:
    """The image AS15-M-0295 with the camera and the Sun of AS15-M-0414, at Hadley."""
    catalog = of("AS15-M-0414", shared_data, folder)
    photo = frames.frame(shared_data, "AS15-M-0414")
    offered = frames.transplanted(frames.frame(shared_data, "AS15-M-0295"), photo)
    answer = locate(catalog, frames.displaced(offered, 0), UNCERTAIN, frames.LAW)
    assert answer.verdict == NOT_HERE
    assert answer.pose is None


def test_nothing_wrong_is_believed(shared_data: Path, folder: Path) -> None:
    catalog = of("AS15-M-0414", shared_data, folder)
    photo = frames.frame(shared_data, "AS15-M-0414")
    for name, image in frames.spoilt(photo, catalog):
        answer = locate(catalog, frames.displaced(image, 0), UNCERTAIN, frames.LAW)
        assert not frames.is_wrong(answer, catalog, photo.sensor), name
        if name.startswith("Sun") and "20 deg azimuth" in name:
            assert answer.verdict == CANNOT_SAY, name
            assert "stated Sun" in answer.reason
        elif name.startswith(("mirrored", "turned", "noise")):
            assert answer.verdict == NOT_HERE, name
        elif name in ("blank", "white noise"):
            assert answer.verdict == CANNOT_SAY, name


def test_the_frames_are_what_they_are_called(shared_data: Path) -> None:
    """A scaled camera sees the same terrain at the same share of its image."""
    hadley, far = (frames.frame(shared_data, key) for key in ("AS15-M-0414", "AS15-M-0295"))
    scaled = frames.transplanted(far, hadley).sensor
    ground = hadley.sensor.position_mcmf_m * 0.94
    share = [(s.project(ground) + 0.5) / s.shape[0] for s in (scaled, hadley.sensor)]
    assert np.allclose(*share)
