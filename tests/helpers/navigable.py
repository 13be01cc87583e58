"""Catalogues whose points work everywhere, for tests of the accuracy of a position."""

from __future__ import annotations

import numpy as np

from lcp_catalog.catalog.catalogue import Catalog
from lcp_catalog.catalog.schema import summarise_usable

from . import catalogs


def everywhere_usable(count: int = 60, patch: int = 9, **spoilt: object) -> Catalog:
    """Points that work under all Suns and views, with ellipses of their own."""
    given = catalogs.arrays(count, patch) | spoilt
    rng = np.random.default_rng(7)
    shape = given["detection_probability"].shape
    condition = np.full(given["condition"].shape, 31, np.uint8)
    lowest, highest = summarise_usable(condition, given["sun_elevation"])
    axes = (slice(None), None, None, None, None)
    major = np.broadcast_to(rng.uniform(20.0, 120.0, count)[axes], shape)
    return Catalog(
        **given
        | {
            "condition": condition,
            "sun_elevation_min": lowest,
            "sun_elevation_max": highest,
            "detection_probability": np.broadcast_to(rng.uniform(0.95, 1.0, count)[axes], shape),
            "sigma_major": major,
            "sigma_minor": major * rng.uniform(0.3, 0.9, count)[axes],
            "sigma_angle": np.broadcast_to(rng.uniform(0.0, 179.0, count)[axes], shape),
        }
    )
