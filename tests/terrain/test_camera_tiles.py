"""Camera rays in tiles against each ray by itself: the same bits for any terrain, camera and order
of the rays.

Single rays are checked in test_heightfield_occluded.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.synthetic import cratered
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.arrays import Array
from lcp_catalog.kernels.rays import bundles, camera_tiles
from lcp_catalog.terrain.heightfield import Heightfield

X0, Y0, GSD = 120.0, -70.0, 10.0
KINDS = ("smooth", "rough", "spikes", "pits", "steps", "flat", "sloping")


def alone(field: Heightfield, origin: Array, directions: Array) -> Array:
    """Each ray by itself."""
    out = np.full(directions.shape[:-1], np.nan)
    flat = np.ascontiguousarray(directions, dtype=np.float64).reshape(-1, 3)
    bundles.first_hits(
        *field.traced, *field._node_units(origin), field.gsd_m, flat, out.reshape(-1)
    )
    return out


def same(field: Heightfield, origin: Array, directions: Array) -> Array:
    got = field.first_hits(origin, directions)
    assert got.shape == directions.shape[:-1]
    np.testing.assert_array_equal(got, alone(field, origin, directions))
    return got


def terrain(rng: np.random.Generator, kind: str, holes: bool) -> Heightfield:
    rows, cols = (int(n) for n in rng.integers(2, 90, 2))
    i, j = np.mgrid[:rows, :cols]
    z = {
        "smooth": 40.0 * np.sin(i / 7.0) * np.cos(j / 5.0),
        "rough": rng.normal(0.0, 15.0, (rows, cols)),
        "spikes": 300.0 * (rng.random((rows, cols)) < 0.01) + rng.normal(0.0, 1.0, (rows, cols)),
        "pits": -300.0 * (rng.random((rows, cols)) < 0.05) + 0.1 * i,
        "steps": 50.0 * np.floor((i + j) / 13.0),
        "flat": np.zeros((rows, cols)),
        "sloping": 7.0 * i - 3.0 * j,
    }[kind]
    if holes:
        z[rng.random((rows, cols)) < rng.choice([0.002, 0.05, 0.4])] = np.nan
        a, b = rng.integers(0, rows), rng.integers(0, cols)
        z[a : a + 12, b : b + 9] = np.nan
    return Heightfield(z.astype(np.float32), GSD, X0, Y0)


def somewhere(rng: np.random.Generator, field: Heightfield) -> Array:
    """A camera far above, near, inside the relief, off the raster, on a node, or at any of them."""
    rows, cols = field.shape
    u, v = rng.uniform(-0.2, 1.2) * (cols - 1), rng.uniform(-0.2, 1.2) * (rows - 1)
    if rng.random() < 0.2:
        u, v = float(round(u)), float(round(v))
    where = rng.integers(4)
    if where == 0:
        height = 10.0 ** rng.uniform(2.0, 6.0)
    elif where == 1:
        height = rng.uniform(0.0, 400.0)
    else:
        ground = float(field.heights_at(X0 + u * GSD, Y0 - v * GSD))
        height = (0.0 if np.isnan(ground) else ground) + rng.choice([0.0, 0.5, 20.0, -1.0])
    return np.array([X0 + u * GSD, Y0 - v * GSD, height])


def image(rng: np.random.Generator, field: Heightfield, origin: Array) -> Array:
    """Rays (rows, cols, 3) of a camera with any roll, field of view and distortion, towards the
    terrain or anywhere, of any length.
    """
    rows, cols = (int(n) for n in rng.choice([1, 2, 7, 8, 9, 31, 64, 65, 77], 2))
    target = np.array(
        [
            X0 + rng.random() * (field.shape[1] - 1) * GSD,
            Y0 - rng.random() * (field.shape[0] - 1) * GSD,
            rng.uniform(-20.0, 60.0),
        ]
    )
    axis = target - origin if rng.random() < 0.8 else rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    right = np.cross(axis, rng.normal(size=3))
    right /= np.linalg.norm(right)
    opening = 10.0 ** rng.uniform(-4.0, 0.3)
    y, x = np.meshgrid(
        np.linspace(-opening, opening, rows), np.linspace(-opening, opening, cols), indexing="ij"
    )
    bent = 1.0 + rng.choice([0.0, -0.3, 0.5]) * (x * x + y * y) / opening**2
    directions = (
        axis + (x * bent)[..., None] * right + (y * bent)[..., None] * np.cross(axis, right)
    )
    return directions * 10.0 ** rng.uniform(-3.0, 3.0)


seeds = st.integers(0, 2**32 - 1)


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(seed=seeds, kind=st.sampled_from(KINDS), holes=st.booleans())
def test_any_camera_over_any_terrain(seed: int, kind: str, holes: bool) -> None:
    rng = np.random.default_rng(seed)
    field = terrain(rng, kind, holes)
    origin = somewhere(rng, field)
    same(field, origin, image(rng, field, origin))


@settings(max_examples=30, deadline=None)
@given(seed=seeds, kind=st.sampled_from(KINDS), holes=st.booleans())
def test_rays_through_nodes_and_along_grid_lines(seed: int, kind: str, holes: bool) -> None:
    rng = np.random.default_rng(seed)
    field = terrain(rng, kind, holes)
    i, j = np.mgrid[: field.shape[0], : field.shape[1]]
    k = (int(rng.integers(n)) for n in field.shape)
    aims = np.stack([X0 + j * GSD, Y0 - i * GSD, np.nan_to_num(field.z_m)], -1)
    origin = aims[tuple(k)] + [0.0, 0.0, rng.choice([1.0, 64.0, 1024.0])]
    same(field, origin, aims - origin)


@settings(max_examples=20, deadline=None)
@given(seed=seeds, kind=st.sampled_from(KINDS))
def test_the_order_and_the_shape_of_the_rays_do_not_matter(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    field = terrain(rng, kind, False)
    origin = somewhere(rng, field)
    directions = image(rng, field, origin)
    want = same(field, origin, directions)
    flat = directions.reshape(-1, 3)
    order = rng.permutation(len(flat))
    np.testing.assert_array_equal(field.first_hits(origin, flat), want.ravel())
    np.testing.assert_array_equal(field.first_hits(origin, flat[order]), want.ravel()[order])
    np.testing.assert_array_equal(field.first_hits(origin, directions[None]), want[None])
    np.testing.assert_array_equal(
        field.first_hits(origin, np.asfortranarray(directions)[::-1]), want[::-1]
    )
    assert field.first_hits(origin, flat[0]) == want.flat[0] or np.isnan(want.flat[0])


def test_rays_that_are_none_and_vertical_ones_leave_their_tile_alone() -> None:
    field = Heightfield(cratered(80, GSD), GSD, X0, Y0)
    origin = np.array([X0 + 333.0, Y0 - 402.0, 2000.0])
    rng = np.random.default_rng(5)
    directions = rng.normal(0.0, 0.1, (40, 40, 3)) - [0.0, 0.0, 1.0]
    clean = same(field, origin, directions)
    assert np.isfinite(clean).mean() > 0.5
    strange = directions.copy()
    strange[3, 3] = np.nan
    strange[4, 3, 0] = np.nan
    strange[5, 3, 1] = np.inf
    strange[6, 3] = 0.0
    strange[9, 9] = [0.0, 0.0, -2.0]
    strange[9, 10] = [0.0, 0.0, 2.0]
    strange[20, 20] = [1.0, 0.0, 0.0]
    strange[21, 20, 2] = -np.inf
    got = same(field, origin, strange)
    assert np.isnan(got[3:7, 3]).all()
    assert np.isnan([got[9, 10], got[21, 20]]).all()
    ground = field.heights_at(origin[0], origin[1])
    assert got[9, 9] == pytest.approx((2000.0 - ground) / 2.0, abs=1e-9)
    kept = (strange == directions).all(-1)
    np.testing.assert_array_equal(got[kept], clean[kept])


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (2, 1), (2, 2), (2, 3), (3, 2), (5, 40)])
def test_small_rasters(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    field = Heightfield(rng.normal(0.0, 3.0, shape).astype(np.float32), GSD, X0, Y0)
    origin = np.array([X0 + 3.0, Y0 - 4.0, 50.0])
    directions = rng.normal(0.0, 0.3, (20, 20, 3)) - [0.0, 0.0, 1.0]
    if field.is_surface:
        assert np.isfinite(same(field, origin, directions)).any()
    else:
        assert np.isnan(field.first_hits(origin, directions)).all()


@pytest.mark.parametrize("shape", [(0, 3), (0, 5, 3), (4, 0, 3)])
def test_no_rays(shape: tuple[int, ...]) -> None:
    field = Heightfield(np.zeros((5, 5), np.float32), GSD)
    assert field.first_hits([0.0, 0.0, 5.0], np.zeros(shape)).shape == shape[:-1]


@settings(max_examples=100, deadline=None)
@given(seed=seeds, kind=st.sampled_from(KINDS), holes=st.booleans())
def test_no_terrain_lies_above_a_clear_height(seed: int, kind: str, holes: bool) -> None:
    """Checked with the nodes beside the rays at many heights, without the pyramid."""
    rng = np.random.default_rng(seed)
    field = terrain(rng, kind, holes)
    u, v = rng.uniform(-5.0, 95.0, 2)
    oz = 400.0 + 10.0 ** rng.uniform(0.0, 4.0)
    a, b = np.sort(rng.normal(0.0, 0.3, (2, 1)) + rng.uniform(0.0, 0.02, (2, 2)), axis=1)
    z, _, levels, summit = field.traced
    if not np.isfinite(summit) or levels[2].size == 1:
        return
    top = min(oz, float(summit))
    clear = camera_tiles._clear_height(levels, u, v, oz, (a[0], a[1], b[0], b[1]), top)
    assert clear <= top
    high = np.where(np.isnan(z), -np.inf, z)
    for height in np.linspace(clear, top, 60) if clear < top else ():  # otherwise there is no bound
        for x, y in ((s, t) for s in a for t in b):
            c = int(np.floor(u + x * (oz - height)))
            r = int(np.floor(v + y * (oz - height)))
            if 0 <= r < z.shape[0] - 1 and 0 <= c < z.shape[1] - 1:
                assert high[r : r + 2, c : c + 2].max() <= height
