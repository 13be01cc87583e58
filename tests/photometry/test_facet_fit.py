"""The fit of the facet model: recovery of known surfaces, and independent checks of its criterion."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from lcp_catalog.photometry.facet_fit import (
    IncidenceSeries,
    Measurements,
    _FitTask,
    curve_length,
    d1,
    d2,
    fit_reflectance,
    fit_table,
    read_measurements,
    regularise,
)
from lcp_catalog.photometry.facet_model import (
    PARAMETERS,
    FacetFile,
    FacetModel,
    Node,
    Optics,
    constants,
    lobes,
    named_model,
)

SURFACE = FacetModel(
    "glossy paint",
    (
        Node(15, 0.30, 6, 0.20, 0.80, -4, 0.90),
        Node(40, 0.35, 5, 0.16, 0.85, -2, 0.92),
        Node(65, 0.25, 3, 0.12, 0.60, 2, 0.95),
    ),
)
EMISSIONS = np.arange(-80.0, 81.0, 4.0)


def measured(model, noise=0.0, seed=0, azimuths=(0.0,), quantity="intensity"):
    """Goniometer measurements of a model; the direction to the source is left out."""
    rng, samples = np.random.default_rng(seed), []
    for node in model.nodes:
        emission, azimuth = (grid.ravel() for grid in np.meshgrid(EMISSIONS, azimuths))
        free = (np.abs(emission - node.incidence_deg) > 4) | (azimuth != 0)
        emission, azimuth = emission[free], azimuth[free]
        values = model.intensity(node.incidence_deg, emission, azimuth)
        values = values * (1 + noise * rng.standard_normal(len(values)))
        samples.append(IncidenceSeries(node.incidence_deg, emission, azimuth, values))
    return Measurements(tuple(samples), quantity, "synthetic.csv", "0" * 64)


def table(nodes):
    return np.array([node[1:] for node in nodes])


def task_of(measurements):
    return _FitTask(measurements.samples, constants(Optics(), SURFACE.shadowing))


def test_recovered_without_noise():
    fit = fit_reflectance(measured(SURFACE), "m", normalize=False, weight=0.0)
    assert table(fit.alone) == pytest.approx(table(SURFACE.nodes), rel=2e-3, abs=2e-3)
    assert max(fit.errors_alone) < 1e-5
    assert fit.model.nodes == fit.alone  # C = 0: no smoothing
    assert fit.sweeps == 0


@pytest.mark.parametrize(
    # three sigma of the worst incidence in the table of docs/measurements/inputs.md
    ("noise", "limits"),
    [
        (0.01, (0.021, 1.9, 0.019, 0.017, 2.0, 0.044)),
        (0.03, (0.063, 5.3, 0.058, 0.053, 5.6, 0.13)),
    ],
)
def test_recovered_from_noise(noise, limits):
    for seed in (1, 2):
        fit = fit_reflectance(measured(SURFACE, noise, seed), "m", normalize=False, weight=0.0)
        missed = np.abs(table(fit.alone) - table(SURFACE.nodes)).max(axis=0)
        assert (missed < limits).all(), dict(zip(PARAMETERS, missed, strict=True))
        # six parameters fit part of the noise
        assert max(fit.errors_alone) < 1.3 * noise


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_no_worse_than_the_truth(seed):
    """The minimum error is not larger than that of the true parameters."""
    model = named_model("labunets-2019-table-3")
    data = measured(model, 0.01, seed)
    task = _FitTask(data.samples, constants(model.optics, model.shadowing))
    fit = fit_reflectance(data, "m", optics=model.optics, normalize=False, weight=0.0)
    assert (np.array(fit.errors_alone) <= task.errors(table(model.nodes))).all()


def test_relative_to_the_specular_direction():
    """Units at every incidence have no effect; the weights are relative to the specular intensity."""
    plain = measured(SURFACE)
    odd = Measurements(
        tuple(
            IncidenceSeries(s.incidence_deg, s.emission_deg, s.azimuth_deg, s.intensity * unit)
            for s, unit in zip(plain.samples, (7.0, 0.01, 300.0), strict=True)
        ),
        *("intensity", "synthetic.csv", "0" * 64),
    )
    fit = fit_reflectance(odd, "m", weight=0.0)
    for found, node in zip(fit.alone, SURFACE.nodes, strict=True):
        specular = float(SURFACE.intensity(node.incidence_deg, -node.incidence_deg))
        assert found.w_b * specular == pytest.approx(node.w_b, rel=0.02)
        assert found.w_d * specular == pytest.approx(node.w_d, rel=0.02)
        assert found.shift_b_deg == pytest.approx(node.shift_b_deg, abs=0.05)


def test_out_of_the_plane():
    data = measured(SURFACE, 0.01, 3, azimuths=(0.0, 40.0, 80.0, -60.0))
    fit = fit_reflectance(data, "m", normalize=False, weight=0.0)
    missed = np.abs(table(fit.alone) - table(SURFACE.nodes)).max(axis=0)
    assert (missed < (0.03, 1.2, 0.02, 0.01, 0.6, 0.01)).all()


def test_absolute_measurements_keep_their_level():
    """I/F of a known model gives a model of the same I/F, without an albedo."""
    known = FacetModel("known", SURFACE.nodes, albedo=0.37, largest_emission_deg=80)
    samples = []
    for node in known.nodes:
        i = node.incidence_deg
        scale = known.albedo / (known.reflectance(i)[0] / _scale(known, i))
        s = measured(FacetModel("one", (node,))).samples[0]
        samples.append(IncidenceSeries(i, s.emission_deg, s.azimuth_deg, s.intensity * scale))
    data = Measurements(tuple(samples), "radiance_factor", "synthetic.csv", "0" * 64)
    fit = fit_reflectance(data, "m", weight=0.0)
    assert fit.model.levels is not None
    assert fit.model.reflectance([n.incidence_deg for n in known.nodes]) == pytest.approx(
        [0.37] * 3, rel=5e-3
    )


def _scale(model, incidence_deg):
    from lcp_catalog.kernels.photometry.facet import scale

    return scale(model.law, np.cos(np.radians(incidence_deg)))


def test_constant_beyond_the_greatest_measured_emission():
    data = measured(SURFACE)
    near = [np.abs(s.emission_deg) <= 68 for s in data.samples]
    samples = tuple(
        IncidenceSeries(s.incidence_deg, s.emission_deg[n], s.azimuth_deg[n], s.intensity[n])
        for s, n in zip(data.samples, near, strict=True)
    )
    fit = fit_reflectance(Measurements(samples, "intensity", "g.csv", "0"), "m", weight=0.0)
    assert fit.model.largest_emission_deg == 68.0


def test_the_relative_error_is_eq_4():
    data = measured(SURFACE, 0.05, 4, azimuths=(0.0, 30.0))
    task, node = task_of(data), SURFACE.nodes[1]._replace(w_b=0.1, shift_d_deg=3)
    s = data.samples[1]
    modelled = lobes(node, task.head, s.emission_deg, s.azimuth_deg)
    wanted = np.sqrt(((s.intensity - modelled) ** 2).sum() / (s.intensity**2).sum())
    assert task.error(1, list(node[1:])) == pytest.approx(wanted, rel=1e-12)


def test_curve_length_is_eq_6():
    cosines = np.cos(np.radians([0.0, 20, 45, 60, 75]))
    values = np.array([3.0, 2.5, 2.7, 0.4, 1.1])
    steps = np.clip((np.arange(1, 102) - 1) / 100, cosines[-1], cosines[0])
    q = PchipInterpolator(cosines[::-1], values[::-1])(steps)
    assert curve_length(cosines, values) == pytest.approx(
        np.sqrt(np.diff(q) ** 2 + 1e-4).sum(), rel=1e-12
    )
    assert curve_length(cosines, np.full(5, 2.0)) == pytest.approx(1.0)


def test_smooth_curves_gain_by_the_papers_criterion():
    """D1 + C D2 falls below 0: shorter curves for larger errors, more so for larger C."""
    data = measured(SURFACE, 0.02, 5)
    task = task_of(data)
    alone = table(fit_reflectance(data, "m", normalize=False, weight=0.0).alone)
    lengths = []
    for weight in (0.2, 2.0, 20.0):
        smooth, _ = regularise(task, alone, weight)
        grown = d1(task.errors(smooth), task.errors(alone))
        shorter = d2(task.cosines, smooth, alone)
        assert grown + weight * shorter < 0.0
        lengths.append(shorter)
    assert lengths[0] > lengths[1] > lengths[2]
    errors, before = task.errors(smooth), task.errors(alone)
    assert grown == pytest.approx(errors.sum() / before.sum() - 1)
    change = [
        curve_length(task.cosines, smooth[:, k]) / curve_length(task.cosines, alone[:, k])
        for k in range(6)
    ]
    assert shorter == pytest.approx(sum(change) - 6)


def test_no_parameter_alone_could_gain_more():
    """The criterion is at a minimum along each node of each curve: small steps do not reduce it."""
    data = measured(SURFACE, 0.02, 6)
    task, weight = task_of(data), 2.0
    alone = table(fit_reflectance(data, "m", normalize=False, weight=0.0).alone)
    smooth, _ = regularise(task, alone, weight)

    def loss(rows):
        return d1(task.errors(rows), task.errors(alone)) + weight * d2(task.cosines, rows, alone)

    for j, k in np.ndindex(smooth.shape):
        for step in (-0.01, 0.01):
            probe = smooth.copy()
            probe[j, k] *= 1 + step
            assert loss(probe) > loss(smooth) - 3e-3


@pytest.mark.slow
def test_the_same_measurements_give_the_same_model():
    data = measured(SURFACE, 0.02, 7)
    fits = [fit_reflectance(data, "m") for _ in range(2)]
    one, two = (FacetFile(fit.model, fit_table(fit, data)).to_toml() for fit in fits)
    assert one == two
    assert FacetFile.from_toml(one).fit["sha256"] == "0" * 64


def test_a_plain_lambert_surface():
    """Without a directional lobe, the model must still be Lambert's."""
    flat = FacetModel("flat", tuple(Node(a, 0, 0, 1, 1, 0, 1) for a in (20.0, 50.0)))
    fit = fit_reflectance(measured(flat), "m", normalize=False)
    found = fit.model.brightness(35, np.arange(-70, 71, 10))
    assert found == pytest.approx(np.ones(15), abs=0.01)


@pytest.mark.slow
def test_one_incidence_has_no_curve():
    single = FacetModel("one", SURFACE.nodes[:1])
    told = []
    fit = fit_reflectance(
        measured(single), "m", progress=lambda done, total: told.append(done / total)
    )
    assert (fit.d1, fit.d2, fit.sweeps) == (0.0, 0.0, 0)
    assert told[-1] == 1.0
    assert told == sorted(told)


REMARKS = """\
# Synthetic: the model "glossy paint" of tests/photometry/test_facet_fit.py with 1 % relative noise, made by `as_csv` there.
# emission_deg is signed in the plane of incidence: positive on the source's side, the specular direction at -incidence.
incidence_deg,emission_deg,intensity
"""


def as_csv(measurements):
    """Text of sample_data/goniometer_synthetic.csv."""
    return REMARKS + "".join(
        f"{s.incidence_deg:g},{e:g},{value:.5f}\n"
        for s in measurements.samples
        for e, value in zip(s.emission_deg, s.intensity, strict=True)
    )


def test_the_sample_file():
    path = Path(__file__).resolve().parents[2] / "sample_data" / "goniometer_synthetic.csv"
    assert path.read_text(encoding="utf-8") == as_csv(measured(SURFACE, 0.01, 2019))
    assert [len(s) for s in read_measurements(path).samples] == [39, 38, 39]
