"""Choice of the fewest candidates that serve every condition at every place as often as wanted, and a
lower bound of their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import AnyArray, Array, Index, Int16, Mask
from ..kernels import multicover as kernels

EXCHANGE_MAX = 30_000
"""Most candidates among which exchanges are tried: their time grows with the candidates and with the
chosen ones near each."""

BOUND_WORK = 6_000_000_000
"""Prices that the ascent to the lower bound adds up: some seconds."""

BOUND_STEPS = 150, 300
"""Steps of the ascent, at least and at most: where the work does not allow as many, the bound is that
of every so many-th place and condition alone.
"""

_PLACES_LEFT = 2
"""Places near a candidate that are left in such a part."""


@dataclass(frozen=True)
class Cover:
    """What candidates serve: candidate i serves condition c of place p if p is ``place[k]`` with k in
    ``first[i]:first[i + 1]`` and bit c of ``bits[row[k]]`` is set (`packed`).

    Candidates are in order of preference: among equally good choices the first is taken.
    """

    first: Index  # (n + 1,)
    place: AnyArray  # (k,) int32
    row: AnyArray  # (k,) int32
    bits: AnyArray  # (rows, words) uint64
    places: int
    conditions: int

    def __len__(self) -> int:
        return len(self.first) - 1

    def counts(self, rows: ArrayLike) -> Int16:
        """How many of the candidates ``rows`` serve each condition, (place, condition), at most
        `kernels.multicover.FREE`.
        """
        found = np.zeros((self.places, self.conditions), np.int16)
        kernels.count(found, *self.links, np.asarray(rows, np.int64))
        return found

    @property
    def links(self) -> tuple[Index, AnyArray, AnyArray, AnyArray]:
        return self.first, self.place, self.row, self.bits

    def at_places(self, some: Index) -> Cover:
        """The same candidates at some of the places, which are numbered anew."""
        number = np.full(self.places, -1, np.int32)
        number[some] = np.arange(len(some), dtype=np.int32)
        place = number[self.place]
        near = place >= 0
        candidate = np.repeat(np.arange(len(self)), np.diff(self.first))[near]
        first = np.concatenate([[0], np.cumsum(np.bincount(candidate, minlength=len(self)))])
        return Cover(first, place[near], self.row[near], self.bits, len(some), self.conditions)

    @cached_property
    def _at_places(self) -> tuple[Index, Index]:
        """The candidates of each place: where they start, and their numbers."""
        candidate = np.repeat(np.arange(len(self)), np.diff(self.first))
        order = np.argsort(self.place, kind="stable")
        per_place = np.bincount(self.place, minlength=self.places)
        return np.concatenate([[0], np.cumsum(per_place)]), candidate[order]


@dataclass(frozen=True)
class CoverChoice:
    """Chosen candidates, rising; and for the greedy order, after each of its candidates, the number of
    conditions at places that are served as often as wanted, and the share of all that was wanted.
    """

    chosen: Index
    met: Index
    served: Array


def packed(serves: Mask) -> AnyArray:
    """Rows of truth values (n, conditions) as bit sets (n, words) of 64 bits, the first in the lowest
    bit.
    """
    rows = np.packbits(serves, axis=1, bitorder="little")
    padded = np.zeros((len(rows), -(-rows.shape[1] // 8) * 8), np.uint8)
    padded[:, : rows.shape[1]] = rows
    return np.ascontiguousarray(padded).view("<u8")


def unpacked(bits: AnyArray, conditions: int) -> Mask:
    """The truth values (n, conditions) of bit sets (`packed`)."""
    whole = np.unpackbits(bits.view(np.uint8), axis=1, count=conditions, bitorder="little")
    return whole.astype(np.bool_)


def choose_cover(cover: Cover, wanted: Int16, most: int | None = None) -> CoverChoice:
    """The fewest candidates found that serve each condition ``wanted`` (place, condition) times, which
    must not exceed `Cover.counts` of all; or, of the choices of ``most``, a greedy one.

    Greedy by the number of conditions that still lack one; then candidates that none needs are
    left out, and one is exchanged for two or more where that is possible, unless the size is
    limited. ValueError for a limit below 1.
    """
    if most is not None and most < 1:
        raise ValueError("most must be at least 1")
    slack = np.where(wanted > 0, -wanted, kernels.FREE).astype(np.int16)
    lacking, tight = packed(slack < 0), packed(slack == 0)
    most = len(cover) if most is None else most
    first, place, row, bits = cover.links
    order, met, served = kernels.greedy(first, place, row, bits, slack, lacking, tight, most)
    total = max(1, int(wanted.sum(dtype=np.int64)))
    is_chosen = np.zeros(len(cover), np.bool_)
    is_chosen[order] = True
    if not (slack < 0).any():  # cut short it has none to spare
        kernels.drop(order, is_chosen, first, place, row, bits, slack, lacking, tight)
        if len(cover) <= EXCHANGE_MAX:
            starts, near = cover._at_places
            while kernels.exchange(
                is_chosen, first, place, row, bits, slack, lacking, tight, starts, near
            ):
                pass
    return CoverChoice(np.flatnonzero(is_chosen), met, served / total)


def least_size(cover: Cover, wanted: Int16, size: int) -> float:
    """A lower bound of the number of candidates of any choice that serves each condition ``wanted``
    times: of the linear relaxation, by subgradient ascent on its dual. ``size``: of a known choice.

    For prices y >= 0 of the conditions the bound is sum(wanted y) - sum(max(0, s - 1)) over the
    candidates' sums s of what they serve; every step's prices give a valid one (Caprara, Fischetti
    and Toth 1999, Oper. Res. 47, 730). The prices of each step are scaled to the best bound. Many
    candidates: the bound is that of a part of the places and conditions, a lower and valid one.
    """
    if not size or not wanted.any():
        return 0.0
    least, most = BOUND_STEPS
    too_much = -(-_work(cover) * least // BOUND_WORK)
    if too_much > 1:
        near = len(cover.place) // max(1, len(cover))  # places of a candidate
        every = max(1, min(too_much, near // _PLACES_LEFT))
        cover, wanted = _part(cover, wanted, every, -(-too_much // every))
    steps = max(least, min(most, BOUND_WORK // max(1, _work(cover))))
    need = wanted.astype(np.float64)
    everyone = np.arange(len(cover))
    shared = cover.counts(everyone).astype(np.float64)
    price = np.where(need > 0.0, 1.0 / np.maximum(shared, 1.0), 0.0)
    best, pace, since = 0.0, 1.0, 0
    for _ in range(steps):
        sums = kernels.prices(*cover.links, price)
        scale, bound = _scaled(sums, float((need * price).sum()))
        if bound > best * (1.0 + 1e-4):
            best, since = bound, 0
        else:
            since += 1
        if since > 5:
            pace, since = pace / 1.5, 0
        price *= scale
        bought = np.flatnonzero(sums * scale > 1.0)
        slope = np.where(need > 0.0, need - cover.counts(bought), 0.0)
        slope[(price <= 0.0) & (slope < 0.0)] = 0.0
        length = float((slope**2).sum())
        if length == 0.0:
            break
        price = np.maximum(0.0, price + pace * max(size - bound, 0.05 * size) / length * slope)
    return best


def _part(cover: Cover, wanted: Int16, places: int, conditions: int) -> tuple[Cover, Int16]:
    """The problem at every so many-th place, in every so many-th condition."""
    part = cover.at_places(np.arange(0, cover.places, places))
    asked = np.arange(cover.conditions) % conditions == 0
    fewer = replace(part, bits=part.bits & packed(asked[None]))
    return fewer, np.where(asked, wanted[::places], 0).astype(np.int16)


def _work(cover: Cover) -> int:
    """Prices that a step of the ascent adds up."""
    bits = np.bitwise_count(cover.bits).sum(axis=1, dtype=np.int64)
    return 2 * int(bits[cover.row].sum())


def _scaled(sums: Array, worth: float) -> tuple[float, float]:
    """The factor of all prices with the greatest bound, and that bound: worth t - sum(max(0, t s - 1))
    rises until the candidates with t s > 1 sum up to the worth.
    """
    falling = np.sort(sums)[::-1]
    total = np.cumsum(falling)
    last = min(int(np.searchsorted(total, worth)), len(falling) - 1)
    if falling[last] <= 0.0:
        return 1.0, 0.0
    scale = 1.0 / falling[last]
    return float(scale), float(worth * scale - np.maximum(0.0, sums * scale - 1.0).sum())
