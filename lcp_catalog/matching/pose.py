"""Correction of a sensor's position and attitude from points found in its image: weighted least
squares with a prior, and its covariance.

The unknowns c are the sensor's own corrections (`Sensor.moved`), so that a framing camera, a
scanner and a map-projected image are solved alike. Minimised over c, counted from the given sensor:

    sum_i  rho( (found_i - project_c(X_i))^T  C_i^-1  (found_i - project_c(X_i)) )  +  sum_j (c_j / sigma_j)^2

with C_i the covariance of a place in the image and sigma_j the prior: Gauss-Newton with Levenberg's
damping. The Jacobian is computed by central differences over a tenth of a pixel; for a pinhole its
relative error is (0.1 px / f)^2, below 1e-6 from f = 100 px on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Mask
from ..cameras.frame_camera import Camera
from ..cameras.sensor import POSE, Sensor, Uncertainty, mean_step, middle_ray, pixel_size_m
from ..errors import CameraError, PoseError
from .common_errors import SharedTerrain

STEP_PX = 0.1
"""Shift of the image, about, by which a correction is varied for the Jacobian."""

HUBER = 2.5
"""Distance in sigmas beyond which a place counts linearly, not squared (Huber's loss), if no
inliers are stated.
"""

_STEPS = 40
_CONVERGED = 1e-4
"""The iteration ends when no unknown moves by more than this share of its own sigma."""
_CONDITION = 1e13


@dataclass(frozen=True, eq=False)
class Pose:
    """A sensor corrected by k numbers, from n points.

    ``covariance`` is that of the correction, in metres and radians squared, with zero rows for
    fixed corrections. Its part from the points is the formal one times ``scale``: if the residuals
    are larger than the points' covariances (``normalised_error`` > 1), the points count that much
    less; smaller residuals do not improve it.
    """

    sensor: Sensor
    correction: Array  # (k,)
    covariance: Array  # (k, k)
    solved: Mask  # (k,)
    used: Mask  # (n,)
    chi2: float  # of the used points' residuals, with their own covariances
    dof: float  # its expectation: 2 per point, less the unknowns that the points decided

    @property
    def normalised_error(self) -> float:
        """chi2 / dof, 1 for right covariances; NaN if there are too few points for a test."""
        return self.chi2 / self.dof if self.dof >= 1.0 else float("nan")

    @property
    def scale(self) -> float:
        """Factor by which the points' covariances were multiplied."""
        return _scale(self.chi2, self.dof)

    @property
    def sigma(self) -> Array:
        """1 sigma of each correction, (k,); 0 for fixed ones."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def position_mcmf_m(self) -> Array:
        """Position (3,) of the corrected sensor, MCMF metres; of a scanner, at the middle line of
        its image. ValueError for a map-projected image, which has no position.
        """
        if self.sensor.corrections != POSE:
            raise ValueError(f"{self.sensor.name}: a map-projected image has no position")
        return middle_ray(self.sensor)[0]

    @property
    def position_covariance_m2(self) -> Array:
        """Covariance (3, 3) of `position_mcmf_m`; of a map-projected image (2, 2), of its shift
        east and north.
        """
        length = 3 if self.sensor.corrections == POSE else len(self.correction)
        return self.covariance[:length, :length]

    @property
    def position_sigma_m(self) -> float:
        """1 sigma of the position, all directions together: the square root of its covariance's
        trace.
        """
        return float(np.sqrt(np.trace(self.position_covariance_m2)))


@dataclass(frozen=True)
class SightSplit:
    """An error of position, or its sigma, in metres: total, across the line of sight (both
    directions together), and along it.
    """

    whole_m: float
    across_m: float
    along_m: float


@dataclass(frozen=True)
class PositionError:
    """Difference between a solved and a known position. ``squared`` is the squared error in units
    of the stated covariance; its expectation is 3.
    """

    error: SightSplit
    sigma: SightSplit
    squared: float


def jacobian(sensor: Sensor, points_mcmf_m: ArrayLike) -> Array:
    """Derivatives (n, 2, k) of the pixels of ground points (n, 3) with respect to the sensor's k
    corrections, pixels per metre and per radian; NaN for points that the sensor cannot see.
    """
    points = np.asarray(points_mcmf_m, dtype=np.float64)
    if isinstance(sensor, Camera):
        return _frame_jacobian(sensor, points)
    here = sensor.project(points)
    columns = []
    for step in np.diag(_steps(sensor, points)):
        ahead, behind = (sensor.moved(sign * step).project(points) for sign in (1.0, -1.0))
        columns.append(mean_step(ahead - here, here - behind) / step.sum())
    return np.stack(columns, axis=-1)


def _frame_jacobian(camera: Camera, points: Array) -> Array:
    """`jacobian` of a framing camera, whose pixel depends on the place v of the point in camera axes
    alone: a shift of the camera by d moves v by -R d, a turn t by t x v.
    """
    rotation = camera.rotation_mcmf_to_camera
    places = (points - camera.position_mcmf_m) @ rotation.T
    step = STEP_PX / camera.focal_length_px * np.linalg.norm(places, axis=-1, keepdims=True)
    pixels = camera.focal_plane.pixels
    by_place = np.stack(
        [(pixels(places + step * e) - pixels(places - step * e)) / (2.0 * step) for e in np.eye(3)],
        axis=-1,
    )
    turns = np.stack([np.cross(e, places) for e in np.eye(3)], axis=-1)
    return np.concatenate([-by_place @ rotation, by_place @ turns], axis=-1)


def solve(
    sensor: Sensor,
    points_mcmf_m: ArrayLike,
    found_px: ArrayLike,
    covariance_px2: ArrayLike,
    uncertainty: Uncertainty,
    inliers: ArrayLike | None = None,
    shared: SharedTerrain | None = None,
    common_px: float = 0.0,
    shift_px: ArrayLike | None = None,
    map_m: float = 0.0,
) -> Pose:
    """The sensor corrected by points (n, 3), MCMF metres, found at pixels (n, 2), each with its
    covariance (n, 2, 2).

    ``inliers`` (n,): the points that count, all alike. None: all points, with Huber's weights. An
    infinite sigma in the uncertainty is no prior; a sigma of 0 fixes a correction. Raises PoseError
    if no point remains, or if the points do not determine a correction without a prior.

    ``shared``: pairs of the n points whose patches overlap, so that they have errors in common.
    ``common_px``: 1 sigma of an error that is the same for all places, in either coordinate.
    ``shift_px`` (n, 2): 1 sigma of an error that moves every place by its own shift times one number.
    ``map_m``: 1 sigma, each axis, of an error of place that is the same for all points.
    They add to the covariance and change nothing else.
    """
    problem = _problem(
        sensor, points_mcmf_m, found_px, covariance_px2, uncertainty.sigmas(sensor), inliers
    )
    first = last = problem.solved()
    if first.scale > 1.0:
        problem = replace(problem, whitening=problem.whitening / np.sqrt(first.scale))
        last = problem.solved(first.unknown)
    corrected = problem.corrected(last.unknown)
    return Pose(
        sensor=corrected,
        correction=problem.correction(last.unknown),
        covariance=problem.covariance(last.matrix)
        + problem.pulled(last, common_px * np.eye(2))
        + problem.pulled(last, _columns(shift_px))
        + problem.pulled(last, _with_the_map(corrected, points_mcmf_m, map_m))
        + problem.shared(last, shared),
        solved=problem.sigmas > 0.0,
        used=problem.used,
        chi2=first.chi2,
        dof=first.dof,
    )


def _columns(shift_px: ArrayLike | None) -> Array:
    return np.zeros((2, 1)) if shift_px is None else np.asarray(shift_px, np.float64)[..., None]


def _with_the_map(sensor: Sensor, points_mcmf_m: ArrayLike, map_m: float) -> Array:
    """What ``map_m`` along each axis of a sensor's place moves its points by, (n, 2, 3), or (n, 2, 2) of a map's."""
    if map_m == 0.0:
        return np.zeros((2, 1))
    return map_m * jacobian(sensor, points_mcmf_m)[..., :3]


def residuals_px(sensor: Sensor, points_mcmf_m: ArrayLike, found_px: ArrayLike) -> Array:
    """Found minus expected pixels (n, 2) of points (n, 3) found at pixels (n, 2); NaN if not found,
    or behind the sensor. For a push-frame camera the expected pixel is that in the framelet where
    the point was found (`project_near`).
    """
    return np.asarray(found_px) - sensor.project_near(points_mcmf_m, found_px)


def _scale(chi2: float, dof: float) -> float:
    return max(1.0, chi2 / dof) if dof >= 1.0 else 1.0


def _steps(sensor: Sensor, points: Array) -> Array:
    """Step (k,) by which each correction is varied: what moves the image by `STEP_PX`."""
    ground_m = float(np.nanmedian(pixel_size_m(sensor, points)))
    if not np.isfinite(ground_m):
        raise PoseError(f"{sensor.name}: none of the {len(points)} points lies in front of it")
    if sensor.corrections != POSE:
        return np.full(len(sensor.corrections), STEP_PX * ground_m)
    range_m = float(np.median(np.linalg.norm(points - middle_ray(sensor)[0], axis=-1)))
    return np.repeat([STEP_PX * ground_m, STEP_PX * ground_m / range_m], 3)


def _problem(
    sensor: Sensor,
    points_mcmf_m: ArrayLike,
    found_px: ArrayLike,
    covariance_px2: ArrayLike,
    sigmas: Array,
    inliers: ArrayLike | None,
) -> _Problem:
    points, found, covariance = (
        np.asarray(a, dtype=np.float64) for a in (points_mcmf_m, found_px, covariance_px2)
    )
    used = np.asarray(np.isfinite(found).all(-1) & np.isfinite(covariance).all((-1, -2)))
    used &= np.isfinite(sensor.project(points)).all(-1)
    if inliers is not None:
        used &= np.asarray(inliers, dtype=bool)
    if not used.any():
        raise PoseError(f"{sensor.name}: no point was found, so its position cannot be solved")
    whitening = np.linalg.inv(np.linalg.cholesky(covariance[used]))
    huber = HUBER if inliers is None else np.inf
    return _Problem(sensor, points[used], found[used], whitening, sigmas, huber, used)


class _Solved(NamedTuple):
    """The unknowns (f,), the points' normal matrix (f, f), and chi2 with its expectation."""

    unknown: Array
    matrix: Array
    chi2: float
    dof: float

    @property
    def scale(self) -> float:
        """Factor by which the points' covariances have to grow; at least 1."""
        return _scale(self.chi2, self.dof)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least squares over the free corrections, each in units of its own step of about `STEP_PX`."""

    sensor: Sensor
    points: Array  # (m, 3) the used ones
    found: Array  # (m, 2)
    whitening: Array  # (m, 2, 2) inverse Cholesky factors of the covariances
    sigmas: Array  # (k,)
    huber: float
    used: Mask  # (n,)

    @cached_property
    def free(self) -> NDArray[np.int64]:
        return np.flatnonzero(self.sigmas > 0.0)

    @cached_property
    def steps(self) -> Array:
        """Metres or radians per unit of each free unknown."""
        return _steps(self.sensor, self.points)[self.free]

    @cached_property
    def prior(self) -> Array:
        """Inverse variance of each free unknown, in its units; 0 for none."""
        return (self.steps / self.sigmas[self.free]) ** 2

    def corrected(self, unknown: Array) -> Sensor:
        return self.sensor.moved(self.correction(unknown))

    def correction(self, unknown: Array) -> Array:
        full = np.zeros(len(self.sigmas))
        full[self.free] = unknown * self.steps
        return full

    def residual(self, unknown: Array) -> Array:
        """Whitened residuals (m, 2); NaN for points that the corrected sensor does not see, and for
        all points if the correction is no valid camera (a step too long may end deep inside the
        Moon).
        """
        try:
            sensor = self.corrected(unknown)
        except CameraError:
            return np.full(self.found.shape, np.nan)
        off = residuals_px(sensor, self.points, self.found)
        return np.asarray(np.einsum("nij,nj->ni", self.whitening, off))

    def weights(self, residual: Array) -> Array:
        """Huber's weights, (m,)."""
        far = np.linalg.norm(residual, axis=-1)
        return np.asarray(np.minimum(1.0, self.huber / np.maximum(far, 1e-300)))

    def cost(self, unknown: Array, residual: Array) -> float:
        """Huber's loss and the prior; infinite if a point is not seen."""
        far = np.linalg.norm(residual, axis=-1)
        with np.errstate(invalid="ignore"):
            linear = 2.0 * self.huber * far - self.huber**2
            loss = np.where(far <= self.huber, far**2, linear)
        total = float(loss.sum() + (self.prior * unknown**2).sum())
        return total if np.isfinite(total) else np.inf

    def slope(self, unknown: Array) -> Array:
        """d(residual) / d(unknown), whitened, (m, 2, f), by central differences of one unit."""
        ahead, behind = (
            np.stack([self.residual(unknown + s * e) for e in np.eye(len(unknown))], axis=-1)
            for s in (1.0, -1.0)
        )
        return np.asarray((ahead - behind) / 2.0)

    def normal(self, unknown: Array, residual: Array) -> tuple[Array, Array]:
        """The points' own normal matrix (f, f) and the gradient of half the cost (f,)."""
        slope = self.slope(unknown)
        weight = self.weights(residual)
        matrix = np.einsum("n,nia,nib->ab", weight, slope, slope)
        gradient = np.einsum("n,nia,ni->a", weight, slope, residual) + self.prior * unknown
        return matrix, gradient

    def solved(self, start: Array | None = None) -> _Solved:
        """The unknowns with the least cost; Levenberg's damping grows after a step that increases
        it. The last step is too small to need another Jacobian.
        """
        unknown = np.zeros(len(self.free)) if start is None else start
        residual, damping = self.residual(unknown), 0.0
        cost = self.cost(unknown, residual)
        if not np.isfinite(cost):
            raise PoseError(f"{self.sensor.name}: not all points lie in front of it")
        matrix = np.zeros((len(unknown),) * 2)
        for _ in range(_STEPS if len(unknown) else 0):
            matrix, gradient = self.normal(unknown, residual)
            covariance = self.inverse(matrix)
            damped = matrix + np.diag(self.prior + damping * np.diag(matrix))
            tried = unknown - np.linalg.solve(damped, gradient)
            off = self.residual(tried)
            worth = self.cost(tried, off)
            small = (np.abs(tried - unknown) <= _CONVERGED * np.sqrt(np.diag(covariance))).all()
            if worth <= cost:
                unknown, residual, cost, damping = tried, off, worth, damping / 10.0
            else:
                damping = max(1e-4, damping * 10.0)
            if small:
                break
        return self._judged(unknown, residual, matrix)

    def _judged(self, unknown: Array, residual: Array, matrix: Array) -> _Solved:
        """The solution with the points' chi2 and its expectation, 2 m - trace(covariance times the
        points' normal matrix).

        For a maximum a posteriori estimate, whose residuals have the covariance C (C + J P J^T)^-1
        C, this is exact for a linear problem and a right prior; without a prior it is the usual 2 m
        - f.
        """
        weight = self.weights(residual)
        chi2 = float((weight * (residual**2).sum(-1)).sum())
        decided = float(np.trace(self.inverse(matrix) @ matrix)) if len(unknown) else 0.0
        return _Solved(unknown, matrix, chi2, 2.0 * float(weight.sum()) - decided)

    def inverse(self, matrix: Array) -> Array:
        """Covariance (f, f) of the unknowns, from the points' normal matrix and the prior."""
        found = covariance_of(matrix + np.diag(self.prior))
        if found is None:
            raise PoseError(
                f"{self.sensor.name}: {len(self.points)} points do not determine a correction without a "
                "prior; state an uncertainty, or give more points"
            )
        return found

    def shared(self, last: _Solved, pairs: SharedTerrain | None) -> Array:
        """Contribution of the errors that points have in common to the covariance (k, k)."""
        full = np.zeros((len(self.sigmas),) * 2)
        if pairs is not None and len(self.free):
            weight = self.weights(self.residual(last.unknown))[:, None, None]
            cross = pairs.some(np.flatnonzero(self.used)).cross(weight * self.slope(last.unknown))
            gain = self.steps[:, None] * self.inverse(last.matrix)
            full[np.ix_(self.free, self.free)] = gain @ cross @ gain.T
        return full

    def pulled(self, last: _Solved, errors_px: Array) -> Array:
        """Contribution of independent errors common to all places to the covariance (k, k):
        ``errors_px`` (2, e), or (n, 2, e) of each place, is what 1 sigma of each moves it by.
        """
        full = np.zeros((len(self.sigmas),) * 2)
        if errors_px.any() and len(self.free):
            weight = self.weights(self.residual(last.unknown))
            moved = np.broadcast_to(errors_px, (len(self.used), *errors_px.shape[-2:]))[self.used]
            pull = np.einsum(
                "n,nia,nie->ae", weight, self.slope(last.unknown), self.whitening @ moved
            )
            gain = self.steps[:, None] * (self.inverse(last.matrix) @ pull)
            full[np.ix_(self.free, self.free)] = gain @ gain.T
        return full

    def covariance(self, matrix: Array) -> Array:
        """Covariance (k, k) of the corrections in metres and radians; zero for fixed ones."""
        full = np.zeros((len(self.sigmas),) * 2)
        if len(self.free):
            scale = np.outer(self.steps, self.steps)
            full[np.ix_(self.free, self.free)] = self.inverse(matrix) * scale
        return full


def covariance_of(normal: Array) -> Array | None:
    """Covariance (k, k) of k unknowns, of any units, by their normal matrix; None if the matrix does
    not determine all of them.
    """
    size = np.sqrt(np.diag(normal))
    if not (size > 0.0).all():
        return None
    unit = normal / np.outer(size, size)
    if not np.linalg.cond(unit) <= _CONDITION:
        return None
    return np.asarray(np.linalg.inv(unit) / np.outer(size, size))


def position_error(pose: Pose, known: Sensor) -> PositionError:
    """Difference between a solved position and the known one; for a scanner at its middle line.
    ValueError for a map-projected image, which has no position.
    """
    position, ahead = middle_ray(known)
    off, covariance = pose.position_mcmf_m - position, pose.position_covariance_m2
    along = float(off @ ahead)
    variance = float(ahead @ covariance @ ahead)
    total = float(np.trace(covariance))
    return PositionError(
        SightSplit(
            float(np.linalg.norm(off)), float(np.linalg.norm(off - along * ahead)), abs(along)
        ),
        SightSplit(np.sqrt(total), np.sqrt(max(total - variance, 0.0)), np.sqrt(variance)),
        float(off @ np.linalg.pinv(covariance) @ off),
    )
