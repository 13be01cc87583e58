"""Answers as JSON documents, CSV tables, GeoJSON, lines of text and, along a trajectory, a chart."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ..arrays import AnyArray, Array, Mask
from ..atomic_files import csv_lines, ending_of
from ..catalog.catalogue import Catalog
from ..constants import MOON_RADIUS_M
from ..ephemeris.times import instants
from ..geometry.bounds import wrapped_deg
from ..plots.axes import Axes, Axis, round_ticks
from ..plots.numbers import drawing, number, page
from .expected_position import LEAST_POINTS, Answer, ExpectedPosition
from .frame_points import CAUSES

POINT_COLUMNS = (
    "point_id", "longitude_deg", "latitude_deg", "elevation_m", "level", "detection_probability",
    "column_px", "row_px", "pixel_m", "sigma_major_px", "sigma_minor_px", "major_axis_px_deg",
    "sigma_major_m", "sigma_minor_m", "sigma_angle_deg",
)  # fmt: skip
"""One row per point. ``major_axis_px_deg`` is from right towards down in the image,
``sigma_angle_deg`` clockwise from north on the ground.
"""

FRAME_COLUMNS = (
    "time_utc", "x_m", "y_m", "z_m", "sun_azimuth_deg", "sun_elevation_deg",
    "in_view", "usable", "listed", "expected_points", "located_probability", "position_sigma_m",
    "sigma_east_m", "sigma_north_m", "sigma_up_m", "position_sigma_known_attitude_m", "position_dop",
    "reason",
)  # fmt: skip
"""One row per frame of a trajectory; figures that the points do not determine are empty."""

NUMBERS_SHOWN = 100
"""Most numbers of points for which the JSON document states the probability to find as many."""

CRS = "urn:ogc:def:crs:IAU_2015::30100"
"""Longitude and latitude on the Moon's sphere of 1737.4 km, MOON_ME."""

MEANINGS = dict(
    zip(
        CAUSES[1:],
        (
            "Sun outside the catalogue's",
            "view outside the catalogue's",
            "pixel too coarse",
            "not evaluated",
            "shadow of other terrain",
            "hidden by other terrain",
            "detection unlikely",
            "cut by the image's edge",
        ),
        strict=True,
    )
)
"""Why points in view are not usable, for readers."""


def document(answer: Answer, catalog: Catalog) -> dict[str, Any]:
    """The answer for a frame as a JSON object; null for what the points do not determine."""
    position = answer.position
    dop, cofactors = position.dop, position.covariance
    azimuth, elevation = answer.sun_deg
    return {
        "time_utc": answer.frame.time_utc,
        "sun": {"azimuth_deg": round(azimuth, 4), "elevation_deg": round(elevation, 4)},
        "points": _points(answer, catalog),
        "counts": {"listed": len(answer.rows)} | answer.counts,
        "expected_points": round(position.expected_points, 3),
        "expected_found": round(answer.joint.expected, 3),
        "probability_at_least": answer.joint.of_numbers(NUMBERS_SHOWN),
        "needed": answer.joint.needed,
        "located_probability": round(answer.joint.located, 4),
        "position_covariance_m2": _listed(position.position_covariance_m2),
        "position_sigma_m": position.position_sigma_m,
        "position_sigma_enu_m": _listed(position.sigma_enu_m),
        "position_sigma_known_attitude_m": position.known_attitude_sigma_m,
        "position_covariance_known_attitude_m2": _listed(position.known_attitude_m2),
        "covariance_6x6": _listed(cofactors),
        "dop": dop,
        "budget_m": position.budget_m,
        "map_sigma_m": position.map_sigma_m,
        "map_unknown": list(position.untied),
        "reason": position.reason or None,
    }


def _listed(values: AnyArray | None) -> list[Any] | None:
    return None if values is None else values.tolist()


def _points(answer: Answer, catalog: Catalog) -> list[dict[str, Any]]:
    table = zip(
        *(getattr(catalog, name)[answer.rows].tolist() for name in ("point_id", "level")),
        np.round(answer.probability, 4).tolist(),
        np.round(answer.pixel, 3).tolist(),
        np.round(np.column_stack([answer.sigma_px, answer.angle_px_deg]), 4).tolist(),
        np.round(np.column_stack([answer.sigma_m, answer.angle_deg]), 4).tolist(),
        *(getattr(catalog, name)[answer.rows].tolist() for name in ("longitude", "latitude")),
        strict=True,
    )
    names = (
        "point_id", "level", "detection_probability", "pixel", "sigma_px", "sigma_m",
        "longitude", "latitude",
    )  # fmt: skip
    return [dict(zip(names, row, strict=True)) for row in table]


def points_csv(answer: Answer, catalog: Catalog) -> str:
    """Table of the points of one frame (`POINT_COLUMNS`)."""
    return "".join(csv_lines([POINT_COLUMNS, *_point_rows(answer, catalog)]))


def _point_rows(answer: Answer, catalog: Catalog) -> list[tuple[Any, ...]]:
    of_points = ("point_id", "longitude", "latitude", "elevation", "level")
    columns = (
        *(getattr(catalog, name)[answer.rows].tolist() for name in of_points),
        np.round(answer.probability, 4).tolist(),
        *np.round(answer.pixel, 3).T.tolist(),
        np.round(answer.pixel_m, 4).tolist(),
        *np.round(answer.sigma_px, 4).T.tolist(),
        np.round(answer.angle_px_deg, 2).tolist(),
        *np.round(answer.sigma_m, 4).T.tolist(),
        np.round(answer.angle_deg, 2).tolist(),
    )
    return list(zip(*columns, strict=True))


def points_geojson(answer: Answer, catalog: Catalog) -> str:
    """The points of one frame as GeoJSON, longitudes -180..180, with the Moon's coordinate system."""
    features = []
    for row in _point_rows(answer, catalog):
        figures = dict(zip(POINT_COLUMNS, row, strict=True))
        lon, lat, up = (figures[name] for name in ("longitude_deg", "latitude_deg", "elevation_m"))
        place = [wrapped_deg(lon), lat, up]
        shape = {"type": "Point", "coordinates": place}
        features.append({"type": "Feature", "geometry": shape, "properties": figures})
    whole = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": CRS}},
        "features": features,
    }
    return json.dumps(whole, allow_nan=False) + "\n"


def frames_csv(answers: Iterable[Answer]) -> Iterator[str]:
    """Lines of the table of the frames of a trajectory (`FRAME_COLUMNS`)."""
    return csv_lines([FRAME_COLUMNS, *map(_frame_row, answers)])


def _frame_row(answer: Answer) -> tuple[Any, ...]:
    position = answer.position
    enu = position.sigma_enu_m
    dop = position.dop
    return (
        answer.frame.time_utc,
        *np.round(answer.sensor_position_m, 3).tolist(),
        *(round(angle, 4) for angle in answer.sun_deg),
        answer.counts["in_view"],
        answer.usable,
        len(answer.rows),
        round(position.expected_points, 3),
        round(answer.joint.located, 4),
        _cell(position.position_sigma_m),
        *(("", "", "") if enu is None else map(_cell, enu.tolist())),
        _cell(position.known_attitude_sigma_m),
        _cell(None if dop is None else dop["position"]),
        position.reason,
    )


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def point_lines(answer: Answer, catalog: Catalog, most: int) -> list[str]:
    """Table of at most ``most`` points for a terminal."""
    lines = [
        "  point_id             level  probability   column      row  sigma px        sigma m        towards"
    ]
    names = dict(zip(POINT_COLUMNS, range(len(POINT_COLUMNS)), strict=True))
    for row in _point_rows(answer, catalog)[:most]:
        given = {name: row[k] for name, k in names.items()}
        px = f"{given['sigma_major_px']:.2f} x {given['sigma_minor_px']:.2f}"
        metres = f"{number(given['sigma_major_m'])} x {number(given['sigma_minor_m'])}"
        lines.append(
            f"  {given['point_id']:<20} {given['level']:>5}  {given['detection_probability']:>11.3f}"
            f" {given['column_px']:>8.1f} {given['row_px']:>8.1f}  {px:<14}  {metres:<13}"
            f" {given['sigma_angle_deg']:>4.0f} deg"
        )
    more = len(answer.rows) - most
    return lines + ([f"  and {more} more"] if more > 0 else [])


def frame_lines(answers: Iterable[Answer]) -> Iterator[str]:
    """Table of the frames of a trajectory for a terminal."""
    yield "time (UTC)                  in view  usable  expected  located   position m  exact attitude m"
    for count, answer in enumerate(answers, 1):
        position = answer.position
        free, known = (
            "-" if value is None else number(value)
            for value in (position.position_sigma_m, position.known_attitude_sigma_m)
        )
        name = answer.frame.time_utc or f"frame {count}"
        yield (
            f"{name:<27} {answer.counts['in_view']:>7} {answer.usable:>7}"
            f" {position.expected_points:>9.1f} {answer.joint.located:>8.2f} {free:>12} {known:>17}"
        )


def result_line(answer: Answer) -> str:
    """One line on the points and the position."""
    causes = ", ".join(
        f"{answer.counts[cause]} {text}" for cause, text in MEANINGS.items() if answer.counts[cause]
    )
    azimuth, elevation = answer.sun_deg
    night = f"the Sun is {-elevation:.1f} deg below the horizon, towards azimuth {azimuth:.0f}"
    dark = not answer.usable and elevation < 0.0
    others = "; ".join(filter(None, (causes, night if dark else "")))
    listed = f", {len(answer.rows)} listed" if len(answer.rows) < answer.usable else ""
    return (
        f"{answer.usable} of {answer.counts['in_view']} points in view usable{listed}"
        f"{f' ({others})' if others else ''}; {position_text(answer.position)}; "
        f"located with probability {answer.joint.located:.2f}"
    )


def position_text(position: ExpectedPosition) -> str:
    """The expected accuracy in a few words."""
    if position.covariance is None:
        return f"no position: {position.reason}"
    enu, sigma = position.sigma_enu_m, position.position_sigma_m
    known = position.known_attitude_sigma_m
    assert enu is not None
    assert sigma is not None
    east, north, up = (number(value) for value in enu.tolist())
    exact = "" if known is None else f"; {number(known)} m with an exact attitude"
    names = ", ".join(position.untied)
    tie = (
        f"; no error of the map's place is published for {names}, and none counted" if names else ""
    )
    return (
        f"position to {number(sigma)} m (1 sigma: east {east}, north {north}, up {up}){exact}{tie}"
    )


_WIDTH, _HEIGHT, _LEFT, _TOP, _BOTTOM, _RIGHT = 640.0, 150.0, 84.0, 30.0, 52.0, 16.0
_TICKS = 6
_STYLE = """
svg{background:#fff;font:13px system-ui,sans-serif;fill:#5d6068}.grid{stroke:#d9dade;fill:none}.axis{stroke:#5d6068;fill:none}
.name{fill:#1c1d20;font-weight:600}.end{text-anchor:end}.middle{text-anchor:middle}
.points{fill:none;stroke:#1f5fbf;stroke-width:1.8}.free{fill:none;stroke:#c05a00;stroke-width:1.8}
.known{fill:none;stroke:#2a7f3e;stroke-width:1.8;stroke-dasharray:6 4}.height{fill:none;stroke:#5d6068;stroke-width:1.4}
.hole{fill:#c62320;fill-opacity:.16}
@media(prefers-color-scheme:dark){svg{background:#15161a;fill:#a0a3ad}.grid{stroke:#383b44}.axis{stroke:#a0a3ad}.name{fill:#e9e9ec}
.points{stroke:#6fa8ff}.free{stroke:#f0954a}.known{stroke:#63c27a}.height{stroke:#a0a3ad}.hole{fill:#ff6b66;fill-opacity:.22}}
"""
_UNITS = ((86400.0, "days"), (3600.0, "hours"), (60.0, "minutes"), (1.0, "seconds"))


class TrajectoryChart:
    """Figures of the frames of a trajectory, for charts and for a summary; frames are added one by
    one.
    """

    def __init__(self) -> None:
        self._times: list[str | None] = []
        self._rows: list[tuple[float, float, float, float]] = []

    def add(self, answer: Answer) -> None:
        """Add a frame."""
        position = answer.position
        figures = position.position_sigma_m, position.known_attitude_sigma_m
        free, known = (math.nan if value is None else value for value in figures)
        above = float(np.linalg.norm(answer.sensor_position_m)) - MOON_RADIUS_M
        self._times.append(answer.frame.time_utc)
        self._rows.append((above / 1e3, float(answer.usable), free, known))

    @property
    def _figures(self) -> Array:
        """Altitude in km, usable points, and 1 sigma without and with a known attitude, (4, n)."""
        return np.array(self._rows, np.float64).reshape(-1, 4).T

    @property
    def holes(self) -> list[tuple[str, str, int]]:
        """Runs of frames with fewer than `LEAST_POINTS` usable points: the names of the first and the
        last frame, and their number.
        """
        empty = self._figures[1] < LEAST_POINTS
        return [(self._name(a), self._name(b - 1), b - a) for a, b in _runs(empty)]

    def summary(self) -> list[str]:
        """Lines on the whole trajectory."""
        _, usable, free, _ = self._figures
        known = free[np.isfinite(free)]
        lines = [
            f"{len(usable)} frames: {usable.min():.0f} to {usable.max():.0f} usable points (median {np.median(usable):.0f})"
        ]
        if len(known):
            lines[0] += (
                f"; position to {number(known.min())} to {number(known.max())} m "
                f"(median {number(float(np.median(known)))}, 1 sigma) in {len(known)} frames"
            )
        for first, last, count in self.holes:
            lines.append(
                f"hole: {count} frame{'s' * (count > 1)} with fewer than {LEAST_POINTS} usable points, "
                f"{first if count == 1 else f'{first} to {last}'}"
            )
        return lines

    def _name(self, number_: int) -> str:
        return self._times[number_] or f"frame {number_ + 1}"

    def encode(self, path: Path | str, title: str) -> bytes:
        """The charts as the ending of ``path`` says; ConfigError for another ending."""
        if ending_of(path, (".svg", ".html")) == ".svg":
            return (self._svg(_STYLE) + "\n").encode("utf-8")
        lines = self.summary()
        text = page(
            "trajectory.html.j2",
            title=title,
            heading="Points and position along a trajectory",
            below=title,
            charts=self._svg(""),
            style=Markup(_STYLE),
            lines=lines,
            least=LEAST_POINTS,
        )
        return text.encode("utf-8")

    def _svg(self, style: str) -> Markup:
        """The three charts, one below the other."""
        altitude, usable, free, known = self._figures
        place, title = self._along()
        span = (float(place.min()), float(place.max()))
        low, high = span if span[1] > span[0] else (span[0] - 0.5, span[1] + 0.5)
        time = Axis(low, high, round_ticks(low, high, _TICKS), title, grid=True)
        holes = self._bands(place, usable < LEAST_POINTS, low, high)
        few = f"red: fewer than {LEAST_POINTS} usable points"
        charts = [
            self._chart(time, _from_zero(usable, "usable points"), holes, [("points", usable)], place, few),
            self._chart(
                time, _decades(np.concatenate([free, known]), "position, 1 sigma, m"), holes,
                [("free", free), ("known", known)], place, "solid: attitude as stated; dashed: exact attitude",
            ),
            self._chart(time, _from_zero(altitude, "altitude, km"), [], [("height", altitude)], place, ""),
        ]  # fmt: skip
        return drawing("stacked", charts, _LEFT + _WIDTH + _RIGHT, _TOP + _HEIGHT + _BOTTOM, style)

    def _chart(
        self,
        x: Axis,
        y: Axis,
        bands: list[tuple[float, float]],
        lines: Sequence[tuple[str, Array]],
        place: Array,
        note: str,
    ) -> Markup:
        axes = Axes(x, y, _WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM)
        parts = []
        for start, end in bands:
            (left, right), _ = axes.at([start, end], [y.low, y.low])
            parts.append(
                Markup('<rect class="hole" x="{:.1f}" y="0" width="{:.1f}" height="{:g}"/>').format(
                    left, max(right - left, 1.0), _HEIGHT
                )
            )
        for css, values in lines:
            for a, b in _runs(np.isfinite(values)):
                stretch = slice(a, b) if b - a > 1 else [a, a]
                drawn = np.clip(values[stretch], y.low, y.high)
                parts.append(axes.line(place[stretch], drawn, css))
        if note:
            parts.append(Markup('<text class="end" x="{:g}" y="-9">{}</text>').format(_WIDTH, note))
        return axes.draw(Markup().join(parts), y.title)

    def _along(self) -> tuple[Array, str]:
        """Places of the frames on the time axis, and its title."""
        times = [time for time in self._times if time is not None]
        if len(times) < len(self._times):
            return np.arange(1.0, len(self._times) + 1.0), "frame"
        civil = instants(times).civil
        seconds = (civil - civil[0]) / np.timedelta64(1, "s")
        span = float(np.ptp(seconds))
        unit, name = next(one for one in _UNITS if span >= 2.0 * one[0] or one[0] == 1.0)
        return np.asarray(seconds / unit), f"{name} after {times[0]}"

    @staticmethod
    def _bands(place: Array, empty: Mask, low: float, high: float) -> list[tuple[float, float]]:
        """Stretches of the axis that belong to empty frames: up to the middle to their neighbours."""
        order = np.argsort(place, kind="stable")
        middle = np.concatenate([[low], 0.5 * (place[order][1:] + place[order][:-1]), [high]])
        return [(float(middle[a]), float(middle[b])) for a, b in _runs(empty[order])]


def _runs(where: Mask) -> Iterator[tuple[int, int]]:
    """First index, and index after the last, of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _from_zero(values: Array, title: str) -> Axis:
    high = 1.05 * max(float(values.max()), 1.0)
    return Axis(0.0, high, round_ticks(0.0, high, 5), title, grid=True)


def _decades(values: Array, title: str) -> Axis:
    """A logarithmic axis of whole decades around the finite values."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (1.0, 10.0)
    first = math.floor(math.log10(max(low, 1e-6)))
    last = max(math.ceil(math.log10(max(high, 1e-6))), first + 1)
    ticks = [(10.0**k, number(10.0**k)) for k in range(first, last + 1)]
    return Axis(10.0**first, 10.0**last, ticks, title, log=True, grid=True)
