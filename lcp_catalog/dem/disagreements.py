"""Agreement of two products of a set in the area that they share, within their published uncertainties."""

from __future__ import annotations

import itertools
import logging
import math
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Index
from ..constants import MOON_RADIUS_M
from ..geometry.bounds import Bounds
from .dem import Dem
from .mosaic import UNKNOWN_SIGMA_M, DemSet
from .products import tie_of
from .shared_ground import FACTOR, PLACES_MIN, REACH, SharedGround, Sigmas, blocks
from .tiles import Layer

log = logging.getLogger(__name__)

_UNKNOWN_TIE_M = 30.0
"""1 sigma, each axis, assumed of the place of a product's map of which none is published: the largest published."""

_NODES = 12
"""Along a side of a cluster: places close together are read in one small window."""

_LATTICE = 16
"""Along a side of what two files share of the box: places among which the clusters' centres are chosen."""


@dataclass(frozen=True)
class Disagreement:
    """Disagreement of two products at ``places`` that both have: the median absolute difference and
    the limit that their uncertainties explain, metres; if it is not beyond that, how far the same ground lies ``apart_m``,
    1 sigma of that, and the limit that errors of place explain.

    ``assumed``: those of the two whose uncertainty is not published, taken as `UNKNOWN_SIGMA_M`.
    """

    products: tuple[str, str]
    places: int
    median_m: float
    limit_m: float
    assumed: tuple[str, ...]
    apart_m: float = 0.0
    apart_sigma_m: float = 0.0
    apart_limit_m: float = math.inf

    def __str__(self) -> str:
        one, other = self.products
        if self.median_m <= self.limit_m:
            return (
                f"the ground of {one} and {other} lies {self.apart_m:.0f} +- {self.apart_sigma_m:.0f} m apart (fitted to "
                f"{self.places} places), beyond the {self.apart_limit_m:.0f} m that errors of place explain"
            )
        text = (
            f"{one} and {other} differ by {self.median_m:.1f} m (median of {self.places} places), "
            f"beyond the {self.limit_m:.1f} m that their uncertainties explain"
        )
        if self.assumed:
            names = " and ".join(self.assumed)
            text += f" (that of {names} is not published: {UNKNOWN_SIGMA_M:g} m assumed)"
        return text

    @property
    def excess(self) -> float:
        """How many times a limit is exceeded."""
        return max(self.median_m / self.limit_m, self.apart_m / self.apart_limit_m)


def disagreements(dems: DemSet, box: Bounds, shifts: bool = True) -> list[Disagreement]:
    """Pairs of products that disagree in a box of longitudes and latitudes, the worst first.

    About two thousand places are compared, in clusters over what two products share of the box, at the pixel of the
    coarser one. They disagree if the median absolute difference is above `FACTOR` * hypot(sigma, sigma), or the same ground
    lies apart (`SharedGround.shift`; only with ``shifts``: 0.1 s a pair). Pairs with fewer than 30 common places are left out.
    """
    pairs = list(itertools.combinations(dems.layers, 2))
    for layer in dems.layers:  # files of one product on one lattice may overlap, too
        pairs += [(Layer((a,)), Layer((b,))) for a, b in itertools.combinations(layer.dems, 2)]
    compared = (_compared(one, other, box, shifts) for one, other in pairs)
    found = [one for one in compared if one is not None and one.excess > 1.0]
    return sorted(found, key=lambda pair: -pair.excess)


def warn_of_disagreements(dems: DemSet, box: Bounds, shifts: bool = True) -> None:
    """Log one warning about all products that disagree in a box (`disagreements`)."""
    found = disagreements(dems, box, shifts)
    if found:
        log.warning(
            "%s; terrain across their seam is tilted: check the files, or leave one out",
            "; ".join(map(str, found)),
        )


def _compared(one: Layer[Dem], other: Layer[Dem], box: Bounds, shifts: bool) -> Disagreement | None:
    """Comparison of two layers; None if they share too few places."""
    dems = one.dems[0], other.dems[0]
    ground = _shared(one, other, box)
    away = np.zeros(0) if ground is None else ground.away(np.zeros(2))
    common = np.abs(away[np.isfinite(away)])
    if ground is None or common.size < PLACES_MIN:
        return None
    sigmas = [dem.facts.sigma_m for dem in dems]
    names = dems[0].product, dems[1].product
    if names[0] == names[1]:
        names = dems[0].path.name, dems[1].path.name
    assumed = tuple(name for name, known in zip(names, sigmas, strict=True) if known is None)
    limit_m = FACTOR * math.hypot(*(UNKNOWN_SIGMA_M if s is None else s for s in sigmas))
    median_m = float(np.median(common))
    if median_m > limit_m or not shifts:
        return Disagreement(names, common.size, median_m, limit_m, assumed)
    here, there = (
        Sigmas(0.0, (tie_of(dem.product) or (_UNKNOWN_TIE_M, ""))[0], 0.0) for dem in dems
    )
    apart_m, sigma_m, most_m = ground.apart(here, there)
    return Disagreement(names, common.size, median_m, limit_m, assumed, apart_m, sigma_m, most_m)


def _shared(one: Layer[Dem], other: Layer[Dem], box: Bounds) -> SharedGround | None:
    """What two layers share of a box, in clusters; None if that is nothing."""
    gsd_m = max(one.pixel_m, other.pixel_m)
    lon, lat = _centres(one, other, box)
    if not len(lon):
        return None
    lons, lats = _cluster(lon, lat, gsd_m, _NODES)
    height = one.sample(lons, lats, gsd_m).height
    side = _NODES + 2 * (REACH + 1)
    lons, lats = _cluster(lon, lat, gsd_m, side)
    raster = other.sample(lons, lats, gsd_m).height
    row, column = np.mgrid[:_NODES, :_NODES].reshape(2, 1, -1) + REACH + 1.0
    place = np.broadcast_to(np.stack([row, column]), (2, len(lon), _NODES**2))
    along = np.array([[0.0, 1.0], [1.0, 0.0]])[:, :, None, None] / gsd_m
    number = np.broadcast_to(_numbers(lon, lat)[:, None], place.shape[1:])
    rasters = raster.reshape(len(lon), side, side)
    return SharedGround(
        height.reshape(len(lon), -1), rasters, place, along, number, gsd_m, (0.0, 0.0)
    )


def _centres(one: Layer[Dem], other: Layer[Dem], box: Bounds) -> tuple[Array, Array]:
    """Longitudes and latitudes of a place in each of `_parts`, spread over what two layers share of a box."""
    share = (np.arange(_LATTICE) + 0.5) / _LATTICE
    lons, lats = [np.zeros(0)], [np.zeros(0)]
    for a, b in itertools.product(one.dems, other.dems):
        both = a.grid.bounds.common(b.grid.bounds)
        if (own := both and both.common(box)) is None:
            continue
        south, north = math.sin(math.radians(own.south)), math.sin(math.radians(own.north))
        lat, lon = np.meshgrid(
            np.degrees(np.arcsin(south + share * (north - south))),
            own.west + share * (own.east - own.west),
        )
        lons.append(lon.ravel())
        lats.append(lat.ravel())
    lon, lat = np.concatenate(lons), np.concatenate(lats)
    held = one.holds(lon, lat).any(axis=0) & other.holds(lon, lat).any(axis=0)
    lon, lat = lon[held], lat[held]
    if not len(lon):
        return lon, lat
    chosen = [own[len(own) // 2] for own in _parts(_numbers(lon, lat))]
    return lon[chosen], lat[chosen]


def _numbers(lon: Array, lat: Array) -> Index:
    return blocks(lon * np.cos(np.radians(lat.mean())), lat)


def _parts(number: Index) -> list[Index]:
    """Places of each number."""
    return [np.flatnonzero(number == one) for one in np.unique(number)]


def _cluster(lon: Array, lat: Array, step_m: float, nodes: int) -> tuple[Array, Array]:
    """Longitudes and latitudes of places a step apart around centres, row by row from the south, centre by centre."""
    step = math.degrees(step_m / MOON_RADIUS_M)
    row, column = np.mgrid[:nodes, :nodes].reshape(2, -1) - (nodes - 1) / 2.0
    lats = np.clip(lat[:, None] + step * row, -90.0, 90.0)
    lons = lon[:, None] + step * column / np.cos(np.radians(lat[:, None]))
    return lons.ravel(), lats.ravel()
