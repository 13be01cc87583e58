"""Information that points give about a sensor's position: normal matrices of the collinearity
equations, the covariance and the dilution of precision that follow, and the choice of points.

The unknowns are the corrections of `cameras.sensor.POSE`: a shift in MCMF, metres, and a rotation
about the camera's own axes, radians. A point i with the derivatives J_i (2 x 6) of its pixel, the
covariance C_i (2 x 2) of its place in the image and the probability p_i that it is found adds
p_i J_i^T C_i^-1 J_i to the normal matrix. Points whose patches overlap have errors in common
(`matching.pose`): with the correlation r_ij and the derivatives a_i in sigmas, the
covariance is N^-1 (N + sum_ij p_i p_j r_ij a_i^T a_j + b b^T) N^-1, with b = sum_i p_i J_i^T C_i^-1 d_i
for an error that moves each place by d_i (`matching.pose`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Array, Index
from ..matching.common_errors import SharedTerrain
from ..matching.pose import covariance_of

FIRST_SIGMAS = 3.0
"""1 sigma of the position before the first point of `best_points`, in mean distances of the points;
of the attitude in radians, where it is not stated.
"""


@dataclass(frozen=True, eq=False)
class Information:
    """What n points say about a sensor's position."""

    slopes: Array  # (n, 2, 6) derivatives of the pixels with respect to the corrections
    covariance_px2: Array  # (n, 2, 2) of the places in the image
    probability: Array  # (n,) that the point is found
    attitude_sigma_rad: float = math.inf  # known before, about each axis; inf: not, 0: exact
    shared: SharedTerrain | None = None  # points with common errors; None: there are none
    shift_px: Array | None = (
        None  # (n, 2) by which 1 sigma of an error moves all places; None: no such
    )

    def __len__(self) -> int:
        return len(self.probability)

    def some(self, which: Index) -> Information:
        """Those points alone."""
        return Information(
            self.slopes[which],
            self.covariance_px2[which],
            self.probability[which],
            self.attitude_sigma_rad,
            None if self.shared is None else self.shared.some(which),
            None if self.shift_px is None else self.shift_px[which],
        )

    @cached_property
    def whitened(self) -> Array:
        """Derivatives (n, 2, 6) in sigmas, times the square root of the probability."""
        root = np.linalg.inv(np.linalg.cholesky(self.covariance_px2))
        return np.asarray(np.sqrt(self.probability)[:, None, None] * (root @ self.slopes))

    @cached_property
    def normal(self) -> Array:
        """Normal matrix (6, 6) of the points alone."""
        rows = self.whitened.reshape(-1, 6)
        return np.asarray(rows.T @ rows)

    def covariance(self) -> Array | None:
        """Covariance (6, 6) of the corrections by least squares with the points' own covariances as
        weights, with the attitude known as stated; None if the points do not determine them. An
        exact attitude has zeros.
        """
        alone = _with_attitude(self.normal, self.attitude_sigma_rad)
        return None if alone is None else alone + alone @ self.common @ alone

    @cached_property
    def common(self) -> Array:
        """What errors common to several points add to the covariance (6, 6) of the right side of the
        normal equations.
        """
        return self.common_shift + self.common_terrain

    @cached_property
    def common_terrain(self) -> Array:
        """`common` by the terrain that patches share."""
        if self.shared is None:
            return np.zeros((6, 6))
        weight = np.sqrt(self.probability)[:, None, None]  # a pair counts if both are found
        return self.shared.cross(weight * self.whitened)

    @cached_property
    def common_shift(self) -> Array:
        """`common` by the error that moves all places."""
        if self.shift_px is None:
            return np.zeros((6, 6))
        weight = np.linalg.inv(self.covariance_px2)
        pull = np.einsum("n,nai,nab,nb->i", self.probability, self.slopes, weight, self.shift_px)
        return np.outer(pull, pull)

    def terrain_part(self) -> Array:
        """Part (6, 6) of `covariance` by the terrain that patches share."""
        gain = self._gain()
        return np.asarray(gain @ self.common_terrain @ gain)

    def shift_part(self) -> Array:
        """Part (6, 6) of `covariance` by the error that moves all places."""
        gain = self._gain()
        return np.asarray(gain @ self.common_shift @ gain)

    def part_of(self, covariance_px2: Array) -> Array:
        """Part (6, 6) of `covariance` by errors of the places whose covariances (n, 2, 2) are a part of
        ``covariance_px2``. The parts of all errors, `attitude_part` of the attitude known before,
        `terrain_part` and `shift_part` are the whole. LinAlgError if the points do not determine the
        corrections.
        """
        weight = np.linalg.inv(self.covariance_px2)
        pull = np.swapaxes(self.slopes, -1, -2) @ weight  # (n, 6, 2)
        inner = np.einsum("n,nia,nab,njb->ij", self.probability, pull, covariance_px2, pull)
        gain = self._gain()
        return np.asarray(gain @ inner @ gain)

    def attitude_part(self) -> Array:
        """Part (6, 6) of `covariance` by the errors of the attitude as it was known before."""
        if not 0.0 < self.attitude_sigma_rad < math.inf:
            return np.zeros((6, 6))
        gain = self._gain()
        return np.asarray(gain[:, 3:] @ gain[3:] / self.attitude_sigma_rad**2)

    def _gain(self) -> Array:
        """Inverse (6, 6) of the normal matrix with the attitude as known before."""
        found = _with_attitude(self.normal, self.attitude_sigma_rad)
        if found is None:
            raise np.linalg.LinAlgError("the points do not determine position and attitude")
        return found

    def covariance_known_attitude(self) -> Array | None:
        """Covariance (3, 3), m^2, of the position if the attitude is exact."""
        alone = covariance_of(self.normal[:3, :3])
        return None if alone is None else alone + alone @ self.common[:3, :3] @ alone


def _with_attitude(normal: Array, sigma_rad: float) -> Array | None:
    if sigma_rad == 0.0:
        position = covariance_of(normal[:3, :3])
        return None if position is None else np.pad(position, ((0, 3), (0, 3)))
    return covariance_of(normal + np.diag(np.repeat([0.0, sigma_rad**-2.0], 3)))


def dilution(slopes: Array, pixel_m: Array, attitude_sigma_rad: float = math.inf) -> Array | None:
    """Dilution of precision: the cofactor matrix (3, 3) of the position for errors of 1 m of each
    point's place, in both directions across the line of sight; without unit. None if the points do
    not determine the position.

    ``slopes`` (n, 2, 6) of the pixels, ``pixel_m`` (n,) their sizes on the ground. An attitude that
    is known but not exact counts as unknown.
    """
    rows = (slopes * pixel_m[:, None, None]).reshape(-1, 6)
    exact = attitude_sigma_rad == 0.0
    found = _with_attitude(rows.T @ rows, 0.0 if exact else math.inf)
    return None if found is None else found[:3, :3]


def best_points(information: Information, distance_m: float, most: int) -> Index:
    """Indices (m,) of at most ``most`` points, the most informative first: each is the one that adds
    most to the logarithm of the determinant of the normal matrix (D-optimal, greedy).

    A greedy choice reaches at least 63 % of the best gain, because the gain of a point falls as
    others are added (Nemhauser et al. 1978). Before the first point the position is known to
    `FIRST_SIGMAS` times ``distance_m``, the mean distance of the points, and the attitude as stated.
    """
    attitude = min(information.attitude_sigma_rad, FIRST_SIGMAS)
    unit = np.repeat([FIRST_SIGMAS * distance_m, attitude], 3)
    rows = information.whitened * unit  # the covariance before is the unit matrix
    covariance = np.eye(6)
    spread = rows @ np.swapaxes(rows, -1, -2)  # (n, 2, 2) of the pixels, in their own sigmas
    chosen: list[int] = []
    free = np.ones(len(information), bool)
    while len(chosen) < min(most, len(information)):
        gain = (1.0 + spread[:, 0, 0]) * (1.0 + spread[:, 1, 1]) - spread[:, 0, 1] ** 2
        best = int(np.argmax(np.where(free, gain, -1.0)))
        chosen.append(best)
        free[best] = False
        root = np.linalg.inv(np.linalg.cholesky(np.eye(2) + spread[best]))
        step = covariance @ rows[best].T @ root.T  # (6, 2): covariance less step step^T
        covariance = covariance - step @ step.T
        moved = rows @ step
        spread = spread - moved @ np.swapaxes(moved, -1, -2)
    return np.array(chosen, np.int64)
