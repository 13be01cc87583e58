"""Camera rays in tiles: what a tile's rays have in common is looked up once, and each ray starts near
the terrain that it meets.

All rays leave one point. Those of a tile that go down are held in a cone: ranges of the cells east
and south that they go per metre of fall. At a height h the tile's rays lie in the rectangle that
the cone has there, and between two heights in the box around the rectangles of both. If no node of
any cell that the box touches is higher than its lower end, no ray of the tile meets anything in
between; if the highest is M, none does above M. So one look into the max pyramid moves the height
down to which the tile is clear (`_clear_height`): first for a block of tiles, then on from there
for each tile. Rays of a tile need not be neighbours for this to hold, only for it to help: nothing
is assumed of the camera, its roll or its distortion.

Each ray is then traced as if it were alone (`rays.hit_from`), from the cell it is in at that
height: skipping changes no bit.
"""

import math

import numpy as np
from numba import njit, prange

from .rays import approach, hit_from, on_grid

TILE = 8
TILES = 8
"""Tiles along a block's side."""

LOOKS = 24
"""Looks for a block or tile at most."""

LOOSE = 2048.0
"""A bundle of rays wider than this (in cells) is not worth a look."""

READS = 16
"""Values of the pyramid that one look reads at most, but on its top level."""

SMALL_CELLS, SMALL = 1e-6, 1e-12
"""What rounding may move a ray by: cells, and a share of all the lengths that go into its place."""


@njit(cache=True, nogil=True, error_model="numpy")
def _cone(directions, gsd, i0, i1, j0, j1):
    """Least and greatest cells east, then south, per metre of fall, of the rays that fall; an empty
    range (inf, -inf) when none does.
    """
    a0, a1, b0, b1 = math.inf, -math.inf, math.inf, -math.inf
    for i in range(i0, i1):
        for j in range(j0, j1):
            east, north, up = directions[i, j, 0], directions[i, j, 1], directions[i, j, 2]
            if up < 0.0 and math.isfinite(east + north + up):
                inverse = -1.0 / (up * gsd)
                a, b = east * inverse, -north * inverse
                a0, a1 = min(a0, a), max(a1, a)
                b0, b1 = min(b0, b), max(b1, b)
    return a0, a1, b0, b1


@njit(cache=True, nogil=True, error_model="numpy")
def _highest(levels, offsets, widths, heights, u0, u1, v0, v1):
    """Highest node of the cells that a box of positions touches, or of some more; -inf off the
    raster.
    """
    if u1 < 0.0 or v1 < 0.0 or u0 > widths[0] or v0 > heights[0]:
        return -math.inf
    c0, c1 = int(max(u0, 0.0)), int(min(u1, widths[0] - 1.0))
    r0, r1 = int(max(v0, 0.0)), int(min(v1, heights[0] - 1.0))
    c0, r0 = min(c0, c1), min(r0, r1)
    level, top = 1, widths.size - 1
    while (
        level < top
        and ((c1 >> level) - (c0 >> level) + 1) * ((r1 >> level) - (r0 >> level) + 1) > READS
    ):
        level += 1
    found = np.float32(-math.inf)
    for r in range(r0 >> level, (r1 >> level) + 1):
        start = offsets[level] + r * widths[level]
        for c in range(start + (c0 >> level), start + (c1 >> level) + 1):
            found = max(found, levels[c])
    return np.float64(found)


@njit(cache=True, nogil=True, error_model="numpy")
def _clear_height(levels, offsets, widths, heights, ou, ov, oz, cone, height):
    """A height down to which no terrain lies above any ray of the cone, given one (``height``)."""
    a0, a1, b0, b1 = cone
    reach = max(abs(a0), abs(a1), abs(b0), abs(b1))
    spread = max(a1 - a0, b1 - b0)
    if not spread * (oz - height) < LOOSE:
        return height
    step = (spread * (oz - height) + 2.0) / (reach + 1e-9)
    fails = 0
    for _ in range(LOOKS):
        near, far = oz - height, oz - height + step
        slack = SMALL_CELLS + SMALL * (abs(ou) + abs(ov) + reach * (abs(oz) + abs(height) + step))
        highest = _highest(
            levels,
            offsets,
            widths,
            heights,
            ou + min(a0 * near, a0 * far) - slack,
            ou + max(a1 * near, a1 * far) + slack,
            ov + min(b0 * near, b0 * far) - slack,
            ov + max(b1 * near, b1 * far) + slack,
        )
        below = height - step
        if highest < height:
            height = max(highest, below)
        else:
            fails += 1
        if highest <= below:
            step *= 2.0
        else:
            step *= 0.5
        if fails > 1:
            break
    return height


@njit(cache=True, nogil=True, error_model="numpy")
def _approach(z, summit, ou, ov, oz, gsd, directions, i0, i1, j0, j1, queue):
    """`approach` of every ray of a tile into queue (rays, 8): divisions of many rays overlap, which
    they do not where each waits for the last one's traversal.
    """
    rows, cols = z.shape
    k = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            east, north, up = directions[i, j, 0], directions[i, j, 1], directions[i, j, 2]
            ray = approach(rows, cols, summit, ou, ov, oz, east, north, up, gsd)
            queue[k, 0], queue[k, 1], queue[k, 2], queue[k, 3] = ray[0], ray[1], ray[2], ray[3]
            queue[k, 4], queue[k, 5], queue[k, 6], queue[k, 7] = ray[4], ray[5], ray[6], ray[7]
            k += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _tile_solid(z, levels, offsets, widths, heights, summit, oz, clear, queue, out, i0, i1, j0, j1):
    """Trace a tile's rays over a raster without nodata."""
    k = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            out[i, j] = hit_from(
                z, False, levels, offsets, widths, heights, summit, oz, clear, queue[k, 0], queue[k, 1], queue[k, 2],
                queue[k, 3], queue[k, 4], queue[k, 5], queue[k, 6], queue[k, 7],
            )  # fmt: skip
            k += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _tile_holed(z, levels, offsets, widths, heights, summit, oz, clear, queue, out, i0, i1, j0, j1):
    """The same over one with nodata: a copy, so that the compiler makes a function of each."""
    k = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            out[i, j] = hit_from(
                z, True, levels, offsets, widths, heights, summit, oz, clear, queue[k, 0], queue[k, 1], queue[k, 2],
                queue[k, 3], queue[k, 4], queue[k, 5], queue[k, 6], queue[k, 7],
            )  # fmt: skip
            k += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _block(
    z,
    holes,
    levels,
    offsets,
    widths,
    heights,
    summit,
    ou,
    ov,
    oz,
    gsd,
    directions,
    out,
    i0,
    j0,
    tile_rows,
    tile_cols,
):
    """A block of TILES x TILES tiles."""
    rows, cols = out.shape
    cones = np.empty((TILES * TILES, 4))
    queue = np.empty((TILE * TILE, 8))
    whole = (math.inf, -math.inf, math.inf, -math.inf)
    for k in range(TILES * TILES):
        i, j = i0 + k // TILES * tile_rows, j0 + k % TILES * tile_cols
        cone = _cone(directions, gsd, i, min(i + tile_rows, rows), j, min(j + tile_cols, cols))
        cones[k, 0], cones[k, 1], cones[k, 2], cones[k, 3] = cone
        whole = (
            min(whole[0], cone[0]), max(whole[1], cone[1]),
            min(whole[2], cone[2]), max(whole[3], cone[3]),
        )  # fmt: skip
    top = min(oz, summit)
    useful = widths.size > 1 and math.isfinite(top)
    common = (
        _clear_height(levels, offsets, widths, heights, ou, ov, oz, whole, top) if useful else top
    )
    for k in range(TILES * TILES):
        i, j = i0 + k // TILES * tile_rows, j0 + k % TILES * tile_cols
        clear = math.inf
        if useful and cones[k, 0] <= cones[k, 1]:
            clear = _clear_height(
                levels,
                offsets,
                widths,
                heights,
                ou,
                ov,
                oz,
                (cones[k, 0], cones[k, 1], cones[k, 2], cones[k, 3]),
                common,
            )
            clear += SMALL_CELLS + SMALL * (abs(oz) + abs(clear))
        i1, j1 = min(i + tile_rows, rows), min(j + tile_cols, cols)
        _approach(z, summit, ou, ov, oz, gsd, directions, i, i1, j, j1, queue)
        if holes:
            _tile_holed(
                z, levels, offsets, widths, heights, summit, oz, clear, queue, out, i, i1, j, j1
            )
        else:
            _tile_solid(
                z, levels, offsets, widths, heights, summit, oz, clear, queue, out, i, i1, j, j1
            )


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def first_hits(z, holes, pyramid, summit, ou, ov, oz, gsd, directions, out):
    """First hits of rays along ENU directions (rows, cols, 3) that leave one point, into out (rows,
    cols): `rays.first_hits`, faster where neighbours in the array are neighbours in the sky.
    """
    levels, offsets, widths, heights = pyramid
    ou, ov = on_grid(ou, ov)
    rows, cols = out.shape
    tile_rows = min(TILE, rows)
    tile_cols = TILE * TILE // tile_rows
    down, across = tile_rows * TILES, tile_cols * TILES
    blocks_across = (cols + across - 1) // across
    blocks = (rows + down - 1) // down * blocks_across
    for block in prange(blocks):
        i0, j0 = block // blocks_across * down, block % blocks_across * across
        _block(
            z, holes, levels, offsets, widths, heights, summit, ou, ov, oz, gsd, directions, out, i0, j0, tile_rows, tile_cols
        )  # fmt: skip
