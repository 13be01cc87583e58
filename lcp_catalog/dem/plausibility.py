"""Heights that are hardly those of the Moon in metres: another unit, and missing pixels written as 0 or as another height.

The least relief (highest less lowest height) of squares anywhere on the Moon is 8.5 m over 30 km, 35 m
over 60 km, 92 m over 100 km and 280 m over 200 km (LDEM_4, 30 S to 30 N), 9 m over 9.5 km and 20 m
over 20 km (WAC GLD100, 16 px/deg), 8 m over 2 km (Hadley, 256 px/deg); the greatest is 0.8 km over
1 km, 3.5 km over 5 km and 5.3 km over 10 km. Below that the maria, the smoothest ground, have slopes
of 2 deg in the median over 17 m (Rosenburg et al. 2011, J. Geophys. Res. 116, E02001). The limits
leave a factor of at least 1.4 to every one of these. Lines of equal heights: `pixel_statistics.stuck_pixels`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Hashable, Iterator
from functools import lru_cache

import numpy as np

from ..constants import MOON_RADIUS_M
from ..errors import DemError
from ..geometry.bounds import Bounds
from ..remote_files import url_of
from .dem import Dem
from .effective_resolution import sample_windows
from .mosaic import DemSet
from .pixel_statistics import HeightStatistics, Stuck, narrowness, pixel_km2, stuck_pixels

log = logging.getLogger(__name__)

_LEAST, _MOST = 2e-4, 2.0
"""Limits of a relief, per length of the side of a square with the area of the heights."""
_KM, _KM_SIDE_M = 11.0, 5000.0
"""Heights of the Moon in kilometres are within this range, and its radii as far from that of the sphere; over such a side,
heights in metres are not.
"""
_FETCH = "an incomplete download; fetch the file again"
ALL_ZERO = f"every pixel is zero: {_FETCH}"
"""What is said of a file without any other height: `file_check` calls it unsound, a build refuses it, others warn."""
_SEEN_ZERO = f"every pixel that was looked at is zero: {_FETCH}"


def doubts(
    dem: Dem, low_m: float, high_m: float, pixels: int, known: int, stuck: Stuck
) -> Iterator[str]:
    """What is doubtful about heights between ``low_m`` and ``high_m``, one line each. Of so many ``pixels`` so many have
    a height.
    """
    grid = dem.grid
    if low_m == high_m == 0.0 and known == pixels:
        whole = pixels == grid.width * grid.height
        yield ALL_ZERO if whole else _SEEN_ZERO
        return
    area_km2 = known / pixels * grid.width * grid.height
    area_km2 *= float(pixel_km2(grid, 0.5 * (grid.width - 1), 0.5 * (grid.height - 1)))
    side_m, relief_m = 1e3 * math.sqrt(area_km2), high_m - low_m
    seen = f"heights from {low_m:.5g} to {high_m:.5g} m over {side_m / 1e3:.3g} km"
    cure = "(UNIT in a label; gdal_translate -a_scale {} for a GeoTIFF)"
    radius_km, flat = 1e-3 * MOON_RADIUS_M, relief_m < _LEAST * side_m
    if relief_m > 0.0 and max(-low_m, high_m) <= _KM and side_m >= _KM_SIDE_M:
        yield f"{seen} look like kilometres; declare the unit {cure.format(1000)}"
    elif max(radius_km - low_m, high_m - radius_km) <= _KM and (flat or side_m >= _KM_SIDE_M):
        declared = f"(gdal_translate -a_scale 1000 -a_offset {-MOON_RADIUS_M:.0f} for a GeoTIFF)"
        yield f"{seen} look like radii in kilometres; declare the unit and the offset {declared}"
    elif flat or relief_m > _MOST * side_m:
        how = "flatter" if flat else "steeper"
        yield f"{seen} are {how} than any ground of the Moon; declare their unit {cure.format('FACTOR')}"
    declare = "declare it (MISSING_CONSTANT in a label; gdal_translate -a_nodata {} for a GeoTIFF)"
    if stuck.zeros:
        yield (
            f"{_percent(stuck.zeros / pixels)} % of the pixels lie in lines or blocks of zeros, like missing data written as 0; "
            f"{declare.format(0)}"
        )
    if stuck.others and relief_m > 0.0:
        yield (
            f"{_percent(stuck.others / pixels)} % of the pixels lie in lines of equal heights, longer than those of any "
            f"ground, like missing data written as a height; {declare.format('HEIGHT')}"
        )


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f}" if share >= 0.1 else f"{100.0 * share:.2g}"


def warn_of_doubts(dems: DemSet, box: Bounds, side: int = 256) -> None:
    """Log what is doubtful about the local files in a box of longitudes and latitudes, by sample windows of at most ``side``
    pixels (`effective_resolution.sample_windows`): all pixels of a small file, 16 windows of a large one.
    """
    for dem in dems.dems:
        if dem.grid.bounds.meets(box) and url_of(dem.path) is None:
            for text in _doubts_of(dem, side, dem.identity):
                log.warning("%s: %s", dem.path, text)


def refuse_zeros(dems: DemSet, box: Bounds, side: int) -> None:
    """DemError for a file in a box, degrees, whose pixels are all zero. Sample windows (`warn_of_doubts`) are read until another
    height is found; where they hold none all pixels of a local file, and those in the box of one on a server.
    """
    for dem in dems.dems:
        if not dem.grid.bounds.meets(box) or any(z.any() for z, *_ in sample_windows(dem, side)):
            continue
        url = url_of(dem.path)
        row0, row1, col0, col1 = (
            _in_box(dem, box) if url else (0, dem.grid.height, 0, dem.grid.width)
        )
        blocks = (dem.read(row, min(row + 64, row1), col0, col1) for row in range(row0, row1, 64))
        if not any(block.any() for block in blocks):
            raise DemError(f"{url or dem.path}: {_SEEN_ZERO if url else ALL_ZERO}")


def _in_box(dem: Dem, box: Bounds) -> tuple[int, int, int, int]:
    """First row and column, and those after the last, of a file's pixels in a box that meets it, by a lattice of places."""
    both = box.common(dem.grid.bounds) or dem.grid.bounds
    lon, lat = np.linspace(both.west, both.east, 65), np.linspace(both.south, both.north, 65)
    inside, *pixel = dem.grid.located(*np.meshgrid(lon, lat))
    if not inside.any():
        return 0, dem.grid.height, 0, dem.grid.width
    ends = []
    for at, size in zip(pixel[::-1], (dem.grid.height, dem.grid.width), strict=True):
        beside = 1.0 + np.ptp(at[inside]) / 32.0  # more than from place to place
        low, high = at[inside].min() - beside, at[inside].max() + beside
        ends += [max(0, math.floor(low)), min(size, math.ceil(high) + 1)]
    return ends[0], ends[1], ends[2], ends[3]


def warn_of_all_heights(dem: Dem, found: HeightStatistics | None) -> None:
    """The same by all pixels of a file; without them (None) by its size alone."""
    texts = [dem.too_small] if dem.too_small else []
    if found and found.min_m is not None and found.max_m is not None and not texts:
        pixels = dem.grid.width * dem.grid.height
        known = pixels - int(found.missing.sum())
        texts = list(doubts(dem, found.min_m, found.max_m, pixels, known, found.stuck))
    for text in texts:
        log.warning("%s: %s", dem.path, text)


@lru_cache(maxsize=64)
def _doubts_of(dem: Dem, side: int, identity: Hashable) -> tuple[str, ...]:
    """What is doubtful about a file; looked at once in a process."""
    if dem.too_small:
        return (dem.too_small,)
    low, high, pixels, known, stuck = math.inf, -math.inf, 0, 0, Stuck(0, 0)
    for z, _, row0, averaged in sample_windows(dem, side):
        there = int(np.count_nonzero(np.isfinite(z)))
        pixels, known = pixels + z.size, known + there
        if there:
            low, high = min(low, float(np.nanmin(z))), max(high, float(np.nanmax(z)))
        stuck += stuck_pixels(z, averaged * narrowness(dem.grid, row0, row0 + len(z)))
    return tuple(doubts(dem, low, high, pixels, known, stuck)) if known else ()
