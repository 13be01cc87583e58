"""Camera rays in tiles: the max pyramid is read once for all rays of a tile, and each ray starts
near the terrain that it meets.

All rays start at one point. The descending rays of a tile are bounded by a cone: ranges of the
cells east and south that they move per metre of descent. At a height h the rays lie in the cone's
rectangle, and between two heights in the box around both rectangles. If no node of a cell that the
box touches is higher than its lower end, no ray of the tile meets the surface in between; if the
highest node is M, none does above M. One read of the max pyramid thus lowers the height down to
which the tile is clear (`_clear_height`): first for a block of tiles, then for each tile. The
result is valid for any rays and efficient for neighbouring ones: nothing is assumed of the camera,
its roll or its distortion.

Each ray then continues from its cell at that height, cell by cell as if it were alone: first all
rays of a tile together (`joint_walk`), then the remaining ones one by one (`tracing.met`). The start of
a ray does not change the result by a single bit.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done
from .bundles import approach, hit_from, on_grid
from .joint_walk import RAYS, ROWS, start_together, walk_on, walking_ray
from .tracing import PATIENCE, met

TILE = 8
"""A tile of TILE x TILE pixels has RAYS rays."""
TILES = 8
"""Tiles along a block's side."""

LOOKS = 24
"""Greatest number of reads of the pyramid for a block or tile."""

LOOSE = 2048.0
"""Width of a bundle of rays, in cells, above which the pyramid is not read."""

READS = 16
"""Greatest number of values of the pyramid in one read, except on its top level."""

SMALL_CELLS, SMALL = 1e-6, 1e-12
"""Bound of the rounding error of a ray's position: cells, and a share of all lengths that enter it.
"""


@njit(nogil=True, error_model="numpy")
def _cone(directions, gsd, i0, i1, j0, j1):
    """Least and greatest cells east, then south, per metre of fall, of the rays that fall; an empty
    range (inf, -inf) if none falls.
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


@njit(nogil=True, error_model="numpy")
def _highest(pyramid, u0, u1, v0, v1):
    """Upper bound of the highest node of the cells that a box of positions touches; -inf off the
    raster.
    """
    levels, offsets, widths, heights = pyramid
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


@njit(nogil=True, error_model="numpy")
def _clear_height(pyramid, ou, ov, oz, cone, height):
    """Height down to which no terrain lies above any ray of the cone, lowered from one
    (``height``).
    """
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
            pyramid,
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


@njit(nogil=True, error_model="numpy")
def _approach(rows, cols, summit, ou, ov, oz, gsd, directions, i0, i1, j0, j1, queue):
    """Write `approach` of every ray of a tile into queue (11, rays), without branches, so that the
    compiler processes several rays at once.
    """
    k = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            queue[0, k], queue[1, k] = directions[i, j, 0], directions[i, j, 1]
            queue[2, k] = directions[i, j, 2]
            k += 1
    a, b, c, d, e, f = queue[0], queue[1], queue[2], queue[3], queue[4], queue[5]
    g, h, o, m, n = queue[6], queue[7], queue[8], queue[9], queue[10]
    for q in range(k):
        a[q], b[q], c[q], d[q], e[q], f[q], g[q], h[q], o[q], m[q], n[q] = approach(
            rows, cols, summit, ou, ov, oz, a[q], b[q], c[q], gsd
        )


@njit(nogil=True, error_model="numpy")
def _tile_solid(
    z, pyramid, summit, oz, clear, queue, work, found, out, i0, i1, j0, j1,
):  # fmt: skip
    """Trace a tile's rays over a raster without nodata: together for some cells, then the remaining
    rays one by one.
    """
    count = max(i1 - i0, 0) * max(j1 - j0, 0)  # tiles outside the image have no rays
    rows, cols = z.shape
    walking = start_together(float(rows), float(cols), summit, clear, queue, count, work, found)
    for _ in range(PATIENCE):
        if walking == 0:
            break
        walking = walk_on(z, work, walking, found)
    for k in range(walking):
        q, (u, v, height, du, dv, dz, inverse_u, inverse_v, s) = walking_ray(work, k)
        found[q] = met(
            z, False, pyramid, summit, u, v, height, du, dv, dz, inverse_u, inverse_v, s, 0
        )  # fmt: skip
    k = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            met_at = found[k]
            if not math.isnan(met_at):
                out[i, j] = (queue[7, k] + met_at) / queue[6, k] if met_at >= 0.0 else math.nan
            else:
                out[i, j] = hit_from(
                    z, False, pyramid, summit, oz, clear, queue[0, k], queue[1, k], queue[2, k],
                    queue[3, k], queue[4, k], queue[5, k], queue[6, k], queue[7, k],
                    queue[8, k], queue[9, k], queue[10, k],
                )  # fmt: skip
            k += 1


@njit(nogil=True, error_model="numpy")
def _tile_holed(z, pyramid, summit, oz, clear, queue, out, i0, i1, j0, j1):
    """`_tile_solid` for a raster with nodata: a copy, so that the compiler makes a function of
    each.
    """
    k = 0
    for i in range(i0, i1):
        for j in range(j0, j1):
            out[i, j] = hit_from(
                z, True, pyramid, summit, oz, clear, queue[0, k], queue[1, k], queue[2, k],
                queue[3, k], queue[4, k], queue[5, k], queue[6, k], queue[7, k],
                queue[8, k], queue[9, k], queue[10, k],
            )  # fmt: skip
            k += 1


@njit(nogil=True, error_model="numpy")
def _block(
    z,
    holes,
    pyramid,
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
    """Trace a block of TILES x TILES tiles."""
    rows, cols = out.shape
    cones = np.empty((TILES * TILES, 4))
    queue, work, found = np.empty((11, RAYS)), np.empty(ROWS * RAYS), np.empty(RAYS)
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
    useful = pyramid[2].size > 1 and math.isfinite(top)
    common = _clear_height(pyramid, ou, ov, oz, whole, top) if useful else top
    for k in range(TILES * TILES):
        i, j = i0 + k // TILES * tile_rows, j0 + k % TILES * tile_cols
        i1, j1 = min(i + tile_rows, rows), min(j + tile_cols, cols)
        if oz > summit and cones[k, 0] > cones[k, 1]:  # none falls: none meets terrain
            out[i:i1, j:j1] = math.nan
            continue
        clear = math.inf
        if useful and cones[k, 0] <= cones[k, 1]:
            clear = _clear_height(
                pyramid,
                ou,
                ov,
                oz,
                (cones[k, 0], cones[k, 1], cones[k, 2], cones[k, 3]),
                common,
            )
            clear += SMALL_CELLS + SMALL * (abs(oz) + abs(clear))
        _approach(*z.shape, summit, ou, ov, oz, gsd, directions, i, i1, j, j1, queue)
        if holes:
            _tile_holed(z, pyramid, summit, oz, clear, queue, out, i, i1, j, j1)
        else:
            _tile_solid(
                z, pyramid, summit, oz, clear, queue, work, found, out, i, i1, j, j1,
            )  # fmt: skip


@njit(nogil=True, error_model="numpy", parallel=True)
def first_hits(z, holes, pyramid, summit, ou, ov, oz, gsd, directions, out):
    """Write the first hits of rays along ENU directions (rows, cols, 3) from one point into out
    (rows, cols): `bundles.first_hits`, faster if neighbours in the array have similar directions.
    """
    ou, ov = on_grid(ou, ov)
    rows, cols = out.shape
    tile_rows = min(TILE, rows)
    tile_cols = TILE * TILE // tile_rows
    down, across = tile_rows * TILES, tile_cols * TILES
    blocks_across = (cols + across - 1) // across
    blocks = (rows + down - 1) // down * blocks_across
    done = 0
    for block in prange(blocks):
        done += 1
        i0, j0 = block // blocks_across * down, block % blocks_across * across
        _block(
            z, holes, pyramid, summit, ou, ov, oz, gsd, directions, out, i0, j0, tile_rows, tile_cols
        )  # fmt: skip
    all_done(done, blocks)
