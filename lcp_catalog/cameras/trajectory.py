"""Position and attitude of a spacecraft at any time, from tables of positions and rotations.

Between the times of a table a position follows the cubic through the positions and velocities
(Hermite), or, without velocities, the polynomial through the eight nearest times (Lagrange). A
rotation has a constant rate between two times (slerp). ISIS reduces its tables for the same
interpolations; if a table has a row for every line, all methods agree. Beyond a table the last
velocity and the last rate continue.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..geometry.rotations import (
    apart_rad,
    between,
    by_vector,
    inverse,
    product,
    quaternion_of,
    same_sides,
    turned,
)

_NEAREST = 8


@dataclass(frozen=True, eq=False)
class Track:
    """Positions (n, 3) in metres at increasing times (n,) in seconds, with velocities (n, 3) in m/s
    or None.
    """

    times_s: Array
    positions_m: Array
    velocities_m_s: Array | None = None

    def at(self, times_s: Array) -> Array:
        """Positions (m, 3) at times (m,)."""
        inside = np.clip(times_s, self.times_s[0], self.times_s[-1])
        beyond = (times_s - inside)[:, None]
        if len(self.times_s) == 1:
            speed = 0.0 if self.velocities_m_s is None else self.velocities_m_s
            return np.asarray(self.positions_m + beyond * speed)
        if self.velocities_m_s is None:
            return self._lagrange(inside) + beyond * self._end_speeds(beyond)
        i = _before(self.times_s, inside)
        ends = np.where(beyond > 0.0, self.velocities_m_s[-1], self.velocities_m_s[0])
        return np.asarray(self._hermite(i, inside) + beyond * ends)

    def _hermite(self, i: NDArray[np.intp], times_s: Array) -> Array:
        assert self.velocities_m_s is not None
        step = (self.times_s[i + 1] - self.times_s[i])[:, None]
        s = (times_s - self.times_s[i])[:, None] / step
        p, q = self.positions_m[i], self.positions_m[i + 1]
        v, w = step * self.velocities_m_s[i], step * self.velocities_m_s[i + 1]
        run = q - p  # p is large: add only small terms to it
        return np.asarray(p + s * (v + s * (3 * run - 2 * v - w + s * (v + w - 2 * run))))

    def _lagrange(self, times_s: Array) -> Array:
        count = min(_NEAREST, len(self.times_s))
        first = np.clip(
            _before(self.times_s, times_s) - count // 2 + 1, 0, len(self.times_s) - count
        )
        nodes = first[:, None] + np.arange(count)
        off = times_s[:, None] - self.times_s[nodes]
        weights = np.ones_like(off)
        for j in range(count):
            for k in range(count):
                if k != j:
                    apart = self.times_s[nodes[:, j]] - self.times_s[nodes[:, k]]
                    weights[:, j] *= off[:, k] / apart
        centre = self.positions_m[nodes[:, :1]]
        return np.asarray(
            centre[:, 0] + np.einsum("ij,ijk->ik", weights, self.positions_m[nodes] - centre)
        )

    def _end_speeds(self, beyond: Array) -> Array:
        t, p = self.times_s, self.positions_m
        first, last = (p[1] - p[0]) / (t[1] - t[0]), (p[-1] - p[-2]) / (t[-1] - t[-2])
        return np.asarray(np.where(beyond > 0.0, last, first))


@dataclass(frozen=True, eq=False)
class Attitude:
    """Rotations at increasing times (n,) in seconds: quaternions (n, 4), w first."""

    times_s: Array
    quaternions: Array

    @classmethod
    def of_table(cls, times_s: Array, quaternions: Array, after: Array) -> Attitude:
        """From a table of quaternions of any sign, followed by a fixed rotation (3, 3)."""
        return cls(times_s, product(quaternion_of(after), same_sides(quaternions)))

    def then(self, rotation: Array) -> Attitude:
        """The same rotations followed by a fixed rotation (4,)."""
        return Attitude(self.times_s, product(rotation, self.quaternions))

    @cached_property
    def _steps_rad(self) -> Array:
        return apart_rad(self.quaternions[:-1], self.quaternions[1:])

    def at(self, times_s: Array) -> Array:
        """Quaternions (m, 4) at times (m,)."""
        if len(self.times_s) == 1:
            return np.broadcast_to(self.quaternions[0], (len(times_s), 4))
        i = _before(self.times_s, times_s)
        share = (times_s - self.times_s[i]) / (self.times_s[i + 1] - self.times_s[i])
        return between(self.quaternions[i], self.quaternions[i + 1], self._steps_rad[i], share)


def _before(nodes: Array, times_s: Array) -> NDArray[np.intp]:
    """Index of the interval of ``nodes`` that contains each time; the first and the last interval
    also for times beyond.
    """
    return np.clip(np.searchsorted(nodes, times_s, side="right") - 1, 0, len(nodes) - 2)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Trajectory of a camera over the rotating Moon.

    ``track`` is in inertial axes, or body-fixed (``fixed``). ``body`` rotates inertial axes to
    MCMF, ``pointing`` inertial axes to those of the camera. ``shift_m`` (3,) is added to all
    positions in MCMF.
    """

    track: Track
    body: Attitude
    pointing: Attitude
    fixed: bool = False
    shift_m: Array | None = None

    def moved(self, correction: Array) -> Trajectory:
        """The trajectory shifted by three metres MCMF and rotated about the camera's axes by a
        vector of three radians, at all times.
        """
        shift = correction[:3] if self.shift_m is None else self.shift_m + correction[:3]
        turn = quaternion_of(by_vector(correction[3:]))
        return replace(self, shift_m=shift, pointing=self.pointing.then(turn))

    def with_axes(self, rotation: Array) -> Trajectory:
        """The trajectory for other camera axes: a rotation (3, 3) follows the attitude."""
        return replace(self, pointing=self.pointing.then(quaternion_of(rotation)))

    def positions(self, times_s: Array) -> Array:
        """MCMF positions (m, 3), metres."""
        return self._positions(times_s, self.body.at(times_s))

    def _positions(self, times_s: Array, body: Array) -> Array:
        there = self.track.at(times_s)
        there = there if self.fixed else turned(body, there)
        return there if self.shift_m is None else there + self.shift_m

    def to_camera(self, times_s: Array, points: Array) -> Array:
        """MCMF points (m, 3) in camera axes, metres from the camera, each at its time (m,)."""
        body = self.body.at(times_s)
        to_camera = product(self.pointing.at(times_s), inverse(body))
        return turned(to_camera, points - self._positions(times_s, body))

    def to_mcmf(self, times_s: Array, directions: Array) -> Array:
        """MCMF directions (m, 3) of directions in camera axes, each at its time (m,)."""
        to_mcmf = product(self.body.at(times_s), inverse(self.pointing.at(times_s)))
        return turned(to_mcmf, directions)
