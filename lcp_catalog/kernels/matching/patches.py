"""Patches of images: copies, differences at half resolution, the optics' blur, and light on them."""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from ..vectors import LANES, load, multiple, splat, store


@njit(nogil=True, error_model="numpy", parallel=True)
def gather(stack, which, rows, cols, half, out):
    """Copy the (2 half + 1)^2 nodes around each (row, col) of image ``which`` of a stack (k, rows,
    cols) into out (n, size, size); nodes outside the image are NaN.
    """
    size = 2 * half + 1
    done = 0
    for n in prange(which.size):
        done += 1
        image = stack[which[n]]
        top, left = rows[n] - half, cols[n] - half
        if 0 <= top <= image.shape[0] - size and 0 <= left <= image.shape[1] - size:
            for i in range(size):
                source, target = image[top + i, left : left + size], out[n, i]
                for j in range(size):
                    target[j] = source[j]
        else:
            for i in range(size):
                for j in range(size):
                    r, c = top + i, left + j
                    inside = 0 <= r < image.shape[0] and 0 <= c < image.shape[1]
                    out[n, i, j] = image[r, c] if inside else math.nan
    all_done(done, which.size)


@njit(nogil=True, error_model="numpy", parallel=True)
def halved_changes(changes, rows, cols, out):
    """Write differences (n, p, p) from images at the patches around (rows, cols), at half their
    resolution, on the pixels of images at half resolution, into out (n, q, q), q = 2 (p // 4) + 1; 0
    beyond the patches.
    """
    p, q = changes.shape[1], out.shape[1]
    fine = p // 2
    done = 0
    for n in prange(changes.shape[0]):
        done += 1
        top, left = fine % 2 - rows[n] % 2, fine % 2 - cols[n] % 2
        for i in range(q):
            for j in range(q):
                total = np.float32(0.0)
                for r in range(max(top + 2 * i, 0), min(top + 2 * i + 2, p)):
                    for c in range(max(left + 2 * j, 0), min(left + 2 * j + 2, p)):
                        total += changes[n, r, c]
                out[n, i, j] = np.float32(0.25) * total
    all_done(done, changes.shape[0])


@njit(nogil=True, error_model="numpy")
def _seven(values, starts, taps, out, at):
    """Write the sum of the runs of vectors that begin at seven places of an array, times taps (7,), to
    out from place ``at`` on; as many vectors as out has room for.
    """
    s, t, u, v = splat(taps[0]), splat(taps[1]), splat(taps[2]), splat(taps[3])
    w, y, z = splat(taps[4]), splat(taps[5]), splat(taps[6])
    a, b, c, d = starts[0], starts[1], starts[2], starts[3]
    e, f, g = starts[4], starts[5], starts[6]
    for x in range(0, out.size - at - LANES + 1, LANES):
        one = s * load(values, a + x) + t * load(values, b + x)
        two = u * load(values, c + x) + v * load(values, d + x)
        three = w * load(values, e + x) + y * load(values, f + x)
        store(out, at + x, (one + two) + (three + z * load(values, g + x)))


@njit(nogil=True, error_model="numpy")
def _blur(image, taps, out):
    """One image through a kernel (7,) along both axes, its border extended."""
    rows, cols = image.shape
    wide = multiple(cols, LANES)
    lines, row = np.zeros((7, wide), np.float32), np.empty(wide, np.float32)
    line, starts, steps = np.zeros(wide + 6, np.float32), np.empty(7, np.int64), np.arange(7)
    for r in range(-6, rows):
        source, newest = image[min(max(r + 3, 0), rows - 1)], lines[(r + 6) % 7]
        for c in range(cols):
            newest[c] = source[c]
        if r < 0:
            continue
        for k in range(7):
            starts[k] = (r + k) % 7 * wide
        _seven(lines.ravel(), starts, taps, line[: wide + 3], 3)
        for x in range(3):
            line[x], line[cols + 3 + x] = line[3], line[cols + 2]
        _seven(line, steps, taps, row, 0)
        target = out[r]
        for x in range(cols):
            target[x] = row[x]


@njit(nogil=True, error_model="numpy", parallel=True)
def blurred(stack, taps, out):
    """Write images (k, rows, cols) through a kernel (7,) along both axes, their borders extended,
    into out; images that are 0 everywhere stay so.
    """
    done = 0
    for k in prange(stack.shape[0]):
        done += 1
        some = False
        for r in range(stack.shape[1]):
            for c in range(stack.shape[2]):
                some = some or stack[k, r, c] != 0.0
        if some:
            _blur(stack[k], taps, out[k])
        else:
            out[k] = 0.0
    all_done(done, stack.shape[0])


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _light(row):
    """Number of lit (above 0) values of a row (n,), and their sum: NaN where a value is missing."""
    count, total = np.int32(0), np.float32(0.0)
    for x in range(row.size):
        value = row[x]
        count += np.int32(value > np.float32(0.0))
        total += value if value > np.float32(0.0) else np.float32(0.0) * value  # NaN and inf stay
    return count, total


@njit(nogil=True, error_model="numpy", parallel=True)
def light(patches, share, level):
    """Write the share of each patch's nodes (n, p, p) that are lit (above 0) into share (n,), and
    their mean into level (n,): NaN where a node is missing or none is lit.
    """
    done = 0
    for n in prange(patches.shape[0]):
        done += 1
        count, total = 0, 0.0
        for i in range(patches.shape[1]):
            lit, brightness = _light(patches[n, i])
            count += lit
            total += brightness
        share[n] = count / (patches.shape[1] * patches.shape[2])
        level[n] = math.nan if count == 0 or not math.isfinite(total) else total / count
    all_done(done, patches.shape[0])


@njit(nogil=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _gradients(above, row, below, step, sums):
    """Add the squares and the product of the gradients at a row's nodes to sums (3,): xx, yy, xy."""
    n = row.size
    xx = yy = xy = np.float32(0.0)
    left, middle, right = row[: n - 2], row[1 : n - 1], row[2:]
    high, low = above[1 : n - 1], below[1 : n - 1]
    for k in range(middle.size):
        x, y = np.float32(0.5) * (right[k] - left[k]), step * (low[k] - high[k])
        xx += x * x
        yy += y * y
        xy += x * y
    for k, x in ((0, row[1] - row[0]), (n - 1, row[n - 1] - row[n - 2])):
        y = step * (below[k] - above[k])
        xx += x * x
        yy += y * y
        xy += x * y
    sums[0] += xx
    sums[1] += yy
    sums[2] += xy


@njit(nogil=True, error_model="numpy", parallel=True)
def harris(patches, level, weight, out):
    """Write det M - weight trace(M)^2 of each patch (n, p, p), divided by its level (n,), over the
    squared number of nodes, into out (n,); M from central differences, one-sided at the border. NaN
    where the level is.
    """
    high, wide = patches.shape[1], patches.shape[2]
    done = 0
    for n in prange(patches.shape[0]):
        done += 1
        image, sums = patches[n], np.zeros(3)
        for i in range(high):
            up, down = max(i - 1, 0), min(i + 1, high - 1)
            _gradients(image[up], image[i], image[down], np.float32(1.0 / (down - up)), sums)
        xx, yy, xy = sums
        scale = (level[n] * level[n]) ** 2 * np.float64(high * wide) ** 2
        out[n] = (xx * yy - xy * xy - weight * (xx + yy) ** 2) / scale
    all_done(done, patches.shape[0])


@njit(nogil=True, error_model="numpy", parallel=True)
def halved(stack, out):
    """Write the means of 2 x 2 pixels of images (k, rows, cols) into out (k, rows // 2, cols // 2)."""
    done = 0
    for k in prange(stack.shape[0]):
        done += 1
        for r in range(out.shape[1]):
            one, other, line = stack[k, 2 * r], stack[k, 2 * r + 1], out[k, r]
            for c in range(line.size):
                line[c] = np.float32(0.25) * (
                    (one[2 * c] + other[2 * c]) + (one[2 * c + 1] + other[2 * c + 1])
                )
    all_done(done, stack.shape[0])
