"""The albedo map that the package holds: the whole Moon at 2.7 km a pixel.

`moon_map.txt` beside it states where it comes from, its terms, and what was done to it. This module imports no array library.
"""

from __future__ import annotations

from pathlib import Path

from ..choices import MOON_MAP, NO_MAP

FILE = Path(__file__).with_name("moon_albedo_643nm_11ppd.tif")

MEAN = 0.041532
"""Mean of its values by area (`albedo_map.mean_value`), so that a build need not read every pixel."""

ORIGIN = {
    "version": "2, of NASA's CGI Moon Kit (svs.gsfc.nasa.gov/4720)",
    "licence": "free to use; credit: NASA's Scientific Visualization Studio",
}


def map_file(name: Path | str) -> Path | None:
    """The file of an albedo map that is named by a word or by its own name; None for no map.

    >>> map_file("none"), map_file("moon").name, map_file("a/b.tif").name
    (None, 'moon_albedo_643nm_11ppd.tif', 'b.tif')
    """
    if name == NO_MAP:
        return None
    return FILE if name == MOON_MAP else Path(name)
