"""Parameters of the facet model: curves over the incidence, the paper's tables and figure 3, names
and limits.
"""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from helpers import twins_facet as twin
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from lcp_catalog.errors import ConfigError
from lcp_catalog.kernels.photometry import facet as kernel
from lcp_catalog.photometry.facet_model import (
    NAMED,
    OPTICS,
    TABLE_1,
    TABLE_2,
    TABLE_3,
    FacetModel,
    Node,
    Optics,
    Shadowing,
    named_model,
)
from lcp_catalog.photometry.laws import reflectance_model

mpmath.mp.dps = 40

ERRORS_PERCENT = (
    # table 2's last two columns: eq. (4) before and after the regularisation
    (5.63, 1.72, 2.18, 1.87, 2.21, 1.97, 3.76, 4.49),
    (5.63, 5.59, 4.04, 1.97, 2.21, 3.00, 3.76, 4.49),
)


OURS = (0.43, 0.0080, -0.80, 0.45)


GLOSSY = Node(50, 0.4, 6, 0.15, 0.9, -4, 0.85)


# -- curves over the incidence


@settings(max_examples=80, deadline=None)
@given(st.lists(st.floats(0.01, 1), min_size=2, max_size=9), st.data())
def test_curves_are_shape_preserving_cubics(gaps, data):
    """Compared with scipy's PCHIP, which has the same rule for slopes."""
    x = np.cumsum(gaps)
    y = np.array(data.draw(st.lists(st.integers(-400, 400), min_size=len(x), max_size=len(x)))) / 8
    slopes = kernel.pchip_slopes(x, y)
    at = np.linspace(x[0], x[-1], 41)
    found = [kernel.hermite(x, y, slopes, value) for value in at]
    assert found == pytest.approx(PchipInterpolator(x, y)(at), abs=1e-9)
    assert kernel.hermite(x, y, slopes, x[0] - 1) == y[0]
    assert kernel.hermite(x, y, slopes, x[-1] + 1) == pytest.approx(y[-1])


def test_a_models_parameters_are_such_curves():
    model = named_model("labunets-2019-table-3")
    table = np.array(TABLE_3)
    cosines = np.cos(np.radians(table[::-1, 0]))
    for psi in (0.0, 4.0, 10.0, 33.3, 60.0, 69.9):
        found = np.array(model.parameters(psi)[1:]) / np.array([OPTICS.at_normal, 1, 1, 1, 1, 1])
        wanted = [
            PchipInterpolator(cosines, col[::-1])(math.cos(math.radians(psi)))
            for col in table[:, 1:].T
        ]
        assert found == pytest.approx(np.array(wanted), rel=1e-12, abs=1e-12)


# -- the paper's tables


def columns(table):
    return np.array(table)[:, 1:].T


def length(values):
    """Eq. (6) by scipy's interpolant; constant below cos 70 deg."""
    cosines = np.cos(np.radians(np.array(TABLE_3)[::-1, 0]))
    steps = np.clip(np.arange(101) / 100, cosines[0], cosines[-1])
    rises = np.diff(PchipInterpolator(cosines, values[::-1])(steps))
    return np.sqrt(rises**2 + 1e-4).sum()


def test_d1_of_the_paper():
    """Sums of table 2's error columns 23.83 and 30.69 %; D1 = 0.288; with D2 = -0.285, D = -0.282."""
    before, after = ERRORS_PERCENT
    assert sum(before) == pytest.approx(23.83)
    assert sum(after) == pytest.approx(30.69)
    grown = (sum(after) - sum(before)) / sum(before)
    assert round(grown, 3) == 0.288
    assert round(grown + 2 * -0.285, 3) == -0.282
    assert round(0.288 + 2 * -0.285, 3) == -0.282


def test_d2_of_the_paper():
    """The five known columns give -0.2906 of D2 = -0.285, so the lost one, w_B, can only have grown
    by 0.5 %.
    """
    changes = [
        length(new) / length(old) - 1
        for new, old in zip(columns(TABLE_3), columns(TABLE_2), strict=True)
    ]
    assert (
        changes[0] == changes[1] == 0.0
    )  # w_B: table 3's in the place of the lost; dpsi: the same in both
    assert sum(changes) == pytest.approx(-0.2906, abs=1e-4)
    assert -0.285 - sum(changes) == pytest.approx(0.0056, abs=6e-4)


def test_where_the_error_did_not_change_nothing_did():
    before, after = ERRORS_PERCENT
    for j, (row2, row3) in enumerate(zip(TABLE_2, TABLE_3, strict=True)):
        assert (row2 == row3) == (before[j] == after[j])
    assert {row[0] for row in TABLE_2} == {0, 10, 20, 30, 40, 50, 60, 70}


def test_the_tables_meet_their_own_normalisation():
    """I_rel(psi, -psi) = 1 by definition, to the errors of the fits; with w_B as a factor of R / R(0) it would be 25."""
    twelve = [*TABLE_3, *TABLE_1["0.91"], *TABLE_1["1.04"]]
    missed, literal = [], []
    for psi, w_b, *rest in twelve:
        for weight, found in ((w_b * OPTICS.at_normal, missed), (w_b, literal)):
            value = twin.intensity((weight, *rest), psi, -psi - 1e-9, 0, OPTICS.n, 0, OURS)
            found.append(abs(float(value) - 1))
    assert max(missed) < 0.09
    assert np.median(missed) < 0.02
    assert min(literal) > 0.4
    assert max(literal) > 20


def test_figure_3():
    """At 60 deg, -40 <= theta <= 0, the measured brightness is the line 1.5978 + 0.000054 theta; it falls beyond 20 deg."""
    model = named_model("labunets-2019-table-3")
    angles = np.arange(-40.0, 1.0, 2.0)
    found = model.brightness(60, angles)
    slope, level = np.polyfit(angles, found, 1)
    assert level == pytest.approx(1.5978, rel=0.01)
    assert slope == pytest.approx(0.000054, abs=0.001)
    assert found == pytest.approx(1.5978 + 0.000054 * angles, rel=0.03)
    assert model.brightness(60, 60) < 0.8 * level


def test_figures_4_to_6():
    """The maximum lies beyond the specular direction."""
    for name in NAMED:
        model = named_model(name)
        angles = np.arange(-88.0, 80.0, 0.25)
        summit = angles[model.intensity(70, angles).argmax()]
        assert -80 < summit < -70
        assert model.intensity(70, summit) > 1.25 * model.intensity(70, -70)


def test_the_shadowing_constants_are_the_best():
    """Shadows counted on a Gaussian profile other than the one of the fit; the recipe of the facet
    model's explanation page, smaller.
    """
    from scipy.optimize import least_squares

    shadow = Shadowing()
    assert (shadow.sigma_c, shadow.sigma_p, shadow.u_p, shadow.v_p) == OURS
    shares = twin.shadow_shares(0.25, 2**16, (11,))
    missed = twin.shadow_residuals(OURS, shares)
    assert math.sqrt(missed @ missed / 3) < 0.015
    model = twin.shadow_model(OURS, shares)
    assert max(np.abs(m - s).max() for m, s in zip(model, shares[:, 3:6].T, strict=True)) < 0.06
    best = least_squares(
        twin.shadow_residuals,
        OURS,
        args=(shares,),
        bounds=([0, 0, -0.95, 1e-6], [10, 1, 10, 100]),
        x_scale=(1, 0.01, 1, 1),
    )
    assert math.sqrt(missed @ missed) < 1.05 * math.sqrt(2 * best.cost)


# -- names and limits


def test_names():
    assert reflectance_model("facet").law == reflectance_model("facet:labunets-2019-table-3").law
    for name in NAMED:
        assert reflectance_model(f"facet:{name}").law[0] == len(NAMED[name])
    with pytest.raises(ConfigError, match=r"labunets-2019-table-3, .* or a MODEL\.toml"):
        reflectance_model("facet:granite")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"nodes": ()}, "at least one"),
        ({"nodes": (GLOSSY, GLOSSY)}, "must increase"),
        (
            {"nodes": (GLOSSY._replace(sigma_b=0.0),)},
            r"sigma_b must lie in 0.01..100, not 0 at incidence 50 deg",
        ),
        ({"nodes": (GLOSSY._replace(w_d=math.nan),)}, "w_d must lie"),
        ({"nodes": (GLOSSY._replace(incidence_deg=90.0),)}, "incidence_deg must lie"),
        ({"nodes": (GLOSSY._replace(w_b=0.0, w_d=0.0),)}, "both weights are 0"),
        ({"albedo": 0.0}, "albedo"),
        ({"albedo": 1.5}, "albedo"),
        ({"largest_emission_deg": 90.0}, "largest_emission_deg"),
        ({"levels": (1.0, 2.0)}, "one value for each node"),
        ({"levels": (0.0,)}, "positive"),
    ],
)
def test_invalid_models(change, said):
    with pytest.raises(ConfigError, match=said):
        FacetModel(**{"name": "bad", "nodes": (GLOSSY,)} | change)


def test_invalid_optics_and_shadowing():
    for bad in (
        (1.0, 0.0),
        (0.0, 0.0),
        (1.5, -1.0),
        (math.nan, 0.0),
        (1.5, 0.0, 1.5),
        (1.5, 0, 0, math.inf),
    ):
        with pytest.raises(ConfigError):
            Optics(*bad)
    for bad in ((-1, 0, 0, 1), (0, -1, 0, 1), (0, 0, -2, 1), (0, 0, 0, 0), (math.inf, 0, 0, 1)):
        with pytest.raises(ConfigError):
            Shadowing(*bad)
