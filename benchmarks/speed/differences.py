"""Differences of the decisions of two results of one area, of candidates at the same places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lcp_catalog.catalog.schema import USABLE
from lcp_catalog.constants import MOON_RADIUS_M


@dataclass(frozen=True)
class Differences:
    """Candidates paired and alone in either result; of the paired ones, how many conditions are evaluated, and the share
    (0..1) of these in which the usable decision differs.
    """

    paired: int
    alone: tuple[int, int]
    evaluated: int
    usable: float


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
        places.append(MOON_RADIUS_M * np.stack(unit, axis=-1))
    away = np.linalg.norm(places[0][:, None] - places[1][None], axis=-1)
    nearest = away.argmin(axis=1)
    rows = np.flatnonzero(away[np.arange(len(nearest)), nearest] < within_m)
    return rows, nearest[rows]


def differences(first: Any, second: Any, cell_m: float) -> Differences:
    """Of the candidates of two results (`production.area_job.Candidates`)."""
    one, two = pairs(first, second, 0.5 * cell_m)
    flags = [of.evaluation.condition[rows] for of, rows in ((first, one), (second, two))]
    either = (flags[0] | flags[1]) & 1 > 0
    usable = [(f == USABLE)[either] for f in flags]
    alone = len(first) - len(one), len(second) - len(one)
    return Differences(len(one), alone, int(either.sum()), share(usable[0] != usable[1]))


def share(mask: np.ndarray) -> float:
    """Share of True, 0 of nothing."""
    return float(mask.mean()) if mask.size else 0.0
