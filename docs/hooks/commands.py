"""mkdocs hook: the command reference, made from the click commands, so that it is the text of ``--help``."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import click
from lcp_cli.main import cli

MARK = "<!-- commands -->"


def _cell(text: str) -> str:
    """A text in a cell of a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _section(command: click.Command, path: str) -> Iterator[str]:
    context = click.Context(command, info_name=path, help_option_names=["-h", "--help"])
    yield f"## {path}\n"
    usage = " ".join([path, *command.collect_usage_pieces(context)])
    yield f"```text\n{usage}\n```\n"
    yield inspect.cleandoc(command.help or "").replace("\b\n", "").replace("\f", "") + "\n"
    options = [p for p in command.get_params(context) if isinstance(p, click.Option)]
    yield "| option | meaning |\n| --- | --- |"
    for record in filter(None, [option.get_help_record(context) for option in options]):
        yield f"| `{_cell(record[0])}` | {_cell(record[1])} |"
    yield ""


def _commands(group: click.Group, path: str) -> Iterator[str]:
    """Sections of the commands of a group, and of the groups in it."""
    context = click.Context(group, info_name=path)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from _commands(command, f"{path} {name}")
        else:
            yield from _section(command, f"{path} {name}")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with the sections of all commands in place of the mark."""
    if MARK not in markdown:
        return markdown
    lines = [*_section(cli, "lcp"), *_commands(cli, "lcp")]
    return markdown.replace(MARK, "\n".join(lines))
