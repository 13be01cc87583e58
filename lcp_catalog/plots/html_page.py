"""HTML pages from the jinja2 templates in ``templates/``, with their style sheets and scripts
inline.

A page refers to no other file and follows the reader's choice of light or dark colours.
"""

from __future__ import annotations

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from .numbers import typeset

_TEMPLATES = Environment(
    loader=PackageLoader("lcp_catalog.plots"),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_TEMPLATES.filters["typeset"] = typeset


def page(template: str, **content: Any) -> str:
    """The HTML text of a template (a file name in ``templates/``).

    Texts in ``content`` are escaped; only `markupsafe.Markup` (drawings) is inserted as markup. The
    filter ``typeset`` raises powers of ten in a text (`numbers.typeset`).
    jinja2.UndefinedError for a name that the template uses and ``content`` lacks.
    """
    return _TEMPLATES.get_template(template).render(content)
