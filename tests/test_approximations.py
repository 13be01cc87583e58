"""The registry of approximations is complete: every field of the configuration, of a tier and every decision of a scene
plan is in it, or is no approximation."""

from __future__ import annotations

import ast
import dataclasses
import functools
import importlib
import importlib.util
import math
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from lcp_catalog.accuracy import Accuracy
from lcp_catalog.approximations import APPROXIMATIONS, Approximation
from lcp_catalog.errors import ConfigError
from lcp_catalog.production.config import SUN_ELEVATIONS_DEG, BuildConfig, ViewConfig

ROOT = Path(__file__).resolve().parents[1]

ASKED = {
    # what a user wants or knows; not how exactly it is computed
    *("area.center_deg", "area.size_km", "area.bounds_deg"),
    *("dem.product_order", "dem.sigma_map", "dem.resolution_map", "dem.only_resolving"),
    *("points.located_probability", "points.per_view", "points.footprint_km", "points.max_points"),
    *("points.max_bytes", "points.spacing_m", "points.min_detection"),
    "points.min_usable_conditions",
    # the model of an image's differences from a render
    *("errors.sensor_noise", "errors.height_sigma_m", "errors.height_length_m", "errors.spread"),
    *("errors.albedo_sigma", "errors.albedo_length_m", "errors.position_sigma_m"),
    *(
        "errors.shadow_shift",
        "errors.moving_share",
        "errors.contrast_power",
        "errors.position_sigma_cells",
    ),
}

CONFIG = BuildConfig().replaced(
    {"area.gsd_m": 118.0, "sun.elevations_deg": SUN_ELEVATIONS_DEG, "model.albedo": "none"}
)


@functools.cache
def decided() -> set[str]:
    """Effects of all decisions in the source: first arguments of ``Decision(...)``, and the names that stand there."""
    found: set[str] = set()
    for folder in ("rendering", "production"):
        for path in (ROOT / "lcp_catalog" / folder).glob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            texts: dict[str, str] = {}
            for node in ast.walk(tree):
                if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
                    names = getattr(node.targets[0], "elts", [])
                    pairs = zip(names, node.value.elts, strict=False)
                    texts |= {
                        n.id: str(v.value)
                        for n, v in pairs
                        if isinstance(n, ast.Name) and isinstance(v, ast.Constant)
                    }
            for node in ast.walk(tree):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Decision":
                    first = node.args[0] if node.args else None
                    if isinstance(first, ast.Constant):
                        found.add(str(first.value))
                    elif isinstance(first, ast.Name) and first.id in texts:
                        found.add(texts[first.id])
    return found | {"cast shadows"}  # given to `decisions.hiding` by name


def missing(registry: tuple[Approximation, ...]) -> set[str]:
    """What is neither in the registry nor asked for."""
    fields = {
        f"{section}.{field.name}"
        for section, kind in get_type_hints(BuildConfig).items()
        for field in dataclasses.fields(kind)
    }
    settings = {field.name for field in dataclasses.fields(Accuracy)} - {"tier"}
    given = {name for one in registry for name in (*one.switch, *one.settings, *one.effects)}
    return (fields - ASKED | settings | decided()) - given


def test_every_approximation_is_in_the_registry() -> None:
    assert missing(APPROXIMATIONS) == set()
    assert len(decided()) > 18


def test_an_approximation_that_is_left_out_is_noticed() -> None:
    for k, one in enumerate(APPROXIMATIONS):
        rest = (*APPROXIMATIONS[:k], *APPROXIMATIONS[k + 1 :])
        known = {
            name for other in rest for name in (*other.switch, *other.settings, *other.effects)
        }
        assert missing(rest) == {*one.switch, *one.settings, *one.effects} - known


@pytest.mark.parametrize("one", APPROXIMATIONS, ids=lambda one: one.name)
def test_an_approximation_has_a_bound_and_a_switch_or_a_reason(one: Approximation) -> None:
    assert one.bound
    assert bool(one.switch) != bool(one.unpriced)
    for constant in one.constants:
        module, _, name = constant.rpartition(".")
        assert hasattr(importlib.import_module(f"lcp_catalog.{module}"), name), constant
    found = one.values(CONFIG)
    assert bool(found) == bool(one.switch)
    assert not set(one.switch) & ASKED
    for values in found.values():
        assert set(values) <= {
            *one.switch,
            "view.off_nadir_deg",
            "view.azimuth_deg",
            "view.altitude_km",
        }
        assert CONFIG.replaced(values) != CONFIG


def test_alternatives_belong_to_any_configuration() -> None:
    """Lists of one number, near views, the extremes of a range: what cannot be is refused by the configuration alone."""
    narrow = CONFIG.replaced(
        {
            "sun.azimuths_deg": (90.0,),
            "sun.elevations_deg": (10.0,),
            "model.direction_tolerance_deg": 10.0,
            "points.patch_nodes": 9,
            "points.image_scales": 1,
            "model.accuracy": "reference",
        }
    )
    narrow = dataclasses.replace(narrow, view=ViewConfig((0.0,), (0.0,), (20.0,)))
    for one in APPROXIMATIONS:
        for values in one.values(narrow).values():
            try:
                assert narrow.replaced(values) != narrow
            except ConfigError:
                assert set(values) == {"model.direction_tolerance_deg"}
    assert math.isinf(
        max(_values(narrow, "parallel or near views")["parallel"]["view.altitude_km"])
    )


def _values(config: BuildConfig, name: str) -> dict[str, Any]:
    return next(one.values(config) for one in APPROXIMATIONS if one.name == name)


def test_the_reference_lists_every_approximation() -> None:
    spec = importlib.util.spec_from_file_location("fields_hook", ROOT / "docs/hooks/fields.py")
    assert spec
    assert spec.loader
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    page = (ROOT / "docs/explanation/accuracy.md").read_text(encoding="utf-8")
    made = hook.on_page_markdown(page)
    assert hook.APPROXIMATED not in made
    rows = [line for line in made.splitlines() if line.startswith("| ")]
    for one in APPROXIMATIONS:
        assert sum(row.startswith(f"| {one.name} |") and row.count("|") == 5 for row in rows) == 1
