"""The public names of `lcp_catalog`, and the example of the API page."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import lcp_catalog as lcp

ROOT = Path(__file__).resolve().parents[1]
DEM = ROOT / "sample_data" / "hadley_gld100_256ppd.tif"


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


def test_example(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The example locates the Apollo frame with a small catalogue of the same cells as the frame's
    own: the position is within 3 sigma of the camera file's, which an independent bundle adjustment
    gave.
    """
    config = lcp.BuildConfig.from_dict(
        {
            "area": {"center_deg": [3.5, 26.0], "size_km": 150.0, "gsd_m": 474.0},
            "sun": {"elevations_deg": [10.0, 15.0, 20.0], "azimuths_deg": [90.0, 105.0]},
            "view": {"off_nadir_deg": [0.0], "azimuth_deg": [0.0], "altitude_km": [float("inf")]},
            "points": {"patch_nodes": 17, "spacing_m": 6000.0, "search_m": 12000.0},
        }
    )
    path = tmp_path / "hadley.h5"
    report = lcp.build_catalog([DEM], config, path)
    assert report.points > 50
    example = runpy.run_path(str(ROOT / "docs" / "examples" / "locate_camera.py"))
    example["main"](str(path))
    said = capsys.readouterr().out
    assert "located: " in said
    catalog = lcp.open_catalog(path)
    camera = lcp.read_camera(example["CAMERA"])
    image = lcp.open_image(example["IMAGE"], camera)
    fix = lcp.locate(catalog, image, lcp.Uncertainty(position_m=2000.0, attitude_rad=0.0035))
    assert fix.pose is not None
    error = fix.pose.position_mcmf_m - camera.position_mcmf_m
    assert error @ np.linalg.solve(fix.pose.position_covariance_m2, error) < 3 * 3.0**2
