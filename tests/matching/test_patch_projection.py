"""Pixels of patches' nodes by polynomials: those of the sensor to 0.004 px, or by the sensor
itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.twins_match import catalog_of_patches, looking_at

from lcp_catalog.cameras.sensor import FullSensor, Reduced
from lcp_catalog.catalog.patch_terrain import nodes_mcmf
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.matching.templates import node_pixels

FRAMES = [EnuFrame(10.0, 40.0), EnuFrame(10.02, 40.03)]
GSD_M = 100.0


@pytest.fixture(scope="module")
def catalog():
    """Two patches of 33 x 33 nodes: level terrain with a hill, and a slope of 1 in 4 with another."""
    east, north = np.meshgrid(*(np.arange(-16, 17) * k * GSD_M for k in (1, -1)))
    hill = 400.0 * np.exp(-((east - 200) ** 2 + north**2) / 5e5)
    z = np.array([hill, 0.5 * hill + 0.25 * east])
    z -= z[:, 16:17, 16:17]
    return catalog_of_patches(z.astype(np.float32), FRAMES, GSD_M)


class Strange(FullSensor):
    """A sensor with a camera's geometry and an offset that depends on the pixel; counts what it
    projects.
    """

    def __init__(self, camera, offset: Callable[[np.ndarray], np.ndarray]) -> None:
        self.camera, self.offset, self.projected = camera, offset, 0

    def project(self, points: np.ndarray) -> np.ndarray:
        self.projected += np.size(points) // 3
        pixels = self.camera.project(points)
        return pixels + self.offset(pixels)


def nothing(pixels: np.ndarray) -> np.ndarray:
    return np.zeros_like(pixels)


@pytest.mark.parametrize("away_m", [5e3, 8e3, 12e3, 20e3, 30e3, 45e3, 70e3, 100e3, 300e3])
def test_from_any_distance_they_are_the_sensors(catalog, away_m: float) -> None:
    """With pixels of 5 m, where an error of the polynomial is most visible."""
    camera = looking_at(FRAMES[0], away_m, 30, 40, 33, away_m / 5.0, (3000, 3000))
    sensor, nodes = Strange(camera, nothing), nodes_mcmf(catalog, np.arange(2))
    found = node_pixels(catalog, np.arange(2), nodes, sensor)
    asked = sensor.projected
    assert np.abs(found - camera.project(nodes)).max() < 0.004
    if away_m >= 300e3:
        assert asked < 0.1 * nodes.size / 3  # far off a cubic is enough


@pytest.mark.parametrize("share", [0.0, 0.5, 2.0 / 3.0, -2.0 / 3.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_jump_in_a_strip_is_noticed_wherever_it_lies(catalog, share: float, axis: int) -> None:
    """A strip of five nodes is 0.1 px off: some of them are fitted points, others checked nodes
    only.
    """
    camera = looking_at(FRAMES[0], 300e3, 0, 0, 0, 3000.0, (500, 500))
    middle = camera.project(FRAMES[0].origin_mcmf_m)[axis] + share * 16.0

    def strip(pixels: np.ndarray) -> np.ndarray:
        off = np.zeros_like(pixels)
        off[..., 1 - axis] = 0.1 * (np.abs(pixels[..., axis] - middle) < 2.2)
        return off

    sensor, nodes = Strange(camera, strip), nodes_mcmf(catalog, [0])
    found = node_pixels(catalog, np.array([0]), nodes, sensor)
    np.testing.assert_array_equal(found, sensor.project(nodes))


def test_only_patches_that_need_it_are_asked_node_by_node(catalog) -> None:
    camera = looking_at(FRAMES[0], 300e3, 0, 0, 0, 3000.0, (500, 500))
    first = camera.project(FRAMES[0].origin_mcmf_m)
    both = catalog_of_patches(
        catalog.dem, [FRAMES[0], EnuFrame(10.3, 40.0)], GSD_M
    )  # 7 km apart: 70 pixels

    def strip(pixels: np.ndarray) -> np.ndarray:
        return 0.1 * (np.abs(pixels[..., :1] - first[0]) < 3.0) * np.ones(2)

    sensor, nodes = Strange(camera, strip), nodes_mcmf(both, np.arange(2))
    found = node_pixels(both, np.arange(2), nodes, sensor)
    asked = sensor.projected
    np.testing.assert_array_equal(found[0], sensor.project(nodes[0]))
    assert 0.0 < np.abs(found[1] - sensor.project(nodes[1])).max() < 0.004
    assert 33 * 33 < asked < 1.3 * 33 * 33


def test_a_camera_answers_itself_however_often_it_is_reduced(catalog) -> None:
    camera = looking_at(FRAMES[0], 80e3, 20, 40, 33, 3200.0, (600, 600))
    nodes = nodes_mcmf(catalog, np.arange(2))
    for sensor in (camera, Reduced(camera, 2), Reduced(Reduced(camera, 2), 3)):
        found = node_pixels(catalog, np.arange(2), nodes, sensor)
        np.testing.assert_array_equal(found, sensor.project(nodes))
    assert node_pixels(catalog, np.arange(0), nodes[:0], Strange(camera, nothing)).shape == (0, 33, 33, 2)  # fmt: skip


def test_level_ground_has_pixels(catalog) -> None:
    """Terrain without relief, to which no slope with height can be fitted."""
    flat = replace(catalog, dem=np.zeros_like(catalog.dem))
    camera = looking_at(FRAMES[0], 100e3, 30, 40, 33, 1000.0, (500, 500))
    nodes = nodes_mcmf(flat, np.arange(2))
    found = node_pixels(flat, np.arange(2), nodes, Strange(camera, nothing))
    assert np.abs(found - camera.project(nodes)).max() < 0.004
