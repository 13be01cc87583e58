"""Recognition of files that hold heights, so that a DEM is not searched as an image."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..dem.dem import Dem
from ..dem.products import facts_of
from ..dem.raster import HEIGHT_LIMIT_M
from ..errors import ImageError, LcpError

LEAST_DEPTH_M = 50.0
DEEP_SHARE = {"f": 0.01, "i": 0.5}
"""Samples (floating-point, signed integers) of which this share is lower than minus that depth are
heights: brightness is negative only by noise. Integers may have an offset.
"""

LEAST_RELIEF_M = 20.0
"""Least range of the samples of a file with the name of a DEM product; calibrated brightness (I/F)
has a range of about 1.
"""

_ORTHOPHOTO = re.compile(r"_M\d{8,}", re.I)
"""Number of an observation in the name: an orthophoto made with a NAC DTM."""

_WINDOWS, _WINDOW_PX = 4, 256
"""Windows along each side of a file whose samples are read, and their size."""


def refuse_heights(path: Path) -> None:
    """ImageError, one line, for a map-projected DEM of the Moon instead of an image.

    A DEM is a file that `Dem.open` reads and that has either the name or label of a known product
    and relief in metres, or samples far below 0. Only some windows are read.
    """
    try:
        dem = Dem.open(path)
        heights = _some_heights(dem)
    except (LcpError, OSError):
        return  # no DEM; whether it is an image is found out by the reader of images
    if not _are_heights(dem, heights):
        return
    raise ImageError(
        f"{path}: holds heights ({dem.product}: {heights.min():.0f} to {heights.max():.0f} m), not brightness; "
        "give an image, and the DEM as `dem`"
    )


def _some_heights(dem: Dem) -> Array:
    """Finite heights (n,), metres, of windows spread over a DEM; special codes are left out."""
    raster, found = dem.raster, []
    for row in _starts(raster.height):
        for col in _starts(raster.width):
            end = min(row + _WINDOW_PX, raster.height), min(col + _WINDOW_PX, raster.width)
            found.append(raster.values(row, end[0], col, end[1]).ravel())
    values = np.concatenate(found)
    return np.asarray(values[np.abs(values) <= HEIGHT_LIMIT_M])


def _starts(length: int) -> list[int]:
    """First rows or columns of the windows along a side."""
    places = np.linspace(0, max(length - _WINDOW_PX, 0), _WINDOWS).astype(int)
    return sorted(set(places.tolist()))


def _are_heights(dem: Dem, heights: Array) -> bool:
    if not heights.size:
        return False
    kind = dem.raster.samples(0, 1, 0, 1).dtype.kind
    known = facts_of(dem.product).family != "unknown" and not _ORTHOPHOTO.search(dem.path.stem)
    if kind not in DEEP_SHARE:
        return False
    deep = float(np.mean(heights < -LEAST_DEPTH_M)) > DEEP_SHARE[kind]
    return deep or (known and float(np.ptp(heights)) > LEAST_RELIEF_M)
