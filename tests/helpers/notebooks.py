"""Cells of notebooks and blocks of pages, run as a notebook runs them: what the last line gives is shown."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any


def cells(path: Path) -> list[str]:
    """The programs of a notebook, or of a page."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.findall(r"```python\n(.*?)```", text, re.S)
    return ["".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "code"]


def run(programs: Iterable[str], names: dict[str, Any]) -> list[str]:
    """Run programs one after the other with the same names; what each shows."""
    shown = []
    for program in programs:
        tree, last = ast.parse(program), None
        if isinstance(tree.body[-1], ast.Expr):
            last = ast.Expression(tree.body.pop().value)  # type: ignore[attr-defined]
        exec(compile(tree, "cell", "exec"), names)
        value = eval(compile(last, "cell", "eval"), names) if last else None
        html = getattr(value, "_repr_html_", None)
        shown.append(str(html()) if html else repr(value))
    return shown
