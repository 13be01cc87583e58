"""TOML of the user's files: BUILD.toml, MODEL.toml."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from .errors import ConfigError, plain, unknown_keys, unread
from .file_kinds import other_kind

T = TypeVar("T")

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


def read_toml(path: Path | str, meaning: Callable[[str], T]) -> T:
    """The meaning of a TOML file's text. The ConfigError of an invalid file names it; InputError if it cannot be read."""
    try:
        return meaning(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise unread(path, error) from error
    except UnicodeDecodeError as error:
        kind = other_kind(path, "TOML") or "not TOML: not a text file in UTF-8"
        raise ConfigError(f"{path}: {kind}") from error
    except ConfigError as error:
        raise ConfigError(f"{path}: {plain(error)}") from error


def is_number(value: object) -> bool:
    """True for a number that a float can hold: neither true nor false, nor nan, nor a longer integer than
    TOML's.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return not math.isnan(value) if isinstance(value, float) else abs(value) < 1 << 63


def dataclass_of(kind: type, name: str, table: object) -> Any:
    """The dataclass ``kind`` with the fields of a table [``name``]. ConfigError for anything but a table,
    for unknown keys and for values of another type.
    """
    if not isinstance(table, dict):
        raise ConfigError(f"[{name}] must be a table")
    hints = get_type_hints(kind)
    if not hints.keys() >= table.keys():
        raise ConfigError(f"[{name}] has {unknown_keys(table, hints)}")
    return kind(**{key: _value(f"{name}.{key}", hints[key], value) for key, value in table.items()})


def _is_list(value: object, fits: Callable[[object], bool]) -> bool:
    return isinstance(value, list) and all(map(fits, value))


_KINDS: tuple[tuple[str, str, Callable[[Any], bool], Callable[[Any], object]], ...] = (
    ("tuple[str", "a list of texts", lambda v: _is_list(v, lambda one: isinstance(one, str)), tuple),
    ("tuple", "a list of numbers", lambda v: _is_list(v, is_number), lambda v: tuple(map(float, v))),
    ("bool", "true or false", lambda v: isinstance(v, bool), bool),
    ("float", "a number", is_number, float),
    ("int", "a whole number", lambda v: isinstance(v, int) and is_number(v), int),
    ("", "a text", lambda v: isinstance(v, str) and "\0" not in v, str),
)  # fmt: skip
"""What is in the type of a field, the first that fits; the values that it takes, in words and as a test; and
the conversion of these."""


def _value(name: str, hint: Any, value: object) -> object:
    """``value`` converted to the type of its field; an integer is accepted for a float."""
    _, words, fits, converted = next(kind for kind in _KINDS if kind[0] in str(hint))
    if not fits(value):
        raise ConfigError(f"{name} must be {words}, not {value!r:.40}")
    return converted(value)
