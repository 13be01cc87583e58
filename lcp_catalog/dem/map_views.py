"""Where the pixels of a small map picture lie on the Moon: the whole Moon, a box, or the ground around a pole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..geometry.bounds import Bounds
from .grid import Grid

POLAR_WITHIN_DEG = 30.0
"""A set that lies within this distance of a pole is shown in the stereographic plane of that pole."""

_WIDE, _HIGH, _POLAR = 720, 480, 540  # largest sides in pixels
_LEAST = 160
_MARGIN = 0.06
_STEPS_DEG = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 45.0)


@dataclass(frozen=True)
class View:
    """A picture of ``width`` x ``height`` pixels of a map plane; ``left`` and ``top`` are its outer edges, y grows upwards.

    Without a ``pole`` the plane is longitude and latitude in degrees, each ``unit_x`` and ``unit_y`` wide a pixel. Around a
    pole it is stereographic, t = tan(colatitude / 2) from the pole: longitude 0 lies below the north pole and above the south
    pole, 90 E to the right of both, as on LOLA's maps.
    """

    pole: int
    width: int
    height: int
    left: float
    top: float
    unit_x: float
    unit_y: float
    graticule_deg: tuple[float, float]  # longitudes, latitudes

    def lonlat(self, x_px: ArrayLike, y_px: ArrayLike) -> tuple[Array, Array]:
        """Longitude and latitude of pixels, centres at whole numbers."""
        x = self.left + (np.asarray(x_px, np.float64) + 0.5) * self.unit_x
        y = self.top - (np.asarray(y_px, np.float64) + 0.5) * self.unit_y
        if not self.pole:
            return x, y
        lat = self.pole * (90.0 - 2.0 * np.degrees(np.arctan(np.hypot(x, y))))
        return np.degrees(np.arctan2(x, -self.pole * y)), lat

    def pixel(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Array, Array]:
        """Fractional pixels of places; a longitude is taken within the turn that begins at the left edge."""
        lon, lat = np.asarray(lon_deg, np.float64), np.asarray(lat_deg, np.float64)
        if self.pole:
            x, y = _plane(lon, lat, self.pole)
        else:
            x, y = self.left + (lon - self.left) % 360.0, lat
        return (x - self.left) / self.unit_x - 0.5, (self.top - y) / self.unit_y - 0.5

    def places(self) -> tuple[Array, Array]:
        """Longitude and latitude of all pixels, (height, width)."""
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return self.lonlat(x, y)

    @property
    def has_pole(self) -> bool:
        """Whether a pole lies inside the picture (polar views)."""
        right, bottom = self.left + self.width * self.unit_x, self.top - self.height * self.unit_y
        return bool(self.pole) and self.left < 0.0 < right and bottom < 0.0 < self.top

    @property
    def caption(self) -> str:
        if self.pole:
            return f"polar stereographic, {'north' if self.pole > 0 else 'south'} pole, 90°E to the right"
        return "equirectangular, north up"


def view_of(grids: Sequence[Grid], box: Bounds) -> View:
    """The view that shows footprints best, and the box of longitudes and latitudes around them."""
    pole = (
        1
        if box.south >= 90.0 - POLAR_WITHIN_DEG
        else -1
        if box.north <= POLAR_WITHIN_DEG - 90.0
        else 0
    )
    if pole:
        return _polar(grids, box, pole)
    margin = _MARGIN * max(box.north - box.south, (box.east - box.west) * _squeeze(box))
    wide = box.east - box.west + 2.0 * margin / _squeeze(box)
    if wide >= 360.0:
        return View(0, _WIDE, _WIDE // 2, -180.0, 90.0, 360.0 / _WIDE, 360.0 / _WIDE, (30.0, 30.0))
    return _regional(box, wide, margin)


def _squeeze(box: Bounds) -> float:
    return math.cos(math.radians(0.5 * (box.south + box.north)))


def _regional(box: Bounds, wide: float, margin: float) -> View:
    south, north = max(box.south - margin, -90.0), min(box.north + margin, 90.0)
    squeeze = _squeeze(box)
    unit = max(wide * squeeze / _WIDE, (north - south) / _HIGH)  # degrees of latitude a pixel
    width = min(max(round(wide * squeeze / unit), _LEAST), int(360.0 * squeeze / unit))
    height = min(max(round((north - south) / unit), _LEAST), int(180.0 / unit))
    middle_lon, middle_lat = 0.5 * (box.west + box.east), 0.5 * (south + north)
    top = min(middle_lat + 0.5 * height * unit, 90.0)
    top = max(top, -90.0 + height * unit)
    left = middle_lon - 0.5 * width * unit / squeeze
    steps = (_step(width * unit / squeeze, width / 90.0), _step(height * unit, height / 60.0))
    return View(0, width, height, left, top, unit / squeeze, unit, steps)


def _polar(grids: Sequence[Grid], box: Bounds, pole: int) -> View:
    """A rectangle around the footprints' outlines in the plane of the pole."""
    outlines = [np.stack(_plane(*_outline(grid), pole)) for grid in grids]
    x, y = np.concatenate(outlines, axis=1)
    left, right, low, top = (float(v) for v in (x.min(), x.max(), y.min(), y.max()))
    margin = _MARGIN * max(right - left, top - low)
    unit = (max(right - left, top - low) + 2.0 * margin) / _POLAR
    width = max(round((right - left + 2.0 * margin) / unit), _LEAST)
    height = max(round((top - low + 2.0 * margin) / unit), _LEAST)
    left, top = 0.5 * (left + right) - 0.5 * width * unit, 0.5 * (low + top) + 0.5 * height * unit
    span = math.degrees(height * unit)  # half of it in t is all of it in degrees, but for the scale
    view = View(pole, width, height, left, top, unit, unit, (30.0, _step(span, 4.0)))
    if view.has_pole:
        return view
    lon = _step(box.east - box.west, width / 90.0)
    return replace(view, graticule_deg=(lon, _step(2.0 * span, height / 60.0)))


def _outline(grid: Grid) -> tuple[Array, Array]:
    """Places along the outer edge of a grid, 721 a side."""
    along = np.linspace(0.0, 1.0, 721)
    across, down = along * grid.width - 0.5, along * grid.height - 0.5
    left, right = np.full(721, -0.5), np.full(721, grid.width - 0.5)
    top, bottom = np.full(721, -0.5), np.full(721, grid.height - 0.5)
    lon, lat = grid.lonlat(
        np.concatenate([across, across, left, right]), np.concatenate([top, bottom, down, down])
    )
    return lon, np.clip(lat, -90.0, 90.0)


def _plane(lon_deg: Array, lat_deg: Array, pole: int) -> tuple[Array, Array]:
    t = np.tan(np.radians(90.0 - pole * lat_deg) / 2.0)
    lon = np.radians(lon_deg)
    return t * np.sin(lon), -pole * t * np.cos(lon)


def _step(span_deg: float, parts: float) -> float:
    """A round distance of graticule lines, so that a span has at most about ``parts`` of them."""
    return next((step for step in _STEPS_DEG if span_deg / step <= parts), _STEPS_DEG[-1])
