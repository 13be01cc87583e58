"""How probably frames of the promised footprint will be located, by the Sun's elevation, from the candidates of a few areas:
by points (`landmarks.located`) and with the ground as a whole (`landmarks.ground_votes`).

A footprint holds as many whole patches of each claim as its area without a border of half a diagonal says, and each has the
claims of the evaluated Sun. They overlap as if they were strewn at random: n patches of the width w on the ground A count as
n / (1 + n w^2 / A).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, Mask
from ..catalog.schema import DETECTION_STEP
from ..landmarks.ground_votes import FEWEST, MOST_POINTS, VoteTable, offsets_of
from ..landmarks.located import WEIGHTS, chance_of, reach_of
from .config import BuildConfig


@dataclass(frozen=True, eq=False)
class SampledPoints:
    """Candidates of one area that could become points."""

    detection: Array  # (n, v, e, a) as stored, 0 where terrain shadows or hides the patch
    occurs: Mask  # (v, e, a)
    share: float  # points in the whole build for each of them


def planned_frames(
    samples: Sequence[SampledPoints], ground_m2: float, footprint_m: float, config: BuildConfig
) -> list[dict[str, float]]:
    """By ``sun_elevation``, degrees, the mean over views and azimuths that occur of the probability that a frame is located,
    ``by_points`` and ``with_ground``; ``ground_m2``: of all samples' areas.
    """
    whole_m = footprint_m - config.points.diagonal_m(config.gsd_m)
    area_m2 = math.pi / 4.0 * max(whole_m, config.gsd_m) ** 2
    parts = [one.share * area_m2 / ground_m2 * _counts(one.detection) for one in samples]
    numbers = np.sum(parts, axis=0)
    occurs: Mask = np.any([one.occurs for one in samples], axis=0)
    points, together = _located(numbers[occurs], area_m2, config)
    row = np.nonzero(occurs)[1]
    return [
        {
            "sun_elevation": elevation,
            "by_points": round(float(points[row == k].mean()), 4),
            "with_ground": round(float(together[row == k].mean()), 4),
        }
        for k, elevation in enumerate(config.sun.elevations_deg)
        if (row == k).any()
    ]


def _steps() -> int:
    """Steps of a stored probability of 1."""
    return round(1.0 / DETECTION_STEP)


def _counts(detection: Array) -> Array:
    """Number of candidates with each stored probability, (v, e, a, steps + 1)."""
    steps = np.rint(detection / DETECTION_STEP).astype(np.int64)
    return np.stack([(steps == k).sum(axis=0) for k in range(_steps() + 1)], axis=-1, dtype=float)


def _located(numbers: Array, area_m2: float, config: BuildConfig) -> tuple[Array, Array]:
    """Probabilities (c,) to be located by points, and with the ground, of numbers of points (c, steps + 1) by claim."""
    width, half = config.points.patch_nodes - 1, DETECTION_STEP / 2.0
    claims = np.clip(np.arange(_steps() + 1) * DETECTION_STEP, half, 1.0 - half)
    offsets = offsets_of(max(reach_of(config.gsd_m), width))
    table = VoteTable(tuple(claims), offsets)
    # of all points the likeliest are added up
    above = np.cumsum(numbers[:, ::-1], axis=1)[:, ::-1]
    some = -np.diff(np.minimum(above, MOST_POINTS), axis=1, append=0.0)
    count = some.sum(axis=1)
    enough = count >= FEWEST
    share = 1.0 / (1.0 + count * (width * config.gsd_m) ** 2 / area_m2)
    by_points = table.found(numbers, chance_of(config.gsd_m))
    ground = np.zeros_like(by_points)
    ground[enough] = table.shows(some[enough], share[enough])
    return by_points @ WEIGHTS, np.maximum(by_points, ground) @ WEIGHTS
