"""Names and texts that a terminal, a pipe or make would misread, and standard streams that are closed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import refusal
from helpers.products import geotiff
from lcp_cli.main import run

from benchmarks.faults.fuzz import DamagedFiles

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
DEM = SAMPLE / "hadley_gld100_256ppd.tif"
LCP = [sys.executable, "-c", "from lcp_cli.main import main; main()"]


@pytest.fixture
def dem(tmp_path: Path) -> Path:
    import numpy as np

    heights = np.arange(64.0, dtype=np.float32).reshape(8, 8)
    return geotiff(tmp_path / "dem.tif", heights, 1e5, 8e5, 500.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "closed",
    ["<&- >&- 2>&-", "2>&-", ">&- 2>&-"],
)
def test_closed_streams(closed: str, dem: Path) -> None:
    """A command works, and a refusal has its exit code. What is printed goes into no file of the command."""
    map_path = dem.with_name("map.png")
    shell = f'"$@" {closed}'
    info = [*LCP, "dem", "info", str(dem), "--map", str(map_path)]
    assert subprocess.run(["sh", "-c", shell, "sh", *info], check=False).returncode == 0
    assert map_path.read_bytes().startswith(b"\x89PNG")
    assert subprocess.run(["sh", "-c", shell, "sh", *info], check=False).returncode == 1


def test_control_characters_of_names_are_shown_as_escapes(dem: Path, capsys: Any) -> None:
    """Of a DEM's name in the output, and of names in errors of the library and of the command line."""
    red = dem.rename(dem.with_name("\x1b[31mred\u202e.tif"))
    assert run(["dem", "info", "--quick", str(red)]) == 0
    shown = capsys.readouterr().out
    assert "\\x1b[31mred\\u202e.tif" in shown
    assert "\x1b" not in shown
    for line, code in ((["dem", "info", f"{red}.gone"], 1), (["inspect", f"{red}.gone"], 1)):
        error = refusal(line, code, capsys)
        assert "\\x1b[31mred" in error
        assert "\x1b" not in error


def test_a_name_that_is_not_utf8(dem: Path, capsys: Any) -> None:
    """GDAL opens no such file; a catalogue, a camera or a configuration can have such a name."""
    other = dem.rename(os.fsdecode(os.fsencode(dem.parent) + b"/d\xffm.tif"))
    assert "d\\udcffm.tif: not a DEM" in refusal(["dem", "info", str(other)], 1, capsys)
    camera = dem.with_name(os.fsdecode(b"\xff.json"))
    shutil.copy(SAMPLE / "AS15-M-0414_camera.json", camera)
    output = str(dem.with_name("o.tif"))
    area = ["--center", "3.5", "26", "--size", "90", "--gsd", "9000"]
    line = ["render", "--surface", "sphere", "--camera", str(camera), *area, "-o", output]
    assert run([*line, "--depfile", f"{output}.d"]) == 0
    assert Path(f"{output}.d").read_bytes().endswith(b"/\xff.json\n")


@pytest.mark.slow
def test_a_message_of_gdal_that_is_not_utf8_is_one_line(tmp_path: Path) -> None:
    """rasterio's log cannot decode it and used to print a stack trace."""
    files = DamagedFiles("dem-pds4", tmp_path)
    path, content = files.input(12)
    path.write_bytes(content)
    line = [*LCP, "dem", "info", str(path)]
    error = subprocess.run(line, capture_output=True, text=True, check=False).stderr
    assert error.count("\n") == 1
    assert error.startswith(f"lcp: {path}: not a DEM")


def test_a_name_that_make_cannot_hold_is_refused_at_once(tmp_path: Path, capsys: Any) -> None:
    for name in ("two\nlines.tif", "a=b.tif", "a;b.tif"):
        shutil.copy(DEM, tmp_path / name)
        line = ["render", str(tmp_path / name), "-o", str(tmp_path / "o.tif")]
        error = refusal([*line, "--depfile", str(tmp_path / "o.d")], 1, capsys)
        assert "a rule for make cannot hold" in error
    assert not (tmp_path / "o.tif").exists()
