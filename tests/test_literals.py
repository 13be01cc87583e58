"""Numbers inside functions of the code that computes: an approximation that is only a number in a function has no name
that the registry could hold, so each is listed here with the reason why it is none, or becomes a constant.

A number that needs no reason is 0, 1, 2, 3, 4, a half or a quarter, 90, 180, 360 or 1000 (degrees, metres), or guards
against rounding and division by zero (up to 1e-9, from 1e9). In a comparison, a limit, a grid and a default these are fewer
(`PLAIN_LIMITS`). An index and the shape of an array (`SHAPES`) are none of these numbers.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from test_approximations import COMPUTES, RUNS

LIBRARY = Path(__file__).resolve().parents[1] / "lcp_catalog"

PLAIN = {0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 90.0, 180.0, 360.0, 1000.0}
PLAIN_LIMITS = {0.0, 1.0, 2.0, 90.0, 180.0, 360.0}
SHAPES = {"empty", "zeros", "ones", "full", "reshape", "broadcast_to", "eye", "IntType"}
LIMITS = {"min", "max", "clip", "minimum", "maximum", "linspace", "arange", "range"}

LISTED: dict[str, str] = {
    "a formula, exact or from a publication that the function names": """
        landmarks.corners 15.865 84.135 100
        landmarks.error_model 6
        landmarks.ground_votes 10
        landmarks.located 10 100
        landmarks.patches 12
        landmarks.point_spread 12
        light.environment_map 0.5
        light.sources 0.0002054 0.0002054 0.00106 0.00106 0.4 10
        terrain.occlusion 32
        terrain.useful_cell 100
        photometry.albedo_map 100
        photometry.hapke_sets 0.078 0.908 1.209 1.5 1.5 2.459 3.29 17.4
        photometry.law_choice 100
        photometry.laws 1e-05 30 30
        photometry.srgb 0.04045 0.055 1.055 2.4 12.92
        rendering.renderer 0.5 0.5 0.5 0.5
        rendering.sphere_renderer 0.5 6 8 15
        production.area_job 0.5
        production.promise 5
        kernels.matching.point_spread 1.5 12
        kernels.matching.registration 0.15 0.75 12 24 60
        kernels.matching.rivals 0.5
        kernels.matching.subpixel_fit 4
        kernels.photometry.images 0.5
        kernels.photometry.laws 1.46e-06 0.000242 0.019 1.5 1.5
        kernels.rays.horizon 0.5
        kernels.resampling.area_means 0.5 0.5 0.5 0.5 5 8
        kernels.resampling.heights 0.5 0.5 0.5 0.5 0.5 0.5 1.5 1.5 2.5 5 7 9 11 13 15 17 19 21 23
        kernels.sphere_rays 6 6
        rendering.sphere_renderer 5
    """,
    "kilometres, microseconds, megabytes, per cent": """
        light.sun_choice 1e6
        light.sun_visibility 0.001
        terrain.area 500 500
        rendering.placement 0.002 1000
        rendering.public 0.001
        rendering.request 500
        rendering.decisions 100 100 100 100 100 100
        production.build_decisions 100 100
        light.environment 100 100
        production.area_job 1e6 1e6
        production.run 1000
        landmarks.located 100
        rendering.public 255
    """,
    "a guard against rounding, overflow and division by zero": """
        catalog.prediction 1e-06 1e-06 1e-06 1e-06
        landmarks.detection 1e-06 0.001 0.01 0.99 0.99
        landmarks.located 0.01
        light.solar_disc 0.0001 89.9
        light.sun_visibility 89
        terrain.area 1e-06
        terrain.terrain 1e-06
        photometry.albedo_map 0.01
        rendering.error_bounds 1.1
        rendering.sphere_renderer 0.001
        production.config 1.01
        production.point_config 31 31 31
        kernels.matching.point_spread 1e-06
        kernels.matching.subpixel_fit 1e-06
        production.first_look 9
        production.region_maps 9
        terrain.occlusion 8 8 8 16
    """,
    "what is accepted: limits of values, at least half of a cell known, defaults that the configuration replaces": """
        catalog.prediction 0.5
        landmarks.error_model 0.02 0.05 10 500 2000
        light.sources 0.5 0.5 5 6 45
        light.environment_map 0.5
        terrain.area 720 720
        terrain.terrain 10
        photometry.facet_model 0.008 0.01 0.1 0.43 0.45 0.8 1.5 5 89 100 100 1000
        photometry.hapke_sets 60
        rendering.placement 0.5
        production.build_decisions 0.0005
        production.config 15 50 50 50 50 270
        production.error_config 0.07 0.08 0.09 0.11 0.9 100 1900
        production.finished_area 0.5
        production.model_config 0.05 10 400 3000
        production.point_config 0.1 0.1 0.9 0.9
        production.promise 0.4 4 4
        kernels.resampling.heights 0.5 0.5
        kernels.sun_moments 0.5
        kernels.photometry.facet 3
        landmarks.detection 0.5 0.5
        light.environment_map 3
        production.model_config 512 4096
        production.point_config 9 33 64 100 257 1024
    """,
    "steps of a search or a fit whose result is held to a tolerance, and grids of bounds with a margin": """
        landmarks.patches 0.1 3 4 40
        landmarks.selection 0.0001 0.05 1.5 5
        light.bounced_light 60 89.5
        light.solar_disc 1441
        light.sources 0.1 8 9 256
        terrain.terrain 33 33
        photometry.facet_fit 1e-08 1e-05 0.01 0.05 0.1 4 5 6 89 89.9 89.9 361
        rendering.placement 65 65
        rendering.sphere_renderer 33
        production.promise 8 16
        production.region_maps 8
        kernels.matching.acquisition 10
        kernels.photometry.facet 3
        kernels.resampling.heights 0.5
        photometry.albedo_map 129
        photometry.facet_fit 400
        rendering.placement 17
    """,
    "how many are computed at once, and in which order": """
        kernels.matching.patches 6 7 7
        kernels.matching.rivals 8 8 8 8 8
        kernels.matching.template_products 8 8 8
        kernels.rays.bundles 0.6180339887498949
        kernels.cpu_level 8 16
        kernels.matching.noise 8 8
        kernels.matching.patches 7
        kernels.matching.rivals 7 7 8 8
        kernels.matching.search 9 9
        kernels.shadows.draft 4
        landmarks.error_model 8 256
        production.area_job 1024
        terrain.occlusion 4
    """,
    "places in a stack of arrays or a table, axes of space, corners, bits and bytes of files, numbers of a hash": """
        catalog.prediction 4
        kernels.cache 16 420
        kernels.matching.correlation 3
        kernels.matching.draw_patch 4 4
        kernels.matching.noise 4 5 6 6 7
        kernels.matching.patches 3
        kernels.matching.point_spread 3 5
        kernels.matching.registration 3
        kernels.matching.subpixel_fit 3
        kernels.photometry.facet 6 8 10 13 13
        kernels.points 17 73856093 19349663 83492791
        kernels.resampling.area_means 3 3
        kernels.resampling.heights 4
        kernels.shadows.draft 255
        kernels.shadows.steep_tiles 60
        kernels.sphere_rays 4
        kernels.vectors 16 23 127
        landmarks.selection 5
        photometry.albedo_map 3
        production.checkpoints 16 64 420
        production.config 5
        rendering.renderer 4
    """,
    "neighbours of a corner, which the number of candidates limits": "landmarks.corners 8",
}
"""Numbers by reason, each as often as it stands in the module."""


QUADRATURES = {"leggauss", "hermegauss", "hermgauss", "laggauss", "chebgauss"}
ORDERS = {"order", "deg", "degree", "iterations"}

COUNTED = {
    "the rest of the integral is below 1e-7 of the disc's flux, and rounding": "ephemeris.limb_darkening 2 32",
    "the rest of the integral is below 1e-6": "kernels.matching.acquisition 32",
    "61 in place of 15 change 0.0002 of a probability (a row of the registry)": "landmarks.located 15",
    "bisection down to rounding": """
        landmarks.patches 40
        validation.error_fit 60
    """,
    "the second looks between two steps of the first, so that a place is known to 1e-6 of the stretch": "rendering.placement 2",
    "attempts, digits of a name, levels of frames": """
        atomic_files 2
        cameras.spice 10
        exports.landmarks 5
    """,
}
"""Numbers of steps, of nodes of a quadrature and orders of interpolation, whatever their size, by reason."""


def is_plain(value: float, limit: bool) -> bool:
    """True for a number that needs no reason."""
    size = abs(value)
    if size in PLAIN_LIMITS or 0.0 < size <= 1e-9 or size >= 1e9:
        return True
    return not limit and size in PLAIN


def _numbers(node: ast.AST, limit: bool) -> Iterator[float]:
    """The numbers below a node that need a reason; ``limit``: it is compared, a limit or a grid."""
    if isinstance(node, ast.Constant):
        value = node.value
        if (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and not is_plain(value, limit)
        ):
            yield float(value)
        return
    if isinstance(node, ast.Subscript):  # an index
        yield from _numbers(node.value, False)
        return
    called = node.func if isinstance(node, ast.Call) else None
    name = getattr(called, "id", getattr(called, "attr", ""))
    if name in SHAPES:
        return
    own = (
        (limit and isinstance(node, ast.UnaryOp | ast.BinOp))
        or isinstance(node, ast.Compare | ast.arguments)
        or name in LIMITS
    )
    for part in ast.iter_child_nodes(node):
        yield from _numbers(part, own)


def walk(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a syntax tree, in any order; in less than half the time of `ast.walk`."""
    left = [tree]
    while left:
        node = left.pop()
        yield node
        for value in vars(node).values():
            if isinstance(value, ast.AST):
                left.append(value)
            elif isinstance(value, list):
                left += [one for one in value if isinstance(one, ast.AST)]


@cache
def literals(source: str) -> Counter[float]:
    """The numbers in functions and in classes of a module that need a reason."""
    found: Counter[float] = Counter()
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.update(_numbers(node, False))
    return found


def counts(source: str) -> Counter[float]:
    """Numbers from 2 on of passes of a loop that does not use which pass it is, of nodes of a quadrature, and orders."""
    found: list[ast.expr] = []
    for node in walk(ast.parse(source)):
        if isinstance(node, ast.For) and isinstance(node.iter, ast.Call):
            used = {
                n.id
                for part in node.body
                for n in walk(part)
                if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)
            }
            if not used & {n.id for n in walk(node.target) if isinstance(n, ast.Name)}:
                found += node.iter.args
        elif isinstance(node, ast.Call):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            found += node.args if called in QUADRATURES else []
            found += [word.value for word in node.keywords if word.arg in ORDERS]
    values = [node.value for node in found if isinstance(node, ast.Constant)]
    return Counter(float(v) for v in values if type(v) is int and v > 1)


def modules() -> dict[str, str]:
    """Sources of the modules that compute, by name."""
    paths = [LIBRARY / "catalog" / "prediction.py"]
    for folder in COMPUTES:
        paths += [p for p in sorted((LIBRARY / folder).rglob("*.py")) if p.stem not in RUNS]
    return {
        ".".join(p.relative_to(LIBRARY).with_suffix("").parts): p.read_text(encoding="utf-8")
        for p in paths
    }


def listed(reasons: dict[str, str] = LISTED) -> dict[str, Counter[float]]:
    """The numbers of such a list by module."""
    found: dict[str, Counter[float]] = {}
    for rows in reasons.values():
        for row in rows.strip().splitlines():
            module, *numbers = row.split()
            found.setdefault(module, Counter()).update(float(n) for n in numbers)
    return found


def unexplained(sources: dict[str, str]) -> list[str]:
    """Numbers without a reason, and reasons without a number, as lines for who added or removed them."""
    known = listed()
    lines = []
    for module in sorted({*sources, *known}):
        there = literals(sources[module]) if module in sources else Counter()
        mine = known.get(module, Counter())
        new, gone = (there - mine).elements(), (mine - there).elements()
        lines += [
            f"{module}: {v:g} in a function: make it a constant of `approximations`, or list it here"
            for v in new
        ]
        lines += [f"{module}: {v:g} is listed and no longer there" for v in gone]
    return lines


def test_every_number_in_a_function_that_computes_has_a_reason() -> None:
    assert unexplained(modules()) == []


@pytest.mark.parametrize(
    "added",
    [
        "def _far(x):\n    return x * 0.97",
        "def _few(x, least=0.07):\n    return x",
        "def _near(a, b):\n    return abs(a - b) < 0.5 * a",
        "def _near(a, b):\n    return min(a, 0.25)",
        "def _steps(x):\n    return sum(x for _ in range(12))",
        "class Fit:\n    step: float = 0.3",
        "def _wide(x):\n    return x * 7",
        "def _few(x, least=3):\n    return x",
        "def _many(x):\n    return x.size > 4",
    ],
)
def test_a_number_that_is_added_to_a_function_is_noticed(added: str) -> None:
    for module in ("kernels.rays.tracing", "terrain.occlusion", "landmarks.uniqueness"):
        sources = modules()
        sources[module] += f"\n\n{added}\n"
        assert len(unexplained(sources)) == 1
        assert module in unexplained(sources)[0]


def test_a_reason_whose_number_is_gone_is_noticed() -> None:
    sources = modules()
    sources["photometry.srgb"] = ""
    assert len(unexplained(sources)) == 5


def test_indices_halves_and_degrees_need_no_reason() -> None:
    plain = "def f(x):\n    if x.ndim == 2 and x[7] > 0.0:\n        return 0.5 * x[12] + 90.0 - 1e-12\n    return x.reshape(5, 6)"
    assert not literals(plain)


def test_every_number_of_steps_has_a_reason() -> None:
    found = {
        ".".join(path.relative_to(LIBRARY).with_suffix("").parts): counts(path.read_text("utf-8"))
        for path in LIBRARY.rglob("*.py")
    }
    assert {name: numbers for name, numbers in found.items() if numbers} == listed(COUNTED)


@pytest.mark.parametrize(
    ("code", "number"),
    [
        ("def f(x):\n    for _ in range(3):\n        x = g(x)", 3),
        ("def f(x):\n    return leggauss(2)", 2),
        ("def f(x):\n    return ndimage.zoom(x, 0.5, order=4)", 4),
        ("def f(x):\n    for k in range(3):\n        x = g(x, k)", None),
        ("def f(x):\n    return np.asarray(x, order='C')", None),
    ],
)
def test_numbers_of_steps_are_seen(code: str, number: int | None) -> None:
    assert counts(code) == Counter([] if number is None else [float(number)])
