"""``lcp export``: formats by ending, whole outputs, and one line for an error."""

from __future__ import annotations

import filecmp
import importlib
import json
import resource
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import pyogrio
import pytest
from helpers import catalogs
from helpers.commands import refusal
from lcp_cli.main import run

import lcp_catalog as lcp
from lcp_catalog.catalog.writing import write_catalog
from lcp_catalog.choices import EXPORT_FOLDERS, EXPORTS
from lcp_catalog.errors import OutputError


@pytest.fixture(scope="module")
def catalog(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("export") / "c.h5"
    write_catalog(catalogs.catalog(4), path)
    return str(path)


@pytest.mark.parametrize("ending", EXPORTS)
def test_every_ending_is_written(ending: str, catalog: str, tmp_path: Path, capsys) -> None:
    out = tmp_path / f"out{ending}"
    assert run(["export", catalog, "-o", str(out), "--frame", "MOON_PA"]) == 0
    assert "4 points written, MOON_PA" in capsys.readouterr().err
    assert out.is_dir() == (ending in EXPORT_FOLDERS)
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    assert "--overwrite" in refusal(["export", catalog, "-o", str(out)], 1, capsys)
    assert run(["export", catalog, "-o", str(out), "--overwrite"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["out.shp"], 2, "the output must end in .csv or .parquet"),
        (["out.abc"], 2, "the output must end in .csv or .parquet"),
        (["out.csv", "--sun-azimuth", "90", "--sun-elevation", "5"], 2, ".lmk maps only"),
        (["out.lmk", "--sun-azimuth", "90"], 2, "go together"),
        (["out.csv", "--frame", "IAU_MOON"], 2, "--frame"),
        (["out.csv", "--bounds", "3", "26", "4", "25"], 2, "south must be below"),
        (["out.csv", "--bounds", "93", "25", "94", "26"], 1, "no points within"),
        (["out.lmk", "--level", "3"], 1, "no points of level 3"),
        (["missing/out.lmk"], 1, "does not exist; make it first"),
    ],
)
def test_refusals_leave_nothing(
    arguments: list[str], code: int, words: str, catalog: str, tmp_path: Path, capsys, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert words in refusal(["export", catalog, "-o", *arguments], code, capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("ending", "name", "extra"),
    [
        (".gpkg", "pyogrio", "gis"),
        (".gpkg", "shapely", "gis"),
        (".parquet", "pyarrow", "gis"),
        (".bds", "spiceypy", "spice"),
    ],
)
def test_a_missing_package_is_one_line(
    ending: str, name: str, extra: str, catalog: str, tmp_path: Path, capsys, monkeypatch
) -> None:
    real = importlib.import_module

    def without(module: str, *more):
        if module.partition(".")[0] == name:
            raise ImportError(module)
        return real(module, *more)

    monkeypatch.setattr("lcp_catalog.errors.import_module", without)
    line = refusal(["export", catalog, "-o", str(tmp_path / f"o{ending}")], 1, capsys)
    assert f"{name}: pip install 'lcp-catalog[{extra}]'" in line
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_other_files_stays(catalog: str, tmp_path: Path, capsys) -> None:
    folder = tmp_path / "mine.lmk"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    line = refusal(["export", catalog, "-o", str(folder), "--overwrite"], 1, capsys)
    assert "notes.txt" in line
    assert (folder / "notes.txt").read_text() == "mine"
    assert len(list(folder.iterdir())) == 1


def test_the_catalogue_that_is_read_is_never_lost(catalog: str, tmp_path: Path, capsys) -> None:
    """Neither one in the folder that is replaced, nor one of the output's own name."""
    folder = tmp_path / "out.lmk"
    assert run(["export", catalog, "-o", str(folder)]) == 0
    inside = Path(shutil.copy(catalog, folder / "c.h5"))
    capsys.readouterr()
    line = refusal(["export", str(inside), "-o", str(folder), "--overwrite"], 1, capsys)
    assert "out.lmk: holds" in line
    named = Path(shutil.copy(catalog, next(folder.glob("*.lmk"))))  # a name of the export itself
    inside.unlink()
    assert "which is read" in refusal(
        ["export", str(named), "-o", str(folder), "--overwrite"], 1, capsys
    )
    own = Path(shutil.copy(catalog, tmp_path / "c.csv"))
    for one in (own, str(own), lcp.open_catalog(own)):
        with pytest.raises(OutputError, match="is read, too"):
            lcp.export(one, own, overwrite=True)
    with pytest.raises(OutputError, match="which is read"):
        lcp.export(lcp.open_catalog(named), folder, overwrite=True)
    assert named.read_bytes() == own.read_bytes() == Path(catalog).read_bytes()


LIMITED = """
import io, json, resource, sys
from lcp_cli.main import run
found = []
for limit in (9_000, 40_000):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    for out in sys.argv[2:]:
        sys.stderr = io.StringIO()
        found.append((out, run(["export", sys.argv[1], "-o", out]), sys.stderr.getvalue()))
sys.stderr = sys.__stderr__
print(json.dumps(found))
"""


@pytest.mark.slow
def test_a_file_that_cannot_grow_is_one_line(catalog: str, tmp_path: Path) -> None:
    """Libraries that write a file themselves: GDAL reports some failures, SPICE ends its process or says
    nothing. The limit stands in for a full disk.
    """
    outs = [str(tmp_path / f"out{ending}") for ending in (".gpkg", ".bds")]
    words = [sys.executable, "-c", LIMITED, catalog, *outs]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    for out, code, text in json.loads(done.stdout):
        said = [line for line in text.splitlines() if not line.endswith("so far")]
        assert (code, len(said)) == (1, 1), text
        assert f"{out}: cannot be written: " in said[0]
    assert list(tmp_path.iterdir()) == []


def test_warnings_of_gdal_are_not_printed(
    catalog: str, tmp_path: Path, monkeypatch, recwarn
) -> None:
    """GDAL warns of a header that it could not write, beside the line of the refusal."""
    real = pyogrio.raw.write

    def warned(*arguments: Any, **more: Any) -> None:
        warnings.warn("GPKG: bad application_id", RuntimeWarning, stacklevel=2)
        real(*arguments, **more)

    monkeypatch.setattr("pyogrio.raw.write", warned)
    assert run(["export", catalog, "-o", str(tmp_path / "o.gpkg")]) == 0
    assert [one for one in recwarn if "GPKG" in str(one.message)] == []


@pytest.mark.parametrize("ending", [".gpkg", ".bds"])
def test_a_file_that_was_not_written_as_told_is_refused(
    ending: str, catalog: str, tmp_path: Path, capsys, monkeypatch
) -> None:
    """One wrong byte in one of two copies, of which no library says anything."""
    real = filecmp.cmp

    def damaged(one: Path, other: Path, shallow: bool) -> bool:
        with one.open("r+b") as file:
            file.seek(one.stat().st_size // 2)
            byte = file.read(1)[0]
            file.seek(-1, 1)
            file.write(bytes([byte ^ 1]))
        return real(one, other, shallow)

    monkeypatch.setattr("lcp_catalog.exports.points.filecmp.cmp", damaged)
    line = refusal(["export", catalog, "-o", str(tmp_path / f"o{ending}")], 1, capsys)
    assert "cannot be written: what was written cannot be read back" in line
    assert list(tmp_path.iterdir()) == []


def test_a_failed_folder_leaves_the_former_one(
    catalog: str, tmp_path: Path, capsys, monkeypatch
) -> None:
    folder = tmp_path / "out.spc"
    assert run(["export", catalog, "-o", str(folder)]) == 0
    before = sorted(path.name for path in folder.rglob("*"))
    capsys.readouterr()

    def fail(*_) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lcp_catalog.exports.landmarks.write_columns", fail)
    line = refusal(["export", catalog, "-o", str(folder), "--overwrite"], 1, capsys)
    assert "disk is full" in line
    assert sorted(path.name for path in folder.rglob("*")) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out.spc"]


def test_a_sun_lights_landmark_maps(catalog: str, tmp_path: Path) -> None:
    sun = ["--sun-azimuth", "270", "--sun-elevation", "10"]
    assert run(["export", catalog, "-o", str(tmp_path / "a.lmk"), *sun]) == 0
    assert run(["export", catalog, "-o", str(tmp_path / "b.lmk")]) == 0
    for path in (tmp_path / "a.lmk").glob("*.lmk"):
        assert path.read_bytes()[:196] == (tmp_path / "b.lmk" / path.name).read_bytes()[:196]
        assert path.read_bytes() != (tmp_path / "b.lmk" / path.name).read_bytes()


def test_a_file_in_the_place_of_a_folder_is_no_output(
    catalog: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "f.lmk").write_text("mine")
    line = refusal(["export", catalog, "-o", str(tmp_path / "f.lmk"), "--overwrite"], 1, capsys)
    assert "f.lmk: is a file, and the output is a folder" in line
    assert (tmp_path / "f.lmk").read_text() == "mine"


def test_a_library_that_cannot_write_is_not_quoted(
    catalog: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
    try:
        line = refusal(["export", catalog, "-o", str(tmp_path / "o.parquet")], 1, capsys)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert line.endswith("o.parquet: cannot be written: File too large\n")
    assert list(tmp_path.iterdir()) == []
