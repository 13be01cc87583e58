"""One system call on a command's files is made to fail (`failing_calls.c`), and what is left is judged.

The process that judges has the library loaded from its start (`preloaded`). It runs a command once, so that all
imports are made, and then forks a process for each call that shall fail.
"""

from __future__ import annotations

import ctypes
import errno
import mmap
import multiprocessing.util
import os
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from unittest.mock import patch

from lcp_cli.main import run

from benchmarks.faults.processes import is_gone, wait_for
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
ALONE = {"each": "once", "halves": "short"}

_SOCKETS = "/pymp-"
"""How the folders begin that multiprocessing makes for its sockets."""

LONGEST_S = 300.0
_GONE_S = 60.0
"""Time in which processes end that a command has started, on a busy machine."""
_STATE = struct.Struct("6q16q64s512s512s")
_HOW = ("once", "on", "short", *ALONE)

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

    def run(self, words: str, place: Path, fault: Fault | None = None) -> Ended:
        """A command in a process of its own that works in a folder."""
        streams = [place.with_suffix(f"{place.suffix}{ending}") for ending in (".out", ".err")]
        self._write(place, fault)
        process = os.fork()
        if not process:
            self._command(words, place, streams)
        handle = os.pidfd_open(process)
        late = not select.select([handle], [], [], LONGEST_S)[0]
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

    def _arm(self, armed: int) -> None:
        self._state[:8] = struct.pack("q", armed)

    def _command(self, words: str, place: Path, streams: Sequence[Path]) -> None:
        code = 70
        try:
            os.setpgrp()
            for number, stream in enumerate(streams, 1):
                os.dup2(os.open(stream, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), number)
            os.chdir(place)
            os.environ["TMPDIR"] = tempfile.tempdir = str(place)
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

    def outcome(self, attempts: Attempts, fault: Fault) -> tuple[str, Ended]:
        """ "whole", "refused" or "not reached"; for anything else what is wrong. And how the command ended."""
        place = attempts.place({**self.inputs, **self.old})
        ended = attempts.run(self.line, place, fault)
        found = content_of(place)
        shutil.rmtree(place)
        wrong = self.wrong(ended, found, fault)
        same = {**self.inputs, **self.old}, {**self.inputs, **self.whole}
        if not wrong and found not in same:
            wrong = self._wrong_next(attempts, found)
        if wrong or not ended.failed:
            return wrong or "not reached", ended
        if ended.code == self.ended.code:
            return "whole", ended
        return "ended" if ended.code < 0 else "refused", ended

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
