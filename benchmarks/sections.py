"""The command of a package of benchmarks: which section runs, with which words, on how many threads."""

from __future__ import annotations

import importlib
import os
import sys
from argparse import ArgumentParser, RawTextHelpFormatter
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.places import OUTPUT, shared_data

_THREADS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


def parser(section: str, about: str | None) -> ArgumentParser:
    """The parser of a section's words, such as ``speed merge``, whose help is the module's text."""
    name = f"python -m benchmarks.{section}"
    return ArgumentParser(name, description=about, formatter_class=RawTextHelpFormatter)


def evidence_parser(section: str, about: str | None, folder: str = "") -> ArgumentParser:
    """The same with ``--output``, a folder of that of the evidence, and ``--data``, that of the shared data."""
    found, output = parser(f"evidence {section}", about), OUTPUT.parent / "evidence" / folder
    found.add_argument("-o", "--output", type=Path, default=output)
    found.add_argument("--data", type=Path, default=shared_data())
    return found


def run(package: str, sections: Mapping[str, str]) -> int:
    """Run the section that the first word of the command line names, or ``all`` with their defaults. Without a
    word, or with another one, print the sections.

    ``sections`` maps the modules of ``package`` to what they measure; each has ``main(words)`` that returns
    an exit code. A section is imported only when it runs, with one thread unless the environment says otherwise.
    """
    name, words = (sys.argv[1], sys.argv[2:]) if len(sys.argv) > 1 else ("", [])
    if name not in (*sections, "all"):
        print(f"usage: python -m {package} SECTION [--help] [OPTION...]\n")
        for section, what in {**sections, "all": "every section with its defaults"}.items():
            print(f"  {section:12} {what}")
        return 0 if name in ("-h", "--help") else 2
    for variable in _THREADS:
        os.environ.setdefault(variable, "1")
    codes = [_run(package, one, words) for one in (sections if name == "all" else [name])]
    return max(codes)


def _run(package: str, section: str, words: Sequence[str]) -> int:
    return int(importlib.import_module(f"{package}.{section}").main(words))
