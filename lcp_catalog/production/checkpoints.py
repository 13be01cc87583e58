"""Checkpoints: finished areas of a build, stored beside the output until the catalogue is written, so that
an interrupted run loses none of them.

A checkpoint is a file in ``OUTPUT.parts/``: a head with the fingerprint of its run, the name of its area and a
checksum, the scene plan, the table of the area's candidates with the checksum of each record, then the records
(`finished_area`). The table is read without the records, and some records without the others. NumPy's
.npz could not: it opens in milliseconds, and a part of an array cannot be read and checked.

The areas of several levels lie in one folder, with the number of the level in their names, and while the
catalogue is written, one of each level beside them.

``run.json`` in the folder names the run too, ``chosen.json`` the candidates that parts evaluate in a second pass. ``run.lock``
is locked while a run uses the folder: by one build, or by any number of parts of the same build. These files, and the folder if
nothing else is in it, are removed when the catalogue has been written.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..arrays import AnyArray, Bytes, Index
from ..atomic_files import (
    know_sums,
    known_sums,
    lock_file,
    remove_left,
    remove_leftovers,
    write_aside,
)
from ..errors import AreaFailedError, OutputExistsError, printable
from ..file_kinds import plain_opener
from ..rendering.plan import ScenePlan
from .code_facts import differences
from .finished_area import TABLE, FinishedArea, checksums

log = logging.getLogger(__name__)

_ENDING = ".parts"
_LOCK, _NOTE, _CHOSEN, _AREA = "run.lock", "run.json", "chosen.json", ".area"
_AREAS = f"r[0-9][0-9][0-9][0-9][0-9]c[0-9][0-9][0-9][0-9][0-9]{_AREA}"
_PASSES = _AREAS.replace(_AREA, f"[a-z]{_AREA}")
_OF_LEVEL, _LEVEL = (f"l[0-9][0-9]{_AREAS}", f"l[0-9][0-9]{_PASSES}"), "level[0-9][0-9].h5"
_KEPT = _AREAS, _PASSES, *_OF_LEVEL, _LEVEL, _CHOSEN
"""Names of checkpoints (`area_job.AreaJob.name`), also of a level, and of the catalogues of levels; other
files in the folder are the user's.
"""

_HEAD = struct.Struct("<8s64s16sQQQQQ")
"""Start of a checkpoint: `_MAGIC`, fingerprint, name of the area, bytes of the plan, rows of the table, stages of
a row, number of records, bytes of a record. The checksum of head, plan, table and stages follows, then these
and the records.
"""

_MAGIC, _SUM = b"LCP-AREA", struct.Struct("<I")

_SMALL_BYTES = 2**14
"""Checkpoints up to this size are checked in a single read."""

_READ_BYTES = 2**24
"""Records that are read together when a checkpoint is checked."""


def fingerprint(facts: Any) -> str:
    """Digest of facts that JSON can hold."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class StoredArea:
    """A checkpoint without its records: the table of the candidates, their stages
    (`finished_area.FinishedArea`), the scene plan as JSON, and where the records are: their number,
    the bytes of each, and the bytes before them.
    """

    table: AnyArray
    stages: Bytes
    plan: str
    records: int
    record_bytes: int
    before: int


@dataclass(frozen=True)
class Checkpoints:
    """The checkpoints of one run."""

    folder: Path
    fingerprint: str
    facts: Mapping[str, str] = field(default_factory=dict)  # what the fingerprint is made of
    files: Any = ()
    """Of the input files what is noted beside (`atomic_files.unread_facts`)."""

    @classmethod
    def beside(cls, output: Path, facts: Mapping[str, str], files: Any = ()) -> Checkpoints:
        """The checkpoints of an output file; ``facts``: all that determines the areas' content, by name."""
        return cls(output.with_name(output.name + _ENDING), fingerprint(facts), facts, files)

    @classmethod
    def noted_files(cls, output: Path) -> Any:
        """The ``files`` that a run of the same output has noted, None without one. Their sums that it has noted are
        known from now on (`atomic_files.know_sums`).
        """
        known = cls.beside(output, {})
        know_sums(known._sums())
        return (known._note() or {}).get("files")

    @contextlib.contextmanager
    def locked(self, shared: bool = False) -> Iterator[None]:
        """The folder, made if needed, for this run alone, or ``shared`` with other parts of a build:
        OutputExistsError while another build uses it. The lock ends with the process, however that ends.
        A folder of this run alone that an error leaves without a finished area is removed.
        """
        stream = self._own_lock(shared)
        try:
            yield
        except BaseException:
            if not shared and not any(any(self.folder.glob(name)) for name in _KEPT):
                self.remove()
            raise
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
            locked = lock_file(stream, shared)
            if locked is False:
                os.close(stream)
                raise OutputExistsError(
                    f"{self.folder}: another build of this output is running; wait for it, or give another output"
                )
            if locked is None:
                log.warning("the file system has no locks: do not run two builds of one output")
            with contextlib.suppress(FileNotFoundError):  # removed by a build that ended now
                if os.stat(self.folder / _LOCK).st_ino == os.fstat(stream).st_ino:
                    return stream
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
        else:
            self.note_sums()

    def note_sums(self) -> None:
        """Note the sums of input files that this process knows and the folder does not."""
        if any(one not in self._sums() for one in known_sums()):
            self._write_note(self.parts)

    def require_same_run(self) -> None:
        """OutputExistsError if the folder's checkpoints are of another run; it says in what this differs."""
        if self._is_same_run():
            return
        its = (self._note() or {}).get("facts")
        its = (
            {name: printable(str(fact)) for name, fact in its.items()}
            if isinstance(its, dict)
            else {}
        )
        raise OutputExistsError(
            f"{self.folder}: its finished areas are from a run with another "
            f"{differences(its, self.facts) or 'configuration, DEM or version'}; go on with the same, or run with "
            "`resume` and `overwrite`, or without `resume`, to remove them"
        )

    def _is_same_run(self) -> bool:
        note = self._note()
        return note is None or note.get("fingerprint") == self.fingerprint

    def _sums(self) -> list[Any]:
        found = (self._note() or {}).get("sums")
        return found if isinstance(found, list) else []

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
        note: dict[str, Any] = {"fingerprint": self.fingerprint, "facts": dict(self.facts)}
        note |= {} if parts is None else {"parts": parts}
        note |= {"files": self.files, "sums": known_sums()}
        with write_aside(self.folder / _NOTE, overwrite) as path:
            path.write_text(json.dumps(note), encoding="utf-8")

    def write_chosen(self, rounds: Mapping[str, Mapping[str, Index]]) -> None:
        """Store which candidates of which areas are evaluated in each round of a second pass, for its parts."""
        text = json.dumps(
            {
                step: {name: rows.tolist() for name, rows in of.items()}
                for step, of in rounds.items()
            }
        )
        note = {"fingerprint": self.fingerprint, "sum": zlib.crc32(text.encode()), "rounds": text}
        with write_aside(self.folder / _CHOSEN, overwrite=True) as path:
            path.write_text(json.dumps(note), encoding="utf-8")

    def chosen(self) -> dict[str, dict[str, Index]] | None:
        """What `write_chosen` stored; None if nothing is stored, or it is damaged or of another run."""
        try:
            note = json.loads((self.folder / _CHOSEN).read_text(encoding="utf-8"))
            text = note["rounds"]
            if (note["fingerprint"], note["sum"]) != (self.fingerprint, zlib.crc32(text.encode())):
                return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None
        return {
            step: {name: np.array(rows, np.int64) for name, rows in of.items()}
            for step, of in json.loads(text).items()
        }

    def path(self, name: str) -> Path:
        """The file of an area."""
        return self.folder / f"{name}{_AREA}"

    def level_file(self, number: int) -> Path:
        """The catalogue of a level, which exists while that of all levels is written."""
        return self.folder / f"level{number:02d}.h5"

    def write(self, name: str, area: FinishedArea) -> None:
        """Store a finished area."""
        plan, records = str(area.plan).encode(), area.records
        stages = np.zeros((len(area.table), 0), np.uint8) if area.stages is None else area.stages
        sizes = (len(plan), len(area.table), stages.shape[1], len(records), records.dtype.itemsize)
        head = _HEAD.pack(*self._marks(name), *sizes)
        checked = head + plan + area.table.tobytes() + stages.tobytes()
        with write_aside(self.path(name), overwrite=True) as path, path.open("wb") as stream:
            stream.write(head + _SUM.pack(zlib.crc32(checked)) + checked[len(head) :])
            stream.write(np.ascontiguousarray(records).view(np.uint8).data)

    def _marks(self, name: str) -> tuple[bytes, bytes, bytes]:
        """What the head of an area's checkpoint begins with."""
        return _MAGIC, self.fingerprint.encode().ljust(64)[:64], name.encode().ljust(16)

    def read(self, name: str) -> StoredArea | None:
        """A finished area without its records; None if there is none, or its file is damaged or of
        another area or run (it is computed again).
        """
        try:
            with open(self.path(name), "rb", buffering=0, opener=plain_opener) as stream:
                return self._read(name, stream)
        except OSError:
            return None

    def _read(self, name: str, stream: IO[bytes]) -> StoredArea | None:
        head = stream.read(_HEAD.size + _SUM.size)
        if len(head) < _HEAD.size + _SUM.size:
            return None
        *marks, plan_bytes, rows, cells, records, each = _HEAD.unpack_from(head)
        table_bytes = rows * TABLE.itemsize
        body_bytes = plan_bytes + table_bytes + rows * cells
        before = len(head) + body_bytes
        if tuple(marks) != self._marks(name):
            return None
        if os.fstat(stream.fileno()).st_size != before + records * each:
            return None
        body = stream.read(body_bytes)
        if zlib.crc32(head[: _HEAD.size] + body) != _SUM.unpack_from(head, _HEAD.size)[0]:
            return None
        table = np.frombuffer(body, TABLE, rows, plan_bytes).copy()  # the plan's bytes can go
        stages = np.frombuffer(body, np.uint8, rows * cells, plan_bytes + table_bytes)
        plan = body[:plan_bytes].decode()
        return StoredArea(table, stages.reshape(rows, cells), plan, records, each, before)

    def is_whole(self, name: str) -> bool:
        """True if the area is finished and its file undamaged, the records too. A file that is not what its
        name says is named in a warning.
        """
        try:
            file = f"{self.folder}{os.sep}{name}{_AREA}"  # a path of pathlib takes longer to make
            with open(file, "rb", buffering=_SMALL_BYTES, opener=plain_opener) as stream:
                area = self._read(name, stream)
                if area is not None and _are_whole(stream, area):
                    return True
        except FileNotFoundError:
            return False
        except (OSError, ValueError):  # ValueError: it was cut short meanwhile
            pass
        log.warning(
            "%s: is damaged, or of another area or run; the area counts as not computed", file
        )
        return False

    def records(
        self, name: str, kind: np.dtype[np.void], before: int, rows: Index, expected: AnyArray
    ) -> AnyArray:
        """Records ``rows`` of an area, of type ``kind``, that start after so many bytes and have the
        ``expected`` checksums. AreaFailedError if the file is lost, damaged or replaced.
        """
        first, count = int(rows.min()), int(np.ptp(rows)) + 1
        span = self._stored(name, kind, before, first, count)
        if len(span) == count:
            found = span[rows - first]
            if np.array_equal(checksums(found), expected):
                return found
        raise lost_area(self.path(name))

    def _stored(
        self, name: str, kind: np.dtype[np.void], before: int, first: int, count: int
    ) -> AnyArray:
        """Records of an area from the ``first``, without a check; fewer if they cannot be read."""
        try:
            offset = before + first * kind.itemsize
            return np.fromfile(self.path(name), kind, count, offset=offset)
        except OSError:
            return np.zeros(0, kind)

    def remove(self) -> None:
        """Remove the checkpoints, and the folder unless it holds other files."""
        self._remove_files()
        (self.folder / _LOCK).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _remove_files(self) -> None:
        """Remove the run's files, also those that a killed process left half-written."""
        for name in (_NOTE, *_KEPT):
            for file in self.folder.glob(name):
                file.unlink(missing_ok=True)
            for left in self.folder.glob(f".{name}.*.part"):
                remove_left(left)


def _are_whole(stream: IO[bytes], area: StoredArea) -> bool:
    """True if the records, which the stream gives next, have the checksums of the table."""
    expected = area.table["checksum"][area.table["worth"] > 0]
    step = max(1, _READ_BYTES // max(1, area.record_bytes))
    for start in range(0, area.records, step):
        count = min(step, area.records - start)
        found = np.frombuffer(stream.read(count * area.record_bytes), (np.void, area.record_bytes))
        if not np.array_equal(checksums(found), expected[start : start + step]):
            return False
    return len(expected) == area.records


def lost_area(path: Path) -> AreaFailedError:
    """The error for a checkpoint that is no longer there or no longer the same."""
    return AreaFailedError(
        f"{path}: the finished area is no longer there, or it is damaged or replaced by another build; "
        "run again with `resume`"
    )


@dataclass(frozen=True)
class JoinedAreas:
    """The candidates (n,) of areas in the order of their names, as a table of type
    `finished_area.TABLE`; the number of each one's area and of its record in it; and the merged plan.
    """

    checkpoints: Checkpoints
    names: Sequence[str]
    table: AnyArray
    area: Index
    record: Index
    before: Index  # bytes before the records, by area
    plan: ScenePlan

    @classmethod
    def read(
        cls,
        checkpoints: Checkpoints,
        names: Sequence[str],
        seen: Callable[[AnyArray, Bytes], None] = lambda table, stages: None,
    ) -> JoinedAreas:
        """AreaFailedError for an area that is lost or damaged. ``seen``: called with the table and the
        stages of each area in turn, which are not kept.
        """
        tables: list[AnyArray] = []
        before: list[int] = []

        def plans() -> Iterator[tuple[str, ScenePlan]]:
            for name in names:
                found = checkpoints.read(name)
                if found is None:
                    raise lost_area(checkpoints.path(name))
                tables.append(found.table)
                before.append(found.before)
                seen(found.table, found.stages)
                yield name, ScenePlan.from_json(json.loads(found.plan))

        plan = ScenePlan.merged(plans())
        counts = [len(table) for table in tables]
        table = np.concatenate(tables)
        number = np.cumsum(table["worth"] > 0)
        first = np.cumsum([0, *counts[:-1]])  # rows
        earlier = np.concatenate([[0], number])[first]  # records in the areas before
        area = np.repeat(np.arange(len(names)), counts)
        return cls(
            checkpoints, names, table, area, number - 1 - earlier[area], np.array(before), plan
        )

    def records(self, rows: Index, kind: np.dtype[np.void]) -> AnyArray:
        """The records of rows of the table, of type ``kind``; each area is read once. AreaFailedError
        for an area that is lost or damaged.
        """
        found = np.empty(len(rows), kind)
        order = np.argsort(self.area[rows], kind="stable")
        rows = rows[order]
        areas, starts = np.unique(self.area[rows], return_index=True)
        ends = [*starts[1:].tolist(), len(rows)]
        for area, start, end in zip(areas.tolist(), starts.tolist(), ends, strict=True):
            own = rows[start:end]
            found[start:end] = self.checkpoints.records(
                self.names[area],
                kind,
                int(self.before[area]),
                self.record[own],
                self.table["checksum"][own],
            )
        if (np.diff(order) > 0).all():
            return found
        back = np.empty(len(order), np.int64)
        back[order] = np.arange(len(order))
        return found[back]
