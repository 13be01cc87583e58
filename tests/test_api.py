"""The public names of `lcp_catalog`, and the example of the API page."""

from __future__ import annotations

import inspect
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lcp_catalog as lcp

ROOT = Path(__file__).resolve().parents[1]
DEM = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"
SMALL = {
    "area": {"gsd_m": 474.0},
    "sun": {"elevations_deg": [10.0, 15.0, 20.0], "azimuths_deg": [90.0, 105.0]},
    "view": {"off_nadir_deg": [0.0], "azimuth_deg": [0.0], "altitude_km": [float("inf")]},
    "points": {"patch_nodes": 17, "spacing_m": 6000.0, "search_m": 12000.0},
}
"""Configuration of a small catalogue with the cells of the Apollo frame."""


def test_every_public_name_is_there() -> None:
    """Each name has a docstring of its own, and `dir` lists it."""
    assert {*lcp.__all__} <= {*dir(lcp)}
    for name in lcp.__all__:
        assert getattr(lcp, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'Atlas'"):
        _ = lcp.Atlas


def test_the_import_loads_no_heavy_package() -> None:
    """numpy, numba and the like are imported with the first name that needs them."""
    code = "import sys, lcp_catalog; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "numba", "rasterio", "cv2", "h5py", "scipy"} & {*done.stdout.split()}


def test_names_for_type_checkers_are_those_that_are_loaded() -> None:
    """The imports under TYPE_CHECKING name the same modules as the table of lazy names."""
    text = (ROOT / "lcp_catalog" / "__init__.py").read_text(encoding="utf-8")
    for name, module in lcp._MODULES.items():
        assert f"from .{module} import {name} as {name}\n" in text


def test_no_function_bears_the_name_of_a_module_of_the_root() -> None:
    """Importing the module would bind its name to it, in place of the function."""
    root = ROOT / "lcp_catalog"
    modules = {path.stem for path in root.glob("*.py")} | {
        path.name for path in root.iterdir() if (path / "__init__.py").is_file()
    }
    assert {"matching", "accuracy"} <= modules
    assert not modules & {*lcp._MODULES}


def test_every_command_has_its_function() -> None:
    """All commands that answer from data have a function of the same name."""
    of_commands = {
        "build_catalog", "render", "validate", "locate", "query", "simulate", "export", "merge",
        "diff", "windows", "report", "trade", "inspect", "dem_info", "sun_at",
    }  # fmt: skip
    assert of_commands <= {*lcp.__all__}


def test_public_functions_name_their_parameters() -> None:
    """Parameter by parameter: typed, none gathered by ``*`` or ``**``, each in the docstring."""
    functions = {name: getattr(lcp, name) for name in lcp.__all__ if name != "__version__"}
    for name, function in functions.items():
        if not inspect.isfunction(function):
            continue
        signature, text = inspect.signature(function), inspect.getdoc(function)
        assert signature.return_annotation is not inspect.Signature.empty, name
        for parameter in signature.parameters.values():
            assert parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD), name
            assert parameter.annotation is not parameter.empty, f"{name}: {parameter.name}"
            assert re.search(rf"^[\w, ]*\b{parameter.name}\b[\w, ]*:$", text or "", re.M), (
                f"{name}: {parameter.name} is not described"
            )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``west.h5`` and ``east.h5``, which overlap, and ``both.h5``, their merge."""
    folder, config = tmp_path_factory.mktemp("api"), lcp.BuildConfig.from_dict(SMALL)
    for name, lon in (("west.h5", 3.0), ("east.h5", 4.2)):
        lcp.build_catalog(DEM, folder / name, config=config, center=(lon, 26.0), size_km=75.0)
    lcp.merge([folder / "west.h5", folder / "east.h5"], folder / "both.h5")
    return folder


@pytest.mark.slow
def test_example(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The example locates the Apollo frame with a small catalogue of the same cells as the frame's
    own: the position is within 3 sigma of the camera file's, which an independent bundle adjustment
    gave.
    """
    found, locate = [], lcp.locate

    def listen(*given: Any) -> Any:
        found.append(locate(*given))
        return found[-1]

    monkeypatch.setattr(lcp, "locate", listen)
    example = runpy.run_path(str(ROOT / "sample_data" / "examples" / "locate_camera.py"))
    example["main"](str(folder / "both.h5"))
    said = capsys.readouterr().out
    assert "located: " in said
    (fix,) = found
    camera = lcp.read_camera(example["CAMERA"])
    assert fix.pose is not None
    error = fix.pose.position_mcmf_m - camera.position_mcmf_m
    assert error @ np.linalg.solve(fix.pose.position_covariance_m2, error) < 3 * 3.0**2


@pytest.mark.slow
def test_a_day_with_the_functions(folder: Path, tmp_path: Path) -> None:
    """Two catalogues from a DEM, joined, asked, exported, and validated with a simulated frame: what one
    function says agrees with the others.
    """
    info = lcp.dem_info(DEM, at_deg=[(3.5, 26.0)])
    height_m = info.files[0]["samples"][0]["height_m"]
    assert float(info.dems.heights(3.5, 26.0, info.files[0]["gsd_m"])[0]) == pytest.approx(height_m)
    both = folder / "both.h5"
    merged = lcp.merge([folder / "west.h5", folder / "east.h5"], tmp_path / "again.h5")
    assert both.read_bytes() == (tmp_path / "again.h5").read_bytes()
    catalog = lcp.open_catalog(both)
    assert len(catalog) == merged.points == lcp.inspect(both)["points"]
    assert lcp.export(catalog, tmp_path / "points.csv") == len(catalog)
    assert lcp.diff(folder / "west.h5", both).counts()["went"] <= merged.crowded
    sun = lcp.sun_at((3.6, 26.0), "1971-07-31T01:25:52")
    angles = (sun.azimuth_deg[0], sun.elevation_deg[0])
    camera = lcp.read_camera(ROOT / "sample_data" / "AS15-M-0414_camera.json")
    answer = lcp.query(catalog, camera, sun=angles)
    at = lcp.windows(catalog, (3.6, 26.0), "1971-07-31T01:25:52", camera=camera)
    assert at.points == answer.counts["in_view"]
    taken = lcp.simulate(
        info.dems,
        camera,
        angles,
        tmp_path / "frame.png",
        gsd_m=474.0,
        accuracy="draft",
        samples=2,
    )
    fix = lcp.locate(catalog, taken.image.with_sensor(camera))
    found = lcp.validate(both, tmp_path / "frame.png", tmp_path / "frame_camera.json")
    (image,) = found.verdict.document()["images"]
    assert fix.verdict == "located" == found.verdict.images[0].located.verdict
    assert np.linalg.norm(fix.pose.position_mcmf_m - camera.position_mcmf_m) < 3.0 * 1000.0
    assert image["points_in_view"] == answer.counts["in_view"]
