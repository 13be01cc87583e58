"""A catalogue of several levels in an image: the points whose cells suit its pixels."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.posed import HADLEY
from helpers.small_world import overhead
from helpers.twins_match import catalog_of_patches

from lcp_catalog.catalog.hdf5 import Catalog
from lcp_catalog.geometry.frames import EnuFrame
from lcp_catalog.images.image import Image
from lcp_catalog.matching.point_choice import at_one_scale, working_image

UP = HADLEY.rotation[2]
CELLS_M = (100.0, 200.0, 400.0)


def levels(counts: tuple[int, ...], coarsest: float = 2.0) -> Catalog:
    """Flat patches around Hadley, so many of each level; ``coarsest``: greatest pixel over cell."""
    gsd = np.repeat(CELLS_M, counts)
    dice = np.random.default_rng(1)
    frames = [
        EnuFrame(HADLEY.lon_deg + x, HADLEY.lat_deg + y)
        for x, y in dice.uniform(-0.2, 0.2, (len(gsd), 2))
    ]
    return catalog_of_patches(
        np.zeros((len(gsd), 17, 17), np.float32),
        frames,
        1.0,
        gsd=gsd,
        gsd_min=gsd,
        gsd_max=coarsest * gsd,
        level=np.searchsorted(CELLS_M, gsd).astype(np.int32),
    )


@pytest.mark.parametrize(
    ("pixel_m", "counts", "used"),
    [
        (10.0, (8, 4, 2), {0}),  # reduced to the finest
        (100.0, (8, 4, 2), {0}),
        (150.0, (8, 4, 2), {0}),
        (250.0, (8, 4, 2), {1}),
        (390.0, (8, 4, 2), {1}),
        (700.0, (8, 4, 2), {2}),
        (900.0, (8, 4, 2), {0, 1, 2}),  # too coarse for all: as without levels
        (10.0, (1, 1, 8), {1, 2}),  # too few of the finest: reduced to the coarsest
        (10.0, (3, 4, 2), {0, 1}),  # seven at 200 m, six at 400 m; three at 100 m are too few
        (10.0, (0, 5, 0), {1}),
        (900.0, (0, 5, 0), {1}),
    ],
)
def test_points_of_the_levels_that_suit_the_pixel(
    pixel_m: float, counts: tuple[int, ...], used: set[int]
) -> None:
    catalog = levels(counts)
    camera = overhead(pixel_m=pixel_m)
    rows = at_one_scale(catalog, np.arange(len(catalog)), camera)
    np.testing.assert_array_equal(rows, np.flatnonzero(np.isin(catalog.level, list(used))))


def test_the_image_is_searched_at_the_scale_of_the_coarsest_level() -> None:
    catalog = levels((8, 4, 2))
    blank = np.ones((200, 200), np.float32)
    image = Image("blank", blank, blank, overhead(pixel_m=10.0), sun_direction_mcmf=UP)
    fine, both = np.arange(8), np.arange(12)
    assert working_image(catalog, image, fine).sensor.factor == 10
    assert working_image(catalog, image, both).sensor.factor == 20
