"""What a user demands of a validation: ``share_above_0_9>=0.85 and points_found>=20``, held against ``report.json``.

    requirement = term { ("and" | ",") term }
    term        = name (">=" | ">" | "<=" | "<" | "==" | "!=") value

A name is a path in an image's entry of ``report.json`` (``windows.share_above_0_9``) or its end; of several paths with
one end the shortest is meant (``share_above_0_9`` is that of all windows, not of the textured half). Every image must hold every
term. What was not measured holds nothing.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import ConfigError
from .result import VERDICTS

NUMBERS = (
    "points_in_view",
    "points_found",
    *(f"{name}.{of}" for name in ("offset_px", "offset_m", "residual_px") for of in ("median", "p95")),
    "correlation.median",
    "correlation.p05",
    *(f"windows.{name}" for name in ("size", "step", "count", "gsd_m", "median", "mode")),
    *(f"windows.{half}share_above_{limit}" for half in ("", "textured.") for limit in ("0_9", "0_7")),
    *(f"pose.position_{what}_m" for what in ("error", "sigma", "error_across", "sigma_across")),
    "pose.normalised_error",
    "log10_false_alarms",
    "log10_false_alarms_rival",
    "light.points",
    "light.correlation",
    "pixel_m",
    "sun.azimuth_deg",
    "sun.elevation_deg",
    "off_nadir_deg",
    "saturated_share",
    "missing_share",
)  # fmt: skip
"""Paths of what may be demanded, from an image's entry on."""

_ERROR = "pose.position_error"

VERDICT = "verdict"
"""The one path whose value is text."""

OPERATORS: dict[str, Callable[[Any, Any], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}

_TERM = re.compile(r"\s*([A-Za-z_][\w.]*)\s*(>=|<=|==|!=|>|<)\s*(\S.*?)\s*", re.DOTALL)
_BETWEEN = re.compile(r",|\band\b", re.IGNORECASE)


@dataclass(frozen=True)
class Term:
    """``path`` of `NUMBERS` or `VERDICT`, compared with a value; ``text`` is what the user wrote."""

    path: str
    symbol: str
    value: float | str
    text: str

    def failure(self, image: Mapping[str, Any]) -> str | None:
        """Why an image's entry does not hold the term, one line; None: it holds."""
        found = _at(image, self.path)
        if found is None:
            return f"{image['image']}: {self.path} was not measured{_why(image, self.path)}; wanted {self.text}"
        if OPERATORS[self.symbol](found, self.value):
            return None
        shown = found if isinstance(found, str) else f"{found:.10g}"
        return f"{image['image']}: {self.path} is {shown}; wanted {self.text}"


@dataclass(frozen=True)
class Requirement:
    """Terms that all images must hold."""

    terms: tuple[Term, ...]

    @classmethod
    def parse(cls, text: str) -> Requirement:
        """From a user's words. Raises ConfigError for what is no term and for names unknown or of several figures."""
        return cls(tuple(_term(part) for part in _BETWEEN.split(text)))

    @property
    def needs_known_pose(self) -> bool:
        """Whether a term is about the error of a position, which is only measured where the true one is known."""
        return any(term.path.startswith(_ERROR) for term in self.terms)

    def failures(self, document: Mapping[str, Any]) -> list[str]:
        """What of ``report.json`` does not hold, one line each, by image; empty: all does. No image holds nothing."""
        if not document["images"]:
            return ["no image was validated"]
        told = (term.failure(image) for image in document["images"] for term in self.terms)
        return [line for line in told if line is not None]


def _term(text: str) -> Term:
    match = _TERM.fullmatch(text)
    if match is None:
        raise ConfigError(
            f"--require: {text.strip()!r} is no condition; write a name, one of {' '.join(OPERATORS)}, and a number, "
            "as in share_above_0_9>=0.85"
        )
    name, symbol, value = match.groups()
    path = _path(name)
    said = f"{name}{symbol}{value}"
    return Term(
        path, symbol, _word(symbol, value) if path == VERDICT else _number(value, said), said
    )


def _path(name: str) -> str:
    """The path that a name stands for."""
    wanted = name.removeprefix("images.")
    known = (VERDICT, *NUMBERS)
    fits = [path for path in known if path == wanted or path.endswith(f".{wanted}")]
    depth = min((path.count(".") for path in fits), default=0)
    nearest = [path for path in fits if path.count(".") == depth]
    if len(nearest) == 1:
        return nearest[0]
    if nearest:
        raise ConfigError(f"--require: {name} may be any of {', '.join(nearest)}: say which")
    raise ConfigError(f"--require: there is no {name}; there are {', '.join(known)}")


def _number(value: str, said: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if math.isnan(number):
        raise ConfigError(f"--require: {value!r} in {said} is no number; shares are 0..1")
    return number


def _word(symbol: str, value: str) -> str:
    """One of the verdicts."""
    word = value.strip("'\"")
    if word not in VERDICTS or symbol not in ("==", "!="):
        raise ConfigError(
            f"--require: a verdict is == or != one of {', '.join(VERDICTS)}, not {symbol}{value}"
        )
    return word


def _at(image: Mapping[str, Any], path: str) -> Any:
    """The value at a path, None where something on the way is missing."""
    found: Any = image
    for name in path.split("."):
        if found is None:
            return None
        found = found.get(name)
    return found


def _why(image: Mapping[str, Any], path: str) -> str:
    """Why there is no such figure, as far as the report says."""
    if path.startswith("windows."):
        return f" ({image['windows']['reason']})" if image["windows"]["reason"] else ""
    if path.startswith("pose.") and image["pose"] is None:
        return f" ({image['verdict']}{': ' if image['reason'] else ''}{image['reason']})"
    if path.startswith(_ERROR):
        return " (the true place is not known)"
    return " (no point was found)" if not image["points_found"] else ""
