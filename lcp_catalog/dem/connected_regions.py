"""Regions of the Moon made of runs: which runs hang together, and the box of longitudes and latitudes around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Index
from ..geometry.bounds import Bounds


@dataclass(frozen=True)
class Region:
    """A piece of ground: the box around it, and its own area."""

    bounds: Bounds
    area_km2: float


def components(
    row: Index, start: Array, end: Array, turn: float = 0.0, links: Index | None = None
) -> Index:
    """Number (0 ..) of the piece that every run belongs to.

    Runs [start, end) are sorted by row and start and do not overlap within a row. They hang together when they overlap in
    neighbouring rows or touch in one row; with a ``turn`` positions repeat after so much. ``links`` (pairs, 2) are further
    runs that hang together.
    """
    joined = [_overlapping(row, start, end), _touching(row, start, end, turn)]
    if links is not None:
        joined.append(links)
    first, second = np.concatenate(joined).T
    label = np.arange(row.size)
    while True:
        lowest = np.minimum(label[first], label[second])
        new = label.copy()
        for one in (first, second):
            np.minimum.at(new, one, lowest)
            np.minimum.at(new, label[one], lowest)
        while not np.array_equal(new, new[new]):
            new = new[new]
        if np.array_equal(new, label):
            return np.unique(label, return_inverse=True)[1]
        label = new


def _overlapping(row: Index, start: Array, end: Array) -> Index:
    """Pairs of runs of neighbouring rows that overlap."""
    low = float(start.min(initial=0.0))
    stride = 2.0 * (float(end.max(initial=1.0)) - low) + 1.0
    starts, ends = row * stride + (start - low), row * stride + (end - low)
    first = np.searchsorted(ends, starts + stride, side="right")
    count = np.maximum(np.searchsorted(starts, ends + stride, side="left") - first, 0)
    mine = np.repeat(np.arange(row.size), count)
    step = np.arange(mine.size) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([mine, np.repeat(first, count) + step], axis=1)


def _touching(row: Index, start: Array, end: Array, turn: float) -> Index:
    """Pairs of runs of one row that touch: neighbours, and with a ``turn`` the last and the first."""
    index = np.arange(row.size)
    near = (row[1:] == row[:-1]) & (start[1:] - end[:-1] < 1e-9)
    pairs = [np.stack([index[:-1][near], index[1:][near]], axis=1)]
    if turn and row.size:
        first = np.flatnonzero(np.append(True, row[1:] != row[:-1]))
        last = np.append(first[1:], row.size) - 1
        near = start[first] + turn - end[last] < 1e-9
        pairs.append(np.stack([first[near], last[near]], axis=1))
    return np.concatenate(pairs)
