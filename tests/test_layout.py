"""The fences of the house: who may import what. Read from the source, so that nothing has to be run."""

from __future__ import annotations

import ast
import functools
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = sorted((ROOT / "lcp_catalog").rglob("*.py"))
COMMANDS = sorted((ROOT / "cli").glob("*.py"))
TESTS = sorted((ROOT / "tests").glob("*.py"))

LINES_MAX = 400
"""A module answers one noun; a longer one answers two (house rules)."""

FENCES = {
    # package: modules of the library that may import it
    "rasterio": {"raster", "raster_out", "image_pixels"},
    "cv2": {"landmarks", "match", "threads", "image_file", "pnp"},
    "h5py": {"catalog"},
    "distributed": {"engine"},
    "click": set(),
    "numba": {"kernels", "threads"},
    "scipy": {"facet_fit"},
    "erfa": {"instants", "sun", "earthshine"},
}

FLOORS = [
    # from the ground up: a module imports only modules of lower floors, or its own
    {"_version", "errors", "constants"},
    {
        "sphere",
        "rotations",
        "inversion",
        "json_fields",
        "lens",
        "kernels",
        "threads",
        "files",
        "schema",
        "pvl",
        "accuracy",
        "instants",
        "products",
        "seams",
        "cap",
        "point_spread",
        "windows",
        "grid_shifts",
    },
    {
        "config",
        "samples",
        "footprints",
        "claims",
        "crs",
        "label",
        "pds4",
        "grid",
        "gridded",
        "raster",
        "pixel_survey",
        "datasets",
        "parallels",
        "regions",
        "map_views",
        "hapke_sets",
        "facet",
        "facet_tables",
        "facet_file",
        "goniometer",
        "image_file",
        "special_pixels",
        "isis_tables",
        "terraces",
        "map_projection",
        "phase_functions",
        "focal_plane",
        "trajectory",
    },
    {
        "heightfield",
        "sun",
        "camera",
        "camera_file",
        "isd",
        "isd_optics",
        "isd_tables",
        "scanners",
        "tsai",
        "reflectance",
        "dem",
        "albedo_pixels",
        "view",
        "sphere_rays",
        "panorama",
        "sensors",
        "pose",
        "pnp",
        "consensus",
        "photo",
        "detector",
        "map_image",
        "image_pixels",
        "image_label",
        "matches",
        "raster_out",
        "png",
        "page",
        "plates",
        "bitmap_font",
        "flags",
    },
    {
        "block_cache",
        "integrity",
        "demset",
        "layers",
        "disagreement",
        "dem_survey",
        "set_coverage",
        "set_map",
        "checks",
        "shadow_lines",
        "limb_darkening",
        "far_terrain",
        "facet_fit",
        "panorama_models",
        "panorama_sources",
    },
    {"shadows", "horizons"},
    {"terrain", "contents", "solar_disc", "sun_table"},
    {"relief", "lighting", "dem_resolution"},
    {"albedo", "panorama_sky", "earthshine", "environment", "risen", "ortho"},
    {"scene_bounds", "surroundings", "model_choice"},
    {"local_horizon", "sphere_bounds"},
    {"scene_effects"},
    {"scene"},
    {"render", "sphere_render", "sphere_plan", "landmarks", "sweep", "plan"},
    {"catalog", "evaluate", "compositing", "node_pixels", "patch_render", "search_image", "usable"},
    {"coarse_match"},
    {"match"},
    {"search_area", "light_check"},
    {"whole_ground"},
    {"locate"},
    {"job"},
    {"shards", "engine", "assemble"},
    {"build", "phase_curves", "charts", "request", "photo_file"},
    {"sphere_scene", "render_area"},
    {"exposure"},
    {"render_file", "simulate"},
    {"simulate_patches", "simulate_file", "ground_comparison"},
    {
        "summary",
        "estimate",
        "tradeoff",
        "trade_points",
        "trade_images",
        "trade_models",
        "trade_runs",
        "verdict",
    },
    {
        "facet_plot",
        "report",
        "trade_plot",
        "trade_model_report",
        "trade_report",
        "requirement",
        "match_table",
        "match_charts",
        "window_charts",
        "windows_section",
        "points_section",
        "pose_section",
        "validation_report",
    },
    {"validate"},
    {"validation_files"},
]


@functools.cache
def nodes(path: Path) -> list[ast.AST]:
    """The imports and calls of a file."""
    kinds = (ast.Import, ast.ImportFrom, ast.Call)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, kinds)]


@functools.cache
def imports(path: Path) -> set[str]:
    """Absolute names of everything a file imports; its own package's modules as ``lcp_catalog.x``."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            name = ".".join(part for part in (base, node.module or "") if part)
            found |= {name} if node.module else {f"{name}.{alias.name}" for alias in node.names}
    return found


def room(path: Path) -> str:
    return path.relative_to(ROOT / "lcp_catalog").with_suffix("").parts[0]


@pytest.mark.parametrize("modules", [LIBRARY, COMMANDS, TESTS], ids=["library", "cli", "tests"])
def test_no_module_has_grown_two_subjects(modules: list[Path]) -> None:
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in modules}
    assert {path.name: n for path, n in lines.items() if n > LINES_MAX} == {}


@pytest.mark.parametrize("package", FENCES)
def test_only_its_rooms_import(package: str) -> None:
    users = {
        room(path)
        for path in LIBRARY
        if any(name.split(".")[0] == package for name in imports(path))
    }
    assert users <= FENCES[package]


@pytest.mark.parametrize(
    "path", [p for p in LIBRARY if room(p) != "__init__"], ids=lambda p: p.stem
)
def test_imports_go_down(path: Path) -> None:
    floor = {name: level for level, names in enumerate(FLOORS) for name in names}
    own = room(path)
    assert own in floor, f"{own} has no floor: say in FLOORS where it stands"
    for name in imports(path):
        parts = name.split(".")
        if parts[0] == "lcp_catalog" and len(parts) > 1 and parts[1] != own:
            assert floor[parts[1]] <= floor[own], f"{own} imports {parts[1]}, which stands above it"


def test_kernels_import_nothing_of_ours_but_constants() -> None:
    for path in (ROOT / "lcp_catalog" / "kernels").glob("*.py"):
        ours = {name for name in imports(path) if name.startswith("lcp_catalog")}
        assert all(
            name.startswith(("lcp_catalog.kernels", "lcp_catalog.constants")) for name in ours
        ), path


def test_the_library_never_prints_or_exits() -> None:
    for path in LIBRARY:
        calls = [
            node.func.id
            for node in nodes(path)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        ]
        assert not {"print", "exit", "quit", "input"} & set(calls), path


def test_commands_hold_no_science() -> None:
    for path in COMMANDS:
        heavy = {name.split(".")[0] for name in imports(path)} & {
            "numpy",
            "cv2",
            "h5py",
            "numba",
            "rasterio",
            "erfa",
        }
        assert not heavy, f"{path.name} imports {heavy}"
