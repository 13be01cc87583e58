"""Occlusion by a heightfield against independent implementations (`twins`), through the public
interface.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from helpers.random_heightfields import (
    AXES,
    GSD,
    ROUNDING_M,
    X0,
    Y0,
    agrees,
    field,
    places,
    quick,
    sun,
    suns,
    terrains,
)
from helpers.synthetic import cratered
from helpers.twins import (
    blocking,
    in_cells,
    node_margins,
    node_margins_to,
    textbook_hit,
    triangles,
)
from helpers.twins_extremes import blocked, exact
from hypothesis import example, given
from hypothesis import strategies as st

from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.threads import limit_threads, thread_limit


class TestOccludedNodes:
    @quick
    @given(terrains(), suns)
    def test_is_that_of_every_triangle_clipped(self, z, direction):
        margins = node_margins(z.astype(float), in_cells(direction, GSD))
        assert agrees(field(z).occluded_nodes(direction), margins)

    @quick
    @given(
        st.integers(0, 2**32 - 1),
        st.sampled_from(AXES),
        st.sampled_from([0, 1, -1, Fraction(1, 2), 2]),
        st.booleans(),
    )
    @example(1, (1, 0, 0), 0, False)
    def test_ties_are_decided_as_fractions_are(self, seed, axis, rise, holes):
        rng = np.random.default_rng(seed)
        z = rng.integers(-2, 3, rng.integers(2, 7, 2)).astype(np.float32)
        if holes:
            z[rng.random(z.shape) < 0.25] = np.nan
        east, north, _ = axis
        answer = Heightfield(z, 1.0).occluded_nodes([east, north, float(rise)])
        ray = exact((east, -north, rise))
        for i, j in np.argwhere(np.isfinite(z)).tolist():
            assert answer[i, j] == blocked(z, exact((j, i, z[i, j])), ray), (i, j)

    @quick
    @given(terrains(holes=0.0), suns)
    def test_is_that_of_the_textbook_where_the_first_hit_is_clear(self, z, direction):
        ray = in_cells(direction, GSD)
        margins, answer = node_margins(z.astype(float), ray), field(z).occluded_nodes(direction)
        for i, j in np.argwhere(np.abs(margins) > 1e-6):
            # a ray that starts below its own facets hits nothing from above: only the result "free"
            # is compared
            if not answer[i, j]:
                assert math.isnan(
                    textbook_hit(z.astype(float), (float(j), float(i), float(z[i, j])), ray)
                )

    @quick
    @given(terrains(), suns)
    def test_transposing_mirrors_the_answer(self, z, direction):
        mirrored = np.array(
            [-direction[1], -direction[0], direction[2]]
        )  # the diagonal stays where it is
        there, back = field(z).occluded_nodes(direction), field(z.T).occluded_nodes(mirrored).T
        margins = node_margins(z.astype(float), in_cells(direction, GSD))
        assert (there == back)[~(np.abs(margins) <= ROUNDING_M)].all()

    @quick
    @given(terrains(), suns, st.data())
    def test_a_window_is_a_part_of_the_whole(self, z, direction, data):
        row0, col0 = data.draw(st.integers(0, len(z))), data.draw(st.integers(0, z.shape[1]))
        window = (
            row0,
            data.draw(st.integers(row0, len(z))),
            col0,
            data.draw(st.integers(col0, z.shape[1])),
        )
        part = field(z).occluded_nodes(direction, window)
        assert (
            part == field(z).occluded_nodes(direction)[window[0] : window[1], window[2] : window[3]]
        ).all()

    def test_one_spike_on_a_plain_shades_a_line(self):
        z = np.zeros((5, 9), np.float32)
        z[2, 6] = 3.0
        dark = Heightfield(z, 1.0).occluded_nodes([1, 0, 1])
        assert (
            dark[2].tolist() == [False] * 4 + [True, True] + [False] * 3
        )  # node 3 touches the top: not strictly above
        assert not dark[[0, 1, 3, 4]].any()

    def test_diagonal_is_north_west_to_south_east(self):
        z = np.zeros((2, 2), np.float32)
        z[0, 0] = z[1, 1] = 5.0  # a ridge along the diagonal parts the other two nodes
        dark = Heightfield(z, 1.0).occluded_nodes([1, 1, 0.1])
        assert dark[1, 0]
        z[:] = [[0, 5], [5, 0]]  # a valley
        assert not Heightfield(z, 1.0).occluded_nodes([-1, 1, 0.1])[1, 1]

    def test_a_lone_node_hides_nothing_and_a_rim_does(self):
        z = np.full((5, 5), np.nan, np.float32)
        z[2, 0] = 0.0
        z[2, 3] = 9.0
        assert not Heightfield(z, 1.0).occluded_nodes([1, 0, 0.1]).any()
        z[1, 2], z[1, 3] = (
            9.0,
            9.0,
        )  # now (2, 3) is the corner of a triangle; the ray meets it in that node only
        assert Heightfield(z, 1.0).occluded_nodes([1, 0, 0.1])[2, 0]

    def test_straight_up_is_free_and_straight_down_is_not(self):
        f = field(cratered(16))
        assert not f.occluded_nodes([0, 0, 1]).any()
        assert f.occluded_nodes([0, 0, -1]).all()

    def test_threads_do_not_matter(self):
        f, direction, camera = field(cratered(96)), sun(37, 3), [50.0, -100.0, 30.0]
        rays = np.array(
            [[[x, y, -1.0] for x in np.linspace(-2, 2, 40)] for y in np.linspace(-2, 2, 40)]
        )

        def answers():
            yield from (
                f.occluded_nodes(direction),
                f.occluded_nodes_from(camera),
                f.first_hits([200, -170, 90], rays),
            )
            yield from (
                f.normals(),
                f.occluded_alone([9], [9], 8, direction),
            )

        with limit_threads(1):
            one = list(answers())
        with limit_threads(thread_limit()):
            for a, b in zip(one, answers(), strict=True):
                np.testing.assert_array_equal(a, b)


class TestOccludedNodesFrom:
    @quick
    @given(terrains(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
    def test_is_that_of_every_triangle_clipped(self, z, seed, on_grid, low):
        rng = np.random.default_rng(seed)
        u, v = rng.uniform(-5, z.shape[1] + 4), rng.uniform(-5, z.shape[0] + 4)
        camera = (
            (round(u), round(v), rng.uniform(-5, 5 if low else 60))
            if on_grid
            else (u, v, rng.uniform(-5, 5 if low else 60))
        )
        answer = field(z).occluded_nodes_from(
            [X0 + camera[0] * GSD, Y0 - camera[1] * GSD, camera[2]]
        )
        assert agrees(answer, node_margins_to(z.astype(float), camera))

    def test_a_camera_on_a_node_sees_it_and_its_neighbours(self):
        z = cratered(24)
        f = field(z)
        i, j = np.unravel_index(np.argmax(z), z.shape)
        camera = [X0 + j * GSD, Y0 - i * GSD, float(z[i, j])]
        assert not f.occluded_nodes_from(camera)[i, j]
        raised = f.occluded_nodes_from([*camera[:2], camera[2] + 1.0])
        margins = node_margins_to(z.astype(float), (float(j), float(i), float(z[i, j]) + 1.0))
        assert agrees(raised, margins)
        assert not raised[i, j]

    def test_from_under_the_ground_nothing_is_seen(self):
        f = field(np.zeros((6, 6), np.float32))
        assert f.occluded_nodes_from([X0 + 9.0, Y0 - 9.0, -1.0]).all()
        assert not f.occluded_nodes_from([X0 + 9.0, Y0 - 9.0, 1.0]).any()

    def test_from_a_million_kilometres_it_is_a_direction(self):
        f, direction = field(cratered(32)), sun(200, 8)
        far = f.occluded_nodes_from(direction * 1e9)
        assert (far != f.occluded_nodes(direction)).mean() < 1e-3


class TestOccludedPoints:
    @quick
    @given(terrains(), suns, st.integers(0, 2**32 - 1))
    def test_is_that_of_every_triangle_clipped(self, z, direction, seed):
        rng, f = np.random.default_rng(seed), field(z)
        u, v = rng.uniform(0, z.shape[1] - 1, 8), rng.uniform(0, z.shape[0] - 1, 8)
        height = f.heights_at(X0 + u * GSD, Y0 - v * GSD)
        answer = f.occluded_points(np.stack([X0 + u * GSD, Y0 - v * GSD, height], 1), direction)
        corners, ray = triangles(z.astype(float)), in_cells(direction, GSD)
        for k in np.flatnonzero(np.isfinite(height)):
            if ray[0] or ray[1]:
                margin = blocking(corners, (u[k], v[k], height[k]), ray)
                assert abs(margin) <= 1e-8 or answer[k] == (margin > 0)

    @quick
    @given(terrains(), suns)
    def test_a_node_is_a_point_however_its_place_was_rounded(self, z, direction):
        f = field(z)
        i, j = np.argwhere(np.isfinite(f.heights_at(*places(z)))).T
        x, y = places(z)
        points = np.stack([x[i, j], y[i, j], z[i, j]], 1) + np.array([3e-10, -2e-10, 1e-7])
        margins = node_margins(z.astype(float), in_cells(direction, GSD))[i, j]
        sure = ~(np.abs(margins) <= ROUNDING_M)
        assert (f.occluded_points(points, direction) == f.occluded_nodes(direction)[i, j])[
            sure
        ].all()

    def test_a_lit_slope_does_not_shade_its_own_hits(self):
        slope = np.tile(np.arange(30, dtype=np.float32), (30, 1))
        f = Heightfield(slope, 1.0)
        aims = np.random.default_rng(1).uniform([1, -28, 0], [28, -1, 0], (500, 3))
        origin = np.array([-300.0, 100.0, 4000.0])
        s = f.first_hits(origin, aims - origin)
        hits = (origin + s[:, None] * (aims - origin))[np.isfinite(s)]
        assert not f.occluded_points(
            hits, np.array([-1, 0, 0.01])
        ).any()  # the Sun in front of the slope
        assert not f.occluded_points(
            hits, np.array([1, 0, 1.001]) / 2
        ).any()  # and just above its face
        assert f.occluded_points(hits[hits[:, 0] < 27], np.array([1, 0, 0.999]) / 2).all()


class TestOccludedAlone:
    @quick
    @given(terrains(), suns, st.integers(0, 4), st.integers(0, 2**32 - 1))
    def test_is_that_of_the_cut_out(self, z, direction, half, seed):
        rng = np.random.default_rng(seed)
        rows, cols = rng.integers(-1, len(z) + 1, 3), rng.integers(-1, z.shape[1] + 1, 3)
        answer = field(z).occluded_alone(rows, cols, half, direction)
        padded = np.pad(z, half + 1, constant_values=np.nan)
        for n, (i, j) in enumerate(zip(rows + 1, cols + 1, strict=True)):
            cut = padded[i : i + 2 * half + 1, j : j + 2 * half + 1]
            assert agrees(answer[n], node_margins(cut.astype(float), in_cells(direction, GSD)))

    @quick
    @given(terrains(), st.lists(suns, min_size=1, max_size=3), st.integers(1, 4), st.integers(0, 9))
    def test_nodes_that_only_terrain_outside_darkens(self, z, directions, half, seed):
        """Against the occlusion by the patch alone, over the patches' nodes inside the window."""
        rng = np.random.default_rng(seed)
        f, (rows, cols) = field(z), z.shape
        window = (rows // 4, rows - rows // 5, cols // 5, cols)
        shape = (window[1] - window[0], window[3] - window[2])
        planes = np.moveaxis(f.normals(window), -1, 0).copy()
        dark = rng.integers(0, 2, (len(directions), *shape)).astype(np.uint8)
        dark[:, np.isnan(f.z_m[window[0] : window[1], window[2] : window[3]])] = 0
        middles = [rng.integers(half, max(side - half, half + 1), 3) for side in shape]
        towards = np.array(directions)
        found = f.shadowed_from_outside(
            dark, planes, window, (middles[0], middles[1]), half, towards
        )
        inside = np.pad(np.zeros(shape, bool), half + 1, constant_values=True)
        for k, direction in enumerate(directions):
            facing = np.einsum("cij,c->ij", planes, np.float32(direction)) > 0.0
            wanted = np.pad((dark[k] > 0) & facing, half + 1)
            for n, (i, j) in enumerate(zip(*middles, strict=True)):
                box = np.s_[i + 1 : i + 2 * half + 2, j + 1 : j + 2 * half + 2]
                if inside[box].any():
                    continue
                at = [i + window[0]], [j + window[2]]
                alone = f.occluded_alone(*at, half, direction)[0]
                np.testing.assert_array_equal(found[k, n], wanted[box] & ~alone)
