"""Points in view, against a projection of all points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers import many_points
from helpers.posed import camera

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.matching.point_choice import points_in_view


@pytest.fixture(scope="module")
def catalog() -> Catalog:
    return many_points.catalog(20_000)


def cameras() -> list[Camera]:
    """Narrow and wide ones, near and far, tilted to the limb, with bent lenses and some without an inverse."""
    dice, found = np.random.default_rng(8), []
    for _ in range(60):
        altitude = 10.0 ** dice.uniform(4.0, 8.0)
        place = EnuFrame(dice.uniform(0, 360), dice.uniform(-60, 60), dice.uniform(-2e3, 2e3))
        tilt = dice.normal(0.0, dice.choice([0.05, 0.6]), 3)
        taken = camera(place, altitude, 10.0 ** dice.uniform(1.7, 3.5), 404, tuple(tilt))
        bend = dice.choice([0.0, -0.05, 0.05, -0.4]) * np.array([1.0, 0.2, 0.01, 0.01, 0.0])
        found.append(replace(taken, distortion=bend))
    return found


@pytest.mark.slow
def test_they_are_those_of_a_projection_of_all(catalog: Catalog) -> None:
    seen = []
    for taken in cameras():
        inside = taken.in_image(taken.project(catalog.position_mcmf))
        away = taken.position_mcmf_m - catalog.position_mcmf
        facing = (away * catalog.rotation_mcmf_to_enu[:, 2]).sum(axis=1) > 0.0
        wanted = np.flatnonzero(inside & facing)
        assert points_in_view(catalog, taken).tolist() == wanted.tolist()
        seen.append(len(wanted))
    assert sum(count > 3 for count in seen) > 20
    assert max(seen) > 1000
