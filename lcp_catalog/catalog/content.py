"""What a catalogue's file holds, from the model: every variable in the schema's type, and all attributes."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ..arrays import AnyArray
from ..constants import FRAME, MOON_RADIUS_M
from ..errors import CatalogError
from .layout import (
    FIXED,
    GROUP_ATTRIBUTES,
    GROUPS,
    OPTIONAL_GROUP_ATTRIBUTES,
    TEXT,
    centred,
    key,
    packing,
    sigma_step_m,
)
from .model import CatalogParts
from .schema import COVERAGE_UNKNOWN, OPTIONAL, PACKED, SCHEMA_VERSION, universal

CONVENTIONS = "CF-1.11"
SOFTWARE = "lcp-catalog"


def values(catalog: CatalogParts) -> dict[str, AnyArray]:
    """Every variable by its path in the file, in the schema's types; claims are packed. CatalogError for an
    array that does not fit into its type.
    """
    found: dict[str, Any] = _numbers(catalog)
    if catalog.coverage.usable is None:
        shape = (len(catalog.coverage.longitude), *np.shape(catalog.condition)[1:])
        found["coverage/usable"] = np.full(shape, COVERAGE_UNKNOWN, np.uint8)
    step_m = catalog.sigma_step_m or sigma_step_m(catalog.gsd)
    for group, owner in catalog.groups().items():
        for short, variable in GROUPS[group].items():
            name = key(group, short)
            if name in OPTIONAL and getattr(owner, short) is None:
                continue
            value = found[name] if name in found else getattr(owner, short)
            if name in PACKED:
                value = packing(name, step_m).packed(value)
            found[name] = typed(name, value, variable.dtype)
    return found


def _numbers(catalog: CatalogParts) -> dict[str, AnyArray]:
    """The variables that only number what stands in others, and what follows from them."""
    shape = np.shape(catalog.dem)
    require(
        ""
        if len(shape) == 3
        else f"dem: {len(shape)} dimensions instead of (point, patch_row, patch_col)"
    )
    found: dict[str, Any] = {
        "point": np.arange(len(catalog.point_id)),
        "view": np.arange(len(catalog.view_off_nadir)),
        "patch_row": centred(shape[1]),
        "patch_col": centred(shape[2]),
        "coverage/cell": np.arange(len(catalog.coverage.longitude)),
        "universal": universal(np.asarray(catalog.condition)),
    } | {name: np.arange(length) for name, length in FIXED.items()}
    if catalog.promise is not None:
        found["promise/place"] = np.arange(len(catalog.promise.longitude))
        found["promise/step"] = np.arange(len(catalog.promise.size))
        found["promise/part"] = np.arange(len(catalog.promise.gsd))
    if catalog.coverage_levels is not None:
        found["coverage_levels/block"] = np.arange(len(catalog.coverage_levels.factor))
        found["coverage_levels/code"] = np.arange(np.shape(catalog.coverage_levels.cells)[1])
    return found


def attributes(catalog: CatalogParts) -> dict[str, Any]:
    """The global attributes, without the digest of the content."""
    found = {
        "Conventions": CONVENTIONS,
        "title": catalog.title,
        "product_version": catalog.product_version,
        "schema_version": SCHEMA_VERSION,
        "software": SOFTWARE,
        "software_version": catalog.software_version,
        "history": catalog.history,
        "body": "MOON",
        "frame": FRAME,
        "reference_radius_m": MOON_RADIUS_M,
        "config": catalog.config,
        "sources": json.dumps(catalog.sources, sort_keys=True),
        "scene_plan": json.dumps(catalog.scene_plan, sort_keys=True),
        "errors": json.dumps(catalog.errors, sort_keys=True),
        "sigma_step_m": float(catalog.sigma_step_m or sigma_step_m(catalog.gsd)),
    }
    if catalog.albedo_map is not None:
        found["albedo_map"] = json.dumps(catalog.albedo_map, sort_keys=True)
    return found


def group_attributes(catalog: CatalogParts) -> dict[str, dict[str, float | str]]:
    """Attributes of the groups by group and name."""
    found: dict[str, dict[str, float | str]] = {}
    parts = catalog.groups()
    for group in parts.keys() & GROUP_ATTRIBUTES.keys():
        found[group] = {
            name: _plain(getattr(parts[group], name)) for name in GROUP_ATTRIBUTES[group]
        }
        if (name := OPTIONAL_GROUP_ATTRIBUTES.get(group, "")) and _is_stated(parts[group], name):
            found[group][name] = _plain(getattr(parts[group], name))
    return found


def _is_stated(part: Any, name: str) -> bool:
    """True for an attribute that is not the default of its part."""
    return bool(getattr(part, name) != type(part).__dataclass_fields__[name].default)


def _plain(value: Any) -> float | str:
    """An attribute of a group: a text or a number."""
    return value if isinstance(value, str) else float(value)


def require(problem: str) -> None:
    """CatalogError for a problem, if there is one."""
    if problem:
        raise CatalogError(f"not a catalogue: {problem}")


def typed(name: str, value: Any, kind: str) -> AnyArray:
    """The array in the schema's type; integers are not made from floats."""
    if kind == TEXT:
        return np.array([str(text) for text in np.asarray(value).ravel()], dtype=object).reshape(
            np.shape(value)
        )
    array = np.asarray(value)
    target = np.dtype(kind)
    require("" if array.dtype.kind in "biuf" else f"{name}: holds {array.dtype}, not numbers")
    if target.kind in "iu" and array.size:
        info = np.iinfo(target)
        require(
            "" if array.dtype.kind in "biu" else f"{name}: holds {array.dtype}, not whole numbers"
        )
        fits = info.min <= int(array.min()) and int(array.max()) <= info.max
        require("" if fits else f"{name}: does not fit into {kind}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array.astype(target))
