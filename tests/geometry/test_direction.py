"""`Direction`: the vector of angles, the angles of a vector, and refused vectors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from lcp_catalog.geometry.frames import Direction, EnuFrame, direction_enu


def test_angles_and_vector() -> None:
    """Recipe: azimuth 30 deg, elevation 60 deg: east cos60 sin30, north cos60 cos30, up sin60."""
    sun = Direction(direction_enu(30.0, 60.0))
    assert_allclose(sun.vector, [0.25, math.sqrt(3.0) / 4.0, math.sqrt(3.0) / 2.0], atol=1e-15)
    assert (sun.azimuth_deg, sun.elevation_deg) == (pytest.approx(30.0), pytest.approx(60.0))
    assert sun.azimuth_rad == pytest.approx(math.pi / 6.0)
    assert sun.elevation_rad == pytest.approx(math.pi / 3.0)


def test_azimuth_is_positive_in_degrees_and_signed_in_radians() -> None:
    west = Direction(np.array([-1.0, 0.0, 0.0]))
    assert (west.azimuth_deg, west.azimuth_rad) == (270.0, pytest.approx(-math.pi / 2.0))


def test_from_mcmf() -> None:
    """At longitude 90 deg on the equator MCMF y is up, z is north and -x is east."""
    frame = EnuFrame(90.0, 0.0)
    assert_allclose(Direction.from_mcmf([0.0, 1.0, 0.0], frame).vector, [0, 0, 1], atol=1e-15)
    assert_allclose(Direction.from_mcmf([-1.0, 0.0, 0.0], frame).vector, [1, 0, 0], atol=1e-15)


def test_numpy_takes_the_vector() -> None:
    vector = [0.0, 0.6, 0.8]
    sun = Direction.of(vector)
    assert Direction.of(sun) is sun
    assert_array_equal(np.asarray(sun), vector)
    assert np.dot([[0.0, 0.0, 1.0]], sun) == [0.8]


def test_refused_vectors() -> None:
    for vector in ([0.0, 0.0, 0.0], [1.0, 0.0], [np.nan, 0.0, 1.0], [[0.0, 0.0, 1.0]]):
        with pytest.raises(ValueError, match="no such direction"):
            Direction.of(vector)
