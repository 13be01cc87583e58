"""Atomic output files: written under another name in the same folder, synced, then renamed."""

from __future__ import annotations

import csv
import ctypes
import errno
import hashlib
import itertools
import logging
import os
import re
import shutil
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from .choices import SPELLINGS
from .errors import ConfigError, OutputError, OutputExistsError, printable, unread
from .file_kinds import plain_opener
from .remote_files import archive_of, server_state, url_of

log = logging.getLogger(__name__)

try:
    import fcntl
except ImportError:  # Windows: what killed processes leave stays
    fcntl = None  # type: ignore[assignment]  # the module is optional


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


def ending_of(path: Path | str, endings: Sequence[str]) -> str:
    """The one of the ``endings`` that an output's name has, in capitals or in another spelling (``.tiff``) as well;
    ConfigError if it has none of them.
    """
    given = Path(path).suffix.lower()
    ending = SPELLINGS.get(given, given)
    if ending not in endings:
        raise ConfigError(f"{path}: the output must end in {' or '.join(endings)}")
    return ending


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
def write_aside(
    path: Path | str, overwrite: bool = False, inputs: Iterable[Path | str] = ()
) -> Iterator[Path]:
    """Yield a path of the same name to write to, in a folder of this process beside ``path`` (`_own_folder`).
    The file is renamed to ``path`` when the block ends without an error, and removed otherwise.

    The file is synced before it is renamed, the folder after it. Raises as `check_output` does, and
    OutputError for a full disk or a failed write. An output that another process has made meanwhile
    is replaced only with ``overwrite``.
    """
    target = check_output(path, overwrite, inputs)
    with _named(path), _own_folder(target) as folder:
        aside = folder / target.name
        yield aside
        _sync(aside)
        if overwrite:
            os.replace(aside, target)
        else:
            _publish_new(aside, target)
        _sync(target.parent)


@contextmanager
def folder_aside(
    path: Path | str, overwrite: bool = False, inputs: Iterable[Path | str] = ()
) -> Iterator[Path]:
    """Yield an empty folder to write files to. With `MANIFEST`, a file that names them, it is renamed to
    ``path`` when the block ends without an error, and removed otherwise.

    Raises as `check_output` does. With ``overwrite`` an existing folder is replaced, at once where the
    system can exchange two names (`_exchange`); OutputError if it holds anything that its own
    `MANIFEST` does not name, or another file by one of its names.
    """
    inputs = tuple(inputs)
    target = _check_new_folder(path, overwrite, inputs)
    with _named(path), _own_folder(target) as folder:
        aside = folder / target.name
        aside.mkdir()
        yield aside
        _write_manifest(aside)
        for file in [*aside.rglob("*"), aside]:
            _sync(file)
        if _check_new_folder(path, overwrite, inputs).is_dir():  # files may have come meanwhile
            _exchange(aside, target)
        else:
            os.rename(aside, target)
        _sync(target.parent)


MANIFEST = "lcp-export.sha256"
"""File of a folder that names its other files, with their SHA-256 sums as `sha256sum` writes and checks
them."""


def _write_manifest(folder: Path) -> None:
    files = sorted(file for file in folder.rglob("*") if not file.is_dir())
    sums = zip(file_facts(files), files, strict=True)
    lines = (f"{one['sha256']}  {file.relative_to(folder).as_posix()}\n" for one, file in sums)
    (folder / MANIFEST).write_text("".join(lines), encoding="utf-8", newline="\n")


def _check_new_folder(path: Path | str, overwrite: bool, inputs: Iterable[Path | str]) -> Path:
    """The real path of a folder to write, which is not there, or may be replaced."""
    target = Path(os.path.realpath(path))
    if not target.is_dir():
        if overwrite and os.path.lexists(target):
            raise OutputError(
                f"{path}: is a file, and the output is a folder; move it, or name another output"
            )
        return check_output(path, inputs=inputs)
    if not overwrite:
        raise OutputExistsError(f"{path} exists; use `overwrite` to replace it")
    for read in inputs:
        if Path(os.path.realpath(read)).is_relative_to(target):
            raise OutputError(f"{path}: holds {read}, which is read; name another folder")
    sums = _exported(target)
    folders = {above for file in sums for above in file.parents}
    for file in sorted(target.rglob("*")):
        name = file.relative_to(target)
        if name in sums:
            foreign = _is_changed(file, sums[name]) and "was changed since it was exported"
        else:
            foreign = name not in folders and "is no part of an export"
        if foreign:
            raise OutputError(
                f"{path}: holds {name}, which {foreign}; move it, or name another folder"
            )
    if not os.access(target.parent, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: no permission to write into {target.parent}")
    return target


def _exported(folder: Path) -> dict[Path, str]:
    """The files of a folder that its manifest names, with their sums, and the manifest; none without one."""
    manifest = folder / MANIFEST
    if not manifest.is_file():
        return {}
    with open(manifest, encoding="utf-8", errors="replace", opener=plain_opener) as file:
        return {Path(line[66:]): line[:64] for line in file.read().splitlines()} | {
            Path(MANIFEST): ""
        }


def _is_changed(file: Path, sum_256: str) -> bool:
    """True for a file that has not the sum of its manifest; the manifest has none (empty)."""
    if file.is_symlink() or not file.is_file():
        return True
    return bool(sum_256) and file_facts([file])[0]["sha256"] != sum_256


_LOCK, _FORMER = "lcp.lock", ".former"
_WRITERS = 8
"""Processes that usually write one output at a time, at most."""


@contextmanager
def _own_folder(target: Path) -> Iterator[Path]:
    """A new folder ``.NAME.N.part`` beside an output, removed with its content at the end.

    A file in it is locked as long as the process lives. What killed processes have left of the output
    is removed first.
    """
    folder, lock = _taken_folder(target)
    try:
        yield folder
    finally:
        for _ in range(2):  # a call can fail once
            _clear(folder)
        os.close(lock)


def _taken_folder(target: Path) -> tuple[Path, int]:
    """A folder that this process has made and locked, and the open lock."""
    remove_leftovers(target)
    for number in itertools.count():
        folder = _folder(target, number)
        with suppress(FileExistsError):
            folder.mkdir()
            with suppress(FileNotFoundError):  # another process took the folder for a leftover
                lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
                if lock_file(lock) is not False and os.fstat(lock).st_nlink:
                    return folder, lock
                os.close(lock)
    raise AssertionError("numbers do not end")


def _folder(target: Path, number: int) -> Path:
    return target.parent / f".{target.name[:60]}.{number}.part"  # 255 bytes at most


def remove_leftovers(path: Path | str) -> None:
    """Remove what killed processes have left of an output."""
    target = Path(os.path.realpath(path))
    for number in range(_WRITERS):
        remove_left(_folder(target, number))


def remove_left(folder: Path) -> None:
    """Remove a folder of `_own_folder` unless its process lives, or the file system has no locks."""
    try:
        lock = os.open(folder / _LOCK, os.O_RDWR)
    except OSError:
        with suppress(OSError):
            folder.rmdir()  # killed before the lock was made; a folder of other files stays
        return
    try:
        if lock_file(lock):
            _clear(folder)
    finally:
        os.close(lock)


def _clear(folder: Path) -> None:
    """Remove a folder of this process, its lock last; put an output back that `_exchange` was moving."""
    with suppress(OSError):  # what stays now, the next run removes
        for former in folder.glob(f"*{_FORMER}"):
            target = folder.parent / former.name.removesuffix(_FORMER)
            if not os.path.lexists(target):
                os.rename(former, target)
        for file in folder.iterdir():
            if file.is_dir():
                shutil.rmtree(file)
            elif file.name != _LOCK:
                file.unlink()
        (folder / _LOCK).unlink()
        folder.rmdir()


def lock_file(opened: int, shared: bool = False) -> bool | None:
    """Lock an open file until it is closed, or this process ends: False if another process has locked it,
    None on a system without locks.
    """
    if fcntl is None:
        return None
    try:
        fcntl.flock(opened, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP):
            raise
        return None
    return True


def _exchange(new: Path, target: Path) -> None:
    """Give two folders each other's name, at once where Linux and the file system can (`renameat2`).

    Elsewhere by two renames: between them there is no output. A process that is killed there leaves the
    former one in its own folder, from which the next run puts it back.
    """
    renameat2 = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is not None:
        if renameat2(_HERE, os.fsencode(new), _HERE, os.fsencode(target), _EXCHANGE) == 0:
            return
        code = ctypes.get_errno()
        if code not in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
            raise OSError(code, os.strerror(code), str(target))
    os.rename(target, new.with_name(target.name + _FORMER))
    os.rename(new, target)  # an error: `_clear` puts the former one back


_HERE, _EXCHANGE = -100, 2
"""Constants of Linux: AT_FDCWD and RENAME_EXCHANGE."""


def write_bytes(path: Path | str, content: bytes | memoryview, overwrite: bool = False) -> None:
    """Write a whole file as `write_aside` does."""
    with write_aside(path, overwrite) as aside:
        aside.write_bytes(content)


def write_lines(path: Path | str, lines: Iterable[str], overwrite: bool = False) -> None:
    """Write a text, whose lines have their ends, as `write_aside` does, as the lines come."""
    with (
        write_aside(path, overwrite) as aside,
        aside.open("w", encoding="utf-8", newline="") as file,
    ):
        file.writelines(lines)


def write_files(files: Mapping[Path, bytes] | Mapping[str, bytes], overwrite: bool = False) -> None:
    """Write all files, or none of them if one cannot be written. The first appears last."""
    with ExitStack() as stack:
        for name, content in files.items():
            stack.enter_context(write_aside(name, overwrite)).write_bytes(content)


def write_folder(folder: Path, texts: Mapping[str, str], overwrite: bool = False) -> None:
    """Write files of a folder, which is made if needed, as `write_files` does; its other files stay.
    Raises as `check_folder`.
    """
    check_folder(folder, texts, overwrite)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: the folder cannot be created: {error.strerror}") from error
    write_files({folder / name: text.encode("utf-8") for name, text in texts.items()}, overwrite)


def file_facts(paths: Iterable[Path]) -> list[dict[str, Any]]:
    """Names (without folders), sizes and SHA-256 sums of files, for the provenance of a result; of a file on a
    server its ETag in place of the sum.
    """
    return [_facts(path) for path in paths]


def _facts(path: Path) -> dict[str, Any]:
    name = printable(path.name)
    if (url := url_of(path)) is not None:
        size, tag = server_state(url)
        return {"name": name, "size": size, "etag": printable(tag)}
    stat = os.stat(path)
    return {"name": name, "size": stat.st_size, "sha256": _sha256(str(path), file_state(stat))}


def content_of(facts: Mapping[str, Any]) -> str:
    """What tells the content of one of the `file_facts` from another: its sum, or its ETag."""
    return str(facts.get("sha256") or f"{facts['size']} {facts['etag']}")


def state_of(path: Path) -> tuple[int | str, ...]:
    """`file_state` of a file, or of the archive that it lies in; of one on a server, which is asked, size and ETag."""
    url = url_of(path)
    return file_state(os.stat(archive_of(path) or path)) if url is None else server_state(url)


def file_state(facts: os.stat_result) -> tuple[int, ...]:
    """Numbers that change when a file is written or replaced, even if its size and its time of
    modification are made the same again.
    """
    return facts.st_dev, facts.st_ino, facts.st_size, facts.st_mtime_ns, facts.st_ctime_ns


def csv_lines(rows: Iterable[Iterable[Any]]) -> Iterator[str]:
    """Lines of a CSV table (RFC 4180), its texts as `csv_cell` returns them."""
    return csv_rows(map(csv_cell, row) for row in rows)


def csv_rows(rows: Iterable[Iterable[Any]]) -> Iterator[str]:
    """Lines of a CSV table of numbers, and of texts that `csv_cell` has seen."""
    writer = csv.writer(_Line(), lineterminator="\r\n")
    return map(cast("Callable[[Iterable[Any]], str]", writer.writerow), rows)


class _Line:
    """A file whose ``write`` returns the line, which a CSV writer then returns."""

    def write(self, text: str) -> str:
        return text


def csv_cell(value: Any) -> Any:
    """A value for a CSV table. A text that a spreadsheet would take for a formula gets an apostrophe before it;
    texts of numbers stay.
    """
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")):
        try:
            float(value)
        except ValueError:
            return f"'{value}"
    return value


_SETTLED_NS = 2_000_000_000
"""Age of a change from which on a later one has another time, on file systems that count in steps of 2 s."""

_SUMS: dict[tuple[int, ...], str] = {}
"""Sums by the file's `_settled` state."""


def _settled(state: tuple[int, ...]) -> tuple[int, ...]:
    """A `file_state` without the device, which is another on every machine; empty for a file that has just changed."""
    return state[1:] if time.time_ns() - max(state[3:]) > _SETTLED_NS else ()


def known_sums() -> list[list[int | str]]:
    """Sums that this process has computed or was told, with the states of the files, for JSON."""
    return [[*state, digest] for state, digest in _SUMS.items()]


def know_sums(found: Any) -> None:
    """Take sums that another process has computed (`known_sums`), so that a file in the same state is not read again."""
    for one in found if isinstance(found, list) else ():
        match one:
            case [int(), int(), int(), int(), str()]:
                _SUMS[tuple(one[:-1])] = one[-1]


def unread_facts(paths: Iterable[Path], beside: Path) -> list[dict[str, Any]]:
    """`file_facts`, but of a file that need not be read now its state in place of size and sum: its sum is not known, it has
    not just changed, and it is in the file system of the folder ``beside``, where other processes see the same state.
    """
    device = os.stat(beside).st_dev
    return [_unread_facts(path, device) for path in paths]


def _unread_facts(path: Path, device: int) -> dict[str, Any]:
    if url_of(path) is None:
        own_device, *state = _local_state(path)
        settled = _settled((own_device, *state))
        if settled and settled not in _SUMS and own_device == device:
            return {"name": printable(path.name), "state": state}
    return _facts(path)


def _local_state(path: Path) -> tuple[int, ...]:
    try:
        return file_state(os.stat(path))
    except OSError as error:
        raise unread(path, error) from error


def are_as_noted(paths: Sequence[Path], noted: Any) -> bool:
    """True for files that are in the states, or of the content, of their ``noted`` `unread_facts`. A file in another state
    is read only if the sum in the noted state is known.
    """
    if not isinstance(noted, list) or len(noted) != len(paths):
        return False
    return all(_is_as_noted(path, one) for path, one in zip(paths, noted, strict=True))


def _is_as_noted(path: Path, noted: Any) -> bool:
    if not isinstance(noted, dict) or "state" not in noted:
        return bool(noted == _facts(path))
    if noted.get("name") != printable(path.name):
        return False
    if noted["state"] == list(_settled(_local_state(path))):
        return True
    sums = [one[-1] for one in known_sums() if one[:-1] == noted["state"]]
    if not sums:
        log.warning(
            "%s: was written or touched before its content was noted: it may be another", path
        )
        return False
    return content_of(_facts(path)) == sums[0]


def sum_in_state(state: tuple[int | str, ...]) -> str | None:
    """The sum of a file when it was in a `file_state`; None if it is not known."""
    return _SUMS.get(cast("tuple[int, ...]", state[1:]))


@lru_cache(maxsize=256)
def _sha256(path: str, state: tuple[int, ...]) -> str:
    settled = _settled(state)
    if settled not in _SUMS:
        found = _digest_of(path)
        if not settled:
            return found
        _SUMS[settled] = found
    return _SUMS[settled]


def _digest_of(path: str) -> str:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise unread(path, error) from error


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
            reason = error.strerror or ""
            if "errno" in reason:  # Arrow's own words
                reason = os.strerror(error.errno or errno.EIO)
            raise OutputError(f"{path}: cannot be written: {reason}") from error
        raise


def _publish_new(aside: Path, target: Path) -> None:
    """Give a file the name of an output that must not be there yet."""
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
