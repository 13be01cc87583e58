"""Heights that are hardly those of the Moon in metres: another unit, and missing pixels written as 0.

The least relief (highest less lowest height) of squares anywhere on the Moon is 8.5 m over 30 km, 35 m
over 60 km, 92 m over 100 km and 280 m over 200 km (LDEM_4, 30 S to 30 N), 9 m over 9.5 km and 20 m
over 20 km (WAC GLD100, 16 px/deg), 8 m over 2 km (Hadley, 256 px/deg); the greatest is 0.8 km over
1 km, 3.5 km over 5 km and 5.3 km over 10 km. Below that the maria, the smoothest ground, have slopes
of 2 deg in the median over 17 m (Rosenburg et al. 2011, J. Geophys. Res. 116, E02001). The limits
leave a factor of at least 1.4 to every one of these. No square of 3 x 3 pixels of the 50 million of
these products (and of a polar LDEM) holds zeros alone.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator

import numpy as np

from ..geometry.bounds import Bounds
from .dem import Dem
from .effective_resolution import sample_windows
from .mosaic import DemSet
from .pixel_statistics import pixel_km2, zeros_in_blocks

log = logging.getLogger(__name__)

_LEAST, _MOST = 2e-4, 2.0
"""Limits of a relief, per length of the side of a square with the area of the heights."""
_KM, _KM_SIDE_M = 11.0, 5000.0
"""Heights of the Moon in kilometres are within this range; over such a side, heights in metres are not."""


def doubts(dem: Dem, low_m: float, high_m: float, known: float, zeros: float) -> Iterator[str]:
    """What is doubtful about heights between ``low_m`` and ``high_m``, one line each. ``known`` and
    ``zeros``: the shares of the file's pixels that have a height and that lie in blocks of zeros.
    """
    grid = dem.grid
    pixels = known * grid.width * grid.height
    area_km2 = pixels * float(pixel_km2(grid, 0.5 * (grid.width - 1), 0.5 * (grid.height - 1)))
    side_m, relief_m = 1e3 * math.sqrt(area_km2), high_m - low_m
    seen = f"heights from {low_m:.5g} to {high_m:.5g} m over {side_m / 1e3:.3g} km"
    cure = "(UNIT in a label; gdal_translate -a_scale {} for a GeoTIFF)"
    if relief_m > 0.0 and max(-low_m, high_m) <= _KM and side_m >= _KM_SIDE_M:
        yield f"{seen} look like kilometres; declare the unit {cure.format(1000)}"
    elif not _LEAST * side_m <= relief_m <= _MOST * side_m:
        how = "flatter" if relief_m < side_m * _LEAST else "steeper"
        yield f"{seen} are {how} than any ground of the Moon; declare their unit {cure.format('FACTOR')}"
    if zeros:
        yield (
            f"{zeros:.2%} of the pixels lie in blocks of zeros, like missing data written as 0; declare it "
            "(MISSING_CONSTANT in a label; gdal_translate -a_nodata 0 for a GeoTIFF)"
        )


def warn_of_doubts(dems: DemSet, box: Bounds) -> None:
    """Log what is doubtful about the files in a box of longitudes and latitudes, by their sample windows
    (`effective_resolution.sample_windows`): all pixels of a small file, 16 million of a large one.
    """
    for dem in dems.dems:
        windows = [w.z_m for w in sample_windows(dem)] if dem.grid.bounds.meets(box) else []
        heights = np.concatenate([z[np.isfinite(z)] for z in windows]) if windows else np.zeros(0)
        if heights.size:
            share = 1.0 / sum(z.size for z in windows)
            zeros = share * sum(map(zeros_in_blocks, windows))
            low, high = float(heights.min()), float(heights.max())
            for text in doubts(dem, low, high, share * heights.size, zeros):
                log.warning("%s: %s", dem.path, text)
