"""Shift of places by shadows below a cell: direction, size and fall with the Sun's elevation; in an image,
against ground that is moved and projected.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.posed import HADLEY, camera, ground

from lcp_catalog.geometry.frames import EnuFrame, mcmf_to_lonlat
from lcp_catalog.matching.common_errors import shadow_shift_m, shadow_shift_px


def sun(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Unit vector east, north, up."""
    a, h = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(h) * np.sin(a), np.cos(h) * np.cos(a), np.sin(h)])


def catalog(**more: Any) -> Any:
    return SimpleNamespace(gsd=np.array([100.0, 50.0]), errors={"shadow_shift": 0.1}, **more)


@pytest.mark.parametrize(
    ("elevation_deg", "cells"),
    [(-1.0, 0.1), (0.0, 0.1), (17.5, 0.075), (35.0, 0.0), (60.0, 0.0), (90.0, 0.0)],
)
def test_it_falls_to_nothing_at_35_deg(elevation_deg: float, cells: float) -> None:
    """Sun in the south-east: the shift is away from it, to the north-west, in cells of each level."""
    suns = np.tile(sun(135.0, elevation_deg), (2, 1))
    found = shadow_shift_m(catalog(), np.array([1, 0]), suns)
    expected = cells * np.array([[50.0], [100.0]]) * np.array([-1.0, 1.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_catalogue_without_the_figure_has_no_such_error() -> None:
    old: Any = SimpleNamespace(gsd=np.array([100.0]), errors={"spread": 0.2})
    assert not shadow_shift_m(old, np.array([0]), sun(90.0, 5.0)[None]).any()


def test_in_the_image_it_is_that_of_moved_ground() -> None:
    seen = camera(tilt=(0.2, 0.0, 0.5))
    places = ground(seen, 2, np.random.default_rng(4))
    lon, lat, _ = mcmf_to_lonlat(places)
    frames = [EnuFrame(float(a), float(b)) for a, b in zip(lon, lat, strict=True)]
    rotation = np.stack([frame.rotation for frame in frames])
    known = catalog(position_mcmf=places, rotation_mcmf_to_enu=rotation)
    direction = HADLEY.rotation.T @ sun(250.0, 12.0)
    found = shadow_shift_px(known, np.arange(2), seen, np.tile(direction, (2, 1)))
    in_enu = rotation @ direction
    azimuth = np.arctan2(in_enu[:, 0], in_enu[:, 1])
    elevation = np.degrees(np.arcsin(in_enu[:, 2]))
    metres = known.gsd * 0.1 * (1.0 - (elevation / 35.0) ** 2)
    away = -np.stack([np.sin(azimuth), np.cos(azimuth)], axis=-1) * metres[:, None]
    moved = places + np.einsum("nij,ni->nj", rotation[:, :2], away)
    np.testing.assert_allclose(found, seen.project(moved) - seen.project(places), rtol=2e-3)
    assert np.abs(found).max() > 0.01
