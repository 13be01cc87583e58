"""The recipe of a build: what is the same for all its areas of one cell size, and how it is chosen.

The files that a build reads, which must stay the same while it runs.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..atomic_files import content_of, file_facts, state_of, sum_in_state
from ..dem.error_maps import ErrorMaps, FigureMap, height_errors, warn_of_unknown
from ..dem.mosaic import DemSet
from ..errors import AreaError, AreaFailedError
from ..landmarks.error_model import ErrorModel
from ..photometry.albedo_map import AlbedoMap
from ..photometry.facet_model import law_file
from ..photometry.law_choice import LawChoice
from ..terrain.area import Area
from ..terrain.terrain import no_height
from ..terrain.useful_cell import Cell, finest_cell, resolves, useful_cell
from .config import BuildConfig
from .model_config import ModelConfig
from .sweep import law_of_build


class InputFiles:
    """Files as they were when they were opened: their state (`atomic_files.file_state`), and after
    `digest` also their content.
    """

    def __init__(self) -> None:
        self._stamps: dict[Path, tuple[int | str, ...]] = {}
        self._sums: dict[Path, str] = {}

    def add(self, paths: Iterable[Path]) -> None:
        """Note the state of files; to be called when they have just been opened."""
        self._stamps |= {path: _stamp(path) for path in paths}

    def digest(self) -> None:
        """Note the content of all files. AreaFailedError if one was changed since it was added."""
        self._sums = {path: _sum(path) for path in self._stamps}
        for path, stamp in self._stamps.items():
            if _stamp(path) != stamp:
                raise _changed(path)

    @property
    def unread_bytes(self) -> int:
        """Bytes of the files whose content is not noted and not known of their state."""
        states = [s for path, s in self._stamps.items() if path not in self._sums]
        return sum(int(s[2]) for s in states if len(s) > 2 and sum_in_state(s) is None)

    def require_unchanged(self) -> None:
        """AreaFailedError for a file whose content is another than at the start. Only files in another
        state are read again.
        """
        for path, stamp in self._stamps.items():
            now = _stamp(path)
            if now != stamp:
                if _sum(path) != (self._sums.get(path) or sum_in_state(stamp)):
                    raise _changed(path)
                self._stamps[path] = now


def _stamp(path: Path) -> tuple[int | str, ...]:
    try:
        return state_of(path)
    except OSError as error:
        raise _changed(path) from error


def _sum(path: Path) -> str:
    try:
        return content_of(file_facts([path])[0])
    except OSError as error:
        raise _changed(path) from error


def _changed(path: Path) -> AreaFailedError:
    return AreaFailedError(
        f"{path}: was changed, replaced or removed while the build ran; put it back and run again with `resume`, "
        "or build anew"
    )


log = logging.getLogger(__name__)

_FINEST = 32.0
"""Most cells along a pixel of the DEM."""

_ERROR_PLACES = 33
"""Side of the lattice of places at which a region's height errors are sampled."""


@dataclass(frozen=True)
class Recipe:
    """All that determines the content of the areas of one cell size. ``config`` states this and the Suns;
    ``law``: the reflectance model of all images; ``errors``: their error model, with medians over the region of what
    differs `by_place`. Small and picklable: maps and DEMs are read where they are used.
    """

    config: BuildConfig
    dems: DemSet
    region: Area
    law: LawChoice
    errors: ErrorModel
    albedo: AlbedoMap | None = None
    maps: ErrorMaps | None = None

    @classmethod
    def of(
        cls,
        config: BuildConfig,
        dems: DemSet,
        region: Area,
        inputs: InputFiles,
        law: LawChoice | None = None,
    ) -> Recipe:
        """The recipe of a configuration with a cell size; the files that it opens are added to the
        ``inputs``. ``law``: what `law_of_build` gives, where it is known.
        """
        file = law_file(config.model.reflectance)
        choice = law or law_of_build(config, region.lat_deg)
        inputs.add([file] if file else ())
        albedo = _albedo_map(config.model)
        if albedo:
            inputs.add(albedo.files)
            albedo.check_cover(albedo.cover_of(region, config.gsd_m), region.bounds)
        maps = ErrorMaps.open(config.dem.sigma_map, config.dem.resolution_map)
        inputs.add(maps.files if maps else ())
        return cls(
            config, dems, region, choice, _error_model(config, dems, region, maps), albedo, maps
        )

    def at_cell(self, gsd_m: float) -> Recipe:
        """The same with another cell size."""
        return replace(self, config=self.config.at_cell(gsd_m))

    @property
    def gsd_m(self) -> float:
        """Cell size of the patches, metres."""
        return self.config.gsd_m

    @cached_property
    def by_place(self) -> tuple[str, ...]:
        """Names of the figures of the error model that every place has of its own DEM or map, so that no claim follows
        the region; none where all files have the same. It follows from the files' names and the configuration alone.
        """
        own, maps = self.config.errors, self.maps or ErrorMaps()
        facts = [dem.facts for dem in self.dems.dems]
        sigma = {one.calibrated_sigma_m or one.sigma_m for one in facts}
        length = {one.calibrated_length_m for one in facts}
        names = []
        if own.height_sigma_m is None and _differ(sigma, len(facts), maps.sigma):
            names += ["height_sigma_m"]
        if own.height_length_m is None and _differ(length, len(facts), maps.resolution):
            names += ["height_length_m"]
            names += ["position_sigma_m"] if own.position_sigma_m is None else []
        return tuple(names)

    @cached_property
    def sources(self) -> tuple[int, ...]:
        """Indices of the DEMs that points come from: all, or those that resolve the cells."""
        every = range(len(self.dems.dems))
        if not self.config.dem.only_resolving:
            return tuple(every)
        return tuple(i for i in every if resolves(self.dems.dems[i], self.gsd_m))

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that areas read."""
        maps = (self.albedo, self.maps)
        return (*self.dems.files, *(path for one in maps if one for path in one.files))


def cells(config: BuildConfig, dems: DemSet, region: Area) -> list[Cell]:
    """The cells of the levels, from fine to coarse; without levels the configured cell or the finest
    useful one.

    Cells that no DEM of the region resolves are left out with a warning if they were derived from
    altitudes; AreaError for a given one, and if none is left.
    """
    area = config.area
    if area.gsd_m:
        _require_coarse(area.gsd_m, dems, region)
        return [Cell(area.gsd_m, "as configured")]
    wanted = area.derived_levels_m if area.altitudes_km else area.levels_m
    if not wanted:
        cell = useful_cell(dems, region)
        log.info("cells of %.5g m: %s; `area.gsd_m` overrules it", cell.gsd_m, cell.reason)
        return [cell]
    near = [dem for dem in dems.dems if dem.grid.bounds.meets(region.bounds)]
    if not near:
        raise no_height(dems, region)
    found = [cell_m for cell_m in wanted if any(resolves(dem, cell_m) for dem in near)]
    lost = [cell_m for cell_m in wanted if cell_m not in found]
    if lost:
        finest = min((finest_cell(dem) for dem in near), key=lambda c: c.gsd_m)
        sizes = ", ".join(f"{cell_m:.5g}" for cell_m in lost)
        text = f"{sizes} m: no DEM of the region resolves such cells; the finest are {finest.gsd_m:.5g} m, {finest.reason}"
        if area.levels_m or not found:
            raise AreaError(f"levels of {text}")
        log.warning("levels left out: %s", text)
    reason = "by altitude and pixel" if area.altitudes_km else "as configured"
    return [Cell(cell_m, reason) for cell_m in found]


def _require_coarse(cell_m: float, dems: DemSet, region: Area) -> None:
    """AreaError for cells that are much finer than every DEM of the region: interpolation alone would fill them."""
    pixels_m = [dem.gsd_m for dem in dems.dems if dem.grid.bounds.meets(region.bounds)]
    if pixels_m and cell_m * _FINEST < min(pixels_m):
        raise AreaError(
            f"`area.gsd_m` of {cell_m:g} m: the pixels of the DEM are {min(pixels_m) / cell_m:.0f} times as large "
            f"({min(pixels_m):.4g} m), and finer cells hold nothing more; leave it out, or give a finer DEM"
        )


def _albedo_map(model: ModelConfig) -> AlbedoMap | None:
    """The albedo map of a configuration; None without one."""
    path = model.albedo_file
    if path is None:
        return None
    return AlbedoMap.open(path, model.albedo_encoding, model.albedo_reference)


def _differ(figures: set[float | None], files: int, one: FigureMap | None) -> bool:
    """Whether a figure of the error model may differ between places: by a map, or between files of which it is not known
    (None) before their heights are read.
    """
    return one is not None or (files > 1 and (None in figures or len(figures) > 1))


def _error_model(
    config: BuildConfig, dems: DemSet, region: Area, maps: ErrorMaps | None
) -> ErrorModel:
    """The error model of a build: its configuration, completed by the height errors of the DEMs and
    the maps, as medians over the region (`dem.error_maps`). DemError for a map without a value in
    the region.
    """
    lon, lat = region.lattice(_ERROR_PLACES)
    if maps is not None:
        maps.check_cover(lon, lat, region.bounds)
    if config.errors.height_sigma_m is None and config.dem.sigma_map is None:
        warn_of_unknown(dems, lon, lat)
    sigma, length = height_errors(dems, lon, lat, maps)
    known = np.isfinite(sigma)
    if not known.any():
        raise no_height(dems, region)
    return config.errors.model(float(np.median(sigma[known])), float(np.median(length[known])))
