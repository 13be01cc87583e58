"""Fields of the configuration: what each means, its range, its choices and its default, stated once.

A field's meaning is in the metadata of its dataclass. The configuration checks values by it, the command
line makes options from it, and the reference lists it.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, cast

from .errors import ConfigError

_UNITS = {"m": "m", "km": "km", "deg": "degrees", "rad": "rad"}


@dataclass(frozen=True)
class Meaning:
    """What a field is: ``text``, in which other fields stand in backticks; ``default`` in words, where no
    value stands for it; its range; its ``choices``, if it has some; and the fields of its section that it
    ``replaces``: a new value of it removes theirs.
    """

    text: str
    default: str = ""
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()
    replaces: tuple[str, ...] = ()

    @property
    def limits(self) -> str:
        """The range or the choices in words, after "must"; empty for neither."""
        if self.choices:
            return f"be {' or '.join(self.choices)}"
        if self.least is not None and self.most is not None:
            return f"lie in {self.least:g}..{self.most:g}"
        said = (("above", self.above), ("at least", self.least), ("below", self.below))
        words = [
            f"{w} {v:g}" for w, v in (*said, ("at most", self.most)) if v not in (None, math.inf)
        ]
        return f"be {' and '.join(words)}" if words else ""

    def admits(self, value: Any) -> bool:
        """True for a value within the range or among the choices."""
        if self.choices:
            return value in self.choices
        return (
            (self.above is None or value > self.above)
            and (self.least is None or value >= self.least)
            and (self.below is None or value < self.below)
            and (self.most is None or value <= self.most)
        )


def meant(value: Any, text: str, **facts: Any) -> Any:
    """A field of a dataclass with the default ``value`` and the `Meaning` of ``text`` and ``facts``, which
    are its fields.
    """
    return dataclasses.field(default=value, metadata={"meaning": Meaning(text, **facts)})


def meanings(section: Any) -> dict[str, Meaning]:
    """The meaning of each field of a dataclass, or of its instance."""
    return {f.name: cast("Meaning", f.metadata["meaning"]) for f in dataclasses.fields(section)}


def unit(name: str) -> str:
    """The unit in a field's name, in words; empty if there is none."""
    return _UNITS.get(name.rpartition("_")[2], "")


def check_fields(section: Any, name: str) -> None:
    """ConfigError for the first value of a section that is out of its range or not among its choices; of
    a list, every element is checked. None is admitted where it is the default.
    """
    for field, meaning in meanings(section).items():
        value = getattr(section, field)
        for one in value if isinstance(value, tuple) else () if value is None else (value,):
            if not meaning.admits(one):
                shown = f"{one:g}" if isinstance(one, float) else one
                raise ConfigError(
                    f"`{name}.{field}` must {meaning.limits} {unit(field)}".rstrip()
                    + f", not {shown}"
                )


def require(condition: bool, text: str) -> None:
    """ConfigError with the text unless the condition holds."""
    if not condition:
        raise ConfigError(text)
