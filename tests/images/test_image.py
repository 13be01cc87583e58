"""The renderer compared with a real image: Apollo 15 Metric frame AS15-M-0414 of Hadley, its camera and
its Sun.

The image is smoothed to the scale of the rendered cells and sampled at the projected nodes
(474 m apart, block means of the 118 m DEM). Every 16 x 16 window of nodes, step 16, whose nodes are
all visible and at least 8 pixels inside the frame (the frame's notched margin; nothing else is left
out) is compared by centred normalised correlation.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from helpers.random_scenes import without_shadows

from lcp_catalog.cameras.camera_file import read_camera
from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.geometry.frames import azimuth_elevation, direction_enu
from lcp_catalog.rendering.pipeline import prepare_terrain
from lcp_catalog.rendering.renderer import Method, render_enu
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.terrain.relief_bounds import nodes_enu

SAMPLE = Path(__file__).parents[2] / "sample_data"
DEM, PHOTO = SAMPLE / "hadley_gld100_256ppd.tif", SAMPLE / "AS15-M-0414.png"
CAMERA = SAMPLE / "AS15-M-0414_camera.json"
GSD_M = 474.0
MARGIN_PX = 8
WINDOW = 16


@dataclass
class Score:
    windows: int
    above: float  # share of the windows that correlate above 0.9
    above_textured: float  # the same of the half that has more contrast in the render
    whole: float  # correlation of all compared nodes


def score(image, render, compared):
    correlations, contrast = [], []
    for row in range(0, image.shape[0] - WINDOW + 1, WINDOW):
        for col in range(0, image.shape[1] - WINDOW + 1, WINDOW):
            here = np.s_[row : row + WINDOW, col : col + WINDOW]
            if compared[here].all():
                correlations.append(correlation(image[here], render[here]))
                contrast.append(render[here].std())
    good = np.array(correlations) > 0.9
    textured = np.array(contrast) >= np.median(contrast)
    whole = correlation(image[compared], render[compared])
    return Score(good.size, good.mean(), good[textured].mean(), whole)


def correlation(a, b):
    a, b = a - a.mean(), b - b.mean()
    scale = np.sqrt((a * a).sum() * (b * b).sum())
    return (a * b).sum() / scale if scale > 0 else 0.0


@pytest.fixture(scope="module")
def scene():
    return prepare_terrain(
        Request(DemSet.open([DEM]), gsd_m=GSD_M, view=ViewChoice(read_camera(CAMERA)))
    )


@pytest.fixture(scope="module")
def smooth():
    """The image, smoothed by a Gaussian whose full width at half maximum is two cells, the shortest
    wavelength on the grid.
    """
    camera = read_camera(CAMERA)
    pixel_m = (np.linalg.norm(camera.position_mcmf_m) - MOON_RADIUS_M) / camera.focal_length_px
    with rasterio.open(PHOTO) as file:
        image = file.read(1).astype(np.float32)
    return cv2.GaussianBlur(image, (0, 0), 2 * GSD_M / np.sqrt(8 * np.log(2)) / pixel_m)


@pytest.fixture(scope="module")
def ground(scene, smooth):
    """The image at the nodes, the render, and the mask of compared nodes."""
    camera, terrain = scene.camera, scene.terrain
    nodes = terrain.frame.to_mcmf(nodes_enu(terrain.field, terrain.core))
    column, row = np.moveaxis(camera.project(nodes).astype(np.float32), -1, 0)
    image = cv2.remap(smooth, column, row, cv2.INTER_CUBIC).astype(np.float64)
    render = scene.expose()
    width, height = camera.image_size_px
    inside = (column >= MARGIN_PX) & (column <= width - 1 - MARGIN_PX)
    inside &= (row >= MARGIN_PX) & (row <= height - 1 - MARGIN_PX)
    return image, np.nan_to_num(render.radiance), inside & render.visible


def rendered(scene, sun=None, **options):
    sun = scene.sun if sun is None else sun
    return np.nan_to_num(render_enu(scene.terrain, sun, scene.view, Method(**options)).radiance)


def test_render_correlates_with_the_image(ground):
    result = score(*ground)
    assert result.windows > 300
    assert result.above >= 0.65
    assert result.above_textured >= 0.94
    assert result.whole >= 0.78


def test_without_cast_shadows_it_is_clearly_worse(scene, ground):
    image, render, compared = ground
    plan = without_shadows(scene.terrain, scene.sun.vector, scene.view)
    lit = score(image, rendered(scene, plan=plan), compared)
    with_shadows = score(image, render, compared)
    assert lit.above < with_shadows.above - 0.08
    assert lit.above_textured < with_shadows.above_textured - 0.15
    assert lit.whole < with_shadows.whole - 0.05


@pytest.mark.parametrize("turn_deg", [-20.0, 20.0])
def test_with_the_sun_turned_it_is_clearly_worse(scene, ground, turn_deg):
    image, _, compared = ground
    azimuth, elevation = azimuth_elevation(scene.sun)
    turned = rendered(scene, direction_enu(azimuth + turn_deg, elevation))
    result = score(image, turned, compared)
    assert result.above < 0.4
    assert result.above_textured < 0.5


@pytest.mark.parametrize("axis", [0, 1])
def test_mirrored_it_is_another_place(ground, axis):
    image, render, compared = ground
    both = compared & np.flip(compared, axis)
    for a, b in ((np.flip(image, axis), render), (image, np.flip(render, axis))):
        result = score(a, b, both)
        assert result.above < 0.01
        assert abs(result.whole) < 0.1


def test_lit_from_behind_it_is_inverted(scene, ground):
    image, _, compared = ground
    azimuth, elevation = azimuth_elevation(scene.sun)
    opposite = rendered(scene, direction_enu(azimuth + 180.0, elevation))
    assert score(image, opposite, compared).whole < -0.5


def test_camera_plane_of_the_render_is_that_of_the_image(smooth):
    """Comparison in the camera's plane, pixel by pixel: windows of 16 x 16 pixels, the same margin."""
    request = Request(
        DemSet.open([DEM]), gsd_m=GSD_M, view=ViewChoice(read_camera(CAMERA)), in_camera_plane=True
    )
    render = prepare_terrain(request).expose()
    compared = np.zeros(smooth.shape, bool)
    compared[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] = True
    assert render.visible[compared].all()
    drawn = np.nan_to_num(render.radiance)
    result = score(smooth.astype(np.float64), drawn, compared)
    assert result.above >= 0.65
    assert result.above_textured >= 0.94
    assert result.whole >= 0.78
    for mirrored in (drawn[::-1], drawn[:, ::-1]):
        assert abs(score(smooth.astype(np.float64), mirrored, compared).whole) < 0.1
