"""Picture of the coverage of a set of DEM files: the product used at each place over shaded relief,
overlaps, gaps, missing pixels, graticule, legend.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Bytes
from ..geometry.bounds import Bounds, wrapped_deg
from ..plots.pictures import HEIGHT_PX, LINE_PX, draw_text, encode_png, width_px
from .grid import Grid
from .mosaic import DemSet, nearest_heights
from .pixel_statistics import HeightStatistics

Colour = tuple[int, int, int]

PRODUCT_COLOURS: tuple[Colour, ...] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (86, 180, 233),
    (213, 94, 0),
    (204, 121, 167),
    (240, 228, 66),
    (130, 90, 40),
)
"""Colours of Okabe and Ito (2008), which colour-blind readers can distinguish, and a brown; by
product in the order of the files.
"""
GAP: Colour = (190, 190, 190)
HOLE: Colour = (0, 0, 0)
PAPER: Colour = (255, 255, 255)
INK: Colour = (40, 40, 40)

_HATCH = (7, 3)  # pixels from stripe to stripe, and of a stripe
_MARGIN = (46, 46, 20, 22)  # left, right, top, bottom
_PAD = 8
_SWATCH = (18, 10)
_CROWDED = 24  # pixels around a pole without meridians
_MOST_PRODUCTS = 16
_NO_FILE, _MISSING = -1, -2

POLAR_WITHIN_DEG = 30.0
"""A set within this distance of a pole is shown in the stereographic plane of that pole."""

_WIDE, _HIGH, _POLAR = 720, 480, 540  # largest sides in pixels
_LEAST = 160
_SLOPE, _BRIGHTNESS = 0.35, (0.3, 1.6)  # of the relief
_AROUND = 0.06  # of the larger side
_STEPS_DEG = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 45.0)


@dataclass(frozen=True)
class _Legend:
    entries: tuple[tuple[Bytes, str], ...]
    caption: str


def set_map(dems: DemSet, surveys: Sequence[HeightStatistics] | None = None) -> bytes:
    """The picture as PNG bytes; without ``surveys`` (one for each file) no pixel is read, and neither
    relief nor missing pixels are shown.
    """
    view = view_of([dem.grid for dem in dems.dems], dems.bounds)
    used, striped = _uses(dems, view, surveys)
    canvas = _coloured(dems, used, striped)
    if surveys is not None:
        canvas = _shaded(canvas, _relief(dems, view), used >= 0)
    _graticule(canvas, view)
    words = ", relief lit from the upper left" if surveys is not None else ", no pixels read"
    caption = view.caption + words
    return encode_png(
        _on_paper(canvas, view, _Legend(tuple(_entries(dems, used, striped)), caption))
    )


def _uses(
    dems: DemSet, view: MapPicture, surveys: Sequence[HeightStatistics] | None
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """For every pixel (height, width) the file that is used, _NO_FILE or _MISSING; and True where
    there are two or more files.
    """
    lon, lat = (places.ravel() for places in view.places())
    inside = dems.candidates_at(lon, lat)
    used = np.asarray(dems.product_at(lon, lat), np.int64)
    if surveys is not None:
        absent = [one.absent(lon, lat) for one in surveys]
        used = _without_holes(used, inside, absent, [dem.gsd_m for dem in dems.dems])
    shape = (view.height, view.width)
    return used.reshape(shape), (inside.sum(axis=0) > 1).reshape(shape)


def _coloured(dems: DemSet, used: NDArray[np.int64], striped: NDArray[np.bool_]) -> Bytes:
    names = list(dict.fromkeys(dems.products))
    colours = [_colour(names.index(product)) for product in dems.products]
    out = np.array([*colours, HOLE, GAP], np.uint8)[used]  # -1 is the last, -2 the last but one
    where = striped & _stripes(*used.shape)
    out[where] = _lighter(out[where])
    return out


def _relief(dems: DemSet, view: MapPicture) -> Array:
    """Brightness (height, width) of the terrain lit from the upper left, 1 where it is level or
    unknown. Slopes are exaggerated to `_SLOPE` in the root mean square.
    """
    lon, lat = view.places()
    height = nearest_heights(dems, lon.ravel(), lat.ravel()).reshape(lon.shape)
    down, right = np.gradient(height)
    if not view.pole:  # a pixel there is as many degrees wide, not metres
        right /= np.cos(np.radians(np.clip(lat, -89.0, 89.0))) * view.unit_x / view.unit_y
    slope = np.hypot(down, right)
    typical = math.sqrt(np.nanmean(slope**2)) if np.isfinite(slope).any() else 0.0
    if typical == 0.0:
        return np.ones(lon.shape)
    down, right = (_SLOPE / typical * one for one in (down, right))
    lit = (1.0 + (right + down) / math.sqrt(2.0)) / np.sqrt(1.0 + right**2 + down**2)
    return np.asarray(np.nan_to_num(np.clip(lit, *_BRIGHTNESS), nan=1.0))


def _shaded(canvas: Bytes, brightness: Array, where: NDArray[np.bool_]) -> Bytes:
    """Colours darkened, or lightened towards white, by a brightness (height, width)."""
    light = np.where(where, brightness, 1.0)[..., None]
    dark, rest = canvas * np.minimum(light, 1.0), np.maximum(light - 1.0, 0.0)
    return np.rint(dark + (255.0 - dark) * rest).astype(np.uint8)


def _without_holes(
    used: NDArray[np.int64],
    inside: NDArray[np.bool_],
    absent: list[NDArray[np.bool_]],
    gsd_m: list[float],
) -> NDArray[np.int64]:
    """Index of the file used where the first one has no pixels: the finest file that has some, else
    _MISSING.
    """
    there = inside & ~np.array(absent)
    lost = (used >= 0) & ~np.take_along_axis(there, np.maximum(used, 0)[None], axis=0)[0]
    finest = np.argsort(gsd_m, kind="stable")
    other = finest[there[finest].argmax(axis=0)]
    return np.where(lost, np.where(there.any(axis=0), other, _MISSING), used)


def _colour(number: int) -> Colour:
    """Colour of a product; after eight products the colours repeat, darker."""
    base, again = PRODUCT_COLOURS[number % len(PRODUCT_COLOURS)], number // len(PRODUCT_COLOURS)
    red, green, blue = (round(value * 0.65**again) for value in base)
    return red, green, blue


def _lighter(pixels: Bytes) -> Bytes:
    return (pixels + (255 - pixels.astype(np.int64)) * 55 // 100).astype(np.uint8)


def _stripes(height: int, width: int) -> NDArray[np.bool_]:
    return np.add.outer(np.arange(height), np.arange(width)) % _HATCH[0] < _HATCH[1]


def _graticule(canvas: Bytes, view: MapPicture) -> None:
    """Lines of one pixel at multiples of the step; the map shows through."""
    lon, lat = view.places()
    near = np.zeros(lon.shape, np.bool_)
    if view.pole:
        column, row = view.pixel(0.0, 90.0 * view.pole)
        x, y = np.meshgrid(np.arange(view.width) - column, np.arange(view.height) - row)
        near = np.hypot(x, y) < _CROWDED
    line = _steps(lat, view.graticule_deg[1]) | (_steps(lon, view.graticule_deg[0]) & ~near)
    canvas[line] = (canvas[line] * 0.55 + 0.45 * np.array(INK)).astype(np.uint8)


def _steps(values: Array, step: float) -> NDArray[np.bool_]:
    part = np.floor(values / step)
    out = np.zeros(values.shape, np.bool_)
    out[:, :-1] |= part[:, 1:] != part[:, :-1]
    out[:-1] |= part[1:] != part[:-1]
    return out


def _entries(
    dems: DemSet, used: NDArray[np.int64], striped: NDArray[np.bool_]
) -> Iterator[tuple[Bytes, str]]:
    """All products, and those of the other marks that the map shows."""
    names = list(dict.fromkeys(dems.products))
    for number, name in enumerate(names[:_MOST_PRODUCTS]):
        yield _swatch(_colour(number)), name
    if len(names) > _MOST_PRODUCTS:
        yield _swatch(PAPER), f"and {len(names) - _MOST_PRODUCTS} more products"
    if striped.any():
        swatch = _swatch(_colour(0))
        where = _stripes(*swatch.shape[:2])
        swatch[where] = _lighter(swatch[where])
        yield swatch, "in two or more files"
    for kind, colour, words in ((_NO_FILE, GAP, "in no file"), (_MISSING, HOLE, "pixels missing")):
        if (used == kind).any():
            yield _swatch(colour), words


def _swatch(colour: Colour) -> Bytes:
    return np.full((_SWATCH[1], _SWATCH[0], 3), colour, np.uint8)


def _on_paper(canvas: Bytes, view: MapPicture, legend: _Legend) -> Bytes:
    """The map in its frame, with labels around it and the legend below."""
    left, right, top, bottom = _MARGIN
    column_px = max(width_px(text) for _, text in legend.entries) + _SWATCH[0] + 3 * _PAD
    width = max(left + view.width + right, left + column_px, left + width_px(legend.caption) + _PAD)
    columns = max(1, (width - left) // column_px)
    lines = -(-len(legend.entries) // columns) + 1
    height = top + view.height + bottom + _PAD + lines * (LINE_PX + 4) + _PAD
    out = np.full((height, width, 3), PAPER, np.uint8)
    out[top - 1 : top + view.height + 1, left - 1 : left + view.width + 1] = INK
    out[top : top + view.height, left : left + view.width] = canvas
    _labels(out, view)
    y = top + view.height + bottom + _PAD
    draw_text(out, left, y, legend.caption, INK)
    for number, (swatch, text) in enumerate(legend.entries):
        x, below = left + number % columns * column_px, y + (1 + number // columns) * (LINE_PX + 4)
        out[below - 1 : below + _SWATCH[1] + 1, x - 1 : x + _SWATCH[0] + 1] = INK
        out[below : below + _SWATCH[1], x : x + _SWATCH[0]] = swatch
        draw_text(out, x + _SWATCH[0] + _PAD, below + 1, text, INK)
    return out


def _labels(out: Bytes, view: MapPicture) -> None:
    """Degrees where the graticule meets the frame; around a pole the latitudes are written along a
    meridian.
    """
    left, _, top, _ = _MARGIN
    step_lon, step_lat = view.graticule_deg
    across, down = np.arange(view.width), np.arange(view.height)
    for y, place in ((-1, top - 3 - HEIGHT_PX), (view.height, top + view.height + 4)):
        lon, _ = view.lonlat(across, np.full(view.width, y))
        if y > 0 or view.pole:
            _row(out, [(left + x, _east(v)) for x, v in _met(lon, step_lon)], place)
    for x in (-1, view.width):
        lon, lat = view.lonlat(np.full(view.height, x), down)
        values, step, words = (lon, step_lon, _east) if view.has_pole else (lat, step_lat, _north)
        if x < 0 or view.pole:
            _column(
                out,
                [(top + y, words(v)) for y, v in _met(values, step)],
                left - 4 if x < 0 else None,
                left + view.width + 4,
            )
    if view.has_pole:
        _along_meridian(out, view)


def _along_meridian(out: Bytes, view: MapPicture) -> None:
    left, _, top, _ = _MARGIN
    for lat in np.arange(0.0, 90.0, view.graticule_deg[1]):
        x, y = (
            round(float(v)) for v in view.pixel(45.0 if view.pole > 0 else 135.0, view.pole * lat)
        )
        text = _north(view.pole * float(lat))
        wide = width_px(text)
        if not (0 <= x < view.width - wide - 2 and 0 <= y < view.height - HEIGHT_PX):
            continue
        part = out[top + y - 5 : top + y + 6, left + x - 2 : left + x + wide + 2]
        part[:] = (part * 0.25 + 0.75 * 255).astype(np.uint8)
        draw_text(out, left + x, top + y - 4, text, INK)


def _met(values: Array, step: float) -> list[tuple[int, float]]:
    """(pixel, multiple of the step) where a multiple lies between two pixels; a jump by a full turn
    is one at 180.
    """
    part = np.floor(values / step)
    found = []
    for pixel in np.flatnonzero(np.diff(part)):
        jump = abs(values[pixel + 1] - values[pixel]) > 180.0
        found.append(
            (int(pixel), 180.0 if jump else float(max(part[pixel], part[pixel + 1])) * step)
        )
    return found


def _row(out: Bytes, labels: list[tuple[int, str]], top: int) -> None:
    """Labels in a row, centred; a label that would touch the previous one is left out."""
    free = 0
    for x, text in labels:
        start = x - width_px(text) // 2
        if start >= free and start + width_px(text) < out.shape[1]:
            draw_text(out, start, top, text, INK)
            free = start + width_px(text) + 6


def _column(out: Bytes, labels: list[tuple[int, str]], right: int | None, left: int) -> None:
    """Labels in a column that end at ``right``, or begin at ``left``."""
    free = 0
    for y, text in labels:
        if y - 4 >= free:
            draw_text(out, left if right is None else right - width_px(text), y - 3, text, INK)
            free = y + HEIGHT_PX


def _east(lon: float) -> str:
    lon = wrapped_deg(lon)
    if abs(lon) in (0.0, 180.0):
        return f"{abs(lon):g}"
    return f"{abs(lon):.6g} {'E' if lon > 0 else 'W'}"


def _north(lat: float) -> str:
    return "0" if abs(lat) < 1e-9 else f"{abs(lat):.6g} {'N' if lat > 0 else 'S'}"


@dataclass(frozen=True)
class MapPicture:
    """A picture of ``width`` x ``height`` pixels of a map plane; ``left`` and ``top`` are its outer
    edges, y grows upwards.

    Without a ``pole`` the plane is longitude and latitude in degrees; a pixel is ``unit_x`` wide
    and ``unit_y`` high. Around a pole it is stereographic, t = tan(colatitude / 2) from the pole:
    longitude 0 is below the north pole and above the south pole, 90 E to the right of both, as on
    LOLA's maps.
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
        """Longitude and latitude of pixels; centres are at whole numbers."""
        x = self.left + (np.asarray(x_px, np.float64) + 0.5) * self.unit_x
        y = self.top - (np.asarray(y_px, np.float64) + 0.5) * self.unit_y
        if not self.pole:
            return x, y
        lat = self.pole * (90.0 - 2.0 * np.degrees(np.arctan(np.hypot(x, y))))
        return np.degrees(np.arctan2(x, -self.pole * y)), lat

    def pixel(self, lon_deg: ArrayLike, lat_deg: ArrayLike) -> tuple[Array, Array]:
        """Fractional pixels of places; longitudes are taken within the turn that begins at the left
        edge.
        """
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
        """True if a pole lies inside the picture (polar views)."""
        right, bottom = self.left + self.width * self.unit_x, self.top - self.height * self.unit_y
        return bool(self.pole) and self.left < 0.0 < right and bottom < 0.0 < self.top

    @property
    def caption(self) -> str:
        if self.pole:
            return f"polar stereographic, {'north' if self.pole > 0 else 'south'} pole, 90 E to the right"
        return "equirectangular, north up"


def view_of(grids: Sequence[Grid], box: Bounds) -> MapPicture:
    """The view for footprints and the box around them."""
    pole = (
        1
        if box.south >= 90.0 - POLAR_WITHIN_DEG
        else -1
        if box.north <= POLAR_WITHIN_DEG - 90.0
        else 0
    )
    if pole:
        return _polar(grids, box, pole)
    margin = _AROUND * max(box.north - box.south, (box.east - box.west) * _squeeze(box))
    wide = box.east - box.west + 2.0 * margin / _squeeze(box)
    if wide >= 360.0:
        return MapPicture(
            0, _WIDE, _WIDE // 2, -180.0, 90.0, 360.0 / _WIDE, 360.0 / _WIDE, (30.0, 30.0)
        )
    return _regional(box, wide, margin)


def _squeeze(box: Bounds) -> float:
    return math.cos(math.radians(0.5 * (box.south + box.north)))


def _regional(box: Bounds, wide: float, margin: float) -> MapPicture:
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
    return MapPicture(0, width, height, left, top, unit / squeeze, unit, steps)


def _polar(grids: Sequence[Grid], box: Bounds, pole: int) -> MapPicture:
    """A rectangle around the outlines of the footprints in the plane of the pole."""
    outlines = [np.stack(_plane(*_outline(grid), pole)) for grid in grids]
    x, y = np.concatenate(outlines, axis=1)
    left, right, low, top = (float(v) for v in (x.min(), x.max(), y.min(), y.max()))
    margin = _AROUND * max(right - left, top - low)
    unit = (max(right - left, top - low) + 2.0 * margin) / _POLAR
    width = max(round((right - left + 2.0 * margin) / unit), _LEAST)
    height = max(round((top - low + 2.0 * margin) / unit), _LEAST)
    left, top = 0.5 * (left + right) - 0.5 * width * unit, 0.5 * (low + top) + 0.5 * height * unit
    span = math.degrees(height * unit)  # half of it in t is all of it in degrees, but for the scale
    view = MapPicture(pole, width, height, left, top, unit, unit, (30.0, _step(span, 4.0)))
    if view.has_pole:
        return view
    lon = _step(box.east - box.west, width / 90.0)
    return replace(view, graticule_deg=(lon, _step(2.0 * span, height / 60.0)))


def _outline(grid: Grid) -> tuple[Array, Array]:
    """Places along the outer edge of a grid, 721 for each side."""
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
    """A round distance of graticule lines that divides a span into at most about ``parts`` parts."""
    return next((step for step in _STEPS_DEG if span_deg / step <= parts), _STEPS_DEG[-1])
