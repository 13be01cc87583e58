"""Line scanners and push-frame cameras, which assemble the image from lines or narrow frames.

A pixel is seen at its own time, with the position and attitude of the camera at that time. Pixel
centres are at whole numbers. Times are seconds from one instant of the image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..geometry.frames import EnuFrame
from .distortion import FocalPlane
from .sensor import POSE, FullSensor
from .trajectory import Trajectory

CONVERGED = 1e-8
"""Tolerance of the line that sees a point, in lines; rounding of positions is 1e-9 of a line of
0.25 m.
"""

BEYOND = 64
"""Lines (or framelets) before the first and after the last within which a point is sought; such a
point is outside the image.
"""

_AT_ONCE = 1 << 17
_KNOTS = 17
_STEPS = 25
_TURNED_ROUND_RAD = 3.0  # a larger jump is a change of sign behind the camera


class _Kind(Protocol):
    """What each kind of scanner has of its own."""

    @property
    def middle_s(self) -> float:
        """Time of the middle of the image."""

    @property
    def duration_s(self) -> float:
        """Time from the exposure of the first line to that of the last."""

    @property
    def exposures(self) -> Sequence[Self]:
        """Scanners of the parts of the image whose rows are neighbours on the surface, in the order
        of the image's rows: the framelets of a push-frame camera, all of a line scanner.
        """

    def divided(self, count: int) -> Sequence[Self]:
        """Scanners of ``count`` or fewer parts of successive rows, with whole framelets, about equally
        many in each.
        """

    def part(self, window: tuple[int, int, int, int], count: int = 1) -> Self:
        """The scanner of a window of the image (first row, row after the last, first column, column
        after the last), which may lie beyond it, with each pixel divided into ``count`` x ``count``
        equal parts. Of a push-frame camera: only with one framelet.
        """

    def around(self, margin_px: int) -> Self:
        """The scanner of an image that extends by ``margin_px`` or more pixels beyond this one's
        exposures on every side.
        """

    def _found(self, points: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) and times (n,) of points (n, 3)."""

    def _lines(self, rows: Array) -> tuple[Array, Array]:
        """Times (n,) and rows of ``plane`` (n,) of rows (n,)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Scanner(FullSensor, _Kind):
    """Base of both kinds. ``trajectory`` takes MCMF to the axes of ``plane``: right, down, ahead."""

    corrections: ClassVar[tuple[str, ...]] = POSE
    kind: ClassVar[str]

    name: str
    image_shape: tuple[int, int]
    plane: FocalPlane
    trajectory: Trajectory
    sun_position_mcmf_m: Array | None = None
    time_utc: str | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the image."""
        return self.image_shape

    def moved(self, correction: ArrayLike) -> Self:
        """The scanner with all lines shifted by three metres MCMF and rotated about the camera's
        own axes by a vector of three radians.
        """
        six = np.asarray(correction, dtype=np.float64)
        return replace(self, trajectory=self.trajectory.moved(six))

    def project(self, points_mcmf_m: ArrayLike) -> Array:
        """Pixels (..., 2) of MCMF points (..., 3); NaN for points that are not seen within `BEYOND`
        more lines.
        """
        return _in_parts(lambda points: self._found(points)[0], points_mcmf_m)

    def towards(self, points_mcmf_m: ArrayLike) -> Array:
        """Unit directions (..., 3) from points (..., 3) to the camera at the time it sees them; NaN
        for points that are not seen.
        """
        return _in_parts(self._towards, points_mcmf_m)

    def looks(self, pixels: ArrayLike) -> tuple[Array, Array]:
        """Origins and unit directions of the rays of pixels (..., 2), both (..., 3), MCMF; NaN more
        than `BEYOND` lines outside the image.
        """
        given = np.asarray(pixels, dtype=np.float64)
        flat = given.reshape(-1, 2)
        times, on_plane = self._exposed(flat)
        directions = self.trajectory.to_mcmf(times, self.plane.directions(on_plane))
        shape = (*given.shape[:-1], 3)
        return self.trajectory.positions(times).reshape(shape), directions.reshape(shape)

    def rays_enu(self, frame: EnuFrame) -> tuple[Array, Array]:
        """Positions (rows, 3) of the camera at every line, and unit directions (rows, columns, 3) of
        all pixels, in an ENU frame; NaN more than `BEYOND` lines outside the image.
        """
        rows, columns = self.shape
        times, lines = self._lines(np.arange(rows, dtype=np.float64))
        different, which = np.unique(lines, return_inverse=True)
        pixels = np.stack(np.meshgrid(np.arange(float(columns)), different), axis=-1)
        looking = self.plane.directions(pixels)[which]
        axes = [self.trajectory.to_mcmf(times, np.tile(axis, (rows, 1))) for axis in np.eye(3)]
        turned = frame.direction_from_mcmf(np.stack(axes, axis=1))
        return frame.from_mcmf(self.trajectory.positions(times)), looking @ turned

    def _towards(self, points: Array) -> Array:
        away = self.trajectory.positions(self._found(points)[1]) - points
        return np.asarray(away / np.linalg.norm(away, axis=-1, keepdims=True))

    def _exposed(self, pixels: Array) -> tuple[Array, Array]:
        """Times (n,) and pixels of ``plane`` (n, 2) of pixels (n, 2)."""
        times, lines = self._lines(pixels[:, 1])
        return times, np.stack([pixels[:, 0], lines], axis=-1)

    def _on_plane(self, times_s: Array, points: Array) -> Array:
        """Pixels of ``plane`` (n, 2) of points (n, 3) at times (n,)."""
        return self.plane.pixels(self.trajectory.to_camera(times_s, points))

    def _crossing(
        self, time_of: Callable[[Array], Array], span: tuple[float, float], line_px: float, p: Array
    ) -> Array:
        """Argument (n,) of ``time_of`` within ``span`` at which points (n, 3) cross a line of
        ``plane``: the first of several, NaN for none.

        Bracketed by the angle along the track at a few times, then solved by secants.
        """
        start = self._bracketed(time_of, span, line_px, p)
        found = np.full(len(p), np.nan)
        active = np.flatnonzero(np.isfinite(start))
        last = start[active]
        here = np.where(last + 0.5 > span[1], last - 0.5, last + 0.5)
        off_last = self._on_plane(time_of(last), p[active])[:, 1] - line_px
        for _ in range(_STEPS):
            off = self._on_plane(time_of(here), p[active])[:, 1] - line_px
            with np.errstate(divide="ignore", invalid="ignore"):
                step = np.where(off == 0.0, 0.0, -off * (here - last) / (off - off_last))
            done = np.abs(step) <= CONVERGED
            found[active[done]] = (here + step)[done]
            step = np.clip(step, span[0] - here, span[1] - here)
            going = ~done & np.isfinite(step) & (step != 0.0)  # 0: at the end of the span
            if not going.any():
                break
            last, off_last, active = here[going], off[going], active[going]
            here = last + step[going]
        return found

    def _bracketed(
        self, time_of: Callable[[Array], Array], span: tuple[float, float], line_px: float, p: Array
    ) -> Array:
        """Approximate arguments (n,) at which points cross a line, to a small part of the span; NaN
        for points that do not.
        """
        knots = np.linspace(*span, _KNOTS)
        times = time_of(knots)
        middle = self.plane.directions(np.array([self.shape[1] / 2 - 0.5, line_px]))
        level = np.arctan2(middle[1], middle[2])
        angles = np.empty((_KNOTS, len(p)))
        for k, position in enumerate(self.trajectory.positions(times)):
            axes = self.trajectory.to_mcmf(np.repeat(times[k], 2), np.eye(3)[1:])
            down, ahead = ((p - position) @ axis for axis in axes)
            angles[k] = np.arctan2(down, ahead) - level
        first, second = angles[:-1], angles[1:]
        across = (first * second <= 0.0) & (np.abs(second - first) < _TURNED_ROUND_RAD)
        at = np.argmax(across, axis=0)
        a, b = (np.take_along_axis(part, at[None], axis=0)[0] for part in (first, second))
        share = a / np.where(a == b, 1.0, a - b)
        return np.where(across.any(axis=0), knots[at] + share * (knots[1] - knots[0]), np.nan)


@dataclass(frozen=True, eq=False, kw_only=True)
class LineScanner(Scanner):
    """A detector line that is read at successive times.

    ``times_s`` (rows + 2 `BEYOND`,): middle of every line's exposure, including `BEYOND` lines
    before the first and after the last, with linear interpolation between them. ``line_px``: row of
    the line on ``plane``.
    """

    kind: ClassVar[str] = "line scanner"

    times_s: Array
    line_px: float

    def _time(self, rows: Array) -> Array:
        first, times = -float(BEYOND), self.times_s
        return np.interp(rows, first + np.arange(len(times)), times, left=np.nan, right=np.nan)

    def _found(self, points: Array) -> tuple[Array, Array]:
        span = (-float(BEYOND), self.shape[0] - 1.0 + BEYOND)
        rows = self._crossing(self._time, span, self.line_px, points)
        times = self._time(rows)
        columns = self._on_plane(times, points)[:, 0]
        rows = np.where(np.isnan(columns), np.nan, rows)
        return np.stack([columns, rows], axis=-1), np.where(np.isnan(rows), np.nan, times)

    def _lines(self, rows: Array) -> tuple[Array, Array]:
        return self._time(rows), np.full(len(rows), self.line_px)

    @property
    def middle_s(self) -> float:
        return float(self._time(np.array([0.5 * (self.shape[0] - 1)]))[0])

    @property
    def duration_s(self) -> float:
        first, last = self._time(np.array([0.0, self.shape[0] - 1.0]))
        return abs(float(last - first))

    @property
    def exposures(self) -> Sequence[Self]:
        return [self]

    def divided(self, count: int) -> Sequence[Self]:
        rows, cols = self.shape
        high = math.ceil(rows / count)
        return [self.part((r, min(r + high, rows), 0, cols)) for r in range(0, rows, high)]

    def part(self, window: tuple[int, int, int, int], count: int = 1) -> Self:
        row0, row1, col0, col1 = window
        rows = count * (row1 - row0)
        middles = (np.arange(-BEYOND, rows + BEYOND) + 0.5) / count - 0.5 + row0
        return replace(
            self,
            image_shape=(rows, count * (col1 - col0)),
            plane=self.plane.part(col0, 0, count),
            times_s=self._time(middles),
            line_px=(self.line_px + 0.5) * count - 0.5,
        )

    def around(self, margin_px: int) -> Self:
        (rows, cols), by = self.shape, margin_px
        return self.part((-by, rows + by, -by, cols + by))


@dataclass(frozen=True, eq=False, kw_only=True)
class PushFrame(Scanner):
    """Framelets of ``lines`` rows, one below the other, each exposed at once.

    ``first_s``: middle of the exposure of the image's first framelet; ``step_s``: time from one
    framelet to the next, negative if the image holds them in reverse. Rows of ``plane`` are rows
    within a framelet.

    Framelets overlap on the surface. A point that several framelets see is given in the one whose
    middle is nearest; a point in a gap between framelets is in none.
    """

    kind: ClassVar[str] = "push-frame camera"

    lines: int
    first_s: float
    step_s: float

    @property
    def framelets(self) -> int:
        """Number of framelets of the image."""
        return self.shape[0] // self.lines

    def project_near(self, points_mcmf_m: ArrayLike, pixels: ArrayLike) -> Array:
        """Pixels (n, 2) of MCMF points (n, 3) in the framelets of given pixels (n, 2), also beyond
        a framelet's edges. Within a row of an edge: in the framelet that has the point nearer. NaN
        behind the camera.
        """
        points, near = (np.asarray(a, dtype=np.float64) for a in (points_mcmf_m, pixels))
        best = np.full(near.shape, np.nan)
        for by in (0.0, -1.0, 1.0):
            framelet = np.floor((np.nan_to_num(near[:, 1]) + by + 0.5) / self.lines)
            framelet = np.clip(framelet, 0, self.framelets - 1)
            there = self._on_plane(self._time(framelet), points)
            there[:, 1] += framelet * self.lines
            nearer = np.abs(there - near)[:, 1] < np.abs(best - near)[:, 1]
            best = np.where((nearer | np.isnan(best[:, 1]))[:, None], there, best)
        return best

    def _time(self, framelets: Array) -> Array:
        return np.asarray(self.first_s + self.step_s * framelets)

    def _found(self, points: Array) -> tuple[Array, Array]:
        count, middle = self.framelets, 0.5 * (self.lines - 1)
        around = self._crossing(self._time, (-2.0, count + 1.0), middle, points)
        nearest = np.clip(np.nan_to_num(np.round(around)), 0, count - 1)
        best = np.full((len(points), 2), np.nan)
        framelet = nearest
        for step in (0, -1, 1):
            other = np.clip(nearest + step, 0, count - 1)
            there = self._on_plane(self._time(other), points)
            with np.errstate(invalid="ignore"):
                nearer = ~(np.abs(there[:, 1] - middle) >= np.abs(best[:, 1] - middle))
            best, framelet = (
                np.where(nearer[:, None], there, best),
                np.where(nearer, other, framelet),
            )
        before = (best[:, 1] < -0.5) & (framelet > 0)
        after = (best[:, 1] >= self.lines - 0.5) & (framelet < count - 1)
        lost = np.isnan(around) | before | after
        pixels = best + np.stack([np.zeros(len(points)), framelet * self.lines], axis=-1)
        pixels = np.where(lost[:, None], np.nan, pixels)
        return pixels, np.where(np.isnan(pixels[:, 1]), np.nan, self._time(framelet))

    def _lines(self, rows: Array) -> tuple[Array, Array]:
        framelet = np.clip(np.floor((rows + 0.5) / self.lines), 0, self.framelets - 1)
        return self._time(framelet), rows - framelet * self.lines

    @property
    def middle_s(self) -> float:
        return self.first_s + 0.5 * self.step_s * (self.framelets - 1)

    @property
    def duration_s(self) -> float:
        return abs(self.step_s) * (self.framelets - 1)

    @property
    def exposures(self) -> Sequence[Self]:
        return self.divided(self.framelets)

    def divided(self, count: int) -> Sequence[Self]:
        step, cols = math.ceil(self.framelets / count), self.shape[1]
        parts = []
        for first in range(0, self.framelets, step):
            shape = min(step, self.framelets - first) * self.lines, cols
            start = self.first_s + first * self.step_s
            parts.append(replace(self, image_shape=shape, first_s=start))
        return parts

    def part(self, window: tuple[int, int, int, int], count: int = 1) -> Self:
        if self.framelets != 1:
            raise ValueError("a part of a push-frame image is a part of one framelet")
        row0, row1, col0, col1 = window
        rows = count * (row1 - row0)
        return replace(
            self,
            image_shape=(rows, count * (col1 - col0)),
            plane=self.plane.part(col0, row0, count),
            lines=rows,
        )

    def around(self, margin_px: int) -> Self:
        more = math.ceil(margin_px / self.lines)
        return replace(
            self,
            image_shape=(self.shape[0] + 2 * more * self.lines, self.shape[1] + 2 * margin_px),
            plane=self.plane.part(-margin_px, 0),
            first_s=self.first_s - more * self.step_s,
        )


def _in_parts(answer: Callable[[Array], Array], points_mcmf_m: ArrayLike) -> Array:
    """``answer`` for points (..., 3), in parts that keep memory small."""
    points = np.asarray(points_mcmf_m, dtype=np.float64)
    flat = points.reshape(-1, 3)
    parts = [answer(flat[i : i + _AT_ONCE]) for i in range(0, max(len(flat), 1), _AT_ONCE)]
    out = np.concatenate(parts)
    return out.reshape(*points.shape[:-1], out.shape[-1])
