"""Compiled kernels on disk: a file for each kernel and signature, in a folder named after what they depend on (`key`).

They are looked up in the installed package, then in the shared folder that ``LCP_KERNELS`` names, which is only read,
then in the user's folder, where those that are compiled here are written; where that cannot be, in the temporary
folder. A file is code that will be run: only files of owners who could change this package are read. Each begins with a
digest of its place and content: a damaged file is compiled again. numba's own cache has an index, which two processes
can spoil, crashes on damaged files, and does not see that a kernel's callee has changed in another file.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import logging
import multiprocessing
import os
import pickle
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba
from numba.core import config, environment, event
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

from .compilation import KernelCompiler, PartCompiler, only_parts
from .cpu_level import level, target
from .waiting import sleep_between_kernels

log = logging.getLogger(__name__)
sleep_between_kernels()

_HERE = Path(__file__).parent

_WITHOUT_CODE = {_HERE / name for name in ("cache.py", "entries.py", "waiting.py")}
"""Sources on which no compiled code depends."""

_PLACES = [os.fsencode(f"{Path(file).parents[1]}/") for file in (_HERE, numba.__file__)]
"""Folders of this machine, which no file names: it may be used on others."""

SHARED = "LCP_KERNELS"
"""The environment's variable that names the shared folder."""

LINKED = numba.version_info.short == (0, 68)
"""Whether kernels are compiled as `compilation` does it, which rests on the insides of numba that this version has. With
others they are compiled as numba does it: the same results, in twice the time.
"""

_KEPT = 20
"""Folders in the user's folder: those of other versions are removed when another one is made, the oldest first."""


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """``numba.njit`` with the options given, and the files of this module. ImportError where numba shall not compile."""
    if config.DISABLE_JIT:
        text = "NUMBA_DISABLE_JIT is set, and kernels only run compiled: unset it"
        raise ImportError(text, name="numba")

    def kernel(function: Callable[..., Any]) -> Any:
        if not LINKED:
            compiled = numba.njit(**options)(function)
            compiled._cache = _Files(function)
            return compiled
        own: dict[str, Any] = {**options, "no_cfunc_wrapper": True}
        compiled = numba.njit(**own | {"pipeline_class": KernelCompiler})(function)
        compiled._cache = _Files(function)
        own |= {"no_cpython_wrapper": True, "pipeline_class": PartCompiler}
        part = numba.njit(**own)(function)
        part._cache = _PartFiles(function)
        compiled.get_call_template = part.get_call_template  # what other kernels ask for
        compiled.get_overload = part.get_overload
        return compiled

    return kernel


@functools.cache
def key() -> str:
    """The name of the folders: the processor's level, and a digest of all that compiled code depends on."""
    # former versions crash on files without LLVM's code: they look in folders that are named without these words
    digest = hashlib.sha256(b"machine code")
    for path in sorted({*_HERE.rglob("*.py")} - _WITHOUT_CODE):
        digest.update(path.relative_to(_HERE).as_posix().encode() + b"\0" + path.read_bytes())
    libraries = numba.__version__, llvmlite.__version__, sys.implementation.cache_tag, target()
    digest.update(repr((libraries, config.USING_SVML, config.OPT, config.BOUNDSCHECK)).encode())
    return f"{level()}-{digest.hexdigest()[:16]}"


def folders() -> Iterator[Path]:
    """The folders in which files are looked up."""
    yield _HERE / "compiled" / key()
    if os.environ.get(SHARED):
        yield Path(os.environ[SHARED]) / key()
    yield from _own_folders()


def _own_folders() -> Iterator[Path]:
    """The folders in which files are written: in the first where that is possible."""
    own = os.environ.get("NUMBA_CACHE_DIR") or AppDirs("lcp-catalog", False).user_cache_dir
    yield Path(own) / "kernels" / key()
    if hasattr(os, "getuid"):
        parent = Path(tempfile.gettempdir()) / f"lcp-kernels-{os.getuid()}"
        if _is_ours(parent):
            yield parent / key()


def _is_ours(folder: Path) -> bool:
    """A folder is not there, or this user's: in the temporary folder others could have made it, or a link."""
    try:
        facts = folder.lstat()
    except OSError:
        return True
    return stat.S_ISDIR(facts.st_mode) and facts.st_uid == os.getuid()


def file_name(kernel: str, signature: str) -> str:
    """The name of the file of a kernel (module below this package, and function) for a signature."""
    return f"{kernel}-{hashlib.sha256(signature.encode()).hexdigest()[:16]}.kernel"


def whole_file(name: str) -> Path | None:
    """The first undamaged file of this name."""
    return next((path for path in (f / name for f in folders()) if _read(path)), None)


class _Files:
    """The files of one kernel, as numba's dispatcher uses a cache."""

    def __init__(self, function: Callable[..., Any]) -> None:
        module = function.__module__.removeprefix(f"{__package__}.")
        self.kernel = f"{module}.{function.__qualname__}"

    @property
    def cache_path(self) -> str:
        """The user's folder."""
        return str(next(_own_folders()))

    def load_overload(self, signature: tuple[Any, ...], context: Any) -> Any:
        """numba's result of a compilation, from the first undamaged file; None without. numba would first make ready
        to compile, which takes longer than a small image.
        """
        rtsys.initialize(context)
        name = file_name(self.kernel, repr(signature))
        for folder in folders():
            body = _read(folder / name)
            if body is not None:
                try:
                    kept = _Unpickler(io.BytesIO(body)).load()
                    if LINKED:  # numba asks this before it asks LLVM for an entry's address
                        known = context.codegen()._engine._defined_symbols
                        known.add(kept[1].llvm_cpython_wrapper_name)
                    return numba.core.compiler.CompileResult._rebuild(context, *kept)
                except Exception:  # whatever an unreadable file raises: it is compiled again
                    log.debug("%s is not used", folder / name, exc_info=True)
        return None

    def save_overload(self, signature: tuple[Any, ...], result: Any) -> None:
        """Write a result; without a word where that is impossible."""
        if result.library.has_dynamic_globals or not all(x.can_cache for x in result.lifted):
            return
        name = file_name(self.kernel, repr(signature))
        # the annotation names places of the source
        library, *others = result._replace(type_annotation="")._reduce()
        if LINKED and library[1] == "object":
            # Beside machine code numba keeps LLVM's, to link it into other kernels, which are here compiled with parts
            # (`_PartFiles`): reading it would take longer than reading the machine code.
            code, nothing = library[2][0], llvmlite.binding.parse_assembly("").as_bitcode()
            library = *library[:2], (code, nothing)
        body = dumps((library, *others))
        for place in _PLACES:  # compiled code that raises errors names its source
            body = body.replace(place, b"./" * (len(place) // 2) + b"/" * (len(place) % 2))
        for folder in _own_folders():
            with contextlib.suppress(OSError):
                if not folder.is_dir():
                    _remove_old(folder.parent)
                write(folder / name, body)
                return

    def flush(self) -> None:
        """Nothing: a file is as good as what it is compiled from."""


class _PartFiles(_Files):
    """The files of a kernel as others call it, which are only read to compile those: in another process, or later."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self.kernel += ".part"

    def load_overload(self, signature: tuple[Any, ...], context: Any) -> Any:
        """As for a kernel."""
        with only_parts(context):
            return super().load_overload(signature, context)


class _Unpickler(pickle.Unpickler):
    """Reads a file without the modules of numba (and scipy) from which its kernel took functions."""

    def find_class(self, module: str, name: str) -> Any:
        return _environment if name == "_rebuild_env" else super().find_class(module, name)


def _environment(module: str, constants: list[Any], name: str) -> Any:
    """numba's environment of a compiled function. Its globals are used when it is compiled, not when it runs: of
    numba's own functions only the module's name is kept.
    """
    if environment.lookup_environment(name) is None and module.startswith("numba."):
        made = environment.Environment({"__name__": module})
        made.consts[:], made.env_name = constants, name
        environment.Environment._memo[name] = made
        return made
    return environment._rebuild_env(module, constants, name)


def _digest(path: Path, body: bytes) -> bytes:
    return hashlib.sha256(f"{path.parent.name}/{path.name}\0".encode() + body).digest()


def _read(path: Path) -> bytes | None:
    """The body of a file; None if it is not there, no plain file, damaged, or of an owner who is not trusted."""
    if not path.is_file():  # to open a pipe would wait for its writer
        return None
    try:
        with path.open("rb") as file:
            if not (path.is_relative_to(_HERE) or _is_trusted(os.fstat(file.fileno()))):
                _warn_of(path.parent)
                return None
            digest, body = file.read(hashlib.sha256().digest_size), file.read()
    except OSError:
        return None
    return body if digest == _digest(path, body) else None


@functools.cache
def _warn_of(folder: Path) -> None:
    log.warning(
        "%s: compiled kernels of another owner, or that others can write, are not used", folder
    )


def _is_trusted(facts: os.stat_result) -> bool:
    """Only owners whose files are run anyway can write the file: root, this user, and the owner of this package."""
    if not hasattr(os, "getuid"):
        return True
    others = facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return not others and facts.st_uid in {0, os.getuid(), os.stat(__file__).st_uid}


def write(path: Path, body: bytes) -> None:
    """Write a file of the cache, whole or not at all. OSError where that is impossible."""
    path.parent.mkdir(parents=True, exist_ok=True)
    number, part = tempfile.mkstemp(dir=path.parent, prefix=".")
    try:
        with open(number, "wb") as file:
            file.write(_digest(path, body) + body)
        os.chmod(part, 0o644)
        os.replace(part, path)
    except OSError:
        Path(part).unlink(missing_ok=True)
        raise


def _remove_old(parent: Path) -> None:
    """Remove folders of other versions, and of other sources, beyond `_KEPT`."""
    found = parent.glob("*-" + 16 * "[0-9a-f]")
    for path in sorted(found, key=lambda path: path.stat().st_mtime, reverse=True)[_KEPT:]:
        shutil.rmtree(path, ignore_errors=True)


class _Notice(event.Listener):
    """Says once that kernels are compiled, which delays the first image."""

    said = False

    def on_start(self, event: event.Event) -> None:
        if not self.said and isinstance(event.data["dispatcher"]._cache, _Files):
            self.said = True
            log.warning(
                "compiling kernels for this machine: up to two minutes, the first time only"
            )

    def on_end(self, event: event.Event) -> None:
        pass


if multiprocessing.parent_process() is None:  # one process of a build says it
    event.register("numba:compile", _Notice())
