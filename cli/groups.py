"""Groups of options: a command gets the values of a group as one object."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, TypeAlias

Command: TypeAlias = Callable[..., Any]
Decorator: TypeAlias = Callable[[Command], Command]


def option_group(*options: Decorator) -> Decorator:
    """Several options as one decorator; the command gets each value under the option's own name."""

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def collected(
    into: str, make: Callable[..., object], *options: Decorator, names: Sequence[str] | None = None
) -> Decorator:
    """Several options, or groups of them, whose values the command gets as one object ``into``, that ``make``
    returns. ``names``: those of the values; None for the parameters of ``make``.
    """
    taken = list(inspect.signature(make).parameters) if names is None else names

    def decorate(command: Command) -> Command:
        @wraps(command)
        def call(**given: Any) -> Any:
            own = {name: given.pop(name) for name in taken if name in given}
            return command(**given, **{into: make(**own)})

        made: Command = call
        for option in reversed(options):
            made = option(made)
        return made

    return decorate
