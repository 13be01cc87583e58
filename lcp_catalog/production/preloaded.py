"""Imported once by the process from which the workers of a build are forked (`executor`): it imports all
that an area needs and loads the compiler's tables, which takes every new process a second.

Kernels that use threads are not loaded here: their threads do not survive a fork.
"""

import gc

import numpy as np

from ..kernels.entries import entries
from ..kernels.resampling.heights import sample
from . import run

__all__ = ["run"]

if all(entry.is_compiled for entry in entries("build-catalog")):  # else others compile them now
    sample(np.zeros((4, 4), np.float32), 0, 0, 0, np.ones(1), np.ones(1), np.empty(1))
gc.freeze()  # no worker looks through the objects of the imports
