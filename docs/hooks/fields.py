"""mkdocs hook: the tables of the configuration's fields and of the approximations, from the code."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, get_type_hints

from lcp_catalog.approximations import APPROXIMATIONS, SAMPLE
from lcp_catalog.fields import Meaning, meanings
from lcp_catalog.production.config import BuildConfig

MARK, APPROXIMATED = "<!-- fields -->", "<!-- approximations -->"


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


def approximations() -> Iterator[str]:
    """Lines of the table of all approximations, with what the alternatives to the sample's configuration cost and change."""
    yield f"| approximation | error | switch | price: alternatives ({SAMPLE}) |\n| --- | --- | --- | --- |"
    for one in APPROXIMATIONS:
        switch = ", ".join(f"`{field}`" for field in one.switch) or one.unpriced
        yield f"| {one.name} | {one.bound} | {switch} | {one.sample or one.price} |"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with the tables in place of the marks."""
    for mark, rows in ((MARK, _rows), (APPROXIMATED, approximations)):
        if mark in markdown:
            markdown = markdown.replace(mark, "\n".join(rows()))
    return markdown
