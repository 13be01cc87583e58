"""Error ellipses of covariances: axes, angles from any axis, circles and unknown covariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.geometry.ellipses import ellipse_covariance, error_ellipses


@given(st.floats(0.01, 50.0), st.floats(0.01, 1.0), st.floats(0.0, 179.0))
def test_an_ellipse_is_its_covariance(major: float, ratio: float, angle_deg: float) -> None:
    """From axes to a covariance and back, where the axes differ."""
    minor, angle = major * ratio, math.radians(angle_deg)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    covariance = turn @ np.diag([major**2, minor**2]) @ turn.T
    (sigma,), (found,) = error_ellipses(np.array([(covariance + covariance.T) / 2.0]))
    assert sigma == pytest.approx([major, minor], rel=1e-6)
    if ratio < 0.99:
        assert min(abs(found - angle_deg), 180.0 - abs(found - angle_deg)) < 1e-4
    assert 0.0 <= found <= 180.0


def test_downwards_is_ninety_degrees() -> None:
    sigma, angle = error_ellipses(np.array([[[1.0, 0.0], [0.0, 4.0]], np.full((2, 2), np.nan)]))
    assert sigma[0].tolist() == [2.0, 1.0]
    assert angle[0] == pytest.approx(90.0)
    assert np.isnan(sigma[1]).all()
    assert np.isnan(angle[1])


def test_angles_from_north_in_a_plane_of_east_and_south() -> None:
    """Columns are east, rows south: an axis towards the north-east has a negative covariance."""
    for azimuth in (0.0, 30.0, 45.0, 90.0, 135.0, 179.0):
        east, south = np.sin(np.radians(azimuth)), -np.cos(np.radians(azimuth))
        axes = np.array([[east, -south], [south, east]])
        covariance = axes @ np.diag([9.0, 4.0]) @ axes.T
        (sigma,), (angle,) = error_ellipses(covariance[None], first_axis_deg=90.0)
        assert sigma == pytest.approx((3.0, 2.0))
        assert abs((angle - azimuth + 90.0) % 180.0 - 90.0) < 1e-6
        assert 0.0 <= angle <= 180.0


def test_covariances_of_ellipses_from_north() -> None:
    """There and back; a plane of north and east counts the angle from its first axis."""
    sigma, angle = np.array([[3.0, 1.0], [2.0, 0.5]]), np.array([20.0, 130.0])
    flipped = ellipse_covariance(sigma, angle)[:, ::-1, ::-1]  # north, east
    found, turned = error_ellipses(flipped)
    np.testing.assert_allclose(found, sigma, rtol=1e-12)
    np.testing.assert_allclose(turned, angle, rtol=1e-12)
