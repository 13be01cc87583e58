"""What a long call is doing, for who shows it: the library says it as it goes on, `lcp` prints it now and then."""

from __future__ import annotations

from collections.abc import Callable


def _unheard(text: str) -> None:
    """Nobody asks."""


told: Callable[[str], None] = _unheard
"""Takes each new stage; replaced by who shows it."""

_within = ""


def stage(text: str) -> None:
    """Say what is done from now on, within the part that `part` named last."""
    told(_within + text)


def part(text: str) -> None:
    """Name the part of the work to which the next stages belong; empty: the whole."""
    global _within  # noqa: PLW0603  one process computes one thing at a time
    _within = f"{text}, " if text else ""
