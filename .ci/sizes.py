"""Sizes of the project that are budgets: lines of code, words of documents, names, starred calls.

`python .ci/sizes.py` prints the table; `tests/test_sizes.py` holds the budgets.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MANUAL = ("tutorial", "howto", "reference")
"""Folders of docs/ that are the manual."""
_LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


@functools.cache
def _nodes(path: Path) -> list[ast.AST]:
    """All nodes of a file's syntax tree."""
    return [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]


def sources(folder: str) -> list[Path]:
    """Python files of a folder of the checkout, in order."""
    return sorted((ROOT / folder).rglob("*.py"))


def code_lines(path: Path) -> int:
    """Lines that hold code: without blank lines, comments and texts that stand alone (docstrings)."""
    text = path.read_text(encoding="utf-8")
    lines = text.split("\n")
    held = {k for k, line in enumerate(lines, 1) if (code := line.strip()) and code[0] != "#"}
    alone: set[int] = set()
    for node in _nodes(path):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            alone |= {*range(node.lineno, (node.end_lineno or node.lineno) + 1)}
    for first, last in {
        (node.lineno, node.end_lineno or node.lineno)
        for node in _nodes(path)
        if isinstance(node, ast.Constant | ast.JoinedStr)
    }:
        # In texts of several lines blank lines count, and what begins as a comment does; beside them in brackets not. Only
        # there is the tokenizer asked: it takes as long as all the rest.
        if last > first and last not in alone:
            held -= {*range(first, last + 1)}
            held |= _token_lines(lines[first - 1 : last], first)
    return len(held - alone)


def _token_lines(lines: list[str], first: int) -> set[int]:
    """Numbers of the lines that hold tokens, of a part of a file that begins with line ``first``."""
    held: set[int] = set()
    with contextlib.suppress(tokenize.TokenError):  # brackets that the part leaves open
        for token in tokenize.generate_tokens(io.StringIO("\n".join(["(" * 9, *lines])).readline):
            if token.type not in _LAYOUT:
                held |= {*range(token.start[0], token.end[0] + 1)}
    return {first - 2 + k for k in held if k > 1}


def repeated_classes() -> dict[str, list[str]]:
    """Class names of the library and the command line that more than one class has: name to files."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in [*sources("lcp_catalog"), *sources("cli")]:
        for node in _nodes(path):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    return {name: found for name, found in sorted(places.items()) if len(found) > 1}


def _own_names() -> set[str]:
    """Names of functions and classes that the library and the command line define."""
    kinds = (ast.FunctionDef, ast.ClassDef)
    return {
        node.name
        for path in [*sources("lcp_catalog"), *sources("cli")]
        for node in _nodes(path)
        if isinstance(node, kinds)
    }


def _foreign_names(nodes: Iterable[ast.AST]) -> set[str]:
    """Names that a file imports from elsewhere: modules, functions and classes that are not ours."""
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
        elif (
            isinstance(node, ast.ImportFrom)
            and not node.level
            and not (node.module or "").startswith("lcp_")
        ):
            found |= {alias.asname or alias.name for alias in node.names}
    return found


def starred_calls() -> list[str]:
    """Calls of our own functions, methods and classes with ``*name`` or ``**name``."""
    own, found = _own_names(), []
    for path in [*sources("lcp_catalog"), *sources("cli")]:
        foreign = _foreign_names(_nodes(path))
        for node in _nodes(path):
            if not isinstance(node, ast.Call):
                continue
            called = node.func
            name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
            owner = getattr(called, "value", None)
            if name == "__init__" or name in foreign or getattr(owner, "id", "") in foreign:
                continue
            stars = [a.value for a in node.args if isinstance(a, ast.Starred)]
            stars += [k.value for k in node.keywords if k.arg is None]
            if (name in own or name == "cls") and any(isinstance(v, ast.Name) for v in stars):
                found.append(f"{path.relative_to(ROOT)}:{node.lineno} {name}")
    return found


_OPTION = re.compile(
    r"(?<![\w-])--[a-z][a-z-]+(?![a-z-]|:\{)"
)  # --name:{value} is of a style sheet


def option_lines() -> list[str]:
    """Lines of the library, its pages' templates included, that name an option of the command line."""
    return [
        f"{path.relative_to(ROOT)}:{number} {line.strip()}"
        for path in [*sources("lcp_catalog"), *sorted((ROOT / "lcp_catalog").rglob("*.html.j2"))]
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if _OPTION.search(line)
    ]


def words(*paths: Path) -> int:
    """Words of the Markdown files."""
    return sum(len(path.read_text(encoding="utf-8").split()) for path in paths)


def manual_share() -> float:
    """Share of the documents' words that is tutorial, how-to or reference; docs/design apart."""
    pages = [path for path in (ROOT / "docs").rglob("*.md")]
    counted = [path for path in pages if path.relative_to(ROOT / "docs").parts[0] != "design"]
    manual = [path for path in counted if path.relative_to(ROOT / "docs").parts[0] in MANUAL]
    return words(*manual) / words(*counted)


def table() -> dict[str, float]:
    """All figures by name."""
    return {
        **{f"code lines, {folder}": sum(map(code_lines, sources(folder))) for folder in FOLDERS},
        "words of docs": words(*(ROOT / "docs").rglob("*.md")),
        "words of the changelog": words(ROOT / "CHANGELOG.md"),
        "share of the manual": round(manual_share(), 3),
        "class names of several classes": len(repeated_classes()),
        "starred calls of our own functions": len(starred_calls()),
        "lines of the library with options": len(option_lines()),
    }


FOLDERS = ("benchmarks", "lcp_catalog", "cli")

if __name__ == "__main__":
    for name, value in table().items():
        print(f"{name:40} {value}")
