"""Files of a command, by the types of its options: which it reads, which it writes. A command that would
write over one of its inputs, or write one file twice, is refused before it starts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

Files = Callable[[str], Iterator[Path]]


class InputFile(click.Path):
    """A file that the command reads. ``others``: the files that are read with it."""

    name = "file"

    def __init__(self, others: Files | None = None, **checks: Any) -> None:
        super().__init__(readable=False, **checks)
        self.others = others

    def inputs(self, value: str) -> Iterator[Path]:
        """Every file that is read for a value of the option."""
        yield Path(value)
        if self.others is not None and os.path.isfile(value):
            yield from self.others(value)


class OutputFile(click.Path):
    """A file that the command writes. ``written``: its files, if they are others than the named one."""

    name = "file"

    def __init__(self, written: Files | None = None, **checks: Any) -> None:
        super().__init__(readable=False, **checks)
        self.written = written

    def outputs(self, value: str) -> Iterator[Path]:
        """Every file that is written for a value of the option."""
        if self.written is None:
            yield Path(value)
        else:
            yield from self.written(value)


class FileCommand(click.Command):
    """Command that compares its outputs with its inputs and with each other before it starts."""

    def invoke(self, ctx: click.Context) -> Any:
        refuse_same_files(ctx)
        _refuse_names_for_make(ctx)
        return super().invoke(ctx)


def refuse_same_files(ctx: click.Context) -> None:
    """Raise a usage error if an output of the command is one of its inputs or another output, also by way
    of links.
    """
    outputs = _files(ctx, "outputs")
    for number, (name, path) in enumerate(outputs):
        _refuse(name, path, outputs[:number])
    if outputs:
        read = _files(ctx, "inputs")
        for name, path in outputs:
            _refuse(name, path, read)


def _refuse(name: str, path: Path, others: list[tuple[str, Path]]) -> None:
    from lcp_catalog.atomic_files import same_file

    for other, its in others:
        if same_file(path, its):
            raise click.UsageError(f"{name} is the same file as {other}; name another output")


def _refuse_names_for_make(ctx: click.Context) -> None:
    """OutputError, before anything is computed, for a name that the rule of ``--depfile`` cannot hold."""
    if ctx.params.get("depfile"):
        from lcp_catalog.atomic_files import depfile_rule

        names = (path for kind in ("inputs", "outputs") for _, path in _files(ctx, kind))
        depfile_rule("target", names)


def _files(ctx: click.Context, kind: str) -> list[tuple[str, Path]]:
    """Every file of a kind (``inputs``, ``outputs``), with the words for it."""
    found = []
    for parameter in ctx.command.params:
        files = getattr(parameter.type, kind, None)
        value = ctx.params.get(parameter.name or "")
        if files is None or value is None:
            continue
        flag = f"{parameter.opts[0]} " if isinstance(parameter, click.Option) else ""
        for one in value if isinstance(value, tuple) else (value,):
            for path in files(one):
                its = flag + one
                found.append((its if str(path) == one else f"{path} of {its}", path))
    return found


def raster_files(path: str) -> Iterator[Path]:
    """Files that are read with a raster: its label or its image, and what GDAL reads with it."""
    from lcp_catalog.dem.dem import files_beside  # imports rasterio

    yield from files_beside(Path(path))


def config_files(path: str) -> Iterator[Path]:
    """Maps and reflectance model that a BUILD.toml names; none for an invalid file, which is refused when
    it is read.
    """
    from lcp_catalog.build.config import BuildConfig
    from lcp_catalog.errors import ConfigError

    try:
        yield from BuildConfig.from_toml(Path(path)).files
    except ConfigError:
        return
