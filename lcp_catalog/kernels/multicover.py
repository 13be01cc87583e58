"""Multicover: candidates that are worth some units, at some places, in the conditions there.

Candidate i is worth ``worth[row[k], c]`` units (uint8) in condition c of place p if p is one of
``place[first[i]:first[i + 1]]`` and place[k] is p. ``slack`` (place, condition), int16: how many more units the
chosen candidates have than are wanted; `FREE` where none is wanted.
"""

import heapq

import numpy as np

from .cache import njit

FREE = 20_000
"""Slack of a condition that wants nothing: more than any sum reaches."""


@njit(nogil=True)
def raise_to(best, first, place, values):
    """Raise best (place, condition) to the values (candidate, condition) of the candidates there."""
    for i in range(len(first) - 1):
        for k in range(first[i], first[i + 1]):
            row = best[place[k]]
            for c in range(values.shape[1]):
                row[c] = max(row[c], values[i, c])


@njit(nogil=True)
def count(found, first, place, row, worth, rows):
    """Add to found (place, condition), int16, the units of the candidates ``rows``, up to `FREE`."""
    for i in rows:
        for k in range(first[i], first[i + 1]):
            own, units = found[place[k]], worth[row[k]]
            for c in range(len(units)):
                own[c] = min(own[c] + units[c], FREE)


@njit(nogil=True)
def _gain(i, first, place, row, worth, slack):
    """Units of a candidate that conditions with negative slack lack."""
    found = np.int64(0)
    for k in range(first[i], first[i + 1]):
        own, units = slack[place[k]], worth[row[k]]
        part = np.int32(0)
        for c in range(len(units)):
            part += min(np.int32(units[c]), max(np.int32(0), np.int32(-own[c])))
        found += part
    return found


@njit(nogil=True)
def _add(i, sign, first, place, row, worth, slack):
    """Add a candidate to the chosen ones, or take it away (sign -1); return the number of conditions
    that have no negative slack any more.
    """
    met = np.int64(0)
    for k in range(first[i], first[i + 1]):
        own, units = slack[place[k]], worth[row[k]]
        part = np.int32(0)
        for c in range(len(units)):
            before = own[c]
            after = before if before >= FREE else np.int16(before + sign * np.int16(units[c]))
            own[c] = after
            part += np.int32(before < 0) & np.int32(after >= 0)
        met += part
    return met


@njit(nogil=True)
def _is_needed(i, first, place, row, worth, slack):
    """True if a condition would have negative slack without the candidate."""
    for k in range(first[i], first[i + 1]):
        own, units = slack[place[k]], worth[row[k]]
        needed = False
        for c in range(len(units)):
            needed |= own[c] < np.int16(units[c])
        if needed:
            return True
    return False


@njit(nogil=True)
def greedy(first, place, row, worth, slack, most):
    """Choose up to ``most`` candidates, always the one with most units that conditions with negative
    slack lack, of several the first. Return their numbers in the order of the choice, and after each how
    many conditions have no negative slack any more and how much of all that was lacking is served.
    """
    heap = [(np.int64(0), np.int64(0)) for _ in range(0)]
    for i in range(len(first) - 1):
        gain = _gain(i, first, place, row, worth, slack)
        if gain:
            heap.append((-gain, np.int64(i)))
    heapq.heapify(heap)
    chosen = np.zeros(min(most, len(heap)), np.int64)
    met, served = np.zeros(len(chosen), np.int64), np.zeros(len(chosen), np.int64)
    size = done = total = 0
    while heap and size < len(chosen):
        stored, i = heapq.heappop(heap)
        gain = _gain(i, first, place, row, worth, slack)
        if gain == 0:
            continue
        if gain < -stored:
            heapq.heappush(heap, (-gain, i))
            continue
        done += _add(i, 1, first, place, row, worth, slack)
        total += gain
        chosen[size], met[size], served[size] = i, done, total
        size += 1
    return chosen[:size], met[:size], served[:size]


@njit(nogil=True)
def drop(chosen, is_chosen, first, place, row, worth, slack):
    """Take away the chosen candidates, the last first, that no condition needs."""
    for k in range(len(chosen) - 1, -1, -1):
        i = chosen[k]
        if is_chosen[i] and not _is_needed(i, first, place, row, worth, slack):
            _add(i, -1, first, place, row, worth, slack)
            is_chosen[i] = False


@njit(nogil=True)
def exchange(is_chosen, first, place, row, worth, slack, first_at, candidate_at):
    """Add each candidate in turn that makes at least two chosen ones superfluous, and take those away;
    return the number of exchanges. ``first_at``, ``candidate_at``: the candidates of each place.
    """
    seen = np.full(len(is_chosen), -1, np.int64)
    gone = np.zeros(len(is_chosen), np.int64)
    done = 0
    for j in range(len(is_chosen)):
        if is_chosen[j]:
            continue
        _add(j, 1, first, place, row, worth, slack)
        size = 0
        seen[j] = j
        for k in range(first[j], first[j + 1]):
            for m in range(first_at[place[k]], first_at[place[k] + 1]):
                i = candidate_at[m]
                if is_chosen[i] and seen[i] != j:
                    seen[i] = j
                    if not _is_needed(i, first, place, row, worth, slack):
                        _add(i, -1, first, place, row, worth, slack)
                        gone[size] = i
                        size += 1
        if size > 1:
            is_chosen[j] = True
            for k in range(size):
                is_chosen[gone[k]] = False
            done += 1
        else:
            for k in range(size):
                _add(gone[k], 1, first, place, row, worth, slack)
            _add(j, -1, first, place, row, worth, slack)
    return done


@njit(nogil=True)
def prices(first, place, row, worth, price):
    """Sum of the prices (place, condition) of the units of each candidate, float64."""
    found = np.zeros(len(first) - 1)
    for i in range(len(found)):
        total = 0.0
        for k in range(first[i], first[i + 1]):
            own, units = price[place[k]], worth[row[k]]
            for c in range(len(units)):
                if units[c]:
                    total += units[c] * own[c]
        found[i] = total
    return found
