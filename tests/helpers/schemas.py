"""JSON schemas of the files that users write and read: `python tests/helpers/schemas.py` writes them into the sample.

That of BUILD.toml is made from the fields of the configuration.
"""

from __future__ import annotations

import dataclasses
import json
import types
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

from lcp_catalog.fields import Meaning, meanings
from lcp_catalog.production.config import BuildConfig

FOLDER = Path(__file__).resolve().parents[2] / "sample_data" / "schemas"
_HEAD = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
_NAMED = {"$schema": {"type": "string", "description": "where this schema is, for editors"}}
_KINDS = {float: "number", int: "integer", str: "string", bool: "boolean"}
_LIMITS = {
    "above": "exclusiveMinimum",
    "least": "minimum",
    "below": "exclusiveMaximum",
    "most": "maximum",
}


def _closed(properties: dict[str, Any], required: list[str] | None = None) -> dict[str, Any]:
    found = {"type": "object", "properties": properties, "additionalProperties": False}
    return found | ({"required": required} if required else {})


def _field(hint: Any, meaning: Meaning) -> dict[str, Any]:
    """The schema of a field: inf is no number of JSON, and stands in TOML only."""
    limits = {
        word: value
        for name, word in _LIMITS.items()
        if (value := getattr(meaning, name)) is not None and abs(value) != float("inf")
    }
    if isinstance(hint, types.UnionType):
        (hint,) = (one for one in get_args(hint) if one is not type(None))
    if get_origin(hint) is tuple:
        inner = {"type": _KINDS[get_args(hint)[0]]} | limits
        found: dict[str, Any] = {"type": "array", "items": inner}
    else:
        found = {"type": _KINDS[hint]} | limits
        if meaning.choices:
            found["enum"] = list(meaning.choices)
    text = f"{meaning.text} Default: {meaning.default}." if meaning.default else meaning.text
    return found | {"description": text.replace("`", "")}


def build() -> dict[str, Any]:
    """Of a BUILD.toml."""
    sections = {}
    for section, kind in get_type_hints(BuildConfig).items():
        hints, told = get_type_hints(kind), meanings(kind)
        fields = {f.name: _field(hints[f.name], told[f.name]) for f in dataclasses.fields(kind)}
        sections[section] = _closed(fields)
    return _HEAD | {"title": "BUILD.toml of lcp"} | _closed(_NAMED | sections)


def _numbers(count: int, text: str) -> dict[str, Any]:
    items = {"type": "number"}
    return {
        "type": "array",
        "items": items,
        "minItems": count,
        "maxItems": count,
        "description": text,
    }


def camera() -> dict[str, Any]:
    """Of a CAMERA.json."""
    rows = {"type": "array", "items": _numbers(3, "a row"), "minItems": 3, "maxItems": 3}
    needed = {
        "position_mcmf_m": _numbers(3, "place of the camera, MOON_ME, metres"),
        "rotation_mcmf_to_camera": rows
        | {"description": "rows: directions right, down and ahead of the camera, MOON_ME"},
        "focal_length_px": {"type": "number", "exclusiveMinimum": 0},
        "principal_point_px": _numbers(2, "column and row; centres of pixels at whole numbers"),
        "image_size_px": _numbers(2, "width and height")
        | {"items": {"type": "integer", "minimum": 1, "maximum": 1000000}},
    }
    optional = {
        "distortion": _numbers(5, "k1, k2, p1, p2, k3 (OpenCV)"),
        "sun_position_mcmf_m": _numbers(3, "place of the Sun, MOON_ME, metres"),
        "time_utc": {"type": "string", "description": "like 2024-01-01T00:00:00"},
        "lens": {"type": "object", "description": "a lens model in place of distortion"},
        "simulated": {"type": "object", "description": "how a simulated frame was made; not read"},
    }
    return (
        _HEAD | {"title": "CAMERA.json of lcp"} | _closed(_NAMED | needed | optional, list(needed))
    )


def _optional_object(*names: str) -> dict[str, Any]:
    return {"type": ["object", "null"], "properties": {name: True for name in names}}


def report() -> dict[str, Any]:
    """Of a report.json: the names that docs/reference/report-json.md promises; others may stand beside them."""
    number = {"type": ["number", "null"]}
    claims = _optional_object("count", "brier", "found_of_usable", "usable_of_found", "reliability")
    image = {
        "image": {"type": "string"},
        "points_in_view": {"type": "integer", "minimum": 0},
        "points_found": {"type": "integer", "minimum": 0},
        "offset_px": {"type": "object", "properties": {"median": number, "p95": number}},
        "offset_m": {"type": "object", "properties": {"median": number, "p95": number}},
        "correlation": {"type": "object", "properties": {"median": number, "p05": number}},
        "windows": _optional_object(
            "size", "count", "share_above_0_9", "share_above_0_7", "median"
        ),
        "pose": _optional_object("position_error_m", "position_sigma_m"),
        "claims": claims,
    }
    image["verdict"] = {"enum": ["located", "not this place", "cannot say"]}
    entry = {"type": "object", "properties": image, "required": list(image)}
    whole = _NAMED | {"images": {"type": "array", "items": entry}, "claims": claims}
    return _HEAD | {
        "title": "report.json of lcp validate",
        "type": "object",
        "properties": whole,
        "required": ["images", "claims"],
    }


FILES = {"build.json": build, "camera.json": camera, "report.json": report}


def text(name: str) -> str:
    """The content of a file."""
    return json.dumps(FILES[name](), indent=1) + "\n"


if __name__ == "__main__":
    for name in FILES:
        (FOLDER / name).write_text(text(name), encoding="utf-8")
