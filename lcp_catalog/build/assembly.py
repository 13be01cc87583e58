"""The catalogue from all areas' candidates: choice, summaries over conditions, coverage, overview."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array
from ..catalog.hdf5 import Catalog
from ..catalog.schema import (
    EVALUATED,
    LOCALIZABLE,
    UNIQUE,
    UNOCCLUDED,
    UNSHADOWED,
    USABLE,
    summarise_usable,
)
from ..dem.error_maps import ErrorMaps
from ..dem.mosaic import DemSet
from ..geometry.frames import enu_rotation, lonlat_to_mcmf
from ..landmarks.error_model import ErrorModel
from ..landmarks.selection import select, stable_id
from ..photometry.albedo_map import AlbedoMap
from ..photometry.laws import Reflectance
from ..rendering.plan import ScenePlan
from ..terrain.area import Area
from .area_job import AreaResult, Candidates
from .config import BuildConfig, ErrorConfig
from .evaluation import Evaluation, image_scales
from .region_maps import region_coverage, region_overview


def assemble(
    config: BuildConfig,
    dems: DemSet,
    region: Area,
    gsd_m: float,
    results: Mapping[str, AreaResult],
    model: Reflectance,
    errors: ErrorModel,
    albedo: AlbedoMap | None = None,
    maps: ErrorMaps | None = None,
) -> Catalog:
    """Choose the points among the areas' candidates (by the area's name) and fill every variable of
    the catalogue; ``model``: the reflectance model of all images; ``errors``: their error model.
    """
    everything = joined([result.candidates for result in results.values()])
    spacing_m = config.points.spacing_nodes(gsd_m) * gsd_m
    points = _rows(everything, choose(everything, config, gsd_m))
    plan = ScenePlan.merged({name: result.plan for name, result in results.items()})
    return Catalog(
        **_places(points, dems, gsd_m, maps),
        **_worth(points.evaluation, config, gsd_m),
        sun_azimuth=np.array(config.sun.azimuths_deg),
        sun_elevation=np.array(config.sun.elevations_deg),
        view_off_nadir=np.array(config.view.off_nadir_deg),
        view_azimuth=np.array(config.view.azimuth_deg),
        view_altitude=np.array(config.view.altitude_km),
        config=_resolved(config, region, gsd_m, spacing_m, model, errors).to_toml(),
        sources=dems.sources(),
        albedo_map=albedo.provenance() if albedo else None,
        scene_plan=str(plan),
        errors=errors.to_dict() | {"min_detection": config.points.min_detection},
        overview=region_overview(dems, region, gsd_m),
        coverage=region_coverage(
            dems,
            region,
            (everything.lon_deg, everything.lat_deg),
            _stages(everything.evaluation, config.points.min_usable_conditions),
            (points.lon_deg, points.lat_deg),
            points.evaluation.condition,
            spacing_m,
        ),
    )


def choose(candidates: Candidates, config: BuildConfig, gsd_m: float) -> NDArray[np.int64]:
    """Rows of the candidates that become points, evenly spread: those with the most usable conditions first,
    then those with the finest localisation.
    """
    usable = (candidates.evaluation.condition == USABLE).sum(axis=(1, 2, 3))
    usable[usable < config.points.min_usable_conditions] = 0
    spacing_m = config.points.spacing_nodes(gsd_m) * gsd_m
    return select(
        candidates.lon_deg, candidates.lat_deg, usable, _quality(candidates.evaluation), spacing_m
    )


def joined(parts: list[Any]) -> Any:
    """Concatenate dataclasses of arrays of the same type."""
    kind = type(parts[0])
    columns = {}
    for field in dataclasses.fields(kind):
        values = [getattr(part, field.name) for part in parts]
        nested = dataclasses.is_dataclass(values[0])
        columns[field.name] = (
            None if values[0] is None else joined(values) if nested else np.concatenate(values)
        )
    return kind(**columns)


def _rows(table: Any, rows: NDArray[np.int64]) -> Any:
    """The same dataclass with a selection of rows."""
    columns = {}
    for field in dataclasses.fields(table):
        value = getattr(table, field.name)
        columns[field.name] = (
            _rows(value, rows)
            if dataclasses.is_dataclass(value)
            else None
            if value is None
            else value[rows]
        )
    return type(table)(**columns)


def _quality(evaluation: Evaluation) -> Array:
    """Order of candidates with equally many usable conditions: minus the largest sigma."""
    return -np.nan_to_num(
        _over_usable(evaluation.sigma_major_m[:, 0], evaluation, np.nanmax), nan=np.inf, posinf=1e30
    )


def _over_usable(values: NDArray[Any], evaluation: Evaluation, how: Callable[..., Any]) -> Array:
    """A statistic of each candidate over its usable conditions; NaN if it has none."""
    shape = (len(values), int(np.prod(values.shape[1:])))
    masked = np.where(evaluation.condition == USABLE, values, np.nan).reshape(shape)
    some = ~np.isnan(masked).all(axis=1)
    out = np.full(len(values), np.nan)
    if some.any():
        out[some] = how(masked[some], axis=1)
    return out


def _places(
    points: Candidates, dems: DemSet, gsd_m: float, maps: ErrorMaps | None
) -> dict[str, Any]:
    rotations = [
        enu_rotation(lon, lat) for lon, lat in zip(points.lon_deg, points.lat_deg, strict=True)
    ]
    names = np.array(dems.products, dtype=object)
    sigma = _known([dem.facts.sigma_m for dem in dems.dems])[points.product]
    resolution = _known([dem.resolution_m for dem in dems.dems])[points.product]
    if maps is not None:
        own = maps.at(points.lon_deg, points.lat_deg)
        sigma, resolution = (
            np.where(np.isfinite(mapped), mapped, figure)
            for mapped, figure in zip(own, (sigma, resolution), strict=True)
        )
    return {
        "point_id": stable_id(points.lon_deg, points.lat_deg),
        "longitude": points.lon_deg,
        "latitude": points.lat_deg,
        "elevation": points.elevation_m,
        "position_mcmf": lonlat_to_mcmf(points.lon_deg, points.lat_deg, points.elevation_m),
        "rotation_mcmf_to_enu": np.array(rotations).reshape(-1, 3, 3),
        "gsd": np.full(len(points), gsd_m),
        "dem_product": names[points.product] if len(points) else np.zeros(0, dtype=object),
        "elevation_sigma": sigma,
        "dem_resolution": resolution,
        "dem": points.patch_m,
        "albedo": points.albedo,
    }


def _known(figures: list[float | None]) -> Array:
    """Numbers as an array, NaN for None."""
    return np.array([math.nan if figure is None else figure for figure in figures])


def _worth(evaluation: Evaluation, config: BuildConfig, gsd_m: float) -> dict[str, Any]:
    worst = {
        name: _over_usable(values, evaluation, np.nanmax)
        for name, values in (
            ("sigma_major_m", evaluation.sigma_major_m[:, 0]),
            ("sigma_minor_m", evaluation.sigma_minor_m[:, 0]),
            ("second_peak", evaluation.second_peak),
            ("false_match", evaluation.false_match),
        )
    }
    lowest, highest = summarise_usable(evaluation.condition, np.array(config.sun.elevations_deg))
    scales = np.array(image_scales(config.points.patch_nodes), dtype=np.float64)
    least = config.points.min_detection
    finest, coarsest = working_scales(evaluation.condition, evaluation.detection, scales, least)
    return {
        "image_scale": scales,
        "detection_probability": evaluation.detection,
        "sigma_major": evaluation.sigma_major_m,
        "sigma_minor": evaluation.sigma_minor_m,
        "sigma_angle": evaluation.sigma_angle_deg,
        "level": np.zeros(len(evaluation.condition), dtype=np.int64),
        "condition": evaluation.condition,
        "sun_elevation_min": lowest,
        "sun_elevation_max": highest,
        "harris_response": _over_usable(evaluation.harris, evaluation, np.nanmedian),
        "localization_sigma": np.stack([worst["sigma_major_m"], worst["sigma_minor_m"]], axis=-1),
        "second_peak": worst["second_peak"],
        "false_match_probability": worst["false_match"],
        "gsd_min": finest * gsd_m,
        "gsd_max": coarsest * gsd_m,
        "shadow_dependence": _over_usable(evaluation.shadow_dependence, evaluation, np.nanmax),
        "occlusion_dependence": _over_usable(
            evaluation.occlusion_dependence, evaluation, np.nanmax
        ),
    }


def working_scales(
    condition: NDArray[np.uint8], detection: NDArray[Any], scales: Array, least: float
) -> tuple[Array, Array]:
    """Finest and coarsest image scale at which each point works, (n,): at which its detection
    probability (n, scale, view, elevation, azimuth) is at least ``least`` in half or more of the
    conditions in which it is so at any scale. Only conditions without terrain that shadows or
    hides the patch count; 1 for points that work at no scale.
    """
    free = EVALUATED | UNSHADOWED | UNOCCLUDED
    detected = (detection >= least) & ((condition & free) == free)[:, None]
    some = detected.any(axis=1).sum(axis=(1, 2, 3))[:, None]
    enough = (detected.sum(axis=(2, 3, 4)) >= 0.5 * some) & (some > 0)
    finest = np.where(enough, scales, np.inf).min(axis=1, initial=np.inf)
    coarsest = np.where(enough, scales, 1.0).max(axis=1, initial=1.0)
    return np.where(np.isfinite(finest), finest, 1.0), coarsest


def _stages(evaluation: Evaluation, min_usable: int) -> NDArray[np.int64]:
    """Result for each candidate: 0 localisable in no condition, 1 not unique where localisable, 2 not
    independent where unique (or in too few conditions), 3 usable.
    """
    condition = evaluation.condition
    localizable = (condition & LOCALIZABLE) > 0
    unique = localizable & ((condition & UNIQUE) > 0)
    stages = localizable.any(axis=(1, 2, 3)).astype(np.int64) + unique.any(axis=(1, 2, 3))
    return stages + ((condition == USABLE).sum(axis=(1, 2, 3)) >= min_usable)


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
    points = dataclasses.replace(config.points, spacing_m=spacing_m, search_m=search_m)
    section = dataclasses.replace(config.model.portable, reflectance=model.name)
    known = ErrorConfig(**errors.to_dict())
    return dataclasses.replace(
        config, area=area, dem=config.dem.portable, points=points, model=section, errors=known
    )
