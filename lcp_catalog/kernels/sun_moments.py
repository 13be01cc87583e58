"""What candidates are worth at places at real moments: the Sun stands in one direction, which has other angles at the
candidate than at the place.

Moments are the corners of where the Sun can stand in a cell of a Sun grid at a place, and Suns between them; and the one that is
nearest to a camera behind which it passes, where relief shows least. Turned into the frame of a candidate a Sun lies between four
directions of the grid, whose claims are averaged as `catalog.prediction` does. A candidate is worth in a cell what it is worth at
the worst of its moments. ``grid``: elevations and azimuths in degrees, and the numbers of the next ones (`sun_cells.SunCells`);
cell (i, j) has the number i a + j.
"""

import math

import numpy as np

from .cache import njit

PART_DEG = 2.0, 5.0
"""Greatest distance in elevation and azimuth of the moments of a cell."""

UNKNOWN = 255
"""Code of a claim that was not evaluated."""

_EDGE_DEG = 1e-6
"""Slack at the ends of the claims."""


@njit(nogil=True)
def moments_of_cells(lat, grid, columns, bound, moments):
    """Suns in cells with a condition (``columns`` >= 0) that can stand at a latitude, rows of cell, elevation and azimuth,
    degrees, in ``moments``; returns their number. ``bound``: greatest sine of the declination. Beyond it directions
    may not be evaluated.
    """
    low, start, above, after = grid
    size = 0
    for cell in range(len(columns)):
        i, j = cell // len(start), cell % len(start)
        if columns[cell] < 0:
            continue
        high, west, begin = low[above[i]], start[j], size
        east = west + (start[after[j]] - west) % 360.0
        turning = 180.0 * math.ceil(west / 180.0)  # north or south
        steps = math.ceil((high - low[i]) / PART_DEG[0])
        for u in range(steps + 1):
            el = low[i] + u * (high - low[i]) / steps
            size = _on_level(el, west, east, lat, bound, moments, size)
        for azimuth in (west, east, turning):
            if azimuth <= east:
                size = _on_line(azimuth, low[i], high, lat, bound, moments, size)
        moments[begin:size, 0] = cell
    return size


@njit(nogil=True)
def _on_level(elevation, west, east, lat, bound, moments, size):
    """Add Suns of one elevation between two azimuths to ``moments`` (`moments_of_cells`), of which there are ``size``:
    sin(dec) = sin(lat) sin(el) + cos(lat) cos(el) cos(az). Returns their number.
    """
    el = math.radians(elevation)
    rise, level = math.sin(lat) * math.sin(el), max(math.cos(lat) * math.cos(el), 1e-12)
    most, least = (bound - rise) / level, (-bound - rise) / level
    if least > 1.0 or most < -1.0:
        return size
    first = math.degrees(math.acos(min(1.0, most)))
    last = math.degrees(math.acos(max(-1.0, least)))
    for begin, end in ((first, last), (360.0 - last, 360.0 - first), (360.0 + first, 360.0 + last)):
        start, wide = max(begin, west), min(end, east) - max(begin, west)
        steps = max(1, math.ceil(wide / PART_DEG[1]))
        for k in range(steps + 1 if wide >= 0.0 else 0):
            moments[size, 1], moments[size, 2] = elevation, start + k * wide / steps
            size += 1
    return size


@njit(nogil=True)
def _on_line(azimuth, low, high, lat, bound, moments, size):
    """Add the Suns of one azimuth between two elevations with the least and the greatest declination (`_on_level`)."""
    up, north = math.sin(lat), math.cos(lat) * math.cos(math.radians(azimuth))
    length, turned = math.hypot(up, north), math.atan2(north, up)
    if length <= bound:
        return size
    for sine in (-bound / length, bound / length):
        for angle in (math.asin(sine), math.pi - math.asin(sine)):
            elevation = (math.degrees(angle - turned) + 180.0) % 360.0 - 180.0
            if low < elevation < high:
                moments[size, 1], moments[size, 2] = elevation, azimuth
                size += 1
    return size


@njit(nogil=True)
def _behind(view, lat, grid, bound):
    """The Sun nearest to a direction that can stand at a latitude (3,), both east, north, up at the place; and the number of its
    cell, -1 for none.
    """
    pole = np.array([0.0, math.cos(lat), math.sin(lat)])
    sine = view[1] * pole[1] + view[2] * pole[2]
    height = min(max(sine, -bound), bound)
    level = math.sqrt((1.0 - height * height) / max(1.0 - sine * sine, 1e-12))
    sun = level * (view - sine * pole) + height * pole
    i, j, _, _ = _below(sun, grid)
    return sun, (i * len(grid[1]) + j if i >= 0 else -1)


@njit(nogil=True)
def _below(sun, grid):
    """Numbers of the elevation and the azimuth of a grid below those of a direction, -1 below the lowest; and these, degrees."""
    elevation = math.degrees(math.atan2(sun[2], math.hypot(sun[0], sun[1])))
    azimuth = math.degrees(math.atan2(sun[0], sun[1])) % 360.0
    i, j = np.searchsorted(grid[0], elevation, "right"), np.searchsorted(grid[1], azimuth, "right")
    return i - 1, (j - 1) % len(grid[1]), elevation, azimuth


@njit(nogil=True)
def _least(suns, given, rule, grid, least):
    """Write the least height of a peak, or with margins logit, of a candidate in each view (v,) under Suns (n, 3) in its frame
    into ``least``; -inf if one is beyond the claims, or too little is known there. The rest is left out of logits that are all
    worth nothing.

    ``given``: codes of its claims (v, e, a), one over how clearly relief shows there for its slope errors
    (`landmarks.relief_signal`), and these. ``rule``: `serve`.
    """
    codes, inverse, slope = given
    low, start, above, after = grid
    heights, views, light, logits, step, limits, margins, ends = rule
    albedo, least_cosine, least_shown = light
    between, beyond = margins
    least[:] = np.inf
    for m in range(len(suns)):
        sun = suns[m]
        i, j, el, azimuth = _below(sun, grid)
        i, k = min(max(i, 0), len(low) - 2), after[j]
        beyond_ends = el < ends[0] - _EDGE_DEG or el > ends[1] + _EDGE_DEG
        if k == j or k < 0 or above[i] != i + 1 or beyond_ends:
            least[:] = -np.inf
            return
        on = ((azimuth - start[j]) % 360.0) / ((start[k] - start[j]) % 360.0)
        up = min(max((el - low[i]) / (low[i + 1] - low[i]), 0.0), 1.0)
        first = (1.0 - up) * (1.0 - on) * (codes[0, i, j] != UNKNOWN)
        second = (1.0 - up) * on * (codes[0, i, k] != UNKNOWN)
        third = up * (1.0 - on) * (codes[0, i + 1, j] != UNKNOWN)
        fourth = up * on * (codes[0, i + 1, k] != UNKNOWN)
        total = first + second + third + fourth
        if total < 0.5:
            least[:] = -np.inf
            return
        mu0, anything = max(sun[2], least_cosine), between == 0.0
        for v in range(len(views)):
            shown = 1.0
            if albedo > 0.0:
                both = mu0 + max(views[v, 2], least_cosine)
                east = (sun[0] + views[v, 0]) / both - sun[0] / mu0
                north = (sun[1] + views[v, 1]) / both - sun[1] / mu0
                square = max(east * east + north * north, least_shown * least_shown)
                shown = math.sqrt(square / (albedo * albedo + slope * slope * square))
            mean = first * heights[codes[v, i, j]] * inverse[v, i, j]
            mean += second * heights[codes[v, i, k]] * inverse[v, i, k]
            mean += third * heights[codes[v, i + 1, j]] * inverse[v, i + 1, j]
            mean += fourth * heights[codes[v, i + 1, k]] * inverse[v, i + 1, k]
            mean *= shown / total
            if between > 0.0:
                mean = _looked_up(logits, mean / step) - between - beyond * (1.0 - total)
            least[v] = min(least[v], mean)
            anything |= least[v] >= limits[0]
        if not anything:
            return


@njit(nogil=True)
def _looked_up(table, at):
    """The value of a table between its entries."""
    at = min(at, len(table) - 1.0)
    first = min(int(at), len(table) - 2)
    return table[first] + (at - first) * (table[first + 1] - table[first])


@njit(nogil=True)
def _lower(worth, own, least, rule):
    """Lower what a candidate is worth (conditions,) in cell ``own`` of each view to what its `_least` (v,) is."""
    logits, step, limits, margins = rule[3], rule[4], rule[5], rule[6]
    each = len(worth) // len(least)
    for v in range(len(least)):
        units = 0
        if least[v] > -np.inf:
            logit = least[v] if margins[0] > 0.0 else _looked_up(logits, least[v] / step)
            while units < len(limits) and logit >= limits[units]:
                units += 1
        worth[v * each + own] = min(worth[v * each + own], np.uint8(units))


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
    bound, size = math.sin(limit), 0
    for i in range(len(grid[0])):
        steps = math.ceil((grid[0][max(grid[2][i], i)] - grid[0][i]) / PART_DEG[0])
        size += 4 * (steps + 4) * (len(grid[1]) + math.ceil(360.0 / PART_DEG[1]))
    moments, suns = np.zeros((size, 3)), np.zeros((size, 3))
    least = np.zeros(views)
    for p in range(len(lats)):
        size = moments_of_cells(lats[p], grid, columns, bound, moments)
        for m in range(size):
            el, az = math.radians(moments[m, 1]), math.radians(moments[m, 2])
            suns[m, 0], suns[m, 1] = math.cos(el) * math.sin(az), math.cos(el) * math.cos(az)
            suns[m, 2] = math.sin(el)
            for v in range(views):
                found[p, v * each + columns[int(moments[m, 0])]] = True
        for pair in range(starts[p], starts[p + 1]):
            i, own = candidate[pair], worth[row[pair]]
            turns = others[i] @ axes[p].T
            turned, towards = suns[:size] @ turns.T, rule[1] @ turns
            given, begin = (codes[i], inverse[number[i]], slopes[number[i]]), 0
            while begin < size:
                cell, end = moments[begin, 0], begin
                while end < size and moments[end, 0] == cell:
                    end += 1
                _least(turned[begin:end], given, rule, grid, least)
                _lower(own, columns[int(cell)], least, rule)
                begin = end
            for v in range(views):
                sun, there = _behind(towards[v], lats[p], grid, bound)
                if there >= 0 and columns[there] >= 0:
                    _least(sun.reshape(1, 3) @ turns.T, given, rule, grid, least)
                    _lower(own, columns[there], least, rule)
