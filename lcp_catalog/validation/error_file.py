"""File of an error model that was fitted to images: a section for BUILD.toml."""

from __future__ import annotations

from dataclasses import dataclass

import tomli_w

from ..landmarks.error_model import ErrorModel

DIGITS = 4
"""Significant digits of a value in the file; a fit is not more precise."""


@dataclass(frozen=True)
class FittedErrors:
    """An error model, the number of points that it was fitted to, and the names of their images."""

    model: ErrorModel
    points: int
    images: tuple[str, ...]

    def to_toml(self) -> str:
        """The section ``[errors]`` of a BUILD.toml; equal models give equal text."""
        values = {name: float(f"{v:.{DIGITS}g}") for name, v in self.model.to_dict().items()}
        source = f"{self.points} points searched for in {', '.join(_plain(name) for name in self.images)}"
        return f"# fitted to {source}\n" + tomli_w.dumps({"errors": values})


def _plain(name: str) -> str:
    """A file's name without line ends and other control characters, for a comment."""
    return "".join(c if c.isprintable() else "?" for c in name)
