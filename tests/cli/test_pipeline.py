"""The pipeline of sample_data/pipeline, run by make as it is."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lcp_catalog.production.config import BuildConfig

ROOT = Path(__file__).resolve().parents[2]
LCP = Path(sys.executable).with_name("lcp")


def started(folder: Path) -> subprocess.Popen[str]:
    command = ["make", "-j2", "-C", str(folder / "pipeline"), f"OUT={folder / 'out'}", f"LCP={LCP}"]
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command, stdout=pipe, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )


def made(folder: Path) -> str:
    """What make prints."""
    process = started(folder)
    text, _ = process.communicate(timeout=900)
    assert process.returncode == 0, text
    return text


def parts_of(text: str) -> list[str]:
    """The parts that were computed."""
    lines = [line for line in text.splitlines() if " build-catalog " in line]
    return sorted(line.split("--part ")[1].split("/")[0] for line in lines if "--part " in line)


@pytest.mark.parametrize(
    "path",
    [
        "sample_data/hadley.toml",
        "sample_data/pipeline/site.toml",
        "sample_data/examples/descent.toml",
    ],
)
def test_the_configurations_that_are_shipped_are_valid(path: str) -> None:
    config = BuildConfig.from_toml(ROOT / path)
    for gsd_m in filter(None, (config.area.gsd_m, *config.area.levels_m)):
        config.points.check_cells(gsd_m)  # raises


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_a_pipeline_is_interrupted_resumed_and_begins_again_with_a_newer_dem(
    tmp_path: Path,
) -> None:
    for path in (ROOT / "sample_data").iterdir():
        (shutil.copytree if path.is_dir() else shutil.copy)(path, tmp_path / path.name)
    out, dem = tmp_path / "out", tmp_path / "hadley_gld100_256ppd.tif"

    process = started(tmp_path)
    until = time.monotonic() + 600.0
    while not list(out.glob("part-*")) and time.monotonic() < until:
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode != 0
    finished = sorted(path.name[len("part-") :] for path in out.glob("part-*"))
    assert finished
    assert not (out / "site.h5").exists()

    resumed = made(tmp_path)
    assert parts_of(resumed) == sorted({"1", "2", "3", "4"} - set(finished))
    first = (out / "site.h5").read_bytes()
    assert (out / "validation" / "report.json").exists()
    assert (out / "site.html").exists()
    assert "lcp" not in made(tmp_path).replace(str(tmp_path), "")  # nothing is left to do

    os.utime(dem, (time.time() + 2.0,) * 2)
    assert parts_of(made(tmp_path)) == ["1", "2", "3", "4"]
    assert (out / "site.h5").read_bytes() == first
