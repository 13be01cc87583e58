"""A view with its own direction for each point, compared with the camera that gives the same
directions.
"""

import numpy as np
import pytest

from lcp_catalog.cameras.sensor import Reduced
from lcp_catalog.cameras.view import ParallelView, camera_view, looking_camera, sensor_view
from lcp_catalog.errors import CameraError
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.renderer import Method, render_enu
from lcp_catalog.terrain.area import NodeWindow
from lcp_catalog.terrain.heightfield import Heightfield
from lcp_catalog.terrain.terrain import Terrain

FRAME = EnuFrame(40.0, -30.0)
SUN = direction_enu(100.0, 35.0)


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    rng = np.random.default_rng(5)
    y, x = np.mgrid[0:48, 0:64]
    z = 30.0 * np.sin(x / 5.0) * np.cos(y / 7.0) + rng.normal(0.0, 1.0, x.shape)
    field = Heightfield(z.astype(np.float32), 100.0, -3200.0, 2400.0)
    whole = NodeWindow(-24, 24, -32, 32)
    return Terrain(field, FRAME, field.whole, whole, np.zeros(z.shape, np.int16), ("made",))


@pytest.fixture(scope="module")
def camera():
    """A near camera: directions differ by 20 deg over the area."""
    return looking_camera(FRAME, np.array([2e3, -3e3, 12e3]), 60.0, (12e3, 12e3))


def test_brightness_uses_the_direction_of_each_point(terrain, camera) -> None:
    law = reflectance_model("hapke")
    seen = render_enu(terrain, SUN, camera_view(camera, FRAME), Method(model=law))
    moving = render_enu(terrain, SUN, sensor_view(Reduced(camera, 1), FRAME), Method(model=law))
    both = seen.visible & moving.visible
    assert both.mean() > 0.9
    assert np.allclose(seen.radiance[both], moving.radiance[both], rtol=1e-6)
    assert np.allclose(seen.emission_deg[both], moving.emission_deg[both], atol=1e-3)
    one_way = ParallelView(sensor_view(Reduced(camera, 1), FRAME).direction)
    parallel = render_enu(terrain, SUN, one_way, Method(model=law)).radiance
    assert np.abs(parallel[both] - seen.radiance[both]).max() > 1e-2 * seen.radiance[both].mean()


def test_occlusion_uses_the_direction_at_the_centre(terrain, camera) -> None:
    view = sensor_view(Reduced(camera, 1), FRAME)
    assert np.allclose(view.direction, camera_view(camera, FRAME).directions(np.zeros(3)))
    assert np.isclose(np.linalg.norm(view.direction), 1.0)


def test_the_view_of_a_camera_has_its_position(camera) -> None:
    assert sensor_view(camera, FRAME).camera is camera


def test_a_sensor_that_does_not_see_the_middle_is_refused(camera) -> None:
    class Blind(Reduced):
        def towards(self, points_mcmf_m):
            return np.full(np.shape(points_mcmf_m), np.nan)

    with pytest.raises(CameraError, match="does not see the centre"):
        sensor_view(Blind(camera, 1), FRAME)
