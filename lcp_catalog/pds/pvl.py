"""PVL, the language of PDS3 labels: statements, and their numbers, texts and lengths."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from ..errors import LabelError

Pvl = dict[str, Any]
"""Statements of a label; an OBJECT or GROUP is a nested dictionary, a number with a unit a
``Quantity``.
"""

_METRES = {"M": 1.0, "METER": 1.0, "METERS": 1.0, "METRE": 1.0, "METRES": 1.0}
_METRES |= {
    "KM": 1000.0,
    "KILOMETER": 1000.0,
    "KILOMETERS": 1000.0,
    "KILOMETRE": 1000.0,
    "KILOMETRES": 1000.0,
}


@dataclass(frozen=True)
class Quantity:
    """A number with the unit given after it in angle brackets, upper case."""

    value: float
    unit: str


_DEPTH = 40
"""Most nested objects; labels have three or four."""

_TOKEN = re.compile(
    r"""/\*.*?\*/ | (?P<string>"[^"]*"|'[^']*') | (?P<unit><[^>]*>) | (?P<mark>[={}(),])
    | (?P<word>[^\s={}(),<>"']+)""",
    re.S | re.X,
)


def parse_pvl(text: str) -> Pvl:
    """Statements of an ODL/PVL text, up to END; of a repeated key the first value is kept. LabelError
    for objects that are nested too deeply.
    """
    tokens = [m for m in _TOKEN.finditer(text) if m.lastgroup is not None]
    stack: list[Pvl] = [{}]
    at = 0
    while at < len(tokens):
        key = tokens[at].group().upper()
        at += 1
        if key == "END":
            break
        if at < len(tokens) and tokens[at].group() == "=":
            value, at = _pvl_value(tokens, at + 1)
        else:
            value = None
        if key in ("OBJECT", "GROUP", "BEGIN_OBJECT", "BEGIN_GROUP"):
            found = stack[-1].setdefault(str(value).upper(), {})
            stack.append(found if isinstance(found, dict) else {})  # the first value is kept
            if len(stack) > _DEPTH:
                raise LabelError(f"the label has more than {_DEPTH} nested objects")
        elif key in ("END_OBJECT", "END_GROUP"):
            if len(stack) > 1:
                stack.pop()
        elif value is not None:
            stack[-1].setdefault(key, value)
    return stack[0]


def _pvl_value(tokens: list[re.Match[str]], at: int) -> tuple[Any, int]:
    """The value that begins at token ``at``, and the index of the token after it."""
    if at >= len(tokens):
        return None, at
    if tokens[at].group() in "({":
        items: list[Any] = []
        at += 1
        while at < len(tokens) and tokens[at].group() not in ")}":
            if tokens[at].group() in ",({":
                at += 1
                continue
            item, at = _pvl_value(tokens, at)
            items.append(item)
        return items, at + 1
    token = tokens[at]
    value: Any = token.group()
    value = " ".join(value[1:-1].split()) if token.lastgroup == "string" else _literal(value)
    if at + 1 < len(tokens) and tokens[at + 1].lastgroup == "unit":
        unit = " ".join(tokens[at + 1].group()[1:-1].split()).upper()
        return (Quantity(value, unit) if isinstance(value, float) else value), at + 2
    return value, at + 1


def _literal(word: str) -> float | str:
    try:
        return float(word) if word[:1] in "+-.0123456789" else word
    except ValueError:
        return word


def table(pvl: Pvl, key: str) -> Pvl | None:
    """The OBJECT or GROUP of a name; None for anything else."""
    value = pvl.get(key)
    return value if isinstance(value, dict) else None


def number(pvl: Pvl, key: str) -> float | None:
    """The finite number of a key, without its unit; None for anything else."""
    value = pvl.get(key)
    value = value.value if isinstance(value, Quantity) else value
    return float(value) if isinstance(value, float | int) and math.isfinite(value) else None


def wanted(pvl: Pvl, key: str) -> float:
    """The finite number of a key. LabelError if there is none."""
    value = number(pvl, key)
    if value is None:
        raise LabelError(f"the label does not give {key} as a number (it says {pvl.get(key)!r})")
    return value


def text(pvl: Pvl, key: str) -> str:
    """The upper-case text of a key, of a list its first item; empty if it is missing."""
    value = pvl.get(key, "")
    value = value[0] if isinstance(value, list) and value else value
    return str(value.value if isinstance(value, Quantity) else value).upper()


def metres(unit: str, key: str) -> float:
    """Metres in a unit of length. LabelError with the key if the unit is unknown."""
    factor = _METRES.get(unit.upper().strip())
    if factor is None:
        raise LabelError(f"the unit <{unit}> of {key} is not a known unit of length")
    return factor
