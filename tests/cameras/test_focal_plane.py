"""Directions to pixels through a lens of other units and axes, compared with the explicit formula."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lcp_catalog.cameras.distortion import (
    FocalPlane,
    LroNac,
    NoLens,
    OnPlane,
    OpenCV,
    UsgsRadial,
    plane_of,
)

LENS = UsgsRadial(0.0, 2e-5, -1e-9)
matrices = arrays(float, (2, 2), elements=st.floats(-200, 200)).filter(
    lambda m: abs(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) > 1.0 and np.linalg.cond(m) < 20
)


def directions(n=40, seed=0):
    rng = np.random.default_rng(seed)
    return np.concatenate([rng.uniform(-0.3, 0.3, (n, 2)), rng.uniform(0.5, 1.5, (n, 1))], axis=-1)


@given(matrices, st.booleans(), st.sampled_from([NoLens(), LENS, LroNac(1.8e-5)]))
@settings(deadline=None)
def test_any_detector(matrix, flipped, lens):
    """pixel = origin + matrix distorted(f x / z, f y / z), for any orientation of the axes."""
    focal, origin = 76.0, (11.5, -3.0)
    plane, axes = plane_of(lens, focal, matrix, origin, flipped=flipped)
    seen = directions()
    x, y = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2] * (-1 if flipped else 1)
    expected = np.array(origin) + np.stack(lens.distort(focal * x, focal * y), -1) @ matrix.T
    assert np.abs(plane.pixels(seen @ axes.T) - expected).max() < 1e-8
    area = focal**2 * abs(np.linalg.det(matrix))  # pixels of a square of the focal length
    assert plane.focal_length_px == pytest.approx(np.sqrt(area), rel=1e-12)
    assert np.abs(axes @ axes.T - np.eye(3)).max() < 1e-14
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[2] == pytest.approx([0, 0, 1.0])
    back = plane.directions(plane.pixels(seen @ axes.T)) @ axes
    assert np.abs(back - seen / np.linalg.norm(seen, axis=1)[:, None]).max() < 1e-11


@given(st.floats(0.0, 6.28), st.booleans(), st.booleans())
@settings(deadline=None)
def test_columns_run_along_x(angle, mirrored, flipped):
    """A square detector turned by any angle: columns run along camera X, rows along Y, or against
    it in a mirror image.
    """
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    plane, _ = plane_of(
        NoLens(),
        50.0,
        200.0 * np.diag([1.0, -1.0 if mirrored else 1.0]) @ turn,
        (0.0, 0.0),
        flipped=flipped,
    )
    assert plane.focal_length_px == pytest.approx(1e4)
    column, row = plane.pixels(np.array([[0.1, 0, 1.0], [0, 0.1, 1.0]]))
    assert column == pytest.approx([1000.0, 0.0], abs=1e-9)
    down = -1.0 if mirrored != flipped else 1.0
    assert row == pytest.approx([0.0, down * 1000.0], abs=1e-9)
    assert isinstance(plane.lens, NoLens if down > 0 else OnPlane)


def test_a_lens_in_units_of_the_focal_length_is_unchanged():
    lens = OpenCV(k1=0.1)
    plane, axes = plane_of(lens, 1.0, np.diag([300.0, 300.0]), (5.0, 6.0))
    assert plane == FocalPlane(pytest.approx(300.0), (5.0, 6.0), lens)
    assert axes == pytest.approx(np.eye(3), abs=1e-15)
    oblong, _ = plane_of(lens, 1.0, np.diag([300.0, 301.0]), (5.0, 6.0))
    assert isinstance(oblong.lens, OnPlane)


def test_points_behind_or_past_the_fold_are_nan():
    plane = FocalPlane(100.0, (0.0, 0.0), OpenCV(k1=-0.5))
    seen = plane.pixels(np.array([[0.1, 0, 1.0], [0.1, 0, -1.0], [0.9, 0, 1.0], [0.1, 0, 0.0]]))
    assert np.isfinite(seen[0]).all()
    assert np.isnan(seen[1:]).all()
    assert np.isfinite(plane.directions(np.array([30.0, 0.0]))).all()
    assert np.isnan(
        plane.directions(np.array([90.0, 0.0]))
    ).all()  # the distortion is smaller than that
