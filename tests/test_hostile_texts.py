"""Texts of users and files: what a terminal or a spreadsheet would run is only shown, and numbers are numbers."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from lcp_catalog import errors
from lcp_catalog._package_files import sample_folder
from lcp_catalog.atomic_files import csv_lines
from lcp_catalog.cameras.camera_file import read_sensor
from lcp_catalog.cameras.json_fields import JsonFields
from lcp_catalog.catalog.origins import origins
from lcp_catalog.errors import CameraError, CatalogError, ConfigError
from lcp_catalog.production.point_config import PointConfig
from lcp_catalog.validation.requirement import Requirement

CAMERA = sample_folder() / "AS15-M-0414_camera.json"


def test_cells_that_a_spreadsheet_would_run() -> None:
    """Texts begin with an apostrophe; numbers, also as texts, stay."""
    row = ["=1+1", "+x", "-x", "@x", "\tx", "\r=x", "-1.5e3", "+2", "-inf", -3.5, "a=1", "", None]
    (line,) = csv_lines([row])
    assert line == "'=1+1,'+x,'-x,'@x,'\tx,\"'\r=x\",-1.5e3,+2,-inf,-3.5,a=1,,\r\n"


@pytest.mark.parametrize(
    "kind",
    [c for c in vars(errors).values() if isinstance(c, type) and c.__module__ == errors.__name__],
)
def test_a_message_is_one_line_without_control_characters(kind: type[Exception]) -> None:
    said = str(kind("x\x1b[31m\ny\t\u202ez\r"))
    assert said == "x\\x1b[31m y \\u202ez\\r"


@pytest.mark.parametrize(
    "text", ["a\x1b[31mb", "points_found>=\x1b[2J", "\x07>=1", "points_found>=1\x9b", "a\x85b>=1"]
)
def test_a_requirement_with_control_characters(text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        Requirement.parse(text)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("number", ["inf", "-inf", "1e999", "nan"])
def test_a_requirement_of_no_finite_number(number: str) -> None:
    with pytest.raises(ConfigError, match="is not a finite number"):
        Requirement.parse(f"points_found>={number}")


@pytest.mark.parametrize("points", ["inf", "nan", "true", "1.5", "'7'", "1e400"])
def test_a_number_of_merged_points_that_is_none(points: str) -> None:
    text = f"[[merged]]\nname = 'a'\ncontent_sha256 = 'b'\npoints = {points}\n[merged.config]\n"
    with pytest.raises(CatalogError, match="does not say what it was merged from"):
        origins(text)


def _with(place: tuple[Any, ...], value: object, folder: Path) -> Path:
    """The sample's camera with another value at a place."""
    document = json.loads(CAMERA.read_text())
    inner = document
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    path = folder / "camera.json"
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("value", [True, False, "1", [True], None])
@pytest.mark.parametrize(
    "place",
    [
        ("focal_length_px",),
        ("image_size_px", 0),
        ("principal_point_px", 1),
        ("position_mcmf_m", 2),
        ("rotation_mcmf_to_camera", 1, 1),
    ],
)
def test_a_camera_with_a_value_that_is_no_number(
    place: tuple[Any, ...], value: object, tmp_path: Path
) -> None:
    with pytest.raises(CameraError, match=place[0]):
        read_sensor(_with(place, value, tmp_path))
    shutil.copy(CAMERA, tmp_path / "same.json")
    assert read_sensor(tmp_path / "same.json")


@pytest.mark.parametrize("value", [[1.0, True], [[1.0], [False]], "3", ["3", 4], True])
def test_a_field_of_a_camera_model_that_holds_no_numbers(value: object) -> None:
    shape = (2, 1) if value == [[1.0], [False]] else (2,) if isinstance(value, list) else ()
    with pytest.raises(CameraError, match="does not consist of numbers"):
        JsonFields({"a": value}, "x.json").numbers("a", shape)


@pytest.mark.parametrize("points", [PointConfig(), PointConfig(search_m=5000.0)])
def test_cells_of_no_size_worth_the_name(points: PointConfig) -> None:
    """A merged configuration can state any."""
    assert points.search_nodes(1e-320) > 0
    assert PointConfig().search_nodes(474.0) == 17
