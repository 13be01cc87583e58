"""mkdocs hook: the tables of the configuration's fields, of the approximations and of the catalogue's variables, from the code."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, get_type_hints

from lcp_catalog.approximations import APPROXIMATIONS, SAMPLE
from lcp_catalog.catalog.schema import PROMISE, VARIABLES, Variable
from lcp_catalog.fields import Meaning, meanings
from lcp_catalog.production.config import BuildConfig

MARK, APPROXIMATED = "<!-- fields -->", "<!-- approximations -->"
STORED, PROMISED = "<!-- variables -->", "<!-- promise -->"


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
    head = "approximation", "error", "where and how known", "switch"
    yield f"| {' | '.join(head)} | price: alternatives ({SAMPLE}) |\n| --- | --- | --- | --- | --- |"
    for one in APPROXIMATIONS:
        switch = ", ".join(f"`{field}`" for field in one.switch) or one.unpriced
        yield f"| {one.name} | {one.error} | {one.bound} | {switch} | {one.sample or one.price} |"


def _variables(group: dict[str, Variable]) -> Iterator[str]:
    """Lines of the table of a group's variables; those that only number a dimension are left out."""
    yield "| variable | dimensions | unit | meaning |\n| --- | --- | --- | --- |"
    for name, one in group.items():
        if one.dims != (name,):
            unit = "" if one.units == "1" else one.units
            yield f"| `{name}` | {', '.join(one.dims)} | {unit} | {one.long_name} |"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with the tables in place of the marks."""
    tables = {MARK: _rows, APPROXIMATED: approximations}
    tables |= {STORED: lambda: _variables(VARIABLES), PROMISED: lambda: _variables(PROMISE)}
    for mark, rows in tables.items():
        if mark in markdown:
            markdown = markdown.replace(mark, "\n".join(rows()))
    return markdown
