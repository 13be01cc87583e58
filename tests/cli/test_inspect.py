"""``lcp inspect``: the fields of the contract, and exit code 4."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import h5py
import pytest
from helpers import catalogs
from lcp_cli.main import run

from lcp_catalog.catalog.writing import write_catalog


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "c.h5").write_bytes(catalogs.content(5))
    return tmp_path / "c.h5"


def test_json_has_the_fields_of_the_contract(path: Path, capsys: pytest.CaptureFixture) -> None:
    assert run(["inspect", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    fields = "points usable_share intact problems schema_version sources bounds"
    assert set(fields.split()) <= set(found)
    assert found["points"] == 5
    assert found["intact"] is True
    assert found["problems"] == []
    assert found["schema_version"] == "3.0"
    assert 0.0 < found["usable_share"] < 1.0
    assert set(found["sources"][0]) == {"name", "size", "sha256"}
    assert list(found["bounds"]) == ["west", "south", "east", "north"]


def test_text_is_for_people(path: Path, capsys: pytest.CaptureFixture) -> None:
    assert run(["inspect", str(path)]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"{path}: intact, schema 3.0")
    for text in (
        "points         5\n",
        "9000 m",
        "WAC GLD100 (5)",
        "view 2",
        "featureless",
        "118 m",
    ):
        assert text in out


@pytest.mark.parametrize("content", [b"", b"no catalogue", None])
def test_what_is_not_intact_exits_4(
    path: Path, content: bytes | None, capsys: pytest.CaptureFixture
) -> None:
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    assert run(["inspect", str(path), "--json"]) == 4
    found = json.loads(capsys.readouterr().out)
    assert found["intact"] is False
    assert found["points"] is None
    assert run(["inspect", str(path)]) == 4
    shown = capsys.readouterr()
    assert "NOT INTACT" in shown.out
    assert found["problems"][0] in shown.out
    assert "Traceback" not in shown.out + shown.err


def test_a_file_of_an_old_schema_is_one_line(path: Path, capsys: pytest.CaptureFixture) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = "2.5"
    assert run(["inspect", str(path)]) == 4
    assert capsys.readouterr().out == f"{path}: made by lcp 0.2; build it again\n"


def test_moments_of_what_is_no_catalogue_are_not_asked(
    path: Path, capsys: pytest.CaptureFixture
) -> None:
    """The file is named as it is, not as one without a promise; a catalogue without one is refused."""
    other = path.with_name("other.h5")
    other.write_text("no catalogue")
    assert run(["inspect", str(other), "--located", "3"]) == 4
    assert "not an HDF5 file" in capsys.readouterr().out
    assert run(["inspect", str(path), "--located", "3"]) == 2
    assert "states no promise" in capsys.readouterr().err


def test_an_empty_catalogue_is_intact(path: Path, capsys: pytest.CaptureFixture) -> None:
    write_catalog(catalogs.catalog(0), path, overwrite=True)
    assert run(["inspect", str(path)]) == 0
    assert "usable         –" in capsys.readouterr().out
    assert run(["inspect", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["usable_share"] is None


def test_a_missing_file_is_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert run(["inspect", str(tmp_path / "none.h5")]) == 1
    assert "none.h5" in capsys.readouterr().err


def test_a_catalogue_is_inspected_without_what_flight_files_need(path: Path) -> None:
    """Kernels and rasters would take a second and 100 MB."""
    code = "import sys; from lcp_cli.main import run; run(sys.argv[1:]); print(*sys.modules)"
    command = [sys.executable, "-c", code, "inspect", path]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert not {"numba", "rasterio", "scipy"} & {*done.stdout.split()}
