"""Rows of the table of all approximations: what an alternative gives beside the user's configuration on the same ground."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array, Mask
from ..catalog.prediction import FREE_SHARE, VIEW_REACH_DEG
from ..catalog.promise import kept_promise
from ..catalog.schema import UNOCCLUDED, UNSHADOWED, evaluated
from ..catalog.stored import StoredFile, stored_catalog
from ..geometry.bounds import wrapped_deg
from ..geometry.frames import direction_enu
from ..landmarks.selection import Places, nearest
from ..production.area_job import Candidates
from ..production.config import BuildConfig
from ..production.estimate import file_bytes
from ..production.run import BuildRun, Level
from .knobs import Measurement, Outcome, Row, Sample, Setting, default_jobs, ratio_interval
from .point_changes import sigma_m, some_of, usable_shares

NEAR_CELLS = 2.0
"""Cells within which two candidates are the same place: those of a point's own peak."""


def _along(wanted: Sequence[float], given: Sequence[float], turn: float | None) -> Array:
    """Weights (wanted, given), linear between neighbours; rows of zeros outside. ``turn``: the period."""
    weights = np.zeros((len(wanted), len(given)))
    for k, value in enumerate(wanted):
        away = np.asarray(given) - value
        away = wrapped_deg(away) if turn else away
        if (near := np.abs(away) < 1e-6).any():
            weights[k, np.argmax(near)] = 1.0
            continue
        below, above = (np.where(side, np.abs(away), np.inf) for side in (away < 0, away > 0))
        low, high = int(np.argmin(below)), int(np.argmin(above))
        step = below[low] + above[high]
        if math.isfinite(step):
            weights[k, low], weights[k, high] = above[high] / step, below[low] / step
    return weights


def _of_views(wanted: Any, given: Any) -> Array:
    """Weights (wanted, given): the nearest view within reach."""
    pairs = [
        direction_enu(np.array(v.azimuth_deg), 90.0 - np.array(v.off_nadir_deg))
        for v in (wanted, given)
    ]
    cosine = np.clip(pairs[0] @ pairs[1].T, -1.0, 1.0)
    near = np.eye(len(given))[np.argmax(cosine, axis=1)]
    reached = np.degrees(np.arccos(cosine.max(axis=1))) <= VIEW_REACH_DEG
    return np.asarray(near * reached[:, None])


@dataclass(frozen=True)
class _Claims:
    """Claims (n, scale, view, elevation, azimuth): whether there is one, its probability, and whether it is usable."""

    known: Mask
    detection: Array
    usable: Mask

    @classmethod
    def at(
        cls, candidates: Candidates, own: BuildConfig, wanted: BuildConfig, scales: int
    ) -> _Claims:
        """The claims of candidates under a configuration at the views and Suns of another, and at so many image scales."""
        weights = (
            _of_views(wanted.view, own.view),
            _along(wanted.sun.elevations_deg, own.sun.elevations_deg, None),
            _along(wanted.sun.azimuths_deg, own.sun.azimuths_deg, 360.0),
        )

        def mean(values: Array) -> Array:
            for axis, weight in enumerate(weights, start=2):
                values = np.moveaxis(np.tensordot(values, weight, (axis, 1)), -1, axis)
            return values

        condition = candidates.evaluation.condition[:, None]
        chance = candidates.evaluation.detection[:, :scales].astype(np.float64)
        none = scales - chance.shape[1]
        chance = np.pad(chance, [(0, 0), (0, none), *[(0, 0)] * 3], constant_values=np.nan)
        stated = evaluated(condition) & np.isfinite(chance)
        weight = mean(stated.astype(np.float64))
        free = UNSHADOWED | UNOCCLUDED
        clear = mean((stated & ((condition & free) == free)).astype(np.float64))
        known = weight >= 0.5
        with np.errstate(invalid="ignore", divide="ignore"):
            detection = mean(np.where(stated, chance, 0.0)) / weight
            usable = (
                known
                & (detection >= own.points.min_detection - 1e-9)
                & (clear >= FREE_SHARE * weight - 1e-9)
            )
        return cls(known, np.where(known, detection, np.nan), usable)


def _wanted(usual: BuildConfig, other: BuildConfig) -> BuildConfig:
    """The configuration with the finer grid of views and Suns."""
    more = len(other.view) * len(other.sun.azimuths_deg) * len(other.sun.elevations_deg)
    return (
        other
        if more > len(usual.view) * len(usual.sun.azimuths_deg) * len(usual.sun.elevations_deg)
        else usual
    )


def _worth(outcome: Outcome, areas: int) -> Array:
    """What the points of each area of a sample are worth: the sum of the usable shares of their conditions."""
    rows = outcome.chosen
    shares = usable_shares(outcome.candidates, rows)
    return np.bincount(outcome.area[rows], shares, areas).astype(np.float64)


def unseen_share(count: int) -> float:
    """The greatest share of which none is seen among ``count`` in 1 case of 20 (Clopper and Pearson 1934, *Biometrika* 26, the
    limit of no event); 1 for none.
    """
    return 1.0 - 0.05 ** (1.0 / count) if count else 1.0


def worth_interval(by_area: Array, points: int) -> list[float] | None:
    """The 90 % interval of what the points of an alternative are worth over those of the configuration, ``points``, of the worth
    of both in each area (n, 2); None for one area. It is that of a ratio (`ratio_interval`), at least as wide as a change of
    one point in a share of the areas that no area of n shows (`unseen_share`): few areas of those that change are as a rule none
    (about 3 of all points).
    """
    around = ratio_interval(by_area)
    if around is None:
        return None
    count, (found, usual) = len(by_area), by_area.sum(axis=0)
    unseen = unseen_share(count) * count / points
    ratio = float(found / usual)
    return [min(around[0], max(0.0, ratio - unseen)), max(around[1], ratio + unseen)]


def unseen_areas(count: int, of: int) -> int:
    """The greatest number of ``of`` areas that change where none of ``count`` of them does in 1 case of 20 (hypergeometric)."""
    changed, chance = 0, 1.0
    while (chance := chance * (of - count - changed) / (of - changed)) > 0.05:
        changed += 1
    return changed


UNSEEN_CHANGE, MOST_TIMES = 0.1, 12.0
"""Share of the conditions of an area like none seen that change: stated, not known; and how many times the share seen its scatter
may give, at most: two areas of which one changes a little tell no more. Of four rules (the unseen added; the greater of both; an
area added to those seen; by how many change) and shares of 0.02 to 0.2 the narrowest that holds in 0.86 of draws or more of each
of 21 simulated populations, from 2 to 32 areas; how far it does of others: docs/measurements/tiers-on-a-scene.md."""


def changed_interval(by_area: Array, left: int, others: bool = False) -> list[float] | None:
    """The 90 % interval of the share of all judged conditions that change, of the changed and the judged ones of each area
    (n, 2) and the number of areas that were not measured; ``others``: of that of as many other areas of such ground; None for
    one area and for none.

    Below it is `ratio_interval`, above that by the logarithm: few areas have many of the changes, so that groups of areas
    without them state too little. Nor does it end below the share with that of areas like none seen, as many as may be unseen
    (`unseen_areas`), each with `UNSEEN_CHANGE`: one rule for none that changes, one, or all.
    """
    count = len(by_area)
    around = ratio_interval(by_area, math.sqrt(2.0 if others else left / max(1, count + left)))
    if around is None:
        return None
    share = float(np.divide(*by_area.sum(axis=0)))
    among = 2 * count if others else count + left
    most = share + UNSEEN_CHANGE * unseen_areas(count, among) / (count if others else among)
    scattered = share * min(MOST_TIMES, math.exp(around[1] / (share or 1.0) - 1.0))
    return [around[0], min(1.0, max(most, scattered))]


def row_of(setting: Setting, usual: Outcome, found: Outcome) -> Row:
    """A row of the table: a setting beside the user's configuration, on the areas on which it was computed."""
    sample, areas_of = found.sample, len(usual.sample.jobs)
    usual = usual.on(sample)
    areas = len(sample.jobs)
    left = len(sample.level.jobs) - areas
    before, after = usual.candidates, found.candidates
    config, own = usual.level.recipe.config, found.level.recipe.config
    near_m = NEAR_CELLS * config.gsd_m
    at, away_m = nearest(
        Places(before.lon_deg, before.lat_deg), Places(after.lon_deg, after.lat_deg)
    )
    here = np.flatnonzero(away_m <= near_m)
    there = at[here]
    wanted = _wanted(config, own)
    # without the scales of coarser pixels a build makes no claim for them; of other patches only the cells' own is compared
    fewer = own.points.image_scales != config.points.image_scales
    scales = len(config.points.scales) if fewer else 1
    old, new = (
        _Claims.at(some_of(some, rows), of, wanted, scales)
        for some, rows, of in ((before, here, config), (after, there, own))
    )
    # Suns of a finer grid that never occur are not judged
    judged = old.known & new.known if wanted is not config else old.known
    changed = (old.usable != new.usable) & judged
    by_area = np.array(
        [
            (changed[group].sum(), judged[group].sum())
            for k in range(areas)
            if judged[group := usual.area[here] == k].any()
        ],
        np.float64,
    )
    share = float(changed.sum() / judged.sum()) if judged.any() else None
    itself = [0.0, 0.0] if len(by_area) > 1 else None
    shift = np.abs(old.detection - new.detection)
    shift = shift[np.isfinite(shift)]
    sigma = [
        sigma_m(some, of)[rows] for some, of, rows in ((before, config, here), (after, own, there))
    ]
    both = (sigma[0] > 0.0) & (sigma[1] > 0.0) & np.isfinite(sigma[0]) & np.isfinite(sigma[1])
    chosen = [
        Places(one.candidates.lon_deg[one.chosen], one.candidates.lat_deg[one.chosen])
        for one in (usual, found)
    ]
    worth = np.stack([_worth(one, areas) for one in (found, usual)], axis=1)
    # of some areas alone: two passes evaluate what a promise takes of the region, and areas of another size have other borders,
    # where no point of a neighbour is near
    alike = own.points.passes == config.points.passes or not own.points.promised
    same = sample.same_areas(found.level) or areas == len(sample.level.jobs)
    told = worth[:, 1].sum() > 0.0 and alike and same and areas == areas_of
    lost, gained = (int((nearest(a, b)[1] > near_m).sum()) for a, b in (chosen, chosen[::-1]))
    areas_s, around_s = found.areas_s()
    start_s = sample.start_s(found.level)
    return {
        "knob": setting.knob,
        "value": setting.value,
        "configured": setting.configured,
        "default": setting.knob == "",
        "accuracy": own.model.precision.tier,
        "seconds": found.cpu_s,
        "seconds_relative": areas_s / usual.areas_s()[0],
        "seconds_interval": None,
        "build_jobs": default_jobs(found.level),
        "build_start_seconds": start_s,
        "build_seconds": areas_s + start_s,
        "build_interval": around_s and [one + start_s for one in around_s],
        "memory_mb": found.peak_mb,
        "bytes": file_bytes(found.level, len(chosen[1].lon_deg) / sample.share),
        # with light by way of other ground a node in shadow is not black
        "sunlit_error_share": found.images.sunlit_error_share
        if found.images and own.model.bounce == config.model.bounce
        else None,
        "radiance_rmse": found.images.radiance_rmse if found.images else None,
        "points": len(chosen[1].lon_deg),
        "points_lost": lost,
        "points_gained": gained,
        "matched_share": len(here) / max(1, len(before)),
        "usable_ratio": float(worth[:, 0].sum() / worth[:, 1].sum()) if told else None,
        "usable_interval": worth_interval(worth, len(usual.chosen)) if told else None,
        "conditions_changed_share": share,
        "interval": changed_interval(by_area, left) if setting.knob else itself,
        "elsewhere": changed_interval(by_area, left, True) if setting.knob else itself,
        "detection_change_mean": float(shift.mean()) if len(shift) else None,
        "detection_change_max": float(shift.max()) if len(shift) else None,
        "sigma_ratio": float(np.median(sigma[1][both] / sigma[0][both])) if both.any() else None,
        "shift_cells": found.shift_px,
        "promise_change": None,
        "areas": areas,
        "areas_of": areas_of,
    }


def rows_of(
    measured: Measurement, usual: Outcome, wanted: Sequence[Setting], whole: Written | None
) -> Iterator[tuple[Setting, Row | str]]:
    """The rows of settings, or why they were not measured. ``whole``: the file of the usual catalogue, if the sample is the
    whole build; each catalogue is then written for its promise and its size.
    """
    for setting, found in measured.outcomes(wanted):
        if isinstance(found, str):
            yield setting, found
            continue
        row = row_of(setting, usual, found)
        if whole and setting.knob:
            row |= Written.of(found.level, measured.sample).beside(whole)
        yield setting, row


@dataclass(frozen=True)
class Written:
    """The file of a whole build: the share of its promise that it keeps, None without a promise, and its size."""

    kept_share: float | None
    bytes: int

    @classmethod
    def of(cls, level: Level, sample: Sample) -> Written:
        """Build a level and write it to a temporary file."""
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder, "c.h5")
            build = dataclasses.replace(sample.build, levels=(level,))
            BuildRun(build, output, jobs=2, advises=False).whole()
            kept = kept_promise(stored_catalog(StoredFile.of(output)))
            share = float(kept["kept_share"]) if kept else None
            return cls(share, output.stat().st_size)

    def beside(self, usual: Written) -> Row:
        """What a row says of it beside the usual one."""
        mine, theirs = self.kept_share, usual.kept_share
        change = None if mine is None or theirs is None else mine - theirs
        return {"promise_change": change, "bytes": self.bytes}
