"""The patch of one surface point."""

from __future__ import annotations

import numpy as np

from lcp_catalog.dem.mosaic import DemSet
from lcp_catalog.terrain.terrain import Patch, sample_patches


def sample_patch(dems: DemSet, lon_deg: float, lat_deg: float, size: int, gsd_m: float) -> Patch:
    """`sample_patches` of one point."""
    return sample_patches(dems, np.array([lon_deg]), np.array([lat_deg]), size, gsd_m)[0]
