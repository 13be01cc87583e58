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

COMPUTES = "landmarks", "light", "terrain", "photometry", "rendering", "production"
"""Packages whose constants decide what a catalogue or a render holds, but for the modules that only run them."""

RUNS = "cluster", "cures", "estimate", "executor", "worker_memory", "camera_views"

FUNCTIONS = {
    *("kernels.resampling.heights.sample", "landmarks.detection.SPREAD_NODES"),
    *("landmarks.uniqueness.RIVALS", "production.point_config.SMALLEST_PX"),
}
"""Approximations that no constant of floating point marks."""

NO_APPROXIMATIONS = {
    # by package: limits of values, units, guards against rounding, figures that were measured, defaults of fields
    "catalog": ("UNIVERSAL_SHARE _TOUCHING"),
    "landmarks": (
        "AMBIGUOUS COMMON_VARIANCE CONTRASTS EXCLUSION_PX GATE GROUP_GAIN HARRIS_K RING "
        "SIGNIFICANT TYPICAL_CONTRAST WRONG _CERTAIN _EXPONENTS _FIRM_PX _FLAT _GAIN "
        "_HIGH_PERCENTILE _LEAST_COSINE _LEAST_HEIGHT _LEAST_SLOPE_SIGNAL _LEAST_VARIANCE "
        "_LOST _NEEDED _NEGLIGIBLE _POSITION_M _PROBITS_OF_SEARCH _REACH_PX _ROUNDING "
        "_SIGMA_PX _SPREAD _TOLERANCE_PX"
    ),
    "light": (
        "CLEAR_SKY_RATIO DARKEST_SHARE EARTH_ALBEDO EARTH_RADIUS_M HIGH_DEG LAST_PHASE_DEG "
        "MEAN_DISTANCE_M SEGMENT_DEG WIDEST_DEG _FLAT _FULL_SCALE _GOLDEN _J2000 _LOWEST_DEG "
        "_NEVER_UP_RAD _ROUNDING_DEG _WHITE_PERCENTILE"
    ),
    "photometry": (
        "ALBEDO BOUNDS DISCS LAMBERT_ALBEDO LARGEST_EMISSION_DEG LIMITS MEAN MINNAERT_ALBEDO "
        "MINNAERT_FLOOR MINNAERT_K OPTICS REC_709 SETS SINGLE_SCATTERING_ALBEDO SURFACES "
        "TABLE_1 TABLE_2 TABLE_3 WEIGHT _DENSEST _GAIN _GAP_DEG _LEVEL_DEG _NO_CONTRAST "
        "_PER_SIGMA _QUADRATURE _RANGES _STARTS _STEPS _THETA_DEG _UNIT"
    ),
    "production": (
        "BANDS_DEG FOOTPRINT_MAX_KM LENGTH_MAX_M LEVEL_FACTOR_MAX LOCATED LOCATED_MAX "
        "LOCATED_MIN PLACE_PER_LENGTH POLAR_ELEVATIONS_DEG POLAR_SUN_DEG SEARCH_MAX_M "
        "SEARCH_NODES SPACING_MAX_M SUN_ELEVATIONS_DEG _COARSEST _FINEST _LATITUDE_STEP_DEG "
        "_LEAST_CHANCE _LEAST_M _LINKS _SAFETY _SLACK_RAD _WORST"
    ),
    "rendering": (
        "DISC_SHIFT DISC_SHIFT_DEG NORMAL_ROUNDING_RAD RING_MAX_M SIZE_MAX_KM STORED "
        "WHITE_PERCENTILE _EXTENT_MAX_M _FACING _GAMMA _MARGIN _RADIUS_UP _SHAPE "
        "_WHITE_PERCENTILE"
    ),
    "terrain": (
        "CELL_PER_RESOLUTION LOCAL_MAX_DEG OFF_SHARE STEEPEST _LIMB _ROUNDING _SLACK_OCTAVES "
        "_TOLERANCE_M"
    ),
}
"""Other constants of floating point; a new one belongs here or in the registry."""

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


def constants(source: str) -> set[str]:
    """Names at the top of a module whose values hold a number of floating point."""
    found: set[str] = set()
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
            inside = [n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant)]
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if any(isinstance(value, float) for value in inside):
                found |= {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
    return found


@functools.cache
def in_code() -> set[str]:
    """Every constant that may be an approximation, and the `FUNCTIONS`."""
    library = ROOT / "lcp_catalog"
    paths = [library / "catalog" / f"{name}.py" for name in ("prediction", "schema")]
    paths += [path for folder in COMPUTES for path in (library / folder).glob("*.py")]
    found = {
        ".".join((*path.relative_to(library).with_suffix("").parts, name))
        for path in paths
        if path.stem not in RUNS
        for name in constants(path.read_text(encoding="utf-8"))
    }
    return found | FUNCTIONS


def is_listed(name: str) -> bool:
    """True for a constant that `NO_APPROXIMATIONS` names, in whichever module of its package."""
    package, *_, own = name.split(".")
    return own in NO_APPROXIMATIONS.get(package, "").split()


def missing(registry: tuple[Approximation, ...]) -> set[str]:
    """What is neither in the registry nor asked for."""
    fields = {
        f"{section}.{field.name}"
        for section, kind in get_type_hints(BuildConfig).items()
        for field in dataclasses.fields(kind)
    }
    settings = {field.name for field in dataclasses.fields(Accuracy)} - {"tier"}
    asked = fields - ASKED | settings | decided()
    asked |= {name for name in in_code() if not is_listed(name)}
    return asked - {name for one in registry for name in _marks(one)}


def _marks(one: Approximation) -> tuple[str, ...]:
    return (*one.switch, *one.settings, *one.effects, *one.constants)


def test_every_approximation_is_in_the_registry() -> None:
    assert missing(APPROXIMATIONS) == set()
    assert len(decided()) > 18


def test_an_approximation_that_is_left_out_is_noticed() -> None:
    for k, one in enumerate(APPROXIMATIONS):
        rest = (*APPROXIMATIONS[:k], *APPROXIMATIONS[k + 1 :])
        known = {name for other in rest for name in _marks(other)}
        lost = set(_marks(one)) - known
        assert lost, one.name
        assert missing(rest) == {name for name in lost if not _only_named(name)}, one.name
        assert missing(rest), one.name


def _only_named(name: str) -> bool:
    """A constant that is no number of floating point: the registry names it, and nothing asks for it."""
    return name.count(".") > 1 and name not in in_code()


def test_a_constant_that_is_added_is_noticed() -> None:
    assert constants("A = 3\nB = 0.5\nC, D = 1e-3, 2\nE: float = f(2.0)\ndef f(): x = 1.0") == {
        *("B", "C", "D", "E")
    }
    assert not is_listed("light.bounced_light.NEW")
    assert not [name for one in APPROXIMATIONS for name in one.constants if is_listed(name)]


@pytest.mark.parametrize("one", APPROXIMATIONS, ids=lambda one: one.name)
def test_an_approximation_has_a_bound_and_a_switch_or_a_reason(one: Approximation) -> None:
    assert one.bound
    assert bool(one.switch) != bool(one.unpriced)
    assert bool(one.unpriced) == bool(one.price)
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
