"""What computes a build: the code, its libraries and the processor's level, on which the last digits of results
depend.
"""

from __future__ import annotations

import functools
import hashlib
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from numpy._core._multiarray_umath import (  # type: ignore[import-not-found]  # it has no stub
    __cpu_features__ as cpu_features,
)

from .._version import __version__
from ..kernels.cpu_level import level

_LEVELS = {
    "AVX-512": ("X86_V4", "AVX512F", "AVX512CD", "AVX512BW", "AVX512DQ", "AVX512VL"),
    "AVX2": ("X86_V3", "AVX2", "FMA3"),
    "AVX": ("AVX",),
    "SSE4.2": ("SSE42", "POPCNT"),
    "SVE": ("SVE",),
    "NEON": ("NEON", "ASIMD"),
}
"""Features of each level of processors, the widest registers first. Those with `_V` are NumPy's own names of levels, which
it has since 2.4: its variable NPY_DISABLE_CPU_FEATURES takes them from a processor that has the other features.
"""

_SHOWN = 40
"""Characters of a fact that is shown; digests are longer."""


def code_facts() -> dict[str, str]:
    """All but the inputs that determines the results of this process, by name."""
    return {
        "lcp-catalog": __version__,
        "source code": package_digest(),
        "numba": version("numba"),
        "NumPy": version("numpy"),
        "processor level": processor_level(),
    }


def differences(its: Mapping[str, str], here: Mapping[str, str]) -> str:
    """Names of the facts that are others here, with both where they are short; empty if none is."""
    return ", ".join(
        f"{name} ({its[name]}, here {mine})" if len(mine) <= _SHOWN else name
        for name, mine in here.items()
        if its.get(name, mine) != mine
    )


def processor_level() -> str:
    """The widest registers for which NumPy has code here, and the level of the kernels: results differ in their last
    digits between levels, not between processors of one.
    """
    has = [n for n, own in _LEVELS.items() if all(cpu_features.get(k, "_V" in k) for k in own)]
    return f"{(has or [platform.machine()])[0]}, kernels for {level()}"


@functools.cache
def package_digest() -> str:
    """SHA-256 sum of the package's source."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
