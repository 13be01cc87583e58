"""What a build keeps of an area: a table of all its candidates, and a record of each that can become
a point.

A record holds what the catalogue states of a point, in the types of its variables. Points are chosen
by the tables of all areas; only the records of the chosen are read again.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array, Bytes, Index, Mask
from ..catalog.layout import axis_direction, packing, sigma_step_m
from ..catalog.schema import (
    EVALUATED,
    FIGURES,
    LOCALIZABLE,
    PACKED,
    UNIQUE,
    UNOCCLUDED,
    UNSHADOWED,
    USABLE,
    VARIABLES,
    Cause,
)
from ..catalog.sun_cells import SunCells
from ..kernels.sun_moments import UNKNOWN
from ..landmarks.located import Units
from ..rendering.plan import ScenePlan
from .area_job import AreaResult, Candidates
from .config import BuildConfig
from .evaluation import Evaluation

TABLE = np.dtype(
    [
        ("lon_deg", "<f8"),
        ("lat_deg", "<f8"),
        ("quality", "<f8"),  # the higher, the better among equally many usable conditions
        ("worth", "<i4"),  # usable conditions (`_worth`); 0: it cannot become a point
        ("checksum", "<u4"),  # CRC-32 of the record; 0 without one
        ("stage", "u1"),  # of `landmarks.selection.coverage`
        ("information", "<f4"),  # mean of `_information`
        ("slope_sigma", "<f4"),  # 1 sigma of the slopes' errors
    ]
)
"""A candidate's row of the table."""

_WORST = -1e30
"""Quality of candidates without a usable condition."""

_LEAST_CHANCE = 1e-6
"""Detection probability that stands for 0 in a logarithm."""


@dataclass(frozen=True)
class FinishedArea:
    """A table (n,) of type `TABLE`; the records (m,) of type `record_type` of its rows that can become
    points, in the same order; and the scene plan of the area's images. ``stages`` (n, 2 cells): what
    each row is good for between the Suns (`cell_stages`); None if nothing is promised.
    """

    table: AnyArray
    records: AnyArray
    plan: ScenePlan
    stages: Bytes | None = None
    ground: bytes | None = None
    """For the steps after a first look (`kept_ground`); no checkpoint has it."""


def record_type(config: BuildConfig) -> np.dtype[np.void]:
    """Type of the records of a build: variables of the catalogue by name, and ``product``, the index
    of the DEM.
    """
    side = config.points.patch_nodes
    shape = (len(config.view), len(config.sun.elevations_deg), len(config.sun.azimuths_deg))
    scaled = (len(config.points.scales), *shape)
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("elevation", *FIGURES), ())
    shapes |= {"localization_sigma": (2,), "condition": shape, "dem": (side, side)}
    shapes |= {"albedo": (side, side)} if config.model.albedo_file else {}
    shapes |= dict.fromkeys(PACKED, scaled)
    own = [(name, f"<{VARIABLES[name].dtype}", size) for name, size in shapes.items()]
    return np.dtype([("product", "<i2"), *own])


def finished_area(
    result: AreaResult, config: BuildConfig, *, first_look: bool = False
) -> FinishedArea:
    """The table and the records of an area's candidates; of a first look, in place of the records, their sites."""
    candidates = result.candidates
    table = table_of(candidates, config)
    if first_look:
        _keep_doubtful(table, candidates.evaluation)
    some = np.flatnonzero(table["worth"])
    if first_look and candidates.sites is not None:
        records = candidates.sites[some]
    else:
        records = np.zeros(len(some), record_type(config))
        for name, values in _record_columns(candidates, config).items():
            records[name] = values[some]
    table["checksum"][some] = checksums(records)
    stages = cell_stages(candidates, config) if config.points.promised else None
    return FinishedArea(table, records, result.plan, stages, result.ground)


def table_of(candidates: Candidates, config: BuildConfig) -> AnyArray:
    """The table (n,) of candidates, of type `TABLE`, without checksums."""
    evaluation, least = candidates.evaluation, config.points.min_usable_conditions
    worth, these = _worth(evaluation, config), counted(evaluation, config)
    table = np.zeros(len(candidates), TABLE)
    table["lon_deg"], table["lat_deg"] = candidates.lon_deg, candidates.lat_deg
    table["quality"] = _quality(evaluation, these)
    table["worth"] = np.where(worth >= least, worth, 0)
    table["stage"] = _stages(evaluation, worth >= least)
    table["slope_sigma"] = 0.0 if candidates.slope_sigma is None else candidates.slope_sigma
    table["information"] = np.nan_to_num(_over(_information(evaluation), these, np.nanmean))
    return table


def _keep_doubtful(table: AnyArray, evaluation: Evaluation) -> None:
    """Let candidates that a first look found usable nowhere come last, the likeliest first: they may be so elsewhere."""
    none = table["worth"] == 0
    best = np.nan_to_num(evaluation.detection[none, 0]).max(axis=(1, 2, 3), initial=0.0)
    table["worth"][none], table["quality"][none] = 1, _WORST * (2.0 - best)


def _worth(evaluation: Evaluation, config: BuildConfig) -> Index:
    """Usable conditions of each candidate, (n,); where a probability of being located is promised, as many as
    all its conditions together are worth, rounded up.
    """
    if config.points.located is None:
        return np.asarray((evaluation.condition == USABLE).sum(axis=(1, 2, 3)))
    least = units_of(config).least
    units = np.searchsorted(least, free_detection(evaluation), "right")
    return np.asarray(-(-units.sum(axis=(1, 2, 3)) // len(least)))


def counted(evaluation: Evaluation, config: BuildConfig) -> Mask:
    """The conditions over which a candidate's figures are taken, (n, v, e, a): the usable ones; of a candidate
    without any, those in which it is worth something.
    """
    usable = evaluation.condition == USABLE
    if config.points.located is None:
        return np.asarray(usable)
    some = _free(evaluation) & (_detection(evaluation) >= units_of(config).least[0])
    none = ~usable.any(axis=(1, 2, 3), keepdims=True)
    return np.asarray(usable | (none & some))


def free_detection(evaluation: Evaluation) -> Array:
    """Detection probabilities at the patch's own scale, (n, v, e, a), as they are stored; 0 where there is none, or where terrain
    shadows or hides the patch.
    """
    return np.where(_free(evaluation), _detection(evaluation), 0.0)


def _free(evaluation: Evaluation) -> Mask:
    """Conditions without terrain that shadows or hides the patch."""
    free = EVALUATED | UNSHADOWED | UNOCCLUDED
    return np.asarray((evaluation.condition & free) == free)


def _detection(evaluation: Evaluation) -> Array:
    """Detection probabilities at the patch's own scale, (n, v, e, a), as they are stored; 0 where there is none."""
    stored = packing("detection_probability", 1.0)
    values = stored.unpacked(stored.packed(evaluation.detection[:, 0]))
    return np.asarray(np.nan_to_num(values), np.float64)


def checksums(records: AnyArray) -> NDArray[np.uint32]:
    """CRC-32 of each record, (n,)."""
    each = records.itemsize
    content = np.ascontiguousarray(records).view(np.uint8).data
    starts = range(0, len(content), each)
    return np.array([zlib.crc32(content[k : k + each]) for k in starts], np.uint32)


def _quality(evaluation: Evaluation, these: Mask) -> Array:
    """Order of candidates with equally many usable conditions: minus the largest sigma."""
    largest = _over(evaluation.sigma_major_m[:, 0], these, np.nanmax)
    return -np.nan_to_num(largest, nan=np.inf, posinf=-_WORST)


def _information(evaluation: Evaluation) -> Array:
    """Logarithm of the determinant of the information on the position east and north that a search
    gives: the inverse covariance of the match times the detection probability; 0 where unknown.
    """
    chance = np.maximum(evaluation.detection[:, 0], _LEAST_CHANCE)
    area = evaluation.sigma_major_m[:, 0] * evaluation.sigma_minor_m[:, 0]
    known = np.isfinite(area) & (area > 0.0)
    return 2.0 * np.log(chance / np.where(known, area, chance))


def _stages(evaluation: Evaluation, enough: NDArray[np.bool_]) -> Index:
    """Result for each candidate: 0 localisable in no condition, 1 not unique where localisable, 2 not
    independent where unique (or in too few conditions), 3 usable.
    """
    condition = evaluation.condition
    localizable = (condition & LOCALIZABLE) > 0
    unique = localizable & ((condition & UNIQUE) > 0)
    stages = localizable.any(axis=(1, 2, 3)).astype(np.int64) + unique.any(axis=(1, 2, 3))
    return stages + enough


def _record_columns(candidates: Candidates, config: BuildConfig) -> dict[str, Any]:
    evaluation, gsd_m = candidates.evaluation, config.gsd_m
    these = counted(evaluation, config)
    axes = [
        _over(sigma[:, 0], these, np.nanmax)
        for sigma in (evaluation.sigma_major_m, evaluation.sigma_minor_m)
    ]
    scales = np.array(config.points.scales, dtype=np.float64)
    least = config.points.min_detection
    finest, coarsest = working_scales(evaluation.condition, evaluation.detection, scales, least)
    columns = {
        "product": candidates.product,
        "elevation": candidates.elevation_m,
        "dem": candidates.patch_m,
        "condition": evaluation.condition,
        "harris_response": _over(evaluation.harris, these, np.nanmedian),
        "localization_sigma": np.stack(axes, axis=-1),
        "gsd_min": finest * gsd_m,
        "gsd_max": coarsest * gsd_m,
        **_claims(evaluation, gsd_m),
    }
    columns |= {} if candidates.albedo is None else {"albedo": candidates.albedo}
    worst = {
        "second_peak": evaluation.second_peak,
        "false_match_probability": evaluation.false_match,
        "shadow_dependence": evaluation.shadow_dependence,
        "occlusion_dependence": evaluation.occlusion_dependence,
    }
    return columns | {name: _over(values, these, np.nanmax) for name, values in worst.items()}


def _claims(evaluation: Evaluation, gsd_m: float) -> dict[str, AnyArray]:
    """The packed claims."""
    claims: dict[str, AnyArray] = {
        "detection_probability": evaluation.detection,
        "sigma_major": evaluation.sigma_major_m,
        "sigma_minor": evaluation.sigma_minor_m,
        "sigma_angle": axis_direction(evaluation.sigma_angle_deg),
    }
    step_m = sigma_step_m(np.array([gsd_m]))
    return {name: packing(name, step_m).packed(values) for name, values in claims.items()}


def _over(values: NDArray[Any], these: Mask, how: Callable[..., Any]) -> Array:
    """A statistic of each candidate over the conditions that count (n, v, e, a); NaN if it has none."""
    shape = (len(values), int(np.prod(values.shape[1:])))
    masked = np.where(these, values, np.nan).reshape(shape)
    some = ~np.isnan(masked).all(axis=1)
    out = np.full(len(values), np.nan)
    if some.any():
        out[some] = how(masked[some], axis=1)
    return out


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


def units_of(config: BuildConfig) -> Units:
    """What a point of a build with a promise is worth, and how much is promised."""
    points = config.points
    if points.located is None:
        return Units.of_usable(points.per_view or 0, points.min_detection, config.gsd_m)
    return Units.of_located(points.located, config.gsd_m)


def cell_stages(candidates: Candidates, config: BuildConfig) -> Bytes:
    """What each candidate is good for, (n, 2 view elevation azimuth): by view and cell of the Sun grid a `Cause`, FEW if it is
    usable under all Suns of the cell, MARGINAL if only at the corners that were evaluated, else what stops it at the worst
    corner, MET (0) where there is no cell; and by view and Sun its detection probability in steps of `DETECTION_STEP`, 0 where
    it cannot be a point, `UNKNOWN` where not evaluated.
    """
    condition = candidates.evaluation.condition
    if not len(condition):
        return np.zeros((0, 2 * int(np.prod(condition.shape[1:]))), np.uint8)
    known: Mask = np.any((condition & EVALUATED) > 0, axis=(0, 1))
    grid = SunCells.of(config.sun.elevations_deg, config.sun.azimuths_deg)
    claims = grid.claims(float(np.mean(candidates.lat_deg)), known, config.points.min_detection)
    chances = np.nan_to_num(candidates.evaluation.detection[:, 0])
    detection = packing("detection_probability", 1.0).packed(chances)
    stage, free = _causes(candidates), _free(candidates.evaluation)
    found = np.full(condition.shape, Cause.FEW, np.uint8)
    enough = np.ones(condition.shape, np.bool_)
    for counts, row, column in zip(claims.counts, *grid.corners(), strict=True):
        at = np.s_[:, :, row, column]
        np.minimum(found, np.where(counts, stage[at], np.uint8(Cause.FEW)), out=found)
        enough &= ~counts | (detection[at] >= claims.least)
    found[(found == Cause.FEW) & ~enough] = Cause.MARGINAL
    if config.points.located is None:
        free &= stage >= Cause.AMBIGUOUS
    codes = np.where(known, np.where(free, detection, 0), UNKNOWN)
    both = np.where(claims.exists, found, 0), codes
    return np.concatenate([part.reshape(len(condition), -1) for part in both], axis=1).astype(
        np.uint8
    )


def _causes(candidates: Candidates) -> Bytes:
    """What stops each candidate in each condition, FEW where it is usable, (n, v, e, a)."""
    evaluation = candidates.evaluation
    condition = evaluation.condition
    free = UNSHADOWED | UNOCCLUDED
    return np.select(
        [
            ~np.isfinite(evaluation.sigma_major_m[:, 0]),
            (condition & LOCALIZABLE) == 0,
            (condition & UNIQUE) == 0,
            (condition & free) != free,
        ],
        [Cause.DARK, Cause.FEATURELESS, Cause.AMBIGUOUS, Cause.DEPENDENT],
        Cause.FEW,
    ).astype(np.uint8)
