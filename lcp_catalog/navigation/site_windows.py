"""When a site has how many usable points: the Sun over time, for a camera that looks at the site from
one direction, or for one that stays where it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array, Index
from ..atomic_files import csv_lines
from ..cameras.public import SensorOrPath, any_sensor
from ..cameras.sensor import Sensor
from ..cameras.view import stated_direction
from ..catalog.catalogue import Catalog
from ..catalog.comparison import CatalogOrPath, opened_catalog
from ..catalog.prediction import predict
from ..catalog.shards import Shard
from ..catalog.stored import narrowed
from ..choices import SITE_KM
from ..constants import MOON_RADIUS_M
from ..ephemeris.solar_position import apparent_sun, sun_table
from ..ephemeris.times import Instants, Times, instants
from ..errors import CatalogError, ConfigError, pair
from ..geometry.frames import EnuFrame, direction_enu
from ..matching.point_choice import seen_from
from ..stages import Progress, unseen
from .expected_position import LEAST_POINTS, Query, answers
from .frame_points import PAIRS_AT_ONCE, PlannedImage

COLUMNS = (
    "time_utc", "sun_azimuth_deg", "sun_elevation_deg", "usable", "expected_points",
    "position_sigma_m", "located_probability",
)  # fmt: skip
"""One row per instant; the last two only for a camera."""


@dataclass(frozen=True)
class Site:
    """Points within a square around a place, and how they are seen: ``size_m``: side of the square;
    ``pixel_m``: size of a pixel on the ground, None: each point's cell; view: direction to the
    camera, degrees.
    """

    frame: EnuFrame
    size_m: float
    pixel_m: float | None = None
    off_nadir_deg: float = 0.0
    view_azimuth_deg: float = 0.0

    def rows(self, catalog: Catalog) -> Index:
        """Rows of the points; CatalogError for none."""
        if not len(catalog):
            raise CatalogError("the catalogue has no points")
        found = self._found(catalog)
        if not len(found):
            raise CatalogError(
                f"no point of the catalogue lies within the {self.size_m / 1e3:g} km around longitude "
                f"{self.frame.lon_deg:g}, latitude {self.frame.lat_deg:g}: give a larger `size_km`, or another `center` "
                f"(the first of {len(catalog)} lies at longitude {catalog.longitude[0]:.2f}, latitude {catalog.latitude[0]:.2f})"
            )
        return found

    def _found(self, catalog: Catalog) -> Index:
        places = self.frame.from_mcmf(catalog.position_mcmf)
        near = (np.abs(places[:, :2]) <= self.size_m / 2.0).all(axis=1)
        return np.flatnonzero(near & (places[:, 2] > -MOON_RADIUS_M))

    def part(self, catalog: Catalog) -> Catalog:
        """The catalogue of an index with those shards alone that can have a point of the site, if there is any."""

        def near(shard: Shard) -> bool:
            away = np.abs(self.frame.from_mcmf(np.array([shard.center_m]))[0, :2])
            return bool((away <= self.size_m / 2.0 + shard.radius_m).all())

        some = narrowed(catalog, near)
        return some if len(self._found(some)) else catalog


@dataclass(frozen=True, eq=False)
class SiteWindows:
    """Usable points of a site at n instants. ``usable`` (n,): their number; ``expected`` (n,): the sum
    of their detection probabilities; ``position_sigma_m`` (n,): 1 sigma of a camera's position, NaN
    where the points do not determine it; ``located`` (n,): probability that a frame is located
    (`matching.joint_detection`). Both None without a camera.
    """

    times: Instants
    sun_deg: Array  # (n, 2) azimuth and elevation at the site
    points: int  # of the site, or in the camera's view
    usable: Index
    expected: Array
    position_sigma_m: Array | None = None
    located: Array | None = None

    def __repr__(self) -> str:
        """The result in short: it may have thousands of instants."""
        count = len(self.times)
        ends = [self.times[k : k + 1].labels()[0] for k in (0, count - 1)] if count else []
        usable = f"{self.usable.min()} to {self.usable.max()}" if count else "none"
        return (
            f"<SiteWindows: {self.points} points, {' to '.join(ends) or 'no time'}, "
            f"{count} instants, {usable} of them usable>"
        )

    def intervals(self, least: int = LEAST_POINTS) -> list[dict[str, Any]]:
        """Runs of instants with at least ``least`` usable points."""
        names = self.times.labels()
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.usable >= least, [0]])))
        found = []
        for first, after in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            own = self.usable[first:after]
            elevation = self.sun_deg[first:after, 1]
            found.append(
                self._located(slice(first, after))
                | {
                    "from": names[first],
                    "to": names[after - 1],
                    "instants": after - first,
                    "usable_min": int(own.min()),
                    "usable_max": int(own.max()),
                    "sun_elevation_min_deg": round(float(elevation.min()), 3),
                    "sun_elevation_max_deg": round(float(elevation.max()), 3),
                }
            )
        return found

    def _located(self, part: slice) -> dict[str, float]:
        """Least probability of being located in an interval."""
        if self.located is None:
            return {}
        return {"located_probability_min": round(float(self.located[part].min()), 4)}

    def records(self) -> Iterator[dict[str, Any]]:
        """One record per instant, with the names of `COLUMNS`."""
        sigma: list[float | None] = [None] * len(self.times)
        located = list(sigma)
        if self.position_sigma_m is not None and self.located is not None:
            sigma = [float(f"{s:.6g}") if np.isfinite(s) else None for s in self.position_sigma_m]
            located = np.round(self.located, 4).tolist()
        columns = (
            self.times.labels(),
            *np.round(self.sun_deg, 4).T.tolist(),
            self.usable.tolist(),
            np.round(self.expected, 3).tolist(),
            sigma,
            located,
        )
        for row in zip(*columns, strict=True):
            record = dict(zip(COLUMNS, row, strict=True))
            if self.position_sigma_m is None:
                del record["position_sigma_m"], record["located_probability"]
            yield record

    def csv_text(self) -> str:
        """Table of all instants (RFC 4180)."""
        columns = COLUMNS if self.position_sigma_m is not None else COLUMNS[:-2]
        return "".join(csv_lines([columns, *(record.values() for record in self.records())]))


def site_windows(
    catalog: Catalog, site: Site, times: Instants, progress: Progress = unseen
) -> SiteWindows:
    """Usable points of a site at instants. CatalogError for a site without points."""
    catalog = site.part(catalog)
    rows = site.rows(catalog)
    rotation = catalog.part("rotation_mcmf_to_enu", rows)
    towards = direction_enu(site.view_azimuth_deg, 90.0 - site.off_nadir_deg)
    pixel = np.full(len(rows), site.pixel_m) if site.pixel_m else catalog.gsd[rows]
    suns, _ = apparent_sun(times)
    usable, expected = np.zeros(len(times), np.int64), np.zeros(len(times))
    step = max(1, PAIRS_AT_ONCE // len(rows))
    for start in range(0, len(times), step):
        sun = np.einsum("pij,tj->tpi", rotation, suns[start : start + step])
        when, which = np.nonzero(sun[..., 2] > 0.0)
        view = np.broadcast_to(towards, (len(when), 3))
        found = predict(catalog, rows[which], sun[when, which], view, pixel[which])
        part = slice(start, start + len(sun))
        usable[part] = np.bincount(when[found.usable], minlength=len(sun))
        weight = found.detection_probability[found.usable]
        expected[part] = np.bincount(when[found.usable], weight, minlength=len(sun))
        progress(min(start + step, len(times)), len(times))
    return SiteWindows(times, _sun_at(site.frame, times), len(rows), usable, expected)


def camera_windows(
    catalog: Catalog,
    frame: EnuFrame,
    sensor: Sensor,
    times: Instants,
    progress: Progress = unseen,
) -> SiteWindows:
    """Usable points of a camera that does not move, and the expected accuracy of its position, at
    instants; the Sun's angles are those at the place of ``frame``. Errors as `answers`.
    """
    catalog = seen_from(catalog, [sensor])
    suns, _ = apparent_sun(times)
    usable, expected = np.zeros(len(times), np.int64), np.zeros(len(times))
    sigma, located, points = np.full(len(times), np.nan), np.zeros(len(times)), 0
    for k, answer in enumerate(
        answers(catalog, (PlannedImage(sensor, sun) for sun in suns), Query())
    ):
        usable[k], expected[k] = answer.usable, answer.position.expected_points
        points, located[k] = answer.counts["in_view"], answer.joint.located
        if answer.position.position_sigma_m is not None:
            sigma[k] = answer.position.position_sigma_m
        progress(k + 1, len(times))
    return SiteWindows(times, _sun_at(frame, times), points, usable, expected, sigma, located)


def _sun_at(frame: EnuFrame, times: Instants) -> Array:
    table = sun_table(frame, times)
    return np.stack([table.azimuth_deg, table.elevation_deg], axis=-1)


def windows(
    catalog: CatalogOrPath,
    center: tuple[float, float],
    times: Times,
    *,
    size_km: float | None = None,
    gsd_m: float | None = None,
    off_nadir_deg: float | None = None,
    view_azimuth_deg: float | None = None,
    camera: SensorOrPath | None = None,
    progress: Progress | None = None,
) -> SiteWindows:
    """When a site has how many usable points: the Sun over time, for a camera that looks at the site
    from one direction, or for one that stays where it is.

    Parameters
    ----------
    catalog:
        A catalogue, or its file.
    center:
        Longitude and latitude of the site, degrees.
    times:
        Instants (`instant_range` makes a range of them).
    size_km:
        Side of the square around the site whose points count; None: 20.
    gsd_m:
        Size of a pixel on the ground; None: each point's cell.
    off_nadir_deg, view_azimuth_deg:
        Direction to the camera, from the vertical and clockwise from north; None: straight down.
    camera:
        In place of size, pixel and direction: a camera that stays, or its file; adds the expected
        accuracy of its position and the probability of being located.
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
    ConfigError
        For a camera beside size, pixel or direction, and for half of a direction.

    Examples
    --------
    >>> times = lcp.instant_range("2026-03-01", "2026-03-31", step_s=86400.0)
    >>> found = lcp.windows(catalog, (3.5, 26.0), times, size_km=40)
    >>> found.usable.shape, found.points > 0
    ((31,), True)
    """
    lon_deg, lat_deg = pair(center, "center", "longitude and latitude, degrees")
    place, when = EnuFrame(lon_deg, lat_deg), instants(times)
    opened = opened_catalog(catalog, check=False)
    if camera is not None:
        if {size_km, gsd_m, off_nadir_deg, view_azimuth_deg} != {None}:
            given = "`size_km`, `gsd_m`, `off_nadir_deg` and `view_azimuth_deg`"
            raise ConfigError(f"`camera` excludes {given}")
        return camera_windows(opened, place, any_sensor(camera), when, progress or unseen)
    side_m = 1e3 * (SITE_KM if size_km is None else size_km)
    site = Site(place, side_m, gsd_m, *stated_direction(off_nadir_deg, view_azimuth_deg))
    return site_windows(opened, site, when, progress or unseen)
