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
def _towards(boxes, suns):
    """Of parts (rows of `parts_of_cells`): half the height and width, elevation and azimuth of the middle, radians, and the unit
    vector there, east, north, up, into the rows of ``suns`` (size, 7).
    """
    for k in range(len(boxes)):
        box, sun = boxes[k], suns[k]
        sun[0] = math.radians(box[2] - box[1]) / 2.0
        sun[1] = math.radians(box[4] - box[3]) / 2.0
        el, az = math.radians(box[1] + box[2]) / 2.0, math.radians(box[3] + box[4]) / 2.0
        sun[2], sun[3] = el, az
        level = math.cos(el)
        sun[4], sun[5], sun[6] = level * math.sin(az), level * math.cos(az), math.sin(el)


@njit(nogil=True)
def _in_circle(angle):
    """``angle % 360.0``, without a division near the circle."""
    if 0.0 <= angle < 360.0:
        return angle
    if -360.0 <= angle < 0.0:
        return angle + 360.0
    return angle % 360.0


@njit(nogil=True)
def _turned(box, sun, turn, away, spread, bend, found):
    """The box (4,) that contains the Suns of a part (row of `parts_of_cells`, and of `_towards`) in a frame that is turned, into
    found. ``away``: angle between the verticals; ``spread``: how far the frame's place may be from the one given,
    where meridians converge by ``bend`` times that.
    """
    half_el, half_az, el, az = sun[0], sun[1], sun[2], sun[3]
    x, y, z = sun[4], sun[5], sun[6]
    east = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z
    north = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z
    up = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
    level = math.hypot(east, north)
    rise = math.degrees(math.atan2(up, level) - el)
    more = math.degrees(_SAFETY * away * half_az + spread)
    found[0], found[1] = box[1] + rise - more, box[2] + rise + more
    steep = max(abs(box[2]), found[1])
    if steep > _NEAR_ZENITH_DEG:
        found[2], found[3] = 0.0, 360.0
        return
    slope = math.tan(math.radians(steep))
    more = _SAFETY * away * (half_el * (1.0 + slope * slope) + half_az * slope)
    more = math.degrees(more + _SAFETY * spread * (slope + bend))
    shift = math.degrees(math.atan2(east, north) - az)
    shift = _in_circle(shift + 180.0) - 180.0
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
def _from_start(west, east, start, wide):
    """The azimuths of a box from the first one of a cell on: the turn of the circle that reaches into the cell."""
    first = _in_circle(west - start)
    last = first + east - west
    if first >= wide * (1.0 - BEYOND):
        first, last = first - 360.0, last - 360.0
    return first, last


@njit(nogil=True)
def _columns(west, east, start, wide):
    """The columns of cells that azimuths overlap: the first, and the end, as if the circle went on."""
    count, begin = len(start), _in_circle(west)
    first = count - 1
    while first > 0 and start[first] > begin:
        first -= 1
    if start[first] > begin:
        first = count - 1
    for end in range(first, first + count):
        j = end if end < count else end - count
        low, high = _from_start(west, east, start[j], wide[j])
        slack = BEYOND * wide[j]
        if low >= wide[j] - slack or high <= slack:
            if end > first:
                return first, end
            first += 1  # they begin where that ends
    return first, end + 1


@njit(nogil=True)
def _overlapped(box, grid, wide, happens, known, mark, marks, cells, size):
    """Append to ``cells`` the cells that a box (4,) overlaps, in which the Sun can stand, and that have no ``mark`` in ``marks``
    (cell,) yet; mark them. Returns the number of cells, or -1 where the box overlaps none, or leaves the grid or what is
    evaluated. ``wide`` (a,): of the columns; ``happens`` (cell,), ``known`` (e, a).
    """
    low, start, above, after = grid
    if box[0] < low[0] - 1e-6 or box[1] > low[-1] + 1e-6:
        return -1
    west, east = box[2], box[3]
    first, last = _columns(west, east, start, wide)
    count, some = len(start), False
    for i in range(len(low) - 1):
        slack = BEYOND * (low[i + 1] - low[i])
        if box[1] <= low[i] + slack or box[0] >= low[i + 1] - slack:
            continue
        for column in range(first, last):
            j = column if column < count else column - count
            k = j + 1 if j + 1 < count else 0
            cell = i * count + j
            if not happens[cell]:
                continue
            if above[i] != i + 1 or after[j] != k:
                return -1
            corners = (known[i, j], known[i, k], known[i + 1, j], known[i + 1, k])
            at = _from_start(west, east, start[j], wide[j])
            if _weight(box, i, at, wide[j], corners, low) < 0.5:
                return -1
            some = True
            if marks[cell] != mark:
                marks[cell], cells[size] = mark, cell
                size += 1
    return size if some else -1


@njit(nogil=True)
def _served(
    worth, units, turns, away, spread, bend, boxes, suns, grid, wide, happens, known, columns, views
):
    """Lower the units (condition,) that a candidate is worth at a place to what it surely is there: the least in all cells that
    the parts of a cell overlap; 0 where one has no condition, or where there is none.

    ``units`` (condition,): by the angles at the candidate; ``turns`` (3, 3): from the frame of the place to
    that of the candidate; ``boxes``, ``suns``: rows of `parts_of_cells` and of `_towards`.
    """
    each = len(units) // views
    box, cells, marks = np.zeros(4), np.zeros(len(columns), np.int64), np.full(len(columns), -1)
    begin = 0
    while begin < len(boxes):
        cell, end = boxes[begin, 0], begin
        while end < len(boxes) and boxes[end, 0] == cell:
            end += 1
        own, size, some = columns[int(cell)], 0, False
        for shift in range(0, len(units), each):
            some |= worth[shift + own] > 0
        for k in range(begin, end if some else begin):
            _turned(boxes[k], suns[k], turns, away, spread, bend, box)
            size = _overlapped(box, grid, wide, happens, known, begin, marks, cells, size)
            if size < 0:
                break
        for k in range(size):
            if columns[cells[k]] < 0:
                size = -1
                break
        for shift in range(0, len(units), each):
            least = worth[shift + own] if size > 0 else np.uint8(0)
            for k in range(size):
                least = min(least, units[shift + columns[cells[k]]])
            worth[shift + own] = least
        begin = end


@njit(nogil=True)
def serve(worth, found, near, frames, spread, units, suns, grid, columns, views, limit):
    """`_served` for all pairs, once for each row of worth; ``found`` (place, condition) is set where the Sun can
    stand in a cell at a place.

    ``near``: where the pairs of each place start, and of each pair the candidate and the row of worth.
    ``frames``: latitudes (p,) and axes (p, 3, 3) of the places, axes of the candidates (n, 3, 3). ``suns``: the
    number of each candidate's latitude, and what happens and is evaluated there (`_overlapped`).
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
    boxes, directions = np.zeros((size, 5)), np.zeros((size, 7))
    done = np.zeros(len(worth), np.bool_)
    wide = (np.roll(grid[1], -1) - grid[1]) % 360.0
    for p in range(len(lats)):
        size = parts_of_cells(lats[p], grid, columns, limit + spread, boxes)
        _towards(boxes[:size], directions)
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
            _served(
                worth[row[k]], units[i], turns, away, spread, bend, boxes[:size], directions, grid,
                wide, happens[own], known[own], columns, views,
            )  # fmt: skip
