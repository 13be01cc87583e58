"""TOML of the user's files: BUILD.toml, MODEL.toml."""

from __future__ import annotations

import math
import re
import tomllib
from typing import Any

from .errors import ConfigError

_DEEPEST = 100
_DEEP = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{_DEEPEST}}}")
"""A dotted name of more than so many parts: the parser's time grows with the square of their number."""


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text. ConfigError if it is not TOML, or nested too deeply."""
    if _DEEP.search(text):
        raise ConfigError(f"not a configuration: a name has more than {_DEEPEST} parts")
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also of an integer of more than 4300 digits
        raise ConfigError(f"not TOML: {error}") from error
    except RecursionError as error:
        raise ConfigError("not a configuration: it is nested too deeply") from error


def is_number(value: object) -> bool:
    """True for a number that a float can hold: neither true nor false, nor nan, nor a longer integer than
    TOML's.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return not math.isnan(value) if isinstance(value, float) else abs(value) < 1 << 63
