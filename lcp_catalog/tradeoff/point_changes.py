"""Changes of the chosen points between tiers: lost, gained and moved points, conditions, and sigma."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import AnyArray, Array, Index
from ..catalog.schema import evaluated, usable
from ..landmarks.selection import Places, nearest, stable_id
from ..production.area_job import Candidates
from ..production.assembly import choose, spacing_m
from ..production.config import BuildConfig
from ..production.finished_area import counted, table_of

DETECTION_CHANGE = 0.05
"""Change of a detection probability from which it is counted."""


@dataclass(frozen=True)
class Change:
    """Change of a figure of the common points: median and 95th percentile of the absolute
    difference; None without points.
    """

    median: float | None
    p95: float | None

    @classmethod
    def of(cls, differences: AnyArray) -> Change:
        if not len(differences):
            return cls(None, None)
        low, high = np.percentile(np.abs(differences), [50.0, 95.0])
        return cls(float(low), float(high))


@dataclass(frozen=True)
class PointChanges:
    """Differences between the points chosen from two sets of candidates; a share of nothing is
    None.
    """

    points: int
    points_lost: int
    points_gained: int
    points_moved: int
    conditions_changed_share: float | None
    detection_changed_share: float | None
    detection_change_max: float | None
    localization_sigma_change_m: Change
    localization_sigma_change_share: Change


def compare_points(reference: Candidates, tier: Candidates, config: BuildConfig) -> PointChanges:
    """Compare the points that `assembly.choose` takes from either set, matched by their
    identifiers.

    Lost: only in the reference's catalogue; gained: only in the tier's; moved: lost points with a
    gained one within half the spacing. Conditions: those evaluated for candidates in both sets; of their
    detection probabilities at all image scales the share that changes by more than `DETECTION_CHANGE`, and
    the greatest change.
    Sigma: the catalogue's ``localization_sigma``, major axis, of common points.
    """
    ids = {"ours": _ids(tier), "exact": _ids(reference)}
    ours, exact = (choose(table_of(c, config), config) for c in (tier, reference))
    lost = exact[~np.isin(ids["exact"][exact], ids["ours"][ours])]
    gained = ours[~np.isin(ids["ours"][ours], ids["exact"][exact])]
    near_m = spacing_m(config) / 2.0
    _, away_m = nearest(
        Places(reference.lon_deg[lost], reference.lat_deg[lost]),
        Places(tier.lon_deg[gained], tier.lat_deg[gained]),
    )
    _, here, there = np.intersect1d(ids["ours"], ids["exact"], return_indices=True)
    both = np.isin(here, ours) & np.isin(there, exact)
    before = sigma_m(reference, config)[there[both]]
    change = sigma_m(tier, config)[here[both]] - before
    claimed = _detection_changes(reference, there, tier, here)
    return PointChanges(
        points=len(ours),
        points_lost=len(lost),
        points_gained=len(gained),
        points_moved=int((away_m <= near_m).sum()),
        conditions_changed_share=_changed(reference, there, tier, here),
        detection_changed_share=float((claimed > DETECTION_CHANGE).mean())
        if len(claimed)
        else None,
        detection_change_max=float(claimed.max()) if len(claimed) else None,
        localization_sigma_change_m=Change.of(change),
        localization_sigma_change_share=Change.of(change / before),
    )


def joined(parts: Sequence[Any]) -> Any:
    """Concatenate dataclasses of arrays of the same type."""
    columns: dict[str, Any] = {}
    for field in dataclasses.fields(parts[0]):
        values = [getattr(part, field.name) for part in parts]
        nested = dataclasses.is_dataclass(values[0])
        columns[field.name] = (
            None if values[0] is None else joined(values) if nested else np.concatenate(values)
        )
    return dataclasses.replace(parts[0], **columns)


def some_of(candidates: Any, rows: Index) -> Any:
    """A selection of candidates, and of the results in them."""
    parts = {f.name: getattr(candidates, f.name) for f in dataclasses.fields(candidates)}
    return dataclasses.replace(
        candidates,
        **{
            name: None
            if v is None
            else some_of(v, rows)
            if dataclasses.is_dataclass(v)
            else v[rows]
            for name, v in parts.items()
        },
    )


def _ids(candidates: Candidates) -> NDArray[np.int64]:
    return stable_id(candidates.lon_deg, candidates.lat_deg)


def sigma_m(candidates: Candidates, config: BuildConfig) -> AnyArray:
    """Largest major axis over the conditions that count, as in the catalogue; -inf without any."""
    evaluation = candidates.evaluation
    works = counted(evaluation, config)
    found = np.where(works, evaluation.sigma_major_m[:, 0], -np.inf)
    return np.asarray(found.max(axis=(1, 2, 3), initial=-np.inf))


def _detection_changes(
    reference: Candidates, there: NDArray[np.int64], tier: Candidates, here: NDArray[np.int64]
) -> AnyArray:
    """Absolute changes of the detection probabilities that are stated in both."""
    exact, ours = reference.evaluation.detection[there], tier.evaluation.detection[here]
    change = np.abs(ours.astype(np.float64) - exact)
    return change[np.isfinite(change)]


def _changed(
    reference: Candidates, there: NDArray[np.int64], tier: Candidates, here: NDArray[np.int64]
) -> float | None:
    """Share of the conditions evaluated in both that are usable in one only; None without any."""
    exact, ours = reference.evaluation.condition[there], tier.evaluation.condition[here]
    judged = evaluated(exact) & evaluated(ours)
    if not judged.any():
        return None
    return float((usable(exact) != usable(ours))[judged].mean())


def usable_shares(some: Candidates, rows: Index) -> Array:
    """Of each point the usable share of its evaluated conditions."""
    condition = some.evaluation.condition[rows]
    axes = tuple(range(1, condition.ndim))
    known = np.maximum(evaluated(condition).sum(axis=axes), 1)
    return np.asarray(usable(condition).sum(axis=axes) / known)
