"""System calls that fail (`benchmarks/faults/calls.py`): the preloaded library lets the right call fail, what is left is
judged as it must be, and a few commands survive a few calls. `make soak` tries every call of every command.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.small_commands import COMMANDS

from benchmarks.faults import failing

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")

CALLS = """
import ctypes, json, mmap, os, sys
from pathlib import Path
from benchmarks.faults.failing import KINDS, Attempts, Fault

libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p

def stream():
    file = ctypes.c_void_p(libc.fopen(b"f", b"w"))
    if not file:
        return 0
    done = libc.fputs(b"text", file)
    return -1 if libc.fflush(file) or done < 0 else libc.fclose(file)

def every_call():
    os.mkdir("d")
    fd = os.open("a", os.O_CREAT | os.O_RDWR)
    os.write(fd, b"0123456789")
    os.pwrite(fd, b"ab", 10)
    os.pread(fd, 4, 0)
    os.fsync(fd)
    os.ftruncate(fd, 8)
    mmap.mmap(fd, 8).close()
    os.close(fd)
    Path("a").read_bytes()
    os.link("a", "b")
    os.rename("b", "c")
    os.unlink("c")
    os.rmdir("d")
    Path(sys.executable).open("rb").close()  # no file of the command
    print(stream())
    return 0

import benchmarks.faults.failing as failing
failing.run = lambda words: every_call()
attempts, found = Attempts(Path(sys.argv[1])), {}
found["none"] = attempts.run("", attempts.place({})).calls
for kind in KINDS:
    for nth in range(1, found["none"][kind] + 1):
        fault = Fault(kind, nth, *KINDS[kind][0])
        ended = attempts.run("", attempts.place({}), fault)
        found[str(fault)] = [ended.failed, ended.out, ended.err.splitlines()[-1:]]
for how in failing.ALONE:
    for kind in ("read", "write"):
        ended = attempts.run("", attempts.place({}), Fault(kind, 1, "EINTR", how))
        found[f"{how} {kind}"] = [ended.code, ended.out, ended.err, ended.calls[kind]]
print(json.dumps(found))
"""


@pytest.mark.slow
def test_the_library_lets_each_call_fail(tmp_path: Path) -> None:
    environment = os.environ | {"LD_PRELOAD": str(failing.built(tmp_path))}
    root = Path(__file__).resolve().parents[1]
    command = [sys.executable, "-c", CALLS, str(tmp_path / "runs")]
    ended = subprocess.run(
        command, cwd=root, env=environment, capture_output=True, text=True, check=True
    )
    found = json.loads(ended.stdout)
    assert found.pop("none") == {
        "open": 3, "read": 3, "write": 3, "rename": 2, "unlink": 2, "fsync": 1,
        "ftruncate": 1, "mmap": 1, "mkdir": 1, "close": 3, "malloc": 0,
    }  # fmt: skip
    # Python makes interrupted and half calls again, the C library half ones
    assert [found.pop(f"{how} read") for how in failing.ALONE] == [
        [0, "0\n", "", 6],
        [0, "0\n", "", 6],
    ]
    assert [found.pop(f"{how} write") for how in failing.ALONE] == [
        [0, "-1\n", "", 5],
        [0, "0\n", "", 5],
    ]
    for fault, (failed, out, err) in found.items():
        kind, _, error = fault.split()[:3]
        assert failed, fault
        if failed.endswith("f") and kind in ("open", "write", "close"):  # the stream's
            assert out != "0\n" or kind == "open", (fault, out)
        else:
            assert os.strerror(getattr(errno, error)) in err[0], (fault, err)


KERNELS = """
import json, os, sys
from pathlib import Path
from benchmarks.faults import failing
from lcp_catalog.kernels import cache

def halved(x):
    return x / 2

def work(words):
    os.environ |= {"NUMBA_CACHE_DIR": os.path.abspath("own"), cache.SHARED: os.path.abspath("shared")}
    print(cache.njit(nogil=True)(halved)(3.0))
    return 0

sys.path[0] = os.getcwd()  # not "", the folder whose calls fail
failing.run = work
attempts, tried, wrong = failing.Attempts(Path(sys.argv[1])), 0, []
place = attempts.place({})
attempts.run("", place)
own = failing.content_of(place)
shared = {name.replace("own/kernels", "shared"): held for name, held in own.items()}
for before in ({}, own, shared, {**own, **shared}):
    calls = attempts.run("", attempts.place(before)).calls
    faults = [failing.Fault(kind, nth, error, failing.ALONE.get(how, how))
              for kind in calls for error, how in failing.KINDS[kind] for nth in range(1, calls[kind] + 1)]
    for fault in faults:
        place, tried = attempts.place(before), tried + 1
        ends = [attempts.run("", place, fault), attempts.run("", place)]
        whole = [cache._read(path) is not None for path in place.rglob("*.kernel")]
        if not all(whole) or [(one.code, one.out) for one in ends] != [(0, "1.5\\n")] * 2:
            wrong.append([str(fault), whole, [[one.code, one.out, one.err[-300:]] for one in ends]])
print(json.dumps([tried, wrong]))
"""


@pytest.mark.slow
def test_a_file_of_a_kernel_that_is_not_read_or_written_is_none(tmp_path: Path) -> None:
    """In the user's folder and in the shared one: the kernel is compiled, and its value is right."""
    environment = os.environ | {"LD_PRELOAD": str(failing.built(tmp_path))}
    root = Path(__file__).resolve().parents[1]
    command = [sys.executable, "-c", KERNELS, str(tmp_path / "runs")]
    ended = subprocess.run(
        command, cwd=root, env=environment, capture_output=True, text=True, check=True
    )
    tried, wrong = json.loads(ended.stdout)
    assert (tried > 10, wrong) == (True, [])


WRITE = failing.Fault("write", 1, "EIO", "once")
SOUND = failing.Ended(0, "text\n", "out: written\n", {}, "write /x")
REFUSED = replace(SOUND, code=1, out="", err="lcp: out: cannot be written\n")


@pytest.mark.parametrize(
    ("ended", "made", "says"),
    [
        (SOUND, b"new", ""),
        (REFUSED, None, ""),
        (REFUSED, b"old", ""),
        (REFUSED, b"new", ""),
        (SOUND, b"ne", "not whole"),
        (SOUND, None, "not whole"),
        (replace(SOUND, out="tex"), b"new", "prints"),
        (REFUSED, b"ne", "neither old nor new"),
        (replace(REFUSED, err="lcp: unexpected OSError\n"), b"old", "not one line"),
        (replace(REFUSED, err="lcp: a\nTraceback\n"), b"old", "not one line"),
        (replace(REFUSED, err=""), b"old", "not one line"),
        (replace(REFUSED, code=4), b"old", "exit 4"),
        (replace(REFUSED, code=-11), b"old", "exit -11"),
    ],
)
def test_what_a_command_leaves_is_judged(
    ended: failing.Ended, made: bytes | None, says: str
) -> None:
    old = {"out": b"old"} if made == b"old" else {}
    trial = failing.Trial(
        COMMANDS["query"], "", {"in": b"1"}, {"out": b"new"}, frozenset(), SOUND, old
    )
    found = {"in": b"1"} | ({} if made is None else {"out": made})
    assert says in trial.wrong(ended, found, WRITE)
    assert bool(says) == bool(trial.wrong(ended, found, WRITE))
    assert "the input in is changed" in trial.wrong(SOUND, {"in": b"2", "out": b"new"}, WRITE)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "--only dem*check export*.lmk inspect --spread 3 --kinds open read rename fsync --errors EIO",
        "--only render --malloc 60 --kinds malloc",
        "--only query --malloc 100 --kinds malloc",
    ],
)
def test_a_few_commands_survive_a_few_calls(words: str) -> None:
    """`inspect` called a file damaged that the system did not read.

    Of 60 calls for memory of `render`, one was lost in a parallel loop of a kernel: exit 0, a wrong image. Of 100
    of `query`, 4 ended HDF5, or kept it busy for ever (`integrity.dimensions`).
    """
    root = Path(__file__).resolve().parents[1]
    only = [word.replace("*", " ") for word in words.split()]
    command = [sys.executable, "-m", "benchmarks.faults", "calls", "--jobs", "1", *only]
    ended = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert ended.stdout.count("| `") == len(words.partition(" --")[0].split()) - 1
