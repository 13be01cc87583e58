"""What candidates are worth at places at real moments: the Sun stands in one direction, which has other angles at the
candidate than at the place.

Cells of a Sun grid are cut into parts. The lowest and the highest Sun in the middle of a part, where it can stand at a place, are
moments; turned into the frame of a candidate one lies between four directions of the grid, whose claims are averaged as
`catalog.prediction` does. A candidate is worth in a cell what it is worth at the worst of its moments. ``grid``: elevations and
azimuths in degrees, and the numbers of the next ones (`sun_cells.SunCells`); cell (i, j) has the number i a + j.
"""

import math

import numpy as np

from .cache import njit

PART_DEG = 2.0, 5.0
"""Greatest height and width of a part of a cell."""

UNKNOWN = 255
"""Code of a claim that was not evaluated."""

_SAFETY = 1.2
"""Factor of the first derivative of the elevation by the azimuth, for what the second ones add."""

_EDGE_DEG = 1e-6
"""Slack at the ends of the claims."""


@njit(nogil=True)
def parts_of_cells(lat, grid, columns, limit, boxes):
    """Parts of cells with a condition (``columns`` >= 0) in which the Sun can stand at a latitude, rows of cell,
    least and greatest elevation and azimuth, degrees, in ``boxes``; returns their number. A part is as wide as the azimuths at
    which the Sun can stand there: beyond them directions may not be evaluated.
    """
    low, start, above, after = grid
    size = 0
    for cell in range(len(columns)):
        i, j = cell // len(start), cell % len(start)
        if columns[cell] < 0:
            continue
        high, wide = low[above[i]] - low[i], (start[after[j]] - start[j]) % 360.0
        ups, ons = math.ceil(high / PART_DEG[0]), math.ceil(wide / PART_DEG[1])
        half, turn = high / ups / 2.0, wide / ons / 2.0
        for u in range(ups):
            middle = low[i] + (2 * u + 1) * half
            el = math.radians(middle)
            reach = math.radians(half + turn * math.cos(el) * math.cos(lat))
            for o in range(ons):
                towards = start[j] + (2 * o + 1) * turn
                sine = math.sin(lat) * math.sin(el)
                sine += math.cos(lat) * math.cos(el) * math.cos(math.radians(towards))
                if abs(sine) > limit + reach:
                    continue
                boxes[size, 0] = cell
                boxes[size, 1], boxes[size, 2] = middle - half, middle + half
                boxes[size, 3], boxes[size, 4] = towards - turn, towards + turn
                size += _narrowed(boxes[size], lat, limit)
    return size


@njit(nogil=True)
def _narrowed(box, lat, limit):
    """Narrow a part (row of `parts_of_cells`) to the azimuths at which the Sun's declination is at most ``limit``; returns
    False if there are none. sin(dec) = sin(lat) sin(el) + cos(lat) cos(el) cos(az); its cos(az) is greatest and least at an
    end of the elevations or where sin(el) = sin(lat) / sin(dec).
    """
    west, east = box[3], box[4]
    if math.floor(west / 180.0) != math.floor((east - 1e-9) / 180.0):
        return True  # across north or south, where cos(az) turns
    lows, highs = math.sin(math.radians(box[1])), math.sin(math.radians(box[2]))
    least, most = math.inf, -math.inf
    for bound in (-limit, limit):
        turning = math.sin(lat) / bound
        for rise in (lows, highs, min(max(turning, lows), highs)):
            level = math.cos(lat) * math.sqrt(1.0 - rise * rise)
            if level < 1e-6:
                return True  # at a pole or at the zenith every azimuth
            cosine = (bound - math.sin(lat) * rise) / level
            least, most = min(least, cosine), max(most, cosine)
    first = math.degrees(math.acos(min(1.0, max(-1.0, most))))
    last = math.degrees(math.acos(min(1.0, max(-1.0, least))))
    turns = 360.0 * math.floor(west / 360.0)
    if west - turns >= 180.0:
        first, last = 360.0 - last, 360.0 - first
    box[3], box[4] = max(west, first + turns), min(east, last + turns)
    return box[3] <= box[4] and least <= 1.0 and most >= -1.0


@njit(nogil=True)
def _least(least, shown, sun, half, codes, inverse, slope, rule, grid):
    """Lower the heights of peaks, or with margins the logits, of a candidate in each view (v,) to those at two moments; False if
    one is beyond the claims, or if too little is known there.

    ``sun``: direction in the candidate's frame, ``half``: degrees by which the Sun stands lower and higher. ``codes``, ``inverse``
    (v, e, a): of its claims, and one over how clearly relief shows there for its ``slope`` errors (`landmarks.relief_signal`).
    ``rule``: `serve`; ``shown`` (v,): for use here.
    """
    low, start, above, after = grid
    heights, views, light, logits, step, _, margins, ends = rule
    albedo, least_cosine, least_shown = light
    between, beyond = margins
    middle = math.degrees(math.atan2(sun[2], math.hypot(sun[0], sun[1])))
    azimuth = math.degrees(math.atan2(sun[0], sun[1])) % 360.0
    j = np.searchsorted(start, azimuth, side="right") - 1
    j = j if j >= 0 else len(start) - 1
    k = after[j]
    if (
        k == j
        or k < 0
        or middle - half < ends[0] - _EDGE_DEG
        or middle + half > ends[1] + _EDGE_DEG
    ):
        return False
    on = ((azimuth - start[j]) % 360.0) / ((start[k] - start[j]) % 360.0)
    flat = max(math.hypot(sun[0], sun[1]), 1e-12)
    for el in (middle - half, middle + half):
        up_here, along = math.sin(math.radians(el)), math.cos(math.radians(el)) / flat
        mu0 = max(up_here, least_cosine)
        for v in range(len(views)):
            shown[v] = 1.0
            if albedo > 0.0:
                both = mu0 + max(views[v, 2], least_cosine)
                east = (along * sun[0] + views[v, 0]) / both - along * sun[0] / mu0
                north = (along * sun[1] + views[v, 1]) / both - along * sun[1] / mu0
                square = max(east * east + north * north, least_shown * least_shown)
                shown[v] = math.sqrt(square / (albedo * albedo + slope * slope * square))
        i = min(max(np.searchsorted(low, el, side="right") - 1, 0), len(low) - 2)
        if above[i] != i + 1:
            return False
        up = min(max((el - low[i]) / (low[i + 1] - low[i]), 0.0), 1.0)
        first = (1.0 - up) * (1.0 - on) * (codes[0, i, j] != UNKNOWN)
        second = (1.0 - up) * on * (codes[0, i, k] != UNKNOWN)
        third = up * (1.0 - on) * (codes[0, i + 1, j] != UNKNOWN)
        fourth = up * on * (codes[0, i + 1, k] != UNKNOWN)
        total = first + second + third + fourth
        if total < 0.5:
            return False
        for v in range(len(views)):
            mean = first * heights[codes[v, i, j]] * inverse[v, i, j]
            mean += second * heights[codes[v, i, k]] * inverse[v, i, k]
            mean += third * heights[codes[v, i + 1, j]] * inverse[v, i + 1, j]
            mean += fourth * heights[codes[v, i + 1, k]] * inverse[v, i + 1, k]
            mean *= shown[v] / total
            if between > 0.0:
                mean = _looked_up(logits, mean / step) - between - beyond * (1.0 - total)
            least[v] = min(least[v], mean)
    return True


@njit(nogil=True)
def _looked_up(table, at):
    """The value of a table between its entries."""
    at = min(at, len(table) - 1.0)
    first = min(int(at), len(table) - 2)
    return table[first] + (at - first) * (table[first + 1] - table[first])


@njit(nogil=True)
def _lower(worth, own, boxes, suns, tilt, codes, inverse, slope, rule, grid, least, shown):
    """Lower what a candidate is worth (conditions,) in cell ``own`` of each view to the least at the moments of a cell's parts:
    rows of `parts_of_cells` and their middles (n, 3) in its frame. ``tilt``: angle between the verticals of place and candidate;
    ``least``, ``shown`` (v,): for use here.
    """
    logits, step, limits, margins, _ = rule[3:]
    each = len(worth) // len(least)
    least[:] = np.inf
    for m in range(len(boxes)):
        half = (boxes[m, 2] - boxes[m, 1]) / 2.0
        half += _SAFETY * tilt * (boxes[m, 4] - boxes[m, 3]) / 2.0
        known = _least(least, shown, suns[m], half, codes, inverse, slope, rule, grid)
        anything = False
        for v in range(len(least)):
            at = v * each + own
            if worth[at] > 0:
                logit = least[v] if margins[0] > 0.0 else _looked_up(logits, least[v] / step)
                units = np.uint8(0)
                while known and units < len(limits) and logit >= limits[units]:
                    units += np.uint8(1)
                worth[at] = min(worth[at], units)
                anything |= worth[at] > 0
        if not anything:
            return


@njit(nogil=True)
def serve(worth, found, near, frames, claims, rule, grid, columns, limit):
    """Lower what candidates are worth, rows (row, condition), to the least at the places of the pairs of each row; ``found``
    (place, condition) is set where the Sun can stand in a cell at a place.

    ``near``: where the pairs of each place start, and of each pair the candidate and the row of worth. ``frames``: latitudes (p,)
    and axes (p, 3, 3) of the places, axes of the candidates (n, 3, 3).
    ``claims``: codes (n, v, e, a) of the probabilities, unknown in all views alike, and of each candidate the number of its
    slope errors; these (k,), and one over how clearly relief shows (k, v, e, a).
    ``rule``: heights of peaks by code; directions to the cameras (v, 3); unmapped brightness, and the least cosine and signal of
    relief; logits of probabilities by height, in steps; least logits of 1, 2, ... units; margins in logits between the grid's
    directions and beyond them; least and greatest elevation, degrees, at which claims count. ``limit``: of the Sun's declination,
    radians.
    """
    starts, candidate, row = near
    lats, axes, others = frames
    codes, number, slopes, inverse = claims
    views = codes.shape[1]
    each = worth.shape[1] // views
    size = 1
    for i in range(len(grid[0])):
        high = grid[0][max(grid[2][i], i)] - grid[0][i]
        size += (math.ceil(high / PART_DEG[0]) + 1) * (
            len(grid[1]) + math.ceil(360.0 / PART_DEG[1])
        )
    boxes, suns = np.zeros((size, 5)), np.zeros((size, 3))
    least, shown = np.zeros(views), np.zeros(views)
    for p in range(len(lats)):
        size = parts_of_cells(lats[p], grid, columns, limit, boxes)
        for m in range(size):
            el = math.radians(boxes[m, 1] + boxes[m, 2]) / 2.0
            az = math.radians(boxes[m, 3] + boxes[m, 4]) / 2.0
            suns[m, 0], suns[m, 1] = math.cos(el) * math.sin(az), math.cos(el) * math.cos(az)
            suns[m, 2] = math.sin(el)
            for v in range(views):
                found[p, v * each + columns[int(boxes[m, 0])]] = True
        for pair in range(starts[p], starts[p + 1]):
            i, own = candidate[pair], worth[row[pair]]
            turns = others[i] @ axes[p].T
            turned, tilt = suns[:size] @ turns.T, math.acos(min(1.0, max(-1.0, turns[2, 2])))
            kind, begin = number[i], 0
            while begin < size:
                cell, end = boxes[begin, 0], begin
                while end < size and boxes[end, 0] == cell:
                    end += 1
                _lower(
                    own, columns[int(cell)], boxes[begin:end], turned[begin:end], tilt, codes[i], inverse[kind],
                    slopes[kind], rule, grid, least, shown,
                )  # fmt: skip
                begin = end
