"""Why too few of a catalogue's points are usable in an image, and the cheapest catalogues that may have more.

The price of a catalogue is its work as a multiple of this one's: the work of a build is proportional to views, Suns and
cells. A cause whose points lack a claim is taken away by the claim: at most all of them become usable. What finer cells or
brightness do for a claimed point needs another build.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..cameras.mistakes import likely_mistake
from ..cameras.sensor import POSE, Sensor
from ..cameras.view import below_sphere, footprint
from ..catalog.catalogue import Catalog
from ..constants import SUBSOLAR_LATITUDE_MAX_DEG
from ..errors import ImageError
from ..geometry.bounds import Bounds, enclosing_bounds
from ..geometry.frames import azimuth_elevation
from ..matching.point_choice import shows_points
from .expected_position import LEAST_POINTS
from .frame_points import FramePoints, PlannedImage, points_of_frames

_MOSTLY = 0.5
"""Share of usable points in view below which a catalogue for the image is priced."""

_COUNTS = 0.1
"""Least share of the points in view that a cause needs for its cures to be named."""

_LOW_DEG = 1.0
"""Sun for which a row of its own is named where it is higher at some points: below it nearly all ground is in shadow."""

_NAMED = 2
"""Catalogues that are named."""

_BUILD = "`build_catalog` with"
"""What a key of a build's configuration follows, which the command that tells of it may not have."""


@dataclass(frozen=True, order=True)
class Better:
    """A catalogue that may have more usable points: its work, what is changed, and the most that it adds; None: only a build
    can tell.
    """

    work: float
    change: str
    adds: int | None

    def __str__(self) -> str:
        more = (
            "whose effect only a build can tell,"
            if self.adds is None
            else f"for at most {self.adds} points more,"
        )
        return f"{self.change}, {more} at {self.work:.3g} times the work"


def better_catalog(catalog: Catalog, image: PlannedImage, planned: bool = False) -> str:
    """That few of the points in view are usable in an image, why, and the two cheapest catalogues that may have more, as the
    end of a sentence; empty if most are usable and enough for a position, and for an image without a camera's place.
    ``planned``: the image is not taken yet, so that another Sun helps without a build.
    """
    if image.sensor.corrections != POSE:
        return ""
    (points,) = points_of_frames(catalog, [image])
    counts = points.counts
    seen, usable = counts.pop("in_view"), counts.pop("usable")
    if usable >= max(_MOSTLY * seen, LEAST_POINTS):
        return ""
    if not seen:
        return _elsewhere(catalog, image.sensor)
    told = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
    better = "; ".join(map(str, sorted(_changes(catalog, points))[:_NAMED]))
    better = f"a catalogue that may have more: {better}" if better else "no other catalogue is known to have more"  # fmt: skip
    if _never(points):
        better += "; the Sun never stands there"
    if planned and counts["sun"] + counts["not evaluated"]:
        suns = catalog.sun_elevation
        better += f"; without a build: the Sun {suns.min():g} to {suns.max():g} deg high"
    why = f" (else {told})" if told else ""
    return f"; of {seen} points in view {usable} are usable here{why}: {better}"


def _elsewhere(catalog: Catalog, sensor: Sensor) -> str:
    """The catalogue of the ground that a sensor sees, priced by its area; empty if it sees none, and for a camera that would
    see points without a mistake of its file.
    """
    if likely_mistake(sensor, shows_points(catalog)):
        return ""
    if below_sphere(sensor):  # without a footprint
        return ""
    try:
        seen = footprint(sensor)
    except ImageError:
        return ""
    lon, lat = catalog.longitude, catalog.latitude
    own = _area(enclosing_bounds(lon, lon, lat.min(), lat.max())) if len(catalog) else 0.0
    price = f" at {_area(seen) / own:.3g} times the work" if own else ""
    box = " ".join(f"{one:.6g}" for one in seen)
    return f"; a catalogue of what the image shows: {_BUILD} `area.bounds_deg` {box}{price}"


def _area(box: Bounds) -> float:
    """Area of a box on the unit sphere."""
    south, north = (math.sin(math.radians(one)) for one in (box.south, box.north))
    return math.radians(box.east - box.west) * (north - south)


def _changes(catalog: Catalog, points: FramePoints) -> Iterator[Better]:
    """What may be changed against the causes that prevail."""
    counts = points.counts
    least = _COUNTS * counts["in_view"]
    cell_m = float(np.median(catalog.gsd[points.rows]))
    for cause in ("sun", "not evaluated"):
        if counts[cause] > least:
            yield from _suns(catalog, points, counts[cause])
    if counts["view"] > least:
        towards = np.einsum(
            "nij,nj->ni",
            points.rotation,
            points.frame.sensor.towards(catalog.position_mcmf[points.rows]),
        )
        around, over = azimuth_elevation(towards.mean(axis=0))
        view = f"a view {90.0 - over:.0f} deg off nadir at azimuth {around:.0f}"
        yield Better(1.0 + 1.0 / len(catalog.view_off_nadir), view, counts["view"])
    if counts["scale"] > least:
        pixel_m = float(np.median(points.pixel_m))
        work = (cell_m / pixel_m) ** 2
        yield Better(work, f"{_BUILD} `area.gsd_m` {pixel_m:.3g}", counts["scale"])
    if (hidden := counts["shadow"] + counts["occlusion"]) > least:
        stated = tomllib.loads(catalog.config).get("points", {}).get("max_dependence")
        value = "higher" if stated is None else f"{min(1.0, 2.0 * stated):.2g}"
        yield Better(1.0, f"{_BUILD} `points.max_dependence` {value}", hidden)
    if counts["detection"] > least:
        if catalog.albedo_map is None:
            yield Better(1.0, "an albedo map", None)
        yield Better(4.0, f"{_BUILD} `area.gsd_m` {0.5 * cell_m:.3g}, if the DEM resolves it", None)
    if few := counts["usable"] + counts["edge"]:
        yield Better(4.0, f"{_BUILD} `points.spacing_m` halved", 3 * few)


def _never(points: FramePoints) -> bool:
    """True for a Sun farther from the Moon's equator than it ever is: no build evaluates it."""
    highest = math.sin(math.radians(SUBSOLAR_LATITUDE_MAX_DEG))
    return bool(abs(points.frame.sun[2]) > highest)


def _suns(catalog: Catalog, points: FramePoints, count: int) -> Iterator[Better]:
    """Another Sun of the table, so that it reaches that of the image at most of the points where it is day; of a Sun between
    the elevations its azimuth is lacking.
    """
    along, above = azimuth_elevation(points.rotation @ points.frame.sun)
    suns = catalog.sun_elevation
    low, high = above[(above > 0.0) & (above < suns.min())], above[above > suns.max()]
    if _never(points) or above.max() <= 0.0:
        return
    if len(low):
        least = float(min(low[low >= _LOW_DEG], default=low.max()))
        node = math.floor(least) or math.floor(10.0 * least) / 10.0
        count = int((low >= node).sum())
    elif len(high):
        node = math.ceil(high.max())
    else:
        azimuth = f"{_BUILD} `sun.azimuths_deg` that include {float(np.median(along)):.0f}"
        yield Better(1.0 + 1.0 / len(catalog.sun_azimuth), azimuth, count)
        return
    yield Better(
        1.0 + 1.0 / len(suns), f"{_BUILD} `sun.elevations_deg` that include {node:g}", count
    )
