"""Points that a camera can use under a Sun, and the accuracy of the position that they are expected
to give: the answer of ``lcp query``, for one frame or for the frames of a trajectory.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
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
from ..matching.common_errors import SharedTerrain, map_sigma_m, shadow_shift_m, untied
from ..matching.joint_detection import JointDetection, joint_detection
from ..matching.options import USUAL
from ..matching.point_choice import LEAST_SIGMA_PX, shows_points
from ..matching.pose import jacobian
from ..matching.search_area import none_in_view
from .frame_points import CAUSES, FramePoints, PlannedImage, points_of_frames
from .information import Information, best_points, dilution
from .trajectory_file import read_trajectory

log = logging.getLogger(__name__)

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
    map_sigma_m: float = 0.0  # 1 sigma, each axis, of the map's place, as counted
    untied: tuple[str, ...] = ()
    """Products of which it is not published and was not stated: it is not counted for them."""

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
    stated = catalog.place_sigma_m(rows) * sharper_sigma(points.factor[usable])
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
        replace(
            _expected(information.some(listed), errors, points.pixel_m[chosen], to_enu, query, tie),
            map_sigma_m=tie,
            untied=untied(catalog, rows) if query.map_sigma_m is None else (),
        ),
        (float(of_sun), float(above)),
        joint_of(catalog, points, query),
    )


def joint_of(catalog: Catalog, points: FramePoints, query: Query) -> JointDetection:
    """How many of the points in view that have a claim are found together, searched for with the attitude known as stated, else as
    `locate` takes it.
    """
    claims, sensor = points.claims, points.frame.sensor
    stated = np.isfinite(claims.covariance_m2).all(axis=(1, 2)) & (claims.cause != _CUT)
    some = np.flatnonzero(stated & np.isfinite(claims.detection_probability) & points.whole)
    rows = points.rows[some]
    slope = ground_slopes(sensor, catalog.position_mcmf[rows], points.rotation[some])
    covariance = slope @ claims.covariance_m2[some] @ np.swapaxes(slope, -1, -2)
    attitude = min(query.attitude_sigma_rad, USUAL.attitude_rad)
    known = Uncertainty(USUAL.position_m, attitude)
    found = claims.detection_probability[some]
    return joint_detection(catalog, rows, sensor, found, covariance, known, points.frame.sun)


_CUT = CAUSES.index("edge")
"""Cause of patches that the image cuts."""


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
