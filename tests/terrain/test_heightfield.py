"""Heightfields against independent implementations (`twins`): hits of rays, normals and heights,
through the public interface.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.random_heightfields import GSD, X0, Y0, field, places, quick, terrains
from helpers.synthetic import cratered
from helpers.twins import blocking, textbook_hit, triangles
from hypothesis import given
from hypothesis import strategies as st

from lcp_catalog.terrain.heightfield import Heightfield


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
        np.testing.assert_array_equal(field(z).heights_at(*places(z)), want)

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
