"""Orthoimages compared with closed forms: no shift, no change of scale, no loss, no signal from
missing pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain
from lcp_catalog.validation.orthoimage import _narrow_px, orthorectify, terrain_nodes

SUN = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Flat:
    """A sensor for which pixels are an affine function of x and y: parallelograms are exact."""

    shape: tuple[int, int]
    matrix: tuple[tuple[float, float], tuple[float, float]]
    start: tuple[float, float] = (0.0, 0.0)
    factor: ClassVar[int] = 1

    @property
    def full(self) -> Flat:
        return self

    def project(self, points: Any) -> np.ndarray:
        return np.asarray(points)[..., :2] @ np.array(self.matrix).T + np.array(self.start)

    def in_image(self, pixels: np.ndarray) -> np.ndarray:
        col, row = np.moveaxis(pixels, -1, 0)
        rows, cols = self.shape
        return (col >= -0.5) & (col < cols - 0.5) & (row >= -0.5) & (row < rows - 0.5)


def photo_of(sensor: Any, values: np.ndarray, weight: np.ndarray | None = None) -> Image:
    weight = np.ones(values.shape) if weight is None else weight
    return Image(
        "made",
        values.astype(np.float32),
        weight.astype(np.float32),
        sensor,
        sun_direction_mcmf=SUN,
    )


def plane(rows: int, cols: int) -> np.ndarray:
    """Nodes one unit apart: x = column, y = row."""
    y, x = np.mgrid[:rows, :cols].astype(float)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def pixels(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    row, col = np.mgrid[:rows, :cols].astype(float)
    return col, row


# -- parallelograms


@given(
    st.floats(-2.9, 2.9), st.floats(-2.9, 2.9), st.floats(-2.9, 2.9), st.floats(-2.9, 2.9),
    st.floats(-3.0, 3.0), st.floats(-3.0, 3.0),
)  # fmt: skip
@settings(deadline=None, max_examples=50)
def test_the_mean_of_a_slope_is_its_value_in_the_middle(a, b, c, d, gx, gy):
    """For any parallelogram: no shift by half a pixel on either axis."""
    sensor = Flat((80, 90), ((a, b), (c, d)), (44.0, 39.0))
    nodes = plane(9, 9) - [4.0, 4.0, 0.0]
    col, row = pixels(80, 90)
    seen = orthorectify(photo_of(sensor, 100.0 + gx * col + gy * row), nodes)
    at = sensor.project(nodes)
    inner = (np.abs(at - [44.5, 39.5]) < [40.0, 35.0]).all(axis=-1)
    wanted = 100.0 + gx * at[..., 0] + gy * at[..., 1]
    np.testing.assert_allclose(seen.signal[inner], wanted[inner], atol=1e-4)
    np.testing.assert_allclose(seen.weight[inner], 1.0, atol=1e-6)
    np.testing.assert_array_equal(seen.pixels, at)


@pytest.mark.parametrize(("wide", "tall"), [(1.0, 1.0), (2.4, 1.0), (3.0, 5.0), (7.0, 6.5)])
def test_the_mean_of_a_square_has_the_cells_own_spread(wide, tall):
    """col^2 over a cell: the middle's square, and a twelfth of the width's; of so many samples,
    less a twelfth of a sample's width.
    """
    sensor = Flat((120, 120), ((wide, 0.0), (0.0, tall)), (8.0, 8.0))
    col, row = pixels(120, 120)
    seen = orthorectify(photo_of(sensor, col**2 + 3.0 * row**2), plane(10, 10))
    at = sensor.project(plane(10, 10))
    between = [side**2 * (1.0 - 1.0 / np.ceil(side) ** 2) / 12.0 for side in (wide, tall)]
    wanted = at[..., 0] ** 2 + between[0] + 3.0 * (at[..., 1] ** 2 + between[1])
    np.testing.assert_allclose(seen.signal, wanted, rtol=1e-5)


@pytest.mark.parametrize("turn_deg", [0.0, 25.0, 115.0, 250.0])
def test_a_turned_cell_is_turned_the_right_way(turn_deg):
    """col * row over a rotated rectangle: its value at the centre plus the covariance of the
    rectangle; mirrored, the sign changes.
    """
    turn = np.radians(turn_deg)
    right, down = np.array([5.0, 0.0]), np.array([0.0, 2.0])
    about = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    right, down = about @ right, about @ down
    sensor = Flat((120, 120), ((right[0], down[0]), (right[1], down[1])), (60.0, 60.0))
    col, row = pixels(120, 120)
    nodes = plane(7, 7) - [3.0, 3.0, 0.0]
    seen = orthorectify(photo_of(sensor, col * row), nodes)
    parts = [np.ceil(np.abs(side).max() - 1e-9) for side in (right, down)]
    own = sum(
        side.prod() * (1.0 - 1.0 / n**2) / 12.0
        for side, n in zip((right, down), parts, strict=True)
    )
    at = sensor.project(nodes)
    np.testing.assert_allclose(seen.signal, at[..., 0] * at[..., 1] + own, atol=2e-3)


def test_what_is_finer_than_a_cell_is_averaged_out_and_not_aliased():
    """A wave of 0.8 cells: its mean over a cell is sinc(1 / 0.8); sampled at the nodes it would be
    a wave of 4 cells.
    """
    pixel_per_cell, wave = 10.0, 8.0
    sensor = Flat((200, 200), ((pixel_per_cell, 0.0), (0.0, pixel_per_cell)), (14.5, 14.5))
    col, _ = pixels(200, 200)
    seen = orthorectify(photo_of(sensor, np.cos(2.0 * np.pi * col / wave)), plane(17, 17))
    left = np.abs(np.sinc(pixel_per_cell / wave))
    assert np.abs(seen.signal).max() < 1.05 * left


def test_where_cells_are_finer_than_pixels_quadratics_are_exact():
    sensor = Flat((60, 60), ((0.23, 0.05), (-0.04, 0.31)), (20.0, 15.0))
    col, row = pixels(60, 60)
    values = 5.0 + (col - 30) ** 2 - 0.5 * (col - 30) * (row - 30) + 0.3 * (row - 30) ** 2
    seen = orthorectify(photo_of(sensor, values), plane(60, 70))
    x, y = np.moveaxis(sensor.project(plane(60, 70)) - 30.0, -1, 0)
    np.testing.assert_allclose(
        seen.signal, 5.0 + x**2 - 0.5 * x * y + 0.3 * y**2, rtol=2e-5, atol=2e-4
    )


@dataclass(frozen=True)
class Curved(Flat):
    """Columns increase with the square of x."""

    def project(self, points: Any) -> np.ndarray:
        x, y = np.moveaxis(np.asarray(points)[..., :2], -1, 0)
        return np.stack([5.0 + 0.5 * x**2, 5.0 + 2.0 * y], axis=-1)


def test_a_cell_reaches_half_way_to_both_its_neighbours():
    """Where the scale changes, a footprint is the mean of both sides wide: x pixels at x; one step
    at the edge.
    """
    sensor = Curved((60, 90), ((1.0, 0.0), (0.0, 1.0)))
    col, _ = pixels(60, 90)
    seen = orthorectify(photo_of(sensor, col**2), plane(12, 12))
    x = np.arange(1.0, 11.0)
    side = x * 1.0
    wanted = (5.0 + 0.5 * x**2) ** 2 + side**2 * (1.0 - 1.0 / np.ceil(side) ** 2) / 12.0
    np.testing.assert_allclose(seen.signal[5, 1:11], wanted, rtol=1e-5)


def test_where_cells_differ_the_narrowest_say_how_fine_the_image_is_kept():
    """Widths from 1 to 59 pixels: a reduction for the median width would blur the narrow ones."""
    sensor = Curved((300, 1900), ((1.0, 0.0), (0.0, 1.0)))
    col, _ = pixels(300, 1900)
    seen = orthorectify(photo_of(sensor, col**2), plane(12, 60))
    x = np.arange(1.0, 7.0)
    wanted = (5.0 + 0.5 * x**2) ** 2 + x**2 * (1.0 - 1.0 / np.ceil(x) ** 2) / 12.0
    np.testing.assert_allclose(seen.signal[5, 1:7], wanted, rtol=1e-5)


@pytest.mark.parametrize(("wide", "tall"), [(7.0, 2.0), (2.0, 7.0)])
def test_a_footprint_is_as_long_as_its_longer_side(wide, tall):
    down, right = np.full((9, 9, 2), (0.0, tall)), np.full((9, 9, 2), (wide, 0.0))
    down[0], right[0] = 0.0, 0.1  # hidden
    seen = np.arange(9)[:, None] + np.zeros(9) > 0
    assert _narrow_px(down, right, seen) == pytest.approx(7.0)


def test_a_cell_of_very_many_pixels_is_the_mean_of_them_all():
    """150 x 150 pixels of noise: a sample of them would have a larger error than the mean itself
    varies.
    """
    noise = np.random.default_rng(0).normal(size=(1200, 1200))
    sensor = Flat((1200, 1200), ((150.0, 0.0), (0.0, 150.0)), (74.5, 74.5))
    seen = orthorectify(photo_of(sensor, noise), plane(8, 8))
    whole = noise.reshape(8, 150, 8, 150).mean(axis=(1, 3))
    assert np.std(seen.signal - whole) < 0.6 * whole.std()


def test_a_much_finer_image_is_reduced_without_a_shift():
    """Footprints of 41 pixels: the image is first reduced by 10; a linear gradient keeps its
    values.
    """
    sensor = Flat((700, 700), ((41.0, 0.0), (0.0, 41.0)), (60.0, 60.0))
    col, row = pixels(700, 700)
    seen = orthorectify(photo_of(sensor, 2.0 * col - row), plane(14, 14))
    at = sensor.project(plane(14, 14))
    np.testing.assert_allclose(seen.signal, 2.0 * at[..., 0] - at[..., 1], atol=1e-3)


# -- what is missing


@pytest.mark.parametrize("scale", [0.4, 1.0, 3.3])
def test_missing_pixels_weigh_nothing(scale):
    sensor = Flat((60, 60), ((scale, 0.0), (0.0, scale)), (5.0, 5.0))
    count = int(48 / scale)
    values, weight = np.full((60, 60), 7.0), np.ones((60, 60))
    values[20:30, 20:40], weight[20:30, 20:40] = 1e9, 0.0
    values[40, 40] = np.nan
    seen = orthorectify(photo_of(sensor, values, weight), plane(count, count))
    there = seen.weight > 0.0
    np.testing.assert_allclose(seen.signal[there], 7.0, rtol=1e-6)
    assert np.isnan(seen.signal[~there]).all()
    at = seen.pixels
    gap = (np.abs(at - [29.5, 24.5]) < [9.5 - scale, 4.5 - scale]).all(axis=-1)
    assert gap.any()
    assert (seen.weight[gap] == 0.0).all()
    far = (np.abs(at - [29.5, 24.5]) > [12.0 + scale, 7.0 + scale]).any(axis=-1)
    far &= (np.abs(at - 40.0) > 2.0 + scale).any(axis=-1)
    np.testing.assert_allclose(seen.weight[far], 1.0, atol=1e-6)


def test_half_a_weight_pulls_half_as_much():
    sensor = Flat((8, 8), ((2.0, 0.0), (0.0, 2.0)), (0.5, 0.5))
    values, weight = np.zeros((8, 8)), np.ones((8, 8))
    values[:, 2], values[:, 3], weight[:, 3] = 4.0, 10.0, 0.5
    seen = orthorectify(photo_of(sensor, values, weight), plane(4, 4))
    assert seen.signal[1, 1] == pytest.approx((4.0 + 0.5 * 10.0) / 1.5, rel=1e-6)
    assert seen.weight[1, 1] == pytest.approx(0.75)


def test_hidden_nodes_and_nodes_beyond_the_image_are_out():
    sensor = Flat((20, 20), ((1.0, 0.0), (0.0, 1.0)), (-5.0, 0.0))
    visible = np.ones((20, 30), np.bool_)
    visible[4, 10] = False
    seen = orthorectify(photo_of(sensor, np.ones((20, 20))), plane(20, 30), visible)
    assert seen.weight[4, 10] == 0.0
    assert np.isnan(seen.signal[4, 10])
    assert (seen.weight[:, :5] == 0.0).all()
    assert (seen.weight[:, 26:] == 0.0).all()
    assert (seen.weight[5:, 5:25] == 1.0).all()


def test_a_pixel_reaches_half_a_pixel_beyond_its_middle():
    """Nodes from -0.5 to 19.4: all are in the image, the first and last beyond the centres of its
    edge pixels.
    """
    sensor = Flat((20, 20), ((0.1, 0.0), (0.0, 0.1)), (-0.5, -0.5))
    seen = orthorectify(photo_of(sensor, np.full((20, 20), 7.0)), plane(200, 200))
    np.testing.assert_allclose(seen.signal[1:, 1:], 7.0, rtol=1e-6)
    np.testing.assert_allclose(seen.weight[1:, 1:], 1.0, atol=1e-6)


def test_ground_without_a_height_shows_nothing_and_spoils_nothing():
    sensor = Flat((20, 20), ((1.5, 0.0), (0.0, 1.5)), (1.0, 1.0))
    nodes = plane(11, 11)
    nodes[5, 5] = np.nan
    nodes[0, :2] = np.nan
    seen = orthorectify(photo_of(sensor, np.full((20, 20), 3.0)), nodes)
    known = np.isfinite(nodes[..., 0])
    assert np.isnan(seen.signal[~known]).all()
    np.testing.assert_allclose(seen.signal[known], 3.0, rtol=1e-6)


def test_nothing_seen_is_no_error():
    sensor = Flat((20, 20), ((1.0, 0.0), (0.0, 1.0)), (500.0, 0.0))
    seen = orthorectify(photo_of(sensor, np.ones((20, 20))), plane(5, 5))
    assert (seen.weight == 0.0).all()


@pytest.mark.parametrize("shape", [(1, 5, 3), (5, 5, 2), (5, 3)])
def test_what_is_no_grid_is_refused(shape):
    sensor = Flat((20, 20), ((1.0, 0.0), (0.0, 1.0)))
    with pytest.raises(ValueError, match="nodes"):
        orthorectify(photo_of(sensor, np.ones((20, 20))), np.zeros(shape))


# -- cameras over the sphere


def over(lon: float, lat: float, tilt_deg: float, roll_deg: float) -> tuple[Camera, EnuFrame]:
    """A camera 90 km above a place, 300 m per pixel, tilted to the north-east and rolled about its
    axis.
    """
    frame = EnuFrame(lon, lat)
    tilt, roll = np.radians([tilt_deg, roll_deg])
    towards = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
    ahead = np.sin(tilt) * towards - np.cos(tilt) * np.array([0.0, 0.0, 1.0])
    first = np.cross(ahead, [0.3, 0.2, 1.0])
    first /= np.linalg.norm(first)
    second = np.cross(ahead, first)
    right = np.cos(roll) * first + np.sin(roll) * second
    rotation = np.stack([right, np.cross(ahead, right), ahead]) @ frame.rotation
    position = frame.to_mcmf(-90e3 * ahead)
    return Camera(position, rotation, 300.0, (79.5, 70.25), (160, 142)), frame


def on_sphere(camera: Camera) -> np.ndarray:
    """Intersections of the pixels' rays with the sphere, (rows, cols, 3); all exist."""
    rows, cols = camera.shape
    col, row = pixels(rows, cols)
    rays = camera.rays(np.stack([col, row], axis=-1))
    along = rays @ camera.position_mcmf_m
    depth = along**2 - (camera.position_mcmf_m @ camera.position_mcmf_m - MOON_RADIUS_M**2)
    return camera.position_mcmf_m + (-along - np.sqrt(depth))[..., None] * rays


def pattern(points: np.ndarray) -> np.ndarray:
    """A function of MCMF position: waves of 9 to 17 km in three directions."""
    waves = ((9e3, (0.6, -0.3, 0.74)), (13e3, (-0.2, 0.95, 0.1)), (17e3, (0.5, 0.5, -0.7)))
    return sum(np.sin(2.0 * np.pi * points @ np.array(d) / length) for length, d in waves)


def ground(frame: EnuFrame, gsd_m: float) -> Terrain:
    """25 km of the sphere around a place."""
    half = round(12e3 / gsd_m)
    step = np.arange(-half, half + 1) * gsd_m
    x, y = np.meshgrid(step, -step)
    z = np.sqrt(MOON_RADIUS_M**2 - x**2 - y**2) - MOON_RADIUS_M
    field = Heightfield(z.astype(np.float32), gsd_m, -half * gsd_m, half * gsd_m)
    window = NodeWindow(-half, half + 1, -half, half + 1)
    return Terrain(field, frame, field.whole, window, np.zeros(z.shape, np.int16), ("made",))


@pytest.mark.parametrize("gsd_m", [150.0, 300.0, 900.0])
@pytest.mark.parametrize(
    ("lon", "lat", "tilt", "roll"),
    [(3.0, 26.0, 0.0, 0.0), (3.0, 26.0, 30.0, 77.0), (150.0, -21.0, 15.0, 181.0),
     (250.0, -70.0, 40.0, 265.0), (359.9, 0.1, 20.0, 333.0), (40.0, 89.0, 10.0, 120.0)],
)  # fmt: skip
def test_the_ground_is_where_it_is(lon, lat, tilt, roll, gsd_m):
    """The orthoimage of a known pattern is the pattern, without a shift for any roll, hemisphere or
    cell size. The shift is estimated by a fit of the pattern, its slopes and a constant.
    """
    camera, frame = over(lon, lat, tilt, roll)
    terrain = ground(frame, gsd_m)
    nodes = terrain_nodes(terrain)
    seen = orthorectify(photo_of(camera, pattern(on_sphere(camera))), nodes)
    there = seen.weight > 0.99
    assert there.sum() > 0.3 * there.size
    truth = pattern(nodes)
    east, north = (
        (pattern(nodes + step) - pattern(nodes - step)) / 2.0
        for step in (frame.rotation[0], frame.rotation[1])
    )
    design = np.stack([truth, east, north, np.ones_like(truth)], axis=-1)[there]
    gain, dx, dy, _ = np.linalg.lstsq(design, seen.signal[there], rcond=None)[0]
    assert np.hypot(dx, dy) < 3.0  # metres: a hundredth of a pixel
    # a cell's mean takes 1 - sinc of the wave, at most 1.7 % of 9 km in cells of 900 m
    assert 0.975 < gain < 1.001
    assert np.abs(seen.signal - truth)[there].max() < 0.08


def test_every_second_node_is_the_coarse_grids():
    """A grid with half the cell size: coincident nodes see the same place with a smaller cell."""
    camera, frame = over(3.0, 26.0, 10.0, 30.0)
    photo = photo_of(camera, pattern(on_sphere(camera)))
    coarse, fine = (
        orthorectify(photo, terrain_nodes(ground(frame, gsd))) for gsd in (300.0, 150.0)
    )
    np.testing.assert_allclose(fine.pixels[::2, ::2], coarse.pixels, atol=1e-3)
    both = (coarse.weight > 0.99) & (fine.weight[::2, ::2] > 0.99)
    np.testing.assert_allclose(fine.signal[::2, ::2][both], coarse.signal[both], atol=0.02)


def test_the_ring_around_the_core_is_left_out():
    terrain = ground(EnuFrame(10.0, 10.0), 600.0)
    inner = replace(terrain, core=(3, 20, 5, 30))
    np.testing.assert_array_equal(terrain_nodes(inner), terrain_nodes(terrain)[3:20, 5:30])
