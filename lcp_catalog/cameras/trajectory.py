"""Where a spacecraft was and how it was turned, at any time, from tables of positions and rotations.

Between the times of a table a position runs on the cubic that has the table's positions and velocities (Hermite), without
velocities on the polynomial through the eight nearest times (Lagrange); a rotation turns at a constant rate from one time
to the next (slerp). That is how the tables of ISIS are thinned out, so it is what they were made for; where they hold a row
for every line, all ways agree. Beyond a table its last speed and its last rate go on.
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
    """Positions (n, 3) in metres at rising times (n,) in seconds, with velocities (n, 3) in m/s or without."""

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
        return self._hermite(i, inside) + beyond * ends

    def _hermite(self, i: NDArray[np.intp], times_s: Array) -> Array:
        assert self.velocities_m_s is not None
        step = (self.times_s[i + 1] - self.times_s[i])[:, None]
        s = (times_s - self.times_s[i])[:, None] / step
        p, q = self.positions_m[i], self.positions_m[i + 1]
        v, w = step * self.velocities_m_s[i], step * self.velocities_m_s[i + 1]
        run = q - p  # p itself is large: what is added to it is kept small
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
        return np.where(beyond > 0.0, last, first)


@dataclass(frozen=True, eq=False)
class Turning:
    """Rotations at rising times (n,) in seconds: quaternions (n, 4), w first."""

    times_s: Array
    quaternions: Array

    @classmethod
    def of_table(cls, times_s: Array, quaternions: Array, after: Array) -> Turning:
        """From a table of quaternions of any sign, and one fixed rotation (3, 3) that comes after all of them."""
        return cls(times_s, product(quaternion_of(after), same_sides(quaternions)))

    def then(self, rotation: Array) -> Turning:
        """With one fixed rotation (4,) more after all of them."""
        return Turning(self.times_s, product(rotation, self.quaternions))

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
    """The interval of ``nodes`` that each time lies in, the first and the last also for what lies beyond."""
    return np.clip(np.searchsorted(nodes, times_s, side="right") - 1, 0, len(nodes) - 2)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A camera over the turning Moon. ``track`` is in inertial axes, or body-fixed (``fixed``); ``body`` turns inertial axes
    to MCMF, ``pointing`` inertial axes to the camera's. ``shift_m`` (3,) is added to all positions in MCMF.
    """

    track: Track
    body: Turning
    pointing: Turning
    fixed: bool = False
    shift_m: Array | None = None

    def moved(self, correction: Array) -> Trajectory:
        """Shifted by three metres MCMF and turned about the camera's own axes by a vector of three radians, at all times."""
        shift = correction[:3] if self.shift_m is None else self.shift_m + correction[:3]
        turn = quaternion_of(by_vector(correction[3:]))
        return replace(self, shift_m=shift, pointing=self.pointing.then(turn))

    def turned_by(self, rotation: Array) -> Trajectory:
        """To other axes of the camera: a rotation (3, 3) comes after its attitude."""
        return replace(self, pointing=self.pointing.then(quaternion_of(rotation)))

    def positions(self, times_s: Array) -> Array:
        """MCMF metres (m, 3)."""
        return self._positions(times_s, self.body.at(times_s))

    def _positions(self, times_s: Array, body: Array) -> Array:
        there = self.track.at(times_s)
        there = there if self.fixed else turned(body, there)
        return there if self.shift_m is None else there + self.shift_m

    def seen(self, times_s: Array, points: Array) -> Array:
        """MCMF points (m, 3) in camera axes, metres from the camera, each at its time (m,)."""
        body = self.body.at(times_s)
        to_camera = product(self.pointing.at(times_s), inverse(body))
        return turned(to_camera, points - self._positions(times_s, body))

    def to_mcmf(self, times_s: Array, directions: Array) -> Array:
        """Directions (m, 3) of camera axes in MCMF, each at its time (m,)."""
        to_mcmf = product(self.body.at(times_s), inverse(self.pointing.at(times_s)))
        return turned(to_mcmf, directions)
