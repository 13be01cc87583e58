"""Differences of two results of one area: decisions, detection probability and sigma, of candidates at
the same places.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

RADIUS_M = 1_737_400.0
FLAGS = ("evaluated", "localizable", "unique", "unshadowed", "unoccluded")
ALL = 2 ** len(FLAGS) - 1


@dataclass(frozen=True)
class Differences:
    """Candidates paired and alone in either result; of the paired ones in every condition: shares
    (0..1) of which any flag, the usable decision, and each flag differs; largest and mean absolute
    difference of the detection probability; largest and mean relative difference of sigma_major where
    both are finite, and the share of which only one is.
    """

    paired: int
    alone: tuple[int, int]
    evaluated: int
    any_flag: float
    usable: float
    flags: tuple[float, ...]
    detection: tuple[float, float]
    sigma: tuple[float, float]
    sigma_lost: float


@dataclass(frozen=True)
class Places:
    """Candidates that only have places and an evaluation."""

    lon_deg: np.ndarray
    lat_deg: np.ndarray
    evaluation: Any

    def __len__(self) -> int:
        return len(self.lon_deg)


def pairs(first: Any, second: Any, within_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of candidates of two results that lie at the same place."""
    if not len(first) or not len(second):
        return np.zeros(0, int), np.zeros(0, int)
    places = []
    for found in (first, second):
        lon, lat = np.radians(found.lon_deg), np.radians(found.lat_deg)
        unit = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
        places.append(RADIUS_M * np.stack(unit, axis=-1))
    away = np.linalg.norm(places[0][:, None] - places[1][None], axis=-1)
    nearest = away.argmin(axis=1)
    rows = np.flatnonzero(away[np.arange(len(nearest)), nearest] < within_m)
    return rows, nearest[rows]


def differences(first: Any, second: Any, cell_m: float) -> Differences:
    """Of the candidates of two results (`production.area_job.Candidates`)."""
    one, two = pairs(first, second, 0.5 * cell_m)
    a, b = first.evaluation, second.evaluation
    flags = [found.condition[rows] for found, rows in ((a, one), (b, two))]
    either = (flags[0] | flags[1]) & 1 > 0
    changed = (flags[0] ^ flags[1])[either]
    usable = [(f == ALL)[either] for f in flags]
    return Differences(
        paired=len(one),
        alone=(len(first) - len(one), len(second) - len(one)),
        evaluated=int(either.sum()),
        any_flag=share(changed > 0),
        usable=share(usable[0] != usable[1]),
        flags=tuple(share(changed >> bit & 1 > 0) for bit in range(len(FLAGS))),
        detection=_largest_and_mean(a.detection[one], b.detection[two]),
        sigma=_largest_and_mean(a.sigma_major_m[one], b.sigma_major_m[two], relative=True),
        sigma_lost=_lost(a.sigma_major_m[one], b.sigma_major_m[two]),
    )


def share(mask: np.ndarray) -> float:
    """Share of True, 0 of nothing."""
    return float(mask.mean()) if mask.size else 0.0


def _largest_and_mean(a: np.ndarray, b: np.ndarray, relative: bool = False) -> tuple[float, float]:
    both = np.isfinite(a) & np.isfinite(b)
    if not both.any():
        return 0.0, 0.0
    a, b = a[both].astype(np.float64), b[both].astype(np.float64)
    apart = np.abs(b - a) / (np.maximum(np.abs(a), 1e-9) if relative else 1.0)
    return float(apart.max()), float(apart.mean())


def _lost(a: np.ndarray, b: np.ndarray) -> float:
    known = ~np.isnan(a) | ~np.isnan(b)
    return share((np.isfinite(a) != np.isfinite(b))[known])
