"""Places that resemble a patch within the area in which it may be searched for.

Correlation is centred and normalised: it does not depend on gain and offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Float32, Index
from ..kernels.matching.rivals import centred, rivals, window_norms
from .corners import fill_missing
from .patches import halved

RIVALS = 64
"""Greatest number of other places for each patch. In noise above the contrast all maxima of a search
square count alike; with 12 the Brier score of the detection probability doubles
(`claims_simulated.py` of c896266)."""

EXCLUSION_PX = 2.0
"""Maxima no farther than this from a patch's own place belong to its own peak."""

_FLAT = 1e-3
"""A patch whose contrast is not above this share of the whole image's has no contrast."""

_COARSE_HALF_MIN = 7
"""Least half width of patches that are searched at half resolution first: 15 x 15 nodes, of 17 x 17 without their
border, become 7 x 7 pixels. On cells of 118 m the probability of 17 x 17 nodes differed from that of the search at
full resolution by 0.019 (rms), of 33 x 33 by 0.012 (`benchmarks/speed/build.py`)."""

_COARSE_REACH_MIN = 12
"""Smaller search areas are searched at full resolution, which then costs about the same."""


_RING_PX = 5.0
RING = np.unique(
    np.round(
        _RING_PX * np.stack([f(np.arange(16) * np.pi / 8.0) for f in (np.cos, np.sin)], axis=-1)
    ).astype(np.int64),
    axis=0,
)
"""Distances (column, row) of the places around a patch's own peak that tell whether noise moves its top: a parabola that is as
high 5 nodes from the true place as there has its top in between, at 2.5 nodes, farther than the peak reaches (`EXCLUSION_PX`).
"""


class OtherPlaces(NamedTuple):
    """Places that resemble n patches. ``correlation``, ``contrast`` (n, most): the highest
    correlations of each patch with other places, best first, and the standard deviations of the
    image's windows there, NaN where there are fewer. ``near``, ``near_contrast`` (n, k): the same at
    the distances `RING` from the patch's own place, NaN for windows that leave the image.
    """

    correlation: Array
    contrast: Array
    near: Array
    near_contrast: Array


@dataclass(frozen=True, eq=False)
class SearchImages:
    """Images (k, rows, cols) prepared for searches for patches of ``size`` x ``size`` nodes: less
    their means, with the norms of their windows, and the same at half resolution; and the least norm
    (k,) of a patch with contrast.
    """

    size: int
    images: Float32
    norms: Float32
    coarse: Float32
    coarse_norms: Float32
    least_norm: Array

    @classmethod
    def of(cls, images: Float32, size: int) -> SearchImages:
        """The images; missing nodes hold the mean of the valid nodes around them."""
        given = np.ascontiguousarray(images, np.float32)
        fine, power = np.empty_like(given), np.empty(len(given))
        centred(given, fine, power)
        if not np.isfinite(power).all():
            given = np.stack([fill_missing(image, size) for image in given])
            centred(given, fine, power)
        coarse = halved(fine)
        least_norm = _FLAT * np.sqrt(power) * size
        norms, coarse_norms = _norms(fine, size), _norms(coarse, size // 2)
        return cls(size, fine, norms, coarse, coarse_norms, least_norm)


def other_places(
    images: Float32 | SearchImages,
    patches: Float32,
    rows: Index,
    cols: Index,
    search: int,
    which: Index | None = None,
    least: Array | None = None,
    exclusion: float = EXCLUSION_PX,
    exact: bool = False,
    most: int = RIVALS,
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

    Maxima below ``least`` (n,), except the two highest, may be left out (`detection.least_rival`). Half
    resolution is searched first, then full resolution from its highest maxima. ``exact``: full
    resolution everywhere, as for small patches and small search areas. ``most``: greatest number of
    places for each patch. ValueError for images that are prepared for patches of another size.
    """
    size, count = patches.shape[1], len(rows)
    shapes = ((count, most), (count, most), (count, len(RING)), (count, len(RING)))
    if not isinstance(images, SearchImages):
        if min(images.shape[1:]) < size:
            return OtherPlaces(*(np.full(shape, np.nan) for shape in shapes))
        images = SearchImages.of(images, size)
    found = OtherPlaces(*(np.empty(shape) for shape in shapes))
    if images.size != size:
        raise ValueError(f"images prepared for patches of {images.size} nodes, not {size}")
    origins = np.stack([cols, rows], axis=-1).astype(np.int64).reshape(-1, 2) - size // 2
    rivals(
        images.images, images.norms, images.coarse, images.coarse_norms, images.least_norm,
        np.ascontiguousarray(patches, dtype=np.float32),
        np.zeros(count, np.int64) if which is None else which, origins, search,
        float(exclusion), not (exact or searched_exactly(size, search)),
        np.full(count, -2.0) if least is None else least, RING,
        found.correlation, found.contrast, found.near, found.near_contrast,
    )  # fmt: skip
    return found


def searched_exactly(size: int, search: int) -> bool:
    """True if patches of size x size nodes are searched for at full resolution at once."""
    return size // 2 < _COARSE_HALF_MIN or search < _COARSE_REACH_MIN


def _norms(images: Float32, size: int) -> Float32:
    """Reciprocals of the norms of all windows of size x size pixels of images (k, rows, cols)."""
    count, rows, cols = images.shape
    norms = np.empty((count, max(rows - size + 1, 0), max(cols - size + 1, 0)), np.float32)
    window_norms(images, size, norms)
    return norms
