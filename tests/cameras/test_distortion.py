"""Lenses, compared with OpenCV, mpmath and the expected values of usgscsm's tests."""

import json

import cv2
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.cameras.distortion import (
    BrownConrady,
    KaguyaLism,
    LroNac,
    NoLens,
    OnPlane,
    OpenCV,
    Photometrix,
    UsgsRadial,
    lens_from_json,
)

TC = KaguyaLism(  # usgscsm, DistortionTests.cpp, KaguyaLism testCoeffs: TC1W2B0_01_05211N095E3380
    (-0.0009649900000000001, 0.00098441, 8.5773e-06, -3.7438e-06),
    (-0.0013796, 1.3502e-05, 2.7251e-06, -6.193800000000001e-06),
    -0.0725,
    0.0214,
)
WAC = UsgsRadial(-0.0258245827515546, -4.6613948359223396e-05, -0.000144650735580122)
METRIC = Photometrix(0.004, -0.191, 1.3e-5, -2.1e-8, -5.3e-11, 7.2e-6, 2.3e-6)
BROWN = BrownConrady(0.5, 0.4, 1.3e-5, -2.1e-8, 1.3e-11, 2e-5, -3e-8, 0.7)
SKEWED = OnPlane(((0.0, -2.0), (2.0, 0.1)), TC, ((0.5, 0.02), (-0.01, -0.4)))

LENSES = {
    "opencv": (OpenCV(-0.11, 0.03, 0.002, -0.0015, -0.004), 0.5),
    "radial": (WAC, 5.0),
    "radial barrel": (UsgsRadial(0.03, 1e-5, 4e-6), 5.0),
    "nac": (LroNac(1.81e-5), 18.0),
    "kaguya": (TC, 18.0),
    "photometrix": (METRIC, 20.0),
    "brown": (BROWN, 20.0),
    "plane": (SKEWED, 5.0),
    "none": (NoLens(), 5.0),
}


@pytest.mark.parametrize("name", LENSES)
@given(st.floats(-1, 1), st.floats(-1, 1))
@settings(deadline=None)
def test_a_lens_undoes_itself(name, a, b):
    lens, reach = LENSES[name]
    u, v = np.array([reach * a]), np.array([reach * b])
    there = lens.distort(*lens.undistort(u, v))
    again = lens.undistort(*lens.distort(u, v))
    assert np.abs([there[0] - u, there[1] - v]).max() < 1e-13 * max(reach, 1.0)
    assert np.abs([again[0] - u, again[1] - v]).max() < 1e-13 * max(reach, 1.0)


@pytest.mark.parametrize("name", LENSES)
def test_a_lens_is_the_same_from_its_json(name):
    lens, _ = LENSES[name]
    assert lens_from_json(json.loads(json.dumps(lens.to_json()))) == lens


def test_opencv_is_opencvs():
    lens = OpenCV(-0.11, 0.03, 0.002, -0.0015, -0.004)
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(-0.5, 0.5, 9), [-0.3, 0.0, 0.2]))
    ideal = np.stack([x, y, np.ones_like(x)], -1)
    numbers = np.array([-0.11, 0.03, 0.002, -0.0015, -0.004])
    theirs, _ = cv2.projectPoints(ideal, np.zeros(3), np.zeros(3), np.eye(3), numbers)
    assert np.abs(np.stack(lens.distort(x, y), -1) - theirs[:, 0]).max() < 1e-15


def test_expected_values_of_usgscsm():
    """Expected values of its tests/DistortionTests.cpp: RadTanInversionTest, KaguyaLism
    testRemoveCoeffs and testCoeffs, LroLrocNac testLastDetectorSample, with their tolerances (the
    second one of TC holds to the 1e-5 used there).
    """
    radtan = OpenCV(0.000031, -0.000056, 1.3e-5, -1.7e-6, 2.9e-8)
    assert radtan.distort(np.array(5.0), np.array(6.0)) == pytest.approx(
        (4.0010785450000004, 4.8022116940000013), abs=1e-8
    )
    cubic = KaguyaLism((1, 2, 3, 4), (1, 2, 3, 4), 0.5, 0.5)
    both = 1 + 1 + 2.828427125 + 6 + 11.313708499 + 0.5
    assert cubic.undistort(np.array(1.0), np.array(1.0)) == pytest.approx((both, both), abs=1e-8)
    x, y = TC.undistort(np.array(1.0), np.array(1.0))
    assert x == pytest.approx(0.9279337415074662, abs=1e-6)
    assert y == pytest.approx(1.0200274261995939, abs=1e-5)
    x, y = LroNac(1.81e-5).undistort(np.array(0.0), np.array(5064.0 / 2.0 * 0.007))
    assert (x, y) == pytest.approx((0.0, 17.6237922244), abs=1e-8)


def test_usgs_radial_is_defined_from_distorted_to_ideal():
    """x = u (1 - k0 - k1 r^2 - k2 r^4) with 50 digits; the inverse by mpmath's root finder."""
    mpmath.mp.dps = 50
    k0, k1, k2 = (mpmath.mpf(k) for k in (WAC.k0, WAC.k1, WAC.k2))
    u, v = mpmath.mpf(3.5), mpmath.mpf(-2.25)
    kept = 1 - k0 - k1 * (u * u + v * v) - k2 * (u * u + v * v) ** 2
    x, y = WAC.undistort(np.array(3.5), np.array(-2.25))
    assert (x, y) == pytest.approx((float(u * kept), float(v * kept)), rel=1e-15)
    distorted = mpmath.findroot(lambda r: r * (1 - k0 - k1 * r**2 - k2 * r**4) - mpmath.mpf(4), 4)
    assert WAC.distort(np.array(0.0), np.array(4.0))[1] == pytest.approx(
        float(distorted), rel=1e-15
    )


def test_photometrix_and_brown_conrady_by_hand():
    """Formulas of ASP's manual (pinholemodels) in exact fractions, with the offset as in its
    program for Photometrix.
    """
    u, v = 11.0, -7.0
    x, y = u - 0.004, v + 0.191
    r2 = x * x + y * y
    radial = 1.3e-5 * r2 - 2.1e-8 * r2**2 - 5.3e-11 * r2**3
    expected = (
        u + x * radial + 7.2e-6 * (r2 + 2 * x * x) + 2 * 2.3e-6 * x * y,
        v + y * radial + 2.3e-6 * (r2 + 2 * y * y) + 2 * 7.2e-6 * x * y,
    )
    assert METRIC.undistort(np.array(u), np.array(v)) == pytest.approx(expected, rel=1e-14)
    x, y = u - 0.5, v - 0.4
    r2 = x * x + y * y
    radial = 1 + 1.3e-5 * r2 - 2.1e-8 * r2**2 + 1.3e-11 * r2**3
    tangential = 2e-5 * r2 - 3e-8 * r2**2
    expected = (x * radial - tangential * np.sin(0.7), y * radial + tangential * np.cos(0.7))
    assert BROWN.undistort(np.array(u), np.array(v)) == pytest.approx(expected, rel=1e-14)


def test_where_lenses_fold():
    # OpenCV: r + k1 r^3 turns at 1 / sqrt(3 |k1|)
    lens = OpenCV(k1=-0.5)
    turn = 1 / np.sqrt(1.5)
    assert lens.within(np.array([0.999, 1.001]) * turn, np.zeros(2)).tolist() == [True, False]
    # each power alone: r + k2 r^5 at (5 |k2|)^(-1/4), r + k3 r^7 at (7 |k3|)^(-1/6)
    for lens, turn in ((OpenCV(k2=-0.5), 2.5**-0.25), (OpenCV(k3=-0.5), 3.5 ** (-1 / 6))):
        assert lens.within(np.zeros(2), np.array([0.999, 1.001]) * turn).tolist() == [True, False]
    # radial: r - k1 r^3 turns at 1 / sqrt(3 k1), where the ideal radius is 2/3 of that
    radial = UsgsRadial(0.0, 1e-3, 0.0)
    ideal = 2 / 3 / np.sqrt(3e-3)
    assert radial.within(np.array([0.999, 1.001]) * ideal, np.zeros(2)).tolist() == [True, False]
    assert UsgsRadial(0.0, -1e-3, 0.0).within(np.array([1e6]), np.zeros(1)).all()
    # NAC: 1 / (2 sqrt k); there v is twice y
    nac = LroNac(1.81e-5)
    edge = 0.5 / np.sqrt(1.81e-5)
    assert nac.within(np.zeros(2), np.array([0.999, 1.001]) * edge).tolist() == [True, False]
    assert nac.distort(np.array(0.0), np.array(edge))[1] == pytest.approx(2 * edge, rel=1e-6)
    # Photometrix: r + k3 r^7 turns where 7 k3 r^6 = -1, at 6/7 of that ideally
    cubic = Photometrix(0.0, 0.0, 0.0, 0.0, -1e-12, 0.0, 0.0)
    ideal = 6 / 7 * (1e12 / 7) ** (1 / 6)
    assert cubic.within(np.array([0.999, 1.001]) * ideal, np.zeros(2)).tolist() == [True, False]
    brown = BrownConrady(0.0, 0.0, 0.0, 0.0, -1e-12, 0.0, 0.0, 0.0)
    assert brown.within(np.array([0.999, 1.001]) * ideal, np.zeros(2)).tolist() == [True, False]
    # on a plane of 70 mm to the focal length, axes exchanged
    scaled = OnPlane(((0.0, 70.0), (70.0, 0.0)), nac, ((0.0, 1 / 70), (1 / 70, 0.0)))
    across = np.array([0.999, 1.001]) * edge / 70
    assert scaled.within(across, np.zeros(2)).tolist() == [True, False]
    assert scaled.within(np.zeros(2), across).all()
    assert not SKEWED.within(np.array([np.nan]), np.zeros(1)).any()


def test_one_point_without_an_answer_does_not_spoil_the_others():
    lens = OpenCV(-0.11, 0.03, 0.002, -0.0015, -0.004)
    alone = lens.undistort(np.array([0.3]), np.array([0.2]))
    among = lens.undistort(np.array([np.nan, 0.3, 1e9]), np.array([0.0, 0.2, 0.0]))
    assert among[0][1] == pytest.approx(alone[0][0], abs=1e-15)
    assert np.isnan(among[0][0])
    radial = WAC.distort(np.array([np.nan, 3.0]), np.array([0.0, 1.0]))
    assert radial[0][1] == pytest.approx(WAC.distort(np.array(3.0), np.array(1.0))[0], rel=1e-15)


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ("opencv", "model"),
        ({"model": "fisheye"}, "model"),
        ({"model": []}, "model"),
        ({"model": "lro-nac", "k": 1e300}, "k must hold"),
        ({"model": "lro-nac"}, "lacks k"),
        ({"model": "lro-nac", "k": "x"}, "k does not consist of numbers"),
        ({"model": "lro-nac", "k": [1.0]}, "k must hold"),
        ({"model": "lro-nac", "k": float("nan")}, "k must hold"),
        (SKEWED.to_json() | {"into": [[1, 2], [2, 4]]}, "into has no inverse"),
        (SKEWED.to_json() | {"lens": {}}, "model"),
    ],
)
def test_refused_documents(document, says):
    with pytest.raises(ValueError, match=says):
        lens_from_json(document)
