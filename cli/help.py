"""``lcp help``: a how-to page, or the help of a command."""

from __future__ import annotations

import click

from .files import FileCommand
from .messages import echo


@click.command(cls=FileCommand, example="lcp help query")
@click.argument("topic", required=False)
@click.pass_context
def command(context: click.Context, topic: str | None) -> None:
    """Print a how-to or reference page as text (Markdown), or the help of a command; without TOPIC the list of the pages."""
    from lcp_catalog._package_files import pages

    found, group = pages(), context.find_root().command
    assert isinstance(group, click.Group)
    commands = group.list_commands(context)
    if topic is None:
        for name, text in found.items():
            echo(f"{name:20} {text.splitlines()[0].lstrip('# ')}")
        echo("\nlcp help TOPIC prints one; so does lcp help COMMAND.")
    elif topic in found:
        echo(found[topic])
        if topic in commands:
            echo(f"Options of the command: lcp {topic} --help")
    elif one := group.get_command(context, topic):
        root = context.find_root()
        echo(one.get_help(click.Context(one, parent=root, info_name=topic)))
    else:
        from difflib import get_close_matches

        for alike in get_close_matches(topic[:80], [*found, *commands], 1):
            raise click.UsageError(f"no topic {topic!r}. Did you mean {alike!r}?")
        raise click.UsageError(f"no topic {topic!r}; there are {', '.join(found)}")
