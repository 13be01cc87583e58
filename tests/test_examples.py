"""The examples of the public names run, and every public name has one.

They see ``lcp``; ``folder``, a `Path` with the files of the sample; ``catalog``, the path of a small
catalogue of its DEM, with ``small_config``, its configuration; ``camera``, the path of its photograph's
camera file; ``small_camera``, that camera with fewer pixels; ``descent``, the path of a trajectory of two
frames.
"""

from __future__ import annotations

import doctest
import inspect
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from helpers import notebooks
from helpers.ccsds_files import aem, oem
from helpers.spice_kernels import mission

import lcp_catalog as lcp
from lcp_catalog._package_files import write_sample
from lcp_catalog.cameras.spice import loaded

ROOT = Path(__file__).resolve().parents[1]
NAMES = [name for name in lcp.__all__ if name != "__version__"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The names that the examples see."""
    folder = tmp_path_factory.mktemp("examples")
    write_sample(folder, overwrite=True)
    with loaded(mission(folder)):  # META.tm
        oem(folder / "orbit.oem", "MOON_ME")
        aem(folder / "attitude.aem", "MY_CAMERA", "MOON_ME")
    config = lcp.BuildConfig.from_dict(
        {
            "sun": {"elevations_deg": [10.0, 15.0, 20.0], "azimuths_deg": [90.0, 105.0]},
            "view": {"off_nadir_deg": [0.0], "azimuth_deg": [0.0], "altitude_km": [float("inf")]},
            "points": {"patch_nodes": 17, "spacing_m": 6000.0, "search_m": 6000.0},
        }
    )
    lcp.build_catalog(
        folder / "hadley_gld100_256ppd.tif",
        folder / "small.h5",
        config=config,
        center=(3.5, 26.0),
        size_km=80.0,
        gsd_m=474.0,
    )
    path = folder / "AS15-M-0414_camera.json"
    camera = lcp.read_camera(path)
    small = replace(
        camera,
        focal_length_px=camera.focal_length_px / 8.0,
        principal_point_px=tuple((c + 0.5) / 8.0 - 0.5 for c in camera.principal_point_px),
        image_size_px=(90, 90),
    )
    names = [f"r{row}{column}" for row in "123" for column in "123"]
    row = [*camera.position_mcmf_m, *camera.rotation_mcmf_to_camera.ravel()]
    times = ("2026-03-01T00:00:00", "2026-03-08T00:00:00")
    lines = [",".join([time, *(repr(float(value)) for value in row)]) for time in times]
    descent = folder / "descent.csv"
    descent.write_text("\n".join([",".join(["time_utc,x_m,y_m,z_m", *names]), *lines]))
    return {
        "lcp": lcp,
        "json": json,
        "folder": folder,
        "catalog": folder / "small.h5",
        "camera": path,
        "small_camera": small,
        "small_config": config,
        "descent": descent,
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_example_of(name: str, scene: dict[str, Any]) -> None:
    """Every public name has an example, and it prints what it says."""
    said: list[str] = []
    text = inspect.getdoc(getattr(lcp, name)) or ""
    test = doctest.DocTestParser().get_doctest(text, {**scene}, name, None, None)
    result = doctest.DocTestRunner(verbose=False).run(test, out=said.append)
    assert result.attempted, "no example"
    assert not said, "".join(said)


@pytest.mark.slow
def test_the_recipes_run(scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty lines of a first hour: all blocks of the page, one after the other."""
    folder = scene["folder"]
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "agg")
    (folder / "hadley.h5").write_bytes(scene["catalog"].read_bytes())
    (folder / "dem.tif").write_bytes((folder / "hadley_gld100_256ppd.tif").read_bytes())
    (folder / "camera.json").write_bytes(scene["camera"].read_bytes())
    (folder / "both.h5").unlink(missing_ok=True)  # of the example of `merge`
    programs = notebooks.cells(ROOT / "docs" / "howto" / "python.md")
    names: dict[str, Any] = {}
    shown = notebooks.run(programs, names)
    assert len(programs) == 10
    assert 0 < len(names["near"]) < len(names["cat"])
    assert names["fix"].verdict == "located"
    assert len(lcp.open_catalog("both.h5")) == len(names["cat"])
    assert "came" in shown[8] or "difference" in shown[8]
    assert 'PROJCS["Moon orthographic' in shown[9]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sample.ipynb", "own_site.ipynb"])
def test_the_notebooks_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_sample(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, Any] = {}
    notebooks.run(notebooks.cells(tmp_path / name), names)
    assert names["fix"].verdict == "located"
    assert len(names["cat"]) > 10
