"""Files of a command, by the types of its options: which it reads, which it writes. A command is refused before
it starts if it would write over one of its inputs or write one file twice, if an
output has another ending than its option writes, and if it cannot be written.
"""

from __future__ import annotations

import logging
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from lcp_catalog.choices import EXPORT_FOLDERS, INDEX, MOON_MAP, NO_MAP, OF_FILES
from lcp_catalog.errors import ConfigError, InputError

from .help_text import write_example, write_options
from .names import runs

log = logging.getLogger(__name__)

Files = Callable[[str], Iterator[Path]]


class InputFile(click.Path):
    """A file that the command reads. ``others``: the files that are read with it."""

    name = "file"

    def __init__(self, others: Files | None = None) -> None:
        super().__init__(readable=False)
        self.others = others

    def inputs(self, value: str) -> Iterator[Path]:
        """Every file that is read for a value of the option."""
        from lcp_catalog.remote_files import archive_of, url_of

        if url_of(value) is None:
            yield archive_of(value) or Path(value)
            if self.others is not None and os.path.isfile(value):
                yield from self.others(value)


class OutputFile(click.Path):
    """A file that the command writes. ``written``: its files, if they are others than the named one.

    Its name must have one of the endings in the option's metavar, such as ``OUT.tif``. ``replaced``: True if it may be there
    without ``--overwrite``, or the command decides.
    """

    name = "file"

    def __init__(self, written: Files | None = None, replaced: bool = False) -> None:
        super().__init__(readable=False)
        self.written, self.replaced = written, replaced

    def outputs(self, value: str) -> Iterator[Path]:
        """Every file that is written for a value of the option."""
        if self.written is None:
            yield Path(value)
        else:
            yield from self.written(value)


depfile_option = click.option(
    "--depfile",
    type=OutputFile(replaced=True),
    metavar="FILE",
    help="Also write the list of input files as a rule for make.",
)


def require_ending(flag: str, name: str, endings: Sequence[str]) -> None:
    """Raise a usage error for an output of an option that has none of the endings."""
    from lcp_catalog.atomic_files import ending_of

    try:
        ending_of(name, endings)
    except ConfigError as error:
        raise click.UsageError(f"{flag} {error}") from error


def _refuse_endings(ctx: click.Context) -> None:
    """Raise a usage error for an output with another ending than its option's metavar has, and for a folder that is
    named like a file. A metavar without an ending (``FILE``) allows any.
    """
    for option in ctx.command.params:
        name = ctx.params.get(option.name or "")
        if name is None or not isinstance(option.type, OutputFile):
            continue
        if endings := re.findall(r"\.\w+", option.metavar or ""):
            require_ending(option.opts[0], name, endings)
        ending = Path(name).suffix.lower()
        if option.metavar == "DIR" and ending in OF_FILES and not Path(name).is_dir():
            raise click.UsageError(
                f"{option.opts[0]} {name}: the output is a folder; name it without {ending}"
            )


def _check_outputs(ctx: click.Context) -> None:
    """OutputExistsError or OutputError for a file that cannot be written. Folders are left to the command, and a file in
    one that it makes.
    """
    from lcp_catalog.atomic_files import check_output

    made: list[Path] = []
    for option in ctx.command.params:
        name, kind = ctx.params.get(option.name or ""), option.type
        if not name or not isinstance(kind, OutputFile):
            continue
        if option.metavar in ("DIR", "FOLDER") or name.endswith(EXPORT_FOLDERS):
            made.append(Path(name))
            continue
        for path in kind.outputs(name):
            if path.parent.is_dir() or path.parent not in made:
                check_output(path, kind.replaced or ctx.params.get("overwrite", False))


class FileCommand(click.Command):
    """Command that checks its files before it starts, and shows its options in groups, with an ``example``.

    A value of an option with a metavar like ``DEM...`` can be followed by further values, once the command's
    arguments are complete. ``rule``: the command has ``--depfile``, whose file is written after the others. The help shows
    the defaults of options that do not say ``show_default=False``, because their text states them.
    """

    def __init__(self, *args: Any, example: str = "", rule: bool = False, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.example = example
        self.rule = rule
        if rule:
            depfile_option(self)
        for option in self.params:
            if isinstance(option, click.Option) and option.show_default is None:
                option.show_default = not option.is_flag

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        return super().parse_args(ctx, _values_apart(self, ctx, args))

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        write_options(self, ctx, formatter)
        if self.example:
            write_example(self.example, formatter)

    def invoke(self, ctx: click.Context) -> Any:
        from lcp_catalog.memory import keep_memory

        runs(self)
        keep_memory()
        refuse_same_files(ctx)
        _refuse_endings(ctx)
        _check_outputs(ctx)
        _refuse_names_for_make(ctx)
        read = list(dict.fromkeys(path for _, path in _inputs(ctx)))
        name = ctx.command_path.partition(" ")[2]
        rule = self._rule(ctx)
        began = time.perf_counter()
        log.info("%s: reads %s", name, ", ".join(map(str, read)) or "no file")
        from .progress import alive

        try:
            with alive(name):
                result = super().invoke(ctx)
        except ConfigError:
            require_inputs(ctx)
            raise
        if rule is not None:
            from lcp_catalog.atomic_files import depfile_rule, write_bytes

            depfile, target = rule
            write_bytes(depfile, depfile_rule(target, read), overwrite=True)
        written = [path for _, path in _files(ctx, "outputs") if path.exists()]
        if written:
            log.info("%s: wrote %s", name, ", ".join(map(str, written)))
        log.info("%s: done in %.1f s", name, time.perf_counter() - began)
        return result

    def _rule(self, ctx: click.Context) -> tuple[str, Path] | None:
        """File of ``--depfile`` and the output that its rule makes; None without one."""
        depfile = ctx.params.pop("depfile", None) if self.rule else None
        if depfile is None:
            return None
        target = next((path for _, path in _files(ctx, "outputs")), None)
        if target is None:
            flags = [p.opts[0] for p in self.params if isinstance(p.type, OutputFile)]
            raise click.UsageError(f"--depfile needs an output: {' or '.join(flags[:-1])}")
        return depfile, target


def _values_apart(command: click.Command, ctx: click.Context, args: list[str]) -> list[str]:
    """Arguments in which every value of an option like ``--dem DEM...`` has the option before it."""
    known = {name: one for one in command.get_params(ctx) for name in one.opts}
    needed = sum(isinstance(one, click.Argument) and one.required for one in command.params)
    found: list[str] = []
    taking, values, places = (
        "",
        0,
        0,
    )  # option of a list, values that are still an option's, arguments
    for number, word in enumerate(args):
        option = known.get(word) if values == 0 else None
        if word == "--" and values == 0:
            return found + args[number:]
        if isinstance(option, click.Option):
            values = 0 if option.is_flag or option.count else option.nargs
            several = option.multiple and str(option.metavar).endswith("...")
            taking = word if several else ""
        elif values > 0:
            values -= 1
        elif word.startswith("-") and len(word) > 1:  # --name=value, or refused by the parser
            taking = ""
        elif taking and places >= needed:
            found.append(taking)
        else:
            places += 1
        found.append(word)
    return found


def require_inputs(ctx: click.Context) -> None:
    """Raise InputError for the first input that is not there: exit code 1, as where the library finds it
    missing. Names that GDAL alone resolves are left to it.
    """
    for parameter in ctx.command.params:
        value = ctx.params.get(parameter.name or "")
        if value is None or not isinstance(parameter.type, InputFile):
            continue
        for path in value if isinstance(value, tuple) else (value,):
            if not os.path.lexists(path) and not path.startswith("/vsi") and ":" not in path:
                raise InputError(f"{path}: there is no such file")


def refuse_same_files(ctx: click.Context) -> None:
    """Raise a usage error if an output of the command is one of its inputs or another output, also by way
    of links.
    """
    outputs = _files(ctx, "outputs")
    for number, (name, path) in enumerate(outputs):
        _refuse(name, path, outputs[:number])
    if outputs:
        read = _inputs(ctx)
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

        names = (path for _, path in [*_inputs(ctx), *_files(ctx, "outputs")])
        depfile_rule("target", names)


def _inputs(ctx: click.Context) -> list[tuple[str, Path]]:
    """Every file that the command reads; found once, since an index or a VRT is opened for it."""
    found: list[tuple[str, Path]] = ctx.meta.setdefault("lcp.inputs", [])
    if not found:
        found += _files(ctx, "inputs")
    return found


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
    """Files that are read with a raster: its label or its image, sidecar files, and what a VRT names."""
    from lcp_catalog.dem.dem import files_beside  # imports rasterio

    yield from files_beside(Path(path))


def config_files(path: str) -> Iterator[Path]:
    """Maps and reflectance model that a BUILD.toml names, with what is read with them; none for an invalid
    file, which is refused when it is read.
    """
    from lcp_catalog.errors import LcpError
    from lcp_catalog.production.config import BuildConfig

    try:
        named = BuildConfig.from_toml(Path(path)).files
    except LcpError:
        return
    for file in named:
        yield from RASTER.inputs(str(file))


def shard_files(path: str) -> Iterator[Path]:
    """The catalogues that an index names; none for another file, or an index that is refused when it is read."""
    if path.lower().endswith(INDEX):
        from lcp_catalog.catalog.stored import sharded
        from lcp_catalog.catalog.verification import open_catalog
        from lcp_catalog.errors import LcpError

        with suppress(LcpError):
            source = sharded(open_catalog(path, check=False))
            yield from map(source.path_of, source.every) if source else ()


CATALOG = InputFile(shard_files)
"""A catalogue, or an index of catalogues."""

RASTER = InputFile(raster_files)
"""A DEM, an image or a map."""


class _Brightness(InputFile):
    """An albedo map, or a word for the package's own or for none, which is no file of the command."""

    def inputs(self, value: str) -> Iterator[Path]:
        return iter(()) if value in (MOON_MAP, NO_MAP) else super().inputs(value)


BRIGHTNESS = _Brightness(raster_files)
