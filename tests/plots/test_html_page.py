"""Templates: texts are escaped, and missing data is an error."""

from __future__ import annotations

from typing import Any

import jinja2
import pytest
from markupsafe import Markup

from lcp_catalog.plots.numbers import page


def content() -> dict[str, Any]:
    return {"title": "a < b", "heading": Markup("<i>h</i>"), "below": "<script>"}


def test_texts_are_escaped_and_markup_is_not() -> None:
    html = page("page.html.j2", **content())
    assert "<title>a &lt; b</title>" in html
    assert "<h1><i>h</i></h1><p class='file'>&lt;script&gt;</p>" in html
    assert html.startswith("<!DOCTYPE html>\n")


def test_missing_data_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError, match="below"):
        page("page.html.j2", title="", heading="")
