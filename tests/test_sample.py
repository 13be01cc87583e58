"""The sample that `lcp sample` writes, and that the wheel holds."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from lcp_cli.main import run

import lcp_catalog
from lcp_catalog._package_files import SAMPLE_FILES, sample_folder, write_sample
from lcp_catalog.errors import OutputError, OutputExistsError

ROOT = Path(__file__).resolve().parents[1]
CODE = {"Makefile", "pipeline/Makefile", "hadley.toml", "pipeline/site.toml", "PROVENANCE.txt"}
CODE |= {name for name in SAMPLE_FILES if name.startswith(("schemas/", "examples/"))}
CODE |= {"sample.ipynb", "own_site.ipynb"}
"""Files of the sample that are no data."""


def test_every_file_of_the_sample_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "hadley"
    assert run(["sample", str(folder)]) == 0
    assert f"make -C {folder}" in capsys.readouterr().out
    there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert there == set(SAMPLE_FILES)
    assert all(
        (folder / name).read_bytes() == (ROOT / "sample_data" / name).read_bytes() for name in there
    )
    assert run(["sample", str(folder)]) == 1
    assert "exists; use --overwrite" in capsys.readouterr().err
    assert run(["sample", str(folder), "--overwrite"]) == 0


def test_nothing_is_written_over_a_file(tmp_path: Path) -> None:
    (tmp_path / "pipeline").mkdir()
    (tmp_path / "pipeline" / "site.toml").write_text("mine")
    with pytest.raises(OutputExistsError, match=r"site\.toml"):
        write_sample(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["pipeline"]
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="is not a folder"):
        write_sample(tmp_path / "file")


def test_the_sample_is_package_data_with_its_provenance() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    tools = declared["tool"]["setuptools"]
    assert tools["package-dir"]["lcp_catalog.sample_data"] == "sample_data"
    packed = {
        path.relative_to(ROOT / "sample_data").as_posix()
        for package, patterns in tools["package-data"].items()
        if package.startswith("lcp_catalog.sample_data")
        for pattern in patterns
        for path in (ROOT / "sample_data" / package[len("lcp_catalog.sample_data.") :]).glob(
            pattern
        )
    }
    assert packed == set(SAMPLE_FILES)
    assert "sample_data/PROVENANCE.txt" in declared["project"]["license-files"]
    provenance = (sample_folder() / "PROVENANCE.txt").read_text(encoding="utf-8")
    paragraphs = provenance.split("\n\n")
    for name in set(SAMPLE_FILES) - CODE:
        (about,) = [text for text in paragraphs if text.startswith(name + "\n")]
        assert "What:" in about
        assert "icence:" in about or "public domain" in about, name
    named = set(re.findall(r"tests/[\w/]+\.py", provenance))
    assert named
    assert all((ROOT / path).is_file() for path in named), named


def test_the_version_stands_in_all_its_places() -> None:
    version = lcp_catalog.__version__
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\n## {version}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_image_tags_of_the_docs_are_of_this_version() -> None:
    text = (ROOT / "docs" / "examples" / "lcp.yaml").read_text(encoding="utf-8")
    assert set(re.findall(r"/lcp:([\w.]+)", text)) == {lcp_catalog.__version__}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of the checkout; pip takes the build backend from the package index."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(folder), str(ROOT)]
    subprocess.run(pip, check=True, timeout=600)
    (found,) = folder.glob("*.whl")
    return found


@pytest.mark.slow
def test_the_wheel_holds_the_library_the_commands_and_the_sample(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"lcp_catalog/sample_data/{name}" for name in SAMPLE_FILES} <= names
    modules = {
        *(p.relative_to(ROOT).as_posix() for p in (ROOT / "lcp_catalog").rglob("*.py")),
        *(f"lcp_cli/{p.name}" for p in (ROOT / "cli").glob("*.py")),
    }
    assert modules <= names
    tops = {name.split("/")[0] for name in names}
    assert tops == {"lcp_catalog", "lcp_cli", f"lcp_catalog-{lcp_catalog.__version__}.dist-info"}
    licences = {name.split("licenses/")[1] for name in names if "licenses/" in name}
    assert {f"lcp_catalog/howto/{p.name}" for p in (ROOT / "docs/howto").glob("*.md")} <= names
    assert "lcp_catalog/reference/cameras.md" in names
    assert licences == {
        "LICENSE",
        "THIRD-PARTY.md",
        "sample_data/PROVENANCE.txt",
        "lcp_catalog/photometry/moon_map.txt",
    }
    assert "lcp_catalog/photometry/moon_albedo_643nm_11ppd.tif" in names


@pytest.mark.slow
def test_the_first_hour_with_the_wheel_alone(wheel: Path, tmp_path: Path) -> None:
    """An environment without the checkout: the sample is written, built and validated by its Makefile."""
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "env")], check=True)
    tools = tmp_path / "env" / "bin"
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    pip = [str(tools / "python"), "-m", "pip", "install", "-q", str(wheel)]
    subprocess.run(pip, check=True, env=clean, cwd=tmp_path)
    here = {**clean, "PATH": f"{tools}{os.pathsep}{clean['PATH']}"}
    subprocess.run(["lcp", "sample", "hadley"], check=True, env=here, cwd=tmp_path)
    subprocess.run(["make", "-C", "hadley"], check=True, env=here, cwd=tmp_path, timeout=3600)
    made = tmp_path / "hadley" / "build"
    for name in ("hadley.h5", "hadley.html", "hadley_relief.png", "validation/report.html"):
        assert (made / name).stat().st_size > 10_000
