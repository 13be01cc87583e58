"""Points that a camera can use under a Sun, and the accuracy of the position that they are expected
to give: the answer of ``lcp query``, for one frame or for the frames of a trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Index
from ..cameras.sensor import POSE, Sensor
from ..catalog.catalogue import Catalog
from ..errors import CameraError
from ..geometry.ellipses import error_ellipses
from ..geometry.frames import azimuth_elevation, enu_rotation, mcmf_to_lonlat
from ..matching.common_errors import SharedTerrain, shadow_shift_m
from ..matching.point_claims import LEAST_SIGMA_PX
from ..matching.pose import jacobian
from .frame_points import FramePoints, PlannedImage, points_of_frames
from .information import Information, best_points, dilution

SOURCES = ("match", "place", "pixel", "height", "shadow", "map", "attitude")
"""Errors of a position: of the matches; of each point's place on the ground; of a pixel's least
error; of the points' heights; by shadows below a cell (`matching.common_errors`); of the place common
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
    an error of place that is the same for all points. ``pixel_sigma_px``: 1 sigma, each axis, of what
    a match errs beyond its claim, pixels of the searched image, which are not finer than the cells;
    `Criteria.floor_px` of a search.
    """

    most: int | None = None
    attitude_sigma_rad: float = math.inf
    height_sigma_m: float | None = None
    map_sigma_m: float = 0.0
    pixel_sigma_px: float = LEAST_SIGMA_PX


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
    place = float(catalog.errors.get("position_sigma_m", 0.0)) ** 2 * (
        level @ np.swapaxes(level, -1, -2)
    )
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
        _expected(information.some(listed), errors, points.pixel_m[chosen], to_enu, query),
        (float(of_sun), float(above)),
    )


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
) -> ExpectedPosition:
    """``errors``: the parts of the covariances of the places in the image, by source."""
    count, expected = len(information), float(information.probability.sum())
    if count < LEAST_POINTS:
        few = "no usable point" if not count else f"{count} usable point{'s' * (count > 1)}"
        reason = f"{few}: a position needs {LEAST_POINTS}"
        return ExpectedPosition(None, None, None, to_enu, expected, reason)
    covariance, known = information.covariance(), information.covariance_known_attitude()
    shared, budget = query.map_sigma_m**2 * np.eye(3), None
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
