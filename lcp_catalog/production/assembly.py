"""The catalogue from all areas' candidates: the choice among them by their tables, then the chosen
ones' records, a block at a time.
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import AnyArray, Array, Bytes, Index, Mask
from ..catalog.hdf5 import Catalog, Coverage, new_catalog
from ..catalog.maps import overview_levels
from ..catalog.packing import sigma_step_m
from ..catalog.schema import PACKED, VARIABLES, summarise_usable, universal
from ..dem.error_maps import ErrorMaps
from ..dem.mosaic import DemSet
from ..geometry.frames import enu_rotation, lonlat_to_mcmf
from ..landmarks.error_model import ErrorModel
from ..landmarks.selection import SPARE_STAGE, USABLE_STAGE, select, stable_id
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance
from ..rendering.plan import ScenePlan
from ..terrain.area import Area
from .checkpoints import Checkpoints
from .config import BuildConfig, ErrorConfig
from .evaluation import image_scales
from .finished_area import record_type
from .joined_areas import JoinedAreas
from .levels import sources
from .promise import PromiseChoice
from .region_maps import has_heights, overview_bytes, region_coverage, region_overview

BLOCK_BYTES = 2**25
"""Records of points that are in memory together; the checks of their values take several times as much."""


_SAMPLED = 256
"""Records whose size in the file is measured for a limit of its size."""

_FILE_BYTES = 260_000
"""Bytes of a file without points (`estimate.FILE_BYTES`) and of its maps."""

_BYTES_BESIDE = 350
"""Bytes of a point beside its record: position, rotation, names, summaries."""


@dataclass(frozen=True)
class Assembly:
    """What a catalogue needs beside the areas: ``model``: the reflectance model of all images;
    ``errors``: their error model.
    """

    config: BuildConfig
    dems: DemSet
    region: Area
    gsd_m: float
    model: Reflectance
    errors: ErrorModel
    albedo: AlbedoMap | None = None
    maps: ErrorMaps | None = None

    def write(
        self,
        checkpoints: Checkpoints,
        names: Sequence[str],
        output: Path,
        overwrite: bool,
        check: Callable[[], None] = lambda: None,
    ) -> int:
        """Choose the points among the candidates of the areas (names) and write the catalogue. Return
        the number of points. ``check``: called before the file appears under its name, which it does
        not if that raises an error.

        AreaFailedError for an area that is lost or damaged; otherwise errors as `new_catalog`.
        """
        choice = PromiseChoice.of(self.region, self.config, self.gsd_m)
        areas = JoinedAreas.read(checkpoints, names, choice.see if choice else _unseen)
        table, stages = areas.table, areas.table["stage"]
        if choice:
            chosen, promise = choice.choose(table, self._with_heights(choice), self._most(areas))
            stages = np.where(stages == USABLE_STAGE, SPARE_STAGE, stages)
        else:
            chosen, promise = choose(table, self.config, self.gsd_m), None
        head, products = self._head(areas.plan), self.dems.products
        with new_catalog(head, len(chosen), products, output, overwrite) as file:
            kind = record_type(self.config, self.albedo is not None)
            step = max(1, BLOCK_BYTES // kind.itemsize)
            for start in range(0, len(chosen), step):
                rows = chosen[start : start + step]
                file.add(self._values(table[rows], areas.records(rows, kind)))
            with file.flags() as condition:
                coverage = region_coverage(
                    self.dems,
                    self.region,
                    (table["lon_deg"], table["lat_deg"]),
                    stages,
                    (table["lon_deg"][chosen], table["lat_deg"][chosen]),
                    condition,
                    _spacing_m(self.config, self.gsd_m),
                    self._sources,
                )
            file.finish(coverage, promise)
            check()
        return len(chosen)

    @property
    def _sources(self) -> tuple[int, ...]:
        return sources(self.config, self.dems, self.gsd_m)

    def _with_heights(self, promise: PromiseChoice) -> Mask:
        """True for the places of a promise but those without candidates and without heights from the DEMs
        that points may come from.
        """
        held = np.ones(len(promise.best), np.bool_)
        bare = np.flatnonzero(~promise.best.any(axis=1))
        held[bare] = has_heights(
            self.dems, promise.places.lon_deg[bare], promise.places.lat_deg[bare], self._sources
        )
        return held

    def _most(self, areas: JoinedAreas) -> int | None:
        """Most points that the configuration allows; None without a limit."""
        points = self.config.points
        limits = [] if points.max_points is None else [points.max_points]
        if points.max_bytes is not None:
            rows = np.flatnonzero(areas.table["usable"])
            some = rows[np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLED)).astype(np.int64)]
            records = areas.records(some, record_type(self.config, self.albedo is not None))
            each = _stored_bytes(records) / max(1, len(records)) + _BYTES_BESIDE
            beside = _FILE_BYTES + overview_bytes(self.region, self.gsd_m)
            limits.append(max(1, int((points.max_bytes - beside) / each)))
        return min(limits, default=None)

    def _head(self, plan: ScenePlan) -> Catalog:
        """The catalogue without points and coverage."""
        config, sun, view = self.config, self.config.sun, self.config.view
        spacing_m = _spacing_m(config, self.gsd_m)
        overview = region_overview(self.dems, self.region, self.gsd_m)
        resolved = _resolved(config, self.region, self.gsd_m, spacing_m, self.model, self.errors)
        files = self.dems.sources()
        none = np.zeros(0, record_type(config, self.albedo is not None))
        empty = self._values(np.zeros(0, [("lon_deg", "<f8"), ("lat_deg", "<f8")]), none)
        columns: dict[str, Any] = {
            f.name: empty[f.name] for f in dataclasses.fields(Catalog) if f.name in empty
        }
        columns |= {name: empty[name].astype(np.float32) for name in PACKED}
        return Catalog(
            **columns,
            image_scale=np.array(image_scales(config.points.patch_nodes), dtype=np.float64),
            sun_azimuth=np.array(sun.azimuths_deg),
            sun_elevation=np.array(sun.elevations_deg),
            view_off_nadir=np.array(view.off_nadir_deg),
            view_azimuth=np.array(view.azimuth_deg),
            view_altitude=np.array(view.altitude_km),
            config=resolved.to_toml(),
            history=f"build of {', '.join(str(one['name']) for one in files)} with {resolved.in_one_line()}",
            sources=files,
            albedo_map=self.albedo.provenance() if self.albedo else None,
            scene_plan=plan.to_json(),
            errors=self.errors.to_dict() | {"min_detection": config.points.min_detection},
            sigma_step_m=sigma_step_m(np.array([self.gsd_m])),
            overview=overview,
            overview_levels=overview_levels(overview),
            coverage=Coverage(np.zeros(0), np.zeros(0), np.zeros(0, np.uint8), spacing_m),
        )

    def _values(self, table: AnyArray, records: AnyArray) -> dict[str, AnyArray]:
        """The variables of points, from their rows of the table and their records."""
        lon, lat, product = table["lon_deg"], table["lat_deg"], records["product"]
        columns = {
            name: np.ascontiguousarray(records[name])
            for name in records.dtype.names or ()
            if name in VARIABLES
        }
        condition, elevations = columns["condition"], np.array(self.config.sun.elevations_deg)
        lowest, highest = summarise_usable(condition, elevations)
        sigma, resolution = self._height_errors(lon, lat, product)
        names = np.array(self.dems.products, dtype=object)
        return columns | {
            "point_id": stable_id(lon, lat),
            "longitude": np.ascontiguousarray(lon),
            "latitude": np.ascontiguousarray(lat),
            "position_mcmf": lonlat_to_mcmf(lon, lat, columns["elevation"]),
            "rotation_mcmf_to_enu": enu_rotation(lon, lat),
            "gsd": np.full(len(table), self.gsd_m),
            "dem_product": names[product],
            "elevation_sigma": sigma,
            "dem_resolution": resolution,
            "sun_elevation_min": lowest,
            "sun_elevation_max": highest,
            "universal": universal(condition).astype(np.uint8),
            "level": np.zeros(len(table), dtype=np.int32),
        }

    def _height_errors(self, lon: Array, lat: Array, product: AnyArray) -> tuple[Array, Array]:
        """1-sigma of the heights and resolution of the DEM at each point, from the maps or else the
        DEM's own, metres; NaN if unknown.
        """
        sigma = _known([dem.facts.sigma_m for dem in self.dems.dems])[product]
        resolution = _known([dem.resolution_m for dem in self.dems.dems])[product]
        if self.maps is None:
            return sigma, resolution
        own = self.maps.at(lon, lat)
        sigma, resolution = (
            np.where(np.isfinite(mapped), mapped, figure)
            for mapped, figure in zip(own, (sigma, resolution), strict=True)
        )
        return sigma, resolution


def _unseen(table: AnyArray, stages: Bytes) -> None:
    """What a build without a promise does with the stages of an area."""


def _stored_bytes(records: AnyArray) -> int:
    """Bytes that records take in a file, where every variable is shuffled and deflated."""
    total = 0
    for name in records.dtype.names or ():
        column = np.ascontiguousarray(records[name])
        shuffled = column.view(np.uint8).reshape(-1, column.dtype.itemsize).T
        total += len(zlib.compress(shuffled.tobytes(), 4))
    return total


def choose(table: AnyArray, config: BuildConfig, gsd_m: float) -> Index:
    """Rows of a table of candidates (`finished_area.TABLE`) that become points, evenly spread: those with
    the most usable conditions first, then those with the finest localisation.
    """
    spacing_m = _spacing_m(config, gsd_m)
    return select(table["lon_deg"], table["lat_deg"], table["usable"], table["quality"], spacing_m)


def _spacing_m(config: BuildConfig, gsd_m: float) -> float:
    return config.points.spacing_nodes(gsd_m) * gsd_m


def _known(figures: list[float | None]) -> Array:
    """Numbers as an array, NaN for None."""
    return np.array([math.nan if figure is None else figure for figure in figures])


def _resolved(
    config: BuildConfig,
    region: Area,
    gsd_m: float,
    spacing_m: float,
    model: Reflectance,
    errors: ErrorModel,
) -> BuildConfig:
    """The configuration with the values that were derived from the DEM, without folders."""
    area = dataclasses.replace(config.area, gsd_m=gsd_m)
    if not area.center_deg and not area.bounds_deg:
        area = dataclasses.replace(area, bounds_deg=tuple(region.bounds))
    search_m = config.points.search_nodes(gsd_m) * gsd_m
    promised = config.points.promised
    points = dataclasses.replace(config.points, search_m=search_m, per_view=promised)
    if not promised:  # else it is the side of cells alone
        points = dataclasses.replace(points, spacing_m=spacing_m)
    section = dataclasses.replace(config.model.portable, reflectance=model.name)
    known = ErrorConfig(**errors.to_dict())
    return dataclasses.replace(
        config, area=area, dem=config.dem.portable, points=points, model=section, errors=known
    )
