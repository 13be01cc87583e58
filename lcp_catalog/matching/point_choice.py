"""Which of a catalogue's points serve an image's Sun and view, and at which scale the image is best compared."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, Mask
from ..cameras.sensor import pixel_size_m
from ..catalog.catalogue import Catalog
from ..catalog.schema import USABLE
from ..images.image import Photo

RESOLUTION_SHARE = 0.5
"""Pixel of the photo that is searched, as a share of the DEM's true resolution."""
_WIDEST_PX = 48
"""Templates wider than this say no more than ones half as wide."""


def usable_now(catalog: Catalog, photo: Photo, points: ArrayLike | None = None) -> Mask:
    """Whether the condition of the catalogue that is nearest to the photo's Sun and view is usable, for each point, (n,).

    Nearest by the angle between directions, first of the views, then of the Suns of its grid.
    """
    rows = np.arange(len(catalog)) if points is None else np.asarray(points, dtype=np.int64)
    places, rotation = catalog.position_mcmf[rows], catalog.rotation_mcmf_to_enu[rows]
    sun = np.einsum("nij,nj->ni", rotation, photo.sun_directions(places))
    camera = np.einsum("nij,nj->ni", rotation, photo.sensor.towards(places))
    elevation, azimuth = np.meshgrid(catalog.sun_elevation, catalog.sun_azimuth, indexing="ij")
    suns = _directions(azimuth, elevation).reshape(-1, 3)
    views = _directions(catalog.view_azimuth, 90.0 - catalog.view_off_nadir)
    view = np.argmax(np.nan_to_num(camera, nan=-1.0) @ views.T, axis=1)
    nearest = np.argmax(sun @ suns.T, axis=1)
    condition = catalog.condition[rows, view].reshape(len(rows), -1)
    return np.asarray((condition[np.arange(len(rows)), nearest] & USABLE) == USABLE)


def _directions(azimuth_deg: Array, elevation_deg: Array) -> Array:
    """Unit east-north-up directions (..., 3)."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(elevation_deg)
    level = np.cos(elevation)
    return np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=-1)


def working_photo(
    catalog: Catalog, photo: Photo, points: ArrayLike, resolution_share: float = RESOLUTION_SHARE
) -> Photo:
    """The photo, reduced by the whole number that brings its pixel at the points nearest below ``resolution_share`` of the true
    resolution of their DEM (its cell, where that is coarser or nothing else is known), and templates to at most
    48 pixels a side.
    """
    rows = np.asarray(points, dtype=np.int64)
    if not len(rows):
        return photo
    pixel = float(np.nanmedian(pixel_size_m(photo.sensor, catalog.position_mcmf[rows])))
    gsd = float(np.median(catalog.gsd[rows]))
    resolution = np.asarray(catalog.dem_resolution, dtype=np.float64)[rows]
    known = np.isfinite(resolution)
    true = float(np.median(resolution[known])) if known.any() else gsd
    target = max(gsd, resolution_share * true)
    wide = gsd * catalog.patch_nodes / _WIDEST_PX
    factor = max(math.floor(target / pixel), math.ceil(wide / pixel), 1)
    return photo.reduced(factor)
