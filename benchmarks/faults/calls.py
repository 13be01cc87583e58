"""Every system call on the files of a command fails once.

    python -m benchmarks.faults calls [--only NAME...] [--kinds KIND...] [--errors ERROR...] [--alone] [--spread N] [--malloc 300]
        [--jobs 2]

For each command of `lcp` on small inputs, each kind of call (`failing.KINDS`) and each call of it: the call fails
in a run of the command. Afterwards the inputs must be as they were; the output must not be there, or be the
old one, or be the whole new one; the exit code must be 0 with a whole output, or 1 with one line; and the next
try must succeed. Prints a table by command and kind: whole outputs + refusals / calls that were made to fail.
Memory that cannot be had (``--malloc`` calls for each command, spread evenly) may end a process.
"""

from __future__ import annotations

import argparse
import gc
import os
import re
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from lcp_cli.main import run

from benchmarks import sections
from benchmarks.faults import failing
from benchmarks.markdown import table
from lcp_catalog.production import executor
from lcp_catalog.tradeoff import measurement
from tests.helpers import small_commands

CHANGING = ("write", "rename", "unlink", "fsync")
"""Kinds of calls that also fail in runs that replace an old output."""


def main(words: Sequence[str]) -> int:
    parser = sections.parser("faults calls", __doc__)
    names = [*small_commands.COMMANDS]
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=names, default=names)
    parser.add_argument("--kinds", nargs="+", choices=[*failing.KINDS], default=[*failing.KINDS])
    parser.add_argument(
        "--spread",
        type=int,
        metavar="N",
        help="at most N calls of each kind and error, spread evenly; default: all",
    )
    errors = sorted({error for kinds in failing.KINDS.values() for error, _ in kinds})
    parser.add_argument("--errors", nargs="+", choices=errors, default=errors)
    alone = "interrupted and half calls fail one by one, not first all at once"
    parser.add_argument("--alone", action="store_true", help=alone)
    malloc = "calls for memory that fail, of each command"
    parser.add_argument("--malloc", type=int, default=300, metavar="N", help=malloc)
    parser.add_argument("--jobs", type=int, default=2, help="commands that are tried at once")
    given = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as name:
        if "failing_calls" not in os.environ.get("LD_PRELOAD", ""):
            return failing.preloaded("benchmarks.faults", ["calls", *words], Path(name))
        return _tried(given, Path(os.path.realpath(name)))


def _tried(given: argparse.Namespace, folder: Path) -> int:
    """Try the commands in processes of their own; print the table."""
    inputs = folder / "inputs"
    inputs.mkdir()
    _wait(_forked(partial(small_commands.prepare, inputs, given.only)))
    running: dict[int, str] = {}
    left = [*given.only]
    failed: list[str] = []
    while left or running:
        if left and len(running) < given.jobs:
            name = left.pop(0)
            running[_forked(partial(_try, name, given, folder))] = name
            continue
        process, status = os.wait()
        name = running.pop(process)
        if status:
            failed.append(name)
    files = [folder / f"{_file(name)}.row" for name in given.only]
    rows = [file.read_text().split("\n") for file in files if file.exists()]
    print(f"\n{table(['command', *given.kinds], rows)}")
    print(f"wrong: {failed or 'nothing'}")
    return 1 if failed else 0


def _forked(function: Callable[[], object]) -> int:
    """A process that runs a function; exit code 0 if it returns anything but False."""
    process = os.fork()
    if process:
        return process
    code = 1
    try:
        code = int(function() is False)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def _wait(process: int) -> None:
    if os.waitpid(process, 0)[1]:
        raise SystemExit("the inputs cannot be made")


def _file(name: str) -> str:
    return re.sub(r"\W+", "_", name)


def _try(name: str, given: argparse.Namespace, folder: Path) -> bool:
    """Try a command; write its row of the table. True if nothing was wrong."""
    words = small_commands.COMMANDS[name]
    workers = measurement.Workers
    # the tiers of `trade` run here, not in processes that each import all anew: no option of the command does that
    measurement.Workers = lambda isolated: workers(isolated=False)  # type: ignore[assignment,misc]  # for a class
    executor.START_METHOD = "fork"  # likewise workers of a build are forks of the command
    attempts = failing.Attempts(folder / _file(name))
    inputs = words.inputs(folder / "inputs")
    _warm(attempts, words, inputs)
    trial = failing.Trial.of(attempts, words, inputs)
    found: dict[str, Counter[str]] = {kind: Counter() for kind in given.kinds}
    start = time.monotonic()
    memory = "malloc" if "malloc" in given.kinds else ""
    for old in (False, True) if trial.whole and "--overwrite" in words.again else (False,):
        if old:
            trial = trial.over_old()
        calls, faults = trial.calls(attempts, memory), list[failing.Fault]()
        for fault in _kinds(calls, given, old):
            at_once = fault.how in failing.ALONE and not given.alone
            if at_once and trial.outcome(attempts, fault)[0] == "whole":
                found[fault.kind]["whole"] += calls[fault.kind]
            else:
                faults += _each(calls, fault, given)
        for fault in faults:
            outcome, ended = trial.outcome(attempts, fault)
            good = outcome in ("whole", "refused", "ended", "not reached")
            found[fault.kind][outcome if good else "wrong"] += 1
            if not good:
                print(
                    f"{name}{' --overwrite' if old else ''}: {fault} ({ended.failed}): {outcome}",
                    flush=True,
                )
    row = [f"`{name}`", *(_cell(found[kind]) for kind in given.kinds)]
    (folder / f"{_file(name)}.row").write_text("\n".join(row))
    print(f"{row[0]}: {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
    return not any(one["wrong"] for one in found.values())


def _warm(attempts: failing.Attempts, words: small_commands.Words, inputs: failing.Content) -> None:
    """Run the command here, so that later runs need not import anything; what it prints is lost."""
    place = attempts.place(inputs)
    kept = [os.dup(number) for number in (1, 2)]
    with open(os.devnull, "w") as nothing:
        for number in (1, 2):
            os.dup2(nothing.fileno(), number)
    os.chdir(place)
    run(words.line.split())
    sys.stdout.flush()
    sys.stderr.flush()
    for number, own in zip((1, 2), kept, strict=True):
        os.dup2(own, number)
        os.close(own)
    os.chdir(attempts.folder)
    shutil.rmtree(place)
    gc.collect()
    gc.freeze()  # so that forks share what is held here


def _kinds(
    calls: Mapping[str, int], given: argparse.Namespace, old: bool
) -> Iterator[failing.Fault]:
    """Of each kind of call that is made, and each error, the first fault."""
    for kind in given.kinds:
        if calls[kind] and not (old and kind not in CHANGING):
            errors = (one for one in failing.KINDS[kind] if one[0] in given.errors)
            yield from (failing.Fault(kind, 1, *how) for how in errors)


def _each(
    calls: Mapping[str, int], fault: failing.Fault, given: argparse.Namespace
) -> Iterator[failing.Fault]:
    """The same fault of one call after the other."""
    most = given.malloc if fault.kind == "malloc" else given.spread
    numbers = np.arange(1, calls[fault.kind] + 1)
    if most is not None and most < len(numbers):
        numbers = np.unique(np.linspace(1, calls[fault.kind], most).round().astype(int))
    how = failing.ALONE.get(fault.how, fault.how)
    for nth in numbers.tolist():
        yield replace(fault, nth=nth, how=how)


def _cell(found: Counter[str]) -> str:
    """Whole outputs + refusals (+ processes that ended for want of memory) / tried; and what was wrong."""
    tried = sum(found.values()) - found["not reached"]
    if not tried:
        return ""
    parts = [found["whole"], found["refused"], *([found["ended"]] if found["ended"] else [])]
    return (
        " + ".join(map(str, parts))
        + f" / {tried}"
        + (f", wrong {found['wrong']}" if found["wrong"] else "")
    )
