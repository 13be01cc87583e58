"""Levels of a catalogue: its cell sizes from fine to coarse, nearly equal ones together."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Index
from ..choices import LEVEL_RATIO


def levels(gsd_m: ArrayLike) -> Index:
    """Level of each cell size (n,), metres: 0 for the finest, one more wherever the next larger size
    exceeds the one before by more than `LEVEL_RATIO`.
    """
    sizes, back = np.unique(np.asarray(gsd_m, np.float64), return_inverse=True)
    steps = np.concatenate(
        [np.zeros(min(1, len(sizes)), bool), sizes[1:] > LEVEL_RATIO * sizes[:-1]]
    )
    return np.asarray(np.cumsum(steps)[back.reshape(-1)], np.int64)
