"""Checkpoints: finished areas of a build, stored beside the output until the catalogue is written, so that
an interrupted run loses none of them.

A checkpoint is an .npz file in ``OUTPUT.parts/`` that holds the fingerprint of its run, as does
``run.json`` there. ``run.lock`` is locked while a run uses the folder: by one build, or by any number
of parts of the same build. These files, and the folder if nothing else is in it, are removed when the
catalogue has been written.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import logging
import os
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from ..atomic_files import remove_leftovers, write_aside
from ..errors import OutputExistsError
from ..rendering.plan import ScenePlan
from .area_job import AreaResult, Candidates

try:
    import fcntl
except ImportError:  # Windows: two builds of one output are not told from each other
    fcntl = None  # type: ignore[assignment]  # the module is optional

log = logging.getLogger(__name__)

_ENDING = ".parts"
_PLAN, _RUN, _LOCK, _NOTE = "scene_plan", "fingerprint", "run.lock", "run.json"
_AREAS = "r[0-9][0-9][0-9][0-9][0-9]c[0-9][0-9][0-9][0-9][0-9].npz"
"""Names of checkpoints (`areas.AreaTask.name`); other files in the folder are the user's."""


@dataclass(frozen=True)
class Checkpoints:
    """The checkpoints of one run."""

    folder: Path
    fingerprint: str

    @classmethod
    def beside(cls, output: Path, fingerprint: str) -> Checkpoints:
        """The checkpoints of an output file."""
        return cls(output.with_name(output.name + _ENDING), fingerprint)

    @contextlib.contextmanager
    def locked(self, shared: bool = False) -> Iterator[None]:
        """The folder, made if needed, for this run alone, or ``shared`` with other parts of a build:
        OutputExistsError while another build uses it. The lock ends with the process, however that ends.
        """
        stream = self._own_lock(shared)
        try:
            yield
        finally:
            os.close(stream)

    def _own_lock(self, shared: bool) -> int:
        """The open and locked file; OutputExistsError if another process has locked it."""
        while True:
            self.folder.mkdir(exist_ok=True)
            try:
                stream = os.open(self.folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
            except FileNotFoundError:  # the folder of a build that ends now
                continue
            try:
                _lock(stream, shared)
                if os.stat(self.folder / _LOCK).st_ino == os.fstat(stream).st_ino:
                    return stream
            except BlockingIOError:
                os.close(stream)
                raise OutputExistsError(
                    f"{self.folder}: another build of this output is running; wait for it, or give another output"
                ) from None
            except FileNotFoundError:
                pass  # removed by a build that ended now
            os.close(stream)

    def begin(self, resume: bool, overwrite: bool = False) -> None:
        """Note the run in the folder. Without ``resume`` remove older checkpoints. Those of a run with
        other inputs are removed if ``overwrite`` is set too; else they raise OutputExistsError. What a
        killed run left of its catalogue is removed.
        """
        remove_leftovers(self.folder.with_name(self.folder.name.removesuffix(_ENDING)))
        if not resume or (overwrite and not self._is_same_run()):
            self._remove_files()
        self.require_same_run()
        self._write_note(self.parts)

    def join(self, parts: int) -> None:
        """Note a run of so many parts in the folder. OutputExistsError if it is of a run with other
        inputs.
        """
        self.require_same_run()
        if self.parts != parts:
            with contextlib.suppress(OutputExistsError):  # another part was quicker: the same run?
                self._write_note(parts, overwrite=self._note() is not None)
            self.require_same_run()

    def require_same_run(self) -> None:
        """OutputExistsError if the folder's checkpoints are of a run with other inputs."""
        if not self._is_same_run():
            raise OutputExistsError(
                f"{self.folder}: its finished areas are from a run with another configuration, DEM or version; "
                "run with --resume --overwrite, or without --resume, to remove them"
            )

    def _is_same_run(self) -> bool:
        note = self._note()
        return note is None or note.get("fingerprint") == self.fingerprint

    @property
    def parts(self) -> int | None:
        """Number of parts of the run that is noted in the folder; None if it has none."""
        return (self._note() or {}).get("parts")

    def _note(self) -> dict[str, Any] | None:
        try:
            note = json.loads((self.folder / _NOTE).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except ValueError:  # damaged: the fingerprint is not known
            note = None
        return note if isinstance(note, dict) else {}

    def _write_note(self, parts: int | None, overwrite: bool = True) -> None:
        note = {"fingerprint": self.fingerprint} | ({} if parts is None else {"parts": parts})
        with write_aside(self.folder / _NOTE, overwrite) as path:
            path.write_text(json.dumps(note), encoding="utf-8")

    def path(self, name: str) -> Path:
        """The file of an area."""
        return self.folder / f"{name}.npz"

    def write(self, name: str, result: AreaResult) -> None:
        """Store a finished area."""
        with write_aside(self.path(name), overwrite=True) as path, path.open("wb") as stream:
            arrays: dict[str, Any] = _flatten("", result.candidates)
            arrays[_PLAN] = np.array(str(result.plan))
            arrays[_RUN] = np.array(self.fingerprint)
            np.savez(stream, **arrays)

    def read(self, name: str) -> AreaResult | None:
        """A finished area; None if there is none, or its file is damaged or of another run (it is
        computed again).
        """
        try:
            with np.load(self.path(name), allow_pickle=False) as arrays:
                if str(arrays[_RUN]) != self.fingerprint:
                    return None
                plan = ScenePlan.from_json(json.loads(str(arrays[_PLAN])))
                return AreaResult(_unflatten("", Candidates, arrays), plan)
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None

    def remove(self) -> None:
        """Remove the checkpoints, and the folder unless it holds other files."""
        self._remove_files()
        (self.folder / _LOCK).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _remove_files(self) -> None:
        """Remove the run's files, also those that a killed process left half-written."""
        for pattern in (_NOTE, f".{_NOTE}.*.part", _AREAS, f".{_AREAS}.*.part"):
            for file in self.folder.glob(pattern):
                file.unlink(missing_ok=True)


def _lock(stream: int, shared: bool) -> None:
    """Lock an open file; BlockingIOError if another process has locked it otherwise."""
    if fcntl is None:
        return
    try:
        fcntl.flock(stream, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP):
            raise
        log.warning("the file system has no locks: do not run two builds of one output")


def _flatten(prefix: str, value: Any) -> dict[str, np.ndarray]:
    """Arrays of nested dataclasses by dotted name, without those that are None."""
    if value is None:
        return {}
    if not dataclasses.is_dataclass(value):
        return {prefix: value}
    found: dict[str, np.ndarray] = {}
    for field in dataclasses.fields(value):
        found |= _flatten(f"{prefix}.{field.name}".lstrip("."), getattr(value, field.name))
    return found


def _unflatten(prefix: str, kind: Any, arrays: Any) -> Any:
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        return arrays[prefix] if prefix in arrays or type(None) not in get_args(kind) else None
    hints = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]
    return kind(
        **{name: _unflatten(f"{prefix}.{name}".lstrip("."), hints[name], arrays) for name in names}
    )
