"""The project stays within its budgets of size (`.ci/sizes.py` prints the figures)."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

_FILE = Path(__file__).resolve().parents[1] / ".ci" / "sizes.py"


def _module() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sizes", _FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SIZES = _module()


BUDGETS = {
    # What issue 33 left, and lines that later issues added, rounded; commits and closing notes say for what
    # 4100; 34: 620 failing calls and commands; 35: 162 located frames, Kaguya, the pole; 36: 355 Embree, the strong
    # pipeline, regions beside it; 37: 390 which matcher survives which Sun; 39: 180 the flight file; 33 took away 597
    "code lines, benchmarks": 5209,
    # 40 430
    # 34: 890 pipes, failed reads, cut and sparse files, implausible DEMs, digests handed on, exports
    # 35: 1508 error models and their fit, tops that noise raises, places of maps, whole ground, the Sun, promises of footprints
    # 36: 1750 compiled files and how they are compiled, indexes of catalogues, two passes and their parts, kept ground, frames
    # 37: 2754 the registry and the trade of approximations, budgets and where their answer holds, one brightness, own Suns,
    # limits where nothing changes
    # 38: 2480 cameras from SPICE and CCSDS, Python and notebooks, cures, files on servers, wrong calls
    # 39: 520 flight files, STAC items
    # 40: 49 wrong values of Python functions that ran on, or ended within numpy; heights in feet; far Suns; settings of a search
    # 33 took away 331
    "code lines, lcp_catalog": 50018,
    # 3570; 34: 80 signals, advice for memory; 35: 44 their option and line of a plan; 36: 148 warm-up, parts of two passes, an
    # index as an input; 37: 80 budgets, switches; 38: 447 cameras, help and examples, silence, stages; 39: 90 flight files;
    # 33 took away 295
    "code lines, cli": 4165,
    # 45 000; 36: 275 regions in one pass and in two beside the strong pipeline, and what two passes cost
    "words of docs": 45000,
    "words of the changelog": 1000,
    "class names of several classes": 0,
    "starred calls of our own functions": 10,
    "lines of the library with options": 0,
}
"""The most of each figure; an issue that adds a capability states its own allowance and raises it here."""


def test_sizes_are_within_their_budgets() -> None:
    found = SIZES.table()
    assert {name: found[name] for name in BUDGETS if found[name] > BUDGETS[name]} == {}
    assert found["share of the manual"] >= 0.55


def test_a_class_name_means_one_class() -> None:
    assert SIZES.repeated_classes() == {}


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ('"""A text.\n\nOf three lines."""\n', 0),
        ("# a comment\n\nx = 1\n", 1),
        ("x = (\n    1,\n    2,\n)\n", 4),
        ('def f():\n    """Nothing."""\n    return "text"\n', 2),
        ('x = """a\n\n# b\n"""\n', 4),
        ('x = (\n    "a"\n    # why\n\n    f"{b}"\n)\n', 4),
    ],
)
def test_lines_of_code_are_without_texts_and_comments(
    text: str, lines: int, tmp_path: Path
) -> None:
    path = tmp_path / "some.py"
    path.write_text(text, encoding="utf-8")
    assert SIZES.code_lines(path) == lines
