"""Requirements on a validation, like ``share_above_0_9>=0.85 and points_found>=20``, checked
against ``report.json``.

    requirement = term { ("and" | ",") term }
    term        = name (">=" | ">" | "<=" | "<" | "==" | "!=") value

A name is a path in an image's entry of ``report.json`` (``windows.share_above_0_9``) or the end of
one. Of several paths with the same end the shortest applies (``share_above_0_9`` is that of all
windows, not of the textured half); ``count`` is that of the windows. Every image must satisfy every term. A figure that was not
measured satisfies none.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import ConfigError
from .result import VERDICTS

_WINDOWS = "windows", "windows_plain"

NUMBERS = (
    "points_in_view",
    "points_found",
    *(f"{name}.{of}" for name in ("offset_px", "offset_m", "residual_px") for of in ("median", "p95")),
    "correlation.median",
    "correlation.p05",
    *(f"{of}.{name}" for of in _WINDOWS for name in ("size", "step", "count", "gsd_m", "median", "mode")),
    *(f"{of}.{half}share_above_{limit}" for of in _WINDOWS for half in ("", "textured.") for limit in ("0_9", "0_7")),
    *(f"pose.position_{what}_m" for what in ("error", "sigma", "error_across", "sigma_across")),
    "pose.normalised_error",
    *(f"claims.{name}" for name in ("count", "unclaimed", "usable", "found", "errors")),
    *(f"claims.{name}" for name in ("brier", "brier_of_the_mean", "expected_calibration_error")),
    *(f"claims.{name}" for name in ("found_of_usable", "found_of_unusable", "usable_of_found")),
    "claims.normalised_squared_error",
    "claims.normalised_squared_error_median",
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
"""Paths of the numeric figures in an image's entry."""

_IN_FULL = "claims.count", "light.points", *(n for n in NUMBERS if n.startswith(_WINDOWS[1]))
"""Paths that must be given in full: their end would be taken for another figure."""

_ERROR = "pose.position_error"

VERDICT = "verdict"
"""Path whose value is text."""

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
    """Comparison of ``path``, one of `NUMBERS` or `VERDICT`, with a value; ``text`` as the user
    wrote it.
    """

    path: str
    symbol: str
    value: float | str
    text: str

    def failure(self, image: Mapping[str, Any]) -> str | None:
        """One line that states how an image's entry fails the term; None if it satisfies it."""
        found = _at(image, self.path)
        if found is None:
            return f"{image['image']}: {self.path} was not measured{_why(image, self.path)}; required: {self.text}"
        if OPERATORS[self.symbol](found, self.value):
            return None
        shown = found if isinstance(found, str) else f"{found:.6g}"
        return f"{image['image']}: {self.path} is {shown}; required: {self.text}"


@dataclass(frozen=True)
class Requirement:
    """Terms that all images must satisfy."""

    terms: tuple[Term, ...]

    @classmethod
    def parse(cls, text: str, numbers: Sequence[str] = NUMBERS) -> Requirement:
        """Parse the text of a requirement on the figures ``numbers``. ConfigError for an invalid term
        and for an unknown or ambiguous name.
        """
        return cls(tuple(_term(part, numbers) for part in _BETWEEN.split(text)))

    @property
    def needs_known_pose(self) -> bool:
        """True if a term needs the position error, which is measured only if the true position is
        known.
        """
        return any(term.path.startswith(_ERROR) for term in self.terms)

    def failures(self, document: Mapping[str, Any]) -> list[str]:
        """One line per failed term and image of ``report.json``; empty if all are satisfied.
        Without an image, one line.
        """
        if not document["images"]:
            return ["no image was validated"]
        told = (term.failure(image) for image in document["images"] for term in self.terms)
        return [line for line in told if line is not None]


def _term(text: str, numbers: Sequence[str]) -> Term:
    match = _TERM.fullmatch(text)
    if match is None:
        raise ConfigError(
            f"`require`: {text.strip()!r} is not a condition; write a name, one of {' '.join(OPERATORS)}, and a number, "
            "like share_above_0_9>=0.85"
        )
    name, symbol, value = match.groups()
    path = _path(name, numbers)
    said = f"{name}{symbol}{value}"
    return Term(
        path, symbol, _word(symbol, value) if path == VERDICT else _number(value, said), said
    )


def _path(name: str, numbers: Sequence[str]) -> str:
    """The path that a name refers to."""
    wanted = name.removeprefix("images.")
    known = (VERDICT, *numbers)
    ends = [path for path in known if path.endswith(f".{wanted}") and path not in _IN_FULL]
    fits = [wanted] if wanted in known else ends
    depth = min((path.count(".") for path in fits), default=0)
    nearest = [path for path in fits if path.count(".") == depth]
    if len(nearest) == 1:
        return nearest[0]
    if nearest:
        raise ConfigError(f"`require`: {name} is ambiguous: {', '.join(nearest)}")
    from difflib import get_close_matches  # noqa: PLC0415  # 7 ms: only for a message

    open_to_all = [path for path in known if path not in _IN_FULL]
    last = {path.rpartition(".")[2]: path for path in open_to_all} | {
        one: one for one in open_to_all
    }
    alike = get_close_matches(wanted[:80], last, 1)
    meant = f" ({last[alike[0]]} is meant?)" if alike else ""
    raise ConfigError(f"`require`: unknown name {name}{meant}; known names: {', '.join(known)}")


def _number(value: str, said: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"`require`: {value!r} in {said} is not a finite number; shares are 0..1")
    return number


def _word(symbol: str, value: str) -> str:
    """One of `VERDICTS`."""
    word = value.strip("'\"")
    if word not in VERDICTS or symbol not in ("==", "!="):
        raise ConfigError(
            f"`require`: verdict must be == or != one of {', '.join(VERDICTS)}, not {symbol}{value}"
        )
    return word


def _at(image: Mapping[str, Any], path: str) -> Any:
    """Value at a path; None if a part of the path is missing."""
    found: Any = image
    for name in path.split("."):
        if found is None:
            return None
        found = found.get(name)
    return found


def _why(image: Mapping[str, Any], path: str) -> str:
    """Reason of a missing figure, as far as the report states it."""
    if path.startswith(_WINDOWS):
        return f" ({image['windows']['reason']})" if image["windows"]["reason"] else ""
    if path.startswith("claims.") and image["claims"]["reason"]:
        return f" ({image['claims']['reason']})"
    if path.startswith("claims."):
        return ""
    if path.startswith("pose.") and image["pose"] is None:
        return f" ({image['verdict']}{': ' if image['reason'] else ''}{image['reason']})"
    if path.startswith(_ERROR):
        return " (the true position is unknown)"
    return " (no point was found)" if not image["points_found"] else ""
