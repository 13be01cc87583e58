"""Multicover by bit sets: candidates that serve, at some places, some of the conditions there.

Candidate i serves condition c of place p if p is one of ``place[first[i]:first[i + 1]]`` and bit c of
``bits[row[k]]`` (words of 64 bits) is set, where place[k] is p. ``slack`` (place, condition): how many more of the chosen
candidates serve it than are wanted; `FREE` where none is wanted.
"""

import heapq

import numpy as np
from numba import njit

FREE = 20_000
"""Slack of a condition that wants no candidate: more than any count reaches."""

_ONE = np.uint64(1)
_PAIRS = np.uint64(0x5555555555555555)
_FOURS = np.uint64(0x3333333333333333)
_BYTES = np.uint64(0x0F0F0F0F0F0F0F0F)
_SUM = np.uint64(0x0101010101010101)


@njit(cache=True, nogil=True)
def _ones(word):
    """Number of bits that are set."""
    word = word - ((word >> _ONE) & _PAIRS)
    word = (word & _FOURS) + ((word >> np.uint64(2)) & _FOURS)
    word = (word + (word >> np.uint64(4))) & _BYTES
    return np.int64((word * _SUM) >> np.uint64(56))


@njit(cache=True, nogil=True)
def _lowest(word):
    """Number of the lowest bit that is set."""
    return _ones((word & (~word + _ONE)) - _ONE)


@njit(cache=True, nogil=True)
def raise_to(best, first, place, values):
    """Raise best (place, condition) to the values (candidate, condition) of the candidates there."""
    for i in range(len(first) - 1):
        for k in range(first[i], first[i + 1]):
            row = best[place[k]]
            for c in range(values.shape[1]):
                row[c] = max(row[c], values[i, c])


@njit(cache=True, nogil=True)
def count(found, first, place, row, bits, rows):
    """Add to found (place, condition), int16, how many of the candidates ``rows`` serve each, up to
    `FREE`.
    """
    for i in rows:
        for k in range(first[i], first[i + 1]):
            own = found[place[k]]
            for w in range(bits.shape[1]):
                word = bits[row[k], w]
                while word:
                    c = 64 * w + _lowest(word)
                    own[c] = min(own[c] + 1, FREE)
                    word &= word - _ONE


@njit(cache=True, nogil=True)
def _gain(i, first, place, row, bits, lacking):
    """Number of conditions with negative slack that a candidate serves."""
    found = 0
    for k in range(first[i], first[i + 1]):
        for w in range(bits.shape[1]):
            word = bits[row[k], w] & lacking[place[k], w]
            if word:
                found += _ones(word)
    return found


@njit(cache=True, nogil=True)
def _add(i, sign, first, place, row, bits, slack, lacking, tight):
    """Add a candidate to the chosen ones, or take it away (sign -1); return the number of conditions
    that have no negative slack any more.
    """
    met = 0
    for k in range(first[i], first[i + 1]):
        p = place[k]
        for w in range(bits.shape[1]):
            word = bits[row[k], w]
            while word:
                bit = word & (~word + _ONE)
                c = 64 * w + _ones(bit - _ONE)
                word ^= bit
                if slack[p, c] >= FREE:
                    continue
                slack[p, c] += sign
                now = slack[p, c]
                if now == 0:
                    tight[p, w] |= bit
                else:
                    tight[p, w] &= ~bit
                if now < 0:
                    lacking[p, w] |= bit
                else:
                    if sign > 0 and now == 0:
                        met += 1
                    lacking[p, w] &= ~bit
    return met


@njit(cache=True, nogil=True)
def _is_needed(i, first, place, row, bits, tight):
    """True if a condition would have negative slack without the candidate."""
    for k in range(first[i], first[i + 1]):
        for w in range(bits.shape[1]):
            if bits[row[k], w] & tight[place[k], w]:
                return True
    return False


@njit(cache=True, nogil=True)
def greedy(first, place, row, bits, slack, lacking, tight, most):
    """Choose up to ``most`` candidates, always the one that serves most conditions with negative
    slack, of several the first. Return their numbers in the order of the choice, and after each how
    many conditions have no negative slack any more and how much of all that was lacking is served.
    """
    heap = [(np.int64(0), np.int64(0)) for _ in range(0)]
    for i in range(len(first) - 1):
        gain = _gain(i, first, place, row, bits, lacking)
        if gain:
            heap.append((-gain, np.int64(i)))
    heapq.heapify(heap)
    chosen = np.zeros(min(most, len(heap)), np.int64)
    met, served = np.zeros(len(chosen), np.int64), np.zeros(len(chosen), np.int64)
    size = done = total = 0
    while heap and size < len(chosen):
        stored, i = heapq.heappop(heap)
        gain = _gain(i, first, place, row, bits, lacking)
        if gain == 0:
            continue
        if gain < -stored:
            heapq.heappush(heap, (-gain, i))
            continue
        done += _add(i, 1, first, place, row, bits, slack, lacking, tight)
        total += gain
        chosen[size], met[size], served[size] = i, done, total
        size += 1
    return chosen[:size], met[:size], served[:size]


@njit(cache=True, nogil=True)
def drop(chosen, is_chosen, first, place, row, bits, slack, lacking, tight):
    """Take away the chosen candidates, the last first, that no condition needs."""
    for k in range(len(chosen) - 1, -1, -1):
        i = chosen[k]
        if is_chosen[i] and not _is_needed(i, first, place, row, bits, tight):
            _add(i, -1, first, place, row, bits, slack, lacking, tight)
            is_chosen[i] = False


@njit(cache=True, nogil=True)
def exchange(is_chosen, first, place, row, bits, slack, lacking, tight, first_at, candidate_at):
    """Add each candidate in turn that makes at least two chosen ones superfluous, and take those away;
    return the number of exchanges. ``first_at``, ``candidate_at``: the candidates of each place.
    """
    seen = np.full(len(is_chosen), -1, np.int64)
    gone = np.zeros(len(is_chosen), np.int64)
    done = 0
    for j in range(len(is_chosen)):
        if is_chosen[j]:
            continue
        _add(j, 1, first, place, row, bits, slack, lacking, tight)
        size = 0
        seen[j] = j
        for k in range(first[j], first[j + 1]):
            for m in range(first_at[place[k]], first_at[place[k] + 1]):
                i = candidate_at[m]
                if is_chosen[i] and seen[i] != j:
                    seen[i] = j
                    if not _is_needed(i, first, place, row, bits, tight):
                        _add(i, -1, first, place, row, bits, slack, lacking, tight)
                        gone[size] = i
                        size += 1
        if size > 1:
            is_chosen[j] = True
            for k in range(size):
                is_chosen[gone[k]] = False
            done += 1
        else:
            for k in range(size):
                _add(gone[k], 1, first, place, row, bits, slack, lacking, tight)
            _add(j, -1, first, place, row, bits, slack, lacking, tight)
    return done


@njit(cache=True, nogil=True)
def prices(first, place, row, bits, price):
    """Sum of the prices (place, condition) of what each candidate serves, float64."""
    found = np.zeros(len(first) - 1)
    for i in range(len(found)):
        total = 0.0
        for k in range(first[i], first[i + 1]):
            for w in range(bits.shape[1]):
                word = bits[row[k], w]
                while word:
                    total += price[place[k], 64 * w + _lowest(word)]
                    word &= word - _ONE
        found[i] = total
    return found
