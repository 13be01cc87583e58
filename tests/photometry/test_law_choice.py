"""The error of one reflectance model relative to another, compared with an independent Monte Carlo
computation; and the choice of a scene's model.
"""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lcp_cli.main import run

from lcp_catalog.accuracy import TIERS
from lcp_catalog.choices import LAWS_BY_COST
from lcp_catalog.errors import ConfigError
from lcp_catalog.geometry.frames import direction_enu
from lcp_catalog.photometry.law_choice import choose, cost, named
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.production.config import BuildConfig, SunConfig, ViewConfig
from lcp_catalog.production.model_config import ModelConfig
from lcp_catalog.production.sweep import Conditions, law_of_build
from lcp_catalog.rendering import decisions

LS, LAMBERT = reflectance_model("lommel-seeliger"), reflectance_model("lambert")
UP = np.array([0.0, 0.0, 1.0])


def image(*pairs):
    """One image of pairs of Sun and camera, in the shape for `cost`."""
    suns, cameras = zip(*pairs, strict=True)
    return np.array(suns)[None], np.array(cameras)[None]


def monte_carlo(pairs, slope_rms, count=400_000, seed=1):
    """sqrt(1 - r^2) of the contrast of Lommel-Seeliger relative to Lambert by random facets, with
    independent formulas.
    """
    rng = np.random.default_rng(seed)
    ours, theirs, weights = [], [], []
    for sun, camera in pairs:
        p, q = rng.normal(0.0, slope_rms, (2, count))
        length = np.sqrt(1 + p * p + q * q)
        mu0 = (-p * sun[0] - q * sun[1] + sun[2]) / length
        mu = (-p * camera[0] - q * camera[1] + camera[2]) / length
        seen = (mu0 > 0) & (mu > 0)
        ours.append((mu0 / (mu0 + mu))[seen])
        theirs.append(mu0[seen])
        weights.append((mu * length)[seen])
    a, b, w = (np.concatenate(x) for x in (ours, theirs, weights))
    r = np.cov(a, b, aweights=w)
    rest = r[1, 1] - r[0, 1] ** 2 / r[0, 0]
    return np.sqrt(rest) / np.average(b, weights=w)


@pytest.mark.parametrize("slope_deg", [3.0, 8.0])
@pytest.mark.parametrize("elevation", [70.0, 30.0, 10.0])
@pytest.mark.parametrize("off_nadir", [0.0, 30.0, 50.0])
def test_the_cost_is_that_of_random_relief(slope_deg, elevation, off_nadir):
    slope = np.tan(np.radians(slope_deg))
    pair = (direction_enu(90.0, elevation), direction_enu(200.0, 90.0 - off_nadir))
    found = cost(LS, LAMBERT, *image(pair), slope).residual
    # facets that face away have a sharp limit, which a quadrature resolves in steps
    assert found == pytest.approx(monte_carlo([pair], slope), abs=0.006)


def test_steep_relief_seen_at_a_slant():
    """Facets count by projected area; those that face away do not count."""
    slope = np.tan(np.radians(25.0))
    pair = (direction_enu(90.0, 50.0), direction_enu(250.0, 30.0))
    found = cost(LS, LAMBERT, *image(pair), slope).residual
    assert found == pytest.approx(monte_carlo([pair], slope), abs=0.003)


def test_many_phases_in_one_image_share_a_gain():
    sun = direction_enu(90.0, 40.0)
    pairs = [(sun, direction_enu(90.0, 90.0 - off)) for off in (0.0, 20.0, 40.0)]
    together = cost(LS, LAMBERT, *image(*pairs)).residual
    assert together == pytest.approx(monte_carlo(pairs, np.tan(np.radians(8.0))), abs=0.006)
    apart = max(cost(LS, LAMBERT, *image(pair)).residual for pair in pairs)
    assert together > apart + 0.05


@settings(max_examples=40)
@given(elevation=st.floats(2.0, 89.0), azimuth=st.floats(0, 360), off=st.floats(0.0, 60.0))
def test_a_law_costs_nothing_against_itself(elevation, azimuth, off):
    pair = (direction_enu(azimuth, elevation), direction_enu(0.0, 90.0 - off))
    assert cost(LS, LS, *image(pair)).residual <= 1e-6
    other = cost(LS, LAMBERT, *image(pair))
    assert 0.0 <= other.residual <= other.contrast * (1.0 + 1e-12)


def test_lommel_seeliger_has_no_contrast_in_opposition():
    sun = direction_enu(90.0, 40.0)
    found = cost(LS, LAMBERT, *image((sun, sun)))
    assert found.residual == pytest.approx(found.contrast)
    assert found.contrast > 0.1
    assert found.correlation == pytest.approx(0.0, abs=1e-6)


def test_the_worst_image_is_named():
    easy, hard = direction_enu(90.0, 5.0), direction_enu(90.0, 80.0)
    suns, cameras = np.array([[easy], [hard]]), np.array([[UP], [UP]])
    found = cost(LS, LAMBERT, suns, cameras)
    alone = [cost(LS, LAMBERT, suns[k : k + 1], cameras[k : k + 1]).residual for k in (0, 1)]
    assert found.residual == max(alone)
    assert found.images == 2
    worst = (85.0, 10.0)[int(np.argmax(alone))]
    assert found.phase_deg == pytest.approx((worst, worst))
    assert found.incidence_deg == pytest.approx((worst, worst))


# ---- which law


def wide(span_deg):
    """One image of a wide camera: phases from 30 deg over a given range."""
    sun = direction_enu(90.0, 40.0)
    return image(*((sun, direction_enu(90.0, 70.0 + off)) for off in np.linspace(0.0, span_deg, 9)))


def test_many_phases_need_a_phase_function():
    """Lommel-Seeliger alone lacks a phase function; at one phase a gain replaces it."""
    hapke = reflectance_model("hapke")
    assert cost(LS, hapke, *wide(0.5)).residual < 0.005
    assert cost(LS, hapke, *wide(60.0)).residual > 0.2
    names = [
        [choose(TIERS[tier], *wide(span)).model.name for tier in ("draft", "standard", "high")]
        for span in (0.5, 40.0, 60.0)
    ]
    assert names == [
        ["lommel-seeliger:rolo"] * 3,
        ["lommel-seeliger:rolo", "lommel-seeliger:rolo", "lunar-lambert:rolo"],
        ["lommel-seeliger:rolo", "lommel-seeliger:rolo", "hapke:rolo"],
    ]


@pytest.mark.parametrize("tier", TIERS)
def test_the_limit_decides(tier):
    hapke = reflectance_model("hapke:rolo")
    for span in (0.0, 5.0, 10.0, 20.0, 40.0, 60.0):
        costs = {
            law: cost(reflectance_model(law), hapke, *wide(span)).residual for law in LAWS_BY_COST
        }
        fitting = [
            law
            for law in LAWS_BY_COST
            if costs[law] <= TIERS[tier].law_residual or law == "hapke:rolo"
        ]
        chosen = choose(TIERS[tier], *wide(span))
        assert chosen.model.name == fitting[0]
        assert chosen.cost.residual == costs["lommel-seeliger:rolo"]
        assert chosen.own.residual == costs[chosen.model.name]
    asked = choose(TIERS[tier], *image((direction_enu(90.0, 60.0), UP)), requested=LAMBERT)
    assert asked.model == LAMBERT
    assert "as asked" in asked.reason
    assert asked.own.residual > 0.0


def test_reference_is_hapke():
    """As in the paper: Lommel-Seeliger on board, Hapke for reference."""
    for elevation in (1.0, 10.0, 45.0, 89.0):
        chosen = choose(TIERS["reference"], *image((direction_enu(0.0, elevation), UP)))
        assert chosen.model.name == "hapke:rolo"


def test_names():
    assert named("auto") is None
    assert named("lambert") == LAMBERT
    with pytest.raises(ConfigError, match="no reflectance model"):
        named("phong")


@pytest.mark.slow
def test_a_law_from_a_file_is_named_by_its_content(tmp_path):
    """A catalogue states the measured surface it was made with, independent of the file's folder."""
    file = tmp_path / "regolith.toml"
    table = Path(__file__).parents[2] / "sample_data" / "goniometer_synthetic.csv"
    assert run(["fit-reflectance", str(table), "-o", str(file)]) == 0
    build = BuildConfig(model=ModelConfig(reflectance=f"facet:{file}"))
    said = decisions.reflectance(law_of_build(build, 26.0)).reason
    assert hashlib.sha256(file.read_bytes()).hexdigest() in said
    assert str(tmp_path) not in said


def test_a_build_gets_the_law_of_its_worst_image():
    suns = SunConfig(elevations_deg=(5.0, 10.0))
    above = ViewConfig(off_nadir_deg=(0.0,), azimuth_deg=(0.0,), altitude_km=(float("inf"),))
    names = {}
    for tier in TIERS:
        build = BuildConfig(sun=suns, view=above, model=ModelConfig(accuracy=tier))
        found = law_of_build(build, 26.0)
        names[tier] = found.model.name
    assert names["draft"] == names["standard"] == "lommel-seeliger:rolo"
    assert names["high"] == "lunar-lambert:rolo"
    assert names["reference"] == "hapke:rolo"
    stated = BuildConfig(model=ModelConfig(reflectance="lambert"))
    assert law_of_build(stated, 26.0).model == LAMBERT


def test_a_build_looks_at_every_sun_and_view():
    """The worst case over all images is that of the single images."""
    views = ViewConfig(off_nadir_deg=(0.0, 40.0), azimuth_deg=(0.0, 90.0), altitude_km=(1e3, 1e3))
    build = BuildConfig(sun=SunConfig(elevations_deg=(5.0, 60.0)), view=views)
    conditions = Conditions.at(26.0, build)
    found = law_of_build(build, 26.0)
    hapke = reflectance_model("hapke")
    alone = [
        cost(
            LS,
            hapke,
            *image((conditions.sun_directions()[e, a], conditions.view_directions()[v])),
        ).residual
        for e, a in np.argwhere(conditions.reachable)
        for v in (0, 1)
    ]
    assert found.cost.images == len(alone)
    assert found.cost.residual == pytest.approx(max(alone))
