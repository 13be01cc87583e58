"""The commands of `lcp`, and runs that they must refuse."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest
from lcp_cli.main import run


def refusal(arguments: list[str], code: int, capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that fails with exit code ``code`` and one line of error; return stderr.

    The lines "Usage: ..." and "Try ..." of a wrong usage do not count, nor those of kernels that are compiled before.
    """
    assert run(arguments) == code
    error = capsys.readouterr().err
    assert "Traceback" not in error
    beside = "Usage", "Try", "compiling kernels for this machine", "kernels: "
    lines = [line for line in error.splitlines() if line and not line.startswith(beside)]
    assert len(lines) == 1, error
    return error


def leaves(group: click.Group, *path: str) -> Iterator[tuple[str, click.Command]]:
    """All commands with their full names."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from leaves(command, *path, name)
        else:
            yield " ".join((*path, name)), command
