"""Maxima of a correlation map."""

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def _above_rows(score, y, x, here):
    """True if no neighbour in the rows above and below is higher."""
    ny, nx = score.shape
    for i in (y - 1, y + 1):
        if 0 <= i < ny:
            for j in range(max(0, x - 1), min(nx, x + 2)):
                if score[i, j] > here:
                    return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def maxima(score, lowest, row, col, exclusion, places, heights):
    """Insert the highest maxima (3 x 3) of a map above ``lowest`` into places (k, 2; row and
    column) and heights (k,), best first. Return their number. Places within ``exclusion``
    (negative: none) of (row, col) are left out.
    """
    ny, nx = score.shape
    found, size = 0, heights.size
    near = exclusion * exclusion if exclusion >= 0.0 else -1.0
    for y in range(ny):
        for x in range(nx):
            here = score[y, x]
            if here <= lowest or (found == size and here <= heights[size - 1]):
                continue
            if (x > 0 and score[y, x - 1] > here) or (x + 1 < nx and score[y, x + 1] > here):
                continue
            if not _above_rows(score, y, x, here):
                continue
            if (y - row) ** 2 + (x - col) ** 2 <= near:
                continue
            k = min(found, size - 1)
            while k > 0 and heights[k - 1] < here:
                heights[k], places[k, 0], places[k, 1] = (
                    heights[k - 1],
                    places[k - 1, 0],
                    places[k - 1, 1],
                )
                k -= 1
            heights[k], places[k, 0], places[k, 1] = here, y, x
            found = min(found + 1, size)
    return found
