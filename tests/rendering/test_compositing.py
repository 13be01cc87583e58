"""Shadows on a transparent plane, compared with closed forms, and backgrounds behind the terrain."""

import itertools
import math

import cv2
import numpy as np
import pytest
from helpers.environment_maps import Lamp, room, uniform

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.view import looking_camera
from lcp_catalog.ephemeris.limb_darkening import LimbDarkening
from lcp_catalog.errors import CameraError, ImageError
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.light.environment_map import LuminanceImage, Panorama
from lcp_catalog.light.solar_disc import SolarDisc
from lcp_catalog.light.sources import Lighting, LightSource, split_sources
from lcp_catalog.rendering.renderer import Method, render_camera
from lcp_catalog.rendering.request import Backdrop, composite, shadow_factor
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain

HIGH = 60.0


def box(height=HIGH, half_m=(100.0, 100.0), gsd=20.0):
    """A block with a level roof at ``height``; its sides are at the border of the raster."""
    rows, cols = (2 * round(side / gsd) + 1 for side in half_m[::-1])
    z = np.full((rows, cols), height, np.float32)
    field = Heightfield(z, gsd, -half_m[0], half_m[1])
    index = np.zeros(z.shape, np.int16)
    return Terrain(
        field, EnuFrame(0.0, 0.0), (0, rows, 0, cols), NodeWindow(0, rows, 0, cols), index, ("box",)
    )


def plane(half_m=500.0, count=101, height=0.0):
    x, y = np.meshgrid(np.linspace(-half_m, half_m, count), np.linspace(half_m, -half_m, count))
    points = np.stack([x + 0.13, y + 0.29, np.full(x.shape, height)], axis=-1)
    return points.reshape(-1, 3)


def crosses(points, direction, height, half_m):
    """Whether the level way to where a ray is as high as the roof meets the block's foot: a line against a
    rectangle (slabs).
    """
    way = (height - points[:, 2:]) / direction[2] * direction[:2]
    first, last = np.zeros(len(points)), np.ones(len(points))
    for axis in range(2):
        with np.errstate(divide="ignore"):
            ends = [(side * half_m[axis] - points[:, axis]) / way[:, axis] for side in (-1, 1)]
        first = np.maximum(first, np.minimum(*ends))
        last = np.minimum(last, np.maximum(*ends))
    return first < last


def test_a_blocks_shadow_ends_where_geometry_says():
    for azimuth, elevation in itertools.product([10.0, 100.0, 190.0, 305.0], [12.0, 40.0]):
        terrain, points = box(), plane()
        direction = direction_enu(azimuth, elevation)
        outside = np.abs(points[:, :2]).max(axis=1) > 101.0
        found = shadow_factor(terrain, points, Lighting.of_sun(direction), TIERS["high"])[outside]
        expected = crosses(points[outside], direction, HIGH, (100.0, 100.0))
        assert set(np.unique(found)) == {0.0, 1.0}
        assert ((found == 0.0) == expected).all()
        assert expected.sum() > 30
        shadow = points[outside][found == 0.0]
        assert np.median(shadow @ direction) < 0  # it falls away from the Sun


@pytest.mark.parametrize("distance", [20.0, 60.0, 200.0])
def test_before_an_endless_wall_under_an_even_sky(distance):
    """A wall up to an elevation h hides (1 - cos h) / 2 of a uniform sky from a horizontal surface."""
    terrain = box(half_m=(200.0, 20000.0), gsd=200.0)
    point = np.array([[200.0 + distance, 0.0, 0.0]])
    sky = Lighting.of_panorama(split_sources(uniform(64)))
    high = math.atan2(HIGH, distance)
    found = shadow_factor(terrain, point, sky, TIERS["high"])[0]
    assert found == pytest.approx(1.0 - 0.5 * (1.0 - math.cos(high)), abs=5e-3)


def test_two_lamps_and_a_sky_share():
    """Each shadow removes the share of its own lamp in the horizontal irradiance."""
    terrain, points = box(), plane(300.0, 41)
    points = points[np.abs(points[:, :2]).max(axis=1) > 101.0]
    one, two = direction_enu(90, 25), direction_enu(130, 35)
    light = Lighting((LightSource(one, 1.0), LightSource(two, 0.5)))
    found = shadow_factor(terrain, points, light, TIERS["high"])
    parts = one[2], 0.5 * two[2]
    dark = [crosses(points, way, HIGH, (100.0, 100.0)) for way in (one, two)]
    expected = 1.0 - (parts[0] * dark[0] + parts[1] * dark[1]) / sum(parts)
    assert found == pytest.approx(expected, abs=1e-12)
    assert len(np.unique(found.round(6))) == 4


def test_a_disc_throws_a_penumbra():
    """Behind a long wall: the share of an even disc above a straight edge, (t - sin t cos t) / pi."""
    radius, elevation = math.radians(0.95), math.radians(20.0)
    terrain = box(half_m=(200.0, 20000.0), gsd=200.0)
    disc = SolarDisc(radius, LimbDarkening(1.0, 0.0, 0.0))
    light = Lighting((LightSource(direction_enu(270, 20.0), disc=disc),))
    heights = np.linspace(-0.9, 0.9, 7)  # of the edge over the disc's middle, in radii
    away = HIGH / np.tan(elevation + np.arctan(heights * math.tan(radius)))
    points = np.stack([200.0 + away, np.zeros(7), np.zeros(7)], axis=-1)
    t = np.arccos(heights)
    found = shadow_factor(terrain, points, light, TIERS["high"])
    assert found == pytest.approx((t - np.sin(t) * np.cos(t)) / math.pi, abs=0.015)  # 512 rays


def test_nothing_to_shade():
    points = np.array([[300.0, 0.0, 0.0]])
    below = Lighting((LightSource(direction_enu(90, -10)),))
    assert shadow_factor(box(), points, below, TIERS["standard"]) == [1.0]
    assert len(shadow_factor(box(), points[:0], below, TIERS["standard"])) == 0


@pytest.fixture(scope="module")
def camera():
    terrain = box()
    return looking_camera(terrain.frame, direction_enu(180, 50) * 3000.0, 10.0, (900.0, 700.0))


def seen_by(camera, light, backdrop, panorama=None):
    terrain = box()
    photo = render_camera(terrain, camera, light, Method(accuracy=TIERS["standard"]))
    args = photo, terrain, camera, light, backdrop, panorama, TIERS["standard"]
    return photo, composite(*args)


def grey(camera, value=0.5, encoded=False):
    return LuminanceImage(np.full(camera.shape, value), encoded, "grey.png")


def test_terrain_background_and_shadow_each_in_their_place(camera):
    direction = direction_enu(100, 30)
    light = Lighting.of_sun(direction)
    photo, whole = seen_by(camera, light, Backdrop(0.0, grey(camera), 0.2))
    assert whole[photo.visible] == pytest.approx(photo.radiance[photo.visible])
    origin, rays = camera.rays_enu(EnuFrame(0.0, 0.0))
    points = origin - (origin[2] / rays[..., 2])[..., None] * rays
    missed = ~photo.visible
    dark = crosses(points[missed], direction, HIGH, (100.0, 100.0))
    assert whole[missed] == pytest.approx(np.where(dark, 0.0, 0.1))
    assert 50 < dark.sum() < 0.2 * dark.size


def test_without_a_catcher_the_picture_is_as_it_is(camera):
    light = Lighting.of_sun(direction_enu(100, 30))
    photo, whole = seen_by(camera, light, Backdrop(None, grey(camera)))
    assert (whole[~photo.visible] == 0.5).all()  # linear values are radiance factors


def test_white_of_a_display_image_is_white_of_the_preview(camera):
    light = Lighting.of_sun(direction_enu(100, 30))
    photo, whole = seen_by(camera, light, Backdrop(None, grey(camera, 1.0, encoded=True)))
    lit = photo.radiance[photo.radiance > 0]
    assert whole[~photo.visible] == pytest.approx(np.percentile(lit, 99.5))


def test_rays_that_never_come_down_see_the_background():
    """A level camera: above the plane's horizon the sky is unshaded."""
    terrain = box()
    rotation = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # looks north
    place = terrain.frame.to_mcmf([0.0, -2000.0, 100.0])
    camera = Camera(place, rotation @ terrain.frame.rotation, 300.0, (40.0, 30.0), (81, 61))
    light = Lighting.of_sun(direction_enu(170, 5))
    photo, whole = seen_by(camera, light, Backdrop(0.0, grey(camera)))
    assert (whole[:30][~photo.visible[:30]] == 0.5).all()
    assert (whole[30:][~photo.visible[30:]] == 0.0).any()  # the shadow, behind the block


def test_the_panorama_itself_stands_behind(camera):
    """Radiance factor of a sky of luminance L is pi L / E."""
    image = room(64, [Lamp(30, 40, 1.0)], ambient=0.25)
    split = split_sources(image)
    light = Lighting.of_panorama(split)
    photo, whole = seen_by(camera, light, Backdrop(), image.times(1.0 / split.power_above))
    _, rays = camera.rays_enu(EnuFrame(0.0, 0.0))
    expected = math.pi * image.at(rays) / split.power_above
    assert whole[~photo.visible] == pytest.approx(expected[~photo.visible])


def test_another_size_is_resampled(camera, tmp_path):
    height, width = camera.shape
    ramp = np.tile(np.linspace(0.0, 1.0, 2 * width, dtype=np.float32), (2 * height, 1))
    cv2.imwrite(str(tmp_path / "ramp.tif"), ramp)
    light = Lighting.of_sun(direction_enu(100, 30))
    photo, whole = seen_by(camera, light, Backdrop.open(None, tmp_path / "ramp.tif", None))
    expected = np.tile(ramp[0].reshape(-1, 2).mean(axis=1), (height, 1))
    assert whole[~photo.visible] == pytest.approx(expected[~photo.visible], abs=1e-6)


def test_refusals(camera):
    light = Lighting.of_sun(direction_enu(100, 30))
    tall = LuminanceImage(np.ones((90, 40)), False, "tall.png")
    with pytest.raises(ImageError, match=r"tall.png: the aspect ratio of 40 x 90 pixels"):
        seen_by(camera, light, Backdrop(None, tall))
    with pytest.raises(CameraError, match="shadow catcher"):
        seen_by(camera, light, Backdrop(5000.0, grey(camera)))


def test_panoramas_of_one_value_stay_it():
    """Under a uniform sky, a plane far from the block is as bright as without it."""
    far = np.array([[1e5, 0.0, 0.0]])
    light = Lighting.of_panorama(split_sources(Panorama(np.ones((16, 32)))))
    assert shadow_factor(box(), far, light, TIERS["standard"])[0] == pytest.approx(1.0, abs=0.01)
