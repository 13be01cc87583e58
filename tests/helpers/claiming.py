"""Catalogues with plain claims: every second point usable, the same at every Sun and view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.maps import usable_nearby
from lcp_catalog.catalog.schema import USABLE, summarise_usable
from lcp_catalog.landmarks.selection import Places

from .catalogs import ERRORS

USABLE_AT, OTHERS_AT = 0.96, 0.2
"""Claimed probability of the usable points and of the others."""


def claiming(plain: Catalog, sigma_m: float, search_m: float) -> Catalog:
    """The points of a catalogue with claims: the even ones usable, 1 sigma north and half as much east;
    pixels of up to two cells; views straight down and 30 deg from north-east and south-west.
    """
    shape = plain.condition.shape
    even = (np.arange(len(plain)) % 2 == 0)[:, None, None, None]
    condition = np.where(np.broadcast_to(even, shape), USABLE, USABLE - 4).astype(np.uint8)
    lowest, highest = summarise_usable(condition, plain.sun_elevation)
    cells = plain.coverage
    nearby = usable_nearby(
        Places(cells.longitude, cells.latitude),
        Places(plain.longitude, plain.latitude),
        condition,
        cells.spacing_m,
    )
    two = (len(plain), 2, *shape[1:])
    return replace(
        plain,
        config=f"[points]\nsearch_m = {search_m}\n",
        condition=condition,
        sun_elevation_min=lowest,
        sun_elevation_max=highest,
        view_azimuth=np.array([0.0, 60.0, 240.0]),
        image_scale=np.array([1.0, 2.0]),
        detection_probability=np.broadcast_to(np.where(even, USABLE_AT, OTHERS_AT)[:, None], two),
        sigma_major=np.full(two, sigma_m),
        sigma_minor=np.full(two, sigma_m / 2.0),
        sigma_angle=np.zeros(two),
        errors=dict(ERRORS) | {"albedo_sigma": 0.0},  # relief shows alike under every Sun and view
        coverage=replace(cells, usable=nearby),
    )
