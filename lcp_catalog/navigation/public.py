"""Public functions that ask a catalogue what a camera can expect of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from ..cameras.public import CameraOrPath, SensorOrPath, any_sensor, framing_camera
from ..catalog.public import CatalogOrPath, opened_catalog
from ..ephemeris.times import Times, instants
from ..geometry.frames import EnuFrame
from ..light.sun_choice import SunChoice
from ..matching.point_choice import LEAST_SIGMA_PX
from .expected_position import Answer, Query, answers
from .frame_points import PlannedImage
from .site_windows import Progress, Site, SiteWindows, camera_windows, site_windows
from .trajectory_file import read_trajectory


def query(
    catalog: CatalogOrPath,
    camera: SensorOrPath,
    *,
    sun_azimuth_deg: float | None = None,
    sun_elevation_deg: float | None = None,
    time_utc: str | None = None,
    subsolar_deg: tuple[float, float] | None = None,
    most: int | None = None,
    attitude_sigma_deg: float = math.inf,
    height_sigma_m: float | None = None,
    map_sigma_m: float = 0.0,
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
    sun_azimuth_deg, sun_elevation_deg:
        The Sun at the image's centre: degrees clockwise from north, and above the horizontal plane.
    time_utc, subsolar_deg:
        In place of the angles: an instant (ISO text, UTC), or longitude and latitude, degrees, of
        the subsolar point. None of them: the Sun of the camera's file.
    most:
        Only so many points: those that together determine the position best. None: all usable ones.
    attitude_sigma_deg:
        1 sigma of the known attitude about each axis; infinite: unknown, 0: exact.
    height_sigma_m:
        1 sigma of the points' heights; None: the catalogue's.
    map_sigma_m:
        1 sigma, each axis, of an error of place common to all points.
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
    >>> answer = lcp.query(catalog, camera, sun_azimuth_deg=96.5, sun_elevation_deg=14)
    >>> answer.counts["in_view"] == len(lcp.open_catalog(catalog)), answer.usable == len(answer.rows)
    (True, True)
    """
    sun = SunChoice(sun_azimuth_deg, sun_elevation_deg, time_utc, subsolar_deg)
    asked = Query(
        most, math.radians(attitude_sigma_deg), height_sigma_m, map_sigma_m, pixel_sigma_px
    )
    image = PlannedImage.lit(any_sensor(camera), sun)
    (answer,) = answers(opened_catalog(catalog, check=False), [image], asked)
    return answer


def query_trajectory(
    catalog: CatalogOrPath,
    trajectory: Path | str,
    camera: CameraOrPath | None = None,
    *,
    sun_azimuth_deg: float | None = None,
    sun_elevation_deg: float | None = None,
    time_utc: str | None = None,
    subsolar_deg: tuple[float, float] | None = None,
    most: int | None = None,
    attitude_sigma_deg: float = math.inf,
    height_sigma_m: float | None = None,
    map_sigma_m: float = 0.0,
    pixel_sigma_px: float = LEAST_SIGMA_PX,
) -> Iterator[Answer]:
    """The answers of `query` for the frames of a trajectory, one after another.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    trajectory:
        CSV of times, positions and attitudes of ``camera``, or JSON list of cameras
        (`navigation.trajectory_file`).
    camera:
        Camera of a CSV, or its file.
    sun_azimuth_deg, sun_elevation_deg, time_utc, subsolar_deg, most, attitude_sigma_deg:
        As `query`; None of the Sun: that of each frame's time.
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
    sun = SunChoice(sun_azimuth_deg, sun_elevation_deg, time_utc, subsolar_deg)
    asked = Query(
        most, math.radians(attitude_sigma_deg), height_sigma_m, map_sigma_m, pixel_sigma_px
    )
    taken = read_trajectory(trajectory, None if camera is None else framing_camera(camera))
    images = [PlannedImage.lit(one, sun) for one in taken]
    return answers(opened_catalog(catalog, check=False), images, asked)


def windows(
    catalog: CatalogOrPath,
    center_deg: tuple[float, float],
    times: Times,
    *,
    size_km: float = 60.0,
    gsd_m: float | None = None,
    off_nadir_deg: float = 0.0,
    view_azimuth_deg: float = 0.0,
    camera: SensorOrPath | None = None,
    progress: Progress | None = None,
) -> SiteWindows:
    """When a site has how many usable points: the Sun over time, for a camera that looks at the site
    from one direction, or for one that stays where it is.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    center_deg:
        Longitude and latitude of the site, degrees.
    times:
        Instants (`instant_range` makes a range of them).
    size_km:
        Side of the square around the site whose points count.
    gsd_m:
        Size of a pixel on the ground; None: each point's cell.
    off_nadir_deg, view_azimuth_deg:
        Direction to the camera, from the vertical and clockwise from north.
    camera:
        In place of size, pixel and direction: a camera that stays, or its file; adds the expected
        accuracy of its position.
    progress:
        Called with the number of instants done and of all.

    Returns
    -------
    SiteWindows
        ``usable`` (n,) and ``expected`` (n,) points at n instants; `SiteWindows.intervals`.

    Raises
    ------
    CatalogError
        If no point of the catalogue lies at the site.
    SunError
        For an invalid time.

    Examples
    --------
    >>> times = lcp.instant_range("2026-03-01", "2026-03-31", step_s=86400.0)
    >>> found = lcp.windows(catalog, (3.5, 26.0), times, size_km=40)
    >>> found.usable.shape, found.points > 0
    ((31,), True)
    """
    lon_deg, lat_deg = center_deg
    place, when = EnuFrame(lon_deg, lat_deg), instants(times)
    opened = opened_catalog(catalog, check=False)
    if camera is not None:
        return camera_windows(opened, place, any_sensor(camera), when, progress)
    site = Site(place, 1e3 * size_km, gsd_m, off_nadir_deg, view_azimuth_deg)
    return site_windows(opened, site, when, progress)
