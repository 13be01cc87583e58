"""The layout of the code: the order of the sub-packages, and which of them may import what.

Everything is read from the source; nothing is imported.
"""

from __future__ import annotations

import ast
import functools
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = sorted((ROOT / "lcp_catalog").rglob("*.py"))
COMMANDS = sorted((ROOT / "cli").glob("*.py"))

ORDER = [
    "kernels",
    "geometry",
    "plots",
    "landmarks",
    "pds",
    "ephemeris",
    "dem",
    "cameras",
    "terrain",
    "photometry",
    "light",
    "images",
    "rendering",
    "catalog",
    "exports",
    "production",
    "matching",
    "navigation",
    "simulation",
    "validation",
    "tradeoff",
]
"""From bottom to top: a sub-package imports only those before it. Modules of the root are below all."""

FENCES = {
    # package: sub-packages or modules of the library that may import it
    "rasterio": {"dem", "rendering", "images"},
    "cv2": {"plots", "landmarks", "matching", "light", "threads"},
    "h5py": {"catalog"},
    "distributed": {"production"},
    "click": set(),
    "numba": {"kernels", "threads"},
    "llvmlite": {"kernels"},
    "erfa": {"ephemeris", "light"},
    "scipy": {"dem", "images", "landmarks", "matching", "photometry", "tradeoff", "validation"},
    "jinja2": {"plots"},
}


@functools.cache
def nodes(path: Path) -> list[ast.AST]:
    """The imports and calls of a file."""
    kinds = (ast.Import, ast.ImportFrom, ast.Call)
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, kinds)]


@functools.cache
def imports(path: Path) -> set[str]:
    """Absolute names of the modules that a file imports."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            name = ".".join(part for part in (base, node.module or "") if part)
            found |= {f"{name}.{alias.name}" for alias in node.names}
    return found


def place(path: Path) -> str:
    """The sub-package of a module of the library, or the module's own name at the root."""
    return path.relative_to(ROOT / "lcp_catalog").with_suffix("").parts[0]


def test_every_sub_package_has_its_place_in_the_order() -> None:
    assert {path.parent.name for path in LIBRARY if path.parent.parent.name == "lcp_catalog"} == {
        *ORDER
    }


def test_imports_go_down() -> None:
    """A sub-package imports those below it and itself; modules of the root import only the root."""
    rank = {name: k for k, name in enumerate(ORDER)}
    upward = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path in LIBRARY
        for name in imports(path)
        if name.startswith("lcp_catalog.") and path.name != "__init__.py"
        if rank.get(name.split(".")[1], -1) > rank.get(place(path), -1)
    ]
    print(*ORDER, sep=" < ")
    assert upward == []


def test_kernels_import_nothing_of_ours_but_constants() -> None:
    for path in (ROOT / "lcp_catalog" / "kernels").rglob("*.py"):
        ours = {name for name in imports(path) if name.startswith("lcp_catalog")}
        assert all(
            name.startswith(("lcp_catalog.kernels", "lcp_catalog.constants")) for name in ours
        ), path


def test_third_party_packages_stay_behind_their_fences() -> None:
    for package, allowed in FENCES.items():
        users = {
            place(path)
            for path in LIBRARY
            if any(name.split(".")[0] == package for name in imports(path))
        }
        assert users <= allowed, package


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


def test_every_sub_package_is_installed() -> None:
    """An editable install finds what `packages` forgets; a wheel does not."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for path in LIBRARY
        if path.name == "__init__.py"
    }
    sample = {f"lcp_catalog.{name}" for name in ("howto", "reference", "sample_data", "flight")}
    sample |= {"lcp_catalog.plots.templates"}
    sample |= {f"lcp_catalog.sample_data.{name}" for name in ("pipeline", "schemas", "examples")}
    assert {*listed["tool"]["setuptools"]["packages"]} == {*packages, *sample, "lcp_cli"}


def test_every_data_file_is_installed() -> None:
    """Each file of the library that is not Python matches a declared pattern of its package."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = declared["tool"]["setuptools"]["package-data"]
    found = {
        file
        for package, names in patterns.items()
        for name in names
        for file in (ROOT / Path(*package.split("."))).glob(name)
    }
    there = {
        path
        for path in (ROOT / "lcp_catalog").rglob("*")
        if path.is_file() and path.suffix != ".py" and "__pycache__" not in path.parts
    }
    assert there == found
    flight = {"", ".h", ".c", ".lcpf", ".pgm", ".txt"}
    assert {path.suffix for path in found} == {
        ".j2",
        ".css",
        ".js",
        ".json",
        ".typed",
        ".tif",
        *flight,
    }
    assert ROOT / "lcp_catalog" / "py.typed" in found
