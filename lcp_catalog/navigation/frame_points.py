"""The points that a camera sees under a Sun, with what the catalogue claims about each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Index, Mask
from ..cameras.sensor import Sensor, altitude_km, pixel_size_m
from ..cameras.view import center_of, optical_axis
from ..catalog import prediction
from ..catalog.catalogue import Catalog
from ..catalog.prediction import Prediction, predict
from ..geometry.frames import EnuFrame
from ..images.image import Image
from ..light.sun_choice import SunChoice
from ..matching.point_choice import points_in_view, usual_reductions

CAUSES = (*prediction.CAUSES, "edge")
"""Why a point in view is not usable: those of `prediction.CAUSES`, and a patch that the image does
not show as a whole.
"""

PAIRS_AT_ONCE = 100_000
"""About the number of points, over all frames, whose claims are read at once."""


@dataclass(frozen=True, eq=False)
class PlannedImage:
    """An image to be taken: its sensor, the unit MCMF vector (3,) to the Sun, and its time, UTC."""

    sensor: Sensor
    sun: Array
    time_utc: str | None = None

    @classmethod
    def lit(cls, sensor: Sensor, sun: SunChoice, warns: bool = False) -> PlannedImage:
        """The frame under a Sun: the stated one, angles being those at the image's centre, else that
        of the sensor's file. SunError if there is neither; ImageError for angles if the image's
        centre does not show the Moon. ``warns``: also of a stated Sun that is not the file's (`SunChoice.warn_of`).
        """
        lon_deg, lat_deg = center_of(sensor) if sun.azimuth_deg is not None else (0.0, 0.0)
        if warns:
            sun.warn_of(EnuFrame(lon_deg, lat_deg), sensor)
        time = sun.time_utc or sensor.time_utc
        return cls(sensor, sun.direction_mcmf(EnuFrame(lon_deg, lat_deg), sensor), time)

    @classmethod
    def of(cls, image: Image) -> PlannedImage:
        """An image that was taken, under the Sun at its sensor's place."""
        return cls(image.sensor, image.sun_directions(optical_axis(image.sensor)[0]))


@dataclass(frozen=True, eq=False)
class FramePoints:
    """The n points in view of a frame, and their claims."""

    frame: PlannedImage
    rows: Index  # (n,) of the catalogue
    pixel: Array  # (n, 2)
    pixel_m: Array  # (n,) size of a pixel on the ground
    rotation: Array  # (n, 3, 3) MCMF to each point's ENU frame
    claims: Prediction  # `cause` is a number in `CAUSES`
    factor: Index  # (n,) how many times the image is reduced for the search
    whole: Mask  # (n,) whether the image shows the patch as a whole

    @property
    def counts(self) -> dict[str, int]:
        """Number of points in view, of usable ones, and of the others by cause."""
        found = np.bincount(self.claims.cause, minlength=len(CAUSES)).tolist()
        return {"in_view": len(self.rows)} | dict(zip(CAUSES, found, strict=True))


def points_of_frames(catalog: Catalog, frames: Iterable[PlannedImage]) -> Iterator[FramePoints]:
    """The points in view of every frame. The claims of several frames are read at once."""
    some: list[_Seen] = []
    for frame in frames:
        some.append(_seen(catalog, frame))
        if sum(len(one.rows) for one in some) >= PAIRS_AT_ONCE:
            yield from _with_claims(catalog, some)
            some = []
    yield from _with_claims(catalog, some)


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points in view of a frame: rows, places MCMF (n, 3), pixels and their sizes."""

    frame: PlannedImage
    rows: Index
    places: Array
    pixel: Array
    pixel_m: Array


def _seen(catalog: Catalog, frame: PlannedImage) -> _Seen:
    rows = points_in_view(catalog, frame.sensor)
    places = catalog.position_mcmf[rows]
    size = pixel_size_m(frame.sensor, places) if len(rows) else np.zeros(0)
    return _Seen(frame, rows, places, frame.sensor.project(places), size)


def _with_claims(catalog: Catalog, seen: list[_Seen]) -> Iterator[FramePoints]:
    """The points of some frames; rotations and claims are read together."""
    rows = np.concatenate([one.rows for one in seen] or [np.zeros(0, np.int64)])
    rotation = catalog.part("rotation_mcmf_to_enu", rows)
    ends = np.cumsum([len(one.rows) for one in seen])
    parts = [slice(end - len(one.rows), end) for one, end in zip(seen, ends, strict=True)]
    sun, view = np.empty((2, len(rows), 3))
    for one, part in zip(seen, parts, strict=True):
        sun[part] = rotation[part] @ one.frame.sun
        view[part] = np.einsum("nij,nj->ni", rotation[part], one.frame.sensor.towards(one.places))
    sizes = np.concatenate([one.pixel_m for one in seen] or [np.zeros(0)])
    heights = [altitude_km(one.frame.sensor, one.places) for one in seen]
    reduced = [usual_reductions(catalog, one.frame.sensor, one.rows, one.frame.sun) for one in seen]
    factor = np.concatenate([*reduced, np.zeros(0, np.int64)])
    height = np.concatenate([*heights, np.zeros(0)])
    claims = predict(catalog, rows, sun, view, sizes, height, factor)
    for one, part in zip(seen, parts, strict=True):
        own = Prediction(**{name: values[part] for name, values in vars(claims).items()})
        cause, usable = own.cause.copy(), np.flatnonzero(own.usable)
        whole = _shown_whole(catalog, one, rotation[part])
        cut = ~whole[usable]
        unstated = ~np.isfinite(own.covariance_m2[usable]).all(axis=(1, 2))
        cause[usable[cut]] = CAUSES.index("edge")
        cause[usable[unstated]] = CAUSES.index("not evaluated")
        own = replace(own, cause=cause)
        yield FramePoints(
            one.frame, one.rows, one.pixel, one.pixel_m, rotation[part], own, factor[part], whole
        )


def _shown_whole(catalog: Catalog, seen: _Seen, rotation: Array) -> Mask:
    """True (n,) for the points in view whose patch has all four corners in the image: claims are about such."""
    places, (east, north, _) = seen.places, np.moveaxis(rotation, 1, 0)
    half = 0.5 * (catalog.patch_nodes - 1) * catalog.gsd[seen.rows, None]
    inside = np.ones(len(places), bool)
    for a, b in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        corner = seen.frame.sensor.project(places + half * (a * east + b * north))
        inside &= seen.frame.sensor.in_image(corner)
    return inside
