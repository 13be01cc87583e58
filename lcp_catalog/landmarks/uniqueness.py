"""Places that resemble a patch within the area in which it may be searched for.

Correlation is centred and normalised: it does not depend on gain and offset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Array, Float32, Index
from ..kernels.matching.rivals import rivals, window_norms
from .corners import fill_missing
from .patches import halved

RIVALS = 64
"""Greatest number of other places for each patch. In noise above the contrast all maxima of a search
square count alike; with 12 the Brier score of the detection probability doubles
(`benchmarks/claims.py simulated`)."""

EXCLUSION_PX = 2.0
"""Maxima no farther than this from a patch's own place belong to its own peak."""

_FLAT = 1e-3
"""A patch whose contrast is not above this share of the whole image's has no contrast."""

_COARSE_HALF_MIN = 8
"""Smaller patches are searched at full resolution: half resolution loses rivals of theirs. The Brier
score of the detection probability is 0.030 with it for 17 x 17 nodes and 0.012 for 25 x 25, and
0.004 at full resolution; for 33 x 33 nodes it is 0.003 and 0.002."""

_COARSE_REACH_MIN = 12
"""Smaller search areas are searched at full resolution, which then costs about the same."""


RING = np.unique(
    np.round(
        3.0 * np.stack([f(np.arange(16) * np.pi / 8.0) for f in (np.cos, np.sin)], axis=-1)
    ).astype(np.int64),
    axis=0,
)
"""Distances (column, row) of the places just outside a patch's own peak (`EXCLUSION_PX`)."""


class OtherPlaces(NamedTuple):
    """Places that resemble n patches. ``correlation``, ``contrast`` (n, `RIVALS`): the highest
    correlations of each patch with other places, best first, and the standard deviations of the
    image's windows there, NaN where there are fewer. ``near``, ``near_contrast`` (n, k): the same at
    the distances `RING` from the patch's own place, NaN for windows that leave the image.
    """

    correlation: Array
    contrast: Array
    near: Array
    near_contrast: Array


def other_places(
    images: Float32,
    patches: Float32,
    rows: Index,
    cols: Index,
    search: int,
    which: Index | None = None,
    least: Array | None = None,
    exclusion: float = EXCLUSION_PX,
    exact: bool = False,
) -> OtherPlaces:
    """Other places that resemble patches (n, p, p), at nodes (rows, cols) of one of the images (k,
    rows, cols), ``which`` (n,) (default: the first): those whose centres lie within +-``search``
    nodes in both axes.

    Another place is a local maximum of the correlation (3 x 3 nodes) farther than ``exclusion``
    nodes from the patch's own. A ridge without change along itself is a chain of equal maxima and
    counts. Places are whole nodes; the search square is cut at the image's border.

    Missing nodes hold the mean of the valid nodes around them; windows without contrast correlate
    0. A patch without contrast has one other place with correlation 1; a patch that the image's
    border cuts has none.

    Half resolution is searched first, then full resolution from its highest maxima; ``exact``: full
    resolution everywhere, as for patches below 33 nodes a side and for small search areas.
    """
    size = patches.shape[1]
    half = size // 2
    least = np.full(len(rows), -2.0) if least is None else least
    which = np.zeros(len(rows), np.int64) if which is None else which
    fine = np.stack([fill_missing(image, size) for image in np.asarray(images, np.float32)])
    fine -= fine.mean(axis=(1, 2), dtype=np.float64, keepdims=True).astype(np.float32)
    centres = np.stack([cols, rows], axis=-1).astype(np.int64).reshape(-1, 2)
    places = OtherPlaces(
        *np.full((2, len(rows), RIVALS), np.nan), *np.full((2, len(rows), len(RING)), np.nan)
    )
    if min(fine.shape[1:]) < size:
        return places
    cut = ((centres < half) | (centres >= np.array(fine.shape[:0:-1]) - half)).any(axis=1)
    contrast = patches.std(axis=(1, 2), dtype=np.float64)
    flat = ~(contrast > _FLAT * fine.std(axis=(1, 2), dtype=np.float64)[which]) & ~cut
    places.correlation[flat, 0], places.contrast[flat, 0] = 1.0, contrast[flat]
    tried = np.flatnonzero(~flat & ~cut)
    two_steps = not (exact or searched_exactly(size, search))
    norms = _norms(fine, size)
    coarse = halved(fine) if two_steps else fine[:0]
    found = OtherPlaces(*(np.empty((len(tried), *part.shape[1:])) for part in places))
    rivals(
        fine, norms, coarse, _norms(coarse, half) if two_steps else norms[:0],
        np.ascontiguousarray(patches[tried], dtype=np.float32), which[tried],
        centres[tried] - half, search, float(exclusion), two_steps, least[tried], RING,
        *found,
    )  # fmt: skip
    for part, own in zip(places, found, strict=True):
        part[tried] = own
    return places


def searched_exactly(size: int, search: int) -> bool:
    """True if patches of size x size nodes are searched for at full resolution at once."""
    return size // 2 < _COARSE_HALF_MIN or search < _COARSE_REACH_MIN


def _norms(images: Float32, size: int) -> Float32:
    """Reciprocals of the norms of all windows of size x size pixels of images (k, rows, cols)."""
    count, rows, cols = images.shape
    norms = np.empty((count, rows - size + 1, cols - size + 1), np.float32)
    window_norms(images, size, norms)
    return norms
