"""A patch with a single hill at 0 N 0 E, a camera above it, and images that are its own render: the
simplest search.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from lcp_catalog.cameras.frame_camera import Camera
from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.geometry.frames import EnuFrame, direction_enu
from lcp_catalog.images.image import Image
from lcp_catalog.matching.templates import Templates, render_patches

from .match_frames import LAW
from .twins_match import catalog_of_patches, looking_at

HERE = EnuFrame(0.0, 0.0)
EAST = HERE.direction_to_mcmf(direction_enu(100, 30))
"""Direction to the Sun."""


@cache
def bump_catalog(nodes: int = 33) -> Catalog:
    """Nodes of 100 m, an odd number a side: one row."""
    middle = nodes // 2
    step = (np.arange(nodes) - middle) * 100.0
    east, north = np.meshgrid(step, -step)
    z = 250.0 * np.exp(-((east - 100) ** 2 + (north + 300) ** 2) / 7e5) + 60 * np.sin(
        east / 230
    ) * np.cos(north / 310)
    z -= z[middle, middle]
    return catalog_of_patches(z[None].astype(np.float32), [HERE], 100.0)


def above_it(**changes: float) -> Camera:
    """A camera 60 km above, with pixels of one cell; 160 x 160 pixels."""
    how = {"off_nadir_deg": 0.0, "azimuth_deg": 0.0, "roll_deg": 0.0, "focal_px": 600.0} | changes
    return looking_at(HERE, 60e3, size=(160, 160), **how)


def drawn(camera: Camera, sun: np.ndarray = EAST, nodes: int = 33) -> Templates:
    """The patch as the matcher renders it."""
    return render_patches(bump_catalog(nodes), [0], camera, sun[None], LAW)


def picture(
    camera: Camera,
    places: tuple[tuple[int, int], ...] = ((0, 0),),
    sun: np.ndarray = EAST,
    nodes: int = 33,
) -> np.ndarray:
    """The patch's own render at some offsets, on noise; with more nodes than 33 also its
    surroundings.
    """
    template = drawn(camera, sun, nodes)
    level = template.values[template.mask].mean()
    signal = level * (1 + 0.02 * np.random.default_rng(2).standard_normal(camera.shape))
    for right, down in places:
        col, row = template.origin[0] + (right, down)
        box = signal[row : row + template.shape[0], col : col + template.shape[1]]
        box[template.mask[0]] = template.values[template.mask]
    return signal.astype(np.float32)


def plain_photo(
    signal: np.ndarray, camera: Camera, sun: np.ndarray = EAST, weight: np.ndarray | None = None
) -> Image:
    weight = np.ones(signal.shape, np.float32) if weight is None else weight
    return Image("made up", signal.astype(np.float32), weight, camera, sun_direction_mcmf=sun)
