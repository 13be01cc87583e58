"""One system call on a command's files is made to fail (`failing_calls.c`), and what is left is judged.

The process that judges has the library loaded from its start (`preloaded`). It runs a command once, so that all
imports are made, and then forks a process for each call that shall fail.
"""

from __future__ import annotations

import ctypes
import errno
import json
import mmap
import multiprocessing.util
import os
import pickle
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import _ExecutorManagerThread
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import h5py
from lcp_cli.main import run

from benchmarks.faults.processes import is_gone, wait_for
from lcp_catalog import atomic_files, child_process
from lcp_catalog.catalog import file_structure, stored, verification
from tests.helpers.small_commands import Words

KINDS = {
    # kind of call: (error, how it fails), of which each is tried
    "open": (("EIO", "once"), ("EMFILE", "once")),
    "read": (("EIO", "once"), ("EINTR", "each"), ("EINTR", "halves")),
    "write": (("EIO", "once"), ("ENOSPC", "on"), ("EINTR", "each"), ("EINTR", "halves")),
    "rename": (("EIO", "once"), ("ENOSPC", "once")),
    "unlink": (("EIO", "once"),),
    "fsync": (("EIO", "once"), ("ENOSPC", "on")),
    "ftruncate": (("EIO", "once"), ("ENOSPC", "on")),
    "mmap": (("ENOMEM", "once"),),
    "mkdir": (("EIO", "once"), ("ENOSPC", "once")),
    "close": (("EIO", "once"),),
    "malloc": (("ENOMEM", "once"),),
}
"""In the order of the library. "on": every later call of the kind fails, too, as on a full disk. "each": every call
fails and succeeds when it is made again; "halves": every call moves half of its bytes, without an error. Of these two,
one run tries all calls; where its output is not whole, each call fails alone, see `ALONE`.
"""
OF_INPUTS = ("open", "read", "mmap", "close")
ALONE = {"each": "once", "halves": "short"}

LOCK = ".lock"
"""How the names end of files by which a command locks the folders that it writes to."""

_SOCKETS = "/pymp-"
"""How the folders begin that multiprocessing makes for its sockets."""

LONGEST_S = 300.0
_GONE_S = 60.0
"""Time in which processes end that a command has started, on a busy machine."""
_STATE = struct.Struct("6q16q64s512s512s")
_HOW = ("once", "on", "short", *ALONE)

_STATIONS: tuple[tuple[Any, str], ...] = (
    (stored.StoredFile, "opened"),
    (atomic_files, "_taken_folder"),
    (file_structure, "_storage_fault"),
    (h5py.Dataset, "__getitem__"),
)
_COUNTS = slice(6 * 8, (6 + len(KINDS)) * 8)
_NUMBERS = struct.Struct(f"{len(KINDS)}q")

Content = dict[str, bytes]
"""What files hold, by their names in a folder; of a folder nothing."""


@dataclass(frozen=True)
class Fault:
    """The ``nth`` call of a kind, counted from 1, fails."""

    kind: str
    nth: int
    error: str
    how: str

    def __str__(self) -> str:
        what = "half" if self.how in ("short", "halves") else self.error
        if self.how in ALONE:
            return f"{self.kind} {what}, all of them"
        return f"{self.kind} {self.nth} {what}{' and later' if self.how == 'on' else ''}"


@dataclass(frozen=True)
class Ended:
    """How a process ended; ``calls``: of each kind; ``failed``: the call that failed, empty if none did."""

    code: int
    out: str
    err: str
    calls: Mapping[str, int]
    failed: str
    fault: str = ""


def built(folder: Path) -> Path:
    """The library, compiled into a folder. FileNotFoundError without a compiler."""
    found = shutil.which("cc")
    if found is None:
        raise FileNotFoundError("there is no C compiler `cc`")
    source, library = Path(__file__).with_name("failing_calls.c"), folder / "failing_calls.so"
    options = ["-O2", "-Wall", "-Werror", "-fPIC", "-shared"]
    subprocess.run([found, *options, "-o", library, source, "-ldl"], check=True)
    return library


def preloaded(module: str, words: Sequence[str], folder: Path) -> int:
    """Run ``python -m module words`` with the library loaded before all others; its exit code."""
    environment = os.environ | {
        "LD_PRELOAD": str(built(folder)),
        "NUMBA_THREADING_LAYER": "workqueue",
    }
    return subprocess.run(
        [sys.executable, "-m", module, *words], env=environment, check=False
    ).returncode


class Attempts:
    """Runs of commands in forks of this process, each in a folder of its own below ``folder``."""

    def __init__(self, folder: Path) -> None:
        # calls are counted: none of them by a thread that says how long a command works
        patch("lcp_cli.progress.alive", lambda name: nullcontext()).start()
        self.folder = folder
        folder.mkdir()
        self.count = 0
        self._on_the_way = 0
        path = folder.with_suffix(".state")
        path.write_bytes(bytes(_STATE.size))
        os.environ["FAILING_CALLS_STATE"] = str(path)
        with open(path, "r+b") as file:
            self._state = mmap.mmap(file.fileno(), 0)
        ctypes.CDLL(None).failing_calls_start()

    def place(self, content: Content) -> Path:
        """A new folder with files."""
        self.count += 1
        path = self.folder / f"{self.count:06d}"
        path.mkdir()
        _fill(path, content)
        return path

    def run(
        self,
        words: str,
        place: Path,
        fault: Fault | None = None,
        at_stations: Callable[[dict[str, int]], object] | None = None,
    ) -> Ended:
        """A command in a process of its own that works in a folder; a function that it calls at its `stations`."""
        streams = self._streams(place)
        self._write(place, fault)
        process = os.fork()
        if not process:
            self._command(words, place, streams, at_stations, apart=fault is not None)
        return self._ended(process, place, streams, LONGEST_S if at_stations is None else None)

    def _ended(
        self, process: int, place: Path, streams: Sequence[Path], most_s: float | None = LONGEST_S
    ) -> Ended:
        """How a process ends that runs a command."""
        handle = os.pidfd_open(process)
        late = not select.select([handle], [], [], most_s)[0]
        os.close(handle)
        if late:
            os.killpg(process, signal.SIGABRT)
        code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        wrong = "it hangs" if late else ""
        if not wait_for(lambda: is_gone(process), _GONE_S):
            wrong = wrong or "processes are left"
            os.killpg(process, signal.SIGKILL)
        out, err = (stream.read_text(errors="replace") for stream in streams)
        for stream in streams:
            stream.unlink()
        _, _, _, _, _, _, *rest = _STATE.unpack(self._state[:])
        calls = dict(zip(KINDS, rest[: len(KINDS)], strict=True))
        call, path = (text.rstrip(b"\0").decode(errors="replace") for text in rest[16:18])
        failed = f"{call} {path.replace(str(place), '')}".strip()
        return Ended(
            code, out.replace(str(place), ""), err.replace(str(place), ""), calls, failed, wrong
        )

    def _write(self, place: Path, fault: Fault | None) -> None:
        """Nothing is counted before `_command` sets the first number."""
        numbers = [0] * 6
        if fault is not None:
            numbers[1:5] = (
                list(KINDS).index(fault.kind), fault.nth, getattr(errno, fault.error), _HOW.index(fault.how)
            )  # fmt: skip
        else:
            numbers[1] = len(KINDS)
        self._state[:] = _STATE.pack(*numbers, *[0] * 16, b"", b"", os.fsencode(place))

    def _counted(self) -> dict[str, int]:
        """Calls of each kind so far."""
        return dict(zip(KINDS, _NUMBERS.unpack(self._state[_COUNTS]), strict=True))

    # -- from within a run

    def stations(self, words: str, place: Path, kind: str) -> list[dict[str, int]]:
        """Calls of each kind until a command, in which nothing fails, comes to each of its stations: where it opens a
        catalogue, checks one, reads a variable, or begins an output. The check is made here, where a crash of it would end the
        command; but of calls for memory, if they are the ``kind``, in its own process, without a station.
        """
        notes = self.folder.with_suffix(".stations")
        notes.write_bytes(b"")

        def note(counts: dict[str, int]) -> None:
            with notes.open("a") as file:
                file.write(json.dumps(counts) + "\n")

        self.run(words, place, Fault(kind, 2**62, "EIO", "once") if kind else None, note)
        return [json.loads(line) for line in notes.read_text().splitlines()]

    def ends(
        self, words: str, content: Content, faults: Sequence[Fault], kind: str
    ) -> dict[Fault, tuple[Ended, Content]]:
        """How a command ends, and what is then there, if one of its calls fails: of those faults that come after a
        station of the command (`stations`) and before the next, while it is not writing. There the command forks for each
        of them, and is spared the way to it; what it has opened, it reads by place. Its threads are idle then.
        """
        place, results = self.place(content), self.folder.with_suffix(".ends")
        counts = self.stations(words, place, kind)
        _restore(place, content)
        results.write_bytes(b"")
        following = iter([*counts[1:], dict.fromkeys(KINDS, 2**62)])

        def serve(here: dict[str, int]) -> None:
            beyond = next(following, here)
            held = _open_files(place)
            if held - {os.O_RDONLY}:
                return
            for fault in faults:
                if (
                    held and fault.kind in OF_INPUTS
                ):  # a fork opens a DEM anew: not the command's own calls
                    continue
                if here[fault.kind] < fault.nth <= beyond[fault.kind]:
                    now = content_of(place)
                    ended = self._branched(place, fault, here)
                    left = content_of(place)
                    with results.open("ab") as file:
                        pickle.dump((fault, ended, None if left == content else left), file)
                    _restore(place, now)

        self.run(words, place, Fault(kind, 2**62, "EIO", "once") if kind else None, serve)
        shutil.rmtree(place)
        found: dict[Fault, tuple[Ended, Content]] = {}
        with results.open("rb") as file:
            while file.peek():
                fault, ended, left = pickle.load(file)
                found[fault] = ended, content if left is None else left
        return found

    def _branched(self, place: Path, fault: Fault, here: Mapping[str, int]) -> Ended:
        """Let a fork of this process go on with the command, in which a call fails; how it ends."""
        sys.stdout.flush()
        sys.stderr.flush()
        streams = self._streams(place.with_suffix(".branch"))
        for own, stream in zip(self._streams(place), streams, strict=True):
            shutil.copy(own, stream)
        self._write(place, fault)
        self._state[_COUNTS] = _NUMBERS.pack(*here.values())
        process = os.fork()
        if process:
            return self._ended(process, place, streams)
        os.setpgrp()
        self._redirect(streams, os.O_APPEND)
        raise _Branched

    def _at_stations(
        self, place: Path, do: Callable[[dict[str, int]], object], apart: bool
    ) -> None:
        """Call a function at each station of the command of this process; what checks a catalogue ``apart``, or here."""
        last: dict[str, int] = {}

        def stop() -> None:
            here, numbers = self._counted(), self._state[: _COUNTS.start]
            if self._on_the_way != os.getpid() or here == last or _has_workers():
                return
            if _open_files(place) - {os.O_RDONLY}:
                return
            last.update(here)
            self._arm(0)
            try:
                do(here)
            except _Branched:
                self._on_the_way = 0
                self._arm(1)
                return
            self._state[:] = numbers + self._state[_COUNTS.start :]
            self._state[_COUNTS] = _NUMBERS.pack(*here.values())

        def check(function: Callable[[Any], Any], *rest: Any) -> Any:
            stop()
            if apart or self._on_the_way != os.getpid():
                return child_process.call_apart(function, *rest)
            return json.loads(json.dumps(function(rest[0])))

        def stopping(call: Callable[..., Any]) -> Callable[..., Any]:
            def stopped(*arguments: Any) -> Any:
                stop()
                return call(*arguments)

            return stopped

        self._on_the_way = os.getpid()
        patch.object(verification, "call_apart", check).start()
        for owner, name in _STATIONS[: 2 if apart else None]:
            patch.object(owner, name, stopping(getattr(owner, name))).start()

    def _arm(self, armed: int) -> None:
        self._state[:8] = struct.pack("q", armed)

    @staticmethod
    def _streams(place: Path) -> list[Path]:
        return [place.with_suffix(f"{place.suffix}{ending}") for ending in (".out", ".err")]

    @staticmethod
    def _redirect(streams: Sequence[Path], how: int) -> None:
        for number, stream in enumerate(streams, 1):
            os.dup2(os.open(stream, os.O_CREAT | os.O_WRONLY | how), number)

    def _command(
        self,
        words: str,
        place: Path,
        streams: Sequence[Path],
        at_stations: Callable[[dict[str, int]], object] | None,
        apart: bool,
    ) -> None:
        code = 70
        try:
            os.setpgrp()
            self._redirect(streams, os.O_TRUNC)
            os.chdir(place)
            os.environ["TMPDIR"] = tempfile.tempdir = str(place)
            if at_stations:
                self._at_stations(place, at_stations, apart)
            self._arm(1)
            code = run(words.split())
            self._arm(0)
            # as where a process that is no fork ends: folders of sockets are removed; there is no public name for it
            multiprocessing.util._exit_function()  # type: ignore[attr-defined]  # not in the stubs
            sys.stdout.flush()
            sys.stderr.flush()
        except BaseException:
            self._arm(0)
            traceback.print_exc()
        finally:
            os._exit(code)


def _open_files(place: Path) -> set[int]:
    """How this process holds files of a folder open, to write or to read; but locks and what HDF5 reads, by place."""
    found = set()
    for opened in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            file = os.readlink(opened)
            how = (
                int(Path("/proc/self/fdinfo", opened.name).read_text().split()[3], 8) & os.O_ACCMODE
            )
            if file.startswith(f"{place}/") and LOCK not in file and (how or ".h5" not in file):
                found.add(how)
    return found


def _has_workers() -> bool:
    """True if a thread of this process, which no fork has, takes results from other processes."""
    return any(isinstance(one, _ExecutorManagerThread) for one in threading.enumerate())


class _Branched(BaseException):
    """This process is now one in which a call fails."""


def _restore(place: Path, content: Content) -> None:
    """Remove from a folder what does not belong there, and write what it lacks; what is as it was stays."""
    for name, held in reversed(content_of(place).items()):
        if content.get(name) != held:
            (place / name).rmdir() if name.endswith("/") else (place / name).unlink()
    _fill(place, {name: held for name, held in content.items() if not (place / name).exists()})


def _fill(place: Path, content: Content) -> None:
    for name, held in content.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        if name.endswith("/"):
            (place / name).mkdir(exist_ok=True)
        else:
            (place / name).write_bytes(held)


def content_of(folder: Path) -> Content:
    """What a folder holds, but the sockets of Python's processes and their folder."""
    found = sorted(path for path in folder.rglob("*") if _SOCKETS not in str(path))
    return {
        f"{path.relative_to(folder)}{'/' if path.is_dir() else ''}": b"" if path.is_dir() else path.read_bytes()
        for path in found
    }  # fmt: skip


@dataclass
class Trial:
    """A command, its inputs, what it writes and prints when nothing fails, and what stands there before."""

    words: Words
    line: str
    inputs: Content
    whole: Content
    loose: frozenset[str]
    ended: Ended
    old: Content = field(default_factory=dict)
    seen: dict[int, str] = field(default_factory=dict)

    @classmethod
    def of(cls, attempts: Attempts, words: Words, inputs: Content) -> Trial:
        """From two runs in which nothing fails; of a file that differs between them only the name counts."""
        ends, contents = [], []
        for _ in range(2):
            place = attempts.place(inputs)
            ends.append(attempts.run(words.line, place))
            made = content_of(place)
            contents.append({name: made[name] for name in made if name not in inputs})
            shutil.rmtree(place)
        first, second = contents
        if first.keys() != second.keys() or ends[0].code not in (0, 4):
            raise SystemExit(f"without a fault: {ends[0]}, {set(first) ^ set(second)}")
        loose = frozenset(name for name in first if first[name] != second[name])
        same = ends[0].out == ends[1].out
        whole = replace(
            ends[0],
            out=ends[0].out if same else "",
            err="\n".join(one.err for one in ends),
        )
        return cls(words, words.line, inputs, first, loose, whole)

    def over_old(self) -> Trial:
        """The same where an old output stands, which the command replaces."""
        old = {
            name: held if name.endswith("/") else held + b"\n" for name, held in self.whole.items()
        }
        return replace(self, line=f"{self.line} --overwrite", old=old, seen={})

    def calls(self, attempts: Attempts, kind: str) -> Mapping[str, int]:
        """Number of calls of each kind, where none fails; those for memory only where they are the ``kind``."""
        place = attempts.place({**self.inputs, **self.old})
        calls = attempts.run(
            self.line, place, Fault(kind, 2**62, "EIO", "once") if kind else None
        ).calls
        shutil.rmtree(place)
        return calls

    def outcomes(
        self, attempts: Attempts, faults: Sequence[Fault], kind: str = ""
    ) -> Iterator[tuple[Fault, str, Ended]]:
        """Faults with their `outcome` and how the command ended, where the command forks as near to each as it can."""
        before = {**self.inputs, **self.old}
        found = attempts.ends(self.line, before, faults, kind)
        for fault in faults:
            if fault not in found:
                yield fault, *self.outcome(attempts, fault)
                continue
            ended, left = found.pop(fault)
            yield fault, self._judged(attempts, fault, ended, left), ended

    def outcome(self, attempts: Attempts, fault: Fault) -> tuple[str, Ended]:
        """ "whole", "refused" or "not reached"; for anything else what is wrong. And how the command ended."""
        place = attempts.place({**self.inputs, **self.old})
        ended = attempts.run(self.line, place, fault)
        found = content_of(place)
        shutil.rmtree(place)
        return self._judged(attempts, fault, ended, found), ended

    def _judged(self, attempts: Attempts, fault: Fault, ended: Ended, found: Content) -> str:
        wrong = self.wrong(ended, found, fault)
        same = {**self.inputs, **self.old}, {**self.inputs, **self.whole}
        if not wrong and found not in same:
            wrong = self._wrong_next(attempts, found)
        if wrong or not ended.failed:
            return wrong or "not reached"
        if ended.code == self.ended.code:
            return "whole"
        return "ended" if ended.code < 0 else "refused"

    def wrong(self, ended: Ended, found: Content, fault: Fault) -> str:
        """What is wrong with how the command ended, or with what it left; empty if nothing is."""
        return (
            ended.fault or self._wrong_end(ended, fault) or self._wrong_files(found, ended, fault)
        )

    def _wrong_end(self, ended: Ended, fault: Fault) -> str:
        if ended.code == self.ended.code:
            return (
                ""
                if not self.ended.out or ended.out == self.ended.out
                else f"exit {self.ended.code}, but it prints {ended.out[:300]!r}"
            )
        if ended.code < 0 and fault.kind == "malloc":
            return ""
        if (
            ended.code == 4
            and self.words.verdict
            and (fault.kind == "malloc" or (fault.kind == "read" and "NOT SOUND" in ended.out))
            and "NOT " in ended.out
        ):
            return ""
        if ended.code != 1:
            return f"exit {ended.code}: {ended.err[-300:]!r} {ended.out[:300]!r}"
        told = (
            line
            for line in ended.err.splitlines()
            if not re.search(r": (\d+ of \d+|preparing|working), ", line)
        )
        own = [line for line in told if line and line not in self.ended.err]
        ugly = any("unexpected" in line or "errno" in line for line in own)
        if fault.kind == "malloc":  # GDAL and LAPACK say it themselves
            own, ugly = [one for one in own if not one.startswith(("ERROR ", "init_ge"))], False
            if own and own[0].startswith("Fatal Python error"):  # of a fork of the interpreter
                own = own[-1:]
        if len(own) != 1 or ugly or not own[0].startswith(("lcp: ", "Error: ")):
            return f"not one line: {own}"
        return (
            f"it prints {ended.out[:300]!r}"
            if ended.out and not self.ended.out.startswith(ended.out)
            else ""
        )

    def _wrong_files(self, found: Content, ended: Ended, fault: Fault) -> str:
        for name, held in self.inputs.items():
            if found.get(name) != held:
                return f"the input {name} is {'changed' if name in found else 'gone'}"
        made = {name: held for name, held in found.items() if name not in self.inputs}
        new = [self._is_whole(name, made.get(name)) for name in self.whole]
        if ended.code == self.ended.code and not all(new):
            missing = [name for name, is_new in zip(self.whole, new, strict=True) if not is_new]
            return f"exit {ended.code}, but not whole: {missing}"
        torn = [
            name
            for name, is_new in zip(self.whole, new, strict=True)
            if not is_new and made.get(name) != self.old.get(name)
        ]
        files = {new for name, new in zip(self.whole, new, strict=True) if not name.endswith("/")}
        if torn or (self.words.together and len(files) > 1):
            return f"neither old nor new: {torn or 'some of both'}"
        return ""

    def _is_whole(self, name: str, held: bytes | None) -> bool:
        if held is None or name in self.loose:
            return held is not None and (name.endswith("/") or bool(held))
        return held == self.whole[name]

    def _wrong_next(self, attempts: Attempts, found: Content) -> str:
        """What is wrong with the next try, which also removes what this one left; one for each content."""
        key = hash(frozenset(found.items()))
        if key not in self.seen:
            place = attempts.place(found)
            ended = attempts.run(f"{self.words.line} {self.words.again}", place)
            after = content_of(place)
            shutil.rmtree(place)
            made = [name for name in self.whole if not self._is_whole(name, after.get(name))]
            left = sorted(after.keys() - self.whole.keys() - self.inputs.keys() - self.old.keys())
            self.seen[key] = ""
            if ended.code != self.ended.code or made or left:
                said = f"exit {ended.code}, not whole {made}, left {left}: {ended.err[-300:]!r}"
                self.seen[key] = f"the next try: {said}"
        return self.seen[key]
