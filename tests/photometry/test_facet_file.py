"""MODEL.toml: exact round trip, and messages for invalid files."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.errors import ConfigError, InputError
from lcp_catalog.photometry.facet_model import (
    FORMAT,
    NAMED,
    FacetFile,
    FacetModel,
    Node,
    Optics,
    Shadowing,
    facet_model,
    load_model,
    model_path,
    named_model,
)
from lcp_catalog.photometry.laws import reflectance_model

NODES = (Node(10, 0.4, 6, 0.15, 0.9, -4, 0.85), Node(60, 0.2, 3, 0.3, 1, 5, 0.9))
FULL = FacetModel(
    'a "name"', NODES, Optics(1.3, 0.7, 0.25, 30), Shadowing(1, 0.2, 0.5, 0.3), 75, 0.31, (0.2, 0.4)
)


@pytest.mark.parametrize("model", [FULL, FacetModel("plain", NODES), *map(named_model, NAMED)])
def test_round_trip(model):
    whole = FacetFile(model, {"source": "g.csv", "errors": [0.25, 1 / 3], "deep": {"c": 2}})
    text = whole.to_toml()
    assert FacetFile.from_toml(text) == whole
    assert FacetFile.from_toml(text).to_toml() == text
    assert FacetFile.from_toml(FacetFile(model).to_toml()) == FacetFile(model)


@settings(max_examples=50, deadline=None)
@given(st.floats(1e-6, 1), st.floats(0.01, 100), st.floats(0, 1e6))
def test_every_bit_comes_back(albedo, sigma, weight):
    model = FacetModel("m", (Node(math.pi, weight, -1 / 3, sigma, 1, 0, 1),), albedo=albedo)
    assert FacetFile.from_toml(FacetFile(model).to_toml()).model == model


def test_as_a_reflectance(tmp_path):
    path = tmp_path / "paint.toml"
    path.write_text(FacetFile(FULL).to_toml(), encoding="utf-8")
    found = reflectance_model(f"facet:{path}")
    assert found.law == tuple(FULL.law)
    assert facet_model(str(path)) == FULL
    assert load_model(path).model == FULL


def test_which_is_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert model_path("") is None
    assert model_path("labunets-2019-table-2") is None
    assert str(model_path("x.TOML")) == "x.TOML"
    assert model_path("paint") is None
    (tmp_path / "paint").write_text(FacetFile(FULL).to_toml())
    assert str(model_path("paint")) == "paint"
    with pytest.raises(InputError, match=r"none\.toml: there is no such file"):
        reflectance_model("facet:none.toml")


TEXT = FacetFile(FULL).to_toml()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[", "not TOML"),
        ("albedo = 1", "format = 'lcp facet model 1'"),
        (TEXT.replace(FORMAT, "lcp facet model 2"), "not a facet model"),
        (
            TEXT.replace("albedo = 0.31", 'albedo = "bright"'),
            "albedo must be a number, not 'bright'",
        ),
        (TEXT.replace("albedo = 0.31", "albedo = true"), "albedo must be a number"),
        (TEXT.replace("albedo = 0.31", "albedo = 3.1"), "albedo must lie in 0..1"),
        (TEXT.replace("albedo = 0.31", "colour = 3"), "unknown key colour; valid keys: albedo,"),
        (TEXT.replace('name = "a', 'title = "a'), "unknown key title"),
        (TEXT.replace("kappa", "k"), "[optics] has no key k; valid keys: n, kappa"),
        (TEXT.replace("[optics]", "[[optics]]"), "[optics] must be a table"),
        (TEXT.replace("sigma_d", "sigma_e"), "[nodes] must hold the lists incidence_deg, w_b"),
        (TEXT.replace("    60.0,\n", ""), "must be of one length"),
        (TEXT.replace("    60.0,\n", '    "60",\n'), "nodes.incidence_deg must be a number"),
        (TEXT.replace("    60.0,\n", "    5.0,\n"), "must increase"),
        (TEXT + "[fit]\n" * 0 + "\n[[fit]]\n", "[fit] must be a table"),
    ],
)
def test_refused(tmp_path, text, said):
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as failure:
        load_model(path)
    assert said in str(failure.value)
    assert str(failure.value).startswith(str(path))
