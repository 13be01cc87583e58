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
from lcp_catalog.kernels.resampling import heights
from lcp_catalog.matching.templates import TOLERANCE_PX
from lcp_catalog.production.build_decisions import TURNED
from lcp_catalog.production.config import SUN_ELEVATIONS_DEG, BuildConfig, ViewConfig
from lcp_catalog.production.evaluation import STEP
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

FUNCTIONS = {"kernels.resampling.heights.sample", "light.bounced_light.bounced_at_points"}
"""Approximations that no constant marks; numbers within functions: `test_literals`."""

NO_APPROXIMATIONS = {
    # by package: limits of values, units, guards against rounding, figures that were measured, defaults of fields
    "catalog": (
        # limits of files, tolerances of checks, drawings, blocks
        "BLOCK_BYTES BYTES_MAX CARDS_MAX CELLS_MAX COVERAGE_STATUS COVERAGE_UNKNOWN "
        "DIGEST_BYTES FLAG_MASKS HOLES_MAX LEVEL_FACTORS MAP_PX NO_CELL PATCHES_MAX POINTS_MAX "
        "RECENT_BYTES STEPS UNIVERSAL_SHARE UNKNOWN WORST _ATTRIBUTE_BYTES_MAX _CELLS_AT_ONCE "
        "_CENTRE_TOLERANCE_M _CHUNK_BYTES _CHUNK_BYTES_MAX _CURVE_STEPS _DEFLATE_MOST _DISC_PX "
        "_ELEVATION_LIMIT_M _ELLIPSE_PX _FEW_VALUES _GRATICULE_DEG _JSON_DEPTH _LIGHT "
        "_HALF_LETTER_PX _MAP_NODES _MAP_POINTS _MAP_PX _MARGIN_PX _MOST_NODES _NEAR _PLACE_TOLERANCE_M "
        "_POINTS_AT_ONCE _ROTATION_TOLERANCE _SECONDS _SECONDS_PER_MB _SIGMA_RATIO _TEXT_BYTES "
        "_TOPS_DEG _TOUCHING _TURNS _UNREACHED _WAITING_BYTES _WHOLE_BYTES "
        # 2 to 4: axes of a variable, level of compression
        "FIXED _DEFLATE"
    ),
    "dem": (
        # error models of products: published or fitted, overruled by `errors.height_sigma_m`, `--map-sigma` and maps
        "LENGTH_PER_RESOLUTION SIGMA_PER_RESOLUTION UNKNOWN_SIGMA_M _FAMILIES _TIES "
        # sizes of blocks and windows, limits of files, pictures, how a resolution is measured
        "BAND_EDGES_DEG BAND_PX BAND_SHARE BETWEEN_AREAS EDGE_PX EXPONENT EXPONENT_SIGMA "
        "FACTOR GREATEST_M HOLE_PX LAW_LONGEST_M MOON_KM2 PIXELS_MAX PLACES_MIN POLAR_ERROR "
        "POLAR_WITHIN_DEG POSSIBLE_M RADIUS_KM RECENT_PIXELS SHAPES WINDOW_PX _APART_M "
        "_ARC_MAX _AROUND _BINS_PER_OCTAVE _BLOCKS _BLOCKS _BLOCK_BYTES _BLOCK_PIXELS _BLOCK_PX _BRIGHTNESS "
        "_CHANCE _CLIP _CLUSTERS _COARSER _CONDITION "
        "_CROWDED _CUTS _DEGREE_M _DEGREE_M _EQUAL_PX _FITTED _FULLY _FURTHEST_DEG _GAP_PX _KM "
        "_KM_SIDE_M _LATTICE _LEAST _LEAST _LEAST_SHARE _LONGEST _MISFIT _MOST _MOST_PRODUCTS "
        "_NARROWEST _NARROW_DEG _NODES _NOISES _OCTAVES_LEAST _OPEN_FILES _PAD _PAIRS "
        "_REPEATED _ROUNDS _ROWS_DEG _SEAM_MAX_DEG _SHORTEST _SLACK _SLOPE _SPARE_PX "
        "_ARCHIVE_BYTES_S _OPENING_S "
        "_STEPS_DEG _STEP_PX _STEP_SHARE _STRETCHED _TILE_BLOCKS _TILE_PIXELS _TILE_PX _TOLD _TRIED _UNKNOWN_TIE_M "
        "_WINDOW_PIXELS _WINDOW_PIXELS _ZEROS_PX "
        # tables of whole numbers
        "GAP GDAL_CACHE_BYTES INK LIMIT_BYTES PAPER PRODUCT_COLOURS TILES _CACHED_PIXELS "
        "_EDGE_POINTS _EDGE_POINTS_OF_SIDE _HATCH _HEAD_BYTES _HIGH _MANY _MARGIN _PACKED "
        "_POLAR _SWATCH _WIDE _XML_BYTES "
        # 2 to 4: windows read or kept, the least side, steps and rounds of a measurement
        "ACROSS DOWN REACH RECENT _MARGIN _ROUNDS _SIDE_MIN"
    ),
    "kernels": (
        # values of single precision, guards against rounding, numbers of results and of what is done at once
        "AT_ONCE BAND_ROWS COT_SMOOTH COS_HELD DISC_NUMBERS FACET FLAT FREE HEAD IN_PLANE LEAST "
        "LINES LOOKS LOOSE LOWEST NEAR_CAMERA NEVER NOWHERE NUMBERS NUMBERS NUMBERS ON_GRID "
        "ON_LINE ON_SURFACE_M PATIENCE READS SMALL SMALL_CELLS SNAP STEEPER SUNS TILE TILE TILES "
        "UNDERGROUND_M _ABOVE _ALONG _BAND_ROWS _BIAS _BITS _CLASS _CLASSES _DETERMINED _ENDLESS "
        "_FAR _FLAT _FLOOR _GONE _HALF _HALF _INF _INV_PI _INVERSE_ROOT_TWO_PI _KEPT _LANES "
        "_LEAST_VARIANCE _LN2 _LOG2E _LOWEST _NAN _NARROW _NEAR _ONE _ONE _ONE _PARTS "
        "LINKED _PARTS _PARTS _ROOT_HALF _RUN _RUN _RUN _SHIFT _SMOOTH _SPLITTER _SQRT_HALF _STEEP "
        "_STEPS _STEPS _STEPS _STEPS _STEPS _TAIL_END _TEXTURED _TINY _TINY _TOUCHING _TWO "
        "_TWO_PI _UNSORTED _ZERO _ZERO "
        # integrals whose rest is below 1e-6, bounds with their margins, the fit of a match, whose sigma is measured
        "BEYOND PART_DEG _APART _AT32 _FARTHEST_PX _FEWEST _LAGS _LAST_STEP_PX _LONGER _MISMATCH "
        "_NEAR_ZENITH_DEG _SAFETY _SETTLED_PX _SIGMAS _SURE _WEIGHTS32 _WHOLE_WEIGHTS points._MARGIN "
        # tables of whole numbers
        "POLAR_COS POLAR_SIN SIGMA_C SIGMA_P U_P V_P "
        # 2 to 4: codes of laws, sums in registers, fields of a product, the level where a ray starts
        "CAMERA_LEVEL FIELDS HAPKE LUNAR_LAMBERT MINNAERT PAIRS matching.template_products._FEW _ROWS _STRIP _TILE"
    ),
    "landmarks": (
        "AMBIGUOUS BLOCK BOUND_WORK COMMON_VARIANCE CONTRASTS EXCLUSION_PX GATE "
        "FARTHEST_PX FEWEST GROUP_GAIN HARRIS_K ID_ROWS MOST_POINTS MOST_SLACK_PX NODES RING RIVAL_Z "
        "SIGNIFICANT TYPICAL_CONTRAST UNITS_MAX WEIGHTS WRONG "
        "_CERTAIN _EXPONENTS _FIRM_PX _FLAT _GAIN _HIGH_PERCENTILE _LEAST_COSINE _LEAST_HEIGHT "
        "_LEAST_PERCENT _LEAST_SLOPE_SIGNAL _LEAST_VARIANCE _LOST _NEEDED _NEGLIGIBLE "
        "_POSITION_M _PROBITS_OF_SEARCH _REACH_PX _ROUNDING _SIGMA_PX _SPREAD _TOLERANCE_PX _Z "
        # tables of whole numbers
        "BOUND_STEPS _ID_STRIDE "
        # 2 to 4: unknowns of a camera, candidates of a cell, stages, places of a part
        "GROUP_EXTRA SPARE_STAGE USABLE_STAGE _MINIMAL _PLACES_LEFT"
    ),
    "light": (
        "CLEAR_SKY_RATIO DARKEST_SHARE EARTH_RADIUS_M HIGH_DEG "
        "MOST_SOURCES SEGMENT_DEG WIDEST_DEG _FLAT _FULL_SCALE _GOLDEN _J2000 "
        "_LOWEST_DEG _NEVER_UP_RAD _ROUNDING_DEG _SHIFTS _TAIL _WHITE_PERCENTILE "
        # tables of whole numbers
        "CHUNK _BLOCK_NODES _RANGE_PIXELS _RAYS "
        # 2 to 4: pixels of a plateau
        "_FLAT_PIXELS"
    ),
    "photometry": (
        "ALBEDO BOUNDS DISCS INTERVALS LAMBERT_ALBEDO LARGEST_EMISSION_DEG LEAST_POINTS LIMITS "
        "MEAN MINNAERT_ALBEDO MINNAERT_FLOOR MINNAERT_K OPTICS REC_709 SETS "
        "SINGLE_SCATTERING_ALBEDO SURFACES TABLE_1 TABLE_2 TABLE_3 WEIGHT _BLOCK_ROWS _DENSEST "
        "_GAIN _GAP_DEG _LEVEL_DEG _NO_CONTRAST _PER_SIGMA _QUADRATURE _QUADRATURE _RANGES "
        "_SAMPLE_NODES _STARTS _STEPS _SWEEPS _THETA_DEG _UNIT "
        # tables of whole numbers
        "TABLE_2_LOST "
        # 2 to 4: starts of a fit that are refined: as good as five
        "_REFINED"
    ),
    "production": (
        "AREAS_MAX AREA_NODES_MIN BANDS_DEG CONDITIONS_MAX COVERAGE_BYTES COVERAGE_CELLS "
        "FOOTPRINT_MAX_KM FOOTPRINT_NODES LARGE_NODES LENGTH_MAX_M LEVELS_MAX LEVEL_FACTOR_MAX "
        "LOCATED LOCATED_MAX LOCATED_MIN OVERVIEW_NODES PART_STEP PER_VIEW_MAX PLACE_PER_LENGTH "
        "POLAR_ELEVATIONS_DEG POLAR_SUN_DEG SEARCH_MAX_M SEARCH_NODES SPACING_MAX_M "
        "SUN_ELEVATIONS_DEG TURNED_DEG TURNED_MOST UNIT _BALL_NODES _BATCH_NODES _BYTES_BESIDE "
        "_CURVE_STEPS _ERROR_PLACES _FILE_BYTES recipe._FINEST "
        "_LATITUDE_STEP_DEG _LATTICE_MAX _LEAST_CHANCE _LEAST_M _LINKS _NODES_MOST _PAIRS_MOST "
        "_PROCESSES _READ_AT_ONCE _READ_BYTES_S _READ_SHARE _ROWS _SAFETY "
        "_SAMPLED _SAMPLES _SHORT _SHOWN _SLACK_RAD _TOGETHER _WORST "
        # tables of whole numbers
        "BLOCK_BYTES SEARCH_MAX_NODES SPACING_MIN_NODES _DISC _DISCS _EVALUATED _RANK "
        "_READ_BYTES _SMALL_BYTES "
        # 2 to 4: fields of a table, borders, groups of Suns
        "CORNER_BORDER SECTORS SITE _PARTS"
    ),
    "rendering": (
        "DISC_SHIFT DISC_SHIFT_DEG NORMAL_ROUNDING_RAD PROBES_MOST RING_MAX_M SIZE_MAX_KM STORED "
        "TILE WHITE_PERCENTILE _AXIS_STEPS _BLOCK_ROWS _BLOCK_ROWS _CELLS_MOST _EXTENT_MAX_M "
        "_FACING _GAMMA _MARGIN _NODES _RADIUS_UP _SAMPLES _SAMPLES _SHAPE _SLOPE_NODES _TURNS "
        "_WHITE_PERCENTILE "
        # tables of whole numbers
        "_BLOCK_PIXELS _CHUNK _CORNERS_AT_ONCE _PIXELS_AT_ONCE _RUNGS "
        # 2 to 4: least side of a block
        "_CELLS_LEAST"
    ),
    "terrain": (
        "BLOCK_ROWS CELL_PER_RESOLUTION LOCAL_MAX_DEG OFF_SHARE STEEPEST _BLOCK_NODES _EDGE "
        "_ITERATIONS _LEAST_STRIDE _LIMB _NODES_MAX _PLACES _ROUNDING _SLACK_OCTAVES _TOLERANCE_M "
        # tables of whole numbers
        "_BLOCK _BLOCKS "
        # 2 to 4: a level of a pyramid
        "_TILE"
    ),
    "matching": (
        # method of a search in an image and of a fix: what is accepted is judged by its number of false alarms
        "AS_STATED FAINT FAR_TURNS_DEG HIGHEST_RAD HUBER JUDGED_BELOW_DEG "
        "LEAST_COVER LEAST_ELEVATION_DEG LEAST_GAIN LEAST_LIKENESS LEAST_SIGMA_PX "
        "LEAST_TURN_DEG LEAST_USABLE LOWERED NO_CLAIM RAISED "
        "RAISE_LIMITS_DEG RESOLUTION_SHARE SHARE_IF_HERE SHOWS SIGMAS STEP_PX TURNS_DEG "
        "TURNS_DEG USUAL _AT_EDGE _BACK_COVER _BACK_REACH _CHUNK _CHUNK _CHUNK _CHUNK "
        "_CHUNK_OFFSETS _CHUNK_PX _CONDITION _CONE_MARGIN _CONVERGED _DRAWS _FARTHEST _FARTHEST "
        "_FEW _FEWEST _FILL_PX _FLOOR_PX _GLANCE_POINTS _GRID_PX _INNER _KEPT _LEAST_CELLS "
        "_LEAST_MOVING _LEAST_REAL _LEAST_SHARE _LEVELS _LOOKED_AT _LOOSEST _MOST _MOST_NEEDED "
        "_MOST_POINTS _MOST_SIGMA_PX _NARROWEST_PX _NEARLY_ALL _NEAR_PX _PLATEAU "
        "_REACH_PX _ROUNDS _ROUNDS _SEEN_DEG _SETS _SMALLEST_PX _SMOOTH_DEG _SMOOTH_FROM_DEG "
        "_SMOOTH_OVER_DEG _STEPS _STILL _SUB _SURE_SHARE _TELLS _TURN_SIGMAS _UP "
        "_WIDEST_PX _WIDEST_PX "
        # 2 to 4: passes that end when nothing moves, what is tried first
        "SIDEWAYS_DEG _GLANCE _PASSES _ROUGH _SUN_PX"
    ),
    "cameras": (
        # limits of files, steps of iterations that end at a tolerance, what a warning says, blocks
        "BEYOND CORNER_PX FARTHEST_M FRAME_PIXELS_MAX LARGEST ORIGIN_HEIGHT_M SUN_NEAREST_M "
        "_ALIKE_DEG _AT_ONCE _BACK _CENTURY_S _COARSEST_MM _COARSE_M _COMPLEX_STEP _CONVERGED "
        "_DEEPEST_M _DOWN_DEG _ENDS_S _GRID _JUMP _KNOTS _MEAN_EARTH _MEAN_EARTH _MOST_STEPS "
        "_NAC _NEAREST _NO_TERM _OFF_CENTRE _RADIUS_TOLERANCE _RECORD _ROTATION_TOLERANCE _ROWS "
        "_SAME _SKEWEST _SPARE _STEPS _SUN_M _TOLERANCE _TURNED_ROUND_RAD _UNIT _UNITS_M "
        "_UNIT_TOLERANCE _UP _VELOCITY_M _VELOCITY_SHARE _WIDEST_DEG _WINDOWS "
        # 2 to 4: what a warning names, units of keywords
        "KEYWORDS _MOST"
    ),
    "navigation": (
        # drawings, limits of files, blocks
        "FIRST_SIGMAS FRAMES FRAMES_MAX NUMBERS_SHOWN PAIRS_AT_ONCE PROMISED WHOLE _BOTTOM _COUNTS _DRAWN _FIELD_DEG _GRID _HEIGHT "
        "_LEFT _LOW_DEG _MOSTLY _RIGHT _TICKS _TOP _UNITS _UNIT_TOLERANCE _WIDTH _WIDTH "
        # 2 to 4: what a message names, points of a position
        "LEAST_POINTS _NAMED"
    ),
    "geometry": (
        # limits of maps
        "RADIUS_RANGE_M _EDGE _POLAR_REACH_DEG"
    ),
    "exports": (
        # limits and fields of formats, blocks
        "ALONE_S DEPENDENT GAP_S NONE NO_SUN PLATES_MAX STEPS TILE_POINTS _ANGLES _ARCSECOND "
        "_BLOCK_BYTES _CENTURY_S _DEGREE _FINE_SCALE _INDEX _LARGEST _LONGEST_S _LONGEST_S "
        "_MOON _MOST_MB _NAMES _NODES _RECORD _ROOM_BYTES _SIDE _UNKNOWN _VOXELS_AND_LISTS "
        "_WORK "
        # 2 to 4: fields and scales of formats
        "_COARSE_SCALE _HEAD"
    ),
    "simulation": (
        # limits of a detector, blocks
        "BITS_MAX BLUR_MAX_PX BRIGHT_PERCENTILE BRIGHT_SHARE _LIT_SHARE _RAYS_AT_ONCE _SHARP_PX "
        # 2 to 4: limits of a default that an option replaces
        "SAMPLES_LEAST SAMPLES_MOST"
    ),
    "images": (
        # limits of files, codes of formats, blocks
        "DEEP_SHARE LEAST_DEPTH_M LEAST_RELIEF_M LONGEST_SPAN_S PLATEAU_FACTOR PLATEAU_LEAST "
        "_FLOAT_CODES _INTEGER_CODES _MOST_PIXELS _WINDOWS _WINDOW_PX "
        # 2 to 4: pixels beside a plateau
        "PLATEAU_NEIGHBOURS"
    ),
    "ephemeris": (
        # calendars, decimals that are shown, limits
        "DECIMALS ERROR_YEARS FIRST_YEAR LAST_YEAR MOST_INSTANTS SUNS_DIFFER_DEG "
        "_AHEAD_OF_TAI_S _CHUNK _SECONDS"
    ),
}
"""Other constants of floating point, and whole numbers above 1; a new one belongs here, once for each module
that has it, or in the registry."""

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
        lost = [
            100.0 * max(map(int, found)) / 28 for found in re.findall(r"(\d+)/(\d+)", one.sample)
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
        "steps of the flight file": 0.5 * 180.0 / ANGLE_STEPS,
        "rounding of height errors": 100.0 * (math.exp(0.5 * STEP) - 1.0),
        "one direction to the Sun from an area": math.degrees(half_m / ASTRONOMICAL_UNIT_M),
    }
    for name, value in told.items():
        assert ERRORS[name].value == pytest.approx(value, rel=0.02), name
    exact = {one.name for one in APPROXIMATIONS if one.error.basis in {EXACT, LIMIT}}
    assert exact - set(told) == {"shape of the ground"}
    assert 100.0 * TIERS["draft"].sky_rms == ERRORS["light other than the Sun's"].value


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
