"""Numbers in texts and on axes: few digits, round steps.

HTML pages from the jinja2 templates in ``templates/``, with their style sheets and scripts
inline.

A page refers to no other file and follows the reader's choice of light or dark colours.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any

from markupsafe import Markup

_POWER = re.compile(r"\b10\^(-?\d+)\b")
_EXPONENT = re.compile(r"(?<![\w.])(\d(?:\.\d+)?)e([+-]\d{2,3})\b")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float, digits: int = 3) -> str:
    """Return a number with ``digits`` significant digits; a dash for nan and inf.

    Exponents are used only below 0.001 and from 100 000 on.
    """
    if not math.isfinite(value):
        return "–"
    if value != 0.0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.{digits - 1}e}"
    text = f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}" if value else "0"
    return text.rstrip("0").rstrip(".") if "." in text else text


def nice_step(span: float, parts: int) -> float:
    """Smallest step of 1, 2, 2.5, 5 or 10 times a power of ten that divides ``span`` into at most
    ``parts`` parts.
    """
    raw = span / parts
    power = 10.0 ** math.floor(math.log10(raw))
    return power * next(m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= raw * (1 - 1e-9))


def typeset(text: str) -> str:
    """A text with its powers of ten raised: "10^-140" as 10⁻¹⁴⁰, "1.50e-07" as 1.5 × 10⁻⁷."""
    text = _EXPONENT.sub(lambda found: _times_power(found[1], int(found[2])), text)
    return _POWER.sub(lambda found: _power(int(found[1])), text)


def _times_power(factor: str, exponent: int) -> str:
    short = factor.rstrip("0").rstrip(".") if "." in factor else factor
    return _power(exponent) if short == "1" else f"{short} × {_power(exponent)}"


def _power(exponent: int) -> str:
    return f"10{str(exponent).translate(_RAISED)}" if exponent else "1"


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  # 7 MB: only where a page is made

    found = Environment(
        loader=PackageLoader("lcp_catalog.plots"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    found.filters |= {"typeset": typeset, "number": number}
    return found


def page(template: str, **content: Any) -> str:
    """The HTML text of a template (a file name in ``templates/``).

    Texts in ``content`` are escaped; only `markupsafe.Markup` (drawings) is inserted as markup. The
    filter ``typeset`` raises powers of ten in a text (`numbers.typeset`).
    jinja2.UndefinedError for a name that the template uses and ``content`` lacks.
    """
    return str(_templates().get_template(template).render(content))


def drawing(name: str, *content: Any) -> Markup:
    """The SVG of a macro of ``templates/drawings.svg.j2``, without its line ends."""
    macro = getattr(_templates().get_template("drawings.svg.j2").module, name)
    return Markup(macro(*content).replace("\n", ""))
