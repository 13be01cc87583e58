"""What tests of ``lcp render`` share: a small DEM and a camera over it to render, and what was written, read back by
rasterio alone.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import rasterio

from lcp_catalog.constants import MOON_RADIUS_M
from lcp_catalog.ephemeris.solar_position import direction_from_subsolar
from lcp_catalog.geometry.frames import EnuFrame

PIXELS_PER_DEGREE = 256
DEGREE_M = np.radians(1.0) * MOON_RADIUS_M
CYLINDER = pyproj.CRS.from_proj4(f"+proj=eqc +R={MOON_RADIUS_M} +units=m").to_wkt()
BANDS = ("radiance", "sunlit", "visible", "incidence", "emission", "phase")
SUN = ["--sun-azimuth", "100", "--sun-elevation", "20"]
AREA = ["--center", "30.5", "10.5", "--size", "8"]


def read(path: Path | str) -> tuple[dict[str, np.ndarray], Any, dict[str, str]]:
    """Bands by name, the profile, the tags."""
    with rasterio.open(path) as file:
        bands = dict(zip(file.descriptions, file.read(), strict=True))
        return bands, file.profile, file.tags()


def write_dem(path, z, west, north):
    """A cylindrical DEM of 256 pixels a degree whose north-west corner is given."""
    gsd = DEGREE_M / PIXELS_PER_DEGREE
    transform = rasterio.Affine(gsd, 0, west * DEGREE_M, 0, -gsd, north * DEGREE_M)
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=z.shape[1],
        height=z.shape[0],
        count=1,
        dtype="float32",
        nodata=-9999.0,
        crs=CYLINDER,
        transform=transform,
    ) as file:
        file.write(np.where(np.isnan(z), -9999, z).astype(np.float32), 1)
    return str(path)


def rolling(rows, cols):
    y, x = np.mgrid[0:rows, 0:cols]
    return 150 * np.sin(x / 7.0) * np.cos(y / 9.0) + 40 * np.sin(x / 2.3 + y / 3.1)


def camera_file(path, **changes):
    frame = EnuFrame(30.5, 10.5)
    document = {
        "position_mcmf_m": frame.to_mcmf([0, 0, 50e3]).tolist(),
        "rotation_mcmf_to_camera": (np.diag([1.0, -1, -1]) @ frame.rotation).tolist(),
        "focal_length_px": 400.0,
        "principal_point_px": [49.5, 39.5],
        "image_size_px": [100, 80],
        "sun_position_mcmf_m": (1.5e11 * direction_from_subsolar(80.0, 0.0)).tolist(),
    }
    path.write_text(json.dumps({k: v for k, v in (document | changes).items() if v is not None}))
    return str(path)
