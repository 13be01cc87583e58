"""A NAC DTM that is made: craters and rolling ground of 2 m cells, as the archive's GeoTIFF with its label."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import rasterio

from .products import label_text

NAME, CELL_M = "NAC_DTM_APOLLO11", 2.0
EAST, SOUTH = -2374376.5, 18747.5  # the label's offsets, pixels
WEST_DEG, NORTH_DEG = 23.3722758, 1.2365388


def ground(cells: int, relief: float) -> np.ndarray:
    """Heights (cells, cells), metres; ``relief`` 1: slopes and craters of mare ground."""
    rng = np.random.default_rng(5)
    y, x = CELL_M * np.mgrid[0:cells, 0:cells]
    waves = np.fft.rfft2(rng.normal(size=(cells, cells)))
    k = np.hypot(np.fft.fftfreq(cells)[:, None], np.fft.rfftfreq(cells)[None])
    k[0, 0] = 1.0
    rolling = np.fft.irfft2(waves / k**1.8, (cells, cells))
    z = 4.0 * rolling / rolling.std()
    for _ in range(round(260 * (cells / 500) ** 2)):
        wide = np.exp(rng.uniform(np.log(8.0), np.log(160.0)))
        cx, cy = rng.uniform(0.0, CELL_M * cells, 2)
        r = np.hypot(x - cx, y - cy) / (0.5 * wide)
        bowl = np.where(r < 1.0, 0.16 * wide * (r**2 - 1.0), 0.0)
        z += rng.uniform(0.3, 1.0) * (bowl + 0.04 * wide * np.exp(-(((r - 1.0) / 0.25) ** 2)))
    return relief * z - 1900.0


def nac_dtm(folder: Path, cells: int, relief: float = 1.0) -> Path:
    """Write the product into a folder; the path of its label."""
    text = label_text(NAME)
    changed = {
        **dict.fromkeys(("LINE_LAST_PIXEL", "SAMPLE_LAST_PIXEL", "LINES", "LINE_SAMPLES"), cells),
        "MINIMUM_LATITUDE": f"{NORTH_DEG - cells / 15161.67521207:.7f}",
        "EASTERNMOST_LONGITUDE": f"{WEST_DEG + cells / 15159.37:.7f}",
    }
    for key, value in changed.items():
        text, count = re.subn(rf"(?m)^(\s*{key}\s*=\s*)\S+", rf"\g<1>{value}", text)
        assert count == 1, key
    crs = rasterio.CRS.from_proj4("+proj=eqc +lat_ts=1 +lon_0=180 +R=1737400 +units=m")
    west, north = CELL_M * (EAST - 0.5), CELL_M * (SOUTH + 0.5)
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": crs}
    profile |= {"height": cells, "width": cells, "nodata": -3.40282266e38}
    profile["transform"] = rasterio.Affine(CELL_M, 0.0, west, 0.0, -CELL_M, north)
    with rasterio.open(folder / f"{NAME}.TIF", "w", **profile) as file:
        file.write(ground(cells, relief).astype(np.float32), 1)
    (folder / f"{NAME}.LBL").write_text(text, encoding="ascii")
    return folder / f"{NAME}.LBL"
