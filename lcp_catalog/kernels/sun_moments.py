"""What candidates serve at places at real moments: the Sun stands in one direction, which has other angles at the
candidate than at the place.

Cells of a Sun grid are cut into parts. A part in which the Sun can stand at a place is a box of elevation and
azimuth; turned into the frame of a candidate it overlaps some cells, and is worth there what it is worth
in the least of them. ``grid``: elevations and azimuths in degrees, and the numbers of the next ones (`sun_cells.SunCells`);
cell (i, j) has the number i a + j.
"""

import math

import numpy as np

from .cache import njit

PART_DEG = 1.0, 5.0
"""Greatest height and width of a part of a cell."""

BEYOND = 0.005
"""Share of a step of the grid by which a part may reach into a cell that is not looked at. A point that is usable
in a cell has at its edges at least 0.125 logits more than it needs (`prediction.BETWEEN_MARGIN`: 0.375 of
the middle and 0.25 of an edge). A far corner without any detection takes away at most 12 logits times its
weight (least probabilities up to 0.99), and both angles add to it: 0.12.
"""

_NEAR_ZENITH_DEG = 84.0
_SAFETY = 1.2
"""Factor of the first derivatives, for what the second ones add."""


@njit(nogil=True)
def parts_of_cells(lat, grid, columns, limit, boxes):
    """Parts of cells with a condition (``columns`` >= 0) in which the Sun can stand at a latitude, rows of cell,
    least and greatest elevation and azimuth, degrees, in ``boxes``; returns their number.
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
                if abs(sine) <= limit + reach:
                    boxes[size, 0] = cell
                    boxes[size, 1], boxes[size, 2] = middle - half, middle + half
                    boxes[size, 3], boxes[size, 4] = towards - turn, towards + turn
                    size += 1
    return size


@njit(nogil=True)
def _turned(box, turn, away, spread, bend, found):
    """The box (4,) that contains the Suns of a part (row of `parts_of_cells`) in a frame that is turned, into
    found. ``away``: angle between the verticals; ``spread``: how far the frame's place may be from the one given,
    where meridians converge by ``bend`` times that.
    """
    el, az = math.radians(box[1] + box[2]) / 2.0, math.radians(box[3] + box[4]) / 2.0
    half_el, half_az = math.radians(box[2] - box[1]) / 2.0, math.radians(box[4] - box[3]) / 2.0
    x, y, z = math.cos(el) * math.sin(az), math.cos(el) * math.cos(az), math.sin(el)
    east = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z
    north = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z
    up = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
    level = math.hypot(east, north)
    rise = math.atan2(up, level) - el
    more = math.degrees(_SAFETY * away * half_az + spread)
    found[0], found[1] = box[1] + math.degrees(rise) - more, box[2] + math.degrees(rise) + more
    steep = max(abs(box[2]), found[1])
    if steep > _NEAR_ZENITH_DEG:
        found[2], found[3] = 0.0, 360.0
        return
    slope = math.tan(math.radians(steep))
    more = _SAFETY * away * (half_el * (1.0 + slope * slope) + half_az * slope)
    more = math.degrees(more + _SAFETY * spread * (slope + bend))
    shift = math.degrees(math.atan2(east, north) - az)
    shift = (shift + 180.0) % 360.0 - 180.0
    found[2], found[3] = box[3] + shift - more, box[4] + shift + more
    if not found[3] - found[2] < 360.0:
        found[2], found[3] = 0.0, 360.0


@njit(nogil=True)
def _weight(box, i, at, wide, corners, low):
    """Least weight of the evaluated corners of a cell in a box's part of it; ``at``: the azimuths of the box
    from the cell's first.
    """
    if corners[0] and corners[1] and corners[2] and corners[3]:
        return 1.0
    least = 1.0
    for el in box[:2]:
        up = min(1.0, max(0.0, (el - low[i]) / (low[i + 1] - low[i])))
        for azimuth in at:
            on = min(1.0, max(0.0, azimuth / wide))
            first = (1.0 - on) * corners[0] + on * corners[1]
            last = (1.0 - on) * corners[2] + on * corners[3]
            least = min(least, (1.0 - up) * first + up * last)
    return least


@njit(nogil=True)
def _from_start(box, start, wide):
    """A box's azimuths from the first one of a cell on: the turn of the circle that reaches into the cell."""
    first = (box[2] - start) % 360.0
    last = first + box[3] - box[2]
    if first >= wide * (1.0 - BEYOND):
        first, last = first - 360.0, last - 360.0
    return first, last


@njit(nogil=True)
def overlapped(box, grid, happens, known, cells):
    """The cells that a box (4,) overlaps and in which the Sun can stand, into cells; returns their number, or
    -1 where the box leaves the grid or what is evaluated. ``happens`` (cell,), ``known`` (e, a).
    """
    low, start, above, after = grid
    if box[0] < low[0] - 1e-6 or box[1] > low[-1] + 1e-6:
        return -1
    size, count = 0, len(start)
    for i in range(len(low) - 1):
        slack = BEYOND * (low[i + 1] - low[i])
        if box[1] <= low[i] + slack or box[0] >= low[i + 1] - slack:
            continue
        for j in range(count):
            k = (j + 1) % count
            wide = (start[k] - start[j]) % 360.0
            first, last = _from_start(box, start[j], wide)
            cell = i * count + j
            slack = BEYOND * wide
            if first >= wide - slack or last <= slack or not happens[cell]:
                continue
            if above[i] != i + 1 or after[j] != k:
                return -1
            corners = (known[i, j], known[i, k], known[i + 1, j], known[i + 1, k])
            if _weight(box, i, (first, last), wide, corners, low) < 0.5:
                return -1
            cells[size] = cell
            size += 1
    return size


@njit(nogil=True)
def _least(cells, size, units, shift, columns):
    """The least units of a candidate (c,) in any of the cells, of the view with this ``shift``."""
    if size <= 0:
        return np.uint8(0)
    least = np.uint8(255)
    for k in range(size):
        c = columns[cells[k]]
        if c < 0:
            return np.uint8(0)
        least = min(least, units[shift + c])
    return least


@njit(nogil=True)
def served(worth, units, turns, away, spread, bend, boxes, grid, happens, known, columns, views):
    """Lower the units (condition,) that a candidate is worth at a place to what it surely is there.

    ``units`` (condition,): by the angles at the candidate; ``turns`` (3, 3): from the frame of the place to
    that of the candidate.
    """
    each = len(units) // views
    box, cells = np.zeros(4), np.zeros(len(columns), np.int64)
    for part in boxes:
        own = columns[int(part[0])]
        size = -2
        for shift in range(0, len(units), each):
            c = shift + own
            if not worth[c]:
                continue
            if size == -2:
                _turned(part, turns, away, spread, bend, box)
                size = overlapped(box, grid, happens, known, cells)
            worth[c] = min(worth[c], _least(cells, size, units, shift, columns))


@njit(nogil=True)
def serve(worth, found, near, frames, spread, units, suns, grid, columns, views, limit):
    """`served` for all pairs, once for each row of worth; ``found`` (place, condition) is set where the Sun can
    stand in a cell at a place.

    ``near``: where the pairs of each place start, and of each pair the candidate and the row of worth.
    ``frames``: latitudes (p,) and axes (p, 3, 3) of the places, axes of the candidates (n, 3, 3). ``suns``: the
    number of each candidate's latitude, and what happens and is evaluated there (`overlapped`).
    """
    starts, candidate, row = near
    lats, axes, others = frames
    number, happens, known = suns
    each = units.shape[1] // views
    size = 1
    for i in range(len(grid[0])):
        high = grid[0][max(grid[2][i], i)] - grid[0][i]
        size += (math.ceil(high / PART_DEG[0]) + 1) * (
            len(grid[1]) + math.ceil(360.0 / PART_DEG[1])
        )
    boxes = np.zeros((size, 5))
    done = np.zeros(len(worth), np.bool_)
    for p in range(len(lats)):
        size = parts_of_cells(lats[p], grid, columns, limit + spread, boxes)
        for part in boxes[:size]:
            for v in range(views):
                found[p, v * each + columns[int(part[0])]] = True
        for k in range(starts[p], starts[p + 1]):
            if done[row[k]]:
                continue
            done[row[k]] = True
            i = candidate[k]
            turns = others[i] @ axes[p].T
            away = math.acos(min(1.0, max(-1.0, turns[2, 2])))
            sine = min(1.0, max(abs(others[i, 2, 2]), abs(axes[p, 2, 2])) + spread)
            bend = sine / math.sqrt(1.0 - sine * sine) if sine < 1.0 else math.inf
            bend = bend if spread > 0.0 else 0.0
            own = number[i]
            served(
                worth[row[k]], units[i], turns, away, spread, bend, boxes[:size], grid,
                happens[own], known[own], columns, views,
            )  # fmt: skip
