"""The registry of approximations is complete: every field of the configuration, of a tier and every decision of a scene
plan is in it, or is no approximation."""

from __future__ import annotations

import ast
import dataclasses
import functools
import importlib
import importlib.util
import math
import re
from collections import Counter
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
import rasterio
from helpers.no_approximations import NO_APPROXIMATIONS
from scipy import ndimage, stats

from lcp_catalog.accuracy import TIERS, Accuracy
from lcp_catalog.approximations import (
    APPROXIMATIONS,
    EXACT,
    LIMIT,
    MEASURED,
    ON_SAMPLE,
    SAMPLE,
    Approximation,
)
from lcp_catalog.cameras.distortion import INVERSE_TOLERANCE_PX
from lcp_catalog.catalog.schema import DETECTION_STEP
from lcp_catalog.constants import ASTRONOMICAL_UNIT_M
from lcp_catalog.ephemeris.solar_position import DIRECTION_ERROR_DEG
from lcp_catalog.errors import ConfigError
from lcp_catalog.exports.flight import ANGLE_STEPS
from lcp_catalog.kernels.matching.subpixel_fit import _MISMATCH
from lcp_catalog.kernels.resampling import heights
from lcp_catalog.landmarks.detection import _PROBITS_OF_SEARCH
from lcp_catalog.matching.templates import TOLERANCE_PX
from lcp_catalog.production.build_decisions import TURNED
from lcp_catalog.production.config import SUN_ELEVATIONS_DEG, BuildConfig, ViewConfig
from lcp_catalog.production.evaluation import STEP
from lcp_catalog.production.promise import _LATITUDE_STEP_DEG
from lcp_catalog.simulation.detector import REACH

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
        "errors.detection_shift",
    ),
}

COMPUTES = "landmarks", "light", "terrain", "photometry", "rendering", "production", "kernels"
"""Packages whose constants decide what a catalogue or a render holds, but for the modules that only run them."""

ALSO = (
    *("dem", "catalog", "ephemeris", "geometry", "cameras", "images", "exports", "matching"),
    *("navigation", "simulation"),
)
"""Packages whose constants are classified, too: they give what a build, a query or a frame takes, or keep it."""

APART = {
    "plots": "draws",
    "pds": "reads labels",
    "flight": "C, which reads the flight file",
    "tradeoff": "measures catalogues and changes none",
    "validation": "measures catalogues and changes none",
}
"""Packages without an approximation of a catalogue or of a frame, and why."""

RUNS = "cluster", "cures", "estimate", "executor", "worker_memory", "camera_views", "kept_ground"

FUNCTIONS = {
    "cameras.trajectory.Attitude",
    "cameras.trajectory.Track",
    "kernels.resampling.heights.sample",
    "landmarks.detection.top_probability",
    "light.bounced_light._gathered",
    "light.bounced_light._reached",
    "light.bounced_light.bounced_at_points",
}
"""Approximations that no constant marks; numbers within functions: `test_literals`."""


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
    """Names at the top of a module whose values hold a number of floating point, or a whole number above 1. Names that are
    numbered from 0 or 1 (``A, B, C = 0, 1, 2``) are none, whatever their type.
    """
    found: set[str] = set()
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            several = isinstance(targets[0], ast.Tuple) and _numbers_them(node.value)
            inside = [] if several or _is_range(node.value) else _values_in(node.value)
            whole = any(isinstance(v, int) and not isinstance(v, bool) and v > 1 for v in inside)
            if whole or any(isinstance(value, float) for value in inside):
                found |= {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
    return found


def _values_in(node: ast.expr) -> list[Any]:
    return [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]


def _is_range(node: ast.expr) -> bool:
    """True for the places of an array, which are numbered."""
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") == "range"


def _numbers_them(node: ast.expr) -> bool:
    """True for whole numbers from 0 or 1, one after the other."""
    each = [_values_in(one) for one in getattr(node, "elts", [])]
    numbers, many = [own[0] for own in each if len(own) == 1], len(each)
    return many > 1 and numbers in ([*range(many)], [*range(1, many + 1)])


@functools.cache
def in_code() -> set[str]:
    """Every constant that may be an approximation, and the `FUNCTIONS`."""
    library = ROOT / "lcp_catalog"
    paths = [path for folder in (*COMPUTES, *ALSO) for path in (library / folder).rglob("*.py")]
    found = {
        ".".join((*path.relative_to(library).with_suffix("").parts, name))
        for path in paths
        if path.stem not in RUNS
        for name in constants(path.read_text(encoding="utf-8"))
    }
    return found | FUNCTIONS


def _entry(name: str) -> tuple[str, str]:
    """Package and entry of a constant in `NO_APPROXIMATIONS`: its name, after its module where that is listed."""
    package, _, rest = name.partition(".")
    return package, rest if rest in NO_APPROXIMATIONS.get(package, "").split() else rest.rpartition(
        "."
    )[2]


def is_listed(name: str) -> bool:
    """True for a constant that `NO_APPROXIMATIONS` names."""
    package, entry = _entry(name)
    return entry in NO_APPROXIMATIONS.get(package, "").split()


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


def miscounted(names: set[str], registry: tuple[Approximation, ...]) -> set[str]:
    """Packages and names of constants that more or fewer modules have than `NO_APPROXIMATIONS` lists."""
    named = {name for one in registry for name in one.constants}
    there = Counter(_entry(name) for name in names - named)
    listed = Counter((p, own) for p, text in NO_APPROXIMATIONS.items() for own in text.split())
    return {".".join(key) for key in {*there, *listed} if there[key] != listed[key]}


def _marks(one: Approximation) -> tuple[str, ...]:
    return (*one.switch, *one.settings, *one.effects, *one.constants)


def test_every_approximation_is_in_the_registry() -> None:
    assert missing(APPROXIMATIONS) == set()
    assert len(decided()) > 18
    assert miscounted(in_code(), APPROXIMATIONS) == set()


def test_every_package_is_classified() -> None:
    library = ROOT / "lcp_catalog"
    packages = {path.parent.name for path in library.glob("*/*.py")}
    assert packages == {*COMPUTES, *ALSO, *APART} - ({"flight"} - packages)
    assert not {*COMPUTES, *ALSO} & set(APART)


@pytest.mark.slow
def test_an_approximation_that_is_left_out_is_noticed() -> None:
    for k, one in enumerate(APPROXIMATIONS):
        rest = (*APPROXIMATIONS[:k], *APPROXIMATIONS[k + 1 :])
        known = {name for other in rest for name in _marks(other)}
        lost = set(_marks(one)) - known
        assert lost, one.name
        assert missing(rest) == {name for name in lost if not _only_named(name)}, one.name
        assert missing(rest), one.name


def _only_named(name: str) -> bool:
    """A constant that is no such number: the registry names it, and nothing asks for it."""
    return name.count(".") > 1 and name not in in_code()


def test_a_constant_that_is_added_is_noticed() -> None:
    assert constants(
        "X, Y = range(9)\nU, V = 2, 3\nP, Q = 0, 1\nT = (1, 2)\nW = 12\n"
        "A = 3\nB = 0.5\nC, D = 1e-3, 2\nE: float = f(2.0)\ndef f(): x = 1.0"
    ) == {*("A", "B", "C", "D", "E", "T", "U", "V", "W")}
    assert not is_listed("light.bounced_light.NEW")
    assert miscounted(in_code() | {"kernels.rays.tracing._STEPS"}, APPROXIMATIONS) == {
        "kernels._STEPS"
    }
    assert miscounted(in_code() - {"terrain.useful_cell._PLACES"}, APPROXIMATIONS) == {
        "terrain._PLACES"
    }
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


ERRORS = {one.name: one.error for one in APPROXIMATIONS}

DATED = r"\b[0-9a-f]{7,8}(?:, |\b.*, )20\d\d-\d\d-\d\d"


@pytest.mark.parametrize("one", APPROXIMATIONS, ids=lambda one: one.name)
def test_an_approximation_has_one_figure_for_its_error(one: Approximation) -> None:
    """A number with its unit, of what, and how it is known: what was measured names the commit and the date of the
    measurement in its row, and its number stands there, too; what was read off the sample is the greatest of its row.
    """
    error = one.error
    assert math.isfinite(error.value)
    assert error.value > 0.0 or (error.value, error.basis) == (0.0, EXACT)
    assert error.unit in {"%", "", "deg", "rad", "m", "cells", "pixels"}
    assert len(error.what) > 5
    if error.basis == MEASURED:
        assert re.search(DATED, one.bound), one.bound
        share = 0.01 * error.value if error.unit == "%" else error.value
        said = {f"{v:g}" for v in (error.value, share, 1.0 - share, 100.0 - error.value)}
        assert said & set(re.findall(r"\d+(?:\.\d+)?", one.bound.replace(".0 m", " m"))), one.bound
    elif error.basis == ON_SAMPLE:
        shares = [float(found) for found in re.findall(r"([\d.]+) % \(", one.sample)]
        (points,) = re.findall(r" with (\d+) points", SAMPLE)
        lost = [
            100.0 * max(map(int, found)) / int(points)
            for found in re.findall(r"(\d+)/(\d+)", one.sample)
        ]
        assert error.value == pytest.approx(
            max(lost if "points" in error.what else shares), rel=0.03
        )
    else:
        assert error.basis in {EXACT, LIMIT}


def test_figures_of_errors_are_those_of_the_code() -> None:
    """What follows from constants and formulas, computed here once more."""
    model, points = BuildConfig().model, BuildConfig().points
    half_m = 30e3 * math.sqrt(2.0)
    told = {
        "accuracy tier": 100.0 * TIERS["draft"].node_error,
        "reflectance law": 100.0 * TIERS["draft"].law_residual,
        "parallel or near views": math.radians(model.direction_tolerance_deg),
        "one direction per area": 100.0 * max(TURNED),
        "limit of dependence": 100.0 * points.max_dependence,
        "packing of claims": 0.5 * DETECTION_STEP,
        "float32": 2.0**-24,
        "position of the Sun": DIRECTION_ERROR_DEG,
        "inverse of a camera": INVERSE_TOLERANCE_PX,
        "shape of a patch in an image": TOLERANCE_PX,
        "blur of a simulated frame": 1.0 - (1.0 - 2.0 * stats.norm.sf(REACH)) ** 2,
        "places that a search refuses": 2.0 * stats.norm.cdf(0.5 * (0.77 - _PROBITS_OF_SEARCH))
        - 1.0,
        "motion of a camera between rows of its table": 0.001 * 10.0**2 / 8.0,
        "steps of the flight file": 0.5 * 180.0 / ANGLE_STEPS,
        "rounding of height errors": 100.0 * (math.exp(0.5 * STEP) - 1.0),
        "latitudes of a promise": 0.5 * _LATITUDE_STEP_DEG,
        "sigma of a match": 100.0 * (1.0 - 1.0 / math.sqrt(1.0 + _MISMATCH)),
        "one direction to the Sun from an area": math.degrees(half_m / ASTRONOMICAL_UNIT_M),
    }
    for name, value in told.items():
        assert ERRORS[name].value == pytest.approx(value, rel=0.02), name
    exact = {one.name for one in APPROXIMATIONS if one.error.basis in {EXACT, LIMIT}}
    assert exact - set(told) == {"shape of the ground"}
    assert 100.0 * TIERS["draft"].sky_rms == ERRORS["light other than the Sun's"].value


@pytest.mark.slow
def test_figures_of_maps_and_heights_are_measured_again() -> None:
    """The Moon's contrast, what coarse cells lose of the sample's heights, and cubic convolution beside quintic splines."""
    with rasterio.open(ROOT / "lcp_catalog/photometry/moon_albedo_643nm_11ppd.tif") as file:
        bright = file.read(1).astype(np.float64)
    middles_deg = 90.0 - 180.0 * (np.arange(len(bright)) + 0.5) / len(bright)
    weight = np.cos(np.radians(middles_deg))[:, None] * np.ones_like(bright)
    mean = np.average(bright, weights=weight)
    contrast = math.sqrt(np.average((bright - mean) ** 2, weights=weight)) / mean
    assert 100.0 * contrast == pytest.approx(ERRORS["brightness of the ground"].value, abs=0.5)

    with rasterio.open(ROOT / "sample_data/hadley_gld100_256ppd.tif") as file:
        z = file.read(1)
    rows, cols = z.shape
    cells = z.reshape(rows // 4, 4, cols // 4, 4).mean((1, 3))
    lost = z - ndimage.zoom(cells, 4, order=1, grid_mode=True, mode="nearest")
    assert lost[8:-8, 8:-8].std() == pytest.approx(ERRORS["cell size"].value, rel=0.02)

    v, u = (at.ravel() + 20.5 for at in np.indices((rows - 40, cols - 40)))
    ours = np.empty(u.size)
    heights.sample(z, 0, 0, 0, u, v, ours)
    splines = ndimage.map_coordinates(z.astype(np.float64), [v, u], order=5)
    apart = ours - splines
    assert apart.std() == pytest.approx(ERRORS["resampling of the DEM"].value, rel=0.05)
    assert np.abs(apart).max() == pytest.approx(7.3, abs=0.1)


def test_every_alternative_has_its_figures_on_the_sample() -> None:
    """Time, conditions changed, points lost and gained of each alternative to the sample's own configuration."""
    config = BuildConfig.from_toml(ROOT / "sample_data/hadley.toml").replaced(
        {"area.gsd_m": 473.802, "model.reflectance": "lunar-lambert:rolo"}
    )
    assert re.search(r"cells of 474 m.* [0-9a-f]{7,8}, 20\d\d-\d\d-\d\d$", SAMPLE)
    figures = r"(.+?): ([\d.]+), (0|[\d.]+ % \([\d.]+\.\.[\d.]+\)), \d+/\d+(?:; |$)"
    for one in APPROXIMATIONS:
        names = [found[0].removesuffix(" m") for found in re.findall(figures, one.sample)]
        own = [
            f"{float(name):.0f}" if one.name == "cell size" else name for name in one.values(config)
        ]
        assert names == own, one.name
        assert one.sample == "; ".join(
            m.group().rstrip("; ") for m in re.finditer(figures, one.sample)
        )


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
        max(_alternatives(narrow, "parallel or near views")["parallel"]["view.altitude_km"])
    )


def _alternatives(config: BuildConfig, name: str) -> dict[str, Any]:
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
        assert sum(row.startswith(f"| {one.name} |") and row.count("|") == 6 for row in rows) == 1
