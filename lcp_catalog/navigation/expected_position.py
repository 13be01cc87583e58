"""Points that a camera can use under a Sun, and the accuracy of the position that they are expected
to give: the answer of ``lcp query``, for one frame or for the frames of a trajectory.

Information that points give about a sensor's position: normal matrices of the collinearity
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

import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..arrays import Array, Index
from ..cameras.public import CameraOrPath, SensorOrPath, any_sensor, framing_camera
from ..cameras.sensor import POSE, Sensor, Uncertainty, ground_slopes
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..errors import CameraError, ConfigError
from ..geometry.ellipses import error_ellipses
from ..geometry.frames import azimuth_elevation, enu_rotation, mcmf_to_lonlat
from ..landmarks.point_spread import sharper_sigma
from ..light.sun_choice import SunChoice, SunStated
from ..matching.common_errors import SharedTerrain, map_sigma_m, shadow_shift_m
from ..matching.joint_detection import JointDetection, joint_detection
from ..matching.point_choice import LEAST_SIGMA_PX, shows_points
from ..matching.pose import covariance_of, jacobian
from ..matching.position_fix import USUAL
from ..matching.search_area import none_in_view
from .frame_points import CAUSES, FramePoints, PlannedImage, points_of_frames
from .trajectory_file import read_trajectory

log = logging.getLogger(__name__)

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


SOURCES = ("match", "place", "pixel", "height", "shadow", "map", "attitude")
"""Errors of a position: of the matches; of each point's place on the ground; of a pixel's least
error; of the points' heights; by shadows below a cell (`matching.pose`); of the place common
to all points; of the attitude known before.
"""

LEAST_POINTS = 4
"""Least number of usable points of a position."""


@dataclass(frozen=True)
class Query:
    """What is asked of a frame. ``most``: largest number of points, the most informative ones
    (`information.best_points`); None: all usable ones. ``attitude_sigma_rad``: 1 sigma of the known
    attitude about each axis; inf: unknown, 0: exact. ``height_sigma_m``: 1 sigma of the points'
    heights in place of the catalogue's ``elevation_sigma``. ``map_sigma_m``: 1 sigma, each axis, of
    an error of place that is the same for all points; None: that of the points' DEM
    (`common_errors.map_sigma_m`). ``pixel_sigma_px``: 1 sigma, each axis, of what
    a match errs beyond its claim, pixels of the searched image, which are not finer than the cells;
    `Criteria.floor_px` of a search. ConfigError for fewer than one point, and for a sigma below 0.
    """

    most: int | None = None
    attitude_sigma_rad: float = math.inf
    height_sigma_m: float | None = None
    map_sigma_m: float | None = None
    pixel_sigma_px: float = LEAST_SIGMA_PX

    def __post_init__(self) -> None:
        if self.most is not None and self.most < 1:
            raise ConfigError(f"`most` must be at least 1, not {self.most}")
        for name in ("attitude_sigma_rad", "height_sigma_m", "map_sigma_m", "pixel_sigma_px"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise ConfigError(f"`{name}` must be 0 or above, not {value:g}")


@dataclass(frozen=True, eq=False)
class ExpectedPosition:
    """Expected accuracy of a sensor's position. Matrices are None if the points do not determine them;
    ``reason`` then says why.
    """

    covariance: Array | None  # (6, 6) of `cameras.sensor.POSE`: m and rad, attitude known as stated
    known_attitude_m2: Array | None  # (3, 3) of the position, MCMF, for an exact attitude
    dilution: Array | None  # (3, 3) cofactors of the position, MCMF (`information.dilution`)
    to_enu: Array  # (3, 3) MCMF to east, north, up below the sensor
    expected_points: float  # sum of the detection probabilities
    reason: str = ""
    budget_m: dict[str, float] | None = None
    """`position_sigma_m` by the errors of `SOURCES` alone: their squares add up to its square."""

    @property
    def position_covariance_m2(self) -> Array | None:
        """Covariance (3, 3) of the position, MCMF."""
        return None if self.covariance is None else self.covariance[:3, :3]

    @property
    def position_sigma_m(self) -> float | None:
        """1 sigma of the position, all directions together: the root of the covariance's trace."""
        return _length(self.position_covariance_m2)

    @property
    def known_attitude_sigma_m(self) -> float | None:
        """`position_sigma_m` for an exact attitude."""
        return _length(self.known_attitude_m2)

    @property
    def sigma_enu_m(self) -> Array | None:
        """1 sigma (3,) of the position east, north and up below the sensor."""
        if self.covariance is None:
            return None
        turned = self.to_enu @ self.covariance[:3, :3] @ self.to_enu.T
        return np.asarray(np.sqrt(np.diag(turned)))

    @property
    def dop(self) -> dict[str, float] | None:
        """Dilution of precision: metres of the position per metre of error of each point's place."""
        if self.dilution is None:
            return None
        east, north, up = np.diag(self.to_enu @ self.dilution @ self.to_enu.T)
        return {
            "position": float(np.sqrt(east + north + up)),
            "horizontal": float(np.sqrt(east + north)),
            "vertical": float(np.sqrt(up)),
        }


@dataclass(frozen=True, eq=False)
class Answer:
    """The m points that a frame can use, and the position they are expected to give. With
    `Query.most` the most informative point comes first, else they have the catalogue's order.

    Examples
    --------
    >>> answer = lcp.query(catalog, camera)
    >>> answer.pixel.shape == (len(answer.rows), 2), answer.position.position_covariance_m2.shape
    (True, (3, 3))
    """

    frame: PlannedImage
    rows: Index  # (m,) of the catalogue
    probability: Array  # (m,) of detection
    pixel: Array  # (m, 2)
    pixel_m: Array  # (m,) size of a pixel on the ground
    sigma_px: Array  # (m, 2) of the match, major and minor axis
    angle_px_deg: Array  # (m,) of the major axis from right towards down
    sigma_m: Array  # (m, 2) of the match on the ground
    angle_deg: Array  # (m,) of the major axis clockwise from north
    counts: dict[str, int]  # points in view, usable, and not usable by cause
    position: ExpectedPosition
    sun_deg: tuple[float, float]  # azimuth and elevation of the Sun below the sensor
    joint: JointDetection  # of all points in view with a claim

    def __repr__(self) -> str:
        """The answer in short: a frame has hundreds of points."""
        sigma = self.position.position_sigma_m
        known = "no position" if sigma is None else f"position to {sigma:.4g} m"
        return (
            f"<Answer: {self.usable} of {self.counts['in_view']} points in view usable, {len(self.rows)} listed, "
            f"{known}, located with probability {self.joint.located:.2f}>"
        )

    @property
    def sensor_position_m(self) -> Array:
        """Position (3,) of the sensor, MCMF; of a scanner, at the middle line of its image."""
        return _position(self.frame.sensor)

    @property
    def usable(self) -> int:
        """Number of usable points in view, listed or not."""
        return self.counts["usable"]


def answers(catalog: Catalog, frames: Iterable[PlannedImage], query: Query) -> Iterator[Answer]:
    """The answer for every frame, in their order.

    CameraError for a sensor
    without a position (a map).
    """
    for points in points_of_frames(catalog, frames):
        if points.frame.sensor.corrections != POSE:
            raise CameraError(f"{points.frame.sensor.name}: a map has no position to be found")
        yield _answer(catalog, points, query)


def _answer(catalog: Catalog, points: FramePoints, query: Query) -> Answer:
    sensor = points.frame.sensor
    usable = np.flatnonzero(points.claims.usable)
    rows = points.rows[usable]
    places = catalog.position_mcmf[rows]
    rotation = points.rotation[usable]
    slopes = jacobian(sensor, places) if len(rows) else np.zeros((0, 2, 6))
    on_ground = -slopes[:, :, :3] @ np.swapaxes(
        rotation, -1, -2
    )  # pixels per metre east, north, up
    level = on_ground[:, :, :2]
    stated = catalog.place_sigma_m(catalog.gsd[rows]) * sharper_sigma(points.factor[usable])
    stated = stated[:, None, None]
    place = stated**2 * (level @ np.swapaxes(level, -1, -2))
    match = level @ points.claims.covariance_m2[usable] @ np.swapaxes(level, -1, -2)
    searched = np.maximum(catalog.gsd[rows] / points.pixel_m[usable], 1.0)  # side, in pixels
    pixel = (query.pixel_sigma_px * searched)[:, None, None] ** 2 * np.eye(2)
    raised = on_ground[:, :, 2] * _heights(catalog, rows, query)[:, None]
    height = raised[:, :, None] * raised[:, None, :]
    errors = {"match": match - place, "place": place, "pixel": pixel, "height": height}
    information = Information(
        slopes,
        match + pixel + height,
        points.claims.detection_probability[usable],
        query.attitude_sigma_rad,
        SharedTerrain.of(catalog, rows, places, rotation) if len(rows) else None,
        np.einsum("nij,nj->ni", level, shadow_shift_m(catalog, rows, rotation @ points.frame.sun)),
    )
    middle = _position(sensor)
    tie = map_sigma_m(catalog, rows) if query.map_sigma_m is None else query.map_sigma_m
    listed = np.arange(len(rows))
    if query.most is not None and len(rows):
        distance = float(np.linalg.norm(places - middle, axis=-1).mean())
        listed = best_points(information, distance, query.most)
    chosen = usable[listed]
    sigma, angle = error_ellipses((match + pixel)[listed])
    errors = {name: part[listed] for name, part in errors.items()}
    lon, lat, _ = mcmf_to_lonlat(middle)
    to_enu = enu_rotation(lon, lat)
    of_sun, above = azimuth_elevation(to_enu @ points.frame.sun)
    claims = points.claims
    return Answer(
        points.frame,
        points.rows[chosen],
        claims.detection_probability[chosen],
        points.pixel[chosen],
        points.pixel_m[chosen],
        sigma,
        angle,
        np.stack([claims.sigma_major_m[chosen], claims.sigma_minor_m[chosen]], axis=-1),
        claims.sigma_angle_deg[chosen],
        points.counts,
        _expected(information.some(listed), errors, points.pixel_m[chosen], to_enu, query, tie),
        (float(of_sun), float(above)),
        joint_of(catalog, points, query),
    )


def joint_of(catalog: Catalog, points: FramePoints, query: Query) -> JointDetection:
    """How many of the points in view that have a claim are found together, searched for with the attitude known as stated, else as
    `locate` takes it.
    """
    claims, sensor = points.claims, points.frame.sensor
    stated = np.isfinite(claims.covariance_m2).all(axis=(1, 2)) & ~np.isin(
        claims.cause, _NOT_CLAIMED
    )
    some = np.flatnonzero(stated & np.isfinite(claims.detection_probability))
    rows = points.rows[some]
    slope = ground_slopes(sensor, catalog.position_mcmf[rows], points.rotation[some])
    covariance = slope @ claims.covariance_m2[some] @ np.swapaxes(slope, -1, -2)
    attitude = min(query.attitude_sigma_rad, USUAL.attitude_rad)
    known = Uncertainty(USUAL.position_m, attitude)
    return joint_detection(
        catalog, rows, sensor, claims.detection_probability[some], covariance, known
    )


_NOT_CLAIMED = CAUSES.index("edge"), CAUSES.index("sun")
"""Patches that the image cuts, and Suns outside the table: claims beyond its last Sun are those of that Sun."""


def _heights(catalog: Catalog, rows: Index, query: Query) -> Array:
    """1 sigma (n,) of the points' heights, metres; 0 where the catalogue does not know it."""
    if query.height_sigma_m is not None:
        return np.full(len(rows), query.height_sigma_m)
    return np.nan_to_num(np.asarray(catalog.elevation_sigma, np.float64)[rows])


def _expected(
    information: Information,
    errors: dict[str, Array],
    pixel_m: Array,
    to_enu: Array,
    query: Query,
    tie_m: float,
) -> ExpectedPosition:
    """``errors``: the parts of the covariances of the places in the image, by source; ``tie_m``: 1 sigma, each axis, of
    the map's place.
    """
    count, expected = len(information), float(information.probability.sum())
    if count < LEAST_POINTS:
        few = "no usable point" if not count else f"{count} usable point{'s' * (count > 1)}"
        reason = f"{few}: a position needs {LEAST_POINTS}"
        if query.most is not None and 0 < query.most == count:
            reason = (
                f"only {count} point{'s' * (count > 1)} asked for: a position needs {LEAST_POINTS} (three fit up to four "
                "positions, and a fourth tells which); ask for more"
            )
        return ExpectedPosition(None, None, None, to_enu, expected, reason)
    covariance, known = information.covariance(), information.covariance_known_attitude()
    shared, budget = tie_m**2 * np.eye(3), None
    if covariance is not None:
        parts = {name: information.part_of(part) for name, part in errors.items()}
        parts |= {"map": np.pad(shared, ((0, 3), (0, 3))), "attitude": information.attitude_part()}
        parts["match"] = parts["match"] + information.terrain_part()
        parts["shadow"] = information.shift_part()
        traces = {name: float(np.trace(parts[name][:3, :3])) for name in SOURCES}
        budget = {name: math.sqrt(max(0.0, trace)) for name, trace in traces.items()}
        covariance = covariance + parts["map"]
    known = None if known is None else known + shared
    spread = dilution(information.slopes, pixel_m, information.attitude_sigma_rad)
    reason = "" if covariance is not None else "the points do not determine position and attitude"
    return ExpectedPosition(covariance, known, spread, to_enu, expected, reason, budget)


def _position(sensor: Sensor) -> Array:
    """Position (3,) of a sensor, MCMF; of a scanner, at the middle line of its image."""
    rows, cols = sensor.shape
    return np.asarray(sensor.looks([(cols - 1) / 2.0, (rows - 1) / 2.0])[0])


def _length(covariance: Array | None) -> float | None:
    return None if covariance is None else float(np.sqrt(np.trace(covariance)))


def query(
    catalog: CatalogOrPath,
    camera: SensorOrPath,
    sun: SunStated = None,
    *,
    most: int | None = None,
    attitude_sigma_deg: float = math.inf,
    height_sigma_m: float | None = None,
    map_sigma_m: float | None = None,
    pixel_sigma_px: float = LEAST_SIGMA_PX,
) -> Answer:
    """Points of a catalogue that a camera can use under a Sun, and the expected accuracy of a position
    from them: the inverse of the information that the claimed matches give (Gauss-Markov; errors of
    places, heights and map as common parameters).

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    camera:
        Camera or another sensor, or its file.
    sun:
        The Sun: its azimuth, degrees clockwise from north, and elevation at the image's centre; or an instant (ISO
        text, UTC); or a `SunChoice`. None: the Sun of the camera's file.
    most:
        Only so many points: those that together determine the position best. None: all usable ones.
    attitude_sigma_deg:
        1 sigma of the known attitude about each axis; infinite: unknown, 0: exact.
    height_sigma_m:
        1 sigma of the points' heights; None: the catalogue's.
    map_sigma_m:
        1 sigma, each axis, of an error of place common to all points; None: that of the points' DEM, where it is published.
    pixel_sigma_px:
        1 sigma, each axis, of what a match errs beyond its claim, pixels not finer than the cells.

    Returns
    -------
    Answer
        ``rows`` (m,) of the points, their ``probability`` (m,), ``pixel`` (m, 2), ``sigma_px``
        (m, 2); ``counts`` by cause; ``position``, an `ExpectedPosition`.

    Raises
    ------
    SunError, CameraError, ImageError, CatalogError
        Without a Sun, for files that cannot be read, for a camera that does not see the Moon.

    Examples
    --------
    >>> answer = lcp.query(catalog, camera, sun=(96.5, 14))
    >>> answer.counts["in_view"] == len(lcp.open_catalog(catalog)), answer.usable == len(answer.rows)
    (True, True)
    """
    asked = Query(
        most, math.radians(attitude_sigma_deg), height_sigma_m, map_sigma_m, pixel_sigma_px
    )
    catalog = opened_catalog(catalog, check=False)
    image = PlannedImage.lit(
        any_sensor(camera, shows_points(catalog)), SunChoice.of(sun), warns=True
    )
    (answer,) = answers(catalog, [image], asked)
    if not answer.counts["in_view"]:
        log.warning("%s: %s", image.sensor.name, none_in_view(catalog, image.sensor))
    return answer


def query_trajectory(
    catalog: CatalogOrPath,
    trajectory: Path | str,
    camera: CameraOrPath | None = None,
    *,
    sun: SunStated = None,
    most: int | None = None,
    attitude_sigma_deg: float = math.inf,
    height_sigma_m: float | None = None,
    map_sigma_m: float | None = None,
    pixel_sigma_px: float = LEAST_SIGMA_PX,
) -> Iterator[Answer]:
    """The answers of `query` for the frames of a trajectory, one after another.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    trajectory:
        CSV of times, positions and attitudes of ``camera``, or JSON list of cameras
        (`navigation.expected_position`).
    camera:
        Camera of a CSV, or its file.
    sun:
        As `query`; None: that of each frame's time.
    most, attitude_sigma_deg:
        As `query`.
    height_sigma_m, map_sigma_m, pixel_sigma_px:
        As `query`.

    Raises
    ------
    SunError, CameraError, ImageError, CatalogError
        As `query`.

    Examples
    --------
    >>> frames = lcp.query_trajectory(catalog, descent, camera)
    >>> [answer.usable >= 0 for answer in frames]
    [True, True]
    """
    asked = Query(
        most, math.radians(attitude_sigma_deg), height_sigma_m, map_sigma_m, pixel_sigma_px
    )
    stated = SunChoice.of(sun)
    taken = read_trajectory(trajectory, None if camera is None else framing_camera(camera))
    images = [PlannedImage.lit(one, stated) for one in taken]
    return answers(opened_catalog(catalog, check=False), images, asked)
