"""How probably frames of the promised footprint are located at single moments, by the Sun's elevation: by points, and with
the ground as a whole (`matching.joint_detection`).

A promise holds under every Sun of a cell: each point counts there with the worst of them, and no two points need to have the
same worst one. Here a moment has one Sun. Places, views and moments are drawn evenly: places of the promise whose footprint
lies in the region (`WHOLE`), the catalogue's views, Suns by the time that they stand where the promise counts them. The camera
has the cell as its pixel and sees as much ground as the footprint; its place is known to 1 km and its attitude to 0.1 deg
(`options.USUAL`), as `lcp query` takes them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Mask
from ..cameras.frame_camera import Camera
from ..catalog.catalogue import Catalog
from ..catalog.model import Promise
from ..catalog.promise import LocatedBySun
from ..catalog.schema import NO_CELL
from ..catalog.sun_cells import SunCells
from ..constants import MOON_RADIUS_M, SUBSOLAR_LATITUDE_MAX_DEG
from ..geometry.frames import EnuFrame, azimuth_elevation, direction_enu, lonlat_to_mcmf
from .expected_position import Query, joint_of
from .frame_points import PlannedImage, points_of_frames

FRAMES = 20
"""Frames of each row of the Sun grid by default: a share of 0.95 is then known to 0.05 (1 sigma)."""

PROMISED = 0.99
"""Probability whose share is stated where a number of points is promised."""

WHOLE = 0.8
"""Share of the footprint in the region from which on a place counts, of the largest share."""

_FIELD_DEG = 10.0
"""Field of view of a camera with parallel rays."""

_DRAWN = 4096


def located_by_sun(catalog: Catalog, frames: int = FRAMES) -> list[LocatedBySun]:
    """So many frames in each row of the Sun grid in which something is promised, promise after promise; the same for
    equal catalogues. Empty for a catalogue without a promise.
    """
    promise = catalog.promise
    if promise is None or not len(catalog):
        return []
    return [
        row
        for part in range(len(promise.gsd))
        for number in range(len(catalog.sun_elevation))
        for row in _RowOfSuns(catalog, promise, part, number).rows(frames)
    ]


@dataclass(frozen=True)
class _RowOfSuns:
    """Frames of a promise under the Suns of a row of the grid."""

    catalog: Catalog
    promise: Promise
    part: int
    number: int

    def rows(self, frames: int) -> Iterator[LocatedBySun]:
        """One row, none where nothing is promised."""
        seen = points_of_frames(self.catalog, self.images(frames))
        joints = [joint_of(self.catalog, points, Query()) for points in seen]
        if not joints:
            return
        points = np.array([joint.located_by_points for joint in joints])
        ground = np.array([joint.located for joint in joints])
        cells, least = self.cells, float(self.promise.located_probability[self.part]) or PROMISED
        ends = cells.elevation[[self.number, cells.above[self.number]]].tolist()
        yield LocatedBySun(
            float(self.promise.gsd[self.part]),
            (ends[0], ends[1]),
            least,
            len(joints),
            float(points.mean()),
            float(ground.mean()),
            float((points >= least).mean()),
            float((ground >= least).mean()),
        )

    @property
    def cells(self) -> SunCells:
        return SunCells.of(self.catalog.sun_elevation, self.catalog.sun_azimuth)

    def images(self, frames: int) -> Iterator[PlannedImage]:
        """Frames at drawn places, in the views in turn, at moments at which the promise counts."""
        some = self.promise.parts()[self.part]
        cause = self.catalog.part("promise/cause", slice(some.start, some.stop))[:, :, self.number]
        demand = self.promise.demand[some]
        whole = demand >= WHOLE * demand.max(initial=0)
        known = np.flatnonzero(whole & (cause != NO_CELL).any(axis=(1, 2)))
        dice = np.random.default_rng([self.part, self.number])
        views = len(self.catalog.view_off_nadir)
        for number in range(frames if len(known) else 0):
            place = int(dice.choice(known))
            frame = EnuFrame(
                float(self.promise.longitude[some][place]),
                float(self.promise.latitude[some][place]),
            )
            suns = self.suns(frame, dice, cause[place, number % views] != NO_CELL)
            if len(suns):
                yield PlannedImage(self.camera(frame, number % views), suns[0])

    def suns(self, frame: EnuFrame, dice: np.random.Generator, counts: Mask) -> Array:
        """Directions to the Sun (n, 3), MCMF, in cells of the row that count, (a,)."""
        lon = dice.uniform(0.0, 360.0, _DRAWN)
        lat = dice.uniform(-SUBSOLAR_LATITUDE_MAX_DEG, SUBSOLAR_LATITUDE_MAX_DEG, _DRAWN)
        sun = lonlat_to_mcmf(lon, lat, 0.0) / MOON_RADIUS_M
        azimuth, elevation = azimuth_elevation(sun @ frame.rotation.T)
        low, high = self.cells.elevation[[self.number, self.cells.above[self.number]]]
        column = np.searchsorted(self.cells.azimuth, azimuth % 360.0, "right") - 1
        return np.asarray(sun[(elevation >= low) & (elevation <= high) & counts[column]])

    def camera(self, frame: EnuFrame, view: int) -> Camera:
        """The camera that sees the footprint around a frame's origin, its rows across the view."""
        off_nadir, azimuth, altitude_km = (
            float(column[view])
            for column in (
                self.catalog.view_off_nadir,
                self.catalog.view_azimuth,
                self.catalog.view_altitude,
            )
        )
        gsd_m, footprint_m = (
            float(column[self.part]) for column in (self.promise.gsd, self.promise.footprint)
        )
        towards, upward = (
            direction_enu(azimuth, 90.0 - off_nadir),
            math.cos(math.radians(off_nadir)),
        )
        away_m = footprint_m / (2.0 * math.tan(math.radians(_FIELD_DEG / 2.0)))
        if math.isfinite(altitude_km):
            up_m, above_m = MOON_RADIUS_M * upward, 1e3 * altitude_km
            away_m = -up_m + math.sqrt(up_m**2 + above_m * (2.0 * MOON_RADIUS_M + above_m))
        # a rectangle of the footprint's area, foreshortened along the view
        side = math.sqrt(math.pi) / 2.0 * footprint_m / gsd_m
        size_px = max(1, round(side)), max(1, round(side * upward))
        across = direction_enu(azimuth + 90.0, 0.0)
        axes = np.stack([across, np.cross(-towards, across), -towards])
        return Camera(
            frame.to_mcmf(away_m * towards),
            axes @ frame.rotation,
            away_m / gsd_m,
            ((size_px[0] - 1) / 2.0, (size_px[1] - 1) / 2.0),
            size_px,
            name="footprint",
        )
