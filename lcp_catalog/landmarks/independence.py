"""Dependence of a patch's shadows and visibility on terrain outside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import Mask


def dependence(alone: Mask, full: Mask, valid: Mask | None = None) -> NDArray[np.float64]:
    """Share of each patch's valid nodes that are lit (or visible) with the patch alone but not with
    all terrain, (n,).

    ``alone`` and ``full`` (n, p, p) are traced on the same surface, so that only terrain outside
    the patch makes a difference. More terrain only removes light: a node that is lit in ``full``
    alone does not count. ``valid`` (default: all nodes) are the nodes with a height. NaN for a
    patch without valid nodes.
    """
    lost = alone & ~full
    if valid is None:
        return np.asarray(lost.mean(axis=(1, 2)))
    count = valid.sum(axis=(1, 2))
    share = (lost & valid).sum(axis=(1, 2)) / np.maximum(count, 1)
    return np.where(count > 0, share, np.nan)
