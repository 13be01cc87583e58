"""Atomic output files: written under another name in the same folder, synced, then renamed."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from .errors import OutputError, OutputExistsError


def check_output(
    path: Path | str, overwrite: bool = False, inputs: Iterable[Path | str] = ()
) -> Path:
    """Return the real path of an output (of a link: its target).

    OutputExistsError if it exists and ``overwrite`` is False; OutputError if its folder is missing
    or not writable, if the name belongs to something that is not a plain file (a folder, a
    device), or if it is one of the ``inputs``, which would be lost.
    """
    for read in inputs:
        if same_file(path, read):
            raise OutputError(f"{path}: is read, too ({read}); name another output")
    target = Path(os.path.realpath(path))  # a link's target is replaced, not the link
    if not target.parent.is_dir():
        raise OutputError(f"{path}: the folder {target.parent} does not exist; make it first")
    if os.path.lexists(target):
        if not stat.S_ISREG(target.stat().st_mode):
            raise OutputError(f"{path}: is not a plain file and cannot be an output")
        if not overwrite:
            raise OutputExistsError(f"{path} exists; use `overwrite` to replace it")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write into {target.parent}")
    return target


def same_file(first: Path | str, second: Path | str) -> bool:
    """True for two names of one file: also through symbolic links, and hard links of a file that exists."""
    if os.path.realpath(first) == os.path.realpath(second):
        return True
    try:
        return os.path.samefile(first, second)
    except OSError:
        return False


def check_folder(folder: Path, names: Iterable[str], overwrite: bool) -> None:
    """Check the files ``names`` of a folder, which need not exist yet, as `check_output` does.
    OutputError if no folder can be at that place.
    """
    names = tuple(names)
    if folder.is_dir():
        for name in names:
            check_output(folder / name, overwrite)
    elif folder.exists():
        raise OutputError(f"{folder}: is not a folder; -o must name one for {', '.join(names)}")
    else:
        check_output(folder)


@contextmanager
def write_aside(path: Path | str, overwrite: bool = False) -> Iterator[Path]:
    """Yield a path in the same folder to write to. It is renamed to ``path`` when the block ends
    without an error, and removed otherwise.

    The file is synced before it is renamed, the folder after it. Raises as `check_output` does, and
    OutputError for a full disk or a failed write. An output that another process has made meanwhile
    is replaced only with ``overwrite``.
    """
    target = check_output(path, overwrite)
    aside = target.parent / f".{target.name[:100]}.{secrets.token_hex(6)}.part"
    try:
        with _named(path):
            os.close(os.open(aside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            yield aside
            _sync(aside)
            _publish(aside, target, overwrite)
            _sync(target.parent)
    finally:
        with suppress(OSError):
            aside.unlink(missing_ok=True)


@contextmanager
def folder_aside(
    path: Path | str, endings: Iterable[str], overwrite: bool = False
) -> Iterator[Path]:
    """Yield an empty folder beside ``path`` to write files with these ``endings`` to. It is renamed to
    ``path`` when the block ends without an error, and removed otherwise.

    Raises as `check_output` does. With ``overwrite`` an existing folder is replaced; OutputError if it
    holds a file with another ending.
    """
    target = _check_new_folder(path, tuple(endings), overwrite)
    aside, old = (target.parent / f".{target.name[:100]}.{secrets.token_hex(6)}.part" for _ in "ab")
    try:
        with _named(path):
            aside.mkdir()
            yield aside
            for file in [*aside.rglob("*"), aside]:
                _sync(file)
            if target.is_dir():
                os.rename(target, old)
            os.rename(aside, target)
            _sync(target.parent)
    finally:
        for folder in (aside, old):
            shutil.rmtree(folder, ignore_errors=True)


def _check_new_folder(path: Path | str, endings: tuple[str, ...], overwrite: bool) -> Path:
    target = Path(os.path.realpath(path))
    if not target.is_dir():
        return check_output(path)
    if not overwrite:
        raise OutputExistsError(f"{path} exists; use `overwrite` to replace it")
    for file in target.rglob("*"):
        if not file.is_dir() and file.suffix not in endings:
            raise OutputError(
                f"{path}: holds {file.name}, no part of an export; name another folder"
            )
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write into {target.parent}")
    return target


def write_bytes(path: Path | str, content: bytes | memoryview, overwrite: bool = False) -> None:
    """Write a whole file as `write_aside` does."""
    with write_aside(path, overwrite) as aside:
        aside.write_bytes(content)


def remove_leftovers(path: Path | str) -> None:
    """Remove what killed processes have left of an output, while no process writes it."""
    target = Path(os.path.realpath(path))
    name = re.compile(rf"\.{re.escape(target.name[:100])}\.[0-9a-f]{{12}}\.part")
    for file in target.parent.iterdir():
        if name.fullmatch(file.name):
            file.unlink(missing_ok=True)


def file_facts(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Names (without folders), sizes and SHA-256 sums of files, for the provenance of a result."""
    found = [(path, os.stat(path)) for path in paths]
    return [
        {
            "name": printable(path.name),
            "size": stat.st_size,
            "sha256": _sha256(str(path), file_state(stat)),
        }
        for path, stat in found
    ]


def file_state(facts: os.stat_result) -> tuple[int, ...]:
    """Numbers that change when a file is written or replaced, even if its size and its time of
    modification are made the same again.
    """
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


def printable(text: str) -> str:
    """The text with escapes in place of control characters, of characters that change the direction of a
    line, and of bytes of a file name that are not UTF-8; line breaks and tabs stay.
    """
    return "".join(
        one if one.isprintable() or one in "\n\t" else one.encode("unicode_escape").decode()
        for one in text
    )


@lru_cache(maxsize=256)
def _sha256(path: str, _state: tuple[int, ...]) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def depfile_rule(target: Path | str, sources: Iterable[Path | str]) -> bytes:
    """A Make rule with the files that an output was made from, by the names that the user gave.
    OutputError for a name that no rule can hold.
    """
    goal = _make_name(str(target), "*?[]", "%\t")
    names = [_make_name(str(name), "*?[]|", "") for name in sources]
    return os.fsencode(f"{goal}: {' '.join(names)}\n")


def _make_name(name: str, escaped: str, refused: str) -> str:
    """A name as make reads it in a rule, with backslashes before white space, #, : and what is ``escaped``.
    OutputError for what has no escape: line breaks, =, ;, round brackets at the end, and ``refused``.
    """
    bad = re.search(rf"[\n\r=;{refused}]|\(.*\)$", name)
    if bad:
        raise OutputError(
            f"{name}: a rule for make cannot hold {bad[0]!r} there; rename the file, or leave out `depfile`"
        )
    name = re.sub(rf"(\\*)([\s#:{re.escape(escaped)}])", lambda m: m[1] * 2 + "\\" + m[2], name)
    return name.replace("$", "$$")


@contextmanager
def _named(path: Path | str) -> Iterator[None]:
    """Raise errors of the operating system as OutputError with the name of the output."""
    try:
        yield
    except (OutputError, OutputExistsError):
        raise
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT) or "No space left" in str(error):
            text = f"{path}: the disk is full; free some space and run again"
            raise OutputError(text) from error
        if isinstance(error, PermissionError) or error.errno in (
            errno.EROFS,
            errno.EIO,
            errno.EFBIG,
        ):
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
        raise


def _publish(aside: Path, target: Path, overwrite: bool) -> None:
    if overwrite:
        os.replace(aside, target)
        return
    try:
        os.link(aside, target)  # unlike a rename, it fails if the target exists by now
    except FileExistsError as error:
        text = f"{target} was created by another process meanwhile; use `overwrite` to replace it"
        raise OutputExistsError(text) from error
    except OSError:  # a file system without hard links
        os.replace(aside, target)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
