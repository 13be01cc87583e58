"""mkdocs hook: the table of sub-packages on the architecture page, read from the source.

The order comes from tests/test_layout.py, the purpose from the sub-package's docstring, the imports and the lines from its
modules; so the table cannot differ from the code.
"""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
MARK = "<!-- table of sub-packages -->"


def _order() -> list[str]:
    spec = importlib.util.spec_from_file_location("layout", ROOT / "tests" / "test_layout.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return list(module.ORDER)


def _takes(folder: Path) -> set[str]:
    """Names of the sub-packages that a sub-package imports."""
    found = set()
    for path in folder.rglob("*.py"):
        depth = len(path.relative_to(ROOT / "lcp_catalog").parts)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == depth:
                modules = [node.module] if node.module else [alias.name for alias in node.names]
                found |= {module.split(".")[0] for module in modules}
    return found


def table() -> str:
    """The table in Markdown, from the top sub-package to the bottom one."""
    order = _order()
    rows = [
        "| sub-package | gives | takes | modules | lines |",
        "| --- | --- | --- | ---: | ---: |",
    ]
    for name in reversed(order):
        folder = ROOT / "lcp_catalog" / name
        sources = {path: path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}
        gives = ast.get_docstring(ast.parse(sources[folder / "__init__.py"])) or ""
        taken = [other for other in order if other in _takes(folder) and other != name]
        modules = sum(path.name != "__init__.py" for path in sources)
        lines = sum(len(source.splitlines()) for source in sources.values())
        first = gives.split("\n\n")[0].replace("\n", " ")
        rows.append(f"| `{name}` | {first} | {', '.join(taken)} | {modules} | {lines} |")
    return "\n".join(rows)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put the table in place of its mark."""
    return markdown.replace(MARK, table()) if MARK in markdown else markdown


if __name__ == "__main__":
    print(table())
