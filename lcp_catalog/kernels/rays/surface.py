"""The triangulated surface of a heightfield: existence of its parts, heights and normals.

Each cell (i, j) has an upper triangle (i, j), (i, j+1), (i+1, j+1) and a lower one (i, j), (i+1,
j), (i+1, j+1); a triangle exists when its three nodes have heights. Positions are in cell units: u
= column, v = row.

Heights are converted by np.float64 before any arithmetic: numba's float() leaves a float32 as it
is.
"""

import math

import numpy as np
from numba import prange

from ..cache import njit
from ..completion import all_done

SNAP = 1e-10
"""Distance from a node, in cells, within which a crossing is one of the node, on a surface with
holes.
"""


@njit(nogil=True, error_model="numpy")
def triangle_exists(z, i, j, upper):
    """True if cell (i, j) is inside the raster and its upper (or lower) triangle has all three
    heights.
    """
    if i < 0 or j < 0 or i >= z.shape[0] - 1 or j >= z.shape[1] - 1:
        return False
    third = z[i, j + 1] if upper else z[i + 1, j]
    return not (math.isnan(z[i, j]) or math.isnan(z[i + 1, j + 1]) or math.isnan(third))


@njit(nogil=True, error_model="numpy")
def node_exists(z, i, j):
    """True if any of the six triangles around a node exists."""
    return (
        triangle_exists(z, i, j, True)
        or triangle_exists(z, i, j, False)
        or triangle_exists(z, i - 1, j - 1, True)
        or triangle_exists(z, i - 1, j - 1, False)
        or triangle_exists(z, i, j - 1, True)
        or triangle_exists(z, i - 1, j, False)
    )


@njit(nogil=True, error_model="numpy")
def edge_exists(z, i, j, i2, j2):
    """True if the edge from (i, j) to its east, south or south-east neighbour (i2, j2) belongs to a
    triangle on either side.
    """
    if i2 == i:
        return triangle_exists(z, i, j, True) or triangle_exists(z, i - 1, j, False)
    if j2 == j:
        return triangle_exists(z, i, j, False) or triangle_exists(z, i, j - 1, True)
    return triangle_exists(z, i, j, True) or triangle_exists(z, i, j, False)


@njit(nogil=True, error_model="numpy", inline="always")
def edge_height(z, i, j, i2, j2, f):
    """Height of an edge at the share f of its length, float64."""
    start, end = np.float64(z[i, j]), np.float64(z[i2, j2])
    return (
        start + (end - start) * f if f < 1.0 else end
    )  # exact at both ends, and along a level edge


@njit(nogil=True, error_model="numpy")
def edge_height_careful(z, i, j, i2, j2, f):
    """`edge_height` where nodes may be missing: NaN unless the edge exists, or the node at which
    the crossing lies.
    """
    if f <= SNAP:
        return np.float64(z[i, j]) if node_exists(z, i, j) else math.nan
    if f >= 1.0 - SNAP:
        return np.float64(z[i2, j2]) if node_exists(z, i2, j2) else math.nan
    if not edge_exists(z, i, j, i2, j2):
        return math.nan
    return edge_height(z, i, j, i2, j2, f)


@njit(nogil=True, error_model="numpy", inline="always")
def facet_height(z, i, j, x, y):
    """Height in cell (i, j) at x, y in 0..1 from its north-west corner; NaN if a node of the facet
    is missing.
    """
    z00, z11 = np.float64(z[i, j]), np.float64(z[i + 1, j + 1])
    if x >= y:
        z01 = np.float64(z[i, j + 1])
        return z00 + (z01 - z00) * x + (z11 - z01) * y
    z10 = np.float64(z[i + 1, j])
    return z00 + (z10 - z00) * y + (z11 - z10) * x


@njit(nogil=True, error_model="numpy")
def surface_height(z, u, v):
    """Height of the surface at (u, v), float64; NaN outside the raster and where no triangle
    exists.

    Edges and nodes belong to every triangle around them, so that a point on the rim of a hole has a
    height.
    """
    rows, cols = z.shape
    if not (rows > 1 and cols > 1 and 0.0 <= u <= cols - 1 and 0.0 <= v <= rows - 1):
        return math.nan
    j, i = min(int(u), cols - 2), min(int(v), rows - 2)
    x, y = u - j, v - i
    if x == y:
        return edge_height_careful(z, i, j, i + 1, j + 1, x)
    if y == 0.0 or y == 1.0:  # noqa: PLR1714  (numba: no set of floats)
        return edge_height_careful(z, i + int(y), j, i + int(y), j + 1, x)
    if x == 0.0 or x == 1.0:  # noqa: PLR1714
        return edge_height_careful(z, i, j + int(x), i + 1, j + int(x), y)
    return facet_height(z, i, j, x, y)


@njit(nogil=True, error_model="numpy")
def stretch_exists(z, i, j, x, y):
    """True if the stretch of a ray whose middle lies at (x, y) in cell (i, j) runs over, or along
    the edge of, an existing triangle.
    """
    if abs(x - y) <= SNAP:
        return edge_exists(z, i, j, i + 1, j + 1)
    if y <= SNAP:
        return edge_exists(z, i, j, i, j + 1)
    if y >= 1.0 - SNAP:
        return edge_exists(z, i + 1, j, i + 1, j + 1)
    if x <= SNAP:
        return edge_exists(z, i, j, i + 1, j)
    if x >= 1.0 - SNAP:
        return edge_exists(z, i, j + 1, i + 1, j + 1)
    return triangle_exists(z, i, j, x > y)


@njit(nogil=True, error_model="numpy")
def stretch_height(z, i, j, x, y, mid_x, mid_y):  # noqa: PLR0911
    """Height at (x, y), the end of a stretch, on the triangle or edge at its middle (mid_x, mid_y);
    along an edge only edge heights are used.
    """
    if abs(mid_x - mid_y) <= SNAP:
        return edge_height(z, i, j, i + 1, j + 1, x)
    if mid_y <= SNAP:
        return edge_height(z, i, j, i, j + 1, x)
    if mid_y >= 1.0 - SNAP:
        return edge_height(z, i + 1, j, i + 1, j + 1, x)
    if mid_x <= SNAP:
        return edge_height(z, i, j, i + 1, j, y)
    if mid_x >= 1.0 - SNAP:
        return edge_height(z, i, j + 1, i + 1, j + 1, y)
    z00, z11 = np.float64(z[i, j]), np.float64(z[i + 1, j + 1])
    if mid_x > mid_y:
        z01 = np.float64(z[i, j + 1])
        return z00 + (z01 - z00) * x + (z11 - z01) * y
    z10 = np.float64(z[i + 1, j])
    return z00 + (z10 - z00) * y + (z11 - z10) * x


@njit(nogil=True, error_model="numpy", parallel=True)
def existing_nodes(z, window, out):
    """Write True into out for nodes of a window that belong to an existing triangle."""
    row0, row1, col0, col1 = window
    done = 0
    for k in prange(row1 - row0):
        done += 1
        for j in range(col0, col1):
            out[k, j - col0] = not math.isnan(z[row0 + k, j]) and node_exists(z, row0 + k, j)
    all_done(done, row1 - row0)


@njit(nogil=True, error_model="numpy", parallel=True)
def heights_at(z, u, v):
    """Surface heights, float64 (n,), at positions (n,)."""
    out = np.empty(u.size)
    done = 0
    for k in prange(u.size):
        done += 1
        out[k] = surface_height(z, u[k], v[k])
    all_done(done, u.size)
    return out


@njit(nogil=True, error_model="numpy", inline="always")
def _slope(before, here, after):
    """Rise per cell from central differences, one-sided where a neighbour is missing, NaN where
    both are.
    """
    if math.isnan(before):
        return after - here
    if math.isnan(after):
        return here - before
    return 0.5 * (after - before)


@njit(nogil=True, error_model="numpy")
def node_normal(z, gsd, i, j):
    """Unit ENU normal of a node; NaN where the node has no height, or no neighbour on an axis."""
    rows, cols = z.shape
    here = np.float64(z[i, j])
    west = np.float64(z[i, j - 1]) if j > 0 else math.nan
    east = np.float64(z[i, j + 1]) if j < cols - 1 else math.nan
    north = np.float64(z[i - 1, j]) if i > 0 else math.nan
    south = np.float64(z[i + 1, j]) if i < rows - 1 else math.nan
    x = -_slope(west, here, east) / gsd + 0.0 * here  # NaN at a node without a height
    y = -_slope(south, here, north) / gsd + 0.0 * here
    inverse = 1.0 / math.sqrt(x * x + y * y + 1.0)
    return x * inverse, y * inverse, inverse


@njit(nogil=True, error_model="numpy", parallel=True)
def normals(z, gsd, row0, col0, out):
    """Write the node normals of the window at (row0, col0) into out (rows, cols, 3) float32."""
    done = 0
    for i in prange(out.shape[0]):
        done += 1
        for j in range(out.shape[1]):
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = node_normal(z, gsd, row0 + i, col0 + j)
    all_done(done, out.shape[0])


@njit(nogil=True, error_model="numpy")
def _add_normal(z, gsd, i, j, weight, out):
    if weight != 0.0:  # a node of weight 0 may be missing
        x, y, up = node_normal(z, gsd, i, j)
        out[0] += weight * x
        out[1] += weight * y
        out[2] += weight * up


@njit(nogil=True, error_model="numpy", parallel=True)
def normals_at(z, gsd, u, v):
    """Node normals interpolated over the triangle at each position and normalised, float64 (n, 3);
    NaN without a surface.
    """
    rows, cols = z.shape
    out = np.full((u.size, 3), np.nan)
    done = 0
    for k in prange(u.size):
        done += 1
        if not math.isnan(surface_height(z, u[k], v[k])):
            j, i = min(int(u[k]), cols - 2), min(int(v[k]), rows - 2)
            x, y = u[k] - j, v[k] - i
            out[k] = 0.0
            _add_normal(z, gsd, i, j, 1.0 - max(x, y), out[k])
            _add_normal(z, gsd, i + 1, j + 1, min(x, y), out[k])
            if x > y:
                _add_normal(z, gsd, i, j + 1, x - y, out[k])
            else:
                _add_normal(z, gsd, i + 1, j, y - x, out[k])
            out[k] /= math.sqrt(out[k, 0] ** 2 + out[k, 1] ** 2 + out[k, 2] ** 2)
    all_done(done, u.size)
    return out
