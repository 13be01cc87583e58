"""The map of a set of files, checked by its decoded pixels."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from helpers.bare_files import cylinder, polar
from helpers.products import DEGREE_M, geotiff, holed

from lcp_catalog.dem.coverage_map import GAP, HOLE, INK, PRODUCT_COLOURS, set_map, view_of
from lcp_catalog.dem.dem import Dem
from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.dem.pixel_statistics import height_statistics
from lcp_catalog.plots.pictures import draw_text, width_px


def picture(dems: list[Dem], missing: bool = False) -> np.ndarray:
    """Rows, columns, RGB of the PNG, decoded by GDAL."""
    surveys = [height_statistics(dem) for dem in dems] if missing else None
    with (
        rasterio.MemoryFile(set_map(DemSet(tuple(dems)), surveys)) as memory,
        memory.open() as file,
    ):
        return np.moveaxis(file.read(), 0, -1)


def middle(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """x (right), y (up) of the mean of a colour's pixels, but for the legend below."""
    rows, columns = np.nonzero((image == np.array(colour, np.uint8)).all(axis=-1)[:-60])
    assert rows.size > 50
    return np.array([columns.mean(), -rows.mean()])


@pytest.mark.parametrize(
    ("pole", "lon", "direction"),
    [  # the LOLA convention: 90 E on the right; 0 below the north pole, above the south pole
        (1, 90.0, (1, 0)), (1, 0.0, (0, -1)), (1, 180.0, (0, 1)), (1, 270.0, (-1, 0)),
        (-1, 90.0, (1, 0)), (-1, 0.0, (0, 1)), (-1, 180.0, (0, -1)), (-1, -90.0, (-1, 0)),
    ],
)  # fmt: skip
def test_a_polar_map_has_the_orientation_of_lola(
    pole: int, lon: float, direction: tuple[int, int]
) -> None:
    """A tile of 8 degrees around 81 deg on a ring from 75 to the pole: its direction and distance from the ring's middle."""
    low, high = sorted((75 * pole, 90 * pole))
    tile = cylinder(
        lon - 4, min(79 * pole, 83 * pole), lon + 4, max(79 * pole, 83 * pole), 16, "TILE"
    )
    image = picture([tile, cylinder(0, low, 360, high, 4, "RING")])
    blue, orange = PRODUCT_COLOURS[:2]
    stripe = tuple(int(v) + (255 - int(v)) * 55 // 100 for v in blue)
    away = 0.5 * (middle(image, blue) + middle(image, stripe)) - middle(image, orange)
    ring = (image == np.array(orange, np.uint8)).all(axis=-1)[:-60]
    radius = np.ptp(np.nonzero(ring)[1]) / 2.0
    expected = radius * math.tan(math.radians(9.0) / 2.0) / math.tan(math.radians(15.0) / 2.0)
    assert away == pytest.approx(expected * np.array(direction), abs=5.0)


def at(image: np.ndarray, lon: float, lat: float) -> tuple[int, ...]:
    """Colour of the global map, 720 x 360 pixels right of 46 and below 20, at a place."""
    return tuple(int(v) for v in image[20 + int((90.0 - lat) * 2.0), 46 + int((lon + 180.0) * 2.0)])


@pytest.mark.parametrize(
    "dem", [polar(-90, 20, 300, 200, -1), polar(-90, 20, 300, 200), cylinder(350, 10, 370, 50)]
)
def test_a_view_finds_its_pixels_again(dem: Dem) -> None:
    view = view_of([dem.grid], dem.grid.bounds)
    x, y = np.meshgrid(np.arange(0, view.width, 7), np.arange(0, view.height, 7))
    back = view.pixel(*view.lonlat(x, y))
    assert np.allclose(back[0], x, atol=1e-6)
    assert np.allclose(back[1], y, atol=1e-6)


def test_a_global_map(tmp_path: Path) -> None:
    heights = np.zeros((180, 360), np.float32)
    heights[20:40, 40:60] = -32768.0  # 50..70 N, 140..120 W
    whole = Dem.open(
        geotiff(
            tmp_path / "whole.tif",
            heights,
            -180 * DEGREE_M,
            90 * DEGREE_M,
            DEGREE_M,
            nodata=-32768.0,
        )
    )
    other = np.zeros((80, 160), np.float32)
    tile = Dem.open(
        geotiff(tmp_path / "tile.tif", other, 100 * DEGREE_M, -20 * DEGREE_M, DEGREE_M / 4)
    )
    image = picture([whole, tile], missing=True)
    blue, orange = PRODUCT_COLOURS[:2]
    light = tuple(v + (255 - v) * 55 // 100 for v in orange)
    assert at(image, 3.3, 3.3) == at(image, -176.7, -86.7) == at(image, 176.7, 86.7) == blue
    assert at(image, -131.7, 61.7) == HOLE
    assert at(image, -131.7, 48.3) == at(image, -118.3, 61.7) == blue
    found = {at(image, lon, -27.7) for lon in np.arange(101.0, 119.0, 0.5)}
    assert found == {orange, light}
    assert at(image, 141.7, -27.7) == at(image, 111.7, -42.7) == blue
    assert {at(image, -0.3, 33.3), at(image, 0.3, 33.3)} != {
        blue
    }  # a meridian lets it show through


def test_heights_show_as_relief(tmp_path: Path) -> None:
    """A cone of 2 degrees on level ground: light on its north-west, dark on its south-east, and the
    colour of its product around it; without pixels no relief.
    """
    x, y = np.meshgrid(np.arange(160) - 79.5, np.arange(160) - 79.5)
    heights = np.maximum(1000.0 - 30.0 * np.hypot(x, y), 0.0).astype(np.float32)
    dem = Dem.open(
        geotiff(tmp_path / "CONE.tif", heights, 10 * DEGREE_M, 5 * DEGREE_M, DEGREE_M / 16)
    )
    image = picture([dem], missing=True).astype(np.int64)
    rows, columns = np.nonzero((image == PRODUCT_COLOURS[0]).all(axis=-1)[:-60])
    row, column = (round((at.min() + at.max()) / 2) for at in (rows, columns))
    side = round((rows.max() - rows.min()) / 160 * 16)  # half of the cone's radius
    north_west, south_east = image[row - side, column - side], image[row + side, column + side]
    assert (north_west > np.array(PRODUCT_COLOURS[0])).all()
    assert (south_east[1:] < 0.8 * np.array(PRODUCT_COLOURS[0])[1:]).all()
    level = picture([dem])
    assert (level[row - side, column - side] == PRODUCT_COLOURS[0]).all()


def test_a_regional_map_is_zoomed() -> None:
    """Two tiles, north-west and south-east of each other: most of the picture is their box, grey between."""
    image = picture([cylinder(350, 10, 360, 20, 16, "WEST"), cylinder(0, 0, 10, 10, 16, "EAST")])
    blue, orange = PRODUCT_COLOURS[:2]
    step = middle(image, orange) - middle(image, blue)
    assert step[0] > 150
    assert step[1] < -150
    assert step[0] == pytest.approx(-step[1], rel=0.03)  # near the equator: degrees are alike
    grey = (image == np.array(GAP, np.uint8)).all(axis=-1)[:-60].mean()
    assert 0.25 < grey < 0.6


def test_a_hole_is_filled_by_another_file(tmp_path: Path) -> None:
    args = ((160, 160), 10 * DEGREE_M, 20 * DEGREE_M, DEGREE_M / 16)
    fine = Dem.open(holed(tmp_path / "FINE.tif", args[0], [np.s_[20:60, 20:60]], *args[1:]))
    coarse = Dem.open(
        holed(tmp_path / "COARSE.tif", (80, 80), [np.s_[10:20, 10:20]], *args[1:3], DEGREE_M / 8)
    )
    image = picture([fine, coarse], missing=True)
    blue, orange = PRODUCT_COLOURS[:2]

    def extent(colour: tuple[int, int, int]) -> np.ndarray:
        """First and last row of a colour in the map, as shares of the fine file's 10 degrees."""
        rows = np.nonzero((image == np.array(colour, np.uint8)).all(axis=-1)[:-80])[0]
        return np.array([rows.min(), rows.max() + 1.0])

    top, bottom = extent(blue)
    assert (extent(HOLE) - top) / (bottom - top) == pytest.approx([0.125, 0.25], abs=0.01)
    assert (extent(orange) - top) / (bottom - top) == pytest.approx([0.125, 0.375], abs=0.01)


def test_labels_stand_at_their_lines() -> None:
    """Words are found by their own pixels on white: 60 N beside its row, 90 E below its column."""
    image = picture([cylinder(-180, -90, 180, 90, 4)])

    def found(text: str) -> list[tuple[int, int]]:
        word = np.full((12, width_px(text), 3), 255, np.uint8)
        draw_text(word, 0, 1, text, INK)
        assert (word < 128).any()
        fits = np.argwhere(cv2.matchTemplate(image, word, cv2.TM_SQDIFF_NORMED) < 1e-3)
        return [(int(r) + 6, int(c) + word.shape[1] // 2) for r, c in fits]

    (row, column), (_, across) = found("60 N")[0], found("90 E")[0]
    assert abs(row - (20 + 60)) <= 2
    assert column < 46
    assert abs(across - (46 + 540)) <= 2
    assert found("60 S")
    assert found("LDEM_16")  # the legend
    assert not found("LDEM_17")


def test_the_same_set_gives_the_same_bytes() -> None:
    dems = DemSet((cylinder(0, 75, 360, 90, 4), polar(-100, -100, 50, 50)))
    assert set_map(dems) == set_map(dems)
