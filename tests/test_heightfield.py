"""Heightfields against judges that share no code with the kernels (`twins`); only the public
interface is used.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from synthetic import cratered
from twins import (
    blocked_exactly,
    blocking,
    in_cells,
    node_margins,
    node_margins_to,
    textbook_hit,
    triangles,
)

from lcp_catalog.heightfield import Heightfield
from lcp_catalog.threads import limit_threads, thread_limit

GSD, X0, Y0 = 4.0, 10.0, 20.0
ROUNDING_M = 1e-9
"""Margins smaller than this are ties, which float64 may decide either way."""

AXES = [
    (1, 0, 0),
    (0, 1, 0),
    (-1, 0, 0),
    (0, -1, 0),
    (1, 1, 0),
    (1, -1, 0),
    (-1, 1, 0),
    (-1, -1, 0),
]
SPECIAL_AZIMUTHS = [0, 45, 90, 135, 180, 225, 270, 315]
SPECIAL_ELEVATIONS = [0, 1e-6, 0.1, 5, 45, 89.9, 90, -5, -40, -90]
quick = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def sun(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Unit ENU vector; exactly on an axis or a diagonal where the azimuth is, so that the judge
    means the same ray.
    """
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    east, north = math.sin(a), math.cos(a)
    if azimuth_deg % 45 == 0:
        east, north = (
            float(np.sign(round(c, 9))) * (1 if azimuth_deg % 90 == 0 else math.sqrt(0.5))
            for c in (east, north)
        )
    level = 0.0 if abs(elevation_deg) == 90 else math.cos(e)
    return np.array([east * level, north * level, math.sin(e)])


@st.composite
def terrains(draw, holes=None) -> np.ndarray:
    """Small terrains: ties of whole numbers, noise, spikes and pits, cliffs, float32 of all sizes;
    some with nodata.
    """
    rows, cols = draw(st.integers(2, 14)), draw(st.integers(2, 14))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["whole", "noise", "spikes", "cliff", "mixed"]))
    if kind == "whole":
        z = rng.integers(-3, 4, (rows, cols)).astype(float)
    elif kind == "noise":
        z = rng.normal(size=(rows, cols)) * 5
    elif kind == "spikes":
        z = np.zeros((rows, cols))
        z.flat[rng.integers(0, z.size, 3)] = rng.choice([-50, 50, 7], 3)
    elif kind == "cliff":
        z = np.where(np.arange(cols) > cols // 2, 20.0, 0.0) + rng.normal(size=(rows, cols))
    else:
        z = rng.normal(size=(rows, cols)) * 10.0 ** rng.integers(-6, 4, (rows, cols))
    share = draw(st.sampled_from([0.0, 0.0, 0.1, 0.3, 0.6])) if holes is None else holes
    z[rng.random(z.shape) < share] = np.nan
    return z.astype(np.float32)


suns = st.builds(
    sun,
    st.one_of(st.sampled_from(SPECIAL_AZIMUTHS), st.floats(0, 360).map(lambda a: round(a, 6))),
    st.one_of(st.sampled_from(SPECIAL_ELEVATIONS), st.floats(0, 90).map(lambda e: round(e, 6))),
)


def field(z: np.ndarray) -> Heightfield:
    return Heightfield(z, GSD, X0, Y0)


def agrees(answer: np.ndarray, margins: np.ndarray) -> bool:
    """Whether answers are those of the judge wherever the judge is sure, and False at nodata."""
    sure = np.isfinite(margins) & (np.abs(margins) > ROUNDING_M) | np.isinf(margins)
    return bool((answer[sure] == (margins[sure] > 0)).all() and not answer[np.isnan(margins)].any())


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
        for i, j in np.argwhere(np.isfinite(z)):
            assert answer[i, j] == blocked_exactly(z, (i, j), (east, -north, rise)), (i, j)

    @quick
    @given(terrains(holes=0.0), suns)
    def test_is_that_of_the_textbook_where_the_first_hit_is_clear(self, z, direction):
        ray = in_cells(direction, GSD)
        margins, answer = node_margins(z.astype(float), ray), field(z).occluded_nodes(direction)
        for i, j in np.argwhere(np.abs(margins) > 1e-6):
            # a ray that starts under its own facets hits nothing from above: only the answer "free"
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


class TestFirstHits:
    @quick
    @given(terrains(), st.integers(0, 2**32 - 1))
    def test_is_the_textbooks_unless_terrain_stands_in_between(self, z, seed):
        rng = np.random.default_rng(seed)
        rows, cols = z.shape
        camera = np.array(
            [rng.uniform(-8, cols + 7), rng.uniform(-8, rows + 7), rng.uniform(60, 90)]
        )
        aims = np.stack(
            [rng.uniform(-1, cols, 8), rng.uniform(-1, rows, 8), rng.uniform(-4, 4, 8)], 1
        )
        ranges = field(z).first_hits(
            [X0 + camera[0] * GSD, Y0 - camera[1] * GSD, camera[2]],
            (aims - camera) * [GSD, -GSD, 1],
        )
        corners = triangles(z.astype(float))
        for ray, got in zip(aims - camera, ranges, strict=True):
            want = textbook_hit(z.astype(float), tuple(camera), tuple(ray))
            if not math.isnan(want):
                rise = blocking(corners, tuple(camera), tuple(ray), want * (1 - 1e-9))
                if abs(rise - 1e-6) < 1e-5 and rise > 0:
                    continue  # a graze
                want = math.nan if rise > 1e-6 else want
            assert got == pytest.approx(want, abs=1e-7, nan_ok=True)

    def test_hits_lie_on_the_surface(self):
        f = field(cratered(40))
        origin = np.array([X0 + 70.0, Y0 - 400.0, 300.0])
        aims = np.random.default_rng(3).uniform([X0, Y0 - 150, -20], [X0 + 150, Y0, 20], (200, 3))
        s = f.first_hits(origin, aims - origin)
        points = origin + s[:, None] * (aims - origin)
        seen = np.isfinite(s)
        assert seen.sum() > 100
        np.testing.assert_allclose(
            f.heights_at(points[seen, 0], points[seen, 1]), points[seen, 2], atol=1e-8
        )

    def test_straight_down_and_units_of_the_direction(self):
        f = field(np.full((4, 4), 2.0, np.float32))
        down = [[[0, 0, -1.0], [0, 0, -4.0], [0, 0, 1.0], [0, 0, 0], [np.nan, 0, -1]]]
        np.testing.assert_array_equal(
            f.first_hits([X0 + 5, Y0 - 5, 10.0], down), [[8, 2, np.nan, np.nan, np.nan]]
        )
        np.testing.assert_array_equal(
            f.first_hits([X0 + 500, Y0, 10.0], down), np.full((1, 5), np.nan)
        )

    def test_from_under_the_ground_nothing_is_hit(self):
        f = field(np.zeros((6, 6), np.float32))
        assert np.isnan(
            f.first_hits([X0 + 9, Y0 - 9, -1.0], [[1, 0, 1], [0, 0, 1], [0, 0, -1], [1, 1, 0.1]])
        ).all()

    def test_under_the_border_or_through_a_hole_nothing_is_hit(self):
        z = np.zeros((6, 9), np.float32)
        f = field(z)
        assert np.isnan(f.first_hits([X0 - 40, Y0 - 10, -5.0], [[1, 0, 0.05], [1, 0, 0.2]])).all()
        z[:, 3:5] = np.nan
        into = field(z).first_hits(
            [X0 + 3.5 * GSD, Y0 - 10, 1.0], [[1, 0, -0.5]]
        )  # under the far rim
        assert np.isnan(into).all()
        over = field(z).first_hits([X0 + 3.5 * GSD, Y0 - 10, 1.0], [[1, 0, -0.1]])
        assert over == pytest.approx(10.0)

    def test_at_the_limb_rays_pass_or_hit(self):
        f = field(np.zeros((50, 50), np.float32))
        s = f.first_hits(
            [X0 - 1000, Y0 - 100, 1.0],
            [[1, 0, -1 / 1100], [1, 0, 0], [1, 0, 1e-9], [1, 0, -1 / 999]],
        )
        np.testing.assert_allclose(s, [1100, np.nan, np.nan, np.nan], rtol=1e-12)


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
        i, j = np.argwhere(np.isfinite(f.heights_at(*_places(z)))).T
        x, y = _places(z)
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


class TestNormalsAndHeights:
    def test_a_plane_has_one_normal(self):
        rows, cols = np.mgrid[:5, :6]
        f = Heightfield(
            3.0 * cols - 2.0 * rows, 2.0
        )  # rises 1.5 a metre eastwards and 1 northwards
        want = np.array([-1.5, -1.0, 1.0]) / math.sqrt(1.5**2 + 1 + 1)
        np.testing.assert_allclose(f.normals(), np.broadcast_to(want, (5, 6, 3)), atol=1e-7)
        np.testing.assert_allclose(f.normals_at([3.3, 0.0], [-2.2, 0.0]), [want, want], atol=1e-12)

    def test_one_sided_beside_nodata_and_nan_without_a_neighbour(self):
        z = np.zeros((3, 4), np.float32)
        z[:, 2] = 8.0
        z[1, 3] = np.nan
        normals = Heightfield(z, 1.0).normals()
        np.testing.assert_allclose(normals[1, 2], np.array([-8, 0, 1]) / math.sqrt(65), rtol=1e-6)
        np.testing.assert_allclose(normals[1, 1], np.array([-4, 0, 1]) / math.sqrt(17), rtol=1e-6)
        assert np.isnan(normals[1, 3]).all()
        z[0, 2] = z[2, 2] = np.nan
        assert np.isnan(Heightfield(z, 1.0).normals()[1, 2]).all()
        part = Heightfield(z, 1.0).normals((1, 3, 1, 4))
        np.testing.assert_array_equal(part, Heightfield(z, 1.0).normals()[1:3, 1:4])

    @quick
    @given(terrains())
    def test_nodes_of_triangles_have_their_heights(self, z):
        corners = triangles(z.astype(float)).reshape(-1, 3)
        want = np.full(z.shape, np.nan)
        for u, v, height in corners:
            want[int(v), int(u)] = height
        np.testing.assert_array_equal(field(z).heights_at(*_places(z)), want)

    def test_between_nodes_the_triangle_counts(self):
        f = Heightfield([[0, 4], [8, 0]], 1.0)
        np.testing.assert_allclose(
            f.heights_at([0.75, 0.25, 0.5, 2.0], [-0.25, -0.75, -0.5, 0.0]), [2, 4, 0, np.nan]
        )


class TestBirth:
    @pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
    def test_without_cells_nothing_hides(self, shape):
        f = Heightfield(np.zeros(shape), 1.0)
        assert not f.occluded_nodes([1, 0, -1]).any()
        assert not f.occluded_nodes_from([0, 0, -3]).any()
        assert np.isnan(f.first_hits([0, 0, 5], [[0, 0, -1]])).all()
        assert np.isnan(f.heights_at([0], [0])).all()
        assert np.isnan(f.normals()).all()

    def test_infinite_heights_are_nodata(self):
        z = np.array([[1, np.inf], [2, 3]])
        assert np.isnan(Heightfield(z, 1.0).z_m[0, 1])
        assert z[0, 1] == np.inf

    @pytest.mark.parametrize(
        ("z", "gsd"),
        [
            (np.zeros(4), 1.0),
            (np.zeros((0, 3)), 1.0),
            (np.zeros((3, 3)), 0.0),
            (np.zeros((3, 3)), np.nan),
        ],
    )
    def test_what_is_no_heightfield(self, z, gsd):
        with pytest.raises(ValueError, match="must be"):
            Heightfield(z, gsd)

    @pytest.mark.parametrize("direction", [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]])
    def test_what_is_no_direction(self, direction):
        with pytest.raises(ValueError, match="direction"):
            field(np.zeros((3, 3))).occluded_nodes(direction)


def _places(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.mgrid[: z.shape[0], : z.shape[1]]
    return X0 + j * GSD, Y0 - i * GSD
