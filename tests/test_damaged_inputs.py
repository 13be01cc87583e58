"""Damaged input files: each parser answers with an error of one line. `make fuzz` tries far more of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.faults.fuzz import PARSERS, DamagedFiles, read_build, read_camera, read_facet
from lcp_catalog.errors import CameraError, ConfigError

SAMPLE = Path(__file__).resolve().parents[1] / "sample_data"

FOUND = [
    ("dem-label", 195),  # a unit of two lines
    ("dem-pds4", 12),  # texts of rasterio that are not UTF-8
    ("dem-geotiff", 2),
    ("dem-geotiff", 220),
    ("dem-jp2", 44),
    ("image-pds4", 54),
    ("image-label-beside", 833),  # a map projection that GDAL cannot parse
    ("dem-label", 2314),  # an infinite number of bytes
    ("dem-label", 3071),
    ("dem-label", 3590),  # an image that begins before its file
    ("dem-check", 7715),  # an object with the name of an earlier value
    ("dem-pds4", 2292),  # an unknown encoding
    ("camera", 2225),  # a distortion of 1e-320
    ("camera", 6745),  # a pixel of 1e-320
    ("image-label-beside", 8502),  # a thousand nested objects
    ("environment", 313),  # light that is too faint for a number
    ("merged", 2531),  # cells of 1e-320 m
    ("facet", 137),  # a name of thousands of parts: minutes of parsing
]
"""Damage (parser, seed) that was not survived."""


@pytest.mark.parametrize("name", PARSERS)
def test_parsers_survive_random_damage(name: str, tmp_path: Path) -> None:
    files = DamagedFiles(name, tmp_path)
    failures = {seed: files.failure(seed) for seed in range(3 if "jp2" in name else 12)}
    assert not {seed: found for seed, found in failures.items() if found}


@pytest.mark.parametrize(("name", "seed"), FOUND)
def test_damage_that_once_broke_a_parser(name: str, seed: int, tmp_path: Path) -> None:
    assert DamagedFiles(name, tmp_path).failure(seed) is None


LONG = "9" * 400
TOO_LONG = "9" * 5000


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"[points]\nspacing_m = {LONG}", "points.spacing_m must be a number"),
        (f"[points]\npatch_nodes = {LONG}", "points.patch_nodes must be a whole number"),
        (f"[points]\nspacing_m = {TOO_LONG}", "not TOML"),
        ("a." * 20_000 + "b = 1", "more than 100 parts"),
        ("a = " + "[" * 20_000, "nested too deeply"),
        ("a = '\\xff'", "not TOML"),
        ('[model]\nalbedo = "a\\u0000b"', "model.albedo must be a text"),
    ],
)
@pytest.mark.parametrize("read", [read_build, read_facet])
def test_numbers_names_and_depths_beyond_reason(
    read: Callable[[Path], None], text: str, says: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(text.replace("'\\xff'", "'\udcff'").encode("utf-8", "surrogateescape"))
    with pytest.raises(ConfigError) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    if read is read_build:
        assert says in str(caught.value)


@pytest.mark.parametrize("field", ["focal_length_px", "position_mcmf_m", "image_size_px"])
def test_a_camera_with_a_number_that_no_float_holds(field: str, tmp_path: Path) -> None:
    camera = json.loads((SAMPLE / "AS15-M-0414_camera.json").read_text())
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(camera | {field: 10**400}))
    with pytest.raises(CameraError, match=field):
        read_camera(path)
