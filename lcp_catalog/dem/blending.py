"""Outer edges of what a product covers, and weights that rise smoothly from them, for the blending
of products.

The weight is 0 at the outer edge and 1 from one band inside it on; between them it is the
smoothstep 3 t^2 - 2 t^3 of the distance. Its slope is at most 1.5 / band and 0 at both ends, so
that neither height nor slope jumps.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Array

BAND_PX = 16.0
"""Width of a seam, in pixels of the coarser of the two products that meet."""
BAND_SHARE = 0.125
"""Greatest width of a band, as a share of the product's smaller side."""

_SLACK = 1e-3  # pixels; tiles lie on whole ones


class Tile(NamedTuple):
    """A file's rectangle on the unbounded lattice of its product, pixel edges: columns ``left`` to
    ``right``, rows ``top`` down to ``bottom``.
    """

    left: float
    right: float
    top: float
    bottom: float


class Edge(NamedTuple):
    """A straight piece of an outer edge: at the column (or row) ``at``, from ``low`` to ``high``
    along it, in pixels.
    """

    column: bool
    at: float
    low: float
    high: float


def smoothstep(share: Array) -> Array:
    """0 below 0, 1 above 1, and 3 t^2 - 2 t^3 between."""
    t = np.clip(share, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def outer_edges(tiles: Sequence[Tile], period: float, poles: tuple[bool, bool]) -> tuple[Edge, ...]:
    """Edges of tiles that have no other tile on their outer side.

    ``period``: columns around the Moon, 0 for a map without a seam. ``poles``: True if the first or
    last row of the tiles ends at a pole, which is no edge.
    """
    turns = (-period, 0.0, period) if period else (0.0,)
    around = [Tile(t.left + turn, t.right + turn, t.top, t.bottom) for t in tiles for turn in turns]
    top, bottom = min(t.top for t in tiles), max(t.bottom for t in tiles)
    found: dict[tuple[bool, float], list[tuple[float, float]]] = {}
    for tile in tiles:
        for column, at, sign in (
            (True, tile.left, -1),
            (True, tile.right, 1),
            (False, tile.top, -1),
            (False, tile.bottom, 1),
        ):
            if not column and ((poles[0] and at == top) or (poles[1] and at == bottom)):
                continue
            span = (tile.top, tile.bottom) if column else (tile.left, tile.right)
            bare = _without(span, _behind(around, column, at, sign))
            found.setdefault((column, at), []).extend(bare)
    return tuple(
        Edge(column, at, first, last)
        for (column, at), spans in found.items()
        for first, last in _joined(spans)
    )


def _behind(
    tiles: Iterable[Tile], column: bool, at: float, sign: int
) -> Iterable[tuple[float, float]]:
    """Spans along an edge that have a tile on the other side."""
    for tile in tiles:
        low, high = (tile.left, tile.right) if column else (tile.top, tile.bottom)
        beyond = at + sign * 2.0 * _SLACK
        if low < beyond < high:
            yield (tile.top, tile.bottom) if column else (tile.left, tile.right)


def _without(
    span: tuple[float, float], others: Iterable[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Parts of a span outside other spans."""
    left = [span]
    for low, high in others:
        cut = [piece for a, b in left for piece in ((a, min(b, low)), (max(a, high), b))]
        left = [(a, b) for a, b in cut if b - a > _SLACK]
    return left


def _joined(spans: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Spans, those that touch joined: two edges in line must count once."""
    out: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if out and low <= out[-1][1] + _SLACK:
            out[-1] = (out[-1][0], max(out[-1][1], high))
        else:
            out.append((low, high))
    return out


def edge_weight(
    column: Array,
    row: Array,
    stretch: Array | float,
    edges: Sequence[Edge],
    period: float,
    band: float,
) -> Array:
    """Weight (n,) of a product at fractional pixels, from the distance to each of its edges.

    ``stretch``: width of a pixel on the surface over its height, (n,); ``band``: width of the seam
    in heights of a pixel.
    """
    weight = np.ones(column.shape)
    if not column.size:
        return weight
    for edge in edges:
        at, along = (column, row) if edge.column else (row, column)
        away = np.abs(at - edge.at)
        past = np.maximum(np.maximum(edge.low - along, along - edge.high), 0.0)
        if period and edge.column:
            away = away % period
            away = np.minimum(away, period - away)
        elif period:
            east = (along - edge.low) % period  # of the edge's west end
            past = np.where(
                east <= edge.high - edge.low,
                0.0,
                np.minimum(east - (edge.high - edge.low), period - east),
            )
        away, past = (away * stretch, past) if edge.column else (away, past * stretch)
        if away.min() < band:
            weight *= smoothstep(np.sqrt(away * away + past * past) / band)
    return weight


def clear_of(
    edges: Iterable[Edge],
    columns: tuple[float, float],
    rows: tuple[float, float],
    stretch: float,
    period: float,
    band: float,
) -> bool:
    """True if every place in a box of pixels is at least a band away from every edge, taken as an
    unbounded line.
    """
    for edge in edges:
        low, high = columns if edge.column else rows
        turns = (-period, 0.0, period) if edge.column and period else (0.0,)
        away = min(max(low - edge.at - t, edge.at + t - high) for t in turns)
        if away * (stretch if edge.column else 1.0) < band * (1.0 + 1e-9):
            return False
    return True
