"""Places that resemble a patch within the area in which it may be searched for.

Correlation is centred and normalised: it does not depend on gain and offset.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array, Float32, Index
from ..kernels.matching.search import rivals
from .corners import fill_missing
from .patches import gather_patches, halved

RIVALS = 64
"""Greatest number of other places for each patch. In noise above the contrast all maxima of a search
square count alike; with 12 the Brier score of the detection probability doubles
(`benchmarks/claims.py simulated`)."""

EXCLUSION_PX = 2.0
"""Maxima no farther than this from a patch's own place belong to its own peak."""

_FLAT = 1e-3
"""A patch whose contrast is not above this share of the whole image's has no contrast."""

_COARSE_HALF_MIN = 16
"""Smaller patches are searched at full resolution: half resolution loses rivals of theirs. The Brier
score of the detection probability is 0.030 with it for 17 x 17 nodes and 0.012 for 25 x 25, and
0.004 at full resolution; for 33 x 33 nodes it is 0.003 and 0.002."""

_COARSE_REACH_MIN = 24
"""Smaller search areas are searched at full resolution, which then costs about the same."""


def other_places(
    image: Float32,
    patches: Float32,
    rows: Index,
    cols: Index,
    search: int,
    exclusion: float = EXCLUSION_PX,
    exact: bool = False,
) -> tuple[Array, Array]:
    """The highest correlations of each patch with other places whose centres lie within
    +-``search`` nodes in both axes, and the contrasts (standard deviations) of the image's windows
    there: (n, `RIVALS`) each, best first, NaN where there are fewer.

    ``patches`` (n, p, p): those at nodes (rows, cols) of the image. Another place is a local
    maximum of the correlation (3 x 3 nodes) farther than ``exclusion`` nodes from the patch's own.
    A ridge without change along itself is a chain of equal maxima and counts. Places are whole
    nodes; the search square is cut at the image's border.

    Missing nodes hold the mean of the valid nodes around them; windows without contrast correlate
    0. A patch without contrast has one other place with correlation 1; a patch that the image's
    border cuts has none.

    The search is that of the matcher (`kernels.matching.search`): half resolution first, then full
    resolution from its highest peaks; ``exact``: full resolution everywhere, as for patches below
    33 nodes a side and for small search areas.
    """
    size = patches.shape[1]
    half = size // 2
    filled = fill_missing(np.asarray(image, dtype=np.float32), size)
    fine = np.ascontiguousarray(filled - filled.mean(dtype=np.float64), dtype=np.float32)
    centres = np.stack([cols, rows], axis=-1).astype(np.int64).reshape(-1, 2)
    cut = ((centres < half) | (centres >= np.array(fine.shape[::-1]) - half)).any(axis=1)
    found = np.full((len(rows), RIVALS), np.nan)
    spread = np.full_like(found, np.nan)
    contrast = patches.std(axis=(1, 2), dtype=np.float64)
    flat = ~(contrast > _FLAT * fine.std(dtype=np.float64))
    found[flat, 0] = 1.0
    spread[flat, 0] = contrast[flat]
    tried = np.flatnonzero(~flat & ~cut)
    coarse = halved(fine)
    two_steps = half >= _COARSE_HALF_MIN and search >= _COARSE_REACH_MIN and not exact
    places = np.empty((len(tried), RIVALS)), np.empty((len(tried), RIVALS))
    rivals(
        fine, np.ones_like(fine), coarse, np.ones_like(coarse),
        np.ascontiguousarray(patches[tried], dtype=np.float32), centres[tried] - half, search,
        float(exclusion), two_steps, *places,
    )  # fmt: skip
    # an ascent from a lower peak at half resolution can end higher; NaN stays last
    order = np.argsort(-places[0], axis=1, kind="stable")
    found[tried], spread[tried] = (np.take_along_axis(part, order, axis=1) for part in places)
    found[cut], spread[cut] = np.nan, np.nan
    return found, spread


RING = np.unique(
    np.round(
        3.0 * np.stack([f(np.arange(16) * np.pi / 8.0) for f in (np.cos, np.sin)], axis=-1)
    ).astype(np.int64),
    axis=0,
)
"""Distances (column, row) of the places just outside a patch's own peak (`EXCLUSION_PX`)."""


def places_around(
    image: Float32, patches: Float32, rows: Index, cols: Index
) -> tuple[Array, Array]:
    """Correlations of patches (n, p, p), those at nodes (rows, cols) of an image, with the windows at
    the distances `RING`, and the contrasts of these windows: (n, k) each; NaN for windows that leave
    the image or hold a missing node.
    """
    half = patches.shape[1] // 2
    unit = patches - patches.mean(axis=(1, 2), dtype=np.float64, keepdims=True)
    norm = np.sqrt(np.einsum("nij,nij->n", unit, unit))
    unit = (unit / np.where(norm > 0.0, norm, 1.0)[:, None, None]).astype(np.float32)
    found, spread = np.empty((2, len(rows), len(RING)))
    for k, (right, down) in enumerate(RING.tolist()):
        window = gather_patches(image, rows + down, cols + right, half)
        spread[:, k] = window.std(axis=(1, 2), dtype=np.float64)
        product = np.einsum("nij,nij->n", unit, window)
        with np.errstate(invalid="ignore", divide="ignore"):
            found[:, k] = product / (spread[:, k] * window[0].size ** 0.5)
    return found, spread
