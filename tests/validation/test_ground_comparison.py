"""Images compared with renders: places, light, albedo and cells, on synthetic images of the
sample's terrain.
"""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.catalogs import ALBEDO_MAP, HADLEY
from helpers.match_frames import simulated_image as simulated
from helpers.twins_match import catalog_of_dem, looking_at

from lcp_catalog.accuracy import TIERS
from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.cameras.sensor import Reduced
from lcp_catalog.catalog.patch_terrain import nodes_mcmf, patch_terrain
from lcp_catalog.dem.effective_resolution import of_file
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.errors import AreaError, ImageError
from lcp_catalog.geometry.frames import EnuFrame, direction_enu, lonlat_to_mcmf
from lcp_catalog.images.image import Image
from lcp_catalog.photometry.laws import reflectance_model
from lcp_catalog.rendering.request import Request, ViewChoice
from lcp_catalog.simulation.detector import Detector
from lcp_catalog.validation import ground_comparison
from lcp_catalog.validation.ground_comparison import (
    RenderSettings,
    WindowChoice,
    _of_one_size,
    _places,
    against_dem,
    against_patches,
    dem_request,
    rendered_cell_m,
    subsolar,
)
from lcp_catalog.validation.orthoimage import CoarseGrid, terrain_nodes

LAW = reflectance_model("lommel-seeliger")
STANDARD = TIERS["standard"]
SETTINGS = RenderSettings(LAW, STANDARD)
PLACE = EnuFrame(3.6, 26.1, -1500.0)
SUN = PLACE.direction_to_mcmf(direction_enu(97.0, 25.0))
ROWS = np.arange(9)


@pytest.fixture(scope="module")
def catalog():
    along = np.linspace(-0.15, 0.15, 3)
    lon, lat = (grid.ravel() for grid in np.meshgrid(PLACE.lon_deg + along, PLACE.lat_deg + along))
    return catalog_of_dem(lon, lat, 33, 118.45)


@pytest.fixture(scope="module")
def camera() -> Camera:
    plain = looking_at(PLACE, 50e3, 8.0, 120.0, 20.0, 420.0, (230, 240))
    return Camera(**plain.to_json() | {"sun_position_mcmf_m": PLACE.origin_mcmf_m + 1.5e11 * SUN})


@pytest.fixture(scope="module")
def photo(camera) -> Image:
    request = Request(
        DemSet.open([HADLEY]), view=ViewChoice(camera), model=LAW, accuracy=STANDARD, disc=False
    )
    return simulated(request, Detector(blur_px=0.4, noise=0.0, bits=14, seed=1))


def test_a_patch_as_terrain_lies_where_its_nodes_are(catalog) -> None:
    for row in (0, 4, 8):
        away = terrain_nodes(patch_terrain(catalog, row)) - nodes_mcmf(catalog, [row])[0]
        assert np.abs(away).max() < 1e-6


@pytest.mark.slow
def test_every_window_has_its_place(photo) -> None:
    """The centre of a window, projected into the image, is the mean of the pixels of its corners;
    cells are as given.
    """
    found = against_dem(photo, DemSet.open([HADLEY]), SETTINGS, WindowChoice(16, 16, 300.0))
    places = lonlat_to_mcmf(found.longitude_deg, found.latitude_deg)
    assert found.windows.gsd_m == 300.0
    assert photo.sensor.in_image(photo.sensor.project(places)).mean() > 0.95
    east = PLACE.from_mcmf(places)[:, 0]
    order = np.unique(found.windows.col)
    step = np.median(
        [
            np.median(east[found.windows.col == b]) - np.median(east[found.windows.col == a])
            for a, b in itertools.pairwise(order)
        ]
    )
    assert step == pytest.approx(16 * 300.0, rel=0.03)


@pytest.fixture
def sharp(monkeypatch):
    """Treat the DEM as sharp as its cells, which is true for an image made from it."""

    def as_posted(dem):
        return replace(of_file(dem), point_spread_m=0.0)

    monkeypatch.setattr(ground_comparison, "of_file", as_posted)


@pytest.mark.slow
@pytest.mark.parametrize("gsd_m", [240.0, 118.45, 80.0])
def test_a_render_of_the_same_dem_is_the_image(photo, sharp, gsd_m) -> None:
    """80 m: finer than the DEM, which is then rendered at 80 m."""
    windows = against_dem(
        photo, DemSet.open([HADLEY]), SETTINGS, WindowChoice(16, 16, gsd_m)
    ).windows
    assert windows.gsd_m == gsd_m
    assert windows.count > 30
    assert windows.share_above(0.95) > 0.95
    assert np.nanmedian(np.abs(windows.offset_px)) < 0.1


def test_an_offset_of_the_whole_image_is_removed_where_it_is_asked_for(
    photo, camera, sharp
) -> None:
    """A camera with a position error of 480 m to the east: two cells of 240 m. The spacing of the
    windows is as given.
    """
    east = PLACE.direction_to_mcmf([1.0, 0.0, 0.0])
    wrong = photo.with_sensor(camera.moved([*(480.0 * east), 0.0, 0.0, 0.0]))
    windows = against_dem(
        wrong, DemSet.open([HADLEY]), SETTINGS, WindowChoice(16, 8, 240.0, remove_offset=True)
    ).windows
    assert windows.offset == "removed"
    assert windows.shift_px == pytest.approx((2.0, 0.0), abs=0.15)
    assert windows.share_above(0.9) > 0.9
    assert windows.step == 8
    assert set(np.unique(windows.row % 16)) == {0, 8}


@pytest.mark.parametrize(
    ("posting_m", "target_m", "cell_m"),
    [
        (118.0, 948.0, 472.0),
        (474.0, 948.0, 474.0),
        (474.0, 1000.0, 474.0),
        (474.0, 600.0, 474.0),
        (474.0, 474.0, 474.0),
        (474.0, 80.0, 80.0),
    ],
)
def test_renders_are_twice_as_fine_as_windows_on_whole_multiples_of_the_posting(
    posting_m, target_m, cell_m
) -> None:
    assert rendered_cell_m(posting_m, target_m) == cell_m


def test_without_smoothing_the_image_keeps_what_the_dem_has_smoothed_away(photo) -> None:
    """An image made from the DEM: plain area means agree, though the smoothed image does not."""
    found = against_dem(photo, DemSet.open([HADLEY]), SETTINGS, WindowChoice(16, 16, 240.0))
    assert found.plain.share_above(0.95) > 0.95 > found.windows.share_above(0.95)
    assert found.plain.gsd_m == found.windows.gsd_m


def test_what_the_dem_has_smoothed_away_the_image_loses_too(photo) -> None:
    """An image made from the DEM already lacks its detail and is smoothed again: less similar than
    the sharp render, but similar. The file resolves 1000 m, four cells of the windows.
    """
    windows = against_dem(
        photo, DemSet.open([HADLEY]), SETTINGS, WindowChoice(16, 16, 240.0)
    ).windows
    assert 0.45 < windows.share_above(0.95) < 0.9
    assert windows.share_above(0.8) > 0.9


def test_without_a_size_cells_are_those_of_the_true_resolution(photo) -> None:
    found = against_dem(photo, DemSet.open([HADLEY]), SETTINGS)
    assert (
        700.0 < found.windows.gsd_m < 1300.0
    )  # GLD100's published 1 to 1.5 km, and half of a wave of 2 km
    assert "wave" in found.resolution


def test_an_image_smaller_than_a_window_says_so(photo) -> None:
    with pytest.raises(
        ImageError, match=r"shows \d+ x \d+ cells of 6000 m, and a window has 16 x 16"
    ):
        against_dem(photo, DemSet.open([HADLEY]), SETTINGS, WindowChoice(16, 16, 6000.0))


def test_under_another_sun_it_is_another_image(photo) -> None:
    turned = PLACE.direction_to_mcmf(direction_enu(160.0, 25.0))
    other = Image("turned", photo.signal, photo.weight, photo.sensor, sun_direction_mcmf=turned)
    choice = WindowChoice(16, 16, 240.0)
    assert (
        against_dem(other, DemSet.open([HADLEY]), SETTINGS, choice).windows.share_above(0.9) < 0.3
    )


def test_patches_are_the_image_too(photo, catalog) -> None:
    found = against_patches(photo, catalog, ROWS, SETTINGS)
    assert found.windows.count == 9 * 4
    assert found.windows.gsd_m == pytest.approx(118.45)
    assert found.windows.share_above(0.95) > 0.9
    assert sorted(set(found.point)) == ROWS.tolist()
    assert np.allclose(found.longitude_deg, catalog.longitude[found.point])


def test_a_patch_that_lies_half_in_a_gap_is_left_out(photo, catalog) -> None:
    """Every window keeps its point."""
    corner = photo.sensor.project(nodes_mcmf(catalog, [3])[0, 2, 2]).round().astype(int)
    weight = photo.weight.copy()
    weight[corner[1] - 3 : corner[1] + 4, corner[0] - 3 : corner[0] + 4] = 0.0
    found = against_patches(replace(photo, weight=weight), catalog, ROWS, SETTINGS)
    assert sorted(set(found.point)) == [0, 1, 2, 4, 5, 6, 7, 8]
    assert found.against == "8 patches of the catalogue"


def test_of_patches_with_different_cells_the_most_common_are_taken() -> None:
    made = SimpleNamespace(gsd=np.array([100.0, 250.0, 100.0, 40.0, 100.0, 250.0]))
    common, rows = _of_one_size(made, np.array([1, 2, 3, 4, 5, 0]))
    assert (common, rows.tolist()) == (100.0, [2, 4, 0])
    common, rows = _of_one_size(made, np.array([1, 2, 5]))
    assert (common, rows.tolist()) == (250.0, [1, 5])


def test_a_window_lies_at_the_node_nearest_to_its_middle() -> None:
    """Cells of 4 nodes, the first around node 1.5; windows of 5 cells begin at rows 0 and 3,
    columns 2 and 7.
    """
    lon, lat = np.meshgrid(np.linspace(10.0, 10.59, 60), np.linspace(20.0, 19.51, 50))
    found = SimpleNamespace(size=5, row=np.array([0, 3]), col=np.array([2, 7]))
    pair = SimpleNamespace(grid=CoarseGrid.over(lon.shape, 4.0))
    at = _places(lonlat_to_mcmf(lon, lat), pair, found)
    # middles at nodes 1.5 + 4 (first + 2): rows 9.5 and 21.5, columns 17.5 and 37.5
    np.testing.assert_allclose(at[0], [10.175, 10.375], atol=0.0051)
    np.testing.assert_allclose(at[1], [19.905, 19.785], atol=0.0051)


def test_a_patch_s_albedo_is_in_its_render(photo, catalog) -> None:
    """A spot that is only in the catalogue's albedo lowers the correlation."""

    row, col = np.mgrid[-16:17, -16:17]
    spots = 1.0 + 2.0 * (np.hypot(row - 4, col + 5) < 6)
    albedo = np.broadcast_to(spots.astype(np.float32), catalog.dem.shape)
    spotted = replace(catalog, albedo=albedo, albedo_map=ALBEDO_MAP)
    plain, with_spots = (
        against_patches(photo, which, ROWS, SETTINGS).windows for which in (catalog, spotted)
    )
    assert with_spots.median < plain.median - 0.2


def test_patches_finer_than_they_are_are_refused(photo, catalog) -> None:
    with pytest.raises(AreaError, match=r"finer than those of the patches, 118\.45 m"):
        against_patches(photo, catalog, ROWS, SETTINGS, WindowChoice(gsd_m=60.0))


def test_coarse_cells_make_a_patch_one_window(photo, catalog) -> None:
    found = against_patches(photo, catalog, ROWS, SETTINGS, WindowChoice(gsd_m=355.0))
    assert found.windows.size == 11
    assert found.windows.count == 9
    assert "windows of 11 cells" in found.resolution


def test_no_patch_in_the_image_is_said(photo, catalog) -> None:
    away = photo.sensor.moved([0.0, 6e4, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(AreaError, match="no patch of the catalogue is entirely"):
        against_patches(photo.with_sensor(away), catalog, ROWS, SETTINGS)


def test_the_sun_of_the_image_lights_the_render(photo, camera) -> None:
    kept = dem_request(photo, DemSet.open([HADLEY]), SETTINGS)
    assert np.allclose(kept.sun.direction_mcmf(PLACE, kept.view.camera), SUN, atol=1e-9)
    stated = Image("stated", photo.signal, photo.weight, camera, sun_direction_mcmf=SUN)
    asked = RenderSettings(LAW, STANDARD, disc=True, bounce="on")
    request = dem_request(photo, DemSet.open([HADLEY]), asked)
    assert (request.disc, request.bounce, kept.bounce) == (True, "on", "off")
    by_flag = dem_request(stated, DemSet.open([HADLEY]), SETTINGS)
    assert np.allclose(by_flag.sun.direction_mcmf(PLACE, by_flag.view.camera), SUN, atol=1e-9)
    lon, lat = subsolar(stated)
    assert np.allclose(lonlat_to_mcmf(lon, lat) / 1737400.0, SUN)


def test_a_reduced_sensor_is_taken_whole(camera) -> None:
    assert Reduced(Reduced(camera, 2), 3).full is camera
