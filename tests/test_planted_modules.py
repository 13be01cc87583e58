"""Modules in the working folder with the names of Python's own are never run by a command, by its children, or
by a thread that opens a catalogue.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import catalogs
from helpers.small_build import DEM

from lcp_catalog.catalog.writing import write_catalog

LCP = Path(sys.executable).with_name("lcp")
PLANTED = ("struct", "types", "json", "random", "numpy", "multiprocessing", "lcp_catalog", "socket")

CONFIG = """
[area]
center_deg = [3.5, 26.0]
size_km = 45.0
gsd_m = 474.0
[sun]
azimuths_deg = [90.0]
elevations_deg = [10.0, 30.0]
[view]
off_nadir_deg = [0.0]
azimuth_deg = [0.0]
altitude_km = [inf]
[points]
patch_nodes = 17
search_m = 5000.0
[model]
accuracy = "draft"
direction_tolerance_deg = 1.0
ring_max_km = 20.0
"""

THREAD = """
import sys, threading
import lcp_catalog as lcp
found = []
thread = threading.Thread(target=lambda: found.append(len(lcp.open_catalog(sys.argv[1]))))
thread.start()
thread.join()
sys.exit(found != [3])
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A working folder in which the modules write a marker when they are run."""
    planted = tmp_path / "data"
    planted.mkdir()
    for name in PLANTED:
        marker = tmp_path / f"{name}.was-run"
        text = f"open({str(marker)!r}, 'w').close()\nraise SystemExit('planted')\n"
        (planted / f"{name}.py").write_text(text)
    (planted / "build.toml").write_text(CONFIG)
    return planted


def require_untouched(folder: Path, *words: str | Path) -> None:
    """Run a command in the folder; it must succeed, and no planted module may have run."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    done = subprocess.run(
        list(map(str, words)),
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert sorted(path.name for path in folder.parent.glob("*.was-run")) == []
    assert (done.returncode, "planted" in done.stderr) == (0, False), done.stderr


@pytest.mark.slow
def test_a_build_of_two_processes(folder: Path) -> None:
    build = [LCP, "build-catalog", DEM, "--config", "build.toml", "-o", "x.h5", "--jobs", "2"]
    require_untouched(folder, *build)


@pytest.mark.slow
def test_a_trade(folder: Path) -> None:
    words = ["--config", "build.toml", "--areas", "1", "--rounds", "1"]
    require_untouched(folder, LCP, "trade", DEM, "-o", "out", *words)


@pytest.mark.slow
def test_a_thread_that_opens_a_catalogue(folder: Path) -> None:
    write_catalog(catalogs.catalog(3), folder / "c.h5")
    (folder.parent / "thread.py").write_text(THREAD)
    require_untouched(folder, sys.executable, folder.parent / "thread.py", "c.h5")
