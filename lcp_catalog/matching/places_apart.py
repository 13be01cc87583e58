"""Words for an image in which none of a catalogue's points can be: where the image and the points lie."""

from __future__ import annotations

import math

import numpy as np

from ..cameras.sensor import Sensor
from ..cameras.view import center_of
from ..catalog.catalogue import Catalog
from ..constants import MOON_RADIUS_M
from ..errors import ImageError
from ..geometry.bounds import enclosing_bounds
from ..geometry.frames import lonlat_to_mcmf


def none_in_view(catalog: Catalog, sensor: Sensor) -> str:
    """One line: the place of the image's centre, its distance from the nearest point on the sphere,
    and the box of the points.
    """
    none = f"none of the catalogue's {len(catalog)} points can be in view"
    if not len(catalog):
        return none
    lon, lat = catalog.longitude, catalog.latitude
    box = enclosing_bounds(lon, lon, float(lat.min()), float(lat.max()))
    points = (
        f"the points lie at longitude {box.west:.2f} .. {box.east:.2f}, "
        f"latitude {box.south:.2f} .. {box.north:.2f}"
    )
    try:
        lon_deg, lat_deg = center_of(sensor)
    except ImageError:
        return f"{none}: the image's centre shows no ground; {points}"
    cosine = lonlat_to_mcmf(lon, lat) @ lonlat_to_mcmf(lon_deg, lat_deg) / MOON_RADIUS_M**2
    away_km = MOON_RADIUS_M / 1e3 * math.acos(float(np.clip(cosine.max(), -1.0, 1.0)))
    return (
        f"{none}: the image's centre shows longitude {lon_deg:.2f}, latitude {lat_deg:.2f}, "
        f"{away_km:.0f} km from the nearest point; {points}"
    )
