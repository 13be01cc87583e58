"""Names that the product defines and does not read: a rule that nobody asks for holds in its own tests alone. Two rules were lost
so in November 2026 (dee11448, e295ed7c).

Names alone are compared. What shares its name with something else, loses one of two callers, or is asked with wrong values is
not noticed: a rule that a page states needs a test through a command.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CALLED_BY_OTHERS = """
    emit find_class readinto truncate reducer_override
    format_commands format_options get_metavar invoke resolve_command type_cast_value from_ccsds
    compile_extra get_pointer_to_function serialize_using_object_code _Model
    _optimize_final_module _finalize_final_module cache_path load_overload save_overload on_start on_end
    from_spice sel to_geodataframe
    POLAR_ERROR
"""
"""Names that Python, click, numba or a user looks for, and a bound that a page and tests quote."""


def defined(body: list[ast.stmt]) -> Iterator[tuple[str, ast.stmt]]:
    """Names that a module or a class defines, without those within its functions."""
    for one in body:
        if isinstance(one, ast.ClassDef):
            yield one.name, one
            yield from defined(one.body)
        elif isinstance(one, ast.FunctionDef):
            yield one.name, one
        elif isinstance(one, ast.Assign | ast.AnnAssign):
            targets = one.targets if isinstance(one, ast.Assign) else [one.target]
            names = [n for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
            yield from ((name.id, one) for name in names)


def read(tree: ast.AST) -> Iterator[str]:
    """Names that code reads: as such, as attributes, and as words of texts that are no docstrings."""
    documented = ast.Module | ast.ClassDef | ast.FunctionDef
    statements = [s for one in ast.walk(tree) if isinstance(one, documented) for s in one.body]
    told = {id(s.value) for s in statements if isinstance(s, ast.Expr)}
    for one in ast.walk(tree):
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load):
            yield one.id
        elif isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Load):
            yield one.attr
        elif isinstance(one, ast.Constant) and isinstance(one.value, str) and id(one) not in told:
            yield from re.findall(r"\w+", one.value)


def unread(modules: list[ast.Module], texts: list[str]) -> set[str]:
    """Names that modules define and that neither they read, outside of the definition itself, nor texts."""
    every = Counter(name for tree in modules for name in read(tree))
    every.update(word for text in texts for word in re.findall(r"\w+", text))
    return {
        name
        for tree in modules
        for name, one in defined(tree.body)
        if every[name] <= Counter(read(one))[name]
    }


def test_what_the_product_defines_it_reads() -> None:
    files = [path for folder in ("lcp_catalog", "cli") for path in (ROOT / folder).rglob("*.py")]
    modules = [ast.parse(path.read_text(encoding="utf-8")) for path in files]
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "lcp_catalog").rglob("*.j2")]
    found = {n for n in unread(modules, texts) if not re.fullmatch(r"__\w+__|_repr_html_|_", n)}
    assert found == set(CALLED_BY_OTHERS.split())


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("FAR = 1\ndef f():\n    return f\nf()", {"FAR"}),
        ("def f():\n    return f()", {"f"}),
        ("class A:\n    x: int = 0\n    def y(self):\n        return self.x\nA()", {"y"}),
        ("class A:\n    x: int = 0\ngetattr(A, 'x')", set()),
        ("A, B = 1, 2\nprint(A)\n'''B'''", {"B"}),
    ],
)
def test_what_is_found(code: str, found: set[str]) -> None:
    assert unread([ast.parse(code)], []) == found
