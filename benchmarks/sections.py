"""The command of a package of benchmarks: which section runs, with which words, on how many threads."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Mapping, Sequence

_THREADS = ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")


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
