"""The level of processors for which kernels are compiled, found by the processor's features. Code for a level is
the same on every processor of the level, and so are its results; code for one processor by its name is not.
"""

from __future__ import annotations

import functools
import platform

import llvmlite.binding as llvm
from numba import config
from numba.core.registry import cpu_target

_V3 = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
_V4 = ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl")

LEVELS = {"x86-64-v4": (*_V3, *_V4), "x86-64-v3": _V3, "x86-64": ()}
"""Features of each level of x86-64, in LLVM's names, the highest first."""

_SETTINGS = {"x86-64-v4": "-prefer-256-bit"}
"""LLVM's features of a level: it would use half of a v4's registers, as was right for the first of them."""


def use_level() -> None:
    """Let numba compile for this processor's level. A processor, or a level, that ``NUMBA_CPU_NAME`` names stays, and
    so does what another program has compiled for before it imported these kernels.
    """
    machine, given = platform.machine().lower(), (config.CPU_NAME, config.CPU_FEATURES)
    if given == (None, None):
        if machine in {"x86_64", "amd64"}:
            has = llvm.get_host_cpu_features()
            config.CPU_NAME = next(k for k, own in LEVELS.items() if all(map(has.get, own)))
        elif machine in {"aarch64", "arm64"}:
            config.CPU_NAME = "generic"
    if config.CPU_NAME in {*LEVELS, "generic"} and config.CPU_FEATURES is None:
        config.CPU_FEATURES = _SETTINGS.get(config.CPU_NAME, "")
    if config.CPU_FEATURES not in {None, _magic()[2]}:
        config.CPU_NAME, config.CPU_FEATURES = given
    target()


def _magic() -> tuple[str, str, str]:
    found: tuple[str, str, str] = cpu_target.target_context.codegen().magic_tuple()
    return found


@functools.cache
def target() -> tuple[str, str, str]:
    """System, level (or processor) and features for which kernels are compiled. numba reads its settings again when
    one in the environment changes, and goes on with its first ones.
    """
    return _magic()


def level() -> str:
    """The level, or else the processor, for which kernels are compiled."""
    return target()[1]


def lanes() -> int:
    """Numbers of float32 in a register of the level: 16 with AVX-512, else 8: narrower ones are used in pairs."""
    _, name, features = target()
    return 16 if name == "x86-64-v4" or "+avx512f" in features.split(",") else 8
