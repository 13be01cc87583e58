"""mkdocs hook: the table of the configuration's fields, from their meanings in the code."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, get_type_hints

from lcp_catalog.fields import Meaning, meanings
from lcp_catalog.production.config import BuildConfig

MARK = "<!-- fields -->"


def _default(value: object, meaning: Meaning) -> str:
    return meaning.default or ("" if value in (None, ()) else f"`{value}`")


def _rows() -> Iterator[str]:
    yield "| field | meaning | must | default |\n| --- | --- | --- | --- |"
    for section, kind in get_type_hints(BuildConfig).items():
        told = meanings(kind)
        for field in dataclasses.fields(kind):
            one = told[field.name]
            cells = (one.text, one.limits, _default(field.default, one))
            yield f"| `{section}.{field.name}` | {' | '.join(cells)} |"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with the table in place of the mark."""
    return markdown.replace(MARK, "\n".join(_rows())) if MARK in markdown else markdown
