"""Corners that remain corners under many Sun directions.

The edge of a shadow is often the strongest corner of an image, and lies elsewhere in the next one.
A single image does not separate it from a feature of the terrain. The mean response over many Suns
does (`Persistence`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, Float32, Index, Mask
from .localization import HARRIS_K

_HIGH_PERCENTILE = 99.0
"""Percentile of the response that counts as 1: below the maximum, so that a single bright spot does
not set the scale.
"""


Part = tuple[slice, slice]
"""Rows and columns of an image."""
WHOLE: Part = np.s_[:, :]

BLOCK = 7
"""Nodes along the window over which the response is summed."""

GROUP_GAIN = 1.2
"""Least ratio of the scores of a group of conditions of another candidate and of those that a cell has."""

GROUP_EXTRA = 2
"""Most candidates in a cell besides the best of all conditions."""


@dataclass(frozen=True, eq=False)
class MissingNodes:
    """Missing nodes (rows, cols) of images, and how many valid nodes the ``size``-wide box around each holds: those of one
    view are the same under all Suns.
    """

    missing: Mask
    size: int

    @cached_property
    def at(self) -> tuple[Index, Index]:
        """Rows and columns (n,) of the missing nodes."""
        rows, cols = np.nonzero(self.missing)
        return rows, cols

    @cached_property
    def count(self) -> Array:
        """Valid nodes (n,) in the box around each."""
        return np.rint(self._sums((~self.missing).astype(np.float32)))

    def fill(self, image: Float32) -> None:
        """`fill_missing` of an image with these missing nodes, in place."""
        image[self.at] = 0.0
        found = self._sums(image) / np.maximum(self.count, 1.0)
        if not self.count.all():
            valid = max(image.size - self.count.size, 1)
            found[self.count == 0.0] = image.sum(dtype=np.float64) / valid
        image[self.at] = found

    def _sums(self, values: Float32) -> Array:
        """Sums (n,) over the boxes around the missing nodes; beyond the border is 0."""
        box, border = (self.size, self.size), cv2.BORDER_CONSTANT
        sums = cv2.boxFilter(values, cv2.CV_64F, box, normalize=False, borderType=border)
        return np.asarray(sums[self.at], np.float64)


def fill_missing(image: Float32, size: int) -> Float32:
    """The image if it is complete, else a copy whose NaN nodes hold the mean of the valid nodes in the
    ``size``-wide box around them.

    Without a valid node in the box: the mean of the whole image; 0 if no node is valid.
    """
    if np.isfinite(image.sum()):
        return image
    filled = image.copy()
    MissingNodes(~np.isfinite(image), size).fill(filled)
    return filled


def robust_contrast(image: Float32) -> float:
    """Robust standard deviation of the lit nodes, (84th - 16th percentile) / 2; 0 if no node is
    lit.
    """
    lit = image[image > 0.0]  # False for NaN
    lit = lit[np.isfinite(lit)]
    if not lit.size:
        return 0.0
    low, high = _percentiles(lit, 15.865, 84.135)
    return (high - low) / 2.0


def _percentiles(values: Float32, *percents: float) -> list[float]:
    """Percentiles of values (n,), interpolated linearly, by one partition."""
    places = [(values.size - 1) * percent / 100.0 for percent in percents]
    firsts = [int(place) for place in places]
    ranks = [(first, min(first + 1, values.size - 1)) for first in firsts]
    ordered = np.partition(values, sorted({rank for pair in ranks for rank in pair}))
    return [
        float(ordered[low]) + (place - low) * (float(ordered[high]) - float(ordered[low]))
        for place, (low, high) in zip(places, ranks, strict=True)
    ]


def harris(image: Float32, contrast: float | None = None) -> Float32:
    """Response of Harris and Stephens (1988) at each node: det M - k trace(M)^2 with k = `HARRIS_K`, M
    summed over `BLOCK` x `BLOCK` nodes.

    The response of cv2 grows with the fourth power of contrast. The image is therefore divided by
    its robust contrast (or ``contrast``) first, so that a gain does not change the response. It is 0
    for an image without contrast, and NaN where the window or its gradients (3 x 3 Sobel) would touch a missing
    node or the image's border. Edges of shadows have a strong response: see `Persistence`.
    """
    margin = BLOCK // 2 + 1
    known = cv2.erode(
        np.isfinite(image).astype(np.uint8),
        np.ones((2 * margin + 1, 2 * margin + 1), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    contrast = robust_contrast(image) if contrast is None else contrast
    if contrast > 0.0:
        scaled = (fill_missing(image, 2 * margin + 1) / np.float32(contrast)).astype(np.float32)
        response = cv2.cornerHarris(scaled, blockSize=BLOCK, ksize=3, k=HARRIS_K)
    else:
        response = np.zeros(image.shape, dtype=np.float32)
    return np.where(known > 0, response, np.float32(np.nan))


def relative_response(image: Float32, part: Part = WHOLE) -> Float32:
    """Fourth root of the Harris response over its own 99th percentile of positive lit responses,
    clipped to 0..1, in a part of the image.

    The root makes the response proportional to contrast, so that terrain that is visible under
    every Sun outweighs the passing edges of shadows, which are ten times as strong. 0 in shadow;
    NaN where the response is NaN.
    """
    # any scale gives the same shares: the contrast of a sixteenth of the nodes, unless it is 0
    response = harris(image, robust_contrast(image[::4, ::4]) or None)
    shown = (response > 0.0) & (image > 0.0)  # False for NaN
    positive = response.ravel()[np.flatnonzero(shown)]
    own, shown = response[part], shown[part]
    if not positive.size:
        return own * np.float32(0.0)
    (high,) = _percentiles(positive, _HIGH_PERCENTILE)
    bounded = np.minimum(
        np.where(shown, own, own * np.float32(0.0)) / np.float32(high), np.float32(1.0)
    )
    return np.sqrt(np.sqrt(bounded))


@dataclass
class Persistence:
    """Relative corner response in a part of images, summed over conditions.

    The score is the mean over
    *all* added conditions: at most one half for a node that is dark or not visible under half of
    the Suns, and nearly 0 for the edge of a shadow, which lies at a node under one or two Suns.
    """

    shape: tuple[int, int]
    part: Part = WHOLE
    conditions: int = 0
    total: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        self.total = np.zeros(self.shape, dtype=np.float64)

    def add(self, image: Float32) -> None:
        """Add the image of one condition."""
        response = relative_response(image, part=self.part)
        self.total[self.part] += np.where(np.isnan(response), np.float32(0.0), response)
        self.conditions += 1

    def score(self) -> Float32:
        """Mean relative response 0..1 over the added conditions; 0 without any and outside the part."""
        return (self.total / max(self.conditions, 1)).astype(np.float32)

    def include(self, other: Persistence) -> None:
        """Add the conditions of another one of the same shape."""
        self.total += other.total
        self.conditions += other.conditions


def candidates(
    score: Float32,
    spacing_px: int,
    per_cell: int,
    border: int,
    valid: Mask | None = None,
    radius: int | None = None,
    origin: tuple[int, int] = (0, 0),
) -> tuple[Index, Index]:
    """Rows and columns of the highest local maxima, at most ``per_cell`` in each cell of
    ``spacing_px`` x ``spacing_px`` nodes, ordered by (row, column).

    A maximum is the highest valid node within ``radius`` nodes in both axes (default: an eighth of
    the spacing, at least 1) and has a positive score; of equal neighbours the first by (row,
    column) counts. ``border`` nodes along the edges are left out. ``origin`` is the row and column
    of node [0, 0] in a fixed grid, from whose origin cells are counted: every build then divides
    the same terrain into the same cells.
    """
    radius = _radius(spacing_px) if radius is None else radius
    usable = _inner(score.shape, border) & np.isfinite(score)
    if valid is not None:
        usable &= valid
    clean = np.where(usable, score, np.float32(0.0)).astype(np.float32)
    highest = cv2.dilate(clean, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))
    rows, cols = np.nonzero((clean == highest) & (clean > 0.0))
    first = _first_of_equals(rows, cols, radius, clean.shape)
    rows, cols = rows[first], cols[first]
    cell_row, cell_col = _cells(rows, cols, spacing_px, origin).T
    order = np.lexsort((cols, rows, -clean[rows, cols], cell_col, cell_row))
    keep = order[_rank_in_group(cell_row[order], cell_col[order]) < per_cell]
    keep = keep[np.lexsort((cols[keep], rows[keep]))]
    return rows[keep], cols[keep]


def candidates_of_groups(
    score: Float32,
    groups: Sequence[Float32],
    spacing_px: int,
    per_cell: int,
    border: int,
    valid: Mask | None = None,
    origin: tuple[int, int] = (0, 0),
) -> tuple[Index, Index]:
    """`candidates` of a score, and besides, group by group, those that exceed by a factor of
    `GROUP_GAIN`, in the score of the group, all that are taken in their cell so far, and are none of
    their neighbours: at most one of each group in a cell, and `GROUP_EXTRA` of all groups. Rows and
    columns, ordered by (row, column).
    """
    radius = _radius(spacing_px)
    rows, cols = candidates(score, spacing_px, per_cell, border, valid, radius, origin)
    most = per_cell + GROUP_EXTRA
    for group in groups:
        more = candidates(group, spacing_px, 1, border, valid, radius, origin)
        places = ((rows, cols), more)
        cells = [_cells(row, col, spacing_px, origin) for row, col in places]
        _, number = np.unique(np.concatenate(cells), axis=0, return_inverse=True)
        own, new = np.split(number.ravel(), [len(rows)])
        best, count = np.zeros(number.size), np.zeros(number.size, dtype=np.int64)
        np.maximum.at(best, own, np.nan_to_num(group[rows, cols]))
        np.add.at(count, own, 1)
        gain = (group[more] > GROUP_GAIN * best[new]) & (count[new] < most)
        gain &= ~_near(rows, cols, radius, group.shape)[more]
        rows, cols = (np.concatenate([a, b[gain]]) for a, b in zip((rows, cols), more, strict=True))
    order = np.lexsort((cols, rows))
    return rows[order], cols[order]


def _near(rows: Index, cols: Index, radius: int, shape: tuple[int, ...]) -> Mask:
    """True within ``radius`` nodes, in both axes, of the given ones."""
    given = np.zeros(shape, np.uint8)
    given[rows, cols] = 1
    square = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return np.asarray(cv2.dilate(given, square) > 0)


def _radius(spacing_px: int) -> int:
    """Nodes around a maximum in which there is no higher one."""
    return max(1, spacing_px // 8)


def _cells(rows: Index, cols: Index, spacing_px: int, origin: tuple[int, int]) -> Index:
    """Row and column of the spacing cells of nodes, (n, 2)."""
    return np.stack([(rows + origin[0]) // spacing_px, (cols + origin[1]) // spacing_px], axis=1)


def _first_of_equals(rows: Index, cols: Index, radius: int, shape: tuple[int, ...]) -> Mask:
    """True for maxima without another one before them, by (row, column), that counts and lies within
    ``radius`` nodes in both axes: of equal height, since each is the highest there.
    """
    taken, first = np.zeros(shape, dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
    for k, (row, col) in enumerate(zip(rows.tolist(), cols.tolist(), strict=True)):
        if not taken[row, col]:
            first[k] = True
            taken[row : row + radius + 1, max(col - radius, 0) : col + radius + 1] = True
    return first


def _inner(shape: tuple[int, ...], border: int) -> Mask:
    inner = np.zeros(shape, dtype=np.bool_)
    inner[border : max(border, shape[0] - border), border : max(border, shape[1] - border)] = True
    return inner


def _rank_in_group(first: Index, second: Index) -> Index:
    """Position of each element within its run of equal (first, second); the input is sorted."""
    if not len(first):
        return np.zeros(0, dtype=np.int64)
    new = np.r_[True, (first[1:] != first[:-1]) | (second[1:] != second[:-1])]
    starts = np.flatnonzero(new)
    return np.arange(len(first)) - np.repeat(starts, np.diff(np.r_[starts, len(first)]))
