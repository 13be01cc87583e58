"""A default that a command and its function both state is the same."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import click
from lcp_cli.main import cli

import lcp_catalog as lcp

_STATED = str, int, float, tuple
"""Types of a default that is a value; anything else says that there is none."""


def _commands(command: click.Command, words: str = "") -> Iterator[tuple[str, click.Command]]:
    """Commands of a group with the words that call them."""
    if not isinstance(command, click.Group):
        yield words, command
        return
    context = click.Context(command)
    for name in command.list_commands(context):
        below = command.get_command(context, name)
        assert below is not None
        yield from _commands(below, f"{words} {name}".strip())


def test_a_command_and_its_function_have_the_same_defaults() -> None:
    compared, differ = 0, set()
    for words, command in _commands(cli):
        function = getattr(lcp, words.replace("-", "_").replace(" ", "_"), None)
        if not callable(function):
            continue
        stated = inspect.signature(function).parameters
        context = click.Context(command)
        for option in command.get_params(context):
            name = option.name or ""
            found = next(
                (
                    n
                    for n in (name, *(f"{name}_{u}" for u in ("deg", "m", "km", "s")))
                    if n in stated
                ),
                None,
            )
            own = option.get_default(context)
            if found is None or not isinstance(own, _STATED):
                continue
            if not isinstance(stated[found].default, _STATED):
                continue
            compared += 1
            if own != stated[found].default:
                differ.add((words, name))
    assert compared > 10
    assert differ == set()
