"""Drawings of the catalogue report: shaded relief, map of the points, Sun-direction discs,
histograms.

Colours are CSS classes of ``plots/templates/catalogue.css``: ``c0`` .. ``c5`` for shares from 0 to
1.
"""

# ruff: noqa: E501 - lines of markup

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray
from ..geometry.bounds import turned_deg, wrapped_deg
from ..geometry.map_plane import MapPlane
from ..plots.axes import Axes, Axis, round_ticks
from ..plots.numbers import drawing, nice_step, number
from ..plots.pictures import data_uri, grey

STEPS = 6
"""Number of colours of a share from 0 to 1."""

_FEW_VALUES = 6
"""Most distinct values that are drawn as a bar each instead of in bins."""

_LIGHT = np.array([-0.5, 0.5, math.sqrt(0.5)])
"""Direction to the light (east, north, up): north-west, 45 deg high."""

MAP_PX = 960.0
_MARGIN_PX = (100.0, 14.0, 74.0, 14.0)  # left, right, bottom, top
_HALF_LETTER_PX = 5.0  # of a label, at most
_DISC_PX = 100.0
_TOPS_DEG = (3.0, 6.0, 12.0, 24.0, 45.0, 90.0)
_GRATICULE_DEG = (0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0)


def shade_class(share: float) -> str:
    """CSS class of a share 0..1."""
    return f"c{min(STEPS - 1, int(share * (STEPS - 1) + 0.5))}"


def hillshade(height_m: AnyArray, cell_m: float) -> NDArray[np.uint8]:
    """Relief lit from the north-west, as grey and alpha (rows, cols, 2); cells without height are
    transparent.
    """
    height = np.asarray(height_m, dtype=np.float64)
    if min(height.shape) < 2:
        return np.zeros((*height.shape, 2), dtype=np.uint8)
    down, right = np.gradient(height, cell_m)
    lit = (_LIGHT[2] - right * _LIGHT[0] + down * _LIGHT[1]) / np.sqrt(1.0 + right**2 + down**2)
    return grey(lit)


# -- azimuth-elevation discs


@dataclass(frozen=True)
class SunDisc:
    """Disc of Sun directions: azimuth clockwise from north (up), the horizon at the rim, the zenith at the
    centre or, where the Sun never comes so high, the elevation ``top_deg``. ``sun_elevation`` and
    ``sun_azimuth`` are the grid of directions, degrees.
    """

    sun_elevation: AnyArray
    sun_azimuth: AnyArray
    top_deg: float = 90.0

    @classmethod
    def of(cls, sun_elevation: AnyArray, sun_azimuth: AnyArray, suns: AnyArray) -> SunDisc:
        """The disc for the Suns that are True (elevation, azimuth): low ones fill it."""
        highest = [
            high
            for (_, high), row in zip(_spans(sun_elevation, 0.0, 90.0), suns, strict=True)
            if row.any()
        ]
        tops = (top for top in _TOPS_DEG if top >= max(highest, default=90.0))
        return cls(sun_elevation, sun_azimuth, next(tops, 90.0))

    def definitions(self) -> Markup:
        """Outlines of the cells, which every disc of the page refers to."""
        cells = [
            f'<path id="s{i}-{j}" d="{_sector(self._radius(e0), self._radius(e1), a0, a1)}"/>'
            for i, (e0, e1) in enumerate(_spans(self.sun_elevation, 0.0, 90.0))
            for j, (a0, a1) in enumerate(_azimuth_spans(self.sun_azimuth))
        ]
        return Markup(
            f'<svg class="defs" width="0" height="0" aria-hidden="true"><defs>{"".join(cells)}</defs></svg>'
        )

    def draw(self, share: AnyArray, label: str, large: bool = False, element: str = "") -> Markup:
        """Disc of shares 0..1 (elevation, azimuth); no cell where NaN (not evaluated). Large discs
        are labelled. ``element``: id of the disc; its cells then carry their number, in the order of
        rows, for a script.
        """
        shown = [
            (i, j, k, shade_class(share[i, j]), self._title(i, j, share[i, j]) if large else "")
            for k, (i, j) in enumerate(np.argwhere(np.isfinite(share)))
        ]
        away = _DISC_PX + 13
        names = [
            (away * math.sin(math.radians(a)), -away * math.cos(math.radians(a)) + 4.5, name)
            for a, name in ((0, "N"), (90, "E"), (180, "S"), (270, "W"))
            if large
        ]
        rings = [(k * self.top_deg / 3, _DISC_PX * (1 - k / 3)) for k in range(3)]
        pad = 26 if large else 6
        return drawing("sun_disc", _DISC_PX, pad, shown, element, names, label, rings)

    def _radius(self, elevation_deg: float) -> float:
        return _DISC_PX * max(0.0, 1.0 - elevation_deg / self.top_deg)

    def _title(self, i: int, j: int, share: float) -> str:
        return f"azimuth {self.sun_azimuth[j]:g}°, elevation {self.sun_elevation[i]:g}°: {100 * share:.0f} %"


def _sector(outer: float, inner: float, a0: float, a1: float) -> str:
    """Outline between two radii and two azimuths, degrees."""
    a1 = min(a1, a0 + 359.9)  # an arc of 360 degrees would be empty
    large = int(a1 - a0 > 180.0)
    corners = [
        f"{r * math.sin(math.radians(a)):.1f} {-r * math.cos(math.radians(a)):.1f}"
        for r, a in ((outer, a0), (outer, a1), (inner, a1), (inner, a0))
    ]
    return (
        f"M{corners[0]}A{outer:.1f} {outer:.1f} 0 {large} 1 {corners[1]}"
        f"L{corners[2]}A{inner:.1f} {inner:.1f} 0 {large} 0 {corners[3]}Z"
    )


def _spans(values: AnyArray, low: float, high: float) -> list[tuple[float, float]]:
    """Limits of the cells around increasing values: the midpoints between neighbours; cells at the
    ends are symmetric.
    """
    if len(values) == 1:
        return [(max(low, float(values[0]) - 5.0), min(high, float(values[0]) + 5.0))]
    middles = (values[1:] + values[:-1]) / 2.0
    edges = np.concatenate([[2 * values[0] - middles[0]], middles, [2 * values[-1] - middles[-1]]])
    edges = np.clip(edges, low, high)
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _azimuth_spans(values: AnyArray) -> list[tuple[float, float]]:
    """Limits of the cells around azimuths on the circle; half widths of at most half the median
    step.
    """
    if len(values) == 1:
        return [(float(values[0]) - 7.5, float(values[0]) + 7.5)]
    gaps = np.diff(np.append(values, values[0] + 360.0))
    half = np.minimum(gaps, np.median(gaps)) / 2.0
    return [(float(v - half[i - 1]), float(v + half[i])) for i, v in enumerate(values)]


# -- histograms


@dataclass(frozen=True)
class Distribution:
    """Histogram of a variable over the points, or a text instead: no values, or one for all points."""

    title: str
    chart: Markup | None = None
    single: str = ""
    count: int = 0


def distribution(values: ArrayLike, unit: str, title: str, bins: int = 24) -> Distribution:
    """Number of points over a variable, in bins of a round width; NaN is left out."""
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if not known.size:
        return Distribution(title)
    low, high = float(known.min()), float(known.max())
    if high - low <= 1e-9 * max(abs(high), 1e-300):
        return Distribution(title, single=f"{number(high, 4)} {unit}".strip(), count=known.size)
    values_found, numbers = np.unique(np.round(known, 6), return_counts=True)
    if len(values_found) <= _FEW_VALUES:
        names = [number(float(value), 4) for value in values_found]
        each = [(n, f"{name} {unit}: {n}") for name, n in zip(names, numbers.tolist(), strict=True)]
        drawn = categories(names, each, unit, "points", title, width=200.0, height=110.0)
        return Distribution(title, drawn, count=known.size)
    counts, edges = np.histogram(known, bins=_bin_edges(low, high, bins))
    most = int(counts.max())
    whole = [tick for tick in round_ticks(0.0, most, min(most, 4)) if tick[0] == round(tick[0])]
    axes = Axes(
        Axis(edges[0], edges[-1], round_ticks(edges[0], edges[-1], 4), unit),
        Axis(0.0, most, whole, "points", grid=True),
        width=200.0,
        height=110.0,
        left=56.0,
        top=10.0,
    )
    bars = axes.bars(
        (a, b, n, "bar", f"{number(a)} to {number(b)} {unit}: {n}")
        for a, b, n in zip(edges[:-1], edges[1:], counts.tolist(), strict=True)
        if n
    )
    return Distribution(title, axes.draw(bars, title), count=known.size)


def categories(
    names: Sequence[str],
    bars: Sequence[tuple[float, str]],
    x_title: str,
    y_title: str,
    label: str,
    width: float = 420.0,
    height: float = 180.0,
    highest: float | None = None,
) -> Markup:
    """Bars side by side, one for each name: height and tooltip. ``highest``: end of the y axis, by
    default the highest bar.
    """
    most = max((value for value, _ in bars), default=1.0) if highest is None else highest
    most = most or 1.0
    ticks = round_ticks(0.0, most, 4)
    if y_title == "points":
        ticks = [tick for tick in ticks if tick[0] == round(tick[0])]
    axes = Axes(
        Axis(0.0, len(names), [(k + 0.5, name) for k, name in enumerate(names)], x_title),
        Axis(0.0, most, ticks, y_title, grid=True),
        width=width,
        height=height,
        left=62.0,
        top=10.0,
    )
    drawn = axes.bars(
        ((k + 0.15, k + 0.85, value, "bar", text) for k, (value, text) in enumerate(bars)),
        gap=0.0,
    )
    return axes.draw(drawn, label)


def _bin_edges(low: float, high: float, bins: int) -> AnyArray:
    step = nice_step(high - low, bins)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return np.arange(first, max(last, first + 1) + 1) * step


# -- maps


@dataclass(frozen=True)
class Mark:
    """A mark on the map: place (metres in the map's frame), symbol, CSS class and tooltip."""

    x_m: float
    y_m: float
    symbol: str
    css: str
    title: str


SYMBOLS = {
    "dot": "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0Z",
    "ring": "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0 -8 0Z",
    "cross": "M-3.5 -3.5L3.5 3.5M-3.5 3.5L3.5 -3.5",
    "triangle": "M0 -4.6L4.4 3.4H-4.4Z",
    "square": "M-3.6 -3.6H3.6V3.6H-3.6Z",
}


def symbol(name: str, css: str) -> Markup:
    """A symbol of the map for its legend."""
    return Markup(
        f'<svg class="key" viewBox="-7 -7 14 14" aria-hidden="true">{_mark_path(name, css)}</svg>'
    )


def _mark_path(name: str, css: str, place: str = "") -> str:
    """The symbol on top of a dark outline, legible on any background."""
    path = SYMBOLS[name]
    return f'<g{place}><path class="halo" d="{path}"/><path class="{css}" d="{path}"/></g>'


@dataclass(frozen=True)
class ReliefMap:
    """Shaded map in a plane: ``height`` (rows, cols), metres, with the coordinates ``x_m`` (cols,) and
    ``y_m`` (rows,), metres.
    """

    height: AnyArray
    x_m: AnyArray
    y_m: AnyArray
    plane: MapPlane

    @property
    def scale(self) -> float:
        """SVG units per metre."""
        left, right, _, _ = _MARGIN_PX
        return (MAP_PX - left - right) / max(self._width_m, 1e-9)

    @property
    def _cell_m(self) -> float:
        return float(abs(self.x_m[1] - self.x_m[0])) if len(self.x_m) > 1 else 1.0

    @property
    def _width_m(self) -> float:
        return len(self.x_m) * self._cell_m

    @property
    def _height_m(self) -> float:
        return len(self.y_m) * self._cell_m

    def pixel(self, x_m: ArrayLike, y_m: ArrayLike) -> tuple[AnyArray, AnyArray]:
        """SVG coordinates of places in the frame."""
        left, _, _, top = _MARGIN_PX
        west, north = self.x_m[0] - self._cell_m / 2, self.y_m[0] + self._cell_m / 2
        return left + (np.asarray(x_m) - west) * self.scale, top + (
            north - np.asarray(y_m)
        ) * self.scale

    @property
    def size_px(self) -> tuple[float, float]:
        """Width and height of the drawing, SVG units."""
        _, _, bottom, top = _MARGIN_PX
        return MAP_PX, round(self._height_m * self.scale + top + bottom, 1)

    def draw(self, marks: Iterable[Mark], label: str) -> Markup:
        """The map with graticule, marks and scale bar."""
        left, _, _, top = _MARGIN_PX
        width, height = self._width_m * self.scale, self._height_m * self.scale
        picture = data_uri(hillshade(self.height, self._cell_m))
        lines, labels = self._graticule()
        drawn = "".join(self._mark(mark) for mark in marks)
        return Markup(
            f'<svg class="map" viewBox="0 0 {self.size_px[0]:g} {self.size_px[1]:g}" role="img" aria-label="{escape(label)}">'
            f'<image href="{picture}" x="{left:g}" y="{top:g}" width="{width:.1f}" height="{height:.1f}" preserveAspectRatio="none"/>'
            f'<g class="graticule">{lines}</g><rect class="frame" x="{left:g}" y="{top:g}" width="{width:.1f}" height="{height:.1f}"/>'
            f'<g class="marks">{drawn}</g><g class="labels">{labels}</g>{self._scale_bar(height + top)}</svg>'
        )

    def _mark(self, mark: Mark) -> str:
        px, py = self.pixel(mark.x_m, mark.y_m)
        shape = _mark_path(mark.symbol, mark.css, f' transform="translate({px:.1f} {py:.1f})"')
        return shape.replace("</g>", f"<title>{escape(mark.title)}</title></g>")

    def _graticule(self) -> tuple[str, str]:
        """Meridians and parallels at round degrees, and their labels at the southern and western
        edge.
        """
        lon, lat = self._lonlat_limits()
        lines, labels = [], []
        for value in _round_degrees(lon):
            line = self._clipped(np.full(241, value), np.linspace(*lat, 241))
            if len(line):
                lines.append(_polyline(line))
                x, y = line[np.argmax(line[:, 1])]
                text = _degrees(turned_deg(value), "E", "")
                most = MAP_PX - _HALF_LETTER_PX * len(text)
                labels.append((min(x, most), y + 26, text, "middle"))
        for value in _round_degrees(lat):
            line = self._clipped(np.linspace(*lon, 241), np.full(241, value))
            if len(line):
                lines.append(_polyline(line))
                x, y = line[np.argmin(line[:, 0])]
                labels.append((x - 7, y + 6, _degrees(value, "N", "S"), "end"))
        left, _, _, top = _MARGIN_PX
        south = top + self._height_m * self.scale
        edge = {"middle": lambda x, y: y > south + 10, "end": lambda x, y: x < left}
        kept = [label for label in labels if edge[label[3]](label[0], label[1])]
        return "".join(lines), "".join(
            f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{a}">{t}</text>' for x, y, t, a in kept
        )

    def _lonlat_limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        xx, yy = np.meshgrid(
            np.linspace(self.x_m[0], self.x_m[-1], 41), np.linspace(self.y_m[0], self.y_m[-1], 41)
        )
        lon, lat = self.plane.lonlat(xx, yy)
        middle = self.plane.center_lon
        away = wrapped_deg(lon - middle)
        return (
            (middle + float(np.nanmin(away)), middle + float(np.nanmax(away))),
            (float(np.nanmin(lat)), float(np.nanmax(lat))),
        )

    def _clipped(self, lon: AnyArray, lat: AnyArray) -> AnyArray:
        """Part of a line inside the map, SVG coordinates (n, 2)."""
        px, py = self.pixel(*self.plane.at(lon, lat))
        left, _, _, top = _MARGIN_PX
        slack = 3.0  # SVG units: a line that ends just short of the edge is extended to it
        inside = (px >= left - slack) & (px <= left + self._width_m * self.scale + slack)
        inside &= (py >= top - slack) & (py <= top + self._height_m * self.scale + slack)
        px = np.clip(px, left, left + self._width_m * self.scale)
        py = np.clip(py, top, top + self._height_m * self.scale)
        return np.stack([px, py], axis=-1)[inside]

    def _scale_bar(self, base: float) -> str:
        """Bar of a round length, about a fifth of the map's width, at the lower right."""
        length_m = nice_step(self._width_m / 5.0, 1) if self._width_m > 0 else 1.0
        length_m = length_m / 2.0 if length_m > self._width_m / 3.0 else length_m
        px = length_m * self.scale
        right = MAP_PX - _MARGIN_PX[1]
        text = f"{length_m / 1e3:g} km" if length_m >= 1e3 else f"{length_m:g} m"
        return (
            f'<g class="scale"><path d="M{right - px:.1f} {base + 52:.1f}v7h{px:.1f}v-6"/>'
            f'<text x="{right - px - 8:.1f}" y="{base + 60:.1f}" text-anchor="end">{text}</text></g>'
        )


def _polyline(points: AnyArray) -> str:
    some = np.unique(np.linspace(0, len(points) - 1, 24).astype(int))
    return '<polyline points="' + " ".join(f"{x:.1f},{y:.1f}" for x, y in points[some]) + '"/>'


def _round_degrees(limits: tuple[float, float]) -> Sequence[float]:
    """Round values within limits, about five."""
    low, high = limits
    span = max(high - low, 1e-9)
    step = next((s for s in _GRATICULE_DEG if span / s <= 7.0), 30.0)
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _degrees(value: float, positive: str, negative: str) -> str:
    return f"{abs(value):.4g}° {positive if value >= 0 or not negative else negative}"
