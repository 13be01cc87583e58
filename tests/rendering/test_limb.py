"""Coverage of pixels on the limb of the sphere, compared with brute force."""

import math

import numpy as np
import pytest
from helpers.twins_sphere import sampled_coverage

import lcp_catalog.rendering.sphere_renderer as limb
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.geometry import sphere_intersection

R = MOON_RADIUS_M


def looking_at_limb(radius_px, distance=3.0 * R, size=(40, 40), distortion=(0, 0, 0, 0, 0)):
    """A camera with the limb at the image centre, ``radius_px``: the limb's radius in pixels there."""
    position = np.array([distance, 0.0, 0.0])
    angle = math.asin(R / distance)
    focal = radius_px / math.tan(angle)
    optical = np.array([-math.cos(angle), math.sin(angle), 0.0])
    right = np.array([0.0, 0.0, 1.0])
    rotation = np.stack([right, np.cross(optical, right), optical])
    middle = ((size[0] - 1) / 2, (size[1] - 1) / 2)
    return Camera(position, rotation, focal, middle, size, distortion)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("radius_px", "distance"),
    [(3, 3 * R), (3, 300 * R), (30, R + 1e3), (30, 3 * R), (3000, R + 1e3), (3000, 300 * R)],
)
def test_coverage_against_brute_force(radius_px, distance):
    camera = looking_at_limb(radius_px, distance)
    column, row = np.meshgrid(np.arange(40), np.arange(40))
    share, middle = limb.coverage(camera, column, row)
    cut = np.flatnonzero((share > 0.0) & (share < 1.0))
    assert cut.size >= 9
    for k in np.random.default_rng(1).choice(cut, 5, replace=False):
        true = sampled_coverage(camera, column.flat[k], row.flat[k], 700)
        assert share[k] == pytest.approx(true, abs=limb.COVERAGE_ERROR + 0.5 / 700)
        towards = camera.rays(middle[k])
        assert not np.isnan(sphere_intersection.ranges(camera.position_mcmf_m, towards))
    pixels = np.stack([column, row], -1).astype(float)
    near = limb.limb_pixels(camera, camera.rays(pixels), limb.pixel_angle(camera))
    assert near.ravel()[cut].all()
    assert near.sum() < 0.3 * near.size or distance < 3 * R
    ground = ~np.isnan(sphere_intersection.ranges(camera.position_mcmf_m, camera.rays(pixels)))
    far = ~near
    assert (share.reshape(40, 40)[far] == ground[far]).all()


def test_coverage_through_a_lens():
    """With distortion the limb is not a conic; its pixels are still found."""
    camera = looking_at_limb(60.0, 2.0 * R, distortion=(-0.3, 0.12, 0.002, -0.001, 0.0))
    column, row = np.meshgrid(np.arange(40), np.arange(40))
    share, _ = limb.coverage(camera, column, row)
    near = limb.limb_pixels(
        camera,
        camera.rays(np.stack([column, row], -1).astype(float)),
        limb.pixel_angle(camera),
    )
    cut = np.flatnonzero((share > 0.0) & (share < 1.0))
    assert near.ravel()[cut].all()
    for k in cut[::12]:
        true = sampled_coverage(camera, column.flat[k], row.flat[k], 500)
        assert share[k] == pytest.approx(true, abs=1e-3)


def test_a_moon_of_a_few_pixels_keeps_its_area():
    """A disc of radius r pixels covers pi r^2 of them (in the plane of a distant camera)."""
    for radius_px, side in ((0.4, 5), (1.7, 7), (20.3, 45)):
        distance = 1e4 * R
        focal = radius_px / math.tan(math.asin(R / distance))
        position = np.array([distance, 0.0, 0.0])
        rotation = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
        camera = Camera(position, rotation, focal, (side / 2 - 0.2, side / 2 - 0.6), (side, side))
        column, row = np.meshgrid(np.arange(side), np.arange(side))
        share, _ = limb.coverage(camera, column, row)
        assert share.sum() == pytest.approx(math.pi * radius_px**2, rel=1e-3)
