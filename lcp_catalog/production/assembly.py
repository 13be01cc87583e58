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
from ..catalog.catalogue import Catalog
from ..catalog.layout import sigma_step_m
from ..catalog.maps import overview_levels
from ..catalog.model import Coverage
from ..catalog.schema import PACKED, VARIABLES, summarise_usable, universal
from ..catalog.writing import new_catalog
from ..dem.error_maps import ErrorMaps, errors_of_file
from ..dem.products import PLACE_PER_LENGTH
from ..geometry.frames import enu_rotation, lonlat_to_mcmf
from ..landmarks.selection import SPARE_STAGE, USABLE_STAGE, Places, select, stable_id
from ..rendering.plan import ScenePlan
from .checkpoints import Checkpoints, JoinedAreas
from .config import BuildConfig
from .error_config import ErrorConfig
from .finished_area import record_type
from .promise import PromiseChoice
from .recipe import Recipe
from .region_maps import has_heights, overview_bytes, region_coverage, region_overview

BLOCK_BYTES = 2**25
"""Records of points that are in memory together; the checks of their values take several times as much."""


_SAMPLED = 256
"""Records whose size in the file is measured for a limit of its size."""

_FILE_BYTES = 150_000
"""Bytes of a file without points (`estimate.FILE_BYTES`) and of its maps."""

_BYTES_BESIDE = 350
"""Bytes of a point beside its record: position, rotation, names, summaries."""


@dataclass(frozen=True)
class Assembly:
    """The catalogue of areas (``names``) of a recipe that are finished."""

    recipe: Recipe
    checkpoints: Checkpoints
    names: Sequence[str]

    def write(self, output: Path, overwrite: bool, check: Callable[[], None]) -> int:
        """Choose the points among the candidates of the areas and write the catalogue. Return the number
        of points. ``check``: called before the file appears under its name, which it does not if that
        raises an error.

        AreaFailedError for an area that is lost or damaged; otherwise errors as `new_catalog`.
        """
        recipe = self.recipe
        choice = PromiseChoice.of(recipe.region, recipe.config)
        areas = JoinedAreas.read(self.checkpoints, self.names, choice.see if choice else _unseen)
        table, stages = areas.table, areas.table["stage"]
        if choice:
            chosen, promise = choice.choose(table, self._with_heights(choice), self._most(areas))
            stages = np.where(stages == USABLE_STAGE, SPARE_STAGE, stages)
        else:
            chosen, promise = choose(table, recipe.config), None
        head = self._head(areas.plan)
        with new_catalog(head, len(chosen), recipe.dems.products, output, overwrite) as file:
            kind = record_type(recipe.config)
            step = max(1, BLOCK_BYTES // kind.itemsize)
            for start in range(0, len(chosen), step):
                rows = chosen[start : start + step]
                file.add(self._values(table[rows], areas.records(rows, kind)))
            with file.flags() as condition:
                coverage = region_coverage(
                    recipe.dems,
                    recipe.region,
                    Places(table["lon_deg"], table["lat_deg"]),
                    stages,
                    Places(table["lon_deg"][chosen], table["lat_deg"][chosen]),
                    condition,
                    spacing_m(recipe.config),
                    recipe.sources,
                )
            file.finish(coverage, promise)
            check()
        return len(chosen)

    def _with_heights(self, promise: PromiseChoice) -> Mask:
        """True for the places of a promise but those without candidates and without heights from the DEMs
        that points may come from.
        """
        held = np.ones(len(promise.best), np.bool_)
        bare = np.flatnonzero(~promise.best.any(axis=1))
        held[bare] = has_heights(
            self.recipe.dems,
            promise.places.at.lon_deg[bare],
            promise.places.at.lat_deg[bare],
            self.recipe.sources,
        )
        return held

    def _most(self, areas: JoinedAreas) -> int | None:
        """Most points that the configuration allows; None without a limit."""
        config = self.recipe.config
        points = config.points
        limits = [] if points.max_points is None else [points.max_points]
        if points.max_bytes is not None:
            rows = np.flatnonzero(areas.table["worth"])
            some = rows[np.linspace(0, len(rows) - 1, min(len(rows), _SAMPLED)).astype(np.int64)]
            records = areas.records(some, record_type(config))
            each = _stored_bytes(records) / max(1, len(records)) + _BYTES_BESIDE
            beside = _FILE_BYTES + overview_bytes(self.recipe.region, config.gsd_m)
            limits.append(max(1, int((points.max_bytes - beside) / each)))
        return min(limits, default=None)

    def _head(self, plan: ScenePlan) -> Catalog:
        """The catalogue without points and coverage."""
        recipe, config = self.recipe, self.recipe.config
        sun, view = config.sun, config.view
        overview = region_overview(recipe.dems, recipe.region, config.gsd_m)
        resolved = _resolved(recipe)
        files = recipe.dems.sources()
        bright = recipe.albedo.provenance() if recipe.albedo else None
        named = [*files, *(bright["files"] if bright else [])]
        none = np.zeros(0, record_type(config))
        empty = self._values(np.zeros(0, [("lon_deg", "<f8"), ("lat_deg", "<f8")]), none)
        columns: dict[str, Any] = {
            f.name: empty[f.name] for f in dataclasses.fields(Catalog) if f.name in empty
        }
        columns |= {name: empty[name].astype(np.float32) for name in PACKED}
        return Catalog(
            **columns,  # by the schema's names, which are the fields of the model
            image_scale=np.array(config.points.scales, dtype=np.float64),
            sun_azimuth=np.array(sun.azimuths_deg),
            sun_elevation=np.array(sun.elevations_deg),
            view_off_nadir=np.array(view.off_nadir_deg),
            view_azimuth=np.array(view.azimuth_deg),
            view_altitude=np.array(view.altitude_km),
            config=resolved.to_toml(),
            history=f"build of {', '.join(str(one['name']) for one in named)} with {resolved.in_one_line()}",
            sources=files,
            albedo_map=bright,
            scene_plan=plan.to_json(),
            errors=recipe.errors.to_dict()
            | {"min_detection": config.points.min_detection}
            | _by_place(recipe),
            sigma_step_m=sigma_step_m(np.array([config.gsd_m])),
            overview=overview,
            overview_levels=overview_levels(overview),
            coverage=Coverage(np.zeros(0), np.zeros(0), np.zeros(0, np.uint8), spacing_m(config)),
        )

    def _values(self, table: AnyArray, records: AnyArray) -> dict[str, AnyArray]:
        """The variables of points, from their rows of the table and their records."""
        lon, lat, product = table["lon_deg"], table["lat_deg"], records["product"]
        columns = {
            name: np.ascontiguousarray(records[name])
            for name in records.dtype.names or ()
            if name in VARIABLES
        }
        condition, elevations = (
            columns["condition"],
            np.array(self.recipe.config.sun.elevations_deg),
        )
        lowest, highest = summarise_usable(condition, elevations)
        sigma, resolution = self._height_errors(lon, lat, product)
        names = np.array(self.recipe.dems.products, dtype=object)
        return columns | {
            "point_id": stable_id(lon, lat),
            "longitude": np.ascontiguousarray(lon),
            "latitude": np.ascontiguousarray(lat),
            "position_mcmf": lonlat_to_mcmf(lon, lat, columns["elevation"]),
            "rotation_mcmf_to_enu": enu_rotation(lon, lat),
            "gsd": np.full(len(table), self.recipe.gsd_m),
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
        DEM's own, metres; a sigma that neither knows is the one that the build assumes, a resolution NaN.
        """
        dems, maps = self.recipe.dems.dems, self.recipe.maps
        sigma = _known([dem.facts.sigma_m for dem in dems])[product]
        for number in np.unique(product[np.isnan(sigma)]).tolist():
            given = self.recipe.config.errors.height_sigma_m
            found = errors_of_file(dems[number]).sigma_m if given is None else given
            sigma[product == number] = found
        resolution = _known([dem.resolution_m for dem in dems])[product]
        if maps is None:
            return sigma, resolution
        own = maps.at(lon, lat)
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


def choose(table: AnyArray, config: BuildConfig) -> Index:
    """Rows of a table of candidates (`finished_area.TABLE`) that become points, evenly spread: those with
    the most usable conditions first, then those with the finest localisation.
    """
    places = Places(table["lon_deg"], table["lat_deg"])
    return select(places, table["worth"], table["quality"], spacing_m(config))


def spacing_m(config: BuildConfig) -> float:
    """Side of the cells in which candidates are looked for, metres."""
    return config.points.spacing_nodes(config.gsd_m) * config.gsd_m


def _known(figures: list[float | None]) -> Array:
    """Numbers as an array, NaN for None."""
    return np.array([math.nan if figure is None else figure for figure in figures])


def _by_place(recipe: Recipe) -> dict[str, Any]:
    """What `catalog.point_errors` reads: the figures that differ by place, and for which products they do not follow from
    what a point states of its DEM.
    """
    found: dict[str, dict[str, float]] = {name: {} for name in recipe.by_place}
    maps = recipe.maps or ErrorMaps()
    for dem in recipe.dems.dems if found else ():
        facts = dem.facts
        if facts.calibrated_sigma_m and "height_sigma_m" in found and maps.sigma is None:
            found["height_sigma_m"][dem.product] = facts.calibrated_sigma_m
        calibrated = facts.calibrated_length_m and maps.resolution is None
        if "height_length_m" in found and (calibrated or dem.resolution_m is None):
            length_m = errors_of_file(dem).length_m
            found["height_length_m"][dem.product] = length_m
            if "position_sigma_m" in found:
                found["position_sigma_m"][dem.product] = PLACE_PER_LENGTH * length_m
    return {"by_place": found} if found else {}


def _resolved(recipe: Recipe) -> BuildConfig:
    """The configuration with the values that were derived from the DEM, without folders."""
    config, area = recipe.config, recipe.config.area
    if not area.center_deg and not area.bounds_deg:
        area = dataclasses.replace(area, bounds_deg=tuple(recipe.region.bounds))
    search_m = config.points.search_nodes(config.gsd_m) * config.gsd_m
    located = config.points.located
    per_view = None if located else config.points.per_view or 0
    points = dataclasses.replace(
        config.points, search_m=search_m, located_probability=located, per_view=per_view
    )
    if not config.points.promised:  # else it is the side of cells alone
        points = dataclasses.replace(points, spacing_m=spacing_m(config))
    section = dataclasses.replace(config.model.portable, reflectance=recipe.law.model.name)
    figures = recipe.errors.to_dict().items()
    known = ErrorConfig(**{name: one for name, one in figures if name not in recipe.by_place})
    return dataclasses.replace(
        config, area=area, dem=config.dem.portable, points=points, model=section, errors=known
    )
