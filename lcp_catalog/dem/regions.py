"""Connected regions of a raster, and their boxes on the Moon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..arrays import Index, Mask
from ..geometry.bounds import Bounds


@dataclass(frozen=True)
class Region:
    """A part of the surface: the box around it, and its own area."""

    bounds: Bounds
    area_km2: float


def connected_regions(mask: Mask, wraps: bool = False) -> Index:
    """Number of each cell's region, (rows, columns): 0 outside the ``mask`` (rows, columns), 1, 2, ...
    in it. Cells are connected along their sides; if the raster ``wraps``, also from the last column
    to the first.
    """
    label, count = ndimage.label(mask)
    if wraps and count:
        first, last = label[:, 0], label[:, -1]
        both = (first > 0) & (last > 0)
        joined = coo_array(
            (np.ones(np.count_nonzero(both)), (first[both], last[both])), (count + 1, count + 1)
        )
        label = connected_components(joined, directed=False)[1][label]
    return np.asarray(label, np.int64)
