"""Patches out of arrays, and how much of a patch depends on terrain outside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import Mask


def dependence(alone: Mask, full: Mask, valid: Mask | None = None) -> NDArray[np.float64]:
    """Share of each patch's valid nodes that are lit (or visible) with the fragment alone but not
    with all terrain, (n,).

    ``alone`` and ``full`` (n, p, p) are traced on the same surface, so a difference is terrain
    outside the patch and nothing else. More terrain can only take light away; should a node be lit
    in ``full`` alone, it does not count. ``valid`` (default: all nodes) are the nodes with a
    height; NaN where a patch has none.
    """
    lost = alone & ~full
    if valid is None:
        return np.asarray(lost.mean(axis=(1, 2)))
    count = valid.sum(axis=(1, 2))
    share = (lost & valid).sum(axis=(1, 2)) / np.maximum(count, 1)
    return np.where(count > 0, share, np.nan)
