"""``lcp fit-reflectance`` from the outside."""

import json
import tomllib
import xml.etree.ElementTree as ET
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from lcp_cli.main import run

from lcp_catalog.photometry.facet_model import FacetFile, FacetModel, Node, load_model
from lcp_catalog.photometry.laws import reflectance_model

DEM = Path(__file__).resolve().parents[2] / "sample_data" / "hadley_gld100_256ppd.tif"
AREA = ["--center", "2.8", "25.4", "--size", "10"]
SURFACE = FacetModel(
    "s", (Node(20, 0.3, 5, 0.2, 0.8, 0, 0.9), Node(60, 0.3, 4, 0.15, 0.7, 2, 0.95))
)


@pytest.fixture
def csv(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = ["incidence_deg,emission_deg,intensity"]
    for node in SURFACE.nodes:
        for e in np.arange(-80.0, 81.0, 5.0):
            value = 50 * SURFACE.intensity(node.incidence_deg, e)
            lines.append(f"{node.incidence_deg:g},{e:g},{value:.6f}")
    (tmp_path / "paint.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def left(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_model_that_renders(csv, capsys):
    assert (
        run(
            [
                "fit-reflectance",
                "paint.csv",
                "-o",
                "paint.toml",
                "--albedo",
                "0.3",
                "--depfile",
                "paint.d",
            ]
        )
        == 0
    )
    out, err = capsys.readouterr()
    assert len(out.splitlines()) == 4
    assert "D1" in out
    assert err == "paint.toml: use it with --reflectance facet:paint.toml\n"
    whole = load_model("paint.toml")
    assert whole.model.name == "paint"
    assert whole.model.albedo == 0.3
    assert whole.model.largest_emission_deg == 80.0
    assert whole.to_toml() == (csv / "paint.toml").read_text()
    assert (csv / "paint.d").read_text() == "paint.toml: paint.csv\n"
    law = reflectance_model("facet:paint.toml")
    angles = np.arange(-75, 76, 15)
    known = SURFACE.intensity(20, angles) / SURFACE.intensity(20, -20)
    assert load_model("paint.toml").model.intensity(20, angles) == pytest.approx(known, rel=0.03)
    assert law.law[0] == 2
    assert str(csv) not in (csv / "paint.toml").read_text()


def test_provenance_and_json(csv, capsys):
    arguments = [
        "fit-reflectance",
        "paint.csv",
        "-o",
        "m.toml",
        "--json",
        "--c",
        "0.5",
        "--name",
        "my paint",
    ]
    assert run([*arguments, "--refractive-index", "1.6", "0.1", "--polarisation", "0.5", "20"]) == 0
    said = json.loads(capsys.readouterr().out)
    document = tomllib.loads((csv / "m.toml").read_text())
    digest = sha256((csv / "paint.csv").read_bytes()).hexdigest()
    assert said["source"] == document["fit"]["source"] == "paint.csv"
    assert said["sha256"] == document["fit"]["sha256"] == digest
    assert said["nodes"] == document["nodes"]
    assert said["name"] == document["name"] == "my paint"
    assert said["errors"] == document["fit"]["errors"]
    assert said["c"] == 0.5
    assert said["d"] == pytest.approx(said["d1"] + 0.5 * said["d2"])
    assert said["points"] == [33, 33]
    assert said["directional_reflectance"] == pytest.approx([0.12, 0.12], rel=5e-3)
    assert document["optics"] == {
        "n": 1.6,
        "kappa": 0.1,
        "polarisation": 0.5,
        "polarisation_angle_deg": 20.0,
    }


def test_a_chart(csv):
    assert run(["fit-reflectance", "paint.csv", "-o", "m.toml", "--chart", "m.svg"]) == 0
    root = ET.parse(csv / "m.svg").getroot()
    dots = [e for e in root.iter() if e.tag.endswith("circle") and e.get("class") == "dots"]
    lines = [e for e in root.iter() if e.tag.endswith("polyline")]
    assert len(dots) == 2 * 33 + 1  # and the legend's
    assert len(lines) == 2 * 3
    away = [np.hypot(float(e.get("cx")), float(e.get("cy"))) for e in dots[:-1]]
    assert 100 < max(away) <= 190.1  # inside the rim
    points = [
        float(value) for line in lines for value in line.get("points").replace(",", " ").split()
    ]
    reach = np.hypot(points[::2], points[1::2]).max()
    assert max(away) == pytest.approx(reach, rel=0.05)  # relative, as the model is


def test_replaced_only_when_told(csv, capsys):
    (csv / "m.toml").write_text("mine")
    assert run(["fit-reflectance", "paint.csv", "-o", "m.toml"]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert (csv / "m.toml").read_text() == "mine"
    assert run(["fit-reflectance", "none.csv", "-o", "m.toml"]) == 1
    assert "m.toml exists" in capsys.readouterr().err  # before anything is read
    assert run(["fit-reflectance", "paint.csv", "-o", "m.toml", "--overwrite"]) == 0
    assert load_model("m.toml").model.name == "m"


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["none.csv"], 1, "none.csv: No such file"),
        (
            ["paint.csv", "--refractive-index", "1", "0"],
            2,
            "--refractive-index: a surface of refractive index 1 reflects no light",
        ),
        (["paint.csv", "--polarisation", "2", "0"], 2, "--polarisation"),
        (["paint.csv", "--c", "-1"], 2, "--c"),
        (["paint.csv", "--albedo", "0"], 2, "--albedo"),
        (["paint.csv", "--chart", "m.toml"], 2, "is the same file as"),
        (["absolute.csv", "--albedo", "0.2"], 2, "--albedo: not with a radiance_factor column"),
        (["gap.csv"], 1, "no intensity around the specular direction"),
        (["short.csv"], 1, "short.csv: incidence 20 deg has 5 measurements"),
        (["paint.csv", "--chart", "no/m.svg"], 1, "does not exist"),
    ],
)
def test_errors_are_one_line_and_nothing_is_written(csv, capsys, arguments, code, said):
    lines = (csv / "paint.csv").read_text().splitlines()
    (csv / "absolute.csv").write_text("\n".join(lines).replace("intensity", "radiance_factor"))
    (csv / "gap.csv").write_text("\n".join(line for line in lines if not line.startswith("60,-")))
    (csv / "short.csv").write_text("\n".join(lines[:6]))
    before = left(csv)
    assert run(["fit-reflectance", *arguments, "-o", "m.toml"]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    if code == 1:
        assert len(err.splitlines()) == 1
    assert left(csv) == before


def test_a_render_names_the_model_and_its_file(csv, capsys):
    """Without folders where it is told, and as a source where Make asks."""
    (csv / "models").mkdir()
    model = "models/paint.toml"
    assert run(["fit-reflectance", "paint.csv", "-o", model, "--c", "0"]) == 0
    light = ["--sun-azimuth", "90", "--sun-elevation", "20", "--reflectance", f"facet:{model}"]
    assert run(["render", str(DEM), "-o", "r.tif", *AREA, *light, "--depfile", "r.d"]) == 0
    assert model in (csv / "r.d").read_text()
    import rasterio

    with rasterio.open(csv / "r.tif") as raster:
        assert raster.tags()["reflectance"] == "facet:paint.toml"
        radiance, incidence = raster.read(1), raster.read(4)
    lit = radiance > 0
    assert lit.mean() > 0.5
    # albedo 0.12, looked at from above: no more than a few times Lambert's
    ratio = radiance[lit] / (0.12 * np.cos(np.radians(incidence[lit])))
    assert 0.3 < np.median(ratio) < 1.5
    assert (
        run(["render", str(DEM), "-o", "no.tif", *AREA, *light[:-1], "facet:models/none.toml"]) != 0
    )
    assert "models/none.toml: there is no such file" in capsys.readouterr().err
    assert not (csv / "no.tif").exists()


def test_a_build_reads_the_model_beside_its_configuration(csv):
    from lcp_catalog.production.config import BuildConfig

    (csv / "deep").mkdir()
    (csv / "deep" / "b.toml").write_text('[model]\nreflectance = "facet:paint.toml"\n')
    config = BuildConfig.from_toml(csv / "deep" / "b.toml")
    assert config.model.reflectance == f"facet:{csv / 'deep' / 'paint.toml'}"
    assert config.model.portable.reflectance == "facet:paint.toml"
    named = BuildConfig.from_dict({"model": {"reflectance": "facet:labunets-2019-table-2"}})
    assert named.model.beside(csv).reflectance == "facet:labunets-2019-table-2"
    assert named.model.portable == named.model


def test_a_build_knows_when_its_model_changed(csv):
    """The file's bytes, not its place, decide whether a build that was broken off goes on."""
    from dataclasses import replace

    from lcp_catalog.production.config import AreaConfig, BuildConfig
    from lcp_catalog.production.model_config import ModelConfig
    from lcp_catalog.production.run import Build

    def plan(where):
        config = BuildConfig(area=AreaConfig(center_deg=(2.8, 25.4), size_km=12.0))
        return Build.plan((DEM,), replace(config, model=ModelConfig(f"facet:{where}")))

    (csv / "other").mkdir()
    text = FacetFile(SURFACE).to_toml()
    for where in ("m.toml", "other/m.toml"):
        (csv / where).write_text(text)
    build = plan("m.toml")
    assert Path("m.toml") in build.files
    before = build.facts()
    assert before == plan("other/m.toml").facts()
    (csv / "m.toml").write_text(text.replace("albedo = 0.12", "albedo = 0.13"))
    assert before != plan("m.toml").facts()
