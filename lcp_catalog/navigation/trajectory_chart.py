"""Charts of a trajectory: usable points and expected accuracy of the position over the time, with the
holes, as an SVG or as a page.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from ..arrays import Array, Mask
from ..choices import CHART_ENDINGS
from ..constants import MOON_RADIUS_M
from ..ephemeris.times import instants
from ..errors import OutputError
from ..plots.axes import Axes, Axis, round_ticks
from ..plots.html_page import page
from ..plots.numbers import number
from .expected_position import LEAST_POINTS, Answer

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
        """The charts as the ending of ``path`` says; OutputError for another ending."""
        ending = Path(path).suffix.lower()
        if ending not in CHART_ENDINGS:
            raise OutputError(f"{path}: the ending must be {' or '.join(CHART_ENDINGS)}")
        if ending == ".svg":
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
        charts = [
            self._chart(time, _from_zero(usable, "usable points"), holes, [("points", usable)], place, ""),
            self._chart(
                time, _decades(np.concatenate([free, known]), "1 sigma, m"), holes,
                [("free", free), ("known", known)], place, "solid: attitude as stated; dashed: exact attitude",
            ),
            self._chart(time, _from_zero(altitude, "altitude, km"), [], [("height", altitude)], place, ""),
        ]  # fmt: skip
        wide, tall = _LEFT + _WIDTH + _RIGHT, _TOP + _HEIGHT + _BOTTOM
        parts = [
            Markup('<svg x="0" y="{:g}" width="{:g}" height="{:g}">{}</svg>').format(
                k * tall, wide, tall, chart
            )
            for k, chart in enumerate(charts)
        ]
        head = Markup('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {:g} {:g}">').format(
            wide, len(charts) * tall
        )
        own = Markup("<style>{}</style>").format(Markup(style)) if style else Markup()
        return head + own + Markup().join(parts) + Markup("</svg>")

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
