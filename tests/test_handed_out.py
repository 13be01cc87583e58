"""What the package hands out beside its code: schemas, notices, how-to pages, recipes for containers and conda."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import jsonschema
import pytest
from helpers import schemas, verdicts
from lcp_cli.main import run

from lcp_catalog import __version__
from lcp_catalog.cameras.frame_camera import camera_from_json
from lcp_catalog.errors import CameraError, ConfigError
from lcp_catalog.production.config import BuildConfig

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def judge(name: str) -> jsonschema.Draft202012Validator:
    schema = json.loads((ROOT / "sample_data" / "schemas" / name).read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", schemas.FILES)
def test_schemas_are_those_of_the_code(name: str) -> None:
    """`python tests/helpers/schemas.py` writes them."""
    assert (schemas.FOLDER / name).read_text(encoding="utf-8") == schemas.text(name)


def test_files_fit_their_schemas_and_misspelt_ones_do_not() -> None:
    build, camera = judge("build.json"), judge("camera.json")
    files = [*ROOT.glob("sample_data/**/*.toml"), ROOT / "tests/data/nine_areas.toml"]
    assert len(files) >= 4
    for path in files:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        build.validate(document)
        section = next(iter(document))
        assert not build.is_valid({section: document[section] | {"spacin_m": 1.0}})
    assert not build.is_valid({"points": {"spacing_m": -1.0}})
    assert BuildConfig.from_dict({"$schema": "schemas/build.json"}) == BuildConfig()
    with pytest.raises(ConfigError, match=r"unknown section \[\$schem\]"):
        BuildConfig.from_dict({"$schem": "schemas/build.json"})
    document = json.loads((ROOT / "sample_data/AS15-M-0414_camera.json").read_text())
    camera.validate(document)
    named = document | {"$schema": "schemas/camera.json"}
    camera.validate(named)
    assert camera_from_json(named).position_mcmf_m.tolist() == document["position_mcmf_m"]
    with pytest.raises(CameraError, match="no key \\$schem;"):
        camera_from_json(document | {"$schem": ""})
    assert not camera.is_valid(document | {"focal_lenght_px": 1.0})
    assert not camera.is_valid({k: v for k, v in document.items() if k != "image_size_px"})


def test_every_package_has_its_licence_noted_and_is_in_the_recipe() -> None:
    extras = [name for names in PROJECT["optional-dependencies"].values() for name in names]
    noted = re.findall(r"^\| ([a-z]\w[\w-]+) \|", (ROOT / "THIRD-PARTY.md").read_text(), re.M)[1:]
    own = [re.match(r"[\w-]+", name)[0] for name in [*PROJECT["dependencies"], *extras]]  # type: ignore[index]
    assert noted == own
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    assert f'version: "{__version__}"' in recipe
    for needed in PROJECT["dependencies"]:
        name, limits = re.match(r"([\w-]+)(.*)", needed).groups()  # type: ignore[union-attr]
        if name == "opencv-contrib-python-headless":  # OpenCV's own version has three parts
            name, limits = "py-opencv", limits.rpartition(".")[0]
        assert f"    - {name} {limits}\n" in recipe


def test_pages_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["help"]) == 0
    names = re.findall(r"^(\S+) {2,}", capsys.readouterr().out, re.M)
    pages = [*(ROOT / "docs/howto").glob("*.md"), *(ROOT / "docs/reference").glob("*.md")]
    assert names == sorted({path.stem for path in pages} - {"api", "commands"})
    assert run(["help", "sun"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("# ")
    assert text.endswith("\nOptions of the command: lcp sun --help\n")
    assert run(["help", "cameras"]) == 0
    assert "## CAMERA.json\n" in capsys.readouterr().out
    assert run(["help", "own-dem"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("# Build a catalogue from your own DEM\n")
    assert "<!--" not in text
    assert run(["help", "merge"]) == 0
    assert capsys.readouterr().out.startswith("Usage: lcp merge [OPTIONS] A.h5 B.h5...")
    assert run(["help", "nothing"]) == 2
    assert "no topic 'nothing'; there are albedo-map" in capsys.readouterr().err
    for wrong, meant in (
        ("camera-s", "cameras"),
        ("quary", "query"),
        ("build-toml.md", "build-toml"),
    ):
        assert run(["help", wrong]) == 2
        assert f"no topic {wrong!r}. Did you mean {meant!r}?" in capsys.readouterr().err


def test_the_sample_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sample", "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line.split()) > 1 for line in lines if "PROVENANCE" not in line), lines
    assert run(["sample"]) == 2
    assert "give a FOLDER, or --list" in capsys.readouterr().err


def test_a_report_fits_its_schema() -> None:
    document = verdicts.whole().document()
    judge("report.json").validate(document)
    document["images"][0]["points_found"] = "many"
    assert not judge("report.json").is_valid(document)
