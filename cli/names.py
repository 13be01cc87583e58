"""Names of the library's parameters and fields in messages, as the options of the command that runs."""

from __future__ import annotations

import re
from collections.abc import Iterator

import click

from lcp_catalog.errors import NAMED

_SUN = "`time_utc`, or `sun_azimuth_deg` and `sun_elevation_deg`, or `subsolar_deg`"
"""Options for the parameter ``sun``."""

_BUILD = re.compile(r"`build_catalog` with `([a-z][\w.]*)`")
"""A key of another build, as in `navigation.better_catalog`."""

_UNIT = re.compile(r"_(deg|km|m|px|rad|utc|gb)$")


class _Running:
    """The command that runs, once its options are known."""

    command: click.Command | None = None


def runs(command: click.Command | None) -> None:
    """Messages are from now on about this command."""
    _Running.command = command


def in_options(text: str) -> str:
    """A message of the library with the options of the running command in place of the names in it. Of names
    that are no option of it, only the marks are removed.
    """
    text = _BUILD.sub(_of_build, text.replace("`sun`", _SUN))
    return NAMED.sub(lambda found: option(found[1]) or found[1], text)


def _of_build(found: re.Match[str]) -> str:
    """How another build gets a field: by its option, or else by its configuration."""
    from .build_options import OPTIONS  # imports the library's configuration: only for a message

    known = OPTIONS.get(found[1])
    return f"lcp build-catalog {known.flag if known else f'--config with {found[1]}'}"


def option(name: str) -> str | None:
    """The option of the running command for a parameter, or a field such as ``points.spacing_m``; None if there is none."""
    if _Running.command is None:
        return None
    options = [one for one in _Running.command.params if isinstance(one, click.Option)]
    last = name.rpartition(".")[2]
    flags = {flag for one in options for flag in one.opts}
    of_fields = {field: long_name(one) for one in options for field in (one.name, *fields(one))}
    spelled = (f"--{word.replace('_', '-')}" for word in _words(name))
    return (
        of_fields.get(name) or of_fields.get(last) or next((f for f in spelled if f in flags), None)
    )


def has_option(flag: str) -> bool:
    """True if the running command has this option."""
    parameters = [] if _Running.command is None else _Running.command.params
    return any(flag in one.opts for one in parameters)


def _words(name: str) -> Iterator[str]:
    """Words that can be an option: without the unit, with and without the name's section."""
    section, _, last = _UNIT.sub("", name).rpartition(".")
    yield from (last, f"{section}_{last}")


def fields(option: click.Option) -> tuple[str, ...]:
    """Fields of the configuration that an option sets, like ``view.off_nadir_deg``."""
    found: tuple[str, ...] = getattr(option, "fields", ())
    return found


def long_name(option: click.Option) -> str:
    """The name of an option that begins with two hyphens."""
    return next(name for name in option.opts if name.startswith("--"))
