"""The promise of a catalogue: near every place of the region the points are worth so many units (`landmarks.located`)
under every view and Sun that can happen, or it is known why not; and the choice of the fewest points that keep it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

import numpy as np

from ..arrays import AnyArray, Array, Bytes, Index, Int16, Mask
from ..catalog.model import Promise
from ..catalog.schema import NO_CELL, Cause
from ..catalog.sun_cells import SunCells
from ..constants import MOON_RADIUS_M
from ..ephemeris.solar_position import reachable_suns
from ..errors import ConfigError
from ..geometry.frames import enu_rotation, mcmf_to_lonlat
from ..kernels.multicover import raise_to
from ..landmarks.located import Units
from ..landmarks.selection import (
    Cover,
    Nearby,
    Places,
    choose_cover,
    least_size,
    nearest,
    select,
    stable_id,
)
from ..terrain.area import Area
from .config import BuildConfig
from .finished_area import units_of
from .moments import Claimed, Near, moment_cover
from .point_config import PointConfig
from .region_maps import COVERAGE_BYTES, COVERAGE_CELLS, coverage_cells

_FINEST, _COARSEST = 16.0, 4.0
"""Steps of the lattice of places in a footprint's diameter: at most, and at least where there are many
candidates.
"""

_LINKS = 4e7
"""Pairs of candidates and places near them that are held in memory."""

_DISC, _DISCS = 128, 2048
"""Places in a footprint at which its share in the region is taken, and footprints taken together."""

_LATTICE_MAX = 1200
"""Longest side of the lattice on which the distance to the nearest place is measured."""

_LATITUDE_STEP_DEG = 0.25
"""Latitudes to which those of places and candidates are rounded for the Suns that can happen."""

_CURVE_STEPS = 200


@dataclass(frozen=True)
class PromisedPlaces:
    """Places at which a promise is made: a camera over any place of the region has one of them within
    ``footprint_m / 2 - radius_m``, less half a patch's diagonal, so that it sees all patches whole whose points are within
    ``radius_m`` of that.
    """

    at: Places
    demand: Bytes  # units promised at each
    footprint_m: float
    radius_m: float

    @classmethod
    @functools.lru_cache(maxsize=2)
    def of(
        cls, region: Area, points: PointConfig, gsd_m: float, conditions: int, demand: int
    ) -> PromisedPlaces:
        """An even lattice over a region. Where a footprint reaches beyond the region, as large a share
        of the ``demand`` is promised as of the footprint lies in it, rounded down. ConfigError for a
        footprint that shows no patch whole, that is small beside the distance of as many places as can be kept, or so large
        that no place has a share.
        The last ones are kept, since a build asks at each choice.
        """
        x0, x1, y0, y1 = region.extent_m
        most = min(COVERAGE_CELLS, COVERAGE_BYTES // conditions)
        ground_m2 = (x1 - x0) * (y1 - y0) if region.is_local else region.bounds_m2
        least_m = _COARSEST * math.sqrt(ground_m2 / most)
        footprint_m = points.footprint_m(gsd_m, min(x1 - x0, y1 - y0), least_m)
        at, reach_m, radius_m = _placed(region, points, gsd_m, footprint_m, most)
        if reach_m > 4.0 * radius_m:
            least_km = math.ceil((reach_m / 0.4 + points.diagonal_m(gsd_m)) / 1e3)
            while not _works(region, points, gsd_m, least_km, most):
                least_km += 1
            # The reach at the stated width was the guess: that of a larger one can be less.
            while _works(region, points, gsd_m, least_km - 1, most):
                least_km -= 1
            at = _placed(region, points, gsd_m, 1e3 * least_km, most)[0]
            helps = f"give {least_km} km or more (or "
            if not _promised(region, at, 1e3 * least_km / 2.0, demand).any():
                helps = "no width helps (give "
            raise ConfigError(
                f"the ground that a frame sees, {footprint_m / 1e3:g} km wide (`points.footprint_km`), is too small for this "
                f"region and patches of {points.patch_nodes * gsd_m / 1e3:.3g} km: {helps}smaller cells, fewer "
                "`points.patch_nodes`, or `points.per_view` 0)"
            )
        promised = _promised(region, at, footprint_m / 2.0, demand)
        if not promised.any():
            raise ConfigError(
                f"the ground that a frame sees, {footprint_m / 1e3:g} km wide (`points.footprint_km`), is too large for this "
                "region: nothing could be promised in any footprint; give a smaller `points.footprint_km`, or a larger region, or "
                "smaller cells; is a stated altitude in km?"
            )
        return cls(at, promised, footprint_m, radius_m)


def _placed(
    region: Area, points: PointConfig, gsd_m: float, footprint_m: float, most: int
) -> tuple[Places, float, float]:
    """Places of footprints, how far from them a location is at most, and the radius within which every camera near a place
    shows patches whole, metres.
    """
    cell_m = points.spacing_nodes(gsd_m) * gsd_m
    near = points.candidates_per_cell * math.pi / 4.0 * (footprint_m / cell_m) ** 2
    at = _lattice(region, footprint_m, near, most)
    reach_m = _reach_m(region, at) if len(at.lon_deg) else 0.0
    return at, reach_m, (footprint_m - points.diagonal_m(gsd_m)) / 2.0 - reach_m


def _works(region: Area, points: PointConfig, gsd_m: float, footprint_km: int, most: int) -> bool:
    """True if a footprint of this width is not small beside the distance of its places."""
    _, reach_m, radius_m = _placed(region, points, gsd_m, 1e3 * footprint_km, most)
    return reach_m <= 4.0 * radius_m


def _promised(region: Area, at: Places, radius_m: float, demand: int) -> Bytes:
    """Units promised at places: as large a share as of the footprint lies in the region."""
    return np.floor(demand * _shares(region, at, radius_m) + 1e-9).astype(np.uint8)


def _lattice(region: Area, footprint_m: float, near: float, most: int) -> Places:
    """Places of an even lattice; ``near``: candidates in a footprint. As many places lie in a footprint,
    and the pairs of both grow with the region.
    """
    x0, x1, y0, y1 = region.extent_m
    footprints = max(1.0, (x1 - x0) * (y1 - y0) / footprint_m**2)
    steps = math.sqrt(_LINKS / max(1.0, near * footprints))
    step_m = footprint_m / min(_FINEST, max(_COARSEST, steps))
    lon, lat, _ = coverage_cells(region, step_m, most)
    return Places(lon, lat)


def _reach_m(region: Area, places: Places) -> float:
    """Distance within which every place of a region has one of the ``places``, metres."""
    x0, x1, y0, y1 = region.extent_m
    step_m = math.sqrt(max(1.0, (x1 - x0) * (y1 - y0)) / len(places.lon_deg))
    side = min(_LATTICE_MAX, 8 + math.ceil(16.0 * max(x1 - x0, y1 - y0) / step_m))
    lon, lat, gap_m = region.covering(side)
    _, away_m = nearest(Places(lon, lat), places)
    return float(away_m.max(initial=0.0)) + gap_m


def _shares(region: Area, places: Places, radius_m: float) -> Array:
    """Share of the disc around each place that lies in a region."""
    number = np.arange(_DISC) + 0.5
    away = radius_m / MOON_RADIUS_M * np.sqrt(number / _DISC)
    turn = number * math.pi * (3.0 - math.sqrt(5.0))
    part = [np.sin(away) * np.cos(turn), np.sin(away) * np.sin(turn), np.cos(away)]
    offsets = np.stack(part, axis=1)
    share = np.empty(len(places.lon_deg))
    axes = enu_rotation(places.lon_deg, places.lat_deg)
    for start in range(0, len(share), _DISCS):
        some = slice(start, start + _DISCS)
        lon, lat, _ = mcmf_to_lonlat(MOON_RADIUS_M * offsets @ axes[some])
        share[some] = region.contains(lon, lat).mean(axis=1)
    return share


@dataclass
class PromiseChoice:
    """The promise of a build, and what its candidates do for it: `see` the areas in turn, then `choose`."""

    config: BuildConfig
    places: PromisedPlaces
    exists: Mask  # (place, cell): Suns that can happen, of those in ``columns``
    columns: Index  # of the whole grid of conditions, flat
    units: Units
    best: Bytes = field(init=False)
    _nearby: Nearby = field(init=False)
    _claims: list[Bytes] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.best = np.zeros((len(self.places.demand), len(self.columns)), np.uint8)
        self._nearby = Nearby(self.places.at)

    @classmethod
    def of(cls, region: Area, config: BuildConfig) -> PromiseChoice | None:
        """None for a build that promises nothing, or with Suns that all are outside what can happen.
        ConfigError for a footprint that is too small.
        """
        if not config.points.promised:
            return None
        views = len(config.view)
        grid = SunCells.of(config.sun.elevations_deg, config.sun.azimuths_deg)
        units, conditions = units_of(config), views * math.prod(grid.shape)
        places = PromisedPlaces.of(region, config.points, config.gsd_m, conditions, units.demand)
        rounded = np.round(places.at.lat_deg / _LATITUDE_STEP_DEG) * _LATITUDE_STEP_DEG
        latitudes, own = np.unique(rounded, return_inverse=True)
        can = np.array([_cells(grid, float(lat), config).ravel() for lat in latitudes])
        used = np.flatnonzero(can.any(axis=0))
        if not len(used):
            return None
        exists = np.tile(can[:, used], (1, views))[own]
        columns = (np.arange(views)[:, None] * can.shape[1] + used).ravel()
        return cls(config, places, exists, columns, units)

    def see(self, table: AnyArray, stages: Bytes) -> None:
        """Note what an area's candidates are good for (`finished_area.cell_stages`)."""
        causes, claims = np.hsplit(stages, 2)
        sites = Places(table["lon_deg"], table["lat_deg"])
        first, place = self._nearby.around(sites, self.places.radius_m)
        raise_to(self.best, first, place, np.ascontiguousarray(causes[:, self.columns]))
        self._claims.append(np.ascontiguousarray(claims))

    def choose(self, table: AnyArray, has_heights: Mask, most: int | None) -> tuple[Index, Promise]:
        """Rows of the table of all areas that become points, in the order of their ids, and how the
        promise is kept. ``has_heights``: of the places; ``most``: greatest number of points.
        """
        pool, cover, wanted, demand = self._asked(table)
        choice = choose_cover(cover, wanted, most)
        found = cover.counts(choice.chosen)
        complete = bool((found >= wanted).all())
        bound = least_size(cover, wanted, len(choice.chosen)) if complete else 0.0
        cause = self._causes(found, wanted, demand, has_heights)
        steps = np.unique(np.linspace(0, len(choice.met) - 1, _CURVE_STEPS).astype(np.int64))
        steps = steps[: len(choice.met)]
        promise = Promise(
            longitude=self.places.at.lon_deg,
            latitude=self.places.at.lat_deg,
            demand=self.places.demand,
            points=self._whole(np.minimum(found, NO_CELL - 1), demand),
            cause=self._whole(cause, demand),
            size=steps.astype(np.int32) + 1,
            met=choice.met[steps] / max(1, int(np.count_nonzero(wanted))),
            served=choice.served[steps],
            places=np.array([len(self.places.demand)]),
            gsd=np.array([self.config.gsd_m]),
            located_probability=np.array([self.config.points.located or 0.0]),
            per_view=np.array([self.config.points.per_view or 0]),
            units=np.array([len(self.units.least)]),
            located=np.array([self.units.located]),
            footprint=np.array([self.places.footprint_m]),
            radius=np.array([self.places.radius_m]),
            lower_bound=np.array([bound]),
        )
        rows = pool[choice.chosen]
        ids = stable_id(table["lon_deg"][rows], table["lat_deg"][rows])
        return rows[np.argsort(ids, kind="stable")], promise

    def rows(self, table: AnyArray, most: int | None) -> tuple[Index, float]:
        """The rows that `choose` chooses, in any order, and the share of what is promised that they keep."""
        pool, cover, wanted, demand = self._asked(table)
        chosen = choose_cover(cover, wanted, most).chosen
        kept = (cover.counts(chosen) >= demand)[demand > 0]
        return pool[chosen], float(kept.mean()) if len(kept) else 0.0

    def _asked(self, table: AnyArray) -> tuple[Index, Cover, Int16, Int16]:
        """Rows that can be chosen and what they are worth, what is wanted of them and what is promised, (place, cell)."""
        pool = self._pool(table)
        sites = Places(table["lon_deg"][pool], table["lat_deg"][pool])
        claims = Claimed.of(
            np.concatenate(self._claims)[pool], table["slope_sigma"][pool], self.config
        )
        radius_m = self.places.radius_m
        first, place = self._nearby.around(sites, radius_m)
        near = Near(sites, self.places.at, radius_m, first, place)
        cover, happens = moment_cover(near, claims, self.columns)
        demand = np.where(happens, self._demand(), 0).astype(np.int16)
        return pool, cover, np.minimum(demand, cover.counts(np.arange(len(pool)))), demand

    def _pool(self, table: AnyArray) -> Index:
        """Candidates no two of which are closer than the least distance, those with more information
        first.
        """
        distance_m = self.config.points.least_distance_m(self.config.gsd_m)
        places, worth = Places(table["lon_deg"], table["lat_deg"]), table["worth"]
        quality = table["quality"]
        pool = select(places, worth, quality, distance_m)
        keys = (-quality[pool], -worth[pool], -table["information"][pool])
        return pool[np.lexsort(keys)]

    def _demand(self) -> Int16:
        """Units promised, (place, cell). None where all candidates near are of latitudes at which the
        Sun does not stand in the cell.
        """
        seen: Mask = np.any(self.best, axis=1)
        foreign = (self.best == 0) & seen[:, None]
        asked = np.where(self.exists & ~foreign, self.places.demand[:, None], 0)
        return asked.astype(np.int16)

    def _causes(self, found: Int16, wanted: Int16, demand: Int16, has_heights: Mask) -> Bytes:
        """`Cause` of each cell, (place, cell)."""
        none = np.where(has_heights, Cause.FEATURELESS, Cause.NODATA)[:, None]
        return np.select(
            [found >= demand, found < wanted, self.best == 0],
            [Cause.MET, Cause.SIZE, none],
            self.best,
        ).astype(np.uint8)

    def _whole(self, values: AnyArray, demand: Int16) -> Bytes:
        """Values (place, cell) in the whole grid of conditions; `NO_CELL` where nothing is promised."""
        sun = self.config.sun
        shape = (len(self.config.view), len(sun.elevations_deg), len(sun.azimuths_deg))
        whole = np.full((len(values), math.prod(shape)), NO_CELL, np.uint8)
        whole[:, self.columns] = np.where(demand > 0, values, NO_CELL)
        return whole.reshape(-1, *shape)


def _cells(grid: SunCells, lat_deg: float, config: BuildConfig) -> Mask:
    """The cells of the Sun grid that can happen at a latitude and for which claims are made."""
    known = reachable_suns(lat_deg, grid.azimuth, grid.elevation)
    return grid.claims(lat_deg, known, config.points.min_detection).exists
